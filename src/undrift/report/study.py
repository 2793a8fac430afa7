"""The page of a study: the protocol to use, Table 1 with the note's rows, error surface, statistics, Figure 3."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.report import figures
from undrift.report.figures import NAMES, p_text, svg_of
from undrift.report.page import Cells, Section, interval, number, plain_words, rows_section, table_section, write_page

if TYPE_CHECKING:
    from undrift.findings import Finding
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import ParameterEffect
    from undrift.study.outcome import EffectPower, StudyOutcome, TaskOutcome
    from undrift.study.real import CohortComparison, Pairwise, RealErrors, RealOutcome, Worn, WornRow
    from undrift.study.rivals import DesignRow, RivalRow, Spread
    from undrift.study.run import Halving, Round, TaskSurface

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
    """Return the sections of a study's page; tables without rows are left out."""
    sections = (
        _answer(outcome),
        *(Section(title=f"{_name(task)}: findings", findings=task.findings) for task in outcome.tasks),
        *(_rounds(task, task.halving) for task in outcome.tasks if task.halving is not None),
        _table_1(outcome),
        _note(outcome),
        _other_cohort(outcome),
        _cohorts(outcome),
        *(section for task in outcome.tasks for section in _task_sections(outcome, task)),
        _tests(outcome),
        _figure3(outcome.figure3, outcome.figure3_missing),
        _figure3_drawn(outcome),
        _figure3_effects(outcome),
        *design_sections(outcome.designs),
        *rival_sections(outcome),
        *real_sections(outcome.real),
    )
    return tuple(section for section in sections if section.rows or section.text or section.findings)


def _name(task: "TaskOutcome") -> str:
    return plain_words(task.surface.task)


def rates_of(surface: "TaskSurface", place: int) -> str:
    """Return the rates of a protocol in words."""
    step, low, high = (f"{getattr(surface, name)[place]:.4g}" for name in list(NAMES)[1:])
    return f"{low} to {high} by {step}"


def _protocol(task: "TaskOutcome", place: int) -> tuple[str, ...]:
    """Return the four parameters, both errors and the session of a protocol."""
    surface = task.surface
    errors = (f"{error[:, place].mean():.3f}" for error in (surface.error_rms_deg, surface.error_max_deg))
    return (*(f"{getattr(surface, name)[place]:.4g}" for name in NAMES), *errors, f"{surface.rig_minutes[place]:.1f}")


_PROTOCOL = (*NAMES.values(), "error, rms (deg)", "largest (deg)", "session (min)")


# ---- answer


def _answer(outcome: "StudyOutcome") -> Section:
    cells: Cells[TaskOutcome] = (
        ("task", _name),
        ("low-pass (Hz)", lambda task: f"{task.surface.cutoff_hz[task.optimum.cheapest]:.4g}"),
        ("rates of the table (deg/s)", lambda task: rates_of(task.surface, task.optimum.cheapest)),
        ("session (min)", lambda task: f"{task.surface.rig_minutes[task.optimum.cheapest]:.0f}"),
        ("pitch error, rms (deg)", lambda task: f"{task.tested[1].error_rms_deg:.3f}"),
        ("95 % interval", lambda task: interval(task.tested[1].interval_rms_deg)),
        ("largest error (deg)", lambda task: f"{task.tested[1].error_max_deg:.3f}"),
    )
    text = (
        "Of all protocols that are as good as the best, the one with the shortest session. Errors are means over subjects and "
        "devices that had no part in the choice. Each rate is turned both ways.",
        "Below, omega_m and omega_M are the least and greatest rate of the table, d is the step between rates.",
    )
    return table_section("Answer: the protocol to use", outcome.tasks, cells, text=text)


