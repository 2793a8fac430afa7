"""Judge the surface of a task: the optimum, what each parameter does, the other cohort, the note's row.

The least of many noisy means is biased low. So the error of the optimum is taken from subjects that did not choose it: the
subjects are split in two, each half chooses, the other half gives the error. A protocol is as good as the optimum where a
one-sided paired t test over the subjects, after Holm over all protocols, does not tell them apart. Where a quarter are as good
and no parameter decides, the minimum is flat. The cheapest of them in minutes on the rig is the one to use.

A parameter is tested with the others at the optimum. All subjects with a value at all levels: analysis of variance, paired
tests of the levels. A run missing, because its protocol could not calibrate that subject's device: the mixed model, contrasts
of the levels. p is after Holm over the parameters; levels are compared where it is below the level of the test, p after Holm
over all pairs of them. A level that calibrates fewer than half of the devices is left out.

The other cohort (the note's Table 2 has two groups of thirty) has its own seed: device, temperature, performance and noise are
shared with nothing. The note's row agrees where its protocol is statistically as good as the optimum, whatever the four numbers
are; where it differs, the four parameters are exchanged one at a time, and the one that takes most of the error off is named.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import TABLE_2, Group, TableRow
from undrift.study.case import subject_of
from undrift.study.plan import NoteRow, Space, Study, StudyTask
from undrift.study.run import InProcess, TaskSurface, run_study
from undrift.study.statistics import (
    Anova,
    MixedModel,
    Pair,
    adjust_holm,
    compare_conditions,
    compare_pairs,
    compare_pairs_of,
    compare_unbalanced,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- effect of each parameter, the others at the optimum

PARAMETERS = ("cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps")
SYMBOLS = dict(zip(PARAMETERS, ("cut-off", "step d", "omega_m", "omega_M"), strict=True))
FEWEST_SHARE = 0.5  # of the subjects whose device a level has to calibrate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterEffect:
    """Whether one parameter of the protocol matters, the others at the optimum."""

    name: str  # Of the parameter
    values: FloatArray  # (k,), its values, Hz or deg/s
    best: int  # Place of the optimum among them
    means_deg: FloatArray  # (k,), mean error at each, deg; the mixed model's where runs are missing
    missing: int  # Runs that are missing among them
    dropped: FloatArray  # Values left out, since they calibrate fewer than half of the devices
    anova: Anova | None  # Where no run is missing
    mixed: MixedModel | None  # Where some are
    untested: str  # Why neither could be; empty where one was
    p_holm: float  # p after Holm over the parameters; NaN without a test
    pairs: tuple[Pair, ...]  # All pairs of values, by their places; empty unless that p is below the level

    @property
    def test(self) -> Anova | MixedModel | None:
        """The test that was made: both have f, dof, p_value, partial_eta_squared, means and subjects."""
        return self.mixed if self.anova is None else self.anova

    @property
    def span_deg(self) -> float:
        """Greatest less least mean error, deg: what the parameter is worth."""
        return float(np.ptp(self.means_deg))

    @property
    def error_variance(self) -> float:
        """Variance of a response about the subject's own mean and the value's, deg squared; NaN without a test."""
        if self.anova is not None:
            return self.anova.mean_square_error
        return float("nan") if self.mixed is None else self.mixed.residual_sd**2

    @property
    def epsilon(self) -> float:
        """Of the sphericity, after Greenhouse and Geisser; the mixed model takes it as 1."""
        return 1.0 if self.anova is None else self.anova.sphericity.greenhouse_geisser


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Levels:
    """Values of one parameter and the errors with each, shape (S, k)."""

    name: str
    values: FloatArray
    best: int
    dropped: FloatArray
    error: FloatArray


def effects_at(
    surface: TaskSurface, best: int, *, error: FloatArray, allowed: BoolArray, level: float = 0.05
) -> tuple[ParameterEffect, ...]:
    """Say what each parameter does about a protocol: error (S, P) deg, allowed (P,)."""
    held = [_levels(surface, name, best, error, allowed) for name in PARAMETERS]
    tests = [_tested(each) for each in held]
    p = np.array([np.nan if isinstance(test, str) else test.p_value for test in tests])
    known = ~np.isnan(p)
    holm = np.full(len(p), np.nan)
    holm[known] = adjust_holm(p[known])
    return tuple(
        ParameterEffect(
            name=each.name,
            values=each.values,
            best=each.best,
            means_deg=test.means if isinstance(test, MixedModel) else np.nanmean(each.error, axis=0),
            missing=int(np.isnan(each.error).sum()),
            dropped=each.dropped,
            anova=test if isinstance(test, Anova) else None,
            mixed=test if isinstance(test, MixedModel) else None,
            untested=test if isinstance(test, str) else "",
            p_holm=float(p_holm),
            pairs=() if isinstance(test, str) or not p_holm < level else _pairs(each, test),
        )
        for each, test, p_holm in zip(held, tests, holm, strict=True)
    )


def _levels(surface: TaskSurface, name: str, best: int, error: FloatArray, allowed: BoolArray) -> _Levels:
    columns = {known: np.asarray(getattr(surface, known)) for known in PARAMETERS}
    same = np.all([np.isclose(c, c[best]) for known, c in columns.items() if known != name], axis=0)
    places = np.flatnonzero(same & allowed)
    places = places[np.argsort(columns[name][places])]
    enough = np.isfinite(error[:, places]).mean(axis=0) >= FEWEST_SHARE
    kept = places[enough]
    return _Levels(
        name=name,
        values=columns[name][kept],
        best=int(np.flatnonzero(kept == best)[0]),
        dropped=columns[name][places[~enough]],
        error=error[:, kept],
    )


def _tested(held: _Levels) -> Anova | MixedModel | str:
    """Return the test that suits, or why there is none."""
    if len(held.values) < 2:
        return "one value only"
    there = np.isfinite(held.error)
    try:
        if there.all():
            return compare_conditions(held.error)
        # by value first, so that the model's conditions come in the order of the values
        condition, subject = np.nonzero(there.T)
        return compare_unbalanced(
            held.error[subject, condition], [str(s) for s in subject], [str(c) for c in condition]
        )
    except InputError:  # nothing to test against
        return "all subjects respond alike"


def _pairs(held: _Levels, test: Anova | MixedModel) -> tuple[Pair, ...]:
    return compare_pairs_of(test) if isinstance(test, MixedModel) else compare_pairs(held.error)


# ---- optimum

FLAT_SHARE = 0.25  # a minimum that a quarter of the protocols share is called flat where no parameter decides


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimum:
    """What a study says of one task."""

    task: str  # Its name
    best: int  # Place of the protocol with the least mean error
    error_rms_deg: float  # Mean over the subjects of both errors at the optimum, deg
    error_max_deg: float
    honest_error_deg: float  # Mean of the objective by subjects that did not choose it, and its 95 % interval, deg
    # Mean of the objective by subjects that did not choose it, and its 95 % interval, deg
    honest_interval_deg: tuple[float, float]
    equivalent: BoolArray  # (P,), protocols that are statistically as good
    cheapest: int  # Of those, the one with the shortest session
    flat: bool  # Whether a quarter of all protocols or more are as good, and no parameter decides the error
    deciding: tuple[str, ...]  # Parameters whose p after Holm is below the level
    effects: tuple[ParameterEffect, ...]  # One a parameter
    p_value: float  # Least p after Holm over the parameters: whether any of them matters
    pareto: IntArray  # Protocols that no other beats in both error and minutes, by rising minutes
    failed: int  # Runs whose protocol could not calibrate the device


def find_optimum(
    surface: TaskSurface, *, objective: str = "rms", level: float = 0.05, rig_minutes_max: float | None = None
) -> Optimum:
    """Find the best protocol of a task, and those that are as good."""
    error = surface.error(objective)
    allowed = surface.rig_minutes <= (np.inf if rig_minutes_max is None else rig_minutes_max)
    usable: BoolArray = np.isfinite(error).all(axis=0) & allowed
    if not usable.any():
        raise NotObservable(
            f"study: wanted a protocol of {surface.task} that calibrates every device in the time allowed, got none; "
            "allow longer sessions or other rates"
        )
    mean = np.where(usable, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    best = int(np.argmin(mean))
    equivalent = _equivalent(error, usable, best, level)
    among = np.flatnonzero(equivalent)
    cheapest = int(among[np.lexsort((mean[among], surface.rig_minutes[among]))[0]])
    effects = effects_at(surface, best, error=error, allowed=allowed, level=level)
    honest, interval = _honest(error, usable)
    tested = [effect.p_holm for effect in effects if effect.test is not None]
    deciding = tuple(effect.name for effect in effects if effect.p_holm < level)
    return Optimum(
        task=surface.task,
        best=best,
        error_rms_deg=float(surface.error_rms_deg[:, best].mean()),
        error_max_deg=float(surface.error_max_deg[:, best].mean()),
        honest_error_deg=honest,
        honest_interval_deg=interval,
        equivalent=equivalent,
        cheapest=cheapest,
        flat=bool(equivalent.sum() >= FLAT_SHARE * usable.sum()) and not deciding,
        deciding=deciding,
        effects=effects,
        p_value=min(tested) if tested else float("nan"),
        pareto=pareto_front(surface.rig_minutes, mean),
        failed=int(np.isnan(error).sum()),
    )


def pareto_front(minutes: FloatArray, error: FloatArray) -> IntArray:
    """Return the protocols that no other beats in both time and error: minutes (P,), error (P,)."""
    front: list[int] = []
    least = np.inf
    for place in np.lexsort((error, minutes)):
        if error[place] < least:
            front.append(int(place))
            least = error[place]
    return np.array(front, dtype=np.int64)


def _equivalent(error: FloatArray, usable: BoolArray, best: int, level: float) -> BoolArray:
    from scipy.stats import t as t_distribution

    subjects = len(error)
    places = np.flatnonzero(usable)
    apart = error[:, places] - error[:, [best]]
    spread = apart.std(axis=0, ddof=1) / np.sqrt(subjects)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(spread > 0.0, apart.mean(axis=0) / spread, np.where(apart.mean(axis=0) > 0.0, np.inf, 0.0))
    p = t_distribution.sf(t, subjects - 1)  # one-sided: worse than the best
    found = np.zeros(len(usable), dtype=bool)
    found[places] = adjust_holm(p) >= level
    found[best] = True
    return found


def _honest(error: FloatArray, usable: BoolArray) -> tuple[float, tuple[float, float]]:
    """Error of the protocol that the other half of the subjects chose, each subject once."""
    from scipy.stats import t as t_distribution

    places = np.flatnonzero(usable)
    half = np.arange(len(error)) % 2 == 0
    judged = np.empty(len(error))
    for choosing in (half, ~half):
        chosen = places[int(np.argmin(error[np.ix_(choosing, places)].mean(axis=0)))]
        judged[~choosing] = error[~choosing, chosen]
    mean, spread = float(judged.mean()), float(judged.std(ddof=1) / np.sqrt(len(judged)))
    reach = float(t_distribution.ppf(0.975, len(judged) - 1)) * spread
    return mean, (mean - reach, mean + reach)


# ---- the other cohort


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """A protocol on the other cohort."""

    place: int  # Of the protocol on the surface
    subjects: int  # How many, and for how many of them it could not calibrate the device
    failed: int
    error_rms_deg: float  # Means over the subjects, deg
    error_max_deg: float
    interval_rms_deg: tuple[float, float]  # Their 95 % intervals, deg
    interval_max_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cohort:
    """A cohort as it was simulated, beside what the note prints."""

    group: Group  # simulation or testing
    count: int  # Subjects
    age_years: tuple[float, float, float]  # Lowest, mean and highest, years and m
    height: tuple[float, float, float]
    printed: TableRow  # The note's Table 2


def other_study(study: Study) -> Study:
    """Return the same study for the other cohort, with random numbers of its own."""
    group: Group = "testing" if study.group == "simulation" else "simulation"
    seed = int(np.random.SeedSequence((study.seed, 1)).generate_state(1, np.uint64)[0])
    return replace(study, group=group, seed=seed, search="grid")


def run_testing(
    study: Study, surfaces: tuple[TaskSurface, ...], optima: tuple[Optimum, ...], folder: Path
) -> tuple[tuple[Tested, Tested], ...]:
    """Run each task's optimum and its cheapest equal on the other cohort."""
    found: list[tuple[Tested, ...]] = []
    for name in ("best", "cheapest"):
        places = [int(getattr(optimum, name)) for optimum in optima]
        tasks = tuple(map(_only, study.tasks, surfaces, places))
        # a few seconds' work: shorter than starting workers
        tested = run_study(replace(other_study(study), tasks=tasks), InProcess(), folder / name)
        found.append(tuple(_tested_testing(surface, place) for surface, place in zip(tested, places, strict=True)))
    best, cheapest = found
    return tuple(zip(best, cheapest, strict=True))


