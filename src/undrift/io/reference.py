"""References: poses from tables of quaternions, of named bodies (OpenSim), and anatomical bodies from skin markers.

The axes of every body are x forward, y left, z up, as for a device worn on the back. mid(.) is the mean of markers::

    pelvis   rigid cluster of the four spines (ASIS, PSIS), or of the belt markers at the sides and the back (MWT, BWT);
             origin: middle of the rear pair, y from right to left, x from the rear pair to the front pair
    trunk    the line from mid(PSIS) or the rear belt markers (origin) to C7 is z, x to the front of the pelvis: the
    lean of the trunk is the tilt of its z. The trunk is not rigid, because it bends with the spine

A cluster is fitted to all of its markers (io/mocap.py). The anatomical axes belong to its mean shape. A frame without
all markers of the body is a gap, because a fit to fewer markers would jump with skin movement.

OpenSim       .sto: cells "w,x,y,z", one column per sensor

A file of poses may contain several bodies, of which the caller selects one. Quaternions are scalar first and turn the
body to the laboratory. Zeros, NaN or empty cells mark a lost body.
"""

from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field

from undrift.arrays import BoolArray, FloatArray
from undrift.base.codec import FileTable, read_toml, toml_of
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes, write_whole
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate
from undrift.io.arrow import to_arrow
from undrift.io.column_map import (
    POSITION,
    QUATERNION,
    ChannelColumns,
    Clock,
    Column,
    ColumnMap,
    TextLayout,
    naming,
)
from undrift.io.columns import RawTable, read_time
from undrift.io.libraries import Arrays, table_of_arrays
from undrift.io.mocap import Markers, Up, fit_cluster, markers_of, pose_from_cluster, quaternions_of
from undrift.io.parquet import read_parquet_table
from undrift.io.text import Text, as_utf8, open_text, parse_text, text_of, write_rows
from undrift.record import Reference
from undrift.units import RADIAN_PER_DEGREE, si_factor

# ---- bodies

BodyName = Literal["pelvis", "trunk"]

# Labels are compared without a prefix up to ":", case, dots, spaces and underscores: r.PSIS, RPSI and Subject:RPSI are equal.
ALIASES = {
    "LASI": ("LASI", "LASIS"),
    "RASI": ("RASI", "RASIS"),
    "LPSI": ("LPSI", "LPSIS"),
    "RPSI": ("RPSI", "RPSIS"),
}
# left front, right front, left rear, right rear
_PELVES = (("LASI", "RASI", "LPSI", "RPSI"), ("LMWT", "RMWT", "LBWT", "RBWT"))

