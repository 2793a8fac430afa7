"""Bodies: anatomical segments from skin markers, and a device fixed on one of them.

All axes are x forward, y left, z up, as a device worn at the back would be mounted. With mid(.) the mean of markers::

    pelvis   rigid cluster of the four spines (ASIS, PSIS), or of the belt markers at the sides and the back (MWT, BWT);
             origin: middle of the rear pair, y from right to left, x from the rear pair to the front pair
    thorax   rigid cluster C7, T10, CLAV, STRN; origin: mid(T10, STRN); z from there to mid(C7, CLAV), x to the front
    trunk    the line from mid(PSIS), SACR or the rear belt markers (origin) to C7 is z, x to the front of the pelvis: the
             trunk's lean is the tilt of its z. Not rigid: it bends with the spine

A cluster is fitted to all of its markers (markers.py) and the anatomical axes are those of its mean shape. A frame that
lacks a marker of the body is a gap: a fit to fewer would jump by what the skin has moved.

Labels are compared without a prefix up to ":", case, dots, blanks and underscores: ``r.PSIS``, ``RPSI`` and
``Subject:RPSI`` are one marker.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_product, rotate
from undrift.io.markers import Markers, fit_cluster
from undrift.record import Reference

BodyName = Literal["pelvis", "thorax", "trunk"]
AxesOf = Callable[[FloatArray], tuple[FloatArray, FloatArray]]  # markers (..., K, 3) to origin and R_nb

ALIASES = {
    "LASI": ("LASI", "LASIS"),
    "RASI": ("RASI", "RASIS"),
    "LPSI": ("LPSI", "LPSIS"),
    "RPSI": ("RPSI", "RPSIS"),
    "CLAV": ("CLAV", "IJ"),
    "STRN": ("STRN", "STERNUM", "PX"),
    "SACR": ("SACR", "SACRUM", "VSAC"),
    "LMWT": ("LMWT",),
    "RMWT": ("RMWT",),
    "LBWT": ("LBWT",),
    "RBWT": ("RBWT",),
    "C7": ("C7",),
    "T10": ("T10",),
}
# left front, right front, left rear, right rear
_PELVES = (("LASI", "RASI", "LPSI", "RPSI"), ("LMWT", "RMWT", "LBWT", "RBWT"))
_THORAX = ("C7", "T10", "CLAV", "STRN")

# From mid(PSIS), at the level of S2, to the skin over the spinous process of L5, and half a case further back. Assumed:
# anatomy of an adult, no measurement; state the offset that was measured where there is one.
L5_OFFSET = (-0.02, 0.0, 0.035)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A segment as an anatomical frame in every frame of a recording.

    Parameters
    ----------
    reference : Reference
        Orientation b to n (b: x forward, y left, z up) and position of its origin, m; NaN where a marker is missing.
    labels : tuple of str
        Markers used, as the file calls them.
    residual : float
        Root mean square of what a rigid body leaves, m; 0 for a body made of lines.
    """

    reference: Reference
    labels: tuple[str, ...]
    residual: float


def find_body(markers: Markers, name: BodyName) -> Body:
    """Return an anatomical segment from marker trajectories.

    Parameters
    ----------
    markers : Markers
        Trajectories in n, m.
    name : str
        pelvis, thorax or trunk.

    Returns
    -------
    Body
        Its frame over time.

    Raises
    ------
    InputError
        A name that is not one; markers that are not there; never all seen at once.
    """
    if name == "pelvis":
        return _pelvis(markers)
    if name == "thorax":
        used = _needed(markers, _THORAX, "thorax")
        return _rigid(markers, used, _thorax_axes, "thorax")
    if name == "trunk":
        return _trunk(markers)
    raise InputError(f"body: wanted {', '.join(get_args(BodyName))}, got {name!r}; choose one")


def device_on(
    body: Body,
    *,
    offset_b: tuple[float, float, float] = L5_OFFSET,
    q_bd: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
) -> Reference:
    """Return the poses of a device fixed on a body.

    ``p_d = p_b + R_nb r`` and ``q_nd = q_nb q_bd``: the device's case d sits at r from the body's origin, turned by q_bd.

    Parameters
    ----------
    body : Body
        What it is worn on.
    offset_b : tuple of float
        Device from the body's origin, in the body's axes, m.
    q_bd : tuple of float
        Case to body, w-x-y-z.

    Returns
    -------
    Reference
        Poses of the case; its name states the offset.

    Raises
    ------
    InputError
        A quaternion that is not of unit length.
    """
    mount = np.array(q_bd)
    if abs(float(np.linalg.norm(mount)) - 1.0) > 1e-6:
        raise InputError(
            f"device: wanted a unit quaternion w-x-y-z from case to body, got length {np.linalg.norm(mount):.6g}; divide by it"
        )
    poses = body.reference
    origin = poses.position if poses.position is not None else np.full((len(poses), 3), np.nan)
    millimetres = ", ".join(f"{1e3 * value:g}" for value in offset_b)
    return Reference(
        time=poses.time,
        q_nb=quaternion_product(poses.q_nb, mount),
        position=origin + rotate(poses.q_nb, np.array(offset_b)),
        moving=poses.moving,
        name=f"{poses.name}, device at ({millimetres}) mm",
    )


