"""Accelerometers over temperature: offset(T) and matrix(T) from poses at rest at several temperatures.

The constant calibration makes v = M0 (u - o0) of a reading. At temperature T the length of gravity shows, over the poses k, ::

    |P (v_k - d)| = g        M(T) = P(T) M0        offset(T) = o0 + M0^-1 d(T)

P is symmetric: a common turn of all three sensors shows in no length, and the case's axes stay those of the calibration. Where two
temperatures or more have poses enough, each is fitted by itself (calibration/norm.py: nine parameters, or six where the
poses lie on the faces) and the parameters go through a smoothing spline. Else all poses of all temperatures are fitted together::

    |(1 + s0 + s1 D) (v - d0 - d1 D)| = g          per axis, D = T - T_0, T_0 the mean temperature of the poses

Twelve parameters by Gauss-Newton steps from zero, weighted by the variances of the lengths; what the residuals show beyond them is
added.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.norm import WEAKEST, NormFit, fit_norm
from undrift.drift.observe import RestBlocks
from undrift.drift.offset import bins_of, near_data
from undrift.drift.rate_steps import MATRIX_GAP_C
from undrift.errors import CalibrationError, InputError, NotObservable, PoorFit
from undrift.findings import Level, finding
from undrift.fit.curve import fit_curve
from undrift.fit.least_squares import excess_variance
from undrift.model import AXES, Calibration, DriftTables, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.units import si_factor

JOINT_NAMES = tuple(
    f"{what} {axis}{per}" for per in ("", " per K") for what in ("sensitivity", "offset") for axis in AXES
)
_SYMMETRIC = (np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2]))  # rows and columns of P's six elements
_FULL, _DIAGONAL = 9, 6
_ON_AXES = np.array([0, 1, 2, 6, 7, 8])  # P's diagonal and d
_MISSES_G = (3e-3, 2e-2)  # rms residual length from which a joint fit is marginal, and bad
_MOST_STEPS = 50
_SETTLED = 1e-3  # of the standard deviation of a length: no step moves a length by more
_GROUP_C = 1.5  # poses within this of each other are at one temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelDriftFit:
    """Accelerometer offset and matrix over temperature, n nodes."""

    temp_c: FloatArray  # (n,), degC
    offset: FloatArray  # (n, 3), absolute, raw unit
    offset_uncertainty: FloatArray  # (n, 3), raw unit
    matrix: FloatArray  # (n, 3, 3), the model's unit_out per raw unit
    matrix_uncertainty: FloatArray  # (n, 3, 3)
    extrapolated: BoolArray  # (n,), true where no poses were near
    percent_per_k: FloatArray  # (3,), slope of each axis' sensitivity over the span seen, %/K
    percent_per_k_uncertainty: FloatArray  # (3,)
    method: str  # by temperature, or joint
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmPoses:
    """Mean readings of poses at rest, K rows, one for each pose and temperature."""

    temp_c: FloatArray  # (K,), degC
    group: IntArray  # (K,), poses of one number were at one temperature
    pose: IntArray  # (K,), which orientation
    v: FloatArray  # (K, 3), corrected by the constant model, m/s2
    variance: FloatArray  # (K, 3), of v, (m/s2)^2
    verdict: Verdict  # what was left out


def fit_accel_drift(rests: RestBlocks, calibration: Calibration, *, temp_c: FloatArray) -> AccelDriftFit:
    """Fit the accelerometers' offset and matrix over temperature, at nodes (n,), degC."""
    model = calibration.accel
    if model is None:
        raise InputError(
            "accelerometers over temperature: wanted a calibration with accelerometers, got one without; calibrate six faces first"
        )
    poses = warm_poses(rests, model)
    low, high = poses.temp_c.min(), poses.temp_c.max()
    if high - low < 2.0:
        raise NotObservable(
            f"accelerometers over temperature: wanted poses 2 degC apart or more, got {high - low:.2g} degC; rest on the "
            "same faces at another temperature"
        )
    n, at = len(temp_c), np.concatenate((temp_c, [low, high]))
    alone = _by_temperature(poses, calibration.gravity_m_s2, at)
    value, deviation, verdict = alone or _joint(poses, calibration.gravity_m_s2, at)
    symmetric, spread = np.zeros((n + 2, 3, 3)), np.zeros((n + 2, 3, 3))
    i, j = _SYMMETRIC
    symmetric[:, i, j] = symmetric[:, j, i] = value[:, :6]
    spread[:, i, j] = spread[:, j, i] = deviation[:, :6]
    cross_axis = np.zeros((3, 3))
    if (spread[:, 0, 1] == 0.0).all():  # not measured: the calibration's
        cross_axis = model.standard_uncertainty[:9].reshape(3, 3) * (1.0 - np.eye(3))
    back = model.forward_matrix / si_factor(model.unit_out, "accel")
    slope = 100.0 * (symmetric[n + 1] - symmetric[n]).diagonal() / (high - low)
    doubt = 100.0 * np.hypot(spread[n + 1].diagonal(), spread[n].diagonal()) / (high - low)
    scale = (
        finding("drift.accel_scale", "info", axis=axis, percent_per_k=-s, expanded_percent_per_k=2.0 * u)
        for axis, s, u in zip(AXES, slope, doubt, strict=True)
    )
    return AccelDriftFit(
        temp_c=temp_c,
        offset=model.offset + value[:n, 6:] @ back.T,
        offset_uncertainty=np.sqrt(deviation[:n, 6:] ** 2 @ (back**2).T),
        matrix=symmetric[:n] @ model.matrix,
        matrix_uncertainty=np.sqrt(spread[:n] ** 2 @ model.matrix**2 + cross_axis**2),
        extrapolated=~near_data(temp_c, poses.temp_c, gap_c=MATRIX_GAP_C),
        percent_per_k=-slope,
        percent_per_k_uncertainty=doubt,
        method="by temperature" if alone else "joint",
        verdict=verdict.also(Verdict.of(*scale)).also(poses.verdict),
    )


