"""Do gyroscopes and accelerometers tell of one motion? Gravity stands still once the rotation that the gyroscopes read is undone.

Over a window of some seconds, started at its first sample, with f the specific force over its median length::

    kept(Q, s) = |mean_k R_k f_k|^2          R_k = R_(k-1) exp(s Q w_k dt)         Q = 1, s = 1 for columns and unit as stated

Kept is 1 where the rotation is right, since motion that ends where it began has no mean acceleration, and less where gravity is
smeared. All 48 signed orders Q of the axes, and scales s of rate times time, are tried in the windows where gravity moves most in
b. What keeps more than the stated order and unit names the mistake. A rotation about the vertical shows nothing. Acceleration
with the opposite sign keeps as much as the right one (a point reflection): only a reference, the axis that should point up, or the
offsets of a calibration tell it.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.plausibility import cause_by_gravity, force_words, order_text
from undrift.errors import Implausible
from undrift.findings import Finding, finding
from undrift.frames import rotate
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

WINDOWS_S = (4.0, 1.0)  # long ones average motion out; a short recording has but short ones
STEP_S = 0.02  # rotations are summed over it; a hand turns by 20 deg in it at most
MOST_WINDOWS, FEWEST_WINDOWS = 60, {4.0: 4, 1.0: 2}
MOVED = 0.1  # of g: gravity moves by 6 deg from one half of a window to the other
LOOKED_AT = 200_000  # samples from the first on: 12 min at 286 Hz
# What is kept by the better order or unit less what the stated one keeps, share of g^2. A free pendulum, the worst real case at
# hand, loses 0.04 to a scale of 0.35: its tangential acceleration hides gravity. It gains 0.013 over no rotation at all.
CLEAR, UNCLEAR = 0.1, 0.015
EXPLAINED = 0.02  # what the better one keeps more than no rotation at all; a scale, also this share of what it gains
SCALE_EXPLAINED = 0.6
SURE = 5.0  # times the scatter of what the better one keeps, over the root of the number of windows
LEAST_SCATTER = 0.01
RIGHT = 0.9  # the better one keeps at least this share
SAME = 0.01  # orders that keep alike: the motion does not tell them apart
ORDINARY = 1.25  # a ratio of scales below it is a device's own
LARGEST_SCALE, COUNTS = 200.0, 0.12  # that is tried; below the second the unit is another, not the sample rate
LARGEST_OFFSET = 40.0 * RADIAN_PER_DEGREE  # rad/s, in a window whose spread of rates is
QUIET = 0.2  # of the largest window's
PLAUSIBLE_HZ = (4.0, 5000.0)  # of a recording that people move in; outside, the unit of time is tried too
TIME_UNITS = {3: "milliseconds", 6: "microseconds", 9: "nanoseconds"}  # by decades


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Windows:
    """Windows in which gravity moves in b."""

    turn: FloatArray  # (W, M, 3), rotation vector of each step as read, rad
    force: FloatArray  # (W, M, 3), specific force over its median length
    gravity: float  # that length, m/s2

    def kept(self, order: FloatArray, scale: float) -> FloatArray:
        """Return the squared length of the mean force with the rotation undone, (W,)."""
        from undrift.kernels.rotation import strapdown

        count, length, _ = self.turn.shape
        q = np.empty((count * length, 4))
        turn = np.ascontiguousarray(scale * self.turn @ order.T).reshape(-1)
        strapdown(turn, np.arange(count * length, dtype=float), np.array([1.0, 0.0, 0.0, 0.0]), q.reshape(-1))
        mean = rotate(q, self.force.reshape(-1, 3)).reshape(count, length, 3).mean(axis=1)
        return np.asarray((mean**2).sum(axis=1))


def _windows(record: Record, unit_s: float = 1.0) -> _Windows | None:
    """Return the windows of an SI record, with its time in units of ``unit_s``; None where too few move."""
    if record.gyro is None or record.accel is None:
        return None
    time, gyro, accel = (values[:LOOKED_AT] for values in (record.time * unit_s, record.gyro, record.accel))
    dt = float(np.median(np.diff(time)))
    for window_s in WINDOWS_S:
        step = max(1, int(STEP_S / dt))
        length = 2 * max(2, round(0.5 * window_s / (step * dt)))
        count = len(time) // (length * step)
        whole = slice(count * length * step)
        steps = np.diff(time, append=time[-1] + dt)[whole].reshape(count, length * step)
        shape = (count, length, step, 3)
        w, f = gyro[whole].reshape(shape), accel[whole].reshape(shape).mean(axis=2)
        sound = np.isfinite(w).all(axis=(1, 2, 3)) & np.isfinite(f).all(axis=(1, 2)) & (steps < 3.0 * dt).all(axis=1)
        if sound.sum() < FEWEST_WINDOWS[window_s]:
            continue
        w, f = w[sound], f[sound]
        gravity = float(np.median(np.linalg.norm(f, axis=2)))
        halves = f.reshape(len(f), 2, -1, 3).mean(axis=2) / gravity
        moved = np.linalg.norm(halves[:, 1] - halves[:, 0], axis=1)
        chosen = [int(k) for k in np.argsort(-moved, kind="stable")[:MOST_WINDOWS] if moved[k] > MOVED]
        if len(chosen) >= FEWEST_WINDOWS[window_s]:
            spread = w.std(axis=(1, 2)).max(axis=1)
            rest = w[int(np.argmin(spread))].mean(axis=(0, 1))
            offset = (
                rest if spread.min() < QUIET * spread.max() and np.linalg.norm(rest) < LARGEST_OFFSET else np.zeros(3)
            )
            return _Windows(turn=(w[chosen] - offset).sum(axis=2) * dt, force=f[chosen] / gravity, gravity=gravity)
    return None


# ---- what may be wrong: a text, an action, and what the option of a command would be


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """What would make gyroscopes and accelerometers tell of one motion."""

    text: str  # "gyroscope is in deg/s, not rad/s"
    action: str
    sample_rate_hz: float = 0.0  # that the recording would have; 0 where that is not the matter
    turned_ratio: float = 0.0  # rotation as stated over rotation by gravity; 0 if axes or time are wrong
    kept: float = 0.0  # share of gravity that stands still with it
    stated: float = 0.0  # and as stated


def check_triads(record: Record) -> tuple[Finding, ...]:
    """Return what speaks against the order, signs, units or time of a record's columns; raise where it is clear.

    Nothing is looked at where a triad is missing or in counts; none where they agree, or where the motion does not show it.
    """
    from undrift.io.inspect import find_saturated

    check_force(record)
    return (*find_saturated(record), *check_agreement(record))


def check_agreement(record: Record) -> tuple[Finding, ...]:
    """Return the finding of ``find_disagreement``; raise if it is clear."""
    conflict = find_disagreement(record)
    if conflict is not None and conflict.level == "fail":
        raise Implausible(
            f"gyroscope and accelerometer: wanted columns, units and time that agree on one motion, got: {conflict.values['text']} "
            f"({conflict.detail}); {conflict.action}",
            **conflict.values,
        )
    return () if conflict is None else (conflict,)


FORCE_WITHIN = (1.0 / 3.0, 3.0)  # g: no motion keeps the median outside, nor an offset


def check_force(record: Record) -> None:
    """Refuse specific forces that no motion explains: another unit, another column, or gravity removed."""
    if record.accel is None or not is_physical(record.accel_unit):
        return
    sizes = {
        name: float(np.nanmedian(np.linalg.norm(values, axis=1)))
        for name, values in (("accel", record.accel), ("gyro", record.gyro))
        if values is not None and np.isfinite(values).all(axis=1).any()
    }
    median = sizes.get("accel", STANDARD_GRAVITY) * si_factor(record.accel_unit, "accel") / STANDARD_GRAVITY
    if FORCE_WITHIN[0] <= median <= FORCE_WITHIN[1]:
        return
    spread = float(np.nanstd(np.linalg.norm(record.accel, axis=1))) / sizes["accel"] * median
    named = (
        force_words(median, spread) or "acceleration is in another unit, or another column is mapped as accelerometer"
    )
    if any(abs(sizes.get("gyro", 0.0) / size - 1.0) < 0.1 for size in (1.0, STANDARD_GRAVITY)):
        named = "gyroscope and accelerometer columns are exchanged"
    raise Implausible(
        f"accelerometer: wanted a specific force of about 1 g, got a median of {median:.3g} g: {named}; correct the columns or "
        "state their true unit in a map (units = { accel = ... }, `column_map` FILE), or in the columns' names",
        mistake=named,
        median_g=median,
    )


def find_disagreement(record: Record) -> Finding | None:
    """Return what explains a record's readings better than its columns, units and time as stated: fail where it is clear."""
    if not (is_physical(record.gyro_unit) and is_physical(record.accel_unit)):
        return None
    record = record.in_si()
    found = next((one for unit_s in _time_units(record) if (one := _mistake(record, unit_s)) is not None), None)
    if found is None:
        return None
    mistake, clear = found
    values = {name: getattr(mistake, name) for name in ("text", "action", "sample_rate_hz", "turned_ratio")}
    shares = {"kept_percent": 100.0 * mistake.kept, "stated_percent": 100.0 * mistake.stated}
    return finding("record.triads_disagree", "fail" if clear else "warn", **values, **shares)


