"""Figures of a calibration, and its certificate as an HTML page."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.commands.answer import NAMES
from undrift.commands.certificate import certificate_content
from undrift.commands.expanded import COVERAGE, expand
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.model import AXES, Calibration, DriftTables
from undrift.report import figures
from undrift.report.drift import draw_dynamic
from undrift.units import is_physical, si_factor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.commands.calibrate import CorrectedPiece
    from undrift.record import Record


def write_certificate(calibration: Calibration, path: Path, content: Mapping[str, Any] | None = None) -> None:
    """Write the certificate of a calibration as a page for A4, the same bytes for the same calibration and content."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("undrift", "report"), autoescape=True)
    environment.filters["number"] = _number
    drift, drawings = calibration.drift, list["Figure"]()
    if drift is not None and (drift.static is not None or drift.scale is not None):
        drawings.append(draw_tables(drift))
    if drift is not None and drift.dynamic is not None:
        drawings.append(draw_dynamic(drift.dynamic))
    pictures = [figures.svg_of(drawing).partition("?>")[2] for drawing in drawings]
    text = environment.get_template("certificate.html.j2").render(
        c=content or certificate_content(calibration), pictures=pictures
    )
    write_whole(path, text.lstrip() + "\n")


def _number(cell: str) -> Any:
    """Return a number with a true minus sign and its power of ten. Other text is unchanged."""
    from markupsafe import Markup

    parts = re.fullmatch(r"(-?)([\d.]+)(?:e([-+]?)(\d+))?", cell)
    if parts is None:
        return cell
    sign, digits, power_sign, power = parts.groups()
    if not power:
        sign = sign if float(digits) else ""
        return f"{sign.replace('-', '−')}{digits}"
    return Markup(
        f"{sign.replace('-', '−')}{digits} × 10<sup>{power_sign.replace('-', '−').replace('+', '')}{power}</sup>"
    )


def draw_tables(drift: DriftTables) -> "Figure":
    """Draw offset and scale factor over temperature minus their mean, each node with its expanded uncertainty (k = 2)."""
    panels: list[tuple[str, FloatArray, FloatArray, FloatArray | None]] = []
    for name in ("gyro", "accel"):
        triad = NAMES[name].lower()
        if drift.static is not None and (offset := getattr(drift.static, f"{name}_offset")) is not None:
            doubt = getattr(drift.static, f"{name}_uncertainty")
            panels.append((f"{triad}: offset (raw unit)", drift.static.temp_c, offset - offset.mean(axis=0), doubt))
        if drift.scale is not None and (matrix := getattr(drift.scale, f"{name}_matrix")) is not None:
            diagonal = np.einsum("nii->ni", matrix)
            doubt = getattr(drift.scale, f"{name}_uncertainty")
            relative = 100.0 * (diagonal / diagonal.mean(axis=0) - 1.0)
            doubt = None if doubt is None else 100.0 * np.einsum("nii->ni", doubt) / np.abs(diagonal.mean(axis=0))
            panels.append((f"{triad}: scale factor (%)", drift.scale.temp_c, relative, doubt))
    figure, axes = figures.new_figure(len(panels), height=1.3, width=7.2, share_x=False)
    for panel, (title, temp_c, value, doubt) in zip(axes, panels, strict=True):
        for k, axis in enumerate(AXES):
            style: Any = {
                "color": figures.AXIS_COLOURS[k],
                "marker": "os^"[k],
                "markersize": 3.0,
                "linestyle": ("-", "--", ":")[k],
            }
            panel.plot(temp_c, value[:, k], label=axis, **style)
            if doubt is not None:
                low, high = value[:, k] - COVERAGE * doubt[:, k], value[:, k] + COVERAGE * doubt[:, k]
                panel.fill_between(temp_c, low, high, color=figures.AXIS_COLOURS[k], alpha=0.12, linewidth=0.0)
        panel.set_title(title, loc="left", fontsize=9)
    axes[-1].set_xlabel("temperature (°C)")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    return figure


def draw_calibration(calibration: Calibration) -> "Figure":
    """Draw each matrix as departures from the ideal, and the offsets. Bars are expanded uncertainties. The ideal matrix
    has no cross-axis terms, and the gain of the unit. For counts or volts, it has the mean gain.
    """
    triads = [(name, triad) for name in ("gyro", "accel") if (triad := getattr(calibration, name)) is not None]
    if not triads:
        raise InputError("plot: expected a calibrated gyroscope or accelerometer, got neither. Calibrate first.")
    figure, panels = figures.new_figure(2 * len(triads), height=1.6, share_x=False)
    elements = [row + column for row in AXES for column in AXES]
    style: Any = {"fmt": "o", "color": figures.DEVICE, "capsize": 3.0, "markersize": 4.0, "label": "estimate, 95 %"}
    for (name, triad), matrix, offset in zip(triads, panels[::2], panels[1::2], strict=True):
        table = expand(triad)
        expanded = dict(zip(table.names, table.expanded, strict=True))
        gain, ideal = float(triad.scale_factor.mean()), "mean scale"
        if is_physical(triad.unit_in):
            gain, ideal = 1.0 / si_factor(triad.unit_in, "rate" if name == "gyro" else "accel"), "unit"
        bars = [100.0 * gain * expanded.get(f"m_{element}", 0.0) for element in elements]
        matrix.errorbar(elements, 100.0 * (gain * triad.matrix - np.eye(3)).ravel(), yerr=bars, **style)
        matrix.axhline(0.0, color=figures.OPTICS, linewidth=0.6)
        matrix.set_ylabel(f"{name} matrix\nminus {ideal} (%)")
        offset.errorbar(AXES, triad.offset, yerr=[expanded.get(f"offset_{axis}", 0.0) for axis in AXES], **style)
        offset.margins(0.3)
        offset.set_ylabel(f"{name} offset\n({triad.unit_in})")
    figures.entitle(figure, "Matrix as departures from ideal, and offsets")
    figures.legend_above(panels[0])
    return figure


