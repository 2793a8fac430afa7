"""Sections of the page of a study that compare it with the note: Figures 1 to 3, Table 1 and Table 2."""

from typing import TYPE_CHECKING

from undrift.base.summary import Section, figure_of, interval, number, plain_words

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import StudyOutcome, TaskOutcome

NOTE = (
    'The note, here and below: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)
SLOPE_OF_THE_NOTE = (
    "The slope of the offset over temperature in the preset was chosen to match Figure 3 of the note. The error without "
    "compensation therefore confirms nothing. Compare only the remaining errors with the note."
)


def note_flows() -> tuple[Section, ...]:
    """Return Figures 1 and 2."""
    text = ("Black: the steps in the text of the note. Blue: the functions of undrift that carry them out.",)
    titles = ("Figure 1: how the parameters are optimised", "Figure 2: how the drift is compensated")
    pictures = (figure_of(f"note:draw_figure{k}") for k in (1, 2))
    return tuple(
        Section(title=title, text=text, pictures=(picture,), folded=True)
        for title, picture in zip(titles, pictures, strict=True)
    )


def table_1(task: "TaskOutcome", name: str) -> Section:
    """Return the errors of a task for other values of the note's four numbers."""
    from undrift.study.plan import HEADINGS, TABLE_1

    rows = list[tuple[str, ...]]()
    for effect in task.effects:
        means = ", ".join(
            f"{value:g}{'*' * (value == effect.own)}: {mean:.3f}"
            for value, mean in zip(effect.values, effect.means_deg, strict=True)
        )
        test = effect.anova
        cells = ("–",) * 3 if test is None else (f"{test.f:.2f}", f"{test.p_value:.2g}", f"{effect.p_holm:.2g}")
        span = max(effect.means_deg, default=0.0) - min(effect.means_deg, default=0.0)
        rows.append((HEADINGS[effect.parameter], means, f"{span:.3f}", *cells, effect.verdict))
    heads = (
        "parameter",
        "value: mean error (deg), * with the values of the task",
        "span (deg)",
        "F",
        "p",
        "p (Holm)",
        "verdict",
    )
    note = next(
        (row for key, row in TABLE_1.items() if key == task.task.name and task.task.around == row.numbers), None
    )
    text = [
        "Each number is varied by itself. The other three keep their values. F is from repeated-measures ANOVA with "
        "the "
        "Greenhouse-Geisser correction. The verdict uses the margin of the study, because p falls with every "
        "device that is added."
    ]
    if note is not None:
        text.append(f"The p of this row in the note is {note.p_value:g}." + f" {note.erratum}" * bool(note.erratum))
    return Section(
        title=f"{name}: the note's Table 1", columns=heads, rows=tuple(rows), text=tuple(text) if rows else ()
    )


def table_2(outcome: "StudyOutcome") -> Section:
    """Return both groups of people, compared with the note's Table 2."""
    import numpy as np

    from undrift.sim.motion.tasks import TABLE_2, cohort
    from undrift.study.case import stream

    rows = list[tuple[str, ...]]()
    for group, printed in TABLE_2.items():
        people = cohort(group, rng=stream(outcome.study.seed, "cohort", group, 0))
        ages, heights = (
            np.array([person.age_years for person in people]),
            np.array([person.height for person in people]),
        )
        cells = []
        for values, (low, mean, high), unit in zip((ages, heights), printed, (1.0, 100.0), strict=True):
            cells += [f"{unit * low:.0f} to {unit * high:.0f}, {unit * mean:.0f}"]
            cells += [f"{unit * values.min():.0f} to {unit * values.max():.0f}, {unit * values.mean():.0f}"]
        rows.append((group, *cells))
    heads = ("group", "age, the note (years)", "age, simulated", "height, the note (cm)", "height, simulated")
    return Section(title="The note's Table 2: least to greatest, mean", columns=heads, rows=tuple(rows), folded=True)


def figure3_section(figure: "Figure3") -> Section:
    """Return the note's Figure 3."""
    from undrift.study.figure3 import COMPARED

    rows = tuple(
        (
            name,
            f"{figure.simulated_max_deg[k]:.2f}",
            f"{figure.actual_max_deg[k]:.2f}",
            f"{figure.simulated_actual_max_deg[k]:.2f}",
            f"{figure.correlation[k]:.2f}",
        )
        for k, name in enumerate(COMPARED)
    )
    text = (
        f"Board {figure.excursion_k:g} K above the bench. Compensation removes {figure.decrease_deg:.2f} deg of the actual "
        f"device's largest error (the note: more than 3.2). With all tables the two errors differ by at most "
        f"{figure.simulated_actual_max_deg[2]:.2f} deg (the note: 0.15).",
        "The actual device is the simulated one with hysteresis, thermometer lag, non-linearity of the converter and "
        "g-sensitivity.",
        SLOPE_OF_THE_NOTE,
    )
    heads = ("level", "simulated: largest (deg)", "actual: largest (deg)", "largest difference (deg)", "correlation")
    picture = figure_of("note:draw_figure3", figure, COMPARED)
    return Section(
        title="Figure 3: sit-to-stand task, simulated and actual device",
        columns=heads,
        rows=rows,
        text=text,
        pictures=(picture,),
    )


def methods_section(outcome: "StudyOutcome") -> Section:
    """Return the methods that undrift offers and the note's rivals."""
    rows = tuple(
        (
            row.method,
            f"{row.minutes:.0f}",
            row.instruments,
            row.triads,
            *(
                f"{number(mean)} ({interval(ends, '.2f')})"
                for mean, ends in zip(row.error_deg, row.interval_deg, strict=True)
            ),
            number(row.tilt_deg),
            str(row.failed),
        )
        for row in outcome.methods
    )
    tasks = (f"{plain_words(task.task.key)} (deg)" for task in outcome.tasks)
    heads = ("method", "minutes", "instruments", "triads", *tasks, "tilt at rest (deg)", "devices that fail")
    text = (
        "Mean error of the pitch with its 95 % interval. All methods calibrate the same devices, which perform the same trials. "
        "Tilt is measured by the accelerometers only. A triad that a method does not calibrate keeps its data sheet, with the "
        "offset of a rest. Each rival has one specified instrument error.",
    )
    return Section(title="Methods and rivals", columns=heads, rows=rows, text=text if rows else (), folded=True)
