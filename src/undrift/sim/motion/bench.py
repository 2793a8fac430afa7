"""Bench: the motions of a calibration session, as a person or a rate table makes them.

``six_face``      six stills, one face up each, off level by a small random tilt
``rate_table``    three mountings, each axis up in turn, steady rates both ways
``bench``         the two after each other: what the note asks for
``ferraris``      six stills and three turns by hand through a known angle
``multi_position`` a long still, then free poses with turns between: no equipment
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.earth import EARTH_RATE
from undrift.errors import InputError
from undrift.frames import quaternion_product
from undrift.session import FACES, Axis, Face
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.script import Script, facing, turn_quaternion, unit_vector
from undrift.sim.streams import Streams, draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

BenchKind = Literal["six_face", "rate_table", "bench", "ferraris", "multi_position"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
SIT_TO_STAND_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(10, 91, 5))  # the note's list, one way round


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSettings:
    """How a session is performed.

    Parameters
    ----------
    sample_rate_hz : float
        Samples per second.
    gravity_m_s2 : float
        Local gravity, m/s2.
    still_s : float
        Length of each still, s.
    first_still_s : float
        Length of the first still of a multi-position session, s.
    move_s : float
        Length of each move between stills and of each half hand turn, s.
    tilt_sd : float
        Levelling error of each face about each horizontal axis, rad.
    poses : int
        Free poses of a multi-position session.
    turn_rates : tuple of float
        Steady rates of the table, rad/s, positive; each is imposed both ways.
    ramp_s, dwell_s : float
        Run-up and steady part of each table rate, s.
    hand_angle : float
        Angle of a hand turn, rad.
    hand_tilt_sd : float
        Error of a hand turn's axis about each axis across it, rad.
    lever_arm_b : tuple of float
        Accelerometers from the turning axis, m.
    latitude_deg : float or None
        Where the bench stands, for the Earth rate; None leaves it out.
    """

    sample_rate_hz: float = 100.0
    gravity_m_s2: float = STANDARD_GRAVITY
    still_s: float = 6.0
    first_still_s: float = 20.0
    move_s: float = 2.0
    tilt_sd: float = 0.0
    poses: int = 24
    turn_rates: tuple[float, ...] = SIT_TO_STAND_RATES
    ramp_s: float = 0.5
    dwell_s: float = 3.0
    hand_angle: float = 2.0 * math.pi
    hand_tilt_sd: float = 0.0
    lever_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latitude_deg: float | None = None


def bench_motion(kind: BenchKind, *, rng: np.random.Generator, settings: BenchSettings | None = None) -> Motion:
    """Return the true motion of a calibration session.

    Parameters
    ----------
    kind : str
        six_face, rate_table, bench, ferraris or multi_position.
    rng : Generator
        Draws tilts, poses and the hand's errors, each from a stream of its own.
    settings : BenchSettings, optional
        How it is performed.

    Returns
    -------
    Motion
        Exact rate and specific force, stills and turns labelled.

    Raises
    ------
    InputError
        A kind that is not one.
    """
    if kind not in get_args(BenchKind):
        raise InputError(f"bench: wanted one of {', '.join(get_args(BenchKind))}, got '{kind}'; name one of them")
    chosen = settings or BenchSettings()
    streams = draw_streams(rng)
    script = Script(chosen.sample_rate_hz, np.array([0.0, 0.0, 1.0]))
    if kind == "multi_position":
        _multi_position(script, chosen, streams)
    if kind in ("six_face", "bench", "ferraris"):
        _six_faces(script, chosen, streams)
    if kind in ("rate_table", "bench"):
        _rate_table(script, chosen)
    if kind == "ferraris":
        _hand_turns(script, chosen, streams)
    return script.motion(
        chosen.gravity_m_s2, lever_arm_b=np.array(chosen.lever_arm_b), earth_rate_n=earth_rate(chosen.latitude_deg)
    )


def earth_rate(latitude_deg: float | None) -> FloatArray:
    """Return the rotation rate of the Earth in a level frame with y north and z up.

    Parameters
    ----------
    latitude_deg : float or None
        Geodetic latitude, deg; None for an Earth that does not turn.

    Returns
    -------
    array, shape (3,)
        rad/s, frame n.
    """
    if latitude_deg is None:
        return np.zeros(3)
    latitude = latitude_deg * RADIAN_PER_DEGREE
    return EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def _six_faces(script: Script, settings: BenchSettings, streams: Streams) -> None:
    tilts = streams.of("tilt").normal(0.0, settings.tilt_sd, (6, 3))
    for face, tilt in zip(FACES, tilts, strict=True):
        up = unit_vector(face)
        _lay(script, settings, up + np.cross(tilt, up), face)


def _lay(script: Script, settings: BenchSettings, up_b: FloatArray, face: Face | None) -> None:
    if script.samples:
        script.turn_to(facing(script.q, up_b), settings.move_s)
    else:
        script.q = facing(script.q, up_b)
    script.still(settings.first_still_s if face is None and not script.samples else settings.still_s, face)


def _rate_table(script: Script, settings: BenchSettings) -> None:
    faces: tuple[Face, ...] = ("+x", "+y", "+z")
    for axis, face in zip(AXES, faces, strict=True):
        _lay(script, settings, unit_vector(face), face)
        for turn_rate in settings.turn_rates:
            for signed in (turn_rate, -turn_rate):  # the way round changes, so that drift cannot pass for scale
                script.spin(axis, signed, settings.ramp_s, settings.dwell_s)


def _hand_turns(script: Script, settings: BenchSettings, streams: Streams) -> None:
    tilts = streams.of("hand").normal(0.0, settings.hand_tilt_sd, (3, 3))
    faces: tuple[Face, ...] = ("+x", "+y", "+z")
    for axis, face, tilt in zip(AXES, faces, tilts, strict=True):
        _lay(script, settings, unit_vector(face), None)
        true_axis = unit_vector(axis) + np.cross(tilt, unit_vector(axis))
        script.hand_turn(
            axis, settings.hand_angle, 2.0 * settings.move_s, true_axis / np.linalg.norm(true_axis), settings.hand_angle
        )
        script.still(settings.still_s)


def _multi_position(script: Script, settings: BenchSettings, streams: Streams) -> None:
    draw = streams.of("pose")
    for _ in range(settings.poses):
        up = draw.normal(size=3)
        heading = draw.uniform(-math.pi, math.pi)
        twist = turn_quaternion(up / np.linalg.norm(up), np.array(heading))  # about the vertical: up stays up
        if script.samples:
            script.turn_to(quaternion_product(facing(script.q, up), twist), settings.move_s)
        else:
            script.q = facing(script.q, up)
        script.still(settings.still_s if script.samples else settings.first_still_s)
