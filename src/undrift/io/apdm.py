"""APDM Opal: several sensors in one CSV.

Test Name:, ...
Sample Rate:,128,Hz
Time,Static/Acceleration/X, ... ,Static/Temperature/Scalar, ...        one group for each sensor
s,m/s^2, ... ,deg C, ...                                               the units
"""

from dataclasses import replace
from pathlib import Path

from undrift.errors import FileFormatError, InputError
from undrift.io.build import build_record
from undrift.io.columns import AXES, Column, ColumnMap, TextLayout
from undrift.io.text import Text, open_text, parse_text
from undrift.record import Record

_GYRO, _ACCEL, _MAG, _TEMP = "Angular Velocity", "Acceleration", "Magnetic Field", "Temperature/Scalar"


def read_apdm(path: str | Path, sensor: str | None = None) -> Record:
    """Read one sensor of an APDM Opal file.

    Parameters
    ----------
    path : str or Path
        The CSV file, plain or gzip.
    sensor : str or None
        Name of the sensor as in the header, before the first slash. None where the file has only one.

    Returns
    -------
    Record
        Units as the file states them (rad/s, m/s2, uT, degC).

    Raises
    ------
    InputError
        No such file or sensor (lists those that are there), or several and none named.
    FileFormatError
        Not an APDM file.
    """
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
    """Return the names of the sensors in an APDM file.

    Parameters
    ----------
    path : str or Path
        The CSV file, plain or gzip.

    Returns
    -------
    tuple of str
        In the order of the file.

    Raises
    ------
    FileFormatError
        Not an APDM file.
    """
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
