"""Accelerometer against poses: matrix, offset, delay and lever arm by least squares on specific force.

With the motion of the optical body's origin from its poses (position p, orientation R_nb, rate w, its change w') the force
at the sensor, r from that origin, is::

    f + L r = M u(t + d) - c            f = R_nb^T (p'' + g z),  L = [w']x + [w]x [w]x,  c = M o

The optics are the noisy side (differentiated twice), the readings u the quiet one, so f is what is explained and no regressor
carries much noise. All terms are turned into n and low-passed there alike; then the model is linear in M, c and r, and in d
by the change of u with time. Residuals beyond 1.345 robust standard deviations count less (Huber). Filtered residuals are
kin to their neighbours, so the covariance is the sandwich over blocks of one second.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.result import scaled_condition
from undrift.calibration.model import MATRIX_NAMES, OFFSET_NAMES, TriadModel
from undrift.errors import InputError, NotObservable
from undrift.frames import rotation
from undrift.sim.motion.motion import Motion
from undrift.twin.match import Match, smoothed, stretches

CUTOFF_HZ = 10.0  # above it the second derivative of the poses is noise
BLOCK_S = 1.0
HUBER = 1.345
_REWEIGHTINGS = 10
_PASSES = 2  # the motion is asked again at the delay found
_LEAST_BLOCKS = 20
NAMES = (*MATRIX_NAMES, *OFFSET_NAMES, "lever_x", "lever_y", "lever_z", "delay")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelRows:
    """Equations of one recording.

    Parameters
    ----------
    design : array, shape (K, 3, 16)
        Matrix row by row, c, lever arm, delay; frame n.
    force : array, shape (K, 3)
        p'' + g z, m/s2.
    raw : array, shape (K, 3)
        Reading turned into n as it is, m/s2.
    block : array, shape (K,)
        Number of the second that each row belongs to.
    """

    design: FloatArray
    force: FloatArray
    raw: FloatArray
    block: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelFit:
    """An accelerometer fitted to poses.

    Parameters
    ----------
    model : TriadModel
        f = M (u - o) with covariance.
    lever_arm : array, shape (3,)
        From the optical body's origin to the sensor, frame of that body, m.
    delay : float
        How late the readings are, s, beyond the delay that each recording was asked at (that of its gyroscopes).
    covariance : array, shape (16, 16)
        Matrix, offset, lever arm, delay.
    residual_rms, raw_rms : array, shape (R,)
        Per axis, after the fit and before, for each recording, m/s2.
    signal_rms : array, shape (R,)
        Of the specific force less gravity, per axis, m/s2.
    cutoff_hz : float
        Low-pass of all three, Hz.
    """

    model: TriadModel
    lever_arm: FloatArray
    delay: float
    covariance: FloatArray
    residual_rms: FloatArray
    raw_rms: FloatArray
    signal_rms: FloatArray
    cutoff_hz: float


def lever_matrix(motion: Motion) -> FloatArray:
    """Return what a lever arm does to specific force: L = [w']x + [w]x [w]x.

    Parameters
    ----------
    motion : Motion
        With angular acceleration.

    Returns
    -------
    array, shape (N, 3, 3)
        1/s2.
    """
    if motion.angular_acceleration_b is None:
        raise InputError("lever arm: wanted a motion with angular acceleration, got none; make it from poses")
    w = motion.rate_b
    outer = w[:, :, None] * w[:, None, :] - (w * w).sum(axis=1)[:, None, None] * np.eye(3)
    x, y, z = motion.angular_acceleration_b.T
    zero = np.zeros_like(x)
    cross = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    lever: FloatArray = outer + cross
    return lever


def accel_rows(
    match: Match, *, delay_s: float, matrix: FloatArray, gravity_m_s2: float, cutoff_hz: float = CUTOFF_HZ
) -> AccelRows:
    """Return the equations of one recording.

    Parameters
    ----------
    match : Match
        Recording with an accelerometer, poses with positions.
    delay_s : float
        Delay to ask the motion at, s.
    matrix : array, shape (3, 3)
        Present matrix, for the column of the delay.
    gravity_m_s2 : float
        Local gravity, m/s2.
    cutoff_hz : float
        Low-pass, Hz.

    Returns
    -------
    AccelRows
        Thinned to a few rows for each period of the cut-off.

    Raises
    ------
    InputError
        No accelerometer, or no positions.
    """
    readings = match.record.accel
    if readings is None or match.reference.position is None:
        raise InputError("accel fit: wanted accel readings and positions of the reference, got one only or neither")
    motion = match.at(delay_s, gravity_m_s2)
    rate = match.record.sample_rate_hz
    parts: list[tuple[FloatArray, FloatArray]] = []
    for rows in stretches(match, motion, readings):
        r_nb = rotation(motion.q_nb[rows]).as_matrix()
        u = readings[rows]
        slope = np.gradient(u, axis=0) * rate @ matrix.T
        n = len(u)
        lever = r_nb @ lever_matrix(_cut(motion, rows))
        turned = [
            (r_nb[:, :, :, None] * u[:, None, None, :]).reshape(n, 3, 9),
            -r_nb,
            -lever,
            np.einsum("nij,nj->ni", r_nb, slope)[:, :, None],
            np.einsum("nij,nj->ni", r_nb, motion.force_b[rows])[:, :, None],
        ]
        done, kept = smoothed(np.concatenate(turned, axis=2).reshape(n, -1), cutoff_hz, rate)
        parts.append((done.reshape(len(kept), 3, 17), match.record.time[rows][kept]))
    if not parts:
        raise NotObservable("accel fit: wanted a second of motion that the poses tell, got none; record longer motion")
    table, time = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    return AccelRows(
        design=table[:, :, :16],
        force=table[:, :, 16],
        raw=table[:, :, (0, 4, 8)].sum(axis=2),
        block=np.floor(time / BLOCK_S).astype(np.int64),
    )


def fit_accel(matches: Sequence[Match], *, gravity_m_s2: float, cutoff_hz: float = CUTOFF_HZ) -> AccelFit:
    """Fit matrix, offset, lever arm and delay of an accelerometer to the poses of one or more recordings.

    Parameters
    ----------
    matches : sequence of Match
        Recordings of one device in one mounting.
    gravity_m_s2 : float
        Local gravity, m/s2.
    cutoff_hz : float
        Low-pass of readings and poses, Hz.

    Returns
    -------
    AccelFit
        With covariance and residuals.

    Raises
    ------
    InputError
        No accelerometer, or no positions.
    NotObservable
        Too little motion, or motion that leaves a parameter undetermined.
    """
    return solve_accel(prepare_accel(matches, gravity_m_s2=gravity_m_s2, cutoff_hz=cutoff_hz), cutoff_hz=cutoff_hz)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedAccel:
    """Equations of several recordings, and where they were linearised.

    Parameters
    ----------
    rows : tuple of AccelRows
        One for each recording.
    delay : float
        Delay beyond the gyroscopes' that they were asked at, s.
    gravity_m_s2 : float
        m/s2.
    """

    rows: tuple[AccelRows, ...]
    delay: float
    gravity_m_s2: float


def prepare_accel(matches: Sequence[Match], *, gravity_m_s2: float, cutoff_hz: float = CUTOFF_HZ) -> PreparedAccel:
    """Return the equations of several recordings, linearised at the delay that fits them all.

    Parameters
    ----------
    matches : sequence of Match
        Recordings of one device.
    gravity_m_s2 : float
        Local gravity, m/s2.
    cutoff_hz : float
        Low-pass, Hz.

    Returns
    -------
    PreparedAccel
        To be solved together or in part.
    """
    delay = 0.0
    matrix: FloatArray = np.eye(3)
    for k in range(_PASSES):
        rows = tuple(
            accel_rows(m, delay_s=m.lag.seconds + delay, matrix=matrix, gravity_m_s2=gravity_m_s2, cutoff_hz=cutoff_hz)
            for m in matches
        )
        if k + 1 < _PASSES:
            x = _solve(rows)[0]
            matrix, delay = x[:9].reshape(3, 3), delay + float(x[15])
    return PreparedAccel(rows=rows, delay=delay, gravity_m_s2=gravity_m_s2)


def solve_accel(
    prepared: PreparedAccel, *, chosen: Sequence[int] | None = None, cutoff_hz: float = CUTOFF_HZ
) -> AccelFit:
    """Solve the equations of chosen recordings together.

    Parameters
    ----------
    prepared : PreparedAccel
        Equations.
    chosen : sequence of int, optional
        Numbers of the recordings; all by default.
    cutoff_hz : float
        Low-pass that the equations went through, Hz.

    Returns
    -------
    AccelFit
        With covariance and residuals.

    Raises
    ------
    NotObservable
        Too little motion, or motion that leaves a parameter undetermined.
    """
    rows = [prepared.rows[k] for k in (range(len(prepared.rows)) if chosen is None else chosen)]
    x, covariance, condition = _solve(rows)
    matrix = x[:9].reshape(3, 3)
    inverse = np.linalg.inv(matrix)
    offset = inverse @ x[9:12]
    jacobian = np.eye(16)
    jacobian[9:12, 9:12] = inverse
    jacobian[9:12, :9] = -np.kron(inverse, offset)  # c = M o: do = M^-1 (dc - dM o)
    covariance = jacobian @ covariance @ jacobian.T
    level = np.array([0.0, 0.0, prepared.gravity_m_s2])
    residuals = [r.force - r.design @ x for r in rows]
    force = np.concatenate([r.force for r in rows])
    model = TriadModel(
        method="reference",
        unit_in="m/s2",
        unit_out="m/s2",
        matrix=matrix,
        offset=offset,
        parameters=NAMES[:12],
        covariance=covariance[:12, :12],
        rms_residual=_rms(np.concatenate(residuals)),
        count=force.size,
        rank=16,
        condition=condition,
        valid_range=(float(force.min()), float(force.max())),
    )
    return AccelFit(
        model=model,
        lever_arm=x[12:15],
        delay=prepared.delay + float(x[15]),
        covariance=covariance,
        residual_rms=np.array([_rms(r) for r in residuals]),
        raw_rms=np.array([_rms(r.force - r.raw) for r in rows]),
        signal_rms=np.array([_rms(r.force - level) for r in rows]),
        cutoff_hz=cutoff_hz,
    )


def _solve(rows: Sequence[AccelRows]) -> tuple[FloatArray, FloatArray, float]:
    a, y = np.concatenate([r.design for r in rows]), np.concatenate([r.force for r in rows])
    starts = [np.flatnonzero(np.concatenate(([True], np.diff(r.block) != 0))) for r in rows]
    shifts = np.cumsum([0, *(len(r.block) for r in rows[:-1])])
    blocks = np.concatenate([s + shift for s, shift in zip(starts, shifts, strict=True)])
    if len(blocks) < _LEAST_BLOCKS:
        raise NotObservable(
            f"accel fit: wanted {_LEAST_BLOCKS} s of motion that the poses tell or more, got {len(blocks)} s; record longer",
            seconds=len(blocks),
        )
    flat = a.reshape(-1, 16)
    rank, condition = scaled_condition(flat)
    if rank < 16:
        raise NotObservable(
            f"accel fit: wanted motion about all three axes, got a design of rank {rank} for 16 parameters; turn the device "
            "about every axis",
            rank=rank,
        )
    scaled = flat / (length := np.linalg.norm(flat, axis=0))
    weight = np.ones(len(y))
    for _ in range(_REWEIGHTINGS):
        each = np.repeat(weight, 3)
        x = np.linalg.solve((scaled.T * each) @ scaled, scaled.T @ (each * y.reshape(-1)))
        residual = y - (scaled @ x).reshape(-1, 3)
        size = np.sqrt((residual**2).mean(axis=1))
        scale = float(np.median(size))
        if scale == 0.0:
            break
        weight = np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-300))
    bread: FloatArray = np.linalg.inv((scaled.T * np.repeat(weight, 3)) @ scaled)
    scores = np.einsum("nap,na->np", scaled.reshape(-1, 3, 16), weight[:, None] * residual)
    sums = np.add.reduceat(scores, blocks)
    covariance: FloatArray = bread @ (sums.T @ sums) @ bread * (len(blocks) / max(len(blocks) - 16 / 3, 1.0))
    return x / length, covariance / np.outer(length, length), condition


def _cut(motion: Motion, rows: slice) -> Motion:
    swing = motion.angular_acceleration_b
    return Motion(
        time=motion.time[rows],
        q_nb=motion.q_nb[rows],
        rate_b=motion.rate_b[rows],
        mean_rate_b=motion.mean_rate_b[rows],
        force_b=motion.force_b[rows],
        gravity_m_s2=motion.gravity_m_s2,
        moving=motion.moving[rows],
        angular_acceleration_b=None if swing is None else swing[rows],
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))
