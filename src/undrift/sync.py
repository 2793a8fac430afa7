"""Sync: bring a record and a reference onto one clock, before any fit or comparison.

``native_poses`` undoes a linear up-sampling of the reference, ``pose_rates`` turns poses into mean rates, ``find_lag`` finds how
late the record's samples are, ``in_step`` whether that stays so, ``find_motion`` where rest ends and begins again. With w the body
rate of the reference and u the readings, both averaged over the same stretches::

    w(t) = A u(t + lag) + c                    A (3 x 3) and c free: scale, mounting and offset do not disturb the lag

First the length of u is correlated with the length of w at every lag of a wide search: no mounting is needed for that. Then
Gauss-Newton on A, c and lag together: the change of u with time is one more column of the design. A reading is the rate at
its time stamp. Where each sample holds over the interval before it, as in strapdown, the lag is half a sample shorter.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs, window_sums
from undrift.errors import AlignmentError, InputError
from undrift.findings import Finding, finding
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotation_vector
from undrift.record import Record, Reference
from undrift.segments import StillSettings, find_still
from undrift.units import RADIAN_PER_DEGREE

# ---- mean rates between neighbouring poses, and readings averaged over the same stretches
#
#     w_k = log(q_k^-1 q_(k+1)) / (t_(k+1) - t_k)          the rotation vector of their quotient over the time between them
#
# Averages of readings come from the running integral of the straight lines between samples.

LONGEST_STEP = 1.5  # medians of the pose interval; a longer step is a gap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseRates:
    """Mean body rates between neighbouring poses."""

    start: FloatArray  # (K,), time of the first pose, s
    stop: FloatArray  # (K,), of the second, s
    rate: FloatArray  # (K, 3), mean rate, rad/s, frame of the body; zero where not valid
    valid: BoolArray  # (K,), false where a pose is missing or the step is a gap

    def part(self, rows: IntArray | BoolArray | slice, later_s: float = 0.0) -> "PoseRates":
        """Return some of the rates, on a clock that is ahead by ``later_s``."""
        start, stop = self.start[rows] + later_s, self.stop[rows] + later_s
        return PoseRates(start=start, stop=stop, rate=self.rate[rows], valid=self.valid[rows])


def pose_rates(reference: Reference) -> PoseRates:
    """Return the mean rate of the body between neighbouring poses."""
    step = np.diff(reference.time)
    turn = rotation_vector(quaternion_product(quaternion_conjugate(reference.q_nb[:-1]), reference.q_nb[1:]))
    valid = np.isfinite(turn[:, 0]) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid[:, None], turn / step[:, None], 0.0)
    return PoseRates(start=reference.time[:-1], stop=reference.time[1:], rate=rate, valid=valid)


class RunningIntegral:
    """Integral of readings from the first sample on, for averages over any stretch."""

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
        self.time = time
        self._values = np.where(gap[:, None], 0.0, values)
        step = np.diff(time)
        late = step > LONGEST_STEP * np.median(step)
        self._gaps: IntArray = np.append(0, np.cumsum(gap[1:] | gap[:-1] | late))
        area = 0.5 * (self._values[1:] + self._values[:-1]) * step[:, None]
        whole = np.cumsum(np.concatenate((0.0 * area[:1], area[:-1])), axis=0)
        bend = 0.5 * (np.diff(self._values, axis=0) / step[:, None])
        self._pieces = np.concatenate((whole, self._values[:-1], bend), axis=1)  # of the integral, from each sample on

    def mean(self, start: FloatArray, stop: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the mean reading (K, C) of each stretch and whether it has no gap (K,)."""
        first, at_first = self._at(start)
        last, at_last = self._at(stop)
        valid = (start >= self.time[0]) & (stop <= self.time[-1])
        valid &= self._gaps[np.minimum(last + 1, len(self.time) - 1)] == self._gaps[first]
        return np.where(valid[:, None], (at_last - at_first) / (stop - start)[:, None], 0.0), valid

    def _at(self, t: FloatArray) -> tuple[IntArray, FloatArray]:
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        dt, (whole, value, bend) = (t - self.time[k])[:, None], np.split(self._pieces[k], 3, axis=1)
        return k, whole + value * dt + bend * (dt * dt)


# ---- coarse lag: where the lengths of the two rates correlate best, over a wide search and with gaps masked
#
# Both lengths are averaged into cells of one width on a common clock. The correlation at every shift counts only cells that both
# sides have: with masks m, n (0 or 1) and values x, y already multiplied by them, all sums over cells are correlations of x, y,
# x^2, y^2, m and n, and a Fourier transform gives them for all shifts at once.

