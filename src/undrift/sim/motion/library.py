"""Library of tasks: what subjects do in a test trial, each drawn anew.

``sit_to_stand``   trunk leans forward and comes up again, then sways; peak rates up to about 90 deg/s
``posturography``  quiet stance on foam: a degree of sway for 50 s
``free``           vigorous turns about all axes for a minute: what a fit against optics wants
"""

import math
from typing import Literal, get_args

import numpy as np

from undrift.errors import InputError
from undrift.sim.motion.task import Step, Task, Wave
from undrift.sim.streams import draw_streams
from undrift.units import RADIAN_PER_DEGREE

TaskName = Literal["sit_to_stand", "posturography", "free"]
DEGREE = RADIAN_PER_DEGREE


def draw_task(name: TaskName, *, rng: np.random.Generator, rest_s: float = 6.0) -> Task:
    """Draw one performance of a task.

    Parameters
    ----------
    name : str
        sit_to_stand, posturography or free.
    rng : Generator
        Draws the subject's performance.
    rest_s : float
        Rest before and after the motion, s.

    Returns
    -------
    Task
        At rest at both ends.

    Raises
    ------
    InputError
        A task that is not one.
    """
    draw = draw_streams(rng).of(name)
    if name == "sit_to_stand":
        return _sit_to_stand(draw, rest_s)
    if name == "posturography":
        return _posturography(draw, rest_s)
    if name == "free":
        return _free(draw, rest_s)
    raise InputError(f"task: wanted one of {', '.join(get_args(TaskName))}, got '{name}'; name one of them")


def _sit_to_stand(draw: np.random.Generator, rest_s: float) -> Task:
    duration = float(np.clip(draw.normal(2.3, 0.5), 1.5, 4.0))
    flexion = duration * float(np.clip(draw.normal(0.4, 0.05), 0.3, 0.5))
    lean = float(np.clip(draw.normal(32.0, 7.0), 15.0, 45.0)) * DEGREE
    start_pitch, end_pitch = draw.normal(5.0, 5.0) * DEGREE, draw.normal(3.0, 3.0) * DEGREE
    peak = rest_s + flexion
    stop = rest_s + duration + 4.0
    sway = {
        axis: _waves(draw, 3, amplitude * DEGREE, (0.2, 1.2), (rest_s + 0.5 * duration, stop))
        for axis, amplitude in (("roll", 0.5), ("pitch", 0.5), ("yaw", 0.5))
    }
    return Task(
        name="sit_to_stand",
        duration_s=stop + rest_s,
        moving_s=(rest_s, stop),
        roll=sway["roll"],
        pitch=(
            Step(-2.0, 1.0, start_pitch),
            Step(rest_s, flexion, lean),
            Step(peak, duration - flexion, end_pitch - start_pitch - lean),
            *sway["pitch"],
        ),
        yaw=sway["yaw"],
        forward=(Step(rest_s, duration, 0.30),),
        up=(Step(peak - 0.1, duration - flexion, 0.35),),
    )


def _posturography(draw: np.random.Generator, rest_s: float) -> Task:
    span = (rest_s, rest_s + 50.0)
    return Task(
        name="posturography",
        duration_s=span[1] + rest_s,
        moving_s=span,
        roll=_waves(draw, 8, 0.25 * DEGREE, (0.1, 0.45), span),
        pitch=(Step(-2.0, 1.0, draw.normal(3.0, 2.0) * DEGREE), *_waves(draw, 8, 0.36 * DEGREE, (0.1, 0.45), span)),
        yaw=_waves(draw, 4, 0.2 * DEGREE, (0.1, 0.5), span),
        forward=_waves(draw, 4, 0.008, (0.1, 0.6), span),
        left=_waves(draw, 4, 0.005, (0.1, 0.6), span),
    )


def _free(draw: np.random.Generator, rest_s: float) -> Task:
    span = (rest_s, rest_s + 60.0)
    return Task(
        name="free",
        duration_s=span[1] + rest_s,
        moving_s=span,
        roll=_waves(draw, 6, 12.0 * DEGREE, (0.1, 0.9), span),
        pitch=_waves(draw, 6, 12.0 * DEGREE, (0.1, 0.9), span),
        yaw=_waves(draw, 6, 15.0 * DEGREE, (0.1, 0.9), span),
        forward=_waves(draw, 4, 0.05, (0.2, 0.9), span),
        left=_waves(draw, 4, 0.05, (0.2, 0.9), span),
        up=_waves(draw, 4, 0.03, (0.2, 0.9), span),
    )


def _waves(
    draw: np.random.Generator, count: int, amplitude: float, band_hz: tuple[float, float], span: tuple[float, float]
) -> tuple[Wave, ...]:
    frequencies = draw.uniform(*band_hz, count)
    amplitudes = amplitude * draw.uniform(0.5, 1.5, count)
    phases = draw.uniform(0.0, 2.0 * math.pi, count)
    return tuple(
        Wave(float(a), float(f), float(p), *span) for a, f, p in zip(amplitudes, frequencies, phases, strict=True)
    )
