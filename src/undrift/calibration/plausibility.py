"""Plausibility: answers that cannot be this device, each named with its number and what to do about it.

A fit calls these before it trusts its data and after it has an answer. Every check returns None or raises.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.errors import Implausible
from undrift.findings import Finding, finding
from undrift.model import AXES
from undrift.record import FACES, Face, Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

# ---- axis order: do a gyroscope's columns have the order and sense of the stated axes?
#
# Of the 48 matrices with one +1 or -1 in every row and column, the one nearest to a gyroscope's forward matrix K, its rows scaled
# to one, gives what each column senses:
#
#     P = argmax sum_ij P_ij K_ij / |K_i|        P_ij = +1: column i reads + for a turn about +j
#
# Any P but the identity is an exchange of columns, a wrong sign, or axis labels that do not belong to the data. A left-handed
# triad is only one half of the cases: an even exchange stays right-handed.

Against = Literal["accelerometer", "turns"]


def nearest_signed_permutation(forward: FloatArray) -> FloatArray:
    """Return the signed permutation (3, 3) nearest to a forward matrix (3, 3)."""
    gain = forward / np.linalg.norm(forward, axis=1)[:, None]
    rows, orders = np.arange(3), [list(order) for order in itertools.permutations(range(3))]
    order = max(orders, key=lambda p: float(np.abs(gain[rows, p]).sum()))
    nearest = np.zeros((3, 3))
    nearest[rows, order] = np.where(gain[rows, order] >= 0.0, 1.0, -1.0)
    return nearest


def check_axis_order(forward: FloatArray, what: str, *, against: Against) -> None:
    """Raise unless each gyroscope column reads + for a turn about its own axis, by the forward matrix (3, 3)."""
    seen = nearest_signed_permutation(forward)
    if not np.array_equal(seen, np.eye(3)):
        by_turns = against == "turns"
        cause = cause_by_turns(seen) if by_turns else cause_by_gravity(seen)
        raise Implausible(
            f"{what}: wanted gyroscope columns x, y, z that read turns about +x, +y, +z "
            f"{'as stated' if by_turns else 'of the accelerometer axes'}, got {order_text(seen)}: {cause}; correct the order or "
            f"the sign of the columns{' or of the turns' if by_turns else ''}",
            seen=order_text(seen),
        )


def order_text(seen: FloatArray) -> str:
    """Return a signed permutation as text: "+y, +x, +z"."""
    axis = np.abs(seen).argmax(axis=1)
    return ", ".join(f"{'+' if seen[i, j] > 0.0 else '-'}{AXES[j]}" for i, j in enumerate(axis))


def cause_by_turns(seen: FloatArray) -> str:
    """Return which columns or stated turns would have to be exchanged or reversed to give an order."""
    negative, moved = _reversed_and_moved(seen)
    if not moved:
        return f"column {' and '.join(negative)} reversed, or the sign of the turns about {' and '.join(negative)}"
    ring = " in a ring" if len(moved) == 3 else ""
    names = f"{', '.join(moved[:-1])} and {moved[-1]}"
    return f"columns {names} exchanged{ring}{_and_reversed(negative)}, or the axes of the turns"


def cause_by_gravity(seen: FloatArray) -> str:
    """Return which columns, of gyroscope or accelerometer, would have to be exchanged or reversed to give an order.

    A turn is a pseudovector: accelerometer columns that are exchanged or reversed, A, show as P = det(A) A^T.
    """
    negative, moved = _reversed_and_moved(seen)
    if not moved:
        if len(negative) == 2:
            other = next(a for a in AXES if a not in negative)
            return f"gyroscope columns {' and '.join(negative)} are reversed, or accelerometer column {other} is"
        if len(negative) == 3:
            return "all gyroscope columns are reversed, or the same two columns of both triads are exchanged"
        return f"gyroscope column {negative[0]} is reversed"
    if len(moved) == 3:
        how = f"columns x, y and z are exchanged in a ring{_and_reversed(negative)}"
        return f"{how}, those of the gyroscope or those of the accelerometer" if not negative else f"gyroscope {how}"
    pair = " and ".join(moved)
    if len(negative) == 3:
        return (
            f"accelerometer columns {pair} are exchanged, or gyroscope columns {pair} and all their signs are reversed"
        )
    return f"gyroscope columns {pair} are exchanged{_and_reversed(negative)}"


def _reversed_and_moved(seen: FloatArray) -> tuple[list[str], list[str]]:
    negative: list[str] = [AXES[i] for i in range(3) if seen[i].min() < 0.0]
    return negative, [AXES[i] for i in range(3) if seen[i, i] == 0.0]


def _and_reversed(negative: list[str]) -> str:
    return f", and {' and '.join(negative)} reversed" if negative else ""


# ---- readings at the end of the range

_RUN = 5  # equal readings in a row: at an end it is the converter's, unless readings inside repeat as long
_ABRUPT = 5.0  # smallest changes: a reading gets to the end of the range, or leaves it, in one sample
_LEAST_VALUES = 20  # different readings; fewer are a constant or steps, with no top to speak of
_FEW = 0.1  # of the readings at one end: fewer are no step of such a signal
# Share of the largest reading of an axis. Ranges are symmetric about zero, so that a reading nearer to zero is the level at rest of
# a motion to one side, not an end of the range [assumed]
_NEAR_ZERO = 0.1


class Stuck(NamedTuple):
    """Readings of one axis at the end of the range."""

    axis: int
    reading: float
    samples: int

    def refusal(self, wanted: str) -> Implausible:
        """Return the error that names them."""
        return Implausible(
            f"{wanted} readings inside the range, got {self.samples} samples stuck at {self.reading:g}; choose a wider range or "
            "move more slowly",
            samples=self.samples,
            extreme=self.reading,
        )


def without_saturated(record: Record) -> tuple[Record, tuple[Finding, ...]]:
    """Return the record with a gap in place of the readings at the end of the range, and a finding for each triad."""
    from undrift.io.inspect import saturated_runs

    found, changed = list[Finding](), dict[str, Any]()
    for channel in ("gyro", "accel"):
        readings = getattr(record, channel)
        limits = [] if readings is None else [[limit for limit, _ in saturated_runs(column)] for column in readings.T]
        if not any(limits):
            continue
        saturated = np.column_stack([np.isin(column, ends) for column, ends in zip(readings.T, limits, strict=True)])
        axes = ", ".join(axis for axis, ends in zip(AXES, limits, strict=True) if ends)
        item = {"channel": channel, "axes": axes, "count": int(saturated.any(axis=1).sum()), "of": len(record)}
        found.append(finding("reference.saturated", "warn", **item))
        changed[channel] = np.where(saturated, np.nan, readings)
    return replace(record, **changed), tuple(found)


def stuck_in_motion(windows: Sequence[FloatArray]) -> Stuck | None:
    """Return the axis that sticks at its largest or smallest reading, over all windows (n_i, 3) together."""
    window = np.repeat(np.arange(len(windows)), [len(one) for one in windows])
    readings = np.concatenate(windows) if len(windows) else np.zeros((0, 3))
    signed = bool((readings < 0.0).any())  # unsigned codes have their zero at an end of the range
    for axis, column in enumerate(readings.T if len(readings) else ()):
        kept = np.isfinite(column)
        finite, seam = column[kept], np.diff(window[kept]) != 0
        for end in (finite.max(), finite.min()) if len(np.unique(finite)) > 2 else ():
            if signed and abs(end) < _NEAR_ZERO * np.abs(finite).max():
                continue
            if _piles_up(finite, end) and _sticks(finite, end, seam):
                return Stuck(axis, float(end), int((finite == end).sum()))
    return None


def stuck_windows(windows: Sequence[FloatArray]) -> BoolArray:
    """Tell for each window (n_i, 3) whether it holds readings at an end of the range, one axis and end after the other."""
    spoilt = np.zeros(len(windows), dtype=bool)
    while found := stuck_in_motion([window for window, bad in zip(windows, spoilt, strict=True) if not bad]):
        spoilt |= [bool((window[:, found.axis] == found.reading).any()) for window in windows]
    return spoilt


def check_range(windows: Sequence[FloatArray], what: str) -> None:
    """Raise when a triad sticks at its largest or smallest reading, over all windows (n_i, 3) together."""
    if found := stuck_in_motion(windows):
        raise found.refusal(f"{what}: wanted {AXES[found.axis]}")


def _piles_up(finite: FloatArray, end: float) -> bool:
    """Tell whether more readings lie at an end than within one sample's change of it."""
    change = np.abs(np.diff(finite))
    away = np.abs(finite - end)
    return bool((away == 0.0).sum() > ((away > 0.0) & (away <= np.median(change[change > 0.0]))).sum())


