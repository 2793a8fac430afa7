"""Formats of records and orientations, selected by the name's ending: undrift's own tables and formats of other programs.

=================  ==================================  ==============================================================
ending             record                              orientation
=================  ==================================  ==============================================================
.parquet           every bit, frame, state, device     time, quaternion, angles
.csv, .csv.gz      plain table, and NAME.csv.json      the same
.sto                                                   OpenSense [1]_: one column per sensor, cells w,x,y,z
=================  ==================================  ==============================================================

.. [1] "OpenSense - Kinematics with IMU Data", OpenSim documentation: opensimconfluence.atlassian.net
"""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.io.arrow import to_arrow
from undrift.io.parquet import write_parquet
from undrift.io.text import Provenance, sidecar_of, write_csv, write_rows
from undrift.record import Record, sample_rate_of
from undrift.units import RADIAN_PER_DEGREE

COLUMNS = ("time_s", "q_w", "q_x", "q_y", "q_z", "inclination_deg", "heading_deg", "pitch_deg")
Columns = tuple[Sequence[str], Sequence[FloatArray]]  # columns (N,) by name


def write_record_as(record: Record, path: Path, made_by: Provenance | None = None) -> None:
    """Write a record in the format that the name's ending selects."""
    _writer(path, RECORD_WRITERS)(record, path, made_by or {})


def write_orientation(
    time: FloatArray,
    q_nb: FloatArray,
    angles: tuple[FloatArray, FloatArray, FloatArray],
    path: str | Path,
    *,
    body: str = "sensor",
) -> None:
    """Write orientation over time. undrift reads the quaternions of its own tables back as a reference.

    Shapes are time (N,) s, q_nb (N, 4) and three angles (N,) rad. The sensor's name is the column name in .sto.
    """
    values = (time, *q_nb.T, *(angle / RADIAN_PER_DEGREE for angle in angles))
    _writer(Path(path), ORIENTATION_WRITERS)((COLUMNS, values), Path(path), body)


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files that are written under a name, starting with the named file."""
    return (path, sidecar_of(path)) if path.name.lower().endswith((".csv", ".csv.gz")) else (path,)


def _writer(path: Path, writers: Mapping[str, Callable[..., None]]) -> Callable[..., None]:
    for ending, write in writers.items():
        if path.name.lower().endswith(ending):
            return write
    *most, last = writers
    raise InputError(
        f"{path}: expected a name ending in {', '.join(most)} or {last}, got another ending. Change the ending."
    )


# ---- own tables


def _orientation_parquet(table: Columns, path: Path, _: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    buffer = io.BytesIO()
    parquet.write_table(pa.table({name: to_arrow(column) for name, column in zip(*table, strict=True)}), buffer)
    write_whole(path, buffer.getvalue())


# ---- OpenSense


def _orientation_sto(table: Columns, path: Path, body: str) -> None:
    """Write the quaternions, scalar first. OpenSense requires a column BODY_imu and a level frame with z up (see docs)."""
    time, *q = table[1][:5]
    if not re.fullmatch(r"\w+", body):
        raise InputError(
            f"`body`: expected letters, digits and _ for a column of {path}, got '{body}'. Choose another name."
        )
    head = (
        f"DataRate={sample_rate_of(time):.6f}", "DataType=Quaternion", "version=3", "OpenSimVersion=4.5", "endheader",
        f"time\t{body.removesuffix('_imu')}_imu",
    )  # fmt: skip
    rows = (f"{t:.9g}\t{w:.12g},{x:.12g},{y:.12g},{z:.12g}" for t, w, x, y, z in zip(time, *q, strict=True))
    write_whole(path, "\n".join((*head, *rows)) + "\n")


RECORD_WRITERS: dict[str, Callable[[Record, Path, Provenance], None]] = {
    ".parquet": lambda record, path, _: write_parquet(record, path),
    ".csv": write_csv,
    ".csv.gz": write_csv,
}
ORIENTATION_WRITERS: dict[str, Callable[[Columns, Path, str], None]] = {
    ".parquet": _orientation_parquet,
    ".csv": lambda table, path, _: write_rows(path, *table),
    ".csv.gz": lambda table, path, _: write_rows(path, *table),
    ".sto": _orientation_sto,
}
