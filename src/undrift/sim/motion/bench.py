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
    tilt_sd: float = 0.0  # Error of each mounting about each axis, rad
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
            swing = (wave(settings.trolley_stroke, frequency_hz, 0.0, 0.0, settings.run_s, 2.0),)
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
            lift = (wave(settings.piston_stroke, frequency_hz, 0.0, 0.0, settings.run_s, 2.0),)
            script.slide(((), (), lift), settings.run_s)
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
    script.lay(
        quaternion_product(turn_quaternion(np.array([0.0, 0.0, 1.0]), -np.arctan2(y, x)), level), settings.move_s
    )
    script.still(settings.still_s)


def _robot_arm(settings: RivalSettings, streams: Streams) -> Motion:
    stop = settings.still_s + 6.0 * settings.run_s
    span = (settings.still_s, stop)
    turn, move = streams.of("robot turn"), streams.of("robot move")
    courses: dict[str, Any] = {
        angle: (draw_lines(turn, np.ones_like, band_hz=ROBOT_TURN_HZ, rms=rms, span=span),)
        for angle, rms in zip(("roll", "pitch", "yaw"), settings.robot_turn, strict=True)
    }
    for way in ("forward", "left", "up"):
        courses[way] = (draw_lines(move, lambda f: f**-2.0, band_hz=ROBOT_MOVE_HZ, rms=settings.robot_move, span=span),)
    task = Task(name="robot_arm", duration_s=stop + settings.still_s, moving_s=span, **courses)
    time = np.arange(round(task.duration_s * settings.sample_rate_hz)) / settings.sample_rate_hz
    motion = task.at(time, settings.gravity_m_s2)
    first, last = round(span[0] * settings.sample_rate_hz), round(span[1] * settings.sample_rate_hz)
    return replace(motion, stills=(Still(start=0, stop=first), Still(start=last + 1, stop=len(time))))


# ---- bench

BenchKind = Literal["six_face", "rate_table", "bench", "ferraris", "multi_position"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
UPS: tuple[Face, ...] = ("+x", "+y", "+z")
SIT_TO_STAND_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(10, 91, 5))  # the note's list, one way round


@dataclass(frozen=True, slots=True, kw_only=True)
class TableErrors:
    """Standard deviations of what a rate table and its operator do wrong; each mounting draws anew."""

    mount_tilt_sd: float = 0.0  # Of the device against the table, about each axis across, rad
    level_sd: float = (
        0.0  # Of the table's axis against the vertical, about each horizontal axis, rad; one table, one draw
    )
    wobble_sd: float = 0.0  # Of the turning axis from dwell to dwell, about each axis across, rad
    rate_sd: float = 0.0  # Of the true rate against the stated one, relative; one table, one draw
    ripple_sd: float = 0.0  # Of the rate once a turn, amplitude, relative
    excess_sd: float = 0.0  # Of the rate at the start of a dwell, relative; a transient
    settle_s: float = 0.5  # Time constant of that, s


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSettings:
    """How a session is performed."""

    sample_rate_hz: float = 100.0  # Samples per second
    gravity_m_s2: float = STANDARD_GRAVITY  # Local gravity, m/s2
    still_s: float = 6.0  # Length of each still, s
    first_still_s: float = 20.0  # Length of the first still of a multi-position session, s
    move_s: float = 2.0  # Length of each move between stills and of each half hand turn, s
    tilt_sd: float = 0.0  # Levelling error of each face about each horizontal axis, rad
    poses: int = 24  # Free poses of a multi-position session
    # Steady rates of the table, rad/s, positive; each is imposed both ways
    turn_rates: tuple[float, ...] = SIT_TO_STAND_RATES
    ramp_s: float = 0.5  # Run-up and steady part of each table rate, s
    dwell_s: float = 3.0
    table: "TableErrors | None" = None  # What mounting and table do wrong; None is an ideal table
    hand_angle: float = 2.0 * math.pi  # Angle of a hand turn, rad
    hand_tilt_sd: float = 0.0  # Error of a hand turn's axis about each axis across it, rad
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
        up, tilt = unit_vector(face), draw.normal(0.0, settings.tilt_sd, 3) if draw else np.zeros(3)
        script.lay(facing(script.q, up + np.cross(tilt, up)), settings.move_s)
        script.still(settings.still_s, face)