def cohort_of(study: Study) -> Cohort:
    """Return who was simulated."""
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


def _tested_testing(surface: TaskSurface, place: int) -> Tested:
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


# ---- comparison with the note's Table 1


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteComparison:
    """A row of the note compared with an optimum."""

    row: NoteRow  # As printed
    place: int | None  # Of the note's protocol on the surface; None where it was not tried
    error_deg: float  # Mean of the objective with the note's protocol, deg
    difference_deg: float  # That minus the optimum's, deg
    verdict: Literal["agrees", "differs", "not tried"]
    finding: Finding  # Why


def compare_with_note(
    surface: TaskSurface, optimum: Optimum, row: NoteRow, *, objective: str = "rms", level: float = 0.05
) -> NoteComparison:
    """Compare an optimum with the note's: they agree where the note's protocol is statistically as good."""
    wanted = np.array([getattr(row, name) for name in PARAMETERS])
    table = np.stack([getattr(surface, name) for name in PARAMETERS], axis=1)
    place, nan, error_of = _place(table, wanted), float("nan"), surface.error(objective)
    mean = error_of.mean(axis=0)
    if place is None or not np.isfinite(mean[place]):
        why = finding("study.note_not_tried" if place is None else "study.note_uncalibrated", "info")
        return NoteComparison(row=row, place=place, error_deg=nan, difference_deg=nan, verdict="not tried", finding=why)
    error, best = float(mean[place]), float(mean[optimum.best])
    count, tried = int(optimum.equivalent.sum()), len(mean)
    if place == optimum.best:
        why = finding("study.note_is_optimum", "info", alike=count - 1, others=tried - 1)
    elif optimum.equivalent[place]:
        why = finding(
            "study.note_as_good",
            "info",
            error_deg=error,
            optimum_deg=best,
            subjects=len(error_of),
            detectable_deg=_least_seen(error_of[:, place] - error_of[:, optimum.best], tried, level),
        )
    else:
        why = _worse(table, mean, place, optimum.best)
    return NoteComparison(
        row=row,
        place=place,
        error_deg=error,
        difference_deg=error - best,
        verdict="agrees" if optimum.equivalent[place] else "differs",
        finding=why,
    )


