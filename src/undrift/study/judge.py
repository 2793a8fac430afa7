"""Results of a study: the error of each session, the cheapest session that is good enough, and the causes of the error.

A session is good enough for a target if the errors of 95 % of the calibrated devices, each on a different person, are below the
target. The quantile is used, not the mean, because a user has a single device. The answer is the shortest session that is good
enough. It is tested again with other devices on the other group of people.

To test if the error depends on a parameter, every subject is evaluated with each of k values: F = MS_condition / MS_error, with
degrees of freedom (k - 1) and (n - 1)(k - 1) times Greenhouse and Geisser's epsilon (1959). p values of several parameters are
adjusted after Holm (1979). With enough simulated people, any difference becomes significant. Therefore each p is reported with the
span of the means in degrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.study.case import EFFECTS
from undrift.study.methods import MethodRow
from undrift.study.plan import Parameter, Study, StudyTask, Timing
from undrift.study.run import SENSITIVITY_K, Run
from undrift.study.sessions import CalibrationSession
from undrift.validation.agreement import MIN_PEOPLE, PairedDifference, decide_between, mean_interval

QUANTILE = 0.95
ENDS = (0.025, 0.975)

# ---- analysis of variance


@dataclass(frozen=True, slots=True, kw_only=True)
class Anova:
    """One-way repeated-measures analysis of variance."""

    subjects: int
    f: float
    dof: tuple[float, float]  # not corrected
    epsilon: float  # epsilon of Greenhouse and Geisser
    p_value: float  # with the corrected degrees of freedom


def repeated_measures_anova(errors: ArrayLike) -> Anova:
    """Compare k conditions with n subjects, all evaluated in each condition: errors (n, k)."""
    from scipy.linalg import helmert
    from scipy.special import fdtrc

    y = np.asarray(errors, dtype=float)
    if y.ndim != 2 or y.shape[0] < 3 or y.shape[1] < 2 or not np.isfinite(y).all():
        raise InputError(
            f"anova: expected three subjects or more in two conditions or more without gaps, got shape {y.shape}."
        )
    n, k = y.shape
    condition_means, subject_means, grand = y.mean(axis=0), y.mean(axis=1, keepdims=True), y.mean()
    between = n * float(((condition_means - grand) ** 2).sum())
    error = float(((y - condition_means - subject_means + grand) ** 2).sum())
    d1, d2 = float(k - 1), float((n - 1) * (k - 1))
    if error <= 1e-24 * max(float(((y - grand) ** 2).sum()), 1e-300):
        raise InputError("anova: all subjects respond alike. The differences between the conditions are exact.")
    f = (between / d1) / (error / d2)
    covariance = np.atleast_2d(np.cov(y @ helmert(k).T, rowvar=False))
    squares = float((covariance * covariance).sum())
    epsilon = min(1.0, float(np.trace(covariance)) ** 2 / (d1 * squares)) if squares > 0.0 else 1.0
    p = float(fdtrc(epsilon * d1, epsilon * d2, f))
    return Anova(subjects=n, f=f, dof=(d1, d2), epsilon=epsilon, p_value=p)


def adjust_holm(p: ArrayLike) -> FloatArray:
    """Adjust p values (m,) after Holm (Scandinavian Journal of Statistics 6, 1979)."""
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate((len(values) - np.arange(len(values))) * values[order])
    adjusted = np.empty(len(values))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


# ---- results


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionErrors:
    """One session in one task."""

    session: CalibrationSession
    mean_deg: float
    interval_deg: tuple[float, float]  # 95 % interval of the mean
    quantile_deg: float  # error that 95 % of devices stay below
    # prediction interval of a further device, 95 % (or (n - 1) / (n + 1) with fewer than 39)
    single_deg: tuple[float, float]
    real_time_deg: float  # mean error relative to the current true pitch
    failed: int  # number of devices that the session could not calibrate
    # this session compared with the session that has the smallest mean (None for the latter)
    against_best: PairedDifference | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The cheapest session that is good enough for a target."""

    target_deg: float
    session: str  # empty if no session is good enough
    below: int = 0  # number of devices of the other group with an error below the target
    tested: int = 0  # number of devices of the other group (0 for recorded people)

    @property
    def confirmed(self) -> bool:
        """True if 95 % of the other group's devices stay below the target too."""
        return self.tested > 0 and self.below >= QUANTILE * self.tested


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterEffect:
    """Effect of one of the note's four numbers, with constant values of the other three."""

    parameter: Parameter
    values: tuple[float, ...]
    means_deg: tuple[float, ...]
    own: float  # value around which the other values were tried
    anova: Anova | None  # None if the differences are exact
    p_holm: float  # adjusted over the parameters of the task, or NaN without an analysis
    differences: tuple[PairedDifference, ...]  # each other value compared with the default

    @property
    def verdict(self) -> str:
        """Return True if another value is better than the default by more than the margin."""
        verdicts = {difference.verdict for difference in self.differences}
        if "better" in verdicts:
            return "another value is better"
        if verdicts == {"equivalent"}:
            return "indifferent"
        return "own value confirmed" if verdicts <= {"worse", "equivalent"} else "not decidable"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskOutcome:
    """One task of a study."""

    task: StudyTask
    sessions: tuple[SessionErrors, ...]  # in order of duration
    answers: tuple[Answer, ...]
    effects: tuple[ParameterEffect, ...]
    breakdown: tuple[tuple[str, float], ...] = ()  # mean square caused by each error, as a share of the total


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOutcome:
    """Results of a study."""

    study: Study
    subjects: int
    tasks: tuple[TaskOutcome, ...]
    for_all: tuple[Answer, ...]  # the cheapest session that is good enough in every task
    # first task: temperature rise (infinite: as in the study), offset rule, session, 95 % quantile in deg (NaN if a device fails)
    sensitivity: tuple[tuple[float, str, str, float], ...]
    runs: tuple[Run, ...]
    methods: tuple[MethodRow, ...] = ()  # methods of undrift and rivals, for the note's preset


