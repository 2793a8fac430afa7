"""A session on a rate table with errors, at room temperature: schedule, true motion and readings of a device.

For a dwell at the commanded rate w about the axis e of the case::

    rate        w + servo / duration               about   a = e turned by the mounting, then by the wobble of this dwell
    read rate   counts of the encoder over the dwell, times 1 - table_rate
    force       g (a + level (c a' + s a''))       c, s the means of cosine and sine of the azimuth over the dwell

The device is mounted once for each axis. A table has one tilt and one clock error.

Mean readings are drawn from their distribution. The steady part of a dwell passes every effect of the chain once. The drift of the
offset is simulated with the actual processes (kernels/device.py). The n readings of a dwell are then a stationary normal series,
filtered white noise with covariance r_l. A converter rounds it to codes, q = u + e(u), where e is the sawtooth of rounding. With
E_k = exp(-2 pi^2 k^2 r_0) and a_k = (-1)^k / (pi k)::

    e(u)      = sum_k a_k sin(2 pi k u)                          rounding to nearest, u in codes
    E q       = m + b(m),    b(m) = sum_k a_k E_k sin(2 pi k m)
    var mean  = sum_l w_l cov(q_0, q_l),     w_0 = 1 / n, w_l = 2 (n - l) / n^2
    cov(u, e) = r_l b'(m)                                        [1]_
    cov(e, e) = sum_kj a_k a_j / 2 (c_-(k, j) cos 2 pi (k - j) m - c_+(k, j) cos 2 pi (k + j) m),
    c_-+      = exp(-2 pi^2 (r_0 k^2 + r_0 j^2 -+ 2 r_l k j)) - E_k E_j

The low-pass is settled at the start of a dwell. A level beyond the rails or the codes is clipped, without the effect of its noise.

References
----------
.. [1] B. Widrow and I. Kollar, "Quantization Noise", Cambridge University Press, 2008.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np

from undrift.arrays import FloatArray, IntArray, Shape, freeze
from undrift.errors import InputError
from undrift.programme import Dwell, Protocol, programme_of
from undrift.record import FACES
from undrift.sim.bench_errors import BenchDraws, BenchErrors
from undrift.sim.device.effects import RATIO, Past, Scene, SensorChain, effects_of, play
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import unit_vector
from undrift.units import STANDARD_GRAVITY

# ---- a session and what is imposed

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0
FACE, REST, RATE = 0, 1, 2
AXES_B = np.eye(3)
ACROSS_B = np.stack((AXES_B[[1, 2, 0]], AXES_B[[2, 0, 1]]))  # two directions across each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableSession:
    """N dwells of a session at room temperature."""

    kind: IntArray  # (N,), FACE, REST or RATE
    axis: IntArray  # (N,), axis of the case that points up and that the table turns about, 0 to 2
    face: IntArray  # (N,), number of the face in FACES that points up
    rate: FloatArray  # (N,), commanded about +axis, rad/s
    start_s: FloatArray  # (N,), of the readings, s since power-on
    duration_s: FloatArray  # (N,), of the readings, s

    def chosen(self, *kinds: int) -> "TableSession":
        """Return the dwells of some kinds."""
        rows = np.isin(self.kind, kinds)
        return TableSession(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


@lru_cache(maxsize=256)
def lay_out(protocol: Protocol) -> TableSession:
    """Lay out the session of a protocol in time."""
    if protocol.turn_rate_step <= 0.0:
        raise InputError("study: the protocol has no rates. State turn_rate_step and the two ends.")
    dwells, starts, clock = list[Dwell](), list[float](), WARMED_UP_S
    for step in programme_of(replace(protocol, faces_at="room")).steps:
        if isinstance(step, Dwell):
            dwells.append(step)
            starts.append(clock + step.ramp_s + step.settle_s)
        clock += step.duration_s
    kinds = {"face": FACE, "bracket": REST, "rate": RATE}
    return TableSession(
        kind=np.array([kinds[dwell.purpose] for dwell in dwells]),
        axis=np.array(["xyz".index(dwell.up[1]) for dwell in dwells]),
        face=np.array([FACES.index(dwell.up[:2]) for dwell in dwells]),
        rate=np.array([dwell.turn_rate for dwell in dwells]),
        start_s=np.array(starts),
        duration_s=np.array([dwell.dwell_s for dwell in dwells]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImposedDwells:
    """True motion of N dwells, in order of time."""

    start_s: Annotated[FloatArray, Shape("n")]  # (N,), begin of each, settled, s since power-on
    duration_s: Annotated[FloatArray, Shape("n")]  # (N,), s
    rate_b: Annotated[FloatArray, Shape("n", 3)]  # (N, 3), steady rate, rad/s
    force_b: Annotated[FloatArray, Shape("n", 3)]  # (N, 3), mean specific force, m/s2
    temp_c: Annotated[FloatArray, Shape("n")]  # (N,), temperature of the board, degC

    def __post_init__(self) -> None:
        freeze(self)
        if len(self) < 2 or (np.diff(self.start_s) <= 0.0).any() or (self.duration_s <= 0.0).any():
            raise InputError(f"dwells: expected two or more, one after the other, longer than 0 s, got {len(self)}.")

    def __len__(self) -> int:
        return len(self.temp_c)


def impose_turns(
    session: TableSession, errors: BenchErrors, draws: BenchDraws, row: IntArray
) -> tuple[ImposedDwells, FloatArray]:
    """Return the true motion of rests and rates, and the encoder's rates (N,). `row` (N,) is the number of the draws."""
    axis, length = session.axis, session.duration_s
    seat = turned(AXES_B, errors.mount_tilt * draws.mount)
    about = turned(seat[axis], errors.wobble * draws.wobble[row])
    rate = session.rate + np.where(session.kind == RATE, errors.servo * draws.servo[row] / length, 0.0)
    angle, phase, azimuth = rate * length, draws.start[row, 0], 2.0 * np.pi * draws.start[row, 1]
    if errors.encoder_lines:
        count = 2.0 * np.pi / (4.0 * errors.encoder_lines)
        angle = (np.floor(phase + angle / count) - np.floor(phase)) * count
    middle, mean = azimuth + 0.5 * rate * length, np.sinc(rate * length / (2.0 * np.pi))
    tilt = errors.level * float(np.hypot(*draws.level))
    across = np.cos(middle)[:, None] * ACROSS_B[0, axis] + np.sin(middle)[:, None] * ACROSS_B[1, axis]
    force_b = STANDARD_GRAVITY * (seat[axis] + tilt * mean[:, None] * across)
    return _imposed(session, rate[:, None] * about, force_b), angle / length * (1.0 - errors.table_rate * draws.clock)