def _rounds(task: "TaskOutcome", halving: "Halving") -> Section:
    def best(each: "Round") -> str:
        place = each.candidates[each.mean_deg.argmin()]
        return f"{halving.every.cutoff_hz[place]:.4g} Hz, {rates_of(halving.every, place)} deg/s"

    cells: Cells[Round] = (
        ("protocols", lambda each: str(len(each.candidates))),
        ("subjects", lambda each: str(each.subjects)),
        ("best so far", best),
        ("its mean error (deg)", lambda each: f"{each.mean_deg.min():.3f}"),
        ("largest mean error (deg)", lambda each: f"{each.mean_deg.max():.3f}"),
    )
    text = (
        f"{halving.runs} runs; the full grid has {halving.runs_of_grid}. Each round keeps the better half of the protocols and "
        "doubles the subjects. All tables below compare the protocols of the last round.",
    )
    return table_section(f"{_name(task)}: successive halving", halving.rounds, cells, text=text)


# ---- tables 1 and 2, the other cohort


def _table_1(outcome: "StudyOutcome") -> Section:
    rows, text = [], []
    for task in outcome.tasks:
        found, note = task.optimum, task.note
        text.append(
            f"{_name(task)}: {found.equivalent.sum()} of {len(task.surface.cutoff_hz)} protocols are as good as the optimum "
            f"(paired t, Holm). Error of the optimum by subjects that did not choose it: {found.honest_error_deg:.3f} deg "
            f"[{interval(found.honest_interval_deg)}]."
        )
        rows.append((f"{_name(task)}: optimum", *_protocol(task, found.best), p_text(found.p_value)))
        if found.cheapest != found.best:
            rows.append(("… shortest that is as good", *_protocol(task, found.cheapest), ""))
        if note is not None:
            four = (f"{getattr(note.row, name):.4g}" for name in NAMES)
            rest = ("", "", "") if note.place is None else _protocol(task, note.place)[4:]
            mark = " *" if note.row.erratum else ""
            rows.append((f"… the note{mark}", *four, *rest, f"{note.row.p_value:.3f}, its own"))
    errata = {task.note.row.erratum for task in outcome.tasks if task.note and task.note.row.erratum}
    text.append(
        "p is the least of the four parameters', after Holm, the others at the optimum. In the note's rows it is as printed; the "
        "note does not define its test."
    )
    return Section(
        title="Table 1: optimised parameters",
        text=(*text, *(f"* {erratum}" for erratum in sorted(errata))),
        columns=("task", *_PROTOCOL, "p"),
        rows=tuple(rows),
    )


def _note(outcome: "StudyOutcome") -> Section:
    rows = tuple((_name(task), task.note.verdict, task.note.finding.text) for task in outcome.tasks if task.note)
    return Section(title="Against the note's Table 1", columns=("task", "the note", "because"), rows=rows, words=True)


def _other_cohort(outcome: "StudyOutcome") -> Section:
    rows = [
        {
            "protocol": f"{_name(task)}: {name}",
            "subjects": str(tested.subjects),
            "error, rms (deg)": f"{tested.error_rms_deg:.3f}",
            "95 % interval": interval(tested.interval_rms_deg),
            "largest (deg)": f"{tested.error_max_deg:.3f}",
            "95 % interval of it": interval(tested.interval_max_deg),
            "not calibrated": str(tested.failed),
        }
        for task in outcome.tasks
        for name, tested in zip(("optimum", "shortest that is as good"), task.tested, strict=True)
    ]
    text = ("Other subjects, other units of the device, other temperatures and noise: means over the subjects.",)
    return rows_section("On the other cohort", rows, text=text)


def _cohorts(outcome: "StudyOutcome") -> Section:
    def span(ends: tuple[float, float, float], factor: float = 1.0, form: str = ".1f") -> str:
        low, mean, high = (factor * end for end in ends)
        return f"{low:.0f} to {high:.0f}, mean {mean:{form}}"

    rows = [
        {
            "group": f"{cohort.group} ({did})",
            "subjects": str(cohort.count),
            "age (years)": span(cohort.age_years),
            "the note's ages": span(cohort.printed.age_years, form=".0f"),
            "height (cm)": span(cohort.height, 100.0),
            "the note's heights": span(cohort.printed.height, 100.0, form=".0f"),
        }
        for cohort, did in zip(outcome.cohorts, ("chose", "tested"), strict=True)
    ]
    return rows_section("Table 2: cohorts", rows)


