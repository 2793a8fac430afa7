"""Simulate: what a device says to a motion, and what each effect has to do with it.

The effects are composed left to right in the order of ``chain.py``. Each stage maps a signal to a signal; the difference is
the contribution of the effect, so that truth plus contributions is the reading. A gyroscope that averages between samples is
driven by the rotation vector of each step over its duration, which loses no coning.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.adc import converted
from undrift.sim.device.amplifier import amplified
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.g_sensitivity import with_g
from undrift.sim.device.hysteresis import with_hysteresis
from undrift.sim.device.instability import with_instability
from undrift.sim.device.lever_arm import lever_arm_force
from undrift.sim.device.low_pass import low_passed
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.noise import with_random_walk, with_white_noise
from undrift.sim.device.nonlinearity import bent
from undrift.sim.device.offset import with_offset
from undrift.sim.device.sampling import Averaging, Ticks, instant, interval, step_means, ticks_of
from undrift.sim.device.scale import scaled
from undrift.sim.device.scene import Scene, scene_of
from undrift.sim.device.thermal_scale import warmed
from undrift.sim.device.thermometer import thermometer_reading
from undrift.sim.device.warm_up import warming_up
from undrift.sim.motion.motion import Motion
from undrift.sim.streams import Streams, draw_streams


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contribution:
    """What one effect adds to a triad's readings.

    Parameters
    ----------
    effect : str
        Its name: a field of ``SensorChain``, or sampling.
    value : array, shape (M, 3)
        rad/s or m/s2, in nominal input units.
    """

    effect: str
    value: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triad:
    """One triad's side of a simulation, M samples.

    Parameters
    ----------
    true : array, shape (M, 3)
        Rate or specific force at the body's origin, rad/s or m/s2, frame b: of the step for a gyroscope that averages.
    contributions : tuple of Contribution
        In the order of the chain: truth and contributions add up to (reading - null) / gain.
    saturated : array of bool, shape (M, 3)
        True where a rail or the end of the codes held the reading.
    """

    true: FloatArray
    contributions: tuple[Contribution, ...]
    saturated: BoolArray

    def of(self, effect: str) -> FloatArray:
        """Return the contribution of one effect.

        Parameters
        ----------
        effect : str
            Its name.

        Returns
        -------
        array, shape (M, 3)
            Zeros for an effect that is switched off.
        """
        return next((c.value for c in self.contributions if c.effect == effect), np.zeros_like(self.true))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """A record and the truth about it, M samples.

    Parameters
    ----------
    record : Record
        What the device said; NaN where the motion is unknown.
    gyro, accel : Triad
        Truth, contributions, saturation.
    temp_c : array, shape (M,)
        True temperature of the board, degC.
    true_time : array, shape (M,)
        When the samples were taken, s, on the clock of the motion.
    """

    record: Record
    gyro: Triad
    accel: Triad
    temp_c: FloatArray
    true_time: FloatArray


def simulate_device(
    model: DeviceModel,
    motion: Motion,
    *,
    rng: np.random.Generator,
    temp_c: float | FloatArray | None = None,
    power_on_s: float = 0.0,
) -> Simulated:
    """Return the readings of a device in a motion.

    Parameters
    ----------
    model : DeviceModel
        The device.
    motion : Motion
        N samples.
    rng : Generator
        Draws the noise, each effect from a stream of its own.
    temp_c : float or array, shape (N,), optional
        Temperature of the board, degC; the reference temperature where not given.
    power_on_s : float
        Time since power-on at the first sample, s.

    Returns
    -------
    Simulated
        Record in frame s, raw, with the thermometer's column; truth and contributions.

    Raises
    ------
    InputError
        A temperature for another number of samples; a motion that lacks what an effect needs.
    """
    n = len(motion)
    temp = model.reference_temp_c if temp_c is None else temp_c
    true_temp = frozen(np.full(n, temp) if np.ndim(temp) == 0 else temp, (n,), "temp_c")
    known = motion.valid > 0.0
    motion = motion if known.all() else _bridged(motion)
    scene = scene_of(motion, true_temp, model.reference_temp_c, power_on_s)
    streams, clock = draw_streams(rng), model.sampling
    ticks = ticks_of(clock, motion.time, streams.of("jitter"))
    gyro_raw, gyro = _triad(
        model.gyro,
        motion.mean_rate_b if clock.gyro_averaging == "interval" else motion.rate_b,
        scene,
        streams,
        _Sampler("gyro", ticks, clock.on_grid, clock.gyro_delay_s, clock.gyro_averaging),
    )
    felt = np.isfinite(motion.force_b).all()
    if model.gyro.g_sensitivity and not felt:
        raise InputError(
            "g-sensitivity: wanted a motion with specific force, got one without positions; switch the effect off, or give "
            "poses with positions"
        )
    accel_raw, accel = _unfelt(len(ticks.true_s))
    if felt:
        accel_raw, accel = _triad(
            model.accel,
            step_means(motion.force_b, motion.time) if clock.accel_averaging == "interval" else motion.force_b,
            scene,
            streams,
            _Sampler("accel", ticks, clock.on_grid, clock.accel_delay_s, clock.accel_averaging),
        )
    said = thermometer_reading(model.thermometer, scene, streams.of("thermometer"))
    seen = np.interp(ticks.true_s, motion.time, known.astype(float)) > 1.0 - 1e-9
    record = Record(
        time=ticks.stamped_s,
        gyro=np.where(seen[:, None], gyro_raw, np.nan),
        accel=np.where(seen[:, None], accel_raw, np.nan) if felt else None,
        temp_c=_latest(said, scene.time, ticks),
        gyro_unit=model.gyro.unit,
        accel_unit=model.accel.unit,
        device=model.serial,
    )
    temp_taken = true_temp if clock.on_grid else np.interp(ticks.true_s, scene.time, true_temp)
    return Simulated(record=record, gyro=gyro, accel=accel, temp_c=temp_taken, true_time=ticks.true_s)


@dataclass(frozen=True, slots=True)
class _Sampler:
    """How the signals of one triad are taken."""

    name: str
    ticks: Ticks
    on_grid: bool
    delay_s: FloatArray
    averaging: Averaging

    @property
    def period_s(self) -> float:
        stamped = self.ticks.stamped_s
        return float((stamped[-1] - stamped[0]) / (len(stamped) - 1))

    def take(self, x: FloatArray, time: FloatArray) -> FloatArray:
        if self.on_grid:
            return x
        taken = interval if self.averaging == "interval" else instant
        return taken(x, time, self.ticks.true_s, self.delay_s)

    def on_ticks(self, x: FloatArray, time: FloatArray) -> FloatArray:
        """Return a signal of the motion's grid at the samples, straight between neighbours: linear, so that sums stay sums."""
        if self.on_grid:
            return x
        return np.stack([np.interp(self.ticks.true_s, time, x[:, k]) for k in range(3)], axis=1)


