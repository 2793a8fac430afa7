"""The text exports of makers, a row of DIALECTS each: how a file is recognised, and what its manual states but the file does not.

A dialect names its columns (``columns``, keys of a ColumnMap), or it is labelled: names and unit rows state what each column is
(io/labelled.py), and the row adds units of the manual, what is left out, and what a function of io/makers.py finds. A folder is
read by the file in it that ``folder`` names. A new maker is a new row::

    "step_logger": Dialect(
        head=rb"\\A# StepLogger \\d",
        maker="StepLogger",
        units={"gyro": "dps", "accel": "g"},
        device=r"^# unit (\\w+)",
        rate=r"^# rate (\\d+)",
    ),
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.errors import FileFormatError, InputError
from undrift.io.columns import READ_SETTINGS, ColumnMap, ReadResult, ReadSettings, TextLayout, build_record
from undrift.io.labelled import Sheet, open_sheet, read_sheet, with_manual
from undrift.io.makers import (
    OPPOSITE,
    SI,
    apdm7_labels,
    dot_clock,
    in_g,
    one_gyroscope,
    read_dot_poses,
    read_xsens_poses,
    sensor_logger_labels,
    trigno_discover_labels,
    trigno_labels,
    with_readings,
    with_temp,
    xsens_clock,
)
from undrift.io.reference import ReferenceMap, read_text_poses
from undrift.io.text import open_text, parse_text
from undrift.record import Record, Reference
from undrift.units import si_factor


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How one maker's software writes a table of text."""

    head: bytes  # Pattern of the first 8 KiB of a file
    folder: str = ""  # Which file of a folder is read: its name, or "*" and its ending
    maker: str = ""  # Whose manual states the units
    units: Mapping[str, str] = field(default_factory=dict)  # By the manual, of channels whose columns state none
    device: str = ""  # Pattern in the lines before the header, whose group is the serial number
    rate: str = ""  # Likewise the sample rate, Hz
    omit: str = ""  # Pattern of columns that are not readings of a sensor
    sensor: tuple[str, str] = ("", "")  # Pattern in a sensor's name, and what takes its place
    opposite: bool = False  # Acceleration is the opposite of specific force
    repair_time: bool = False  # Stamps may repeat: such rows are left out and counted
    header: bool = True  # False where what stands over the readings is no line of names
    finish: tuple[Callable[[Sheet, ReadSettings], Sheet], ...] = ()  # What the keys above do not say
    # Name and unit of each channel, {} for X, Y and Z, where columns are fixed. They stand after so many lines; temperature, degC,
    # may have a file of its own: its name, its columns of time (or packets, as in the table) and of temperature
    columns: Mapping[str, tuple[str, str]] | None = None
    skip_rows: int = 0
    thermometer: tuple[str, str, str] | None = None
    poses: Callable[[Path, ReferenceMap | None], Reference] | None = None  # Who reads a table of orientations

    def read(self, path: Path, _: ColumnMap | None = None, settings: ReadSettings = READ_SETTINGS) -> ReadResult:
        """Read a file, or a folder, of this dialect."""
        if self.columns is not None:
            return ReadResult(record=self._by_columns(self._file(path), settings))
        return read_sheet(self._labelled(open_sheet(self._file(path), header=self.header), settings), settings)

    def _file(self, path: Path) -> Path:
        if not path.is_dir():
            return path
        files = sorted(path.glob(self.folder))
        if not files:
            raise InputError(f"{path}: wanted a folder with {self.folder}, got none there; check the path")
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise InputError(f"{path}: wanted one {self.folder}, got {names}; name the file")
        return files[0]

    def _labelled(self, sheet: Sheet, settings: ReadSettings) -> Sheet:
        """Return a sheet with its labels, clock, device and notes."""
        stated = sheet.stated(self.rate) if self.rate else None
        device = (sheet.stated(self.device) or "").strip(", ") if self.device else ""
        sheet = replace(sheet, device=device, rate_hz=float(stated) if stated else None, repair_time=self.repair_time)
        sheet = with_manual(sheet, self.maker, self.units)
        labels = []
        for name, label in zip(sheet.names, sheet.labels, strict=True):
            if label and not (self.omit and re.search(self.omit, name)):
                turned = self.opposite and label.channel == "accel"
                sensor = re.sub(*self.sensor, label.sensor) if self.sensor[0] else label.sensor
                labels.append(label._replace(sensor=sensor, gain=-label.gain if turned else label.gain))
            else:
                labels.append(None)
        sheet = replace(sheet, labels=tuple(labels), notes=(*sheet.notes, *([OPPOSITE] if self.opposite else [])))
        for finish in self.finish:
            sheet = finish(sheet, settings)
        return sheet

    def _by_columns(self, path: Path, settings: ReadSettings) -> Record:
        """Return the record of fixed columns, with the temperature of a file of its own where there is one."""
        text = open_text(path, TextLayout(skip_rows=self.skip_rows))
        preamble = "\n".join(line.decode("utf-8", "replace") for line in text.head.splitlines()[: self.skip_rows])
        rate, device = (re.search(pattern, preamble) if pattern else None for pattern in (self.rate, self.device))
        keys: dict[str, Any] = {"device": device.group(1) if device else ""}
        for channel, (name, unit) in (self.columns or {}).items():
            three = tuple(name.format(axis) for axis in "XYZ")
            keys |= {channel: three if "{}" in name else name, f"{channel}_unit": unit}
        keys["sample_rate_hz"] = float(rate.group(1)) if rate else None if "time" in keys else settings.sample_rate_hz
        if "time" not in keys and keys["sample_rate_hz"] is None:
            raise InputError(
                f"{path}: wanted the sample rate of this {self.maker} recording, got none; give sample_rate_hz (--sample-rate-hz)"
            )
        columns = ColumnMap(**keys)
        missing = [column for column in columns.wanted() if column not in text.names]
        if missing:
            raise FileFormatError(
                f"{path}: wanted column {missing[0]!r}, got {', '.join(text.names[:12])}; not the expected format of {self.maker}"
            )
        record = build_record(parse_text(text, columns.numeric()), columns).record
        if self.thermometer is None:
            return record
        name, clock, temp = self.thermometer
        slow = path.with_name(name.replace("*", path.name.removesuffix(self.folder.removeprefix("*"))))
        if not slow.is_file():
            return record
        table = parse_text(open_text(slow), (clock, temp))
        time = table.numbers(clock)
        if clock == columns.time:
            time = time * si_factor(columns.time_unit, "time")
        else:  # numbers of packets: their times are those of the samples
            time = np.interp(time, parse_text(text, (clock,)).numbers(clock), record.time)
        return with_temp(record, time, table.numbers(temp))


