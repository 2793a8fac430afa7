"""Optics: poses of the device as a camera system reports them, with noise, gaps and a clock of their own."""

from dataclasses import dataclass

import numpy as np

from undrift.frames import quaternion_product
from undrift.record import Reference
from undrift.sim.motion.task import Task
from undrift.sim.streams import draw_streams


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticsSettings:
    """What the cameras do to a pose.

    Parameters
    ----------
    sample_rate_hz : float
        Poses per second.
    delay_s : float
        A pose stamped t was taken at t - delay_s.
    angle_sd : float
        Noise about each body axis, rad.
    position_sd : float
        Noise of each coordinate, m.
    gaps : int
        Number of gaps while the device moves.
    gap_s : float
        Length of each, s.
    mount_sd : float
        Misalignment of the marker body against the case about each axis, rad.
    """

    sample_rate_hz: float = 100.0
    delay_s: float = 0.0
    angle_sd: float = 3e-4
    position_sd: float = 2e-4
    gaps: int = 2
    gap_s: float = 0.2
    mount_sd: float = 0.0


def see(task: Task, *, rng: np.random.Generator, settings: OpticsSettings | None = None) -> Reference:
    """Return what the cameras saw of a task.

    Parameters
    ----------
    task : Task
        The true motion.
    rng : Generator
        Draws noise, gaps and mounting, each from a stream of its own.
    settings : OpticsSettings, optional
        What the cameras do.

    Returns
    -------
    Reference
        Poses with gaps as NaN; ``moving`` marks the task.
    """
    chosen = settings or OpticsSettings()
    streams = draw_streams(rng)
    time = np.arange(round(task.duration_s * chosen.sample_rate_hz)) / chosen.sample_rate_hz
    motion = task.at(time - chosen.delay_s, 9.8)
    mount = _small_turn(streams.of("mount").normal(0.0, chosen.mount_sd, 3))
    noise = _small_turn(streams.of("angle").normal(0.0, chosen.angle_sd, (len(time), 3)))
    q = quaternion_product(quaternion_product(motion.q_nb, mount), noise)
    position = task.position(time - chosen.delay_s)
    position = position + streams.of("position").normal(0.0, chosen.position_sd, position.shape)
    starts = streams.of("gap").uniform(task.moving_s[0], task.moving_s[1] - chosen.gap_s, chosen.gaps)
    hidden = ((time >= starts[:, None]) & (time < starts[:, None] + chosen.gap_s)).any(axis=0)
    q[hidden] = np.nan
    position[hidden] = np.nan
    return Reference(time=time, q_nb=q, position=position, moving=motion.moving, name=f"simulated optics, {task.name}")


def _small_turn(rotation_vector: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    half = 0.5 * angle
    sinc = np.where(angle > 0.0, np.sin(half) / np.where(angle > 0.0, angle, 1.0), 0.5)
    return np.concatenate((np.cos(half), sinc * rotation_vector), axis=-1)
