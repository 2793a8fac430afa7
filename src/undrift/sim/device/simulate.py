"""Simulate: the readings of a device in a motion, and the contribution of each effect.

The effects are composed left to right in the order of ``sim/device/effects.py``. Each stage maps a signal to a signal; the
difference is the contribution of the effect, so that truth plus contributions is the reading. A gyroscope that averages between
samples is driven by the rotation vector of each step over its duration, which loses no coning.

Each effect draws from a generator of its own, seeded by (root, crc32 of its name), so that adding an effect changes no other's
noise. The root is drawn from the caller's generator, 128 bits at a time.
"""

import zlib
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.effects import (
    Past,
    Scene,
    SensorChain,
    converted,
    effects_of,
    instant,
    interval,
    scene_of,
    step_means,
    ticks_of,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import Motion

# ---- Streams: one independent source of random numbers per effect, named, so that adding an effect changes no other's noise.


@dataclass(frozen=True, slots=True)
class Streams:
    """Named random streams of one simulation."""

    root: tuple[int, ...]  # Entropy shared by the streams, four words of 32 bits

    def of(self, effect: str) -> np.random.Generator:
        """Return the stream of one effect."""
        return np.random.default_rng(np.random.SeedSequence(self.root, spawn_key=(zlib.crc32(effect.encode()),)))

    def pasts(self, chain: SensorChain, name: str) -> dict[str, Past]:
        """Return what the effects of a chain begin with."""
        short = {"white_noise": "white", "random_walk": "walk"}
        return {effect: Past(self.of(f"{name}_{short.get(effect, effect)}")) for effect in effects_of(chain)}


def draw_streams(rng: np.random.Generator) -> Streams:
    """Return fresh streams; the caller's generator moves on by one draw of 128 bits."""
    return Streams(tuple(int(word) for word in rng.integers(0, 2**32, 4, dtype=np.uint64)))


# ---- A motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contribution:
    """What one effect adds to a triad's readings."""

    effect: str  # Its name: a field of ``SensorChain``, or sampling
    value: FloatArray  # (M, 3), rad/s or m/s2, in nominal input units


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedTriad:
    """One triad's side of a simulation, M samples."""

    # (M, 3), rate or specific force at the body's origin, rad/s or m/s2, frame b: of the step for a gyroscope that
    # averages
    true: FloatArray
    # In the order of the chain: truth and contributions add up to (reading - null) / gain
    contributions: tuple[Contribution, ...]
    saturated: BoolArray  # (M, 3), true where a rail or the end of the codes held the reading

    def of(self, effect: str) -> FloatArray:
        """Return the contribution of one effect, (M, 3)."""
        return next((c.value for c in self.contributions if c.effect == effect), np.zeros_like(self.true))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """A record and the truth about it, M samples.

    Parameters
    ----------
    record : Record
        Readings of the device; NaN where the motion is unknown.
    gyro, accel : SimulatedTriad
        Truth, contributions, saturation.
    temp_c : array, shape (M,)
        True temperature of the board, degC.
    true_time : array, shape (M,)
        When the samples were taken, s, on the clock of the motion.
    """

    record: Record
    gyro: SimulatedTriad
    accel: SimulatedTriad
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
    known = motion.valid > 0.0
    motion = motion if known.all() else _bridged(motion)
    scene = scene_of(motion, true_temp, model.reference_temp_c, power_on_s)
    streams, clock = draw_streams(rng), model.sampling
    stamped, taken = ticks = ticks_of(clock, motion.time, streams.of("jitter"))
    rate = motion.mean_rate_b if clock.gyro_averaging == "interval" else motion.rate_b
    gyro_raw, gyro = _triad(model, "gyro", rate, scene, streams, ticks)
    felt = bool(np.isfinite(motion.force_b).all())
    if model.gyro.g_sensitivity and not felt:
        raise InputError(
            "g-sensitivity: wanted a motion with specific force, got one without positions; switch the effect off, or give "
            "poses with positions"
        )
    if felt:
        force = step_means(motion.force_b, motion.time) if clock.accel_averaging == "interval" else motion.force_b
        accel_raw, accel = _triad(model, "accel", force, scene, streams, ticks)
    else:
        accel_raw = np.full((len(taken), 3), np.nan)
        accel = SimulatedTriad(true=accel_raw, contributions=(), saturated=np.zeros(accel_raw.shape, dtype=bool))
    thermometer, past = model.thermometer, Past(streams.of("thermometer"))
    shown = thermometer.shown(thermometer.felt(scene, past), past.rng)
    seen = np.interp(taken, motion.time, known.astype(float)) > 1.0 - 1e-9
    latest = np.maximum(np.searchsorted(scene.time, taken + 1e-12, side="right") - 1, 0)
    record = Record(
        time=stamped,
        gyro=np.where(seen[:, None], gyro_raw, np.nan),
        accel=np.where(seen[:, None], accel_raw, np.nan) if felt else None,
        temp_c=shown if clock.on_grid else shown[latest],
        gyro_unit=model.gyro.unit,
        accel_unit=model.accel.unit,
        device=model.serial,
    )
    temp_taken = true_temp if clock.on_grid else np.interp(taken, scene.time, true_temp)
    return Simulated(record=record, gyro=gyro, accel=accel, temp_c=temp_taken, true_time=taken)


def filtered(record: Record, device: DeviceModel) -> Record:
    """Return a record that was simulated without low-pass and converter behind those of a device that samples evenly."""
    time, behind = record.time, dict[str, FloatArray]()
    step_s = float((time[-1] - time[0]) / (len(time) - 1))
    scene = Scene(time=time, step_s=step_s, temp_c=time, warmth=time, age_s=time)
    for name in ("gyro", "accel"):
        chain: SensorChain = getattr(device, name)
        if (x := getattr(record, name)) is not None:
            x = x if chain.low_pass is None else chain.low_pass.apply(x, scene, Past(np.random.default_rng(0)))
            behind[name] = x if chain.adc is None else converted(x, chain.adc)[0]
    return replace(record, gyro=behind["gyro"], accel=behind.get("accel"))


def _triad(
    model: DeviceModel, name: Literal["gyro", "accel"], true: FloatArray, scene: Scene, streams: Streams,
    ticks: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, SimulatedTriad]:  # fmt: skip
    """Return the readings of one triad and the truth about them."""
    chain: SensorChain = getattr(model, name)
    clock, (stamped, taken_s), pasts = model.sampling, ticks, streams.pasts(chain, name)

    def on_ticks(x: FloatArray) -> FloatArray:  # straight between neighbours: linear, so that sums stay sums
        return x if clock.on_grid else np.stack([np.interp(taken_s, scene.time, column) for column in x.T], axis=1)

    late = chain.white_noise if chain.low_pass is None and not clock.on_grid else None
    found: list[Contribution] = []
    x = true
    for effect, y in (replace(chain, white_noise=None) if late else chain).stages(x, scene, pasts):
        found.append(Contribution(effect=effect, value=on_ticks(y - x)))
        x = y
    taken = x
    if not clock.on_grid:
        averaging = interval if getattr(clock, f"{name}_averaging") == "interval" else instant
        taken = averaging(x, scene.time, taken_s, getattr(clock, f"{name}_delay_s"))
        found.append(Contribution(effect="sampling", value=taken - on_ticks(x)))
    if late:  # nothing but the sampling limits its band: independent from sample to sample, whatever the motion's grid
        period_s = float((stamped[-1] - stamped[0]) / (len(stamped) - 1))
        noisy = late.apply(taken, replace(scene, step_s=period_s), pasts["white_noise"])
        found.append(Contribution(effect="white_noise", value=noisy - taken))
        taken = noisy
    reading = chain.reading(taken)
    held = np.zeros(reading.shape, dtype=bool)
    for c in found:
        if c.effect == "amplifier":  # it changes nothing but what a rail holds
            held |= c.value != 0.0
    if chain.adc:
        reading, beyond = converted(reading, chain.adc)
        found.append(Contribution(effect="adc", value=(reading - chain.null) / chain.gain - taken))
        held |= beyond
    return reading, SimulatedTriad(true=on_ticks(true), contributions=tuple(found), saturated=held)


def _bridged(motion: Motion) -> Motion:
    """Return a motion whose gaps are bridged by straight lines, so that filters stay finite; the readings are masked later."""
    rate = _filled(motion.rate_b, motion.time)
    if np.isnan(rate).any():
        raise InputError("motion: wanted known samples, got none; the poses hold gaps only")
    swing = motion.angular_acceleration_b
    return replace(
        motion,
        rate_b=rate,
        mean_rate_b=np.where(np.isfinite(motion.mean_rate_b), motion.mean_rate_b, rate),
        force_b=_filled(motion.force_b, motion.time),
        angular_acceleration_b=None if swing is None else _filled(swing, motion.time),
    )


def _filled(x: FloatArray, time: FloatArray) -> FloatArray:
    """Return an array without gaps; unchanged where there is nothing but gaps."""
    known = np.isfinite(x).all(axis=1)
    if not known.any():
        return x
    return np.stack([np.interp(time, time[known], x[known, k]) for k in range(x.shape[1])], axis=1)
