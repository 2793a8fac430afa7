"""References: poses from BROAD, marker files, and tables of quaternions.

undrift's own names in CSV, Parquet, npz and mat: time_s, q_w, q_x, q_y, q_z, and optionally pos_x_m, pos_y_m, pos_z_m, moving.
Empty cells are gaps. q maps the body to a level frame with z up, scalar first.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.frames import quaternion_conjugate
from undrift.io.arrays import mat_arrays, npz_arrays, table_of_arrays
from undrift.io.broad import read_broad
from undrift.io.c3d import read_c3d
from undrift.io.columns import Column, TextLayout
from undrift.io.detect import detect
from undrift.io.markers import Markers, Up, pose_from_cluster
from undrift.io.parquet import read_parquet_table
from undrift.io.table import Table
from undrift.io.text import open_text, parse_text
from undrift.io.trc import read_trc
from undrift.record import Reference
from undrift.units import si_factor

QUATERNION = ("q_w", "q_x", "q_y", "q_z")
_NEARLY_UNIT = 0.01  # devices round, and some scale: such quaternions are made unit, others are refused
POSITION = ("pos_x_m", "pos_y_m", "pos_z_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceMap:
    """Where poses are in a foreign file.

    Parameters
    ----------
    quaternion : tuple of str or int
        Columns w, x, y, z, in this order, wherever they stand in the file.
    time : str, int or None
        Time column; without it ``sample_rate_hz`` is required.
    position : tuple of str or int, or None
        Columns x, y, z.
    moving : str, int or None
        Column that is 1 in motion.
    time_unit, position_unit : str
        Units; needed where the columns are named.
    sample_rate_hz : float or None
        Hz, where there is no time column.
    turns : str
        "body_to_level" as undrift has it, or "level_to_body" for the inverse.
    layout : TextLayout
        For text files.
    """

    quaternion: tuple[Column, Column, Column, Column] = QUATERNION
    time: Column | None = None
    position: tuple[Column, Column, Column] | None = None
    moving: Column | None = None
    time_unit: str = ""
    position_unit: str = ""
    sample_rate_hz: float | None = None
    turns: Literal["body_to_level", "level_to_body"] = "body_to_level"
    layout: TextLayout = field(default_factory=TextLayout)

    def __post_init__(self) -> None:
        if self.time is None and self.sample_rate_hz is None:
            raise InputError(
                "reference: wanted a time column or sample_rate_hz, got neither; the rate is never assumed"
            )
        if self.time is not None:
            si_factor(self.time_unit, "time")
        if self.position is not None:
            si_factor(self.position_unit, "length")
        if self.turns not in ("body_to_level", "level_to_body"):
            raise InputError(f"turns: wanted body_to_level or level_to_body, got {self.turns!r}")

    def wanted(self) -> tuple[Column, ...]:
        """Return all mapped columns.

        Returns
        -------
        tuple of str or int
            Time, quaternion, position, moving, those that are there.
        """
        more = (*(self.position or ()), *(() if self.moving is None else (self.moving,)))
        return (*(() if self.time is None else (self.time,)), *self.quaternion, *more)


def read_reference(
    path: str | Path,
    columns: ReferenceMap | None = None,
    *,
    labels: tuple[str, ...] | list[str] | None = None,
    up: Up | None = None,
) -> Reference:
    """Read poses of a body.

    Parameters
    ----------
    path : str or Path
        BROAD HDF5; CSV, Parquet, npz or mat with quaternions; C3D or TRC markers.
    columns : ReferenceMap or None
        For foreign names; None for undrift's own.
    labels : tuple of str or None
        Markers of one rigid cluster, for C3D and TRC.
    up : str or None
        Laboratory axis that points up, "y" or "z": required for TRC, and for C3D files that do not say.

    Returns
    -------
    Reference
        q_nb, position m where there is one, gaps NaN.

    Raises
    ------
    InputError
        No such file; marker files without labels or axis; columns that are not there; quaternions that are none.
    FileFormatError
        A damaged file, or one of another kind.
    """
    path = Path(path)
    kind = detect(path)
    if kind == "broad":
        return read_broad(path)[1]
    if kind in ("trc", "c3d"):
        markers = read_markers(path, up=up)
        if not labels:
            raise InputError(
                f"{path}: wanted the labels of one rigid cluster, got none; choose from {', '.join(markers.labels)}"
            )
        return pose_from_cluster(markers, labels)
    if kind in ("csv", "parquet", "npz", "mat", "ngimu", "ximu3"):
        return _from_table(path, kind, columns)
    raise FileFormatError(f"{path}: wanted poses (BROAD, C3D, TRC, or a table with q_w, q_x, q_y, q_z), got {kind}")


def read_markers(path: str | Path, *, up: Up | None = None) -> Markers:
    """Read marker trajectories from C3D or TRC.

    Parameters
    ----------
    path : str or Path
        The file, plain or gzip.
    up : str or None
        Laboratory axis that points up, "y" or "z": required for TRC, and for C3D files that do not say.

    Returns
    -------
    Markers
        m, z up, gaps NaN.

    Raises
    ------
    InputError
        No such file, or the axis is not stated.
    FileFormatError
        Another format, or a damaged file.
    """
    kind = detect(path)
    if kind == "c3d":
        return read_c3d(path, up=up)
    if kind != "trc":
        raise FileFormatError(f"{path}: wanted markers (C3D or TRC), got {kind}; check the path")
    if up is None:
        raise InputError(f'{path}: wanted the axis that points up, got none; TRC does not say: state up = "y" or "z"')
    return read_trc(path, up=up)


def write_reference(reference: Reference, path: str | Path) -> None:
    """Write poses with undrift's own names; every number reads back to the same bits (unit length apart).

    Parameters
    ----------
    reference : Reference
        Poses; gaps become empty cells.
    path : str or Path
        NAME.parquet or NAME.csv.

    Raises
    ------
    InputError
        Another ending, or a file that cannot be written.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow_csv
    from pyarrow import parquet as pq

    names = ["time_s", *QUATERNION]
    columns = [reference.time, *reference.q_nb.T]
    if reference.position is not None:
        names += POSITION
        columns += [*reference.position.T]
    if reference.moving is not None:
        names.append("moving")
        columns.append(reference.moving)
    table = pa.table([pa.array(np.ascontiguousarray(column), from_pandas=True) for column in columns], names=names)
    suffix = Path(path).suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: wanted a name ending in .parquet or .csv, got another; name the format so")
    try:
        if suffix == ".csv":
            with pa.OSFile(str(path), "wb") as sink:
                sink.write(",".join(names).encode() + b"\n")
                arrow_csv.write_csv(table, sink, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))
        else:
            pq.write_table(table, str(path), use_dictionary=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error}; check the folder and its rights") from error