def _sticks(finite: FloatArray, end: float, seam: BoolArray) -> bool:
    """Tell whether readings repeat at an end as no rounding to codes and no sample that is held repeats them inside.

    ``seam`` (N-1,) is True where one window ends and the next begins: no reading gets anywhere there.
    """
    change = np.where(seam, 0.0, np.abs(np.diff(finite)))
    begins = np.flatnonzero(np.concatenate(([True], (change != 0.0) | seam)))
    value, length = finite[begins], np.diff(np.append(begins, len(finite)))
    jump = change[begins[1:] - 1] > _ABRUPT * change[change > 1e-9 * np.abs(finite).max()].min()
    before, after = np.append(False, jump), np.append(jump, False)
    inside = (length >= _RUN) & (value != finite.max()) & (value != finite.min())
    stuck = (length >= _RUN) & (value == end)
    if (inside & before & after).sum() > stuck.sum():
        return False
    if len(np.unique(finite)) < _LEAST_VALUES and (finite == end).mean() > _FEW:
        return False
    coarse = inside.any() or len(np.unique(finite)) < _LEAST_VALUES
    return bool((stuck & (before | after)).any() if coarse else stuck.any())


# ---- labels, gravity, scale

SCALE_TOLERANCE = 0.25  # largest relative difference of a scale factor from the stated unit

