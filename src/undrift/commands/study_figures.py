"""What a study shows of devices that were worn: the note's Figures 1 to 3, simulated and actual, and real recordings.

Rows are those of study/figure3.py and study/real.py; ``study_sections`` puts the sections in their places.
"""

from typing import TYPE_CHECKING

from undrift.base.summary import (
    Cells,
    Section,
    figure_of,
    number,
    plain_words,
    rows_section,
    table_section,
    with_interval,
)
from undrift.sim.motion.tasks import CATEGORIES
from undrift.study.space import COMPARED_NAMES

if TYPE_CHECKING:
    from undrift.study.figure3 import DrawnRow, Figure3
    from undrift.study.outcome import StudyOutcome
    from undrift.study.real import CohortComparison, Pairwise, RealErrors, RealOutcome, Worn, WornRow

SLOPE_OF_THE_NOTE = (
    "The preset's slope over temperature was inferred from the note's own Figure 3: the size of the error without compensation "
    "confirms nothing, only what each compensation leaves of it."
)


def task_words(key: str) -> str:
    """Return a task and the category of its subjects in words."""
    name, _, category = key.partition("-")
    label = next((held.label for kind, held in CATEGORIES.items() if kind == category), plain_words(category))
    return f"{plain_words(name)}, {label}" if label else plain_words(name)


# ---- real recordings


def real_sections(real: "RealOutcome | None") -> tuple[Section, ...]:
    """Return the sections on real recordings."""
    if real is None:
        return ()
    return (
        _trials(real.errors),
        _compared("Real recordings: captured people and the cohort", real.motions),
        *((_worn(real.worn),) if real.worn else ()),
        _compared("Real recordings: stance on a force plate and the cohort's sway", real.sways),
        Section(title="Real recordings: what is not there", findings=real.lacks),
    )


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
        ("task", lambda row: task_words(row.task)),
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


# ---- Figures 1 to 3


def note_flows() -> tuple[Section, ...]:
    """Return Figures 1 and 2."""
    text = (
        "In black the steps of the note's text, in blue the functions that do them here. Numbers of blocks stand where its text "
        "has them; block 1 is not in it.",
    )
    titles = ("Figure 1: how the parameters are optimised", "Figure 2: how the drift is compensated")
    drawings = (figure_of(f"note:draw_figure{k}") for k in (1, 2))
    return tuple(Section(title=title, text=text, pictures=(one,)) for title, one in zip(titles, drawings, strict=True))


def figure3_section(outcome: "StudyOutcome") -> Section:
    """Return the section on Figure 3; none of a study without a sit-to-stand."""
    title, found, drawn = "Figure 3: sit-to-stand, simulated and actual device", outcome.figure3, outcome.figure3_drawn
    if found is None:
        missing = outcome.figure3_missing
        if missing is None or missing.code == "study.no_sit_to_stand":  # such a study does not speak of the figure
            return Section(title="")
        return Section(title=title, findings=(missing,))
    twin = None if outcome.real is None else outcome.real.figure3
    rows = [
        {"compensation": name}
        | _columns("", found, k)
        | (_drawn_columns(drawn[k]) if drawn else {})
        | (_columns("twin of a real device: ", twin, k) if twin else {})
        for k, name in enumerate(COMPARED_NAMES)
    ]
    text = (*_words(found, drawn), *((_twin_words(twin),) if twin else ()))
    picture = figure_of("note:draw_figure3", found, COMPARED_NAMES, drawn, twin)
    return rows_section(title, rows, text=text, pictures=(picture,))


def _columns(of: str, found: "Figure3", k: int) -> dict[str, str]:
    """Return the cells of one compensation for one pair of devices."""
    return {
        f"{of}simulated: largest, rms (deg)": f"{found.simulated_max_deg[k]:.2f}, {found.simulated_rms_deg[k]:.2f}",
        f"{of}actual: largest, rms (deg)": f"{found.actual_max_deg[k]:.2f}, {found.actual_rms_deg[k]:.2f}",
        f"{of}largest difference (deg)": f"{found.simulated_actual_max_deg[k]:.2f}",
        f"{of}correlation": f"{found.correlation[k]:.2f}",
    }


