"""``undrift study``: which calibration protocol is enough for a task, found by simulation, tested on other subjects."""

import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from undrift.base.options import Details, Flag, Json, Output, Report
from undrift.cli.common import progress, say, show_table, waiting, write_json
from undrift.commands.files import check_folder, check_report, origin_of, save_json
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import ParameterEffect
    from undrift.study.outcome import EffectPower, Split, Stage, StageName, StudyOutcome, TaskOutcome
    from undrift.study.plan import Study
    from undrift.study.real import CohortComparison, RealOutcome
    from undrift.study.rivals import TriadRow
    from undrift.study.run import TaskSurface

QUICK_SUBJECTS = 8
REAL_FIGURES = ("rmse_total_deg", "rmse_inclination_deg", "max_abs_pitch_deg", "end_total_deg")
SHOWN_EVERY_S = 10.0  # where stderr is not a terminal


def study(
    plan: Path | None = None,
    /,
    *,
    output: Output = Path("study"),
    preset: Literal["note"] | None = None,
    quick: Flag = False,
    search: Literal["grid", "halving", "cma"] | None = None,
    categories: str | None = None,
    candidates: int | None = None,
    subjects: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    no_rivals: Flag = False,
    real: Path | None = None,
    report: Report = None,
    details: Details = False,
    json: Json = False,
) -> int:
    """Try calibration protocols on simulated subjects; find which is enough, with its error and its minutes on the rig.

    Parameters
    ----------
    plan : Path or None
        study.toml: tasks, subjects, device, what is tried. See docs/study.md.
    output : Path
        Folder for surface.parquet, report.html and summary.json; an interrupted study in it resumes.
    preset : str or None
        "note" in place of a plan: the technical note's three tasks, thirty subjects, over 400 protocols each.
    quick : bool
        The ends of what is tried, on eight subjects: a first look.
    search : str or None
        "grid" runs every protocol on every subject; "halving" keeps the better half of the protocols and doubles the subjects,
        round by round; "cma" evolves protocols by CMA-ES, for wide spaces (pip install undrift[search]). The plan's where not
        given, else "grid".
    categories : str or None
        Categories of subjects, separated by commas, or "all": level_2 (the note's), young, elderly, impaired, parkinson. Each
        performs every task, and each one's optimum is worn by the others. The plan's where not given, else level_2.
    candidates : int or None
        Most protocols of a task that halving draws from a wider space, or that cma tries; the plan's where not given, else all
        and 600.
    subjects : int or None
        Other number of subjects than the plan's.
    seed : int or None
        Other seed than the plan's; the same seed gives the same bits on any machine and any number of workers.
    workers : int or None
        Processes on this machine; all its processors where not given.
    scheduler : str or None
        Address of a Dask scheduler, as in tcp://host:8786, to work on its workers.
    no_rivals : bool
        Leave out the other ways to calibrate, which the note's Discussion names, 12 units of about 10 s, and Figure 3 effect by
        effect, about 15 s, and its 30 drawn units, 12 s each on one processor. --quick implies it.
    real : Path or None
        real.toml: real recordings to judge too. See docs/study.md.
    report : Path or None
        Copy of report.html to write: .html.
    """
    from undrift.report.study import write_study_report
    from undrift.study.outcome import forecast, judge_study
    from undrift.study.real import read_real
    from undrift.study.run import HEAD, RunStore, choose_executor

    if (plan is None) == (preset is None):
        raise InputError(f"study: wanted a study.toml or --preset note, got {'both' if plan else 'neither'}; name one")
    if seed is not None and seed < 0:
        raise InputError(f"seed: wanted 0 or more, got {seed}; give another")
    planned = _planned(plan, quick, subjects, seed, search, candidates, categories)
    with waiting("reading real recordings"):
        held = None if real is None else read_real(real)
    executor, rivals = choose_executor(scheduler, workers), not (no_rivals or quick)
    check_report(report, reads=(plan, real))
    check_folder(output)
    if output.is_dir() and any(output.iterdir()) and not (output / HEAD).is_file():
        raise InputError(
            f"{output}: wanted a new folder, or that of this study, got one with other files; name another"
        )
    RunStore(output, planned)  # refuses the folder of another study before anything is computed
    stages = forecast(planned, output, workers=executor.workers, rivals=rivals, real=held)
    _announce(planned, stages, executor.workers, json)
    shown = _Progress(planned, stages)
    with shown.display:
        outcome = judge_study(
            planned,
            executor,
            output,
            advance=shown.advance,
            rivals=rivals,
            real=held,
            begin=shown.begin,
            tell=shown.tell,
        )
    save_json(output / "summary.json", summary := study_summary(outcome))
    for page in (output / "report.html", *([report] if report else [])):
        write_study_report(outcome, page, origin_of(plan, real))
    write_json(summary, "study") if json else _show(outcome, output, details)
    return 0


