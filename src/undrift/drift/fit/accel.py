"""Accelerometers over temperature: offset(T) and matrix(T) from poses at rest at several temperatures.

The constant calibration makes v = M0 (u - o0) of a reading. At temperature T the length of gravity shows, over the poses k, ::

    |P (v_k - d)| = g        M(T) = P(T) M0        offset(T) = o0 + M0^-1 d(T)

P is symmetric: a common turn of all three sensors shows in no length, and the case's axes stay those of the calibration. Where two
temperatures or more have poses enough, each is fitted by itself (``calibration/fit/norm.py``: nine parameters, or six where
the poses lie on the faces) and the parameters go through a smoothing spline. Else all poses of all temperatures are fitted at
once, with d and a diagonal P linear in T.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.fit.norm import WEAKEST, NormFit, fit_norm
from undrift.calibration.model import AXES, Calibration, DriftTables, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.drift.fit.scale import NodeSettings
from undrift.drift.fit.spline import fit_smooth
from undrift.drift.fit.static import near_data
from undrift.drift.fit.warm_poses import JOINT_NAMES, WarmPoses, fit_joint, warm_poses
from undrift.drift.observe.observations import RestBlocks
from undrift.errors import CalibrationError, InputError, NotObservable
from undrift.units import si_factor

_SYMMETRIC = (np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2]))  # rows and columns of P's six elements
_FULL, _DIAGONAL = 9, 6
_MISSES_G = (3e-3, 2e-2)  # rms residual length from which a joint fit is marginal, and bad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelDriftFit:
    """Accelerometer offset and matrix over temperature, n nodes.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Nodes, degC.
    offset, offset_uncertainty : array, shape (n, 3)
        Absolute, raw unit.
    matrix, matrix_uncertainty : array, shape (n, 3, 3)
        The model's unit_out per raw unit.
    extrapolated : array of bool, shape (n,)
        True where no poses were near.
    percent_per_k, percent_per_k_uncertainty : array, shape (3,)
        Slope of each axis' sensitivity over the span seen, %/K.
    method : str
        by temperature, or joint.
    verdict : Verdict
        In words.
    """

    temp_c: FloatArray
    offset: FloatArray
    offset_uncertainty: FloatArray
    matrix: FloatArray
    matrix_uncertainty: FloatArray
    extrapolated: BoolArray
    percent_per_k: FloatArray
    percent_per_k_uncertainty: FloatArray
    method: str
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Curves:
    """P's six elements and d at the nodes and at the ends of the data, with standard uncertainties."""

    value: FloatArray  # (n + 2, 9)
    uncertainty: FloatArray
    method: str
    verdict: Verdict


def fit_accel_drift(
    rests: RestBlocks,
    calibration: Calibration,
    *,
    temp_c: FloatArray,
    settings: NodeSettings = NodeSettings(),
) -> AccelDriftFit:
    """Fit the accelerometers' offset and matrix over temperature.

    Parameters
    ----------
    rests : RestBlocks
        Poses at rest at two temperatures or more.
    calibration : Calibration
        The device's constant model and local gravity.
    temp_c : array, shape (n,)
        Nodes, degC, increasing.
    settings : NodeSettings
        Marks of extrapolation.

    Returns
    -------
    AccelDriftFit
        Offsets and matrices with uncertainty.

    Raises
    ------
    InputError
        A calibration without accelerometers, or no block with reading and temperature.
    NotObservable
        One temperature, one pose, or poses that leave a parameter unseen.
    """
    model = calibration.accel
    if model is None:
        raise InputError(
            "accelerometers over temperature: wanted a calibration with accelerometers, got one without; calibrate six faces first"
        )
    poses = warm_poses(rests, model)
    if np.ptp(poses.temp_c) < 2.0:
        raise NotObservable(
            f"accelerometers over temperature: wanted poses 2 degC apart or more, got {np.ptp(poses.temp_c):.2g} degC; rest on the "
            "same faces at another temperature"
        )
    at = np.concatenate((temp_c, [poses.temp_c.min(), poses.temp_c.max()]))
    curves = _by_temperature(poses, calibration.gravity_m_s2, at) or _joint(poses, calibration.gravity_m_s2, at)
    return _made(curves, model, poses, temp_c, settings)


