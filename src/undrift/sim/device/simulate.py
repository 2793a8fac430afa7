"""Simulate the readings of a device in a motion, and the contribution of each effect.

The effects are applied in the order of ``sim/device/effects.py``. Each effect maps a signal to a signal. The difference is its
contribution, so that truth plus contributions is the reading. The input of a gyroscope that averages between samples is the
rotation vector of each step, divided by its duration, which includes coning.

Each effect has its own generator, seeded with (root, crc32 of its name), so an additional effect does not change the noise of the
others. The root is 128 random bits from the caller's generator.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, bridged, frozen
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.effects import (
    Past,
    Scene,
    SensorChain,
    effects_of,
    sampled,
    step_means,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import Motion

# ---- Streams: a named, independent random generator for each effect.


@dataclass(frozen=True, slots=True)
class Streams:
    """Named random streams of a simulation."""

    root: tuple[int, ...]  # common entropy of the streams, four words of 32 bits

    def of(self, effect: str) -> np.random.Generator:
        """Return the stream of an effect."""
        return np.random.default_rng(np.random.SeedSequence(self.root, spawn_key=(zlib.crc32(effect.encode()),)))

    def pasts(self, chain: SensorChain, name: str) -> dict[str, Past]:
        """Return the initial states of a chain's effects."""
        short = {"white_noise": "white", "random_walk": "walk"}
        return {effect: Past(self.of(f"{name}_{short.get(effect, effect)}")) for effect in effects_of(chain)}


def draw_streams(rng: np.random.Generator) -> Streams:
    """Return new streams, with a root of 128 bits from the caller's generator."""
    return Streams(tuple(int(word) for word in rng.integers(0, 2**32, 4, dtype=np.uint64)))


