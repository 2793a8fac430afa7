"""Sections of a study's report with the note's Figures 1 to 3. The rows of Figure 3 come from study/figure3.py."""

from typing import TYPE_CHECKING

from undrift.base.summary import (
    Section,
    figure_of,
    plain_words,
    rows_section,
    with_interval,
)
from undrift.sim.motion.tasks import CATEGORIES
from undrift.study.space import COMPARED_NAMES

if TYPE_CHECKING:
    from undrift.study.figure3 import DrawnRow, Figure3
    from undrift.study.outcome import StudyOutcome

SLOPE_OF_THE_NOTE = (
    "The preset's slope over temperature was inferred from the note's own Figure 3: the size of the error without compensation "
    "confirms nothing, only what each compensation leaves of it."
)


def task_words(key: str) -> str:
    """Return a task and the category of its subjects in words."""
    name, _, category = key.partition("-")
    label = next((held.label for kind, held in CATEGORIES.items() if kind == category), plain_words(category))
    return f"{plain_words(name)}, {label}" if label else plain_words(name)


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
    rows = [
        {"compensation": name} | _columns(found, k) | (_drawn_columns(drawn[k]) if drawn else {})
        for k, name in enumerate(COMPARED_NAMES)
    ]
    picture = figure_of("note:draw_figure3", found, COMPARED_NAMES, drawn)
    return rows_section(title, rows, text=_words(found, drawn), pictures=(picture,))


def _columns(found: "Figure3", k: int) -> dict[str, str]:
    """Return the cells of one compensation for one pair of devices."""
    return {
        "simulated: largest, rms (deg)": f"{found.simulated_max_deg[k]:.2f}, {found.simulated_rms_deg[k]:.2f}",
        "actual: largest, rms (deg)": f"{found.actual_max_deg[k]:.2f}, {found.actual_rms_deg[k]:.2f}",
        "largest difference (deg)": f"{found.simulated_actual_max_deg[k]:.2f}",
        "correlation": f"{found.correlation[k]:.2f}",
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