def _triad(
    chain: SensorChain, true: FloatArray, scene: Scene, streams: Streams, sampler: _Sampler
) -> tuple[FloatArray, Triad]:
    """Return the readings of one triad and the truth about them."""
    found: list[Contribution] = []
    x = true
    late = chain.white_noise if chain.low_pass is None and not sampler.on_grid else None
    early = replace(chain, white_noise=None) if late else chain
    for effect, stage in _stages(early, scene, streams, sampler.name):
        y = stage(x)
        found.append(Contribution(effect=effect, value=sampler.on_ticks(y - x, scene.time)))
        x = y
    taken = sampler.take(x, scene.time)
    if not sampler.on_grid:
        found.append(Contribution(effect="sampling", value=taken - sampler.on_ticks(x, scene.time)))
    if late:  # nothing but the sampling limits its band: independent from sample to sample, whatever the motion's grid
        noisy = with_white_noise(taken, late, sampler.period_s, streams.of(f"{sampler.name}_white"))
        found.append(Contribution(effect="white_noise", value=noisy - taken))
        taken = noisy
    amplifier, sensitivity = chain.amplifier, chain.scale.nominal_sensitivity
    reading = amplifier.null + amplifier.gain * sensitivity * taken if amplifier else sensitivity * taken
    held = np.zeros(reading.shape, dtype=bool)
    for c in found:
        if c.effect == "amplifier":  # it changes nothing but what a rail holds
            held |= c.value != 0.0
    if chain.adc:
        reading, beyond = converted(reading, chain.adc)
        found.append(Contribution(effect="adc", value=(reading - chain.null) / chain.gain - taken))
        held |= beyond
    truth = sampler.on_ticks(true, scene.time)
    return reading, Triad(true=truth, contributions=tuple(found), saturated=held)


Stage = Callable[[FloatArray], FloatArray]