def with_accel(tables: DriftTables, fit: AccelDriftFit) -> DriftTables:
    """Return tuning tables with the accelerometers' part."""
    for table in (tables.static, tables.scale):
        if table is not None and not np.array_equal(table.temp_c, fit.temp_c):
            raise InputError(
                f"accelerometer tables: wanted the nodes of the gyroscope tables, {len(table.temp_c)} from {table.temp_c[0]:g} to "
                f"{table.temp_c[-1]:g} degC, got {len(fit.temp_c)} from {fit.temp_c[0]:g} to {fit.temp_c[-1]:g}; fit on the same"
            )
    static = replace(
        tables.static or StaticDrift(temp_c=fit.temp_c),
        accel_offset=fit.offset,
        accel_uncertainty=fit.offset_uncertainty,
        accel_extrapolated=fit.extrapolated,
        accel_visit=None,
    )
    scale = tables.scale or ScaleDrift(temp_c=fit.temp_c)
    scale = replace(
        scale, accel_matrix=fit.matrix, accel_uncertainty=fit.matrix_uncertainty, accel_extrapolated=fit.extrapolated
    )
    return replace(tables, static=static, scale=scale)


def _by_temperature(poses: WarmPoses, gravity: float, at: FloatArray) -> tuple[FloatArray, FloatArray, Verdict] | None:
    """Return P's six elements and d at temperatures, each fitted by itself; None where fewer than two have poses enough."""
    for count in (_FULL, _DIAGONAL):
        fits = []
        for s in np.unique(poses.group):
            rows = poses.group == s
            fit = _norm(poses.v[rows], poses.variance[rows], gravity, count)
            if fit is not None:
                fits.append((poses.temp_c[rows].mean(), *_symmetric(fit)))
        if len(fits) >= 2 and fits[-1][0] - fits[0][0] > 0.8 * np.ptp(poses.temp_c):
            break
    else:
        return None
    free = np.arange(9) if count == _FULL else _ON_AXES
    temps, values, variances = (np.array(column) for column in zip(*fits, strict=True))
    curve = fit_curve(temps, values[:, free], variances[:, free]).at(at)
    value, uncertainty = np.zeros((len(at), 9)), np.zeros((len(at), 9))
    value[:, free], uncertainty[:, free] = curve.value, curve.uncertainty
    notes = [finding("drift.accel_two_temperatures", "warn")] if len(fits) == 2 else []
    notes += [finding("drift.accel_faces_only", "info")] if count == _DIAGONAL else []
    return value, uncertainty, Verdict.of(*notes)


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


def _joint(poses: WarmPoses, gravity: float, at: FloatArray) -> tuple[FloatArray, FloatArray, Verdict]:
    """Fit all poses at once: d and a diagonal P, linear in temperature."""
    p, c, rms = fit_joint(poses, gravity)
    warm = (at - float(poses.temp_c.mean()))[:, None]
    value, variance = np.zeros((len(at), 9)), np.zeros((len(at), 9))
    value[:, _ON_AXES] = p[:6] + p[6:] * warm
    own = np.diag(c)
    variance[:, _ON_AXES] = own[:6] + 2.0 * warm * np.diag(c[:6, 6:]) + warm**2 * own[6:]
    notes = [finding("drift.accel_joint", "warn", parameters=len(JOINT_NAMES))]
    if rms / gravity > _MISSES_G[0]:
        level: Level = "fail" if rms / gravity > _MISSES_G[1] else "warn"
        limit = 1e3 * _MISSES_G[0]
        notes.append(finding("drift.accel_misses_gravity", level, rms_mg=1e3 * rms / gravity, limit_mg=limit))
    return value, np.sqrt(np.maximum(variance, 0.0)), Verdict.of(*notes)


# ---- poses at rest, and the fit of all of them together