# ---- one task


def _task_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    name, surface = _name(task), svg_of(figures.draw_surface(outcome, task))
    white = "not tried" if task.halving is None else "not tried, dropped in an earlier round"
    return (
        Section(
            title=f"{name}: error surface",
            text=(
                f"Mean error over the subjects. Each cell is the best of the protocols that share it; white: {white}, or a "
                "device could not be calibrated. Star: optimum; ring: the note's protocol. The colours span a factor of two at "
                "least, so that small differences look small.",
            ),
            pictures=(surface,),
        ),
        _effects(outcome, task),
        _pairs(outcome, task),
        Section(
            title=f"{name}: error against minutes on the rig",
            text=("One point a protocol; the table has those that no other beats in both error and time.",),
            columns=_PROTOCOL,
            rows=tuple(_protocol(task, int(place)) for place in task.optimum.pareto),
            pictures=(svg_of(figures.draw_pareto(outcome, task)),),
        ),
    )


def _effects(outcome: "StudyOutcome", task: "TaskOutcome") -> Section:
    powers = {power.name: power for power in task.powers}
    text = [
        "One parameter at a time, the others at the optimum; bars are 95 % intervals within subjects, p after Holm over the "
        "parameters. Partial eta²: share of the variance left after the subjects' own levels. Power: chance that as many subjects "
        "detect these differences.",
        _stopping(outcome, task),
    ]
    if not any(effect.pairs for effect in task.optimum.effects):
        text.insert(1, f"No parameter's p is below {outcome.study.level:g}, so its values are not compared in pairs.")
    title = f"{_name(task)}: what each parameter does"
    rows = [_effect_row(effect, powers.get(effect.name)) for effect in task.optimum.effects]
    return rows_section(title, rows, text=tuple(text), pictures=(svg_of(figures.draw_effects(task)),))


def _effect_row(effect: "ParameterEffect", power: "EffectPower | None") -> dict[str, str]:
    test, values = effect.test, ", ".join(f"{value:.4g}" for value in effect.values)
    if len(effect.dropped):
        values += f" (left out, too few calibrated: {', '.join(f'{value:.4g}' for value in effect.dropped)})"
    named = "ANOVA" if effect.anova is not None else f"mixed model, {effect.missing} missing"
    needed = "none" if power is None or power.subjects is None else str(power.subjects)
    return {
        "parameter": NAMES[effect.name],
        "values tried": values,
        "best to worst (deg)": f"{effect.span_deg:.3f}" if test else "",
        "test": f"none: {effect.untested.detail}" if effect.untested else named,
        "F (degrees of freedom)": f"{test.f:.2f} ({test.dof[0]:.0f}, {test.dof[1]:.0f})" if test else "",
        "p after Holm": p_text(effect.p_holm) if test else "",
        "partial eta²": f"{test.partial_eta_squared:.2f}" if test else "",
        "power": f"{power.power:.2f}" if power else "",
        "subjects for power 0.8": needed if test else "",
    }


def _stopping(outcome: "StudyOutcome", task: "TaskOutcome") -> str:
    level, held = outcome.study.level, task.stopping
    if held is None:
        return (
            "Optional stopping: adding subjects until p falls below the level raises the rate of false findings; it is computed "
            "with more than ten subjects. Fix their number beforehand."
        )
    first, last = held.p_by_subjects[0][0], held.p_by_subjects[-1][0]
    return (
        f"Optional stopping: adding subjects until p falls below {level:g} gives a false finding in {100.0 * held.false_alarm:.0f} "
        f"% of studies in place of {100.0 * level:g} % (looks from {first} to {last} subjects). Here p of "
        f"{NAMES[task.stopping_of]} crossed the level {held.crossings} times. Fix the number of subjects beforehand."
    )


