"""The page of a study: Table 1 with the note's rows, the error surface, statistics, the other cohort, Figure 3."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.report.figures import svg_of
from undrift.report.page import Section, write_page
from undrift.report.study_answer import answer_sections
from undrift.report.study_extra import design_sections, real_sections, rival_sections
from undrift.report.study_pictures import LEVEL_NAMES, NAMES, draw_figure3, draw_pareto, draw_surface, told_p
from undrift.report.study_statistics import effect_sections, full_section

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.outcome import StudyOutcome, TaskOutcome
    from undrift.study.testing import Tested

FOUR = tuple(NAMES.values())
NOTE = (
    'The note, here and below: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)


def write_study_report(outcome: "StudyOutcome", path: Path) -> None:
    """Write the page of a study.

    Parameters
    ----------
    outcome : StudyOutcome
        What came out.
    path : Path
        The .html file.
    """
    held = outcome.study
    write_page(
        path,
        title=f"Study: {held.name}",
        lead=f"{outcome.runs} calibration sessions simulated, fitted and judged: {held.subjects} subjects, device {held.device}, "
        f"seed {held.seed}; the {'root-mean-square' if held.objective == 'rms' else 'maximum'} error of the sagittal pitch is "
        f"minimised. {NOTE}",
        sections=study_sections(outcome),
    )


def study_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the sections of a study's page.

    Parameters
    ----------
    outcome : StudyOutcome
        What came out.

    Returns
    -------
    tuple of Section
        The answer, tables, a group for each task, the tests in full, Figure 3, rates to dwell at, rival methods, real recordings.
    """
    tasks = [section for task in outcome.tasks for section in _task_sections(outcome, task)]
    beside, full = _beside(outcome), full_section(outcome)
    return (
        *answer_sections(outcome),
        _table_1(outcome),
        *((beside,) if beside.rows else ()),
        _testing(outcome),
        _cohorts(outcome),
        *tasks,
        *((full,) if full.rows else ()),
        _figure3(outcome.figure3, outcome.figure3_missing),
        *_figure3_effects(outcome),
        *design_sections(outcome.designs),
        *rival_sections(outcome),
        *real_sections(outcome.real),
    )


def _table_1(outcome: "StudyOutcome") -> Section:
    rows = []
    for task in outcome.tasks:
        found = task.optimum
        rows.append((f"{_words(task.surface.task)}: optimum", *_protocol(task, found.best), told_p(found.p_value)))
        if found.cheapest != found.best:
            rows.append(("… shortest that is as good", *_protocol(task, found.cheapest), ""))
        if task.beside is not None:
            row = task.beside.row
            four = row.cutoff_hz, row.turn_rate_step_dps, row.turn_rate_min_dps, row.turn_rate_max_dps
            mark = " *" if row.erratum else ""
            rest = ("", "", "") if task.beside.place is None else _protocol(task, task.beside.place)[4:]
            rows.append(
                (f"… the note{mark}", *(f"{value:.4g}" for value in four), *rest, f"{row.p_value:.3f}, its own")
            )
    text = [_worth(task) for task in outcome.tasks]
    errata = {task.beside.row.erratum for task in outcome.tasks if task.beside and task.beside.row.erratum}
    return Section(
        title="Table 1: optimised parameters",
        text=(
            *text,
            "p is the least of the four parameters', after Holm: whether any of them matters at all, others at the optimum. In the "
            "note's rows it is the one that the note prints as its own; what that tests the note does not say.",
            *(f"* {erratum}" for erratum in sorted(errata)),
        ),
        columns=("task", *FOUR, "error, rms (deg)", "largest (deg)", "session (min)", "p"),
        rows=tuple(rows),
    )


def _worth(task: "TaskOutcome") -> str:
    found = task.optimum
    flat = "; the minimum is flat, use the one with the shortest session" if found.flat else ""
    if found.deciding and found.equivalent.sum() > 1:
        names = " and ".join(NAMES[name] for name in found.deciding)
        flat = f"; not that nothing matters: {names} {'decides' if len(found.deciding) == 1 else 'decide'} the error"
    failed = f" {found.failed} runs could not calibrate their device." if found.failed else ""
    return (
        f"{_words(task.surface.task)}: {found.equivalent.sum()} of {len(task.surface.cutoff_hz)} protocols are statistically as "
        f"good as the optimum (paired, Holm){flat}. Error of the optimum, by subjects that did not choose it: "
        f"{found.honest_error_deg:.3f} deg [{found.honest_interval_deg[0]:.3f}, {found.honest_interval_deg[1]:.3f}].{failed}"
    )


def _beside(outcome: "StudyOutcome") -> Section:
    rows = [
        (_words(task.surface.task), held.verdict, held.because)
        for task in outcome.tasks
        if (held := task.beside) is not None
    ]
    return Section(
        title="Against the note's Table 1", columns=("task", "the note", "because"), rows=tuple(rows), words=True
    )


def _testing(outcome: "StudyOutcome") -> Section:
    rows = [
        (f"{_words(task.surface.task)}: {name}", *_tested(tested))
        for task in outcome.tasks
        for name, tested in zip(("optimum", "shortest that is as good"), task.tested, strict=True)
    ]
    return Section(
        title="On the other cohort",
        text=(
            "Other subjects, other units of the device, other temperatures and noise: means and their 95 % intervals.",
        ),
        columns=("protocol", "subjects", "error, rms (deg)", "interval", "largest (deg)", "interval", "not calibrated"),
        rows=tuple(rows),
    )