# A gain this close to a whole factor is a unit, a range or a sample rate, not a sensor.
_FACTORS = (2.0, 4.0, 8.0, 16.0)
_REPEAT_APART = 0.5  # g; 29 deg: no repeated face leans so far
_FAR_FROM_REST = 50.0  # steps between the extreme and the median before a run counts as saturation


def face_vectors(faces: Sequence[Face]) -> FloatArray:
    """Return the direction of +g in s for each face, one unit vector a row, (P, 3)."""
    sign = np.array([1.0 if face[0] == "+" else -1.0 for face in faces]).reshape(-1, 1)
    return np.asarray(axis_vectors([face[1] for face in faces]) * sign)


def axis_vectors(axes: Sequence[str]) -> FloatArray:
    """Return the unit vector of each axis, one a row, (R, 3)."""
    return np.eye(3)[[AXES.index(axis) for axis in axes]]


def check_gravity(means: FloatArray, gravity: float, *, factor: float = 1.6) -> None:
    """Raise when the length of the specific force at rest, means (P, 3) in m/s2, cannot be gravity."""
    ratio = float(np.median(np.linalg.norm(means, axis=1))) / gravity
    if not 1.0 / factor <= ratio <= factor:
        lengths = np.linalg.norm(means, axis=1) / gravity
        named = force_words(ratio, float(lengths.std()) if len(lengths) > 1 else 0.0)
        raise Implausible(
            f"accelerometer at rest: wanted |a| near {gravity:.4g} m/s2, got {ratio * gravity:.4g} m/s2 ({ratio:.3f} g); "
            f"{f'{named}: ' if named else _likely_factor(ratio)}check the unit of the columns, the range setting, and that no "
            "other quantity is mapped as accelerometer",
            ratio=ratio,
        )


def check_faces(means: FloatArray, faces: Sequence[Face]) -> None:
    """Raise when the labels of a six-face session contradict its mean readings (P, 3)."""
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
    check_repeats(means, faces)
    present = [f for f in FACES if f in faces]
    before = _affine(means, up)[1]
    if len(present) < 5 or before < 0.2 * radius:
        _check_opposites(means, up)
        return
    # Several swaps may fit alike, all but one of them with axes exchanged: take the one whose sensors read their own axes.
    swapped = {
        (one, other): _affine(means, face_vectors([other if f == one else one if f == other else f for f in faces]))
        for one, other in itertools.combinations(present, 2)
    }
    fitting = [pair for pair, (_, misfit) in swapped.items() if misfit < 0.2 * before]
    pair = max(fitting, key=lambda one: swapped[one][0], default=None)
    what = f"faces {pair[0]} and {pair[1]} are swapped" if pair else "labels do not fit the readings"
    raise Implausible(
        f"six faces: wanted readings that follow their labels, got a misfit of {before / radius:.2f} g rms; {what}: "
        "correct the labels in session.toml",
        misfit_g=before / radius,
        swapped=pair,
    )