# Position relative to mid(PSIS), at the level of S2: on the skin over the spinous process of L5, plus half a case further back.
# Assumed from the anatomy of an adult, not measured. Enter the measured offset if there is one.
L5_OFFSET = (-0.02, 0.0, 0.035)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A segment as an anatomical frame in every frame of a recording."""

    # orientation b to n (b: x forward, y left, z up) and position of the origin, m, or NaN if a marker is missing
    reference: Reference
    labels: tuple[str, ...]  # used markers, with their names in the file
    residual: float  # root mean square of the residuals of a rigid body, m (0 for a body defined by lines)


def find_body(markers: Markers, name: BodyName) -> Body:
    """Return an anatomical segment from marker trajectories."""
    if name not in get_args(BodyName):
        raise InputError(f"body: expected {', '.join(get_args(BodyName))}, got {name!r}. Choose one.")
    pelvis = next((four for four in _PELVES if all(find_label(markers, label) for label in four)), _PELVES[0])
    labels = _needed(markers, pelvis if name == "pelvis" else (*pelvis, "C7"), name)
    points, residual = markers.pick(labels), 0.0
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=(1, 2)))
    if name == "pelvis":
        cluster = fit_cluster(markers, labels)
        poses, residual = cluster.reference, cluster.rms
        rear, axes = _pelvis_axes(cluster.template)
        q_nb = quaternion_product(poses.q_nb, quaternions_of(axes[None], np.array([True])))
        origin = np.asarray(poses.position) + rotate(poses.q_nb, rear)
    else:
        origin, axes = _pelvis_axes(points[:, :4])
        axes = _axes(up=points[:, 4] - origin, forward=axes[:, :, 0])
        visible &= np.isfinite(axes).all(axis=(1, 2))
        q_nb = quaternions_of(axes, visible)
    if not visible.any():
        raise InputError(f"{markers.name or 'markers'}: {name}: expected frames with all of its markers, got none")
    reference = Reference(
        time=markers.time,
        q_nb=np.where(visible[:, None], q_nb, np.nan),
        position=np.where(visible[:, None], origin, np.nan),
        name=f"{markers.name} {name}".strip(),
    )
    return Body(reference=reference, labels=tuple(labels), residual=residual)


def device_on(body: Body, *, offset_b: tuple[float, float, float] = L5_OFFSET) -> Reference:
    """Return the poses of a device fixed on a body, with the axes of the body.

    ``p_d = p_b + R_nb r``: the device's case d is at the position r relative to the body's origin.
    """
    poses = body.reference
    position = np.asarray(poses.position) + rotate(poses.q_nb, np.array(offset_b))
    millimetres = ", ".join(f"{1e3 * value:g}" for value in offset_b)
    return replace(poses, position=position, name=f"{poses.name}, device at ({millimetres}) mm")


def find_label(markers: Markers, name: str) -> str | None:
    """Return the label of a marker in a recording."""

    def plain(label: str) -> str:
        return "".join(c for c in label.rsplit(":", 1)[-1].upper() if c not in "._- ")

    labels = {plain(label): label for label in reversed(markers.labels)}
    return next((labels[alias] for alias in ALIASES.get(name, (name,)) if alias in labels), None)


def _needed(markers: Markers, names: tuple[str, ...], body: str) -> list[str]:
    labels = [find_label(markers, name) for name in names]
    missing = [name for name, label in zip(names, labels, strict=True) if label is None]
    if missing:
        raise InputError(
            f"{markers.name or 'markers'}: {body}: expected markers {', '.join(names)}, but {', '.join(missing)} "
            f"are missing. Rename the markers, or use a cluster."
        )
    return [label for label in labels if label is not None]


def _pelvis_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    left_front, right_front, left_rear, right_rear = np.moveaxis(shape, -2, 0)
    rear, front = 0.5 * (left_rear + right_rear), 0.5 * (left_front + right_front)
    leftward = left_front + left_rear - right_front - right_rear
    return rear, _axes(up=np.cross(front - rear, leftward), forward=front - rear)


def _axes(*, up: FloatArray, forward: FloatArray) -> FloatArray:
    """Return R_nb (..., 3, 3), with z along up and x towards forward."""
    z = up / np.linalg.norm(up, axis=-1, keepdims=True)
    y = np.cross(z, forward)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack((np.cross(y, z), y, z), axis=-1)


# ---- tables of quaternions

# undrift's own names in CSV, Parquet and mat: time_s, the following, and optionally position and moving.
NEARLY_UNIT = 0.01  # devices round, and some scale: such quaternions are normalised, others are refused


_ANGLE = {"rad": 1.0, "deg": RADIAN_PER_DEGREE}
_HALF = 2.0**-0.5
_LEVELLED = {  # quaternions that turn an axis of the laboratory up, to z
    "x": (_HALF, 0.0, -_HALF, 0.0), "y": (_HALF, _HALF, 0.0, 0.0), "z": (1.0, 0.0, 0.0, 0.0),
    "-x": (_HALF, 0.0, _HALF, 0.0), "-y": (_HALF, -_HALF, 0.0, 0.0), "-z": (0.0, 1.0, 0.0, 0.0),
}  # fmt: skip


class PoseColumns(FileTable):
    """Columns of poses: names in the header, or positions from 0."""

    quaternion: tuple[Column, Column, Column, Column] = QUATERNION  # w, x, y, z, in this order
    time: Column | None = None  # time column; without it ``sample_rate_hz`` is required
    position: tuple[Column, Column, Column] | None = None  # x, y, z
    # columns x, y, z of three or more markers of a rigid body, instead of a quaternion
    markers: tuple[tuple[Column, Column, Column], ...] = ()
    matrix: tuple[Column, ...] | str = ()  # nine columns of rotation matrices by rows, or the name of one array (mat)
    angle: Column | None = None  # angle of an encoder about ``axis``, instead of a quaternion
    moving: Column | None = None  # column that is 1 in motion
    counter: Column | None = None  # frame counter, which may wrap; used by a regular clock


class ReferenceMap(FileTable):
    """Columns and conventions of poses in a foreign file."""

    columns: PoseColumns = PoseColumns.model_construct()
    units: dict[Literal["time", "position", "markers", "angle"], str] = Field(
        default_factory=dict
    )  # unit of each named column
    sample_rate_hz: float | None = None  # sample rate of a file without a time column, Hz
    # "body_to_level" as in undrift, or "level_to_body" for the inverse
    turns: Literal["body_to_level", "level_to_body"] = "body_to_level"
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = "z"  # axis of the laboratory that points up
    # axis of the laboratory about which the angle is positive, right-handed; the body's axes are the laboratory's at 0
    axis: tuple[float, float, float] | None = None
    repair_time: bool = False  # omit rows whose time does not increase
    clock: Clock = "file"  # "file", or "regular" for time stamps of a host, to which a rate and an offset are fitted
    layout: TextLayout = TextLayout.model_construct()  # layout of text files

    def wanted(self) -> tuple[Column, ...]:
        """Return all mapped columns."""
        named = self.columns
        bodies = chain.from_iterable(named.markers) if named.markers else (*self.pose(), *(named.position or ()))
        return (*bodies, *(column for column in (named.time, named.moving, named.counter) if column is not None))

    def pose(self) -> tuple[Column, ...]:
        """Return the columns of the orientation: an angle, nine of a matrix, or four of a quaternion."""
        named = self.columns
        if named.angle is not None:
            return (named.angle,)
        if isinstance(named.matrix, str):
            return tuple(f"{named.matrix}[{k}]" for k in range(9))
        return named.matrix or named.quaternion

    def factor(self, what: Literal["time", "position", "markers"]) -> float:
        """Return the SI value of one unit of the time, the position or the markers."""
        return si_factor(self.units.get(what, ""), "time" if what == "time" else "length")


def read_reference_map(path: Path) -> ReferenceMap | None:
    """Read a map of orientations. Return None for a map of readings."""
    columns = toml_of(path)[0].get("columns")
    if not isinstance(columns, dict) or not {"quaternion", "markers", "matrix", "angle"} & {*columns}:
        return None
    how, _ = read_toml(ReferenceMap, path)
    with naming(path):
        _check(how)
    return how


def _check(how: ReferenceMap) -> None:
    if how.columns.time is None and how.sample_rate_hz is None:
        raise InputError("reference: expected a time column or sample_rate_hz, got neither. Add one of them.")
    for what in ("time", "position", "markers"):
        if getattr(how.columns, what):
            how.factor(what)
    if how.columns.matrix and len(how.pose()) != 9:
        raise InputError(f"columns.matrix: expected nine columns, got {len(how.pose())}. Name them row by row.")
    if how.columns.angle is not None and (how.axis is None or not any(how.axis)):
        raise InputError("axis: expected the axis of the angle, got none. For example, write axis = [0, 0, 1].")
    if how.columns.angle is not None and how.units.get("angle") not in _ANGLE:
        raise InputError(f'units.angle: expected "deg" or "rad", got {how.units.get("angle", "none")}. Set the unit.')


def read_text_poses(path: Path, columns: ReferenceMap | None = None) -> Reference:
    """Read poses from a text table."""
    return poses_in(open_text(path, None if columns is None else columns.layout), columns)


def poses_in(text: Text, columns: ReferenceMap | None) -> Reference:
    """Return the poses in an open text table."""
    columns = columns or _native_map(text.path, text.names)
    return _poses(parse_text(text, columns.wanted()), columns, text.path)


def read_parquet_poses(path: Path, columns: ReferenceMap | None = None) -> Reference:
    """Read poses from Parquet."""
    table = read_parquet_table(path)
    return _poses(table, columns or _native_map(path, table.names), path)


def read_array_poses(arrays: Arrays, path: Path, columns: ReferenceMap | None = None) -> Reference:
    """Return the poses in named arrays (mat)."""
    columns = columns or _native_map(path, tuple(name for name, _ in arrays))
    return _poses(table_of_arrays(arrays, path, columns.wanted()), columns, path)


def write_reference(reference: Reference, path: str | Path) -> None:
    """Write poses with undrift's own names. Every number is read back without loss, except for the normalisation of quaternions."""
    import pyarrow as pa
    from pyarrow import parquet as pq

    path, names, columns = Path(path), ["time_s", *QUATERNION], [reference.time, *reference.q_nb.T]
    if reference.position is not None:
        names += POSITION
        columns += [*reference.position.T]
    if reference.moving is not None:
        names.append("moving")
        columns.append(reference.moving)
    if path.suffix.lower() == ".csv":
        write_rows(path, names, columns)
    elif path.suffix.lower() == ".parquet":
        table = {name: to_arrow(column, empty=True) for name, column in zip(names, columns, strict=True)}
        write_whole(path, lambda part: pq.write_table(pa.table(table), str(part), use_dictionary=False))
    else:
        raise InputError(f"{path}: expected a name ending in .parquet or .csv. Change the ending.")


