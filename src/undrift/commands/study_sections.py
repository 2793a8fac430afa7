"""What a study shows: the protocol to use, what speaks for it, Table 1 beside the note's, error surface, statistics, Figure 3.

``answer_of`` is the sentence, ``sections_of`` everything under it. All but the answer, the findings, the note's tables and real
recordings is folded. Rows are those of study/outcome.py; pictures are drawn by report/figures.py.
"""

from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING

from undrift.base.codec import tree_of
from undrift.base.summary import (
    Cells,
    Section,
    figure_of,
    interval,
    plain_words,
    rows_section,
    table_section,
    with_interval,
)
from undrift.commands.study_figures import figure3_effects, figure3_section, note_flows, real_sections, task_words
from undrift.rig.programme import ProgrammeSettings
from undrift.sim.motion.tasks import CATEGORIES
from undrift.study.claims import claims_section, rival_sections
from undrift.study.judge import needed_text
from undrift.study.space import HEADINGS, OF_NOTE

if TYPE_CHECKING:
    from undrift.study.judge import NoteValue, ParameterEffect
    from undrift.study.outcome import EffectPower, StudyOutcome, TaskOutcome
    from undrift.study.plan import Objective, Timing
    from undrift.study.run import TaskSurface
    from undrift.study.search import DesignRow, Halving, Round
    from undrift.study.statistics import Decision

NOTE = (
    'The note, here and below: D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with '
    'rate-gyroscopes and accelerometers", EMBC 2007.'
)
LEAST_P = 1e-4
ASSUMED = ("level_1", "level_3", "level_4")  # categories of which the note has no number
OBJECTIVES: "dict[Objective, str]" = {
    "rms": "the root-mean-square error",
    "maximum": "the largest error",
    "end": "the error over the last half second",
}
TIMINGS: "dict[Timing, str]" = {
    "real time": "in real time (against the pitch of the same instant)",
    "offline": "offline (with the delay that is found from the readings taken out)",
}


def answer_of(outcome: "StudyOutcome") -> str:
    """Return the protocol of each task in a sentence."""
    study, text = outcome.study, "; ".join(map(_answer_of, outcome.tasks))
    if study.target_deg is not None:
        return f"For {study.target_deg:g} deg, with {100.0 * study.confidence:g} % confidence on other people and devices: {text}."
    return f"{text[:1].upper()}{text[1:]}."


def _answer_of(task: "TaskOutcome") -> str:
    surface, place, tested, target = task.surface, *task.to_use, task.target
    minutes = f"{surface.rig_minutes[place]:.0f} min on the table"
    if target is None:
        best = "the best that were tried" if task.optimum.edges else "enough"
        head = f"{_name(task)}: {surface.cutoff_hz[place]:.4g} Hz and rates of {_rates_of(surface, place)} deg/s"
        return f"{head} are {best}, {tested.error_rms_deg:.2f} deg rms after {minutes}"
    lower, upper = tested.limits_deg
    if target.verdict == "not reached":
        return f"{_name(task)}: nothing that was tried, the best is above {lower:.2g} deg"
    words = {"enough": "are enough", "at the edge": "do, at the edge of what was tried"}
    return f"{_name(task)}: {minutes} {words.get(target.verdict, 'are not shown to do')}, below {upper:.2g} deg"


