"""Thermal sessions of a simulated device: soaks, ramps, warm-ups, poses at several temperatures.

A programme of hours is simulated leg by leg. What a device remembers from leg to leg is kept: its age, the play of its
hysteresis (by the turns of temperature before, for a play has no clock), where a random walk had gone, and what the thermometer
felt all the way. Bias instability, which is stationary, is drawn anew for each leg.
"""

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Record
from undrift.session import Session, Still, Turn
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.offset import Offset
from undrift.sim.device.scene import Scene
from undrift.sim.device.simulate import Simulated, Triad, simulate_device
from undrift.sim.device.thermometer import Thermometer, thermometer_reading
from undrift.sim.motion.motion import Motion
from undrift.sim.streams import draw_streams
from undrift.sim.thermal.chamber import Profile
from undrift.sim.thermal.programme import Leg, Programme, programme_of
from undrift.sim.thermal.settings import ThermalKind, ThermalSettings

RUN_IN_S = 2.0  # at the leg's own temperature, for the filters to settle
PLAIN = Thermometer()
Walks = tuple[FloatArray, FloatArray]  # of the gyroscopes and the accelerometers


def simulate_thermal_session(
    kind: ThermalKind,
    device: DeviceModel,
    *,
    rng: np.random.Generator,
    settings: ThermalSettings | None = None,
) -> Session:
    """Return a thermal session of a simulated device.

    Parameters
    ----------
    kind : str
        ``soak``: at each set-point a rest in one face or six, then steady rates both ways about three axes. ``ramp``: at rest,
        up and down at a rate. ``warm_up``: at rest from power-on, no chamber. ``multi_position``: free poses at each set-point.
    device : DeviceModel
        The sensors.
    rng : Generator
        Draws tilts, poses and noise.
    settings : ThermalSettings, optional
        How it is performed.

    Returns
    -------
    Session
        Of kind thermal. Where the temperature column was left out, stills and turns state their set-point.

    Raises
    ------
    InputError
        A kind that is not one; a board that is not soaked in time.
    """
    if kind not in get_args(ThermalKind):
        raise InputError(f"thermal: wanted one of {', '.join(get_args(ThermalKind))}, got '{kind}'; name one of them")
    chosen = settings or ThermalSettings()
    chosen = replace(chosen, power_on_s=0.0) if kind == "warm_up" else chosen
    programme = programme_of(kind, chosen, draw_streams(rng))
    records, stills, turns = _pieced(_read(programme, device, chosen, rng), chosen)
    return Session(
        kind="thermal",
        serial=device.serial,
        gravity_m_s2=chosen.bench.gravity_m_s2,
        records=records,
        stills=stills if chosen.labelled else (),
        turns=turns if chosen.labelled else (),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """What was recorded of a leg, its labels counted from its own first sample."""

    record: Record
    stills: tuple[Still, ...]
    turns: tuple[Turn, ...]


def _read(
    programme: Programme, device: DeviceModel, settings: ThermalSettings, rng: np.random.Generator
) -> tuple[_Taken, ...]:
    felt = _felt(device.thermometer, programme.profile, settings.power_on_s)
    taken: list[_Taken] = []
    walked: Walks = (np.zeros(3), np.zeros(3))
    ended_s = 0.0
    for leg in programme.legs:
        time = leg.motion.time
        walked = _walked_on(device, walked, float(time[0]) - ended_s, rng)
        made, first = _simulated(leg.motion, programme.profile, _shifted(device, walked), settings.power_on_s, rng)
        walked = (walked[0] + _walk_of(made.gyro), walked[1] + _walk_of(made.accel))
        ended_s = float(time[-1])
        noise = draw_streams(rng).of("thermometer")
        said = _said(device.thermometer, np.interp(made.true_time, programme.profile.time, felt), made.true_time, noise)
        record = replace(made.record, temp_c=None if settings.drop_temperature else said)
        taken.append(_labelled(leg, record.part(first, len(record)), made.true_time[first:], settings))
    return tuple(taken)


def _simulated(
    motion: Motion, profile: Profile, device: DeviceModel, power_on_s: float, rng: np.random.Generator
) -> tuple[Simulated, int]:
    """Return the readings of a leg behind those of a run-in, and the number of its first sample.

    In the run-in the temperature goes through its turns of the time before, a sample each, and then rests.
    """
    start_s, step_s = float(motion.time[0]), 1.0 / motion.sample_rate_hz
    turns = profile.turns_before(start_s)
    temp_c = profile.board_at(motion.time)
    if len(turns):
        count = len(turns) + round(RUN_IN_S / step_s)
        motion = _with_rest_before(motion, count, step_s)
        temp_c = np.concatenate((turns, np.full(count - len(turns), temp_c[0]), temp_c))
    plain = replace(device, thermometer=PLAIN)
    age_s = power_on_s + float(motion.time[0])
    made = simulate_device(plain, motion, rng=rng, temp_c=temp_c, power_on_s=age_s)
    return made, int(np.searchsorted(made.true_time, start_s - 1e-3 * step_s))


def _with_rest_before(motion: Motion, count: int, step_s: float) -> Motion:
    """Return a motion that begins with a rest, with a longer one."""

    def longer(x: FloatArray) -> FloatArray:
        return np.concatenate((np.repeat(x[:1], count, axis=0), x))

    swing = motion.angular_acceleration_b
    return Motion(
        time=np.concatenate((motion.time[0] - np.arange(count, 0, -1) * step_s, motion.time)),
        q_nb=longer(motion.q_nb),
        rate_b=longer(motion.rate_b),
        mean_rate_b=longer(motion.mean_rate_b),
        force_b=longer(motion.force_b),
        gravity_m_s2=motion.gravity_m_s2,
        moving=longer(motion.moving),
        angular_acceleration_b=None if swing is None else longer(swing),
    )


def _felt(thermometer: Thermometer, profile: Profile, power_on_s: float) -> FloatArray:
    """Return what the thermometer feels throughout: lag and its own warmth, no error of reading, degC, shape (n,)."""
    silent = replace(thermometer, trim_error_c=0.0, slope_error=0.0, noise_c=0.0, step_c=0.0)
    scene = _scene(profile.time, profile.board_c, power_on_s)
    return thermometer_reading(silent, scene, np.random.default_rng(0))  # nothing is drawn without noise


def _said(thermometer: Thermometer, felt: FloatArray, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return what it says to what it felt: trim, slope, noise and steps, degC, shape (N,)."""
    return thermometer_reading(replace(thermometer, lag_s=0.0, self_heating_c=0.0), _scene(time, felt, 0.0), rng)


def _scene(time: FloatArray, temp_c: FloatArray, power_on_s: float) -> Scene:
    """Return a scene for the thermometer, which looks at temperature and age."""
    unmoved = np.zeros((len(time), 3))
    return Scene(
        time=time,
        step_s=float((time[-1] - time[0]) / (len(time) - 1)),
        temp_c=temp_c,
        warmth=temp_c,
        age_s=time - time[0] + power_on_s,
        rate_b=unmoved,
        angular_acceleration_b=None,
        force_b=unmoved,
    )


def _walked_on(device: DeviceModel, walked: Walks, gap_s: float, rng: np.random.Generator) -> Walks:
    """Return where the random walks are after a time in which nothing was recorded."""
    streams, span = draw_streams(rng), np.sqrt(max(gap_s, 0.0))
    gyro, accel = (
        at + streams.of(name).standard_normal(3) * (chain.random_walk.bias_walk * span if chain.random_walk else 0.0)
        for name, chain, at in (("gyro_walk", device.gyro, walked[0]), ("accel_walk", device.accel, walked[1]))
    )
    return gyro, accel


def _shifted(device: DeviceModel, walked: Walks) -> DeviceModel:
    def shift(chain: SensorChain, by: FloatArray) -> SensorChain:
        if chain.random_walk is None:
            return chain
        offset = chain.offset or Offset()
        return replace(chain, offset=replace(offset, constant=offset.constant + by))

    return replace(device, gyro=shift(device.gyro, walked[0]), accel=shift(device.accel, walked[1]))


def _walk_of(triad: Triad) -> FloatArray:
    end: FloatArray = triad.of("random_walk")[-1]
    return end


def _labelled(leg: Leg, record: Record, true_time: FloatArray, settings: ThermalSettings) -> _Taken:
    """Return a record with the labels of its leg, in samples of the record: the device's clock may be another."""
    time, slack = leg.motion.time, 1e-3 / leg.motion.sample_rate_hz

    def sample(edge: int) -> int:
        return len(record) if edge >= len(time) else int(np.searchsorted(true_time, time[edge] - slack))

    def temp_of(label: Still | Turn) -> float | None:
        at_set_point = leg.soak is not None and time[label.start] >= leg.soak.soaked_s
        return leg.soak.set_point_c if settings.drop_temperature and leg.soak and at_set_point else None

    stills = tuple(replace(s, start=sample(s.start), stop=sample(s.stop), temp_c=temp_of(s)) for s in leg.motion.stills)
    turns = tuple(replace(t, start=sample(t.start), stop=sample(t.stop), temp_c=temp_of(t)) for t in leg.motion.turns)
    return _Taken(record, stills, turns)


def _pieced(
    taken: tuple[_Taken, ...], settings: ThermalSettings
) -> tuple[tuple[Record, ...], tuple[Still, ...], tuple[Turn, ...]]:
    """Return the records of a session with its labels: one record for each leg, or one in all."""
    stills: list[Still] = []
    turns: list[Turn] = []
    before = 0
    for number, leg in enumerate(taken):
        recording, offset = (0, before) if settings.one_record else (number, 0)
        stills += [replace(s, start=s.start + offset, stop=s.stop + offset, recording=recording) for s in leg.stills]
        turns += [replace(t, start=t.start + offset, stop=t.stop + offset, recording=recording) for t in leg.turns]
        before += len(leg.record)
    records = tuple(leg.record for leg in taken)
    return (_joined(records),) if settings.one_record else records, tuple(stills), tuple(turns)


def _joined(records: tuple[Record, ...]) -> Record:
    def all_of(parts: list[FloatArray | None]) -> FloatArray | None:
        held = [part for part in parts if part is not None]
        return np.concatenate(held) if len(held) == len(parts) else None

    return replace(
        records[0],
        time=np.concatenate([record.time for record in records]),
        gyro=all_of([record.gyro for record in records]),
        accel=all_of([record.accel for record in records]),
        temp_c=all_of([record.temp_c for record in records]),
    )