def _pairs(outcome: "StudyOutcome", task: "TaskOutcome") -> Section:
    """Compare the optimum's value with each other value of the parameters that decide."""
    rows, level = [], outcome.study.level
    for effect in task.optimum.effects:
        for pair in effect.pairs:
            if effect.best not in (pair.first, pair.second):
                continue
            other, sign = (pair.first, 1.0) if pair.second == effect.best else (pair.second, -1.0)
            row = {
                "parameter": NAMES[effect.name],
                "optimum": f"{effect.values[effect.best]:.4g}",
                "value": f"{effect.values[other]:.4g}",
                "difference (deg)": f"{sign * pair.difference:.3f}",
                "95 % interval": interval(sorted(sign * end for end in pair.interval)),
                "t": f"{sign * pair.t:.2f}",
                "p after Holm": p_text(pair.p_holm),
                "dz": f"{sign * pair.cohen_dz:.2f}",
                f"differs (p < {level:g})": "yes" if pair.p_holm < level else "no",
            }
            rows.append(row)
    text = (
        "Paired differences of the error, positive where the value is worse than the optimum's. p after Holm over all pairs of a "
        "parameter's values; the other pairs are in summary.json. Cohen's dz: difference over the standard deviation of the "
        "subjects' differences.",
    )
    return rows_section(f"{_name(task)}: which values differ from the optimum's", rows, text=text)


def _tests(outcome: "StudyOutcome") -> Section:
    rows = [
        {"task: parameter": f"{_name(task)}: {NAMES[effect.name]}"} | _test_row(effect)
        for task in outcome.tasks
        for effect in task.optimum.effects
        if effect.test is not None
    ]
    text = (
        "One-way repeated-measures analysis of variance; p uncorrected, with the degrees of freedom of Greenhouse-Geisser (GG), "
        "and of Huynh-Feldt (HF). The p above is HF where epsilon GG exceeds 0.75, else GG. Mauchly's test needs three values or "
        "more. A mixed model has one p and assumes spherical differences.",
    )
    return rows_section("The tests in full", rows, text=text)


def _test_row(effect: "ParameterEffect") -> dict[str, str]:
    found, mixed = effect.anova, effect.mixed
    form = found.sphericity if found else None
    several = form if found and found.conditions > 2 else None
    return {
        "p": p_text(found.p_uncorrected) if found else p_text(mixed.p_value) if mixed else "",
        "p GG": p_text(found.p_greenhouse_geisser) if found else "",
        "p HF": p_text(found.p_huynh_feldt) if found else "",
        "quoted": {"huynh-feldt": "HF", "greenhouse-geisser": "GG"}[found.correction] if found else "mixed model",
        "epsilon GG": f"{form.greenhouse_geisser:.2f}" if form else "",
        "epsilon HF": f"{form.huynh_feldt:.2f}" if form else "",
        "Mauchly's W": f"{several.mauchly_w:.2f}" if several else "",
        "p of Mauchly": p_text(several.p_value) if several else "",
        "generalised eta²": f"{found.generalized_eta_squared:.3f}" if found else "",
        "residual sd (deg)": f"{effect.error_variance**0.5:.4f}",
    }


# ---- Figure 3

SLOPE_OF_THE_NOTE = (
    "The preset's slope over temperature was inferred from the note's own Figure 3: the size of the error without compensation "
    "confirms nothing, only what each compensation leaves of it."
)


def _figure3(found: "Figure3 | None", missing: "Finding | None") -> Section:
    title = "Figure 3: sit-to-stand, simulated and actual device"
    if found is None:
        return Section(title=title, findings=(missing,) if missing else ())
    columns = {
        "max, simulated (deg)": found.simulated_max_deg,
        "max, actual (deg)": found.actual_max_deg,
        "rms, simulated": found.simulated_rms_deg,
        "rms, actual": found.actual_rms_deg,
        "largest difference": found.simulated_actual_max_deg,
    }
    return Section(
        title=title,
        text=(
            f"Board {found.excursion_k:g} K above the bench. Compensation removes {found.decrease_deg:.2f} deg of the actual "
            "device's largest error (the note: more than 3.2). With both tables the two errors differ by at most "
            f"{found.simulated_actual_max_deg[2]:.2f} deg (the note: 0.15).",
            "The actual device is the simulated one with hysteresis, thermometer lag, integral non-linearity of the converter and "
            "g-sensitivity, which the study's model lacks.",
            "A rest before the motion re-zeroes the offset without a chamber and leaves "
            f"{found.actual_max_deg[3]:.2f} deg of the actual device's {found.actual_max_deg[0]:.2f}: scale and dynamic drift, "
            f"which no rest shows. Both tables leave {found.actual_max_deg[2]:.2f} deg, with the rest "
            f"{found.actual_max_deg[4]:.2f} deg. "
            "Recommended: tables, and undrift correct --offset rest.",
        ),
        columns=("compensation", *columns),
        rows=tuple((name, *(f"{v[k]:.2f}" for v in columns.values())) for k, name in enumerate(figures.COMPARED_NAMES)),
        pictures=(svg_of(figures.draw_figure3(found)),),
    )