def native_reference(names: tuple[str, ...]) -> ReferenceMap | None:
    """Return the map of a table with undrift's own names of poses.

    Parameters
    ----------
    names : tuple of str
        Column names.

    Returns
    -------
    ReferenceMap or None
        None where the names are not undrift's.
    """
    if not {"time_s", *QUATERNION} <= set(names):
        return None
    return ReferenceMap(
        time="time_s",
        time_unit="s",
        position=POSITION if set(POSITION) <= set(names) else None,
        position_unit="m",
        moving="moving" if "moving" in names else None,
    )


def _from_table(path: Path, kind: str, columns: ReferenceMap | None) -> Reference:
    if kind in ("npz", "mat"):
        arrays = npz_arrays(path) if kind == "npz" else mat_arrays(path)
        columns = columns or _own(path, tuple(name for name, _ in arrays))
        return _poses(table_of_arrays(arrays, path, columns.wanted()), columns, path)
    if kind == "parquet":
        table = read_parquet_table(path)
        return _poses(table, columns or _own(path, table.names), path)
    text = open_text(path, None if columns is None else columns.layout)
    columns = columns or _own(path, text.names)
    return _poses(parse_text(text, columns.wanted()), columns, path)


def _own(path: Path, names: tuple[str, ...]) -> ReferenceMap:
    found = native_reference(names)
    if found is None:
        raise InputError(
            f"{path}: wanted columns time_s, q_w, q_x, q_y, q_z, got {', '.join(repr(name) for name in names[:12])}; map them with "
            'ReferenceMap(time="t", time_unit="s", quaternion=("W", "X", "Y", "Z"))'
        )
    return found


def _poses(table: Table, columns: ReferenceMap, path: Path) -> Reference:
    quat = np.stack([table.numbers(column) for column in columns.quaternion], axis=1)
    quat[np.isnan(quat).any(axis=1)] = np.nan
    norm = np.linalg.norm(quat, axis=1)[:, None]
    quat = np.where(np.abs(norm - 1.0) < _NEARLY_UNIT, quat / np.where(norm > 0.0, norm, 1.0), quat)
    position: FloatArray | None = None
    if columns.position is not None:
        stacked = np.stack([table.numbers(column) for column in columns.position], axis=1)
        position = stacked * si_factor(columns.position_unit, "length")
        position[np.isnan(position).any(axis=1)] = np.nan
    if columns.time is None:
        # the map has seen to it that the rate is there
        time: FloatArray = np.arange(len(table)) / (columns.sample_rate_hz or np.nan)
    else:
        time = table.numbers(columns.time) * si_factor(columns.time_unit, "time")
    try:
        return Reference(
            time=time,
            q_nb=quat if columns.turns == "body_to_level" else quaternion_conjugate(quat),
            position=position,
            moving=None if columns.moving is None else table.numbers(columns.moving),
            name=path.name,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
