"""Rest at the beginning of a recorded motion: whether the body is as still as study.toml says, by its own poses.

Three figures of the first ``rest_s`` seconds, rates and accelerations as means over a quarter of a second, so that the noise of
cameras does not count as motion::

    w    |mean of w_b|                          how fast the body turns
    a    |mean of p''|                          how fast its velocity changes
    e    angle(mean of f_b, R_nb^T z)           what a device without any error would mistake in its tilt at the end of that time

A study lays all that the pitch errs by at the device and its calibration. Where e is not small it errs by the motion instead.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.sim.motion.poses import PoseSpline
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the tilt at the start is a mean over the rest
# People who stand quietly keep to 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s at the pelvis; who has begun to rise is at 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """How still a body is for a time from the first pose on, and how long it is.

    Parameters
    ----------
    turn_rate : float
        Largest, rad/s.
    acceleration : float
        Largest, m/s2.
    tilt_error : float
        Of a device without errors, at the end of the time, rad.
    still_s : float
        How long the body truly is still, s.
    """

    turn_rate: float
    acceleration: float
    tilt_error: float
    still_s: float


def measure_rest(spline: PoseSpline, rest_s: float) -> Rest:
    """Measure how still a body is at the beginning of its poses.

    Parameters
    ----------
    spline : PoseSpline
        Poses with positions, without gaps.
    rest_s : float
        How long it is said to be at rest, s; a window or longer.

    Returns
    -------
    Rest
        Over that time, and how long it keeps all three limits.
    """
    start, stop = spline.span_s
    count = int((stop - start) * SAMPLE_RATE_HZ)
    motion = spline.at(start + np.arange(count) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)
    swing = rotate(motion.q_nb, motion.force_b) - np.array([0.0, 0.0, STANDARD_GRAVITY])
    # by the number of samples since the first pose: what the time up to there shows
    rate, acceleration = (np.maximum.accumulate(_windowed(x)) for x in (motion.rate_b, swing))
    up = rotate(quaternion_conjugate(motion.q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.cumsum(motion.force_b, axis=0)
    apart = np.linalg.norm(np.cross(mean, up), axis=1)
    tilt = np.arctan2(apart, (mean * up).sum(axis=1))
    kept = (rate <= MOST_TURN_RATE) & (acceleration <= MOST_ACCELERATION) & (tilt <= MOST_TILT_ERROR)
    last = min(round(rest_s * SAMPLE_RATE_HZ), count) - 1
    return Rest(
        turn_rate=float(rate[last]),
        acceleration=float(acceleration[last]),
        tilt_error=float(tilt[last]),
        still_s=(int(np.flatnonzero(kept)[-1]) + 1) / SAMPLE_RATE_HZ if kept.any() else 0.0,
    )


def check_rest(spline: PoseSpline, rest_s: float, path: Path) -> None:
    """Refuse a motion that does not begin with the rest that is stated.

    Parameters
    ----------
    spline : PoseSpline
        Poses with positions, without gaps.
    rest_s : float
        How long the body is said to be at rest at the beginning, s.
    path : Path
        File, for the message.

    Raises
    ------
    InputError
        The body turns or accelerates; names how long it is still.
    """
    found = measure_rest(spline, rest_s)
    if (
        found.turn_rate <= MOST_TURN_RATE
        and found.acceleration <= MOST_ACCELERATION
        and found.tilt_error <= MOST_TILT_ERROR
    ):
        return
    still_s = np.floor(10.0 * found.still_s) / 10.0
    todo = (
        f"set rest_s = {still_s:g}"
        if still_s >= LEAST_REST_S
        else f"take a recording that begins with {LEAST_REST_S:g} s at rest or more, or set hold = true and rest_s = 6"
    )
    raise InputError(
        f"{path}: wanted a body at rest for its first rest_s = {rest_s:g} s, got one that turns at up to "
        f"{found.turn_rate / RADIAN_PER_DEGREE:.3g} deg/s and accelerates by up to {found.acceleration:.2g} m/s2 (at rest: "
        f"{MOST_TURN_RATE / RADIAN_PER_DEGREE:g} and {MOST_ACCELERATION:g}), for which the first tilt alone would be wrong by "
        f"{found.tilt_error / RADIAN_PER_DEGREE:.1f} deg; it is still for {still_s:g} s: {todo}",
        turn_rate=found.turn_rate,
        acceleration=found.acceleration,
        tilt_error=found.tilt_error,
        still_s=found.still_s,
    )


def _windowed(values: FloatArray) -> FloatArray:
    """Return the size of the mean over the window that ends at each sample; over what there is before the first whole one."""
    n, width = len(values), max(round(WINDOW_S * SAMPLE_RATE_HZ), 1)
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(values, axis=0)))
    ends = np.arange(1, n + 1)
    first = np.maximum(ends - width, 0)
    size: FloatArray = np.linalg.norm((total[ends] - total[first]) / (ends - first)[:, None], axis=1)
    size[: min(width, n) - 1] = 0.0  # a shorter mean would let the noise of cameras count
    return size
