"""Rivals: the calibration motions that the note weighs against its own and leaves.

``trolley``         a cart on a rail swings to and fro, each axis along the rail in turn; the rail shakes it
``inclined_plane``  stills on a plane tilted in steps through half a turn about each axis
``piston``          a servohydraulic piston lifts and lowers it by a sinusoid, each axis upright in turn
``robot_arm``       an arm turns and carries it at random about and along all axes, between two stills
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_product, rotate
from undrift.session import Still
from undrift.sim.motion.course import Course, Wave
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.script import Path, Script, facing, turn_quaternion
from undrift.sim.motion.sway import draw_lines
from undrift.sim.motion.task import Task
from undrift.sim.streams import Streams, draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

RivalKind = Literal["trolley", "inclined_plane", "piston", "robot_arm"]
RAIL_SHAKE_HZ = (8.0, 25.0)  # [assumed] wheels on a rail
ROBOT_TURN_HZ, ROBOT_MOVE_HZ = (0.02, 0.2), (0.05, 0.6)  # [assumed]


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalSettings:
    """How a rival procedure is performed. All defaults are choices: the note gives none.

    Parameters
    ----------
    sample_rate_hz : float
        Samples per second.
    gravity_m_s2 : float
        Local gravity, m/s2.
    still_s, move_s : float
        Length of each still and of each move between mountings, s.
    run_s : float
        Length of each run at one frequency, and of the robot's motion over six, s.
    tilt_sd : float
        Error of each mounting about each axis, rad.
    trolley_hz : tuple of float
        Frequencies of the trolley's runs, Hz.
    trolley_stroke : float
        Amplitude of its sinusoid, m.
    shake : float
        Displacement rms by which an uneven rail shakes it upwards and sideways, m.
    piston_hz : tuple of float
        Frequencies of the piston's runs, Hz.
    piston_stroke : float
        Amplitude of its sinusoid, m.
    plane_angles : tuple of float
        Inclinations, rad.
    robot_turn : (float, float, float)
        rms of roll, pitch and yaw, rad.
    robot_move : float
        rms along each axis, m.
    """

    sample_rate_hz: float = 100.0
    gravity_m_s2: float = STANDARD_GRAVITY
    still_s: float = 4.0
    move_s: float = 2.0
    run_s: float = 10.0
    tilt_sd: float = 0.0
    trolley_hz: tuple[float, ...] = (0.5, 0.8)
    trolley_stroke: float = 0.15
    shake: float = 2e-5
    piston_hz: tuple[float, ...] = (1.0, 2.0, 4.0)
    piston_stroke: float = 0.02
    plane_angles: tuple[float, ...] = tuple(angle * RADIAN_PER_DEGREE for angle in range(-90, 91, 15))
    robot_turn: tuple[float, float, float] = (1.0, 0.6, 1.5)
    robot_move: float = 0.12


def rival_motion(kind: RivalKind, *, rng: np.random.Generator, settings: RivalSettings | None = None) -> Motion:
    """Return the true motion of a rival procedure.

    Parameters
    ----------
    kind : str
        trolley, inclined_plane, piston or robot_arm.
    rng : Generator
        Draws mounting errors, the rail's unevenness and the robot's path, each from a stream of its own.
    settings : RivalSettings, optional
        How it is performed.

    Returns
    -------
    Motion
        Exact, stills labelled.

    Raises
    ------
    InputError
        A kind that is not one.
    """
    if kind not in get_args(RivalKind):
        raise InputError(f"rival: wanted one of {', '.join(get_args(RivalKind))}, got '{kind}'; name one of them")
    chosen = settings or RivalSettings()
    streams = draw_streams(rng)
    if kind == "robot_arm":
        return _robot_arm(chosen, streams)
    script = Script(chosen.sample_rate_hz, np.array([0.0, 0.0, 1.0]))
    {"trolley": _trolley, "inclined_plane": _inclined_plane, "piston": _piston}[kind](script, chosen, streams)
    return script.motion(chosen.gravity_m_s2, lever_arm_b=np.zeros(3), earth_rate_n=np.zeros(3))


def _trolley(script: Script, settings: RivalSettings, streams: Streams) -> None:
    tilts, rail = streams.of("tilt"), streams.of("rail")
    for axis in range(3):
        _mount(script, settings, np.eye(3)[(axis + 1) % 3], np.eye(3)[axis], tilts)
        for frequency_hz in settings.trolley_hz:
            swing = (Wave(settings.trolley_stroke, frequency_hz, 0.0, 0.0, settings.run_s, 2.0),)
            script.slide((swing, _shake(settings, rail), _shake(settings, rail)), settings.run_s)
            script.still(settings.still_s)


def _shake(settings: RivalSettings, rail: np.random.Generator) -> Course:
    if settings.shake == 0.0:
        return ()
    span = (0.0, settings.run_s)
    return (draw_lines(rail, lambda f: f**-4.0, band_hz=RAIL_SHAKE_HZ, rms=settings.shake, span=span),)


def _piston(script: Script, settings: RivalSettings, streams: Streams) -> None:
    tilts = streams.of("tilt")
    for axis in range(3):
        _mount(script, settings, np.eye(3)[axis], np.eye(3)[(axis + 1) % 3], tilts)
        for frequency_hz in settings.piston_hz:
            lift = (Wave(settings.piston_stroke, frequency_hz, 0.0, 0.0, settings.run_s, 2.0),)
            path: Path = ((), (), lift)
            script.slide(path, settings.run_s)
            script.still(settings.still_s)


def _inclined_plane(script: Script, settings: RivalSettings, streams: Streams) -> None:
    tilts = streams.of("tilt")
    for axis in range(3):  # the plane turns about this axis of the case
        across, up = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for angle in settings.plane_angles:
            _mount(script, settings, math.cos(angle) * up + math.sin(angle) * across, np.eye(3)[axis], tilts)


def _mount(
    script: Script, settings: RivalSettings, up_b: FloatArray, forward_b: FloatArray, tilts: np.random.Generator
) -> None:
    """Turn the case until one direction points up and another, across it, along x; then wait."""
    level = facing(script.q, up_b + np.cross(tilts.normal(0.0, settings.tilt_sd, 3), up_b))
    x, y, _ = rotate(level, forward_b)
    q = quaternion_product(turn_quaternion(np.array([0.0, 0.0, 1.0]), -np.arctan2(y, x)), level)
    if script.samples:
        script.turn_to(q, settings.move_s)
    else:
        script.q = q
    script.still(settings.still_s)


def _robot_arm(settings: RivalSettings, streams: Streams) -> Motion:
    stop = settings.still_s + 6.0 * settings.run_s
    span = (settings.still_s, stop)
    turn, move = streams.of("robot turn"), streams.of("robot move")
    roll, pitch, yaw = (
        (draw_lines(turn, np.ones_like, band_hz=ROBOT_TURN_HZ, rms=rms, span=span),) for rms in settings.robot_turn
    )
    forward, left, up = (
        (draw_lines(move, lambda f: f**-2.0, band_hz=ROBOT_MOVE_HZ, rms=settings.robot_move, span=span),)
        for _ in range(3)
    )
    task = Task(
        name="robot_arm",
        duration_s=stop + settings.still_s,
        moving_s=span,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        forward=forward,
        left=left,
        up=up,
    )
    time = np.arange(round(task.duration_s * settings.sample_rate_hz)) / settings.sample_rate_hz
    motion = task.at(time, settings.gravity_m_s2)
    first, last = round(span[0] * settings.sample_rate_hz), round(span[1] * settings.sample_rate_hz)
    return replace(motion, stills=(Still(start=0, stop=first), Still(start=last + 1, stop=len(time))))
