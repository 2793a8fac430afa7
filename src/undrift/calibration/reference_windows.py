"""Rotations over windows between two poses: equations of a gyroscope, their solution, and its covariance.

R_i and R_j are the poses at both ends of a window. T turns the mean body of all recordings into the body of this recording::

    w   = M (u + c (sign u - s) - o) - m d          readings u, offset o at rest, mean sign s of u at rest, m = 1 while it turns
    R_w = exp(w dt) ... exp(w dt)                   product over the samples of the window
    P   = T' R_i' R_j T                             the same rotation from the reference
    y   = log(R_w' P) = J (dM, dd, dc) + (P' - 1) dt + errors of the poses and readings

J is a running sum of R u dt along the recording. Poses are used at their own times and never interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import NotObservable
from undrift.findings import Finding
from undrift.fit.gls import fit_huber, student_factor
from undrift.fit.triad import scaled_condition
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation, rotation_vector
from undrift.sync import Lag

STRIDE_S = 0.5  # distance between the starts of neighbouring windows
MIN_BLOCKS = 8  # smallest number of blocks of two windows for the jackknife, otherwise blocks of one window


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One recording, prepared for the fit."""

    time: FloatArray  # (N,), s, clock of the record
    gyro: FloatArray  # (N, 3), readings, raw unit, with zeros in gaps
    gaps: IntArray  # (N,), number of gaps since the start
    lag: Lag  # lag of the record behind the reference
    moving: BoolArray  # (N,), True between the first and the last rest
    turning: FloatArray  # (N,), m
    rest: FloatArray  # (3,), mean reading at rest before the motion, raw unit, or NaN without a rest
    rest_sign: FloatArray  # (3,), mean sign of the readings there
    rest_uncertainty: FloatArray  # (3,), standard uncertainty of the mean reading, raw unit
    pose_time: FloatArray  # (L,), times of the poses at which windows start and end, s, clock of the record
    q_nb: FloatArray  # (L, 4), these poses, with NaN in gaps
    findings: tuple[Finding, ...]  # about the clocks, the ends of both files, and saturated readings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Equations of a recording."""

    turn: FloatArray  # (n, 3), y, rad
    design: FloatArray  # (n, 3, 18), J and P' - 1: M row by row, d, c, rotation of the mounting
    first: IntArray  # (n,), number of the pose at which each window starts


def window_equations(
    recording: Recording, values: FloatArray, offset: FloatArray, mounting: FloatArray, reach: int
) -> Windows:
    """Return the equations of all windows that span ``reach`` strides, at ``values`` (18,) of M, d and c, at o and T (4,)."""
    from undrift.kernels.rotation import accumulate

    matrix, moving, codes = values[:9].reshape(3, 3), values[9:12], values[12:15]
    sign, turning = np.sign(recording.gyro) - recording.rest_sign, recording.turning[:, None]
    u = recording.gyro + sign * codes - offset
    regressors = np.concatenate((u, turning, sign), axis=1)
    q, total = np.empty((len(recording.pose_time), 4)), np.zeros((len(recording.pose_time), 3, 3, 7))
    accumulate(
        np.ascontiguousarray(u @ matrix.T - turning * moving).reshape(-1),
        np.ascontiguousarray(regressors).reshape(-1),
        np.ascontiguousarray(recording.time),
        recording.pose_time,
        q.reshape(-1),
        total.reshape(-1),
    )
    valid = np.isfinite(recording.q_nb[:, 0])
    gaps = recording.gaps[np.searchsorted(recording.time, recording.pose_time).clip(0, len(recording.time) - 1)]
    first = np.flatnonzero(valid[:-reach] & valid[reach:] & (gaps[:-reach] == gaps[reach:]))
    last = first + reach
    body = quaternion_product(recording.q_nb, mounting)
    reading_turn = quaternion_product(quaternion_conjugate(q[first]), q[last])
    pose_turn = quaternion_product(quaternion_conjugate(body[first]), body[last])
    inverse = quaternion_conjugate(q[last])[:, None, None, :]
    gain = np.moveaxis(rotate(inverse, np.moveaxis(total[last] - total[first], 1, -1)), -1, 1)  # (n, 3, 3, channel)
    matrix_slopes = gain[..., :3].reshape(len(first), 3, 9)
    code_slopes = np.einsum("narj,rj->naj", gain[..., 4:], matrix)
    mounting_slopes = np.swapaxes(rotation(pose_turn).as_matrix(), 1, 2) - np.eye(3)
    return Windows(
        turn=rotation_vector(quaternion_product(quaternion_conjugate(reading_turn), pose_turn)),
        design=np.concatenate((matrix_slopes, -gain[..., 3], code_slopes, mounting_slopes), axis=2),
        first=first,
    )


