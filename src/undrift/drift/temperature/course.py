"""Course: the temperature of a board is a smooth function of time, found from readings that are noisy or come in steps.

Noise that blurs the steps is smoothed: block means y_i with variance s^2 / n_i of a curve g whose second derivative is white noise
of density q, so that g is the natural cubic smoothing spline with stiffness l = s^2 / q [1]_::

    g = y - l W^-1 Q c,   (R + l Q^T W^-1 Q) c = Q^T y        Q second divided differences, R their tent functions

The stiffness is the likeliest one: Q^T y has the covariance q R + s^2 Q^T W^-1 Q whatever level and slope are, and one banded
factor gives its likelihood. Time may be uneven.

Steps that no noise blurs hold no more than the moments at which they change: there the temperature is midway between two steps.
A monotone cubic joins those moments.

References
----------
.. [1] P. J. Green, B. W. Silverman, "Nonparametric Regression and Generalized Linear Models", 1994, section 2.3.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undrift.arrays import BoolArray, FloatArray

MOST_BLOCKS = 4000
BLOCK_S = 1.0  # a board does not warm and cool within a second
FEWEST_BLOCKS = 200
STIFFNESS = np.geomspace(1e-3, 1e13, 49)  # s^3, in means of one reading: from no smoothing to a straight line over days
BLURRED = 0.35  # of a step: where the scatter of readings, steps included, is larger, their mean tells no step
MOVING = 0.35  # uncertainty where steps follow each other, over that of one step by itself
CHATTER = 0.25  # of the time to the next step: crossings closer than that are noise
SAME_STEP = 0.02  # of a step: how far a column may be from whole steps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """A temperature over time.

    Parameters
    ----------
    temp_c : array, shape (N,)
        degC.
    uncertainty_c : float
        Standard uncertainty, root-mean-square over the record, K.
    noise_c : float
        Standard deviation of one reading, K.
    """

    temp_c: FloatArray
    uncertainty_c: float
    noise_c: float


def step_of(temp_c: FloatArray) -> float:
    """Return the step in which readings come.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Without NaN, degC.

    Returns
    -------
    float
        K; 0 where there is none, or where a single value leaves it open.
    """
    values = np.unique(temp_c)
    if len(values) < 2 or len(values) > max(2, len(temp_c) // 4):
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * np.abs(values).max()]
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if (off < SAME_STEP * np.maximum(gaps / step, 1.0)).mean() > 0.95 else 0.0


def noise_of(temp_c: FloatArray, step_c: float) -> float:
    """Return the standard deviation of one reading, from the differences of neighbours.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Without NaN, degC.
    step_c : float
        Step of the readings, K.

    Returns
    -------
    float
        K. Where it blurs the steps, their own step / sqrt(12) is in it.
    """
    if len(temp_c) < 3:
        return 0.0
    bend = np.diff(temp_c, 2)
    size = np.sort(np.abs(bend))[: max(2, int(0.99 * len(bend)))]  # without what stands alone
    both = float(np.sqrt(np.mean(size**2) / 6.0))
    return both if step_c == 0.0 or both >= BLURRED * step_c else both**2 / step_c * math.sqrt(math.pi)


def find_course(temp_c: FloatArray, time: FloatArray, step_c: float) -> Course:
    """Return the smooth course behind readings.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Without NaN, degC.
    time : array, shape (N,)
        s, increasing.
    step_c : float
        Step of the readings, K; 0 for none.

    Returns
    -------
    Course
        At the same times.
    """
    noise = noise_of(temp_c, step_c)
    if len(temp_c) < 8 or np.ptp(temp_c) == 0.0:
        return Course(temp_c=temp_c, uncertainty_c=math.hypot(noise, step_c / math.sqrt(12.0)), noise_c=noise)
    if step_c > 0.0 and noise < BLURRED * step_c:
        return _between_steps(temp_c, time, step_c, noise)
    return _smoothed(temp_c, time, noise, step_c)


def _smoothed(temp_c: FloatArray, time: FloatArray, noise: float, step: float) -> Course:
    from scipy.interpolate import CubicSpline

    t, y, count = block_means(time, temp_c)
    g, variance = smoothing_spline(t, y, count)
    spline = CubicSpline(t, g, bc_type="natural")
    course = np.asarray(spline(np.clip(time, t[0], t[-1])))
    for end, out in ((0, time < t[0]), (-1, time > t[-1])):  # straight on over the half block at each end
        course[out] = g[end] + spline(t[end], 1) * (time[out] - t[end])
    ripple = 0.0  # what noise s leaves of the steps in a mean: step / pi exp(-2 pi^2 s^2 / step^2), a sine of the temperature
    if step > 0.0:
        blur = max(noise**2 / step**2 - 1.0 / 12.0, 0.0)
        ripple = step / math.pi * math.exp(-2.0 * math.pi**2 * blur) / math.sqrt(2.0)
    return Course(temp_c=course, uncertainty_c=math.hypot(math.sqrt(variance), ripple), noise_c=noise)


def block_means(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means over blocks of a second or so; an empty stretch makes no block.

    Parameters
    ----------
    time : array, shape (N,)
        s, increasing.
    values : array, shape (N,)
        Without NaN.

    Returns
    -------
    time, values, count : array, shape (n,)
        Mean time s, mean value, and readings in each block.
    """
    span = float(time[-1] - time[0])
    width = max(min(BLOCK_S, span / FEWEST_BLOCKS), span / MOST_BLOCKS)
    number = np.floor((time - time[0]) / width).astype(np.int64)
    first = np.flatnonzero(np.concatenate(([True], np.diff(number) > 0)))
    count = np.diff(np.append(first, len(time))).astype(np.float64)
    return np.add.reduceat(time, first) / count, np.add.reduceat(values, first) / count, count


