"""Suitability of a calibration: the pitch error of a sit-to-stand, from the uncertainty of the calibration.

A person is at rest for R = 5 s, and then leans by A = 45 deg and back, once or repeatedly, for a time t. The tilt at the start is
determined from gravity at the rest. The offset of the gyroscopes is the mean rate at the rest. To first order, the variance of the
pitch about an axis p of the device is::

    u^2(t) = u_f^2 / g^2 + u_a^2 + A^2 u_pp^2 + A_q^2 sum_q u_pq^2
             + t^2 (N^2 / R + B^2 + m^2 + r^2 + s^2 + sum_c (u_pc <f_c - f_c(0)>)^2) + N^2 t

    u_f     specific force at rest, across p and the vertical: accelerometers, temperature, a year of ageing and codes (rest.py)
    u_a     axes of the sensors in the case, if only the size of gravity was used: 0.01 rad, as cross-axis terms of data sheets
    u_pq    error matrix E = dM M^-1 of the gyroscopes: scale factor, and cross-axis terms for turns A_q = 10 deg about the others
    N, B    noise of the rate at the rest and in motion, and flicker of the offset between them
    m       change of the offset from rest to motion, if the calibration contains it
    r       rounding to codes at the rest: the share of codes in the offset of the calibration, times the root of its rests
    s       a third of a code step, if codes are truncated toward zero and the offset is within a step of zero
    u_pc    g-sensitivity of the gyroscopes, for the mean change of the specific force during a lean

Codes that the calibration did not identify, and the delay of a slow filter while the device turns, are not counted.

Without a rest, the offset is taken from the calibration. Its covariance, and its changes at a switch-on, with temperature and from
rest to motion, replace N^2 / R, m^2 and r^2. The limit is 1.96 u for the least certain axis p and vertical. Without gyroscopes, the
limit contains only the first two terms. Without an accelerometer, it contains the other terms, and applies to a change of the
pitch.
"""

import math

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.motion import CALIBRATED_RATE
from undrift.correction.plan import force_uncertainty
from undrift.correction.rest import UNKNOWN_K, UNKNOWN_YEARS, calibrated_force_covariances, moved_by
from undrift.fit.priors import CROSS_AXIS, G_SENSITIVITY, GYRO_FLICKER, GYRO_NOISE
from undrift.model import AXES, G_NAMES, MATRIX_NAMES, Calibration, TriadModel
from undrift.record import TemperatureSensitivity
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

TASK_S = (5.0, 60.0)  # duration of one sit-to-stand, and of repeated ones
REST_S = 5.0
LEAN, TURN = 45.0 * RADIAN_PER_DEGREE, 10.0 * RADIAN_PER_DEGREE
WITHIN_K = UNKNOWN_K  # largest distance from the temperature of the calibration for which the answer applies
# error that a clinic accepts, rad: J. L. McGinley et al., Gait and Posture 29, 360-369, 2009 [figure not compared]
ACCEPTED = 2.0 * RADIAN_PER_DEGREE
OF_CASE = ("six-face", "reference")  # methods of accelerometers that determine the axes of the case
NORMAL_95 = 1.96


def pitch_limits(calibration: Calibration, *, rested: bool = True, away_k: float = 0.0) -> FloatArray | None:
    """Return the 95 % limits of the pitch after the times ``TASK_S``, (2,), rad, or None for an unknown uncertainty.

    ``rested`` is False for a recording without a rest. ``away_k`` is the distance from the temperature of the calibration, K.
    """
    accel, gyro = calibration.accel, calibration.gyro
    models = [model for model in (accel, gyro) if model is not None]
    if not models or any(not np.isfinite(model.covariance).all() or not model.covariance.any() for model in models):
        return None
    variance = np.zeros((3, 2, 2))  # variances about each axis, with each other axis up, after each time
    if accel is not None:
        variance += _tilt_variance(calibration, accel, away_k)[:, :, None]
    if gyro is not None:
        task_s = np.array(TASK_S)
        variance += _rotation_variance(calibration, gyro, away_k)[:, None, None]
        variance += _rate_variance(calibration, gyro, rested=rested, away_k=away_k)[:, :, None] * task_s**2
        variance += GYRO_NOISE**2 * task_s
    return np.asarray(NORMAL_95 * np.sqrt(variance.max(axis=(0, 1))))


def answer_sentence(calibration: Calibration) -> str:
    """Return one or two sentences on suitable and unsuitable uses of a calibration."""
    if calibration.verdict.status == "bad":
        return "Do not use this calibration, because one of its numbers may be wrong. The findings give the reason."
    limits = pitch_limits(calibration, away_k=WITHIN_K)
    if limits is None:
        return "This calibration has no uncertainty, so its accuracy in use is unknown."
    once, minute = (f"{limit / RADIAN_PER_DEGREE:#.2g}".rstrip(".") + " deg" for limit in limits)
    if calibration.gyro is None:
        return f"Good for the tilt at rest: within {once}. Not for motion, because gyroscopes are not calibrated."
    what = "pitch" if calibration.accel is not None else "change of the pitch"
    if limits[0] > ACCEPTED:
        return f"Not good enough for a sit-to-stand: even after a rest, the {what} is only within {once} after 5 s."
    good, excluded = f"{once} after 5 s, {minute} after 60 s", ""
    if limits[1] > ACCEPTED:
        good, excluded = f"{once} after 5 s", f"for a minute of motion ({minute}), "
    return (
        f"Good for a sit-to-stand after a rest: {what} within {good}. "
        f"Not {excluded}for recordings without a rest, nor {_beyond(calibration)}."  # a switch-on changes the offset
    )


