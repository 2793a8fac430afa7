"""Calibrate gyroscopes against an orientation reference: optics, a robot arm, or other poses of the same body.

    w   = M (u + c (sign u - s) - o) - m(t) d       rate w of the mean body, readings u, m = 1 while the device turns
    R_w = exp(w dt) ... exp(w dt)                   product over the samples of a window between two poses R_i and R_j
    P   = T' R_i' R_j T                             the same rotation from the reference
    y   = log(R_w' P) = J (dM, dd, dc) + (P' - 1) dt + errors of the poses and readings

Poses are used at their own times, never interpolated and never differentiated. J is a running sum of R u dt along the recording.
Windows start at 2 s, where the linear equations are safe for a raw device, and double up to 16 s. Errors of the poses do not grow
with the window, but the rotation from errors of M or o does.

All recordings of a device are fitted together. The offset at rest o is the mean reading at rest of each recording, and s its mean
sign there. Offsets in motion differ from it by 0.01 to 0.05 deg/s (rounding, vibration, g-sensitivity): a common change d applies
to all recordings while the device turns. A recording without a rest has the mean offset of the others plus its own change. Each
recording has its own small rotation T between the mean body and its body, because markers are attached again. ``mounting`` "one"
omits T.

If the readings have a physical unit, every element of M has a prior about the rotation that maps the readings to the body. Elements
that the motion does not determine keep the prior, and the verdict names their axes. If the rounding of the codes can be identified,
c is fitted with a prior mean of half a step or zero.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

import undrift.sync as sync
from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.plausibility import without_saturated
from undrift.calibration.sources import uncertain
from undrift.errors import AlignmentError, Implausible, InputError, NotObservable, check_choice
from undrift.findings import Finding, finding, told_apart
from undrift.fit.gls import fit_huber, student_factor
from undrift.fit.triad import TriadFit, scaled_condition, triad_fit
from undrift.frames import (
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation,
    rotation_vector,
)
from undrift.model import CODE_NAMES, MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES, AdcModel, TriadModel
from undrift.record import Mounting, Record, Reference
from undrift.segments import find_still, find_turning, unpadded
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- results


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceFit:
    """Gyroscope fitted to the references of R recordings."""

    # residuals: rotations of the longest windows, over their length. The offset of the model is the mean at rest if the model has a
    # ``moving_offset``, otherwise the offset in motion
    triad: TriadFit
    motion_offset: FloatArray  # (3,), reading in motion minus reading at rest, at zero rate, raw unit
    rest_offsets: FloatArray  # (R, 3), mean reading at rest of each recording, raw unit, or NaN without a rest
    lags_s: FloatArray  # (R,), lag of each recording, s
    lag_uncertainties_s: FloatArray  # (R,), standard uncertainty of the lag, s
    window_s: float  # longest windows that fit into the recordings, s
    mountings: FloatArray  # (R, 3), rotation vector from the mean body to the body of each recording, rad

    def model_at_rest_offset(self, rest_offset: FloatArray) -> TriadModel:
        """Return the model for a recording that reads ``rest_offset`` (3,), codes corrected, at rest."""
        model = self.triad.model
        if not np.isfinite(rest_offset).all():
            return model
        return replace(model, offset=rest_offset + self.motion_offset * (model.moving_offset is None))


class HeldOut(NamedTuple):
    """The fit to all other recordings, for a recording that was held out."""

    fit: ReferenceFit
    model: TriadModel  # model with the rest offset of the recording that was left out


# ---- recordings

MARGIN_S = 0.5  # time at each end of a rest that belongs to the motion, s
REST_BLOCK_S = 0.5  # means of this length count as independent


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aligned:
    """A record and its reference on a common clock."""

    record: Record
    gyro: FloatArray  # (N, 3), readings
    reference: Reference  # poses at the frames of the cameras
    lag: sync.Lag  # lag of the gyroscope's readings behind the poses
    span: sync.MotionSpan  # motion from the first to the last rest, on the clock of the record
    findings: tuple[Finding, ...]  # findings about the two clocks, the ends of both files, and saturated readings


def align(record: Record, reference: Reference, longest_lag_s: float = sync.LONGEST_LAG_S) -> Aligned:
    """Find lag and motion of a recording, without padded rows and saturated readings."""
    full_record, record = record, unpadded(record)
    padded = sync.padding(full_record, record)
    record, saturated = without_saturated(record)
    clocks = sync.in_step(record, reference, longest_lag_s)
    record = replace(record, time=clocks.time)
    return Aligned(
        record=record,
        gyro=np.asarray(record.gyro),
        reference=clocks.poses,
        lag=clocks.lag,
        span=sync.find_motion(record, clocks.poses, lag_s=clocks.lag.seconds),
        findings=(*padded, *saturated, *clocks.findings),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One recording, prepared for the fit."""

    aligned: Aligned
    gyro: FloatArray  # (N, 3), readings, raw unit, with zeros in gaps
    gaps: IntArray  # (N,), number of gaps since the start
    moving: BoolArray  # (N,), True between the first and the last rest
    turning: FloatArray  # (N,), m
    rest: FloatArray  # (3,), mean reading at rest before the motion, raw unit, or NaN without a rest
    rest_sign: FloatArray  # (3,), mean sign of the readings there
    rest_uncertainty: FloatArray  # (3,), standard uncertainty of the mean reading, raw unit
    pose_time: FloatArray  # (L,), times of the poses at which windows start and end, s, clock of the record
    q_nb: FloatArray  # (L, 4), poses at these times, with NaN in gaps