def smoothing_spline(t: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Return the values of the likeliest natural cubic smoothing spline at its knots.

    Parameters
    ----------
    t : array, shape (n,)
        s, increasing, n of 4 or more.
    y : array, shape (n,)
        Means.
    weight : array, shape (n,)
        Readings in each mean.

    Returns
    -------
    values : array, shape (n,)
        Of the spline, in the unit of y.
    variance : float
        Mean of their variances, the unit of y squared.
    """
    h = np.diff(t)
    bend, second = _bands(h, weight)
    z = np.diff(np.diff(y) / h)
    found = [_likelihood(bend, second, z, stiffness) for stiffness in STIFFNESS]
    best = int(np.argmax([likelihood for likelihood, _, _ in found]))
    _, c, variance = found[best]
    pad = np.concatenate(([0.0], c, [0.0]))
    pull = np.diff(np.concatenate(([0.0], np.diff(pad) / h, [0.0])))  # Q c
    free = _freedom(bend, second, STIFFNESS[best])
    return y - STIFFNESS[best] * pull / weight, float(variance / weight.mean() * free / len(t))


def _bands(h: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R and Q^T W^-1 Q as upper bands, shape (3, n - 2)."""
    n = len(h) - 1
    tents, differences = np.zeros((3, n)), np.zeros((3, n))
    tents[2] = (h[:-1] + h[1:]) / 3.0
    tents[1, 1:] = h[1:-1] / 6.0
    left, right = 1.0 / h[:-1], 1.0 / h[1:]
    middle = -(left + right)
    v = 1.0 / weight
    differences[2] = left**2 * v[:-2] + middle**2 * v[1:-1] + right**2 * v[2:]
    differences[1, 1:] = middle[:-1] * left[1:] * v[1:-2] + right[:-1] * middle[1:] * v[2:-1]
    differences[0, 2:] = right[:-2] * left[2:] * v[2:-2]
    return tents, differences


def _likelihood(
    tents: FloatArray, differences: FloatArray, z: FloatArray, stiffness: float
) -> tuple[float, FloatArray, float]:
    """Return log-likelihood, c, and the variance of a reading, for z = Q^T y with covariance s^2 (R / l + Q^T W^-1 Q)."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    factor = cholesky_banded(tents / stiffness + differences)
    c = cho_solve_banded((factor, False), z)
    variance = float(z @ c) / len(z)
    if variance <= 0.0:  # a straight line without noise
        return -math.inf, c / stiffness, 0.0
    likelihood = -0.5 * len(z) * math.log(variance) - float(np.log(factor[2]).sum())
    return likelihood, np.asarray(c) / stiffness, variance


def _freedom(tents: FloatArray, differences: FloatArray, stiffness: float) -> float:
    """Return the trace of the smoother: n - d log|R + l D| / d log l."""
    from scipy.linalg import cholesky_banded

    def half_log(x: float) -> float:
        return float(np.log(cholesky_banded(tents + x * differences)[2]).sum())

    step = 1e-3  # of the logarithm of the stiffness
    slope = 2.0 * (half_log(stiffness * (1.0 + step)) - half_log(stiffness * (1.0 - step))) / (2.0 * step)
    return float(tents.shape[1] + 2 - slope)


def _between_steps(temp_c: FloatArray, time: FloatArray, step: float, noise: float) -> Course:
    from scipy.interpolate import PchipInterpolator

    level = np.round((temp_c - temp_c.min()) / step)
    at, height, up = _crossings(level, time)
    half = np.where(up, 0.5, -0.5)
    course = np.empty(len(time))
    if len(at) == 0:
        course[:] = level.mean()
    else:
        t, y = _with_turns(at, height, half)
        if len(t) > 1:
            course[:] = PchipInterpolator(t, y)(np.clip(time, t[0], t[-1]))
        before, after = time < t[0], time > t[-1]
        course[before] = _fading(t[0] - time[before], t, y, height[0] - half[0])
        course[after] = _fading(time[after] - t[-1], t[::-1], y[::-1], height[-1] + half[-1])
        course[(time == t[0]) & (len(t) == 1)] = y[0]
    return Course(temp_c=temp_c.min() + step * course, uncertainty_c=_doubt(at, time) * step, noise_c=noise)


def _crossings(level: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return when a running mean of the steps passes midway between two of them, at which height, and whether upward."""
    from scipy.ndimage import median_filter

    span = float(time[-1] - time[0])
    passed, ref = [float(time[0])], level[0]
    calm = median_filter(level, size=9, mode="nearest")  # without single readings two steps off
    for k in np.flatnonzero(np.diff(calm)) + 1:
        if abs(calm[k] - ref) >= 2.0:  # two steps on: no chatter between neighbours
            passed.append(float(time[k]))
            ref = calm[k]
    dwell = 0.5 * float(np.quantile(np.diff(passed), 0.1)) if len(passed) > 1 else 0.2 * span
    mean = _running_mean(level, time, 0.25 * dwell)
    code = np.floor(mean + 0.5)
    at, height, up = [], [], []
    for k in np.flatnonzero(np.diff(code)):
        rising = bool(code[k + 1] > code[k])
        for between in np.arange(min(code[k], code[k + 1]), max(code[k], code[k + 1]))[:: 1 if rising else -1] + 0.5:
            part = (between - mean[k]) / (mean[k + 1] - mean[k])
            at.append(float(time[k] + part * (time[k + 1] - time[k])))
            height.append(float(between))
            up.append(rising)
    return _without_chatter(np.array(at), np.array(height), np.array(up, dtype=bool), span)


def _without_chatter(
    at: FloatArray, height: FloatArray, up: BoolArray, span: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the crossings with those that noise repeats made one, at their mean time; there and back makes two."""
    bounds = np.concatenate(([0], np.flatnonzero(np.diff(height)) + 1, [len(at)]))
    times, first = [], []
    for start, stop in pairwise(bounds.tolist()):
        if start == stop:
            continue
        stays = [at[start] - at[start - 1]] if start > 0 else []
        stays += [at[stop] - at[stop - 1]] if stop < len(at) else []
        near = CHATTER * float(np.mean(stays) if stays else span)
        cuts = np.flatnonzero(np.diff(at[start:stop]) >= near) + start + 1
        for group in np.split(np.arange(start, stop), cuts - start):
            if len(group) % 2 == 1:
                times.append(float(at[group].mean()))
                first.append(int(group[0]))
            elif (
                at[group[-1]] > at[group[0]]
            ):  # it touched the height and went back: both ends stay, or a slow end of the record would lose it
                times += [float(at[group[0]]), float(at[group[-1]])]
                first += [int(group[0]), int(group[-1])]
    return np.array(times), height[first], up[first]


def _running_mean(values: FloatArray, time: FloatArray, width: float) -> FloatArray:
    """Return the mean over a window of time around each sample, cut off at the ends of the record."""
    if width < 3.0 * float(np.median(np.diff(time))):
        return values
    total = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))))
    reach = np.minimum(0.5 * width, np.minimum(time - time[0], time[-1] - time))  # even on both sides: no shift
    inside = reach > 0.0
    wide = np.interp(time + reach, time, total) - np.interp(time - reach, time, total)
    return np.where(inside, wide / np.where(inside, 2.0 * reach, 1.0), values)


def _with_turns(at: FloatArray, height: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the crossings with points between two at one height, where the temperature turned or stayed."""
    t, y = [at[0]], [height[0]]
    for k in range(1, len(at)):
        if height[k] == height[k - 1]:
            stay = at[k] - at[k - 1]
            slope = max(_slope(at[k - 1 :: -1], height[k - 1 :: -1]), _slope(at[k:], height[k:]))
            rise = math.copysign(min(0.5, slope * stay / 3.0), half[k - 1])
            if rise != 0.0:
                aside = min(0.5 * stay, 1.5 * abs(rise) / slope)
                t += [at[k - 1] + aside] + ([at[k] - aside] if aside < 0.45 * stay else [])
                y += [height[k] + rise] * (2 if aside < 0.45 * stay else 1)
        t.append(at[k])
        y.append(height[k])
    return np.array(t), np.array(y)


def _fading(away: FloatArray, t: FloatArray, y: FloatArray, code: float) -> FloatArray:
    """Return the way on from the last crossing: the slope there, fading toward the middle of the step."""
    if len(away) == 0:
        return away
    room = code - y[0]
    slope = _slope(t, y) or 2.0 * abs(room) / float(away.max())
    return np.asarray(y[0] - room * np.expm1(-away * slope / abs(room)))


def _slope(t: FloatArray, y: FloatArray) -> float:
    """Return the size of the slope from the first point to the first at another height, steps/s; 0 where there is none."""
    other = np.flatnonzero(y != y[0])
    return float(abs((y[other[0]] - y[0]) / (t[other[0]] - t[0]))) if len(other) else 0.0


def _doubt(at: FloatArray, time: FloatArray) -> float:
    """Return the standard uncertainty of a temperature told by steps alone, in steps, root-mean-square over time."""
    stays = np.diff(np.concatenate((time[:1], at, time[-1:])))
    usual = 3.0 * float(np.median(stays))
    long = float(stays[stays > usual].sum()) / float(stays.sum())
    return math.sqrt((long + (1.0 - long) * MOVING**2) / 12.0)
