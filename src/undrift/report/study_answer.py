"""The first section of a study's page: which protocol to use for each task, in how many minutes, and how good it then is."""

from typing import TYPE_CHECKING

from undrift.report.page import Section
from undrift.report.study_pictures import NAMES, told_p
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.study.effects import ParameterEffect
    from undrift.study.outcome import StudyOutcome, TaskOutcome
    from undrift.study.plan import Untried


def answer_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return what a study says to the person who has to choose a protocol.

    Parameters
    ----------
    outcome : StudyOutcome
        What came out.

    Returns
    -------
    tuple of Section
        A row a task, then a paragraph a task: how surely, and what decides.
    """
    rows = Section(
        title="Answer: the protocol to use",
        text=("Of all protocols that are as good as the best, the one with the shortest session.",),
        columns=(
            "task",
            "low-pass (Hz)",
            "rates of the table (deg/s)",
            "session (min)",
            "pitch error, rms (deg)",
            "95 % interval",
            "largest error (deg)",
        ),
        rows=tuple(_row(task) for task in outcome.tasks),
    )
    why = Section(
        title="How surely, and what decides",
        text=(
            *(_paragraph(outcome, task) for task in outcome.tasks),
            "Errors above are means over people and devices that had no part in the choice. Each rate is turned both ways. Below, "
            "omega_m and omega_M are the least and greatest rate of the table, d is the step between rates.",
        ),
    )
    return rows, why


def _row(task: "TaskOutcome") -> tuple[str, ...]:
    surface, tested, place = task.surface, task.tested[1], task.optimum.cheapest
    return (
        _words(surface.task),
        f"{surface.cutoff_hz[place]:.4g}",
        rates_of(task, place),
        f"{surface.rig_minutes[place]:.0f}",
        f"{tested.error_rms_deg:.3f}",
        f"{tested.interval_rms_deg[0]:.3f} to {tested.interval_rms_deg[1]:.3f}",
        f"{tested.error_max_deg:.3f}",
    )


def rates_of(task: "TaskOutcome", place: int) -> str:
    """Return the rates of a protocol in words.

    Parameters
    ----------
    task : TaskOutcome
        With its surface.
    place : int
        Of the protocol.

    Returns
    -------
    str
        As in "5 to 70 by 5".
    """
    surface = task.surface
    low, high, step = (
        f"{getattr(surface, name)[place]:.4g}"
        for name in ("turn_rate_min_dps", "turn_rate_max_dps", "turn_rate_step_dps")
    )
    return f"{low} to {high} by {step}"


def _paragraph(outcome: "StudyOutcome", task: "TaskOutcome") -> str:
    found, surface = task.optimum, task.surface
    matter = [effect for effect in found.effects if effect.p_holm < outcome.study.level]
    others, subjects = len(surface.cutoff_hz) - 1, len(surface.error_rms_deg)
    said = f"{_words(surface.task).capitalize()}: "
    if others:
        alike = int(found.equivalent.sum()) - 1
        said += f"{subjects} subjects do not tell {alike} of the {others} other protocols from the best one. "
    said += _decides(matter, found.p_value)
    if found.cheapest != found.best:
        saved = surface.rig_minutes[found.best] - surface.rig_minutes[found.cheapest]
        mean = surface.error(outcome.study.objective).mean(axis=0)
        said += (
            f" The best one, {rates_of(task, found.best)} deg/s at {surface.cutoff_hz[found.best]:.4g} Hz, takes {saved:.1f} min "
            f"longer; its error is {_less(float(mean[found.cheapest] - mean[found.best]))}, which may be chance."
        )
    untried = untried_words(task.untried)
    return said + (f" {untried}" if untried else "") + missing_words(task)


def _less(difference_deg: float) -> str:
    return f"{difference_deg:.3f} deg less" if difference_deg >= 5e-4 else "less by under 0.001 deg"


def _decides(matter: "list[ParameterEffect]", p: float) -> str:
    if not matter:
        return (
            f"None of the four parameters decides the error (least p {told_p(p)}, after Holm)."
            if p == p
            else ("The four parameters could not be tested.")
        )
    told = ", ".join(f"{NAMES[e.name]} ({e.span_deg:.3f} deg from best to worst, p {told_p(e.p_holm)})" for e in matter)
    return f"What decides the error: {told}."


def untried_words(rows: "tuple[Untried, ...]") -> str:
    """Say which values of the plan no protocol has.

    Parameters
    ----------
    rows : tuple of Untried
        Values, rad/s, and reasons.

    Returns
    -------
    str
        Empty where all are tried.
    """
    told = "; ".join(
        f"{NAMES[f'{row.parameter}_dps'].replace(' (deg/s)', '')} {row.value / RADIAN_PER_DEGREE:.4g} deg/s ({row.reason})"
        for row in rows
    )
    return f"Not tried: {told}." if told else ""


def missing_words(task: "TaskOutcome") -> str:
    """Say which runs and subjects a task lacks, and what follows.

    Parameters
    ----------
    task : TaskOutcome
        With its surface and effects.

    Returns
    -------
    str
        Empty where nothing is missing.
    """
    found, said = task.optimum, ""
    if task.surface.left_out:
        numbers = ", ".join(str(subject) for subject in task.surface.left_out)
        said += f" Left out, since no protocol could calibrate the device: subject {numbers} of surface.parquet."
    if found.failed:
        said += (
            f" Missing: {found.failed} of {task.surface.error_rms_deg.size} runs, in which the protocol could not calibrate the "
            "subject's device; such a protocol is no candidate."
        )
    mixed = [NAMES[effect.name] for effect in found.effects if effect.mixed is not None]
    if mixed:
        said += (
            f" Since runs are missing, {' and '.join(mixed)} {'is' if len(mixed) == 1 else 'are'} judged by a mixed model (a "
            "random level for each subject) in place of the analysis of variance; it takes what is missing as "
            "missing by chance, which failures seldom are: its means flatter the value that failed."
        )
    return said


def _words(task: str) -> str:
    return task.replace("_", " ")
