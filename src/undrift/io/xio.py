"""x-io sensors as their software writes them: NGIMU and x-IMU3 folders, x-IMU files.

Temperature comes in a file of its own at its own rate; it is interpolated onto the samples and held at the ends. The x-IMU
has no time column: packets are numbered and its sample rate must be stated. The x-IMU3's magnetometer is in arbitrary units
and is left unread.
"""

from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.build import build_record, with_temperature
from undrift.io.columns import Column, ColumnMap
from undrift.io.text import open_text, parse_text
from undrift.record import Record
from undrift.units import si_factor

_GYRO: tuple[Column, ...] = tuple(f"Gyroscope {axis} (deg/s)" for axis in "XYZ")
_ACCEL: tuple[Column, ...] = tuple(f"Accelerometer {axis} (g)" for axis in "XYZ")
_PACKET = "Packet number"


def read_ngimu(path: str | Path) -> Record:
    """Read an NGIMU folder: sensors.csv, and temperature.csv where there is one.

    Parameters
    ----------
    path : str or Path
        The folder, or its sensors.csv.

    Returns
    -------
    Record
        deg/s, g, uT; temp_c of the gyroscope and accelerometer chip.

    Raises
    ------
    InputError
        No such folder or file.
    FileFormatError
        Not NGIMU files.
    """
    path = _main_file(path, "sensors.csv")
    columns = ColumnMap(
        time="Time (s)",
        time_unit="s",
        gyro=_GYRO,
        gyro_unit="dps",
        accel=_ACCEL,
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
    """Read an x-IMU3 folder: Inertial.csv, and Temperature.csv where there is one.

    Parameters
    ----------
    path : str or Path
        The folder, or its Inertial.csv.

    Returns
    -------
    Record
        deg/s, g, degC; time in s on the device's clock.

    Raises
    ------
    InputError
        No such folder or file.
    FileFormatError
        Not x-IMU3 files.
    """
    path = _main_file(path, "Inertial.csv")
    clock = "Timestamp (us)"
    columns = ColumnMap(time=clock, time_unit="us", gyro=_GYRO, gyro_unit="dps", accel=_ACCEL, accel_unit="g")
    record = _read(path, columns)
    beside = path.parent / "Temperature.csv"
    if not beside.is_file():
        return record
    time, temp_c = _two(beside, clock, "Temperature (degC)")
    return with_temperature(record, time * si_factor("us", "time"), temp_c)


def read_ximu(path: str | Path, *, sample_rate_hz: float) -> Record:
    """Read x-IMU files: NAME_CalInertialAndMag.csv, and NAME_CalBattAndTherm.csv where there is one.

    Parameters
    ----------
    path : str or Path
        The folder that holds one recording, or the CalInertialAndMag file.
    sample_rate_hz : float
        Hz, as set in the device; the files do not say.

    Returns
    -------
    Record
        deg/s, g, mag from gauss, degC. Temperature is placed by packet number.

    Raises
    ------
    InputError
        No such file, or a folder with several recordings.
    FileFormatError
        Not x-IMU files.
    """
    path = Path(path)
    if path.is_dir():
        held = sorted(path.glob("*_CalInertialAndMag.csv"))
        if len(held) != 1:
            names = ", ".join(file.name for file in held) or "none"
            raise InputError(f"{path}: wanted one *_CalInertialAndMag.csv, got {names}; name the file")
        path = held[0]
    columns = ColumnMap(
        sample_rate_hz=sample_rate_hz,
        gyro=_GYRO,
        gyro_unit="dps",
        accel=_ACCEL,
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