# ---- robust least squares of overlapping windows
#
# Huber's estimate by reweighting. Neighbouring windows share readings and poses, so the covariance is a jackknife covariance: to
# first order, leaving a block b of windows out moves the estimate by
#
# x_b = (N - N_b)^-1 A_b' p_b            N = A' D A + K, bounded residuals p, D = 1 within Huber's bound else 0, prior K
#
# and cov x is the sum of x_b x_b' over B blocks, widened by Student's factor for B - 1 degrees of freedom. A block is two
# windows long, so its errors are independent of those two blocks later.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """One linear solution."""

    step: FloatArray  # (P,), change of the parameters
    covariance: FloatArray  # (P, P)
    residuals: FloatArray  # (n, 3), rad
    scale: float  # robust standard deviation of the residuals, rad
    condition: float  # condition number of the design with unit columns


def solve(
    windows: Sequence[Windows],
    design: FloatArray,
    prior_step: FloatArray,
    spread: FloatArray,
    *,
    reach: int,
    scale: float,
) -> Solution:
    """Solve the window equations for the columns of ``design`` (n, 3, P).

    The prior has the mean step ``prior_step`` (P,) and the standard deviation ``spread`` (P,), infinite without a prior. Windows
    overlap ``reach`` times, so a prior row is sigma sqrt(reach) / spread, for residuals of about ``scale``, rad.
    """
    a, y = design.reshape(-1, len(prior_step)), np.concatenate([samples.turn for samples in windows]).reshape(-1)
    pull = scale * np.sqrt(reach) / spread
    with_prior = np.vstack((a, np.diag(pull)))
    condition = full_rank(with_prior)
    step, weight, scale = fit_huber(with_prior, np.append(y, pull * prior_step), prior=len(pull))
    residuals, weight = y - a @ step, weight[: len(y)]
    inside = weight == 1.0
    normal = (a.T * inside) @ a + np.diag(pull**2)
    prior_gain = np.linalg.solve(normal, np.diag(pull**2 * np.where(pull > 0.0, spread, 0.0)))
    covariance, blocks = prior_gain @ prior_gain.T, np.repeat(_blocks(windows, reach), 3)
    for block in range(blocks.max() + 1):
        rows = blocks == block
        reduced_normal = normal - (a[rows].T * inside[rows]) @ a[rows]
        change = np.linalg.solve(reduced_normal, a[rows].T @ (weight * residuals)[rows])
        covariance += student_factor(blocks.max()) * np.outer(change, change)
    return Solution(
        step=step, covariance=covariance, residuals=residuals.reshape(-1, 3), scale=scale, condition=condition
    )


def _blocks(windows: Sequence[Windows], reach: int) -> IntArray:
    """Return the block that each window belongs to. Blocks are numbered through all recordings."""
    for length in (2 * reach, reach):
        place = np.concatenate([1_000_000 * number + samples.first // length for number, samples in enumerate(windows)])
        blocks: IntArray = np.unique(place, return_inverse=True)[1]
        if blocks.max() + 1 >= MIN_BLOCKS:
            break
    return blocks


def full_rank(design: FloatArray, what: str = "reference") -> float:
    """Return the condition number of a design (E, P) with unit columns. Raise if the motion does not determine all parameters."""
    rank, condition = scaled_condition(design)
    if rank < design.shape[1]:
        raise NotObservable(
            f"{what}: the motion determines {rank} of {design.shape[1]} parameters. Turn the device about all three axes.",
            rank=rank,
        )
    return condition
