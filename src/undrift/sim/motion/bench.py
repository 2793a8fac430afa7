"""Motions of calibration sessions, by hand or on a rate table.

``six_face``       six stills, each with another face up, with a small random tilt
``rate_table``     three mountings, each with another axis up, and steady rates in both directions
``bench``          six_face and then rate_table, as in the note
``ferraris``       six stills and three turns by hand through a known angle
``multi_position`` a long still, then free poses with turns between them, without equipment
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import cross, quaternion_product
from undrift.record import FACES, Axis, Face
from undrift.sim.device.simulate import Streams, draw_streams
from undrift.sim.motion.motion import Motion, Script, facing, turn_quaternion, unit_vector
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- Errors of table, faces and hands. Draws are standard normal numbers, which are then scaled.


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchErrors:
    """Standard deviations of the errors of a bench. With zeros, the bench is ideal."""

    # tilt of each face, about each axis, rad
    face_tilt: float = 0.0
    hand_axis: float = 0.0  # tilt of the axis of a turn by hand, about each perpendicular axis, rad
    # misalignment of the device on the rig, about each axis, rad, drawn for each mounting
    mount_tilt: float = 0.0
    # tilt of the rig's axis from the vertical, about each horizontal axis, rad, drawn once per rig
    level: float = 0.0
    # wobble of the table's axis between dwells, or of a plane between angles, about each axis, rad
    wobble: float = 0.0
    # relative error of rate or frequency, drawn once per rig
    table_rate: float = 0.0
    ripple: float = 0.0  # relative amplitude of a rate error with the period of a turn
    excess: float = 0.0  # relative transient error of the rate at the start of a dwell
    settle_s: float = 0.5  # time constant of that transient, s
    # error of the angle turned in a dwell, rad
    servo: float = 0.0
    encoder_lines: int = 0  # lines of the table's encoder, four counts each (0: rates without steps)


IDEAL = BenchErrors()


def level_of(errors: BenchErrors, streams: Streams) -> FloatArray:
    """Return the tilt of a rig from level, as a quaternion in n, (4,)."""
    level_n = np.array([*streams.of("bearing").normal(0.0, errors.level, 2), 0.0])
    size = float(np.linalg.norm(level_n))
    return turn_quaternion(np.cross(level_n, [0.0, 0.0, 1.0]) / (size or 1.0), np.array(size))


def gain_of(errors: BenchErrors, streams: Streams) -> float:
    """Return the ratio of true to nominal rate or frequency of a rig."""
    return 1.0 + float(streams.of("motor").normal(0.0, errors.table_rate))


# ---- Bench.

BenchKind = Literal["six_face", "rate_table", "bench", "ferraris", "multi_position"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
UPS: tuple[Face, ...] = ("+x", "+y", "+z")
SIT_TO_STAND_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(10, 91, 5))  # the note's list, in one direction


HAND_ANGLE = 2.0 * math.pi  # angle of a turn by hand, rad


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSettings:
    """Settings of a session."""

    sample_rate_hz: float = 100.0  # sample rate, Hz
    gravity_m_s2: float = STANDARD_GRAVITY  # local gravity, m/s2
    errors: BenchErrors = IDEAL  # errors of table, faces and hands
    still_s: float = 6.0  # duration of each still, s
    first_still_s: float = 20.0  # duration of the first still of a multi-position session, s
    move_s: float = 2.0  # duration of each move between stills and of each half hand turn, s
    poses: int = 24  # number of free poses of a multi-position session
    # positive steady rates of the table, rad/s, each used in both directions
    turn_rates: tuple[float, ...] = SIT_TO_STAND_RATES
    ramp_s: float = 0.5  # run-up of each table rate, s
    dwell_s: float = 3.0  # steady part of each table rate, s


def bench_motion(kind: BenchKind, *, rng: np.random.Generator, settings: BenchSettings | None = None) -> Motion:
    """Return the true motion of a calibration session."""
    if kind not in get_args(BenchKind):
        raise InputError(f"bench: unknown kind '{kind}'. Use one of {', '.join(get_args(BenchKind))}.")
    chosen = settings or BenchSettings()
    streams = draw_streams(rng)
    script = Script(chosen.sample_rate_hz, np.array([0.0, 0.0, 1.0]))
    if kind == "multi_position":
        free_poses(script, chosen, streams.of("pose"))
    if kind in ("six_face", "bench", "ferraris"):
        rest_on_faces(script, chosen, FACES, streams.of("tilt"))
    if kind in ("rate_table", "bench"):
        steady_rates(script, chosen, streams)
    if kind == "ferraris":
        _hand_turns(script, chosen, streams)
    return script.motion(chosen.gravity_m_s2)


def rest_on_faces(
    script: Script, settings: BenchSettings, faces: tuple[Face, ...], draw: np.random.Generator | None = None
) -> None:
    """Rest with each face up in turn, with a random tilt from level."""
    for face in faces:
        up, tilt = unit_vector(face), draw.normal(0.0, settings.errors.face_tilt, 3) if draw else np.zeros(3)
        script.lay(facing(script.q, up + np.cross(tilt, up)), settings.move_s)
        script.still(settings.still_s, face)


_RESEAT_S = 0.5  # duration of the return to the nominal axis after two dwells, s


def steady_rates(script: Script, settings: BenchSettings, streams: Streams) -> None:
    """Add a rest for each axis up, then steady rates in both directions, so that drift does not bias the scale."""
    table = settings.errors
    mount, bearing, motor, servo = (streams.of(name) for name in ("mount", "bearing", "motor", "servo"))
    off_level, gain = level_of(table, streams), gain_of(table, streams)
    bearing.normal(size=2), motor.normal()  # level and gain are the first draws of these two generators
    for axis, face in zip(AXES, UPS, strict=True):
        table_axis = turned(unit_vector(axis), mount.normal(0.0, table.mount_tilt, 3))
        level = facing(script.q, table_axis)  # orientation with the table's axis vertical, then tilted
        if table.level > 0.0:
            level = quaternion_product(off_level, level)
        script.lay(level, settings.move_s)
        script.still(settings.still_s, face)
        seat, azimuth = script.q, float(motor.uniform(-math.pi, math.pi))
        ripple, excess = float(motor.normal(0.0, table.ripple)), float(motor.normal(0.0, table.excess))
        for commanded in settings.turn_rates:
            for signed in (commanded, -commanded):
                true = signed * gain + float(servo.normal(0.0, table.servo)) / settings.dwell_s
                label_rate = _read_rate(table, true / gain, settings.dwell_s, servo) if table.encoder_lines else signed
                azimuth += 0.5 * true * settings.ramp_s
                uneven = (ripple, azimuth, excess, table.settle_s)
                wobbling = turned(table_axis, bearing.normal(0.0, table.wobble, 3))
                script.spin(
                    axis, wobbling, true, settings.ramp_s, settings.dwell_s, stated_rate=label_rate, uneven=uneven
                )
                azimuth += true * (settings.dwell_s + 0.5 * settings.ramp_s)
            if table.wobble > 0.0:
                script.lay(seat, _RESEAT_S)


def _read_rate(table: BenchErrors, turn_rate: float, dwell_s: float, draw: np.random.Generator) -> float:
    """Return the rate from whole counts of an encoder over a dwell, rad/s."""
    count, phase = 0.5 * math.pi / table.encoder_lines, float(draw.uniform())
    return (math.floor(phase + turn_rate * dwell_s / count) - math.floor(phase)) * count / dwell_s


def turned(axis_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return unit vectors turned by small rotations, (..., 3)."""
    off = axis_b + cross(tilt, axis_b)
    return np.asarray(off / np.linalg.norm(off, axis=-1, keepdims=True))


def _hand_turns(script: Script, settings: BenchSettings, streams: Streams) -> None:
    for axis, tilt in zip(AXES, streams.of("hand").normal(0.0, settings.errors.hand_axis, (3, 3)), strict=True):
        unit = unit_vector(axis)
        script.lay(facing(script.q, unit), settings.move_s)
        script.still(settings.still_s)
        script.hand_turn(axis, HAND_ANGLE, 2.0 * settings.move_s, turned(unit, tilt))
        script.still(settings.still_s)


def free_poses(script: Script, settings: BenchSettings, draw: np.random.Generator) -> None:
    """Add rests in free poses, the first of which is long."""
    for number in range(settings.poses):
        up = draw.normal(size=3)
        # heading about the vertical
        twist = turn_quaternion(up / np.linalg.norm(up), np.array(draw.uniform(-math.pi, math.pi)))
        q = facing(script.q, up)
        script.lay(quaternion_product(q, twist) if script.samples else q, settings.move_s)
        script.still(settings.still_s if number else settings.first_still_s)
