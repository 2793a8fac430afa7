"""The page of a thermal fit: offset and scale over temperature with what they rest on, dynamic drift, the choice of tables."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.calibration.model import AXES
from undrift.report.drift_figures import draw_alternatives, draw_dynamic, draw_offsets, draw_scale, shown_unit
from undrift.report.figures import svg_of
from undrift.report.page import Section, write_page

if TYPE_CHECKING:
    from undrift.drift.fit.choose import Alternatives
    from undrift.drift.procedure import DriftFit
    from undrift.drift.summary import TriadSummary


def offset_heads(summary: "TriadSummary") -> tuple[str, ...]:
    """Return the heads of ``offset_rows``.

    Parameters
    ----------
    summary : TriadSummary
        Offsets over temperature.

    Returns
    -------
    tuple of str
        With units.
    """
    unit, _ = shown_unit(summary.unit)
    heads = ["axis", f"slope ({unit} per degC)", f"table +- ({unit})", f"left out, rms ({unit})"]
    heads += [f"half loop ({unit})"] if summary.half_loop is not None else []
    heads += [f"between sessions ({unit})"] if summary.turn_on is not None else []
    return tuple(heads)


def offset_rows(summary: "TriadSummary") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each axis: slope, uncertainty of the table, error of what was left out, loop, sessions.

    Parameters
    ----------
    summary : TriadSummary
        Offsets over temperature.

    Returns
    -------
    tuple of tuple of str
        Standard uncertainties behind +-.
    """
    _, factor = shown_unit(summary.unit)
    rows = []
    for k, axis in enumerate(AXES):
        row = [axis, plus_minus(summary.slope[k] * factor, summary.slope_uncertainty[k] * factor)]
        row.append(f"{summary.usual_uncertainty[k] * factor:.2g}")
        left = summary.left_out_rms[k] * factor
        row.append(f"{left:.2g}" if np.isfinite(left) else "too few")
        if summary.half_loop is not None and summary.half_loop_uncertainty is not None:
            row.append(plus_minus(summary.half_loop[k] * factor, summary.half_loop_uncertainty[k] * factor))
        if summary.turn_on is not None:
            between = summary.turn_on[k] * factor
            row.append(f"{between:.2g}" if np.isfinite(between) else "not seen")
        rows.append(tuple(row))
    return tuple(rows)


def plus_minus(value: float, uncertainty: float) -> str:
    """Return a value with its standard uncertainty, to the uncertainty's second digit.

    Parameters
    ----------
    value, uncertainty : float
        In the same unit.

    Returns
    -------
    str
        +0.0279 +- 0.0012; the value alone where the uncertainty is not known.
    """
    if not (uncertainty > 0.0 and np.isfinite(uncertainty)):
        return f"{value:+.3g}" if np.isfinite(value) else "not seen"
    places = min(9, max(0, 1 - int(np.floor(np.log10(uncertainty)))))
    return f"{value:+.{places}f} +- {uncertainty:.{places}f}"


def offset_title(name: str, summary: "TriadSummary") -> str:
    """Return what an offset table covers, in one line.

    Parameters
    ----------
    name : str
        Which sensors.
    summary : TriadSummary
        Offsets over temperature.

    Returns
    -------
    str
        Span seen, nodes, how many of them are extrapolated.
    """
    low, high = summary.seen_c
    seen = f"{name} offset over temperature: {low:.1f} to {high:.1f} degC seen"
    if not summary.in_table:
        return f"{seen}; the change alone is known, no table"
    nodes = summary.temp_c
    step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    count = int(summary.extrapolated.sum())
    far = f", {count} of them extrapolated" if count else ""
    return f"{seen}, {len(nodes)} nodes {nodes[0]:g} to {nodes[-1]:g} degC by {step:g}{far}"


SCALE_HEADS = ("axis", "scale factor (% per degC)", "asymmetry (%)")


def scale_rows(fit: "DriftFit") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each axis: thermal sensitivity of the scale factor, and asymmetry.

    Parameters
    ----------
    fit : DriftFit
        With rate steps; no rows otherwise.

    Returns
    -------
    tuple of tuple of str
        Standard uncertainties behind +-.
    """
    scale = None if fit.choice is None else fit.choice.scale
    rows = []
    for k, axis in enumerate(AXES):
        sensitivity = asymmetry = "not seen"
        if scale is not None:
            sensitivity = plus_minus(scale.percent_per_k[k], scale.percent_per_k_uncertainty[k])
        if fit.asymmetry is not None:
            asymmetry = plus_minus(100.0 * fit.asymmetry.mean[k], 100.0 * fit.asymmetry.mean_uncertainty[k])
        rows.append((axis, sensitivity, asymmetry))
    return tuple(rows) if scale is not None or fit.asymmetry is not None else ()


CHOICE_HEADS = ("tables beside offsets", "fitted (deg/s rms)", "left out (deg/s rms)", "chosen")


def choice_rows(alternatives: "Alternatives") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each choice of tables.

    Parameters
    ----------
    alternatives : Alternatives
        What each foretells.

    Returns
    -------
    tuple of tuple of str
        A mark in the last cell of the one that was taken.
    """
    return tuple(
        (
            name,
            _figure(alternatives.fitted_rms_dps[k]),
            plus_minus(alternatives.left_out_rms_dps[k], alternatives.standard_error_dps[k]).lstrip("+"),
            "chosen" if name == alternatives.chosen else "",
        )
        for k, name in enumerate(alternatives.name)
    )


def _figure(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "not fitted"


def write_drift_report(fit: "DriftFit", path: Path) -> None:
    """Write the page of a thermal fit.

    Parameters
    ----------
    fit : DriftFit
        Tables and what they rest on.
    path : Path
        The .html file.
    """
    device = fit.calibration.device or "device without a serial number"
    write_page(
        path,
        title=f"Thermal drift of {device}",
        lead=f"{len(fit.rests)} blocks of rest, {len(fit.steps)} dwells at known rates.",
        sections=drift_sections(fit),
        verdict=fit.verdict,
    )


def drift_sections(fit: "DriftFit") -> tuple[Section, ...]:
    """Return the sections of the page of a thermal fit.

    Parameters
    ----------
    fit : DriftFit
        Tables and what they rest on.

    Returns
    -------
    tuple of Section
        Gyroscopes, accelerometers, scale, dynamic drift, choice: those that there are.
    """
    sections = []
    for name, summary in (("Gyroscopes", fit.gyro_summary), ("Accelerometers", fit.accel_summary)):
        if summary is not None:
            sections.append(
                Section(
                    title=name,
                    text=(offset_title(name.lower(), summary) + ". Standard uncertainties behind +-.",),
                    columns=offset_heads(summary),
                    rows=offset_rows(summary),
                    pictures=(svg_of(draw_offsets(summary)),),
                )
            )
    if fit.scale_summary is not None:
        pictures = (svg_of(draw_scale(fit.scale_summary)),)
        sections.append(
            Section(title="Scale over temperature", columns=SCALE_HEADS, rows=scale_rows(fit), pictures=pictures)
        )
    drift = fit.calibration.drift
    if drift is not None and drift.dynamic is not None:
        sections.append(Section(title="Dynamic drift", pictures=(svg_of(draw_dynamic(drift.dynamic)),)))
    if fit.choice is not None:
        held = fit.choice.alternatives
        sections.append(
            Section(
                title="Which tables",
                text=(held.reason,),
                columns=CHOICE_HEADS,
                rows=choice_rows(held),
                pictures=(svg_of(draw_alternatives(held)),),
            )
        )
    return tuple(sections)
