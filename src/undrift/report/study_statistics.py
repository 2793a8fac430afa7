"""Statistics on a study's page: what each parameter does, which of its values differ, and every figure behind it."""

from typing import TYPE_CHECKING

from undrift.report.figures import svg_of
from undrift.report.page import Section
from undrift.report.study_answer import missing_words
from undrift.report.study_pictures import NAMES, draw_effects, told_p

if TYPE_CHECKING:
    from undrift.study.effects import ParameterEffect
    from undrift.study.outcome import EffectPower, StudyOutcome, TaskOutcome


def effect_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    """Return the sections on the parameters of a task.

    Parameters
    ----------
    outcome : StudyOutcome
        Gives the level of the tests.
    task : TaskOutcome
        With its effects.

    Returns
    -------
    tuple of Section
        Effects, and the values that differ where a parameter matters.
    """
    name = task.surface.task.replace("_", " ")
    powers = {power.name: power for power in task.powers}
    missing = missing_words(task).strip()
    effects = Section(
        title=f"{name}: what each parameter does",
        text=(
            "One parameter at a time, the others at the optimum; bars are 95 % intervals within subjects, p after Holm over the "
            "parameters. Partial eta²: the parameter's share of the variance that the subjects' own levels leave. Power: the "
            "chance that as many subjects find such differences, were they the truth; the last column says how many find them in "
            "eight studies of ten.",
            *((missing,) if missing else ()),
            *_compared(outcome, task),
            *_stopping(outcome, task),
        ),
        columns=(
            "parameter",
            "values tried",
            "moves the error by (deg)",
            "test",
            "F (degrees of freedom)",
            "p after Holm",
            "partial eta²",
            "power",
            "subjects for power 0.8",
        ),
        rows=tuple(_effect_row(effect, powers.get(effect.name)) for effect in task.optimum.effects),
        pictures=(svg_of(draw_effects(task)),),
    )
    rows = tuple(row for effect in task.optimum.effects for row in _pair_rows(outcome, effect))
    if not rows:
        return (effects,)
    differ = Section(
        title=f"{name}: which values differ from the optimum's",
        text=(
            "Paired differences of the error, positive where the value is worse than the optimum's. p after Holm over all pairs of "
            "a parameter's values; those between other values are in summary.json. Cohen's dz: difference over the standard "
            "deviation of the subjects' differences.",
        ),
        columns=(
            "parameter",
            "optimum",
            "value",
            "difference (deg)",
            "95 % interval",
            "t",
            "p after Holm",
            "dz",
            f"differs (p < {outcome.study.level:g})",
        ),
        rows=rows,
    )
    return effects, differ


def _effect_row(effect: "ParameterEffect", power: "EffectPower | None") -> tuple[str, ...]:
    test, values = effect.test, ", ".join(f"{value:.4g}" for value in effect.values)
    if len(effect.dropped):
        values += f" (left out, too few calibrated: {', '.join(f'{value:.4g}' for value in effect.dropped)})"
    if test is None or power is None:
        return (NAMES[effect.name], values, "", f"none: {effect.untested}", *("",) * 5)
    return (
        NAMES[effect.name],
        values,
        f"{effect.span_deg:.3f}",
        "ANOVA" if effect.anova is not None else f"mixed model, {effect.missing} missing",
        f"{test.f:.2f} ({test.dof[0]:.0f}, {test.dof[1]:.0f})",
        told_p(effect.p_holm),
        f"{test.partial_eta_squared:.2f}",
        f"{power.power:.2f}",
        "no number" if power.subjects is None else str(power.subjects),
    )


