"""Readers of wearables' own files: APDM Opal, x-io (NGIMU, x-IMU, x-IMU3), ActiGraph GT9X Link.

Temperature that comes in a file of its own, at its own rate, is interpolated onto the samples and held at the ends.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.columns import AXES, Column, ColumnMap, Table, TempFile, TextLayout, build_record
from undrift.io.text import Text, open_text, parse_text
from undrift.record import Record
from undrift.units import canonical_unit, si_factor, temp_offset

# ---- APDM Opal: several sensors in one CSV
#
#     Test Name:, ...
#     Sample Rate:,128,Hz
#     Time,Static/Acceleration/X, ... ,Static/Temperature/Scalar, ...        one group for each sensor
#     s,m/s^2, ... ,deg C, ...                                               the units


def read_apdm(path: str | Path, sensor: str | None = None) -> Record:
    """Read one sensor of an APDM Opal file."""
    text = open_text(path, TextLayout(skip_rows=2))
    sensors = _sensors(text)
    if sensor is None and len(sensors) == 1:
        (sensor,) = sensors
    if sensor not in sensors:
        wanted = "the name of one sensor" if sensor is None else f"sensor {sensor!r}"
        raise InputError(f"{text.path}: wanted {wanted}, got a file with {', '.join(sensors)}; name one of them")
    lines = [line.decode("utf-8", "replace").split(",") for line in text.head.splitlines()[: text.skip + 1]]
    if len(lines) <= text.skip:
        raise FileFormatError(
            f"{text.path}: wanted a row of units under the header, got the end of the file; copy it again"
        )
    try:
        rate = float(lines[1][1])
    except (IndexError, ValueError) as error:
        raise FileFormatError(
            f"{text.path}: wanted 'Sample Rate:,128,Hz' in line 2, got {','.join(lines[1][:3])!r}"
        ) from error
    units = dict(zip(text.names, lines[text.skip], strict=False))

    held: dict[str, Any] = {"time": "Time", "time_unit": units["Time"]}
    for channel, quantity in (("gyro", "Angular Velocity"), ("accel", "Acceleration"), ("mag", "Magnetic Field")):
        names = tuple(f"{sensor}/{quantity}/{axis.upper()}" for axis in AXES)
        if all(name in text.names for name in names):
            held |= {channel: names, f"{channel}_unit": units[names[0]]}
    if (temp := f"{sensor}/Temperature/Scalar") in text.names:
        held |= {"temp": temp, "temp_unit": units.get(temp, "")}
    columns = ColumnMap(**held, device=sensor, sample_rate_hz=rate)
    return build_record(parse_text(replace(text, skip=text.skip + 1), columns.wanted()), columns).record


def apdm_sensors(path: str | Path) -> tuple[str, ...]:
    """Return the names of the sensors in an APDM file."""
    return _sensors(open_text(path, TextLayout(skip_rows=2)))


def _sensors(text: Text) -> tuple[str, ...]:
    names = [name.split("/")[0] for name in text.names if name.count("/") == 2 and "/Acceleration/" in name]
    if "Time" not in text.names or not names:
        raise FileFormatError(
            f"{text.path}: wanted an APDM header in line 3 (Time, Name/Acceleration/X, ...), got another file"
        )
    return tuple(dict.fromkeys(names))


# ---- x-io sensors as their software writes them

_GYRO: tuple[Column, ...] = tuple(f"Gyroscope {axis} (deg/s)" for axis in "XYZ")
_ACCEL: tuple[Column, ...] = tuple(f"Accelerometer {axis} (g)" for axis in "XYZ")
_XIO = ColumnMap(time="", time_unit="s", gyro=_GYRO, gyro_unit="dps", accel=_ACCEL, accel_unit="g")
_PACKET = "Packet number"


def read_ngimu(path: str | Path) -> Record:
    """Read an NGIMU folder: sensors.csv, and temperature.csv where there is one."""
    path, clock = _main_file(path, "sensors.csv"), "Time (s)"
    record = _read(path, replace(_XIO, time=clock, mag=_magnetometer("uT"), mag_unit="uT"))
    return _with_temperature(record, path.parent / "temperature.csv", clock, "Gyroscope And Accelerometer (degC)", "s")


def read_ximu3(path: str | Path) -> Record:
    """Read an x-IMU3 folder: Inertial.csv, and Temperature.csv where there is one; its magnetometer has no unit."""
    path, clock = _main_file(path, "Inertial.csv"), "Timestamp (us)"
    record = _read(path, replace(_XIO, time=clock, time_unit="us"))
    return _with_temperature(record, path.parent / "Temperature.csv", clock, "Temperature (degC)", "us")


def read_ximu(path: str | Path, sample_rate_hz: float | None = None) -> Record:
    """Read x-IMU files, which number packets: NAME_CalInertialAndMag.csv, and NAME_CalBattAndTherm.csv where there is one."""
    path = Path(path)
    if sample_rate_hz is None:
        raise InputError(
            f"{path}: wanted the sample rate of this x-IMU recording, got none; give sample_rate_hz (--sample-rate-hz)"
        )
    if path.is_dir():
        held = sorted(path.glob("*_CalInertialAndMag.csv"))
        if len(held) != 1:
            names = ", ".join(file.name for file in held) or "none"
            raise InputError(f"{path}: wanted one *_CalInertialAndMag.csv, got {names}; name the file")
        path = held[0]
    columns = replace(_XIO, time=None, sample_rate_hz=sample_rate_hz, mag=_magnetometer("G"), mag_unit="gauss")
    record, slow = _read(path, columns), path.with_name(path.name.replace("CalInertialAndMag", "CalBattAndTherm"))
    if slow == path or not slow.is_file():
        return record
    table = parse_text(open_text(slow), (_PACKET, "Thermometer (degrees C)"))
    mine = parse_text(open_text(path), (_PACKET,)).numbers(_PACKET)
    time = np.interp(table.numbers(_PACKET), mine, record.time)
    return _interpolated(record, time, table.numbers("Thermometer (degrees C)"))


def _magnetometer(unit: str) -> tuple[Column, ...]:
    return tuple(f"Magnetometer {axis} ({unit})" for axis in "XYZ")


def _main_file(path: str | Path, name: str) -> Path:
    path = Path(path)
    if path.is_dir() and not (path / name).is_file():
        raise InputError(f"{path}: wanted a folder with {name}, got none there; check the path")
    return path / name if path.is_dir() else path


def _read(path: Path, columns: ColumnMap) -> Record:
    text = open_text(path)
    missing = [column for column in columns.wanted() if column not in text.names]
    if missing:
        raise FileFormatError(
            f"{path}: wanted column {missing[0]!r}, got {', '.join(text.names[:12])}; not the expected format"
        )
    return build_record(parse_text(text, columns.wanted()), columns).record


def _with_temperature(record: Record, slow: Path, clock: str, column: str, time_unit: str) -> Record:
    """Return the record with the temperature of a file of its own, where there is one."""
    if not slow.is_file():
        return record
    table = parse_text(open_text(slow), (clock, column))
    return _interpolated(record, table.numbers(clock) * si_factor(time_unit, "time"), table.numbers(column))


def _interpolated(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
    known = np.isfinite(time) & np.isfinite(temp_c)
    if not known.any():
        raise InputError("temperature: wanted one reading or more, got none; leave the temperature file out")
    order = np.argsort(time[known], kind="stable")
    return replace(record, temp_c=np.interp(record.time, time[known][order], temp_c[known][order]))


def with_thermometer(record: Record, thermometer: TempFile) -> Record:
    """Return the record with the temperature of a thermometer's own file."""
    table = parse_text(open_text(thermometer.path, thermometer.layout), (thermometer.time, thermometer.temp))
    time = table.numbers(thermometer.time) * si_factor(thermometer.time_unit, "time") + thermometer.shift_s
    unit = canonical_unit(thermometer.temp_unit, "temp")
    temp_c = table.numbers(thermometer.temp) * si_factor(unit, "temp") + temp_offset(unit)
    known = time[np.isfinite(time) & np.isfinite(temp_c)]
    if len(known) and (known.max() < record.time[0] or known.min() > record.time[-1]):
        raise InputError(
            f"{thermometer.path}: wanted temperatures from {record.time[0]:.6g} to {record.time[-1]:.6g} s, the recording's clock, "
            f"got {known.min():.6g} to {known.max():.6g} s; set temp_file.shift_s, in s"
        )
    try:
        return _interpolated(record, time, temp_c)
    except InputError as error:
        raise InputError(f"{thermometer.path}: {error}") from error


