"""Segments: where in a record the device stood still, turned at a steady rate, or was moved from one pose to the next.

Ranges are [start, stop). Stillness of a triad at sample k is the sliding standard deviation of its reading y, smoothed over
``smooth_s``: d_k^2 = sum over axes of var(y over the window centred at k). Smoothing averages white noise out and keeps what a
hand or a body does. The threshold comes from the data: at rest log d has one narrow peak at the noise floor, motion lies
decades above, and the threshold is the emptiest place between the two. Without such a gap there is no still phase. A steady
turn is a stretch where the smoothed rate r, less the offset at rest, is far from zero and steady::

    |r| > least_floors * floor        d <= max(steadiness * |r|, 4 floor)
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
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


@dataclass(frozen=True, slots=True, kw_only=True)
class StillThreshold:
    """The threshold of one triad and where it came from."""

    channel: Literal["gyro", "accel"]  # gyro or accel
    value: float  # Largest spread d of a still window, in ``unit``; NaN where none could be found
    unit: str  # Unit of the record's channel
    noise_floor: float  # Spread of the quietest windows, in ``unit``
    # gap (between two peaks), all still, given, limit (what a bench allows), or none
    basis: Literal["gap", "all still", "given", "limit", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSearch:
    """Still phases and how they were separated from motion."""

    stills: tuple[Still, ...]  # In order of time, without faces
    thresholds: tuple[StillThreshold, ...]  # One for each triad of the record
    window_s: float  # Window used, s
    reason: str = ""  # Why there is none; "" when there is one or more


def find_still(record: Record, settings: StillSettings = StillSettings(), *, recording: int = 0) -> StillSearch:
    """Find the stretches in which the device did not move.

    A sample is still when the window centred at it is quiet in every triad and the mean rate reading is that of the
    quietest windows (a steady turn is not a still phase). Half a window is lost at each end of a phase, on purpose.

    Parameters
    ----------
    record : Record
        Any units, either triad may be missing.
    settings : StillSettings
        Window and thresholds.
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
    fs = record.sample_rate_hz
    window, smooth = sample_count(settings.window_s, fs), max(1, round(settings.smooth_s * fs))
    if len(record) < window + smooth:
        raise InputError(
            f"find_still: wanted a record longer than one window of {settings.window_s:g} s, got {record.duration_s:.2f} s; "
            "record for longer, or find still phases with a shorter window_s"
        )
    quiet = np.ones(len(record) - window - smooth + 2, bool)
    thresholds: list[StillThreshold] = []
    triads = (
        (record.gyro, record.gyro_unit, settings.gyro_threshold),
        (record.accel, record.accel_unit, settings.accel_threshold),
    )
    for is_gyro, (values, unit, given) in zip((True, False), triads, strict=True):
        if values is None:
            continue
        mean, spread = sliding_moments(values, window, smooth)
        found = _threshold(spread, is_gyro, unit, given)
        if found.basis == "all still" and not is_physical(unit):
            # The spread of white noise alone after smoothing, from the steps between neighbouring samples.
            white = float(np.sqrt(np.nanvar(np.diff(values, axis=0), axis=0).sum() / 2.0 / smooth))
            if float(np.median(spread)) > _WHITE * white:
                found = replace(found, value=np.nan, basis="none")
        thresholds.append(found)
        if found.basis != "none":
            quiet &= spread <= found.value
            if is_gyro:
                quiet &= ~_turning(mean, spread, found)
    if all(t.basis == "none" for t in thresholds) or any(t.value < t.noise_floor for t in thresholds):
        quiet[:] = False
    edge = (window + smooth - 1) // 2
    stills = _phases(quiet, len(record), edge, sample_count(settings.min_duration_s, fs), recording)
    return StillSearch(
        stills=stills,
        thresholds=tuple(thresholds),
        window_s=settings.window_s,
        reason="" if stills else _why_none(thresholds, settings),
    )