def _pair_rows(outcome: "StudyOutcome", effect: "ParameterEffect") -> tuple[tuple[str, ...], ...]:
    rows = []
    for pair in effect.pairs:
        if effect.best not in (pair.first, pair.second):
            continue
        other, sign = (pair.first, 1.0) if pair.second == effect.best else (pair.second, -1.0)
        low, high = sorted(sign * end for end in pair.interval)
        rows.append(
            (
                NAMES[effect.name],
                f"{effect.values[effect.best]:.4g}",
                f"{effect.values[other]:.4g}",
                f"{sign * pair.difference:.3f}",
                f"{low:.3f} to {high:.3f}",
                f"{sign * pair.t:.2f}",
                told_p(pair.p_holm),
                f"{sign * pair.cohen_dz:.2f}",
                "yes" if pair.p_holm < outcome.study.level else "no",
            )
        )
    return tuple(rows)


def _compared(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[str, ...]:
    if any(effect.pairs for effect in task.optimum.effects):
        return ()
    return (f"No parameter's p is below {outcome.study.level:g}, so the values of none are compared with each other.",)


def _stopping(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[str, ...]:
    held = task.stopping
    if held is None:
        return (
            "Optional stopping: looking again after each added subject, until p falls below the level, finds differences that are "
            "not there; how often is computed with more than ten subjects. Fix their number beforehand.",
        )
    first, last = held.p_by_subjects[0][0], held.p_by_subjects[-1][0]
    return (
        f"Optional stopping: adding subjects until p falls below {outcome.study.level:g}, as the note's thirty subjects that "
        f"obtained the target significance invite, finds a difference where there is none in {100.0 * held.false_alarm:.0f} % of "
        f"studies (looks from {first} to {last} subjects), not in {100.0 * outcome.study.level:g} %. Here p of "
        f"{NAMES[task.stopping_of]} crossed the level {held.crossings} times on the way; only the last p, with the number of "
        "subjects fixed beforehand, counts.",
    )


def full_section(outcome: "StudyOutcome") -> Section:
    """Return every figure of the tests, for those who check them.

    Parameters
    ----------
    outcome : StudyOutcome
        What came out.

    Returns
    -------
    Section
        A row for each parameter that was tested; without rows where none was.
    """
    return Section(
        title="The tests in full",
        text=(
            "One-way repeated-measures analysis of variance; p as it stands, with the degrees of freedom of Greenhouse-Geisser "
            "(GG), and of Huynh-Feldt (HF). The one quoted above is HF where epsilon GG is above 0.75, else GG. Mauchly's test of "
            "sphericity needs three values or more. A mixed model has one p, a residual in place of epsilons, and takes the "
            "differences as spherical.",
        ),
        columns=(
            "task: parameter",
            "p",
            "p GG",
            "p HF",
            "quoted",
            "epsilon GG",
            "epsilon HF",
            "Mauchly's W",
            "p of Mauchly",
            "generalised eta²",
            "residual sd (deg)",
        ),
        rows=tuple(
            _full_row(task, effect)
            for task in outcome.tasks
            for effect in task.optimum.effects
            if effect.test is not None
        ),
    )


def _full_row(task: "TaskOutcome", effect: "ParameterEffect") -> tuple[str, ...]:
    name, residual = f"{task.surface.task.replace('_', ' ')}: {NAMES[effect.name]}", f"{effect.error_variance**0.5:.4f}"
    found = effect.anova
    if found is None:
        p = "" if effect.mixed is None else told_p(effect.mixed.p_value)
        return (name, p, "", "", "mixed model", *("",) * 5, residual)
    form = found.sphericity
    more = found.conditions > 2
    return (
        name,
        told_p(found.p_uncorrected),
        told_p(found.p_greenhouse_geisser),
        told_p(found.p_huynh_feldt),
        {"huynh-feldt": "HF", "greenhouse-geisser": "GG"}[found.correction],
        f"{form.greenhouse_geisser:.2f}",
        f"{form.huynh_feldt:.2f}",
        f"{form.mauchly_w:.2f}" if more else "",
        told_p(form.p_value) if more else "",
        f"{found.generalized_eta_squared:.3f}",
        residual,
    )