def _stages(chain: SensorChain, scene: Scene, streams: Streams, name: str) -> list[tuple[str, Stage]]:
    """Return the effects of a chain that are switched on, in order, up to the converter."""
    arm = lever_arm_force(chain.lever_arm, scene) if chain.lever_arm else None
    stages: list[tuple[str, Stage]] = []
    if arm is not None:
        stages.append(("lever_arm", lambda x: x + np.einsum("nii->ni", arm)))
    stages.append(("scale", lambda x: _scaled(x, chain, arm)))
    if bend := chain.nonlinearity:
        stages.append(("nonlinearity", lambda x: bent(x, bend)))
    if feigning := chain.g_sensitivity:
        stages.append(("g_sensitivity", lambda x: with_g(x, feigning, scene)))
    if offset := chain.offset:
        stages.append(("offset", lambda x: with_offset(x, offset, scene)))
    if warmth := chain.thermal_scale:
        stages.append(("thermal_scale", lambda x: warmed(x, warmth, scene)))
    if drift := chain.rate_drift:
        stages.append(("rate_drift", lambda x: x + drift.error(x, scene.warmth)))
    if young := chain.warm_up:
        stages.append(("warm_up", lambda x: warming_up(x, young, scene)))
    if loop := chain.hysteresis:
        stages.append(("hysteresis", lambda x: with_hysteresis(x, loop, scene)))
    return stages + _noise_stages(chain, scene, streams, name) + _analogue_stages(chain, scene)


def _noise_stages(chain: SensorChain, scene: Scene, streams: Streams, name: str) -> list[tuple[str, Stage]]:
    stages: list[tuple[str, Stage]] = []
    if white := chain.white_noise:
        stages.append(("white_noise", lambda x: with_white_noise(x, white, scene.step_s, streams.of(f"{name}_white"))))
    if flicker := chain.instability:
        stages.append(("instability", lambda x: with_instability(x, flicker, scene, streams.of(f"{name}_instability"))))
    if walk := chain.random_walk:
        stages.append(("random_walk", lambda x: with_random_walk(x, walk, scene, streams.of(f"{name}_walk"))))
    return stages


def _analogue_stages(chain: SensorChain, scene: Scene) -> list[tuple[str, Stage]]:
    stages: list[tuple[str, Stage]] = []
    if amplifier := chain.amplifier:
        stages.append(("amplifier", lambda x: amplified(x, amplifier, chain.scale.nominal_sensitivity)[0]))
    if low_pass := chain.low_pass:
        stages.append(("low_pass", lambda x: low_passed(x, low_pass, scene)))
    return stages


def _scaled(x: FloatArray, chain: SensorChain, arm: FloatArray | None) -> FloatArray:
    if arm is None:
        return scaled(x, chain.scale)
    return scaled(x - np.einsum("nii->ni", arm), chain.scale, arm)  # x holds each sensor's own part already


def _unfelt(samples: int) -> tuple[FloatArray, Triad]:
    """Return the side of accelerometers in a motion whose specific force is not known."""
    unknown = np.full((samples, 3), np.nan)
    return unknown, Triad(true=unknown, contributions=(), saturated=np.zeros((samples, 3), dtype=bool))


def _bridged(motion: Motion) -> Motion:
    """Return a motion whose gaps are bridged by straight lines, so that filters stay finite; the readings are masked later."""
    acceleration = motion.angular_acceleration_b
    rate = _filled(motion.rate_b, motion.time)
    if np.isnan(rate).any():
        raise InputError("motion: wanted known samples, got none; the poses hold gaps only")
    return replace(
        motion,
        rate_b=rate,
        mean_rate_b=np.where(np.isfinite(motion.mean_rate_b), motion.mean_rate_b, rate),
        force_b=_filled(motion.force_b, motion.time),
        angular_acceleration_b=None if acceleration is None else _filled(acceleration, motion.time),
    )


def _filled(x: FloatArray, time: FloatArray) -> FloatArray:
    """Return an array without gaps; unchanged where there is nothing but gaps."""
    known = np.isfinite(x).all(axis=1)
    if not known.any():
        return x
    return np.stack([np.interp(time, time[known], x[known, k]) for k in range(x.shape[1])], axis=1)


def _latest(said: FloatArray, time: FloatArray, ticks: Ticks) -> FloatArray:
    """Return the thermometer's reading that is there when a sample is taken."""
    if ticks.true_s is time:
        return said
    at: FloatArray = said[np.maximum(np.searchsorted(time, ticks.true_s + 1e-12, side="right") - 1, 0)]
    return at