def _time_units(record: Record) -> Iterator[float]:
    """Yield the units of time to try, s: where the sample rate is none that people move in, others before the second."""
    if record.gyro is not None and record.accel is not None:
        if record.sample_rate_hz < PLAUSIBLE_HZ[0]:
            yield from (10.0**-decades for decades in TIME_UNITS)
        if record.sample_rate_hz > PLAUSIBLE_HZ[1]:
            yield from (10.0**decades for decades in TIME_UNITS)
    yield 1.0


def _mistake(record: Record, unit_s: float) -> tuple[Mistake, bool] | None:
    """Return the mistake that explains the readings better than none, and whether that is clear."""
    seen = _windows(record, unit_s)
    if seen is None:
        return None
    # A wrong unit of time is judged against time as stated, in which no window lasts as long: rotation is too fast or slow.
    stated = seen.kept(np.eye(3), 1.0 / unit_s)
    # A mean is no longer than its parts, whatever the rotation.
    longest = np.linalg.norm(seen.force, axis=2).mean(axis=1) ** 2
    if float((longest - stated).mean()) < max(UNCLEAR, SURE * LEAST_SCATTER / np.sqrt(len(stated))):
        return None
    best = max(_candidates(seen, record, unit_s, stated), key=lambda one: float(one[1].mean()), default=None)
    if best is None:
        return None
    mistake, explained = best
    gain, over_none = float((explained - stated).mean()), float((explained - seen.kept(np.eye(3), 0.0)).mean())
    scatter = max(float(np.sqrt(((explained - 1.0) ** 2).mean())), LEAST_SCATTER)
    least = max(EXPLAINED, SCALE_EXPLAINED * gain if mistake.sample_rate_hz else 0.0)
    if gain < max(UNCLEAR, SURE * scatter / np.sqrt(len(explained))) or explained.mean() < RIGHT or over_none < least:
        return None
    ordinary = abs(seen.gravity / STANDARD_GRAVITY - 1.0) < 0.1 and len(explained) >= FEWEST_WINDOWS[WINDOWS_S[0]]
    made = replace(mistake, kept=float(np.sqrt(explained.mean())), stated=float(np.sqrt(stated.mean())))
    return made, bool(gain >= CLEAR and ordinary)


