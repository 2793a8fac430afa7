"""Kernels of simulated hardware: offsets that drift from dwell to dwell, and the servo of a table, sample by sample.

Dwells: normals (U, 3, 2 K + 2 or more) are normal random numbers, and row (N,) selects those of a dwell. start and duration (N,)
are in s. first (S + 1,) contains the first dwell of each session. constants (K,) are in s, sd is (K, 3), and walk (3,) is per
sqrt(s). out is (N, 3).
"""

import math
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.kernels.compilation import compiled, compiled_to_the_bit

# ---- dwells: drift, and state passed from one dwell to the next


@compiled
def add_drift(
    normals: FloatArray, row: IntArray, start: FloatArray, duration: FloatArray, first: IntArray,
    constants: FloatArray, sd: FloatArray, walk: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    # out += mean over each dwell of Gauss-Markov processes and of a random walk that is 0 at the first dwell. One normal number
    # gives the start for the previous dwell, another gives the mean for the start. This is exact for any gap and length.
    count = constants.size
    ahead, spread = np.zeros((count + 1, 3)), np.ones(count + 1)  # mean and variance at the end of the previous dwell
    phi, root, pull, step_sd, fade = np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    last_length = -1.0
    for s in range(first.size - 1):
        ahead[:], spread[:] = 0.0, 1.0
        spread[count] = 0.0
        for j in range(first[s], first[s + 1]):
            length, u = duration[j], normals[row[j]]
            gap = start[j] - start[j - 1] - duration[j - 1] if j > first[s] else math.inf
            if length != last_length:
                last_length = length
                for p in range(count):
                    a = length / constants[p]
                    lost = -math.expm1(-a)
                    phi[p] = lost / a
                    v = 2.0 / a * (1.0 - phi[p]) - phi[p] * phi[p]
                    root[p], pull[p] = math.sqrt(v), phi[p] * lost / v
                    fade[p] = math.exp(-a)
                    step_sd[p] = max(lost * (2.0 - lost) - pull[p] * phi[p] * lost, 0.0)
            for p in range(count):
                keep = math.exp(-gap / constants[p])
                fresh = math.sqrt(keep * keep * (spread[p] - 1.0) + 1.0)
                for i in range(3):
                    x = keep * ahead[p, i] + fresh * u[i, 2 * p]
                    mean = phi[p] * x + root[p] * u[i, 2 * p + 1]
                    out[j, i] += sd[p, i] * mean
                    ahead[p, i] = fade[p] * x + pull[p] * root[p] * u[i, 2 * p + 1]
                spread[p] = step_sd[p]
            p = count
            fresh = math.sqrt(spread[p] + gap) if j > first[s] else 0.0
            for i in range(3):
                if walk[i] > 0.0:
                    x = ahead[p, i] + fresh * u[i, 2 * p]
                    out[j, i] += walk[i] * (x + math.sqrt(length / 3.0) * u[i, 2 * p + 1])
                    ahead[p, i] = x + math.sqrt(0.75 * length) * u[i, 2 * p + 1]
            spread[p] = 0.25 * length


@compiled_to_the_bit
def add_process(
    draws: FloatArray, keep: float, fresh: float, stationary: bool, sd: FloatArray, state: FloatArray, out: FloatArray
) -> None:
    # out (N, 3) += sd y, y_k = keep y_(k-1) + fresh draws_k, y_(-1) = state (3,), updated in place (stationary: y_0 = draws_0)
    for k in range(draws.shape[0]):
        for i in range(3):
            state[i] = (1.0 if k == 0 and stationary else fresh) * draws[k, i] + keep * state[i]
            out[k, i] += sd[i] * state[i]


@compiled_to_the_bit
def filter_columns(b: FloatArray, a: FloatArray, state: FloatArray, x: FloatArray) -> None:
    # each column of x (N, C), in place: y_k = b0 x_k + b1 x_(k-1) + b2 x_(k-2) - a1 y_(k-1) - a2 y_(k-2); state (C, 2) too
    for k in range(x.shape[0]):
        for i in range(x.shape[1]):
            y = state[i, 0] + b[i, 0] * x[k, i]
            state[i, 0] = state[i, 1] + b[i, 1] * x[k, i] - a[i, 1] * y
            state[i, 1] = b[i, 2] * x[k, i] - a[i, 2] * y
            x[k, i] = y


@compiled
def follow_with_play(temp: FloatArray, half_width: float, output: float, out: FloatArray) -> None:
    # out (N,): output of a play operator for a temperature, from its current state
    for k in range(temp.size):
        output = min(max(output, temp[k] - half_width), temp[k] + half_width)
        out[k] = output


# ---- servo

COUNTS_PER_LINE = 4
VOLTS_PER_COUNT, CLIP_V = 3.0e-4, 10.0  # resolution and limit of the controller's converter
ANGLE, RATE, ERROR, SAMPLES = 0, 1, 2, 3  # state: rad, rad/s, counts, samples since the start


class ServoSettings(NamedTuple):
    """Coefficients of the loop: the figures of the note."""

    torque_constant: float = 0.1  # Kt, N m/A, also the back-EMF constant of the motor, V s/rad
    inertia: float = 2.0e-4  # J of motor and table, kg m2
    resistance: float = 2.0  # R of the winding, ohm
    amplifier_gain: float = 4.0  # Ka, A/V
    supply_voltage: float = 12.0  # supply voltage of the amplifier, positive and negative, V
    encoder_lines: int = 10_000  # N
    period_s: float = 1.0e-4  # time between samples, s
    gains: tuple[float, float] = (12.5, 245.0)  # KP and KD, in the units of the controller
    friction: float = 2.0e-3  # friction torque, N m

    @property
    def counts_per_rad(self) -> float:
        """Encoder counts in a radian."""
        return COUNTS_PER_LINE * self.encoder_lines / (2.0 * math.pi)


@compiled
def servo(
    state: FloatArray, loop: ServoSettings, powered: bool, profile: FloatArray, stride: int, out: FloatArray
) -> None:
    # out (n,): angle after each `stride` samples. profile (K, 4) contains start in s, position, speed and acceleration in counts,
    # in the order of time. Its last row is a rest.
    counts_per_rad = COUNTS_PER_LINE * loop.encoder_lines / (2.0 * math.pi)
    proportional, derivative = 4.0 * loop.gains[0], 4.0 * loop.gains[1]
    row = 0
    for k in range(out.size):
        for _ in range(stride):
            time = state[SAMPLES] * loop.period_s
            while row + 1 < profile.shape[0] and profile[row + 1, 0] <= time:
                row += 1
            u = time - profile[row, 0]
            wanted = math.floor(profile[row, 1] + u * (profile[row, 2] + 0.5 * u * profile[row, 3]))
            angle, rate = state[ANGLE], state[RATE]
            error = wanted - math.floor(angle * counts_per_rad) if powered else 0.0
            word = proportional * error + derivative * (error - state[ERROR])
            volts = min(max(VOLTS_PER_COUNT * word, -CLIP_V), CLIP_V)
            back_emf = loop.torque_constant * rate
            most, least = (
                (loop.supply_voltage - back_emf) / loop.resistance,
                (-loop.supply_voltage - back_emf) / loop.resistance,
            )
            torque = loop.torque_constant * min(max(loop.amplifier_gain * volts, least), most) if powered else 0.0
            drive = torque
            if rate != 0.0:
                torque -= math.copysign(loop.friction, rate)
            else:
                torque = 0.0 if abs(torque) <= loop.friction else torque - math.copysign(loop.friction, torque)
            next_rate = rate + torque / loop.inertia * loop.period_s
            if rate * next_rate < 0.0 and abs(drive) <= loop.friction:  # the motor stops and sticks
                next_rate = 0.0
            state[ANGLE] = angle + 0.5 * (rate + next_rate) * loop.period_s
            state[RATE], state[ERROR] = next_rate, error
            state[SAMPLES] += 1.0
        out[k] = state[ANGLE]
