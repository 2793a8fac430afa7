"""Plausibility: answers that cannot be this device, each named with its number and what to do about it.

A fit calls these before it trusts its data and after it has an answer. Every function returns None or raises.
"""

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import AXES
from undrift.errors import Implausible, NotObservable
from undrift.session import FACES, Axis, Face

# A gain this close to a whole factor is a unit, a range or a sample rate, not a sensor.
_FACTORS = (2.0, 4.0, 8.0, 16.0)
_SATURATED_RUN = 5  # samples in a row at the same extreme reading
_REPEAT_APART = 0.5  # g; 29 deg: no repeated face leans so far
_FAR_FROM_REST = 50.0  # steps between the extreme and the median before a run counts as saturation


def face_vectors(faces: Sequence[Face]) -> FloatArray:
    """Return the direction of +g in s for each face, one unit vector a row.

    Parameters
    ----------
    faces : sequence of str
        "+x" means that the x axis points up and reads +g.

    Returns
    -------
    array, shape (P, 3)
        Signed unit vectors.
    """
    up = np.zeros((len(faces), 3))
    for row, face in enumerate(faces):
        up[row, AXES.index(face[1])] = 1.0 if face[0] == "+" else -1.0
    return up


def axis_vectors(axes: Sequence[Axis]) -> FloatArray:
    """Return the unit vector of each axis, one a row.

    Parameters
    ----------
    axes : sequence of str
        "x", "y" or "z".

    Returns
    -------
    array, shape (R, 3)
        Unit vectors.
    """
    return np.eye(3)[[AXES.index(axis) for axis in axes]].reshape(-1, 3)


def check_pose_count(count: int, needed: int, what: str) -> None:
    """Raise unless there are enough poses or turns for a fit.

    Parameters
    ----------
    count, needed : int
        How many there are, and how many the fit needs.
    what : str
        What is counted, in the plural.

    Raises
    ------
    NotObservable
        Too few.
    """
    if count < needed:
        raise NotObservable(
            f"wanted {needed} {what} or more, got {count}; record the missing ones", count=count, needed=needed
        )


def check_gravity(means: FloatArray, gravity: float, *, factor: float = 1.6) -> None:
    """Raise when the length of the specific force at rest cannot be gravity.

    Parameters
    ----------
    means : array, shape (P, 3)
        Mean reading of each pose, m/s2.
    gravity : float
        Local gravity, m/s2.
    factor : float
        Largest ratio, either way, between the median length and gravity.

    Raises
    ------
    Implausible
        Wrong unit or range.
    """
    ratio = float(np.median(np.linalg.norm(means, axis=1))) / gravity
    if not 1.0 / factor <= ratio <= factor:
        raise Implausible(
            f"accelerometer at rest: wanted |a| near {gravity:.4g} m/s2, got {ratio * gravity:.4g} m/s2 ({ratio:.3f} g); "
            f"{_likely_factor(ratio)}check the unit of the columns and the range setting",
            ratio=ratio,
        )


def check_faces(means: FloatArray, faces: Sequence[Face]) -> None:
    """Raise when the labels of a six-face session contradict its readings.

    Duplicated: two poses with different labels read the same, or two with the same label do not. Swapped: exchanging the
    readings of two labels makes the affine fit at least five times better, or a face reads less along its axis than the
    opposite one.

    Parameters
    ----------
    means : array, shape (P, 3)
        Mean reading of each pose, any unit.
    faces : sequence of str
        Label of each pose.

    Raises
    ------
    Implausible
        Duplicated or swapped faces.
    """
    up = face_vectors(faces)
    radius = 0.5 * float(np.max(means.max(axis=0) - means.min(axis=0)))
    for a, b in itertools.combinations(range(len(faces)), 2):
        apart = float(np.linalg.norm(means[a] - means[b]))
        if faces[a] != faces[b] and apart < 0.3 * radius:
            raise Implausible(
                f"faces {faces[a]} and {faces[b]}: wanted two poses, got readings {apart / radius:.3f} g apart; "
                "one face was recorded twice: label it again or record the missing one",
                faces=(faces[a], faces[b]),
                apart_g=apart / radius,
            )
    _check_repeats(means, faces, radius)
    present = [f for f in FACES if f in faces]
    before = _affine_misfit(means, up)
    if len(present) < 5 or before < 0.2 * radius:
        _check_opposites(means, up, faces)
        return
    pair = _explaining_swap(means, faces, present, 0.2 * before)
    what = f"faces {pair[0]} and {pair[1]} are swapped" if pair else "labels do not fit the readings"
    raise Implausible(
        f"six faces: wanted readings that follow their labels, got a misfit of {before / radius:.2f} g rms; {what}: "
        "correct the labels in session.toml",
        misfit_g=before / radius,
        swapped=pair,
    )


def check_handedness(forward: FloatArray, what: str) -> None:
    """Raise when a forward matrix turns a right-handed frame into a left-handed one.

    Parameters
    ----------
    forward : array, shape (3, 3)
        K of the forward model.
    what : str
        Which triad.

    Raises
    ------
    Implausible
        det K < 0, with the axes whose own gain is negative.
    """
    if np.linalg.det(forward) < 0.0:
        negative = [axis for k, axis in enumerate(AXES) if forward[k, k] < 0.0]
        named = " and ".join(negative) if negative else "two axes exchanged"
        raise Implausible(
            f"{what}: wanted right-handed axes, got a left-handed triad (reversed: {named}); "
            "correct the labels, or the sign or order of the columns",
            reversed=tuple(negative),
        )