def _drawn_columns(row: "DrawnRow") -> dict[str, str]:
    """Return the cells of one compensation over drawn units."""
    low, middle, high = row.simulated_deg
    apart = row.apart_deg
    return {
        f"{row.units} drawn units, simulated: median (quartiles)": f"{middle:.2f} ({low:.2f} to {high:.2f})",
        "actual: median (quartiles)": f"{row.median_deg:.2f} ({row.lower_deg:.2f} to {row.upper_deg:.2f})",
        "difference: median (quartiles)": f"{apart[1]:.2f} ({apart[0]:.2f} to {apart[2]:.2f})",
        "within 0.15 deg": f"{row.within} of {row.units}",
        "correlation over time [95 %]": with_interval(row.correlation, row.correlation_interval, ".2f"),
        "of the largest errors over units [95 %]": with_interval(row.largest_correlation, row.largest_interval, ".2f"),
    }


def _words(found: "Figure3", drawn: "tuple[DrawnRow, ...]") -> tuple[str, ...]:
    text = [
        f"Board {found.excursion_k:g} K above the bench. Compensation removes {found.decrease_deg:.2f} deg of the actual "
        "device's largest error (the note: more than 3.2). With both tables the two errors differ by at most "
        f"{found.simulated_actual_max_deg[2]:.2f} deg (the note: 0.15) and have a correlation coefficient of "
        f"{found.correlation[2]:.2f}, without tables {found.correlation[0]:.2f} (the note: a correlation, no coefficient).",
        "The actual device is the simulated one with hysteresis, thermometer lag, integral non-linearity of the converter and "
        "g-sensitivity, which the study's model lacks. Noise is drawn anew for each: where it is most of an error, the correlation "
        "falls although both errors are small.",
        "A rest before the motion re-zeroes the offset without a chamber and leaves "
        f"{found.actual_max_deg[3]:.2f} deg of the actual device's {found.actual_max_deg[0]:.2f}: scale and dynamic drift, "
        f"which no rest shows. Both tables leave {found.actual_max_deg[2]:.2f} deg, with the rest "
        f"{found.actual_max_deg[4]:.2f} deg. "
        "Recommended: tables, and the offset at that rest subtracted.",
    ]
    if drawn:
        text.append(
            f"Drawn units: {drawn[0].units} units of the kind's spread, each calibrated and worn by a person of its own, simulated "
            "and actual. Correlation over time: of the two errors of a unit, mean over the units by Fisher's z. "
            f"{SLOPE_OF_THE_NOTE}"
        )
    return tuple(text)


def _twin_words(twin: "Figure3") -> str:
    return (
        "Twin of a real device: matrix, offset, noise and codes were found beside optics, offsets over temperature in a recording "
        "at rest of this device or of another of its kind. Simulated is the typical unit of the kind, from its data sheet, which "
        "does not know the sign of a unit's drift. With both tables the errors differ by at most "
        f"{twin.simulated_actual_max_deg[2]:.2f} "
        "deg. Not in the twin: dynamic drift, scale over temperature, hysteresis, flicker, lag of the thermometer."
    )


def figure3_effects(outcome: "StudyOutcome") -> Section:
    """Return the section on what each effect of the actual device makes of the figure."""
    rows = [
        {"effect": plain_words(row.effect)}
        | {f"{name} (deg)": f"{v:.2f}" for name, v in zip(COMPARED_NAMES, row.simulated_actual_max_deg, strict=True)}
        | {"largest error, both tables (deg)": f"{row.full_max_deg:.2f}"}
        for row in outcome.figure3_effects
    ]
    text = (
        "The actual device's effects one at a time: largest difference between the two errors at each level of compensation, and "
        "the largest error with both tables. Noise alone is another recording of the same model.",
    )
    return rows_section("Figure 3: simulated against actual, effect by effect", rows, text=text)
