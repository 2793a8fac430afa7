"""Scene: what surrounds the sensors while they are read: the motion on an even grid, the temperature, the age."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.motion.motion import Motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """What every effect may look at, N samples.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    step_s : float
        Mean step of time, s.
    temp_c : array, shape (N,)
        Temperature of the board, degC.
    warmth : array, shape (N,)
        The same above the device's reference temperature, K.
    age_s : array, shape (N,)
        Time since power-on, s.
    rate_b : array, shape (N, 3)
        Angular rate at the sample, rad/s.
    angular_acceleration_b : array, shape (N, 3), or None
        rad/s2.
    force_b : array, shape (N, 3)
        Specific force at the body's origin, m/s2.
    """

    time: FloatArray
    step_s: float
    temp_c: FloatArray
    warmth: FloatArray
    age_s: FloatArray
    rate_b: FloatArray
    angular_acceleration_b: FloatArray | None
    force_b: FloatArray


def scene_of(motion: Motion, temp_c: FloatArray, reference_temp_c: float, power_on_s: float) -> Scene:
    """Return the scene of a motion.

    Parameters
    ----------
    motion : Motion
        N samples.
    temp_c : array, shape (N,)
        Temperature of the board, degC.
    reference_temp_c : float
        Of the device, degC.
    power_on_s : float
        Time since power-on at the first sample, s.

    Returns
    -------
    Scene
        Shares the motion's arrays.
    """
    time = motion.time
    return Scene(
        time=time,
        step_s=float((time[-1] - time[0]) / (len(time) - 1)),
        temp_c=temp_c,
        warmth=temp_c - reference_temp_c,
        age_s=time - time[0] + power_on_s,
        rate_b=motion.rate_b,
        angular_acceleration_b=motion.angular_acceleration_b,
        force_b=motion.force_b,
    )


def check_even(scene: Scene, what: str) -> None:
    """Raise unless the samples are evenly spaced.

    Parameters
    ----------
    scene : Scene
        With its time.
    what : str
        The effect that needs it.

    Raises
    ------
    InputError
        A step that differs from the mean by more than a part in a thousand.
    """
    steps = np.diff(scene.time)
    if np.abs(steps - scene.step_s).max() > 1e-3 * scene.step_s:
        raise InputError(
            f"{what}: wanted evenly spaced samples of the motion, got steps from {steps.min():.6g} to {steps.max():.6g} s; "
            "make the motion on an even grid"
        )