def check_scale_factor(scale_factor: FloatArray, stated: float, tolerance: float, what: str) -> None:
    """Raise when a fitted scale factor is outside the tolerance of the sensitivity the maker states.

    Parameters
    ----------
    scale_factor : array, shape (K,)
        Fitted, reading per input.
    stated : float
        Stated by the maker, same unit; 1 where the readings were converted by the stated sensitivity.
    tolerance : float
        Relative: 0.03 for a part of +-3 %.
    what : str
        Which triad or axis.

    Raises
    ------
    Implausible
        With the worst ratio.
    """
    ratio = np.atleast_1d(np.asarray(scale_factor, float)) / stated
    worst = float(ratio[int(np.argmax(np.abs(ratio - 1.0)))])
    if abs(worst - 1.0) > tolerance:
        raise Implausible(
            f"{what}: wanted a scale factor within {100 * tolerance:g} % of the stated sensitivity, got {worst:.4f} of it "
            f"({100 * (worst - 1.0):+.1f} %); {_likely_factor(worst)}check the conversion from counts, the range setting "
            "and the sample rate",
            ratio=worst,
            tolerance=tolerance,
        )


def check_saturation(values: FloatArray, what: str, *, full_scale: float | None = None) -> None:
    """Raise when readings stick at the end of the range.

    Parameters
    ----------
    values : array, shape (N, 3)
        Readings of one triad, any unit.
    what : str
        Which triad.
    full_scale : float, optional
        Largest reading the converter can give, same unit; without it, a run of five samples at an axis' extreme, far from
        its median, counts.

    Raises
    ------
    Implausible
        With the axis, the number of samples and the reading they stick at.
    """
    for axis, column in zip(AXES, values.T, strict=True):
        finite = column[np.isfinite(column)]
        steps = np.unique(np.abs(np.diff(np.unique(finite))))
        if not len(steps):
            continue
        for extreme in (finite.max(), finite.min()):
            stuck = finite == extreme
            if full_scale is not None:
                hit = abs(extreme) >= full_scale and bool(stuck.any())
            else:
                far = abs(extreme - np.median(finite)) > _FAR_FROM_REST * max(steps[0], 1e-9 * abs(extreme))
                hit = far and _longest_run(stuck) >= _SATURATED_RUN
            if hit:
                raise Implausible(
                    f"{what} {axis}: wanted readings inside the range, got {int(stuck.sum())} samples stuck at {extreme:g}; "
                    "choose a wider range or move more slowly",
                    samples=int(stuck.sum()),
                    extreme=float(extreme),
                )


def missing_faces(faces: Sequence[Face]) -> tuple[Face, ...]:
    """Return the faces that a session lacks.

    Parameters
    ----------
    faces : sequence of str
        Labels there are.

    Returns
    -------
    tuple of str
        Those of the six that are not among them.
    """
    have = Counter(faces)
    return tuple(f for f in FACES if not have[f])


def _check_repeats(means: FloatArray, faces: Sequence[Face], radius: float) -> None:
    for a, b in itertools.combinations(range(len(faces)), 2):
        apart = float(np.linalg.norm(means[a] - means[b])) / radius
        if faces[a] == faces[b] and apart > _REPEAT_APART:
            missing = missing_faces(faces)
            lacking = f"; {' and '.join(missing)} missing" if missing else ""
            raise Implausible(
                f"face {faces[a]}: stated twice, readings {apart:.2f} g apart{lacking}: one of the two is another face, "
                "correct its label",
                faces=(faces[a], faces[b]),
                apart_g=apart,
            )


def _check_opposites(means: FloatArray, up: FloatArray, faces: Sequence[Face]) -> None:
    # The affine fit cannot see +x and -x exchanged: the gain merely turns negative. Axes are named by the readings' columns.
    for axis, name in enumerate(AXES):
        plus, minus = means[up[:, axis] > 0.0], means[up[:, axis] < 0.0]
        if len(plus) and len(minus):
            gain = float(plus[:, axis].mean() - minus[:, axis].mean())
            span = float(np.abs(plus.mean(axis=0) - minus.mean(axis=0)).max())
            if gain < 0.0 and -gain > 0.5 * span:
                raise Implausible(
                    f"faces +{name} and -{name}: wanted the axis that points up to read the larger value, got {gain:.4g} less; "
                    f"the two are swapped: a face names the axis that points up, which reads +g",
                    swapped=(f"+{name}", f"-{name}"),
                )


def _explaining_swap(
    means: FloatArray, faces: Sequence[Face], present: list[Face], enough: float
) -> tuple[Face, Face] | None:
    # Several swaps may fit alike, all but one of them with axes exchanged: take the one whose sensors see their own axes.
    best: tuple[Face, Face] | None = None
    most = -np.inf
    for one, other in itertools.combinations(present, 2):
        up = face_vectors([_exchange(f, one, other) for f in faces])
        design = np.column_stack((up, np.ones(len(up))))
        own = float(np.trace(np.linalg.lstsq(design, means, rcond=None)[0][:3]))
        if own > most and _affine_misfit(means, up) < enough:
            best, most = (one, other), own
    return best


def _affine_misfit(means: FloatArray, up: FloatArray) -> float:
    design = np.column_stack((up, np.ones(len(up))))
    residual = means - design @ np.linalg.lstsq(design, means, rcond=None)[0]
    return float(np.sqrt((residual**2).sum(axis=1).mean()))


def _exchange(face: Face, one: Face, other: Face) -> Face:
    return other if face == one else one if face == other else face


def _likely_factor(ratio: float) -> str:
    size = max(abs(ratio), 1.0 / max(abs(ratio), 1e-12))
    for factor in _FACTORS:
        if abs(size / factor - 1.0) < 0.06:
            return f"readings are {factor:g} times too {'small' if abs(ratio) < 1.0 else 'large'}: "
    return ""


def _longest_run(flag: FloatArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0