# ---- before and while it runs


def _planned(
    plan: Path | None,
    quick: bool,
    subjects: int | None,
    seed: int | None,
    search: Literal["grid", "halving", "cma"] | None,
    candidates: int | None,
    categories: str | None,
) -> "Study":
    """Return the study of a plan, or the note's, with the choices of the command line."""
    from undrift.sim.motion.tasks import CategoryName
    from undrift.study.plan import ends_of, note_study, read_study, with_categories
    from undrift.study.search import check_installed

    if candidates is not None and candidates < 4:
        raise InputError(f"candidates: wanted 4 or more, got {candidates}; give more")
    planned = note_study(quick=quick) if plan is None else read_study(plan)
    if quick and plan is not None:
        planned = ends_of(planned)
    count = subjects if subjects is not None else min(QUICK_SUBJECTS, planned.subjects) if quick else planned.subjects
    seed = planned.seed if seed is None else seed
    planned = replace(
        planned, subjects=count, search=search or planned.search, seed=seed, candidates=candidates or planned.candidates
    )
    check_installed(planned)
    if categories is None:
        return planned
    known = get_args(CategoryName)
    return with_categories(planned, known if categories == "all" else [name.strip() for name in categories.split(",")])


def _announce(planned: "Study", stages: "tuple[Stage, ...]", workers: int, json: bool) -> None:
    """Print how many runs there are, about how long all stages take, and which values no protocol has."""
    from undrift.study.outcome import untried_findings
    from undrift.study.search import count_runs

    tasks = ", ".join(task.key for task in planned.tasks)
    most = sorted(stages, key=lambda stage: -stage.seconds)[:3]
    parts = ", ".join(f"{stage.name} {duration(stage.seconds)}" for stage in stages if stage in most)
    say(
        f"{planned.name}: {count_runs(planned)} runs ({tasks}; {planned.subjects} subjects) on {workers} "
        f"worker{'s' * (workers > 1)}, in all about {duration(sum(stage.seconds for stage in stages))} ({parts})",
        *(f"{task.key}: {item.text}" for task in planned.tasks for item in untried_findings(task.space.untried())),
        err=json,
    )


class _Progress:
    """A bar on a terminal; elsewhere a line on stderr for each stage and round, and now and then one within the first."""

    def __init__(self, planned: "Study", stages: "tuple[Stage, ...]") -> None:
        self._name, self._stages = planned.name, stages
        self._stage: StageName = "calibration sessions"
        self._counted = "runs" if planned.search != "grid" else "units of work"
        self._live, self._next_s = sys.stderr.isatty(), 0.0
        self.display = progress()
        self._bar = self.display.add_task(self._name, total=None)

    def begin(self, stage: "StageName") -> None:
        """Show that a stage begins; one without a forecast has nothing to do."""
        names, self._stage = [each.name for each in self._stages], stage
        left = self._stages[names.index(stage) :] if stage in names else ()
        if left:
            text = f"{stage}, about {duration(left[0].seconds)}"
            rest = f"; {duration(sum(each.seconds for each in left))} left in all" if len(left) > 1 else ""
            self.tell(text + rest)

    def advance(self, done: int, total: int) -> None:
        """Show how much of the first stage is done."""
        self.display.update(self._bar, completed=done, total=total)
        now_s = time.monotonic()
        if self._live or done == 0:
            self._next_s = now_s + SHOWN_EVERY_S
        elif done == total or now_s >= self._next_s:
            self._next_s = now_s + SHOWN_EVERY_S
            counted = self._counted if self._stage == "calibration sessions" else "units of work"
            self.tell(f"{self._stage}: {done} of {total} {counted}")

    def tell(self, text: str) -> None:
        """Show a line; on a terminal it begins a bar of its own."""
        if self._live:
            self.display.remove_task(self._bar)
            self._bar = self.display.add_task(f"{self._name}: {text}", total=None)
        else:
            sys.stderr.write(f"{self._name}: {text}\n")
            sys.stderr.flush()


