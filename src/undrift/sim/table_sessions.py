"""A session on a rate table with errors, at room temperature: schedule, true motion and readings of a device.

For a dwell at the commanded rate w about the axis e of the case::

    rate        w + servo / duration               about   a = e turned by the mounting, then by the wobble of this dwell
    read rate   counts of the encoder over the dwell, times 1 - table_rate
    force       g (a + level (c a' + s a''))       c, s the means of cosine and sine of the azimuth over the dwell

The device is mounted once for each axis. A table has one tilt and one clock error.

Mean readings are drawn from their distribution. The steady part of a dwell passes every effect of the chain once. The drift of the
offset is simulated with the actual processes (sim/kernels.py). White noise N and codes of a step q add, over n readings in T s::

    sd^2 = N^2 / T + q^2 / (12 n)

The second term applies to noise of 0.4 codes or more, which decorrelates the rounding errors of the readings. The low-pass is
settled at the start of a dwell, and does not change the mean. A level beyond the rails or the codes is clipped.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.programme import Dwell, Protocol, programme_of
from undrift.record import FACES
from undrift.sim.device.effects import RATIO, Past, Scene, SensorChain, effects_of
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.bench import BenchErrors, turned
from undrift.sim.motion.motion import unit_vector
from undrift.units import STANDARD_GRAVITY

# ---- a session and its imposed inputs

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0
FACE, REST, RATE = 0, 1, 2
AXES_B = np.eye(3)
ACROSS_B = np.stack((AXES_B[[1, 2, 0]], AXES_B[[2, 0, 1]]))  # two directions across each


# Dwells of a session at room temperature, one row each: kind is FACE, REST or RATE, axis (0 to 2) points up and is turned about,
# face is the number in FACES, rate is commanded about +axis, rad/s. start_s (since power-on) and duration_s are of the readings.
COLUMNS = np.dtype(
    [(name, int) for name in ("kind", "axis", "face")] + [(name, float) for name in ("rate", "start_s", "duration_s")]
)
TableSession: TypeAlias = "np.recarray[Any, Any]"


@lru_cache(maxsize=256)
def lay_out(protocol: Protocol) -> TableSession:
    """Return the schedule of a protocol's session."""
    if protocol.rates is None:
        raise InputError("study: the protocol has no rates. Add the table [rates].")
    kinds, rows, clock = {"face": FACE, "bracket": REST, "rate": RATE}, list[tuple[float, ...]](), WARMED_UP_S
    for step in programme_of(protocol.with_faces_at_room()).steps:
        if isinstance(step, Dwell):
            axis, face, start_s = "xyz".index(step.up[1]), FACES.index(step.up), clock + step.ramp_s + step.settle_s
            rows.append((kinds[step.purpose], axis, face, step.turn_rate, start_s, step.dwell_s))
        clock += step.duration_s
    return np.array(rows, dtype=COLUMNS).view(np.recarray)


class BenchDraws:
    """Random numbers of a bench, the same for all its sessions, with six kinds of dwells per rate: normal, and start uniform.

    Each rate has its own generator, so that its draws do not depend on the other rates.
    """

    def __init__(self, rng: np.random.Generator, turns: Sequence[np.random.Generator]) -> None:
        draws = [(generator.standard_normal((6, 4)), generator.uniform(size=(6, 2))) for generator in turns]
        # start (6 U, 2) is the phase of the encoder and the azimuth
        normals, self.start = (np.concatenate(arrays) for arrays in zip(*draws, strict=True))
        self.wobble, self.servo = normals[:, :3], normals[:, 3]
        self.mount, self.level = (
            rng.standard_normal((3, 3)),
            rng.standard_normal(2),
        )  # one row of mount per axis that points up
        self.clock, self.face = float(rng.standard_normal(1)[0]), rng.standard_normal((6, 3))


class ImposedDwells(NamedTuple):
    """True motion of N dwells, in order of time."""

    start_s: FloatArray  # (N,), start of each settled dwell, s since power-on
    duration_s: FloatArray  # (N,), duration, s
    rate_b: FloatArray  # (N, 3), steady rate, rad/s
    force_b: FloatArray  # (N, 3), mean specific force, m/s2


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
    dwells = ImposedDwells(start_s=session.start_s, duration_s=length, rate_b=rate[:, None] * about, force_b=force_b)
    return dwells, angle / length * (1.0 - errors.table_rate * draws.clock)


