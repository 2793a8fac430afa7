"""Judge the surface of a task: the optimum, what each parameter does, the other cohort, the note's row.

The least of many noisy means is biased low. So the subjects are split in two: each half chooses, the other half gives the error.
A protocol is as good as the optimum where a one-sided paired t test, after Holm over all protocols, does not tell them apart.
Where a quarter are as good and no parameter decides, the minimum is flat. The cheapest in minutes on the rig is the one to use.

A parameter is tested with the others at the optimum: analysis of variance and paired tests of the levels; where a run is missing
because its protocol could not calibrate that device, the mixed model and its contrasts. p is after Holm over the parameters;
levels are compared where it is below the level of the test, p after Holm over all pairs. A level that calibrates fewer than half
of the devices is left out. The other cohort shares nothing with the first. The note's row agrees where its protocol is as good.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import TABLE_2, Group, TableRow
from undrift.study import statistics
from undrift.study.case import COLUMNS, subject_of
from undrift.study.plan import NoteRow, Space, Study, StudyTask
from undrift.study.run import InProcess, TaskSurface, run_study
from undrift.study.statistics import Anova, MixedModel, adjust_holm, compare_pairs, compare_pairs_of, mean_interval
from undrift.units import RADIAN_PER_DEGREE

# ---- effect of each parameter, the others at the optimum

PARAMETERS = COLUMNS[:4]
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
    untested: Finding | None  # Why neither could be
    p_holm: float  # p after Holm over the parameters; NaN without a test
    pairs: tuple[statistics.Pair, ...]  # All pairs of values, by their places; empty unless that p is below the level

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


def effects_at(
    surface: TaskSurface, best: int, *, error: FloatArray, allowed: BoolArray, level: float = 0.05
) -> tuple[ParameterEffect, ...]:
    """Say what each parameter does about a protocol: error (S, P) deg, allowed (P,)."""
    columns = {name: np.asarray(getattr(surface, name)) for name in PARAMETERS}
    same = {name: np.isclose(column, column[best]) for name, column in columns.items()}
    effects = []
    for name, column in columns.items():
        places = np.flatnonzero(allowed & np.all([same[other] for other in PARAMETERS if other != name], axis=0))
        places = places[np.argsort(column[places])]
        enough = np.isfinite(error[:, places]).mean(axis=0) >= FEWEST_SHARE
        kept = places[enough]
        own = error[:, kept]
        test = _tested(own)
        effect = ParameterEffect(
            name=name,
            values=column[kept],
            best=int(np.flatnonzero(kept == best)[0]),
            means_deg=test.means if isinstance(test, MixedModel) else np.nanmean(own, axis=0),
            missing=int(np.isnan(own).sum()),
            dropped=column[places[~enough]],
            anova=test if isinstance(test, Anova) else None,
            mixed=test if isinstance(test, MixedModel) else None,
            untested=test if isinstance(test, Finding) else None,
            p_holm=float("nan") if isinstance(test, Finding) else test.p_value,
            pairs=(),
        )
        effects.append((effect, own))
    tested = [effect.p_holm for effect, _ in effects if effect.test is not None]
    holm = iter(adjust_holm(tested))
    made = []
    for effect, own in effects:
        p = float("nan") if effect.test is None else float(next(holm))
        pairs = (compare_pairs(own) if effect.mixed is None else compare_pairs_of(effect.mixed)) if p < level else ()
        made.append(replace(effect, p_holm=p, pairs=pairs))
    return tuple(made)


def _tested(error: FloatArray) -> Anova | MixedModel | Finding:
    """Return the test that suits the errors with each value (S, k), or why there is none."""
    if error.shape[1] < 2:
        return finding("study.one_value", "info")
    there = np.isfinite(error)
    try:
        if there.all():
            return statistics.compare_conditions(error)
        # by value first, so that the model's conditions come in the order of the values
        condition, subject = np.nonzero(there.T)
        return statistics.compare_unbalanced(
            error[subject, condition], [str(s) for s in subject], [str(c) for c in condition]
        )
    except InputError:  # nothing to test against
        return finding("study.all_alike", "info")


# ---- optimum

FLAT_SHARE = 0.25  # a minimum that a quarter of the protocols share is called flat where no parameter decides


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimum:
    """What a study says of one task."""

    best: int  # Place of the protocol with the least mean error
    error_rms_deg: float  # Mean over the subjects of both errors at the optimum, deg
    error_max_deg: float
    honest_error_deg: float  # Mean of the objective by subjects that did not choose it, deg
    honest_interval_deg: tuple[float, float]  # Its 95 % interval
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
    honest, interval = mean_interval(_honest(error, usable))
    tested = [effect.p_holm for effect in effects if effect.test is not None]
    deciding = tuple(effect.name for effect in effects if effect.p_holm < level)
    return Optimum(
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


def _honest(error: FloatArray, usable: BoolArray) -> FloatArray:
    """Return the error of the protocol that the other half of the subjects chose, each subject once."""
    places = np.flatnonzero(usable)
    half = np.arange(len(error)) % 2 == 0
    judged = np.empty(len(error))
    for choosing in (half, ~half):
        chosen = places[int(np.argmin(error[np.ix_(choosing, places)].mean(axis=0)))]
        judged[~choosing] = error[~choosing, chosen]
    return judged


# ---- the other cohort


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """A protocol on the other cohort."""

    subjects: int  # How many
    failed: int  # For how many of them it could not calibrate the device
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
    other, found = other_study(study), []
    for name in ("best", "cheapest"):
        places = [int(getattr(optimum, name)) for optimum in optima]
        tasks = tuple(map(_only, study.tasks, surfaces, places))
        # a few seconds' work: shorter than starting workers
        found.append(map(_on_others, run_study(replace(other, tasks=tasks), InProcess(), folder / name)))
    return tuple(zip(*found, strict=True))


def cohort_of(study: Study) -> Cohort:
    """Return who was simulated."""
    people = [subject_of(study, number) for number in range(study.subjects)]
    ages, heights = (np.array([getattr(person, name) for person in people]) for name in ("age_years", "height"))
    age, height = ((float(x.min()), float(x.mean()), float(x.max())) for x in (ages, heights))
    return Cohort(group=study.group, count=study.subjects, age_years=age, height=height, printed=TABLE_2[study.group])


def _only(task: StudyTask, surface: TaskSurface, place: int) -> StudyTask:
    cutoff, *dps = (float(getattr(surface, name)[place]) for name in PARAMETERS)
    step, low, high = ((value * RADIAN_PER_DEGREE,) for value in dps)
    return replace(task, space=Space(cutoff_hz=(cutoff,), turn_rate_step=step, turn_rate_min=low, turn_rate_max=high))


def _on_others(surface: TaskSurface) -> Tested:
    done = np.isfinite(surface.error_rms_deg[:, 0])
    error_rms, of_rms = mean_interval(surface.error_rms_deg[done, 0])
    error_max, of_max = mean_interval(surface.error_max_deg[done, 0])
    return Tested(
        subjects=len(done),
        failed=int((~done).sum()),
        error_rms_deg=error_rms,
        error_max_deg=error_max,
        interval_rms_deg=of_rms,
        interval_max_deg=of_max,
    )


# ---- comparison with the note's Table 1


NoteVerdict = Literal["agrees", "differs", "not tried"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteComparison:
    """A row of the note compared with an optimum."""

    row: NoteRow  # As printed
    place: int | None  # Of the note's protocol on the surface; None where it was not tried
    error_deg: float  # Mean of the objective with the note's protocol, deg
    difference_deg: float  # That minus the optimum's, deg
    verdict: NoteVerdict
    finding: Finding  # Why


def compare_with_note(
    surface: TaskSurface, optimum: Optimum, row: NoteRow, objective: str = "rms", level: float = 0.05
) -> NoteComparison:
    """Compare an optimum with the note's: they agree where the note's protocol is statistically as good."""
    wanted = np.array([getattr(row, name) for name in PARAMETERS])
    table = np.stack([getattr(surface, name) for name in PARAMETERS], axis=1)
    place, errors, best = _place(table, wanted), surface.error(objective), optimum.best
    mean = errors.mean(axis=0)
    verdict: NoteVerdict = "agrees"
    error, ours = float("nan") if place is None else float(mean[place]), float(mean[best])
    if place is None or not np.isfinite(error):
        verdict = "not tried"
        why = finding("study.note_not_tried" if place is None else "study.note_uncalibrated", "info")
    elif place == best:
        why = finding("study.note_is_optimum", "info", alike=optimum.equivalent.sum() - 1, others=len(mean) - 1)
    elif optimum.equivalent[place]:
        least = _least_seen(errors[:, place] - errors[:, best], len(mean), level)
        numbers = {"error_deg": error, "optimum_deg": ours, "subjects": len(errors), "detectable_deg": least}
        why = finding("study.note_as_good", "info", **numbers)
    else:
        verdict, why = "differs", _worse(table, mean, place, best)
    return NoteComparison(
        row=row, place=place, error_deg=error, difference_deg=error - ours, verdict=verdict, finding=why
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
