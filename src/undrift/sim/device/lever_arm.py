"""Lever arm: an accelerometer away from the body's origin feels the rotation, each sensor at its own place.

``d_i = alpha x r_i + omega x (omega x r_i)``, to be added to the specific force at sensor i [1]_.

References
----------
.. [1] any text on rigid-body kinematics: the acceleration of a point fixed in a rotating body.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeverArm:
    """Where the sensors sit.

    Parameters
    ----------
    arms : array, shape (3, 3)
        Position of each sensor from the body's origin, one a row, m, frame b.
    """

    arms: FloatArray = quantity("m", (3, 3))

    def __post_init__(self) -> None:
        settle(self)


def lever_arm_force(effect: LeverArm, scene: Scene) -> FloatArray:
    """Return what each sensor feels beside the force at the origin.

    Parameters
    ----------
    effect : LeverArm
        Positions of the sensors.
    scene : Scene
        With rate and angular acceleration.

    Returns
    -------
    array, shape (N, 3, 3)
        m/s2: sample, sensor, axis of b.

    Raises
    ------
    InputError
        A motion without angular acceleration.
    """
    if scene.angular_acceleration_b is None:
        raise InputError(
            "lever arm: wanted a motion with angular acceleration, got one without; take it from poses or a task, or "
            "switch the lever arm off"
        )
    rate, arm = scene.rate_b[:, None, :], effect.arms[None, :, :]
    felt: FloatArray = np.cross(scene.angular_acceleration_b[:, None, :], arm) + np.cross(rate, np.cross(rate, arm))
    return felt