def native_reference(names: tuple[str, ...]) -> ReferenceMap | None:
    """Return the map of a table with undrift's own names of poses."""
    if not {"time_s", *QUATERNION} <= set(names):
        return None
    position, moving = POSITION if set(POSITION) <= set(names) else None, "moving" if "moving" in names else None
    columns = PoseColumns(time="time_s", position=position, moving=moving)
    return ReferenceMap(columns=columns, units={"time": "s", "position": "m"})


def _native_map(path: Path, names: tuple[str, ...]) -> ReferenceMap:
    found = native_reference(names)
    if found is None:
        raise InputError(
            f"{path}: expected columns time_s, q_w, q_x, q_y, q_z, got {', '.join(repr(name) for name in names[:12])}. "
            'Map them with columns = { time = "t", quaternion = ["W", "X", "Y", "Z"] } and units = { time = "s" }'
        )
    return found


def _poses(table: RawTable, how: ReferenceMap, path: Path) -> Reference:
    _check(how)
    named = how.columns
    clock = ChannelColumns(time=named.time, counter=named.counter)
    keys: dict[str, Any] = {key: getattr(how, key) for key in ("sample_rate_hz", "repair_time", "clock")}
    time, kept, _ = read_time(table, ColumnMap(columns=clock, units={"time": how.units.get("time", "")}, **keys))
    keep = np.ones(len(table), dtype=np.bool_) if kept is None else kept
    lost = int((~keep).sum())
    name = f"{path.name} ({lost} rows left out, because their time does not increase)" if lost else path.name
    moving = None if named.moving is None else table.numbers(named.moving)[keep]
    levelled = np.array(_LEVELLED[how.up])

    def columns(names: tuple[Column, ...]) -> FloatArray:
        values = np.stack([table.numbers(column) for column in names], axis=1)[keep]
        values[np.isnan(values).any(axis=1)] = np.nan
        return values

    with naming(path):
        if named.markers:
            points = np.stack([columns(marker) for marker in named.markers], axis=1) * how.factor("markers")
            labels = tuple(str(marker[0]) for marker in named.markers)
            markers = markers_of(path, labels, rotate(levelled, points), time, up="z")
            poses = pose_from_cluster(markers, markers.labels)
            return replace(poses, moving=moving, name=poses.name.replace(path.name, name))
        quat = _quaternions(path, columns(how.pose()), how)
        quat = quat if how.turns == "body_to_level" else quaternion_conjugate(quat)
        position = named.position and rotate(levelled, columns(named.position) * how.factor("position"))
        return Reference(
            time=time,
            q_nb=quat if how.up == "z" else quaternion_product(levelled, quat),
            position=position,
            moving=moving,
            name=name,
        )


