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
from undrift.errors import InputError, RigTimeout, check_positive
from undrift.findings import finding, told_apart
from undrift.model import Verdict
from undrift.rig.lock import uninterrupted
from undrift.rig.rig import Position, Rig, ServoReport, achieved_turn_rate
from undrift.units import RADIAN_PER_DEGREE

Report = Callable[[str], None]

SETTLE_S = 0.05  # time after a run-up before the error is evaluated, s
READ_S = 0.01  # time between two readings of the error, s


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """The step wave and its limit."""

    turn_rate: float = 90.0 * RADIAN_PER_DEGREE  # rad/s, in either direction
    duration_s: float = 60.0  # table s
    acceleration: float = 2300.0 * RADIAN_PER_DEGREE  # rad/s2
    limit: float = 0.012 * RADIAN_PER_DEGREE  # rad, largest following error
    half_period_s: float = 1.0  # table s, in one direction

    def __post_init__(self) -> None:
        names = ("turn_rate", "duration_s", "acceleration", "limit", "half_period_s")
        check_positive(self, "rig check", "Set a positive value", *names)
        if not self.turn_rate / self.acceleration < 0.2 * self.half_period_s:
            raise InputError(
                f"rig check: run-ups must be shorter than {0.2 * self.half_period_s:g} s, got "
                f"{self.turn_rate / self.acceleration:.3g} s. Choose a larger acceleration or a slower wave."
            )


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
    largest: float  # rad, at steady rate and at rest at the end
    in_run_up: float  # rad, largest during a run-up
    turn_rate: float  # rad/s, mean of the achieved rates in either direction
    verdict: Verdict  # bad if `largest` is beyond the limit


def check_rig(rig: Rig, clock: Clock, settings: CheckSettings, report: Report = lambda line: None) -> RigCheck:
    """Check a table and close it at rest with its motor off."""
    try:
        if not hasattr(rig, "read_servo"):
            raise InputError(
                f"rig check: {rig.identify()} has no encoder, so it reports no following error. Check a servo table."
            )
        rig.limits.check_turn_rate(settings.turn_rate)
        rig.limits.check_travel(settings.turn_rate * settings.half_period_s)
        return _run_wave(cast(ServoRig, rig), clock, settings, report)
    finally:
        with uninterrupted():
            rig.close()


def _run_wave(rig: ServoRig, clock: Clock, settings: CheckSettings, report: Report) -> RigCheck:
    """Turn in alternating directions, and read the following error continuously."""
    steady: list[float] = []
    run_up: list[float] = []
    rates: list[float] = []
    identity, servo = rig.identify(), rig.read_servo()
    rig.enable(True)
    rig.set_acceleration(settings.acceleration)
    turn_rate, ramp_s = settings.turn_rate, settings.turn_rate / settings.acceleration
    end = clock.now() + settings.duration_s
    while (start := clock.now()) < end:
        report(f"step wave, {end - start:.0f} s left")
        positions: list[Position] = []
        rig.turn_for(turn_rate, settings.half_period_s)
        while (elapsed_s := clock.now() - start) < settings.half_period_s - ramp_s:
            error = abs(rig.following_error())
            if elapsed_s < ramp_s + SETTLE_S:
                run_up.append(error)
            else:
                steady.append(error)
                positions.append(rig.position())
            clock.wait(READ_S)
        if len(positions) > 2:
            rates.append(abs(achieved_turn_rate(positions).turn_rate))
        rig.stop()
        turn_rate = -turn_rate
    if not rates:
        raise RigTimeout("rig check: no position was read at steady rate. Check the link and the table.")
    largest = max(*steady, abs(rig.following_error()))
    largest_deg, limit_deg = largest / RADIAN_PER_DEGREE, settings.limit / RADIAN_PER_DEGREE
    failed = finding(
        "rig_check.error",
        "fail",
        f"The following error is up to {told_apart(largest_deg, '.4f', limit_deg)} deg at steady rate (limit {limit_deg:g} deg).",
        "Check friction, load and gains of the table.",
        largest_deg=largest_deg,
    )
    return RigCheck(
        identity=identity,
        servo=servo,
        rms=math.sqrt(float(np.mean(np.square(steady)))),
        largest=largest,
        in_run_up=max(run_up, default=math.nan),
        turn_rate=float(np.mean(rates)),
        verdict=Verdict.of(*([failed] if largest > settings.limit else [])),
    )
