"""Synchronise a record with a reference on a common clock, before any fit or comparison.

``native_poses`` undoes a linear up-sampling of the reference. ``pose_rates`` turns poses into mean rates. ``find_lag`` determines
the lag of the record's samples, and ``in_step`` checks whether it is constant. ``find_motion`` finds the end of the first rest and
the start of the last. With w the body rate of the reference and u the readings, both averaged over the same stretches::

    w(t) = A u(t + lag) + c                    free A (3 x 3) and c, so that scale, mounting and offset do not affect the lag

First their covariance is computed at every lag of a wide search. Gauss-Newton then fits A, c and lag together, with the change of u
over time as another column of the design. A reading is the rate at its time stamp. If a sample applies to the interval before it,
as in strapdown, the lag is half a sample shorter.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs, window_sums
from undrift.errors import AlignmentError, InputError
from undrift.findings import Finding, finding
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotation_vector
from undrift.record import Record, Reference
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE

# ---- mean rates between neighbouring poses, and readings averaged over the same stretches
#
#     w_k = log(q_k^-1 q_(k+1)) / (t_(k+1) - t_k)          the rotation vector of their quotient over the time between them
#
# Averages of readings come from the running integral of the straight lines between samples.

LONGEST_STEP = 1.5  # longest step, in medians of the pose interval (a longer step is a gap)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseRates:
    """Mean body rates between neighbouring poses."""

    start: FloatArray  # (K,), time of the first pose, s
    stop: FloatArray  # (K,), time of the second pose, s
    rate: FloatArray  # (K, 3), mean rate, rad/s, frame of the body, with zeros for invalid rows
    valid: BoolArray  # (K,), False if a pose is missing or the step is a gap

    def part(self, rows: IntArray | BoolArray) -> "PoseRates":
        """Return selected rates."""
        return PoseRates(start=self.start[rows], stop=self.stop[rows], rate=self.rate[rows], valid=self.valid[rows])


def pose_rates(reference: Reference) -> PoseRates:
    """Return the mean rate of the body between neighbouring poses."""
    step = np.diff(reference.time)
    turn = rotation_vector(quaternion_product(quaternion_conjugate(reference.q_nb[:-1]), reference.q_nb[1:]))
    valid = np.isfinite(turn[:, 0]) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid[:, None], turn / step[:, None], 0.0)
    return PoseRates(start=reference.time[:-1], stop=reference.time[1:], rate=rate, valid=valid)


class RunningIntegral:
    """Integral of readings from the first sample, for averages over any stretch."""

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
        step = np.diff(time)
        gap_before = step > LONGEST_STEP * np.median(step)
        self.time, self._values = time, np.where(gap[:, None], 0.0, values)
        self._gaps: IntArray = np.append(0, np.cumsum(gap[1:] | gap[:-1] | gap_before))
        area = 0.5 * (self._values[1:] + self._values[:-1]) * step[:, None]
        self._area = np.cumsum(np.concatenate((0.0 * area[:1], area)), axis=0)

    def mean(self, start: FloatArray, stop: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the mean reading (K, C) of each stretch, and True for stretches without a gap (K,)."""
        (first, first_area), (last, last_area) = self._integral_at(start), self._integral_at(stop)
        valid = (start >= self.time[0]) & (stop <= self.time[-1])
        valid &= self._gaps[np.minimum(last + 1, len(self.time) - 1)] == self._gaps[first]
        return np.where(valid[:, None], (last_area - first_area) / (stop - start)[:, None], 0.0), valid

    def _integral_at(self, t: FloatArray) -> tuple[IntArray, FloatArray]:
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        dt, value = (t - self.time[k])[:, None], self._values[k]
        slope = (self._values[k + 1] - value) / (self.time[k + 1] - self.time[k])[:, None]
        return k, self._area[k] + value * dt + 0.5 * slope * dt**2


