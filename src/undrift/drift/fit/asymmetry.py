"""Scale factor asymmetry over temperature: how far the two ways round differ (IEEE Std 528).

At each soak and axis, o the offset of the mounting::

    u = o + S+ max(w, 0) + S- min(w, 0)        asymmetry = 2 (S+ - S-) / (S+ + S-)
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.model import AXES, Calibration, StaticDrift, Verdict
from undrift.drift.fit.steps import Steps, offset_at, steps_of
from undrift.drift.observe.observations import RateSteps

_OWN = 0.9  # share of the turning rate from which a row speaks of one axis alone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Asymmetry:
    """Scale factor asymmetry of three gyroscopes at S soaks.

    Parameters
    ----------
    temp_c : array, shape (S,)
        degC, increasing.
    value, uncertainty : array, shape (S, 3)
        Dimensionless, with standard uncertainty; NaN where an axis did not turn both ways at two rates each.
    mean, mean_uncertainty : array, shape (3,)
        Over the soaks, weighted; their scatter beyond the stated noise counts.
    per_k, per_k_uncertainty : array, shape (3,)
        Slope over temperature, per K; NaN with fewer than three soaks.
    verdict : Verdict
        In words.
    """

    temp_c: FloatArray
    value: FloatArray
    uncertainty: FloatArray
    mean: FloatArray
    mean_uncertainty: FloatArray
    per_k: FloatArray
    per_k_uncertainty: FloatArray
    verdict: Verdict


def scale_asymmetry(
    steps: RateSteps | Steps, calibration: Calibration, *, static: StaticDrift | None = None
) -> Asymmetry:
    """Compare the scale factors of the two ways round at each soak.

    Parameters
    ----------
    steps : RateSteps or Steps
        Dwells at steady rates; one soak is enough.
    calibration : Calibration
        Gives the offset where there is no table.
    static : StaticDrift, optional
        Offset table, raw unit: takes out what the temperature does within a soak.

    Returns
    -------
    Asymmetry
        Per soak and axis, and over the soaks.

    Raises
    ------
    InputError
        Steps without a usable row, or a calibration without gyroscopes.
    """
    clean = steps_of(steps)
    reading = clean.gyro - offset_at(clean.temp_c, calibration, static)
    numbers = np.unique(clean.soak)
    temps = np.array([clean.temp_c[clean.soak == s].mean() for s in numbers])
    order = np.argsort(temps, kind="stable")
    value, doubt = np.full((len(numbers), 3), np.nan), np.full((len(numbers), 3), np.nan)
    for k, s in enumerate(numbers[order]):
        for axis in range(3):
            main = np.abs(clean.rate_b[:, axis]) > _OWN * np.linalg.norm(clean.rate_b, axis=1)
            rows = np.flatnonzero((clean.soak == s) & main)
            value[k, axis], doubt[k, axis] = _one(
                clean.rate_b[rows, axis], reading[rows, axis], clean.variance[rows, axis]
            )
    mean, mean_doubt, slope, slope_doubt = _over_soaks(temps[order], value, doubt)
    return Asymmetry(
        temp_c=temps[order],
        value=value,
        uncertainty=doubt,
        mean=mean,
        mean_uncertainty=mean_doubt,
        per_k=slope,
        per_k_uncertainty=slope_doubt,
        verdict=_verdict(mean, mean_doubt).also(clean.verdict),
    )


def _one(rate: FloatArray, reading: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Return the asymmetry of one axis at one soak and its standard uncertainty; NaN where it does not show."""
    if len(np.unique(rate[rate > 0.0])) < 2 or len(np.unique(rate[rate < 0.0])) < 2:
        return float("nan"), float("nan")
    z = rate / np.abs(rate).max()
    design = np.column_stack((np.ones_like(z), np.maximum(z, 0.0), np.minimum(z, 0.0)))
    full = np.column_stack((design, z**2, z**3)) if len(z) > 7 else design  # what bends is no noise
    noise = reading - full @ np.linalg.lstsq(full, reading, rcond=None)[0]
    v = variance + excess_variance(noise, variance, len(z) - np.linalg.matrix_rank(full))
    inverse = np.linalg.inv(design.T @ (design / v[:, None]))
    _, plus, minus = inverse @ (design.T @ (reading / v))
    total = plus + minus
    slope = np.array([0.0, 4.0 * minus, -4.0 * plus]) / total**2
    return float(2.0 * (plus - minus) / total), float(np.sqrt(slope @ inverse @ slope))


def _over_soaks(
    temp_c: FloatArray, value: FloatArray, doubt: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    mean, mean_doubt, slope, slope_doubt = (np.full(3, np.nan) for _ in range(4))
    for axis in range(3):
        have = np.isfinite(value[:, axis])
        t, y, v = temp_c[have], value[have, axis], doubt[have, axis] ** 2
        if not len(y):
            continue
        spread = v + excess_variance(y - np.average(y, weights=1.0 / v), v, len(y) - 1)
        mean[axis] = np.average(y, weights=1.0 / spread)
        mean_doubt[axis] = np.sqrt(1.0 / (1.0 / spread).sum())
        if len(y) < 3 or np.ptp(t) == 0.0:
            continue
        x = np.column_stack((np.ones(len(t)), t - t.mean()))
        left = y - x @ np.linalg.lstsq(x / np.sqrt(v)[:, None], y / np.sqrt(v), rcond=None)[0]
        v = v + excess_variance(left, v, len(y) - 2)
        inverse = np.linalg.inv(x.T @ (x / v[:, None]))
        slope[axis], slope_doubt[axis] = (inverse @ (x.T @ (y / v)))[1], np.sqrt(inverse[1, 1])
    return mean, mean_doubt, slope, slope_doubt


def _verdict(mean: FloatArray, doubt: FloatArray) -> Verdict:
    reasons, short = [], False
    for axis, a, u in zip(AXES, mean, doubt, strict=True):
        if np.isnan(a):
            short = True
            reasons.append(
                f"scale factor asymmetry of {axis} was not observable: turn about {axis} both ways at two rates each"
            )
        elif abs(a) > 3.0 * u:
            reasons.append(f"scale factor asymmetry of {axis}: {100.0 * a:+.3f} +- {200.0 * u:.2g} % (95 %)")
    return Verdict(status="marginal" if short else "good", reasons=tuple(reasons))
