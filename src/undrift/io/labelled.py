"""Tables that contain their units: in lines before the header, in a unit row, or in names. Sensors may be next to each other.

Every column has a Label from its name and unit (``labels``). Three labels x, y, z of the same sensor and unit become a
channel. A missing unit is never added here. Only a maker's manual (``dialects``) may add it, and a note reports it.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes
from undrift.io.column_map import AXES, ChannelScale, ColumnMap, map_of_channels
from undrift.io.columns import EPOCH_S, RawTable, in_seconds, is_date
from undrift.io.labels import Label, label_of
from undrift.io.text import Text, find_table, parse_text
from undrift.units import si_factor

_SAME_TIME = 1e-9  # relative
_TIME = "(time, s)"  # name of the column of time in s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A text table with a label for each column, and the additions of a maker's map."""

    text: Text
    labels: tuple[Label | None, ...] = ()
    rate_hz: float | None = None  # sample rate from the file, Hz
    device: str = ""
    notes: tuple[str, ...] = ()
    counters: tuple[int, ...] = ()  # columns with counters of the device, instead of a time column
    clock: Callable[..., tuple[FloatArray, tuple[str, ...]]] | None = None  # time in s, and notes, from the counters
    repair_time: bool = False  # True if time stamps may repeat: such rows are omitted and counted

    @property
    def path(self) -> Path:
        """Return the path of the file."""
        return self.text.path

    def position(self, pattern: str) -> int | None:
        """Return the position of the first column whose name matches."""
        names = enumerate(self.text.names)
        return next((k for k, name in names if re.search(pattern, name, re.IGNORECASE)), None)

    def of_channel(self, channel: str) -> list[tuple[int, str, Label]]:
        """Return position, name and label of each column of a channel."""
        columns = zip(self.text.names, self.labels, strict=True)
        return [(k, name, label) for k, (name, label) in enumerate(columns) if label and label.channel == channel]

    def array(self, positions: Sequence[int]) -> FloatArray:
        """Return columns as numbers, (N, K)."""
        table = parse_text(self.text, tuple(positions))
        return np.stack([table.numbers(k) for k in positions], axis=1)


def open_sheet(path: str | Path, assumed: Mapping[str, str] | None = None, *, whole_names: bool = False) -> Sheet:
    """Open a text export and label its columns. The units ``assumed`` are from a maker's manual."""
    path = Path(path)
    text = find_table(path, read_bytes(path))
    if text is None or not text.layout.header:
        raise FileFormatError(f"{path}: expected a header line above rows of numbers, got none. Check the export.")
    first = text.cells()
    if not text.names[-1] and len(first) == len(text.names) and first[-1]:
        raise FileFormatError(
            f"{path}: expected a name for each of {len(first)} columns, got fewer. Repair the header."
        )
    return labelled(text, assumed, whole_names=whole_names)


def labelled(text: Text, assumed: Mapping[str, str] | None = None, *, whole_names: bool = False) -> Sheet:
    """Return the sheet with a label for each column, with sensors named by the distinct parts of their names."""
    units = text.units or ("",) * len(text.names)
    labels = [label_of(name, unit, assumed) for name, unit in zip(text.names, units, strict=True)]
    sensor_words = [set(label.sensor.split()) for label in labels if label and label.axis]
    shared = set.intersection(*sensor_words) if sensor_words and not whole_names else set()
    labels = [
        label and label._replace(sensor=" ".join(word for word in label.sensor.split() if word not in shared))
        for label in labels
    ]
    clocks = {k: label for k, label in enumerate(labels) if label and label.channel == "time"}
    first = text.cells()
    dated = [k for k in clocks if k < len(first) and is_date(first[k])]
    if dated and not any(label.unit for k, label in clocks.items() if k not in dated):
        labels[dated[0]] = clocks[dated[0]]._replace(unit="date")
    return Sheet(text=text, labels=tuple(labels))


# ---- from labels to a record

Triples = dict[str, dict[str, tuple[int, ...]]]  # key: channel and sensor; value: the columns x, y, z


def triples_of(sheet: Sheet, channels: tuple[str, ...] = ("gyro", "accel", "mag")) -> Triples:
    """Return the three axes of each channel and sensor. Physical units are preferred to counts."""
    triples: Triples = {}
    for channel in channels:
        groups: dict[tuple[str, str, float], dict[str, int]] = {}
        for k, _, label in sheet.of_channel(channel):
            if label.unit:
                groups.setdefault((label.sensor, label.unit, label.gain), {}).setdefault(label.axis, k)
        sensors: dict[str, tuple[int, ...]] = {}
        for (sensor, unit, _), axes in groups.items():
            if len(axes) == 3 and (sensor not in sensors or unit != "count"):
                sensors[sensor] = tuple(axes[axis] for axis in AXES)
        triples |= {channel: sensors} if sensors else {}
    return triples