def errors_of(runs: Sequence[Run], task: str, session: str, timing: Timing, role: str = "session") -> FloatArray:
    """Return the rms error of each subject, (n,) deg, NaN for a device that was not calibrated."""
    task_runs = sorted(
        (run for run in runs if (run.task, run.session, run.role) == (task, session, role)), key=lambda run: run.subject
    )
    return np.array([run.rms_deg if timing == "aligned" else run.real_time_deg for run in task_runs])


def judge_sessions(study: Study, runs: Sequence[Run], task: StudyTask) -> tuple[SessionErrors, ...]:
    """Return every session in a task, starting with the shortest."""
    columns = {one.name: errors_of(runs, task.key, one.name, study.timing) for one in study.sessions}
    means = {name: float(np.nanmean(x)) if np.isfinite(x).any() else np.inf for name, x in columns.items()}
    best = min(means, key=lambda name: means[name])
    rows = []
    for session in sorted(study.sessions, key=lambda one: one.length_min):
        errors = columns[session.name]
        valid, both = np.isfinite(errors), np.isfinite(errors) & np.isfinite(columns[best])
        mean, interval = mean_interval(errors[valid])
        nan = float("nan")
        # the k-th of n errors is the quantile k / (n + 1) for a further device, so a few devices cannot reach 95 %
        ends = (*ENDS, QUANTILE)
        low, high, quantile = np.quantile(errors[valid], ends, method="weibull").tolist() if valid.any() else (nan,) * 3
        decision = None
        if session.name != best and both.sum() >= MIN_PEOPLE:
            tests = len(study.sessions) - 1
            decision = decide_between(errors[both], columns[best][both], margin=study.margin_deg, tests=tests)
        now = errors_of(runs, task.key, session.name, "real time")
        rows.append(
            SessionErrors(
                session=session, mean_deg=mean, interval_deg=interval, single_deg=(low, high), failed=int((~valid).sum()),
                quantile_deg=quantile if valid.all() else float("inf"),  # a failed device is not below the target
                real_time_deg=float(np.nanmean(now)) if np.isfinite(now).any() else nan, against_best=decision,
            )
        )  # fmt: skip
    return tuple(rows)


def find_answers(study: Study, rows: Sequence[Sequence[SessionErrors]]) -> tuple[Answer, ...]:
    """Return the cheapest session that is good enough for each target in every one of some tasks."""
    answers = []
    for target in study.target_deg:
        name = ""
        for row in rows[0]:
            session_rows = [other for task in rows for other in task if other.session.name == row.session.name]
            if all(other.quantile_deg <= target for other in session_rows):
                name = row.session.name
                break
        answers.append(Answer(target_deg=target, session=name))
    return tuple(answers)


