"""Worn: what a sensor on skin does while the bone below it moves: soft tissue that rings, impacts, vibration.

The sensor is a mass on a damped spring, outward of the bone along n (at L5 backward, -x). Its mass lags behind the bone, whose
acceleration is a and angular acceleration alpha, both in b, w = 2 pi f::

    phi'' + 2 z w phi' + w^2 phi = -alpha - w^2 c (n x a)     rotation against the bone; c its size below resonance, rad per m/s2
    d''   + 2 z w d'   + w^2 d   = -a                         displacement, of which accelerometers feel d''
    q_s = q_nb (x) exp(phi)      w_s = R(phi)^T w_b + phi'      f_s = R(phi)^T (f_b + d'')

The pitch of the bone stays the truth: phi is an error, part of which is faster than the body and can be filtered. An impact is a
pulse of upward acceleration, a raised cosine, whenever seat or foot takes load. Vibration turns the sensor about the axis of the
pitch by a sinusoid, at rest too; above half the sampling rate it is read as a slower one.

All is made on a grid fine enough for it (``FINE_HZ``); a device's low-pass and converter follow there.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Protocol

import numpy as np
from annotated_types import Ge, Gt, Lt

from undrift.arrays import FloatArray
from undrift.base.codec import Key, stored
from undrift.frames import cross, quaternion_conjugate, quaternion_of, quaternion_product, rotate
from undrift.sim.motion.motion import Motion, mean_rate, wave
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

FINE_HZ = 800.0  # samples of the simulated motion
OUTWARD_B = np.array([-1.0, 0.0, 0.0])  # from L5 to the sensor on its skin


@stored()  # of [study.trial]
@dataclass(frozen=True, slots=True, kw_only=True)
class WornErrors:
    """What wearing does to a sensor; an effect of size 0 is off."""

    # Rotation of the sensor by an acceleration of the bone across its skin, below resonance, rad per m/s2
    tissue: Annotated[float, Ge(0.0), Key("tissue_deg_per_m_s2", unit=RADIAN_PER_DEGREE)] = 0.0
    tissue_hz: Annotated[float, Gt(0.0), Lt(FINE_HZ / 8.0)] = 12.5  # Resonance of the sensor on its skin, Hz
    tissue_damping: Annotated[float, Gt(0.0)] = 0.17  # Of it, relative to critical damping
    # Largest upward acceleration of an impact, as the seat is left and a foot comes down, m/s2
    impact: Annotated[float, Ge(0.0), Key("impact_g", unit=STANDARD_GRAVITY)] = 0.0
    impact_s: Annotated[float, Gt(0.0), Key("impact_ms", unit=0.001)] = 0.03  # Its length, s
    # Largest rate of a vibration about the axis of the pitch, rad/s
    vibration: Annotated[float, Ge(0.0), Key("vibration_dps", unit=RADIAN_PER_DEGREE)] = 0.0
    vibration_hz: Annotated[float, Gt(0.0), Lt(FINE_HZ / 4.0)] = 80.0  # Its frequency, Hz

    @property
    def on(self) -> bool:
        """Whether anything differs from a sensor that is fixed to the bone."""
        return bool(self.tissue or self.impact or self.vibration)


FIXED = WornErrors()  # to the bone
# At the low back. Measured by benchmarks/soft_tissue.py on one person who sits down heavily (worn_lowback): resonance, damping and
# size; an impact of 0.16 g is the 95th percentile of that person's steps and rises. No vibration was found there.
AT_L5 = WornErrors(tissue=0.12 * RADIAN_PER_DEGREE, impact=0.16 * STANDARD_GRAVITY)


class Performed(Protocol):
    """A task, drawn or recorded."""

    @property
    def duration_s(self) -> float:
        """Length, s."""

    @property
    def contacts_s(self) -> tuple[float, ...]:
        """When seat or foot takes load or leaves, s."""

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants."""


def wear_on_skin(performed: Performed, errors: WornErrors, rng: np.random.Generator, gravity_m_s2: float) -> Motion:
    """Return the motion of a sensor that is worn in a task, at ``FINE_HZ``."""
    time = np.arange(round(performed.duration_s * FINE_HZ)) / FINE_HZ
    bone, phase = performed.at(time, gravity_m_s2), float(rng.uniform(0.0, 2.0 * np.pi))
    up = rotate(quaternion_conjugate(bone.q_nb), np.array([0.0, 0.0, 1.0]))
    since = (time[:, None] - np.array(performed.contacts_s)) / errors.impact_s
    pulses = np.where((since > 0.0) & (since < 1.0), 0.5 - 0.5 * np.cos(2.0 * np.pi * since), 0.0).sum(axis=1)
    force = bone.force_b + errors.impact * pulses[:, None] * up
    turned: FloatArray = np.zeros((3, len(time), 3))  # phi and its first two derivatives
    shift: FloatArray = np.zeros(3)  # d''
    if errors.tissue:
        push, w = np.nan_to_num(force - gravity_m_s2 * up), 2.0 * np.pi * errors.tissue_hz
        drive = w * w * errors.tissue * cross(OUTWARD_B, push)
        if bone.angular_acceleration_b is not None:
            drive = drive + np.nan_to_num(bone.angular_acceleration_b)
        turned, shift = _ringing(-drive, errors), _ringing(-push, errors)[2]
    if errors.vibration:
        size = errors.vibration / (2.0 * np.pi * errors.vibration_hz)
        turned[:, :, 1] += wave(size, errors.vibration_hz, phase, 0.0, time[-1]).at(time)
    angle, rate, spin_up = turned
    leant = quaternion_of(angle)
    back, q_nb = quaternion_conjugate(leant), quaternion_product(bone.q_nb, leant)
    rate_b = rotate(back, bone.rate_b) + rate
    return replace(
        bone,
        q_nb=q_nb,
        rate_b=rate_b,
        mean_rate_b=mean_rate(time, q_nb, rate_b[0]),
        force_b=rotate(back, force + shift),
        angular_acceleration_b=None
        if bone.angular_acceleration_b is None
        else rotate(back, bone.angular_acceleration_b) + spin_up,
    )


def _ringing(drive: FloatArray, errors: WornErrors) -> FloatArray:
    """Return x, x' and x'', (3, N, 3), of x'' + 2 z w x' + w^2 x = drive (N, 3), straight between samples; at rest before."""
    from scipy.signal import cont2discrete, lfilter, ss2tf

    w, z = 2.0 * np.pi * errors.tissue_hz, errors.tissue_damping
    spring = (np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1)))
    rows, a = ss2tf(*cont2discrete(spring, 1.0 / FINE_HZ, method="foh")[:4])
    x, speed = (np.asarray(lfilter(b, a, drive, axis=0)) for b in rows)
    return np.stack((x, speed, drive - 2.0 * z * w * speed - w * w * x))
