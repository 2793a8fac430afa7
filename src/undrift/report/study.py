"""Report of a study: the cheapest session that is good enough, and the tables that support it."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from undrift.report.figures import draw_figure3, draw_sessions
from undrift.report.report import Cell, Report, Table
from undrift.sim.motion.tasks import TABLE_2, cohort
from undrift.study.case import ASSUMED, stream
from undrift.study.figure3 import COMPARED, Figure3
from undrift.study.judge import Answer, StudyOutcome, TaskOutcome, breakdown_session
from undrift.study.plan import HEADINGS, TABLE_1
from undrift.study.sessions import CalibrationSession

FEWEST = 20  # smallest number of devices of which one exceeds the 95 % quantile
OFFSETS = {
    "rest": "with the offset of the rest subtracted",
    "motion": "with the offset from the motion subtracted",
    "none": "no offset subtracted",
}
GOOD_ENOUGH = (
    "Good enough: 95 % of the simulated devices, each on a different person, stay below the target. A session is tested "
    "with other devices on the other group of people. All figures are simulated, and errors apply to a device that "
    "is fixed to the bone: the attachment to the body adds about 1 deg for every session."
)
SLOPE_OF_THE_NOTE = (
    "The slope of the offset over temperature in the preset was chosen to match Figure 3 of the note. The error without "
    "compensation is therefore not evidence. Compare only the remaining errors with the note."
)
NOTE = (
    'The note: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)


def study_report(outcome: StudyOutcome, figure: Figure3 | None, folder: Path) -> Report:
    """Return the report of a study: the answer first, then the supporting tables."""
    notes = [NOTE]
    if outcome.subjects < FEWEST:
        notes.append(
            f"{outcome.subjects} devices do not determine the error below which 95 % of devices stay. Study {FEWEST} or "
            "more for a result."
        )
    return Report(
        title=f"Study: {outcome.study.name}",
        answer=_answer(outcome),
        tables=[
            _for_all(outcome),
            *(_sessions(outcome, task) for task in outcome.tasks),
            _sensitivity(outcome),
            *map(_table_1, outcome.tasks),
            *([_figure3(figure)] if figure else []),
            Table(title="Commands", columns=("session", "command"), rows=_commands(outcome, folder)),
        ],
        details=[_breakdown(outcome), _table_2(outcome), _methods(outcome)],
        notes=notes,
        figures=[lambda: draw_sessions(outcome)],
        written=[folder / name for name in ("report.html", "summary.json", "runs.parquet")],
        data=_json(outcome),
    )


def name_of(task: TaskOutcome) -> str:
    """Return a task in words."""
    return task.task.key.replace("-", ", ").replace("_", " ")


def chosen_sessions(outcome: StudyOutcome) -> list[CalibrationSession]:
    """Return each session that is an answer, once."""
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
    """Return the share of each answer's error that depends on assumed properties of the device."""
    shares = [
        f"{100.0 * share:.0f} % ({name_of(task)}, {breakdown_session(task)})"
        for task in outcome.tasks
        for name, share in task.breakdown
        if name == ASSUMED
    ]
    return (
        f" Share of the mean square error that depends on assumed properties of the device: {', '.join(shares)}."
        if shares
        else ""
    )


def _for_all(outcome: StudyOutcome) -> Table:
    rows = list[dict[str, Cell]]()
    for k, overall in enumerate(outcome.for_all):
        for name, answer in [*((name_of(task), task.answers[k]) for task in outcome.tasks), ("all tasks", overall)]:
            below, tested, confirmed = answer.below, answer.tested, answer.confirmed
            row: dict[str, Cell] = {
                "target (deg)": answer.target_deg,
                "task": name,
                "cheapest session": answer.session or "none",
            }
            test = {"other group below": below, "of": tested, "confirmed": confirmed}
            rows.append(row | (test if tested else dict.fromkeys(test)))
    note = GOOD_ENOUGH + _assumed(outcome)
    if outcome.study.shipped:
        note += " Fits that come with undrift were used if available. One of them was computed again for comparison, and agrees."
    return Table.of("The cheapest session that is good enough", rows, form="g", note=note)


