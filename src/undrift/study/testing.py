"""The other cohort: protocols that a study chose are run on subjects, and units of the device, that it never saw.

The note's Table 2 has two groups of thirty; the second tests what the first chose. Device, temperature, performance and noise
are drawn from another seed, so that nothing is shared.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.motion.subject import TABLE_2, Group, TableRow
from undrift.study.case import subject_of
from undrift.study.executor import InProcess
from undrift.study.optimise import Optimum
from undrift.study.plan import Space, Study, StudyTask
from undrift.study.run import TaskSurface, run_study
from undrift.units import RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """A protocol on the other cohort.

    Parameters
    ----------
    place : int
        Of the protocol on the surface.
    subjects, failed : int
        How many, and for how many of them it could not calibrate the device.
    error_rms_deg, error_max_deg : float
        Means over the subjects, deg.
    interval_rms_deg, interval_max_deg : (float, float)
        Their 95 % intervals, deg.
    """

    place: int
    subjects: int
    failed: int
    error_rms_deg: float
    error_max_deg: float
    interval_rms_deg: tuple[float, float]
    interval_max_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cohort:
    """A cohort as it was simulated, beside what the note prints.

    Parameters
    ----------
    group : str
        simulation or testing.
    count : int
        Subjects.
    age_years, height : (float, float, float)
        Lowest, mean and highest, years and m.
    printed : TableRow
        The note's Table 2.
    """

    group: Group
    count: int
    age_years: tuple[float, float, float]
    height: tuple[float, float, float]
    printed: TableRow


def other_study(study: Study) -> Study:
    """Return the same study for the other cohort, with random numbers of its own.

    Parameters
    ----------
    study : Study
        Of one group.

    Returns
    -------
    Study
        Of the other.
    """
    group: Group = "testing" if study.group == "simulation" else "simulation"
    seed = int(np.random.SeedSequence((study.seed, 1)).generate_state(1, np.uint64)[0])
    return replace(study, group=group, seed=seed)


def run_testing(
    study: Study, surfaces: tuple[TaskSurface, ...], optima: tuple[Optimum, ...], folder: Path
) -> tuple[tuple[Tested, Tested], ...]:
    """Run each task's optimum and its cheapest equal on the other cohort.

    Parameters
    ----------
    study : Study
        That chose them.
    surfaces : tuple of TaskSurface
        What was tried.
    optima : tuple of Optimum
        What was chosen.
    folder : Path
        Runs are kept in folders there.

    Returns
    -------
    tuple of (Tested, Tested)
        Optimum and cheapest of each task.
    """
    found: list[tuple[Tested, ...]] = []
    for name in ("best", "cheapest"):
        places = [int(getattr(optimum, name)) for optimum in optima]
        tasks = tuple(map(_only, study.tasks, surfaces, places))
        # a few seconds' work: shorter than starting workers
        tested = run_study(replace(other_study(study), tasks=tasks), InProcess(), folder / name)
        found.append(tuple(_tested(surface, place) for surface, place in zip(tested, places, strict=True)))
    best, cheapest = found
    return tuple(zip(best, cheapest, strict=True))


def cohort_of(study: Study) -> Cohort:
    """Return who was simulated.

    Parameters
    ----------
    study : Study
        Gives group, seed and number.

    Returns
    -------
    Cohort
        Beside the note's figures.
    """
    people = [subject_of(study, number) for number in range(study.subjects)]
    ages, heights = (np.array([getattr(person, name) for person in people]) for name in ("age_years", "height"))
    return Cohort(
        group=study.group,
        count=study.subjects,
        age_years=_span(ages),
        height=_span(heights),
        printed=TABLE_2[study.group],
    )


def _only(task: StudyTask, surface: TaskSurface, place: int) -> StudyTask:
    step, low, high = (
        (float(getattr(surface, f"turn_rate_{name}_dps")[place]) * RADIAN_PER_DEGREE,)
        for name in ("step", "min", "max")
    )
    cutoff = (float(surface.cutoff_hz[place]),)
    return replace(task, space=Space(cutoff_hz=cutoff, turn_rate_step=step, turn_rate_min=low, turn_rate_max=high))


def _tested(surface: TaskSurface, place: int) -> Tested:
    rms, worst = surface.error_rms_deg[:, 0], surface.error_max_deg[:, 0]
    done = np.isfinite(rms)
    return Tested(
        place=place,
        subjects=len(rms),
        failed=int((~done).sum()),
        error_rms_deg=float(rms[done].mean()) if done.any() else float("nan"),
        error_max_deg=float(worst[done].mean()) if done.any() else float("nan"),
        interval_rms_deg=_interval(rms[done]),
        interval_max_deg=_interval(worst[done]),
    )


def _interval(values: FloatArray) -> tuple[float, float]:
    from scipy.stats import t as t_distribution

    if len(values) < 2:
        return float("nan"), float("nan")
    reach = float(t_distribution.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / len(values) ** 0.5
    mean = float(values.mean())
    return mean - reach, mean + reach


def _span(values: FloatArray) -> tuple[float, float, float]:
    return float(values.min()), float(values.mean()), float(values.max())
