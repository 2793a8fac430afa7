"""Plausibility: checks for results that this device cannot have. Each message gives the value and a remedy.

A fit calls these checks on its data and on its result. Every check returns None or raises.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import Implausible
from undrift.findings import Finding, Level, above, finding, told_apart
from undrift.fit.priors import SCALE_LIMIT
from undrift.io.symptoms import STUCK, saturated_runs
from undrift.model import AXES
from undrift.record import FACES, Face, Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

# ---- axis order: check that the columns have the order and sense of the given axes
#
# There are 48 matrices with one +1 or -1 in every row and column. The matrix nearest to a forward matrix K with unit rows gives
# the axis that each column reads:
#
#     P = argmax sum_ij P_ij K_ij / |K_i|        P_ij = +1: column i reads + for axis +j
#
# Any P other than the identity means an exchange of columns, a wrong sign, or axis labels that do not belong to the data. A
# left-handed triad is only half of the cases: an even exchange remains right-handed.


def nearest_signed_permutation(forward: FloatArray) -> FloatArray:
    """Return the signed permutation (3, 3) nearest to a forward matrix (3, 3)."""
    gain = forward / np.linalg.norm(forward, axis=1)[:, None]
    rows, orders = np.arange(3), [list(order) for order in itertools.permutations(range(3))]
    order = max(orders, key=lambda p: float(np.abs(gain[rows, p]).sum()))
    nearest = np.zeros((3, 3))
    nearest[rows, order] = np.where(gain[rows, order] >= 0.0, 1.0, -1.0)
    return nearest


def check_axis_order(forward: FloatArray, what: str, *, against: Literal["accelerometer", "turns"]) -> None:
    """Raise unless each gyroscope column reads + for a turn about its own axis, for a forward matrix (3, 3)."""
    order = nearest_signed_permutation(forward)
    if not np.array_equal(order, np.eye(3)):
        turns = against == "turns"
        cause = (
            f"{columns_text(order)}, or the axes or signs of the turns are wrong" if turns else cause_by_gravity(order)
        )
        raise Implausible(
            f"{what}: the gyroscope columns x, y, z read turns about the "
            f"{'given' if turns else 'accelerometer'} axes {order_text(order)}: {cause}. "
            f"Correct the order or the sign of the columns{' or of the turns' if turns else ''}.",
            order=order_text(order),
        )


def order_text(order: FloatArray) -> str:
    """Return a signed permutation as text: "+y, +x, +z"."""
    axis = np.abs(order).argmax(axis=1)
    return ", ".join(f"{'+' if order[i, j] > 0.0 else '-'}{AXES[j]}" for i, j in enumerate(axis))


def columns_text(order: FloatArray) -> str:
    """Describe the exchange or reversal of columns that explains an order of the axes."""
    negative = [AXES[i] for i in range(3) if order[i].min() < 0.0]
    exchanged = [AXES[i] for i in range(3) if order[i, i] == 0.0]
    if not exchanged:
        return f"column{'s' if len(negative) > 1 else ''} {_join_names(negative)} {'are' if len(negative) > 1 else 'is'} reversed"
    ring = " in a ring" if len(exchanged) == 3 else ""
    return f"columns {_join_names(exchanged)} are exchanged{ring}{f', and {_join_names(negative)} reversed' if negative else ''}"


def _join_names(names: Sequence[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1]) if len(names) > 1 else names)


def columns_to_mend(order: FloatArray) -> int:
    """Return how many columns of a triad must be corrected: 1 for a reversed column, 2 for a moved column."""
    return 6 - int(2 * np.trace(order > 0.5)) - int((np.diag(order) < -0.5).sum())


def accel_order(order: FloatArray) -> FloatArray | None:
    """Return the accelerometer columns A that gravity reveals as gyroscope columns P, or None if there are none.

    A turn is a pseudovector, so exchanged or reversed accelerometer columns A appear as P = det(A) A^T.
    """
    return min(order.T, -order.T, key=columns_to_mend) if np.linalg.det(order) > 0.0 else None


def cause_by_gravity(order: FloatArray) -> str:
    """Describe the exchange or reversal of columns, of either triad, that explains an order of the axes."""
    if np.array_equal(order, -np.eye(3)):
        return "all gyroscope columns are reversed, or the same two columns of both triads are exchanged"
    causes = [(columns_to_mend(order), f"gyroscope {columns_text(order)}")]
    if (accel := accel_order(order)) is not None:
        causes.append((columns_to_mend(accel), f"accelerometer {columns_text(accel)}"))
    return ", or ".join(cause for _, cause in sorted(causes, key=lambda pair: pair[0]))


# ---- readings at the end of the range

MANY_VALUES = 20  # smallest number of different readings (fewer are a constant or steps, without a clear maximum)
NEAR_ZERO = 0.1  # relative to the largest reading: a level nearer to zero is a rest after motion to one side


def end_readings(column: FloatArray) -> list[float]:
    """Return the readings at which a column (N,) is stuck because it reaches the end of its range."""
    if all(np.count_nonzero(column == end.reduce(column)) < STUCK for end in (np.fmin, np.fmax)):
        return []
    limits, finite = [limit for limit, _ in saturated_runs(column)], column[np.isfinite(column)]
    ends = (float(finite.min()), float(finite.max())) if len(finite) else ()
    for end in ends:  # most readings at one end, which ``saturated_runs`` considers the usual level
        most = abs(end) > NEAR_ZERO * max(map(abs, ends)) and 2 * int((finite == end).sum()) > len(column)
        if most and len(np.unique(finite)) > MANY_VALUES:
            limits.append(end)
    return limits


def stuck_windows(windows: Sequence[FloatArray]) -> BoolArray:
    """Return True for each window (n_i, 3) that has saturated readings. All windows are judged together."""
    saturated = np.zeros(len(windows), dtype=bool)
    for axis, column in enumerate(np.concatenate(windows).T if len(windows) else ()):
        limits = end_readings(column)
        saturated |= [bool(np.isin(window[:, axis], limits).any()) for window in windows]
    return saturated


def check_range(windows: Sequence[FloatArray], what: str) -> None:
    """Raise Implausible if an axis is saturated. All windows (n_i, 3) are judged together."""
    for axis, column in enumerate(np.concatenate(windows).T if len(windows) else ()):
        for limit in end_readings(column):
            samples = int((column == limit).sum())
            raise Implausible(
                f"{what}: {samples} samples of {AXES[axis]} are stuck at {limit:g}, the end of the range. Choose a wider range or "
                "move more slowly.",
                samples=samples,
                extreme=limit,
            )


def saturated(what: str, count: int, of: int, pieces: tuple[str, ...]) -> Finding:
    """Return a finding about samples, moves or turns that were left out because a reading is stuck at the end of its range."""
    names = ", ".join(pieces[:5]) + (f" and {len(pieces) - 5} more" if len(pieces) > 5 else "")
    return finding(
        "session.saturated",
        "warn",
        f"{count} of {of} {what} are saturated and were left out: {names}.",
        "Choose a wider range or move more slowly, and record them again.",
        what=what,
        count=count,
        of=of,
        pieces=pieces,
    )


def without_saturated(record: Record) -> tuple[Record, tuple[Finding, ...]]:
    """Return the record with gaps instead of readings at the end of the range, and a finding for each triad."""
    findings, changed = list[Finding](), dict[str, Any]()
    for channel in ("gyro", "accel"):
        readings = getattr(record, channel)
        if readings is None:
            continue
        ends = [np.isin(column, [limit for limit, _ in saturated_runs(column)]) for column in readings.T]
        stuck = np.column_stack(ends)
        if stuck.any():
            axes = tuple(f"{channel} {axis}" for axis, rows in zip(AXES, ends, strict=True) if rows.any())
            count = int(stuck.any(axis=1).sum())
            findings.append(saturated("samples", count, len(record), axes))
            changed[channel] = np.where(stuck, np.nan, readings)
    return replace(record, **changed), tuple(findings)


# ---- labels, gravity, scale

SCALE_TOLERANCE = 0.25  # largest relative difference of a scale factor from its nominal value
CHECK_GYRO_SCALE = (
    "Compare it with the range set on the device. Give turn rates in deg/s, not rad/s, and angles in deg, not rad."
)
MIN_RANGE_DPS = 100.0  # the range of 16-bit gyroscopes is 125 deg/s or more
FORCE_UNITS = {  # length of the specific force in g -> cause
    STANDARD_GRAVITY: "acceleration is in m/s2, not g",
    1.0 / STANDARD_GRAVITY: "acceleration is in g, not m/s2",
    1e3: "acceleration is in mg, not g",
    1e3 / STANDARD_GRAVITY: "acceleration is in mg, not m/s2",
    1e-3: "acceleration is in g, not mg",
}
RATE_UNITS = {  # ratio of readings to their true value -> cause
    RADIAN_PER_DEGREE: "gyroscope is in rad/s, not deg/s",
    1.0 / RADIAN_PER_DEGREE: "gyroscope is in deg/s, not rad/s",
    1e3: "time is in milliseconds, not seconds",
    1e6: "time is in microseconds, not seconds",
}


def face_vectors(faces: Sequence[Face]) -> FloatArray:
    """Return the direction of +g in s for each face, one unit vector per row, (P, 3)."""
    sign = np.array([1.0 if face[0] == "+" else -1.0 for face in faces]).reshape(-1, 1)
    return np.asarray(axis_vectors([face[1] for face in faces]) * sign)


def axis_vectors(axes: Sequence[str]) -> FloatArray:
    """Return the unit vector of each axis, one per row, (R, 3)."""
    return np.eye(3)[[AXES.index(axis) for axis in axes]]


def missing_faces(faces: Sequence[Face]) -> tuple[Face, ...]:
    """Return the faces that a session lacks."""
    return tuple(face for face in FACES if face not in faces)


def check_faces(means: FloatArray, faces: Sequence[Face]) -> None:
    """Raise if the labels of five faces or more contradict the face that each mean reading (P, 3) points to.

    A reading points to the face of its largest component, relative to the middle between the extremes of each axis.
    """
    deviation = means - 0.5 * (means.max(axis=0) + means.min(axis=0))
    axes = np.abs(deviation).argmax(axis=1)
    read = [FACES[2 * axis + int(row[axis] < 0.0)] for axis, row in zip(axes, deviation, strict=True)]
    if read == list(faces):
        return
    pairs = dict.fromkeys(zip(faces, read, strict=True))  # label and face, each combination once
    labels, measured_faces = [label for label, _ in pairs], [face for _, face in pairs]
    wrong = [label for label in FACES if any(label == wanted and wanted != face for wanted, face in pairs)]
    # columns that would give these readings if all labels were right
    order = face_vectors(measured_faces).T @ face_vectors(labels)
    nearest = nearest_signed_permutation(order) if np.abs(order).sum(axis=1).all() else np.zeros((3, 3))
    if twice := [label for label in FACES if labels.count(label) > 1]:
        missing = missing_faces(faces)
        cause = f"face {twice[0]} is labelled twice{f', and {_join_names(missing)} is missing' if missing else ''}"
    elif repeated := [label for label, face in pairs if measured_faces.count(face) > 1]:
        cause = f"faces {_join_names(repeated[:2])} have the same readings, so the same face was recorded twice"
    elif np.array_equal(order != 0.0, nearest != 0.0) and np.abs(order).sum() == len(pairs):
        reversed_ = [f"+{AXES[j]} and -{AXES[j]}" for j in range(3) if nearest[j, j] < 0.0]
        cause = (
            "acceleration has the opposite sign" if len(reversed_) == 3 else f"accelerometer {columns_text(nearest)}"
        )
        cause += f", or faces {' and '.join(reversed_)} are swapped" if reversed_ else ""
    else:
        cause = f"faces {_join_names(wrong)} are swapped" if len(wrong) == 2 else "the labels do not fit the readings"
    raise Implausible(
        f"six faces: the poses labelled {', '.join(faces)} read {', '.join(read)} up: {cause}. Correct the labels in session.toml, "
        "or the order or sign of the columns.",
        wrong=tuple(wrong),
    )


def check_gravity(force: FloatArray, gravity: float, *, factor: float = 1.6, cause: str = "") -> None:
    """Raise if the median length of specific forces (P, 3), m/s2, cannot be gravity. ``cause`` replaces the cause in messages."""
    lengths = np.linalg.norm(force, axis=1) / gravity
    ratio = float(np.nanmedian(lengths))
    if not 1.0 / factor <= ratio <= factor:
        raise Implausible(
            f"accelerometer: expected gravity, {gravity:.4g} m/s2, got {ratio * gravity:.4g} m/s2 ({ratio:.3f} g): "
            f"{cause or force_words(ratio, float(np.nanstd(lengths))) or _times(ratio)}. Check the range setting, and correct the "
            "columns or their unit in the file for `column_map` (units = { accel = ... }).",
            ratio=ratio,
        )


def check_own_scale(
    scale_factor: FloatArray | float,
    unit: str,
    quantity: Quantity,
    what: str,
    *,
    sample_rate_hz: float | None = None,
) -> None:
    """Raise if a scale factor, reading per SI unit, scalar or (K,), is beyond ``SCALE_TOLERANCE`` of its nominal value.

    Counts have no nominal value. A wrong sample rate scales angles, so fits that integrate turns pass the sample rate.
    """
    if not is_physical(unit):
        return
    ratio = np.atleast_1d(np.asarray(scale_factor, float)) * si_factor(unit, quantity)
    worst = float(ratio[int(np.argmax(np.abs(ratio - 1.0)))])
    if abs(worst - 1.0) > SCALE_TOLERANCE:
        cause = _name_unit(worst, RATE_UNITS, 1.1) or _times(worst)
        if sample_rate_hz:
            cause += (
                f", or the file has {sample_rate_hz * abs(worst):.3g} samples a second instead of {sample_rate_hz:.3g}"
            )
        raise Implausible(
            f"{what}: expected a scale factor within {100 * SCALE_TOLERANCE:g} % of its nominal value, got {worst:.4f} of it "
            f"({100 * (worst - 1.0):+.1f} %): {cause}. Check the unit, the range setting and the sample rate.",
            ratio=worst,
        )


def check_gyro_scale(scale_factor: FloatArray, unit: str, largest: float, *, rates_given: bool) -> Iterator[Finding]:
    """Compare the scale factors (3,) of gyroscopes, reading per rad/s, with their unit.

    Counts, with the largest reading given, have no nominal scale. If only the given turns determine the scale, a finding gives the
    range in deg/s that this scale implies for 16 bits.
    """
    if is_physical(unit):
        ratio = scale_factor * si_factor(unit, "rate") - 1.0
        axis = int(np.abs(ratio).argmax())
        percent = 100.0 * float(ratio[axis])
        limit_percent = 100.0 * SCALE_LIMIT
        size = told_apart(percent, "+.1f", limit_percent)
        sentence = f"Gyroscope {AXES[axis]} is {size} % off its nominal scale factor (limit {limit_percent:g} %)."
        limits = (SCALE_LIMIT, 2.0 * SCALE_LIMIT)
        yield from above("gyro.scale_factor", abs(ratio[axis]), limits, sentence, CHECK_GYRO_SCALE, off_percent=percent)
    elif rates_given:
        per_dps = float(np.median(scale_factor)) * RADIAN_PER_DEGREE
        range_dps = 2.0**15 / per_dps
        sentence = (
            "The gyroscope scale depends on the given turns only, so a wrong angle, rate or sample rate changes it. "
            f"With {per_dps:.4g} counts per deg/s, readings of 16 bit end at {range_dps:.4g} deg/s."
        )
        level: Level = "warn" if range_dps < MIN_RANGE_DPS and largest < 2.0**15 else "info"
        yield finding("gyro.scale_factor", level, sentence, CHECK_GYRO_SCALE)


def force_words(median_g: float, spread_g: float) -> str:
    """Return the reason why a specific force at rest does not have the length of gravity, or "" if it is unknown.

    A scatter of more than 0.3 of the median indicates that gravity was removed, because a wrong unit scales scatter and median
    alike.
    """
    if median_g < 0.5 and spread_g > 0.3 * median_g:
        return "gravity is missing: an app's linear acceleration, without gravity"
    return _name_unit(median_g, FORCE_UNITS, 1.3)


def _name_unit(ratio: float, units: Mapping[float, str], within: float) -> str:
    size = max(abs(ratio), 1e-12)
    return next((text for unit, text in units.items() if abs(np.log(size / unit)) < np.log(within)), "")


def _times(ratio: float) -> str:
    size = abs(ratio)
    return f"readings are {max(size, 1.0 / max(size, 1e-12)):.2g} times too {'small' if size < 1.0 else 'large'}"
