"""ActiGraph GT9X Link IMU files: ten lines about the recording, then Timestamp and g, deg/s, uT, degC.

The temperature column is of the chip: it reads 20 to 30 degC above the room.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError
from undrift.io.build import build_record
from undrift.io.columns import Column, ColumnMap, TextLayout
from undrift.io.table import Table
from undrift.io.text import open_text, parse_text
from undrift.record import Record

_HEADER_LINES = 10
_CLOCK = "Timestamp"


def read_actigraph(path: str | Path) -> Record:
    """Read an ActiGraph IMU file.

    Parameters
    ----------
    path : str or Path
        The CSV file, plain or gzip.

    Returns
    -------
    Record
        deg/s, g, uT, degC; time in s from the first sample; device from the serial number.

    Raises
    ------
    InputError
        No such file, or timestamps that deny the rate of the first line.
    FileFormatError
        Not an ActiGraph IMU file, or timestamps that are none.
    """

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