def _figure3_drawn(outcome: "StudyOutcome") -> Section:
    rows = [
        {"compensation": name}
        | {
            "median (deg)": f"{row.median_deg:.2f}",
            "quartiles (deg)": f"{row.lower_deg:.2f} to {row.upper_deg:.2f}",
        }
        for name, row in zip(figures.COMPARED_NAMES, outcome.figure3_drawn, strict=bool(outcome.figure3_drawn))
    ]
    units = outcome.figure3_drawn[0].units if rows else 0
    text = (
        f"Largest error of {units} units drawn from the kind's spread, actual devices, each calibrated and worn by a person of its "
        f"own. {SLOPE_OF_THE_NOTE}",
    )
    return rows_section("Figure 3: drawn units", rows, text=text)


def _figure3_effects(outcome: "StudyOutcome") -> Section:
    rows = [
        {"effect": plain_words(row.effect)}
        | {
            f"{name} (deg)": f"{v:.2f}"
            for name, v in zip(figures.COMPARED_NAMES, row.simulated_actual_max_deg, strict=True)
        }
        | {"largest error, both tables (deg)": f"{row.full_max_deg:.2f}"}
        for row in outcome.figure3_effects
    ]
    text = (
        "The actual device's effects one at a time: largest difference between the two errors at each level of compensation, and "
        "the largest error with both tables. Noise alone is another recording of the same model.",
    )
    return rows_section("Figure 3: simulated against actual, effect by effect", rows, text=text)


# ---- Rates to dwell at, the note's Discussion as an experiment, real recordings

MANY = 8  # rates; of more the two ends are shown
MOTION_S = 10.0  # for which a rate error is shown as an angle too

# ---- rates to dwell at


def design_sections(rows: "tuple[DesignRow, ...]") -> tuple[Section, ...]:
    """Return the section on rates to dwell at."""
    if not rows:
        return ()
    highest = max(row.degree for row in rows)
    cells: Cells[DesignRow] = (
        ("task", lambda row: plain_words(row.task)),
        ("curve", lambda row: _curve(row.degree)),
        ("set", lambda row: f"{row.grid} grid" if row.criterion == "uniform" else f"{row.criterion}-optimal"),
        ("time at rates of an axis (deg/s)", _rates),
        ("grid's D-efficiency", lambda row: "" if row.criterion == "uniform" else f"{row.d_efficiency_uniform:.2f}"),
        ("grid's I-efficiency", lambda row: "" if row.criterion == "uniform" else f"{row.i_efficiency_uniform:.2f}"),
        ("dwells", lambda row: f"{row.dwells}"),
        ("each (s)", lambda row: "–" if row.dwell_s is None else f"{row.dwell_s:g}"),
        ("rate error (deg/s)", lambda row: "–" if row.error_dps is None else f"{row.error_dps:.2g}"),
    )
    text = (
        "All sets have the grid's dwelling time and greatest rate. D: least uncertainty of the coefficients together. I: least "
        "error of the rate over the task, whose rates are those of the cohort about the axis of the pitch.",
        "Efficiency: the grid's information over the set's; 0.5 needs twice the time. The error comes from the white noise of the "
        "dwells alone; drift of the offset adds to it, whatever the rates.",
        *(_meaning(row, rows) for row in rows if row.degree == highest and row.criterion == "I"),
    )
    title = "Rates to dwell at: D- and I-optimal sets against the uniform grid"
    return (table_section(title, rows, cells, text=text),)