def _candidates(
    seen: _Windows, record: Record, unit_s: float, stated: FloatArray
) -> Iterator[tuple[Mistake, FloatArray]]:
    """Yield mistakes with what each keeps."""
    if unit_s != 1.0:
        name = TIME_UNITS[round(abs(math.log10(unit_s)))]
        text = f"time is in {name}, not seconds" if unit_s < 1.0 else f"time is in seconds, not {name}"
        yield (
            Mistake(text=text, action="correct the unit of time in the map or the column's name"),
            seen.kept(np.eye(3), 1.0),
        )
        return
    orders = [(order, seen.kept(order, 1.0)) for order in _orders()]
    most = max(float(explained.mean()) for _, explained in orders)
    alike = [(order, explained) for order, explained in orders if explained.mean() > most - SAME]
    order, explained = min(alike, key=lambda one: _changes(one[0]))
    if not np.array_equal(order, np.eye(3)):
        reads = order.T  # forward: column i reads + for a turn about +j
        others = (
            f", or one of {len(alike) - 1} other orders that this motion does not tell apart" if len(alike) > 1 else ""
        )
        text = (
            f"{cause_by_gravity(reads)} (they read turns about {order_text(reads)} of the accelerometer axes{others})"
        )
        yield Mistake(text=text, action="correct the order or the sign of the columns"), explained
    yield from _scales(seen, record)


