"""The report of a study: the cheapest session that is good enough, and the tables behind it."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from undrift.report.figures import draw_sessions
from undrift.report.note import draw_figure3
from undrift.report.report import Cell, Report, Table
from undrift.sim.motion.tasks import TABLE_2, cohort
from undrift.study.case import ASSUMED, stream
from undrift.study.figure3 import COMPARED, Figure3
from undrift.study.judge import Answer, StudyOutcome, TaskOutcome, breakdown_session
from undrift.study.plan import HEADINGS, TABLE_1
from undrift.study.sessions import CalibrationSession

FEWEST = 20  # devices, of which one lies above the 95 % quantile
OFFSETS = {
    "rest": "with the offset of the rest subtracted",
    "motion": "with the offset from the motion subtracted",
    "none": "no offset subtracted",
}
GOOD_ENOUGH = (
    "Good enough: 95 % of the simulated devices, each on a person of its own, stay below the target. A session is tested "
    "with other devices on the other group of people. All figures are simulated, and errors are those of a device that "
    "is fixed to the bone: how it sits on the body adds about 1 deg, whichever session is chosen."
)
SLOPE_OF_THE_NOTE = (
    "The slope of the offset over temperature in the preset was chosen to match Figure 3 of the note. The error without "
    "compensation therefore confirms nothing. Compare only the remaining errors with the note."
)
NOTE = (
    'The note: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)


def study_report(outcome: StudyOutcome, figure: Figure3 | None, folder: Path) -> Report:
    """Return the answer first, then the tables behind it."""
    notes = [NOTE]
    if outcome.subjects < FEWEST:
        notes.append(
            f"{outcome.subjects} devices do not determine the error that 95 % of devices stay below. Study {FEWEST} or "
            "more for a result."
        )
    return Report(
        title=f"Study: {outcome.study.name}",
        answer=_answer(outcome),
        tables=[
            _for_all(outcome),
            *(_sessions(outcome, task) for task in outcome.tasks),
            *_sensitivity(outcome),
            *(table for task in outcome.tasks for table in _table_1(task)),
            *([_figure3(figure)] if figure else []),
            Table(title="Commands", columns=("session", "command"), rows=_commands(outcome, folder)),
        ],
        details=[*_breakdown(outcome), _table_2(outcome), *_methods(outcome)],
        notes=notes,
        figures=[lambda: draw_sessions(outcome)],
        written=[folder / name for name in ("report.html", "summary.json", "runs.parquet")],
        data=study_json(outcome, figure),
    )


def name_of(task: TaskOutcome) -> str:
    """Return a task in words."""
    return task.task.key.replace("-", ", ").replace("_", " ")


def chosen_sessions(outcome: StudyOutcome) -> list[CalibrationSession]:
    """Return the sessions that are an answer, each once."""
    answers = (*outcome.for_all, *(answer for task in outcome.tasks for answer in task.answers))
    names = dict.fromkeys(answer.session for answer in answers if answer.session)
    sessions = {session.name: session for session in outcome.study.sessions}
    return [sessions[name] for name in names]


def file_stem(session: CalibrationSession) -> str:
    """Return the name of the files of a session, without ending."""
    return "session-" + "-".join(session.name.replace(",", "").split())


def _answer(outcome: StudyOutcome) -> str:
    """Return a sentence that names, for each target, the cheapest session that reaches it in all tasks."""
    several = "all tasks" if len(outcome.tasks) > 1 else name_of(outcome.tasks[0])
    targets = dict[str, list[Answer]]()
    for answer in outcome.for_all:
        targets.setdefault(answer.session or "", []).append(answer)
    sentences = "; ".join(_sentence(answers, outcome) for answers in targets.values())
    return f"Cheapest session that is good enough in {several}: {sentences}."


def _sentence(answers: Sequence[Answer], outcome: StudyOutcome) -> str:
    degrees = f"for {' and '.join(f'{answer.target_deg:g}' for answer in answers)} deg"
    if not answers[0].session:
        return f"{degrees} none"
    session = next(one for one in outcome.study.sessions if one.name == answers[0].session)
    needs = "no instrument" if session.instruments == "none" else session.instruments
    doubt = ", not confirmed" if any(answer.tested and not answer.confirmed for answer in answers) else ""
    return f"{degrees} {session.name} ({session.length_min:.0f} min, {needs}{doubt})"


def _assumed(outcome: StudyOutcome) -> str:
    """Return the share of the error of each answer that rests on assumed figures of the device."""
    shares = [
        f"{100.0 * share:.0f} % ({name_of(task)}, {breakdown_session(task)})"
        for task in outcome.tasks
        for name, share in task.breakdown
        if name == ASSUMED
    ]
    return (
        f" Share of its mean square error that rests on assumed figures of the device: {', '.join(shares)}."
        if shares
        else ""
    )


def _for_all(outcome: StudyOutcome) -> Table:
    rows = list[tuple[Cell, ...]]()
    for k, overall in enumerate(outcome.for_all):
        answers = [(name_of(task), task.answers[k]) for task in outcome.tasks] + [("all tasks", overall)]
        for name, answer in answers:
            counts = (answer.below, answer.tested, answer.confirmed) if answer.tested else (None, None, None)
            rows.append((answer.target_deg, name, answer.session or "none", *counts))
    note = GOOD_ENOUGH + _assumed(outcome)
    if outcome.study.shipped:
        note += " Fits that come with undrift were used where they exist. One of them was made again for comparison, and agrees."
    columns = ("target (deg)", "task", "cheapest session", "other group below", "of", "confirmed")
    title = "The cheapest session that is good enough"
    return Table(title=title, columns=columns, rows=rows, form="g", note=note)


def _sessions(outcome: StudyOutcome, task: TaskOutcome) -> Table:
    study, device = outcome.study, outcome.study.typical_unit()
    rows = list[tuple[Cell, ...]]()
    for row in task.sessions:
        session = row.session
        about = (session.name, session.length_min, session.instruments)
        if row.failed == outcome.subjects:
            reason = "every device fails" if session.suits(device) else "not for readings in counts"
            rows.append((*about, *(None,) * 8, reason, row.failed))
            continue
        low, high = row.interval_deg
        enough = [target for target in study.target_deg if row.quantile_deg <= target]
        errors = (row.mean_deg, max(low, 0.0), high, row.quantile_deg, *row.single_deg, row.real_time_deg)
        against = "best" if row.against_best is None else row.against_best.verdict
        rows.append((*about, *errors, enough[0] if enough else None, against, row.failed))
    columns = (
        "session", "minutes", "instruments", "mean (deg)", "95 % from", "to", "95 % of devices below", "one device from",
        "one device to", "mean in real time", "enough for (deg)", "against the best", "devices that fail",
    )  # fmt: skip
    timing = "aligned in time, as the note compares" if study.timing == "aligned" else "in real time"
    low_k, high_k = study.excursion_k
    note = (
        f"Root mean square of the pitch error over the motion, {timing}: {outcome.subjects} devices, {low_k:g} to "
        f"{high_k:g} K above the room, {OFFSETS[study.offset]}. Against the best: better or worse by more than "
        f"{study.margin_deg:g} deg, or equivalent within it. The error rate of all these tests together is 5 %."
    )
    form = {"minutes": ".0f", "mean (deg)": ".3f", "95 % from": ".3f", "to": ".3f", "95 % of devices below": ".2f",
            "one device from": ".3f", "one device to": ".3f", "mean in real time": ".2f", "enough for (deg)": "g"}  # fmt: skip
    return Table(title=f"{name_of(task)}: sessions", columns=columns, rows=rows, form=form, note=note)


def _sensitivity(outcome: StudyOutcome) -> list[Table]:
    names = [session.name for session in outcome.study.sessions]
    errors: dict[tuple[float, str, str], float] = {
        (rise, offset, name): value for rise, offset, name, value in outcome.sensitivity
    }
    low_k, high_k = outcome.study.excursion_k
    rows: list[tuple[Cell, ...]] = [
        (
            f"{rise:g}" if math.isfinite(rise) else f"{low_k:g} to {high_k:g}",
            offset,
            *(errors[rise, offset, name] for name in names),
        )
        for rise, offset in dict.fromkeys((rise, offset) for rise, offset, *_ in outcome.sensitivity)
    ]
    note = (
        f"{name_of(outcome.tasks[0])}: error that 95 % of devices stay below (deg), for other temperatures and offsets."
    )
    columns = ("K above the room", "offset subtracted", *names)
    return [Table(title="Sensitivity", columns=columns, rows=rows, form=".2f", note=note)] if rows else []


def _breakdown(outcome: StudyOutcome) -> list[Table]:
    rows: list[tuple[Cell, ...]] = [
        (name_of(task), breakdown_session(task), *(100.0 * share for _, share in task.breakdown))
        for task in outcome.tasks
        if task.breakdown
    ]
    columns = ("task", "session", *(f"{name} (%)" for name, _ in outcome.tasks[0].breakdown))
    note = (
        "Share of the mean square that is gone if one kind of error is switched off. Kinds act together, so shares need "
        "not add up to 100 %."
    )
    return [Table(title="What the error is made of", columns=columns, rows=rows, form=".0f", note=note)] if rows else []


def _commands(outcome: StudyOutcome, folder: Path) -> Sequence[tuple[str, str]]:
    return [
        (session.name, line)
        for session in chosen_sessions(outcome)
        for line in session.commands(str(folder / file_stem(session)))
    ]


# ---- what the note reports


def _table_1(task: TaskOutcome) -> list[Table]:
    """Return the errors of a task for other values of the note's four numbers."""
    rows = list[tuple[Cell, ...]]()
    for effect in task.effects:
        test: tuple[Cell, ...] = (None, None, None)
        if effect.anova is not None:
            test = (effect.anova.f, effect.anova.p_value, effect.p_holm)
        span = max(effect.means_deg, default=0.0) - min(effect.means_deg, default=0.0)
        for value, mean in zip(effect.values, effect.means_deg, strict=True):
            is_own = value == effect.own
            rows.append(
                (HEADINGS[effect.parameter], value, mean, *((span, *test, effect.verdict) if is_own else (None,) * 5))
            )
    note = (
        "Each number is varied by itself. The other three keep their values. The row with the value of the task has the "
        "span of the means, and F of repeated-measures ANOVA with the Greenhouse-Geisser correction. The verdict uses the "
        "margin of the study, because p falls with every device that is added."
    )
    for key, row in TABLE_1.items():
        if key == task.task.name and task.task.tried and task.task.tried.around == row.numbers:
            note += f" The p of this row in the note is {row.p_value:g}." + (f" {row.erratum}" if row.erratum else "")
    columns = ("parameter", "value", "mean error (deg)", "span (deg)", "F", "p", "p (Holm)", "verdict")
    form = {"value": "g", "mean error (deg)": ".3f", "span (deg)": ".3f", "F": ".2f", "p": ".2g", "p (Holm)": ".2g"}
    title = f"{name_of(task)}: the note's Table 1"
    return [Table(title=title, columns=columns, rows=rows, form=form, note=note)] if rows else []


