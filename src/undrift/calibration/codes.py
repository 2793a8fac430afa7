"""ADC identification: the step of the codes and how they were rounded, from the readings themselves.

The step q is the common divisor of the differences between readings; readings in rad/s that went through a float are the
same codes with rounding dust on them. The rounding shows at code 0: truncation toward zero maps (-q, q) to 0, a bin twice as
wide as its neighbours. So with n(k) samples at code k, expected(0) the mean of n over codes +-1..+-8::

    ratio = n(0) / expected(0)          1 for nearest and floor, 2 for toward zero

Nearest and floor differ by half a step everywhere, which an offset takes up: codes alone do not show which it is, and need
not. Only samples that sweep through zero are counted: at rest the density near code 0 is anything but level.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.findings import Finding, finding
from undrift.model import AdcModel, Rounding
from undrift.record import Record

_LEAST_CODES = 4  # distinct readings that show a grid
_MOST_CODES = 200_000  # distinct readings looked at when the step is sought
_GRID_MISS = 0.15  # of a step: how far readings may be off the grid; files round to a tenth of a step
_DUST = 4.0 * float(np.finfo(np.float32).eps)  # of the largest reading: float rounding, not a step
_SIDE = 8  # codes on either side of zero that give its expected count
_HALF, _TRAVEL = 5, 20  # a sample is in motion when the readings 5 before and 5 after differ by 20 codes
_LEAST_COUNT = 100  # samples in motion near code 0
_SURE = 4.0  # standard deviations by which the other ratio must be excluded


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AdcFinding:
    """Step and rounding of the codes of one triad, and the evidence."""

    lsb: FloatArray | None  # (3,), step of each axis, unit of the readings; None where the readings lie on no grid
    rounding: Rounding | None  # toward_zero; nearest (which stands for floor too); None where not identifiable
    ratio: FloatArray  # (3,), count at code 0 over the expected one; NaN where too few samples are near zero
    finding: Finding  # The evidence, or why there is none


def identify_adc(values: FloatArray) -> AdcFinding:
    """Find the step and the rounding of a triad (N, 3)."""
    grids = [code_grid(column) for column in values.T]
    steps, phases = np.array([g[0] for g in grids]), np.array([g[1] for g in grids])
    if np.isnan(steps).any():
        why, nothing = finding("adc.no_grid", "info"), np.full(3, np.nan)
        return AdcFinding(lsb=None, rounding=None, ratio=nothing, finding=why)
    counts = [
        _sweeping(column, step) if abs(phase) < 0.05 else np.zeros(2 * _SIDE + 1)
        for column, step, phase in zip(values.T, steps, phases, strict=True)
    ]
    ratio = np.array([_zero_ratio(c)[0] for c in counts])
    rounding, why = _judge(*_zero_ratio(np.sum(counts, axis=0)), phases, ratio)
    return AdcFinding(lsb=steps, rounding=rounding, ratio=ratio, finding=why)


def identify_record_adc(*records: Record) -> AdcModel | None:
    """Find the ADC of both triads of a device from its raw records, all together."""
    triads = ([r.gyro for r in records if r.gyro is not None], [r.accel for r in records if r.accel is not None])
    return adc_model(*(identify_adc(np.concatenate(parts)) if parts else None for parts in triads))


def device_adc(records: Sequence[Record]) -> AdcModel | None:
    """Find how the gyroscope codes of one device were rounded, from all its recordings; None where they disagree."""
    models = [model for model in map(identify_record_adc, records) if model is not None and model.gyro_lsb is not None]
    ranked = Counter(model.gyro_rounding for model in models).most_common()
    if not ranked or (len(ranked) > 1 and ranked[0][1] == ranked[1][1]):
        return None
    chosen = [model for model in models if model.gyro_rounding == ranked[0][0]]
    return min(chosen, key=lambda model: float(np.sum(np.asarray(model.gyro_lsb))))


def adc_model(gyro: AdcFinding | None, accel: AdcFinding | None) -> AdcModel | None:
    """Return the model of the triads whose rounding is certain; None where none is."""
    known = [found if found is not None and found.rounding is not None else None for found in (gyro, accel)]
    if known == [None, None]:
        return None
    steps = [None if found is None else found.lsb for found in known]
    roundings: list[Rounding] = [found.rounding or "nearest" if found else "nearest" for found in known]
    return AdcModel(gyro_lsb=steps[0], accel_lsb=steps[1], gyro_rounding=roundings[0], accel_rounding=roundings[1])


def code_grid(column: FloatArray) -> tuple[float, float]:
    """Return the step between neighbouring codes of one axis (N,), and the phase of the grid."""
    distinct = np.unique(column[np.isfinite(column)])
    if not _LEAST_CODES <= len(distinct) <= _MOST_CODES:
        return float("nan"), float("nan")
    largest = float(np.abs(distinct).max())
    nodes = distinct[np.concatenate(([True], np.diff(distinct) > _DUST * largest))]
    if len(nodes) < _LEAST_CODES:
        return float("nan"), float("nan")
    gaps = np.diff(nodes)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    origin = float(nodes[np.argmin(np.abs(nodes - np.median(nodes)))])
    for reach in (8.0, 30.0, 120.0, 500.0, 2000.0, 8000.0, np.inf):  # a wider span gives a finer step
        near = nodes[np.abs(nodes - origin) <= reach * step]
        codes = np.round((near - origin) / step)
        if len(near) > 3 and np.ptp(codes) > 0.0:
            step, shift = np.polyfit(codes, near - origin, 1)
            origin += float(shift)
    places = (nodes - origin) / step
    miss = float(np.quantile(np.abs(places - np.round(places)), 0.99))
    if step < 20.0 * _DUST * largest or miss > _GRID_MISS:
        return float("nan"), float("nan")
    phase = origin / step - float(np.round(origin / step))
    if abs(phase) < 0.05:
        codes = np.round(nodes / step)
        step = float(nodes @ codes / (codes @ codes))
    return float(step), phase


def code_steps(records: Sequence[Record], *, rate: bool) -> FloatArray:
    """Return the step between neighbouring codes of each gyroscope or accelerometer (3,), NaN where readings lie on no grid."""
    parts = [values for record in records if (values := record.gyro if rate else record.accel) is not None]
    return _steps(parts) if parts else np.full(3, np.nan)


def _steps(values: Sequence[FloatArray]) -> FloatArray:
    steps = []
    for column in np.concatenate(values).T:
        distinct = np.unique(column[np.isfinite(column)])
        few = 1 < len(distinct) < _LEAST_CODES  # too few for a grid: the nearest two are a step apart
        steps.append(float(np.diff(distinct).min()) if few else code_grid(column)[0])
    return np.array(steps)


# ---- what rounding to codes leaves in a mean reading
#
# A reading x + n, n normal of variance s^2, that is rounded to steps q has a mean off x by sum_k q/(pi k) sin(2 pi k x / q)
# exp(-2 pi^2 k^2 s^2 / q^2), whose variance over all places x between two codes is Q; the readings themselves scatter by S:
#
#     Q = sum_k q^2 / (2 pi^2 k^2) exp(-4 pi^2 k^2 s^2 / q^2)       q^2 / 12 without noise
#     S = s^2 + q^2 / 12 - Q

_NOISES = np.linspace(0.0, 1.0, 201)  # s / q
_HARMONICS = np.arange(1, 200)[:, None]
_MOST_OF = 0.5


def code_variance(step: FloatArray, scatter: FloatArray) -> FloatArray:
    """Return Q for steps q and variances S of single readings (3,); 0 where the step is not known."""
    left = (np.exp(-((2.0 * np.pi * _HARMONICS * _NOISES) ** 2)) / (2.0 * np.pi**2 * _HARMONICS**2)).sum(axis=0)
    shown = _NOISES**2 + 1.0 / 12.0 - left
    square = np.where(step > 0.0, step, np.inf) ** 2
    return np.asarray(np.where(step > 0.0, step, 0.0) ** 2 * np.interp(scatter / square, shown, left))


def mean_rounding(values: Sequence[FloatArray], rests: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation (3,) that rounding leaves in a mean at rest: all readings and those at rest, (N, 3) each."""
    within = np.mean([rest.var(axis=0) for rest in rests], axis=0)
    return np.sqrt(code_variance(_steps(values), within))


