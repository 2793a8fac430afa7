"""ActiGraph GT9X Link IMU files: ten lines about the recording, then Timestamp and g, deg/s, uT, degC.

The temperature column is of the chip: it reads 20 to 30 degC above the room.

APDM Opal: several sensors in one CSV.

Test Name:, ...
Sample Rate:,128,Hz
Time,Static/Acceleration/X, ... ,Static/Temperature/Scalar, ...        one group for each sensor
s,m/s^2, ... ,deg C, ...                                               the units

x-io sensors as their software writes them: NGIMU and x-IMU3 folders, x-IMU files.

Temperature comes in a file of its own at its own rate; it is interpolated onto the samples and held at the ends. The x-IMU
has no time column: packets are numbered and its sample rate must be stated. The x-IMU3's magnetometer is in arbitrary units
and is left unread.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.columns import AXES, Column, ColumnMap, TextLayout
from undrift.io.record import build_record, with_temperature
from undrift.io.table import Table, Text, open_text, parse_text
from undrift.record import Record
from undrift.units import si_factor

# ---- APDM Opal: several sensors in one CSV.

_GYRO, _ACCEL, _MAG, _TEMP = "Angular Velocity", "Acceleration", "Magnetic Field", "Temperature/Scalar"


def read_apdm(path: str | Path, sensor: str | None = None) -> Record:
    """Read one sensor of an APDM Opal file."""
    text = open_text(path, TextLayout(skip_rows=2))
    chosen = _choose(text, sensor)
    units = dict(zip(text.names, text.head.splitlines()[text.skip].decode("utf-8", "replace").split(","), strict=False))
    text = replace(text, skip=text.skip + 1)

    def triple(quantity: str) -> tuple[Column, ...] | None:
        names = tuple(f"{chosen}/{quantity}/{axis.upper()}" for axis in AXES)
        return names if all(name in text.names for name in names) else None

    gyro, accel, mag, temp = triple(_GYRO), triple(_ACCEL), triple(_MAG), f"{chosen}/{_TEMP}"
    columns = ColumnMap(
        time="Time",
        gyro=gyro,
        accel=accel,
        mag=mag,
        temp=temp if temp in text.names else None,
        time_unit=units["Time"],
        gyro_unit=units[str(gyro[0])] if gyro else "",
        accel_unit=units[str(accel[0])] if accel else "",
        mag_unit=units[str(mag[0])] if mag else "",
        temp_unit=units.get(temp, ""),
        device=chosen,
        sample_rate_hz=_stated_rate(text),
    )
    wanted = tuple(column for channel in columns.mapped() for column in columns.columns_of(channel))
    return build_record(parse_text(text, wanted), columns)


def apdm_sensors(path: str | Path) -> tuple[str, ...]:
    """Return the names of the sensors in an APDM file."""
    return _sensors(open_text(path, TextLayout(skip_rows=2)))


def _sensors(text: Text) -> tuple[str, ...]:
    names = [name.split("/")[0] for name in text.names if name.count("/") == 2 and f"/{_ACCEL}/" in name]
    if "Time" not in text.names or not names:
        raise FileFormatError(
            f"{text.path}: wanted an APDM header in line 3 (Time, Name/Acceleration/X, ...), got another file"
        )
    return tuple(dict.fromkeys(names))


def _choose(text: Text, sensor: str | None) -> str:
    held = _sensors(text)
    if sensor is None and len(held) == 1:
        return held[0]
    if sensor not in held:
        wanted = "the name of one sensor" if sensor is None else f"sensor {sensor!r}"
        raise InputError(f"{text.path}: wanted {wanted}, got a file with {', '.join(held)}; name one of them")
    return sensor


def _stated_rate(text: Text) -> float | None:
    cells = text.head.splitlines()[1].decode("utf-8", "replace").split(",")
    try:
        return float(cells[1])
    except (IndexError, ValueError) as error:
        raise FileFormatError(
            f"{text.path}: wanted 'Sample Rate:,128,Hz' in line 2, got {','.join(cells[:3])!r}"
        ) from error


# ---- x-io sensors as their software writes them: NGIMU and x-IMU3 folders, x-IMU files.

_GYRO_XIO: tuple[Column, ...] = tuple(f"Gyroscope {axis} (deg/s)" for axis in "XYZ")
_ACCEL_XIO: tuple[Column, ...] = tuple(f"Accelerometer {axis} (g)" for axis in "XYZ")
_PACKET = "Packet number"


def read_ngimu(path: str | Path) -> Record:
    """Read an NGIMU folder: sensors.csv, and temperature.csv where there is one."""
    path = _main_file(path, "sensors.csv")
    columns = ColumnMap(
        time="Time (s)",
        time_unit="s",
        gyro=_GYRO_XIO,
        gyro_unit="dps",
        accel=_ACCEL_XIO,
        accel_unit="g",
        mag=tuple(f"Magnetometer {axis} (uT)" for axis in "XYZ"),
        mag_unit="uT",
    )
    record = _read(path, columns)
    beside = path.parent / "temperature.csv"
    if not beside.is_file():
        return record
    time, temp_c = _two(beside, "Time (s)", "Gyroscope And Accelerometer (degC)")
    return with_temperature(record, time, temp_c)


def read_ximu3(path: str | Path) -> Record:
    """Read an x-IMU3 folder: Inertial.csv, and Temperature.csv where there is one."""
    path = _main_file(path, "Inertial.csv")
    clock = "Timestamp (us)"
    columns = ColumnMap(time=clock, time_unit="us", gyro=_GYRO_XIO, gyro_unit="dps", accel=_ACCEL_XIO, accel_unit="g")
    record = _read(path, columns)
    beside = path.parent / "Temperature.csv"
    if not beside.is_file():
        return record
    time, temp_c = _two(beside, clock, "Temperature (degC)")
    return with_temperature(record, time * si_factor("us", "time"), temp_c)


def read_ximu(path: str | Path, *, sample_rate_hz: float) -> Record:
    """Read x-IMU files: NAME_CalInertialAndMag.csv, and NAME_CalBattAndTherm.csv where there is one."""
    path = Path(path)
    if path.is_dir():
        held = sorted(path.glob("*_CalInertialAndMag.csv"))
        if len(held) != 1:
            names = ", ".join(file.name for file in held) or "none"
            raise InputError(f"{path}: wanted one *_CalInertialAndMag.csv, got {names}; name the file")
        path = held[0]
    columns = ColumnMap(
        sample_rate_hz=sample_rate_hz,
        gyro=_GYRO_XIO,
        gyro_unit="dps",
        accel=_ACCEL_XIO,
        accel_unit="g",
        mag=tuple(f"Magnetometer {axis} (G)" for axis in "XYZ"),
        mag_unit="gauss",
    )
    record = _read(path, columns)
    beside = path.with_name(path.name.replace("CalInertialAndMag", "CalBattAndTherm"))
    if beside == path or not beside.is_file():
        return record
    packet, temp_c = _two(beside, _PACKET, "Thermometer (degrees C)")
    mine = parse_text(open_text(path), (_PACKET,)).numbers(_PACKET)
    return with_temperature(record, np.interp(packet, mine, record.time), temp_c)


def _main_file(path: str | Path, name: str) -> Path:
    path = Path(path)
    if path.is_dir() and not (path / name).is_file():
        raise InputError(f"{path}: wanted a folder with {name}, got none there; check the path")
    return path / name if path.is_dir() else path


def _read(path: Path, columns: ColumnMap) -> Record:
    text = open_text(path)
    wanted = tuple(column for channel in columns.mapped() for column in columns.columns_of(channel))
    missing = [column for column in wanted if column not in text.names]
    if missing:
        raise FileFormatError(
            f"{path}: wanted column {missing[0]!r}, got {', '.join(text.names[:12])}; not the expected format"
        )
    return build_record(parse_text(text, wanted), columns)


def _two(path: Path, first: str, second: str) -> tuple[FloatArray, FloatArray]:
    table = parse_text(open_text(path), (first, second))
    return table.numbers(first), table.numbers(second)


# ---- wearables

_HEADER_LINES = 10
_CLOCK = "Timestamp"


def read_actigraph(path: str | Path) -> Record:
    """Read an ActiGraph IMU file."""

    def axes(name: str) -> tuple[Column, ...]:
        return tuple(f"{name} {axis}" for axis in "XYZ")

    text = open_text(path, TextLayout(skip_rows=_HEADER_LINES))
    lines = [line.decode("utf-8", "replace") for line in text.head.splitlines()[:_HEADER_LINES]]
    if "ActiGraph" not in lines[0] or _CLOCK not in text.names:
        raise FileFormatError(
            f"{path}: wanted an ActiGraph IMU file with a Timestamp column in line 11, got {lines[0][:40]!r}; check the format"
        )
    rate = re.search(r"at (\d+(?:\.\d+)?) Hz", lines[0])
    serial = re.search(r"Serial Number: *([A-Za-z0-9-]+)", "\n".join(lines))
    columns = ColumnMap(
        time="time_s",
        time_unit="s",
        gyro=axes("Gyroscope"),
        gyro_unit="dps",
        accel=axes("Accelerometer"),
        accel_unit="g",
        mag=axes("Magnetometer"),
        mag_unit="uT",
        temp="Temperature",
        temp_unit="degC",
        sample_rate_hz=float(rate.group(1)) if rate else None,
        device=serial.group(1) if serial else "",
    )
    wanted = tuple(
        column for channel in columns.mapped() if channel != "time" for column in columns.columns_of(channel)
    )
    table = parse_text(text, wanted)
    time = _seconds(table.columns[table.position(_CLOCK)], text.path)
    timed = Table(source=table.source, names=(*table.names, "time_s"), columns=(*table.columns, time))
    return build_record(timed, columns)


def _seconds(stamps: Any, path: Path) -> FloatArray:
    """Return seconds since the first of a column of ISO 8601 timestamps."""
    try:
        moments = np.asarray(stamps.to_numpy()).astype("datetime64[ns]")
    except (TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: wanted ISO 8601 timestamps, got something else ({error}); export them so"
        ) from error
    seconds: FloatArray = (moments - moments[0]).astype(np.int64) * 1e-9
    return seconds
