"""Programme: what is done with the device at which temperature, as motions on the clock of the chamber.

A leg is a stretch that is recorded without a break: a visit to a set-point, a whole ramp, a whole warm-up.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_product
from undrift.session import FACES, Face
from undrift.sim.motion.bench import AXES, earth_rate
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.script import Script, facing, turn_quaternion, unit_vector
from undrift.sim.streams import Streams
from undrift.sim.thermal.chamber import Profile, Soak, ramp_profile, soak_profile, warm_up_profile
from undrift.sim.thermal.settings import ThermalKind, ThermalSettings

Work = Callable[[Script], Face | None]  # writes what is done at a set-point and returns the face that it leaves up


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """A stretch recorded without a break.

    Parameters
    ----------
    motion : Motion
        On the clock of the chamber, with its labels.
    soak : Soak or None
        The visit it belongs to.
    """

    motion: Motion
    soak: Soak | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Programme:
    """Temperatures and motions of a thermal session.

    Parameters
    ----------
    profile : Profile
        Temperatures.
    legs : tuple of Leg
        In order of time.
    """

    profile: Profile
    legs: tuple[Leg, ...]


def programme_of(kind: ThermalKind, settings: ThermalSettings, streams: Streams) -> Programme:
    """Return what is done at which temperature.

    Parameters
    ----------
    kind : str
        soak, ramp, warm_up or multi_position.
    settings : ThermalSettings
        How.
    streams : Streams
        Of tilts and poses.

    Returns
    -------
    Programme
        One leg for each visit to a set-point, or one in all.
    """
    if kind == "ramp":
        return _resting(ramp_profile(settings.ramp, settings=settings.chamber), settings)
    if kind == "warm_up":
        return _resting(warm_up_profile(settings.warm_up, step_s=settings.chamber.step_s), settings)
    if kind == "multi_position":
        poses = streams.of("pose")
        return _visits(settings, lambda script: _poses(script, settings, poses))
    tilts = streams.of("tilt")
    return _visits(settings, lambda script: _faces_and_steps(script, settings, tilts))


def _resting(profile: Profile, settings: ThermalSettings) -> Programme:
    script = Script(settings.bench.sample_rate_hz, unit_vector(settings.rest_face))
    script.still(float(profile.time[-1]), settings.rest_face)
    return Programme(profile=profile, legs=(Leg(motion=_motion(script, settings, 0)),))


def _visits(settings: ThermalSettings, work: Work) -> Programme:
    rate, throughout = settings.bench.sample_rate_hz, settings.recorded == "throughout"
    length_s = _length_s(settings, work)
    points = settings.set_points_c + (settings.set_points_c[::-1] if settings.back else ())
    profile = soak_profile(points, measured_s=length_s, settings=settings.chamber)
    legs: list[Leg] = []
    up = unit_vector("+z")
    q, face = Script(rate, up).q, cast("Face | None", "+z")
    for soak in profile.soaks:
        script = Script(rate, up)
        script.q = q
        first, last = round(soak.soaked_s * rate), round(soak.end_s * rate)
        if throughout:
            first = round(soak.begin_s * rate)
            script.still(soak.soaked_s - soak.begin_s, face)
        face = work(script)
        if throughout and first + script.samples < last:
            script.slide(((), (), ()), (last - first - script.samples) / rate)  # at rest until the chamber moves on
        q = script.q
        legs.append(Leg(motion=_motion(script, settings, first), soak=soak))
    return Programme(profile=profile, legs=tuple(legs))


def _length_s(settings: ThermalSettings, work: Work) -> float:
    """Return how long a visit measures, s: that of a rehearsal after a wait, whose tilts and poses are not used."""
    script = Script(settings.bench.sample_rate_hz, unit_vector("+z"))
    script.still(1.0)
    before = script.samples
    work(script)
    if script.samples == before:
        raise InputError(
            "thermal: wanted a motion at the set-points, got one of no length; give still_s, rates or poses"
        )
    return (script.samples - before) / settings.bench.sample_rate_hz


def _faces_and_steps(script: Script, settings: ThermalSettings, draw: np.random.Generator) -> Face:
    """Rest on one face or six; then each axis up in turn: a rest, the steady rates both ways."""
    bench = settings.bench
    faces: tuple[Face, ...] = FACES if settings.faces == "six" else ("+z",)
    for face in faces:
        up, tilt = unit_vector(face), draw.normal(0.0, bench.tilt_sd, 3)
        _lay(script, settings, facing(script.q, up + np.cross(tilt, up)))
        script.still(bench.still_s, face)
    if not bench.turn_rates:
        return faces[-1]
    ups: tuple[Face, ...] = ("+x", "+y", "+z")
    for axis, face in zip(AXES, ups, strict=True):
        _lay(script, settings, facing(script.q, unit_vector(face)))
        script.still(bench.still_s, face)
        for turn_rate in bench.turn_rates:
            for signed in (turn_rate, -turn_rate):  # the way round changes, so that drift cannot pass for scale
                script.spin(axis, signed, bench.ramp_s, bench.dwell_s)
    return "+z"


def _poses(script: Script, settings: ThermalSettings, draw: np.random.Generator) -> None:
    """Rest in free poses, a long one first."""
    bench = settings.bench
    for number in range(bench.poses):
        up = draw.normal(size=3)
        twist = turn_quaternion(up / np.linalg.norm(up), np.array(draw.uniform(-math.pi, math.pi)))
        _lay(script, settings, quaternion_product(facing(script.q, up), twist))
        script.still(bench.first_still_s if number == 0 else bench.still_s)


def _lay(script: Script, settings: ThermalSettings, q: FloatArray) -> None:
    if script.samples:
        script.turn_to(q, settings.bench.move_s)
    else:
        script.q = q


def _motion(script: Script, settings: ThermalSettings, first: int) -> Motion:
    """Return what was written, its first sample the given one of the programme's clock."""
    bench = settings.bench
    motion = script.motion(
        bench.gravity_m_s2, lever_arm_b=np.array(bench.lever_arm_b), earth_rate_n=earth_rate(bench.latitude_deg)
    )
    return replace(motion, time=motion.time + first / bench.sample_rate_hz)
