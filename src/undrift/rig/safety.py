"""Whether a programme may be run on a rig: asked before anything moves."""

from collections.abc import Callable

from undrift.errors import InputError, LimitError
from undrift.rig.programme import Dwell, Programme
from undrift.rig.rig import Limits
from undrift.units import RADIAN_PER_DEGREE

TRAVEL_MARGIN = 1.1  # a wait is never shorter than asked for, and the table turns on meanwhile


def check_programme(
    programme: Programme, limits: Limits, done: frozenset[int] = frozenset(), *, by_hand: bool = False
) -> None:
    """Refuse a programme that the rig may not run.

    Parameters
    ----------
    programme : Programme
        Steps.
    limits : Limits
        Of the rig.
    done : frozenset of int
        Steps that are not run any more.
    by_hand : bool
        The rig is a person, who holds no rate.

    Raises
    ------
    InputError
        A rate, the acceleration, or the angle that the turns add up to; any rate by hand.
    """
    left = [(number, step) for number, step in enumerate(programme.steps) if isinstance(step, Dwell)]
    left = [(number, step) for number, step in left if number not in done]
    turning = [(number, step) for number, step in left if step.turn_rate != 0.0]
    if by_hand:
        _check_hands(turning)
        return
    _check(limits.check_acceleration, programme.acceleration, limits.acceleration, "", "acceleration", "deg/s2")
    angle = 0.0
    for number, step in turning:
        what = f"step {number} ({step}): "
        _check(limits.check_turn_rate, step.turn_rate, limits.turn_rate, what, "turn rate", "deg/s")
        reached = angle + TRAVEL_MARGIN * step.travel
        _check(limits.check_travel, reached, limits.travel, what, "travel", "deg from the start")
        angle += step.travel


def _check_hands(turning: list[tuple[int, Dwell]]) -> None:
    if turning:
        number, step = turning[0]
        raise InputError(
            f"manual rig: wanted rests on faces only, got {len(turning)} dwells at a steady rate (step {number}: {step}), which no "
            "hand holds; leave [rates] out of the protocol, and record a session of turns through known angles for the gyroscopes"
        )


def _check(check: Callable[[float], None], value: float, most: float | None, what: str, name: str, unit: str) -> None:
    """Say a limit as a protocol states it, in degrees."""
    try:
        check(value)
    except LimitError as error:
        highest = "no end" if most is None else f"{most / RADIAN_PER_DEGREE:.6g}"
        raise InputError(
            f"{what}{name}: wanted at most {highest} {unit}, got {value / RADIAN_PER_DEGREE:.6g}; mend the protocol or state "
            "another limit",
            **error.numbers,
        ) from error