CELL_S = 0.02  # s
LEAST_OVERLAP = 0.3  # of the shorter side


def coarse_lag(time: FloatArray, gyro: FloatArray, rates: PoseRates, longest_lag_s: float) -> float:
    """Return the lag, s, at which the lengths of the two rates correlate best."""
    lags, correlation, overlap = lag_correlation(time, gyro, rates, longest_lag_s)
    if not overlap.any():
        raise AlignmentError(
            f"lag: wanted record and reference to share {LEAST_OVERLAP:.0%} of the shorter one within {longest_lag_s:g} s "
            f"of search, got less; they begin at {time[0]:.6g} and {rates.start[0]:.6g} s: check their clocks, or widen "
            "`longest_lag_s`"
        )
    if not np.isfinite(correlation).any():
        raise AlignmentError(
            "lag: wanted both sides to turn, got one that does not; there is no common motion to align by"
        )
    return float(lags[np.nanargmax(correlation)])


def lag_correlation(
    time: FloatArray, gyro: FloatArray, rates: PoseRates, longest_lag_s: float, *, centre: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lags, s, the correlation of the two lengths at each, and the cells that both have; NaN and 0 where too few."""
    centred = gyro - _offset(gyro) if centre else gyro  # a device that seldom rests shows no offset
    u, w = np.linalg.norm(centred, axis=1), np.linalg.norm(rates.rate, axis=1)
    middle = 0.5 * (rates.start + rates.stop)
    start = min(time[0], middle[0])
    count = int(np.ceil((max(time[-1], middle[-1]) - start) / CELL_S)) + 1
    cell = max(1, round(float(np.median(np.diff(time))) / CELL_S), round(float(np.median(np.diff(middle))) / CELL_S))
    x, m = _cells(time, u, np.isfinite(u), start, count // cell + 1, cell * CELL_S)
    y, n = _cells(middle, w, rates.valid, start, count // cell + 1, cell * CELL_S)
    reach = min(int(longest_lag_s / (cell * CELL_S)) + 1, len(x) - 1)
    correlation, overlap = _masked_correlation(x, m, y, n, reach)
    enough = overlap >= LEAST_OVERLAP * min(m.sum(), n.sum())
    lags = (np.arange(len(correlation)) - reach) * cell * CELL_S
    return lags, np.where(enough, correlation, np.nan), np.where(enough, overlap, 0.0)


def _offset(gyro: FloatArray) -> FloatArray:
    seen = gyro[np.isfinite(gyro).all(axis=1)]
    change = np.abs(np.diff(seen, axis=0)).sum(axis=1)
    quiet = seen[1:][change <= np.quantile(change, 0.1)]
    spread = np.linalg.norm(quiet - np.median(quiet, axis=0), axis=1)
    return np.asarray(np.median(quiet[spread <= np.median(spread)], axis=0))


def _cells(
    t: FloatArray, values: FloatArray, valid: BoolArray, start: float, count: int, width: float
) -> tuple[FloatArray, FloatArray]:
    k = ((t[valid] - start) / width).astype(np.int64)
    weight = np.bincount(k, minlength=count).astype(float)
    mean = np.bincount(k, weights=values[valid], minlength=count) / np.maximum(weight, 1.0)
    seen = (weight > 0.0).astype(float)
    return (mean - float((mean * seen).sum() / max(seen.sum(), 1.0))) * seen, seen


def _masked_correlation(
    x: FloatArray, m: FloatArray, y: FloatArray, n: FloatArray, reach: int
) -> tuple[FloatArray, FloatArray]:
    # At shift s the record's cell k + s meets the reference's cell k.
    size = 1 << (2 * len(x) - 1).bit_length()
    first = np.fft.rfft(np.stack((x, x * x, m)), size)
    second = np.conj(np.fft.rfft(np.stack((y, y * y, n)), size))

    def summed(i: int, j: int) -> FloatArray:
        full = np.fft.irfft(first[i] * second[j], size)
        return np.concatenate((full[size - reach :], full[: reach + 1]))

    count = np.maximum(np.round(summed(2, 2)), 0.0)
    safe = np.maximum(count, 1.0)
    mean_x, mean_y = summed(0, 2) / safe, summed(2, 0) / safe
    var_x, var_y = summed(1, 2) / safe - mean_x**2, summed(2, 1) / safe - mean_y**2
    good = (count > 10.0) & (var_x > 1e-12 * var_x.max()) & (var_y > 1e-12 * var_y.max())
    product = np.sqrt(np.where(good, var_x * var_y, 1.0))
    return np.where(good, (summed(0, 0) / safe - mean_x * mean_y) / product, np.nan), count


# ---- poses as the instrument took them: undo a linear up-sampling of the reference
#
# Many files hold optics at the sensor's sample rate, drawn on straight lines (great arcs) between the frames that the cameras took.
# Between frames such a pose cuts the corner: by a h^2 / 8 at an angular acceleration a and a frame interval h, always towards less
# motion. At 2 Hz and 120 frames/s that is 0.1 % of the amplitude, which a fit would take as scale factor.
#
# On a straight line the rate between neighbours repeats to the last digit; it jumps at the frames. The middles of the repeats lie
# on a comb of the frame rate; its frequency and phase come from the largest Fourier sum, and each frame is the end of the straight
# line before it and the start of the line after it.

LEAST_REPEATS = 0.02  # share of neighbouring rates that repeat before up-sampling is suspected
COMB_SHARPNESS = 0.95  # of what a perfect comb gives
_SAME = 1e-4  # of the median change of rate: two rates are one
_NEAR_FRAME = 2e-5  # s; a sample this close to a frame may stand on either side


def native_poses(reference: Reference) -> Reference:
    """Return the frames that the instrument took, where the reference was drawn on straight lines between them."""
    rates = pose_rates(reference)
    repeats, share = _repeats(rates)
    if share < LEAST_REPEATS:
        return reference
    interval = float(np.median(np.diff(reference.time)))
    frequency, phase, sharpness = _comb(rates.stop[:-1][repeats], (1.0 - share) / (2.0 * interval))
    if sharpness < COMB_SHARPNESS * np.sinc(share):
        return reference
    first = np.ceil(frequency * reference.time[0] - phase)
    last = np.floor(frequency * reference.time[-1] - phase)
    frames: FloatArray = (np.arange(first, last + 1.0) + phase) / frequency
    # Where the line before a frame has a gap, the line after it.
    after = np.searchsorted(reference.time, frames)
    before = _drawn_to(reference, rates, frames, after - 2, (frames - 1.0 / frequency, frames))
    drawn = np.where(
        np.isfinite(before), before, _drawn_to(reference, rates, frames, after, (frames, frames + 1.0 / frequency))
    )
    moving = None if reference.moving is None else reference.moving[np.clip(after, 0, len(reference) - 1)]
    position = None if reference.position is None else drawn[:, 4:]
    return Reference(time=frames, q_nb=drawn[:, :4], position=position, moving=moving, name=reference.name)


def _repeats(rates: PoseRates) -> tuple[BoolArray, float]:
    both = rates.valid[1:] & rates.valid[:-1]
    change = np.abs(np.diff(rates.rate, axis=0)).max(axis=1)
    moved = both & (np.abs(rates.rate[1:]).max(axis=1) > 0.0)
    if not moved.any():
        return moved, 0.0
    same = moved & (change <= _SAME * np.median(change[moved]))
    return same, float(same.sum() / moved.sum())


def _comb(t: FloatArray, guess: float) -> tuple[float, float, float]:
    # Frame times are (k + phase) / frequency; the middles of the repeats lie half a frame later. Longer and longer spans.
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


def _drawn_to(
    reference: Reference, rates: PoseRates, frames: FloatArray, pair: IntArray, span: tuple[FloatArray, FloatArray]
) -> FloatArray:
    # The line through samples pair, pair + 1, drawn to the frame, q_nb beside position; NaN unless both lie within the span.
    k = np.clip(pair, 0, len(rates.rate) - 1)
    inside = (pair == k) & rates.valid[k]
    inside &= (rates.start[k] >= span[0] - _NEAR_FRAME) & (rates.stop[k] <= span[1] + _NEAR_FRAME)
    ahead = (frames - rates.start[k])[:, None]
    drawn = quaternion_product(reference.q_nb[k], quaternion_of(rates.rate[k] * ahead))
    if reference.position is not None:
        velocity = (reference.position[k + 1] - reference.position[k]) / (rates.stop[k] - rates.start[k])[:, None]
        drawn = np.column_stack((drawn, reference.position[k] + velocity * ahead))
    return np.where(inside[:, None], drawn, np.nan)


# ---- lag to a fraction of a sample

_STEPS = 12  # Gauss-Newton steps at most; the last ones move the lag by less than a microsecond
AVERAGE_S = 0.05  # s, of rates that are compared
_BLOCK_S = 0.5  # residuals this far apart count as independent
_LEAST_AVERAGES = 30  # that both sides have


@dataclass(frozen=True, slots=True, kw_only=True)
class LagSettings:
    """How the lag is found."""

    longest_lag_s: float = 5.0  # Half-width of the search, s
    # Both sides are averaged over this long, s. Longer takes more pose noise away and blurs fast motion
    average_s: float = AVERAGE_S
    # Between the rates after alignment; less means that the two did not see the same motion
    least_correlation: float = 0.7


# Least singular value that counts, of the largest: with one axis the other readings are noise
_ONE_AXIS, _THREE_AXES = 0.05, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lag:
    """How the clock of a record stands against that of a reference."""

    seconds: float  # A reading stamped t was true at t - seconds on the reference's clock, s
    standard_uncertainty: float  # Of ``seconds``, s, from half-second blocks of residuals
    correlation_before: float  # multiple correlation of reference rate and readings without a shift; 0 without overlap
    correlation_after: float  # the same with the shift
    matrix: FloatArray  # (A, 3), reference rate per reading: scale and mounting, rad/s per unit of the readings
    constant: FloatArray  # (A,), reference rate at zero reading, rad/s


def find_lag(record: Record, reference: Reference, settings: LagSettings = LagSettings()) -> Lag:
    """Find how late the readings of a gyroscope are against poses of the same body."""
    if record.gyro is None:
        raise InputError("lag: wanted a record with a gyroscope, got none; map its columns")
    return lag_of(record.time, record.gyro, pose_rates(native_poses(reference)), settings)


def lag_of(
    time: FloatArray, gyro: FloatArray, rates: PoseRates, settings: LagSettings, *, near: float | None = None
) -> Lag:
    """Find how late readings are against mean rates about three axes or one; ``near`` is where the search begins, if known."""
    lag = coarse_lag(time, gyro, rates, settings.longest_lag_s) if near is None else near
    known, wanted = RunningIntegral(time, gyro), _averaged(rates, settings.average_s)
    before, fit = _aligned(known, wanted, 0.0)[0], None
    limit = settings.average_s  # the linear model reaches about one averaging length
    for _ in range(_STEPS):
        fit, step = _aligned(known, wanted, lag)
        if fit is None or not abs(step) < settings.longest_lag_s:
            break
        step = float(np.clip(step, -limit, limit))
        lag += step
        if abs(step) < 1e-7:
            break
    correlation = 0.0 if fit is None else fit.correlation_after
    if fit is None or correlation < settings.least_correlation or abs(lag) > settings.longest_lag_s + 1.0:
        raise AlignmentError(
            f"lag: wanted a correlation of {settings.least_correlation:g} or more between the record's rates and the "
            f"reference's, got {correlation:.2f} within {settings.longest_lag_s:g} s: no common motion; check that the two "
            "files belong together, or widen `longest_lag_s`",
            correlation=correlation,
        )
    return replace(fit, seconds=lag, correlation_before=0.0 if before is None else before.correlation_after)


def _averaged(rates: PoseRates, average_s: float) -> PoseRates:
    """Return the rates averaged over runs of neighbouring steps that are all valid."""
    step = rates.stop - rates.start
    width = max(1, round(average_s / float(np.median(step))))
    turn = window_sums(rates.rate * step[:, None], width)
    whole = window_sums(rates.valid[:, None].astype(float), width)[:, 0] > width - 0.5
    start, stop = rates.start[: len(whole)][whole], rates.stop[width - 1 :][whole]
    return PoseRates(start=start, stop=stop, rate=turn[whole] / (stop - start)[:, None], valid=whole[whole])


def _aligned(integral: RunningIntegral, wanted: PoseRates, lag: float) -> tuple[Lag | None, float]:
    """Fit A and c at a lag; return them with the step of the lag that reduces the residual most; None without common motion."""
    start, stop = wanted.start + lag, wanted.stop + lag
    mean, inside = integral.mean(start, stop)
    if inside.sum() < _LEAST_AVERAGES:
        return None, 0.0
    width = 0.25 * float(np.median(stop - start))
    (late, late_inside), (early, early_inside) = (integral.mean(start + by, stop + by) for by in (width, -width))
    inside &= late_inside & early_inside
    u, w, slope = mean[inside], wanted.rate[inside], (late - early)[inside] / (2.0 * width)
    centre_u, centre_w = u.mean(axis=0), w.mean(axis=0)
    u, w = u - centre_u, w - centre_w
    a = np.linalg.lstsq(u, w, rcond=_ONE_AXIS if w.shape[1] == 1 else _THREE_AXES)[0]
    residual, power = w - u @ a, float((w**2).sum())
    if not power > 0.0:
        return None, 0.0
    # The column of the lag, cleared of what A and c explain, leaves one equation: step = sum(s r) / sum(s s).
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
        correlation_before=0.0,
        correlation_after=float(np.sqrt(max(0.0, 1.0 - float((residual**2).sum()) / power))),
        matrix=a.T,
        constant=centre_w - a.T @ centre_u,
    ), step


# ---- two clocks that do not run alike: a straight line through the lags of parts of a recording


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagLine:
    """Lag over time: lag = ``lag_s`` + ``skew`` (t - ``middle_s``), t on the clock of the reference."""

    middle_s: float
    lag_s: float
    skew: float  # seconds per second by which the clock of the record runs faster
    lag_uncertainty_s: float  # standard, at ``middle_s``
    skew_uncertainty: float  # standard; infinite if one part only has a lag
    off_s: FloatArray  # (P,), lags minus the line


def lag_line(when: FloatArray, lags: FloatArray, uncertainty: FloatArray) -> LagLine:
    """Fit a line to lags (P,), s, at times (P,); its uncertainty is enlarged by their scatter."""
    weight = uncertainty**-2.0
    middle, lag = float(weight @ when / weight.sum()), float(weight @ lags / weight.sum())
    away = when - middle
    square = float(weight @ away**2)
    skew = float(weight @ (away * (lags - lag)) / square) if square > 0.0 else 0.0
    off = lags - lag - skew * away
    spread = max(1.0, float(weight @ off**2) / (len(lags) - 2)) if len(lags) > 2 else 1.0
    return LagLine(
        middle_s=middle, lag_s=lag, skew=skew, off_s=off,
        lag_uncertainty_s=float(np.sqrt(spread / weight.sum())),
        skew_uncertainty=float(np.sqrt(spread / square)) if square > 0.0 else float("inf"),
    )  # fmt: skip


def middle_of_motion(rates: PoseRates) -> float:
    """Return the mean time, s, weighted by the square of the rate: the time at which a lag is determined."""
    return float(np.average(rates.start, weights=(rates.rate**2).sum(axis=1)))


_PARTS, _LEAST_PART_S = 5, 6.0  # of a recording, each with a lag of its own
# s, over the recording, and its standard uncertainties: BROAD's clocks, which run alike, differ by up to 0.1 ms and two of them
_LEAST_SKEW, _CLEAR = 1e-3, 4.0
_OUT_OF_STEP = 0.05  # s, off a line through the lags: samples were lost, or another trial's were put in [assumed]
_TURNS = 5.0 * RADIAN_PER_DEGREE  # rad/s, median: no rest, whatever the device's offset


def in_step(
    record: Record, poses: Reference, settings: LagSettings = LagSettings()
) -> tuple[Record, Lag, list[Finding]]:
    """Return the record on a clock that runs like the reference's, its lag, and findings about the two clocks."""
    lag, findings, rates = find_lag(record, poses, settings), list[Finding](), pose_rates(poses)
    common = (rates.start + lag.seconds >= record.time[0]) & (rates.stop + lag.seconds <= record.time[-1])
    span_s = float(np.ptp(rates.start[common])) if common.any() else 0.0
    if not span_s > _PARTS * _LEAST_PART_S:
        return record, lag, findings
    parts = [rates.part(rows) for rows in np.array_split(np.flatnonzero(common), _PARTS)]
    try:
        lags = [lag_of(record.time, np.asarray(record.gyro), part, settings, near=lag.seconds) for part in parts]
    except AlignmentError:  # a part lies still, or is not seen
        return record, lag, findings
    spread = np.maximum([part.standard_uncertainty for part in lags], 1e-6)
    when, late = np.array([middle_of_motion(part) for part in parts]), np.array([part.seconds for part in lags])
    line = lag_line(when, late, spread)
    if abs(line.skew) * span_s > _LEAST_SKEW and abs(line.skew) > _CLEAR * line.skew_uncertainty:
        record = replace(record, time=record.time - line.skew * (record.time - lag.seconds - when.mean()))
        lag, late = find_lag(record, poses, settings), line.off_s
    if np.ptp(late) > _OUT_OF_STEP:
        findings.append(finding("sync.out_of_step", "warn", most_ms=1e3 * float(np.ptp(late))))
    return record, lag, findings


def padding(whole: Record, record: Record) -> tuple[Finding, ...]:
    """Return what ``segments.unpadded`` left out of a record."""
    padded_s = whole.duration_s - record.duration_s
    return (finding("recording.padded", "info", padded_s=padded_s),) if len(record) < len(whole) else ()


def seen_poses(record: Record, poses: Reference, lag: Lag) -> Reference:
    """Return poses with a gap where the first or the last one is repeated while the record turns: the file was filled up."""
    q_nb, time = np.array(poses.q_nb), record.time - lag.seconds
    for start, stop in runs((np.diff(poses.q_nb, axis=0) == 0.0).all(axis=1)):
        inside = (time >= poses.time[start]) & (time <= poses.time[stop])
        rate = np.asarray(record.gyro)[inside] @ lag.matrix.T + lag.constant
        edge = start == 0 or stop == len(poses) - 1
        if edge and len(rate) and np.nanmedian(np.linalg.norm(rate, axis=1)) > _TURNS:
            q_nb[start + (start > 0) : stop + (start > 0)] = np.nan
    return poses if np.isfinite(q_nb[poses.valid]).all() else replace(poses, q_nb=q_nb)


# ---- motion between the first and the last rest: the author's mark of the reference, else the record's still phases

LEAST_REST_S, LEAST_MOTION_S = 3.0, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSpan:
    """The stretch between the first and the last rest of a recording, or all that both have seen where it begins in motion."""

    start_s: float  # On the record's clock, s: the first moment of motion
    stop_s: float  # The first moment after it
    basis: str  # "mark of the reference", "still phases of the record" or "no rest"
    rested: bool = True  # The motion begins after a rest


def find_motion(record: Record, reference: Reference, *, lag_s: float = 0.0) -> MotionSpan:
    """Find the stretch of motion between the first and the last rest; without a rest before it, all that both have seen of it."""
    seen = reference.time[reference.valid] + lag_s
    first, last = max(float(record.time[0]), float(seen[0])), min(float(record.time[-1]), float(seen[-1]))
    if reference.moving is not None and (reference.moving > 0.0).any():
        marked = reference.time[np.flatnonzero(reference.moving > 0.0)] + lag_s
        step = float(np.median(np.diff(reference.time)))
        motion = MotionSpan(start_s=float(marked[0]), stop_s=float(marked[-1]) + step, basis="mark of the reference")
    else:
        motion = _between_stills(record) or MotionSpan(start_s=first, stop_s=last, basis="no rest", rested=False)
    if motion.start_s - max(float(record.time[0]), float(reference.time[0]) + lag_s) >= LEAST_REST_S:
        return motion
    motion = replace(motion, start_s=max(first, motion.start_s), stop_s=min(last, motion.stop_s), rested=False)
    if motion.stop_s - motion.start_s < LEAST_MOTION_S:
        raise AlignmentError(
            f"motion: wanted {LEAST_MOTION_S:g} s or more in which record and reference share the motion, got "
            f"{max(motion.stop_s - motion.start_s, 0.0):.1f} s; check that the two files belong together"
        )
    return motion


def _between_stills(record: Record) -> MotionSpan | None:
    search = find_still(record, StillSettings())
    search = search if search.stills else find_still(record)
    long = [s for s in search.stills if record.time[s.stop - 1] - record.time[s.start] >= LEAST_REST_S]
    if not long:
        return None
    first, last = long[0], search.stills[-1]
    to_the_end = last.stop < len(record) - 1 - record.sample_rate_hz * LEAST_REST_S or last is first
    start, stop = float(record.time[first.stop - 1]), float(record.time[-1 if to_the_end else last.start])
    if stop - start < LEAST_MOTION_S:
        if record.time[first.start] - record.time[0] > LEAST_MOTION_S:
            return None  # it rests at the end alone
        raise AlignmentError("motion: wanted a motion after the first rest, got none; the device lay still throughout")
    return MotionSpan(start_s=start, stop_s=stop, basis="still phases of the record")