_XIO = {"gyro": ("Gyroscope {} (deg/s)", "dps"), "accel": ("Accelerometer {} (g)", "g")}
DIALECTS: dict[str, Dialect] = {
    "actigraph": Dialect(  # its temperature is the chip's: 20 to 30 degC above the room
        head=rb"\A.*Data File Created By ActiGraph",
        maker="ActiGraph",
        rate=r"\A.*?at (\d+(?:\.\d+)?) Hz",
        device=r"Serial Number: *([A-Za-z0-9-]+)",
        skip_rows=10,
        columns={
            "time": ("Timestamp", "date"),
            "gyro": ("Gyroscope {}", "dps"),
            "accel": ("Accelerometer {}", "g"),
            "mag": ("Magnetometer {}", "uT"),
            "temp": ("Temperature", "degC"),
        },
    ),
    "ngimu": Dialect(
        head=rb"\ATime \(s\).*Gyroscope X \(deg/s\)",
        folder="sensors.csv",
        maker="NGIMU",
        columns=_XIO | {"time": ("Time (s)", "s"), "mag": ("Magnetometer {} (uT)", "uT")},
        thermometer=("temperature.csv", "Time (s)", "Gyroscope And Accelerometer (degC)"),
        poses=read_text_poses,
    ),
    "ximu3": Dialect(  # its magnetometer has no unit
        head=rb"\ATimestamp \(us\).*Gyroscope X \(deg/s\)",
        folder="Inertial.csv",
        maker="x-IMU3",
        columns=_XIO | {"time": ("Timestamp (us)", "us")},
        thermometer=("Temperature.csv", "Timestamp (us)", "Temperature (degC)"),
        poses=read_text_poses,
    ),
    "ximu": Dialect(
        head=rb"\APacket number.*Gyroscope X \(deg/s\)",
        folder="*_CalInertialAndMag.csv",
        maker="x-IMU",
        columns=_XIO | {"mag": ("Magnetometer {} (G)", "gauss")},
        thermometer=("*_CalBattAndTherm.csv", "Packet number", "Thermometer (degrees C)"),
    ),
    "xsens": Dialect(
        head=rb"\A(\xef\xbb\xbf)?//[\s\S]*^(Packet)?Counter[\t,; ]",
        maker="Xsens",
        units=SI,
        device=r"^// *DeviceId: *(\w+)",
        finish=(xsens_clock, with_readings),
        poses=read_xsens_poses,
    ),
    "dot": Dialect(
        head=rb"\A(\xef\xbb\xbf)?sep=[\s\S]*^PacketCounter,",
        maker="Movella DOT",
        units={"gyro": "dps", "accel": "m/s2"},
        device=r"^DeviceTag:, *(.*)$",
        finish=(dot_clock, with_readings),
        poses=read_dot_poses,
    ),
    "shimmer": Dialect(  # stamps of Consensys are whole ms
        head=rb"\A.*\n?.*Timestamp_\w*(CAL|RAW)\b.*(Accel|Gyro)_\w*(CAL|RAW)\b", repair_time=True
    ),
    "trigno": Dialect(head=rb"\ALabel: .*Sampling frequency:", finish=(trigno_labels,)),
    "trigno_discover": Dialect(head=rb"\AApplication:.*Trigno", header=False, finish=(trigno_discover_labels,)),
    "noraxon": Dialect(  # "RT Hand" and "Hand RT" are one sensor
        head=rb"Accel Sensor [XYZ]|Noraxon MyoMotion-",
        maker="Noraxon",
        units={"time": "s"},
        omit=r"(?i)segments-.*-acceleration",
        sensor=(r"^([LR]T) (.+)", r"\2 \1"),
    ),
    "sensor_logger": Dialect(head=rb"\Atime,seconds_elapsed,", finish=(sensor_logger_labels,)),
    "sensorlog": Dialect(
        head=rb"accelerometerAcceleration[XYZ]\(G\)|gyroRotation[XYZ]\(rad/s\)",
        opposite=True,
        finish=(one_gyroscope,),
    ),
    "mobgap": Dialect(
        head=rb"\Asamples,acc_x,acc_y,acc_z,gyr_x",
        maker="mobgap",
        units={"accel": "g", "gyro": "dps"},
        finish=(in_g,),
    ),
    "apdm7": Dialect(head=rb"\AFormat=7,", finish=(apdm7_labels,)),
}
