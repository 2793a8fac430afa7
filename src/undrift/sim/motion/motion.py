"""Motion: what an ideal sensor would feel, sample by sample, and the orientation that goes with it.

::

    rate_b   angular rate of b against inertial space, seen in b (Earth rate in it only where a motion puts it there)
    force_b  specific force R_nb^T (p'' + g z), seen in b: at rest the axis that points up reads +g

Both are closed-form values at the instant of the sample: nothing is differentiated numerically. Where a motion was recorded
and the cameras lost the body, it is unknown: NaN, and ``valid`` 0.
"""

from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.session import Still, Turn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """True motion of a device.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z.
    rate_b : array, shape (N, 3)
        Angular rate at the sample, rad/s.
    mean_rate_b : array, shape (N, 3)
        Rotation vector of the step from the sample before, over its duration, rad/s: what a gyroscope reads that
        averages between samples.
    force_b : array, shape (N, 3)
        Specific force at the sample, m/s2.
    gravity_m_s2 : float
        Gravity in it, m/s2.
    stills : tuple of Still
        Where the device stood still, to the sample.
    turns : tuple of Turn
        Where it turned in a way the bench knows.
    moving : array, shape (N,)
        1 where the device moved, else 0.
    angular_acceleration_b : array, shape (N, 3), or None
        Change of the angular rate, rad/s2; None where a motion does not tell.
    valid : array, shape (N,)
        1 where the motion is known, else 0; all 1 unless stated.
    """

    time: FloatArray
    q_nb: FloatArray
    rate_b: FloatArray
    mean_rate_b: FloatArray
    force_b: FloatArray
    gravity_m_s2: float
    stills: tuple[Still, ...] = ()
    turns: tuple[Turn, ...] = ()
    moving: FloatArray
    angular_acceleration_b: FloatArray | None = None
    valid: FloatArray = field(default_factory=lambda: np.ones(0))

    def __post_init__(self) -> None:
        n = len(self.time)
        widths = {"time": None, "q_nb": 4, "rate_b": 3, "mean_rate_b": 3, "force_b": 3, "moving": None, "valid": None}
        if len(self.valid) == 0:
            object.__setattr__(self, "valid", np.ones(n))
        if self.angular_acceleration_b is not None:
            widths["angular_acceleration_b"] = 3
        for name, width in widths.items():
            shape = (n,) if width is None else (n, width)
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Motion.{name}"))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


def mean_rate(time: FloatArray, q_nb: FloatArray, first: FloatArray) -> FloatArray:
    """Return the rotation vector of each step over its duration.

    ``w[k] = log(conj(q[k-1]) q[k]) / (t[k] - t[k-1])``, exact for any motion: turning by w[k] for one step leads from
    one orientation to the next.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z; less than half a turn a step.
    first : array, shape (3,)
        Value of the first sample, which has no step before it, rad/s.

    Returns
    -------
    array, shape (N, 3)
        rad/s, frame b.
    """
    step = quaternion_product(quaternion_conjugate(q_nb[:-1]), q_nb[1:])
    step = np.where(step[:, :1] < 0.0, -step, step)
    sine = np.linalg.norm(step[:, 1:], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = np.where(sine > 0.0, 2.0 * np.arctan2(sine, step[:, 0]) / sine, 2.0)
    rates = step[:, 1:] * (stretch / np.diff(time))[:, None]
    return np.vstack((first[None, :], rates))
