"""Bench: the motions of a calibration session, as a person or a rate table makes them.

``six_face``      six stills, one face up each, off level by a small random tilt
``rate_table``    three mountings, each axis up in turn, steady rates both ways
``bench``         the two after each other: what the note asks for
``ferraris``      six stills and three turns by hand through a known angle
``multi_position`` a long still, then free poses with turns between: no equipment

Rivals: the calibration motions that the note weighs against its own and leaves.

``trolley``         a cart on a rail swings to and fro, each axis along the rail in turn; the rail shakes it
``inclined_plane``  stills on a plane tilted in steps through half a turn about each axis
``piston``          a servohydraulic piston lifts and lowers it by a sinusoid, each axis upright in turn
``robot_arm``       an arm turns and carries it at random about and along all axes, between two stills
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_product, rotate
from undrift.record import FACES, Axis, Face, Still
from undrift.sim.bench_errors import IDEAL, BenchErrors, gain_of, level_of
from undrift.sim.device.simulate import Streams, draw_streams
from undrift.sim.motion.motion import Course, Motion, Script, facing, turn_quaternion, unit_vector, wave
from undrift.sim.motion.tasks import Task, draw_lines
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- Rivals: the calibration motions that the note weighs against its own and leaves.

RivalKind = Literal["trolley", "inclined_plane", "piston", "robot_arm"]
RAIL_SHAKE_HZ = (8.0, 25.0)  # [assumed] wheels on a rail
ROBOT_TURN_HZ, ROBOT_MOVE_HZ = (0.02, 0.2), (0.05, 0.6)  # [assumed]


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalSettings:
    """How a rival procedure is performed. All defaults are choices: the note gives none."""

    sample_rate_hz: float = 100.0  # Samples per second
    gravity_m_s2: float = STANDARD_GRAVITY  # Local gravity, m/s2
    still_s: float = 4.0  # Length of each still and of each move between mountings, s
    move_s: float = 2.0
    run_s: float = 10.0  # Length of each run at one frequency, and of the robot's motion over six, s
    errors: BenchErrors = IDEAL  # What the rig and the mounting do wrong
    trolley_hz: tuple[float, ...] = (0.5, 0.8)  # Frequencies of the trolley's runs, Hz
    trolley_stroke: float = 0.15  # Amplitude of its sinusoid, m
    shake: float = 2e-5  # Displacement rms by which an uneven rail shakes it upwards and sideways, m
    piston_hz: tuple[float, ...] = (1.0, 2.0, 4.0)  # Frequencies of the piston's runs, Hz
    piston_stroke: float = 0.02  # Amplitude of its sinusoid, m
    # Inclinations, rad
    plane_angles: tuple[float, ...] = tuple(angle * RADIAN_PER_DEGREE for angle in range(-90, 91, 15))
    robot_turn: tuple[float, float, float] = (1.0, 0.6, 1.5)  # rms of roll, pitch and yaw, rad
    robot_move: float = 0.12  # rms along each axis, m


def rival_motion(kind: RivalKind, *, rng: np.random.Generator, settings: RivalSettings | None = None) -> Motion:
    """Return the true motion of a rival procedure."""
    if kind not in get_args(RivalKind):
        raise InputError(f"rival: wanted one of {', '.join(get_args(RivalKind))}, got '{kind}'; name one of them")
    chosen = settings or RivalSettings()
    if kind == "robot_arm":
        return motion_of_arm(robot_task(rng=rng, settings=chosen), chosen)
    script = Script(chosen.sample_rate_hz, np.array([0.0, 0.0, 1.0]))
    streams = draw_streams(rng)
    if kind == "inclined_plane":
        _inclined_plane(script, chosen, streams)
    else:
        _driven(script, chosen, streams, kind)
    return script.motion(chosen.gravity_m_s2, lever_arm_b=np.zeros(3), earth_rate_n=np.zeros(3))


def _driven(script: Script, settings: RivalSettings, streams: Streams, kind: RivalKind) -> None:
    """Swing each axis in turn along the rail of a trolley, or upright on a piston."""
    errors, mounts, rail, drive = settings.errors, *(streams.of(name) for name in ("mount", "rail", "drive"))
    level, gain, carried = level_of(errors, streams), gain_of(errors, streams), kind == "trolley"
    way = rotate(level, np.array([1.0, 0.0, 0.0] if carried else [0.0, 0.0, 1.0]))
    stroke = settings.trolley_stroke if carried else settings.piston_stroke
    for axis in range(3):
        along, across = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
        up, forward = (across, along) if carried else (along, across)
        _mount(script, settings, up, forward, mounts.normal(0.0, errors.mount_tilt, 3), level)
        for frequency_hz in settings.trolley_hz if carried else settings.piston_hz:
            size = stroke * (1.0 + drive.normal(0.0, errors.stroke))
            second = stroke * drive.normal(0.0, errors.harmonic)
            lines = ((size, gain * frequency_hz), (second, 2.0 * gain * frequency_hz))
            path: list[Course] = [
                tuple(wave(part * a, f, 0.0, 0.0, settings.run_s, 2.0) for a, f in lines if part * a != 0.0)
                for part in way
            ]
            if carried:
                path[1:] = [(*course, *_shake(settings, rail)) for course in path[1:]]
            script.slide((path[0], path[1], path[2]), settings.run_s)
            script.still(settings.still_s)


def _shake(settings: RivalSettings, rail: np.random.Generator) -> Course:
    if settings.shake == 0.0:
        return ()
    return (draw_lines(rail, lambda f: f**-4.0, band_hz=RAIL_SHAKE_HZ, rms=settings.shake, span=(0.0, settings.run_s)),)


def _inclined_plane(script: Script, settings: RivalSettings, streams: Streams) -> None:
    errors, mounts, bearing, scale = settings.errors, *(streams.of(name) for name in ("mount", "hinge", "angle"))
    level = level_of(errors, streams)
    for axis in range(3):  # the plane turns about this axis of the case
        across, up = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        tilt = mounts.normal(0.0, errors.mount_tilt, 3)
        for stated in settings.plane_angles:
            angle = stated + float(scale.normal(0.0, errors.inclination))
            lain = tilt + bearing.normal(0.0, errors.wobble, 3)
            _mount(script, settings, math.cos(angle) * up + math.sin(angle) * across, np.eye(3)[axis], lain, level)


def _mount(
    script: Script,
    settings: RivalSettings,
    up_b: FloatArray,
    forward_b: FloatArray,
    tilt: FloatArray,
    level: FloatArray,
) -> None:
    """Turn the case until one direction points up and another, across it, along x, but for errors; then wait."""
    upright = facing(script.q, up_b + np.cross(tilt, up_b))
    x, y, _ = rotate(upright, forward_b + np.cross(tilt, forward_b))
    heading = turn_quaternion(np.array([0.0, 0.0, 1.0]), -np.arctan2(y, x))
    script.lay(quaternion_product(level, quaternion_product(heading, upright)), settings.move_s)
    script.still(settings.still_s)


def rig_of(errors: BenchErrors, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, float]:
    """Return the first mounting of a rig, a rotation vector, its level as a turn in n, (4,), and true over stated rate."""
    streams = draw_streams(rng)
    mount = streams.of("mount").normal(0.0, errors.mount_tilt, 3)
    return mount, level_of(errors, streams), gain_of(errors, streams)


def robot_task(*, rng: np.random.Generator, settings: RivalSettings) -> Task:
    """Return what an arm or a hand does, at any instant."""
    streams = draw_streams(rng)
    stop = settings.still_s + 6.0 * settings.run_s
    span = (settings.still_s, stop)
    turn, move = streams.of("robot turn"), streams.of("robot move")
    courses: dict[str, Any] = {
        angle: (draw_lines(turn, np.ones_like, band_hz=ROBOT_TURN_HZ, rms=rms, span=span),)
        for angle, rms in zip(("roll", "pitch", "yaw"), settings.robot_turn, strict=True)
    }
    for way in ("forward", "left", "up"):
        courses[way] = (draw_lines(move, lambda f: f**-2.0, band_hz=ROBOT_MOVE_HZ, rms=settings.robot_move, span=span),)
    return Task(name="robot_arm", duration_s=stop + settings.still_s, moving_s=span, **courses)


def motion_of_arm(task: Task, settings: RivalSettings) -> Motion:
    """Return the motion of that at the samples of a record, with its two stills."""
    time = np.arange(round(task.duration_s * settings.sample_rate_hz)) / settings.sample_rate_hz
    motion = task.at(time, settings.gravity_m_s2)
    first, last = (round(moment * settings.sample_rate_hz) for moment in task.moving_s)
    return replace(motion, stills=(Still(start=0, stop=first), Still(start=last + 1, stop=len(time))))


# ---- bench

BenchKind = Literal["six_face", "rate_table", "bench", "ferraris", "multi_position"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
UPS: tuple[Face, ...] = ("+x", "+y", "+z")
SIT_TO_STAND_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(10, 91, 5))  # the note's list, one way round


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSettings:
    """How a session is performed."""

    sample_rate_hz: float = 100.0  # Samples per second
    gravity_m_s2: float = STANDARD_GRAVITY  # Local gravity, m/s2
    errors: BenchErrors = IDEAL  # What table, faces and hands do wrong
    still_s: float = 6.0  # Length of each still, s
    first_still_s: float = 20.0  # Length of the first still of a multi-position session, s
    move_s: float = 2.0  # Length of each move between stills and of each half hand turn, s
    poses: int = 24  # Free poses of a multi-position session
    # Steady rates of the table, rad/s, positive; each is imposed both ways
    turn_rates: tuple[float, ...] = SIT_TO_STAND_RATES
    ramp_s: float = 0.5  # Run-up and steady part of each table rate, s
    dwell_s: float = 3.0
    hand_angle: float = 2.0 * math.pi  # Angle of a hand turn, rad
    lever_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Accelerometers from the turning axis, m
    latitude_deg: float | None = None  # Where the bench stands, for the Earth rate; None leaves it out


def bench_motion(kind: BenchKind, *, rng: np.random.Generator, settings: BenchSettings | None = None) -> Motion:
    """Return the true motion of a calibration session."""
    if kind not in get_args(BenchKind):
        raise InputError(f"bench: wanted one of {', '.join(get_args(BenchKind))}, got '{kind}'; name one of them")
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
    return script_motion(script, chosen)


def script_motion(script: Script, settings: BenchSettings) -> Motion:
    """Return what was written, as a bench stands."""
    return script.motion(
        settings.gravity_m_s2,
        lever_arm_b=np.array(settings.lever_arm_b),
        earth_rate_n=earth_rate(settings.latitude_deg),
    )


def earth_rate(latitude_deg: float | None) -> FloatArray:
    """Return the rotation rate of the Earth in a level frame with y north and z up, (3,) rad/s."""
    if latitude_deg is None:
        return np.zeros(3)
    latitude = latitude_deg * RADIAN_PER_DEGREE
    return EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def rest_on_faces(
    script: Script, settings: BenchSettings, faces: tuple[Face, ...], draw: np.random.Generator | None = None
) -> None:
    """Rest with each face up in turn, off level by a random tilt."""
    for face in faces:
        up, tilt = unit_vector(face), draw.normal(0.0, settings.errors.face_tilt, 3) if draw else np.zeros(3)
        script.lay(facing(script.q, up + np.cross(tilt, up)), settings.move_s)
        script.still(settings.still_s, face)


_RESEAT_S = 0.5  # after two dwells about axes of their own the bearing is back in its seat


def steady_rates(script: Script, settings: BenchSettings, streams: Streams) -> None:
    """Put each axis up in turn: a rest, then the steady rates both ways, so that drift cannot pass for scale."""
    table = settings.errors
    mount, bearing, motor, servo = (streams.of(name) for name in ("mount", "bearing", "motor", "servo"))
    off_level, gain = level_of(table, streams), gain_of(table, streams)
    bearing.normal(size=2), motor.normal()  # level and gain are the first draws of these two
    for axis, face in zip(AXES, UPS, strict=True):
        turned = _off(unit_vector(axis), mount.normal(0.0, table.mount_tilt, 3))
        level = facing(script.q, turned)  # the table's axis upright in n, then off level
        if table.level > 0.0:
            level = quaternion_product(off_level, level)
        script.lay(level, settings.move_s)
        script.still(settings.still_s, face)
        seat, azimuth = script.q, float(motor.uniform(-math.pi, math.pi))
        ripple, excess = float(motor.normal(0.0, table.ripple)), float(motor.normal(0.0, table.excess))
        for commanded in settings.turn_rates:
            for signed in (commanded, -commanded):
                true = signed * gain + float(servo.normal(0.0, table.servo)) / settings.dwell_s
                stated = _read_rate(table, true / gain, settings.dwell_s, servo) if table.encoder_lines else signed
                azimuth += 0.5 * true * settings.ramp_s
                uneven = (ripple, azimuth, excess, table.settle_s)
                wobbling = _off(turned, bearing.normal(0.0, table.wobble, 3))
                script.spin(
                    axis, true, settings.ramp_s, settings.dwell_s, axis_b=wobbling, stated_rate=stated, uneven=uneven
                )
                azimuth += true * (settings.dwell_s + 0.5 * settings.ramp_s)
            if table.wobble > 0.0:
                script.lay(seat, _RESEAT_S)


def _read_rate(table: BenchErrors, turn_rate: float, dwell_s: float, draw: np.random.Generator) -> float:
    """Return the rate that whole counts of an encoder show over a dwell, rad/s."""
    count, phase = 0.5 * math.pi / table.encoder_lines, float(draw.uniform())
    return (math.floor(phase + turn_rate * dwell_s / count) - math.floor(phase)) * count / dwell_s


def _off(axis_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return a unit vector turned by a small random rotation, (3,)."""
    off = axis_b + np.cross(tilt, axis_b)
    return np.asarray(off / np.linalg.norm(off))


def _hand_turns(script: Script, settings: BenchSettings, streams: Streams) -> None:
    for axis, tilt in zip(AXES, streams.of("hand").normal(0.0, settings.errors.hand_axis, (3, 3)), strict=True):
        unit = unit_vector(axis)
        script.lay(facing(script.q, unit), settings.move_s)
        script.still(settings.still_s)
        script.hand_turn(axis, settings.hand_angle, 2.0 * settings.move_s, _off(unit, tilt))
        script.still(settings.still_s)


def free_poses(
    script: Script, settings: BenchSettings, draw: np.random.Generator, *, first_twisted: bool = False
) -> None:
    """Rest in free poses, a long one first."""
    for number in range(settings.poses):
        up = draw.normal(size=3)
        # about the vertical
        twist = turn_quaternion(up / np.linalg.norm(up), np.array(draw.uniform(-math.pi, math.pi)))
        q = facing(script.q, up)
        script.lay(quaternion_product(q, twist) if script.samples or first_twisted else q, settings.move_s)
        script.still(settings.still_s if number else settings.first_still_s)