def recording_of(aligned: Aligned, *, turning: bool) -> Recording:
    """Return a recording with its mean at rest and the poses at the ends of windows."""
    gyro, time, span, poses, lag = aligned.gyro, aligned.record.time, aligned.span, aligned.reference, aligned.lag
    gap: BoolArray = np.asarray(np.isnan(gyro).any(axis=1))
    step = float(np.median(np.diff(time)))
    rest, uncertainty, sign = rest_reading(aligned)
    turns: FloatArray = np.ones(len(time))
    if turning and np.isfinite(rest).all():
        turns = find_turning((gyro - rest) @ lag.matrix.T, time)[0]
    # a strapdown holds each reading over the step before its time stamp, a shift of half a sample
    pose_time = poses.time + (lag.seconds - 0.5 * step)
    inside = (pose_time >= max(span.start_s - MARGIN_S, time[0])) & (pose_time <= min(span.stop_s + MARGIN_S, time[-1]))
    ends = np.flatnonzero(inside)[:: max(1, round(STRIDE_S * poses.sample_rate_hz))]
    return Recording(
        aligned=aligned,
        gyro=np.where(gap[:, None], 0.0, gyro),
        gaps=np.cumsum(gap | (np.diff(time, prepend=time[0]) > sync.LONGEST_STEP * step)),
        moving=(time >= span.start_s) & (time < span.stop_s) & ~gap,
        turning=turns,
        rest=rest,
        rest_sign=sign,
        rest_uncertainty=uncertainty,
        pose_time=np.ascontiguousarray(pose_time[ends]),
        q_nb=np.ascontiguousarray(poses.q_nb[ends]),
    )


