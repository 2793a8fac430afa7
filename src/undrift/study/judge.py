"""Judge the surface of a task: the optimum, what each parameter does, the other cohort, the note's row.

The least of many noisy means is biased low. So each subject gives the error of the protocol that all the others choose.
A protocol is equivalent to the optimum where its mean error is shown to be less than the margin above (one-sided paired t test),
worse where it is shown to be more than that above, else not decidable. The first is after Bonferroni over the protocols, the second
over all their pairs, as the optimum is chosen. The equivalent one with the shortest session is the one to use.

A parameter is tested with the others at the optimum: analysis of variance and paired tests of the levels. A level that leaves a
device uncalibrated is listed and not tested. p is after Holm over the parameters. It is
worth setting where the optimum's value is shown to be better than another by more than the margin. Its values are equivalent where
each pair is shown to be within the margin, which needs no correction for the pairs. Both are after Bonferroni over the parameters.
The other cohort shares nothing with the first.

A value of the note is confirmed where it is better than a next value that was tried and equivalent or better on the other side too,
indifferent where it is equivalent to both. The next value's protocol is the one nearest to the note's in all else. The row is
confirmed, or indifferent, where its values are and its protocol is equivalent to the optimum.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import DEFAULT, Group, TableRow, numbers_of, table_row
from undrift.study import statistics
from undrift.study.case import COLUMNS, subject_of
from undrift.study.plan import AIM, Aim, NoteRow, Objective, Study, StudyTask, Timing
from undrift.study.run import Executor, TaskSurface, run_study
from undrift.study.space import HEADINGS, TURN_RATES, Space
from undrift.study.statistics import (
    Anova,
    Decision,
    Pair,
    Verdict,
    adjust_holm,
    compare_pairs,
    decide,
    decide_between,
    mean_limits,
    three_sided,
)
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import mean_interval

# ---- effect of each parameter, the others at the optimum

PARAMETERS = COLUMNS[:4]
SYMBOLS = {name: heading.split(" (")[0] for name, heading in HEADINGS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterVerdict:
    """Whether a parameter is worth setting, against the margin."""

    verdict: Verdict  # better: than one value or more; equivalent: all values are
    decisions: tuple[Decision, ...]  # The optimum's value against each of the others
    widest: Decision  # Of the two values that differ most, after Bonferroni over the parameters alone
    p_better: float  # Least of the decisions'
    p_equivalent: float  # That two values differ by the margin or more, after Bonferroni over the parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterEffect:
    """Whether one parameter of the protocol matters, the others at the optimum."""

    name: str  # Of the parameter
    values: FloatArray  # (k,), its values, Hz or deg/s
    places: IntArray  # (k,), the protocols that have them, alike in all else
    best: int  # Which of them is the optimum; the best of them where the optimum was tried with one value alone
    means_deg: FloatArray  # (k,), mean error at each, deg
    dropped: FloatArray  # Values left out, since they leave a device uncalibrated
    anova: Anova | None  # None where it could not be made
    untested: Finding | None  # Why it could not
    p_holm: float  # p after Holm over the parameters; NaN without a test
    pairs: tuple[Pair, ...]  # All pairs of values, by their places; empty unless that p is below the level
    # Against the margin; None with one value
    judged: ParameterVerdict | None = None

    @property
    def span_deg(self) -> float:
        """Greatest less least mean error, deg: what the parameter is worth."""
        return float(np.ptp(self.means_deg))

    @property
    def error_variance(self) -> float:
        """Variance of a response about the subject's own mean and the value's, deg squared; NaN without a test."""
        return float("nan") if self.anova is None else self.anova.mean_square_error


def effects_at(
    surface: TaskSurface, best: int, *, error: FloatArray, allowed: BoolArray, aim: Aim = AIM
) -> tuple[ParameterEffect, ...]:
    """Say what each parameter does about a protocol: error (S, P) deg, allowed (P,)."""
    effects = []
    for name in surface.names:
        column, line = surface.column(name), _line_of(surface, best, name, error)
        places = line[allowed[line]]
        enough = np.isfinite(error[:, places]).all(axis=0)
        kept = places[enough]
        own = error[:, kept]
        test = _tested(own)
        at = np.flatnonzero(kept == best)
        effect = ParameterEffect(
            name=name,
            values=column[kept],
            places=kept,
            best=int(at[0] if len(at) else np.argmin(own.mean(axis=0))),
            means_deg=own.mean(axis=0),
            dropped=column[places[~enough]],
            anova=test if isinstance(test, Anova) else None,
            untested=test if isinstance(test, Finding) else None,
            p_holm=float("nan") if isinstance(test, Finding) else test.p_value,
            pairs=(),
        )
        effects.append((effect, own))
    holm = iter(adjust_holm([effect.p_holm for effect, _ in effects if effect.anova is not None]))
    pairs = [_pairs(effect, own) for effect, own in effects]
    tests, made = sum(map(bool, pairs)), []
    for (effect, own), each in zip(effects, pairs, strict=True):
        p = float("nan") if effect.anova is None else float(next(holm))
        judged = judge_values(effect.best, each, len(own), aim, tests=tests) if each else None
        made.append(replace(effect, p_holm=p, pairs=each if p < aim.level else (), judged=judged))
    return tuple(made)


def _line_of(surface: TaskSurface, best: int, name: str, error: FloatArray) -> IntArray:
    """Return the protocols that differ in one parameter alone: about the optimum, or about the best that has several values."""
    line, mean = surface.line(best, name), error.mean(axis=0)
    if len(line) == 1 and np.ptp(surface.column(name)) > 0.0:
        for place in np.argsort(mean)[: np.isfinite(mean).sum()]:
            if len(other := surface.line(int(place), name)) > 1:
                return other
    return line


def _pairs(effect: ParameterEffect, error: FloatArray) -> tuple[Pair, ...]:
    return compare_pairs(error) if len(effect.values) > 1 and len(error) > 2 else ()


def judge_values(best: int, pairs: tuple[Pair, ...], subjects: int, aim: Aim, *, tests: int) -> ParameterVerdict:
    """Judge a parameter of several ``tests`` by all pairs of its values."""
    level, margin = aim.level, aim.margin_deg
    own = tuple(
        decide(pair, subjects, of=best, margin=margin, level=level, tests=tests * len(pairs))
        for pair in pairs
        if best in (pair.first, pair.second)
    )
    apart, uncertainty = (np.array([getattr(pair, name) for pair in pairs]) for name in ("difference", "uncertainty"))
    p_equivalent = min(tests * float(three_sided(apart, uncertainty, subjects - 1, margin=margin)[1].max()), 1.0)
    p_better = min(decision.p_better for decision in own)
    widest = max(pairs, key=lambda pair: abs(pair.difference))
    return ParameterVerdict(
        verdict="better" if p_better <= level else "equivalent" if p_equivalent <= level else "not decidable",
        decisions=own,
        widest=decide(widest, subjects, of=widest.first, margin=margin, level=level, tests=tests),
        p_better=p_better,
        p_equivalent=p_equivalent,
    )


def _tested(error: FloatArray) -> Anova | Finding:
    """Return the test that suits the errors with each value (S, k), or why there is none."""
    if error.shape[1] < 2:
        return finding("study.one_value", "info")
    try:
        return statistics.compare_conditions(error)
    except InputError:  # nothing to test against
        return finding("study.all_alike", "info")


# ---- optimum

FLAT_SHARE = 0.25  # a minimum that a quarter of the others are equivalent to is flat where no parameter decides


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimum:
    """What a study says of one task."""

    objective: Objective  # That is minimised
    timing: Timing
    best: int  # Place of the protocol with the least mean error
    error_rms_deg: float  # Mean over the subjects of both errors at the optimum, deg
    error_max_deg: float
    honest_error_deg: float  # Mean of the objective by subjects that did not choose it, deg
    honest_interval_deg: tuple[float, float]  # Its 95 % interval
    margin_deg: float  # Smallest difference that matters, deg
    equivalent: BoolArray  # (P,), protocols that are shown to be worse by less than the margin, the optimum among them
    worse: BoolArray  # (P,), those that are shown to be worse by more
    undecided: BoolArray  # (P,), those that are allowed and calibrate all devices, and neither
    cheapest: int  # Of the equivalent ones, that with the shortest session
    flat: bool  # Whether a quarter of the other protocols or more are equivalent, and no parameter decides the error
    deciding: tuple[str, ...]  # Parameters whose verdict is better
    edges: tuple[str, ...]  # Those of them whose error still falls at the first or last value that was tried
    effects: tuple[ParameterEffect, ...]  # One a parameter
    p_value: float  # Least p after Holm over the parameters: whether any of them matters
    failed: int  # Runs whose protocol could not calibrate the device


def find_optimum(surface: TaskSurface, aim: Aim = AIM) -> Optimum:
    """Find the best protocol of a task, and those that are equivalent."""
    error, timing = surface.aimed(aim), aim.timing
    allowed = surface.rig_minutes <= (np.inf if aim.rig_minutes_max is None else aim.rig_minutes_max)
    usable: BoolArray = np.isfinite(error).all(axis=0) & allowed
    if not usable.any():
        raise NotObservable(
            f"study: wanted a protocol of {surface.task} that calibrates every device in the time allowed, got none; "
            "allow longer sessions or other rates"
        )
    mean = np.where(usable, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    best = int(np.argmin(mean))
    equivalent, worse = _against_best(error, usable, best, aim)
    among = np.flatnonzero(equivalent)
    cheapest = int(among[np.lexsort((mean[among], surface.rig_minutes[among]))[0]])
    effects = effects_at(surface, best, error=error, allowed=allowed, aim=aim)
    honest, interval = mean_interval(_honest(error, usable))
    tested = [effect.p_holm for effect in effects if effect.anova is not None]
    deciding = tuple(effect.name for effect in effects if effect.judged and effect.judged.verdict == "better")
    return Optimum(
        objective=aim.objective,
        timing=timing,
        best=best,
        error_rms_deg=float(surface.error("rms", timing)[:, best].mean()),
        error_max_deg=float(surface.error("maximum", timing)[:, best].mean()),
        honest_error_deg=honest,
        honest_interval_deg=interval,
        margin_deg=aim.margin_deg,
        equivalent=equivalent,
        worse=worse,
        undecided=usable & ~equivalent & ~worse,
        cheapest=cheapest,
        flat=bool(equivalent.sum() - 1 >= max(FLAT_SHARE * (usable.sum() - 1), 1)) and not deciding,
        deciding=deciding,
        edges=tuple(effect.name for effect in effects if effect.name in deciding and _at_edge(surface, best, effect)),
        effects=effects,
        p_value=min(tested) if tested else float("nan"),
        failed=int(np.isnan(error).sum()),
    )


def _at_edge(surface: TaskSurface, best: int, effect: ParameterEffect) -> bool:
    """Return whether the optimum has the first or last value that was tried, and the next one is not equivalent."""
    beside = {each.other: each.verdict for each in effect.judged.decisions} if effect.judged else {}
    flat = any(beside.get(effect.best + step) == "equivalent" for step in (-1, 1))
    return not flat and best in effect.places and surface.at_end(float(effect.values[effect.best]), effect.name)


def _against_best(error: FloatArray, usable: BoolArray, best: int, aim: Aim) -> tuple[BoolArray, BoolArray]:
    """Return which protocols are shown to be equivalent to the best, and which to be worse."""
    places, subjects = np.flatnonzero(usable), len(error)
    apart = error[:, places] - error[:, [best]]
    uncertainty = apart.std(axis=0, ddof=1) / np.sqrt(subjects)
    p_worse, p_equivalent, _ = three_sided(apart.mean(axis=0), uncertainty, subjects - 1, margin=aim.margin_deg)
    others = len(places) - 1
    equivalent, worse = np.zeros((2, len(usable)), dtype=bool)
    equivalent[places] = others * p_equivalent <= aim.level  # chosen for its low mean, the best makes this harder
    # and this easier: any pair could have been compared
    worse[places] = 0.5 * others * (others + 1) * p_worse <= aim.level
    equivalent[best], worse[best] = True, False
    return equivalent, worse


def _honest(error: FloatArray, usable: BoolArray) -> FloatArray:
    """Return the error of each subject with the protocol that all others chose: one person left out."""
    places, every = np.flatnonzero(usable), np.arange(len(error))
    table = error[:, places]
    return np.asarray(table[every, np.argmin(table.sum(axis=0) - table, axis=1)])


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
    # Lower and upper limit of the mean of what the study minimises, each at its confidence, one-sided, deg
    limits_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cohort:
    """A cohort as it was simulated, beside what the note prints."""

    group: Group  # simulation or testing
    count: int  # Subjects
    category: str
    label: str  # Of the category, for people
    age_years: tuple[float, float, float]  # Lowest, mean and highest, years and m
    height: tuple[float, float, float]
    printed: TableRow  # The note's Table 2; for another category what it is drawn by


def other_study(study: Study) -> Study:
    """Return the same study for the other cohort, with random numbers of its own."""
    group: Group = "testing" if study.group == "simulation" else "simulation"
    seed = int(np.random.SeedSequence((study.seed, 1)).generate_state(1, np.uint64)[0])
    return replace(study, group=group, seed=seed)


def run_testing(
    study: Study, surfaces: tuple[TaskSurface, ...], chosen: Sequence[Sequence[int]], folder: Path, executor: Executor
) -> tuple[tuple[Tested, ...], ...]:
    """Run a protocol of each task on the other cohort, for each of several choices."""
    other, found = other_study(study), list[list[Tested]]()
    for places in chosen:
        tasks = tuple(map(only, study.tasks, surfaces, places))
        mark = hashlib.sha256(repr(tasks).encode()).hexdigest()[:12]  # another objective chooses other protocols
        tried = run_study(replace(other, tasks=tasks), executor, folder / mark)
        found.append([_on_others(surface, study) for surface in tried])
    return tuple(zip(*found, strict=True))


def cohort_of(study: Study, category: str = DEFAULT) -> Cohort:
    """Return who was simulated."""
    people = [subject_of(study, number, category) for number in range(study.subjects)]
    ages, heights = (np.array([getattr(person, name) for person in people]) for name in ("age_years", "height"))
    age, height = ((float(x.min()), float(x.mean()), float(x.max())) for x in (ages, heights))
    kind, of = study.kind(category), {"group": study.group, "count": study.subjects, "category": category}
    more: Any = of | {"printed": table_row(study.group, kind), "label": numbers_of(kind).label}
    return Cohort(age_years=age, height=height, **more)


def only(task: StudyTask, surface: TaskSurface, place: int) -> StudyTask:
    """Return a task with one protocol of its surface."""
    rates: Any = {name: (float(surface.column(f"{name}_dps")[place]) * RADIAN_PER_DEGREE,) for name in TURN_RATES}
    further = tuple((name, (float(values[place]),)) for name, values in surface.further.items())
    return replace(task, space=Space(cutoff_hz=(float(surface.cutoff_hz[place]),), further=further, **rates))


def _on_others(surface: TaskSurface, aim: Aim) -> Tested:
    timing = aim.timing
    done = np.isfinite(surface.error_rms_deg[:, 0])
    error_rms, of_rms = mean_interval(surface.error("rms", timing)[done, 0])
    error_max, of_max = mean_interval(surface.error("maximum", timing)[done, 0])
    return Tested(
        subjects=len(done),
        failed=int((~done).sum()),
        error_rms_deg=error_rms,
        error_max_deg=error_max,
        interval_rms_deg=of_rms,
        interval_max_deg=of_max,
        limits_deg=mean_limits(surface.aimed(aim)[done, 0], aim.confidence),
    )


# ---- comparison with the note's Table 1


# Indifferent: equivalent to the values beside it, any of them does
NoteVerdict = Literal["confirmed", "indifferent", "contradicted", "not decidable", "not tried"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteValue:
    """A value of the note's row beside the next that were tried."""

    name: str  # Of the parameter
    value: float  # Hz or deg/s
    lower: Decision | None  # Against the protocol with the next lower value; None where none was tried
    upper: Decision | None  # As above, higher
    verdict: NoteVerdict
    finding: Finding  # Why


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteComparison:
    """A row of the note compared with an optimum."""

    row: NoteRow  # As printed
    place: int | None  # Of the note's protocol on the surface; None where it was not tried
    error_deg: float  # Mean of the objective with the note's protocol, deg
    difference_deg: float  # That minus the optimum's, deg
    verdict: NoteVerdict
    finding: Finding  # Why: its protocol against the optimum
    values: tuple[NoteValue, ...]  # One a parameter; empty where the protocol was not tried

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All reasons."""
        return (self.finding, *(value.finding for value in self.values))


def compare_with_note(surface: TaskSurface, optimum: Optimum, row: NoteRow, aim: Aim = AIM) -> NoteComparison:
    """Compare a row of the note with the optimum, and each of its values with the next that were tried."""
    table = np.stack([surface.column(name) for name in surface.names], axis=1)
    errors, best = surface.aimed(aim), optimum.best
    mean, values = errors.mean(axis=0), tuple[NoteValue, ...]()
    place = _place_of_note(surface, table, row, mean)
    error, ours = float("nan") if place is None else float(mean[place]), float(mean[best])
    verdict: NoteVerdict = "not decidable"
    if place is None or not np.isfinite(error):
        verdict = "not tried"
        why = finding("study.note_not_tried" if place is None else "study.note_uncalibrated", "info")
    else:
        values = _note_values(table, errors, place, margin=optimum.margin_deg, level=aim.level)
        why = _against_optimum(table, errors, place, optimum, aim.level)
        if optimum.worse[place] or any(value.verdict == "contradicted" for value in values):
            verdict = "contradicted"
        elif optimum.equivalent[place] and (verdicts := {value.verdict for value in values}) <= {
            "confirmed",
            "indifferent",
        }:
            verdict = "confirmed" if "confirmed" in verdicts else "indifferent"
    return NoteComparison(
        row=row, place=place, error_deg=error, difference_deg=error - ours, verdict=verdict, finding=why, values=values
    )


def _place_of_note(surface: TaskSurface, table: FloatArray, row: NoteRow, mean: FloatArray) -> int | None:
    """Return the protocol of the note's row: of several, alike but in what it has no value of, that with most values beside it."""
    four = [getattr(row, name) for name in PARAMETERS]
    places = np.flatnonzero(np.isclose(table[:, : len(four)], four, rtol=1e-6).all(axis=1))
    beside = [sum(len(surface.line(int(place), name)) for name in PARAMETERS) for place in places]
    return int(places[np.lexsort((mean[places], -np.array(beside)))[0]]) if len(places) else None


