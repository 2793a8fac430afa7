"""Sway of quiet stance, by one device at the lower back.

Accelerations are those of Moe-Nilssen [1]_: the axes are turned so that the mean specific force is vertical; low-pass 3.5 Hz,
less the mean, as in ISway [2]_. Each is over the whole recording::

    RMS            sqrt(mean(x^2)), forward-backward (AP), left-right (ML), and both                     m/s2
    path           sum of |a_k - a_(k-1)|, both axes together, per second of the recording                m/s2 a second
    ellipse        2 pi F (s_1 s_2), F = F_0.95(2, N - 2), s^2 the principal variances [3]_                m2/s4
    mean velocity  mean of |integral of a|, both axes, high-pass 0.15 Hz in both directions [2]_          m/s
    frequency      mean: sum f P / sum P; median: half of the power is below; 0.15 to 3.5 Hz [3]_         Hz

The same of the angles pitch and roll: RMS, ellipse (deg2), mean angular velocity, and the frequencies of the pitch.

.. [1] R. Moe-Nilssen, "A new method for evaluating motor control in gait under real-life environmental conditions. Part 1",
   Clinical Biomechanics 13, 320-327, 1998.
.. [2] M. Mancini et al., "ISway: a sensitive, valid and reliable measure of postural control", J. NeuroEngineering and
   Rehabilitation 9, 59, 2012.
.. [3] T. E. Prieto et al., "Measures of postural steadiness", IEEE Trans. Biomedical Engineering 43, 956-966, 1996.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.worn import Course, smooth
from undrift.units import RADIAN_PER_DEGREE

CUTOFF_HZ, LOWEST_HZ = 3.5, 0.15
LEAST_S = 10.0  # a recording: one and a half periods of the slowest sway
MOST_LEAN = 6.0 * RADIAN_PER_DEGREE  # rms of pitch and of roll: stance on foam, eyes closed, has 2 at most
MOST_ACCELERATION = 0.8  # m/s2 rms, level; foam, eyes closed, has 0.13, slow walking 1
MOST_UPWARD = 0.4  # m/s2 rms; foam, eyes closed, has 0.12, walking 0.8 or more


def sway(course: Course) -> TaskResult:
    """Measure sway."""
    length, rate_hz = float(course.time[-1]), 1.0 / course.step
    angles = np.stack((course.pitch, course.roll), axis=1)
    level = smooth(_levelled(course.force), CUTOFF_HZ, rate_hz)
    level = level - level.mean(axis=0)
    lean, push = np.std(angles, axis=0).max(), np.sqrt((level**2).sum(axis=1).mean())
    upward = float(course.up.std())
    if length < LEAST_S or lean > MOST_LEAN or push > MOST_ACCELERATION or upward > MOST_UPWARD:
        raise not_shown(
            "standing",
            f"{LEAST_S:g} s or more of quiet stance, angles within {MOST_LEAN / RADIAN_PER_DEGREE:g} deg rms and accelerations "
            f"within {MOST_ACCELERATION:g} m/s2 rms level and {MOST_UPWARD:g} upward",
            f"{length:.3g} s, {lean / RADIAN_PER_DEGREE:.2g} deg, {push:.2g} and {upward:.2g} m/s2",
            "name the recording of the stance alone",
        )
    degrees = smooth((angles - angles.mean(axis=0)) / RADIAN_PER_DEGREE, CUTOFF_HZ, rate_hz)
    speed = smooth(np.cumsum(level, axis=0) / rate_hz, LOWEST_HZ, rate_hz, order=2, kind="highpass")
    mean, median = frequencies(level, rate_hz)
    mean_pitch, median_pitch = frequencies(degrees[:, :1], rate_hz)
    values = {
        "rms_ap_m_s2": _rms(level[:, 0]), "rms_ml_m_s2": _rms(level[:, 1]), "rms_m_s2": float(push),
        "path_m_s2": _path(level) / length, "ellipse_area_m2_s4": ellipse_area(level),
        "mean_velocity_m_s": float(np.hypot(*speed.T).mean()), "mean_frequency_hz": mean, "median_frequency_hz": median,
        "rms_pitch_deg": _rms(degrees[:, 0]), "rms_roll_deg": _rms(degrees[:, 1]),
        "angle_ellipse_area_deg2": ellipse_area(degrees), "mean_angular_velocity_dps": _path(degrees) / length,
        "mean_pitch_frequency_hz": mean_pitch, "median_pitch_frequency_hz": median_pitch,
        "mean_pitch_deg": float(course.pitch.mean()) / RADIAN_PER_DEGREE,
    }  # fmt: skip
    return TaskResult(
        values={name: np.array([one]) for name, one in values.items()}, events=(Event(0.0, length, "standing"),)
    )


def _levelled(force: FloatArray) -> FloatArray:
    """Return the specific force (N, 3) along forward and left (N, 2), both level where its mean is vertical."""
    up = force.mean(axis=0) / np.linalg.norm(force.mean(axis=0))
    left = np.cross(up, [1.0, 0.0, 0.0])
    left = left / np.linalg.norm(left)
    return np.stack((force @ np.cross(left, up), force @ left), axis=1)


def _rms(x: FloatArray) -> float:
    return float(np.sqrt((x**2).mean()))


def _path(x: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())


def ellipse_area(x: FloatArray) -> float:
    """Return the area of the ellipse that holds 95 % of points (N, 2)."""
    from scipy.special import fdtri

    return float(2.0 * np.pi * fdtri(2, len(x) - 2, 0.95) * np.sqrt(np.linalg.det(np.cov(x.T))))


def frequencies(x: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Return mean and median frequency of the power of all columns of x (N, C), Hz."""
    power = (np.abs(np.fft.rfft((x - x.mean(axis=0)) * np.hanning(len(x))[:, None], axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(len(x), 1.0 / rate_hz)
    use = (frequency >= LOWEST_HZ) & (frequency <= CUTOFF_HZ)
    power, frequency = power[use], frequency[use]
    total = np.cumsum(power)
    return float((frequency * power).sum() / total[-1]), float(np.interp(0.5 * total[-1], total, frequency))