def rest_reading(aligned: Aligned) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean reading at rest (3,), its standard uncertainty, and the mean sign, or NaN and zeros without a rest."""
    record, span = aligned.record, aligned.span
    rows: BoolArray = np.asarray(span.rested & (record.time < span.start_s - MARGIN_S))
    if not span.rested:  # a rest that is too short for the inclination still determines the offset
        for still in find_still(record).stills[:1]:
            rows[still.start : still.stop - 1] = True
    readings = aligned.gyro[rows & np.isfinite(aligned.gyro).all(axis=1)]
    count = int(len(readings) / (REST_BLOCK_S * record.sample_rate_hz))
    if count < 2:
        return np.full(3, np.nan), np.zeros(3), np.zeros(3)
    means = np.array([block.mean(axis=0) for block in np.array_split(readings, count)])
    return readings.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(count), np.sign(readings).mean(axis=0)


# ---- equations of a gyroscope over windows between two poses

STRIDE_S = 0.5  # distance between the starts of neighbouring windows
MIN_BLOCKS = 8  # smallest number of blocks of two windows for the jackknife, otherwise blocks of one window


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
    time = np.ascontiguousarray(recording.aligned.record.time)
    sign, turning = np.sign(recording.gyro) - recording.rest_sign, recording.turning[:, None]
    u = recording.gyro + sign * codes - offset
    regressors = np.concatenate((u, turning, sign), axis=1)
    q, total = np.empty((len(recording.pose_time), 4)), np.zeros((len(recording.pose_time), 3, 3, 7))
    accumulate(
        np.ascontiguousarray(u @ matrix.T - turning * moving).reshape(-1),
        np.ascontiguousarray(regressors).reshape(-1),
        time,
        recording.pose_time,
        q.reshape(-1),
        total.reshape(-1),
    )
    valid = np.isfinite(recording.q_nb[:, 0])
    gaps = recording.gaps[np.searchsorted(time, recording.pose_time).clip(0, len(time) - 1)]
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
# first order, omitting a block b of windows changes the estimate by
#
# x_b = (N - N_b)^-1 A_b' p_b            N = A' D A + K, bounded residuals p, D = 1 within Huber's bound, otherwise 0, prior K
#
# and cov x is the sum of x_b x_b' over B blocks, widened by Student's factor for B - 1 degrees of freedom. A block is two
# windows long, so its errors are independent of the errors two blocks later.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """One linear solution."""

    step: FloatArray  # (P,), change of the parameters
    covariance: FloatArray  # (P, P)
    residuals: FloatArray  # (n, 3), rad
    scale: float  # robust standard deviation of the residuals, rad
    condition: float  # condition number of the design with unit columns


def solve_windows(
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
    """Return the block that each window belongs to. Blocks are numbered consecutively over all recordings."""
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


# ---- fit

# least rms rate about the second and third axis of the motion, relative to the first axis, that determines these axes
SECOND_AXIS, THIRD_AXIS = 0.03, 0.1
# weight of all recordings in the initial body of each: a recording about a single axis does not determine its body
SHARED_BODY = 0.01
# elements of M about the rotation from readings to body, relative (data sheets of consumer parts: scale factor 1 to 3 %, cross-axis
# sensitivity 1 to 2 %), and rotation of a mounting about its first estimate, rad. Assumed.
MATRIX_PRIOR, MOUNTING_PRIOR = 0.03, 0.05
TURN_ON = 0.1 * RADIAN_PER_DEGREE  # repeatability of the offset between recordings without a rest, rad/s. Assumed.
# d, rad/s, and the deviation of c from half a step (codes cut off toward zero) or from zero, in steps. 24 trials of four devices
# have 0.01 to 0.05 deg/s and -0.3 to 0.8 of a step
MOVING_PRIOR, CODE_PRIOR = 0.05 * RADIAN_PER_DEGREE, 1.0 / 3.0
MATRIX_DIFFERENCE = 0.05  # relative difference between the matrices of single recordings of the same device
START_RIDGE = 1e-3  # weight of the nominal matrix in the initial estimate, relative to the largest power of the rates
USUAL_RESIDUAL = 5e-3  # residual of a window before the first solution, rad
WINDOWS_S = (2.0, 4.0, 8.0, 16.0, 16.0, 16.0)  # window lengths: in 2 s, raw readings err by less than 0.5 rad
WANTED_PERCENT = (0.2, np.inf)  # limits of the uncertainty of M
WANTED_REST_DPS = 0.03  # largest spread of the rest offsets
RECORD_LONGER = "Record longer: turn about every axis, and rest on all six sides of the device."


def fit_reference(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    mounting: Mounting = "each",
    adc: AdcModel | None = None,
    longest_lag_s: float = sync.LONGEST_LAG_S,
) -> ReferenceFit:
    """Fit matrix, offset in motion, and rounding loss of a gyroscope to references, for the rounding ``adc`` of its codes.

    If ``mounting`` is "each", the device was put on the reference body again for each recording.
    """
    check_choice(mounting, Mounting, "reference", "mounting")
    return fit_aligned(_align_all(records, references, longest_lag_s), mounting, adc=adc)


def leave_one_out(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    mounting: Mounting = "each",
    adc: AdcModel | None = None,
    longest_lag_s: float = sync.LONGEST_LAG_S,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[HeldOut, ...]:
    """Fit a model for each recording to all other recordings of the device. ``progress`` receives a text and a fraction, 0 to 1."""
    check_choice(mounting, Mounting, "reference", "mounting")
    if len(records) < 2:
        raise InputError(f"leave one out: two recordings of a device or more are needed, got {len(records)}.")
    aligned = _align_all(records, references, longest_lag_s)
    trials = list[HeldOut]()
    for k, held_out in enumerate(aligned):
        progress(f"fit without recording {k + 1} of {len(records)}", k / len(records))
        fit = fit_aligned([*aligned[:k], *aligned[k + 1 :]], mounting, adc=adc)
        (rest, _, sign), codes = rest_reading(held_out), fit.triad.model.code_offset
        trials.append(HeldOut(fit, fit.model_at_rest_offset(rest if codes is None else rest + sign * codes)))
    return tuple(trials)


def _align_all(records: Sequence[Record], references: Sequence[Reference], longest_lag_s: float) -> list[Aligned]:
    """Find lag and motion of all recordings of a device."""
    if not records or len(records) != len(references):
        raise InputError(
            f"reference: each record needs one reference, got {len(records)} records and {len(references)} references."
        )
    units = sorted({record.gyro_unit for record in records})
    if len(units) > 1:
        raise InputError(f"reference: the recordings of a device need one unit, got {', '.join(units)}. Convert them.")
    return [align(*pair, longest_lag_s) for pair in zip(records, references, strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Parameters:
    """The P parameters of R recordings: M row by row, d, c, changes of the offset, and rotations of the mountings.

    Each recording without a rest has its own change of the offset. Rotations are combinations that add up to zero.
    """

    value: FloatArray  # (P,)
    expected: FloatArray  # (P,), mean of the prior
    spread: FloatArray  # (P,), standard deviation of the prior: infinite without a prior, 0 if the parameter is fixed
    local: FloatArray  # (R, 18, P), maps the parameters to M, d, c and rotation of the mounting in each recording
    offsets: FloatArray  # (R, 3), o, raw unit
    mountings: FloatArray  # (R, 4), rotation from the mean body to the body of each recording

    @property
    def free(self) -> IntArray:
        """Return the indices of the fitted parameters."""
        return np.flatnonzero(self.spread)

    def equations(self, recordings: Sequence[Recording], reach: int) -> tuple[list[Windows], FloatArray]:
        """Return the window equations of all recordings, and the columns (n, 3, F) of the free parameters."""
        windows = [
            window_equations(recording, local @ self.value, offset, mounting, reach)
            for recording, local, offset, mounting in zip(
                recordings, self.local, self.offsets, self.mountings, strict=True
            )
        ]
        columns = [stretch.design @ local[:, self.free] for stretch, local in zip(windows, self.local, strict=True)]
        return windows, np.concatenate(columns)

    def moved(self, step: FloatArray) -> "_Parameters":
        """Return the parameters after a step (F,) of the free parameters."""
        full_step = np.zeros(len(self.value))
        full_step[self.free] = step
        mountings = quaternion_product(self.mountings, quaternion_of((self.local @ full_step)[:, 15:]))
        return replace(self, value=self.value + full_step, mountings=mountings)


def fit_aligned(
    aligned: Sequence[Aligned], mounting: Mounting, *, turning: bool = True, adc: AdcModel | None = None
) -> ReferenceFit:
    """Fit the gyroscope of a device to short windows, then to longer windows. Each fit starts from the previous one.

    d applies while the device turns or, without ``turning``, from the first to the last rest.
    """
    recordings, unit = [recording_of(item, turning=turning) for item in aligned], aligned[0].record.gyro_unit
    parameters = _start(recordings, mounting, unit, adc, moving_apart=turning)
    solution, scale, window_s = None, USUAL_RESIDUAL, 0.0
    for length_s in WINDOWS_S:
        reach = round(length_s / STRIDE_S)
        windows, design = parameters.equations(recordings, reach)
        count = sum(-(-len(recording_windows.first) // reach) for recording_windows in windows)
        unknown = design.shape[2]
        if 3 * count <= unknown:  # the recordings are too short for these windows
            break
        free = parameters.free
        prior_step, spread = (parameters.expected - parameters.value)[free], parameters.spread[free]
        solution, window_s = solve_windows(windows, design, prior_step, spread, reach=reach, scale=scale), length_s
        parameters, scale = parameters.moved(solution.step), solution.scale
    if solution is None:
        causes = " ".join(item.text for recording in recordings for item in recording.aligned.findings)
        raise NotObservable(
            f"reference: {unknown} parameters need more than {unknown // 3} windows of {length_s:g} s without overlap, got "
            f"{count}. {causes} Record longer motion.",
            windows=count,
        )
    if np.linalg.det(parameters.value[:9].reshape(3, 3)) <= 0.0:
        raise Implausible(
            "reference: the fit did not converge to a right-handed matrix. Check the axes of the readings."
        )
    return _result(recordings, parameters, solution, window_s, unit)


def _start(
    recordings: Sequence[Recording], mounting: Mounting, unit: str, adc: AdcModel | None, *, moving_apart: bool
) -> _Parameters:
    """Return the initial parameters, from the regression of rates on readings in the search for the lags."""
    from scipy.linalg import null_space
    from scipy.spatial.transform import Rotation

    matrices = np.array([r.aligned.lag.matrix for r in recordings])
    power = np.array([np.cov(r.gyro[r.moving].T) for r in recordings])  # (R, 3, 3), covariance of the readings
    common, eigenvalues = matrices @ power, np.linalg.eigvalsh(power.sum(axis=0))  # covariance of rates and readings
    if not eigenvalues[1] > SECOND_AXIS**2 * eigenvalues[2]:
        raise NotObservable("reference: the device was turned about one axis only. Turn it about a second axis too.")
    axes = np.linalg.svd(common, compute_uv=False)
    if ((np.linalg.det(common) < 0.0) & (axes[:, 2] > THIRD_AXIS**2 * axes[:, 0])).any():
        raise Implausible("reference: one axis of the readings or of the reference is reversed. Change its sign.")
    each = mounting == "each"
    bodies = Rotation.from_matrix(_nearest_rotation(each * common + SHARED_BODY * common.sum(axis=0)))
    mountings = bodies * bodies.mean().inv()
    physical = is_physical(unit)
    factor = si_factor(unit, "rate") if physical else float(axes.sum() / np.trace(power, axis1=1, axis2=2).sum())
    nominal, inverse_mountings = factor * bodies.mean().as_matrix(), mountings.inv().as_matrix()
    matrix = _first_matrix(inverse_mountings @ matrices, power, nominal)

    rest = np.array([r.rest for r in recordings])
    rested = np.isfinite(rest[:, 0])
    offsets = np.where(rested[:, None], rest, rest[rested].mean(axis=0) if rested.any() else 0.0)
    moving = [
        -b @ r.aligned.lag.constant - matrix @ o for b, r, o in zip(inverse_mountings, recordings, offsets, strict=True)
    ]
    step: FloatArray = np.zeros(3)
    half = 0.0
    if adc is not None and adc.gyro_lsb is not None:
        step, half = adc.gyro_lsb, 0.5 * (adc.gyro_rounding == "toward_zero")
    count = len(recordings)
    changes = np.eye(count)[:, ~rested] if count > 1 else np.zeros((1, 0))
    rotations = null_space(np.ones((1, count))) if each else np.zeros((count, 0))
    sizes = 3 * changes.shape[1], 3 * rotations.shape[1]
    local = np.zeros((count, 18, 15 + sum(sizes)))
    local[:, :15, :15] = np.eye(15)
    local[:, 9:12, 15 : 15 + sizes[0]] = [np.kron(shares, np.eye(3)) for shares in changes]
    local[:, 15:, 15 + sizes[0] :] = [np.kron(shares, np.eye(3)) for shares in rotations]
    matrix_spread = MATRIX_PRIOR * factor if physical else np.inf
    moving_spread = MOVING_PRIOR if moving_apart and rested.any() else np.inf
    spread = np.repeat([matrix_spread, moving_spread, 0.0, TURN_ON, MOUNTING_PRIOR], (9, 3, 3, *sizes))
    spread[12:15] = CODE_PRIOR * step
    return _Parameters(
        value=np.concatenate((matrix.ravel(), np.mean(moving, axis=0), half * step, np.zeros(sum(sizes)))),
        expected=np.concatenate((nominal.ravel(), np.zeros(3), half * step, np.zeros(sum(sizes)))),
        spread=spread,
        local=local,
        offsets=offsets,
        mountings=mountings.as_quat(scalar_first=True),
    )


def _nearest_rotation(matrices: FloatArray) -> FloatArray:
    """Return the rotations (R, 3, 3) nearest to matrices, or to their projections on a plane (Kabsch 1976)."""
    u, _, v = np.linalg.svd(matrices)
    u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
    return np.asarray(u @ v)


def _first_matrix(matrices: FloatArray, power: FloatArray, nominal: FloatArray) -> FloatArray:
    """Return the common matrix of all recordings from single matrices (R, 3, 3), weighted by the covariance of their readings.

    M = (sum M_r W_r + e N) (sum W_r + e)^-1 with the nominal matrix N for directions that no recording determines. A recording
    differs from M by the difference of its rates, |(M_r - M) W_r^(1/2)| / |M W_r^(1/2)|.
    """
    total_power = power.sum(axis=0)
    ridge = START_RIDGE * float(np.linalg.eigvalsh(total_power)[2])
    shared = ((matrices @ power).sum(axis=0) + ridge * nominal) @ np.linalg.inv(total_power + ridge * np.eye(3))
    apart = matrices - shared
    difference_power = np.einsum("rij,rjk,rik->r", apart, power, apart)
    difference = float(np.sqrt((difference_power / np.einsum("ij,rjk,ik->r", shared, power, shared)).max()))
    if difference > MATRIX_DIFFERENCE:
        raise AlignmentError(
            f"reference: the matrices of the recordings differ by {difference:.0%}. Fit each sensor separately. With "
            "`mounting` one, also fit each placement of the markers separately.",
            difference=difference,
        )
    return np.asarray(shared)


def _result(
    recordings: Sequence[Recording], parameters: _Parameters, solution: Solution, window_s: float, unit: str
) -> ReferenceFit:
    """Return the fit with the covariance of M, o, d and c."""
    from scipy.linalg import block_diag
    from scipy.spatial.transform import Rotation

    matrix, moving, codes = parameters.value[:9].reshape(3, 3), parameters.value[9:12], parameters.value[12:15]
    moving_apart, coded = bool(np.isfinite(parameters.spread[9])), bool(parameters.spread[12] > 0.0)
    rested = [r for r in recordings if np.isfinite(r.rest).all()]
    base = sign = spread = np.zeros(3)
    if rested:
        sign = np.mean([r.rest_sign for r in rested], axis=0)
        base = np.mean([r.rest for r in rested], axis=0) + sign * codes
        spread = np.sqrt(np.sum([r.rest_uncertainty**2 for r in rested], axis=0)) / len(rested)
    inverse = np.linalg.inv(matrix)
    motion_offset = inverse @ moving
    # The fit has M, d and c. The offset o is the mean at rest. An error r of this mean changes o by r and d by -r.
    matrix_rows, moving_rows, code_rows, rest_rows = np.split(np.eye(18), (9, 12, 15))
    offset_rows = np.diag(sign) @ code_rows
    if moving_apart:
        rows = [matrix_rows, offset_rows + rest_rows, moving_rows - matrix @ rest_rows]
    else:
        rows = [matrix_rows, offset_rows + inverse @ moving_rows - np.kron(inverse, motion_offset) @ matrix_rows]
    jacobian = np.vstack((*rows, *([code_rows] if coded else [])))
    free = parameters.free[parameters.free < 15]
    covariance = block_diag(np.zeros((15, 15)), np.diag(spread**2))
    covariance[np.ix_(free, free)] = solution.covariance[: len(free), : len(free)]
    rates = [(r.gyro[r.moving] - base - motion_offset) @ matrix.T for r in recordings]
    triad = triad_fit(
        solution.residuals / window_s,
        method="reference/motion",
        unit_in=unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=base if moving_apart else base + motion_offset,
        parameters=MATRIX_NAMES + OFFSET_NAMES + MOVING_NAMES * moving_apart + CODE_NAMES * coded,
        covariance=jacobian @ covariance @ jacobian.T,
        rank=len(free),
        condition=solution.condition,
        valid_range=(min(float(rate.min()) for rate in rates), max(float(rate.max()) for rate in rates)),
        moving_offset=moving if moving_apart else None,
        code_offset=codes if coded else None,
    )
    findings = [
        *_findings(triad.model, parameters.expected[:9].reshape(3, 3), [r.rest for r in rested]),
        *(item for r in recordings for item in r.aligned.findings),
    ]
    return ReferenceFit(
        triad=triad.also(*findings),
        motion_offset=motion_offset,
        rest_offsets=np.array([r.rest for r in recordings]),
        lags_s=np.array([r.aligned.lag.seconds for r in recordings]),
        lag_uncertainties_s=np.array([r.aligned.lag.standard_uncertainty for r in recordings]),
        window_s=window_s,
        mountings=Rotation.from_quat(parameters.mountings, scalar_first=True).as_rotvec(),
    )


def _findings(model: TriadModel, nominal: FloatArray, rests: Sequence[FloatArray]) -> Iterator[Finding]:
    """Yield findings about axes that keep their prior, about an uncertain matrix, and about rest offsets that differ."""
    size = float(np.linalg.norm(nominal, 2))
    jacobian = np.kron(nominal.T, np.eye(3)) / size**2
    spread = np.sqrt(np.diag(jacobian @ model.covariance[:9, :9] @ jacobian.T)).reshape(3, 3)
    near_prior = is_physical(model.unit_in) & (spread > 0.5 * MATRIX_PRIOR).any(axis=0)
    if near_prior.any():
        axes = tuple(axis for axis, keeps in zip("xyz", near_prior, strict=True) if keeps)
        advice = "Also record turns about these axes of the device."
        yield uncertain_scale("gyroscope", axes, MATRIX_PRIOR, advice)
    else:
        yield from uncertain("The gyroscope matrix", 100.0 * float(spread.max()), WANTED_PERCENT, "%", RECORD_LONGER)
    spread_dps = float(np.std(rests, axis=0, ddof=1).max() * size / RADIAN_PER_DEGREE) if len(rests) > 1 else 0.0
    if spread_dps > WANTED_REST_DPS:
        spread_text = told_apart(spread_dps, ".3f", WANTED_REST_DPS)
        yield finding(
            "reference.rest_offset",
            "warn",
            f"The rest offset scatters by {spread_text} deg/s between recordings (limit {WANTED_REST_DPS:g} deg/s).",
            "Warm the device up before each recording.",
            spread_dps=spread_dps,
        )


def uncertain_scale(triad: str, axes: tuple[str, ...], uncertainty: float, action: str) -> Finding:
    """Return a finding about scale factors that the motion hardly determines, with the uncertainty that remains."""
    percent = f"{100.0 * uncertainty:.2g} %"
    sentence = f"The motion determines the scale of the {triad} for {', '.join(axes)} only to +- {percent} (1 sigma)."
    return finding("motion.prior", "warn", sentence, action, axes=axes)
