"""Find the segments of a record: still phases, turns at a steady rate, and moves from one pose to the next.

Ranges are [start, stop). Stillness of a triad at sample k is the sliding standard deviation of its reading y, smoothed over
``smooth_s``: d_k^2 = sum over axes of var(y over the window centred at k). Smoothing averages out white noise and keeps the motion
of a hand or a body. The threshold is determined from the data. At rest, log d has a narrow peak at the noise floor. In motion, it
is decades higher. The threshold is the least frequent value between. Without such a gap there is no still phase. The threshold is
at most the limit of a bench, or of a hand if a bench would leave too few poses. In a steady turn the smoothed rate r minus the
offset at rest is far from zero and steady::

    |r| > least_floors * floor        d <= max(steadiness * |r|, 4 floor)
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs, window_sums
from undrift.errors import InputError
from undrift.record import FACES, Axis, Face, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- still phases

# Limits of the variation within a window at rest, in physical units: rms of three axes after smoothing. It is 0.02-0.6 deg/s and
# 0.01-0.06 m/s2 on benches or for hands on a support, and larger for a person in quiet stance or on a chair.
BENCH_RATE_LIMIT = 0.7 * RADIAN_PER_DEGREE  # rad/s
BENCH_ACCEL_LIMIT = 0.1  # m/s2
# limits for a pose in the hand: tremor and slow sway
HAND_RATE_LIMIT = 6.0 * RADIAN_PER_DEGREE  # rad/s
HAND_ACCEL_LIMIT = 0.6  # m/s2
LARGEST_OFFSET = 40.0 * RADIAN_PER_DEGREE  # largest offset of gyroscopes of this class at rest, rad/s

FLOOR_QUANTILE = 0.005  # quantile of d: level of the quietest windows
_PEAK = 4.0  # a noise peak spans at most this factor above its floor
_DECADES = (0.4, 2.2)  # range of the search for the gap, decades above the floor
_BIN = 0.05  # decades
_GAP_DEPTH = 0.5  # largest density of the gap, relative to the lower of its neighbouring peaks
_MOTION = 8.0  # for counts there is no known limit: a single peak this far above its white noise is motion, not rest
_ALL_NOISE = 1.5  # a floor within this factor of the white noise contains no motion
_NOISE = 2.5  # largest ratio of the white noise in a window to that in the quietest window
_MOST_NOISE = 12.0  # noise limit, in limits at rest (readings with more noise do not determine anything)
_TURNING = 20.0  # a mean reading this many floors away from the mean of the quietest windows is a turn, not an offset
BENCH_SHARE = 0.8  # share of still time within a hand's limits above which a bench's limits do not omit a pose


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSettings:
    """Settings of the search for still phases.

    Parameters
    ----------
    window_s : float
        Length of the sliding window, s. A longer window is more reliable but misses short pauses.
    smooth_s : float
        Averaging time before the spread is computed, s. A longer time tolerates more noise and vibration.
    min_duration_s : float
        Shortest still phase, s. The stretch around the phase is one window longer.
    threshold_floors : float or None
        Threshold on d of both triads as a multiple of their noise floors. None determines it from the data.

    Examples
    --------
    >>> import undrift
    >>> undrift.StillSettings(window_s=0.5).window_s
    0.5
    """

    window_s: float = 1.0
    smooth_s: float = 0.1
    min_duration_s: float = 1.0
    threshold_floors: float | None = None

    def __post_init__(self) -> None:
        for name in ("window_s", "smooth_s", "min_duration_s", "threshold_floors"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise InputError(f"stills: {name} must be above 0, got {value:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSearch:
    """Still phases of a record."""

    stills: tuple[Still, ...]  # in order of time, without faces
    reason: str = ""  # reason why there are no stills, or ""


def find_still(record: Record, settings: StillSettings = StillSettings(), *, recording: int = 0) -> StillSearch:
    """Find the stretches in which the device did not move.

    A sample is still if the window centred at it is quiet in every triad and its mean rate equals that of the quietest windows (a
    steady turn is not a still phase). Half a window at each end of a phase is deliberately not included.

    Parameters
    ----------
    record : Record
        Readings in any unit. Either triad may be missing.
    settings : StillSettings
        Window and thresholds, by default a window of 1 s and a threshold from the data.
    recording : int
        Number of the record in its session, stored in each Still.

    Returns
    -------
    StillSearch
        Phases, and the reason if there are no phases.

    Raises
    ------
    InputError
        The record is shorter than a window.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(1)
    >>> gyro = np.repeat([0.01, 2.0, 0.01], 500)[:, None] * rng.standard_normal((1500, 3))
    >>> record = undrift.Record(time=np.arange(1500) / 100.0, gyro=gyro)
    >>> [(still.start, still.stop) for still in undrift.find_still(record).stills]
    [(0, 446), (1054, 1500)]
    """
    return _find(record, settings, recording, BENCH_RATE_LIMIT, BENCH_ACCEL_LIMIT)


def find_poses(records: Sequence[Record], settings: StillSettings = StillSettings()) -> tuple[StillSearch, ...]:
    """Find the stills of recordings that together contain many poses of a device.

    The limits of a pose in the hand apply if the device is still for clearly longer within them than within the limits of a bench.
    """
    bench = tuple(find_still(record, settings, recording=number) for number, record in enumerate(records))
    limits = HAND_RATE_LIMIT, HAND_ACCEL_LIMIT
    hand = tuple(_find(record, settings, number, *limits) for number, record in enumerate(records))
    return bench if _still_samples(bench) >= BENCH_SHARE * _still_samples(hand) else hand


def _still_samples(searches: Sequence[StillSearch]) -> int:
    return sum(still.stop - still.start for search in searches for still in search.stills)


def _find(
    record: Record, settings: StillSettings, recording: int, rate_limit: float, accel_limit: float
) -> StillSearch:
    triads = _moments(record, settings)
    limits = [triad.limit(rate_limit, accel_limit) for triad in triads]
    thresholds = [_threshold(triad, settings, limit) for triad, limit in zip(triads, limits, strict=True)]
    restless = [triad.floor > threshold for triad, threshold in zip(triads, thresholds, strict=True)]
    quiet = np.full(len(triads[0].spread), not (np.isnan(thresholds).all() or any(restless)))
    for triad, threshold in zip(triads, thresholds, strict=True):
        if not np.isnan(threshold):
            quiet &= triad.spread <= threshold
            if triad.channel == "gyro":
                quiet &= ~_turning(triad, threshold)
    edge, shortest = triads[0].edge, sample_count(settings.min_duration_s, record.sample_rate_hz)
    spans = [
        (first + edge if first else 0, last + edge if last < len(quiet) else len(record))
        for first, last in runs(quiet).tolist()
    ]
    stills = tuple(Still(start=a, stop=b, recording=recording) for a, b in spans if b - a >= shortest)
    if stills:
        return StillSearch(stills=stills)
    floors = " and ".join(f"{triad.channel} {triad.floor:.3g} {triad.unit}" for triad in triads)
    over = [
        f"{threshold:.3g} {triad.unit}"
        for triad, threshold, limit in zip(triads, thresholds, limits, strict=True)
        if threshold == limit < triad.floor
    ]
    if over:
        why = f"too restless: a device at rest varies less than {' and '.join(over)}"
    elif np.isnan(thresholds).all():
        usual = " and ".join(f"{np.median(m.spread):.3g} {m.unit} against a floor of {m.floor:.3g}" for m in triads)
        why = f"no gap separates rest from motion: half of the windows vary by more than {usual}"
    else:
        longest_s = max((stop - start for start, stop in runs(quiet)), default=0) / record.sample_rate_hz
        why = f"the longest rest is too short: {longest_s:.2g} s, limit {settings.min_duration_s:g} s"
    gyro, accel = triads[0], triads[-1]
    accel_rests = accel.channel == "accel" and accel.floor < accel.limit(BENCH_RATE_LIMIT, BENCH_ACCEL_LIMIT)
    if accel_rests and gyro.unit == "rad/s" and gyro.floor > BENCH_RATE_LIMIT:
        why += ". In these windows the accelerometer is at rest: check whether the gyroscope is in deg/s, not rad/s"
    why = f"no still phase: the quietest {settings.window_s:g} s windows vary by {floors} rms, and {why}"
    return StillSearch(stills=(), reason=why)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    """Mean and spread of the windows of a triad."""

    channel: str  # gyro or accel
    unit: str
    values: FloatArray  # (N, 3)
    mean: FloatArray  # (M, 3)
    spread: FloatArray  # (M,)
    floor: float  # spread of the quietest windows, or infinity without readings
    window: int  # samples
    smooth: int  # samples

    @property
    def edge(self) -> int:
        """Samples from the start of a window to its centre."""
        return (self.window + self.smooth - 1) // 2

    @cached_property
    def white(self) -> float:
        """Spread of white noise after smoothing, from the steps between samples in the quietest windows."""
        steps = np.diff(self.values, axis=0)
        _, spread = sliding_moments(steps, min(self.window, len(steps)), 1)
        return float(_floor(spread) / np.sqrt(2.0 * self.smooth))

    def limit(self, rate: float, accel: float) -> float:
        """Return a limit, rad/s or m/s2, in the unit of the readings, with their white noise, or infinity in other units."""
        if not is_physical(self.unit):
            return np.inf
        limit = rate / si_factor(self.unit, "rate") if self.channel == "gyro" else accel / si_factor(self.unit, "accel")
        if self.floor <= limit / (2.0 * _NOISE):
            return limit  # white noise cannot exceed this limit
        white = self.white
        if _NOISE * white <= limit or self.floor > _ALL_NOISE * white:
            return limit
        return float(np.hypot(limit, min(_NOISE * white, _MOST_NOISE * limit)))


def _floor(spread: FloatArray) -> float:
    finite = spread[np.isfinite(spread)]
    return float(np.quantile(finite, FLOOR_QUANTILE)) if len(finite) else np.inf


def _moments(record: Record, settings: StillSettings) -> list[_Moments]:
    fs = record.sample_rate_hz
    window, smooth = sample_count(settings.window_s, fs), max(1, round(settings.smooth_s * fs))
    if len(record) < window + smooth:
        raise InputError(
            f"find_still: expected a record longer than one window of {settings.window_s:g} s, got {record.duration_s:.2f} s. "
            "Record for longer, or find still phases with a shorter window_s."
        )
    triads = list[_Moments]()
    readings = (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit))
    for channel, values, unit in readings:
        if values is None:
            continue
        mean, spread = sliding_moments(values, window, smooth)
        floor = max(_floor(spread), _rounding_spread(values, smooth))  # rests in coarse codes repeat a single code
        triads.append(
            _Moments(
                channel=channel, unit=unit, values=values, mean=mean, spread=spread, floor=floor, window=window, smooth=smooth
            )
        )  # fmt: skip
    return triads


def _rounding_spread(values: FloatArray, smooth: int) -> float:
    """Return the spread of rounding errors after smoothing, from the smallest steps between readings."""
    steps = np.abs(np.diff(values, axis=0))
    steps = steps[steps > 0.0]
    return float(np.quantile(steps, 0.01)) * 0.5 / np.sqrt(smooth) if len(steps) else 0.0  # sqrt(3 / 12) = 0.5


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
    """Return a duration in samples, at least two."""
    return max(2, round(seconds * sample_rate_hz))


def _threshold(triad: _Moments, settings: StillSettings, limit: float) -> float:
    """Return the largest spread of a still window, in the unit of the triad, or NaN if rest and motion cannot be separated."""
    finite = triad.spread[np.isfinite(triad.spread)]
    if not len(finite):
        return np.nan
    if settings.threshold_floors is not None:
        return min(settings.threshold_floors * triad.floor, triad.limit(HAND_RATE_LIMIT, HAND_ACCEL_LIMIT))
    if (gap := _gap_above(finite, triad.floor)) is not None:
        return min(gap, limit)
    if np.quantile(finite, 0.99) <= _PEAK * max(triad.floor, np.finfo(float).tiny) and (
        is_physical(triad.unit) or float(np.median(finite)) <= _MOTION * triad.white
    ):
        return min(max(float(finite.max()), _PEAK * triad.floor), limit)
    return np.nan


def _gap_above(spread: FloatArray, floor: float) -> float | None:
    """Return the value with the lowest density between two peaks of log d, or None."""
    # density of log10(d / floor), smoothed (the threshold has the lowest density with a peak on either side)
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


def _turning(triad: _Moments, threshold: float) -> BoolArray:
    mean, spread = triad.mean, triad.spread
    quiet = spread <= min(threshold, 2.0 * triad.floor)
    if is_physical(triad.unit):
        small = np.abs(mean).max(axis=1) <= LARGEST_OFFSET / si_factor(triad.unit, "rate")
        if not (quiet & small).any():
            return np.ones(len(mean), bool)
        quiet &= small
    if not quiet.any():
        return np.zeros(len(mean), bool)
    # A steady turn differs from the offset throughout. The slow drift of a warm-up crosses the offset within the stretch.
    distance = np.abs(mean - np.median(mean[quiet], axis=0)).max(axis=1)
    turning = np.zeros(len(mean), bool)
    for first, last in runs(spread <= threshold):
        turning[first:last] = (distance[first:last] > max(_TURNING * triad.floor, threshold)).all()
    return turning


# ---- padding rows of a file: they repeat the first or the last reading, and are not a rest

_PADDED_S, _PADDED = 0.2, 10  # shorter runs of equal readings occur by chance
# First step after the run, and changes of step around it, relative to the steps there. A device that starts to move begins with
# smaller steps, and a device without noise has smooth steps
_BREAKS = 0.1


def unpadded(record: Record) -> Record:
    """Return a record without the rows at its ends that repeat a reading for longer than elsewhere in the record."""
    triads = [values for values in (record.gyro, record.accel) if values is not None]
    least = max(_PADDED, round(_PADDED_S * record.sample_rate_hz))
    ends = (slice(0, least + 1), slice(-least - 1, None))
    if not any(all((np.diff(readings[end], axis=0) == 0.0).all() for readings in triads) for end in ends):
        return record
    steps = np.diff(np.hstack(triads), axis=0)
    repeats, first, last = runs((steps == 0.0).all(axis=1)), 0, len(record)
    inner = max((stop - start for start, stop in repeats if start > 0 and stop < len(steps)), default=0)
    for start, stop in repeats:
        edge = start == 0 or stop == len(steps)
        if not edge or stop - start < max(least, 2 * inner) or stop - start == len(steps):
            continue
        adjacent = steps[stop : stop + least] if start == 0 else steps[start - least : start][::-1]
        if len(adjacent) < least:
            continue
        rough = np.minimum(np.abs(adjacent[0]), np.diff(adjacent[1:], 2, axis=0).std(axis=0))
        if np.median(rough / np.maximum(np.sqrt((adjacent**2).mean(axis=0)), 1e-300)) > _BREAKS:
            first, last = (stop, last) if start == 0 else (first, start + 1)
    return record if last - first == len(record) else record.part(first, last)


# Rates above this turn, rad/s, low-passed over 0.1 s and kept for 0.5 s: noise and sway of a body are smaller. 1 to 8 deg/s, 0.05
# to 0.25 s and 0.2 to 1 s leave end errors of BROAD within 0.01 deg
TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S = 2.0 * RADIAN_PER_DEGREE, 0.1, 0.5
NOT_TURNING = (0.0, 0.0, 0.0, np.nan, -np.inf)  # state before the first sample


def find_turning(
    rate: FloatArray, time: FloatArray, state: tuple[float, ...] = NOT_TURNING
) -> tuple[FloatArray, tuple[float, ...]]:
    """Return 1 while a device turns and 0 otherwise, (N,), for rates (N, 3), rad/s, from a causal filter with state.

    A turn starts when its low-passed rate is above the limit: 0.02 s after the onset of 10 deg/s, 0.1 s for 3.2 deg/s. Its end lags
    by the hold time, plus 0.2 s after 20 deg/s or 0.5 s after 200 deg/s.
    """
    from undrift.kernels.correct import follow_turning

    out, next_state = np.empty(len(time)), np.array(state)
    settings = (TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S)
    follow_turning(np.ascontiguousarray(rate).reshape(-1), np.ascontiguousarray(time), *settings, next_state, out)
    return out, tuple(next_state.tolist())


# ---- faces: the sensor axis that points up, determined from gravity


_FACE_DEG = 15.0  # largest angle between a face and the vertical


def faces_of(means: FloatArray, *, centred: bool) -> tuple[Face | None, ...]:
    """Return the axis that points up for each mean reading (P, 3), or None if no axis is near the vertical."""
    if not centred and len(means) < 5:
        raise InputError(
            f"faces: expected five poses or more to find the zero of readings in counts, got {len(means)}. "
            "Label the faces in session.toml."
        )
    up = means if centred else means - sphere_of(means)[0]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    axis = np.abs(up).argmax(axis=1)
    most = up[np.arange(len(up)), axis]
    vertical = np.abs(most) >= np.cos(_FACE_DEG * RADIAN_PER_DEGREE)
    return tuple(FACES[2 * a + (m < 0.0)] if n else None for a, m, n in zip(axis, most, vertical, strict=True))


def sphere_of(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of the sphere |p - c| = R, linear in c and R^2 - |c|^2, within the plane of flat poses."""
    mean = points.mean(axis=0)
    spread = float(np.abs(points - mean).max())
    p = (points - mean) / spread
    solution = np.linalg.lstsq(np.column_stack((2.0 * p, np.ones(len(p)))), (p**2).sum(axis=1), rcond=0.02)[0]
    radius = float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.01)))
    return mean + spread * solution[:3], spread * radius


