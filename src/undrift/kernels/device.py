"""Kernels of simulated hardware: dwells through a low-pass and a converter, and the servo of an emulated card, sample by sample.

Dwells: steady (N, 3) signal before the low-pass, nominal input units; samples (N,) per dwell; white (3,) standard deviation of
a sample; b, a (3, 3) difference equation of the low-pass, b[:, 0] = 1 and the rest 0 for none; converter (5,) gain and null in
steps, first and last code, rounding: 0 none, 1 nearest, 2 down; rails (2,) unit of the signal. Out: mean and variance of the
samples (N, 3). Servo: state (SIZE,) as indexed below; counts are encoder counts, angles rad, torque N m; tell (m,) the last m
encoder counts, a ring; log_time, log_angle, log_rate (h,) a ring of s, rad, rad/s, one entry each ``stride`` samples.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from undrift.arrays import FloatArray, IntArray

# ---- Kernel of dwells: white noise through the low-pass and the converter about a steady value, averaged.


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def dwell_readings(
    steady: FloatArray, samples: IntArray, burn_in: int, white: FloatArray, b: FloatArray, a: FloatArray,
    converter: FloatArray, rails: FloatArray, rng: np.random.Generator, mean: FloatArray, variance: FloatArray,
) -> None:  # fmt: skip
    gain, null, first, last, rounding = converter[0], converter[1], converter[2], converter[3], converter[4]
    for j in range(steady.shape[0]):
        for i in range(3):
            level, sd, n = steady[j, i], white[i], samples[j]
            b0, b1, b2, a1, a2 = b[i, 0], b[i, 1], b[i, 2], a[i, 1], a[i, 2]
            z1, z2 = (1.0 - b0) * level, (b2 - a2) * level  # the filter rests at the level
            total, squares, pivot = 0.0, 0.0, 0.0
            for k in range(-burn_in, n):
                x = level + (sd * rng.standard_normal() if sd > 0.0 else 0.0)
                x = min(max(x, rails[0]), rails[1])
                y = b0 * x + z1
                z1 = b1 * x - a1 * y + z2
                z2 = b2 * x - a2 * y
                u = null + gain * y
                if rounding == 1.0:
                    u = np.rint(u)
                elif rounding == 2.0:
                    u = math.floor(u)
                if rounding > 0.0:
                    u = min(max(u, first), last)
                if k < 0:
                    continue
                if k == 0:
                    pivot = u
                total += u - pivot
                squares += (u - pivot) * (u - pivot)
            mean[j, i] = pivot + total / n
            variance[j, i] = max(squares - total * total / n, 0.0) / max(n - 1, 1)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def follow(x: FloatArray, keep: FloatArray) -> None:
    # Unit normal numbers x (N, 3) to a first-order Gauss-Markov process of unit variance: x_j = keep x_(j-1) + sqrt(1 - keep^2) x_j
    for j in range(1, x.shape[0]):
        fresh = math.sqrt(1.0 - keep[j - 1] * keep[j - 1])
        for i in range(x.shape[1]):
            x[j, i] = keep[j - 1] * x[j - 1, i] + fresh * x[j, i]


# ---- servo

# state
ANGLE, RATE = 0, 1  # the axis itself: rad, rad/s
REFERENCE, SPEED = 2, 3  # commanded position, counts, and its speed, counts/s
SUM, LAST, ERROR, VOLTAGE, COUNT = 4, 5, 6, 7, 8  # filter: sum and last of the error, error, output V, encoder count
MODE, TARGET = 9, 10  # what the profile does, and its speed (counts/s) or position (counts)
SAMPLES, LOGGED, OVER, TIME, PEAK = 11, 12, 13, 14, 15  # counters; error limit exceeded; s; largest abs error, counts
BEHIND = 16  # by how much smoothing holds the commanded position behind the profile, counts
SIZE = 17

REST, JOG, MOVE, STOPPING, SMOOTHING = 0.0, 1.0, 2.0, 3.0, 4.0  # MODE; the last: the profile is over, smoothing is not
NOTHING, DONE, FORWARD_LIMIT, REVERSE_LIMIT, ERROR_LIMIT = 0, 1, 2, 3, 4  # what ended a call


class Coefficients(NamedTuple):
    """Everything that does not change from sample to sample; see sim/rig/axes.py for the meaning of each."""

    period: float
    proportional: float  # 4 KP
    derivative: float  # 4 KD
    integral: float  # KI / 2
    volts_per_count: float
    clip: float
    torque_constant: float  # Kt, and the back voltage of the motor in V s/rad
    amplifier_gain: float  # Ka
    supply: float  # V behind the amplifier
    resistance: float
    inertia: float
    counts_per_rad: float
    coulomb: float
    viscous: float
    cogging: float
    cogging_periods: float
    acceleration: float
    deceleration: float
    slew: float
    smoothing: float  # IT: part of the way to the profile that a sample takes; 1 takes it all
    error_limit: float
    forward: float
    reverse: float
    forward_at: float  # encoder counts where the limit switches close
    reverse_at: float
    offset: float  # encoder register minus encoder count
    quantise: bool
    powered: bool
    motor_on: bool
    amplifier_good: bool
    encoder_good: bool
    forward_closed: bool
    reverse_closed: bool
    stride: int


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def approach(speed: float, wanted: float, up: float, down: float) -> float:
    # counts/s: speed after one sample; away from zero by at most `up`, toward zero by at most `down`, resting at zero to turn
    if speed != 0.0 and speed * wanted <= 0.0:
        return 0.0 if abs(speed) <= down else speed - math.copysign(down, speed)
    if abs(wanted) >= abs(speed):
        return wanted if abs(wanted - speed) <= up else speed + math.copysign(up, wanted)
    return wanted if abs(wanted - speed) <= down else speed - math.copysign(down, speed)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def profile(state: FloatArray, c: Coefficients) -> bool:
    # one sample of the trapezoid, counts and counts/s, and of its smoothing; True when the motion has just ended
    mode, speed = state[MODE], state[SPEED]
    up, down = c.acceleration * c.period, c.deceleration * c.period
    place = state[REFERENCE] + state[BEHIND]
    over = mode == SMOOTHING
    if mode == JOG:
        speed = approach(speed, state[TARGET], up, down)
    elif mode == STOPPING:
        speed = approach(speed, 0.0, up, down)
        over = speed == 0.0
    elif mode == MOVE:
        left = state[TARGET] - place
        way = 1.0 if left >= 0.0 else -1.0
        along = speed * way
        if abs(left) <= down * c.period and along <= 1.5 * down:
            place, state[SPEED], speed, over = state[TARGET], 0.0, 0.0, True
        else:
            ahead = max(abs(left) - 0.5 * along * c.period, 0.0)
            brake = down * (
                math.sqrt(0.25 + 2.0 * ahead / (down * c.period)) - 0.5
            )  # stops on the target, to the sample
            forward = max(min(along + up, c.slew, brake), along - down)
            speed = way * (min(along + down, 0.0) if along < 0.0 else forward)
    place += 0.5 * (state[SPEED] + speed) * c.period
    state[SPEED] = speed
    behind = (1.0 - c.smoothing) * (place - state[REFERENCE])
    if over:
        over = abs(behind) < 0.5
        behind = 0.0 if over else behind
        state[MODE] = REST if over else SMOOTHING
    state[BEHIND], state[REFERENCE] = behind, place - behind
    return bool(over)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def turn(state: FloatArray, c: Coefficients, voltage: float) -> None:
    # the axis over one sample under a constant voltage: J alpha = Kt i - friction - cogging, i = Ka V within the supply
    angle, rate = state[ANGLE], state[RATE]
    back = c.torque_constant * rate
    current = min(max(c.amplifier_gain * voltage, (-c.supply - back) / c.resistance), (c.supply - back) / c.resistance)
    torque = c.torque_constant * current if c.motor_on and c.powered and c.amplifier_good else 0.0
    if c.cogging != 0.0:
        torque -= c.cogging * math.sin(c.cogging_periods * angle)
    drive = torque
    if c.coulomb > 0.0:
        if rate == 0.0:
            torque = 0.0 if abs(torque) <= c.coulomb else torque - math.copysign(c.coulomb, torque)
        else:
            torque -= math.copysign(c.coulomb, rate)
    alpha = (torque - c.viscous * rate) / c.inertia
    after = rate + alpha * c.period
    if c.coulomb > 0.0 and rate * after < 0.0 and abs(drive) <= c.coulomb:  # comes to rest within the sample and sticks
        state[ANGLE] = angle - 0.5 * rate * rate / alpha
        state[RATE] = 0.0
        return
    state[ANGLE] = angle + c.period * (rate + 0.5 * alpha * c.period)
    state[RATE] = after


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def control(state: FloatArray, c: Coefficients) -> float:
    # V: the sampled filter 4 KP e + 4 KD (e - e_last) + KI/2 sum(e), clipped; zero with the motor off
    register = state[COUNT] + c.offset
    if not (c.powered and c.motor_on):
        state[REFERENCE], state[SPEED], state[SUM], state[LAST], state[ERROR] = register, 0.0, 0.0, 0.0, 0.0
        state[BEHIND] = 0.0
        return 0.0
    reference = math.floor(state[REFERENCE]) if c.quantise else state[REFERENCE]
    error = reference - register
    state[SUM] += error
    word = c.proportional * error + c.derivative * (error - state[LAST]) + c.integral * state[SUM]
    state[LAST], state[ERROR] = error, error
    return float(min(max(c.volts_per_count * word, -c.clip), c.clip))


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def check(state: FloatArray, c: Coefficients, done: bool) -> int:
    # what the card notices at the end of its sample: limits and following error, else the end of a motion
    if state[MODE] == JOG or state[MODE] == MOVE:
        if state[SPEED] > 0.0 and (c.forward_closed or state[COUNT] >= c.forward_at or state[REFERENCE] > c.forward):
            state[MODE] = STOPPING
            return FORWARD_LIMIT
        if state[SPEED] < 0.0 and (c.reverse_closed or state[COUNT] <= c.reverse_at or state[REFERENCE] < c.reverse):
            state[MODE] = STOPPING
            return REVERSE_LIMIT
    over = abs(state[ERROR]) > c.error_limit
    state[PEAK] = max(state[PEAK], abs(state[ERROR]))
    fresh = over and state[OVER] == 0.0
    state[OVER] = 1.0 if over else 0.0
    if fresh:
        return ERROR_LIMIT
    return DONE if done else NOTHING


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def servo(
    state: FloatArray, c: Coefficients, tell: FloatArray,
    log_time: FloatArray, log_angle: FloatArray, log_rate: FloatArray, samples: int,
) -> int:  # fmt: skip
    # up to `samples` samples; returns early with what happened, else NOTHING
    for _ in range(samples):
        if c.encoder_good:
            state[COUNT] = state[ANGLE] * c.counts_per_rad
            if c.quantise:
                state[COUNT] = math.floor(state[COUNT])
        tell[int(state[SAMPLES]) % tell.size] = state[COUNT]
        done = profile(state, c)
        voltage = control(state, c)
        state[VOLTAGE] = voltage
        turn(state, c, voltage)
        state[SAMPLES] += 1.0
        state[TIME] += c.period
        if int(state[SAMPLES]) % c.stride == 0:
            k = int(state[LOGGED]) % log_time.size
            log_time[k], log_angle[k], log_rate[k] = state[TIME], state[ANGLE], state[RATE]
            state[LOGGED] += 1.0
        event = check(state, c, done)
        if event != NOTHING:
            return event
    return NOTHING