_RESEAT_S = 0.5  # after two dwells about axes of their own the bearing is back in its seat


def steady_rates(script: Script, settings: BenchSettings, streams: Streams | None = None) -> None:
    """Put each axis up in turn: a rest, then the steady rates both ways."""
    if settings.table is not None and streams is not None:
        _erring_rates(script, settings, settings.table, streams)
        return
    for axis, face in zip(AXES, UPS, strict=True):
        rest_on_faces(script, settings, (face,))
        for turn_rate in settings.turn_rates:
            for signed in (turn_rate, -turn_rate):  # the way round changes, so that drift cannot pass for scale
                script.spin(axis, signed, settings.ramp_s, settings.dwell_s)


def _erring_rates(script: Script, settings: BenchSettings, table: TableErrors, streams: Streams) -> None:
    mount, bearing, motor = (streams.of(name) for name in ("mount", "bearing", "motor"))
    level_n = np.array([*bearing.normal(0.0, table.level_sd, 2), 0.0])
    gain = 1.0 + float(motor.normal(0.0, table.rate_sd))
    for axis, face in zip(AXES, UPS, strict=True):
        unit = unit_vector(axis)
        turned = _off(unit, mount.normal(0.0, table.mount_tilt_sd, 3))
        level = facing(script.q, turned)  # the table's axis upright in n, then off level
        tilt, size = np.cross(level_n, [0.0, 0.0, 1.0]), float(np.linalg.norm(level_n))
        if size > 0.0:
            level = quaternion_product(turn_quaternion(tilt / size, np.array(size)), level)
        script.lay(level, settings.move_s)
        script.still(settings.still_s, face)
        seat, azimuth = script.q, float(motor.uniform(-math.pi, math.pi))
        ripple, excess = float(motor.normal(0.0, table.ripple_sd)), float(motor.normal(0.0, table.excess_sd))
        for stated in settings.turn_rates:
            for signed in (stated, -stated):
                true = signed * gain
                azimuth += 0.5 * true * settings.ramp_s
                uneven = (ripple, azimuth, excess, table.settle_s)
                wobbling = _off(turned, bearing.normal(0.0, table.wobble_sd, 3))
                script.spin(
                    axis, true, settings.ramp_s, settings.dwell_s, axis_b=wobbling, stated_rate=signed, uneven=uneven
                )
                azimuth += true * (settings.dwell_s + 0.5 * settings.ramp_s)
            if table.wobble_sd > 0.0:
                script.lay(seat, _RESEAT_S)


def _off(axis_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return a unit vector turned by a small random rotation, (3,)."""
    off = axis_b + np.cross(tilt, axis_b)
    return np.asarray(off / np.linalg.norm(off))


def _hand_turns(script: Script, settings: BenchSettings, streams: Streams) -> None:
    tilts = streams.of("hand").normal(0.0, settings.hand_tilt_sd, (3, 3))
    for axis, tilt in zip(AXES, tilts, strict=True):
        unit = unit_vector(axis)
        script.lay(facing(script.q, unit), settings.move_s)
        script.still(settings.still_s)
        true_axis = unit + np.cross(tilt, unit)
        script.hand_turn(axis, settings.hand_angle, 2.0 * settings.move_s, true_axis / np.linalg.norm(true_axis))
        script.still(settings.still_s)


def free_poses(
    script: Script, settings: BenchSettings, draw: np.random.Generator, *, first_twisted: bool = False
) -> None:
    """Rest in free poses, a long one first."""
    for number in range(settings.poses):
        up = draw.normal(size=3)
        twist = turn_quaternion(
            up / np.linalg.norm(up), np.array(draw.uniform(-math.pi, math.pi))
        )  # about the vertical
        q = facing(script.q, up)
        script.lay(quaternion_product(q, twist) if script.samples or first_twisted else q, settings.move_s)
        script.still(settings.still_s if number else settings.first_still_s)
