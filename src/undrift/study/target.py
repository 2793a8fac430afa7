"""The cheapest session that is good enough: a target in place of an optimum.

Of each protocol S subjects, each with a device and a bench of its own, give the mean error m and their standard deviation s. With t
the quantile of Student's distribution at the confidence c, one-sided::

    upper limit      U = m + t s / sqrt(S)
    reach            R = m + 2 t s / sqrt(S)     what the upper limit on as many other subjects is expected to keep below

Of the protocols whose reach is below the target the one with the shortest session is chosen, to the minute; of those the one that
asks least of a laboratory (``plan.INSTRUMENTS``, by the dearest that is needed), then that with the least error. It alone is then
tried on the other cohort, whose people, devices and benches had no part in the choice. The session is enough if *their* upper
limit is below the target and every device was calibrated. It is not enough if their lower limit is above the target, or if it
left a device uncalibrated; otherwise this is not decidable with so many subjects. Errors of people are skewed, and Student's
upper limit is low for these: of 30 lognormal ones (0.4) below the true mean in 8 % at a confidence of 95 %. The reach makes up
for it: a session that is not enough is hardly ever tried. People who were recorded have no other cohort: each is then judged with
the session that all the others choose.

The chosen one may have the first or the last value that was tried of a parameter that decides the error, with more beyond it. Then
the best session may lie outside what was tried, and the verdict is not "enough". Where nothing reaches the target, the error of the
optimum is split by its effects (study/outcome.py): the largest stands in the way.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.findings import Finding, finding
from undrift.study.judge import SYMBOLS, Optimum, Tested
from undrift.study.plan import INSTRUMENTS, Aim, StudyTask
from undrift.study.run import TaskSurface
from undrift.study.statistics import mean_limits

TargetVerdict = Literal["enough", "at the edge", "not enough", "not reached", "not decidable"]

# What makes each effect of study/case.py smaller
REMEDIES: dict[str, str] = {
    "noise": "a device of less noise removes it, and offline a lower cut-off",
    "gyroscope offset": "take the offset from the rest before each motion, or from the motion itself",
    "accelerometer offset": "calibrate on faces at the temperature of use, or close to it in time",
    "scale": "calibrate at set-points about the temperature of use, on a table whose rate is exact",
    "cross-axis": "square and level the block that the device is mounted on",
    "dynamic drift": "turn at more rates, up to those of the motion",
    "delay": "raise the cut-off, or judge offline",
    "quantisation": "take a converter of more bits, or more gain",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CheapestSession:
    """The cheapest session that keeps a task's error below a target, or why there is none."""

    target_deg: float  # Of the mean error, deg
    confidence: float  # Of the limits, one-sided
    place: int  # Of the protocol that was tried on the other cohort: the chosen one, or the optimum where none reaches
    chosen: bool  # Whether one does reach on the subjects that choose
    minutes: float  # On the rig
    needs: tuple[str, ...]  # Of ``plan.INSTRUMENTS``
    edges: tuple[str, ...]  # Deciding parameters of which it has the first or last value that was tried
    tested: Tested  # On the other cohort
    obstacle: tuple[str, float] | None  # Effect that stands in the way, and its share of the mean square
    verdict: TargetVerdict

    @property
    def needs_text(self) -> str:
        """What is needed, separated by commas."""
        return ", ".join(self.needs)

    @property
    def finding(self) -> Finding:
        """The verdict in words."""
        lower, upper = self.tested.limits_deg
        words = {"target_deg": self.target_deg, "upper_deg": upper, "confidence_percent": 100.0 * self.confidence}
        words |= {"minutes": self.minutes, "subjects": self.tested.subjects}
        if self.verdict == "enough":
            return finding("study.enough", "info", needs=self.needs_text, **words)
        if self.verdict == "at the edge":
            return finding(
                "study.enough_at_edge", "warn", parameters=tuple(SYMBOLS[name] for name in self.edges), **words
            )
        if self.verdict == "not decidable":
            return finding("study.target_undecided", "warn", lower_deg=lower, **words)
        if self.verdict == "not enough" and self.tested.failed:
            return finding("study.target_uncalibrated", "warn", failed=self.tested.failed, **words)
        if self.verdict == "not enough":
            return finding("study.target_missed", "warn", lower_deg=lower, **words)
        effect, share = self.obstacle or ("no single effect", float("nan"))
        todo = REMEDIES.get(effect, "try a wider space")
        return finding(
            "study.target_not_reached",
            "warn",
            lower_deg=lower,
            effect=effect,
            share_percent=100.0 * share,
            todo=todo,
            **words,
        )