def limited_by_codes(
    triad: Literal["gyroscope", "accelerometer"], codes: FloatArray, variance: FloatArray, unit: str
) -> Iterator[Finding]:
    """Report where rounding, of variance ``codes`` (3,), is most of a variance (3,): its error is no normal one."""
    if (codes > _MOST_OF * np.maximum(variance, 1e-300)).any():
        uncertainty = float(np.sqrt(codes.max()))
        yield finding("session.rounding", "warn", triad=triad, uncertainty=uncertainty, unit=unit)


def _sweeping(column: FloatArray, step: float) -> FloatArray:
    # How often each code from -_SIDE to _SIDE occurs while the reading sweeps through zero.
    known = np.isfinite(column)
    codes = np.round(np.where(known, column, 0.0) / step).astype(np.int64)
    flag = np.zeros(len(codes), bool)
    travelled = np.abs(codes[2 * _HALF :] - codes[: -2 * _HALF]) >= _TRAVEL
    flag[_HALF:-_HALF] = travelled & known[2 * _HALF :] & known[: -2 * _HALF]  # a gap is no motion
    near = codes[flag & known & (np.abs(codes) <= _SIDE)] + _SIDE
    return np.bincount(near, minlength=2 * _SIDE + 1).astype(float)


def _zero_ratio(counts: FloatArray) -> tuple[float, float]:
    if float(counts.sum() - counts[_SIDE]) < _LEAST_COUNT:
        return float("nan"), float("nan")
    others = np.delete(counts, _SIDE)
    expected = float(others.mean())
    uneven = max(1.0, float(others.var(ddof=1)) / expected)  # a motion in step with the sampling beats Poisson's law
    return float(counts[_SIDE]) / expected, float(np.sqrt(uneven / expected))


