"""Acceptance test of a servo table: the following error in a step wave, with the card's gains and sample period.

The wave is the preliminary test of the note: +-90 deg/s for 60 s, with an error below 0.012 deg. The error is commanded minus
actual angle, as the controller reports it. It is evaluated from 50 ms after each run-up, and at rest at the end.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from undrift.base.clock import Clock
from undrift.errors import InputError, RigTimeout, check_positive
from undrift.findings import finding
from undrift.model import Verdict
from undrift.rig.lock import uninterrupted
from undrift.rig.rig import Position, ServoReport, achieved_turn_rate
from undrift.units import RADIAN_PER_DEGREE

Report = Callable[[str], None]

HALF_PERIOD_S = 1.0  # duration of the wave in one direction, table s
SETTLE_S = 0.05  # time after a run-up before the error is evaluated, s
READ_S = 0.01  # time between two readings of the error, s


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """The step wave and its limit."""

    turn_rate: float = 90.0 * RADIAN_PER_DEGREE  # rad/s, in either direction
    duration_s: float = 60.0  # table s
    acceleration: float = 2300.0 * RADIAN_PER_DEGREE  # rad/s2
    limit: float = 0.012 * RADIAN_PER_DEGREE  # rad, largest following error

    def __post_init__(self) -> None:
        check_positive(self, "rig check", "Set a positive value", "turn_rate", "duration_s", "acceleration", "limit")
        if not self.turn_rate / self.acceleration < 0.2 * HALF_PERIOD_S:
            raise InputError(
                f"rig check: run-ups must be shorter than {0.2 * HALF_PERIOD_S:g} s, got "
                f"{self.turn_rate / self.acceleration:.3g} s. Choose a larger acceleration or a slower wave."
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCheck:
    """Following error of a table in a step wave, with its servo."""

    identity: str
    servo: ServoReport
    rms: float  # rad, at steady rate
    largest: float  # rad, at steady rate and at rest at the end
    turn_rate: float  # rad/s, mean of the achieved rates in either direction
    verdict: Verdict  # bad if `largest` is beyond the limit


def check_rig(rig: Any, clock: Clock, settings: CheckSettings, report: Report = lambda line: None) -> RigCheck:
    """Check a table, which must report its servo and its following error, and close it at rest with its motor off."""
    try:
        if not hasattr(rig, "read_servo"):
            raise InputError(
                f"rig check: {rig.identify()} has no encoder, so it reports no following error. Check a servo table."
            )
        rig.limits.check_turn_rate(settings.turn_rate)
        rig.limits.check_travel(settings.turn_rate * HALF_PERIOD_S)
        return _run_wave(rig, clock, settings, report)
    finally:
        with uninterrupted():
            rig.close()


def _run_wave(rig: Any, clock: Clock, settings: CheckSettings, report: Report) -> RigCheck:
    """Turn in alternating directions, and read the following error continuously."""
    errors = list[float]()
    rates = list[float]()
    identity, servo = rig.identify(), rig.read_servo()
    rig.enable(True)
    rig.set_acceleration(settings.acceleration)
    turn_rate, ramp_s = settings.turn_rate, settings.turn_rate / settings.acceleration
    end = clock.now() + settings.duration_s
    while (start := clock.now()) < end:
        report(f"step wave, {end - start:.0f} s left")
        positions = list[Position]()
        rig.turn_for(turn_rate, HALF_PERIOD_S)
        clock.wait(ramp_s + SETTLE_S)
        while clock.now() - start < HALF_PERIOD_S - ramp_s:
            errors.append(abs(rig.following_error()))
            positions.append(rig.position())
            clock.wait(READ_S)
        if len(positions) > 2:
            rates.append(abs(achieved_turn_rate(positions).turn_rate))
        rig.stop()
        turn_rate = -turn_rate
    if not rates:
        raise RigTimeout("rig check: no position was read at steady rate. Check the link and the table.")
    largest = max(*errors, abs(rig.following_error()))
    numbers = {"largest_deg": largest / RADIAN_PER_DEGREE, "limit_deg": settings.limit / RADIAN_PER_DEGREE}
    return RigCheck(
        identity=identity,
        servo=servo,
        rms=math.sqrt(float(np.mean(np.square(errors)))),
        largest=largest,
        turn_rate=float(np.mean(rates)),
        verdict=Verdict.of(*([finding("rig_check.error", "fail", **numbers)] if largest > settings.limit else [])),
    )