def needs_of(task: StudyTask, surface: TaskSurface, place: int) -> tuple[str, ...]:
    """Return the instruments that a protocol needs."""
    further = {name: int(values[place]) for name, values in surface.further.items()}
    listed = task.places[further["places"] - 1] if "places" in further else task.base.temperatures_c
    chamber = bool(listed) and further.get("set_points", 2) > 1
    inclined = any(" " in pose for pose in (task.poses[further["poses"] - 1] if "poses" in further else ()))
    needed = {"faces fixture": True, "inclined plane": inclined, "rate table": True, "chamber": chamber}
    return tuple(name for name in INSTRUMENTS if needed.get(name))


def choose(task: StudyTask, surface: TaskSurface, optimum: Optimum, aim: Aim) -> int | None:
    """Return the protocol with the cheapest session whose reach is below the target; None: no target, or no protocol."""
    if aim.target_deg is None:
        return None
    usable: BoolArray = optimum.equivalent | optimum.worse | optimum.undecided
    return _cheapest(task, surface, surface.aimed(aim), usable, aim)


def _cheapest(task: StudyTask, surface: TaskSurface, error: FloatArray, usable: BoolArray, aim: Aim) -> int | None:
    mean = error.mean(axis=0)
    upper = np.array([mean_limits(column, aim.confidence)[1] for column in error.T])
    places = np.flatnonzero(usable & (2.0 * upper - mean <= (aim.target_deg or 0.0)))
    if not len(places):
        return None
    needs, minutes = [needs_of(task, surface, int(place)) for place in places], surface.rig_minutes[places]
    asked = np.array([sum(2 ** INSTRUMENTS.index(name) for name in each) for each in needs])
    return int(places[np.lexsort((mean[places], asked, minutes.round()))[0]])


def leave_one_out(task: StudyTask, surface: TaskSurface, optimum: Optimum, aim: Aim, tested: Tested) -> Tested:
    """Return what each recorded person gives with the session that all the others choose, in place of another cohort."""
    if task.motion is None or not task.motion.others or aim.target_deg is None:
        return tested
    usable: BoolArray = optimum.equivalent | optimum.worse | optimum.undecided
    error, places = surface.aimed(aim), []
    for person in range(len(error)):
        rest = np.delete(error, person, axis=0)
        place = _cheapest(task, surface, rest, usable, aim)
        places.append(int(np.argmin(np.where(usable, rest.mean(axis=0), np.inf))) if place is None else place)
    alone = error[np.arange(len(error)), places]
    return replace(tested, limits_deg=mean_limits(alone, aim.confidence))


def judge_target(
    task: StudyTask,
    surface: TaskSurface,
    optimum: Optimum,
    chosen: int | None,
    tested: Tested,
    obstacle: tuple[str, float] | None,
    aim: Aim,
) -> CheapestSession | None:
    """Judge what was chosen, or the optimum where nothing reaches, by the other cohort, or by each recorded person left out."""
    if aim.target_deg is None:
        return None
    tested = leave_one_out(task, surface, optimum, aim, tested)
    place = optimum.best if chosen is None else chosen
    edges = tuple(name for name in optimum.edges if surface.at_end(surface.column(name)[place], name))
    lower, upper = tested.limits_deg
    verdict: TargetVerdict = "not decidable"
    if chosen is None:
        verdict = "not reached" if lower > aim.target_deg else "not decidable"
    elif tested.failed or lower > aim.target_deg:
        verdict = "not enough"
    elif upper <= aim.target_deg:
        verdict = "at the edge" if edges else "enough"
    return CheapestSession(
        target_deg=aim.target_deg,
        confidence=aim.confidence,
        place=place,
        chosen=chosen is not None,
        minutes=float(surface.rig_minutes[place]),
        needs=needs_of(task, surface, place),
        edges=edges,
        tested=tested,
        obstacle=obstacle,
        verdict=verdict,
    )