# ---- Simulation of a motion.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedTriad:
    """Results of a simulation for a triad, M samples."""

    # (M, 3), rate or specific force at the body's origin, rad/s or m/s2, frame b (the mean over the step if the
    # gyroscope averages)
    true: FloatArray
    # contribution of each effect in the order of the chain, (M, 3), rad/s or m/s2, in nominal input units. Together with the
    # truth they sum up to (reading - null) / gain. "sampling" is the error of other sampling times.
    contributions: dict[str, FloatArray]
    saturated: BoolArray  # (M, 3), True if a rail or the end of the codes limits the reading

    def of(self, effect: str) -> FloatArray:
        """Return the contribution of an effect, (M, 3)."""
        return self.contributions.get(effect, np.zeros_like(self.true))

    def before(self, effect: str) -> FloatArray:
        """Return the signal before an effect, (M, 3), or the final signal if the device does not have the effect."""
        names = list(self.contributions)
        before = names[: names.index(effect)] if effect in names else names
        return self.true + sum(self.contributions[name] for name in before if name != "adc")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """A record and its truth, M samples."""

    record: Record  # readings of the device, NaN if the motion is unknown
    gyro: SimulatedTriad
    accel: SimulatedTriad
    true_time: FloatArray  # (M,), true times of the samples on the clock of the motion, s


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
        Random generator of the noise, with a separate stream for each effect.
    temp_c : float or array, shape (N,), optional
        Temperature of the board, degC, by default the reference temperature.
    power_on_s : float
        Time since power-on at the first sample, s.

    Returns
    -------
    Simulated
        Record in frame s, raw, with the thermometer's column; truth and contributions.

    Raises
    ------
    InputError
        If the temperature has another number of samples, or if the motion lacks data that an effect requires.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> trial = undrift.simulate_trial("step", undrift.random_device(rng), rng=rng)
    >>> again = undrift.simulate_device(undrift.random_device(rng), trial.motion, rng=rng)
    >>> len(again.record) == len(trial.record)
    True
    """
    n = len(motion)
    temp = model.reference_temp_c if temp_c is None else temp_c
    true_temp = frozen(np.full(n, temp) if np.ndim(temp) == 0 else temp, (n,), "temp_c")
    is_known = motion.valid > 0.0
    motion = motion if is_known.all() else _bridged(motion)
    scene = Scene(
        time=motion.time,
        step_s=float((motion.time[-1] - motion.time[0]) / (n - 1)),
        temp_c=true_temp,
        warmth=true_temp - model.reference_temp_c,
        age_s=motion.time - motion.time[0] + power_on_s,
        rate_b=motion.rate_b,
        angular_acceleration_b=motion.angular_acceleration_b,
        force_b=motion.force_b,
    )
    streams, clock = draw_streams(rng), model.sampling
    stamped, taken = ticks = clock.ticks(motion.time, streams.of("jitter"))
    rate = motion.mean_rate_b if clock.gyro_averaging == "interval" else motion.rate_b
    gyro_raw, gyro = _triad(model, "gyro", rate, scene, streams, ticks)
    has_force = bool(np.isfinite(motion.force_b).all())
    if model.gyro.g_sensitivity and not has_force:
        raise InputError(
            "g-sensitivity: the motion has no specific force. Switch the effect off, or use poses with positions."
        )
    if has_force:
        force = step_means(motion.force_b, motion.time) if clock.accel_averaging == "interval" else motion.force_b
        accel_raw, accel = _triad(model, "accel", force, scene, streams, ticks)
    else:
        accel_raw = np.full((len(taken), 3), np.nan)
        accel = SimulatedTriad(true=accel_raw, contributions={}, saturated=np.zeros(accel_raw.shape, dtype=bool))
    thermometer, past = model.thermometer, Past(streams.of("thermometer"))
    temp_readings = thermometer.shown(thermometer.felt(scene, past), past.rng)
    is_valid = np.interp(taken, motion.time, is_known.astype(float)) > 1.0 - 1e-9
    latest = np.maximum(np.searchsorted(scene.time, taken + 1e-12, side="right") - 1, 0)
    record = Record(
        time=stamped,
        gyro=np.where(is_valid[:, None], gyro_raw, np.nan),
        accel=np.where(is_valid[:, None], accel_raw, np.nan) if has_force else None,
        temp_c=temp_readings if clock.on_grid else temp_readings[latest],
        gyro_unit=model.gyro.unit,
        accel_unit=model.accel.unit,
        device=model.serial,
    )
    return Simulated(record=record, gyro=gyro, accel=accel, true_time=taken)


def _triad(
    model: DeviceModel, name: Literal["gyro", "accel"], true: FloatArray, scene: Scene, streams: Streams,
    ticks: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, SimulatedTriad]:  # fmt: skip
    """Return the readings of a triad and their truth."""
    chain: SensorChain = getattr(model, name)
    clock, (stamped, taken_s), pasts = model.sampling, ticks, streams.pasts(chain, name)

    def on_ticks(x: FloatArray) -> FloatArray:  # linear interpolation keeps the sum of contributions exact
        return x if clock.on_grid else np.stack([np.interp(taken_s, scene.time, column) for column in x.T], axis=1)

    # without a low-pass, the noise is independent from sample to sample on any grid of the motion
    noise = chain.white_noise if chain.low_pass is None and not clock.on_grid else None
    contributions, x = dict[str, FloatArray](), true
    for effect, y in (replace(chain, white_noise=None) if noise else chain).stages(x, scene, pasts):
        contributions[effect] = on_ticks(y - x)
        x = y
    taken = x
    if not clock.on_grid:
        averaging, delay_s = getattr(clock, f"{name}_averaging"), getattr(clock, f"{name}_delay_s")
        taken = sampled(x, scene.time, taken_s, delay_s, averaging)
        contributions["sampling"] = taken - on_ticks(x)
    if noise:
        period_s = float((stamped[-1] - stamped[0]) / (len(stamped) - 1))
        noisy = noise.apply(taken, replace(scene, step_s=period_s), pasts["white_noise"])
        contributions["white_noise"] = noisy - taken
        taken = noisy
    reading, saturated = chain.converted(taken)
    if "amplifier" in contributions:  # the amplifier only clips at its rails
        saturated |= contributions["amplifier"] != 0.0
    if chain.adc:
        contributions["adc"] = (reading - chain.null) / chain.gain - taken
    return reading, SimulatedTriad(true=on_ticks(true), contributions=contributions, saturated=saturated)


def _bridged(motion: Motion) -> Motion:
    """Return a motion with linear interpolation in its gaps, so that filter outputs stay finite. The readings are masked later."""

    def filled(x: FloatArray) -> FloatArray:
        return bridged(motion.time, x) if np.isfinite(x).all(axis=1).any() else x

    rate, swing = filled(motion.rate_b), motion.angular_acceleration_b
    if np.isnan(rate).any():
        raise InputError("motion: all samples are unknown. Use poses that contain more than gaps.")
    return replace(
        motion,
        rate_b=rate,
        mean_rate_b=np.where(np.isfinite(motion.mean_rate_b), motion.mean_rate_b, rate),
        force_b=filled(motion.force_b),
        angular_acceleration_b=None if swing is None else filled(swing),
    )


# ---- Readings chunk by chunk: if the device's clock has the relative error c, reading k is taken at k / (rate (1 + c)).

# Environment at times (n,), s, with the step before each: rate, angular acceleration, force, mean rate over the step (n, 3), and
# the temperature of the board (n,)
Seen = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Surroundings = Callable[[FloatArray, float], Seen]


class SimulatedDevice:
    """A device that is read at even steps of its clock. The state of its effects is passed from one chunk to the next."""

    def __init__(
        self, model: DeviceModel, surroundings: Surroundings, seed: int, start_s: float, *, power_on_s: float = 3600.0
    ) -> None:
        self.model, self.rate = model, model.sampling.sample_rate_hz or 100.0
        self.step_s = 1.0 / (self.rate * (1.0 + model.sampling.clock_error))
        self._surroundings, self._power_on_s = surroundings, power_on_s
        self._next = 1 + int(start_s / self.step_s + 1e-6)  # reading k is taken at k steps
        streams = draw_streams(np.random.default_rng(seed))
        self._pasts = {name: streams.pasts(getattr(model, name), name) for name in ("gyro", "accel")}
        for name, pasts in self._pasts.items():
            if flicker := getattr(model, name).instability:
                past = pasts["instability"]
                past.state = past.rng.standard_normal((len(flicker.time_constants_s), 3))
        self._thermometer = Past(streams.of("thermometer"))

    def read(self, now: float) -> tuple[IntArray, FloatArray]:
        """Return numbers and values of the readings up to the current time: (n,), (n, 7) of both triads and the thermometer."""
        counts = np.arange(self._next, int(now / self.step_s + 1e-6) + 1)
        if not counts.size:
            return counts, np.empty((0, 7))
        self._next = int(counts[-1]) + 1
        times, model = np.minimum(counts * self.step_s, now), self.model
        rate, acceleration, force, mean_rate, temp_c = self._surroundings(times, self.step_s)
        scene = Scene(
            time=times,
            step_s=self.step_s,
            temp_c=temp_c,
            warmth=temp_c - model.reference_temp_c,
            age_s=times + self._power_on_s,
            rate_b=rate,
            angular_acceleration_b=acceleration,
            force_b=force,
        )
        readings = []
        for name, true in (
            ("gyro", mean_rate if model.sampling.gyro_averaging == "interval" else rate),
            ("accel", force),
        ):
            chain: SensorChain = getattr(model, name)
            *_, (_, x) = chain.stages(true, scene, self._pasts[name])
            readings.append(chain.converted(x)[0])
        felt_c = model.thermometer.felt(scene, self._thermometer)
        return counts, np.column_stack((*readings, model.thermometer.shown(felt_c, self._thermometer.rng)))
