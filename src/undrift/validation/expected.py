"""Expected end error and root-mean-square error of a recording, from the calibration's uncertainty.

To first order, the error of a strapdown orientation in earth axes is the initial error plus the integral of the rate error::

    e(t) = e0 + int R_nb (dM (u - o) - M do - dG a - m dd + M dc sign(u)) dt + h(t)        R_nb from the integration
         = A(t) x + h(t)        x: errors of M, o, G, d, c; change of the offset; start; mounting; noise; pose.   h: remaining lag

    end    |e|^2 at the end of the motion      rms    mean of |e|^2 over the motion

Both are quadratic forms x' D x + 2 b' x + c of normal x. Their first two moments are computed exactly, and their distribution is
approximated by a scaled chi-square distribution [1]_. The covariance of x has two parts. One is the covariance of the fit, the
other is the prior ``ErrorPrior``. The prior covers errors that a single recording cannot determine: changes of matrix, offset in
motion, start and mounting between recordings of a device, and errors of the reference poses.

.. [1] F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics 2, 110-114, 1946.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.rest import MOVED_AGAIN
from undrift.frames import rotate
from undrift.model import CODE_NAMES, G_NAMES, MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES, TriadModel
from undrift.record import Record
from undrift.segments import find_turning
from undrift.units import RADIAN_PER_DEGREE, si_factor

_STEP_S = 0.25  # interval at which the error is evaluated
_TAILS = (0.025, 0.975, 0.95)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorPrior:
    """Standard deviations of changes between recordings of a device, which the covariance of a fit does not include.

    The values are from eight BROAD trials (three devices of one model), 2026-11-22, rounded up. For each device under test,
    ``python -m benchmarks.broad`` estimates them from the other devices.
    """

    matrix: float = 3e-4  # element of the matrix, relative to the scale: nonlinearity, speed of the motion
    motion_offset: float = MOVED_AGAIN  # offset in motion minus offset at rest, about its mean, rad/s
    rest_to_motion: float = 0.03 * RADIAN_PER_DEGREE  # the same difference if the calibration did not fit it, rad/s
    day_to_day: float = 0.01 * RADIAN_PER_DEGREE  # offset at rest, if the rest of the recording is not used, rad/s
    # start from an uncalibrated accelerometer against the reference, each axis, rad
    tilt: float = 0.15 * RADIAN_PER_DEGREE
    mounting: float = 0.1 * RADIAN_PER_DEGREE  # mounting of the device on the reference's body, each axis, rad
    pose: float = 0.1 * RADIAN_PER_DEGREE  # pose of the reference, each axis, rad


ERROR_PRIOR = ErrorPrior()


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Errors expected from the uncertainty of a calibration, deg."""

    end_total_deg: float  # root mean square of the end error
    end_interval_deg: tuple[float, float]  # 95 %
    end_at_most_deg: float  # 95 % quantile of the end error
    rmse_total_deg: float  # root-mean-square error over the motion
    rmse_interval_deg: tuple[float, float]
    rmse_at_most_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetSource:
    """Source of the offset of a recording."""

    # "other": offset of the model, from another recording. "own": offset from a rest in the recording plus the model's change
    # to motion. "subtracted": the mean of that rest is subtracted after the correction, which also removes the model's
    # offset. "shown": offset determined from the motion.
    rest: Literal["other", "own", "subtracted", "shown"]
    in_motion: bool  # True if the change from rest to motion was fitted
    recordings: int = 1  # number of recordings in the fit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strapdown:
    """A recording and the orientation integrated from it, up to the end of the motion."""

    record: Record  # corrected record, rad/s and m/s2, from the start of the integration
    q_nb: FloatArray  # (N, 4), integrated orientation
    stop_s: float  # end of the motion, s, on the clock of the record
    delay_s: float  # lag of the orientation behind the reference that remains in the errors, s
    turned: FloatArray  # (3, 3), rotation from the frame of the model to the frame of the integration
    offset_covariance: FloatArray  # (3, 3), covariance of the rest's mean rate or the motion's offset, (rad/s)^2
    offset_prior: FloatArray  # (3,), prior standard deviation of the offset determined from motion, rad/s
    noise_density: float  # noise density of the rate, rad/sqrt(s)
    tilt: float  # standard uncertainty of the initial orientation, each level axis, rad
    mounting: float  # mounting error between device and body of the reference, about each axis, rad