# ---- turns: plateaus of constant rate, and rotations from one still phase to the next


_AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
_STEADY_S = 1.0  # length over which a rate must be steady, and shortest plateau
_AVERAGED_S = 0.1  # averaging time before the spread is computed
_STEADINESS = 0.05  # largest spread of a plateau as a share of its rate
_LEAST_FLOORS = 10.0  # a plateau or rotation must exceed this many noise floors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnSearch:
    """Steady turns and rotations detected in a record, as measured by the gyroscope. Their true rates must come from the rig."""

    # stretches of constant rate (``axis`` is the sensor axis with the largest reading, ``turn_rate`` is not set)
    plateaus: tuple[Turn, ...]
    rotations: tuple[Turn, ...]  # motions between consecutive still phases (``angle`` is not set)
    rotation_angle: FloatArray  # (R, 3), integral of each reading minus the offset at rest, gyro unit times s


def find_turns(record: Record, stills: Sequence[Still]) -> TurnSearch:
    """Find plateaus of constant rate, and the rotations between still phases.

    Parameters
    ----------
    record : Record
        Record with gyroscope readings in any unit.
    stills : sequence of Still
        Still phases of this record, in order of time. They determine the offset and the limits of the rotations.

    Returns
    -------
    TurnSearch
        Plateaus and rotations, with the angle of each rotation.

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
    >>> turns = undrift.find_turns(record, undrift.find_still(record).stills)
    >>> len(turns.rotations)
    11
    """
    if record.gyro is None:
        raise InputError("find_turns: the record has no gyroscope. Map the gyro columns.")
    fs = record.sample_rate_hz
    mean, spread = sliding_moments(record.gyro, sample_count(_STEADY_S, fs), max(1, round(_AVERAGED_S * fs)))
    finite, floor = np.isfinite(spread), _floor(spread)
    offset = np.median(mean[finite], axis=0) if finite.any() else np.zeros(3)
    if stills:
        offset = np.nanmean(np.concatenate([record.gyro[s.start : s.stop] for s in stills]), axis=0)
    recording = stills[0].recording if stills else 0
    plateaus, rotations, angles = list[Turn](), list[Turn](), list[FloatArray]()
    for start, stop in _steady_stretches(mean - offset, spread, floor, stills, len(record), fs):
        axis = _axis(np.nanmean(record.gyro[start:stop], axis=0) - offset)
        plateaus.append(Turn(start=start, stop=stop, recording=recording, axis=axis))
    for previous, following in itertools.pairwise(stills):
        move = slice(previous.stop, following.start)
        reading = record.gyro[move] - offset
        if len(reading) and np.nanmax(np.linalg.norm(reading, axis=1)) > _LEAST_FLOORS * floor:
            angles.append(np.asarray(np.trapezoid(np.nan_to_num(reading), record.time[move], axis=0)))
            rotations.append(Turn(start=move.start, stop=move.stop, recording=recording, axis=_axis(angles[-1], 0.9)))
    return TurnSearch(
        plateaus=tuple(plateaus), rotations=tuple(rotations), rotation_angle=np.array(angles).reshape(-1, 3)
    )