def _table_2(outcome: StudyOutcome) -> Table:
    """Return both groups of people beside the note's Table 2."""
    rows = list[tuple[Cell, ...]]()
    for group, printed in TABLE_2.items():
        people = cohort(group, rng=stream(outcome.study.seed, "cohort", group, 0))
        ages, heights_cm = [person.age_years for person in people], [100.0 * person.height for person in people]
        for quantity, values, printed_row, factor in (
            ("age (years)", ages, printed[0], 1.0),
            ("height (cm)", heights_cm, printed[1], 100.0),
        ):
            simulated = (min(values), float(np.mean(values)), max(values))
            rows.append((group, quantity, *(factor * value for value in printed_row), *simulated))
    columns = ("group", "quantity", "note, minimum", "note, mean", "note, maximum", "minimum", "mean", "maximum")
    return Table(title="The note's Table 2", columns=columns, rows=rows, form=".0f")


def _figure3(figure: Figure3) -> Table:
    rows = [
        (
            name,
            figure.simulated_max_deg[k],
            figure.actual_max_deg[k],
            figure.simulated_actual_max_deg[k],
            figure.correlation[k],
        )
        for k, name in enumerate(COMPARED)
    ]
    note = (
        f"Board {figure.excursion_k:g} K above the bench. Compensation removes {figure.decrease_deg:.2f} deg of the actual "
        f"device's largest error (the note: more than 3.2). With all tables the two errors differ by at most "
        f"{figure.simulated_actual_max_deg[2]:.2f} deg (the note: 0.15). The actual device is the simulated one with "
        f"hysteresis, thermometer lag, non-linearity of the converter and g-sensitivity. {SLOPE_OF_THE_NOTE}"
    )
    columns = ("level", "simulated: largest (deg)", "actual: largest (deg)", "largest difference (deg)", "correlation")
    return Table(
        title="Figure 3: sit-to-stand task, simulated and actual device",
        columns=columns,
        rows=rows,
        form=".2f",
        note=note,
        figure=lambda: draw_figure3(figure, COMPARED),
    )


