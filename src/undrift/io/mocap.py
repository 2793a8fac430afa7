"""Optical motion capture: marker trajectories (C3D, TRC) and the pose of a rigid cluster of markers.

Points are in m in n, the level frame with z up. NaN is a gap. A cluster of three or more markers that do not lie on one
line is a body with frame m: origin at the centroid of the cluster, axes parallel to n in the first frame in which all
of its markers are visible. Its pose in each frame solves

    minimise over R, p    sum_k | R c_k + p - x_k |^2        c_k marker k in m, x_k as measured

by the singular value decomposition of sum_k x_k c_k^T (Kabsch). Frames with fewer than three markers are gaps.
"""

import tempfile
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import FileFormatError, InputError
from undrift.files import is_gzip, read_bytes, sound
from undrift.frames import signed
from undrift.io.column_map import naming
from undrift.io.columns import is_number
from undrift.io.isolated import isolated
from undrift.record import Reference, check_time, sample_rate_of
from undrift.units import si_factor

Up = Literal["y", "z"]
_ROUNDS = 4  # number of iterations for the average shape, which converges in two
_FLAT = 1e-2  # smallest ratio of a cluster's width to its length that determines the turn about the long axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """Marker trajectories."""

    labels: tuple[str, ...]  # one label per marker, all different
    time: FloatArray  # (N,), s, strictly increasing
    points: FloatArray  # (N, M, 3), m, frame n, with NaN for a gap
    name: str = ""  # File
    short_rows: int = 0  # number of rows that end before the last marker

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "time", frozen(self.time, (None,), "time"))
        set_(self, "points", frozen(self.points, (len(self.time), len(self.labels), 3), "points"))
        if len(set(self.labels)) != len(self.labels):
            twice = sorted({label for label in self.labels if self.labels.count(label) > 1})
            raise InputError(f"markers: expected different labels, got {', '.join(twice)} more than once. Rename them.")
        check_time(self.time)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Return the number of frames per second."""
        return sample_rate_of(self.time)

    def pick(self, labels: tuple[str, ...] | list[str]) -> FloatArray:
        """Return the trajectories of some markers, (N, K, 3) m."""
        for label in labels:
            if label not in self.labels:
                near = [other for other in self.labels if label.lower() in other.lower()]
                hint = f"Name {' or '.join(near[:3])}" if near else "Check the label"
                raise InputError(
                    f"{self.name or 'markers'}: expected marker {label!r}, got {', '.join(self.labels)}. {hint}."
                )
        return self.points[:, [self.labels.index(label) for label in labels]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClusterPose:
    """Pose of a rigid cluster and how rigid it was."""

    reference: Reference  # q_nb with b the frame m of the cluster, and position of its centroid
    template: FloatArray  # (K, 3), positions of the markers in frame m, m
    rms: float  # root mean square of the residuals of the pose, over the frames with a pose, m


def pose_from_cluster(markers: Markers, labels: tuple[str, ...] | list[str]) -> Reference:
    """Return the pose of a rigid cluster of markers. :func:`fit_cluster` also returns a measure of its rigidity."""
    return fit_cluster(markers, labels).reference


def fit_cluster(markers: Markers, labels: tuple[str, ...] | list[str]) -> ClusterPose:
    """Fit a rigid body to a cluster of markers, frame by frame (W. Kabsch, Acta Cryst. A32, 1976)."""
    if len(labels) < 3 or len(set(labels)) != len(labels):
        raise InputError(
            f"cluster: expected three different markers or more, got {', '.join(labels) or 'none'}. Select three."
        )
    points = markers.pick(labels)
    visible: BoolArray = np.all(np.isfinite(points), axis=2)
    complete: BoolArray = np.all(visible, axis=1)
    if not complete.any():
        rarest = labels[int(visible.sum(axis=0).argmin())]
        raise InputError(f"cluster: expected a frame with all of {', '.join(labels)}, got none. Omit {rarest}.")
    template = _mean_shape(points, complete)
    spread = np.linalg.svd(template, compute_uv=False)
    if spread[1] < _FLAT * spread[0]:
        raise InputError(
            f"cluster: expected markers that span a plane, got {', '.join(labels)} on one line. Add a marker off this line."
        )
    turn, shift, good = _fit(points, visible, template)
    misfit = points - (np.einsum("nij,kj->nki", turn, template) + shift[:, None])
    square = np.where(visible, (misfit**2).sum(axis=2), 0.0).sum(axis=1)
    residual = np.where(good, np.sqrt(square / np.maximum(visible.sum(axis=1), 1)), np.nan)
    rms = float(np.sqrt(np.nanmean(residual**2)))
    q_nb = quaternions_of(turn, good)
    q_nb[good] = signed(q_nb[good])
    reference = Reference(
        time=markers.time,
        q_nb=q_nb,
        position=np.where(good[:, None], shift, np.nan),
        name=f"{markers.name} cluster {' '.join(labels)} (rigid within {1e3 * rms:.2f} mm rms)".strip(),
    )
    return ClusterPose(reference=reference, template=template, rms=rms)


def quaternions_of(matrices: FloatArray, known: BoolArray) -> FloatArray:
    """Return the quaternions (N, 4) of rotation matrices (N, 3, 3), NaN for unknown matrices."""
    from scipy.spatial.transform import Rotation

    quaternions = np.full((len(matrices), 4), np.nan)
    quaternions[known] = Rotation.from_matrix(matrices[known]).as_quat(scalar_first=True)
    return quaternions


def level_from(points: FloatArray, up: Up) -> FloatArray:
    """Return points (..., 3) in n from a laboratory frame whose y or z axis points up."""
    if up == "z":
        return points
    if up == "y":
        return np.stack((points[..., 0], -points[..., 2], points[..., 1]), axis=-1)
    raise InputError(f'up: expected "y" or "z", got {up!r}. Select the laboratory axis that points up.')


def unique_labels(labels: tuple[str, ...] | list[str]) -> tuple[str, ...]:
    """Return unique labels: the second and later occurrences of a name get #2, #3, ..."""
    out: list[str] = []
    for label in labels:
        count, name = 1, label
        while name in out:
            count += 1
            name = f"{label}#{count}"
        out.append(name)
    return tuple(out)


