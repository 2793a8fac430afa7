"""``undrift study``: which calibration session is enough for a task, found with simulated devices and people."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Output, verb
from undrift.base.summary import Result, Section, Summary, at, figure_of, interval, number, plain_words
from undrift.commands import Progress, silent
from undrift.commands.files import check_folder, origin_of, save_json
from undrift.commands.study_note import NOTE, figure3_section, methods_section, note_flows, table_1, table_2
from undrift.errors import InputError
from undrift.files import write_whole

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import Answer, StudyOutcome, TaskOutcome
    from undrift.study.plan import Study
    from undrift.study.run import Run
    from undrift.study.sessions import CalibrationSession

RUN, EFFECTS, TESTING, METHODS = 0.7, 0.8, 0.9, 0.97  # shares of the time at which each stage ends
EFFECT_DEVICES = 10  # whose error is split
FEWEST = 20  # devices, of which one lies above the 95 % quantile
OFFSETS = {
    "rest": "with the offset of the rest subtracted",
    "motion": "with the offset from the motion subtracted",
    "none": "no offset subtracted",
}
FEW = "{} devices do not determine the error that 95 % of devices stay below: study {} or more for a result"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Studied(Result):
    """A study that was run to its end, and its folder."""

    outcome: "StudyOutcome"
    figure3: "Figure3 | None"
    output: Path

    def summary(self) -> Summary:
        """Return the answer first, then the tables behind it."""
        outcome = self.outcome
        sections = [_for_all(outcome)]
        sections += [_sessions(outcome, task) for task in outcome.tasks]
        sections += [_sensitivity(outcome), *(table_1(task, _name(task)) for task in outcome.tasks)]
        sections += [figure3_section(self.figure3)] if self.figure3 else []
        sections += [_made_of(outcome), table_2(outcome), methods_section(outcome), _commands(outcome, self.output)]
        shown = tuple(section for section in sections if section.rows or section.text)
        return Summary(
            title=f"Study: {outcome.study.name}",
            answer=_answer(outcome),
            data=study_json(outcome, self.figure3),
            pictures=(figure_of("figures:draw_sessions", outcome),),
            sections=(*shown, *note_flows(), Section(title="The note", text=(NOTE,), folded=True)),
            notes=(FEW.format(outcome.subjects, FEWEST),) if outcome.subjects < FEWEST else (),
            written=tuple(self.output / name for name in ("report.html", "summary.json", "runs.parquet")),
        )


@verb
def study(
    plan: Path | None = None,
    /,
    *,
    output: Output = Path("study"),
    preset: Literal["note"] | None = None,
    target_deg: float | None = None,
    categories: str | None = None,
    subjects: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Studied:
    """Calibrate simulated devices by named sessions; find the cheapest one whose error in a task is good enough.

    Parameters
    ----------
    plan : Path or None
        study.toml: tasks, people, device, sessions. See docs/study.md.
    output : Path
        Folder for report.html, summary.json, runs.parquet and a protocol.toml for each answer that needs a rate table.
    preset : str or None
        "note" in place of a plan: the technical note's three tasks, with its fits.
    target_deg : float or None
        Error that is good enough for 95 % of devices, deg; the plan's if not given, otherwise 0.5, 1 and 2.
    categories : str or None
        Categories of people, separated by commas: level_1 to level_4 (level_2 is the note's), young, elderly, impaired, parkinson,
        and those of the plan. Each performs every task.
    subjects : int or None
        Number of devices, each on a person of its own; the plan's if not given, otherwise 30.
    seed : int or None
        Other seed than the plan's; the same seed gives the same numbers with any number of workers.
    workers : int or None
        Processes on this machine; all its processors if not given.
    scheduler : str or None
        Address of a Dask scheduler, as in tcp://host:8786, to work on its workers.
    """
    from undrift.study.figure3 import figure3
    from undrift.study.judge import breakdown_session, chosen_sessions, judge, with_test
    from undrift.study.methods import compare_methods
    from undrift.study.run import executor, run_chosen, run_effects, run_study, with_checked_fits

    if (plan is None) == (preset is None):
        raise InputError(
            f"study: expected a study.toml or `preset` note, got {'both' if plan else 'neither'}. Name one."
        )
    planned = _planned(plan, target_deg, categories, subjects, seed)
    check_folder(output)
    if output.is_dir() and any(output.iterdir()) and not (output / "runs.parquet").is_file():
        raise InputError(f"{output}: this folder contains other files. Name a new folder, or the folder of a study.")
    with executor(workers, scheduler) as spread:
        progress("shipped fits compared with those of device 0", 0.0)
        planned = with_checked_fits(planned, spread)
        units = [] if preset is None else [planned.typical_unit()]
        figures = spread(partial(figure3, seed=planned.seed), units)
        runs = run_study(planned, spread, lambda done, total: progress(f"device {done} of {total}", RUN * done / total))
        outcome = judge(planned, runs)
        progress("errors switched off one at a time", RUN)
        split = tuple((task.task.key, breakdown_session(task)) for task in outcome.tasks)
        devices = range(min(EFFECT_DEVICES, outcome.subjects))
        effects = [run for made in spread(partial(run_effects, planned, split), devices) for run in made]
        progress("answers on the other group of people", EFFECTS)
        chosen = chosen_sessions(outcome)
        tested = list["Run"]()
        if chosen and all(task.motion is None for task in planned.tasks):
            others = range(outcome.subjects)
            tested = [run for made in spread(partial(run_chosen, planned.other(), chosen), others) for run in made]
        outcome = with_test(outcome, tested, effects)
        progress("methods and rivals", TESTING)
        if preset is not None:
            outcome = replace(outcome, methods=compare_methods(planned, spread, min(EFFECT_DEVICES, outcome.subjects)))
        progress("Figure 3", METHODS)
        figure = next(iter(figures), None)
    result = Studied(outcome=outcome, figure3=figure, output=output)
    output.mkdir(exist_ok=True)
    _write_runs(outcome, output / "runs.parquet")
    _write_protocols(outcome, output)
    summary = result.summary()
    save_json(output / "summary.json", summary.data)
    at("undrift.report.page:write_page")(output / "report.html", summary, origin_of(plan))
    return result


def _planned(
    plan: Path | None, target_deg: float | None, categories: str | None, subjects: int | None, seed: int | None
) -> "Study":
    from undrift.study.plan import note_study, read_study, with_categories

    planned = note_study() if plan is None else read_study(plan)
    if target_deg is not None:
        if not target_deg > 0.0:
            raise InputError(f"study: `target_deg` must be above 0, got {target_deg:g}.")
        planned = replace(planned, target_deg=(target_deg,))
    if subjects is not None:
        if subjects < 3:
            raise InputError(f"study: `subjects` must be 3 or more, got {subjects}.")
        planned = replace(
            planned, subjects=subjects, subjects_max=max(subjects, planned.subjects_max if plan else subjects)
        )
    if seed is not None:
        if seed < 0:
            raise InputError(f"study: `seed` must be 0 or more, got {seed}.")
        planned = replace(planned, seed=seed)
    return planned if categories is None else with_categories(planned, [name.strip() for name in categories.split(",")])


# ---- sections


def _name(task: "TaskOutcome") -> str:
    return plain_words(task.task.key.replace("-", ", "))


def _sentence(answer: "Answer", outcome: "StudyOutcome") -> str:
    if not answer.session:
        return f"for {answer.target_deg:g} deg no session is good enough"
    session = next(one for one in outcome.study.sessions if one.name == answer.session)
    needs = "no instrument" if session.instruments == "none" else session.instruments
    tested = f"; {answer.below} of {answer.tested} other devices on other people below" if answer.tested else ""
    tested += ", not confirmed" if answer.tested and not answer.confirmed else ""
    return f"for {answer.target_deg:g} deg '{answer.session}' ({session.length_min:.0f} min, {needs}{tested})"


def _answer(outcome: "StudyOutcome") -> str:
    """Return the sentence that names the cheapest session for all tasks at each target."""
    several = "all tasks" if len(outcome.tasks) > 1 else _name(outcome.tasks[0])
    sentences = "; ".join(_sentence(one, outcome) for one in outcome.for_all)
    return f"Cheapest session that is good enough in {several}: {sentences}.{_assumed(outcome)}"


def _assumed(outcome: "StudyOutcome") -> str:
    """Return how much of the error rests on assumed figures of the device, nothing for a measured device."""
    from undrift.study.case import ASSUMED
    from undrift.study.judge import breakdown_session

    shares = [
        (f"{100.0 * share:.0f} % ({_name(task)}, {breakdown_session(task)})")
        for task in outcome.tasks
        for name, share in task.breakdown
        if name == ASSUMED
    ]
    return f" Share of its mean square error that rests on assumed figures of the device: {', '.join(shares)}." * bool(
        shares
    )


def _for_all(outcome: "StudyOutcome") -> Section:
    rows = tuple(
        (f"{task.answers[k].target_deg:g}", name, session or "none", tested)
        for k in range(len(outcome.for_all))
        for task, name, session, tested in (
            *((one, _name(one), one.answers[k].session, _tested(one.answers[k])) for one in outcome.tasks),
            (outcome.tasks[0], "all tasks", outcome.for_all[k].session, _tested(outcome.for_all[k])),
        )
    )
    text = (
        "Good enough: 95 % of the simulated devices, each on a person of its own, stay below the target. A session is tested with "
        "other devices on the other group of people. All figures are simulated, and errors are those of a device that is fixed to "
        "the bone: how it sits on the body adds about 1 deg, whichever session is chosen.",
        *(
            ["Fits that come with undrift were used where they exist; those of device 0 were made again and agree."]
            * outcome.study.shipped
        ),
    )
    heads = ("target (deg)", "task", "cheapest session", "other group below the target")
    return Section(title="The cheapest session that is good enough", columns=heads, rows=rows, text=text)


def _tested(answer: "Answer") -> str:
    return f"{answer.below} of {answer.tested}{'' if answer.confirmed else ': not confirmed'}" if answer.tested else "–"


def _sessions(outcome: "StudyOutcome", task: "TaskOutcome") -> Section:
    rows, device = list[tuple[str, ...]](), outcome.study.typical_unit()
    for row in task.sessions:
        enough = [f"{target:g}" for target in outcome.study.target_deg if row.quantile_deg <= target]
        about = (row.session.name, f"{row.session.length_min:.0f}", row.session.instruments)
        failed = f"{row.failed} of {outcome.subjects}" if row.failed else "none"
        if not row.session.suits(device):
            failed = "not for readings in counts"
        if row.failed == outcome.subjects:
            rows.append((*about, *("–",) * 7, failed))
            continue
        low, high = row.interval_deg
        quantile = number(row.quantile_deg) if row.quantile_deg < float("inf") else "–"
        cells = (
            number(row.mean_deg),
            interval((max(low, 0.0), high), ".3f"),
            quantile,
            interval(row.single_deg, ".3f"),
        )
        versus = "best" if row.against_best is None else row.against_best.verdict
        rows.append((*about, *cells, number(row.real_time_deg), enough[0] if enough else "–", versus, failed))
    heads = (
        "session", "minutes", "instruments", "mean (deg)", "its 95 % interval", "95 % of devices below", "single device, 95 %",
        "mean in real time", "enough for (deg)", "against the best", "devices that fail",
    )  # fmt: skip
    timing = "aligned in time, as the note compares" if outcome.study.timing == "aligned" else "in real time"
    text = (
        f"Root mean square of the pitch error over the motion, {timing}: {outcome.subjects} devices, {_rise(outcome)} K above the "
        f"room, {OFFSETS[outcome.study.offset]}.",
        f"Against the best: better or worse by more than {outcome.study.margin_deg:g} deg, or equivalent within it. The error rate "
        "of all these tests together is 5 %.",
    )
    return Section(title=f"{_name(task)}: sessions", columns=heads, rows=tuple(rows), text=text)


def _rise(outcome: "StudyOutcome") -> str:
    low, high = outcome.study.excursion_k
    return f"{low:g} to {high:g}"


def _sensitivity(outcome: "StudyOutcome") -> Section:
    names = [session.name for session in outcome.study.sessions]
    cells = {(rise, offset, name): value for rise, offset, name, value in outcome.sensitivity}
    keys = list(dict.fromkeys((rise, offset) for rise, offset, *_ in outcome.sensitivity))
    rows = tuple(
        (
            f"{rise:g}" if rise < float("inf") else _rise(outcome),
            offset,
            *(number(cells[rise, offset, name]) for name in names),
        )
        for rise, offset in keys
    )
    text = (
        f"{_name(outcome.tasks[0])}: error that 95 % of devices stay below (deg), for other temperatures and offsets.",
    )
    return Section(title="Sensitivity", columns=("K above the room", "offset subtracted", *names), rows=rows, text=text)


def _made_of(outcome: "StudyOutcome") -> Section:
    from undrift.study.judge import breakdown_session

    rows = tuple(
        (_name(task), breakdown_session(task), *(f"{100.0 * share:.0f} %" for _, share in task.breakdown))
        for task in outcome.tasks
        if task.breakdown
    )
    names = tuple(name for name, _ in outcome.tasks[0].breakdown)
    text = (
        "Share of the mean square that is gone if one kind of error is switched off. Kinds act together, so shares need not add up "
        "to 100 %.",
    )
    return Section(
        title="What the error is made of",
        columns=("task", "session", *names),
        rows=rows,
        text=text if rows else (),
        folded=True,
    )


def _chosen(outcome: "StudyOutcome") -> "list[CalibrationSession]":
    answers = (*outcome.for_all, *(answer for task in outcome.tasks for answer in task.answers))
    names = dict.fromkeys(answer.session for answer in answers if answer.session)
    by_name = {session.name: session for session in outcome.study.sessions}
    return [by_name[name] for name in names]


def _stem(session: "CalibrationSession") -> str:
    return "session-" + "-".join(session.name.replace(",", "").split())


def _commands(outcome: "StudyOutcome", folder: Path) -> Section:
    lines = list[str]()
    for session in _chosen(outcome):
        needs = "" if session.instruments == "none" else f" ({session.instruments})"
        lines += [f"{session.name}{needs}:", *session.commands(str(folder / _stem(session)))]
    return Section(title="Commands", text=tuple(lines))


def _write_protocols(outcome: "StudyOutcome", folder: Path) -> None:
    from undrift.programme import write_protocol

    for session in _chosen(outcome):
        if session.protocol is not None:
            write_protocol(
                replace(session.protocol, name=_stem(session), faces_at="room"), folder / f"{_stem(session)}.toml"
            )


def _write_runs(outcome: "StudyOutcome", path: Path) -> None:
    import io

    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(pa.Table.from_pylist([asdict(run) for run in outcome.runs]), buffer)
    write_whole(path, buffer.getvalue())


# ---- summary.json


def study_json(outcome: "StudyOutcome", figure: "Figure3 | None") -> dict[str, Any]:
    """Return the JSON of a study."""
    from undrift.base.codec import tree_of

    planned = outcome.study
    keys = ("name", "device", "group", "excursion_k", "seed", "offset", "timing", "fit", "margin_deg", "target_deg")
    return {
        **{key: getattr(planned, key) for key in keys},
        "subjects": outcome.subjects,
        "shipped_fits": planned.shipped,
        "bench": tree_of(planned.bench),
        "for_all": [asdict(answer) | {"confirmed": answer.confirmed} for answer in outcome.for_all],
        "tasks": [_task_json(task) for task in outcome.tasks],
        "sensitivity": [
            {
                "excursion_k": None if rise == float("inf") else rise,
                "offset": offset,
                "session": name,
                "quantile_deg": value,
            }
            for rise, offset, name, value in outcome.sensitivity
        ],
        "methods": [asdict(row) for row in outcome.methods],
        "figure3": figure
        and {
            "actual_max_deg": figure.actual_max_deg,
            "simulated_max_deg": figure.simulated_max_deg,
            "simulated_actual_max_deg": figure.simulated_actual_max_deg,
            "decrease_deg": figure.decrease_deg,
        },
    }


def _task_json(task: "TaskOutcome") -> dict[str, Any]:
    sessions = [
        {"session": row.session.name, "minutes": row.session.length_min, "instruments": row.session.instruments}
        | {key: getattr(row, key) for key in ("mean_deg", "interval_deg", "single_deg", "real_time_deg", "failed")}
        | {"quantile_deg": row.quantile_deg if row.quantile_deg < float("inf") else None}
        | {"against_best": row.against_best and asdict(row.against_best)}
        for row in task.sessions
    ]
    effects = [asdict(effect) | {"verdict": effect.verdict} for effect in task.effects]
    answers = [asdict(answer) | {"confirmed": answer.confirmed} for answer in task.answers]
    return {
        "task": task.task.key,
        "sessions": sessions,
        "answers": answers,
        "effects": effects,
        "made_of": dict(task.breakdown),
    }