# ---- ActiGraph GT9X Link: ten lines about the recording, then Timestamp and g, deg/s, uT, degC

_HEADER_LINES = 10
_CLOCK = "Timestamp"


def read_actigraph(path: str | Path) -> Record:
    """Read an ActiGraph IMU file. Its temperature is the chip's: 20 to 30 degC above the room."""
    text = open_text(path, TextLayout(skip_rows=_HEADER_LINES))
    lines = [line.decode("utf-8", "replace") for line in text.head.splitlines()[:_HEADER_LINES]]
    if "ActiGraph" not in lines[0] or _CLOCK not in text.names:
        raise FileFormatError(
            f"{path}: wanted an ActiGraph IMU file with a Timestamp column in line 11, got {lines[0][:40]!r}; check the format"
        )
    rate = re.search(r"at (\d+(?:\.\d+)?) Hz", lines[0])
    serial = re.search(r"Serial Number: *([A-Za-z0-9-]+)", "\n".join(lines))
    gyro, accel, mag = (
        tuple(f"{name} {axis}" for axis in "XYZ") for name in ("Gyroscope", "Accelerometer", "Magnetometer")
    )
    columns = replace(
        _XIO, time="time_s", gyro=gyro, accel=accel, mag=mag, mag_unit="uT", temp="Temperature", temp_unit="degC"
    )
    table = parse_text(text, columns.wanted()[1:])
    stamps: Any = table.columns[table.position(_CLOCK)]
    try:
        moments = np.asarray(stamps.to_numpy()).astype("datetime64[ns]")
    except (TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: wanted ISO 8601 timestamps, got something else ({error}); export them so"
        ) from error
    time = (moments - moments[0]).astype(np.int64) * 1e-9
    columns = replace(
        columns,
        sample_rate_hz=float(rate.group(1)) if rate else None,
        device=serial.group(1) if serial else "",
    )
    timed = Table(source=table.source, names=(*table.names, "time_s"), columns=(*table.columns, time))
    return build_record(timed, columns).record