def _judge(pooled: float, sigma: float, phases: FloatArray, ratio: FloatArray) -> tuple[Rounding | None, Finding]:
    if (np.abs(phases) >= 0.05).any():
        return None, finding("adc.offset_subtracted", "info")
    if np.isfinite(ratio).sum() < 2:
        return None, finding("adc.few_axes", "info")
    if np.isnan(pooled):
        return None, finding("adc.few_samples", "info")
    sure_1 = _SURE * sigma * np.sqrt(1.0 + 1.0 / (2 * _SIDE))  # scatter of the ratio if it were 1, and if it were 2
    sure_2 = _SURE * sigma * np.sqrt(2.0 + 4.0 / (2 * _SIDE))
    if abs(pooled - 2.0) < max(0.3, sure_2) and pooled - 1.0 > sure_1:
        return "toward_zero", finding("adc.toward_zero", "info", ratio=pooled, uncertainty=sigma)
    if abs(pooled - 1.0) < max(0.3, sure_1) and 2.0 - pooled > sure_2:
        return "nearest", finding("adc.nearest", "info", ratio=pooled, uncertainty=sigma)
    return None, finding("adc.uncertain", "info", ratio=pooled, uncertainty=sigma)


def without_truncation(values: FloatArray, lsb: FloatArray, rounding: Rounding) -> FloatArray:
    """Return readings (N, 3) corrected for the half step that the rounding took: lsb (3,)."""
    if rounding == "nearest":
        return values
    direction = np.sign(values) * (np.abs(values) > 0.5 * lsb) if rounding == "toward_zero" else 1.0
    return np.asarray(values + 0.5 * lsb * direction)


def restored_gyro(gyro: FloatArray, adc: AdcModel | None) -> FloatArray:
    """Return gyroscope readings (N, 3) corrected for the half steps that the rounding took."""
    if adc is None or adc.gyro_lsb is None:
        return gyro
    return without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)


def restored(record: Record, adc: AdcModel | None, codes: FloatArray | None = None) -> Record:
    """Return a record corrected for the half steps that the rounding took, gyroscopes by what a fit found of them, (3,)."""
    if adc is None:
        return record
    accel, gyro = record.accel, None if record.gyro is None else restored_gyro(record.gyro, adc)
    if codes is not None and record.gyro is not None:
        gyro = record.gyro + codes * np.sign(record.gyro)
    if accel is not None and adc.accel_lsb is not None:
        accel = without_truncation(accel, adc.accel_lsb, adc.accel_rounding)
    return replace(record, gyro=gyro, accel=accel)