def _methods(outcome: StudyOutcome) -> list[Table]:
    """Return the methods that undrift offers and the note's rivals."""
    rows = list[tuple[Cell, ...]]()
    for row in outcome.methods:
        errors = [cell for mean, ends in zip(row.error_deg, row.interval_deg, strict=True) for cell in (mean, *ends)]
        rows.append((row.method, row.minutes, row.instruments, row.triads, *errors, row.tilt_deg, row.failed))
    heads = [
        f"{name_of(task)}{part}" for task in outcome.tasks for part in (" (deg)", ", 95 % from (deg)", ", to (deg)")
    ]
    note = (
        "Mean error of the pitch with its 95 % interval. All methods calibrate the same devices, which perform the same "
        "trials. Tilt is measured by the accelerometers only. A triad that a method does not calibrate keeps its data "
        "sheet, with the offset of a rest. Each rival has one specified instrument error."
    )
    columns = ("method", "minutes", "instruments", "triads", *heads, "tilt at rest (deg)", "devices that fail")
    form = dict.fromkeys((*heads, "tilt at rest (deg)"), ".2f") | {"minutes": ".0f"}
    return [Table(title="Methods and rivals", columns=columns, rows=rows, form=form, note=note)] if rows else []


# ---- summary.json


def study_json(outcome: StudyOutcome, figure: Figure3 | None) -> dict[str, Any]:
    """Return the JSON of a study."""
    planned = outcome.study
    keys = ("name", "device", "group", "excursion_k", "seed", "offset", "timing", "fit", "margin_deg", "target_deg")
    return {
        **{key: getattr(planned, key) for key in keys},
        "subjects": outcome.subjects,
        "shipped_fits": planned.shipped,
        "bench": planned.bench.model_dump(),
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


def _task_json(task: TaskOutcome) -> dict[str, Any]:
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
