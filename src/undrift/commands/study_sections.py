"""What a study shows: the protocol to use, what speaks for it, Table 1 beside the note's, error surface, statistics, Figure 3.

``answer_of`` is the sentence, ``sections_of`` everything under it. All but the answer, the findings and the note's tables is
folded. Rows are those of study/outcome.py; pictures are drawn by report/figures.py.
"""

from dataclasses import replace
from itertools import cycle
from math import isfinite
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
from undrift.commands.study_figures import figure3_section, note_flows, task_words
from undrift.programme import ProgrammeSettings
from undrift.sim.motion.tasks import CATEGORIES
from undrift.study.space import HEADINGS, OF_NOTE

if TYPE_CHECKING:
    from undrift.study.judge import NoteValue, ParameterEffect
    from undrift.study.outcome import StudyOutcome, TaskOutcome
    from undrift.study.plan import Objective, Timing
    from undrift.study.rivals import RivalRow, Spread, TriadRow
    from undrift.study.run import TaskSurface
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
    if target.verdict == "not enough" and tested.failed:
        return f"{_name(task)}: {minutes} are not enough, {tested.failed} of {tested.subjects} devices were left uncalibrated"
    if target.verdict == "not enough":
        return f"{_name(task)}: {minutes} are not enough, above {lower:.2g} deg"
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
        figure3_section(outcome),
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
        _note_values(outcome),
        _other_cohort(outcome),
        _cohorts(outcome),
        _bench(outcome),
        *(section for task in outcome.tasks for section in _task_sections(outcome, task)),
        _tests(outcome),
        *note_flows(),
        *_rivals(outcome),
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
            "confidence, or the best if there is none. Cheapest: the shortest to the minute, then the one that asks least of a "
            "laboratory."
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
    text.append("p is the smallest over all parameters that were varied, after Holm, with the others at the optimum.")
    of_note = [task.note for task in outcome.tasks if task.note]
    text += ["In the note's rows it is as printed; the note does not define its test."] * bool(of_note)
    text += sorted({f"* {note.row.erratum}" for note in of_note if note.row.erratum})
    heads = ("task", *_PROTOCOL, "p")
    return Section(title="Table 1: optimised parameters", text=tuple(text), columns=heads, rows=tuple(rows))


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
        "dz": with_interval(found.cohen_dz, found.dz_interval, ".2f") if isfinite(found.cohen_dz) else "–",
        "p of better": _p(found.p_better),
        "p of equivalent": _p(found.p_equivalent),
        "verdict": found.verdict,
    }


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
    rows = [{"key of study.toml": key, "value": f"{value:g}"} for key, value in held.items()]
    text = (
        "Standard deviations, except encoder_lines (lines) and board_lag_s (s). Every protocol of a subject has the same draws.",
    )
    return rows_section("Errors of bench and parts", rows, text=text)


# ---- one task