def _quaternions(path: Path, values: FloatArray, how: ReferenceMap) -> FloatArray:
    """Return unit quaternions (N, 4) of angles (N, 1), of matrices (N, 9), or of quaternions that are nearly unit."""
    if values.shape[1] == 9:
        matrices, known = values.reshape(-1, 3, 3), np.asarray(np.isfinite(values).all(axis=1))
        wrong = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2)) > 2 * NEARLY_UNIT
        if (wrong | (np.linalg.det(matrices) < 0.0))[known].any():
            raise FileFormatError(f"{path}: the matrices are not rotation matrices. Export orientations again.")
        return quaternions_of(matrices, known)
    if values.shape[1] == 1:
        axis = np.array(how.axis) / np.linalg.norm(np.array(how.axis))
        return quaternion_of(values * _ANGLE[how.units["angle"]] * axis)
    norm = np.linalg.norm(values, axis=1)[:, None]
    norm[norm == 0.0] = np.nan  # a lost body
    return np.where(np.abs(norm - 1.0) < NEARLY_UNIT, values / norm, np.where(np.isnan(norm), np.nan, values))


# ---- OpenSim: poses of named bodies


def read_sto(path: Path, name: str | None = None, up: Up | None = None) -> Reference:
    """Read one sensor of an OpenSense table: "endheader", names, then cells "w,x,y,z". The default for `up` is z."""
    _, _, body = as_utf8(read_bytes(path)).replace(b"\r\n", b"\n").partition(b"endheader")
    header, _, rows = body.lstrip(b" \t\n").partition(b"\n")
    first, *names = (cell.strip() for cell in header.decode("utf-8", "replace").split("\t") if cell.strip())
    if not names or first.lower() != "time":
        raise FileFormatError(
            f"{path}: expected 'time' and sensor names after endheader, got {header[:40]!r}. Check the export."
        )
    if name not in names and (name is not None or len(names) > 1):
        got = "none" if name is None else repr(name)
        raise InputError(
            f"{path}: expected the name of one body, got {got}. The file contains {', '.join(names)}. Choose one with `markers`.",
            names=tuple(names),
        )
    body_name, columns = name or names[0], tuple(map(str, range(1 + 4 * len(names))))
    text = text_of(path, rows.replace(b",", b"\t"), columns, TextLayout(delimiter="\t", header=False))
    table = parse_text(text, columns)
    if len(table) < 2:
        raise FileFormatError(
            f"{path}: expected two frames or more, got {len(table)}. The file is truncated. Copy it again."
        )
    start = 1 + 4 * names.index(body_name)
    four = (start, start + 1, start + 2, start + 3)
    named = PoseColumns(time=0, quaternion=four)
    poses = _poses(table, ReferenceMap(columns=named, units={"time": "s"}, up=up or "z"), path)
    return replace(poses, name=f"{path.name} {body_name}")
