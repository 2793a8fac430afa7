"""Acceptance test of a servo table: the following error in a step wave, with the card's gains and sample period.

The wave is the preliminary test of the note: +-90 deg/s for 60 s, with an error below 0.012 deg. The error is commanded minus
actual angle, as the controller reports it. It is evaluated from 50 ms after each run-up, and at rest at the end. During a run-up
the error increases with the acceleration, so it is reported separately.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np

from undrift.base.clock import Clock
from undrift.errors import InputError, RigTimeout
from undrift.rig.lock import uninterrupted
from undrift.rig.rig import Position, Rig, ServoReport, achieved_turn_rate
from undrift.units import RADIAN_PER_DEGREE

HALF_PERIOD_S = 1.0  # time in one direction, table s
ACCELERATION = 2300.0 * RADIAN_PER_DEGREE  # acceleration of the run-ups, rad/s2
SETTLE_S = 0.05  # time after a run-up before the error is evaluated, s
READ_S = 0.01  # time between two readings of the error, s


class ServoRig(Rig, Protocol):
    """A rig that reports its servo and its following error."""

    def read_servo(self) -> ServoReport:
        """Return the servo's gains and sample period."""

    def following_error(self) -> float:
        """Return commanded minus actual angle, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCheck:
    """Following error of a table in a step wave, with its servo."""

    identity: str
    servo: ServoReport
    rms: float  # rad, at steady rate
    largest: float  # largest error at steady rate and at rest at the end, rad
    in_run_up: float  # largest error during a run-up, rad
    turn_rate: float  # mean of the achieved rates in both directions, rad/s


def check_rig(
    rig: Rig, clock: Clock, *, turn_rate: float, duration_s: float, report: Callable[[str], None] = lambda line: None
) -> RigCheck:
    """Turn a table at a rate, rad/s, in alternating directions for a time, table s. Close it at rest with its motor off."""
    try:
        if not hasattr(rig, "read_servo"):
            raise InputError(
                f"rig check: {rig.identify()} has no encoder, so it reports no following error. Check a servo table."
            )
        fastest = 0.2 * HALF_PERIOD_S * ACCELERATION
        if not 0.0 < turn_rate < fastest or not duration_s > 0.0:
            raise InputError(
                f"rig check: the rate must be 0 to {fastest / RADIAN_PER_DEGREE:g} deg/s and the duration positive, got "
                f"{turn_rate / RADIAN_PER_DEGREE:g} deg/s for {duration_s:g} s. Correct them."
            )
        rig.limits.check_turn_rate(turn_rate)
        rig.limits.check_travel(turn_rate * HALF_PERIOD_S)
        return _run_wave(cast(ServoRig, rig), clock, turn_rate, duration_s, report)
    finally:
        with uninterrupted():
            rig.close()


def _run_wave(
    rig: ServoRig, clock: Clock, turn_rate: float, duration_s: float, report: Callable[[str], None]
) -> RigCheck:
    """Read the following error continuously during the wave."""
    steady, run_up, rates = list[float](), list[float](), list[float]()
    identity, servo = rig.identify(), rig.read_servo()
    rig.enable(True)
    rig.set_acceleration(ACCELERATION)
    ramp_s, end = turn_rate / ACCELERATION, clock.now() + duration_s
    while (start := clock.now()) < end:
        report(f"step wave, {end - start:.0f} s left")
        positions = list[Position]()
        rig.turn_for(turn_rate, HALF_PERIOD_S)
        while (elapsed_s := clock.now() - start) < HALF_PERIOD_S - ramp_s:
            is_steady = elapsed_s >= ramp_s + SETTLE_S
            (steady if is_steady else run_up).append(abs(rig.following_error()))
            positions += [rig.position()] if is_steady else []
            clock.wait(READ_S)
        if len(positions) > 2:
            rates.append(abs(achieved_turn_rate(positions).turn_rate))
        rig.stop()
        turn_rate = -turn_rate
    if not rates:
        raise RigTimeout("rig check: no position was read at steady rate. Check the link and the table.")
    return RigCheck(
        identity=identity,
        servo=servo,
        rms=math.sqrt(float(np.mean(np.square(steady)))),
        largest=max(*steady, abs(rig.following_error())),
        in_run_up=max(run_up, default=math.nan),
        turn_rate=float(np.mean(rates)),
    )
