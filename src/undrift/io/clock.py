"""A regular clock for readings with time stamps of the host that received them, in files and live (live/clock.py).

    t_k = a + n_k / f + d_k        n_k sample number on the device's clock, f its rate, d_k >= 0 delay of the time stamp

Packets arrive late but never early. Therefore the device's clock is the line below all points (n, t) with the smallest sum of
distances, min sum(t_k - a - n_k / f). It is the edge of the lower convex hull that spans the mean of n [1]_. A constant delay
cannot be determined.

In a file, n_k is the row number plus the number of samples that were lost before it. The device's counter determines the losses.
Without a counter, a loss is a lasting increase of the smallest delay:

    step_k = min(d after k) - min(d up to k)        over several bursts on either side; lost = round(step f)

Losses and rate are determined alternately until they do not change. A loss within a step of 0.7 samples or less is not detected.

.. [1] S. B. Moon, P. Skelly and D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray, IntArray, runs
from undrift.errors import InputError

LEAST_SAMPLES = 100  # smallest number of samples for a rate
_SEEN = 0.7  # share of a sample: a smaller step is not counted as a loss
_SURE = 1.5  # the same limit in the first round, in which the rate is still rough
_BURSTS = 25  # multiple of the longest usual step: number of samples on either side of a loss that determine the smallest delay
_STRETCHES = 100
_GAP = 1.5  # longest step between two readings, in usual steps; a longer step is a drop-out
_ROUNDS, _SLOPES = 12, 3
_LONGEST_LOSS = 0.5  # largest share of lost samples in a recording


# ---- Lower convex hull of (device time, host time).

Point = tuple[float, float]  # device time, s or samples, and host time, s


def extend_hull(hull: list[Point], point: Point) -> None:
    """Add a point to the right of a lower convex hull."""
    if hull and point[0] <= hull[-1][0]:
        if point[1] >= hull[-1][1]:
            return
        hull.pop()
    while len(hull) >= 2:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (y1 - y0) * (point[0] - x0) < (point[1] - y0) * (x1 - x0):
            break
        hull.pop()
    hull.append(point)


def slope_at(hull: list[Point], x: float, single: float = 0.0) -> float:
    """Return the slope of the hull's edge at x, or `single` for a hull of one point."""
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x <= x1:
            return (y1 - y0) / (x1 - x0)
    return single


# ---- Clock of a file.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockFit:
    """A regular clock and the residuals of the time stamps."""

    time: FloatArray  # (N,), s, strictly increasing: earliest possible time stamp of each sample
    sample_rate_hz: float  # sample rate of the device, measured with the host's clock
    offset_s: float  # time of the first sample, s
    jitter_s: float  # delay relative to the promptest time stamp that 95 % of time stamps do not exceed, s
    gaps: int  # number of stretches with missing samples
    missing: int  # number of missing samples
    counted: bool  # True if a counter determines the missing samples

    @property
    def longest_step_s(self) -> float:
        """Return the longest time from one sample to the next, s."""
        return float(np.diff(self.time).max())


