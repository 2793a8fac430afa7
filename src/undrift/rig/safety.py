"""Whether a programme may be run on a rig: asked before anything moves."""

from undrift.errors import LimitError
from undrift.rig.programme import Dwell, Programme
from undrift.rig.rig import Limits

TRAVEL_MARGIN = 1.1  # a wait is never shorter than asked for, and the table turns on meanwhile


def check_programme(programme: Programme, limits: Limits, done: frozenset[int] = frozenset()) -> None:
    """Refuse a programme that the rig may not run.

    Parameters
    ----------
    programme : Programme
        Steps.
    limits : Limits
        Of the rig.
    done : frozenset of int
        Steps that are not run any more.

    Raises
    ------
    LimitError
        A rate, the acceleration, or the angle that the turns add up to.
    """
    limits.check_acceleration(programme.acceleration)
    angle = 0.0
    for number, step in enumerate(programme.steps):
        if not isinstance(step, Dwell) or number in done:
            continue
        try:
            limits.check_turn_rate(step.turn_rate)
            limits.check_travel(angle + TRAVEL_MARGIN * step.travel)
        except LimitError as error:
            raise LimitError(f"step {number} ({step}): {error}", **error.numbers) from error
        angle += step.travel