def _task_sections(outcome: "StudyOutcome", task: "TaskOutcome") -> tuple[Section, ...]:
    name, own = _name(task), outcome.study.timing
    timings = (own, *(timing for timing in TIMINGS if timing != own))
    surfaces = tuple(figure_of("figures:draw_surface", outcome, task, each, HEADINGS) for each in timings)
    return (
        Section(
            title=f"{name}: error surface",
            text=(
                f"Mean error over the subjects. Each cell is the best of the protocols that share it; white: not tried, or a "
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
    text = [
        "One parameter at a time, the others at the optimum; bars are 95 % intervals within subjects, p after Holm over the "
        "parameters. Partial eta²: share of the variance left after the subjects' own levels.",
        f"Better: the optimum's value is better than another by more than {outcome.study.margin_deg:g} deg. Equivalent: all values "
        "are within it. Not decidable: neither is shown.",
    ]
    title = f"{_name(task)}: what each parameter does"
    rows = [_effect_row(effect) for effect in task.optimum.effects]
    return rows_section(title, rows, text=tuple(text), pictures=(figure_of("figures:draw_effects", task, HEADINGS),))


def _effect_row(effect: "ParameterEffect") -> dict[str, str]:
    judged, test, values = effect.judged, effect.anova, ", ".join(f"{value:.4g}" for value in effect.values)
    if len(effect.dropped):
        values += f" (left out, a device was not calibrated: {', '.join(f'{value:.4g}' for value in effect.dropped)})"
    share = with_interval(test.partial_eta_squared, test.partial_eta_squared_interval, ".2f") if test else ""
    return {
        "parameter": HEADINGS[effect.name],
        "values tried": values,
        "best to worst (deg)": f"{effect.span_deg:.3f}" if test else "",
        "test": f"none: {effect.untested.detail}" if effect.untested else "ANOVA",
        "F (degrees of freedom)": f"{test.f:.2f} ({test.dof[0]:.0f}, {test.dof[1]:.0f})" if test else "",
        "p after Holm": _p(effect.p_holm) if test else "",
        "partial eta² [95 %]": share,
        "verdict": judged.verdict if judged else "",
        "p of better": _p(judged.p_better) if judged else "",
        "p of equivalent": _p(judged.p_equivalent) if judged else "",
    }


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
        if effect.anova is not None
    ]
    text = (
        "One-way repeated-measures analysis of variance; p uncorrected, with the degrees of freedom of Greenhouse-Geisser (GG), "
        "and of Huynh-Feldt (HF). The p above is HF where epsilon GG exceeds 0.75, else GG. Mauchly's test needs three values or "
        "more.",
    )
    return rows_section("The tests in full", rows, text=text)


def _test_row(effect: "ParameterEffect") -> dict[str, str]:
    if (found := effect.anova) is None:
        return {}
    form = found.sphericity
    several = form if found.conditions > 2 else None
    return {
        "p": _p(found.p_uncorrected),
        "p GG": _p(found.p_greenhouse_geisser),
        "p HF": _p(found.p_huynh_feldt),
        "quoted": {"huynh-feldt": "HF", "greenhouse-geisser": "GG"}[found.correction],
        "epsilon GG": f"{form.greenhouse_geisser:.2f}",
        "epsilon HF": f"{form.huynh_feldt:.2f}",
        "Mauchly's W": f"{several.mauchly_w:.2f}" if several else "",
        "p of Mauchly": _p(several.p_value) if several else "",
        "generalised eta²": f"{found.generalized_eta_squared:.3f}",
        "residual sd (deg)": f"{effect.error_variance**0.5:.4f}",
    }


# ---- other ways to calibrate


def _rivals(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the other ways to calibrate: the error that each leaves in a task, and its errors of each triad."""
    tasks: Cells[RivalRow] = (
        ("task", lambda row: plain_words(row.task)),
        ("method", lambda row: plain_words(row.method)),
        ("calibrates", lambda row: ", ".join(row.observable) or "nothing"),
        ("min", lambda row: f"{row.minutes:.1f}"),
        ("rms (deg)", lambda row: _over_units(row.error_rms_deg)),
        ("max (deg)", lambda row: _over_units(row.error_max_deg)),
        ("refused", lambda row: f"{row.refused} of {row.units}"),
    )
    triads: Cells[TriadRow] = (
        ("triad", lambda row: row.triad),
        ("method", lambda row: plain_words(row.method)),
        ("calibrated", lambda row: f"{row.calibrated} of {row.units}"),
        ("scale (%)", lambda row: _over_units(row.scale_percent)),
        ("cross-axis (%)", lambda row: _over_units(row.cross_axis_percent)),
        ("offset (m/s2 or deg/s)", lambda row: _over_units(row.offset)),
    )
    text = "Median over the units, with the least and the greatest. The data sheet replaces a triad that a method cannot calibrate."
    title = "The note's Discussion as an experiment: other ways to calibrate"
    if not outcome.rivals:
        missing = outcome.rivals_missing
        return (Section(title=title, findings=(missing,) if missing else ()),)
    return (
        table_section(title, outcome.rivals, tasks, text=(text,)),
        table_section("Other ways to calibrate: each triad", outcome.rival_triads, triads),
    )


def _over_units(spread: "Spread") -> str:
    if spread.median != spread.median:
        return "no unit"
    return f"{spread.median:.3f} [{spread.least:.3f} to {spread.greatest:.3f}]"