def fit_clock(stamps: FloatArray, counter: FloatArray | None = None) -> ClockFit:
    """Fit a regular clock to time stamps (N,), s, which never decrease, and to the device's counter (N,) if there is one."""
    if len(stamps) < LEAST_SAMPLES:
        raise InputError(
            f"clock: expected {LEAST_SAMPLES} samples or more for a regular clock, got {len(stamps)}. Set "
            "sample_rate_hz and map no time column."
        )
    if (np.diff(stamps) < 0.0).any():
        row = int(np.flatnonzero(np.diff(stamps) < 0.0)[0]) + 1
        raise InputError(
            f"clock: expected increasing time stamps, got {stamps[row - 1]:.9g} s then {stamps[row]:.9g} s in data row {row + 1}. "
            "Set repair_time = true to drop such rows."
        )
    elapsed = stamps - stamps[0]
    number = np.arange(len(elapsed)) if counter is None else unwrapped(counter)
    width = _width(elapsed)
    step = _rough_step(elapsed, number, width)
    for count in range(_ROUNDS if counter is None else 0):
        up, step = _steps_up(elapsed, number, step, width)
        new_losses = _losses(elapsed, up, step, _SEEN if count else _SURE)
        gone = np.diff(number) - 1
        over = (gone > 0) & (up < -_SEEN * step)  # too many samples were counted as lost there
        new_losses[over] = np.maximum(np.rint(up[over] / step).astype(np.int64), -gone[over])
        number = number + np.concatenate(([0], np.cumsum(new_losses)))
        if count and not new_losses.any():
            break
    step, start = _line(elapsed, number, step, width)
    delay = elapsed - start - step * number
    lost = np.diff(number) - 1
    if lost.sum() > _LONGEST_LOSS * number[-1]:
        raise InputError(
            f"clock: expected a recording with most of its samples, got {int(lost.sum())} of {int(number[-1]) + 1} missing. Check "
            "the time column and the counter."
        )
    return ClockFit(
        time=stamps[0] + start + step * number,
        sample_rate_hz=1.0 / step,
        offset_s=float(stamps[0] + start),
        jitter_s=float(np.quantile(delay, 0.95)),
        gaps=int((lost > 0).sum()),
        missing=int(lost.sum()),
        counted=counter is not None,
    )