def _axis(reading: FloatArray, least_share: float = 0.0) -> Axis | None:
    """Return the axis with the largest reading of (3,), or None if its share of the length is too small."""
    axis = int(np.argmax(np.abs(reading)))
    return _AXES[axis] if abs(reading[axis]) > least_share * np.linalg.norm(reading) else None


def _steady_stretches(
    rate: FloatArray, spread: FloatArray, floor: float, stills: Sequence[Still], count: int, sample_rate_hz: float
) -> Iterator[tuple[int, int]]:
    """Yield start and stop of the plateaus in a record, from the mean rate (M, 3) and spread (M,) of windows."""
    edge, size = (count - len(rate)) // 2, np.linalg.norm(rate, axis=1)
    steady = (size > _LEAST_FLOORS * floor) & (spread <= np.maximum(_STEADINESS * size, 4.0 * floor))
    for still in stills:
        steady[max(0, still.start - edge) : max(0, still.stop - edge)] = False
    for first, last in runs(steady).tolist():
        # A ramp at an end is trimmed, and a step between two rates splits the run, because both exceed the run's quietest quarter.
        limit = max(4.0 * float(np.quantile(spread[first:last], 0.25)), 4.0 * floor)
        for start, stop in (first + runs(spread[first:last] <= limit)).tolist():
            begin, end = start + edge if start else 0, stop + edge if stop < len(rate) else count
            if end - begin >= sample_count(_STEADY_S, sample_rate_hz):
                yield begin, end
