"""Offset of the gyroscopes from motion, by gravity in the level frame of the strapdown.

::

    <F>_k = g u - A_k b + P_k d + e_k      A_k = <[F]x J>_k, J the integral of R dt, P_k = <R>_k, accelerometer offset d

with the means, the random walk of the attitude and the sizes of fit/carried.py. Generalised least squares determines b, d and the
vertical u, linearised about the last b (Gauss-Newton). Long recordings are cut into stretches, each with its own vertical, offset
and sizes. Offsets follow a random walk from one stretch to the next.

The prior of b is the mean at a rest. Without a rest it is the uncertainty of a calibration or a data sheet. Gravity does not
determine turns about the vertical, so b keeps its prior along an axis that stays upright. The rates of an uncalibrated device
have errors E w, with E within the tolerances of data sheets. They change b, and its uncertainty includes this change.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.rest import LEAST_IN_MOTION_S, MOVED, RemainingOffset, moved_by
from undrift.errors import InputError
from undrift.fit.carried import CarriedMeans, tilted_axes
from undrift.fit.priors import CROSS_AXIS, SCALE_FACTOR
from undrift.model import TriadModel
from undrift.record import Record
from undrift.segments import unpadded
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

STRETCH_S, SHORT_S = 300.0, 25.0  # length of a stretch, and of stretches for the initial estimate, s
WALK = 2e-4 * RADIAN_PER_DEGREE  # random walk of a consumer gyroscope's offset, rad/s/sqrt(s) [assumed]
# offset of accelerometers, m/s2, and relative error of their size of gravity: calibrated, and from data sheets [assumed]
CALIBRATED, RAW = (0.05, 0.005), (0.5, 0.03)
# offset without a rest, rad/s: turn-on repeatability of a calibrated device, and zero-rate output of a raw device [assumed]
CALIBRATED_RATE, RAW_RATE = 0.1 * RADIAN_PER_DEGREE, 1.0 * RADIAN_PER_DEGREE
_UNRESTED = 1.6  # ratio of actual to computed error without a rest, for 30 simulated people who move freely
_LOOSE = 1.0 * RADIAN_PER_DEGREE  # standard deviation of the offset while the sizes are estimated, rad/s
_FIXED = 1e-9  # error of the rates, while the sizes are estimated
_ROUNDS, _SETTLED = 8, 1e-7  # linearisations, and final change in rad/s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionFit:
    """Offset of the gyroscopes, and the vertical at the start, from gravity in motion."""

    offset: RemainingOffset
    vertical: FloatArray  # (3,), specific force at rest in the attitude and frame b of the first sample, m/s2
    vertical_covariance: FloatArray  # (3, 3), (m/s2)^2


def fit_motion(record: Record, rest: RemainingOffset | None, model: TriadModel | None = None) -> MotionFit:
    """Fit the offset that gravity determines in motion, with the mean at a rest or the model's uncertainty as its prior."""
    record = unpadded(record)
    advice = "Record with a pause at rest." if rest is None else "Use `offset` rest."
    if record.gyro is None or record.accel is None:
        raise InputError(f"offset from motion: rates and specific force are needed, but one is missing. {advice}")
    gaps = int((~np.isfinite(np.hstack((record.gyro, record.accel)))).any(axis=1).sum())
    if gaps or record.duration_s < LEAST_IN_MOTION_S:
        got = f"{gaps} gaps (NaN)" if gaps else f"{record.duration_s:.3g} s"
        raise InputError(
            f"offset from motion: expected {LEAST_IN_MOTION_S:g} s or more without gaps, got {got}. {advice}"
        )
    prior = _prior_without_rest(model) if rest is None else rest.covariance[0] + np.eye(3) * axis_moved_by(model) ** 2
    usual = np.zeros(3) if rest is None else rest.mean
    stretches, theta, information = _fit_stretches(record, usual, usual, prior, STRETCH_S)
    if rest is None:  # over a whole recording, the vertical may turn too far for a linearisation about zero offset
        pieces, short, _ = _fit_stretches(record, usual, usual, prior, SHORT_S)
        initial = short[: 3 * len(pieces)].reshape(-1, 3).mean(axis=0)
        other = _fit_stretches(record, initial, usual, prior, STRETCH_S)
        if sum(stretch.cost for stretch in other[0]) < sum(stretch.cost for stretch in stretches):
            stretches, theta, information = other
    covariance, count = np.linalg.inv(information), 3 * len(stretches)
    covariance *= _UNRESTED**2 if rest is None else 1.0
    if (matrix_sigma := matrix_deviation(record, model)) is not None:  # E turns gravity in the same way as an offset
        answers = offset_gains(record, theta[:count].reshape(-1, 3).mean(axis=0), usual, prior, np.asarray(record.gyro))
        covariance += (answers * matrix_sigma.ravel() ** 2) @ answers.T
    first = np.r_[:3, count : count + 3]
    vertical, vertical_covariance = stretches[0].vertical(covariance[np.ix_(first, first)])
    offset = RemainingOffset(
        time=np.array([stretch.middle for stretch in stretches]),
        rate=theta[:count].reshape(-1, 3),
        covariance=np.stack([covariance[k : k + 3, k : k + 3] for k in range(0, count, 3)]),
        rest_s=None if rest is None else rest.rest_s,
        stills=None if rest is None else rest.stills,
        moved=0.0,
        prior=np.sqrt(np.diag(prior)),
    )
    return MotionFit(offset=offset, vertical=vertical, vertical_covariance=vertical_covariance)