def _width(elapsed: FloatArray) -> int:
    """Return the number of samples that contain several bursts, so that one burst arrived promptly."""
    steps = np.diff(elapsed)
    return int(np.clip(_BURSTS * np.quantile(steps, 0.98) / max(steps.mean(), 1e-12), 10, len(elapsed) // 8))


def _rough_step(elapsed: FloatArray, number: IntArray, width: int) -> float:
    """Return the median time per sample over some bursts, because drop-outs affect only a few of them."""
    return float(np.median((elapsed[width:] - elapsed[:-width]) / (number[width:] - number[:-width])))


def _steps_up(elapsed: FloatArray, number: IntArray, step: float, width: int) -> tuple[FloatArray, float]:
    """Return the increase of the smallest delay in ``width`` samples from before to after each sample (N - 1,), s, and a better
    step.

    The median is robust, because most samples have no loss near them.
    """
    up = np.zeros(len(elapsed) - 1)
    for _ in range(_SLOPES):
        lowest = np.lib.stride_tricks.sliding_window_view(elapsed - step * number, width).min(axis=1)
        inner = lowest[width:] - lowest[:-width]
        wrong = float(np.median(inner))
        step += wrong / width
    up[width - 1 : len(elapsed) - width] = inner - wrong
    return up, step


def _line(elapsed: FloatArray, number: IntArray, step: float, width: int) -> tuple[float, float]:
    """Return step and start, s, of the line below the smallest delays of up to a hundred stretches."""
    edges = np.linspace(0, len(elapsed), int(np.clip(len(elapsed) // width, 4, _STRETCHES)) + 1).astype(np.int64)
    delay = elapsed - step * number
    hull = list[Point]()
    for low, high in pairwise(edges.tolist()):
        least = low + int(delay[low:high].argmin())
        extend_hull(hull, (float(number[least]), float(delay[least])))
    slope = slope_at(hull, float(number.mean()))
    return step + slope, min(y - slope * x for x, y in hull)


def _losses(elapsed: FloatArray, up: FloatArray, step: float, least: float) -> IntArray:
    """Return the number of samples lost between neighbours (N - 1,). A loss is a lasting increase of the smallest delay."""
    lost = np.zeros(len(up), np.int64)
    for first, last in runs(up > least * step).tolist():
        at = first + int(np.diff(elapsed)[first:last].argmax())
        lost[at] = round(float(up[at]) / step)  # further on, a second loss may add to the first
    return lost


# ---- time stamps of a host


_UNEVEN = (0.5, 1.5)  # limits relative to the mean step, beyond which one of ten steps lies
_CATCHES_UP = 0.35  # variance of the time over many samples, divided by the variance of independent steps
_SPAN = 64  # samples
_NORMAL = 2.563  # standard deviations between the 10 % and 90 % quantiles of a normal distribution


def host_clock(stamps: FloatArray) -> ClockFit | None:
    """Return the regular clock for time stamps of a host, or None for other time stamps.

    Time stamps of a host are uneven, and a late time stamp is followed by a short step.
    """
    if len(stamps) < LEAST_SAMPLES:
        return None
    steps = np.diff(stamps)
    low, high = np.quantile(steps, (0.1, 0.9))
    mean = _rough_step(stamps, np.arange(len(stamps)), _width(stamps))
    if low > _UNEVEN[0] * mean and high < _UNEVEN[1] * mean:
        return None
    over = np.quantile(stamps[_SPAN:] - stamps[:-_SPAN], (0.1, 0.9))  # longer steps are drop-outs
    step_variance = float(steps[steps <= np.quantile(steps, 0.99)].var())
    if (float(np.ptp(over)) / _NORMAL) ** 2 > _CATCHES_UP * _SPAN * step_variance:
        return None
    try:
        return fit_clock(stamps)
    except InputError:
        return None


# ---- counters

_OFTEN = 0.05  # share of the rows: a step this frequent is one sample, or a few samples if some are lost
_WHOLE_BITS = 0.95  # share of a power of two: the counter has this number of bits, and samples are lost at each wrap
_DECIMAL = (100, 1000, 10_000, 100_000)


def unwrapped(counter: FloatArray) -> IntArray:
    """Return the number of each sample (N,) from a counter (N,) that increases with each sample and may wrap."""
    if not np.isfinite(counter).all():
        raise InputError(
            f"counter: expected a number in every row, got {int((~np.isfinite(counter)).sum())} empty cells. Repair the file."
        )
    steps: IntArray = np.asarray(np.rint(np.diff(counter)), np.int64)
    sizes, times = np.unique(steps[steps > 0], return_counts=True)
    often = sizes[times >= _OFTEN * len(steps)]
    usual = int(np.gcd.reduce(often)) if len(often) else 0
    if usual not in often:
        raise InputError(
            f"counter: expected an increase with every sample, got {len(sizes)} different steps and "
            f"{int((steps == 0).sum())} samples without a step. Name a counter of samples, or omit the counter."
        )
    if (steps < 0).any():
        size = usual - int(steps.min())  # size of a wrap without lost samples
        bits = 1 << (size - 1).bit_length()
        alone = (steps == steps.min()).sum() == 1 and size not in _DECIMAL
        steps = np.where(steps < 0, steps + (bits if alone and size > _WHOLE_BITS * bits else size), steps)
    wrong = np.flatnonzero((steps <= 0) | (steps % usual != 0))
    if len(wrong):
        row = int(wrong[0]) + 1
        raise InputError(
            f"counter: expected an increase of {usual} with every sample, got {counter[row - 1]:g} then {counter[row]:g} in "
            f"data row {row + 1}. Name a counter of samples, or omit the counter."
        )
    return np.concatenate(([0], np.cumsum(steps // usual)))


def onto_clock(time: FloatArray, source_time: FloatArray, values: FloatArray) -> tuple[FloatArray, int]:
    """Interpolate readings (M, K) at times ``own`` (M,) onto ``time`` (N,), and return how many samples are gaps.

    A sample becomes a gap (NaN) if the readings on either side of it are more than 1.5 usual steps apart.
    """
    out = np.stack([np.interp(time, source_time, column) for column in values.T], axis=1)
    steps = np.diff(source_time)
    after = np.clip(np.searchsorted(source_time, time), 1, len(steps))
    inside = (
        (steps[after - 1] > _GAP * np.median(steps)) & (time > source_time[after - 1]) & (time < source_time[after])
    )
    out[inside] = np.nan
    return out, int(inside.sum())
