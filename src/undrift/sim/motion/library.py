"""Library of tasks: what subjects do in a test trial, each drawn anew.

``sit_to_stand``   trunk leans forward through a via-point and comes up again, then sways; up to 90 deg/s
``step``           rising a step: lean, shift of weight, rise, the knock of each foot; up to 45 deg/s
``posturography``  quiet stance on foam, eyes closed: a degree of sway for 50 s; up to 5 deg/s
``free``           vigorous turns about all axes for a minute: what a fit against optics wants

The three bounds are those that the note's Table 1 calibrates for: a performance beyond them is drawn again. docs/motions.md
lists model, numbers and their sources.
"""

import math
from typing import Literal, get_args

import numpy as np

from undrift.errors import InputError
from undrift.sim.motion.course import Burst, Part, Step, ViaPoint, Wave
from undrift.sim.motion.subject import TYPICAL_AGE, Performance, Subject
from undrift.sim.motion.sway import Balance, draw_sway
from undrift.sim.motion.task import Task
from undrift.sim.streams import draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

TaskName = Literal["sit_to_stand", "posturography", "free", "step"]
DEGREE = RADIAN_PER_DEGREE
POSTUROGRAPHY_S = 50.0
LOUDEST = (
    1.385  # peak of the acceleration's spectrum over the sine's frequency, where the envelope peaks at half a period
)