def _sessions(outcome: StudyOutcome, task: TaskOutcome) -> Table:
    study, device = outcome.study, outcome.study.typical_unit()
    rows = list[dict[str, Cell]]()
    for row in task.sessions:
        against: str = "best" if row.against_best is None else row.against_best.verdict
        if row.failed == outcome.subjects:
            against = "every device fails" if row.session.suits(device) else "unsuitable for readings in counts"
        rows.append(
            {
                "session": row.session.name,
                "minutes": row.session.length_min,
                "instruments": row.session.instruments,
                "mean (deg)": row.mean_deg,
                "95 % from": max(row.interval_deg[0], 0.0),
                "to": row.interval_deg[1],
                "95 % of devices below": row.quantile_deg,
                "one device from": row.single_deg[0],
                "one device to": row.single_deg[1],
                "mean in real time": row.real_time_deg,
                "enough for (deg)": next((x for x in study.target_deg if row.quantile_deg <= x), None),
                "against the best": against,
                "devices that fail": row.failed,
            }
        )
    timing = "aligned in time, as in the note" if study.timing == "aligned" else "in real time"
    low_k, high_k = study.excursion_k
    note = (
        f"Root mean square of the pitch error over the motion, {timing}: {outcome.subjects} devices, {low_k:g} to "
        f"{high_k:g} K above room temperature, {OFFSETS[study.offset]}. Against the best: better or worse by more than "
        f"{study.margin_deg:g} deg, or equivalent within it. The error rate of all these tests together is 5 %."
    )
    form = dict.fromkeys(("mean (deg)", "95 % from", "to", "one device from", "one device to"), ".3f")
    form |= dict.fromkeys(("95 % of devices below", "mean in real time"), ".2f")
    form |= {"minutes": ".0f", "enough for (deg)": "g"}
    return Table.of(f"{name_of(task)}: sessions", rows, form=form, note=note)


def _sensitivity(outcome: StudyOutcome) -> Table:
    errors = {(rise, offset, name): value for rise, offset, name, value in outcome.sensitivity}
    names, range_k = (
        [session.name for session in outcome.study.sessions],
        "{:g} to {:g}".format(*outcome.study.excursion_k),
    )
    rows: list[dict[str, Cell]] = [
        {"K above the room": f"{rise:g}" if math.isfinite(rise) else range_k, "offset subtracted": offset}
        | {name: errors[rise, offset, name] for name in names}
        for rise, offset in dict.fromkeys((rise, offset) for rise, offset, *_ in outcome.sensitivity)
    ]
    note = f"{name_of(outcome.tasks[0])}: error below which 95 % of devices stay (deg), for other temperatures and offsets."
    return Table.of("Sensitivity", rows, form=".2f", note=note)


def _breakdown(outcome: StudyOutcome) -> Table:
    rows: list[dict[str, Cell]] = [
        {"task": name_of(task), "session": breakdown_session(task)}
        | {f"{name} (%)": 100.0 * share for name, share in task.breakdown}
        for task in outcome.tasks
        if task.breakdown
    ]
    note = (
        "Share of the mean square error that disappears if one kind of error is switched off. Kinds interact, so shares need not "
        "add up to 100 %."
    )
    return Table.of("Sources of the error", rows, form=".0f", note=note)


def _commands(outcome: StudyOutcome, folder: Path) -> Sequence[tuple[str, str]]:
    return [
        (session.name, line)
        for session in chosen_sessions(outcome)
        for line in session.commands(str(folder / file_stem(session)))
    ]


# ---- results of the note


def _table_1(task: TaskOutcome) -> Table:
    """Return the errors of a task for other values of the note's four numbers."""
    rows = list[tuple[Cell, ...]]()
    for effect in task.effects:
        test: tuple[Cell, ...] = (None, None, None)
        if effect.anova is not None:
            test = (effect.anova.f, effect.anova.p_value, effect.p_holm)
        span = max(effect.means_deg, default=0.0) - min(effect.means_deg, default=0.0)
        for value, mean in zip(effect.values, effect.means_deg, strict=True):
            tested = (span, *test, effect.verdict) if value == effect.own else (None,) * 5
            rows.append((HEADINGS[effect.parameter], value, mean, *tested))
    note = (
        "Each number is varied by itself. The other three keep their values. The row with the value of the task has the "
        "span of the means, and F of repeated-measures ANOVA with the Greenhouse-Geisser correction. The verdict uses the "
        "margin of the study, because p decreases with every additional device."
    )
    for key, row in TABLE_1.items():
        if key == task.task.name and task.task.tried and task.task.tried.around == row.numbers:
            note += f" The p of this row in the note is {row.p_value:g}." + (f" {row.erratum}" if row.erratum else "")
    columns = ("parameter", "value", "mean error (deg)", "span (deg)", "F", "p", "p (Holm)", "verdict")
    form = {"value": "g", "mean error (deg)": ".3f", "span (deg)": ".3f", "F": ".2f", "p": ".2g", "p (Holm)": ".2g"}
    title = f"{name_of(task)}: the note's Table 1"
    return Table(title=title, columns=columns, rows=rows, form=form, note=note if rows else "")