def draw_rests(accel: FloatArray, rate: FloatArray, gravity_m_s2: float) -> "Figure":
    """Draw |a|, m/s2, and |w|, deg/s, of each rest, raw next to corrected, (n, 2), with gravity and zero."""
    rows = [(accel, "|a| (m/s2)", "local gravity", gravity_m_s2), (rate, "|w| (deg/s)", "at rest", 0.0)]
    panels = [row for row in rows if len(row[0])]
    figure, axes = figures.new_figure(max(1, len(panels)), height=1.9, share_x=False)
    figures.entitle(figure, "Each rest, raw and corrected")
    for panel, (sizes, label, ideal, value) in zip(axes, panels, strict=False):
        place = np.arange(1, len(sizes) + 1)
        panel.vlines(place, sizes.min(axis=1), sizes.max(axis=1), color=figures.LIMIT, linewidth=0.6)
        panel.plot(place, sizes[:, 0], "s", color=figures.ERROR, markersize=4.0, label="raw")
        panel.plot(place, sizes[:, 1], "o", color=figures.DEVICE, markersize=4.0, label="corrected")
        panel.axhline(value, color=figures.OPTICS, linewidth=0.6, linestyle="--", label=ideal)
        panel.set(ylabel=label, xlabel="rest, in order of time", xlim=(0.5, len(sizes) + 0.5))
        panel.locator_params(axis="x", integer=True)
        figures.legend_above(panel)
    return figure


def draw_residuals(poses: FloatArray, dwells: FloatArray) -> "Figure":
    """Draw the residual of each pose, mg (n,), and of each dwell, deg/s (n, 3)."""
    figure, panels = figures.new_figure(int(len(poses) > 0) + int(len(dwells) > 0), share_x=False)
    figures.entitle(figure, "Residual of each pose and dwell: the fit on its own readings")
    if len(poses):
        marks = np.arange(1, len(poses) + 1)
        panels[0].vlines(marks, 0.0, poses, color=figures.LIMIT, linewidth=0.8)
        panels[0].plot(marks, poses, "o", color=figures.DEVICE, markersize=4.0)
        panels[0].set(xlabel="pose, in order of time", ylabel="|a| - g (mg)")
    if len(dwells):
        marks = np.arange(1, len(dwells) + 1)
        for k, axis in enumerate(AXES):
            style: Any = {"color": figures.AXIS_COLOURS[k], "markersize": 4.0, "label": f"gyro {axis}"}
            panels[-1].plot(marks + 0.2 * (k - 1), dwells[:, k], figures.AXIS_MARKERS[k], **style)
        panels[-1].set(xlabel="dwell at a known rate, in order of time", ylabel="rate error (deg/s)")
        figures.legend_above(panels[-1])
    for panel in panels:
        panel.axhline(0.0, color=figures.OPTICS, linewidth=0.6)
    return figure


def draw_norm(records: Sequence["Record"], judged: Sequence["CorrectedPiece"], gravity_m_s2: float) -> "Figure":
    """Draw |a| over the recordings, one after the other, with the stills shaded."""
    figure, (panel,) = figures.new_figure(1, height=2.4)
    figures.entitle(figure, "Norm of the specific force over the session, stills shaded")
    start, bar = 0.0, dict[str, Any](color=figures.ERROR, linewidth=2.2, solid_capstyle="butt")
    for number_, record in enumerate(records):
        time = record.time - record.time[0] + start
        if record.accel is not None:
            panel.plot(
                *figures.envelope(time, np.linalg.norm(record.accel, axis=1), 600), color=figures.DEVICE, linewidth=0.8
            )
        for item in judged:
            if item.piece.recording == number_ and item.piece.kind == "still":
                ends = float(time[item.piece.start]), float(time[item.piece.stop - 1])
                panel.axvspan(*ends, facecolor=figures.SHADE, linewidth=0.0, zorder=0)
                panel.plot(ends, [np.linalg.norm(item.accel)] * 2, label="mean of a still", **bar)
        start = float(time[-1]) + 1.0 / record.sample_rate_hz
    panel.axhline(gravity_m_s2, color=figures.OPTICS, linewidth=0.6, linestyle="--", label="local gravity")
    where = "time, recordings one after the other (s)" if len(records) > 1 else "time (s)"
    panel.set(xlabel=where, ylabel="|a| (m/s2)")
    figures.legend_above(panel)
    return figure