def _tested(tested: "Tested") -> tuple[str, ...]:
    return (
        str(tested.subjects),
        f"{tested.error_rms_deg:.3f}",
        f"{tested.interval_rms_deg[0]:.3f} to {tested.interval_rms_deg[1]:.3f}",
        f"{tested.error_max_deg:.3f}",
        f"{tested.interval_max_deg[0]:.3f} to {tested.interval_max_deg[1]:.3f}",
        str(tested.failed),
    )


def _cohorts(outcome: "StudyOutcome") -> Section:
    rows = []
    for cohort, role in zip(outcome.cohorts, ("chose", "tested"), strict=True):
        age, height = cohort.age_years, [100.0 * value for value in cohort.height]
        note_age, note_height = cohort.printed.age_years, [100.0 * value for value in cohort.printed.height]
        rows.append(
            (
                f"{cohort.group} ({role})",
                str(cohort.count),
                f"{age[0]:.0f} to {age[2]:.0f}, mean {age[1]:.1f}",
                f"{note_age[0]:.0f} to {note_age[2]:.0f}, mean {note_age[1]:.0f}",
                f"{height[0]:.0f} to {height[2]:.0f}, mean {height[1]:.1f}",
                f"{note_height[0]:.0f} to {note_height[2]:.0f}, mean {note_height[1]:.0f}",
            )
        )
    return Section(
        title="Table 2: cohorts",
        columns=("group", "subjects", "age (years)", "the note's", "height (cm)", "the note's"),
        rows=tuple(rows),
    )


def _task_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    name = _words(task.surface.task)
    return (
        Section(
            title=f"{name}: error surface",
            text=(
                "Mean error over the subjects. Each cell is the best of the protocols that share it; white: not tried, or a "
                "device could not be calibrated. Star: optimum; ring: the note's protocol. The colours span a factor of two at "
                "least, so that small differences look small.",
            ),
            pictures=(svg_of(draw_surface(outcome, task)),),
        ),
        *effect_sections(outcome, task),
        Section(
            title=f"{name}: error against minutes on the rig",
            text=("One point a protocol; in the table those that no other beats in both error and time.",),
            columns=(*FOUR, "error, rms (deg)", "largest (deg)", "session (min)"),
            rows=tuple(_protocol(task, int(place)) for place in task.optimum.pareto),
            pictures=(svg_of(draw_pareto(outcome, task)),),
        ),
    )


def _figure3(found: "Figure3 | None", missing: str) -> Section:
    if found is None:
        return Section(title="Figure 3", text=(f"Not made: {missing}.",))
    rows = tuple(
        (
            name,
            f"{found.simulated_max_deg[k]:.2f}",
            f"{found.actual_max_deg[k]:.2f}",
            f"{found.simulated_rms_deg[k]:.2f}",
            f"{found.actual_rms_deg[k]:.2f}",
            f"{found.simulated_actual_max_deg[k]:.2f}",
        )
        for k, name in enumerate(LEVEL_NAMES)
    )
    return Section(
        title="Figure 3: sit-to-stand, simulated and actual device",
        text=(
            f"Board {found.excursion_k:g} K above the bench. Compensation takes {found.decrease_deg:.2f} deg off the actual "
            "device's largest error (the note: more than 3.2). The actual device is the simulated one with hysteresis, a "
            "lagging thermometer, a bowed converter and g-sensitivity, of which the model knows nothing; with both tables the "
            f"two errors differ by {found.simulated_actual_max_deg[2]:.2f} deg at most (the note: 0.15).",
        ),
        columns=(
            "compensation",
            "max, simulated (deg)",
            "max, actual (deg)",
            "rms, simulated",
            "rms, actual",
            "differ by at most",
        ),
        rows=rows,
        pictures=(svg_of(draw_figure3(found)),),
    )


def _figure3_effects(outcome: "StudyOutcome") -> tuple[Section, ...]:
    if not outcome.figure3_effects:
        return ()
    return (
        Section(
            title="Figure 3: what sets simulated and actual apart",
            text=(
                "The actual device's effects switched on one at a time: largest difference between the two errors at each level of "
                "compensation, and the largest error that both tables leave. Noise alone is another recording of the same model.",
            ),
            columns=("effect", *(f"{name} (deg)" for name in LEVEL_NAMES), "largest error, both tables (deg)"),
            rows=tuple(
                (
                    _words(row.effect),
                    *(f"{value:.2f}" for value in row.simulated_actual_max_deg),
                    f"{row.full_max_deg:.2f}",
                )
                for row in outcome.figure3_effects
            ),
        ),
    )


def _protocol(task: "TaskOutcome", place: int) -> tuple[str, ...]:
    surface = task.surface
    return (
        *(f"{getattr(surface, name)[place]:.4g}" for name in NAMES),
        f"{surface.error_rms_deg[:, place].mean():.3f}",
        f"{surface.error_max_deg[:, place].mean():.3f}",
        f"{surface.rig_minutes[place]:.1f}",
    )


def _words(task: str) -> str:
    return task.replace("_", " ")
