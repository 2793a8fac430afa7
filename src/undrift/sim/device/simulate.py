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
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, frozen
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.effects import (
    RATIO,
    BiasInstability,
    Past,
    Sampling,
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
        accel = Triad(true=accel_raw, contributions=(), saturated=np.zeros(accel_raw.shape, dtype=bool))
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


def _triad(
    model: DeviceModel, name: Literal["gyro", "accel"], true: FloatArray, scene: Scene, streams: Streams,
    ticks: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, Triad]:  # fmt: skip
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
    return reading, Triad(true=on_ticks(true), contributions=tuple(found), saturated=held)


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
    ).record
    found: dict[str, FloatArray] = {}
    for name, level in (("gyro", steady.gyro), ("accel", steady.accel)):
        if level is None:
            raise InputError(f"dwells: wanted {name} readings of the device, got none")
        chain = getattr(device, name)
        level = level + _flicker(chain.instability, dwells, streams.of(f"{name}_instability"))
        lengths = samples if name == "gyro" or felt is None else np.where(felt, samples, 1)
        draws = streams.of(f"{name}_white")
        found[name], found[f"{name}_variance"] = _averaged(chain, level, lengths, sample_rate_hz, draws)
    temp_c = dwells.temp_c if steady.temp_c is None else steady.temp_c
    return DwellReadings(**found, samples=samples, temp_c=temp_c)


def _steady(device: DeviceModel) -> DeviceModel:
    """Return the device with all that is steady over a dwell, in nominal input units: no noise, filter, gain, rails or codes."""
    off: dict[str, Any] = dict.fromkeys(
        ("white_noise", "instability", "random_walk", "amplifier", "low_pass", "adc"), None
    )
    gyro, accel = (
        replace(chain, **off, unit=unit, scale=replace(chain.scale, nominal_sensitivity=1.0))
        for chain, unit in ((device.gyro, "rad/s"), (device.accel, "m/s2"))
    )
    thermometer = replace(device.thermometer, lag_s=0.0)
    return replace(device, gyro=gyro, accel=accel, sampling=Sampling(), thermometer=thermometer)


def _motion(dwells: Dwells) -> Motion:
    n = len(dwells)
    return Motion(
        time=dwells.start_s + 0.5 * dwells.duration_s,
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

    total = np.zeros((len(dwells), 3))
    if effect is None:
        return total
    sd = effect.instability * math.sqrt(math.log(RATIO) / math.pi)
    middle, length = dwells.start_s + 0.5 * dwells.duration_s, dwells.duration_s
    for constant in effect.time_constants_s.tolist():
        share = length / constant
        shrink = np.sqrt(np.maximum(2.0 / share * (1.0 + np.expm1(-share) / share), 0.0))  # of the mean over a dwell
        draws = rng.standard_normal(total.shape)
        if constant > float(np.median(length)):
            follow(draws, np.exp(-np.diff(middle) / constant))
        total += sd * shrink[:, None] * draws
    return total


def _averaged(
    chain: SensorChain, level: FloatArray, samples: IntArray, sample_rate_hz: float, draws: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    from undrift.kernels.device import dwell_readings

    step_s = 1.0 / sample_rate_hz
    white = chain.white_noise.random_walk / math.sqrt(step_s) if chain.white_noise else np.zeros(3)
    b = a = np.tile([1.0, 0.0, 0.0], (3, 1))
    if chain.low_pass:
        b, a = (np.array(side) for side in zip(*chain.low_pass.equations(step_s), strict=True))
    mean, variance = np.empty_like(level), np.empty_like(level)
    burn_in = round(BURN_IN_S * sample_rate_hz) if chain.low_pass else 0
    dwell_readings(
        np.ascontiguousarray(level), samples, burn_in, np.array(white), b, a, _converter(chain), chain.rails, draws,
        mean, variance,
    )  # fmt: skip
    return mean, variance


def _converter(chain: SensorChain) -> FloatArray:
    """Gain and null in the unit of the reading, first and last code, rounding."""
    if chain.adc is None or not chain.adc.codes:
        return np.array([chain.gain, chain.null, -np.inf, np.inf, 0.0])
    rounding = {"nearest": 1.0, "floor": 2.0}.get(chain.adc.rounding)
    if rounding is None and not chain.adc.signed:
        rounding = 2.0  # codes from 0 up: toward zero is down
    if rounding is None or chain.adc.inl_lsb.any():
        raise InputError(
            f"dwells: wanted a straight converter that rounds to nearest or down, got {chain.adc.rounding}; use simulate_device"
        )
    return np.array([chain.gain, chain.null, *chain.adc.code_limits, rounding])
