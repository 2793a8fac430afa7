"""Poses at rest at several temperatures, and the fit of all of them at once.

::

    |(1 + s0 + s1 D) (v - d0 - d1 D)| = g          per axis, D = T - T_0, T_0 the mean temperature of the poses

Twelve parameters by Gauss-Newton steps from none of it, weighted by the variances of the lengths; what the residuals show beyond
them is added.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.fit.norm import WEAKEST
from undrift.calibration.model import AXES, TriadModel, Verdict
from undrift.drift.observe.observations import RestBlocks
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.units import si_factor

JOINT_NAMES = (
    *(f"sensitivity {axis}" for axis in AXES),
    *(f"offset {axis}" for axis in AXES),
    *(f"sensitivity {axis} per K" for axis in AXES),
    *(f"offset {axis} per K" for axis in AXES),
)
_MOST_STEPS = 50
_SETTLED = 1e-3  # of the standard deviation of a length: no step moves a length by more
_GROUP_C = 1.5  # poses within this of each other are at one temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmPoses:
    """Mean readings of poses at rest, K rows, one for each pose and temperature.

    Parameters
    ----------
    temp_c : array, shape (K,)
        degC.
    group : array of int, shape (K,)
        Poses of one number were at one temperature.
    pose : array of int, shape (K,)
        Which orientation.
    v : array, shape (K, 3)
        What the constant model makes of them, m/s2.
    variance : array, shape (K, 3)
        Of v, (m/s2)^2.
    verdict : Verdict
        What was left out.
    """

    temp_c: FloatArray
    group: IntArray
    pose: IntArray
    v: FloatArray
    variance: FloatArray
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFit:
    """All poses fitted at once.

    Parameters
    ----------
    p : array, shape (12,)
        1 + s0 (3), d0 (3, m/s2), s1 (3, 1/K), d1 (3, m/s2/K).
    covariance : array, shape (12, 12)
        Of p.
    origin_c : float
        T_0, degC.
    rms : float
        Residual length, m/s2.
    """

    p: FloatArray
    covariance: FloatArray
    origin_c: float
    rms: float


def warm_poses(rests: RestBlocks, model: TriadModel) -> WarmPoses:
    """Gather blocks of rest into one row for each pose and temperature.

    Parameters
    ----------
    rests : RestBlocks
        With accelerometer readings.
    model : TriadModel
        The constant model of the accelerometers.

    Returns
    -------
    WarmPoses
        In the order of temperature.

    Raises
    ------
    InputError
        No block with reading and temperature.
    """
    rows = np.flatnonzero(np.isfinite(rests.accel).all(axis=1) & np.isfinite(rests.temp_c))
    if not len(rows):
        raise InputError(
            f"accelerometers over temperature: wanted rests with readings and temperature, got {len(rests)} blocks and none of "
            "them usable; check the temperature column and the gaps"
        )
    used = rests.taken(rows[np.argsort(rests.temp_c[rows], kind="stable")])
    temps, group, start = used.temp_c, np.zeros(len(used), dtype=np.int64), float(used.temp_c[0])
    for k in range(1, len(temps)):
        begins = temps[k] - start > _GROUP_C
        start = float(temps[k]) if begins else start
        group[k] = group[k - 1] + begins
    which, inside = np.unique(np.column_stack((group, used.pose)), axis=0, return_inverse=True)
    count = np.bincount(inside.reshape(-1))[:, None]

    def mean(x: FloatArray) -> FloatArray:
        return np.stack([np.bincount(inside.reshape(-1), column) for column in x.T], axis=1) / count

    unit = si_factor(model.unit_out, "accel")
    told = np.isfinite(used.accel_variance) & (used.accel_variance > 0.0)
    variance = np.where(told, used.accel_variance, np.median(used.accel_variance[told]) if told.any() else 0.0)
    lost = len(rests) - len(rows)
    reason = f"{lost} of {len(rests)} blocks of rest have gaps in accelerometer or temperature and were left out"
    return WarmPoses(
        temp_c=mean(temps[:, None])[:, 0],
        group=which[:, 0],
        pose=which[:, 1],
        v=(mean(used.accel) - model.offset) @ model.matrix.T * unit,
        variance=mean(variance) / count @ (model.matrix.T * unit) ** 2,
        verdict=Verdict(status="marginal", reasons=(reason,)) if lost else Verdict(),
    )


def fit_joint(poses: WarmPoses, gravity: float) -> JointFit:
    """Fit offset and sensitivity, both linear in temperature, to all poses at once.

    Parameters
    ----------
    poses : WarmPoses
        At two temperatures or more.
    gravity : float
        Local gravity, m/s2.

    Returns
    -------
    JointFit
        With covariance.

    Raises
    ------
    NotObservable
        Poses that leave a parameter unseen: it is named.
    PoorFit
        The steps do not settle.
    """
    origin = float(poses.temp_c.mean())
    warm = poses.temp_c - origin
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
    rms = float(np.sqrt(np.mean(residual**2)))
    return JointFit(p=p, covariance=np.linalg.inv(design.T @ design), origin_c=origin, rms=rms)


def _linearised(v: FloatArray, warm: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 12) and residual length (K,) at p."""
    gain = p[0:3] + warm[:, None] * p[6:9]
    centred = v - p[3:6] - warm[:, None] * p[9:12]
    a = gain * centred
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
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