def duration(seconds: float) -> str:
    """Return a time in s, min or h."""
    if seconds < 90.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


# ---- summary.json


FIGURE3_KEYS = ("none_max_deg", "static_max_deg", "full_max_deg", "rest_max_deg", "full_and_rest_max_deg")


def study_summary(outcome: "StudyOutcome") -> dict[str, object]:
    """Return the JSON of a study."""
    from undrift.study.claims import claims_of
    from undrift.study.plan import bench_keys

    held, figure = outcome.study, outcome.figure3
    return {
        **{
            key: getattr(held, key)
            for key in (
                "name",
                "device",
                "subjects",
                "seed",
                "objective",
                "timing",
                "search",
                "candidates",
                "level",
                "margin_deg",
            )
        },
        "bench": bench_keys(held.bench) | {"chain_percent": 100.0 * held.chain_sd},
        "runs": outcome.runs,
        "tasks": [_task_summary(task) for task in outcome.tasks],
        "cohorts": [
            {
                "group": cohort.group,
                "category": cohort.category,
                "subjects": cohort.count,
                "age_years": cohort.age_years,
                "height_m": cohort.height,
                "note_age_years": cohort.printed.age_years,
                "note_height_m": cohort.printed.height,
            }
            for cohort in outcome.cohorts
        ],
        "figure3": figure and _figure3_summary(figure),
        "figure3_missing": outcome.figure3_missing and outcome.figure3_missing.detail,
        "figure3_drawn": [asdict(row) for row in outcome.figure3_drawn] or None,
        "figure3_effects": [asdict(row) for row in outcome.figure3_effects] or None,
        "designs": [asdict(row) for row in outcome.designs],
        "rivals": [asdict(row) | {"said": row.notes} for row in outcome.rivals] or None,  # binding key
        "rival_triads": [_triad_summary(row) for row in outcome.rival_triads] or None,
        "claims": [asdict(row) | {"lacks": row.lacks and row.lacks.text} for row in claims_of(outcome)],
        "rivals_missing": outcome.rivals_missing and outcome.rivals_missing.detail,
        "real": outcome.real and _real_summary(outcome.real),
        "categories": [
            asdict(each) | {"because": each.finding.text, "code": each.finding.code} for each in outcome.categories
        ]
        or None,
    }


def _triad_summary(row: "TriadRow") -> dict[str, object]:
    needed = [worth.decision and worth.decision.subjects_needed for worth in row.worth]
    held = asdict(row)
    for worth, units in zip(held["worth"], needed, strict=True):
        if worth["decision"] is not None:
            worth["decision"] |= {"units_needed": units}
    return held


def _figure3_summary(figure: "Figure3") -> dict[str, object]:
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


def _real_summary(real: "RealOutcome") -> dict[str, object]:
    def compared(rows: "tuple[CohortComparison, ...]") -> list[dict[str, object]]:
        return [asdict(row) | {"inside": row.inside, "said": row.note} for row in rows]  # binding key

    return {
        "trials": [
            {
                "level": level.level,
                "rounding": level.rounding,
                "median": {name: getattr(level.median, name) for name in REAL_FIGURES},
                "trials": [{"recording": trial.recording} | asdict(trial.figures) for trial in level.trials],
                "agreement": level.agreement and asdict(level.agreement),
            }
            for level in real.errors
        ],
        "captures": compared(real.motions),
        "worn": real.worn
        and {
            "rows": [asdict(row) for row in real.worn.rows],
            "agreement": {level: asdict(pairwise) for level, pairwise in real.worn.agreement},
        },
        "stances": compared(real.sways),
        "lacks": [lack.text for lack in real.lacks],
        "figure3": real.figure3 and _figure3_summary(real.figure3),
    }