def impose_faces(session: TableSession, errors: BenchErrors, draws: BenchDraws) -> ImposedDwells:
    """Return the true inputs of rests on faces."""
    level = np.array([unit_vector(FACES[face]) for face in session.face])
    up = turned(level, errors.face_tilt * draws.face[session.face])
    return ImposedDwells(
        start_s=session.start_s, duration_s=session.duration_s, rate_b=np.zeros_like(up), force_b=STANDARD_GRAVITY * up
    )


# ---- mean readings of a device

SAMPLE_RATE_HZ = 100.0


def numbers_of_dwell(chain: SensorChain) -> int:
    """Return the number of normal numbers that each sensor of a chain needs for a dwell."""
    return 3 + 2 * (len(chain.instability.time_constants_s) if chain.instability else 0)


def mean_readings(
    device: DeviceModel, name: Literal["gyro", "accel"], dwells: ImposedDwells, normals: FloatArray, row: IntArray
) -> FloatArray:
    """Return the mean readings of a triad over dwells (N, 3), unit of the reading.

    normals (U, 3, ``numbers_of_dwell``), row (N,): dwells of different sessions with the same row have the same draws.
    """
    from undrift.sim.kernels import add_drift

    chain: SensorChain = getattr(device, name)
    level = _steady(chain, dwells.rate_b if name == "gyro" else dwells.force_b, dwells, device.reference_temp_c)
    flicker = chain.instability
    constants: FloatArray = flicker.time_constants_s if flicker else np.empty(0)
    size = flicker.instability * math.sqrt(math.log(RATIO) / math.pi) if flicker else np.zeros(3)
    sd = np.tile(size, (len(constants), 1))
    walk = np.array(chain.random_walk.bias_walk) if chain.random_walk else np.zeros(3)
    session = np.array([0, len(dwells.start_s)])
    add_drift(normals, row, dwells.start_s, dwells.duration_s, session, constants, sd, walk, level)
    noise: FloatArray = chain.white_noise.random_walk if chain.white_noise else np.zeros(3)
    adc, variance = chain.adc, (chain.gain * noise) ** 2 / dwells.duration_s[:, None]
    reading = chain.null + chain.gain * np.clip(level, *chain.rails)
    if adc is None:
        return np.asarray(reading + np.sqrt(variance) * normals[row, :, -1])
    if adc.inl_lsb.any() or (adc.rounding == "toward_zero" and adc.signed):
        raise InputError(
            f"dwells: a linear converter that rounds to nearest or down is required, got {adc.rounding}. Use simulate_device."
        )
    step, down = (1.0 if adc.codes else adc.step), (0.0 if adc.rounding == "nearest" else 0.5)
    samples = np.maximum(np.round(dwells.duration_s * SAMPLE_RATE_HZ), 1.0)[:, None]
    means = reading / step - down + np.sqrt(variance / step**2 + 1.0 / (12.0 * samples)) * normals[row, :, -1]
    return np.asarray(np.clip(means, *adc.code_limits) * step)


def _steady(chain: SensorChain, imposed: FloatArray, dwells: ImposedDwells, reference_temp_c: float) -> FloatArray:
    """Return the signal after the steady effects, nominal input units, (N, 3). Hysteresis is 0 at constant temperature."""
    off: dict[str, Any] = dict.fromkeys(
        ("hysteresis", "white_noise", "instability", "random_walk", "amplifier", "low_pass", "adc")
    )
    steady: SensorChain = replace(chain, **off)
    temp_c = np.full(len(dwells.start_s), ROOM_TEMP_C)
    middle_s = dwells.start_s + 0.5 * dwells.duration_s
    scene = Scene(
        time=middle_s,
        step_s=1.0,
        temp_c=temp_c,
        warmth=temp_c - reference_temp_c,
        age_s=middle_s,
        rate_b=dwells.rate_b,
        angular_acceleration_b=np.zeros_like(dwells.rate_b),
        force_b=dwells.force_b,
    )
    *_, (_, level) = steady.stages(imposed, scene, dict.fromkeys(effects_of(steady), Past(np.random.default_rng(0))))
    return np.array(level)