PARAMETERS = (*MATRIX_NAMES, *OFFSET_NAMES, *G_NAMES, *MOVING_NAMES, *CODE_NAMES)  # parameters, in the order of A
SIZE = len(PARAMETERS)


def expected_errors(run: Strapdown, model: TriadModel, source: OffsetSource, prior: ErrorPrior) -> Expected:
    """Return the expected end error and root-mean-square error of a recording."""
    elapsed, gain, rate = _sensitivity(run, model, source)
    covariance = _covariance(run, model, source, prior)
    size = gain.shape[2]
    ends = np.concatenate((gain[-1], np.sqrt(elapsed[-1]) * np.eye(3), np.eye(3)), axis=1)
    means = np.zeros_like(covariance)
    means[:size, :size] = np.einsum("kap,kaq->pq", gain, gain) / len(gain)
    means[size:, size:] = np.diag(np.repeat((float(elapsed.mean()), 1.0), 3))
    late = run.delay_s * rate  # (K, 3), error in earth axes, rad
    linear = np.zeros(len(covariance))
    linear[:size] = np.einsum("kap,ka->p", gain, late) / len(late)
    end, *end_quantiles = _root_deg(covariance, ends.T @ ends, 0.0 * linear, 0.0)
    rmse, *rmse_quantiles = _root_deg(covariance, means, linear, float((late**2).sum(axis=1).mean()))
    return Expected(
        end_total_deg=end,
        end_interval_deg=(end_quantiles[0], end_quantiles[1]),
        end_at_most_deg=end_quantiles[2],
        rmse_total_deg=rmse,
        rmse_interval_deg=(rmse_quantiles[0], rmse_quantiles[1]),
        rmse_at_most_deg=rmse_quantiles[2],
    )


def offset_answer(record: Record, prior: FloatArray, rate_errors: FloatArray) -> FloatArray:
    """Return the error of the mean offset determined from motion, for unit errors of the rates, (3, 3, C).

    The rate errors are x_c e_b rad/s, x (N, C), in a record corrected by that offset, with its prior (3,). A scale factor error
    turns gravity as an offset does. The estimated offset compensates for part of this error, so less remains in the orientation.
    """
    from undrift.correction.motion import offset_gains  # imported here, because it requires scipy and kernels
    from undrift.fit.carried import MEAN_S

    zero, unit = np.zeros(3), rate_errors.shape[1]
    if record.duration_s < 2.0 * MEAN_S:  # two means determine nothing beyond the prior
        return np.zeros((3, 3, unit))
    answers = offset_gains(record, zero, zero, np.diag(prior**2), rate_errors)[:-3]
    mean: FloatArray = answers.reshape(-1, 3, 3, unit).mean(axis=0)
    return mean


