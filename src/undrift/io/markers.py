"""Markers: what the optics measured point by point, and the pose of a rigid cluster of them.

Points are in n, the level frame with z up, in m; NaN is a gap. A cluster of three or more markers that do not lie on one line
is a body with frame m: origin at the centroid of the cluster, axes parallel to n in the first frame in which all of its
markers are seen. Its pose in each frame solves

    minimise over R, p    sum_k | R c_k + p - x_k |^2        c_k marker k in m, x_k as seen

by the singular value decomposition of sum_k x_k c_k^T (Kabsch); frames with fewer than three markers are gaps.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import InputError
from undrift.record import Reference, check_time, sample_rate_of

Up = Literal["y", "z"]
_ROUNDS = 4  # of the average shape: it settles in two
_FLAT = 1e-2  # a cluster's width over its length, under which the turn about the long axis is not seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """Marker trajectories.

    Parameters
    ----------
    labels : tuple of str
        One for each marker, all different.
    time : array, shape (N,)
        s, strictly increasing.
    points : array, shape (N, M, 3)
        Positions in n (z up), m; NaN is a gap.
    name : str
        Where they came from.

    Raises
    ------
    InputError
        Shapes that disagree, repeated labels, time that does not increase.
    """

    labels: tuple[str, ...]
    time: FloatArray
    points: FloatArray
    name: str = ""

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "time", frozen(self.time, (None,), "time"))
        set_(self, "points", frozen(self.points, (len(self.time), len(self.labels), 3), "points"))
        if len(set(self.labels)) != len(self.labels):
            twice = sorted({label for label in self.labels if self.labels.count(label) > 1})
            raise InputError(f"markers: wanted different labels, got {', '.join(twice)} more than once; number them")
        check_time(self.time)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Frames per second."""
        return sample_rate_of(self.time)

    def pick(self, labels: tuple[str, ...] | list[str]) -> FloatArray:
        """Return the trajectories of some markers.

        Parameters
        ----------
        labels : tuple of str
            Wanted markers, in this order.

        Returns
        -------
        array, shape (N, K, 3)
            Positions in n, m.

        Raises
        ------
        InputError
            A label that is not there; lists those that are.
        """
        for label in labels:
            if label not in self.labels:
                near = [other for other in self.labels if label.lower() in other.lower()]
                hint = f"say {' or '.join(near[:3])}" if near else "check the label"
                raise InputError(
                    f"{self.name or 'markers'}: wanted marker {label!r}, got {', '.join(self.labels)}; {hint}"
                )
        return self.points[:, [self.labels.index(label) for label in labels]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClusterPose:
    """Pose of a rigid cluster and how rigid it was.

    Parameters
    ----------
    reference : Reference
        q_nb with b the frame m of the cluster, and position of its centroid.
    template : array, shape (K, 3)
        Markers in m, m.
    residual : array, shape (N,)
        Root mean square over the seen markers of what the pose leaves, m; NaN in gaps.
    visible : array, shape (N,)
        Markers seen in each frame.
    """

    reference: Reference
    template: FloatArray
    residual: FloatArray
    visible: FloatArray

    @property
    def rms(self) -> float:
        """Root mean square of the residual over all frames with a pose, m."""
        return float(np.sqrt(np.nanmean(self.residual**2)))


def pose_from_cluster(markers: Markers, labels: tuple[str, ...] | list[str]) -> Reference:
    """Return the pose of a rigid cluster of markers; :func:`fit_cluster` also tells how rigid it was.

    Parameters
    ----------
    markers : Markers
        Trajectories.
    labels : tuple of str
        Three markers or more on one rigid body.

    Returns
    -------
    Reference
        Orientation m to n and position of the centroid, m; NaN where fewer than three are seen. Its name states the rms
        residual.

    Raises
    ------
    InputError
        As :func:`fit_cluster`.
    """
    return fit_cluster(markers, labels).reference


def fit_cluster(markers: Markers, labels: tuple[str, ...] | list[str]) -> ClusterPose:
    """Fit a rigid body to a cluster of markers, frame by frame [1]_.

    Parameters
    ----------
    markers : Markers
        Trajectories.
    labels : tuple of str
        Three markers or more on one rigid body.

    Returns
    -------
    ClusterPose
        Pose, the cluster's mean shape and the residual of each frame.

    Raises
    ------
    InputError
        Fewer than three labels, a label twice or not there, never all seen at once, or markers on one line.

    References
    ----------
    .. [1] W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32, 1976.
    """
    if len(labels) < 3 or len(set(labels)) != len(labels):
        raise InputError(
            f"cluster: wanted three different markers or more, got {', '.join(labels) or 'none'}; name them"
        )
    points = markers.pick(labels)
    seen: BoolArray = np.all(np.isfinite(points), axis=2)
    whole: BoolArray = np.all(seen, axis=1)
    if not whole.any():
        rarest = labels[int(seen.sum(axis=0).argmin())]
        raise InputError(f"cluster: wanted a frame with all of {', '.join(labels)}, got none; leave out {rarest}")
    template = _mean_shape(points, whole)
    spread = np.linalg.svd(template, compute_uv=False)
    if spread[1] < _FLAT * spread[0]:
        raise InputError(
            f"cluster: wanted markers that span a plane, got {', '.join(labels)} on one line; add one beside it"
        )
    turn, shift, good = _fit(points, seen, template)
    left = points - (np.einsum("nij,kj->nki", turn, template) + shift[:, None])
    square = np.where(seen, (left**2).sum(axis=2), 0.0).sum(axis=1)
    residual = np.where(good, np.sqrt(square / np.maximum(seen.sum(axis=1), 1)), np.nan)
    rms_mm = 1e3 * float(np.sqrt(np.nanmean(residual**2)))
    reference = Reference(
        time=markers.time,
        q_nb=_quaternions(turn, good),
        position=np.where(good[:, None], shift, np.nan),
        name=f"{markers.name} cluster {' '.join(labels)} (rigid within {rms_mm:.2f} mm rms)".strip(),
    )
    return ClusterPose(
        reference=reference, template=template, residual=residual, visible=seen.sum(axis=1).astype(np.float64)
    )


def level_from(points: FloatArray, up: Up) -> FloatArray:
    """Return points in n from a laboratory frame whose y or z axis points up.

    Parameters
    ----------
    points : array, shape (..., 3)
        Any unit.
    up : str
        "z" leaves them; "y" turns about x: (x, y, z) becomes (x, -z, y).

    Returns
    -------
    array, shape (..., 3)
        The same points, z up.

    Raises
    ------
    InputError
        Another letter.
    """
    if up == "z":
        return points
    if up == "y":
        return np.stack((points[..., 0], -points[..., 2], points[..., 1]), axis=-1)
    raise InputError(f'up: wanted "y" or "z", got {up!r}; name the axis of the laboratory that points up')


def unique_labels(labels: tuple[str, ...] | list[str]) -> tuple[str, ...]:
    """Return labels made different: the second and later of a name get #2, #3, ...

    Parameters
    ----------
    labels : tuple of str
        As in the file.

    Returns
    -------
    tuple of str
        As many, all different.
    """
    out: list[str] = []
    for label in labels:
        count, name = 1, label
        while name in out:
            count += 1
            name = f"{label}#{count}"
        out.append(name)
    return tuple(out)


def _mean_shape(points: FloatArray, whole: BoolArray) -> FloatArray:
    """Return the cluster's average shape over the frames that show all of it, in the axes of the first of them."""
    full = points[whole]
    template: FloatArray = full[0] - full[0].mean(axis=0)
    all_seen = np.ones(full.shape[:2], dtype=np.bool_)
    for _ in range(_ROUNDS):
        turn, shift, good = _fit(full, all_seen, template)
        if not good.any():
            break
        back = np.einsum("nji,nkj->nki", turn[good], full[good] - shift[good][:, None])
        template = back.mean(axis=0)
        template = template - template.mean(axis=0)
    # Averaging may have turned the shape by the noise of one frame: put it back on the first.
    turn, _, good = _fit(full[:1], all_seen[:1], template)
    if good[0]:
        template = np.asarray(np.einsum("ij,kj->ki", turn[0], template))
    return template


def _fit(points: FloatArray, seen: BoolArray, template: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return rotation (N, 3, 3), position (N, 3) and whether there is one (N,), of the template in each frame."""
    weight = seen.astype(np.float64)[..., None]
    count = np.maximum(weight.sum(axis=1), 1.0)
    x = np.where(seen[..., None], points, 0.0)
    centre_x = x.sum(axis=1) / count
    centre_c = (weight * template).sum(axis=1) / count
    c = weight * (template - centre_c[:, None])
    u, s, vt = np.linalg.svd(np.einsum("nki,nkj->nij", weight * (x - centre_x[:, None]), c))
    sign = np.ones((len(points), 3))
    sign[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = (u * sign[:, None]) @ vt
    good = (seen.sum(axis=1) >= 3) & (s[:, 1] > _FLAT**2 * s[:, 0])
    return turn, centre_x - np.einsum("nij,nj->ni", turn, centre_c), good


def _quaternions(turn: FloatArray, good: BoolArray) -> FloatArray:
    """Return w-x-y-z of the rotations, NaN in gaps, without jumps of sign."""
    from scipy.spatial.transform import Rotation

    q = np.full((len(turn), 4), np.nan)
    some = Rotation.from_matrix(turn[good]).as_quat(scalar_first=True)
    flips = np.where((some[1:] * some[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    some[1:] *= np.cumprod(flips)[:, None]
    q[good] = some
    return q
