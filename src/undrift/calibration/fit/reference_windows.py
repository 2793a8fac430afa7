"""Window equations of the reference fit: what the gyroscope turned by against what the reference turned by.

Over a window from pose i to pose j, with M, offset and d at their present values::

    w  = M (u - offset) - d - G a                         readings u, specific force a
    R_w = exp(w dt) ... exp(w dt)                         product over the window's samples
    y  = log(R_w^T R_i^T R_j)                             what is left, rad, in the body at j
    y  = J (dM, dd, dG) + pose noise                      J from one running sum of R regressor dt along the recording

Poses are taken at their own times; the integration is read off there, the lag added. So no pose is ever interpolated.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.adc import without_truncation
from undrift.calibration.model import AdcModel
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.record import Record, Reference
from undrift.sync import Lag, LagSettings, Motion, find_lag, find_motion, native_poses
from undrift.sync.rates import LONGEST_STEP

_MARGIN_S = 0.5  # of rest that belongs to the motion on either side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One recording made ready for the fit.

    Parameters
    ----------
    time : array, shape (N,)
        s, record clock.
    gyro : array, shape (N, 3)
        Readings, raw unit, after ADC correction; gaps are zero.
    accel : array, shape (N, 3), or None
        m/s2, where a g-sensitivity is wanted.
    gaps : array, shape (N,)
        Gaps counted from the start: a window without one has the same count at both ends.
    lag : Lag
        Of the record against the reference.
    motion : Motion
        On the record's clock.
    rest_offset : array, shape (3,)
        Mean reading at rest before the motion, raw unit.
    rest_uncertainty : array, shape (3,)
        Standard uncertainty of that mean, raw unit, from blocks of one second.
    at : array, shape (L,)
        Times of the poses at which windows start and end, s, record clock as the integration needs it.
    q_nb : array, shape (L, 4)
        Those poses; NaN rows are gaps.
    """

    time: FloatArray
    gyro: FloatArray
    accel: FloatArray | None
    gaps: IntArray
    lag: Lag
    motion: Motion
    rest_offset: FloatArray
    rest_uncertainty: FloatArray
    at: FloatArray
    q_nb: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroGuess:
    """Present values of the parameters.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        M, rad/s per raw unit.
    constant : array, shape (3,)
        d, rad/s.
    g_sensitivity : array, shape (3, 3)
        G, rad/s per m/s2.
    """

    matrix: FloatArray
    constant: FloatArray
    g_sensitivity: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Equations of one recording.

    Parameters
    ----------
    turn : array, shape (n, 3)
        y, rad.
    design : array, shape (n, 3, P)
        J: matrix row by row, then d, then G where accel readings are given.
    first : array, shape (n,)
        Number of the pose at which each window starts.
    """

    turn: FloatArray
    design: FloatArray
    first: IntArray


def prepare(
    record: Record,
    reference: Reference,
    *,
    stride_s: float,
    adc: AdcModel | None,
    with_accel: bool,
    lag_settings: LagSettings,
) -> Recording:
    """Find lag, motion, rest and poses of one recording.

    Parameters
    ----------
    record : Record
        With a gyroscope, any unit.
    reference : Reference
        Poses of the same motion.
    stride_s : float
        Time between the poses used, s.
    adc : AdcModel or None
        Rounding to undo first.
    with_accel : bool
        Keep specific force for a g-sensitivity.
    lag_settings : LagSettings
        Of the lag search.

    Returns
    -------
    Recording
        Ready for ``window_equations``.

    Raises
    ------
    InputError
        No accelerometer where one is needed.
    AlignmentError
        No common motion, or no rest before it.
    """
    poses = native_poses(reference)
    lag = find_lag(record, poses, lag_settings)
    readings = record.gyro
    if readings is None or (with_accel and record.accel is None):
        raise InputError("reference: wanted gyro and accel for a g-sensitivity, got one only; map the other's columns")
    gyro = restored(readings, adc)
    motion = find_motion(record, poses, lag_s=lag.seconds)
    gap: BoolArray = np.asarray(np.isnan(gyro).any(axis=1))
    step = np.diff(record.time)
    late = np.concatenate(([False], step > LONGEST_STEP * np.median(step)))
    rest, rest_uncertainty = _rest(record.time, gyro, motion)
    half_sample = 0.5 * float(np.median(step))  # strapdown holds each reading over the step before its stamp
    at, q = _window_poses(poses, lag.seconds - half_sample, stride_s, motion, record.time)
    return Recording(
        time=record.time,
        gyro=np.where(gap[:, None], 0.0, gyro),
        accel=record.in_units(record.gyro_unit, "m/s2").accel if with_accel else None,
        gaps=np.cumsum(gap | late),
        lag=lag,
        motion=motion,
        rest_offset=rest,
        rest_uncertainty=rest_uncertainty,
        at=at,
        q_nb=q,
    )


def restored(gyro: FloatArray, adc: AdcModel | None) -> FloatArray:
    """Return readings with the mean loss of the ADC's rounding given back.

    Parameters
    ----------
    gyro : array, shape (N, 3)
        Readings, raw unit.
    adc : AdcModel or None
        Step and rounding; None changes nothing.

    Returns
    -------
    array, shape (N, 3)
        As ``without_truncation`` gives them.
    """
    if adc is None or adc.gyro_lsb is None:
        return gyro
    return without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)


def window_equations(recording: Recording, guess: GyroGuess, offset: FloatArray, reach: int) -> Windows:
    """Return the equations of all windows that span ``reach`` strides.

    Parameters
    ----------
    recording : Recording
        One recording.
    guess : GyroGuess
        Present values.
    offset : array, shape (3,)
        Raw reading subtracted before the matrix.
    reach : int
        Strides from a window's first pose to its last.

    Returns
    -------
    Windows
        Windows with a gap at an end or, in the readings, within are left out.
    """
    from undrift.kernels.windows import accumulate

    u = recording.gyro - offset
    rate = u @ guess.matrix.T - guess.constant
    columns: list[FloatArray] = [u, np.ones((len(u), 1))]
    if recording.accel is not None:
        accel = np.nan_to_num(recording.accel)
        rate = rate - accel @ guess.g_sensitivity.T
        columns.append(accel)
    regressors = np.concatenate(columns, axis=1)
    points, channels = len(recording.at), regressors.shape[1]
    q, total = np.empty((points, 4)), np.zeros((points, 3, 3, channels))
    accumulate(
        np.ascontiguousarray(rate).reshape(-1),
        np.ascontiguousarray(regressors).reshape(-1),
        np.ascontiguousarray(recording.time),
        recording.at,
        q.reshape(-1),
        total.reshape(-1),
    )
    first = np.flatnonzero(_whole(recording, reach))
    last = first + reach
    turned = quaternion_product(quaternion_conjugate(q[first]), q[last])
    seen = quaternion_product(quaternion_conjugate(recording.q_nb[first]), recording.q_nb[last])
    turn = rotation_vector(quaternion_product(quaternion_conjugate(turned), seen))
    gain = total[last] - total[first]
    back = quaternion_conjugate(q[last])[:, None, None, :]
    design = np.moveaxis(rotate(back, np.moveaxis(gain, 1, -1)), -1, 1)  # (n, 3 residual, 3 row, C regressor)
    n = len(first)
    blocks = [design[..., :3].reshape(n, 3, 9), -design[..., 3]]
    if recording.accel is not None:
        blocks.append(-design[..., 4:].reshape(n, 3, 9))
    return Windows(turn=turn, design=np.concatenate(blocks, axis=2), first=first)


def _whole(recording: Recording, reach: int) -> BoolArray:
    if len(recording.at) <= reach:
        return np.zeros(0, bool)
    seen = np.isfinite(recording.q_nb[:, 0])
    sample = np.clip(np.searchsorted(recording.time, recording.at), 0, len(recording.time) - 1)
    count = recording.gaps[sample]
    whole: BoolArray = seen[:-reach] & seen[reach:] & (count[:-reach] == count[reach:])
    return whole


def _rest(time: FloatArray, gyro: FloatArray, motion: Motion) -> tuple[FloatArray, FloatArray]:
    at_rest = (time < motion.start_s - _MARGIN_S) & np.isfinite(gyro).all(axis=1)
    readings, second = gyro[at_rest], np.floor(time[at_rest] - time[0]).astype(np.int64)
    if len(readings) < 2 or second[-1] == second[0]:
        raise InputError(
            "reference: wanted two seconds of rest readings before the motion, got fewer; record a rest first"
        )
    blocks = np.flatnonzero(np.concatenate(([True], np.diff(second) > 0)))
    means = np.add.reduceat(readings, blocks) / np.diff(np.append(blocks, len(readings)))[:, None]
    return readings.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))


def _window_poses(
    poses: Reference, shift_s: float, stride_s: float, motion: Motion, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    at = poses.time + shift_s
    inside = (at >= max(motion.start_s - _MARGIN_S, time[0])) & (at <= min(motion.stop_s + _MARGIN_S, time[-1]))
    step = max(1, round(stride_s * poses.sample_rate_hz))
    chosen = np.flatnonzero(inside)[::step]
    return np.ascontiguousarray(at[chosen]), np.ascontiguousarray(poses.q_nb[chosen])
