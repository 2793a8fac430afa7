"""Check that gyroscopes and accelerometers agree on one motion: gravity is constant after the measured rotation is undone.

A window of some seconds starts at its first sample. With f the specific force over its median length::

    kept(P, s) = |mean_k R_k f_k|^2          R_k = R_(k-1) exp(s P w_k dt)         P = 1, s = 1 for columns and unit as declared

``kept`` is 1 for the right rotation, because motion that ends where it began has no mean acceleration. A wrong rotation smears
gravity and makes ``kept`` smaller. All 48 signed orders P of the axes, and scales s of rate times time, are tested in the windows
in which gravity moves most in b. An order or unit with a larger ``kept`` than the declared one names the mistake. A rotation about
the vertical does not distinguish them. Acceleration with the opposite sign has the same ``kept`` (a point reflection). Only a
reference, the axis that should point up, or the offsets of a calibration reveal the sign.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.plausibility import accel_order, cause_by_gravity, check_gravity, columns_to_mend, order_text
from undrift.errors import Implausible
from undrift.findings import Finding, finding
from undrift.frames import rotate
from undrift.io.symptoms import find_saturated
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

WINDOWS_S = (4.0, 1.0)  # long windows average motion out, but a short recording has only short windows
STEP_S = 0.02  # step over which rotations are summed (a hand turns by 20 deg at most in this time)
MOST_WINDOWS, FEWEST_WINDOWS = 60, {4.0: 4, 1.0: 2}
MIN_MOVE = 0.1  # smallest movement of gravity, in g: 6 deg from one half of a window to the other
SAMPLES = 200_000  # number of samples used from the start: 12 min at 286 Hz
# Smallest increase of ``kept`` by the better order or unit, share of g^2. A free pendulum, the worst real case, gains 0.04 with a
# scale of 0.35, because its tangential acceleration hides gravity. It gains 0.013 compared with no rotation.
CLEAR_GAIN, MIN_GAIN = 0.1, 0.015
MIN_EXPLAINED = 0.02  # smallest increase compared with no rotation (for a scale also SCALE_EXPLAINED of its gain)
SCALE_EXPLAINED = 0.6
SIGMAS = 5.0  # smallest increase relative to the scatter of the better ``kept``, over the root of the number of windows
MIN_SCATTER = 0.01
MIN_KEPT = 0.9  # smallest ``kept`` of the better order or unit
SAME = 0.01  # difference of ``kept`` below which the motion does not distinguish orders
ORDINARY = 1.25  # a smaller ratio of scales is a property of the device
# largest scale that is tested, and the scale below which the unit is wrong, not the sample rate
LARGEST_SCALE, COUNTS = 200.0, 0.12
LARGEST_OFFSET = 40.0 * RADIAN_PER_DEGREE  # smallest spread of rates in a window, rad/s
QUIET = 0.2  # smallest spread relative to the largest spread of a window
PLAUSIBLE_HZ = (4.0, 5000.0)  # range of sample rates for human motion (outside it the unit of time is tested too)
TIME_UNITS = {3: "milliseconds", 6: "microseconds", 9: "nanoseconds"}  # names of decades
UNITS = {
    RADIAN_PER_DEGREE: "gyroscope is in deg/s, not rad/s",
    1.0 / RADIAN_PER_DEGREE: "gyroscope is in rad/s, not deg/s",
}
FORCE_FACTOR = 3.0  # neither motion nor an offset can move the median of the specific force farther from gravity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Windows:
    """Windows in which gravity moves in b."""

    turn: FloatArray  # (W, M, 3), rotation vector of each step as read, rad
    force: FloatArray  # (W, M, 3), specific force over its median length
    gravity: float  # length of the specific force, m/s2

    def kept(self, order: FloatArray, scale: float) -> FloatArray:
        """Return the squared length (W,) of the mean force after the rotation is undone."""
        from undrift.kernels.rotation import strapdown  # imported here for a quick --help

        count, length, _ = self.turn.shape
        q = np.empty((count * length, 4))
        turn = np.ascontiguousarray(scale * self.turn @ order.T).reshape(-1)
        strapdown(turn, np.arange(count * length, dtype=float), np.array([1.0, 0.0, 0.0, 0.0]), q.reshape(-1))
        mean = rotate(q, self.force.reshape(-1, 3)).reshape(count, length, 3).mean(axis=1)
        return np.asarray((mean**2).sum(axis=1))


def _windows(record: Record, unit_s: float) -> _Windows | None:
    """Return the windows of an SI record, with its time in units of ``unit_s``, or None if too few move."""
    if record.gyro is None or record.accel is None:
        return None
    time, gyro, accel = (values[:SAMPLES] for values in (record.time * unit_s, record.gyro, record.accel))
    dt = float(np.median(np.diff(time)))
    for window_s in WINDOWS_S:
        step = max(1, int(STEP_S / dt))
        length = 2 * max(2, round(0.5 * window_s / (step * dt)))
        count = len(time) // (length * step)
        windowed = slice(count * length * step)
        steps = np.diff(time, append=time[-1] + dt)[windowed].reshape(count, length * step)
        shape = (count, length, step, 3)
        w, f = gyro[windowed].reshape(shape), accel[windowed].reshape(shape).mean(axis=2)
        sound = np.isfinite(w).all(axis=(1, 2, 3)) & np.isfinite(f).all(axis=(1, 2)) & (steps < 3.0 * dt).all(axis=1)
        if sound.sum() < FEWEST_WINDOWS[window_s]:
            continue
        w, f = w[sound], f[sound]
        gravity = float(np.median(np.linalg.norm(f, axis=2)))
        halves = f.reshape(len(f), 2, -1, 3).mean(axis=2) / gravity
        gravity_change = np.linalg.norm(halves[:, 1] - halves[:, 0], axis=1)
        selection = [
            int(k) for k in np.argsort(-gravity_change, kind="stable")[:MOST_WINDOWS] if gravity_change[k] > MIN_MOVE
        ]
        if len(selection) >= FEWEST_WINDOWS[window_s]:
            spread = w.std(axis=(1, 2)).max(axis=1)
            offset = w[int(np.argmin(spread))].mean(axis=(0, 1))
            if spread.min() >= QUIET * spread.max() or np.linalg.norm(offset) >= LARGEST_OFFSET:
                offset = np.zeros(3)
            return _Windows(
                turn=(w[selection] - offset).sum(axis=2) * dt, force=f[selection] / gravity, gravity=gravity
            )
    return None


# ---- checks


def check_triads(record: Record) -> tuple[Finding, ...]:
    """Return a finding about order, signs, units or time of a record's columns. Raise if the error is clear.

    Return no finding if a triad is missing or in counts, if both agree, or if the motion does not determine it.
    """
    check_force(record)
    return (*find_saturated(record), *check_agreement(record))


def check_agreement(record: Record) -> tuple[Finding, ...]:
    """Return the finding of ``find_disagreement``. Raise if the disagreement is clear."""
    conflict = find_disagreement(record)
    if conflict is not None and conflict.level == "fail":
        raise Implausible(
            f"{conflict.sentence} {conflict.action}",
            **conflict.values,
        )
    return () if conflict is None else (conflict,)


def check_force(record: Record) -> None:
    """Refuse specific forces that no motion explains: another unit, another column, or gravity removed."""
    if record.accel is None or not is_physical(record.accel_unit) or not np.isfinite(record.accel).any():
        return
    cause = ""
    if record.gyro is not None and np.isfinite(record.gyro).any():
        rate = float(np.nanmedian(np.linalg.norm(record.gyro, axis=1)))
        if any(abs(rate / size - 1.0) < 0.1 for size in (1.0, STANDARD_GRAVITY)):
            cause = "gyroscope and accelerometer columns are exchanged"
    force = record.accel * si_factor(record.accel_unit, "accel")
    check_gravity(force, STANDARD_GRAVITY, factor=FORCE_FACTOR, cause=cause)


def find_disagreement(record: Record) -> Finding | None:
    """Return a finding if other columns, units or time explain the readings better, at level fail if it is clear."""
    if not (is_physical(record.gyro_unit) and is_physical(record.accel_unit)):
        return None
    record = record.in_si()
    rate_hz, units = record.sample_rate_hz, [1.0]
    if not PLAUSIBLE_HZ[0] <= rate_hz <= PLAUSIBLE_HZ[1]:
        units = [*((10.0**decades if rate_hz > 1.0 else 10.0**-decades) for decades in TIME_UNITS), 1.0]
    return next((conflict for unit_s in units if (conflict := _disagreement(record, unit_s)) is not None), None)


def _disagreement(record: Record, unit_s: float) -> Finding | None:
    """Return the mistake that explains the readings better than none, with time in another unit."""
    windows = _windows(record, unit_s)
    if windows is None:
        return None
    # A wrong unit of time is compared with the declared time, in which windows have another length: rotation is too fast or slow.
    unchanged = windows.kept(np.eye(3), 1.0 / unit_s)
    # The length of a mean is at most the mean length, for any rotation.
    longest = np.linalg.norm(windows.force, axis=2).mean(axis=1) ** 2
    if float((longest - unchanged).mean()) < max(MIN_GAIN, SIGMAS * MIN_SCATTER / np.sqrt(len(unchanged))):
        return None
    mistakes = list(_mistakes(windows, record)) if unit_s == 1.0 else [_time_mistake(windows, unit_s)]
    mistake = max(mistakes, key=lambda mistake: float(mistake.kept.mean()), default=None)
    if mistake is None:
        return None
    gain = float((mistake.kept - unchanged).mean())
    unturned = windows.kept(np.eye(3), 0.0)
    explained = float((mistake.kept - unturned).mean())
    # the declared rotation is worse than no rotation at all
    contradicted = float((unturned - unchanged).mean()) > CLEAR_GAIN
    scatter = max(float(np.sqrt(((mistake.kept - 1.0) ** 2).mean())), MIN_SCATTER)
    least = max(MIN_EXPLAINED, SCALE_EXPLAINED * gain if mistake.sample_rate_hz else 0.0)
    significant = gain >= max(MIN_GAIN, SIGMAS * scatter / np.sqrt(len(unchanged)))
    if not significant or mistake.kept.mean() < MIN_KEPT or (explained < least and not contradicted):
        return None
    enough = contradicted or len(unchanged) >= FEWEST_WINDOWS[WINDOWS_S[0]]
    ordinary = enough and abs(windows.gravity / STANDARD_GRAVITY - 1.0) < 0.1
    share, constant = 100.0 * np.sqrt(unchanged.mean()), 100.0 * np.sqrt(mistake.kept.mean())
    return finding(
        "record.triads_disagree",
        "fail" if gain >= CLEAR_GAIN and ordinary else "warn",
        f"Gyroscope and accelerometer do not agree on one motion: {mistake.text}. "
        f"With the rotation undone, gravity is constant to {share:.1f} %, and with this correction to {constant:.1f} %.",
        mistake.action,
        sample_rate_hz=mistake.sample_rate_hz,
        turned_ratio=mistake.turned_ratio,
    )


# ---- mistakes that are tried


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mistake:
    """A mistake that makes gyroscopes and accelerometers disagree on a motion."""

    text: str  # "gyroscope is in deg/s, not rad/s"
    action: str
    kept: FloatArray  # (W,), ``kept`` with the mistake undone
    sample_rate_hz: float = 0.0  # sample rate that the recording would have, or 0 if the rate is right
    turned_ratio: float = 0.0  # ratio of declared rotation to rotation from gravity, or 0 if axes or time are wrong


def _time_mistake(windows: _Windows, unit_s: float) -> Mistake:
    name = TIME_UNITS[round(abs(math.log10(unit_s)))]
    text = f"time is in {name}, not seconds" if unit_s < 1.0 else f"time is in seconds, not {name}"
    action = "Correct the unit of time in the map or the column's name."
    return Mistake(text=text, action=action, kept=windows.kept(np.eye(3), 1.0))


def _mistakes(windows: _Windows, record: Record) -> Iterator[Mistake]:
    """Yield the best order of the axes, if it differs from the declared order, and the best scale of rate times time."""
    places, signs = itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)
    orders = [np.eye(3)[list(place)] * np.array(sign)[:, None] for place, sign in itertools.product(places, signs)]
    residuals = [windows.kept(order, 1.0) for order in orders]
    most = max(float(values.mean()) for values in residuals)
    candidates = [k for k, values in enumerate(residuals) if values.mean() > most - SAME]
    best = min(candidates, key=lambda k: _changes(orders[k].T))
    reads = orders[best].T  # forward: column i reads + for a turn about +j
    if not np.array_equal(reads, np.eye(3)):
        alternatives = (
            f", or one of {len(candidates) - 1} other orders that fit this motion equally well"
            if candidates[1:]
            else ""
        )
        text = f"{cause_by_gravity(reads)} (they read turns about the accelerometer axes {order_text(reads)}{alternatives})"
        yield Mistake(text=text, action="Correct the order or the sign of the columns.", kept=residuals[best])
    yield from _scale_mistake(windows, record)


def _changes(order: FloatArray) -> int:
    """Return the number of columns of a triad (gyroscope or accelerometer) that must be corrected."""
    accel = accel_order(order)
    return min(columns_to_mend(order), 6 if accel is None else columns_to_mend(accel))


def _scale_mistake(windows: _Windows, record: Record) -> Iterator[Mistake]:
    """Yield the gyroscope unit or sample rate that corresponds to the best scale of rate times time."""
    grid = np.geomspace(1.0 / LARGEST_SCALE, LARGEST_SCALE, 161)
    means = np.array([windows.kept(np.eye(3), float(scale)).mean() for scale in grid])
    best = int(means.argmax())
    scale, rate_hz = float(grid[best]), 0.0
    if 0 < best < len(grid) - 1:  # the vertex of the parabola through three points
        low, mid, high = means[best - 1 : best + 2]
        scale *= float((grid[1] / grid[0]) ** (0.5 * (low - high) / min(low - 2.0 * mid + high, -1e-12)))
    if max(scale, 1.0 / scale) <= ORDINARY:
        return
    for unit, text in UNITS.items():
        residuals = windows.kept(np.eye(3), unit)
        if max(scale / unit, unit / scale) < ORDINARY or residuals.mean() > means[best] - SAME:
            action = "Correct the unit of the gyroscope in the map or the columns' names."
            yield Mistake(text=text, action=action, kept=residuals, turned_ratio=1.0 / unit)
            return
    text = f"turns {1.0 / scale:.3g} times as large as measured with gravity: "
    if scale < COUNTS:  # such a large error of a sample rate is implausible
        text += f"gyroscope is in counts, not deg/s or rad/s ({1.0 / scale:.3g} counts per declared unit)"
        action = "Give the sensitivity: unit count and its scale."
    else:
        rate_hz = record.sample_rate_hz / scale
        text += f"the file has {rate_hz:.3g} samples a second, {record.sample_rate_hz:.3g} were declared, or its range is wrong"
        action = "Correct the sample rate, unit of time or sensitivity."
    residuals = windows.kept(np.eye(3), scale)
    yield Mistake(text=text, action=action, kept=residuals, sample_rate_hz=rate_hz, turned_ratio=1.0 / scale)
