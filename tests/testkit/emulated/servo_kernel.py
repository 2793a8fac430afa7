"""Kernel of the emulated servo card, sample by sample.

state (SIZE,) as indexed below; counts are encoder counts, angles rad, torque N m; log_time, log_angle, log_rate (h,) a ring of
s, rad, rad/s, one entry each ``stride`` samples.
"""

import math
from typing import NamedTuple

from numba import njit

from undrift.arrays import FloatArray

# state
ANGLE, RATE = 0, 1  # the axis itself: rad, rad/s
REFERENCE, SPEED = 2, 3  # commanded position, counts, and its speed, counts/s
SUM, LAST, ERROR, VOLTAGE, COUNT = 4, 5, 6, 7, 8  # filter: sum and last of the error, error, output V, encoder count
MODE, TARGET = 9, 10  # what the profile does, and its speed (counts/s) or position (counts)
SAMPLES, LOGGED, OVER, TIME = 11, 12, 13, 14  # counters; error limit exceeded; s
SIZE = 15

REST, JOG, MOVE, STOPPING = 0.0, 1.0, 2.0, 3.0  # MODE
NOTHING, DONE, FORWARD_LIMIT, REVERSE_LIMIT, ERROR_LIMIT = 0, 1, 2, 3, 4  # what ended a call


class Coefficients(NamedTuple):
    """Everything that does not change from sample to sample; see axes.py for the meaning of each."""

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
    quantise: bool
    stride: int
    # A healthy card with its motor off
    acceleration: float = 256_000.0
    deceleration: float = 256_000.0
    slew: float = 25_000.0
    error_limit: float = 16_384.0
    forward: float = 2_147_483_647.0
    reverse: float = -2_147_483_648.0
    offset: float = 0.0  # encoder register minus encoder count
    powered: bool = True
    motor_on: bool = False
    amplifier_good: bool = True
    encoder_good: bool = True
    forward_closed: bool = False
    reverse_closed: bool = False


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
    # one sample of the trapezoid, counts and counts/s; True when the motion has just ended
    mode, speed, over = state[MODE], state[SPEED], False
    up, down = c.acceleration * c.period, c.deceleration * c.period
    place = state[REFERENCE]
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
    state[SPEED], state[REFERENCE] = speed, place
    if over:
        state[MODE] = REST
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
        if state[SPEED] > 0.0 and (c.forward_closed or state[REFERENCE] > c.forward):
            state[MODE] = STOPPING
            return FORWARD_LIMIT
        if state[SPEED] < 0.0 and (c.reverse_closed or state[REFERENCE] < c.reverse):
            state[MODE] = STOPPING
            return REVERSE_LIMIT
    over = abs(state[ERROR]) > c.error_limit
    fresh = over and state[OVER] == 0.0
    state[OVER] = 1.0 if over else 0.0
    if fresh:
        return ERROR_LIMIT
    return DONE if done else NOTHING


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def servo(
    state: FloatArray, c: Coefficients, log_time: FloatArray, log_angle: FloatArray, log_rate: FloatArray, samples: int
) -> int:
    # up to `samples` samples; returns early with what happened, else NOTHING
    for _ in range(samples):
        if c.encoder_good:
            state[COUNT] = state[ANGLE] * c.counts_per_rad
            if c.quantise:
                state[COUNT] = math.floor(state[COUNT])
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