def _meaning(best: "DesignRow", rows: "tuple[DesignRow, ...]") -> str:
    own = (best.task, best.degree, "uniform")
    even = next(row for row in rows if (row.task, row.degree, row.criterion) == own)
    text = (
        f"{plain_words(best.task)}, {_curve(best.degree)}: the I-optimal set reaches the error of {best.grid} grid in "
        f"{100.0 * best.i_efficiency_uniform:.0f} % of its dwelling time"
    )
    if best.error_dps is not None and even.error_dps is not None:
        angle_deg = MOTION_S * abs(even.error_dps - best.error_dps)
        text += f" (or {best.error_dps:.2g} in place of {even.error_dps:.2g} deg/s in the same: at most {angle_deg:.1g} deg "
        text += f"in {MOTION_S:g} s of motion)"
    beyond = "" if best.beyond == 0.0 else f" {100.0 * best.beyond:.2g} % of the task's rates are above the grid's."
    return f"{text}.{beyond}"


def _rates(row: "DesignRow") -> str:
    if len(row.share) > MANY:
        return f"{len(row.share)} rates from {row.turn_rate_dps[0]:.3g} to {row.turn_rate_dps[-1]:.3g}, equal shares"
    pairs = zip(row.turn_rate_dps, row.share, strict=True)
    return ", ".join(f"{100.0 * share:.0f} % at {rate:.3g}" for rate, share in pairs)


def _curve(degree: int) -> str:
    return {1: "line", 3: "cubic"}.get(degree, f"degree {degree}")


# ---- other ways to calibrate