def offset_gains(
    record: Record, initial: FloatArray, usual: FloatArray, prior: FloatArray, rate_errors: FloatArray
) -> FloatArray:
    """Return the change of the offsets of each stretch and of d, (3 S + 3, 3 C), per unit of an error x_c e_b of the rates."""
    stretches, _, information = _fit_stretches(record, initial, usual, prior, STRETCH_S, rate_errors)
    offsets = 3 * len(stretches) + 3
    return np.asarray(np.linalg.solve(information[:offsets, :offsets], information[:offsets, offsets:]))


def _fit_stretches(
    record: Record,
    initial: FloatArray,
    usual: FloatArray,
    prior: FloatArray,
    stretch_s: float,
    rate_errors: FloatArray | None = None,
) -> tuple[list[CarriedMeans], FloatArray, FloatArray]:
    """Return stretches of roughly a given length, their offsets, the accelerometer offset, and the information, from ``initial``.

    With ``rate_errors`` (N, C), do one step, and include the information about errors x_c e_b of the rates.
    """
    edges = np.linspace(0, len(record), max(1, round(record.duration_s / stretch_s)) + 1).astype(int)
    force, rate, error = np.asarray(record.accel), np.asarray(record.gyro), record.accel_uncertainty
    calibrated = error is not None and np.diag(error.covariance)[9:].max() < RAW[0] ** 2 / 4.0
    accel = CALIBRATED if calibrated else RAW
    spans = [slice(a, b) for a, b in pairwise(edges)]
    stretches = [CarriedMeans(record.time[span]) for span in spans]
    tilted_mean = tilted_axes(record.time, force, accel[0])
    axes = [
        tilted_axes(record.time[span], force[span], accel[0]) if np.trace(tilted_mean) > 2.5 else tilted_mean
        for span in spans
    ]
    columns = np.ones((len(rate), 1)) if rate_errors is None else np.hstack((np.ones((len(rate), 1)), rate_errors))
    errors = 3 * (columns.shape[1] - 1)
    loose = np.concatenate((np.repeat((_LOOSE, accel[0]), 3), np.full(errors, _FIXED)))
    middle, count = np.array([stretch.middle for stretch in stretches]), 3 * len(stretches)
    walk_of_offsets = np.pad(_walk_information(middle, prior, accel[0]), (0, errors))
    start, theta = (np.append(np.tile(stretch, len(stretches)), np.zeros(3 + errors)) for stretch in (usual, initial))
    for _ in range(_ROUNDS):
        information, right = walk_of_offsets.copy(), walk_of_offsets @ (start - theta)
        for k, (stretch, span) in enumerate(zip(stretches, spans, strict=True)):
            places = np.r_[3 * k : 3 * k + 3, count : count + 3 + errors]
            offset, force_offset = theta[places[:6]].reshape(2, 3)
            mean, moments, fixed = stretch.means(
                rate[span] - offset, force[span] - force_offset, columns[span], columns[span, :1]
            )
            moments = np.einsum("kibc,ab->kiac", moments, axes[k])
            error_columns = moments[..., 1:].reshape(len(mean), 3, errors)
            design = -np.concatenate((moments[..., 0], fixed[..., 0], error_columns), axis=2)
            stretch_information, right_part = stretch.equations(
                mean, design, loose, (STANDARD_GRAVITY, accel[1] * STANDARD_GRAVITY)
            )
            information[np.ix_(places, places)] += stretch_information
            right[places] += right_part
        if errors:
            break
        step = np.linalg.solve(information, right)
        theta = theta + step
        if np.abs(step[:count]).max() < _SETTLED:
            break
    return stretches, theta, information


def matrix_deviation(record: Record, model: TriadModel | None) -> FloatArray | None:
    """Return the standard deviation of each element of E (3, 3) from data sheets, or None for a calibrated device."""
    if record.state == "corrected" and (model is None or model.covariance[:9, :9].any()):
        return None
    return np.where(np.eye(3, dtype=bool), SCALE_FACTOR, CROSS_AXIS)


def axis_moved_by(model: TriadModel | None) -> float:
    """Return the standard deviation of an axis' change from rest to motion, rad/s, with any fitted change taken into account."""
    if model is None or model.moving_offset is None:
        return MOVED
    fitted = moved_by(model) / math.sqrt(3.0)
    return fitted * MOVED / math.hypot(fitted, MOVED)


def _prior_without_rest(model: TriadModel | None) -> FloatArray:
    """Return the covariance of an offset without a rest, from the calibration and the change at a switch-on."""
    if model is None or not model.covariance.any():
        return np.eye(3) * RAW_RATE**2
    spread: FloatArray = model.offset_covariance * si_factor(model.unit_out, "rate") ** 2
    return spread + np.eye(3) * CALIBRATED_RATE**2


def _walk_information(middle: FloatArray, prior: FloatArray, accel: float) -> FloatArray:
    """Return the prior information of offsets (S, 3), which walk at random, and of the accelerometer offset."""
    count = 3 * len(middle)
    information = np.zeros((count + 3, count + 3))
    information[:3, :3], information[count:, count:] = np.linalg.inv(prior), np.eye(3) / accel**2
    for k, length in enumerate(np.diff(middle)):
        pair = slice(3 * k, 3 * k + 6)
        information[pair, pair] += np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3)) / (WALK**2 * length)
    return information