def _against_optimum(table: FloatArray, errors: FloatArray, place: int, optimum: Optimum, level: float) -> Finding:
    mean, best, others = errors.mean(axis=0), optimum.best, len(table) - 1
    numbers = {"error_deg": mean[place], "optimum_deg": mean[best], "margin_deg": optimum.margin_deg}
    if place == best:
        alike = optimum.equivalent.sum() - 1
        return finding("study.note_is_optimum", "info", alike=alike, others=others, margin_deg=optimum.margin_deg)
    if optimum.equivalent[place]:
        return finding("study.note_as_good", "info", subjects=len(errors), **numbers)
    if optimum.worse[place]:
        return _worse(table, mean, place, best)
    found = decide_between(errors[:, best], errors[:, place], margin=optimum.margin_deg, level=level, tests=others)
    return finding("study.note_undecided", "warn", subjects=len(errors), interval_deg=found.interval, **numbers)


def _note_values(
    table: FloatArray, errors: FloatArray, place: int, *, margin: float, level: float
) -> tuple[NoteValue, ...]:
    """Compare each value of the note's protocol with the next lower and higher that calibrated every device."""
    usable = np.asarray(np.isfinite(errors).all(axis=0))
    beside = [[_next(table, usable, place, k, up) for up in (False, True)] for k in range(len(PARAMETERS))]
    tests = sum(at is not None for pair in beside for at in pair)
    words: Any = {"margin": margin, "level": level, "tests": tests}
    values = []
    for k, (name, at) in enumerate(zip(PARAMETERS, beside, strict=True)):
        lower, upper = (
            None if other is None else replace(decide_between(errors[:, place], errors[:, other], **words), other=other)
            for other in at
        )
        verdict, why = _of_value(table, place, k, lower, upper)
        values.append(
            NoteValue(name=name, value=float(table[place, k]), lower=lower, upper=upper, verdict=verdict, finding=why)
        )
    return tuple(values)