def _table_2(outcome: StudyOutcome) -> Table:
    """Return both groups of people next to the note's Table 2."""
    rows = list[tuple[Cell, ...]]()
    for group, (note_ages, note_heights) in TABLE_2.items():
        people = cohort(group, rng=stream(outcome.study.seed, "cohort", group, 0))
        for quantity, values, note_row in (
            ("age (years)", [person.age_years for person in people], note_ages),
            ("height (cm)", [100.0 * person.height for person in people], [100.0 * height for height in note_heights]),
        ):
            rows.append((group, quantity, *note_row, min(values), float(np.mean(values)), max(values)))
    columns = ("group", "quantity", "note, minimum", "note, mean", "note, maximum", "minimum", "mean", "maximum")
    return Table(title="The note's Table 2", columns=columns, rows=rows, form=".0f")


def _figure3(figure: Figure3) -> Table:
    errors = (figure.simulated_max_deg, figure.actual_max_deg, figure.simulated_actual_max_deg, figure.correlation)
    note = (
        f"Board {figure.excursion_k:g} K above the bench. Compensation removes {figure.decrease_deg:.2f} deg of the actual "
        f"device's largest error (the note: more than 3.2). With all tables the two errors differ by at most "
        f"{figure.simulated_actual_max_deg[2]:.2f} deg (the note: 0.15). The actual device is the simulated device with "
        f"hysteresis, thermometer lag, non-linearity of the converter and g-sensitivity. {SLOPE_OF_THE_NOTE}"
    )
    return Table(
        title="Figure 3: sit-to-stand task, simulated and actual device",
        columns=(
            "level",
            "simulated: largest (deg)",
            "actual: largest (deg)",
            "largest difference (deg)",
            "correlation",
        ),
        rows=[*zip(COMPARED, *errors, strict=True)],
        form=".2f",
        note=note,
        figure=lambda: draw_figure3(figure, COMPARED),
    )


def _methods(outcome: StudyOutcome) -> Table:
    """Return the table of undrift's methods and the note's rivals."""
    rows = list[dict[str, Cell]]()
    for row in outcome.methods:
        cells: dict[str, Cell] = {
            "method": row.method,
            "minutes": row.minutes,
            "instruments": row.instruments,
            "triads": row.triads,
        }
        for name, mean, (low, high) in zip(map(name_of, outcome.tasks), row.error_deg, row.interval_deg, strict=True):
            cells |= {f"{name} (deg)": mean, f"{name}, 95 % from (deg)": low, f"{name}, to (deg)": high}
        rows.append(cells | {"tilt at rest (deg)": row.tilt_deg, "devices that fail": row.failed})
    form = {head: ".0f" if head == "minutes" else ".2f" for head in (rows[0] if rows else ())}
    note = (
        "Mean error of the pitch with its 95 % interval. All methods calibrate the same devices, which perform the same "
        "trials. Tilt is measured by the accelerometers only. A triad that a method does not calibrate uses its data sheet, with "
        "the offset of a rest. Each rival has one specified instrument error."
    )
    return Table.of("Methods and rivals", rows, form=form, note=note)


def _json(outcome: StudyOutcome) -> dict[str, Any]:
    """Return the settings of a study, and the results that do not fit into tables."""
    keys = ("name", "device", "group", "excursion_k", "seed", "offset", "timing", "fit", "margin_deg", "target_deg")
    tasks = [
        {
            "task": task.task.key,
            "sessions": [asdict(row) | {"session": row.session.name} for row in task.sessions],
            "answers": task.answers,
            "effects": task.effects,
            "made_of": dict(task.breakdown),
        }
        for task in outcome.tasks
    ]
    settings = {key: getattr(outcome.study, key) for key in keys} | {"bench": outcome.study.bench.model_dump()}
    return settings | {"subjects": outcome.subjects, "for_all": outcome.for_all, "tasks": tasks}