def rival_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the sections on other ways to calibrate."""
    title = "The note's Discussion as an experiment: other ways to calibrate"
    if not outcome.rivals:
        missing = outcome.rivals_missing
        return (Section(title=title, findings=(missing,) if missing else ()),)
    first = outcome.rivals[0]
    kind = "the note's kind, in place of the one device," if outcome.study.worn else outcome.study.device
    cells: Cells[RivalRow] = (
        ("task", lambda row: plain_words(row.task)),
        ("method", lambda row: plain_words(row.method)),
        ("calibrates", lambda row: ", ".join(row.observable) or "nothing"),
        ("min", lambda row: f"{row.minutes:.1f}"),
        ("rms (deg)", lambda row: _spread(row.error_rms_deg)),
        ("max (deg)", lambda row: _spread(row.error_max_deg)),
        ("max of the change (deg)", lambda row: _spread(row.change_max_deg)),
        ("refused", lambda row: f"{row.refused} of {row.units}"),
    )
    text = (
        f"{first.units} units of {kind} calibrated by each method in about the time of the note's rate table, then worn in the "
        "same tasks at the temperature of the calibration: median [least to greatest] of the pitch error over the units.",
        "The change of pitch since the motion began excludes the tilt at the start, which the accelerometers give. Where a "
        "method cannot calibrate a triad, the data sheet is used. Refused units, whose gravity at rest is too far from the local "
        "value, have no figure.",
    )
    limits: Cells[RivalRow] = (
        ("method", lambda row: plain_words(row.method)),
        ("findings of its fit, first unit", lambda row: "; ".join(row.notes)),
    )
    noted = [row for row in outcome.rivals if row.task == first.task and row.notes]
    return (
        table_section(title, outcome.rivals, cells, text=text),
        table_section("What each method cannot observe", noted, limits, words=True),
    )


def _spread(spread: "Spread") -> str:
    if spread.median != spread.median:
        return "no unit"
    return f"{spread.median:.3f} [{spread.least:.3f} to {spread.greatest:.3f}]"


# ---- real recordings


def real_sections(real: "RealOutcome | None") -> tuple[Section, ...]:
    """Return the sections on real recordings."""
    if real is None:
        return ()
    sections = (
        _trials(real.errors),
        _compared("Real recordings: captured people and the cohort", real.motions),
        Section(title="") if real.worn is None else _worn(real.worn),
        _compared("Real recordings: stance on a force plate and the cohort's sway", real.sways),
        Section(title="Real recordings: what is not there", findings=real.lacks),
    )
    return tuple(section for section in sections if section.text or section.findings)


def _trials(levels: "tuple[RealErrors, ...]") -> Section:
    if not levels:
        return Section(title="")
    heads = {
        "rmse_total_deg": "total rms (deg)",
        "rmse_inclination_deg": "inclination rms",
        "max_abs_pitch_deg": "largest pitch error",
        "end_total_deg": "total at the end",
    }
    named = [(trial.recording, level, trial.figures) for level in levels for trial in level.trials]
    rows = tuple(
        (name, level.level, level.rounding, *(number(getattr(figures, key)) for key in heads))
        for name, level, figures in (*named, *(("median", level, level.median) for level in levels))
    )
    rounding = (
        "Converters that truncate leave half a step as an offset. Rounding undone: the half step is corrected at all three "
        "levels; left in: at none. Compare levels with the same treatment alone."
    )
    if levels[0].rounding == "none found":
        rounding = "The codes of no recording show how the converter rounds: no correction."
    return Section(
        title="Real recordings: devices worn beside optics",
        text=(
            "none: no offset removed; rest: less the mean rate of the first rest; calibrated: a gyroscope fit to the other trials "
            "of the same device, without the one that is judged.",
            rounding,
            *(
                _agreement(f"{each.level}, rounding {each.rounding}", each.agreement)
                for each in levels
                if each.agreement
            ),
        ),
        columns=("recording", "level", "converter's rounding", *heads.values()),
        rows=rows,
    )


def _agreement(level: str, held: "Pairwise") -> str:
    limits, icc = held.limits, held.icc
    return (
        f"{level}: {held.quantity}: bias {limits.bias:.2f}, limits of agreement {limits.limits[0]:.2f} to "
        f"{limits.limits[1]:.2f} ({limits.count} trials); ICC(2,1) {icc.value:.4f} [{icc.interval[0]:.4f}, "
        f"{icc.interval[1]:.4f}]."
    )


def _compared(title: str, rows: "tuple[CohortComparison, ...]") -> Section:
    cells: Cells[CohortComparison] = (
        ("trial", lambda row: row.trial),
        ("task", lambda row: plain_words(row.task)),
        ("measure", lambda row: f"{row.measure} ({row.unit})"),
        ("real", lambda row: number(row.real)),
        ("cohort's median", lambda row: f"{row.median:.2f}"),
        ("cohort's 95 %", lambda row: f"{row.low:.2f} to {row.high:.2f}"),
        ("inside", lambda row: "" if row.real != row.real else "yes" if row.inside else "no"),
    )
    notes = dict.fromkeys(f"{row.trial}: {row.note}." for row in rows if row.note)
    text = ("Other people than the cohort: nothing is paired, a figure is within the cohort's 95 % or not.", *notes)
    return table_section(title, rows, cells, text=text if rows else ())


def _worn(worn: "Worn") -> Section:
    cells: Cells[WornRow] = (
        ("trial", lambda row: row.trial),
        ("compensation", lambda row: row.level),
        ("rms (deg)", lambda row: f"{row.error_rms_deg:.2f}"),
        ("max (deg)", lambda row: f"{row.error_max_deg:.2f}"),
        ("lean, optics (deg)", lambda row: f"{row.lean_optics_deg:.1f}"),
        ("lean, device (deg)", lambda row: f"{row.lean_device_deg:.1f}"),
        ("length (s)", lambda row: f"{row.length_s:.1f}"),
        ("saturated (%)", lambda row: f"{100.0 * row.saturated:.1f}"),
    )
    text = (
        "Pitch of the simulated device against the optics: without compensation, static alone, static and dynamic.",
        *(_agreement(level, held) for level, held in worn.agreement),
    )
    return table_section(
        "Real recordings: the simulated device worn in the captured motions", worn.rows, cells, text=text
    )