# ---- coarse lag: lag with the largest correlation of readings and rates, over a wide search
#
# Both are averaged into cells of equal width on a common clock. At every shift the score is the multiple correlation of rates w
# and readings u over common cells, tr(C' V^-1 C) / tr(W), with the covariances C of u and w, V of u, W of w. It is equal for
# all mountings. All sums over cells, with masks for gaps, are correlations. A Fourier transform computes them for all shifts.

CELL_S = 0.02  # s
LEAST_OVERLAP, LEAST_CELLS = 0.3, 10.0  # smallest overlap: share of the shorter side, and number of cells
STILL = 1e-9  # variance below which a side does not turn, relative to the largest variance


def coarse_lag(time: FloatArray, gyro: FloatArray, rates: PoseRates, longest_lag_s: float) -> float:
    """Return the lag, s, with the largest correlation between readings and rates. More overlap decides between equal lags."""
    from scipy.signal import fftconvolve

    middle = 0.5 * (rates.start + rates.stop)
    width = CELL_S * max(1, *(round(float(np.median(np.diff(t))) / CELL_S) for t in (time, middle)))
    start = min(time[0], middle[0])
    count = int((max(time[-1], middle[-1]) - start) / width) + 1
    reach = min(int(longest_lag_s / width) + 1, count - 1)
    (u, m), (w, n) = (
        _cell_means(np.floor((t[valid] - start) / width).astype(np.int64), values[valid], count)
        for t, values, valid in ((time, gyro, np.isfinite(gyro).all(axis=1)), (middle, rates.rate, rates.valid))
    )

    def summed(first: FloatArray, second: FloatArray) -> FloatArray:
        """Return sums over cells, (shifts, ...), with cell k + s of the record at cell k of the reference."""
        return np.asarray(fftconvolve(first, second[::-1], axes=0)[count - 1 - reach : count + reach])

    overlap = np.round(summed(m, n))[:, 0]
    enough = overlap >= max(LEAST_OVERLAP * min(m.sum(), n.sum()), LEAST_CELLS)
    if not enough.any():
        raise AlignmentError(
            f"lag: record and reference share less than {LEAST_OVERLAP:.0%} of the shorter one. They begin at {time[0]:.6g} and "
            f"{rates.start[0]:.6g} s: check their clocks, or widen `longest_lag_s`, {longest_lag_s:g} s."
        )
    cells = np.maximum(overlap, 1.0)[:, None]
    mean_u, mean_w = summed(u, n) / cells, summed(m, w) / cells  # (shifts, C)
    v = summed(u[:, :, None] * u[:, None], n[:, :, None]) / cells[:, :, None] - mean_u[:, :, None] * mean_u[:, None]
    c = summed(u[:, :, None], w[:, None]) / cells[:, :, None] - mean_u[:, :, None] * mean_w[:, None]
    turn_u = np.trace(v, axis1=1, axis2=2)
    turn_w = (summed(m, w**2) / cells - mean_w**2).sum(axis=1)
    turns = enough & (turn_u > STILL * turn_u.max()) & (turn_w > STILL * turn_w.max())
    if not turns.any():
        raise AlignmentError(
            "lag: record and reference must both turn, but one of them does not. Choose a stretch with motion."
        )
    ridge = STILL * turn_u.max() * np.eye(v.shape[1])
    explained = (c * np.linalg.solve(v + ridge, c)).sum(axis=(1, 2)) / np.where(turns, turn_w, np.inf)
    return float((int(np.argmax(explained * overlap)) - reach) * width)


