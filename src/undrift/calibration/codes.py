"""Step size and rounding of a converter's codes, and the rounding error that remains in a mean.

The step q is the common divisor of the differences between readings. Readings in rad/s that were stored as a float are the same
codes with float errors. Code 0 identifies the rounding: truncation toward zero maps (-q, q) to 0, a bin twice as wide as its
neighbours. With n(k) samples at code k and expected(0) the mean of n over codes +-1..+-8::

    ratio = n(0) / expected(0)          1 for nearest and floor, 2 for toward zero

Nearest and floor differ by half a step everywhere, so the offset absorbs the difference. Only samples that sweep through zero are
counted, because the density near code 0 is not uniform at rest.

A reading x + n with normal n of variance s^2 is rounded to steps q. Its mean differs from x by sum_k q/(pi k) sin(2 pi k x / q)
exp(-2 pi^2 k^2 s^2 / q^2). Q is the variance of this difference over all positions x between two codes. The readings themselves
scatter by S::

    Q = sum_k q^2 / (2 pi^2 k^2) exp(-4 pi^2 k^2 s^2 / q^2)       q^2 / 12 without noise
    S = s^2 + q^2 / 12 - Q

At a single position S does not determine s: readings that toggle between two codes, a share p of them in the upper one, scatter by
p (1 - p) q^2 for any small s. x then lies between the mean of the readings and the edge between the codes, |p - 1/2| q away. An
even distribution over this distance to both sides has the variance (p - 1/2)^2 q^2 / 3, and at least this variance is counted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.findings import Finding, finding
from undrift.model import AdcModel, Rounding
from undrift.record import Record

MIN_CODES, MAX_CODES = 4, 200_000  # smallest number of different readings on a grid, and largest that is searched
MAX_GRID_MISS = 0.15  # largest distance of readings from the grid, in steps (files round to a tenth of a step)
MAX_PHASE = 0.05  # largest phase, in steps (a larger phase means that an offset was subtracted from the codes)
FLOAT_DUST = 4.0 * float(np.finfo(np.float32).eps)  # relative to the largest reading: below this, float rounding
SIDE_CODES = 8  # codes on either side of zero that determine its expected count
SWEEP_SAMPLES, SWEEP_CODES = 5, 20  # a sample is in motion if the readings 5 before and 5 after differ by 20 codes
MIN_SWEPT = 100  # samples in motion near code 0
SUBTRACTED = "an offset was subtracted from the codes"
SIGMAS = 4.0  # standard errors by which the other ratio must be excluded


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CodeGrid:
    """Step and rounding of the codes of a triad."""

    lsb: FloatArray | None  # (3,), step of each axis, unit of the readings, or None if the readings are not on a grid
    rounding: Rounding | None  # toward_zero, nearest (also used for floor), or None if not identifiable
    reason: str = ""  # reason why the step or the rounding is not known


def identify_adc(values: FloatArray) -> CodeGrid:
    """Find the step and the rounding of a triad (N, 3)."""
    steps, phases = np.array([code_grid(column) for column in values.T]).T
    if np.isnan(steps).any():
        return CodeGrid(lsb=None, rounding=None, reason="readings are not on a grid")
    if (np.abs(phases) >= MAX_PHASE).any():
        return CodeGrid(lsb=steps, rounding=None, reason=SUBTRACTED)
    counts = np.array([_swept_codes(column, step) for column, step in zip(values.T, steps, strict=True)])
    counts_beyond = np.delete(counts, SIDE_CODES, axis=1)
    if (counts_beyond.sum(axis=1) >= MIN_SWEPT).sum() < 2:
        return CodeGrid(lsb=steps, rounding=None, reason="fewer than two axes sweep through code 0")
    neighbours = counts_beyond.sum(axis=0)
    expected = float(neighbours.mean())
    # motion synchronous with the sampling violates Poisson statistics
    uneven = max(1.0, float(neighbours.var(ddof=1)) / expected)
    ratio, sigma = float(counts[:, SIDE_CODES].sum()) / expected, float(np.sqrt(uneven / expected))
    deviation = ratio - np.array([1.0, 2.0])
    # uncertainty of the ratios 1 and 2
    chance = SIGMAS * sigma * np.sqrt([1.0 + 0.5 / SIDE_CODES, 2.0 + 2.0 / SIDE_CODES])
    possible, excluded = np.abs(deviation) < np.maximum(0.3, chance), np.abs(deviation) > chance
    if possible[1] and excluded[0]:
        return CodeGrid(lsb=steps, rounding="toward_zero")
    if possible[0] and excluded[1]:
        return CodeGrid(lsb=steps, rounding="nearest")
    reason = f"code 0 occurs {ratio:.2f} +- {sigma:.2f} times as often as expected"
    return CodeGrid(lsb=steps, rounding=None, reason=reason)


def device_adc(records: Sequence[Record]) -> AdcModel | None:
    """Identify the ADC from all raw recordings of a device. Return None if the rounding of no triad is certain."""
    fields: dict[str, Any] = {}
    for name in ("gyro", "accel"):
        readings = [values for record in records if (values := getattr(record, name)) is not None]
        grid = identify_adc(np.concatenate(readings)) if readings else None
        if grid is not None and grid.rounding is not None:
            fields |= {f"{name}_lsb": grid.lsb, f"{name}_rounding": grid.rounding}
    return AdcModel(**fields) if fields else None


def unknown_rounding(records: Sequence[Record]) -> float:
    """Return the step of gyroscope codes on both sides of zero whose rounding is not known, unit of the readings, or 0.

    If the codes are truncated toward zero, the offset at rest on one side differs from the offset in motion on the other side.
    """
    readings = [record.gyro for record in records if record.gyro is not None]
    if not readings:
        return 0.0
    values = np.concatenate(readings)
    grid = identify_adc(values)
    if grid.lsb is None or grid.rounding is not None or grid.reason == SUBTRACTED:
        return 0.0
    both_sides = (np.nanmin(values, axis=0) < -grid.lsb) & (np.nanmax(values, axis=0) > grid.lsb)
    return float(grid.lsb[both_sides].max(initial=0.0))


def code_grid(column: FloatArray) -> tuple[float, float]:
    """Return the step between neighbouring codes of an axis (N,) and the phase of the grid, or NaN without a grid."""
    no_grid = float("nan"), float("nan")
    distinct = np.unique(column[np.isfinite(column)])
    if not MIN_CODES <= len(distinct) <= MAX_CODES:
        return no_grid
    largest = float(np.abs(distinct).max())
    nodes = distinct[np.concatenate(([True], np.diff(distinct) > FLOAT_DUST * largest))]
    if len(nodes) < MIN_CODES:
        return no_grid
    gaps = np.diff(nodes)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    origin = float(nodes[np.argmin(np.abs(nodes - np.median(nodes)))])
    for reach in (8.0, 30.0, 120.0, 500.0, 2000.0, 8000.0, np.inf):  # a wider span determines the step more finely
        nearby = nodes[np.abs(nodes - origin) <= reach * step]
        codes = np.round((nearby - origin) / step)
        if len(nearby) > 3 and np.ptp(codes) > 0.0:
            step, shift = np.polyfit(codes, nearby - origin, 1)
            origin += float(shift)
    places = (nodes - origin) / step
    miss = float(np.quantile(np.abs(places - np.round(places)), 0.99))
    if step < 20.0 * FLOAT_DUST * largest or miss > MAX_GRID_MISS:
        return no_grid
    phase = origin / step - float(np.round(origin / step))
    if abs(phase) < MAX_PHASE:
        codes = np.round(nodes / step)
        step = float(nodes @ codes / (codes @ codes))
    return float(step), phase


def _swept_codes(column: FloatArray, step: float) -> FloatArray:
    """Count each code near zero while the reading sweeps through zero."""
    codes = np.round(column / step)
    # NaN next to a gap, which does not count as motion
    travelled = np.abs(codes[2 * SWEEP_SAMPLES :] - codes[: -2 * SWEEP_SAMPLES])
    middle = codes[SWEEP_SAMPLES:-SWEEP_SAMPLES]
    swept = middle[(travelled >= SWEEP_CODES) & (np.abs(middle) <= SIDE_CODES)]
    return np.bincount(swept.astype(np.int64) + SIDE_CODES, minlength=2 * SIDE_CODES + 1).astype(float)


# ---- readings without truncation


def without_truncation(values: FloatArray, lsb: FloatArray, rounding: Rounding) -> FloatArray:
    """Return readings (N, 3) corrected for the half step that truncation removed, with steps lsb (3,)."""
    if rounding == "nearest":
        return values
    direction = np.sign(values) * (np.abs(values) > 0.5 * lsb) if rounding == "toward_zero" else 1.0
    return np.asarray(values + 0.5 * lsb * direction)


def restored_gyro(gyro: FloatArray, adc: AdcModel | None) -> FloatArray:
    """Return gyroscope readings (N, 3) corrected for the half steps that truncation removed."""
    return gyro if adc is None or adc.gyro_lsb is None else without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)


def restored(record: Record, adc: AdcModel | None, codes: FloatArray | None = None) -> Record:
    """Return a record without the half steps of rounding. ``codes`` (3,) replaces the half steps of the gyroscopes."""
    if adc is None:
        return record
    accel, gyro = record.accel, record.gyro
    if gyro is not None:
        gyro = restored_gyro(gyro, adc) if codes is None else gyro + codes * np.sign(gyro)
    if accel is not None and adc.accel_lsb is not None:
        accel = without_truncation(accel, adc.accel_lsb, adc.accel_rounding)
    return replace(record, gyro=gyro, accel=accel)


# ---- error of a mean reading due to rounding to codes

_NOISES = np.linspace(0.0, 1.0, 201)  # s / q
_HARMONICS = np.arange(1, 200)[:, None]
_BIAS = (np.exp(-((2.0 * np.pi * _HARMONICS * _NOISES) ** 2)) / (2.0 * np.pi**2 * _HARMONICS**2)).sum(axis=0)  # Q / q^2
TWO_CODES = 0.99  # share of the readings in two codes from which a window toggles between them
MAX_SHARE = 0.5  # largest share of a variance, because the rounding error is not normal


def code_steps(records: Sequence[Record], *, rate: bool) -> FloatArray:
    """Return the step between neighbouring codes of each gyroscope or accelerometer (3,), or NaN without a grid."""
    return _steps([values for record in records if (values := record.gyro if rate else record.accel) is not None])


def _steps(values: Sequence[FloatArray]) -> FloatArray:
    steps = list[float]()
    for column in np.concatenate((np.empty((0, 3)), *values)).T:
        distinct = np.unique(column[np.isfinite(column)])
        few = 1 < len(distinct) < MIN_CODES  # too few readings for a grid: the nearest two are a step apart
        steps.append(float(np.diff(distinct).min()) if few else code_grid(column)[0])
    return np.array(steps)


def code_variance(step: FloatArray, scatter: FloatArray, windows: Sequence[FloatArray] = ()) -> FloatArray:
    """Return Q for steps q and variances S of single readings (3,), or 0 if the step is unknown.

    Readings at rest, ``windows`` (N, 3), that toggle between two codes count with their limit.
    """
    scatter_variance = _NOISES**2 + 1.0 / 12.0 - _BIAS
    square = np.where(step > 0.0, step, np.inf) ** 2
    shares = [np.interp(scatter / square, scatter_variance, _BIAS)]
    if len(windows):
        shares.append(np.mean([_toggling_share(window, step) for window in windows], axis=0))
    return np.asarray(np.where(step > 0.0, step, 0.0) ** 2 * np.max(shares, axis=0))


def _toggling_share(window: FloatArray, step: FloatArray) -> FloatArray:
    """Return (p - 1/2)^2 / 3 for readings (N, 3) that toggle between two codes, and 0 for other readings, (3,)."""
    codes = np.rint((window - window.min(axis=0)) / np.where(step > 0.0, step, np.inf))
    edge = np.floor(codes.mean(axis=0)) + 0.5
    toggling = (np.abs(codes - edge) < 1.0).mean(axis=0) >= TWO_CODES
    return np.where(toggling, (codes.mean(axis=0) - edge) ** 2 / 3.0, 0.0)


def rounding_correlation(distance: FloatArray, spread: FloatArray, share: FloatArray) -> FloatArray:
    """Return the correlation of the rounding errors of two means whose inputs differ by a normally distributed distance d.

    d has a mean and a spread in steps, and ``share`` is the variance Q/q^2 of each error. Errors repeat with every step. For
    readings without noise at a known distance this is 1 - 6 d (1 - d), with d between 0 and 1.
    """
    noise = np.interp(share, _BIAS[::-1], _NOISES[::-1])  # s / q
    cosines, weights = np.zeros(distance.shape), np.zeros(np.shape(noise))
    for k in range(1, 21):
        weight = np.exp(-((2.0 * np.pi * k * noise) ** 2)) / k**2
        cosines += weight * np.cos(2.0 * np.pi * k * distance) * np.exp(-2.0 * (np.pi * k * spread) ** 2)
        weights += weight
    return np.asarray(cosines / np.maximum(weights, 1e-300))


def mean_rounding(values: Sequence[FloatArray], rests: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation (3,) of a mean at rest due to rounding, from all readings and those at rest, (N, 3) each."""
    return np.sqrt(code_variance(_steps(values), np.mean([rest.var(axis=0) for rest in rests], axis=0), rests))


def limited_by_codes(
    triad: Literal["gyroscope", "accelerometer"], codes: FloatArray, variance: FloatArray, unit: str
) -> Iterator[Finding]:
    """Yield a finding if rounding, with variance ``codes`` (3,), causes most of a variance (3,). Its error is not normal."""
    if (codes > MAX_SHARE * np.maximum(variance, 1e-300)).any():
        uncertainty = float(np.sqrt(codes.max()))
        yield finding(
            "session.rounding",
            "warn",
            f"Readings of the {triad} at rest move by less than a step, which adds {uncertainty:.2g} {unit} (1 sigma) to every "
            "mean.",
            "Choose a smaller range or more bits.",
            triad=triad,
            uncertainty=uncertainty,
        )