def warm_poses(rests: RestBlocks, model: TriadModel) -> WarmPoses:
    """Gather blocks of rest into one row for each pose and temperature."""
    rows = np.flatnonzero(np.isfinite(rests.accel).all(axis=1) & np.isfinite(rests.temp_c))
    if not len(rows):
        raise InputError(
            f"accelerometers over temperature: wanted rests with readings and temperature, got {len(rests)} blocks and none of "
            "them usable; check the temperature column and the gaps"
        )
    used = rests.taken(rows[np.argsort(rests.temp_c[rows], kind="stable")])
    which, inside = np.unique(np.column_stack((bins_of(used.temp_c, _GROUP_C), used.pose)), axis=0, return_inverse=True)
    inside = inside.reshape(-1)
    count = np.bincount(inside)[:, None]

    def mean(x: FloatArray) -> FloatArray:
        return np.stack([np.bincount(inside, column) for column in x.T], axis=1) / count

    unit = si_factor(model.unit_out, "accel")
    known = np.isfinite(used.accel_variance) & (used.accel_variance > 0.0)
    variance = np.where(known, used.accel_variance, np.median(used.accel_variance[known]) if known.any() else 0.0)
    lost = len(rests) - len(rows)
    gaps = [finding("drift.accel_left_out", "warn", count=lost, blocks=len(rests))] if lost else []
    return WarmPoses(
        temp_c=mean(used.temp_c[:, None])[:, 0],
        group=which[:, 0],
        pose=which[:, 1],
        v=(mean(used.accel) - model.offset) @ model.matrix.T * unit,
        variance=mean(variance) / count @ (model.matrix.T * unit) ** 2,
        verdict=Verdict.of(*gaps),
    )


def fit_joint(poses: WarmPoses, gravity: float) -> tuple[FloatArray, FloatArray, float]:
    """Fit offset and sensitivity, both linear in temperature, to all poses at once.

    Returns p (12,): 1 + s0 (3), d0 (3, m/s2), s1 (3, 1/K), d1 (3, m/s2/K), its covariance, and the rms residual length, m/s2.
    """
    warm = poses.temp_c - float(poses.temp_c.mean())
    _check_seen(poses, warm, gravity)
    p = np.concatenate((np.ones(3), np.zeros(9)))
    variance = np.full(len(warm), 1.0)
    for _ in range(_MOST_STEPS):
        design, residual = _linearised(poses.v, warm, p, gravity)
        weighted = design / np.sqrt(variance)[:, None]
        step = np.linalg.lstsq(weighted, -residual / np.sqrt(variance), rcond=1e-12)[0]
        p = p + step
        stated = (design[:, 3:6] ** 2 * poses.variance).sum(axis=1)
        residual = _linearised(poses.v, warm, p, gravity)[1]
        variance = np.maximum(stated + excess_variance(residual, stated, len(warm) - 12), (1e-9 * gravity) ** 2)
        if float(np.abs(weighted @ step).max()) < _SETTLED:
            break
    else:
        raise PoorFit(
            f"accelerometers over temperature: wanted {len(warm)} poses of length {gravity:g} m/s2, got none that a device whose "
            "offset and sensitivity are linear in temperature could give; check that it lay still"
        )
    design = _linearised(poses.v, warm, p, gravity)[0] / np.sqrt(variance)[:, None]
    return p, np.linalg.inv(design.T @ design), float(np.sqrt(np.mean(residual**2)))


def _linearised(v: FloatArray, warm: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 12) and residual length (K,) at p."""
    gain = p[0:3] + warm[:, None] * p[6:9]
    centred = v - p[3:6] - warm[:, None] * p[9:12]
    length = np.linalg.norm(gain * centred, axis=1)
    n = gain * centred / length[:, None]
    by_gain, by_offset = n * centred, -n * gain
    return np.column_stack((by_gain, by_offset, by_gain * warm[:, None], by_offset * warm[:, None])), length - gravity


def _check_seen(poses: WarmPoses, warm: FloatArray, gravity: float) -> None:
    """Raise where a combination of parameters changes no length."""
    start = np.concatenate((np.ones(3), np.zeros(9)))
    spread = float(np.std(warm))
    size = np.array([1.0 / gravity] * 3 + [1.0] * 3 + [1.0 / gravity / spread] * 3 + [1.0 / spread] * 3)
    design = _linearised(poses.v, warm, start, gravity)[0] * size
    _, singular, right = np.linalg.svd(design, full_matrices=True)
    strength = np.zeros(12)
    strength[: len(singular)] = singular / np.sqrt(len(warm))
    weak = np.flatnonzero(strength < WEAKEST)
    if not len(weak):
        return
    share = np.linalg.norm(right[weak], axis=0)
    unseen = tuple(JOINT_NAMES[i] for i in np.flatnonzero(share > 0.3 * share.max()))
    count = len(np.unique(poses.pose))
    raise NotObservable(
        f"accelerometers over temperature: wanted poses that show all twelve parameters, got {count} poses and {len(warm)} means "
        f"that leave {', '.join(unseen)} open; rest on all six faces at two temperatures or more",
        parameters=unseen,
        poses=count,
    )