def sheet_table(sheet: Sheet, how: ColumnMap) -> RawTable:
    """Return the columns of one sensor of a labelled sheet, with the map from its labels and notes on the reading."""
    triples = triples_of(sheet)
    _check_readings(sheet, triples)
    chosen = _chosen(sheet, triples, how.sensor)
    temp = _temperature(sheet, how.sensor)
    columns = chosen if temp is None else chosen | {"temp": (temp,)}
    firsts = {channel: label for channel, (k, *_) in columns.items() if (label := sheet.labels[k])}
    labels = [label for positions in chosen.values() for k in positions if (label := sheet.labels[k])]
    rates = {label.rate_hz for label in labels}
    if len(rates) > 1:
        listed = ", ".join(f"{rate:g} Hz" for rate in sorted(rate for rate in rates if rate))
        raise InputError(
            f"{sheet.path}: expected one sample rate per sensor, got {listed}. Export each rate to its own file."
        )
    table, has_time = _timed(sheet, columns, labels, how)
    rate_hz = how.sample_rate_hz or sheet.rate_hz
    if not has_time and (rate_hz := rate_hz or labels[0].rate_hz) is None:
        raise InputError(
            f"{sheet.path}: there is no time column and no sample rate. Set `sample_rate_hz`, or use a map "
            "(`column_map` FILE).",
            missing="sample_rate_hz",
        )
    table, trimmed = (table, ()) if None in rates else _trimmed(table, chosen)
    own = map_of_channels(
        {**chosen, "temp": temp, "time": _TIME if has_time else None},
        {"time": "s"} | {channel: label.unit for channel, label in firsts.items()},
        scale={channel: ChannelScale(gain=label.gain) for channel, label in firsts.items() if label.gain != 1.0},
        sample_rate_hz=rate_hz,
        gaps=how.gaps,
        clock=how.clock,
        repair_time=how.repair_time or sheet.repair_time,
        device=sheet.device or next((label.sensor for label in labels if label.sensor), ""),
    )
    return replace(table, own=own, notes=(*sheet.notes, *table.notes, *_notes(sheet, triples), *trimmed))


def _timed(
    sheet: Sheet, columns: Mapping[str, tuple[int, ...]], labels: list[Label], how: ColumnMap
) -> tuple[RawTable, bool]:
    """Return the parsed columns, and True if a time column, s, was added, from counters, dates or numbers."""
    stated = next((k for k, _, label in sheet.of_channel("time") if label.unit), None)
    clock = stated if labels[0].time is None else labels[0].time
    label = None if clock is None else sheet.labels[clock]
    dated = label is not None and label.unit == "date"
    counters = sheet.counters or (() if clock is None or dated else (clock,))
    times = sorted({label.time for label in labels if label.time is not None} - {*counters})  # per channel
    layout = sheet.text.layout.but(drop_bad_rows=how.drop_bad_rows)
    positions = (*(k for channel in columns.values() for k in channel), *counters, *times)
    table = parse_text(replace(sheet.text, layout=layout), positions)
    notes, epoch_s = table.notes, 0.0
    if sheet.clock is not None:
        time, clock_notes = sheet.clock(*_counts(sheet, table))
        notes += clock_notes
    elif clock is None or label is None:
        return table, False
    else:
        factor = si_factor(label.unit, "time")
        cells = (in_seconds(table, clock) if dated else table).numbers(clock)
        first = float(cells[0]) if len(cells) and cells[0] * factor > EPOCH_S else 0.0
        time, epoch_s = (cells - first) * factor, first * factor
    for k in times:
        if (wrong := np.flatnonzero(np.abs(table.numbers(k) - cells) > _SAME_TIME * np.abs(cells))).size:
            raise FileFormatError(
                f"{sheet.path}: expected one time for all channels of a sensor, got {cells[wrong[0]]:g} and "
                f"{table.numbers(k)[wrong[0]]:g} in data row {table.row(int(wrong[0]))}. Repair the file."
            )
    names, columns_ = (*table.names, _TIME), (*table.columns, time)
    return replace(table, names=names, columns=columns_, notes=notes, epoch_s=epoch_s), True


def _counts(sheet: Sheet, table: RawTable) -> list[FloatArray]:
    """Return the columns with counters of the device."""
    counts = [table.numbers(k) for k in sheet.counters]
    for k, counter in zip(sheet.counters, counts, strict=True):
        if not np.isfinite(counter).all():
            raise FileFormatError(
                f"{sheet.path}: column {sheet.text.names[k]!r}: expected a count in every row, got none in data row "
                f"{int(np.isfinite(counter).argmin()) + 1}. Repair the file."
            )
    return counts


def _trimmed(table: RawTable, chosen: Mapping[str, tuple[int, ...]]) -> tuple[RawTable, tuple[str, ...]]:
    """Remove the rows that a slower channel does not fill, and the zeros at its start."""
    values = np.stack([table.numbers(k) for columns in chosen.values() for k in columns], axis=1)
    filled = np.isfinite(values).any(axis=1)
    live = np.flatnonzero(filled & (values != 0.0).any(axis=1))
    if not len(live):
        return table, ()
    cut = slice(int(live[0]), int(np.flatnonzero(filled)[-1]) + 1)
    notes = (f"{cut.start} rows of zeros at the start left out",) if cut.start else ()
    return replace(table, columns=tuple(column[cut] for column in table.columns)), notes


