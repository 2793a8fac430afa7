"""Orientation over time as a table: Parquet or CSV, columns that carry their units."""

from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

COLUMNS = ("time_s", "q_w", "q_x", "q_y", "q_z", "inclination_deg", "heading_deg", "pitch_deg")


def write_orientation(
    time: FloatArray, q_nb: FloatArray, angles: tuple[FloatArray, FloatArray, FloatArray], path: str | Path
) -> None:
    """Write orientation over time; undrift reads the quaternions back as a reference.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    q_nb : array, shape (N, 4)
        b to n, w-x-y-z.
    angles : tuple of three arrays, shape (N,)
        Inclination, heading and pitch, rad.
    path : str or Path
        NAME.parquet, NAME.csv or NAME.csv.gz. It appears whole or not at all.

    Raises
    ------
    InputError
        Another ending, or a file that cannot be written.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    path = Path(path)
    values = np.column_stack((time, q_nb, *(angle / RADIAN_PER_DEGREE for angle in angles)))
    table = pa.table(dict(zip(COLUMNS, values.T, strict=True)))
    part = path.with_name(path.name + ".part")
    try:
        if path.name.lower().endswith(".parquet"):
            parquet.write_table(table, part)
        elif path.name.lower().endswith(".csv"):
            csv.write_csv(table, part)
        elif path.name.lower().endswith(".csv.gz"):
            with pa.CompressedOutputStream(str(part), "gzip") as stream:
                csv.write_csv(table, stream)
        else:
            raise InputError(
                f"{path}: wanted a name ending in .parquet, .csv or .csv.gz, got another; name the format so"
            )
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error}; check the folder and its rights") from error
