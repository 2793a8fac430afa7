"""Dwells: what a device reads on average while it is turned at a steady rate, or rests, for a while.

The effects that are steady over a dwell (scale, non-linearity, g-sensitivity, offset, thermal scale, rate drift, warm-up,
hysteresis) are those of ``simulate_device``, a sample a dwell. White noise, low-pass, rails and converter run over every sample of
the dwell, in a kernel. The flicker of the offset is exact from dwell to dwell for processes slower than a dwell, and drawn afresh,
as its mean over the dwell, for faster ones. The low-pass has settled when a dwell begins.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, frozen
from undrift.errors import InputError
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.instability import RATIO, BiasInstability
from undrift.sim.device.low_pass import difference_equation
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.streams import Streams, draw_streams
from undrift.units import STANDARD_GRAVITY

BURN_IN_S = 0.3  # a second-order filter at 3 Hz has forgotten its start to 1 %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dwells:
    """What is imposed, N dwells in the order of time.

    Parameters
    ----------
    start_s : array, shape (N,)
        When each begins, settled, s since power-on.
    duration_s : array, shape (N,)
        s.
    rate_b : array, shape (N, 3)
        Steady rate, rad/s.
    force_b : array, shape (N, 3)
        Mean specific force, m/s2.
    temp_c : array, shape (N,)
        Temperature of the board, degC.
    """

    start_s: FloatArray
    duration_s: FloatArray
    rate_b: FloatArray
    force_b: FloatArray
    temp_c: FloatArray

    def __post_init__(self) -> None:
        n = len(self.temp_c)
        for name, shape in (
            ("start_s", (n,)),
            ("duration_s", (n,)),
            ("rate_b", (n, 3)),
            ("force_b", (n, 3)),
            ("temp_c", (n,)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Dwells.{name}"))
        if n < 2 or (np.diff(self.start_s) <= 0.0).any() or (self.duration_s <= 0.0).any():
            raise InputError(
                f"dwells: wanted two or more, one after the other, each longer than 0 s, got {n}; sort them by their start"
            )

    def __len__(self) -> int:
        return len(self.temp_c)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellReadings:
    """What the device said, N dwells.

    Parameters
    ----------
    gyro, accel : array, shape (N, 3)
        Mean reading, raw unit.
    gyro_variance, accel_variance : array, shape (N, 3)
        Variance of the samples, raw unit squared.
    samples : array of int, shape (N,)
        In each dwell.
    temp_c : array, shape (N,)
        What the thermometer said, settled, degC.
    """

    gyro: FloatArray
    accel: FloatArray
    gyro_variance: FloatArray
    accel_variance: FloatArray
    samples: IntArray
    temp_c: FloatArray


def simulate_dwells(
    device: DeviceModel,
    dwells: Dwells,
    *,
    rng: np.random.Generator,
    sample_rate_hz: float = 100.0,
    felt: BoolArray | None = None,
) -> DwellReadings:
    """Return what a device reads over dwells.

    Parameters
    ----------
    device : DeviceModel
        The truth.
    dwells : Dwells
        What is imposed.
    rng : Generator
        Draws the noise, each effect from a stream of its own.
    sample_rate_hz : float
        Hz.
    felt : array of bool, shape (N,), optional
        Dwells whose accelerometer readings are wanted; those of the others are one sample long. All where not given.

    Returns
    -------
    DwellReadings
        Means, variances, temperature.
    """
    streams = draw_streams(rng)
    samples = np.maximum(np.round(dwells.duration_s * sample_rate_hz).astype(np.int64), 1)
    steady = simulate_device(
        _steady(device), _motion(dwells), rng=streams.of("steady"), temp_c=dwells.temp_c, power_on_s=dwells.start_s[0]
    )
    said = steady.record.temp_c if steady.record.temp_c is not None else dwells.temp_c
    gyro, accel = steady.record.gyro, steady.record.accel
    found: list[FloatArray] = []
    for name, chain, level in (("gyro", device.gyro, gyro), ("accel", device.accel, accel)):
        if level is None:
            raise InputError(f"dwells: wanted {name} readings of the device, got none")
        flicker = _flicker(chain.instability, dwells, streams.of(f"{name}_instability"))
        lengths = samples if name == "gyro" or felt is None else np.where(felt, samples, 1)
        found += _averaged(chain, level + flicker, lengths, sample_rate_hz, streams, name)
    return DwellReadings(
        gyro=found[0], gyro_variance=found[1], accel=found[2], accel_variance=found[3], samples=samples, temp_c=said
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
    from undrift.kernels.dwells import follow

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
    from undrift.kernels.dwells import dwell_readings

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