def _check_readings(sheet: Sheet, triples: Triples) -> None:
    if triples.get("gyro") or triples.get("accel"):
        return
    if free := sheet.of_channel("free"):
        raise FileFormatError(
            f"{sheet.path}: expected accelerometer readings with gravity, got {free[0][1]!r}, acceleration without "
            "gravity. Record or export the acceleration with gravity.",
            missing="readings",
        )
    listing = ", ".join(repr(name) for name in sheet.text.names[:8] if name)
    raise FileFormatError(
        f"{sheet.path}: expected gyroscope or accelerometer columns x, y, z with a unit, got {listing}. Export them, "
        "or use a map (`column_map` FILE).",
        missing="readings",
    )


def _chosen(sheet: Sheet, triples: Triples, sensor: str | None) -> dict[str, tuple[int, ...]]:
    """Return the columns of the named sensor. Part of a name is enough if it is unique. No name is needed for a single sensor."""
    sensors = [sensor for channel in ("accel", "gyro") for sensor in triples.get(channel, {}) if sensor]
    names, wanted = tuple(dict.fromkeys(sensors)), None
    if sensor is not None:
        same = [name for name in names if name.lower() == sensor.lower()]
        partial_matches = [name for name in names if sensor.lower() in name.lower()]
        wanted = same[0] if same else partial_matches[0] if len(partial_matches) == 1 else None
    several = any(len(by_sensor) > 1 for channel, by_sensor in triples.items() if channel != "mag")
    if wanted is None and names and (several or sensor is not None):
        got = "none" if sensor is None else repr(sensor)
        raise InputError(
            f"{sheet.path}: expected the name of one sensor, got {got}. The file contains {', '.join(names)}. "
            f"Choose one with `sensor`.",
            missing="sensor",
            names=names,
        )
    chosen: dict[str, tuple[int, ...]] = {}
    for channel, by_sensor in triples.items():
        only = next(iter(by_sensor.values())) if len(by_sensor) == 1 else None  # none of several
        if columns := only if wanted is None else by_sensor.get(wanted) or by_sensor.get(""):
            chosen[channel] = columns
    return chosen


def _temperature(sheet: Sheet, sensor: str | None) -> int | None:
    """Return the column of the sensor's thermometer, or of the only thermometer."""
    thermometers = [(label.sensor, k) for k, _, label in sheet.of_channel("temp") if label.unit]
    mine = [k for name, k in thermometers if sensor is not None and name.lower() == sensor.lower()]
    return mine[0] if mine else thermometers[0][1] if len(thermometers) == 1 else None


def _notes(sheet: Sheet, triples: Triples) -> tuple[str, ...]:
    """Return notes on how a sheet was read and which columns were left out."""
    notes = []
    if lines := sum(bool(line.strip()) for line in sheet.text.preamble):
        notes.append(f"lines before the header skipped: {lines}")
    if sheet.text.units:
        notes.append("units from the row under the header")
    if free := sheet.of_channel("free"):
        notes.append(f"{free[0][1]!r} left out: gravity is removed in it")
    for channel, what in (("gyro", "a turn rate"), ("accel", "an acceleration"), ("mag", "a magnetic field")):
        columns = [] if channel in triples else sheet.of_channel(channel)
        axes = {label.axis for _, _, label in columns if label.unit}
        bare = next((name for _, name, label in columns if not label.unit), None)
        if axes:
            notes.append(f"{what.partition(' ')[2]} left out: it has only axes {', '.join(sorted(axes))}")
        if bare:
            notes.append(f"{bare!r} left out: it has no unit of {what}")
    return tuple(notes)


# ---- tables that contain all necessary information


def is_labelled(path: Path, head: bytes) -> bool:
    """Return True if a text contains a unit for a gyroscope or an accelerometer, and for its time column, if any."""
    if b"\0" in head or not head or path.suffix.lower() in (".md", ".rst", ".pdf", ".html", ".json", ".toml", ".xml"):
        return False
    text = find_table(path, head if len(head) < 8192 else head[: head.rfind(b"\n") + 1])
    return text is not None and text.layout.header and states_units(labelled(text))


def states_units(sheet: Sheet) -> bool:
    """Return True if labels contain a unit for a gyroscope or an accelerometer, and for the time column, if any."""
    clocks = sheet.of_channel("time")
    triples = triples_of(sheet, ("gyro", "accel", "free"))
    bare = {label.channel for label in sheet.labels if label and not label.unit and label.channel in ("gyro", "accel")}
    return bool(triples) and bare <= triples.keys() and (not clocks or any(label.unit for _, _, label in clocks))


def read_labelled(path: Path, how: ColumnMap) -> RawTable:
    """Read a table whose names or unit row contain every unit."""
    return sheet_table(open_sheet(path), how)