def _cell_means(cell: IntArray, values: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the cell means minus their mean, (cells, C), zero in empty cells, and a mask of the other cells, (cells, 1)."""
    weight = np.bincount(cell, minlength=count)[:, None]
    mask = (weight > 0).astype(float)
    sums = np.column_stack([np.bincount(cell, weights=column, minlength=count) for column in values.T])
    means = sums / np.maximum(weight, 1)
    return means - means.sum(axis=0) / max(mask.sum(), 1.0) * mask, mask


# ---- original poses of the instrument: undo a linear up-sampling of the reference
#
# Many files contain poses at the sensor's sample rate, on straight lines (great arcs) between the frames of the cameras. Between
# frames, such a pose is off by a h^2 / 8 for an angular acceleration a and a frame interval h, always towards less motion. At 2
# Hz and 120 frames/s that is 0.1 % of the amplitude, which would look like a scale factor.
#
# On a straight line the rate between neighbours repeats to the last digit, and changes at the frames. The middles of the repeats
# form a comb of the frame rate. The largest Fourier sum gives its frequency and phase, and each frame is the end of a line.

LEAST_REPEATS = 0.02  # share of neighbouring rates that repeat before up-sampling is suspected
COMB_SHARPNESS = 0.95  # smallest Fourier sum, relative to a perfect comb
SAME_RATE = 1e-4  # relative to the median change of rate: closer rates are equal
NEAR_FRAME_S = 2e-5  # a sample this close to a frame may be on either side of it


def native_poses(reference: Reference) -> Reference:
    """Return the frames of the instrument, if the reference was interpolated linearly between them."""
    rates = pose_rates(reference)
    repeats, share = _repeats(rates)
    if share < LEAST_REPEATS:
        return reference
    interval = float(np.median(np.diff(reference.time)))
    frequency, phase, sharpness = _comb(rates.stop[:-1][repeats], (1.0 - share) / (2.0 * interval))
    if sharpness < COMB_SHARPNESS * np.sinc(share):
        return reference
    first, last = np.ceil(frequency * reference.time[0] - phase), np.floor(frequency * reference.time[-1] - phase)
    frames: FloatArray = (np.arange(first, last + 1.0) + phase) / frequency
    # line through the last two samples before a frame, extended to the frame, or NaN if they are not both in the interval before it
    following = np.searchsorted(reference.time, frames)
    k = np.clip(following - 2, 0, len(rates.rate) - 1)
    inside = rates.valid[k] & (rates.start[k] >= frames - 1.0 / frequency - NEAR_FRAME_S)
    inside &= rates.stop[k] <= frames + NEAR_FRAME_S
    ahead = (frames - rates.start[k])[:, None]
    q_nb = quaternion_product(reference.q_nb[k], quaternion_of(rates.rate[k] * ahead))
    position = reference.position
    if position is not None:
        velocity = (position[k + 1] - position[k]) / (rates.stop[k] - rates.start[k])[:, None]
        position = np.where(inside[:, None], position[k] + velocity * ahead, np.nan)
    moving = None if reference.moving is None else reference.moving[np.clip(following, 0, len(reference) - 1)]
    q_nb = np.where(inside[:, None], q_nb, np.nan)
    return Reference(time=frames, q_nb=q_nb, position=position, moving=moving, name=reference.name)


def _repeats(rates: PoseRates) -> tuple[BoolArray, float]:
    neighbours_valid = rates.valid[1:] & rates.valid[:-1]
    change = np.abs(np.diff(rates.rate, axis=0)).max(axis=1)
    turning = neighbours_valid & (np.abs(rates.rate[1:]).max(axis=1) > 0.0)
    if not turning.any():
        return turning, 0.0
    equal = turning & (change <= SAME_RATE * np.median(change[turning]))
    return equal, float(equal.sum() / turning.sum())


def _comb(t: FloatArray, guess: float) -> tuple[float, float, float]:
    # Frame times are (k + phase) / frequency. The middles of the repeats are half a frame later. Spans grow step by step.
    if len(t) < 20:
        return guess, 0.0, 0.0
    t0, span, width = t[0], 200.0 / guess, 0.1 * guess
    frequency, total = guess, 0j
    while True:
        some = t[t <= t0 + span] - t0
        trial = frequency + np.linspace(-width, width, 161)
        sums = np.exp(2j * np.pi * np.outer(trial, some)).mean(axis=1)
        best = int(np.argmax(np.abs(sums)))
        frequency, total = float(trial[best]), sums[best]
        if some[-1] >= t[-1] - t0 and width * span < 2e-2:
            break
        width = min(width / 20.0, 2.0 / span)
        span = min(4.0 * span, float(t[-1] - t0) + 1e-9)
    phase = frequency * t0 + float(np.angle(total)) / (2.0 * np.pi) - 0.5
    return frequency, float(phase % 1.0), float(abs(total))


# ---- lag to a fraction of a sample

_STEPS = 12  # largest number of Gauss-Newton steps (the last steps change the lag by less than a microsecond)
LONGEST_LAG_S = 5.0  # half-width of the search, s
AVERAGE_S = 0.05  # averaging time of compared rates, s: a longer time removes more pose noise but blurs fast motion
_BLOCK_S = 0.5  # residuals this far apart count as independent
LEAST_AVERAGES = 30  # smallest number of common averages
LEAST_CORRELATION = 0.7  # smallest correlation of the rates at the lag for a common motion


# smallest singular value, relative to the largest: with one axis, the other readings are noise
_ONE_AXIS, _THREE_AXES = 0.05, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lag:
    """Lag between the clock of a record and the clock of a reference."""

    seconds: float  # lag, s: a reading with time stamp t was taken at t - seconds on the reference's clock
    standard_uncertainty: float  # standard uncertainty of ``seconds``, s, from half-second blocks of residuals
    correlation: float  # multiple correlation of reference rate and readings at this lag
    matrix: FloatArray  # (A, 3), reference rate per reading: scale and mounting, rad/s per unit of the readings
    constant: FloatArray  # (A,), reference rate at zero reading, rad/s


def find_lag(record: Record, reference: Reference, longest_lag_s: float = LONGEST_LAG_S) -> Lag:
    """Determine the lag of gyroscope readings behind poses of the same body."""
    if record.gyro is None:
        raise InputError("lag: the record has no gyroscope. Map its columns.")
    return lag_of(record.time, record.gyro, pose_rates(native_poses(reference)), longest_lag_s)


def lag_of(
    time: FloatArray,
    gyro: FloatArray,
    rates: PoseRates,
    longest_lag_s: float = LONGEST_LAG_S,
    *,
    average_s: float = AVERAGE_S,
    near: float | None = None,
) -> Lag:
    """Determine the lag of readings behind mean rates about three axes or one axis, starting at ``near`` if it is given."""
    lag = coarse_lag(time, gyro, rates, longest_lag_s) if near is None else near
    integral, wanted = RunningIntegral(time, gyro), _average_rates(rates, average_s)
    fit: Lag | None = None
    for _ in range(_STEPS):
        fit, step = _align(integral, wanted, lag)
        if fit is None or not abs(step) < longest_lag_s:
            break
        step = float(np.clip(step, -average_s, average_s))  # the linear model reaches about one averaging length
        lag += step
        if abs(step) < 1e-7:
            break
    correlation = 0.0 if fit is None else fit.correlation
    if fit is None or correlation < LEAST_CORRELATION or abs(lag) > longest_lag_s + 1.0:
        raise AlignmentError(
            f"lag: record and reference have no common motion: the correlation of their rates is {correlation:.2f} at best, within "
            f"{longest_lag_s:g} s. Check that the two files belong together, or widen `longest_lag_s`",
            correlation=correlation,
        )
    return replace(fit, seconds=lag)


def _average_rates(rates: PoseRates, average_s: float) -> PoseRates:
    """Return the rates averaged over runs of neighbouring steps that are all valid."""
    step = rates.stop - rates.start
    width = max(1, round(average_s / float(np.median(step))))
    turn = window_sums(rates.rate * step[:, None], width)
    complete = window_sums(rates.valid[:, None].astype(float), width)[:, 0] > width - 0.5
    start, stop = rates.start[: len(complete)][complete], rates.stop[width - 1 :][complete]
    return PoseRates(start=start, stop=stop, rate=turn[complete] / (stop - start)[:, None], valid=complete[complete])


def _align(integral: RunningIntegral, wanted: PoseRates, lag: float) -> tuple[Lag | None, float]:
    """Fit A and c at a lag. Also return the step of the lag that reduces the residual most, or None without common motion."""
    start, stop = wanted.start + lag, wanted.stop + lag
    mean, inside = integral.mean(start, stop)
    if inside.sum() < LEAST_AVERAGES:
        return None, 0.0
    width = 0.25 * float(np.median(stop - start))
    late, late_inside = integral.mean(start + width, stop + width)
    early, early_inside = integral.mean(start - width, stop - width)
    inside &= late_inside & early_inside
    u, w, slope = mean[inside], wanted.rate[inside], (late - early)[inside] / (2.0 * width)
    centre_u, centre_w = u.mean(axis=0), w.mean(axis=0)
    u, w = u - centre_u, w - centre_w
    a = np.linalg.lstsq(u, w, rcond=_ONE_AXIS if w.shape[1] == 1 else _THREE_AXES)[0]
    residual, power = w - u @ a, float((w**2).sum())
    if not power > 0.0:
        return None, 0.0
    # The column of the lag, without the part that A and c explain, leaves one equation: step = sum(s r) / sum(s s).
    column = (slope - slope.mean(axis=0)) @ a
    column -= u @ np.linalg.lstsq(u, column, rcond=_THREE_AXES)[0]
    square, step, uncertainty = float((column**2).sum()), 0.0, float("inf")
    if square > 0.0:
        step = float((column * residual).sum()) / square
        score = (column * (residual - step * column)).sum(axis=1)
        block = np.flatnonzero(np.diff(np.floor(wanted.start[inside] / _BLOCK_S), prepend=-np.inf) > 0.0)
        uncertainty = float(np.sqrt((np.add.reduceat(score, block) ** 2).sum()) / square)
    return Lag(
        seconds=lag,
        standard_uncertainty=uncertainty,
        correlation=float(np.sqrt(max(0.0, 1.0 - float((residual**2).sum()) / power))),
        matrix=a.T,
        constant=centre_w - a.T @ centre_u,
    ), step


# ---- two clocks with different rates: a straight line through the lags of parts of a recording

PARTS, LEAST_PART_S = 5, 6.0  # number of parts of a recording, each with its own lag, and shortest part
LEAST_SKEW_S, SKEW_SIGMAS = 1e-3, 4.0  # over the recording: clocks in step differ by up to 0.1 ms in BROAD
OUT_OF_STEP_S = 0.03  # deviation from a line through the lags: samples were lost, or are from another trial. Assumed.
TURNING = 5.0 * RADIAN_PER_DEGREE  # median rate, rad/s: larger than at any rest, for any offset of the device


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagLine:
    """Lag over time: lag = ``lag_s`` + ``skew`` (t - ``middle_s``), t on the clock of the reference."""

    middle_s: float
    lag_s: float
    skew: float  # relative excess rate of the record's clock, s/s
    lag_uncertainty_s: float  # standard uncertainty at ``middle_s``, s
    skew_uncertainty: float  # standard uncertainty, or infinity if only one part has a lag
    off_s: FloatArray  # (P,), lags minus the line

    def later(self, time: float) -> float:
        """Return the time on the clock of the record at a time of the reference."""
        return time + self.lag_s + self.skew * (time - self.middle_s)

    def uncertainty_s(self, time: float) -> float:
        """Return the standard uncertainty of the time that ``later`` returns."""
        return float(np.hypot(self.lag_uncertainty_s, (time - self.middle_s) * self.skew_uncertainty))


def lag_line(
    record: Record, parts: Sequence[PoseRates], *, near: float, average_s: float = AVERAGE_S, floor_s: float = 1e-6
) -> LagLine:
    """Fit a line to the lags of parts of a recording, with an uncertainty that includes their scatter.

    Lags with an uncertainty above an average are omitted. ``floor_s`` is the smallest uncertainty that is used. Raise
    AlignmentError if a part has no common motion.
    """
    lags, when, longest_lag_s = list[Lag](), list[float](), abs(near) + LONGEST_LAG_S
    for section in parts:
        lag = lag_of(record.time, np.asarray(record.gyro), section, longest_lag_s, average_s=average_s, near=near)
        if lag.standard_uncertainty < average_s:
            lags.append(lag)
            when.append(float(np.average(section.start, weights=(section.rate**2).sum(axis=1))))
    if not lags:
        raise AlignmentError(
            "lag: no part of record and reference has a common motion. Check that they belong together."
        )
    lags_s, weight = np.array([lag.seconds for lag in lags]), np.array([lag.standard_uncertainty for lag in lags])
    weight = np.hypot(weight, floor_s) ** -2.0
    middle, lag_s = float(weight @ when / weight.sum()), float(weight @ lags_s / weight.sum())
    distance = np.array(when) - middle
    square = float(weight @ distance**2)
    skew = float(weight @ (distance * (lags_s - lag_s)) / square) if len(lags) > 1 else 0.0
    residual = lags_s - lag_s - skew * distance
    spread = max(1.0, float(weight @ residual**2) / (len(lags) - 2)) if len(lags) > 2 else 1.0
    return LagLine(
        middle_s=middle, lag_s=lag_s, skew=skew, off_s=residual,
        lag_uncertainty_s=float(np.sqrt(spread / weight.sum())),
        skew_uncertainty=float(np.sqrt(spread / square)) if len(lags) > 1 else float("inf"),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Clocks:
    """A recording in step with its reference."""

    time: FloatArray  # (N,), times of the recording on a clock that runs at the rate of the reference's clock
    lag: Lag  # delay of the recording relative to the reference
    reference: Reference  # reference without padding poses
    poses: Reference  # poses at the frames of the cameras only
    findings: tuple[Finding, ...]  # findings about lost samples


def in_step(record: Record, reference: Reference, longest_lag_s: float = LONGEST_LAG_S) -> Clocks:
    """Determine the lag of a recording behind its reference, and check whether both clocks have the same rate."""
    poses = native_poses(reference)
    lag, rates = find_lag(record, poses, longest_lag_s), pose_rates(poses)
    common = (rates.start + lag.seconds >= record.time[0]) & (rates.stop + lag.seconds <= record.time[-1])
    span_s = float(np.ptp(rates.start[common])) if common.any() else 0.0
    line: LagLine | None = None
    if span_s > PARTS * LEAST_PART_S:
        parts = [rates.part(rows) for rows in np.array_split(np.flatnonzero(common), PARTS)]
        with suppress(AlignmentError):  # a part is at rest, or has no poses
            line = lag_line(record, parts, near=lag.seconds)
    findings: tuple[Finding, ...] = ()
    if line is not None:
        if abs(line.skew) * span_s > LEAST_SKEW_S and abs(line.skew) > SKEW_SIGMAS * line.skew_uncertainty:
            record = replace(record, time=record.time - line.skew * (record.time - line.lag_s - line.middle_s))
            lag = find_lag(record, poses, longest_lag_s)
        if (lost_s := float(np.ptp(line.off_s))) > OUT_OF_STEP_S:
            sentence = f"Recording and reference are out of step: their lag changes by {1e3 * lost_s:.0f} ms, not in proportion "
            sentence += "to time. Samples were lost, or the two do not belong together."
            action = "Check both files for lost samples, or judge each part separately."
            findings = (finding("sync.out_of_step", "warn", sentence, action),)
    poses, reference = (seen_poses(record, each, lag) for each in (poses, reference))
    return Clocks(time=record.time, lag=lag, reference=reference, poses=poses, findings=findings)


def padding(full_record: Record, record: Record) -> tuple[Finding, ...]:
    """Return a finding about rows that ``segments.unpadded`` removed from a record."""
    padded_s = full_record.duration_s - record.duration_s
    sentence = f"{padded_s:.2f} s at the ends of the recording repeat a reading and were not used."
    return (finding("recording.padded", "info", sentence),) if len(record) < len(full_record) else ()


def seen_poses(record: Record, poses: Reference, lag: Lag) -> Reference:
    """Return poses with gaps if the file repeats the first or the last pose while the record turns."""
    q_nb, time = np.array(poses.q_nb), record.time - lag.seconds
    for start, stop in runs((np.diff(poses.q_nb, axis=0) == 0.0).all(axis=1)):
        inside = (time >= poses.time[start]) & (time <= poses.time[stop])
        rate = np.asarray(record.gyro)[inside] @ lag.matrix.T + lag.constant
        edge = start == 0 or stop == len(poses) - 1
        if edge and len(rate) and np.nanmedian(np.linalg.norm(rate, axis=1)) > TURNING:
            q_nb[start + (start > 0) : stop + (start > 0)] = np.nan
    return poses if np.isfinite(q_nb[poses.valid]).all() else replace(poses, q_nb=q_nb)


# ---- motion: the part that the reference marks as motion; without marks, the part between the first and the last rest

LEAST_REST_S, LEAST_MOTION_S = 3.0, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSpan:
    """The stretch between the first and the last rest, or the whole common stretch if a recording begins in motion."""

    start_s: float  # start of the motion on the clock of the record, s
    stop_s: float  # end of the motion, s
    rested: bool  # True if the motion begins after a rest


def find_motion(record: Record, reference: Reference, *, lag_s: float = 0.0) -> MotionSpan:
    """Find the stretch of motion between the first and the last rest, or the common stretch of motion if there is no first rest."""
    valid_time = reference.time[reference.valid] + lag_s
    first, last = max(float(record.time[0]), float(valid_time[0])), min(float(record.time[-1]), float(valid_time[-1]))
    begins = max(float(record.time[0]), float(reference.time[0]) + lag_s)
    marked = reference.time[:0] if reference.moving is None else reference.time[reference.moving > 0.0] + lag_s
    span = _motion_between_stills(record) if not len(marked) else None
    if len(marked):
        span = float(marked[0]), float(marked[-1]) + float(np.median(np.diff(reference.time)))
    if span is not None and span[0] - begins >= LEAST_REST_S:
        return MotionSpan(start_s=span[0], stop_s=span[1], rested=True)
    start, stop = (first, last) if span is None else (max(first, span[0]), min(last, span[1]))
    if stop - start < LEAST_MOTION_S:
        raise AlignmentError(
            f"motion: record and reference share {max(stop - start, 0.0):.1f} s of motion, less than {LEAST_MOTION_S:g} s. Check "
            "that the two files belong together."
        )
    return MotionSpan(start_s=start, stop_s=stop, rested=False)


def _motion_between_stills(record: Record) -> tuple[float, float] | None:
    """Return the stretch from the first rest of 3 s to the last rest or to the end, or None without such a rest."""
    search = find_still(record)
    long = [s for s in search.stills if record.time[s.stop - 1] - record.time[s.start] >= LEAST_REST_S]
    if not long:
        return None
    first, last = long[0], search.stills[-1]
    ends_moving = last.stop < len(record) - 1 - record.sample_rate_hz * LEAST_REST_S or last is first
    start, stop = float(record.time[first.stop - 1]), float(record.time[-1 if ends_moving else last.start])
    if stop - start >= LEAST_MOTION_S:
        return start, stop
    if record.time[first.start] - record.time[0] > LEAST_MOTION_S:
        return None  # the device rests only at the end
    raise AlignmentError("motion: the device is at rest throughout, so no motion follows the first rest.")