def _sensitivity(run: Strapdown, model: TriadModel, source: OffsetSource) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times since the start (K,), sensitivities A (K, 3, P) without noise and pose, and rates in earth axes (K, 3)."""
    from undrift.kernels.rotation import accumulate

    gyro, time, q = np.ascontiguousarray(run.record.gyro), np.ascontiguousarray(run.record.time), run.q_nb
    projection = si_factor(model.unit_out, "rate") * run.turned
    matrix = projection @ model.matrix
    force = np.zeros_like(gyro) if run.record.accel is None else np.nan_to_num(run.record.accel)
    u, rezeroed = gyro @ np.linalg.inv(matrix).T, source.rest in ("subtracted", "shown")
    sign = np.sign(u + model.offset) - np.sign(model.offset) * rezeroed  # a subtracted offset includes c
    turning = find_turning(gyro, time)[0][:, None] * (source.rest != "shown" or model.moving_offset is not None)
    regressors = np.concatenate((u, np.ones((len(gyro), 1)), force @ run.turned, turning, sign), axis=1)
    last = max(1, int(np.searchsorted(time, run.stop_s, side="right")) - 1)
    knots = np.append(np.arange(0, last, max(1, round(_STEP_S * run.record.sample_rate_hz))), last)
    total, relative = np.zeros((len(knots), 3, 3, regressors.shape[1])), np.empty((len(knots), 4))
    accumulate(gyro.reshape(-1), regressors.reshape(-1), time, time[knots], relative.reshape(-1), total.reshape(-1))
    axes = np.stack([rotate(q[knots], axis[None]) for axis in np.eye(3)], axis=2)  # (K, 3, 3), R_nb
    sums = np.einsum("ab,kbcd->kacd", axes[0], total)
    steady = sums[..., 3]
    if source.rest == "shown":  # the offset responds to an error of the rates: A x becomes (A_w - A_o dO/dw) x
        sums = sums - np.einsum("kab,bcd->kacd", steady, offset_answer(run.record, run.offset_prior, regressors))
    by_matrix, by_g = (
        np.einsum("kabc,br->karc", sums[..., first : first + 3], projection).reshape(-1, 3, 9) for first in (0, 4)
    )
    by_offset = -steady @ matrix * (not rezeroed)
    by_codes = np.einsum("kabr,br->kar", sums[..., 8:], matrix)
    moved = axes - axes[0]
    start = np.broadcast_to(np.eye(3), moved.shape)
    columns = (by_matrix, by_offset, -by_g, -sums[..., 7] @ projection, by_codes, steady, start, moved)
    return time[knots] - time[0], np.concatenate(columns, axis=2), rotate(q[knots], gyro[knots])


def _covariance(run: Strapdown, model: TriadModel, source: OffsetSource, prior: ErrorPrior) -> FloatArray:
    """Return the covariance of model, change of the offset, start, mounting, noise and pose, in this order."""
    from undrift.correction.motion import axis_moved_by

    of_mean = 1.0 + 1.0 / source.recordings if source.in_motion else 1.0  # the mean of the recordings has an error
    change = of_mean * (prior.motion_offset if source.in_motion else prior.rest_to_motion) ** 2
    offset = prior.day_to_day**2 * np.eye(3) if source.rest == "other" else run.offset_covariance
    in_model = np.zeros(SIZE)  # variances added to those of the model
    in_model[:9] = of_mean * (prior.matrix * float(np.linalg.norm(model.matrix, 2))) ** 2
    if model.moving_offset is not None:
        in_model[21:24] = change / si_factor(model.unit_out, "rate") ** 2
        if source.rest == "shown":  # the covariance of the model already includes the prior's share of d
            reduction = offset / run.offset_prior * axis_moved_by(model) / run.offset_prior
            offset = offset - reduction @ reduction.T
    elif source.rest != "shown":
        offset = offset + change * np.eye(3)
    start = (run.tilt**2, run.tilt**2, prior.pose**2)
    rest = np.repeat((run.mounting**2 + prior.mounting**2, run.noise_density**2, prior.pose**2), 3)
    covariance = np.diag(np.concatenate((in_model, np.zeros(3), start, rest)))
    covariance[:SIZE, :SIZE] += model.covariance_of(PARAMETERS)
    covariance[SIZE : SIZE + 3, SIZE : SIZE + 3] = offset
    return covariance


def _root_deg(covariance: FloatArray, square: FloatArray, linear: FloatArray, constant: float) -> list[float]:
    """Return root mean and quantiles of the root of x' D x + 2 b' x + c for normal x of mean zero, deg."""
    from scipy.special import gammaincinv

    spread = square @ covariance
    mean = float(np.trace(spread)) + constant
    variance = 2.0 * float(np.trace(spread @ spread)) + 4.0 * float(linear @ covariance @ linear)
    shape = mean**2 / max(variance, 1e-300)  # half the degrees of freedom
    squares = np.append(mean, gammaincinv(shape, _TAILS) * mean / shape)
    return [float(root) / RADIAN_PER_DEGREE for root in np.sqrt(squares)]