def with_accel(tables: DriftTables, fit: AccelDriftFit) -> DriftTables:
    """Return tuning tables with the accelerometers' part.

    Parameters
    ----------
    tables : DriftTables
        Of the same device; static and scale tables, where there are any, on the same nodes.
    fit : AccelDriftFit
        Offsets and matrices.

    Returns
    -------
    DriftTables
        The same gyroscope tables.

    Raises
    ------
    InputError
        Tables on other nodes.
    """
    for table in (tables.static, tables.scale):
        if table is not None and not np.array_equal(table.temp_c, fit.temp_c):
            raise InputError(
                f"accelerometer tables: wanted the nodes of the gyroscope tables, {len(table.temp_c)} from {table.temp_c[0]:g} to "
                f"{table.temp_c[-1]:g} degC, got {len(fit.temp_c)} from {fit.temp_c[0]:g} to {fit.temp_c[-1]:g}; fit on the same"
            )
    static = tables.static or StaticDrift(temp_c=fit.temp_c)
    scale = tables.scale or ScaleDrift(temp_c=fit.temp_c)
    return replace(
        tables,
        static=replace(
            static,
            accel_offset=fit.offset,
            accel_uncertainty=fit.offset_uncertainty,
            accel_extrapolated=fit.extrapolated,
        ),
        scale=replace(
            scale,
            accel_matrix=fit.matrix,
            accel_uncertainty=fit.matrix_uncertainty,
            accel_extrapolated=fit.extrapolated,
        ),
    )


def _by_temperature(poses: WarmPoses, gravity: float, at: FloatArray) -> _Curves | None:
    """Fit each temperature by itself; None where fewer than two have poses enough."""
    for count in (_FULL, _DIAGONAL):
        temps, values, variances = [], [], []
        for s in np.unique(poses.group):
            rows = poses.group == s
            fit = _norm(poses.v[rows], poses.variance[rows], gravity, count)
            if fit is not None:
                value, variance = _symmetric(fit)
                temps.append(poses.temp_c[rows].mean())
                values.append(value)
                variances.append(variance)
        if len(temps) >= 2 and np.ptp(temps) > 0.8 * np.ptp(poses.temp_c):
            break
    else:
        return None
    free = np.arange(9) if count == _FULL else np.array([0, 1, 2, 6, 7, 8])
    found = fit_smooth(np.array(temps), np.array(values)[:, free], np.array(variances)[:, free]).at(at)
    value, uncertainty = np.zeros((len(at), 9)), np.zeros((len(at), 9))
    value[:, free], uncertainty[:, free] = found.value, found.uncertainty
    reasons = (
        [] if len(temps) > 2 else ["accelerometers: two temperatures draw a line and cannot show a bend; add a third"]
    )
    if count == _DIAGONAL:
        reasons.append(
            "accelerometers: the poses show offset and sensitivity over temperature; cross-axis terms are held at the "
            "calibration's, add poses on edges and corners at each temperature to see them change"
        )
    return _Curves(
        value=value,
        uncertainty=uncertainty,
        method="by temperature",
        verdict=Verdict(status="good" if len(temps) > 2 else "marginal", reasons=tuple(reasons)),
    )


def _norm(v: FloatArray, variance: FloatArray, gravity: float, count: int) -> NormFit | None:
    if len(v) < count:
        return None
    try:
        fit = fit_norm(v, gravity=gravity, variances=variance, cross_axis=count == _FULL)
    except CalibrationError:
        return None
    return fit if fit.weakest >= WEAKEST else None


def _symmetric(fit: NormFit) -> tuple[FloatArray, FloatArray]:
    """Return P's six elements and d of a solution, with the variance of each to first order."""

    def made(p: FloatArray) -> FloatArray:
        solution = replace(fit, p=p)
        values, vectors = np.linalg.eigh(solution.matrix.T @ solution.matrix)
        root = (vectors * np.sqrt(values)) @ vectors.T
        return np.concatenate((root[_SYMMETRIC], solution.offset))

    steps = np.array([1e-6] * 6 + [1e-5] * 3)
    slopes = [(made(fit.p + h * e) - made(fit.p - h * e)) / (2.0 * h) for h, e in zip(steps, np.eye(9), strict=True)]
    jacobian = np.array(slopes).T
    return made(fit.p), np.diag(jacobian @ fit.covariance @ jacobian.T).copy()


