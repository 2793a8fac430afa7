"""The page of a study: Table 1 with the note's rows, the error surface, statistics, the other cohort, Figure 3."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.report.figures import (
    LEVEL_NAMES,
    NAMES,
    draw_effects,
    draw_figure3,
    draw_pareto,
    draw_surface,
    svg_of,
    told_p,
)
from undrift.report.page import Section, write_page
from undrift.report.study_rivals import design_sections, real_sections, rival_sections
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import ParameterEffect, Tested
    from undrift.study.outcome import EffectPower, StudyOutcome, TaskOutcome
    from undrift.study.plan import Untried

# ---- The first section of a study's page: which protocol to use for each task, in how many minutes, and how good it then is.


def answer_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return what a study says to the person who has to choose a protocol."""
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
    """Return the rates of a protocol in words."""
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
    """Say which values of the plan no protocol has."""
    told = "; ".join(
        f"{NAMES[f'{row.parameter}_dps'].replace(' (deg/s)', '')} {row.value / RADIAN_PER_DEGREE:.4g} deg/s ({row.reason})"
        for row in rows
    )
    return f"Not tried: {told}." if told else ""


def missing_words(task: "TaskOutcome") -> str:
    """Say which runs and subjects a task lacks, and what follows."""
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


# ---- Statistics on a study's page: what each parameter does, which of its values differ, and every figure behind it.


def effect_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    """Return the sections on the parameters of a task."""
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
    """Return every figure of the tests, for those who check them."""
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


# ---- study

FOUR = tuple(NAMES.values())
NOTE = (
    'The note, here and below: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)


def write_study_report(outcome: "StudyOutcome", path: Path) -> None:
    """Write the page of a study."""
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
    """Return the sections of a study's page."""
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
