"""Watch over a run: the guard stands by, nobody stopped the table from elsewhere, and the program does not hang."""

from undrift.rig.guard import Guard
from undrift.rig.programme import Dwell, Programme
from undrift.rig.run import Progress
from undrift.rig.stops import StopWatch

LONGEST_WORDLESS_S = 60.0  # that a run says nothing beside its ramp and settling, s of the host; then it hangs


class Watch:
    """Is told what a run is told, before each step and several times a second, and ends it by an exception.

    Parameters
    ----------
    stops : StopWatch
        Of the table.
    guard : Guard or None
        None where nothing is driven.
    programme : Programme
        That is run.
    """

    def __init__(self, stops: StopWatch, guard: Guard | None, programme: Programme) -> None:
        waits = [step.ramp_s + step.settle_s for step in programme.steps if isinstance(step, Dwell)]
        self._stops, self._guard = stops, guard
        self._within_s = LONGEST_WORDLESS_S + max(waits, default=0.0)

    def arm(self) -> None:
        """Say that the rig is open from now on."""
        if self._guard is not None:
            self._guard.arm()

    def __call__(self, progress: Progress) -> None:
        """Look whether the run may go on.

        Parameters
        ----------
        progress : Progress
            Where it is; the closing at its end is never refused.

        Raises
        ------
        RigFault
            The guard has ended, or the table was stopped from elsewhere.
        """
        if progress.phase != "closing":
            self._stops.check()
            if self._guard is not None:
                self._guard.check()
        if self._guard is not None:
            self._guard.expect(None if progress.phase in ("mounting", "closing") else self._within_s)