def _beyond(calibration: Calibration) -> str:
    """Return the temperatures for which a calibration is not suitable."""
    static = None if calibration.drift is None else calibration.drift.static
    if static is not None:
        return f"below {static.temp_c[0]:.0f} or above {static.temp_c[-1]:.0f} degC"
    if math.isfinite(calibration.reference_temp_c):
        return f"more than {WITHIN_K:.0f} K from {calibration.reference_temp_c:.0f} degC"
    return f"more than {WITHIN_K:.0f} K from its temperature, which was not recorded"


def _tilt_variance(calibration: Calibration, accel: TriadModel, away_k: float) -> FloatArray:
    """Return the variance of the pitch at the rest, about each axis and with each other axis up, (3, 2), rad^2."""
    variance = np.zeros((3, 2))
    error = force_uncertainty(calibration, accel.unit_in)
    if error is None:
        return variance
    for p, k, up, forward in _POSTURES:
        force = STANDARD_GRAVITY * np.eye(3)[up]
        parts = calibrated_force_covariances(error, force, calibration.reference_temp_c + away_k, UNKNOWN_YEARS)
        variance[p, k] = sum(part[forward, forward] for part in parts.values()) + error.step[forward] ** 2 / 12.0
    case_variance = 0.0 if accel.method.startswith(OF_CASE) else CROSS_AXIS**2
    return variance / STANDARD_GRAVITY**2 + case_variance


_POSTURES = [  # axis of the pitch and number of the posture, with the axes that point up and forward
    (p, k, (p + 1 + k) % 3, (p + 2 - k) % 3) for p in range(3) for k in range(2)
]


def _rotation_variance(calibration: Calibration, gyro: TriadModel, away_k: float) -> FloatArray:
    """Return the variance of the pitch due to the rotations of the task, about each axis, (3,), rad^2."""
    inverse = gyro.forward_matrix
    rows = [gyro.covariance_of(MATRIX_NAMES[3 * axis : 3 * axis + 3]) for axis in range(3)]
    error = np.einsum("cq,acd,dq->aq", inverse, np.array(rows), inverse)
    angle = np.where(np.eye(3, dtype=bool), LEAN, TURN)
    has_table = calibration.drift is not None and calibration.drift.scale is not None
    scale_change = 0.0 if has_table else 0.01 * _per_k(calibration, "gyro_scale_percent_per_k") * away_k
    return np.asarray((error * angle**2).sum(axis=1) + (LEAN * scale_change) ** 2)


def _rate_variance(calibration: Calibration, gyro: TriadModel, *, rested: bool, away_k: float) -> FloatArray:
    """Return the variance of a steady error of the rate, about each axis and with each other axis up, (3, 2), (rad/s)^2."""
    lean = 0.5 * LEAN * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)))
    forward_change = STANDARD_GRAVITY * float(np.sin(lean).mean())
    upward_change = STANDARD_GRAVITY * float(np.cos(lean).mean() - 1.0)
    force_variance = np.empty((3, 2))
    for p, k, up, forward in _POSTURES:
        fitted = gyro.g_sensitivity is not None
        sensitivity = gyro.covariance_of(G_NAMES[3 * p : 3 * p + 3]) if fitted else G_SENSITIVITY**2 * np.eye(3)
        force_variance[p, k] = (
            upward_change**2 * sensitivity[up, up] + forward_change**2 * sensitivity[forward, forward]
        )
    triad, codes = calibration.triad("gyro"), np.zeros(3)
    if triad.lsb is not None and triad.rounding == "toward_zero" and gyro.code_offset is None:
        step = triad.lsb * gyro.si_per_reading("rate")
        codes = np.where(np.abs(gyro.offset) < triad.lsb, step / 3.0, 0.0)
    motion_variance = moved_by(gyro) ** 2 / 3.0
    if rested:
        offset = _rest_code_variance(calibration, gyro) + GYRO_NOISE**2 / REST_S
        offset += motion_variance if gyro.moving_offset is not None else 0.0
    else:
        temperature_change = _per_k(calibration, "gyro_offset_dps_per_k") * RADIAN_PER_DEGREE * away_k
        offset = np.diag(gyro.offset_covariance) + CALIBRATED_RATE**2 + temperature_change**2 + motion_variance
    return np.asarray(force_variance + (offset + codes**2 + GYRO_FLICKER**2)[:, None])


def _rest_code_variance(calibration: Calibration, gyro: TriadModel) -> FloatArray:
    """Return the variance of the mean of a rest due to rounding to codes, (3,), (rad/s)^2."""
    rests = str(dict(calibration.provenance.settings).get("stills", "")).partition(" ")[0]
    if gyro.budget is None or "adc" not in gyro.budget.sources or not rests.isdigit():
        return np.zeros(3)
    share = gyro.budget.uncertainty[gyro.budget.sources.index("adc")]
    offset_share = np.array([share[gyro.parameters.index(f"offset_{axis}")] for axis in AXES])
    return np.asarray(int(rests) * (offset_share * gyro.si_per_reading("rate")) ** 2)


def _per_k(calibration: Calibration, name: str) -> float:
    return calibration.provenance.number(name, getattr(TemperatureSensitivity(), name))