def judge_parameters(study: Study, runs: Sequence[Run], task: StudyTask) -> tuple[ParameterEffect, ...]:
    """Return the effect of each of the note's four numbers on the error, with constant values of the other three."""
    if task.tried is None:
        return ()
    tried = {
        (run.session, run.cutoff_hz, run.subject): run for run in runs if run.task == task.key and run.role == "try"
    }
    subjects = sorted({subject for *_, subject in tried})
    effects = []
    for parameter in dict.fromkeys(name for name, *_ in task.variations()):
        values = [(value, numbers) for name, value, numbers in task.variations() if name == parameter]
        table = np.array(
            [[_error(tried[n.session().name, n.cutoff_hz, k], study.timing) for _, n in values] for k in subjects]
        )
        table = table[np.isfinite(table).all(axis=1)]
        anova = None
        if len(table) >= MIN_PEOPLE:
            try:
                anova = repeated_measures_anova(table)
            except InputError:
                anova = None
        default = getattr(task.tried.around, parameter)
        place = [value for value, _ in values].index(default)
        differences = tuple(
            decide_between(table[:, k], table[:, place], margin=study.margin_deg, tests=len(values) - 1)
            for k in range(len(values))
            if k != place and len(table) >= MIN_PEOPLE
        )
        effects.append(
            ParameterEffect(
                parameter=parameter, values=tuple(value for value, _ in values), means_deg=tuple(table.mean(axis=0).tolist()),
                own=default, anova=anova, p_holm=float("nan"), differences=differences,
            )
        )  # fmt: skip
    tested = [effect for effect in effects if effect.anova is not None]
    adjusted = iter(adjust_holm([effect.anova.p_value for effect in tested if effect.anova]).tolist())
    return tuple(replace(effect, p_holm=next(adjusted)) if effect.anova else effect for effect in effects)


def _error(run: Run, timing: Timing) -> float:
    return run.rms_deg if timing == "aligned" else run.real_time_deg


def chosen_sessions(outcome: StudyOutcome) -> tuple[tuple[str, str], ...]:
    """Return the task and session of every answer, each once."""
    pairs = [(task.task.key, answer.session) for task in outcome.tasks for answer in (*task.answers, *outcome.for_all)]
    return tuple(dict.fromkeys(pair for pair in pairs if pair[1]))


def judge(study: Study, runs: Sequence[Run]) -> StudyOutcome:
    """Evaluate the runs, without the test of the answers on the other group."""
    tasks = []
    for task in study.tasks:
        rows = judge_sessions(study, runs, task)
        effects = judge_parameters(study, runs, task)
        tasks.append(TaskOutcome(task=task, sessions=rows, answers=find_answers(study, [rows]), effects=effects))
    results_by_rise = dict[tuple[float, str, str], list[float]]()
    for run in runs:
        if run.role == "sensitivity" or (run.role, run.task) == ("session", study.tasks[0].key):
            rise = run.excursion_k if run.excursion_k in SENSITIVITY_K else float("inf")
            results_by_rise.setdefault((rise, run.offset, run.session), []).append(_error(run, study.timing))
    sensitivity = tuple(
        (rise, offset, name, float(np.quantile(errors, QUANTILE, method="weibull")))
        for (rise, offset, name), errors in sorted(results_by_rise.items())
    )
    return StudyOutcome(
        study=study,
        subjects=len({run.subject for run in runs}),
        tasks=tuple(tasks),
        for_all=find_answers(study, [task.sessions for task in tasks]),
        sensitivity=sensitivity,
        runs=tuple(runs),
    )


def with_test(outcome: StudyOutcome, tested: Sequence[Run], effects: Sequence[Run]) -> StudyOutcome:
    """Return the outcome with the test of its answers on the other group and the shares of each kind of error."""
    study = outcome.study

    def checked(answer: Answer, keys: Sequence[str]) -> Answer:
        columns = [errors_of(tested, key, answer.session, study.timing, "testing") for key in keys]
        if not answer.session or any(not len(column) for column in columns):
            return answer
        worst = np.max(np.nan_to_num(np.array(columns), nan=np.inf), axis=0)
        return replace(answer, below=int((worst <= answer.target_deg).sum()), tested=len(worst))

    tasks = []
    for task in outcome.tasks:
        key = task.task.key
        answers = tuple(checked(answer, [key]) for answer in task.answers)
        tasks.append(replace(task, answers=answers, breakdown=_breakdown(outcome, effects, task)))
    keys = [task.task.key for task in outcome.tasks]
    return replace(outcome, tasks=tuple(tasks), for_all=tuple(checked(answer, keys) for answer in outcome.for_all))


def breakdown_session(task: TaskOutcome) -> str:
    """Return the session for the split of the error: the answer for the first target that is reached, otherwise the best."""
    reached = [answer.session for answer in task.answers if answer.session]
    return reached[0] if reached else min(task.sessions, key=lambda row: row.mean_deg).session.name


def _breakdown(outcome: StudyOutcome, effects: Sequence[Run], task: TaskOutcome) -> tuple[tuple[str, float], ...]:
    key, name, timing = task.task.key, breakdown_session(task), outcome.study.timing
    rows = []
    for effect in EFFECTS:
        without = errors_of(effects, key, name, timing, effect)
        complete = errors_of(outcome.runs, key, name, timing)[: len(without)]
        both = np.isfinite(without) & np.isfinite(complete)
        if both.any():
            mean_square = float((complete[both] ** 2).mean())
            rows.append((effect, 1.0 - float((without[both] ** 2).mean()) / mean_square))
    return tuple(rows)