def find_label(markers: Markers, name: str) -> str | None:
    """Return how a recording calls a marker.

    Parameters
    ----------
    markers : Markers
        Trajectories.
    name : str
        One of ``ALIASES``.

    Returns
    -------
    str or None
        The file's label; None where there is none.
    """
    plain = {_plain(label): label for label in reversed(markers.labels)}
    return next((plain[alias] for alias in ALIASES[name] if alias in plain), None)


def _plain(label: str) -> str:
    return "".join(c for c in label.rsplit(":", 1)[-1].upper() if c not in "._- ")


def _needed(markers: Markers, names: tuple[str, ...], body: str) -> list[str]:
    found = [find_label(markers, name) for name in names]
    missing = [name for name, label in zip(names, found, strict=True) if label is None]
    if missing:
        raise InputError(
            f"{markers.name or 'markers'}: {body}: wanted markers {', '.join(names)}, got none called {', '.join(missing)}; "
            "rename them or take a cluster"
        )
    return [label for label in found if label is not None]


def _pelvis_labels(markers: Markers) -> list[str]:
    for names in _PELVES:
        if all(find_label(markers, name) for name in names):
            return _needed(markers, names, "pelvis")
    return _needed(markers, _PELVES[0], "pelvis")


def _pelvis(markers: Markers) -> Body:
    return _rigid(markers, _pelvis_labels(markers), _pelvis_axes, "pelvis")


def _pelvis_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    left_front, right_front, left_rear, right_rear = np.moveaxis(shape, -2, 0)
    rear, front = 0.5 * (left_rear + right_rear), 0.5 * (left_front + right_front)
    left = left_front + left_rear - right_front - right_rear
    return rear, _axes(up=np.cross(front - rear, left), forward=front - rear)


def _thorax_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    c7, t10, clavicle, sternum = np.moveaxis(shape, -2, 0)
    low, high = 0.5 * (t10 + sternum), 0.5 * (c7 + clavicle)
    return low, _axes(up=high - low, forward=clavicle + sternum - c7 - t10)


def _axes(*, up: FloatArray, forward: FloatArray) -> FloatArray:
    """Return R_nb (..., 3, 3): z along up, x towards forward."""
    z = up / np.linalg.norm(up, axis=-1, keepdims=True)
    y = np.cross(z, forward)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack((np.cross(y, z), y, z), axis=-1)


def _rigid(markers: Markers, labels: list[str], axes: AxesOf, name: str) -> Body:
    from scipy.spatial.transform import Rotation

    cluster = fit_cluster(markers, labels)
    origin, turn = axes(cluster.template)
    q_mb = Rotation.from_matrix(turn).as_quat(scalar_first=True)
    whole = cluster.visible >= len(labels)
    poses = cluster.reference
    centre = poses.position if poses.position is not None else np.full((len(poses), 3), np.nan)
    return Body(
        reference=Reference(
            time=poses.time,
            q_nb=np.where(whole[:, None], quaternion_product(poses.q_nb, q_mb), np.nan),
            position=np.where(whole[:, None], centre + rotate(poses.q_nb, origin), np.nan),
            name=f"{markers.name} {name}".strip(),
        ),
        labels=tuple(labels),
        residual=cluster.rms,
    )


def _trunk(markers: Markers) -> Body:
    from scipy.spatial.transform import Rotation

    pelvis = _pelvis(markers)
    (c7,) = _needed(markers, ("C7",), "trunk")
    x = markers.pick([*pelvis.labels, c7])
    low, frame = _pelvis_axes(x[:, :4])
    turn = _axes(up=x[:, 4] - low, forward=frame[:, :, 0])
    seen: BoolArray = np.asarray(np.isfinite(turn).all(axis=(1, 2)))
    if not seen.any():
        raise InputError(f"{markers.name or 'markers'}: trunk: wanted frames with all of its markers, got none")
    q = np.full((len(x), 4), np.nan)
    q[seen] = Rotation.from_matrix(turn[seen]).as_quat(scalar_first=True)
    poses = Reference(
        time=markers.time, q_nb=q, position=np.where(seen[:, None], low, np.nan), name=f"{markers.name} trunk".strip()
    )
    return Body(reference=poses, labels=(*pelvis.labels, c7), residual=0.0)
