"""Accelerometers over temperature: offset(T) and matrix(T) from poses at rest at several temperatures.

The constant calibration turns a reading u into v = M0 (u - o0). At temperature T the length of gravity determines, over poses k, ::

    |P (v_k - d)| = g        M(T) = P(T) M0        offset(T) = o0 + M0^-1 d(T)

P is diagonal: the sensitivity of each axis changes, and cross-axis terms and the axes of the case remain those of the calibration.
Each temperature has a separate fit (calibration/norm.py) to six poses or more, and a smooth curve (fit/curve.py) joins them.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.norm import fit_norm
from undrift.drift.observe import RestBlocks
from undrift.drift.offset import bins_of, near_data
from undrift.drift.rates import MATRIX_GAP_C
from undrift.errors import CalibrationError, NotObservable
from undrift.fit.curve import fit_curve
from undrift.model import TriadModel
from undrift.units import si_factor

_SCALES, _OFFSETS = np.array([0, 3, 5]), np.array([6, 7, 8])  # diagonal of P, and d, among the parameters of a norm fit
_POSES = 6  # fewest poses at a temperature
_SQUARE = 1e-6  # prior standard deviation of cross-axis terms, which are not fitted
_SAME_TEMPERATURE_C = 1.5
_COVERED = 0.8  # share of the span of all poses that the fitted temperatures must cover [assumed]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelDriftFit:
    """Accelerometer offset and matrix over temperature, n nodes."""

    temp_c: FloatArray  # (n,), degC
    offset: FloatArray  # (n, 3), absolute, raw unit
    offset_uncertainty: FloatArray  # (n, 3), raw unit
    matrix: FloatArray  # (n, 3, 3), the model's unit_out per raw unit
    matrix_uncertainty: FloatArray  # (n, 3, 3)
    extrapolated: BoolArray  # (n,), True if there were no poses near the node


def fit_accel_drift(rests: RestBlocks, model: TriadModel, *, gravity: float, temp_c: FloatArray) -> AccelDriftFit:
    """Fit the accelerometers' offset and matrix over temperature, at nodes (n,), degC, for gravity in m/s2."""
    rests = rests.taken(np.isfinite(rests.accel).all(axis=1) & np.isfinite(rests.temp_c))
    rests = rests.taken(np.argsort(rests.temp_c, kind="stable"))
    temps, values, variances = _fit_temperatures(rests, model, gravity)
    curve = fit_curve(temps, values, variances).at(temp_c)
    (scale, offset), (scale_spread, offset_spread) = (
        np.split(table, 2, axis=1) for table in (curve.value, curve.uncertainty)
    )
    cross_axis = model.standard_uncertainty[:9].reshape(3, 3) * (1.0 - np.eye(3))
    raw_per_si = model.forward_matrix / si_factor(model.unit_out, "accel")
    return AccelDriftFit(
        temp_c=temp_c,
        offset=model.offset + offset @ raw_per_si.T,
        offset_uncertainty=np.sqrt(offset_spread**2 @ (raw_per_si**2).T),
        matrix=scale[:, :, None] * model.matrix,
        matrix_uncertainty=np.hypot(scale_spread[:, :, None] * np.abs(model.matrix), cross_axis),
        extrapolated=~near_data(temp_c, rests.temp_c, gap_c=MATRIX_GAP_C),
    )


def _fit_temperatures(
    rests: RestBlocks, model: TriadModel, gravity: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fitted temperatures, (m,), the diagonal of P and d at each, (m, 6), and their variances."""
    unit, groups = si_factor(model.unit_out, "accel"), bins_of(rests.temp_c, _SAME_TEMPERATURE_C)
    v = (rests.accel - model.offset) @ model.matrix.T * unit
    variance = rests.accel_variance @ (model.matrix.T * unit) ** 2
    variance = np.where(np.isfinite(variance), variance, np.nanmedian(variance, axis=0))
    temps, values, variances = list[float](), list[FloatArray](), list[FloatArray]()
    for group in np.unique(groups):
        poses = [np.flatnonzero((groups == group) & (rests.pose == pose)) for pose in np.unique(rests.pose)]
        poses = [rows for rows in poses if len(rows)]
        means = np.array([v[rows].mean(axis=0) for rows in poses])
        noise = np.array([variance[rows].mean(axis=0) / len(rows) for rows in poses])
        try:
            fit = fit_norm(means, gravity=gravity, variances=noise, prior_sd=_SQUARE) if len(poses) >= _POSES else None
        except CalibrationError:
            continue
        if fit is not None:
            spread, scale = np.diag(fit.covariance), fit.scale
            temps.append(float(rests.temp_c[groups == group].mean()))
            values.append(np.concatenate((scale * fit.p[_SCALES], fit.offset)))
            variances.append(np.concatenate((scale**2 * spread[_SCALES], spread[_OFFSETS] / scale**2)))
    if len(temps) < 2 or temps[-1] - temps[0] <= _COVERED * np.ptp(rests.temp_c):
        raise NotObservable(
            f"accelerometers over temperature: {len(np.unique(rests.pose))} poses over {np.ptp(rests.temp_c):.1f} degC do not "
            "determine offset and sensitivity at two temperatures. Rest on all six faces at three temperatures.",
            temperatures=len(temps),
        )
    return np.array(temps), np.array(values), np.array(variances)