def _affine(means: FloatArray, up: FloatArray) -> tuple[float, float]:
    """Return how much the sensors read their own axes, and the rms misfit, of an affine fit."""
    design = np.column_stack((up, np.ones(len(up))))
    solution = np.linalg.lstsq(design, means, rcond=None)[0]
    misfit = np.sqrt(((means - design @ solution) ** 2).sum(axis=1).mean())
    return float(np.trace(solution[:3])), float(misfit)


def check_handedness(forward: FloatArray, what: str) -> None:
    """Raise when a forward matrix (3, 3) turns a right-handed frame into a left-handed one."""
    if np.linalg.det(forward) < 0.0:
        negative, moved = _reversed_and_moved(nearest_signed_permutation(forward))
        columns = f"{what} columns {' and '.join(moved)}" if moved else ""
        named = f"{columns} are exchanged" if moved else f"{what} reversed about {' and '.join(negative)}"
        raise Implausible(
            f"{what}: wanted right-handed axes, got a left-handed triad: {named}; "
            "correct the labels, or the sign or order of the columns",
            reversed=tuple(negative),
        )


def check_scale_factor(
    scale_factor: FloatArray | float, stated: float, tolerance: float, what: str, *, sample_rate_hz: float | None = None
) -> None:
    """Raise when a fitted scale factor, one or (K,), is outside the tolerance of the stated sensitivity.

    A wrong sample rate scales angles: it is given where a fit integrates turns.
    """
    ratio = np.atleast_1d(np.asarray(scale_factor, float)) / stated
    worst = float(ratio[int(np.argmax(np.abs(ratio - 1.0)))])
    if abs(worst - 1.0) > tolerance:
        raise Implausible(
            f"{what}: wanted a scale factor within {100 * tolerance:g} % of the stated sensitivity, got {worst:.4f} of it "
            f"({100 * (worst - 1.0):+.1f} %); {_likely_factor(worst, sample_rate_hz)}check the conversion from counts, "
            "the range setting and the sample rate",
            ratio=worst,
            tolerance=tolerance,
        )


def check_own_scale(
    scale_factor: FloatArray | float,
    unit: str,
    quantity: Quantity,
    tolerance: float,
    what: str,
    *,
    sample_rate_hz: float | None = None,
) -> None:
    """Raise when a fitted scale factor, reading per SI unit, is outside the tolerance of the unit's own; counts have none."""
    if is_physical(unit):
        check_scale_factor(
            scale_factor, 1.0 / si_factor(unit, quantity), tolerance, what, sample_rate_hz=sample_rate_hz
        )


_LEAST_RANGE = 100.0 * RADIAN_PER_DEGREE  # rad/s; gyroscopes of 16 bit end at 125 deg/s or beyond


def range_in_doubt(scale_factor: float, largest: float, *, stated: bool) -> Iterator[Finding]:
    """Yield the range that a scale factor, counts per rad/s, means for readings of 16 bit.

    It is a warning if no gyroscope has a range as small; otherwise a note if only stated turns determine the scale.
    """
    range_ = 2.0**15 / scale_factor
    small = range_ < _LEAST_RANGE and largest < 2.0**15
    if small or stated:
        per_dps, range_dps = scale_factor * RADIAN_PER_DEGREE, range_ / RADIAN_PER_DEGREE
        yield finding("gyro.range", "warn" if small else "info", per_dps=per_dps, range_dps=range_dps)


def stuck_at_rate(values: FloatArray) -> Stuck | None:
    """Return the axis whose readings (N, 3) at a steady rate, or at rest, stick at the end of the range."""
    for axis, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        steps = np.unique(np.abs(np.diff(np.unique(finite))))
        if not len(steps):
            continue
        for end in (finite.max(), finite.min()):
            far = abs(end - np.median(finite)) > _FAR_FROM_REST * max(steps[0], 1e-9 * abs(end))
            if far and int(np.diff(runs(finite == end)).max(initial=0)) >= _RUN:
                return Stuck(axis, float(end), int((finite == end).sum()))
    return None


