"""Blocks of rest: means over ten seconds or so, torn lines and spikes left out.

A mean over a block leaves out samples that lie more than six robust standard deviations from the median of their block. Its
variance comes from the differences of neighbouring half-second means, pooled over the rest::

    var of a block's mean = mean((m_(k+1) - m_k)^2) / 2 / number of half seconds

so that a ramp does not count as noise; what wanders from block to block is left to the fit.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.noise import block_size
from undrift.drift.observe.observations import RestBlocks
from undrift.record import Record
from undrift.session import Still

_FAR = 6.0  # robust standard deviations: further samples are dirty
_ROBUST = 1.4826  # standard deviation of normal noise over its median absolute deviation
_LEAST_SHARE = 0.5  # of a block's samples that have to be there
_JUMP = 1.0  # degC: a temperature this far off its block, and far off its scatter, is dirty


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Whole:
    """What a rest shares with the rest of its recording.

    Parameters
    ----------
    begin_s : float
        When the recording begins on its session's clock, s.
    gyro_step, accel_step : array, shape (3,)
        Least step between readings, raw unit; 0 where there is one reading only.
    """

    begin_s: float
    gyro_step: FloatArray
    accel_step: FloatArray


def whole_of(record: Record, begin_s: float) -> Whole:
    """Return what the rests of a recording share.

    Parameters
    ----------
    record : Record
        The recording.
    begin_s : float
        When it begins on its session's clock, s.

    Returns
    -------
    Whole
        With the steps of its converters.
    """
    steps = [np.zeros(3) if v is None else _step(v[np.isfinite(v).all(axis=1)]) for v in (record.gyro, record.accel)]
    return Whole(begin_s=begin_s, gyro_step=steps[0], accel_step=steps[1])


def rest_blocks(
    record: Record,
    temp_c: FloatArray,
    still: Still,
    whole: Whole,
    *,
    block_s: float,
    ramp_s: float,
    session: int,
    pose: int,
) -> RestBlocks:
    """Return the blocks of one rest.

    Parameters
    ----------
    record : Record
        The recording.
    temp_c : array, shape (N,)
        Its temperature, degC; NaN where not known.
    still : Still
        The rest.
    whole : Whole
        Of the recording.
    block_s : float
        Length of a block, s; a rest shorter than two of them is one block.
    ramp_s : float
        Stretch over which the slope of the temperature is taken, s.
    session, pose : int
        Numbers to write into the rows.

    Returns
    -------
    RestBlocks
        Blocks half of whose samples or more are there, with a temperature; perhaps none.
    """
    inside = slice(still.start, still.stop)
    time, temp = record.time[inside], temp_c[inside]
    edges = _edges(time, block_s)
    count, size = len(edges) - 1, block_size(record.sample_rate_hz)
    gyro, gyro_variance, gyro_step = _means(record.gyro, inside, edges, size, whole.gyro_step)
    accel, accel_variance, accel_step = _means(record.accel, inside, edges, size, whole.accel_step)
    middle = np.array([0.5 * (time[a] + time[b - 1]) for a, b in pairwise(edges)])
    own = np.array([_temperature(temp[a:b]) for a, b in pairwise(edges)])
    ramp = np.array([_slope(time, temp, at, ramp_s) for at in middle])
    made = RestBlocks(
        session=np.full(count, session, np.int64),
        pose=np.full(count, pose, np.int64),
        time=middle - record.time[0] + whole.begin_s,
        power_on_s=middle - record.time[0],
        temp_c=own,
        ramp_c_per_min=ramp,
        gyro=gyro,
        accel=accel,
        gyro_variance=gyro_variance,
        accel_variance=accel_variance,
        gyro_step_error=gyro_step,
        accel_step_error=accel_step,
    )
    seen = np.isfinite(gyro).all(axis=1) | np.isfinite(accel).all(axis=1)
    return made.taken(np.flatnonzero(np.isfinite(own) & seen))


def _temperature(temp: FloatArray) -> float:
    known = temp[np.isfinite(temp)]
    if len(known) < _LEAST_SHARE * len(temp):
        return float("nan")
    off = np.abs(known - np.median(known))
    return float(known[off <= _JUMP + _FAR * _ROBUST * np.median(off)].mean())


def _edges(time: FloatArray, block_s: float) -> IntArray:
    # As many blocks of about block_s as fit; a still shorter than two blocks is one.
    count = max(1, int((time[-1] - time[0]) / block_s + 0.05))
    edges = np.searchsorted(time, time[0] + (time[-1] - time[0]) * np.arange(1, count) / count)
    return np.unique(np.concatenate(([0], edges, [len(time)])))


def _means(
    readings: FloatArray | None, inside: slice, edges: IntArray, size: int, step: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, its variance and its step error of each block, shape (B, 3); NaN where too many samples are missing."""
    means = np.full((len(edges) - 1, 3), np.nan)
    if readings is None:
        return means, means.copy(), np.zeros_like(means)
    values = readings[inside]
    counts = np.zeros(len(edges) - 1)
    square, pairs = np.zeros(3), 0
    own_variance: list[FloatArray] = []
    for k, (start, stop) in enumerate(pairwise(edges)):
        part = values[start:stop]
        good = _clean(part)
        if good.mean() < _LEAST_SHARE:
            continue
        part = part[good]
        means[k], counts[k] = part.mean(axis=0), len(part)
        own_variance.append(part.var(axis=0))
        own = min(size, max(1, len(part) // 2))
        halves = part[: len(part) // own * own].reshape(-1, own, 3).mean(axis=1)
        steps = np.diff(halves, axis=0)
        square += (steps**2).sum(axis=0) * own
        pairs += len(steps)
    if not own_variance:
        return means, means.copy(), np.zeros_like(means)
    variance = square / (2.0 * pairs) if pairs else np.full(3, np.nan)  # of a sample with the noise of a half second
    seen = np.isfinite(means)
    error = step_error(step, np.mean(own_variance, axis=0))
    return means, np.where(seen, variance / np.maximum(counts, 1.0)[:, None], np.nan), np.where(seen, error, np.nan)


def step_error(step: FloatArray, variance: FloatArray) -> FloatArray:
    """Return what the steps of a converter leave in a mean at a level that may be anywhere between two codes.

    Noise of deviation s before a converter of step q blurs its steps. Over all levels, the mean reading is off with variance
    ``B2(s) = sum over k of (q / pi k)^2 / 2 exp(-4 pi^2 k^2 s^2 / q^2)``, and the readings scatter by ``s^2 + q^2 / 12 - B2(s)``.

    Parameters
    ----------
    step : array, shape (3,)
        q, raw unit; 0 where there is none.
    variance : array, shape (3,)
        Of the readings at one level, raw unit squared.

    Returns
    -------
    array, shape (3,)
        Root of B2, raw unit: 0.29 q without noise, 0.01 q for noise of 0.4 q.
    """
    blur = np.linspace(0.0, 1.5, 151)  # s / q
    order = np.arange(1, 60)[:, None]
    left = ((1.0 / (np.pi * order)) ** 2 / 2.0 * np.exp(-4.0 * np.pi**2 * order**2 * blur**2)).sum(axis=0)
    seen = np.maximum.accumulate(blur**2 + 1.0 / 12.0 - left)
    scaled = np.where(step > 0.0, variance / np.where(step > 0.0, step, 1.0) ** 2, np.inf)
    return np.asarray(step * np.sqrt(np.interp(scaled, seen, left, right=0.0)))


def _clean(part: FloatArray) -> BoolArray:
    finite: BoolArray = np.asarray(np.isfinite(part).all(axis=1))
    if not finite.any():
        return finite
    middle = np.median(part[finite], axis=0)
    off = np.abs(part - middle)
    deviation = np.maximum(_ROBUST * np.median(off[finite], axis=0), _step(part[finite]))
    good: BoolArray = np.asarray(finite & (off <= _FAR * deviation).all(axis=1))
    return good


def _step(part: FloatArray) -> FloatArray:
    # The least step between readings of each axis: a converter whose noise is below one code has no median deviation.
    steps = [np.diff(np.unique(column)) for column in part.T]
    return np.array([float(s.min()) if len(s) else 0.0 for s in steps])


def _slope(time: FloatArray, temp: FloatArray, middle: float, span_s: float) -> float:
    """Return the slope of the temperature about a moment, degC/min."""
    start, stop = np.searchsorted(time, (middle - 0.5 * span_s, middle + 0.5 * span_s))
    known = np.isfinite(temp[start:stop])
    t, y = time[start:stop][known], temp[start:stop][known]
    if len(t) < 2:
        return 0.0
    t = t - t.mean()
    return float(60.0 * (t @ (y - y.mean())) / (t @ t))