def impose_faces(session: TableSession, errors: BenchErrors, draws: BenchDraws) -> ImposedDwells:
    """Return what rests on faces truly impose."""
    level = np.array([unit_vector(FACES[face]) for face in session.face])
    up = turned(level, errors.face_tilt * draws.face[session.face])
    return _imposed(session, np.zeros_like(up), STANDARD_GRAVITY * up)


def _imposed(session: TableSession, rate_b: FloatArray, force_b: FloatArray) -> ImposedDwells:
    temp_c = np.full(len(session.kind), ROOM_TEMP_C)
    return ImposedDwells(
        start_s=session.start_s, duration_s=session.duration_s, rate_b=rate_b, force_b=force_b, temp_c=temp_c
    )


def turned(axis_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return unit vectors turned by small rotations, (N, 3)."""
    off = axis_b + np.cross(tilt, axis_b)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


# ---- mean readings of a device

SAMPLE_RATE_HZ = 100.0
BLOCK = 8192  # number of dwells per block, which fits into the processor's cache


def numbers_of_dwell(chain: SensorChain) -> int:
    """Return how many normal numbers each sensor of a chain needs for a dwell."""
    return 3 + 2 * (len(chain.instability.time_constants_s) if chain.instability else 0)


def mean_readings(
    device: DeviceModel, name: Literal["gyro", "accel"], dwells: ImposedDwells, normals: FloatArray, row: IntArray
) -> FloatArray:
    """Return the mean readings of a triad over dwells (N, 3), unit of the reading.

    normals (U, 3, ``numbers_of_dwell``), row (N,): dwells of different sessions with one row have the same draws.
    """
    from undrift.kernels.device import add_drift

    chain: SensorChain = getattr(device, name)
    level = _steady(chain, dwells.rate_b if name == "gyro" else dwells.force_b, dwells, device.reference_temp_c)
    flicker = chain.instability
    constants: FloatArray = flicker.time_constants_s if flicker else np.empty(0)
    size = flicker.instability * math.sqrt(math.log(RATIO) / math.pi) if flicker else np.zeros(3)
    sd = np.tile(size, (len(constants), 1))
    walk = np.array(chain.random_walk.bias_walk) if chain.random_walk else np.zeros(3)
    session = np.array([0, len(dwells)])
    add_drift(normals, row, dwells.start_s, dwells.duration_s, session, constants, sd, walk, level)
    reading = chain.null + chain.gain * np.clip(level, *chain.rails)
    return _converted(chain, reading, dwells.duration_s, normals, row)


def _steady(chain: SensorChain, imposed: FloatArray, dwells: ImposedDwells, reference_temp_c: float) -> FloatArray:
    """Return what every effect that is steady makes of dwells, nominal input units, (N, 3)."""
    off: dict[str, Any] = dict.fromkeys(
        ("hysteresis", "white_noise", "instability", "random_walk", "amplifier", "low_pass", "adc")
    )
    steady: SensorChain = replace(chain, **off)
    level, pasts = np.empty_like(imposed), dict.fromkeys(effects_of(steady), Past(np.random.default_rng(0)))
    for start in range(0, len(dwells), BLOCK):
        block = slice(start, start + BLOCK)
        age_s, temp_c = dwells.start_s[block] + 0.5 * dwells.duration_s[block], dwells.temp_c[block]
        scene = Scene(
            time=age_s,
            step_s=1.0,
            temp_c=temp_c,
            warmth=temp_c - reference_temp_c,
            age_s=age_s,
            rate_b=dwells.rate_b[block],
            angular_acceleration_b=np.zeros_like(dwells.rate_b[block]),
            force_b=dwells.force_b[block],
        )
        *_, (_, level[block]) = steady.stages(imposed[block], scene, pasts)
    if loop := chain.hysteresis:  # last effect, and the only one with a state
        follower = play(dwells.temp_c, loop.play_k)
        level += np.outer((follower - dwells.temp_c) / loop.play_k, loop.amplitude)
    return level


# ---- what noise and converter make of the mean

NODES = 256  # of the tables over the fraction of a code
MOST_TERMS = 64  # of the sawtooth: enough from noise of 0.04 codes on


def _converted(
    chain: SensorChain, reading: FloatArray, duration_s: FloatArray, normals: FloatArray, row: IntArray
) -> FloatArray:
    """Return the mean of noisy, rounded readings about a level, (N, 3), with the last of the normal numbers each."""
    from undrift.kernels.device import mean_codes

    adc, n = chain.adc, np.maximum(np.round(duration_s * SAMPLE_RATE_HZ), 1.0)
    step, shift = (adc.step if adc and not adc.codes else 1.0), 0.0
    if adc:
        if adc.inl_lsb.any() or (adc.rounding == "toward_zero" and adc.signed):
            raise InputError(
                f"dwells: a straight converter that rounds to nearest or down is required, got {adc.rounding}. "
                "Use simulate_device."
            )
        shift = 0.0 if adc.rounding == "nearest" else 0.5
        reading = np.clip(reading / step, *adc.code_limits) - shift
    samples, which = np.unique(n, return_inverse=True)
    bias, sd, silent = np.zeros((len(samples), 3, NODES + 1)), np.zeros((len(samples), 3, NODES + 1)), []
    for axis in range(3):
        covariance = (chain.gain / step if adc else chain.gain) ** 2 * _autocovariance(chain, axis)
        if adc and covariance[0] == 0.0:
            silent.append(axis)
            continue
        for k, count in enumerate(samples):
            if adc:
                bias[k, axis], sd[k, axis] = code_means(covariance, count)
            else:
                sd[k, axis] = math.sqrt(_weights(covariance, count) @ covariance)
    out = np.empty_like(reading)
    mean_codes(reading, normals, row, which, bias, sd, out)
    out[:, silent] = np.rint(reading[:, silent])
    return np.clip(out, *adc.code_limits) * step if adc else out


@lru_cache(maxsize=64)  # a chain meets several sets of sessions
def _autocovariance(chain: SensorChain, axis: int) -> FloatArray:
    """Return the covariance of readings l samples apart by filtered white noise, (L,), nominal input units squared."""
    from scipy.signal import lfilter

    step_s = 1.0 / SAMPLE_RATE_HZ
    variance = (chain.white_noise.random_walk[axis] ** 2 / step_s) if chain.white_noise else 0.0
    if chain.low_pass is None:
        return np.array([variance])
    b, a = chain.low_pass.equations(step_s)[axis]
    slowest = math.pi * chain.low_pass.cutoff_hz[axis] / max(chain.low_pass.quality[axis], 0.5)  # part to fade, 1/s
    answer = lfilter(b, a, np.eye(1, max(round(16.0 / (slowest * step_s)), 8))[0])
    lags: FloatArray = variance * np.correlate(answer, answer, "full")[len(answer) - 1 :]
    return lags[: int(np.flatnonzero(np.abs(lags) >= 1e-7 * lags[0])[-1]) + 1]


def _weights(covariance: FloatArray, samples: float) -> FloatArray:
    """Return how much each lag counts in the variance of a mean."""
    weights: FloatArray = 2.0 * np.maximum(samples - np.arange(len(covariance)), 0.0) / samples**2
    weights[0] *= 0.5
    return weights


def code_means(covariance: FloatArray, samples: float) -> tuple[FloatArray, FloatArray]:
    """Return bias and standard deviation of the mean of rounded readings over the fraction of a code, (NODES + 1,) each.

    covariance (L,) of the readings, codes squared.
    """
    return _code_means(covariance.tobytes(), samples)


@lru_cache(maxsize=4096)  # a unit's filters have the same noise whatever else of it is switched off
def _code_means(covariance_bytes: bytes, samples: float) -> tuple[FloatArray, FloatArray]:
    covariance = np.frombuffer(covariance_bytes)
    weights, variance = _weights(covariance, samples), float(covariance[0])
    near = float(covariance[1] / variance) if len(covariance) > 1 else 0.0
    terms = min(max(math.ceil(0.64 / math.sqrt(variance * max(1.0 - near, 1e-6))), 4), MOST_TERMS)
    k, phase = np.arange(1, terms + 1), 2.0 * math.pi * np.linspace(0.0, 1.0, NODES + 1)
    saw, shrink = (-1.0) ** k / (math.pi * k), np.exp(-2.0 * math.pi**2 * variance * k**2)
    sine, cosine = np.sin(np.outer(phase, k)), np.cos(np.outer(phase, k))
    bias, slope = sine @ (saw * shrink), cosine @ (2.0 * math.pi * k * saw * shrink)
    rounding_variance = 1.0 / 12.0 + cosine @ ((-1.0) ** k / (math.pi * k) ** 2 * shrink) - bias**2
    total = (weights @ covariance) * (1.0 + 2.0 * slope) + weights[0] * rounding_variance
    (first, two), after = k[np.array(np.triu_indices(terms))], covariance[1:]  # pairs, each once
    square, product = 2.0 * math.pi**2 * variance * (first**2 + two**2), 4.0 * math.pi**2 * first * two
    pair = np.where(first == two, 0.5, 1.0) * saw[first - 1] * saw[two - 1]
    for sign, order in ((1.0, two - first), (-1.0, first + two)):
        counts = square - (sign * after).max(initial=0.0) * product < 60.0  # others vanish: exp(-60)
        exponent, joint = square[counts], sign * np.multiply.outer(after, product[counts])
        shared = weights[1:] @ np.exp(joint - exponent) - weights[1:].sum() * np.exp(-exponent)
        size = np.bincount(order[counts], sign * pair[counts] * shared, 1)
        total = total + np.cos(np.outer(phase, np.arange(len(size)))) @ size
    return bias, np.sqrt(np.maximum(total, 0.0))
