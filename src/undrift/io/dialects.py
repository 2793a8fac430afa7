"""Text exports of makers as data. A TOML file in ``maps`` defines how a maker's file is recognised and which units its
manual specifies.

For a new maker, only a new file in ``maps`` is needed::

    # step_logger.toml
    maker = "StepLogger"
    head = '\\A# StepLogger \\d'                # pattern of the first 8 KiB of a file
    units = { gyro = "dps", accel = "g" }     # units from the manual, for columns without a unit
    device = '^# unit (\\w+)'                  # pattern in the lines before the header; its group is the serial number
    rate = '^# rate (\\d+)'                    # sample rate, Hz

The other units come from the header and the unit row of a file (``labelled``).
"""

import re
import tomllib
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import READ_SETTINGS, ColumnMap
from undrift.io.columns import RawTable
from undrift.io.labelled import Sheet, labelled, open_sheet, sheet_table
from undrift.io.labels import Label, label_of, unit_for
from undrift.io.text import open_text, parse_text
from undrift.units import si_factor

Pattern = Annotated[re.Pattern[str], BeforeValidator(lambda text: re.compile(text, re.MULTILINE))]


class MapTable(BaseModel):
    """A table of a shipped map."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)


class MapCounter(MapTable):
    """A column with a counter of the device."""

    column: str  # pattern of the column's name
    bits: int  # number of counts after which the counter restarts at 0
    step_s: float | None = None  # time between two counts, or 1 / sample rate
    absolute: bool = False  # True if several files share the clock: time starts at the first count, not at 0
    note: str = ""


class MapThermometer(MapTable):
    """A separate file with the temperature, degC."""

    file: str  # name of the file, with "*" for the part that differs between recordings
    time: str  # time column, with the same name as in the recording
    temp: str  # temperature column


class Dialect(MapTable):
    """The text table format of a maker's software."""

    maker: str  # device whose manual contains the units
    head: Pattern  # pattern in the first 8 KiB of a file
    folder: str = ""  # file of a folder that is read: its name, or "*" and its ending
    units: dict[str, str] = {}  # units from the manual, for channels whose columns have no unit
    device: str = ""  # pattern in the lines before the header, with the serial number as its group
    device_in_name: Pattern | None = None  # pattern of the device in the name of the file
    rate: str = ""  # pattern in the lines before the header, with the sample rate as its group, Hz
    channel_line: Pattern | None = None  # line before the header with name, sensor, signal, rate, unit, time
    packets: MapCounter | None = None  # counter of the packets: a skipped number is a lost packet
    stamps: MapCounter | None = None  # clock of the device
    omit: Pattern | None = None  # columns that are not readings of a sensor
    sensor: tuple[str, str] | None = None  # pattern in the name of a sensor, and its replacement
    whole_names: bool = False  # True if a sensor keeps its name in a file with one sensor
    repair_time: bool = False  # True if time stamps may repeat: such rows are omitted and counted
    thermometer: MapThermometer | None = None

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return True if the first bytes of a file, or the names in a folder, match this maker."""
        if not head:
            return bool(self.folder) and any(path.glob(self.folder))
        return b"\0" not in head and self.head.search(head.decode("latin-1")) is not None

    def read(self, path: Path, how: ColumnMap = READ_SETTINGS) -> RawTable:
        """Read a file or a folder."""
        sheet = self._labelled(self._file(path))
        rate_hz = how.sample_rate_hz or sheet.rate_hz
        table = sheet_table(replace(self._with_clock(sheet, rate_hz), rate_hz=rate_hz), how)
        return self._with_thermometer(table, sheet)

    def _file(self, path: Path) -> Path:
        if not path.is_dir():
            return path
        matches = sorted(path.glob(self.folder))
        if len(matches) != 1:
            names = ", ".join(file.name for file in matches) or "none there"
            raise InputError(f"{path}: expected one {self.folder}, got {names}. Give the path of one file.")
        return matches[0]

    def _labelled(self, path: Path) -> Sheet:
        """Return a sheet with labels, device and notes."""
        sheet = open_sheet(path, self.units, whole_names=self.whole_names)
        device, rate = (_stated(pattern, sheet.text.preamble) for pattern in (self.device, self.rate))
        names = self.device_in_name.findall(path.name) if self.device_in_name else []
        labels, notes = sheet.labels, tuple[str, ...]()
        if self.channel_line:
            labels = _labels_of_lines(self.channel_line, sheet)
        else:
            in_file = {label.channel for label in labelled(sheet.text).labels if label and label.unit}
            assumed = {label.channel for label in labels if label and label.unit} - in_file
            if units := ", ".join(f"{channel} {unit}" for channel, unit in self.units.items() if channel in assumed):
                notes = (f"units from the manual of {self.maker}, not from the file: {units}",)
            labels = tuple(map(self._own, sheet.text.names, labels))
        return replace(
            sheet,
            labels=labels,
            notes=notes,
            device=device.strip(", ") or (names[-1] if names else ""),
            rate_hz=float(rate) if rate else None,
            repair_time=self.repair_time,
        )

    def _own(self, name: str, label: Label | None) -> Label | None:
        """Return the label of a column according to the rules of the maker."""
        if label is None or (self.omit and self.omit.search(name)):
            return None
        if self.sensor:
            label = label._replace(sensor=re.sub(*self.sensor, label.sensor).strip())
        return label

    def _with_clock(self, sheet: Sheet, rate_hz: float | None) -> Sheet:
        """Return a sheet with the clock of its packets or its time stamps. Lost packets become gaps in time."""
        packets, stamps = (None if c is None else sheet.position(c.column) for c in (self.packets, self.stamps))
        absolute = self.stamps is not None and self.stamps.absolute
        if absolute and (packets is None or stamps is None):
            raise FileFormatError(
                f"{sheet.path}: expected the columns of the packet counter and of its time stamps, got "
                f"{', '.join(sheet.text.names[:8])}. Export them too."
            )
        by_rate = packets is not None and rate_hz is not None and not absolute
        ticks, counter = (packets, self.packets) if by_rate else (stamps, self.stamps)
        if ticks is None or counter is None or not (by_rate or np.isfinite(sheet.array((ticks,))).all()):
            return sheet
        step_s = 1.0 / rate_hz if by_rate and rate_hz else counter.step_s or np.nan

        def clock(count: FloatArray, *packet: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
            start = count[0] if absolute else 0.0
            numbers = (_from_zero(sheet, other, self.packets) for other in packet)
            lost = (int(number[-1]) + 1 - len(number) for number in numbers if len(number))
            notes = [
                f"{n} of {n + len(count)} packets lost according to PacketCounter are gaps in time"
                for n in lost
                if n > 0
            ]
            note = [counter.note] if counter.note else []
            return step_s * (start + _from_zero(sheet, count, counter)), (*note, *notes)

        counters = (ticks, packets) if packets is not None and (by_rate or absolute) else (ticks,)
        return replace(sheet, clock=clock, counters=counters)

    def _with_thermometer(self, table: RawTable, sheet: Sheet) -> RawTable:
        """Return the table with the temperature of the file next to it, if there is one."""
        if self.thermometer is None:
            return table
        stem = sheet.path.name.removesuffix(self.folder.removeprefix("*"))
        path = sheet.path.with_name(self.thermometer.file.replace("*", stem))
        clock = sheet.position(f"^{re.escape(self.thermometer.time)}$")
        label = None if clock is None else sheet.labels[clock]
        if clock is None or not path.is_file():
            return table
        slow = parse_text(open_text(path), (self.thermometer.time, self.thermometer.temp))
        time = slow.numbers(self.thermometer.time)
        if label is not None and label.unit:
            time = time * si_factor(label.unit, "time")
        else:  # packets are numbered, and their times are the times of the samples
            rate_hz = (table.own and table.own.sample_rate_hz) or np.nan
            time = np.interp(time, sheet.array((clock,))[:, 0], np.arange(len(table)) / rate_hz)
        return replace(table, thermometer=(time, slow.numbers(self.thermometer.temp)))


@cache
def dialects() -> dict[str, Dialect]:
    """Return the shipped maps by the names of their files."""
    maps = sorted((path for path in files("undrift.io").joinpath("maps").iterdir()), key=lambda path: path.name)
    return {
        path.name.removesuffix(".toml"): Dialect.model_validate(tomllib.loads(path.read_text("utf-8")))
        for path in maps
        if path.name.endswith(".toml")
    }


def _stated(pattern: str, lines: tuple[str, ...]) -> str:
    """Return the first group of a pattern in lines, or an empty string."""
    match = re.search(pattern, "\n".join(lines), re.IGNORECASE | re.MULTILINE) if pattern else None
    return match.group(1).strip() if match else ""


def _labels_of_lines(pattern: re.Pattern[str], sheet: Sheet) -> tuple[Label | None, ...]:
    """Return the labels from the lines before the header. Each channel has a column of time before it."""
    channels = {match["name"]: match for text in sheet.text.preamble if (match := pattern.search(text))}
    labels: list[Label | None] = [None] * len(sheet.text.names)
    for k, name in enumerate(sheet.text.names):
        label = label_of(channels[name]["signal"], channels[name]["unit"]) if name in channels and k > 0 else None
        if label is not None:
            line = channels[name]
            labels[k - 1] = Label("", "own time", unit=(unit_for(line["time"], "time") or ("s", 1.0))[0])
            labels[k] = label._replace(sensor=line["sensor"], rate_hz=float(line["rate"]), time=k - 1)
    return tuple(labels)


def _from_zero(sheet: Sheet, counts: FloatArray, counter: MapCounter | None) -> FloatArray:
    """Return a counter that starts at 0, without overflows. A step of half its range or more is a step back."""
    size = 1 << (counter.bits if counter else 32)
    steps = np.mod(np.diff(counts), size)
    if (back := np.flatnonzero(steps > size // 2)).size:
        raise FileFormatError(
            f"{sheet.path}: expected a counter that increases, got {counts[back[0]]:.10g} and then "
            f"{counts[back[0] + 1]:.10g} in "
            f"data row {back[0] + 2}. The file is damaged or contains two recordings. Split it there."
        )
    return np.concatenate(([0.0], np.cumsum(steps)))