def check_saturation(values: FloatArray, what: str) -> None:
    """Raise when readings (N, 3) stick at the end of the range."""
    if found := stuck_at_rate(values):
        raise found.refusal(f"{what} {AXES[found.axis]}: wanted")


def missing_faces(faces: Sequence[Face]) -> tuple[Face, ...]:
    """Return the faces that a session lacks."""
    return tuple(face for face in FACES if face not in faces)


def check_repeats(means: FloatArray, faces: Sequence[Face]) -> None:
    """Raise when a face is stated twice with readings of two."""
    radius = 0.5 * float(np.max(means.max(axis=0) - means.min(axis=0)))
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


def _check_opposites(means: FloatArray, up: FloatArray) -> None:
    # The affine fit cannot see +x and -x exchanged: the gain merely turns negative. Axes are named by the readings' columns.
    swapped: dict[str, float] = {}
    for axis, name in enumerate(AXES):
        plus, minus = means[up[:, axis] > 0.0], means[up[:, axis] < 0.0]
        if len(plus) and len(minus):
            gain = float(plus[:, axis].mean() - minus[:, axis].mean())
            span = float(np.abs(plus.mean(axis=0) - minus.mean(axis=0)).max())
            if gain < 0.0 and -gain > 0.5 * span:
                swapped[name] = gain
    if not swapped:
        return
    first, gain = next(iter(swapped.items()))
    every = "acceleration has the opposite sign, or " if len(swapped) == 3 else ""
    names = " and ".join(f"faces +{one} and -{one}" for one in swapped)
    raise Implausible(
        f"{names}: wanted the axis that points up to read the larger value, got {gain:.4g} less; "
        f"{every}the two are swapped: a face names the axis that points up, which reads +g",
        swapped=(f"+{first}", f"-{first}"),
    )


FORCE_UNITS = {  # length of the specific force in g -> what is wrong
    STANDARD_GRAVITY: "acceleration is in m/s2, not g",
    1.0 / STANDARD_GRAVITY: "acceleration is in g, not m/s2",
    1e3: "acceleration is in mg, not g",
    1e3 / STANDARD_GRAVITY: "acceleration is in mg, not m/s2",
    1e-3: "acceleration is in g, not mg",
}
RATE_UNITS = {  # readings over what they should be -> what is wrong
    RADIAN_PER_DEGREE: "gyroscope is in rad/s, not deg/s",
    1.0 / RADIAN_PER_DEGREE: "gyroscope is in deg/s, not rad/s",
    1e3: "time is in milliseconds, not seconds",
    1e6: "time is in microseconds, not seconds",
}


def force_words(median_g: float, spread_g: float) -> str:
    """Return what a specific force of another length than gravity's at rest comes from, "" where it is not known.

    Lengths that scatter by more than 0.3 of their median have gravity removed; a unit only scales both.
    """
    if median_g < 0.5 and spread_g > 0.3 * median_g:
        return "gravity is missing: an app's linear acceleration, without gravity"
    return _named(median_g, FORCE_UNITS, 1.3)


def rate_unit_words(ratio: float) -> str:
    """Return the mistaken unit that makes rates read this multiple of the true ones, "" if there is none."""
    return _named(ratio, RATE_UNITS, 1.1) if np.isfinite(ratio) else ""


def _named(ratio: float, units: Mapping[float, str], within: float) -> str:
    found = (text for size, text in units.items() if abs(np.log(max(abs(ratio), 1e-12) / size)) < np.log(within))
    return next(found, "")


def _likely_factor(ratio: float, sample_rate_hz: float | None = None) -> str:
    if named := _named(ratio, RATE_UNITS, 1.1):
        return f"{named}: "
    size = max(abs(ratio), 1.0 / max(abs(ratio), 1e-12))
    for factor in _FACTORS:
        if abs(size / factor - 1.0) < 0.06:
            text = f"readings are {factor:g} times too {'small' if abs(ratio) < 1.0 else 'large'}"
            true = (sample_rate_hz or 0.0) * abs(ratio)
            return (
                f"{text}, or the file has {true:.3g} samples a second, {sample_rate_hz:.3g} were stated: "
                if true
                else f"{text}: "
            )
    return ""