def sliding_moments(values: FloatArray, window: int, smooth: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean (M, 3) and the spread (M,) of every window of a smoothed triad (N, 3)."""
    gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
    centre = values[~gap].mean(axis=0) if (~gap).any() else np.zeros(3)
    smoothed = _running_mean(np.where(gap[:, None], 0.0, values - centre), smooth)
    mean = _running_mean(smoothed, window)
    variance = (_running_mean(smoothed * smoothed, window) - mean * mean).sum(axis=1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    if gap.any():
        spread[_running_mean(gap.astype(float)[:, None], window + smooth - 1)[:, 0] > 0.0] = np.inf
    return mean + centre, spread


def sample_count(seconds: float, sample_rate_hz: float) -> int:
    """Return a length of time in samples, two at least."""
    return max(2, round(seconds * sample_rate_hz))


def _running_mean(values: FloatArray, width: int) -> FloatArray:
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return np.asarray((total[width:] - total[:-width]) / width)


def _threshold(spread: FloatArray, is_gyro: bool, unit: str, given: float | None) -> StillThreshold:
    finite = spread[np.isfinite(spread)]
    floor = float(np.quantile(finite, FLOOR_QUANTILE)) if len(finite) else np.inf
    found = StillThreshold(
        channel="gyro" if is_gyro else "accel", value=np.nan, unit=unit, noise_floor=floor, basis="none"
    )
    if given is not None:
        return replace(found, value=given, basis="given")
    if not len(finite):
        return found
    if (value := _gap_above(finite, floor)) is not None:
        found = replace(found, value=value, basis="gap")
    elif np.quantile(finite, 0.99) <= _PEAK * max(floor, np.finfo(float).tiny):
        found = replace(found, value=max(float(finite.max()), _PEAK * floor), basis="all still")
    if is_physical(unit):
        limit = BENCH_RATE_LIMIT / si_factor(unit, "rate") if is_gyro else BENCH_ACCEL_LIMIT / si_factor(unit, "accel")
        if found.value > limit:
            found = replace(found, value=limit, basis="limit")
    return found


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
    emptiest = inside[np.flatnonzero(depth <= depth[least] + 1e-12)]
    return floor * float(10.0 ** centre[emptiest].mean())


def _turning(mean: FloatArray, spread: FloatArray, found: StillThreshold) -> BoolArray:
    quiet = spread <= min(found.value, 2.0 * found.noise_floor)
    if is_physical(found.unit):
        small = np.abs(mean).max(axis=1) <= LARGEST_OFFSET / si_factor(found.unit, "rate")
        if not (quiet & small).any():
            return np.ones(len(mean), bool)
        quiet &= small
    if not quiet.any():
        return np.zeros(len(mean), bool)
    offset = np.median(mean[quiet], axis=0)
    # A steady turn is off the offset throughout; the slow drift of a warm-up meets the offset somewhere in its stretch.
    far = np.abs(mean - offset).max(axis=1) > max(_TURNING * found.noise_floor, found.value)
    turning = np.zeros(len(mean), bool)
    for first, last in runs(spread <= found.value):
        turning[first:last] = far[first:last].all()
    return turning


def _phases(quiet: BoolArray, count: int, edge: int, shortest: int, recording: int) -> tuple[Still, ...]:
    spans = [
        (0 if first == 0 else int(first) + edge, count if last == len(quiet) else int(last) + edge)
        for first, last in runs(quiet)
    ]
    return tuple(Still(start=a, stop=b, recording=recording) for a, b in spans if b - a >= shortest)


def runs(flag: BoolArray) -> IntArray:
    """Return the stretches [start, stop), (R, 2), where a flag (N,) is set."""
    change = np.flatnonzero(np.diff(np.concatenate(([False], flag, [False])).astype(np.int8)))
    return change.reshape(-1, 2)


def _why_none(thresholds: list[StillThreshold], settings: StillSettings) -> str:
    floors = " and ".join(f"{t.channel} {t.noise_floor:.3g} {t.unit}" for t in thresholds)
    over = [f"{t.value:.3g} {t.unit}" for t in thresholds if t.basis == "limit" and t.value < t.noise_floor]
    if over:
        why = f"a device at rest varies less than {' and '.join(over)}"
    elif all(t.basis == "none" for t in thresholds):
        why = "no gap separates rest from motion"
    else:
        why = f"no stretch below the thresholds lasts {settings.min_duration_s:g} s"
    return f"no still phase: the quietest {settings.window_s:g} s windows vary by {floors} rms, and {why}"


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnSettings:
    """How steady turns and rotations are found."""

    window_s: float = 1.0  # Length over which a rate must be steady, s
    smooth_s: float = 0.1  # Averaging before the spread is taken, s
    min_duration_s: float = 1.0  # Shortest plateau kept, s
    steadiness: float = 0.05  # Largest spread of a plateau as a share of its rate
    least_floors: float = 10.0  # A plateau or rotation must exceed this many noise floors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnSearch:
    """Steady turns and rotations found in a record, as the gyroscope read them; their true rates only the rig knows."""

    # Stretches of constant rate; ``axis`` is the sensor axis that reads most, ``turn_rate`` is left open
    plateaus: tuple[Turn, ...]
    plateau_rate: FloatArray  # (P, 3), mean reading of each less the offset at rest, gyro unit
    rotations: tuple[Turn, ...]  # Motions between one still phase and the next; ``angle`` is left open
    rotation_angle: FloatArray  # (R, 3), integral of each reading less the offset at rest, gyro unit times s


def find_turns(record: Record, stills: Sequence[Still], settings: TurnSettings = TurnSettings()) -> TurnSearch:
    """Find plateaus of constant rate, and the rotations between still phases.

    Parameters
    ----------
    record : Record
        With gyroscope, any unit.
    stills : sequence of Still
        Still phases of this record, in order of time; they give the offset and bound the rotations.
    settings : TurnSettings
        Window and limits.

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
    window, smooth = sample_count(settings.window_s, fs), max(1, round(settings.smooth_s * fs))
    mean, spread = sliding_moments(record.gyro, window, smooth)
    seen = np.isfinite(spread)
    floor = float(np.quantile(spread[seen], FLOOR_QUANTILE))
    rest = [record.gyro[s.start : s.stop] for s in stills]
    offset = np.nanmean(np.concatenate(rest), axis=0) if rest else np.median(mean[seen], axis=0)
    plateaus, rates = _plateaus(record, (mean, spread), (offset, floor), stills, settings)
    rotations, angles = _rotations(record, stills, offset, settings.least_floors * floor)
    return TurnSearch(plateaus=plateaus, plateau_rate=rates, rotations=rotations, rotation_angle=angles)


def _plateaus(
    record: Record,
    moments: tuple[FloatArray, FloatArray],
    rest: tuple[FloatArray, float],
    stills: Sequence[Still],
    settings: TurnSettings,
) -> tuple[tuple[Turn, ...], FloatArray]:
    (mean, spread), (offset, floor), gyro = moments, rest, np.asarray(record.gyro)
    rate, shortest = mean - offset, sample_count(settings.min_duration_s, record.sample_rate_hz)
    edge = (len(gyro) - len(rate)) // 2
    size = np.linalg.norm(rate, axis=1)
    steady = (size > settings.least_floors * floor) & (spread <= np.maximum(settings.steadiness * size, 4.0 * floor))
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
    found: list[tuple[Turn, FloatArray]] = []
    for before, after in itertools.pairwise(stills):
        reading = np.asarray(record.gyro)[before.stop : after.start] - offset
        if len(reading) and np.nanmax(np.linalg.norm(reading, axis=1)) > least:
            angle = np.asarray(np.trapezoid(np.nan_to_num(reading), record.time[before.stop : after.start], axis=0))
            share = np.abs(angle) / max(float(np.linalg.norm(angle)), np.finfo(float).tiny)
            axis: Axis | None = _AXES[int(np.argmax(share))] if share.max() > 0.9 else None
            found.append((Turn(start=before.stop, stop=after.start, axis=axis, recording=before.recording), angle))
    return tuple(turn for turn, _ in found), np.array([angle for _, angle in found]).reshape(-1, 3)