def _task_summary(task: "TaskOutcome") -> dict[str, object]:
    from undrift.io.store import findings_json
    from undrift.study.plan import ERRORS

    surface, found, stopping, front = task.surface, task.optimum, task.stopping, task.front
    powers = {power.name: power for power in task.powers}
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
        "made_of": [_split_summary(split) for split in task.splits],
        "effects": [_effect_summary(effect, powers.get(effect.name)) for effect in found.effects],
        "one_way": task.one_way and asdict(task.one_way),
        "repeated_measures": task.repeated and asdict(task.repeated),
        "optional_stopping": stopping
        and {"parameter": task.stopping_of}
        | {key: getattr(stopping, key) for key in ("looks", "crossings", "false_alarm")},
        "note": _note_summary(task),
        "halving": _halving_summary(task),
        "findings": findings_json(task.findings),
    }


def _split_summary(split: "Split") -> dict[str, object]:
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


def _note_summary(task: "TaskOutcome") -> dict[str, object] | None:
    surface, note = task.surface, task.note
    if note is None:
        return None
    values = [
        {"parameter": each.name, "value": each.value, "verdict": each.verdict, "because": each.finding.text}
        | {
            name: found
            and asdict(found) | {"other": _protocol(surface, found.other), "subjects_needed": found.subjects_needed}
            for name, found in (("lower", each.lower), ("upper", each.upper))
        }
        for each in note.values
    ]
    figures = {key: getattr(note, key) for key in ("error_deg", "difference_deg", "verdict")}
    return {**asdict(note.row), **figures, "because": note.finding.text, "values": values}


def _halving_summary(task: "TaskOutcome") -> dict[str, object] | None:
    halving = task.halving
    if halving is None:
        return None
    rounds = []
    for each in halving.rounds:
        means = zip(each.candidates, each.mean_deg.tolist(), strict=True)
        rows = [_protocol(halving.every, int(place)) | {"mean_deg": mean} for place, mean in means]
        rounds.append({"subjects": each.subjects, "protocols": rows})
    numbers = {"runs": halving.runs, "runs_of_grid": halving.runs_of_grid, "generations": halving.generations}
    return {**numbers, "rounds": rounds}


def _effect_summary(effect: "ParameterEffect", power: "EffectPower | None") -> dict[str, object]:
    test, judged = effect.test, effect.judged
    return {
        "parameter": effect.name,
        **{key: getattr(effect, key) for key in ("values", "means_deg", "span_deg", "missing", "dropped")},
        "untested": effect.untested and effect.untested.detail,
        "f": test and test.f,
        "p_value": test and test.p_value,
        "p_holm": effect.p_holm,
        "partial_eta_squared": test and test.partial_eta_squared,
        "partial_eta_squared_interval": test and test.partial_eta_squared_interval,
        "judged": judged
        and {key: getattr(judged, key) for key in ("verdict", "p_better", "p_equivalent", "subjects_needed")}
        | {
            "decisions": [
                asdict(each) | {"other": effect.values[each.other], "subjects_needed": each.subjects_needed}
                for each in judged.decisions
            ]
        },
        "greenhouse_geisser": effect.anova and effect.epsilon,
        "power": power and power.power,
        "subjects_needed": power and power.subjects,
        "anova": effect.anova and asdict(effect.anova),
        "mixed_model": effect.mixed and asdict(effect.mixed),
        "pairs": [
            asdict(pair) | {"first": effect.values[pair.first], "second": effect.values[pair.second]}
            for pair in effect.pairs
        ],
    }


# ---- terminal


