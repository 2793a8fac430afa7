"""Segments: where in a record the device stood still, turned at a steady rate, or was moved from one pose to the next.

Ranges are [start, stop). Stillness of a triad at sample k is the sliding standard deviation of its reading y, smoothed over
``smooth_s``: d_k^2 = sum over axes of var(y over the window centred at k). Smoothing averages white noise out and keeps what a
hand or a body does. The threshold comes from the data: at rest log d has one narrow peak at the noise floor, motion lies
decades above, and the threshold is the emptiest place between the two. Without such a gap there is no still phase. A steady
turn is a stretch where the smoothed rate r, less the offset at rest, is far from zero and steady::

    |r| > least_floors * floor        d <= max(steadiness * |r|, 4 floor)

Where that search finds too few poses, ``find_poses`` tries windows of 0.2 to 2 s with thresholds of 3 to 64 noise floors and takes
the count of poses that most of them agree on: what is a pose is one at many windows and thresholds, what is noise or a slow
moment of a move is not.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs, window_sums
from undrift.errors import InputError
from undrift.record import FACES, Axis, Face, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- still phases

# A device at rest varies less than this within a window, in physical units: rms of three axes after smoothing. Benches and
# hands that rest on something give 0.02-0.6 deg/s and 0.01-0.06 m/s2; a person who stands or sits gives more.
BENCH_RATE_LIMIT = 0.7 * RADIAN_PER_DEGREE  # rad/s
BENCH_ACCEL_LIMIT = 0.1  # m/s2
LARGEST_OFFSET = 40.0 * RADIAN_PER_DEGREE  # rad/s; no gyroscope of this class is off by more at rest

FLOOR_QUANTILE = 0.005  # of d: the level of the quietest windows
_PEAK = 4.0  # a noise peak spans at most this factor above its floor
_DECADES = (0.4, 2.2)  # where to look for the gap, decades above the floor
_BIN = 0.05  # decades
_GAP_DEPTH = 0.5  # the gap is at most this share as dense as the lower of its neighbouring peaks
_WHITE = 8.0  # in counts no limit is known: one peak this far above its white noise is motion, not rest
_ALL_NOISE = 1.5  # a floor within this factor of the white noise holds no motion
_NOISE = 2.5  # white noise in a window spreads by up to this factor over that in the quietest
_MOST_NOISE = 12.0  # limits; readings with more noise than that tell nothing
_TURNING = 20.0  # a mean reading this many floors away from the quietest windows' is a turn, not an offset


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSettings:
    """How still phases are found.

    Parameters
    ----------
    window_s : float
        Length of the sliding window, s. Longer is more certain and loses short pauses.
    smooth_s : float
        Averaging before the spread is taken, s. Longer tolerates noise and vibration.
    min_duration_s : float
        Shortest still phase kept, s; the stretch around it is one window longer.
    gyro_threshold, accel_threshold : float or None
        Threshold on d in the record's unit; None to find it in the data.
    threshold_floors : float or None
        Threshold on d of both triads as a multiple of their noise floors; None to find it in the data.
    adapt : bool
        Where too few poses are found, try windows of 0.2 to 2 s, and other thresholds where none is given.

    Examples
    --------
    >>> import undrift
    >>> undrift.StillSettings(window_s=0.5).window_s
    0.5
    """

    window_s: float = 1.0
    smooth_s: float = 0.1
    min_duration_s: float = 1.0
    gyro_threshold: float | None = None
    accel_threshold: float | None = None
    threshold_floors: float | None = None
    adapt: bool = False

    def __post_init__(self) -> None:
        least = min(self.window_s, self.smooth_s, self.min_duration_s)
        given = (self.gyro_threshold, self.accel_threshold, self.threshold_floors)
        if not least > 0.0 or any(value is not None and not value > 0.0 for value in given):
            raise InputError(
                "stills: wanted window, smoothing, shortest duration and thresholds above 0, got "
                f"{self.window_s:g} s, {self.smooth_s:g} s, {self.min_duration_s:g} s and "
                f"{', '.join('none' if value is None else f'{value:g}' for value in given)}; correct them"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class StillThreshold:
    """The threshold of one triad and where it came from."""

    channel: Literal["gyro", "accel"]  # gyro or accel
    value: float  # Largest spread d of a still window, in ``unit``; NaN where none could be found
    unit: str  # Unit of the record's channel
    noise_floor: float  # Spread of the quietest windows, in ``unit``
    # gap (between two peaks), all still, given, limit (what a bench allows), floors (a multiple of the noise floor that
    # gives the poses most windows agree on), or none
    basis: Literal["gap", "all still", "given", "limit", "floors", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSearch:
    """Still phases and how they were separated from motion."""

    stills: tuple[Still, ...]  # In order of time, without faces
    thresholds: tuple[StillThreshold, ...]  # One for each triad of the record
    window_s: float  # Window used, s
    settings: StillSettings  # Window, smoothing and shortest duration used
    reason: str = ""  # Why there is none; "" when there is one or more


def find_still(
    record: Record, settings: StillSettings = StillSettings(adapt=True), *, recording: int = 0
) -> StillSearch:
    """Find the stretches in which the device did not move.

    A sample is still when the window centred at it is quiet in every triad and the mean rate reading is that of the
    quietest windows (a steady turn is not a still phase). Half a window is lost at each end of a phase, on purpose.

    Parameters
    ----------
    record : Record
        Any units, either triad may be missing.
    settings : StillSettings
        Window and thresholds; by default a window of 1 s, and where that finds too few poses, others of 0.2 to 2 s.
    recording : int
        Number of the record in its session, written into each Still.

    Returns
    -------
    StillSearch
        Phases, thresholds with unit and basis, and a reason where there is none.

    Raises
    ------
    InputError
        The record is shorter than one window.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(1)
    >>> gyro = np.repeat([0.01, 2.0, 0.01], 500)[:, None] * rng.standard_normal((1500, 3))
    >>> record = undrift.Record(time=np.arange(1500) / 100.0, gyro=gyro)
    >>> [(still.start, still.stop) for still in undrift.find_still(record).stills]
    [(0, 446), (1054, 1500)]
    """
    if not settings.adapt:
        return _find(record, _moments(record, settings), settings, recording)
    (found,) = find_poses((record,), settings)
    if not found.stills:  # the noise of the readings may hide a rest
        over = _find(record, _moments(record, settings), settings, recording, over_noise=True)
        found = over if over.stills else found
    return replace(found, stills=tuple(replace(still, recording=recording) for still in found.stills))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Moments:
    """What the windows of one triad hold."""

    is_gyro: bool
    unit: str
    values: FloatArray  # (N, 3)
    mean: FloatArray  # (M, 3)
    spread: FloatArray  # (M,)
    window: int  # samples
    smooth: int  # samples


def _moments(record: Record, settings: StillSettings) -> tuple[_Moments, ...]:
    fs = record.sample_rate_hz
    window, smooth = sample_count(settings.window_s, fs), max(1, round(settings.smooth_s * fs))
    if len(record) < window + smooth:
        raise InputError(
            f"find_still: wanted a record longer than one window of {settings.window_s:g} s, got {record.duration_s:.2f} s; "
            "record for longer, or find still phases with a shorter window_s"
        )
    triads: list[_Moments] = []
    for is_gyro, values, unit in ((True, record.gyro, record.gyro_unit), (False, record.accel, record.accel_unit)):
        if values is not None:
            mean, spread = sliding_moments(values, window, smooth)
            triads.append(
                _Moments(
                    is_gyro=is_gyro, unit=unit, values=values, mean=mean, spread=spread, window=window, smooth=smooth
                )
            )
    return tuple(triads)


def _find(
    record: Record, triads: tuple[_Moments, ...], settings: StillSettings, recording: int, *, over_noise: bool = False
) -> StillSearch:
    """Search with one window; ``over_noise`` counts what a bench allows from the white noise of the readings."""
    quiet = np.ones(len(triads[0].spread) if triads else 0, bool)
    thresholds: list[StillThreshold] = []
    for triad in triads:
        threshold = _threshold(triad, settings, over_noise=over_noise)
        if threshold.basis == "all still" and not is_physical(triad.unit):
            # The spread of white noise alone after smoothing, from the steps between neighbouring samples.
            steps = np.diff(triad.values, axis=0)
            white = float(np.sqrt(np.nanvar(steps, axis=0).sum() / 2.0 / triad.smooth))
            if float(np.median(triad.spread)) > _WHITE * white:
                threshold = replace(threshold, value=np.nan, basis="none")
        thresholds.append(threshold)
        if threshold.basis != "none":
            quiet &= triad.spread <= threshold.value
            if triad.is_gyro:
                quiet &= ~_turning(triad.mean, triad.spread, threshold)
    if all(t.basis == "none" for t in thresholds) or any(t.value < t.noise_floor for t in thresholds):
        quiet[:] = False
    fs = record.sample_rate_hz
    edge = (triads[0].window + triads[0].smooth - 1) // 2 if triads else 0
    stills = _phases(quiet, len(record), edge, sample_count(settings.min_duration_s, fs), recording)
    return StillSearch(
        stills=stills,
        thresholds=tuple(thresholds),
        window_s=settings.window_s,
        settings=settings,
        reason="" if stills else _why_none(thresholds, triads, settings, quiet, fs),
    )


def sliding_moments(values: FloatArray, window: int, smooth: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean (M, 3) and the spread (M,) of every window of a smoothed triad (N, 3)."""
    gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
    centre = values[~gap].mean(axis=0) if (~gap).any() else np.zeros(3)
    smoothed = window_sums(np.where(gap[:, None], 0.0, values - centre), smooth) / smooth
    mean = window_sums(smoothed, window) / window
    variance = (window_sums(smoothed * smoothed, window) / window - mean * mean).sum(axis=1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    if gap.any():
        spread[window_sums(gap.astype(float)[:, None], window + smooth - 1)[:, 0] > 0.0] = np.inf
    return mean + centre, spread


def sample_count(seconds: float, sample_rate_hz: float) -> int:
    """Return a length of time in samples, two at least."""
    return max(2, round(seconds * sample_rate_hz))


def _threshold(triad: _Moments, settings: StillSettings, *, over_noise: bool) -> StillThreshold:
    spread, is_gyro, unit = triad.spread, triad.is_gyro, triad.unit
    given = settings.gyro_threshold if is_gyro else settings.accel_threshold
    finite = spread[np.isfinite(spread)]
    floor = float(np.quantile(finite, FLOOR_QUANTILE)) if len(finite) else np.inf
    threshold = StillThreshold(
        channel="gyro" if is_gyro else "accel", value=np.nan, unit=unit, noise_floor=floor, basis="none"
    )
    if given is not None:
        return replace(threshold, value=given, basis="given")
    if not len(finite):
        return threshold
    if settings.threshold_floors is not None:
        floor = max(floor, _quantisation(triad))
        return replace(threshold, value=settings.threshold_floors * floor, noise_floor=floor, basis="given")
    if (value := _gap_above(finite, floor)) is not None:
        threshold = replace(threshold, value=value, basis="gap")
    elif np.quantile(finite, 0.99) <= _PEAK * max(floor, np.finfo(float).tiny):
        threshold = replace(threshold, value=max(float(finite.max()), _PEAK * floor), basis="all still")
    if is_physical(unit):
        limit = BENCH_RATE_LIMIT / si_factor(unit, "rate") if is_gyro else BENCH_ACCEL_LIMIT / si_factor(unit, "accel")
        if over_noise and floor <= _ALL_NOISE * _white(triad):
            limit = _over_white(limit, triad)
            threshold = replace(threshold, value=limit, basis="limit")
        if threshold.value > limit:
            threshold = replace(threshold, value=limit, basis="limit")
    return threshold


def _over_white(limit: float, triad: _Moments) -> float:
    """Return the limit of a spread that holds white noise as well."""
    return float(np.hypot(limit, min(_NOISE * _white(triad), _MOST_NOISE * limit)))


def _white(triad: _Moments) -> float:
    """Return the spread that white noise leaves after smoothing, from the steps between samples in the quietest windows."""
    steps = np.diff(triad.values, axis=0)
    _, spread = sliding_moments(steps, min(triad.window, len(steps)), 1)
    finite = spread[np.isfinite(spread)]
    return float(np.quantile(finite, FLOOR_QUANTILE)) / np.sqrt(2.0 * triad.smooth) if len(finite) else 0.0


def _quantisation(triad: _Moments) -> float:
    """Return the spread that rounding leaves after smoothing, from the smallest steps between readings."""
    steps = np.abs(np.diff(triad.values, axis=0))
    steps = steps[steps > 0.0]
    return float(np.quantile(steps, 0.01)) * 0.5 / np.sqrt(triad.smooth) if len(steps) else 0.0  # sqrt(3 / 12) = 0.5


def _gap_above(spread: FloatArray, floor: float) -> float | None:
    # Density of log10(d / floor), smoothed; the threshold is its emptiest place with a peak on either side.
    positive = spread[spread > 0.0]
    if floor <= 0.0 or not len(positive):
        return None
    decades = np.log10(positive / floor)
    edges = np.arange(-1.0, 6.0, _BIN)
    density = np.histogram(decades, edges)[0].astype(float)
    kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
    density = np.convolve(density, kernel / kernel.sum(), mode="same")
    centre = 0.5 * (edges[1:] + edges[:-1])
    inside = np.flatnonzero((centre >= _DECADES[0]) & (centre <= _DECADES[1]))
    below = np.maximum.accumulate(density)[inside]
    above = np.maximum.accumulate(density[::-1])[::-1][inside]
    depth = density[inside] / np.minimum(below, above).clip(np.finfo(float).tiny)
    depth[(above <= 0.0) | (below <= 0.0)] = np.inf
    least = int(np.argmin(depth))
    if depth[least] > _GAP_DEPTH:
        return None
    return floor * float(10.0 ** centre[inside[np.flatnonzero(depth <= depth[least] + 1e-12)]].mean())


def _turning(mean: FloatArray, spread: FloatArray, threshold: StillThreshold) -> BoolArray:
    quiet = spread <= min(threshold.value, 2.0 * threshold.noise_floor)
    if is_physical(threshold.unit):
        x, y, z = np.abs(mean).T
        small = np.maximum(np.maximum(x, y), z) <= LARGEST_OFFSET / si_factor(threshold.unit, "rate")
        if not (quiet & small).any():
            return np.ones(len(mean), bool)
        quiet &= small
    if not quiet.any():
        return np.zeros(len(mean), bool)
    # A steady turn is off the offset throughout; the slow drift of a warm-up meets the offset somewhere in its stretch.
    x, y, z = np.abs(mean - np.median(mean[quiet], axis=0)).T
    far = np.maximum(np.maximum(x, y), z) > max(_TURNING * threshold.noise_floor, threshold.value)
    turning = np.zeros(len(mean), bool)
    for first, last in runs(spread <= threshold.value):
        turning[first:last] = far[first:last].all()
    return turning


def _phases(quiet: BoolArray, count: int, edge: int, shortest: int, recording: int) -> tuple[Still, ...]:
    spans = [
        (0 if first == 0 else int(first) + edge, count if last == len(quiet) else int(last) + edge)
        for first, last in runs(quiet)
    ]
    return tuple(Still(start=a, stop=b, recording=recording) for a, b in spans if b - a >= shortest)


# ---- rows that fill a file up: they repeat the first or the last reading, and nothing rests there

_PADDED_S, _PADDED = 0.2, 10  # shorter runs of one reading are chance
# The step from it and the changes of step beside it, over the steps there: a device that leaves its rest begins with smaller
# steps, and one without noise has smooth ones
_BREAKS = 0.1


def unpadded(record: Record) -> Record:
    """Return a record without the rows that repeat its first or last reading where others never repeat so long."""
    triads = [values for values in (record.gyro, record.accel) if values is not None]
    least = max(_PADDED, round(_PADDED_S * record.sample_rate_hz))
    ends = (slice(0, least + 1), slice(-least - 1, None))
    if not any(all((np.diff(each[end], axis=0) == 0.0).all() for each in triads) for end in ends):
        return record
    steps = np.diff(np.hstack(triads), axis=0)
    same, first, last = runs((steps == 0.0).all(axis=1)), 0, len(record)
    inner = max((stop - start for start, stop in same if start > 0 and stop < len(steps)), default=0)
    for start, stop in same:
        edge = start == 0 or stop == len(steps)
        if not edge or stop - start < max(least, 2 * inner) or stop - start == len(steps):
            continue
        beside = steps[stop : stop + least] if start == 0 else steps[start - least : start][::-1]
        if len(beside) < least:
            continue
        rough = np.minimum(np.abs(beside[0]), np.diff(beside[1:], 2, axis=0).std(axis=0))
        if np.median(rough / np.maximum(np.sqrt((beside**2).mean(axis=0)), 1e-300)) > _BREAKS:
            first, last = (stop, last) if start == 0 else (first, start + 1)
    return record if last - first == len(record) else record.part(first, last)


# Rates above this turn, rad/s, low-passed over 0.1 s and held for 0.5 s: noise and sway of a body stay below. 1 to 8 deg/s, 0.05 to
# 0.25 s and 0.2 to 1 s leave end errors of BROAD within 0.01 deg
TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S = 2.0 * RADIAN_PER_DEGREE, 0.1, 0.5
NOT_TURNING = (0.0, 0.0, 0.0, np.nan, -np.inf)  # state before the first sample


def find_turning(
    rate: FloatArray, time: FloatArray, state: tuple[float, ...] = NOT_TURNING
) -> tuple[FloatArray, tuple[float, ...]]:
    """Return 1 while a device turns, else 0, (N,), for rates (N, 3), rad/s; it looks back only, with a state from chunk to chunk.

    A turn shows once its low-passed rate is above: 0.02 s after the onset of 10 deg/s, 0.1 s of 3.2 deg/s; the end lags by the hold
    and 0.2 s after 20 deg/s, 0.5 s after 200 deg/s.
    """
    from undrift.kernels.correct import follow_turning

    out, after = np.empty(len(time)), np.array(state)
    settings = (TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S)
    follow_turning(np.ascontiguousarray(rate).reshape(-1), np.ascontiguousarray(time), *settings, after, out)
    return out, tuple(after.tolist())


def _why_none(
    thresholds: list[StillThreshold],
    triads: tuple[_Moments, ...],
    settings: StillSettings,
    quiet: BoolArray,
    sample_rate_hz: float,
) -> str:
    floors = " and ".join(f"{t.channel} {t.noise_floor:.3g} {t.unit}" for t in thresholds)
    over = [f"{t.value:.3g} {t.unit}" for t in thresholds if t.basis == "limit" and t.value < t.noise_floor]
    if over:
        why = f"too restless: a device at rest varies less than {' and '.join(over)}"
        if len(over) == 1 < len(thresholds) and over[0].endswith(" rad/s"):
            why += " while the accelerometer rests: is the gyroscope in deg/s, not rad/s?"
    elif all(t.basis == "none" for t in thresholds):
        usual = " and ".join(
            f"{np.median(m.spread):.3g} {m.unit} against a floor of {t.noise_floor:.3g}"
            for m, t in zip(triads, thresholds, strict=True)
        )
        why = f"no gap separates rest from motion; too restless: half of the windows vary by more than {usual}"
    else:
        longest = max((int(stop - start) for start, stop in runs(quiet)), default=0) / sample_rate_hz
        why = f"no stretch below the thresholds lasts {settings.min_duration_s:g} s; too short: the longest lasts {longest:.2g} s"
    return f"no still phase: the quietest {settings.window_s:g} s windows vary by {floors} rms, and {why}"


# ---- poses: still phases by the window and threshold that suit the recordings

WINDOWS_S = (2.0, 1.4, 1.0, 0.7, 0.5, 0.35, 0.2)
FLOORS = (3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
# A hand that holds a pose keeps below this over the noise: tremor and slow sway, rms of three axes after smoothing.
HAND_RATE_LIMIT = 6.0 * RADIAN_PER_DEGREE  # rad/s
HAND_ACCEL_LIMIT = 0.6  # m/s2
LEAST_POSES = 9  # free poses of a fit of nine parameters
_SAME = float(np.cos(5.0 * RADIAN_PER_DEGREE))  # neighbouring stills nearer than this are one pose
_APART = float(np.cos(20.0 * RADIAN_PER_DEGREE))  # poses farther apart tell a fit something new
_SPAN = 0.2  # smallest singular value of their directions: they lie all around, not in a plane
_NEAR = 4.0  # thresholds: a stretch as quiet as this may have been meant as a rest
_SHORT = 0.2  # of the window: how short pauses are looked for
_LOST = 2  # poses in short pauses that the first search misses; one fewer is no reason to try others
_ALL_STILL = 0.95  # of the samples: nothing moves, and no pose can be missing
_MOST = 200_000  # samples searched with every window; longer recordings are averaged
_TINY = float(np.finfo(float).tiny)


class _Poses:
    """The poses that stills of some recordings show, by the direction of gravity in each; sums are taken once."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.sums: list[tuple[FloatArray, FloatArray] | None] = []
        self.centred = all(is_physical(record.accel_unit) for record in records if record.accel is not None)
        for record in records:
            if record.accel is None:
                self.sums.append(None)
                continue
            seen = ~np.isnan(record.accel)
            parts = np.where(seen, record.accel, 0.0), seen.astype(float)
            total, count = (np.concatenate((np.zeros((1, 3)), np.cumsum(part, axis=0))) for part in parts)
            self.sums.append((total, count))

    def directions(self, searches: Sequence[StillSearch]) -> FloatArray:
        """Return the unit direction of gravity in each still of the records with accelerometers, (P, 3)."""
        means = [np.empty((0, 3))]
        for sums, search in zip(self.sums, searches, strict=True):
            if sums is not None and search.stills:
                start, stop = (np.array([getattr(s, end) for s in search.stills]) for end in ("start", "stop"))
                total, count = sums
                means.append((total[stop] - total[start]) / np.maximum(count[stop] - count[start], 1.0))
        up = np.concatenate(means)
        if not self.centred and len(up) >= 5:
            up = up - sphere_of(up)[0]
        length = np.linalg.norm(up, axis=1, keepdims=True)
        return np.asarray(up / np.where(length > 0.0, length, 1.0))

    def count(self, searches: Sequence[StillSearch]) -> int:
        """Return how many poses the stills show: neighbours that point alike are one."""
        count, last = 0, np.zeros(3)
        for one in self.directions(searches):
            if one @ last < _SAME:
                count, last = count + 1, one
        return count

    def enough(self, searches: Sequence[StillSearch]) -> bool:
        """Tell whether stills show all six faces, or nine poses that lie all around."""
        up, apart = self.directions(searches), list[FloatArray]()
        if not self.centred and len(up) < len(FACES):
            return False
        for one in up:
            if all(one @ other < _APART for other in apart):
                apart.append(one)
        if len(apart) < len(FACES):
            return False
        signed = np.concatenate((up, -up), axis=1)
        if (signed.max(axis=0) >= np.cos(_FACE_DEG * RADIAN_PER_DEGREE)).all():
            return True
        values = np.linalg.svd(np.array(apart) - np.mean(apart, axis=0), compute_uv=False) / np.sqrt(len(apart))
        return len(apart) >= LEAST_POSES and float(values[-1]) >= _SPAN


def find_poses(
    records: Sequence[Record], settings: StillSettings = StillSettings(adapt=True)
) -> tuple[StillSearch, ...]:
    """Find the stills of recordings that together show a device in many poses.

    First one window, with the threshold that the data show. With ``adapt``, where that finds too few poses or misses short pauses,
    every window with every threshold: of the searches that find poses all around, the count of poses that most agree on is
    taken; among those that give it the one with fewest interruptions, the lowest threshold, and the longest window.
    """
    moments = [_moments(record, settings) for record in records]
    first = tuple(_find(*pair, settings, number) for number, pair in enumerate(zip(records, moments, strict=True)))
    if not settings.adapt:
        return first
    poses = _Poses(records)
    over = tuple(
        own if own.stills else _find(record, triads, settings, number, over_noise=True)
        for number, (record, triads, own) in enumerate(zip(records, moments, first, strict=True))
    )
    over = over if poses.count(over) > max(1, poses.count(first)) else first
    enough = poses.enough(first)
    if _covered(records, over) > _ALL_STILL or (enough and not _misses_poses(records, first, poses, settings)):
        return over
    thin, factor = _thinned(records)
    tried = _most_agreed(thin, settings)
    if tried is None:
        return over
    best = tuple(
        replace(
            search,
            stills=tuple(replace(s, start=factor * s.start, stop=min(factor * s.stop, len(r))) for s in search.stills),
        )
        for r, search in zip(records, tried, strict=True)
    )
    return best if not enough or poses.count(best) > poses.count(first) else over


def _covered(records: Sequence[Record], searches: Sequence[StillSearch]) -> float:
    """Return the share of the samples that lie in stills."""
    held = sum(still.stop - still.start for search in searches for still in search.stills)
    return held / sum(len(record) for record in records)


def _misses_poses(
    records: Sequence[Record], searches: Sequence[StillSearch], poses: _Poses, settings: StillSettings
) -> bool:
    """Tell whether a search loses poses to noise near its limit, or in pauses shorter than its window."""
    if any(t.basis == "limit" and t.value < _NOISE * t.noise_floor for own in searches for t in own.thresholds):
        return True
    with_short = [
        replace(own, stills=tuple(sorted((*own.stills, *short_pauses(record, own, settings)), key=lambda s: s.start)))
        for record, own in zip(records, searches, strict=True)
    ]
    return poses.count(with_short) >= poses.count(searches) + _LOST


def _thinned(records: Sequence[Record]) -> tuple[tuple[Record, ...], int]:
    """Return records of at most ``_MOST`` samples together, each the mean of a factor of samples, 25 a second at least."""
    count, slowest = sum(len(record) for record in records), min(record.sample_rate_hz for record in records)
    factor = max(1, min(-(-count // _MOST), int(slowest / 25.0), min(len(record) for record in records) // 2))
    if factor == 1:
        return tuple(records), 1
    thin = []
    for record in records:
        rows = len(record) // factor
        triads = [
            None if values is None else values[: rows * factor].reshape(rows, factor, 3).mean(axis=1)
            for values in (record.gyro, record.accel)
        ]
        time = record.time[: rows * factor : factor]
        gyro_unit, accel_unit = record.gyro_unit, record.accel_unit
        thin.append(Record(time=time, gyro=triads[0], accel=triads[1], gyro_unit=gyro_unit, accel_unit=accel_unit))
    return tuple(thin), factor


def _most_agreed(records: Sequence[Record], settings: StillSettings) -> tuple[StillSearch, ...] | None:
    """Return the best of the searches with the most frequent count of poses, the larger where two are as frequent."""
    poses = _Poses(records)
    tried = [one for one in _tries(records, settings) if poses.enough(one[1])]
    if not tried:
        return None
    counts = [poses.count(searches) for _, searches in tried]
    most = max((times, count) for count, times in Counter(counts).items())[1]
    ranked = [
        (sum(len(search.stills) for search in searches), floors, -searches[0].window_s, k)
        for k, (floors, searches) in enumerate(tried)
        if counts[k] == most
    ]
    return tried[min(ranked)[-1]][1]


def short_pauses(record: Record, search: StillSearch, settings: StillSettings) -> tuple[Still, ...]:
    """Return pauses too short for a still, seen through a window of a fifth of its length."""
    if not search.stills:  # nothing shows what this device's rest looks like
        return ()
    window_s, least_s = _SHORT * settings.window_s, 0.5 * _SHORT * settings.min_duration_s
    shorter = replace(settings, window_s=window_s, min_duration_s=least_s, adapt=False)
    pauses = find_still(record, shorter, recording=search.stills[0].recording).stills
    return tuple(s for s in pauses if not any(s.start < o.stop and o.start < s.stop for o in search.stills))


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A quiet stretch that is no still phase."""

    start: int
    stop: int
    why: Literal["too short", "too restless", "turning"]
    value: float  # s at rest, smallest spread or that of the quietest windows, or mean rate
    unit: str
    limit: float  # What a still phase needs, in ``unit``; NaN where none is known


def left_out(record: Record, search: StillSearch) -> tuple[LeftOut, ...]:
    """Return the quiet stretches, up to four thresholds, that touch no still phase, and why they are none."""
    settings = search.settings
    triads, fs = _moments(record, settings), record.sample_rate_hz
    marks = [t.value if t.value >= t.noise_floor else 2.0 * t.noise_floor for t in search.thresholds]
    searched = [np.isfinite(t.value) for t in search.thresholds]
    used = [k for k, mark in enumerate(marks) if np.isfinite(mark) and mark > 0.0 and searched[k] >= any(searched)]
    noisy = [k for k in used if search.thresholds[k].noise_floor > search.thresholds[k].value]  # refuses every window
    if not used:
        return ()
    over = np.array([triads[k].spread / marks[k] for k in used])  # (triads, M)
    worst, edge, pauses = over.max(axis=0), (triads[0].window + triads[0].smooth - 1) // 2, list[LeftOut]()
    near: list[list[int]] = []
    for first, last in runs(worst <= _NEAR).tolist():
        if any(s.start < last + 2 * edge and first < s.stop for s in search.stills):
            continue
        if near and first - near[-1][1] <= triads[0].window:
            near[-1][1] = last  # a jerk in a pause parts it no further
        else:
            near.append([first, last])
    for first, last in near:
        start, stop = first + edge, last + edge
        at = first + int(np.argmin(worst[first:last]))
        k = noisy[0] if noisy else used[int(np.argmax(over[:, at]))]
        triad, mark, least_s = triads[k], search.thresholds[k], settings.min_duration_s
        rest = max((b - a for a, b in runs(worst[first:last] <= 1.0).tolist()), default=0)
        spread, rate = float(triad.spread[at]), float(np.linalg.norm(triads[0].mean[at]))
        spread, limit = max(spread, mark.noise_floor if noisy else 0.0), mark.value
        if not spread <= limit:
            why = LeftOut(start=start, stop=stop, why="too restless", value=spread, unit=triad.unit, limit=limit)
        elif rest < sample_count(least_s, fs):
            why = LeftOut(start=start, stop=stop, why="too short", value=rest / fs, unit="s", limit=least_s)
        else:
            why = LeftOut(start=start, stop=stop, why="turning", value=rate, unit=triads[0].unit, limit=np.nan)
        pauses.append(why)
    return tuple(pauses)


def _tries(records: Sequence[Record], settings: StillSettings) -> Iterator[tuple[float, tuple[StillSearch, ...]]]:
    """Search with every window and threshold; return multiple of the noise floor, and what each record holds."""
    given, shortest = settings.threshold_floors, min(record.duration_s for record in records)
    for window_s in WINDOWS_S:
        smooth_s = min(settings.smooth_s, window_s / 4.0)
        if shortest < 2.0 * (window_s + smooth_s):
            continue
        least_s = min(settings.min_duration_s, window_s)
        trial = replace(settings, window_s=window_s, smooth_s=smooth_s, min_duration_s=least_s)
        moments = [_moments(record, trial) for record in records]
        floors = [[_floor_and_limit(triad) for triad in triads] for triads in moments]
        for multiple in FLOORS if given is None else (given,):
            searches = []
            for number, (record, triads) in enumerate(zip(records, moments, strict=True)):
                marks: dict[str, float] = {}
                for triad, (floor, limit) in zip(triads, floors[number], strict=True):
                    name = "gyro_threshold" if triad.is_gyro else "accel_threshold"
                    if getattr(settings, name) is None:
                        marks[name] = multiple * floor if given is not None else min(multiple * floor, limit)
                here = replace(trial, threshold_floors=None, **{name: max(mark, _TINY) for name, mark in marks.items()})  # type: ignore[arg-type]
                search = _find(record, triads, here, number)
                basis: Literal["given", "floors"] = "floors" if given is None else "given"
                thresholds = tuple(
                    replace(t, basis=basis) if f"{t.channel}_threshold" in marks else t for t in search.thresholds
                )
                searches.append(replace(search, thresholds=thresholds))
            yield multiple, tuple(searches)


def _floor_and_limit(triad: _Moments) -> tuple[float, float]:
    """Return the noise floor, rounding included, and what a hand that holds a pose does: without limit in unknown units."""
    finite = triad.spread[np.isfinite(triad.spread)]
    floor = max(float(np.quantile(finite, FLOOR_QUANTILE)), _quantisation(triad)) if len(finite) else 0.0
    if not is_physical(triad.unit):
        return floor, np.inf
    kind: Literal["rate", "accel"] = "rate" if triad.is_gyro else "accel"
    limit = (HAND_RATE_LIMIT if triad.is_gyro else HAND_ACCEL_LIMIT) / si_factor(triad.unit, kind)
    return floor, _over_white(limit, triad)


# ---- faces: the sensor axis that points up, by gravity


_FACE_DEG = 15.0  # a face is this near to the vertical


def still_means(values: FloatArray, stills: Sequence[Still]) -> FloatArray:
    """Return the mean reading (P, 3) of each still phase, gaps left out."""
    for still in stills:
        if np.isnan(values[still.start : still.stop]).all(axis=0).any():
            raise InputError(
                f"still [{still.start}, {still.stop}): wanted readings, got nothing but gaps; choose another stretch"
            )
    return np.array([np.nanmean(values[s.start : s.stop], axis=0) for s in stills]).reshape(-1, 3)


def faces_of(means: FloatArray, *, centred: bool) -> tuple[Face | None, ...]:
    """Name the axis that points up for each mean reading (P, 3); None where none is near the vertical."""
    if not centred and len(means) < 5:
        raise InputError(
            f"faces: wanted five poses or more to find the zero of readings in counts, got {len(means)}; "
            "label the faces in session.toml"
        )
    up = means if centred else means - sphere_of(means)[0]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    axis = np.abs(up).argmax(axis=1)
    most = up[np.arange(len(up)), axis]
    near = np.abs(most) >= np.cos(_FACE_DEG * RADIAN_PER_DEGREE)
    return tuple(FACES[2 * a + (m < 0.0)] if n else None for a, m, n in zip(axis, most, near, strict=True))


def sphere_of(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of the sphere |p - c| = R: linear in c and R^2 - |c|^2; in the plane of flat poses."""
    mean = points.mean(axis=0)
    spread = float(np.abs(points - mean).max())
    p = (points - mean) / spread
    solution = np.linalg.lstsq(np.column_stack((2.0 * p, np.ones(len(p)))), (p**2).sum(axis=1), rcond=0.02)[0]
    radius = float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.01)))
    return mean + spread * solution[:3], spread * radius


# ---- turns: plateaus of constant rate, and rotations from one still phase to the next


_AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
_STEADY_S = 1.0  # length over which a rate must be steady, and shortest plateau
_AVERAGED_S = 0.1  # before the spread is taken
_STEADINESS = 0.05  # largest spread of a plateau as a share of its rate
_LEAST_FLOORS = 10.0  # a plateau or rotation must exceed this many noise floors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnSearch:
    """Steady turns and rotations found in a record, as the gyroscope read them; their true rates only the rig knows."""

    # Stretches of constant rate; ``axis`` is the sensor axis that reads most, ``turn_rate`` is left open
    plateaus: tuple[Turn, ...]
    plateau_rate: FloatArray  # (P, 3), mean reading of each less the offset at rest, gyro unit
    rotations: tuple[Turn, ...]  # Motions between one still phase and the next; ``angle`` is left open
    rotation_angle: FloatArray  # (R, 3), integral of each reading less the offset at rest, gyro unit times s


def find_turns(record: Record, stills: Sequence[Still]) -> TurnSearch:
    """Find plateaus of constant rate, and the rotations between still phases.

    Parameters
    ----------
    record : Record
        With gyroscope, any unit.
    stills : sequence of Still
        Still phases of this record, in order of time; they give the offset and bound the rotations.

    Returns
    -------
    TurnSearch
        Plateaus and rotations with what the gyroscope read.

    Raises
    ------
    InputError
        The record has no gyroscope.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> session = undrift.simulate_session("ferraris", device, rng=rng, labelled=False)
    >>> record = session.records[0]
    >>> found = undrift.find_turns(record, undrift.find_still(record).stills)
    >>> len(found.rotations)
    11
    """
    if record.gyro is None:
        raise InputError("find_turns: wanted a gyroscope, got a record without; map the gyro columns")
    fs = record.sample_rate_hz
    mean, spread = sliding_moments(record.gyro, sample_count(_STEADY_S, fs), max(1, round(_AVERAGED_S * fs)))
    seen, rest = np.isfinite(spread), [record.gyro[s.start : s.stop] for s in stills]
    floor = float(np.quantile(spread[seen], FLOOR_QUANTILE)) if seen.any() else np.inf  # none: a gap in each window
    usual = np.median(mean[seen], axis=0) if seen.any() else np.zeros(3)
    offset = np.nanmean(np.concatenate(rest), axis=0) if rest else usual
    plateaus, rates = _plateaus(record, (mean, spread), (offset, floor), stills)
    rotations, angles = _rotations(record, stills, offset, _LEAST_FLOORS * floor)
    return TurnSearch(plateaus=plateaus, plateau_rate=rates, rotations=rotations, rotation_angle=angles)


def _plateaus(
    record: Record, moments: tuple[FloatArray, FloatArray], rest: tuple[FloatArray, float], stills: Sequence[Still]
) -> tuple[tuple[Turn, ...], FloatArray]:
    (mean, spread), (offset, floor), gyro = moments, rest, np.asarray(record.gyro)
    rate, shortest = mean - offset, sample_count(_STEADY_S, record.sample_rate_hz)
    edge = (len(gyro) - len(rate)) // 2
    size = np.linalg.norm(rate, axis=1)
    steady = (size > _LEAST_FLOORS * floor) & (spread <= np.maximum(_STEADINESS * size, 4.0 * floor))
    for still in stills:
        steady[max(0, still.start - edge) : max(0, still.stop - edge)] = False
    turns: list[Turn] = []
    rates: list[FloatArray] = []
    for first, last in runs(steady):
        # A ramp at an end is trimmed off and a step between two rates cuts the run: both exceed the run's quietest quarter.
        own = spread[first:last]
        for start, stop in runs(own <= max(4.0 * float(np.quantile(own, 0.25)), 4.0 * floor)):
            begin = int(first + start) + edge if first + start else 0
            end = int(first + stop) + edge if first + stop < len(rate) else len(gyro)
            if end - begin < shortest:
                continue
            reading = np.nanmean(gyro[begin:end], axis=0) - offset
            axis = _AXES[int(np.argmax(np.abs(reading)))]
            turns.append(Turn(start=begin, stop=end, axis=axis, recording=stills[0].recording if stills else 0))
            rates.append(reading)
    return tuple(turns), np.array(rates).reshape(-1, 3)


def _rotations(
    record: Record, stills: Sequence[Still], offset: FloatArray, least: float
) -> tuple[tuple[Turn, ...], FloatArray]:
    rotations: list[tuple[Turn, FloatArray]] = []
    for before, after in itertools.pairwise(stills):
        reading = np.asarray(record.gyro)[before.stop : after.start] - offset
        if len(reading) and np.nanmax(np.linalg.norm(reading, axis=1)) > least:
            angle = np.asarray(np.trapezoid(np.nan_to_num(reading), record.time[before.stop : after.start], axis=0))
            share = np.abs(angle) / max(float(np.linalg.norm(angle)), np.finfo(float).tiny)
            axis: Axis | None = _AXES[int(np.argmax(share))] if share.max() > 0.9 else None
            rotations.append((Turn(start=before.stop, stop=after.start, axis=axis, recording=before.recording), angle))
    return tuple(turn for turn, _ in rotations), np.array([angle for _, angle in rotations]).reshape(-1, 3)
