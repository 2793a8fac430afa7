"""Accelerometers over temperature: offset(T) and matrix(T) from poses at rest at several temperatures.

The constant calibration turns a reading u into v = M0 (u - o0). At temperature T the length of gravity determines, over poses k, ::

    |P (v_k - d)| = g        M(T) = P(T) M0        offset(T) = o0 + M0^-1 d(T)

P is symmetric, because the length of gravity does not determine a common rotation of all three sensors. The case axes therefore
stay the axes of the calibration. Each temperature has a separate fit (calibration/norm.py) with nine parameters, or with six if the
poses are on the faces. A smooth curve (fit/curve.py) goes through the parameters.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.norm import NormFit, fit_norm
from undrift.drift.observe import RestBlocks
from undrift.drift.offset import bins_of, near_data
from undrift.drift.rates import MATRIX_GAP_C, two_temperatures
from undrift.errors import CalibrationError, InputError, NotObservable
from undrift.fit.curve import fit_curve
from undrift.model import Calibration, TriadModel, Verdict
from undrift.units import si_factor

_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])  # row and column of the six elements of P
_FULL, _DIAGONAL = 9, 6  # parameters, and poses that are needed
_ON_AXES = np.array([0, 1, 2, 6, 7, 8])  # diagonal of P, and d
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
    extrapolated: BoolArray  # (n,), True if no poses were near
    verdict: Verdict


def fit_accel_drift(rests: RestBlocks, calibration: Calibration, *, temp_c: FloatArray) -> AccelDriftFit:
    """Fit the accelerometers' offset and matrix over temperature, at nodes (n,), degC."""
    model = calibration.accel
    if model is None:
        raise InputError("accelerometers over temperature: the calibration has no accelerometers. Calibrate six faces.")
    rests = rests.taken(np.isfinite(rests.accel).all(axis=1) & np.isfinite(rests.temp_c))
    if not len(rests):
        raise InputError(
            "accelerometers over temperature: no rest has a reading and a temperature. Check the temperature column and the gaps."
        )
    rests = rests.taken(np.argsort(rests.temp_c, kind="stable"))
    free, poses_c, temps, values, variances = _fit_temperatures(rests, model, calibration.gravity_m_s2)
    curve = fit_curve(temps, values[:, free], variances[:, free]).at(temp_c)
    value, deviation = np.zeros((2, len(temp_c), 9))
    value[:, free], deviation[:, free] = curve.value, curve.uncertainty
    symmetric, spread = np.zeros((2, len(temp_c), 3, 3))
    symmetric[:, _ROWS, _COLUMNS] = symmetric[:, _COLUMNS, _ROWS] = value[:, :6]
    spread[:, _ROWS, _COLUMNS] = spread[:, _COLUMNS, _ROWS] = deviation[:, :6]
    cross_axis = np.zeros((3, 3))
    if len(free) == _DIAGONAL:  # not measured: the calibration's
        cross_axis = model.standard_uncertainty[:9].reshape(3, 3) * (1.0 - np.eye(3))
    raw_per_si = model.forward_matrix / si_factor(model.unit_out, "accel")
    return AccelDriftFit(
        temp_c=temp_c,
        offset=model.offset + value[:, 6:] @ raw_per_si.T,
        offset_uncertainty=np.sqrt(deviation[:, 6:] ** 2 @ (raw_per_si**2).T),
        matrix=symmetric @ model.matrix,
        matrix_uncertainty=np.sqrt(spread**2 @ model.matrix**2 + cross_axis**2),
        extrapolated=~near_data(temp_c, poses_c, gap_c=MATRIX_GAP_C),
        verdict=Verdict.of(*([two_temperatures("accelerometers")] if len(temps) == 2 else [])),
    )


def _fit_temperatures(
    rests: RestBlocks, model: TriadModel, gravity: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit each temperature. Return the free parameters, all temperatures, the fitted temperatures, P and d, and their variances."""
    unit, groups = si_factor(model.unit_out, "accel"), bins_of(rests.temp_c, _SAME_TEMPERATURE_C)
    v = (rests.accel - model.offset) @ model.matrix.T * unit
    variance = rests.accel_variance @ (model.matrix.T * unit) ** 2
    variance = np.where(np.isfinite(variance), variance, np.nanmedian(variance, axis=0))
    for count in (_FULL, _DIAGONAL):
        fits = []
        for group in np.unique(groups):
            poses = [np.flatnonzero((groups == group) & (rests.pose == pose)) for pose in np.unique(rests.pose)]
            poses = [rows for rows in poses if len(rows)]
            means = np.array([v[rows].mean(axis=0) for rows in poses])
            variances = np.array([variance[rows].mean(axis=0) / len(rows) for rows in poses])
            fit = _fit_poses(means, variances, gravity, count)
            if fit is not None:
                fits.append((rests.temp_c[groups == group].mean(), *_symmetric(fit)))
        if len(fits) >= 2 and fits[-1][0] - fits[0][0] > _COVERED * np.ptp(rests.temp_c):
            free = np.arange(9) if count == _FULL else _ON_AXES
            temps, values, variances = (np.array(column) for column in zip(*fits, strict=True))
            return free, rests.temp_c, temps, values, variances
    raise NotObservable(
        f"accelerometers over temperature: {len(np.unique(rests.pose))} poses over {np.ptp(rests.temp_c):.1f} degC do not "
        "determine offset and sensitivity at two temperatures. Rest on all six faces at three temperatures.",
        temperatures=len(fits),
    )


def _fit_poses(v: FloatArray, variance: FloatArray, gravity: float, count: int) -> NormFit | None:
    if len(v) < count:
        return None
    try:
        return fit_norm(v, gravity=gravity, variances=variance, cross_axis=count == _FULL)
    except CalibrationError:
        return None


def _symmetric(fit: NormFit) -> tuple[FloatArray, FloatArray]:
    """Return P's six elements and d of a solution, with the variance of each to first order."""

    def symmetric(p: FloatArray) -> FloatArray:
        solution = replace(fit, p=p)
        values, vectors = np.linalg.eigh(solution.matrix.T @ solution.matrix)
        root = (vectors * np.sqrt(values)) @ vectors.T
        return np.concatenate((root[_ROWS, _COLUMNS], solution.offset))

    steps = np.array([1e-6] * 6 + [1e-5] * 3)
    jacobian = np.array(
        [(symmetric(fit.p + step) - symmetric(fit.p - step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    ).T
    return symmetric(fit.p), np.diag(jacobian @ fit.covariance @ jacobian.T).copy()
