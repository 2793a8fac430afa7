"""``undrift study``: which calibration protocol is enough for a task, found by simulation, tested on other subjects."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Flag, Output, options, verb
from undrift.base.summary import Result, Section, Summary, at, figure_of
from undrift.commands import Progress, silent
from undrift.commands.files import check_folder, origin_of, save_json
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import ParameterEffect
    from undrift.study.outcome import ErrorBreakdown, StudyOutcome, TaskOutcome
    from undrift.study.plan import Study
    from undrift.study.run import TaskSurface

QUICK_SUBJECTS = 8
# Of a study, in place of the plan's
NUMBERS = ("subjects", "offset", "target_deg", "confidence", "seed")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Studied(Result):
    """A study that was run to its end, and its folder."""

    outcome: "StudyOutcome"
    output: Path

    def summary(self) -> Summary:
        """Return the protocol to use for each task, and all that speaks for it."""
        from undrift.commands.study_rig import protocol_of, rig_sections, run_words
        from undrift.commands.study_sections import NOTE, answer_of, sections_of

        outcome, note = self.outcome, Section(title="The note", text=(NOTE,), folded=True)
        files = ("report.html", "summary.json", "surface.parquet")
        return Summary(
            title=f"Study: {outcome.study.name}",
            answer=answer_of(outcome),
            data=study_json(outcome),
            pictures=(figure_of("figures:draw_pareto", outcome, outcome.tasks[0]),),
            sections=(*sections_of(outcome), *rig_sections(outcome, self.output), note),
            written=(*(self.output / name for name in files), *sorted(self.output.glob("protocol-*.toml"))),
            next=run_words(protocol_of(outcome, outcome.tasks[0]), self.output),
        )


@options
@dataclass(frozen=True, kw_only=True)
class Choices:
    """What is other than in the plan.

    Parameters
    ----------
    quick : bool
        The ends of what is tried, on eight subjects: a first look.
    categories : str or None
        Categories of subjects, separated by commas, or "all": level_1 to level_4 (level_2 is the note's), young, elderly,
        impaired, parkinson, and those of the plan. Each performs every task. The plan's where not given, else level_2.
    subjects : int or None
        Other number of subjects than the plan's.
    offset : str or None
        Of the gyroscopes in a trial: "rest" takes off the mean of the rest before it; "motion" what a trial of 20 s or more shows
        from there on, as `orient` does; "none" nothing, as in the note. The plan's where not given, else "rest".
    target_deg : float or None
        Mean error that is good enough, deg: the cheapest session whose upper limit on other people and devices is below it.
    confidence : float or None
        Of that limit, one-sided; the plan's where not given, else 0.95.
    seed : int or None
        Other seed than the plan's; the same seed gives the same bits on any machine and any number of workers.
    """

    quick: Flag = False
    categories: str | None = None
    subjects: int | None = None
    offset: Literal["rest", "motion", "none"] | None = None
    target_deg: float | None = None
    confidence: float | None = None
    seed: int | None = None

    def applied(self, plan: Path | None) -> "Study":
        """Return the study of a plan, or the note's, with these choices."""
        from undrift.study.plan import ends_of, note_study, read_study, with_categories

        if self.seed is not None and self.seed < 0:
            raise InputError(f"seed: wanted 0 or more, got {self.seed}; give another")
        study = note_study(quick=self.quick) if plan is None else read_study(plan)
        if self.quick:
            study = study if plan is None else ends_of(study)
            study = replace(study, subjects=min(QUICK_SUBJECTS, study.subjects))
        numbers: dict[str, Any] = {name: getattr(self, name) for name in NUMBERS}
        study = replace(study, **{name: value for name, value in numbers.items() if value is not None})
        if self.categories is None:
            return study
        stated = [name.strip() for name in self.categories.split(",")]
        return with_categories(study, study.known if self.categories == "all" else stated)


@verb
def study(
    plan: Path | None = None,
    /,
    *,
    output: Output = Path("study"),
    preset: Literal["note"] | None = None,
    choices: Choices = Choices(),
    workers: int | None = None,
    scheduler: str | None = None,
    no_rivals: Flag = False,
    progress: Progress = silent,
) -> Studied:
    """Try calibration protocols on simulated subjects; find which is enough, with its error and its minutes on the rig.

    Parameters
    ----------
    plan : Path or None
        study.toml: tasks, subjects, device, what is tried. See docs/study.md.
    output : Path
        Folder for surface.parquet, report.html, summary.json and a protocol.toml for each task; an interrupted study in it
        resumes.
    preset : str or None
        "note" in place of a plan: the technical note's three tasks, thirty subjects, over 600 protocols each.
    workers : int or None
        Processes on this machine; all its processors where not given.
    scheduler : str or None
        Address of a Dask scheduler, as in tcp://host:8786, to work on its workers.
    no_rivals : bool
        Leave out the other ways to calibrate, which the note's Discussion names, 12 units of about 10 s, and the 30 drawn units
        of Figure 3, 5 s each on one processor. --quick implies it.
    """
    from undrift.study.case import run_unit, units_of
    from undrift.study.run import HEAD, Pool, RunStore, choose_executor

    if (plan is None) == (preset is None):
        raise InputError(f"study: wanted a study.toml or `preset` note, got {'both' if plan else 'neither'}; name one")
    planned = choices.applied(plan)
    executor, rivals = choose_executor(scheduler, workers), not (no_rivals or choices.quick)
    check_folder(output)
    if output.is_dir() and any(output.iterdir()) and not (output / HEAD).is_file():
        raise InputError(f"{output}: wanted a new folder, or that of this study, got other files; name another")
    RunStore(output, planned)  # refuses the folder of another study before anything is computed
    if isinstance(executor, Pool):  # while this process imports what it alone needs
        executor.start(partial(run_unit, units_of(planned)[0]))
    from undrift.commands.study_rig import write_protocols
    from undrift.study.outcome import StudyProgress, judge_study

    progress("\n".join((*_announced(planned, executor.workers), "")), 0.0)
    course = StudyProgress(progress, stages=5 if rivals else 3)
    outcome = judge_study(planned, executor, output, course=course, rivals=rivals)
    result = Studied(outcome=outcome, output=output)
    write_protocols(result.outcome, output)
    summary = result.summary()
    save_json(output / "summary.json", summary.data)
    at("undrift.report.page:write_page")(output / "report.html", summary, origin_of(plan))
    return result


def _announced(planned: "Study", workers: int) -> tuple[str, ...]:
    """Return how many runs there are, and which values no protocol has."""
    from undrift.study.outcome import untried_findings
    from undrift.study.run import count_runs

    tasks = ", ".join(task.key for task in planned.tasks)
    return (
        f"{planned.name}: {count_runs(planned)} runs ({tasks}; {planned.subjects} subjects) on {workers} "
        f"worker{'s' * (workers > 1)}",
        *(f"{task.key}: {item.text}" for task in planned.tasks for item in untried_findings(task.space.untried())),
    )


# ---- summary.json


HEAD_KEYS = (
    "name", "device", "subjects", "seed", "objective", "timing", "offset", "level", "margin_deg", "target_deg",
    "confidence",
)  # fmt: skip
FIGURE3_KEYS = ("none_max_deg", "static_max_deg", "full_max_deg", "rest_max_deg", "full_and_rest_max_deg")


def study_json(outcome: "StudyOutcome") -> dict[str, object]:
    """Return the JSON of a study."""
    from undrift.base.codec import tree_of

    held, figure = outcome.study, outcome.figure3
    return {
        **{key: getattr(held, key) for key in HEAD_KEYS},
        "bench": tree_of(held.bench) | {"chain_percent": 100.0 * held.chain_sd},
        "runs": outcome.runs,
        "tasks": [_task_json(task) for task in outcome.tasks],
        "cohorts": [
            {"group": one.group, "category": one.category, "subjects": one.count, "age_years": one.age_years}
            | {"height_m": one.height, "note_age_years": one.printed.age_years, "note_height_m": one.printed.height}
            for one in outcome.cohorts
        ],
        "figure3": figure and _figure3_json(figure),
        "figure3_missing": outcome.figure3_missing and outcome.figure3_missing.detail,
        "figure3_drawn": [asdict(row) for row in outcome.figure3_drawn] or None,
        "rivals": [asdict(row) | {"said": row.notes} for row in outcome.rivals] or None,  # binding key
        "rival_triads": [asdict(row) for row in outcome.rival_triads] or None,
        "rivals_missing": outcome.rivals_missing and outcome.rivals_missing.detail,
    }


def _figure3_json(figure: "Figure3") -> dict[str, object]:
    from undrift.study.figure3 import COMPARED

    return {
        **dict(zip(FIGURE3_KEYS, figure.actual_max_deg, strict=True)),
        "decrease_deg": figure.decrease_deg,
        "simulated_actual_max_deg": figure.simulated_actual_max_deg[2],
        "compared": COMPARED,
        "actual_max_deg": figure.actual_max_deg,
        "simulated_max_deg": figure.simulated_max_deg,
        "simulated_actual_by_level_deg": figure.simulated_actual_max_deg,
        "correlation": figure.correlation,
    }


def _task_json(task: "TaskOutcome") -> dict[str, object]:
    from undrift.io.store import findings_json
    from undrift.study.plan import ERRORS

    surface, found, front = task.surface, task.optimum, task.front
    errors = ("error_rms_deg", "error_max_deg", "honest_error_deg", "honest_interval_deg", "p_value")
    return {
        "task": surface.task,
        "optimum": _protocol(surface, found.best),
        **{key: getattr(found, key) for key in errors},
        "errors": {name: float(getattr(surface, name)[:, found.best].mean()) for name in ERRORS},
        "equivalent_protocols": int(found.equivalent.sum()),
        "protocols": len(surface.cutoff_hz),
        "worse_protocols": int(found.worse.sum()),
        "undecided_protocols": int(found.undecided.sum()),
        "flat": found.flat,
        "deciding": found.deciding,
        "failed_runs": found.failed,
        "rig_minutes": float(surface.rig_minutes[found.best]),
        "cheapest": {
            "protocol": _protocol(surface, found.cheapest),
            "error_rms_deg": float(surface.error("rms", found.timing)[:, found.cheapest].mean()),
            "rig_minutes": float(surface.rig_minutes[found.cheapest]),
        },
        "target": task.target and asdict(task.target) | {"protocol": _protocol(surface, task.target.place)},
        "tested": dict(zip(("optimum", "cheapest"), map(asdict, task.tested), strict=True)),
        "pareto": [
            _protocol(front.surface, place)
            | {"rig_minutes": float(front.surface.rig_minutes[place]), "interval_deg": interval}
            | {key: float(getattr(front.surface, key)[:, place].mean()) for key in ERRORS}
            for interval, place in zip(front.interval_deg.tolist(), front.places.tolist(), strict=True)
        ],
        "left_out": surface.left_out,
        "untried": [
            {
                "parameter": f"{row.parameter}_dps",
                "value": round(row.value / RADIAN_PER_DEGREE, 9),
                "reason": row.reason,
            }
            for row in task.untried
        ],
        "made_of": [_split_json(split) for split in task.splits],
        "effects": [_effect_json(effect) for effect in found.effects],
        "note": _note_json(task),
        "findings": findings_json(task.findings),
    }


def _split_json(split: "ErrorBreakdown") -> dict[str, object]:
    terms = [
        {key: getattr(term, key) for key in ("effect", "share", "share_interval", "rms_deg", "span_deg")}
        | {"verdict": term.judged.verdict, "p_better": term.judged.p_better, "best": split.values[term.best]}
        for term in split.terms
    ]
    return {
        **{key: getattr(split, key) for key in ("parameter", "values", "rms_deg", "together")},
        "verdict": split.judged.verdict,
        "covering": [term.effect for term in split.covering],
        "terms": terms,
    }


def _protocol(surface: "TaskSurface", place: int) -> dict[str, float]:
    return {name: round(float(surface.column(name)[place]), 9) for name in surface.names}


def _note_json(task: "TaskOutcome") -> dict[str, object] | None:
    surface, note = task.surface, task.note
    if note is None:
        return None
    values = [
        {"parameter": each.name, "value": each.value, "verdict": each.verdict, "because": each.finding.text}
        | {
            name: found and asdict(found) | {"other": _protocol(surface, found.other)}
            for name, found in (("lower", each.lower), ("upper", each.upper))
        }
        for each in note.values
    ]
    figures = {key: getattr(note, key) for key in ("error_deg", "difference_deg", "verdict")}
    return {**asdict(note.row), **figures, "because": note.finding.text, "values": values}


def _effect_json(effect: "ParameterEffect") -> dict[str, object]:
    test, judged = effect.anova, effect.judged
    return {
        "parameter": effect.name,
        **{key: getattr(effect, key) for key in ("values", "means_deg", "span_deg", "dropped")},
        "untested": effect.untested and effect.untested.detail,
        "f": test and test.f,
        "p_value": test and test.p_value,
        "p_holm": effect.p_holm,
        "partial_eta_squared": test and test.partial_eta_squared,
        "partial_eta_squared_interval": test and test.partial_eta_squared_interval,
        "judged": judged
        and {key: getattr(judged, key) for key in ("verdict", "p_better", "p_equivalent")}
        | {"decisions": [asdict(each) | {"other": effect.values[each.other]} for each in judged.decisions]},
        "greenhouse_geisser": test and test.sphericity.greenhouse_geisser,
        "anova": test and asdict(test),
        "pairs": [
            asdict(pair) | {"first": effect.values[pair.first], "second": effect.values[pair.second]}
            for pair in effect.pairs
        ],
    }