def markers_of(
    path: Path, labels: tuple[str, ...], points: FloatArray, time: FloatArray, *, up: Up | None, why: str = "the file"
) -> Markers:
    """Return marker trajectories in the level frame. The axis that points up must be given."""
    if up is None:
        raise InputError(
            f"{path}: expected the axis that points up, got none. {why} does not contain it. Set up = 'y' or 'z', or use "
            "the option --reference-up.",
            missing="up",
        )
    with naming(path):
        return Markers(labels=unique_labels(labels), time=time, points=level_from(points, up), name=path.name)


def _mean_shape(points: FloatArray, complete: BoolArray) -> FloatArray:
    """Return the cluster's average shape over the frames with all markers, in the axes of the first of these frames."""
    full = points[complete]
    template: FloatArray = full[0] - full[0].mean(axis=0)
    all_seen = np.ones(full.shape[:2], dtype=np.bool_)
    for _ in range(_ROUNDS):
        turn, shift, good = _fit(full, all_seen, template)
        if not good.any():
            break
        template = np.einsum("nji,nkj->nki", turn[good], full[good] - shift[good][:, None]).mean(axis=0)
        template = template - template.mean(axis=0)
    # Averaging may have turned the shape by the noise of a single frame: align it with the first frame.
    turn, _, good = _fit(full[:1], all_seen[:1], template)
    if good[0]:
        template = np.asarray(np.einsum("ij,kj->ki", turn[0], template))
    return template