def _joint(poses: WarmPoses, gravity: float, at: FloatArray) -> _Curves:
    """Fit all poses at once: d and a diagonal P, linear in temperature."""
    fit = fit_joint(poses, gravity)
    warm = at - fit.origin_c
    value, variance = np.zeros((len(at), 9)), np.zeros((len(at), 9))
    for column, (constant, slope) in enumerate(zip(range(6), range(6, 12), strict=True)):
        place = column if column < 3 else column + 3
        value[:, place] = fit.p[constant] + fit.p[slope] * warm
        c = fit.covariance
        variance[:, place] = c[constant, constant] + 2.0 * warm * c[constant, slope] + warm**2 * c[slope, slope]
    reason = (
        f"accelerometers: no two temperatures have six poses each, so that {len(JOINT_NAMES)} parameters, offset and sensitivity "
        "linear in temperature, were fitted to all poses at once; rest on all six faces at three temperatures to see bends"
    )
    return _Curves(
        value=value,
        uncertainty=np.sqrt(np.maximum(variance, 0.0)),
        method="joint",
        verdict=Verdict(status="marginal", reasons=(reason,)).also(_missing_gravity(fit.rms / gravity)),
    )


def _missing_gravity(rms_g: float) -> Verdict:
    if rms_g < _MISSES_G[0]:
        return Verdict()
    return Verdict(
        status="bad" if rms_g > _MISSES_G[1] else "marginal",
        reasons=(
            f"accelerometers over temperature: poses miss gravity by {1e3 * rms_g:.2g} mg rms (wanted {1e3 * _MISSES_G[0]:g}): the "
            "device moved in some of them, or is not linear in temperature",
        ),
    )


def _made(
    curves: _Curves, model: TriadModel, poses: WarmPoses, nodes: FloatArray, settings: NodeSettings
) -> AccelDriftFit:
    n, unit = len(nodes), si_factor(model.unit_out, "accel")
    symmetric, spread = np.zeros((n + 2, 3, 3)), np.zeros((n + 2, 3, 3))
    for k, (i, j) in enumerate(zip(*_SYMMETRIC, strict=True)):
        symmetric[:, i, j] = symmetric[:, j, i] = curves.value[:, k]
        spread[:, i, j] = spread[:, j, i] = curves.uncertainty[:, k]
    own = model.standard_uncertainty[:9].reshape(3, 3).copy()
    if (spread[:, 0, 1] == 0.0).all():
        np.fill_diagonal(own, 0.0)  # measured anew; what lies off the diagonal is the calibration's
    else:
        own[:] = 0.0
    back = model.forward_matrix / unit
    slope = 100.0 * (symmetric[n + 1] - symmetric[n]).diagonal() / (poses.temp_c.max() - poses.temp_c.min())
    doubt = 100.0 * np.hypot(spread[n + 1].diagonal(), spread[n].diagonal()) / np.ptp(poses.temp_c)
    reasons = tuple(
        f"accelerometer {axis}: sensitivity {-s:+.4f} +- {2.0 * u:.2g} %/K (95 %)"
        for axis, s, u in zip(AXES, slope, doubt, strict=True)
    )
    return AccelDriftFit(
        temp_c=nodes,
        offset=model.offset + curves.value[:n, 6:] @ back.T,
        offset_uncertainty=np.sqrt(curves.uncertainty[:n, 6:] ** 2 @ (back**2).T),
        matrix=symmetric[:n] @ model.matrix,
        matrix_uncertainty=np.sqrt(spread[:n] ** 2 @ model.matrix**2 + own**2),
        extrapolated=~near_data(nodes, poses.temp_c, edge_c=settings.edge_c, gap_c=settings.gap_c),
        percent_per_k=-slope,
        percent_per_k_uncertainty=doubt,
        method=curves.method,
        verdict=curves.verdict.also(Verdict(reasons=reasons)).also(poses.verdict),
    )
