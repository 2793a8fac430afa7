"""Simulate: the readings of a device in a motion, and the contribution of each effect.

The effects are composed left to right in the order of ``sim/device/effects.py``. Each stage maps a signal to a signal; the
difference is the contribution of the effect, so that truth plus contributions is the reading. A gyroscope that averages between
samples is driven by the rotation vector of each step over its duration, which loses no coning.

Dwells have a shorter way: the effects that are steady over a dwell are taken once a dwell; white noise, low-pass, rails and
converter run over every sample of it, in a kernel; the flicker of the offset is exact from dwell to dwell for processes slower
than a dwell and drawn afresh, as its mean over the dwell, for faster ones. The low-pass has settled when a dwell begins.

Each effect draws from a generator of its own, seeded by (root, crc32 of its name), so that adding an effect changes no other's
noise. The root is drawn from the caller's generator, 128 bits at a time.
"""

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, frozen
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.effects import (
    RATIO,
    Averaging,
    BiasInstability,
    Sampling,
    Scene,
    SensorChain,
    Ticks,
    amplified,
    bent,
    converted,
    difference_equation,
    instant,
    interval,
    lever_arm_force,
    low_passed,
    scaled,
    scene_of,
    step_means,
    thermometer_reading,
    ticks_of,
    warmed,
    warming_up,
    with_g,
    with_hysteresis,
    with_instability,
    with_offset,
    with_random_walk,
    with_white_noise,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import Motion
from undrift.units import STANDARD_GRAVITY

# ---- Streams: one independent source of random numbers per effect, named, so that adding an effect changes no other's noise.


@dataclass(frozen=True, slots=True)
class Streams:
    """Named random streams of one simulation."""

    root: tuple[int, ...]  # Entropy shared by the streams, four words of 32 bits

    def of(self, effect: str) -> np.random.Generator:
        """Return the stream of one effect."""
        key = zlib.crc32(effect.encode())
        return np.random.default_rng(np.random.SeedSequence(self.root, spawn_key=(key,)))


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
class Triad:
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
    shown = thermometer_reading(model.thermometer, scene, streams.of("thermometer"))
    seen = np.interp(ticks.true_s, motion.time, known.astype(float)) > 1.0 - 1e-9
    record = Record(
        time=ticks.stamped_s,
        gyro=np.where(seen[:, None], gyro_raw, np.nan),
        accel=np.where(seen[:, None], accel_raw, np.nan) if felt else None,
        temp_c=_latest(shown, scene.time, ticks),
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
    if felt := chain.g_sensitivity:
        stages.append(("g_sensitivity", lambda x: with_g(x, felt, scene)))
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
    if white := chain.white_noise:
        stages.append(("white_noise", lambda x: with_white_noise(x, white, scene.step_s, streams.of(f"{name}_white"))))
    if flicker := chain.instability:
        stages.append(("instability", lambda x: with_instability(x, flicker, scene, streams.of(f"{name}_instability"))))
    if walk := chain.random_walk:
        stages.append(("random_walk", lambda x: with_random_walk(x, walk, scene, streams.of(f"{name}_walk"))))
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


def _latest(shown: FloatArray, time: FloatArray, ticks: Ticks) -> FloatArray:
    """Return the thermometer's reading that is there when a sample is taken."""
    if ticks.true_s is time:
        return shown
    return np.asarray(shown[np.maximum(np.searchsorted(time, ticks.true_s + 1e-12, side="right") - 1, 0)])


# ---- Dwells

BURN_IN_S = 0.3  # a second-order filter at 3 Hz has forgotten its start to 1 %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dwells:
    """What is imposed, N dwells in the order of time."""

    start_s: FloatArray  # (N,), when each begins, settled, s since power-on
    duration_s: FloatArray  # (N,), s
    rate_b: FloatArray  # (N, 3), steady rate, rad/s
    force_b: FloatArray  # (N, 3), mean specific force, m/s2
    temp_c: FloatArray  # (N,), temperature of the board, degC

    def __post_init__(self) -> None:
        n = len(self.temp_c)
        for name, width in (("start_s", ()), ("duration_s", ()), ("rate_b", (3,)), ("force_b", (3,)), ("temp_c", ())):
            shape = (n, *width)
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Dwells.{name}"))
        if n < 2 or (np.diff(self.start_s) <= 0.0).any() or (self.duration_s <= 0.0).any():
            raise InputError(
                f"dwells: wanted two or more, one after the other, each longer than 0 s, got {n}; sort them by their start"
            )

    def __len__(self) -> int:
        return len(self.temp_c)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellReadings:
    """Readings of the device over N dwells."""

    gyro: FloatArray  # (N, 3), mean reading, raw unit
    accel: FloatArray
    gyro_variance: FloatArray  # (N, 3), variance of the samples, raw unit squared
    accel_variance: FloatArray
    samples: IntArray  # (N,), in each dwell
    temp_c: FloatArray  # (N,), reading of the thermometer, settled, degC


def simulate_dwells(
    device: DeviceModel,
    dwells: Dwells,
    *,
    rng: np.random.Generator,
    sample_rate_hz: float = 100.0,
    felt: BoolArray | None = None,
) -> DwellReadings:
    """Return the mean readings of a device over dwells; accelerometers of dwells that are not felt get one sample."""
    streams = draw_streams(rng)
    samples = np.maximum(np.round(dwells.duration_s * sample_rate_hz).astype(np.int64), 1)
    steady = simulate_device(
        _steady(device), _motion(dwells), rng=streams.of("steady"), temp_c=dwells.temp_c, power_on_s=dwells.start_s[0]
    )
    shown = steady.record.temp_c if steady.record.temp_c is not None else dwells.temp_c
    gyro, accel = steady.record.gyro, steady.record.accel
    found: list[FloatArray] = []
    for name, chain, level in (("gyro", device.gyro, gyro), ("accel", device.accel, accel)):
        if level is None:
            raise InputError(f"dwells: wanted {name} readings of the device, got none")
        flicker = _flicker(chain.instability, dwells, streams.of(f"{name}_instability"))
        lengths = samples if name == "gyro" or felt is None else np.where(felt, samples, 1)
        found += _averaged(chain, level + flicker, lengths, sample_rate_hz, streams, name)
    return DwellReadings(
        gyro=found[0], gyro_variance=found[1], accel=found[2], accel_variance=found[3], samples=samples, temp_c=shown
    )


def _steady(device: DeviceModel) -> DeviceModel:
    """Return the device with all that is steady over a dwell, in nominal input units: no noise, filter, gain, rails or codes."""

    def bare(chain: SensorChain, unit: str) -> SensorChain:
        nothing = replace(
            chain, white_noise=None, instability=None, random_walk=None, amplifier=None, low_pass=None, adc=None
        )
        return replace(nothing, unit=unit, scale=replace(chain.scale, nominal_sensitivity=1.0))

    return replace(
        device,
        gyro=bare(device.gyro, "rad/s"),
        accel=bare(device.accel, "m/s2"),
        sampling=Sampling(),
        thermometer=replace(device.thermometer, lag_s=0.0),
    )


def _motion(dwells: Dwells) -> Motion:
    n = len(dwells)
    middle = dwells.start_s + 0.5 * dwells.duration_s
    return Motion(
        time=middle,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        rate_b=dwells.rate_b,
        mean_rate_b=dwells.rate_b,
        force_b=dwells.force_b,
        gravity_m_s2=STANDARD_GRAVITY,
        moving=np.zeros(n),
        angular_acceleration_b=np.zeros((n, 3)),
    )


def _flicker(effect: BiasInstability | None, dwells: Dwells, rng: np.random.Generator) -> FloatArray:
    """Return the mean of the flicker over each dwell, nominal input units, shape (N, 3)."""
    from undrift.kernels.device import follow

    n = len(dwells)
    total = np.zeros((n, 3))
    if effect is None:
        return total
    sd = effect.instability * math.sqrt(math.log(RATIO) / math.pi)
    middle, length = dwells.start_s + 0.5 * dwells.duration_s, dwells.duration_s
    for constant in effect.time_constants_s.tolist():
        share = length / constant
        shrink = np.sqrt(np.maximum(2.0 / share * (1.0 + np.expm1(-share) / share), 0.0))  # of the mean over a dwell
        draws = rng.standard_normal((n, 3))
        if constant > float(np.median(length)):
            follow(draws, np.exp(-np.diff(middle) / constant))
        total += sd * shrink[:, None] * draws
    return total


def _averaged(
    chain: SensorChain, level: FloatArray, samples: IntArray, sample_rate_hz: float, streams: Streams, name: str
) -> list[FloatArray]:
    from undrift.kernels.device import dwell_readings

    step_s = 1.0 / sample_rate_hz
    white = chain.white_noise.random_walk / math.sqrt(step_s) if chain.white_noise else np.zeros(3)
    b, a = np.tile([1.0, 0.0, 0.0], (3, 1)), np.tile([1.0, 0.0, 0.0], (3, 1))
    if chain.low_pass:
        for axis in range(3):
            b[axis], a[axis] = difference_equation(
                float(chain.low_pass.cutoff_hz[axis]), float(chain.low_pass.quality[axis]), step_s
            )
    mean, variance = np.empty_like(level), np.empty_like(level)
    burn_in = round(BURN_IN_S * sample_rate_hz) if chain.low_pass else 0
    dwell_readings(
        np.ascontiguousarray(level), samples, burn_in, np.array(white), b, a, _converter(chain), _rails(chain),
        streams.of(f"{name}_white"), mean, variance,
    )  # fmt: skip
    return [mean, variance]


def _converter(chain: SensorChain) -> FloatArray:
    """Gain and null in the unit of the reading, first and last code, rounding."""
    if chain.adc is None or not chain.adc.codes:
        return np.array([chain.gain, chain.null, -np.inf, np.inf, 0.0])
    first, last = chain.adc.code_limits
    rounding = {"nearest": 1.0, "floor": 2.0}.get(chain.adc.rounding)
    if rounding is None and not chain.adc.signed:
        rounding = 2.0  # codes from 0 up: toward zero is down
    if rounding is None or chain.adc.inl_lsb.any():
        raise InputError(
            f"dwells: wanted a straight converter that rounds to nearest or down, got {chain.adc.rounding}; use simulate_device"
        )
    return np.array([chain.gain, chain.null, float(first), float(last), rounding])


def _rails(chain: SensorChain) -> FloatArray:
    if chain.amplifier is None:
        return np.array([-np.inf, np.inf])
    total = chain.amplifier.gain * chain.scale.nominal_sensitivity
    return np.array(
        [(chain.amplifier.low - chain.amplifier.null) / total, (chain.amplifier.high - chain.amplifier.null) / total]
    )
