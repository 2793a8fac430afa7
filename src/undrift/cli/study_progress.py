"""What ``undrift study`` says before and while it runs: what is not tried, how long each stage takes, where it is."""

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from undrift.study.forecast import Stage, StageName
    from undrift.study.plan import Study

SHOWN_EVERY_S = 10.0  # where stderr is not a terminal


def announce(planned: "Study", stages: "tuple[Stage, ...]", workers: int, json: bool) -> None:
    """Say how many runs there are, about how long all stages take, and which values no protocol has.

    Parameters
    ----------
    planned : Study
        What will be done.
    stages : tuple of Stage
        Forecast.
    workers : int
        That share the calibration sessions.
    json : bool
        Stdout is for JSON: stderr is used.
    """
    from rich.console import Console

    from undrift.cli.output import console
    from undrift.report.study_answer import untried_words
    from undrift.study.run import count_runs

    out = Console(stderr=True, highlight=False, soft_wrap=True) if json else console()
    tasks = ", ".join(task.name for task in planned.tasks)
    most = sorted(stages, key=lambda stage: -stage.seconds)[:3]
    parts = ", ".join(f"{stage.name} {duration(stage.seconds)}" for stage in stages if stage in most)
    out.print(
        f"{planned.name}: {count_runs(planned)} runs ({tasks}; {planned.subjects} subjects) on {workers} "
        f"worker{'s' * (workers > 1)}, in all about {duration(sum(stage.seconds for stage in stages))} ({parts})",
        markup=False,
    )
    for task in planned.tasks:
        if words := untried_words(task.space.untried()):
            out.print(f"{task.name}: {words}", markup=False)


class StudyProgress:
    """A bar on a terminal; elsewhere a line on stderr for each stage, and now and then one within the first.

    Parameters
    ----------
    name : str
        Of the study.
    stages : tuple of Stage
        Forecast.
    """

    def __init__(self, name: str, stages: "tuple[Stage, ...]") -> None:
        from undrift.cli.output import progress

        self._name, self._stages = name, stages
        self._live = sys.stderr.isatty()
        self._shown = progress()
        self._bar = self._shown.add_task(name, total=None)
        self._next_s = 0.0

    def __enter__(self) -> Self:
        self._shown.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shown.stop()

    def say(self, stage: "StageName") -> None:
        """Tell that a stage begins.

        Parameters
        ----------
        stage : str
            Which.
        """
        names = [each.name for each in self._stages]
        left = self._stages[names.index(stage) :] if stage in names else ()
        if not left:  # not forecast, since there is nothing to do
            return
        text = f"{stage}, about {duration(left[0].seconds)}"
        if len(left) > 1:
            text += f"; {duration(sum(each.seconds for each in left))} left in all"
        self._tell(text)

    def advance(self, done: int, total: int) -> None:
        """Tell how many units of work are done.

        Parameters
        ----------
        done, total : int
            Of the first stage.
        """
        self._shown.update(self._bar, completed=done, total=total)
        now_s = time.monotonic()
        if self._live or done == 0:
            self._next_s = now_s + SHOWN_EVERY_S
        elif done == total or now_s >= self._next_s:
            self._next_s = now_s + SHOWN_EVERY_S
            self._tell(f"calibration sessions: {done} of {total} units of work")

    def _tell(self, text: str) -> None:
        if self._live:  # a stage of its own bar: only the first counts units
            self._shown.remove_task(self._bar)
            self._bar = self._shown.add_task(f"{self._name}: {text}", total=None)
        else:
            sys.stderr.write(f"{self._name}: {text}\n")
            sys.stderr.flush()


def duration(seconds: float) -> str:
    """Return a time for people.

    Parameters
    ----------
    seconds : float
        s.

    Returns
    -------
    str
        In s, min or h.
    """
    if seconds < 90.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