def draw_task(name: TaskName, *, rng: np.random.Generator, subject: Subject | None = None, rest_s: float = 6.0) -> Task:
    """Draw one performance of a task.

    Parameters
    ----------
    name : str
        sit_to_stand, posturography, free or step.
    rng : Generator
        Draws the performance.
    subject : Subject, optional
        Who performs it; somebody unknown where not given. ``free`` is the same for all.
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
    if name not in get_args(TaskName):
        raise InputError(f"task: wanted one of {', '.join(get_args(TaskName))}, got '{name}'; name one of them")
    who = Performance(draw_streams(rng).of(name), subject)
    if name == "free":
        return _free(who.draw, rest_s)
    bound, perform = {
        "sit_to_stand": (90.0 * DEGREE, _sit_to_stand),
        "step": (45.0 * DEGREE, _step),
        "posturography": (5.0 * DEGREE, _posturography),
    }[name]
    while True:
        task = perform(who, rest_s)
        if _peak_rate(task) <= bound:
            return task


def _peak_rate(task: Task) -> float:
    time = np.arange(task.moving_s[0], task.moving_s[1], 0.02)
    return float(np.abs(task.at(time, STANDARD_GRAVITY).rate_b).max())


def _slowness(who: Performance) -> float:
    return 1.0 + 0.003 * (who.age_years - TYPICAL_AGE)  # [assumed] 3 % in ten years


def _sit_to_stand(who: Performance, rest_s: float) -> Task:
    duration = who.number("sit_to_stand duration", 2.3, 0.5, 1.5, 4.0) * _slowness(who)
    flexion = duration * who.number("sit_to_stand peak time", 0.40, 0.05, 0.3, 0.5)
    lean = who.number("sit_to_stand lean", 32.0, 7.0, 15.0, 50.0) * DEGREE
    sitting = who.number("sit_to_stand first pitch", 5.0, 5.0, -10.0, 20.0) * DEGREE
    standing = who.number("sit_to_stand last pitch", 3.0, 3.0, -6.0, 12.0) * DEGREE
    settle = who.draw.uniform(0.5, 1.5)
    turn, stop = rest_s + flexion, rest_s + duration + settle
    off = turn - 0.1  # the seat is left a little before the trunk turns back
    return Task(
        name="sit_to_stand",
        duration_s=stop + rest_s,
        moving_s=(rest_s, stop),
        roll=(_there_and_back(who, "sit_to_stand roll", rest_s, duration), *_settling(who, 0.4, turn, stop)),
        pitch=(
            Step(-2.0, 1.0, sitting),
            ViaPoint(rest_s, flexion, duration - flexion, lean, standing - sitting - lean),
            *_settling(who, 0.5, turn, stop),
        ),
        yaw=(_there_and_back(who, "sit_to_stand yaw", rest_s, duration), *_settling(who, 0.3, turn, stop)),
        forward=(Step(rest_s, 0.52 * duration, 0.18 * who.height),),
        up=(Step(off, 0.42 * duration, 0.21 * who.height),),
    )


def _there_and_back(who: Performance, name: str, start_s: float, duration_s: float) -> Part:
    size = who.number(name, 0.0, 1.5, -3.0, 3.0) * DEGREE
    return ViaPoint(start_s, 0.45 * duration_s, 0.55 * duration_s, size, -size)


def _settling(who: Performance, amplitude_deg: float, start_s: float, stop_s: float) -> tuple[Wave, ...]:
    return _waves(who.draw, 2, 0.5 * amplitude_deg * DEGREE, (0.4, 1.2), (start_s, stop_s), 0.45 * (stop_s - start_s))


def _step(who: Performance, rest_s: float) -> Task:
    duration = who.number("step duration", 2.0, 0.4, 1.2, 3.2) * _slowness(who)
    lean = who.number("step lean", 12.0, 4.0, 3.0, 25.0) * DEGREE
    shift = who.number("step roll", 5.0, 2.0, 1.0, 10.0) * DEGREE * who.draw.choice((-1.0, 1.0))
    first, second = rest_s + 0.35 * duration, rest_s + 0.95 * duration  # the two feet come down
    stop = rest_s + duration + 1.0
    side = 0.03 * np.sign(shift)
    return Task(
        name="step",
        duration_s=stop + rest_s,
        moving_s=(rest_s, stop),
        roll=(
            ViaPoint(rest_s, 0.22 * duration, 0.28 * duration, shift, -shift),
            ViaPoint(rest_s + 0.5 * duration, 0.22 * duration, 0.28 * duration, -0.7 * shift, 0.7 * shift),
        ),
        pitch=(
            Step(-2.0, 1.0, who.number("step pitch", 3.0, 3.0, -6.0, 12.0) * DEGREE),
            ViaPoint(rest_s, 0.4 * duration, 0.6 * duration, lean, -lean),
            *_settling(who, 0.5, rest_s + 0.5 * duration, stop),
        ),
        yaw=(_there_and_back(who, "step yaw", rest_s, duration),),
        forward=(Step(rest_s + 0.1 * duration, 0.8 * duration, 0.28), *_knocks(who, 0.4, (first, second))),
        left=(
            ViaPoint(rest_s, 0.25 * duration, 0.25 * duration, -side, side),
            ViaPoint(rest_s + 0.5 * duration, 0.25 * duration, 0.25 * duration, side, -side),
        ),
        up=(Step(first, 0.5 * duration, 0.17), *_knocks(who, 1.0, (first, second))),
    )


def _knocks(who: Performance, share: float, instants_s: tuple[float, ...]) -> tuple[Burst, ...]:
    return tuple(_knock(share * who.draw.uniform(1.0, 2.0), who.draw.uniform(5.0, 15.0), at) for at in instants_s)


def _knock(acceleration: float, frequency_hz: float, start_s: float) -> Burst:
    """Return a burst of a given peak acceleration, m/s2, whose acceleration is loudest at a given frequency."""
    peak_s = 0.5 * LOUDEST / frequency_hz
    unit = Burst(1.0, frequency_hz / LOUDEST, 0.0, peak_s)
    largest = float(np.abs(unit.at(np.linspace(0.0, 8.0 * peak_s, 2001))[2]).max())
    return Burst(acceleration / largest, frequency_hz / LOUDEST, start_s, peak_s)


def _posturography(who: Performance, rest_s: float) -> Task:
    span = (rest_s, rest_s + POSTUROGRAPHY_S)
    arm = 0.54 * who.height  # [assumed] L5 at 0.58 and ankles at 0.04 of the height; the body's centre is there too
    older = 1.0 + 0.01 * (who.age_years - TYPICAL_AGE)  # [assumed] sway rises by a per cent a year
    balance = Balance(centre_height=arm, kp=who.number("stance stiffness", 1.45, 0.08, 1.25, 1.6))
    pitch = who.number("sway pitch", 0.9, 0.3, 0.3, 1.8) * older * DEGREE
    roll = who.number("sway roll", 0.6, 0.2, 0.2, 1.2) * older * DEGREE
    yaw = who.number("sway yaw", 0.4, 0.1, 0.1, 0.8) * older * DEGREE
    return Task(
        name="posturography",
        duration_s=span[1] + rest_s,
        moving_s=span,
        roll=(draw_sway(who.draw, balance, rms=roll, span=span),),
        pitch=(
            Step(-2.0, 1.0, who.number("stance pitch", 3.0, 2.0, -3.0, 9.0) * DEGREE),
            draw_sway(who.draw, balance, rms=pitch, span=span),
        ),
        yaw=(draw_sway(who.draw, balance, rms=yaw, span=span),),
        arm_b=(0.0, 0.0, arm),
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
    draw: np.random.Generator,
    count: int,
    amplitude: float,
    band_hz: tuple[float, float],
    span: tuple[float, float],
    swell_s: float = 1.0,
) -> tuple[Wave, ...]:
    frequencies = draw.uniform(*band_hz, count)
    amplitudes = amplitude * draw.uniform(0.5, 1.5, count)
    phases = draw.uniform(0.0, 2.0 * math.pi, count)
    return tuple(
        Wave(float(a), float(f), float(p), *span, swell_s)
        for a, f, p in zip(amplitudes, frequencies, phases, strict=True)
    )