def _orders() -> Iterator[FloatArray]:
    """Yield the 48 matrices that exchange and reverse axes."""
    for places, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        yield np.eye(3)[list(places)] * np.array(signs)[:, None]


def _changes(order: FloatArray) -> int:
    """Return how many columns of one triad, the gyroscope's or the accelerometer's, would have to be mended."""
    return min(
        6 - int(2 * np.trace(one > 0.5)) - int((np.diag(one) < -0.5).sum())
        for one in (order, np.linalg.det(order) * order)
    )


def _scales(seen: _Windows, record: Record) -> Iterator[tuple[Mistake, FloatArray]]:
    """Yield units of the gyroscope and other sample rates."""
    grid = np.geomspace(1.0 / LARGEST_SCALE, LARGEST_SCALE, 161)
    means = np.array([seen.kept(np.eye(3), float(scale)).mean() for scale in grid])
    at = int(means.argmax())
    scale = float(grid[at])
    if 0 < at < len(grid) - 1:  # the vertex of the parabola through three points
        low, mid, high = means[at - 1 : at + 2]
        scale *= float((grid[1] / grid[0]) ** (0.5 * (low - high) / min(low - 2.0 * mid + high, -1e-12)))
    for unit, text in (
        (RADIAN_PER_DEGREE, "gyroscope is in deg/s, not rad/s"),
        (1.0 / RADIAN_PER_DEGREE, "gyroscope is in rad/s, not deg/s"),
    ):
        if max(scale / unit, unit / scale) < ORDINARY:
            action = "correct the unit of the gyroscope in the map or the columns' names"
            yield Mistake(text=text, action=action, turned_ratio=1.0 / unit), seen.kept(np.eye(3), unit)
            return
    if max(scale, 1.0 / scale) > ORDINARY:
        rate = record.sample_rate_hz / scale
        text = f"turns {1.0 / scale:.3g} times as large as gravity shows: "
        if scale < COUNTS:  # No person mistakes a sample rate by as much
            text += f"gyroscope is in counts, not deg/s or rad/s ({1.0 / scale:.3g} counts for one of the unit stated)"
            yield (
                Mistake(text=text, action="state the sensitivity: unit count and its scale", turned_ratio=1.0 / scale),
                seen.kept(np.eye(3), scale),
            )
            return
        text += (
            f"the file has {rate:.3g} samples a second, {record.sample_rate_hz:.3g} were declared, or the gyroscope's range is "
            "another"
        )
        action = "state the true sample rate, unit of time or sensitivity"
        found = Mistake(text=text, action=action, sample_rate_hz=rate, turned_ratio=1.0 / scale)
        yield found, seen.kept(np.eye(3), scale)