def sections_of(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the sections of a study: the answer, the note's tables beside it, everything else folded."""
    study = outcome.study
    offset = study.offset + " (of trials of 20 s or more)" * (study.offset == "motion")
    text = (
        f"{outcome.runs} calibration sessions simulated, fitted and judged: {study.subjects} subjects, device {study.device}, "
        f"seed {study.seed}, offset from {offset}; {OBJECTIVES[study.objective]} of the sagittal pitch is minimised, "
        f"{TIMINGS[study.timing]}."
    )
    # what concerns the note stands beside its table
    apart = {_name(t): [f for f in t.findings if t.note is None or f not in t.note.findings] for t in outcome.tasks}
    return (
        _answer(outcome),
        *(Section(title=f"{name}: findings", findings=tuple(found)) for name, found in apart.items()),
        _table_1(outcome),
        _note(outcome),
        *(
            Section(title=f"{plain_words(each.task)}: categories", findings=(each.finding,))
            for each in outcome.categories
        ),
        figure3_section(outcome),
        *real_sections(outcome.real),
        *(replace(section, folded=True) for section in _details(outcome)),
        Section(title="How the study was made", text=(text, *_people(outcome)), folded=True),
    )


def _people(outcome: "StudyOutcome") -> tuple[str, ...]:
    """Say whose motions they are, where that is not as in the note, and in which poses accelerometers were read."""
    study, motions = outcome.study, [task.motion for task in outcome.study.tasks if task.motion is not None]
    sets = {task.poses: None for task in study.tasks if "poses" in task.space.names}
    levels = [held.label for name, held in CATEGORIES.items() if name in study.categories and name in ASSUMED]
    return (
        *(f"{label}: the note gives no more than its meaning. Ages and heights: its Table 2; all other numbers are assumed, each "
          "with its reason in sim/motion/categories.toml." for label in levels),
        *(f"{kind.label}: numbers of the plan; bounds 2.5 standard deviations from the mean where none are stated."
          for name, kind in study.lab if name in study.categories),
        *(f"{one.people} recorded people, {sum(len(one.of(k)) for k in range(one.people))} recordings: one person's are averaged."
          for one in motions if one.others),
        *(f"Poses of the accelerometers, {k}: {', '.join(poses)}." for each in sets for k, poses in enumerate(each, 1)),
        *(f"Set-points, {k}: {', '.join(f'{c:g}' for c in listed) or 'room temperature'}{' degC' * bool(listed)}."
          for each in {task.places: None for task in study.tasks} for k, listed in enumerate(each, 1)),
    )  # fmt: skip


def _details(outcome: "StudyOutcome") -> tuple[Section, ...]:
    return (
        *(_rounds(outcome, task, task.halving) for task in outcome.tasks if task.halving is not None),
        *_categories(outcome),
        claims_section(outcome),
        _note_values(outcome),
        _note_analysis(outcome),
        _other_cohort(outcome),
        _cohorts(outcome),
        _bench(outcome),
        *(section for task in outcome.tasks for section in _task_sections(outcome, task)),
        _tests(outcome),
        *note_flows(),
        figure3_effects(outcome),
        *design_sections(outcome.designs),
        *rival_sections(outcome),
    )


def _p(p: float) -> str:
    """Return a p value for people; one below ``LEAST_P`` as a bound."""
    return f"{p:.2g}" if p >= LEAST_P else f"< {LEAST_P:.4f}"


def _name(task: "TaskOutcome") -> str:
    return task_words(task.surface.task)


def _rates_of(surface: "TaskSurface", place: int) -> str:
    """Return the rates of a protocol in words."""
    step, low, high = (f"{getattr(surface, name)[place]:.4g}" for name in list(OF_NOTE)[1:])
    return f"{low} to {high} by {step}"


def _further(surface: "TaskSurface", place: int) -> str:
    """Return what a protocol has of the further parameters other than the plan's first, to be set behind a name."""
    other = [n for n, values in surface.further.items() if values[place] != values[0] or n == "set_points"]
    words = ", ".join(f"{HEADINGS[name]} {surface.further[name][place]:.4g}" for name in other)
    return f" ({words})" if words else ""


def _protocol(surface: "TaskSurface", place: int) -> tuple[str, ...]:
    """Return the four parameters, the errors in both timings and the session of a protocol."""
    means = [[f"{surface.error(name, timing)[:, place].mean():.3f}" for name in OBJECTIVES] for timing in TIMINGS]
    errors = map(", ".join, means)
    return (*(f"{getattr(surface, name)[place]:.4g}" for name in OF_NOTE), *errors, f"{surface.rig_minutes[place]:.1f}")


_PROTOCOL = (*OF_NOTE.values(), *(f"{timing}: rms, largest, end (deg)" for timing in TIMINGS), "session (min)")


# ---- answer


def _answer(outcome: "StudyOutcome") -> Section:
    study = outcome.study
    cells: Cells[TaskOutcome] = (
        ("task", _name),
        ("low-pass (Hz)", lambda task: f"{task.surface.cutoff_hz[task.to_use[0]]:.4g}"),
        ("rates of the table (deg/s)", lambda task: _rates_of(task.surface, task.to_use[0])),
        ("session (min)", lambda task: f"{task.surface.rig_minutes[task.to_use[0]]:.0f}"),
        ("pitch error, rms (deg)", lambda task: f"{task.to_use[1].error_rms_deg:.3f}"),
        ("95 % interval", lambda task: interval(task.to_use[1].interval_rms_deg)),
        ("largest error (deg)", lambda task: f"{task.to_use[1].error_max_deg:.3f}"),
    )
    if study.target_deg is None:
        how = f"Of all protocols equivalent to the best within {study.margin_deg:g} deg, the one with the shortest session."
    else:
        cells = (
            *cells,
            (f"for {study.target_deg:g} deg", lambda task: "" if task.target is None else task.target.verdict),
            ("upper limit (deg)", lambda task: f"{task.to_use[1].limits_deg[1]:.3f}"),
            ("needs", lambda task: "" if task.target is None else task.target.needs_text),
        )
        how = (
            f"The cheapest session whose mean error is below {study.target_deg:g} deg with {100.0 * study.confidence:g} % "
            "confidence; where none is, the best. Cheapest: the shortest to the minute, then of the least price, then what "
            "asks least of a laboratory; where an hour has a price, of the least price first."
        )
    recorded = any(task.motion is not None for task in study.tasks)
    who = "devices (of the people or motion that was recorded)" if recorded else "subjects and devices"
    text = (
        f"{how} Errors are means over {who} that had no part in the choice. Each rate is turned both ways.",
        f"Minutes of a soak: the chamber changes by {ProgrammeSettings().heating_c_per_min:g} K/min, the board follows with a time "
        f"constant of {study.bench.board_lag_s:g} s (board_lag_s), and the temperature must hold still.",
        *(f"{_name(task)}{words}." for task in outcome.tasks if (words := _further(task.surface, task.to_use[0]))),
        "Below, omega_m and omega_M are the least and greatest rate of the table, d is the step between rates.",
    )
    return table_section("Answer: the protocol to use", outcome.tasks, cells, text=text)


def _rounds(outcome: "StudyOutcome", task: "TaskOutcome", halving: "Halving") -> Section:
    def best(each: "Round") -> str:
        place = each.candidates[each.mean_deg.argmin()]
        return f"{halving.every.cutoff_hz[place]:.4g} Hz, {_rates_of(halving.every, place)} deg/s{_further(halving.every, place)}"

    cells: Cells[Round] = (
        ("protocols", lambda each: str(len(each.candidates))),
        ("subjects", lambda each: str(each.subjects)),
        ("best so far", best),
        ("its mean error (deg)", lambda each: f"{each.mean_deg.min():.3f}"),
        ("largest mean error (deg)", lambda each: f"{each.mean_deg.max():.3f}"),
    )
    how = "Each round keeps the better half of the protocols and doubles the subjects."
    tried, every = len(halving.points), halving.runs_of_grid // outcome.study.subjects
    if halving.generations:
        met = halving.rounds[0].subjects
        how = f"The first {halving.generations} rounds are generations of CMA-ES, each on the next {met} subjects. "
        how += "The best are halved: each round keeps the better half of the protocols and doubles the subjects."
    elif tried < every:
        how = f"{tried} of {every} protocols were drawn by a Latin hypercube. {how}"
    text = (
        f"{halving.runs} runs; the full grid has {halving.runs_of_grid}. {how} All tables below but the front compare the "
        "protocols of the last round.",
    )
    title = f"{_name(task)}: {'CMA-ES, then halving' if halving.generations else 'successive halving'}"
    return table_section(title, halving.rounds, cells, text=text)


# ---- tables 1 and 2, the other cohort


def _table_1(outcome: "StudyOutcome") -> Section:
    rows, text = [], []
    for task in outcome.tasks:
        found, note = task.optimum, task.note
        text.append(
            f"{_name(task)}: of {len(task.surface.cutoff_hz)} protocols {found.equivalent.sum()} are equivalent to the optimum "
            f"within {found.margin_deg:g} deg, {found.worse.sum()} are worse, {found.undecided.sum()} not decidable. Error of the "
            f"optimum by subjects that did not choose it, deg: {with_interval(found.honest_error_deg, found.honest_interval_deg)}."
        )
        further = _further(task.surface, found.best)
        rows.append((f"{_name(task)}: optimum{further}", *_protocol(task.surface, found.best), _p(found.p_value)))
        if found.cheapest != found.best:
            further = _further(task.surface, found.cheapest)
            rows.append((f"… shortest equivalent{further}", *_protocol(task.surface, found.cheapest), ""))
        if note is not None:
            four = (f"{getattr(note.row, name):.4g}" for name in OF_NOTE)
            rest = ("", "", "") if note.place is None else _protocol(task.surface, note.place)[4:]
            mark = " *" if note.row.erratum else ""
            rows.append((f"… the note{mark}", *four, *rest, f"{note.row.p_value:.3f}, its own"))
    text.append("p is the least of the four parameters', after Holm, the others at the optimum.")
    of_note = [task.note for task in outcome.tasks if task.note]
    text += ["In the note's rows it is as printed; the note does not define its test."] * bool(of_note)
    text += sorted({f"* {note.row.erratum}" for note in of_note if note.row.erratum})
    heads = ("task", *_PROTOCOL, "p")
    return Section(title="Table 1: optimised parameters", text=tuple(text), columns=heads, rows=tuple(rows))


def _categories(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return, for each task, the optimum of every category worn by the others."""
    sections = []
    for each in outcome.categories:
        rows = [
            {"subjects": cell.labels[1], "optimum of": cell.labels[0], "error (deg)": f"{cell.error_deg:.3f}"}
            | {"with their own (deg)": f"{cell.own_deg:.3f}"}
            | _decision_cells(cell.decision)
            for cell in each.crossed
            if cell.decision is not None
        ]
        text = (
            "The other cohort of each category with the optimum that another category chose. Better: their own optimum is, by more "
            f"than {each.margin_deg:g} deg. {DECISIONS}",
        )
        title = f"{plain_words(each.task)}: the optimum of each category, worn by the others"
        sections.append(rows_section(title, rows, text=text))
    return tuple(sections)


def _note(outcome: "StudyOutcome") -> Section:
    held = [(_name(task), task.note) for task in outcome.tasks if task.note]
    rows = []
    for name, note in held:
        reasons = [each.finding.text for each in note.values if each.verdict not in ("confirmed", "indifferent")]
        rows.append((name, note.verdict, ". ".join((note.finding.text, *reasons))))
    text = (
        "A value is confirmed where it is better than a next one that was tried by more than the margin, and not worse than the "
        "other; indifferent where it is equivalent to both within it, so that any does. A row is where its values are and its "
        f"protocol is equivalent to the optimum. Margin: {outcome.study.margin_deg:g} deg.",
    )
    title = "Against the note's Table 1"
    return Section(title=title, text=text, columns=("task", "the note", "because"), rows=tuple(rows), words=True)


def _note_values(outcome: "StudyOutcome") -> Section:
    rows = [
        {"value": f"{_name(task)}: {HEADINGS[value.name]} {value.value:.4g}", "the note": value.verdict}
        | {"against": _beside(task, value, found)}
        | _decision_cells(found)
        for task in outcome.tasks
        for value in (task.note.values if task.note else ())
        for found in (value.lower, value.upper)
        if found is not None
    ]
    text = (
        "Each value of the note against the next lower and higher that was tried, in the protocol that is nearest to the note's in "
        "the other three. " + DECISIONS,
    )
    values = (value for task in outcome.tasks for value in (task.note.values if task.note else ()))
    agreeing = tuple(value.finding for value in values if value.verdict in ("confirmed", "indifferent"))
    return rows_section("The note's values beside the next ones", rows, text=text, findings=agreeing)


def _beside(task: "TaskOutcome", value: "NoteValue", found: "Decision") -> str:
    """Return the next value, and what else its protocol has other than the note's."""
    surface, place = task.surface, None if task.note is None else task.note.place
    text = f"{getattr(surface, value.name)[found.other]:.4g}"
    for name in surface.names:
        other = float(surface.column(name)[found.other])
        if name != value.name and place is not None and abs(other / surface.column(name)[place] - 1.0) > 1e-6:
            text += f", {HEADINGS[name]} {other:.4g}"
    return text


DECISIONS = (
    "Difference: mean error with the other value less that with this one, positive where this one is better, with its 95 % "
    "interval. dz: difference over the standard deviation of the subjects' differences. p of better: of a difference within the "
    "margin. p of equivalent: of one of the margin or more. Both after Bonferroni."
)


def _decision_cells(found: "Decision") -> dict[str, str]:
    return {
        "difference (deg)": f"{found.difference:.3f}",
        "95 % interval": interval(found.interval),
        "dz": with_interval(found.cohen_dz, found.dz_interval, ".2f") if found.sd > 0.0 else "–",
        "p of better": _p(found.p_better),
        "p of equivalent": _p(found.p_equivalent),
        "verdict": found.verdict,
        "subjects for power 0.8": needed_text(found.subjects_needed),
    }


def _note_analysis(outcome: "StudyOutcome") -> Section:
    rows = []
    for task in outcome.tasks:
        one, repeated, note = task.one_way, task.repeated, task.note
        if one is None or repeated is None:
            continue
        rows.append(
            {
                "task": _name(task),
                "the note's p": f"{note.row.p_value:.3f}" if note else "",
                "one-way F (degrees of freedom)": f"{one.f:.2f} ({one.dof[0]:.0f}, {one.dof[1]:.0f})",
                "its p": _p(one.p_value),
                "eta² [95 %]": with_interval(one.eta_squared, one.eta_squared_interval),
                "repeated measures F": f"{repeated.f:.2f} (epsilon {repeated.sphericity.greenhouse_geisser:.3f})",
                "p, corrected": _p(repeated.p_value),
                "partial eta² [95 %]": with_interval(
                    repeated.partial_eta_squared, repeated.partial_eta_squared_interval
                ),
                "least p of a parameter, after Holm": _p(task.optimum.p_value),
            }
        )
    text = (
        'The note analysed "by ANOVA", task by task, and does not describe it. One-way: all protocols of a task as if other '
        "subjects had met each. Repeated measures: every subject met every protocol, so that differences between subjects are no "
        "error; p with the correction for sphericity. Neither shows that protocols are equivalent: that is what the margin is for.",
    )
    return rows_section("The note's analysis of variance beside a stricter one", rows, text=text)


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
        for name, tested in zip(("optimum", "shortest equivalent"), task.tested, strict=True)
    ]
    text = ("Other subjects, other units of the device, other temperatures and noise: means over the subjects.",)
    return rows_section("On the other cohort", rows, text=text)


def _cohorts(outcome: "StudyOutcome") -> Section:
    def span(ends: tuple[float, float, float], factor: float = 1.0, form: str = ".1f") -> str:
        low, mean, high = (factor * end for end in ends)
        return f"{low:.0f} to {high:.0f}, mean {mean:{form}}"

    rows = [
        {
            "group": f"{cohort.group} ({did}), {cohort.label}",
            "subjects": str(cohort.count),
            "age (years)": span(cohort.age_years),
            "the note's ages": span(cohort.printed.age_years, form=".0f"),
            "height (cm)": span(cohort.height, 100.0),
            "the note's heights": span(cohort.printed.height, 100.0, form=".0f"),
        }
        for cohort, did in zip(outcome.cohorts, cycle(("chose", "tested")), strict=False)
    ]
    text = "Least to greatest, and mean. The note's subjects are at Tinetti level 2; cohorts of 30 are drawn to its figures."
    return rows_section("Table 2: cohorts", rows, text=(text,))


def _bench(outcome: "StudyOutcome") -> Section:
    held = tree_of(outcome.study.bench) | {"chain_percent": 100.0 * outcome.study.chain_sd}
    held |= tree_of(outcome.study.trial) if outcome.study.trial.on else {}
    rows = [{"key of study.toml": key, "value": f"{value:g}"} for key, value in held.items()]
    text = (
        "Standard deviations, but for encoder_lines (lines), board_lag_s (s) and what wearing does to the sensor (tissue, impact, "
        "vibration). Every protocol of a subject has the same draws.",
    )
    return rows_section("Errors of bench and parts", rows, text=text)


# ---- one task


def _task_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    name, own = _name(task), outcome.study.timing
    timings = (own, *(timing for timing in TIMINGS if timing != own))
    surfaces = tuple(figure_of("figures:draw_surface", outcome, task, each, HEADINGS) for each in timings)
    white = "not tried" if task.halving is None else "not tried, dropped in an earlier round"
    return (
        Section(
            title=f"{name}: error surface",
            text=(
                f"Mean error over the subjects. Each cell is the best of the protocols that share it; white: {white}, or a "
                "device could not be calibrated. Star: optimum; ring: the note's protocol. The colours span a factor of two at "
                f"least, so that small differences look small. Above {timings[0]}, below {timings[1]}.",
            ),
            pictures=surfaces,
        ),
        _effects(outcome, task),
        _decisions(task),
        _made_of(task),
        _front(outcome, task),
    )


def _front(outcome: "StudyOutcome", task: "TaskOutcome") -> Section:
    """Return the front of error against minutes."""
    front, surface, text = task.front, task.front.surface, "One point a protocol"
    if task.halving is not None:
        text += " of the last round; the front comes from all that were tried, and what seemed to be on it met every subject too"
    error = f"mean {outcome.study.objective} error, {outcome.study.timing} (deg)"
    heads = (*(HEADINGS[name] for name in surface.names), error, "95 % interval", "session (min)")
    rows = [
        (
            *(f"{surface.column(name)[place]:.4g}" for name in surface.names),
            f"{front.mean_deg[k]:.3f}",
            interval((front.interval_deg[k, 0], front.interval_deg[k, 1])),
            f"{surface.rig_minutes[place]:.1f}",
        )
        for k, place in enumerate(front.places.tolist())
    ]
    text += ". The table has the protocols that no other beats in both error and time, means over all subjects."
    title, drawing = f"{_name(task)}: error against minutes on the rig", figure_of("figures:draw_pareto", outcome, task)
    return Section(title=title, text=(text,), columns=heads, rows=tuple(rows), pictures=(drawing,))


def _effects(outcome: "StudyOutcome", task: "TaskOutcome") -> Section:
    powers = {power.name: power for power in task.powers}
    text = [
        "One parameter at a time, the others at the optimum; bars are 95 % intervals within subjects, p after Holm over the "
        "parameters. Partial eta²: share of the variance left after the subjects' own levels. Power: chance that as many subjects "
        "detect these differences.",
        f"Better: the optimum's value is better than another by more than {outcome.study.margin_deg:g} deg. Equivalent: all values "
        "are within it. Not decidable: neither is shown; the last column has the subjects that would do, were these means true.",
        _stopping(outcome, task),
    ]
    title = f"{_name(task)}: what each parameter does"
    rows = [_effect_row(effect, powers.get(effect.name)) for effect in task.optimum.effects]
    return rows_section(title, rows, text=tuple(text), pictures=(figure_of("figures:draw_effects", task, HEADINGS),))


def _effect_row(effect: "ParameterEffect", power: "EffectPower | None") -> dict[str, str]:
    judged, test, values = effect.judged, effect.test, ", ".join(f"{value:.4g}" for value in effect.values)
    if len(effect.dropped):
        values += f" (left out, too few calibrated: {', '.join(f'{value:.4g}' for value in effect.dropped)})"
    named = "ANOVA" if effect.anova is not None else f"mixed model, {effect.missing} missing"
    needed = "none" if power is None or power.subjects is None else str(power.subjects)
    share = with_interval(test.partial_eta_squared, test.partial_eta_squared_interval, ".2f") if test else ""
    return {
        "parameter": HEADINGS[effect.name],
        "values tried": values,
        "best to worst (deg)": f"{effect.span_deg:.3f}" if test else "",
        "test": f"none: {effect.untested.detail}" if effect.untested else named,
        "F (degrees of freedom)": f"{test.f:.2f} ({test.dof[0]:.0f}, {test.dof[1]:.0f})" if test else "",
        "p after Holm": _p(effect.p_holm) if test else "",
        "partial eta² [95 %]": share,
        "power": f"{power.power:.2f}" if power else "",
        "subjects for power 0.8": needed if test else "",
        "verdict": judged.verdict if judged else "",
        "p of better": _p(judged.p_better) if judged else "",
        "p of equivalent": _p(judged.p_equivalent) if judged else "",
        "subjects for a verdict": needed_text(judged.subjects_needed) if judged else "",
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
        f"{HEADINGS[task.stopping_of]} crossed the level {held.crossings} times. Fix the number of subjects beforehand."
    )


def _decisions(task: "TaskOutcome") -> Section:
    """Compare the optimum's value of each parameter with its others."""
    rows = [
        {"parameter": HEADINGS[effect.name], "optimum": f"{effect.values[effect.best]:.4g}"}
        | {"value": f"{effect.values[found.other]:.4g}"}
        | _decision_cells(found)
        for effect in task.optimum.effects
        if effect.judged is not None
        for found in effect.judged.decisions
    ]
    text = (f"{DECISIONS} Differences of all pairs of values, with p after Holm, are in summary.json.",)
    return rows_section(f"{_name(task)}: the optimum's values against the others", rows, text=text)


def _made_of(task: "TaskOutcome") -> Section:
    """Say what the error of the optimum is made of, and how much each parameter is worth without each effect."""
    if not task.splits:
        return Section(title="")
    splits, first = task.splits, task.splits[0]
    worth = {HEADINGS[split.parameter]: {term.effect: term for term in split.terms} for split in splits}
    verdicts = {HEADINGS[split.parameter]: split.judged.verdict for split in splits}
    alone = f"{first.rms_deg:.3f} in all"
    rows = [{"switched off": "nothing", "share of the mean square": "", "alone (deg)": alone} | verdicts]
    rows += [
        {
            "switched off": term.effect,
            "share of the mean square": "{:.1f} % [{:.1f} to {:.1f}]".format(
                *(100.0 * share for share in (term.share, *term.share_interval))
            ),
            "alone (deg)": f"{term.rms_deg:.3f}",
        }
        | {
            name: f"{terms[term.effect].span_deg:.3f}, {terms[term.effect].judged.verdict}"
            for name, terms in worth.items()
        }
        for term in first.terms
    ]
    text = (
        "The optimum with one effect switched off in the simulated devices and benches, the draws of all others kept. Share: what "
        "the mean square loses, with its 95 % interval; below 0 where the error grows, as effects that cancel each other do. "
        f"Several effects together, or none of these: {100.0 * first.together:.1f} %.",
        "For each parameter: mean error from best to worst of its values without that effect, and the verdict then. An effect "
        "without which a parameter is better hides it. Of more than five values the optimum's, its neighbours and both ends are "
        "run.",
    )
    return rows_section(f"{_name(task)}: what the error is made of", rows, text=text)


def _tests(outcome: "StudyOutcome") -> Section:
    rows = [
        {"task: parameter": f"{_name(task)}: {HEADINGS[effect.name]}"} | _test_row(effect)
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
        "p": _p(found.p_uncorrected) if found else _p(mixed.p_value) if mixed else "",
        "p GG": _p(found.p_greenhouse_geisser) if found else "",
        "p HF": _p(found.p_huynh_feldt) if found else "",
        "quoted": {"huynh-feldt": "HF", "greenhouse-geisser": "GG"}[found.correction] if found else "mixed model",
        "epsilon GG": f"{form.greenhouse_geisser:.2f}" if form else "",
        "epsilon HF": f"{form.huynh_feldt:.2f}" if form else "",
        "Mauchly's W": f"{several.mauchly_w:.2f}" if several else "",
        "p of Mauchly": _p(several.p_value) if several else "",
        "generalised eta²": f"{found.generalized_eta_squared:.3f}" if found else "",
        "residual sd (deg)": f"{effect.error_variance**0.5:.4f}",
    }


# ---- rates to dwell at

MANY = 8  # rates; of more the two ends are shown
MOTION_S = 10.0  # for which a rate error is shown as an angle too


def design_sections(rows: "tuple[DesignRow, ...]") -> tuple[Section, ...]:
    """Return the section on rates to dwell at."""
    if not rows:
        return ()
    highest = max(row.degree for row in rows)
    cells: Cells[DesignRow] = (
        ("task", lambda row: task_words(row.task)),
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
        f"{task_words(best.task)}, {_curve(best.degree)}: the I-optimal set reaches the error of {best.grid} grid in "
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
