"""More of a study's page: rates to dwell at, the note's Discussion as an experiment, real recordings."""

from typing import TYPE_CHECKING

from undrift.report.page import Cells, Section, number, plain_words, table_section

if TYPE_CHECKING:
    from undrift.study.outcome import StudyOutcome
    from undrift.study.real import CohortComparison, Pairwise, RealErrors, RealOutcome, Worn, WornRow
    from undrift.study.rivals import DesignRow, RivalRow, Spread
    from undrift.validation.trial import Trial

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
        return (Section(title=title, text=(f"Not made: {outcome.rivals_missing}.",)),)
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
        Section(title="Real recordings: what is not there", text=tuple(f"{lack}." for lack in real.lacks)),
    )
    return tuple(section for section in sections if section.text)


def _trials(levels: "tuple[RealErrors, ...]") -> Section:
    if not levels:
        return Section(title="")
    cells: Cells[tuple[RealErrors, Trial]] = (
        ("recording", lambda row: row[1].recording),
        ("level", lambda row: row[0].level),
        ("converter's rounding", lambda row: row[0].rounding),
        ("total rms (deg)", lambda row: number(row[1].figures.rmse_total_deg)),
        ("inclination rms", lambda row: number(row[1].figures.rmse_inclination_deg)),
        ("largest pitch error", lambda row: number(row[1].figures.max_abs_pitch_deg)),
        ("total at the end", lambda row: number(row[1].figures.end_total_deg)),
    )
    trials = table_section("", [(level, trial) for level in levels for trial in level.trials], cells)
    medians = tuple(
        (
            "median",
            level.level,
            level.rounding,
            *map(number, (level.rmse_total_deg, level.rmse_inclination_deg)),
            *map(number, (level.max_abs_pitch_deg, level.end_total_deg)),
        )
        for level in levels
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
        columns=trials.columns,
        rows=(*trials.rows, *medians),
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