def _next(table: FloatArray, usable: BoolArray, place: int, k: int, up: bool) -> int | None:
    """Return the protocol with the next value of a parameter that is nearest in the others, by their ratios."""
    own, column = table[place, k], table[:, k]
    beyond = usable & (column > own * (1.0 + 1e-6) if up else column < own * (1.0 - 1e-6))
    if not beyond.any():
        return None
    value = column[beyond].min() if up else column[beyond].max()
    places = np.flatnonzero(beyond & np.isclose(column, value))
    apart = np.abs(np.log(np.delete(table[places] / table[place], k, axis=1))).sum(axis=1)
    return int(places[np.argmin(apart)])


def _of_value(
    table: FloatArray, place: int, k: int, lower: Decision | None, upper: Decision | None
) -> tuple[NoteVerdict, Finding]:
    """Judge a value by what it is against the next ones."""
    beside = [each for each in (lower, upper) if each is not None]
    verdicts, own = tuple(each.verdict for each in beside), float(table[place, k])
    numbers = {
        "parameter": SYMBOLS[PARAMETERS[k]],
        "value": own,
        "unit": "Hz" if k == 0 else "deg/s",
        "others": table[[each.other for each in beside], k],
        "verdicts": verdicts,
        "difference_deg": tuple(each.difference for each in beside),
        "p": tuple(_quoted(each) for each in beside),
        "margin_deg": beside[0].margin if beside else 0.0,
    }
    if "worse" in verdicts:
        return "contradicted", finding("study.note_value_contradicted", "warn", **numbers)
    if len(beside) < 2:
        end = "only" if not beside else "least" if lower is None else "greatest"
        return "not decidable", finding("study.note_value_at_edge", "warn", end=end, **numbers)
    if "not decidable" in verdicts:
        return "not decidable", finding("study.note_value_undecided", "warn", **numbers)
    if "better" in verdicts:
        return "confirmed", finding("study.note_value_confirmed", "info", **numbers)
    return "indifferent", finding("study.note_value_indifferent", "info", **numbers)


def _quoted(found: Decision) -> float:
    """Return the p of a verdict; the least of the three where there is none."""
    p: dict[str, float] = {"better": found.p_better, "equivalent": found.p_equivalent, "worse": found.p_worse}
    return p.get(found.verdict, min(p.values()))


def _place(table: FloatArray, wanted: FloatArray) -> int | None:
    hits = np.flatnonzero(np.isclose(table, wanted, rtol=1e-6).all(axis=1))
    return int(hits[0]) if len(hits) else None


def _worse(table: FloatArray, mean: FloatArray, place: int, best: int) -> Finding:
    """Name the parameter whose exchange for ours removes most of the error, where such protocols were tried."""
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
