"""Acceptance of a table with a servo: the following error in a step wave, with the gains and the sample period that the card runs.

The wave is the note's preliminary test: +-90 deg/s for 60 s, with an error below 0.012 deg. The error is commanded minus actual
angle, as the controller reports it. It counts from 50 ms after each run-up, and at rest at the end. During a run-up the error grows
with the acceleration, so it is reported apart.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from undrift.base.clock import Clock
from undrift.errors import InputError, RigError, RigTimeout, check_positive
from undrift.findings import finding
from undrift.model import Verdict
from undrift.rig.lock import uninterrupted
from undrift.rig.rig import Position, Rig, ServoReport, achieved_turn_rate
from undrift.units import RADIAN_PER_DEGREE

Report = Callable[[str], None]

SETTLE_S = 0.05  # s, from the end of a run-up until the error counts
READ_S = 0.01  # s, between two readings of the error


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
        check_positive(self, "rig check", "state another", *names)
        if not self.turn_rate / self.acceleration < 0.2 * self.half_period_s:
            raise InputError(
                f"rig check: wanted run-ups below {0.2 * self.half_period_s:g} s, got "
                f"{self.turn_rate / self.acceleration:.3g} s; choose a larger acceleration or a slower wave"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveError:
    """Following error in a step wave."""

    rms: float  # rad, at steady rate
    largest: float  # rad, at steady rate and at rest at the end
    in_run_up: float  # rad, largest while the rate changes
    turn_rate: float  # rad/s, mean of the achieved rates in either direction


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCheck:
    """Result of a check."""

    identity: str
    error: WaveError
    passed: bool
    servo: ServoReport
    verdict: Verdict = field(default_factory=Verdict)


def check_rig(rig: Rig, clock: Clock, settings: CheckSettings, report: Report = lambda line: None) -> RigCheck:
    """Check a table and close it: at rest, with its motor as it was; off after an error of the rig itself."""
    try:
        result = _run_check(rig, clock, settings, report)
    except BaseException as error:
        with uninterrupted():
            rig.close(as_found=not isinstance(error, RigError))
        raise
    with uninterrupted():
        rig.close(as_found=True)
    return result


def _run_check(rig: Rig, clock: Clock, settings: CheckSettings, report: Report) -> RigCheck:
    rig.limits.check_turn_rate(settings.turn_rate)
    rig.limits.check_travel(settings.turn_rate * settings.half_period_s)
    identity, servo = rig.identify(), rig.read_servo()
    if servo is None:
        raise InputError(
            f"rig check: {identity} has no encoder, so it reports no following error. Check a servo table."
        )
    rig.enable(True)
    rig.set_acceleration(settings.acceleration)
    error = _step_wave(rig, clock, settings, report)
    passed = error.largest <= settings.limit
    numbers = {"largest_deg": error.largest / RADIAN_PER_DEGREE, "limit_deg": settings.limit / RADIAN_PER_DEGREE}
    verdict = Verdict.of(*([] if passed else [finding("rig_check.error", "fail", **numbers)]))
    return RigCheck(identity=identity, error=error, passed=passed, servo=servo, verdict=verdict)


def _step_wave(rig: Rig, clock: Clock, settings: CheckSettings, report: Report) -> WaveError:
    """Turn to and fro and read the following error all the time."""
    steady: list[float] = []
    in_run_up: list[float] = []
    rates: list[float] = []
    turn_rate, ramp_s = settings.turn_rate, settings.turn_rate / settings.acceleration
    end = clock.now() + settings.duration_s
    while (start := clock.now()) < end:
        report(f"step wave, {end - start:.0f} s left")
        positions: list[Position] = []
        rig.turn_for(turn_rate, settings.half_period_s)
        while (elapsed_s := clock.now() - start) < settings.half_period_s - ramp_s:
            error = abs(rig.following_error())
            if elapsed_s < ramp_s + SETTLE_S:
                in_run_up.append(error)
            else:
                steady.append(error)
                positions.append(rig.position())
            clock.wait(READ_S)
        if len(positions) > 2:
            rates.append(abs(achieved_turn_rate(positions).turn_rate))
        rig.stop()
        turn_rate = -turn_rate
    if not rates:
        raise RigTimeout("rig check: no position was read at steady rate. Look at the link and at the table.")
    return WaveError(
        rms=math.sqrt(float(np.mean(np.square(steady)))),
        largest=max(*steady, abs(rig.following_error())),
        in_run_up=max(in_run_up, default=math.nan),
        turn_rate=float(np.mean(rates)),
    )