def _place(table: FloatArray, wanted: FloatArray) -> int | None:
    hits = np.flatnonzero(np.isclose(table, wanted, rtol=1e-6).all(axis=1))
    return int(hits[0]) if len(hits) else None


def _least_seen(apart: FloatArray, tests: int, level: float) -> float:
    """Return the mean difference from which on the test among so many tells a protocol from the optimum, deg."""
    from scipy.stats import t as t_distribution

    n = len(apart)
    return float(t_distribution.ppf(1.0 - level / tests, n - 1) * apart.std(ddof=1) / np.sqrt(n))


def _worse(table: FloatArray, mean: FloatArray, place: int, best: int) -> Finding:
    """Name the parameter whose exchange for ours takes most of the error off, where such protocols were tried."""
    gains: list[tuple[float, int]] = []
    for k in range(len(PARAMETERS)):
        exchanged = table[place].copy()
        exchanged[k] = table[best, k]
        at = _place(table, exchanged)
        if at is not None and at != place and np.isfinite(mean[at]):
            gains.append((float(mean[place] - mean[at]), k))
    error, optimum = float(mean[place]), float(mean[best])
    if not gains or max(gains)[0] <= 0.0:
        return finding("study.note_worse", "warn", error_deg=error, optimum_deg=optimum)
    gain, k = max(gains)
    return finding(
        "study.note_worse_by_one",
        "warn",
        error_deg=error,
        optimum_deg=optimum,
        parameter=SYMBOLS[PARAMETERS[k]],
        note=table[place, k],
        ours=table[best, k],
        unit="Hz" if k == 0 else "deg/s",
        gain_deg=gain,
    )