def _show(outcome: "StudyOutcome", output: Path, details: bool) -> None:
    from undrift.findings import SHOWN_FIRST, most_consequential_first
    from undrift.study.space import HEADINGS, OF_NOTE

    heads = ("task", *OF_NOTE.values(), "p", "rms (deg)", "rig (min)")
    rows = []
    for task in outcome.tasks:
        found, surface, note = task.optimum, task.surface, task.note
        places = [(surface.task, found.best), (" cheapest", found.cheapest)]
        for name, place in places[: 1 if found.best == found.cheapest else 2]:
            own = [f"{value:.4g}" for value in list(_protocol(surface, place).values())[:4]]
            p = f"{found.p_value:.2g}" if place == found.best else ""
            error, minutes = surface.error("rms", found.timing)[:, place].mean(), surface.rig_minutes[place]
            rows.append((name, *own, p, f"{error:.3f}", f"{minutes:.0f}"))
        if note is not None:
            row = note.row
            four = (row.cutoff_hz, row.turn_rate_step_dps, row.turn_rate_min_dps, row.turn_rate_max_dps)
            rows.append((" the note", *(f"{value:.4g}" for value in four), f"{row.p_value:.3f} (its own)", "", ""))
    show_table("Optimised parameters and the note's", heads, rows)
    for task in outcome.tasks:
        tested, note = task.tested[0], task.note
        ordered = most_consequential_first(item for item in task.findings if note is None or item not in note.findings)
        shown = len(ordered) if details else SHOWN_FIRST
        more, undecided = len(ordered) - shown, note is not None and note.verdict == "not decidable"
        held = ((HEADINGS[name], values[task.optimum.best]) for name, values in task.surface.further.items())
        say(
            *(f"{task.surface.task}: optimum with {name} {value:.4g}" for name, value in held),
            f"{task.surface.task}: {tested.error_rms_deg:.3f} deg rms [{tested.interval_rms_deg[0]:.3f}, "
            f"{tested.interval_rms_deg[1]:.3f}] on {tested.subjects} other subjects, largest error {tested.error_max_deg:.3f} deg",
            *(f"  {item.text}" for item in ordered[:shown]),
            *([] if note is None else [f"  the note {'is ' * undecided}{note.verdict}: {note.finding.text}"]),
            *([] if note is None else [f"  {each.finding.text}" for each in note.values if each.verdict != "agrees"]),
            *([f"  {more} more: --details, and {output / 'report.html'}"] if more > 0 else []),
        )
    say(*(each.finding.text for each in outcome.categories))
    if outcome.figure3 is not None:
        none, static, full, rest, both = outcome.figure3.actual_max_deg
        say(
            f"Figure 3, largest error: {none:.2f} deg without compensation, {static:.2f} deg static, {full:.2f} deg static and "
            f"dynamic; {rest:.2f} deg re-zeroed at a rest, {both:.2f} deg with tables and rest"
        )
    say(
        *(() if outcome.real is None else real_lines(outcome.real)), f"Wrote {output}: look at {output / 'report.html'}"
    )


def real_lines(real: "RealOutcome") -> tuple[str, ...]:
    """Return a line for each real recording, and for each part that is missing."""
    lines = []
    first, left_in = real.errors[:3], real.errors[3:]
    for place, trial in enumerate(first[0].trials if first else ()):
        each = ", ".join(f"{level.level} {level.trials[place].figures.rmse_total_deg:.2f}" for level in first)
        line = f"{trial.recording}: total rms {each} deg"
        if left_in:
            each = ", ".join(f"{level.trials[place].figures.rmse_total_deg:.2f}" for level in left_in)
            line += f", the converter's rounding undone; {each} deg, left in"
        lines.append(line)
    worn = () if real.worn is None else real.worn.rows
    for name in dict.fromkeys(row.trial for row in worn):
        each = ", ".join(f"{row.level} {row.error_rms_deg:.2f}" for row in worn if row.trial == name)
        lines.append(f"{name}: pitch of the simulated device worn in it, rms {each} deg")
    for name in dict.fromkeys(row.trial for row in (*real.motions, *real.sways)):
        own = [row for row in (*real.motions, *real.sways) if row.trial == name and row.real == row.real]
        lines.append(f"{name}: {sum(row.inside for row in own)} of {len(own)} figures within the cohort's 95 %")
    if real.figure3 is not None:
        none, static, full, rest, both = real.figure3.actual_max_deg
        lines.append(
            f"Figure 3 with the twin as actual device: {none:.2f} deg without compensation, {static:.2f} static, {full:.2f} all "
            f"tables, {rest:.2f} re-zeroed at a rest, {both:.2f} both; apart by {real.figure3.simulated_actual_max_deg[2]:.2f}"
        )
    return (*(f"real, {line}" for line in lines), *(f"real, not there: {lack.text}" for lack in real.lacks))