def _fit(points: FloatArray, visible: BoolArray, template: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return rotation (N, 3, 3) and position (N, 3) of the template in each frame, and True for frames with a pose (N,)."""
    weight = visible.astype(np.float64)[..., None]
    count = np.maximum(weight.sum(axis=1), 1.0)
    x = np.where(visible[..., None], points, 0.0)
    centre_x = x.sum(axis=1) / count
    centre_c = (weight * template).sum(axis=1) / count
    c = weight * (template - centre_c[:, None])
    u, s, vt = np.linalg.svd(np.einsum("nki,nkj->nij", weight * (x - centre_x[:, None]), c))
    sign = np.ones((len(points), 3))
    sign[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = (u * sign[:, None]) @ vt
    good = (visible.sum(axis=1) >= 3) & (s[:, 1] > _FLAT**2 * s[:, 0])
    return turn, centre_x - np.einsum("nij,nj->ni", turn, centre_c), good


# ---- C3D, plain or gzip: integer and real storage; Intel, DEC and MIPS byte orders

_MAGIC, _FARTHEST = 0x50, 1e6  # largest plausible position, in the unit of the file: 1 km in mm


def read_c3d(path: str | Path, up: Up | None = None) -> Markers:
    """Read marker trajectories from a C3D file."""
    path = Path(path)
    header, point, points, residuals = _parse(path)
    xyz = np.moveaxis(np.asarray(points, dtype=np.float64)[:3], 0, 2)  # (M, N, 3)
    count, frames = xyz.shape[:2]
    if count == 0 or frames < 2:
        raise FileFormatError(
            f"{path}: expected marker points over two frames or more, got {count} markers, {frames} frames"
        )
    # A point with a negative residual, or at exactly 0, 0, 0, was not visible.
    xyz[(residuals[0] < 0.0) | ~np.isfinite(xyz).all(axis=2) | (xyz == 0.0).all(axis=2)] = np.nan
    farthest = float(np.abs(xyz).max(initial=0.0, where=np.isfinite(xyz)))
    if farthest > _FARTHEST:
        raise FileFormatError(
            f"{path}: expected positions up to {_FARTHEST:g}, got {farthest:.3g}. The file is damaged."
        )
    rate, first = float(header["frame_rate"]), int(header["first_frame"])
    if not rate > 0.0:
        raise FileFormatError(f"{path}: expected a frame rate above 0, got {rate:g} Hz. The header is damaged.")
    unit, screen = (str(next(iter(point.get(key, ())), "")) for key in ("UNITS", "Y_SCREEN"))
    if not unit.strip():
        raise FileFormatError(
            f"{path}: expected the unit of length in POINT:UNITS, got none. The parameters are damaged."
        )
    labels: list[str] = []
    for k in range(1, 100):  # LABELS2, LABELS3, ... continue LABELS
        key = "LABELS" if k == 1 else f"LABELS{k}"
        if key not in point or len(labels) >= count:
            break
        labels += [str(label).strip() for label in point[key]]
    names = tuple(label or "unlabelled" for label in (labels + [""] * count)[:count])
    time = (first + np.arange(frames)) / rate
    up = up or {"+Z": "z", "+Y": "y"}.get(screen)  # type: ignore[assignment]
    metres = np.moveaxis(xyz, 0, 1) * si_factor(unit, "length")
    return markers_of(path, names, metres, time, up=up, why="POINT:Y_SCREEN")


def is_c3d(head: bytes) -> bool:
    """Return True if a file begins like a C3D file."""
    return len(head) > 512 and head[1] == _MAGIC and 2 <= head[0] < 128


def _parse(path: Path) -> tuple[Any, Any, FloatArray, FloatArray]:
    """Return the header, the parameters, the points and the residuals of a C3D file."""
    if find_spec("ezc3d") is None:
        raise InputError(
            f"{path}: C3D files need the package ezc3d, which is not installed. Run pip install ezc3d, or export TRC."
        )
    content = read_bytes(path)
    analogs, plain = _check_size(content, path), path
    with tempfile.TemporaryDirectory() as folder:
        if is_gzip(path):
            plain = Path(folder) / "unpacked.c3d"
            plain.write_bytes(content)
        header, point, points, residuals, values = isolated(_parts, path, plain)
    if analogs * points.shape[2] != values:  # otherwise points would be read from wrong positions
        raise FileFormatError(
            f"{path}: the parameters do not give {analogs} analog values per frame. The file is damaged."
        )
    return header, point, points, residuals


def _parts(path: Path, plain: Path) -> tuple[Any, Any, FloatArray, FloatArray, int]:
    import ezc3d

    with sound(path, "C3D"):
        trial = ezc3d.c3d(str(plain))
        header, data = trial["header"]["points"], trial["data"]
        point = {name: item["value"] for name, item in trial["parameters"]["POINT"].items() if "value" in item}
        return header, point, data["points"], data["meta_points"]["residuals"], data["analogs"].size


def _check_size(content: bytes, path: Path) -> int:
    """Return the analog values per frame. Before parsing, raise for a file that is not C3D or does not have the length that its
    header requires.
    """
    if not is_c3d(content):
        raise FileFormatError(f"{path}: expected a C3D file, got other content. Check the path.")
    block = (content[0] - 1) * 512
    if len(content) < block + 4:
        raise FileFormatError(f"{path}: the C3D file is truncated before its parameters. Copy it again.")
    processor = content[block + 3] - 83  # 1 Intel, 2 DEC (Intel's order of bytes in words), 3 MIPS
    header = np.frombuffer(content[:512], dtype=">u2" if processor == 3 else "<u2")
    points, analogs, first, last, start = (int(header[k]) for k in (1, 2, 3, 4, 8))
    real = bool(header[7 if processor == 1 else 6] & 0x8000)  # a negative scale indicates real storage
    frames = last - first + 1 if last < 65535 else 0  # longer trials have their length in the parameters
    need = 512 * (start - 1) + frames * (4 * points + analogs) * (4 if real else 2)
    padded_size = -(-need // 512) * 512
    one_more = len(content) == padded_size + 512 and not any(
        content[padded_size:]
    )  # some writers end with an empty block
    if len(content) < need or (frames and len(content) not in (need, padded_size) and not one_more):
        raise FileFormatError(
            f"{path}: expected {need} bytes according to its header, got {len(content)}. The file is damaged. Copy it again."
        )
    return analogs


# ---- TRC, plain or gzip: four or five header lines, then frame, time and x, y, z of every marker
#
# Header tabs differ between programs (labels every three columns, or every two), so a label belongs to the next triple in
# order. An empty cell, a row that ends early, and the point 0, 0, 0 that some programs write for a lost marker, are gaps.

_HEAD = ("DataRate", "NumMarkers", "Units")


def read_trc(path: str | Path, up: Up | None = None) -> Markers:
    """Read marker trajectories from a TRC file."""
    path = Path(path)
    try:
        lines = read_bytes(path).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: expected a TRC file in UTF-8, got other bytes at {error.start}. Save it again."
        ) from error
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise FileFormatError(
            f"{path}: expected a TRC file (first word PathFileType), got {lines[0][:40] if lines else ''!r}"
        )
    keys, values = lines[1].split("\t"), lines[2].split("\t")
    head = dict(zip((key.strip() for key in keys), (value.strip() for value in values), strict=False))
    if not all(head.get(key) for key in _HEAD):
        raise FileFormatError(
            f"{path}: expected {', '.join(_HEAD)} in lines 2 and 3, got {', '.join(filter(None, head))}"
        )
    labels = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    if not head["NumMarkers"].isdigit() or int(head["NumMarkers"]) < 1:
        raise FileFormatError(f"{path}: expected NumMarkers of 1 or more in line 3, got {head['NumMarkers']!r}")
    wanted = int(head["NumMarkers"])
    if len(labels) != wanted:
        raise FileFormatError(f"{path}: expected {wanted} marker labels in line 4 (NumMarkers), got {len(labels)}.")
    time, cells, short = _rows(lines, 2 + 3 * wanted, path)
    frame_count = int(head.get("NumFrames", "")) if head.get("NumFrames", "").isdigit() else 2
    if len(time) < max(frame_count, 2):
        raise FileFormatError(
            f"{path}: expected {max(frame_count, 2)} frames (NumFrames in line 3), got {len(time)}. The file is "
            f"truncated. Copy it again."
        )
    points = cells.reshape(len(time), wanted, 3) * si_factor(head["Units"], "length")
    points[~np.isfinite(points).all(axis=2) | (points == 0.0).all(axis=2)] = np.nan
    return replace(markers_of(path, labels, points, time, up=up, why="TRC"), short_rows=short)


def _rows(lines: list[str], width: int, path: Path) -> tuple[FloatArray, FloatArray, int]:
    """Return time (N,), cells (N, width - 2), and the number of short rows, which end after a marker and are filled with NaN."""
    rows = [(number, line.split("\t")) for number, line in enumerate(lines[5:], start=6) if line.strip()]
    out = np.full((len(rows), width), np.nan)
    for row, (number, cells) in enumerate(rows):
        extra = [cell for cell in cells[width:] if cell.strip()]
        torn = len(cells) < width and len("\t".join(cells).rstrip().split("\t")) % 3 != 2
        if extra or len(cells) < 2 or torn:
            raise FileFormatError(
                f"{path}: expected {width} columns in line {number}, got {len(cells)}. Correct the line or the header."
            )
        wrong = next((cell for cell in cells if not is_number(cell, empty=True)), None)
        if wrong is not None:
            raise FileFormatError(f"{path}: expected numbers in line {number}, got {wrong!r}. Repair the line.")
        out[row, : min(width, len(cells))] = [float(cell) if cell.strip() else np.nan for cell in cells[:width]]
    return out[:, 1], out[:, 2:], sum(len(cells) < width for _, cells in rows)
