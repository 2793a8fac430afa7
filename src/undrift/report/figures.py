"""Figures: each function draws a result as a matplotlib Figure. :func:`svg_of` converts it to text for a page or a file.

Colours keep one meaning throughout: the device in blue, the optics in black, errors in orange, limits in grey. Axes x,
y and z and levels of compensation also have a dash or a marker, because some readers cannot distinguish the colours.
Figures are 4.8 inches wide, so that their text has at least 9 pixels on a screen 390 pixels wide.
"""

import io
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import escape

from undrift.arrays import FloatArray, runs
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.io.symptoms import saturated_runs
from undrift.model import AXES
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undrift.calibration.noise import AxisNoise, NoiseFit
    from undrift.calibration.pieces import Piece
    from undrift.orientation import Orientation
    from undrift.rig.folder import RecordedDwell
    from undrift.study.figure3 import Figure3
    from undrift.study.judge import StudyOutcome
    from undrift.twin.held_out import HeldOutTrial
    from undrift.validation.agreement import Validation
    from undrift.validation.levels import LevelSummary, LevelTable
    from undrift.validation.trial import Trial

DEVICE, OPTICS, ERROR, LIMIT = "#1f5fa8", "#222222", "#c2500f", "#767676"
SHADE, SATURATED = "#f1efe8", "#b0198f"
AXIS_COLOURS = ("#cc3311", "#007d5e", "#2b62b3")  # x, y, z
AXIS_DASHES, AXIS_MARKERS = ("-", "--", ":"), ("o", "s", "^")
LEVEL_COLOURS, LEVEL_MARKERS = (LIMIT, ERROR, DEVICE, "#9a6a00", "#3f8f4f"), ("o", "s", "^", "D", "v")
COLUMNS_DRAWN = 1200  # largest number of points that a figure can resolve
WIDTH, TEXT_PT, LEAST_SIZE = 4.8, 9.0, 8.7  # width, inches, and usual and smallest text size, points
_LETTER = 0.58  # usual width of a letter, relative to the text size
_LABELS_PT = 56.0  # width of the labels of an axis next to a panel
_UNDATED: Any = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same figure gives the same bytes
_STYLE: Any = {  # matplotlib types every key by name
    "font.size": TEXT_PT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "svg.hashsalt": "undrift",
    "svg.fonttype": "none",
}


# ---- figures


def new_figure(
    *labels: str, x: str = "", title: str = "", height: float = 2.0, columns: int = 1, **grid: Any
) -> tuple["Figure", list["Axes"]]:
    """Return a figure in the house style, and its panels: one row per label of a y axis. ``x`` labels the last row."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        figure = _figure_class()(figsize=(WIDTH, 0.4 + height * len(labels)), layout="constrained")
        panels = np.asarray(figure.subplots(len(labels), columns, squeeze=False, **{"sharex": "col"} | grid))
    for row, label in zip(panels, labels, strict=True):
        row[0].set_ylabel(label)
    for panel in panels[-1]:
        panel.set_xlabel(x)
    if title:
        figure.suptitle(_wrapped(title, 0.98 * 72.0 * WIDTH, 10.0), x=0.01, ha="left", fontsize=10)
    return figure, list(panels.ravel())


@cache
def _figure_class() -> type["Figure"]:
    """Return matplotlib's Figure in a form that notebooks display without pyplot."""
    from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        def _repr_png_(self) -> bytes:
            return _saved(self, format="png", dpi=80)

    return NotebookFigure


def svg_of(figure: "Figure", *, outlines: bool = False) -> str:
    """Return a figure as SVG text with a description. The same figure gives the same bytes. Letters are drawn as outlines,
    independent of fonts.
    """
    from matplotlib.text import Text

    for label in figure.findobj(Text):
        label.set_fontsize(max(label.get_fontsize(), LEAST_SIZE))
    fonts = {"svg.fonttype": "path"} if outlines else {}
    text = _saved(figure, fonts, format="svg", metadata={"Date": None, "Creator": "undrift"}).decode()
    opening_tag = f'<svg role="img" aria-label="{escape(_describe_figure(figure))}" '
    return text[text.index("<svg") :].replace("<svg ", opening_tag, 1)


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as SVG, PNG or PDF, by the ending of the name."""
    if path.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise InputError(f"{path}: expected a name ending in .svg, .png or .pdf. Change the ending.")
    kind = path.suffix[1:].lower()
    write_whole(path, _saved(figure, dpi=130, format=kind, metadata=_UNDATED.get(kind)))


def _saved(figure: "Figure", style: Any = None, **how: Any) -> bytes:
    import matplotlib as mpl
    from matplotlib.text import Text

    for axes in figure.axes:
        _plain_log(axes)
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # a dollar sign in a file name is literal
    buffer = io.BytesIO()
    with mpl.rc_context(_STYLE | (style or {})):
        figure.savefig(buffer, **how)
    return buffer.getvalue()


def _plain_log(axes: "Axes") -> None:
    """Label logarithmic axes with plain numbers, because exponents are too small to read."""
    from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        if isinstance(axis.get_major_formatter(), LogFormatter):
            axis.set_major_locator(LogLocator(numticks=7))
            low, high = axis.get_view_interval()
            plain = FuncFormatter(lambda x, _: f"{x:g}")
            axis.set_major_formatter(plain)
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            axis.set_minor_formatter(plain if high < 100.0 * low else NullFormatter())


def _describe_figure(figure: "Figure") -> str:
    """Return the description of a figure: its title, and the labels of its axes."""
    titles = [figure.get_suptitle(), *(axes.get_title(loc) for axes in figure.axes for loc in ("left", "center"))]
    labels = (dict.fromkeys(getattr(axes, get)() for axes in figure.axes) for get in ("get_ylabel", "get_xlabel"))
    described = " against ".join(filter(None, (", ".join(filter(None, names)) for names in labels)))
    return " ".join(": ".join(filter(None, (next(filter(None, titles), ""), described))).split())


def axis_style(k: int, *, marked: bool = False) -> dict[str, Any]:
    """Return the line style of axis x, y or z: colour, and a dash or a few markers."""
    marker: dict[str, Any] = {"marker": AXIS_MARKERS[k], "markevery": (0.05 * k, 0.15), "markersize": 4.0}
    return {"color": AXIS_COLOURS[k]} | (marker if marked else {"linestyle": AXIS_DASHES[k]})


def level_style(k: int) -> dict[str, Any]:
    """Return the line style of a level of compensation: its colour and a few markers."""
    marker = {"marker": LEVEL_MARKERS[k], "markevery": (0.03 * k, 0.15), "markersize": 4.0}
    return {"color": LEVEL_COLOURS[k]} | marker


def shade(axes: "Axes", spans: Iterable[tuple[float, float]]) -> None:
    """Shade stretches behind the lines of a panel."""
    for start, stop in spans:
        axes.axvspan(start, stop, color=SHADE, linewidth=0.0, zorder=0)


def named(axes: "Axes") -> dict[str, Any]:
    """Return the lines and marks of a panel by their names."""
    handles, names = axes.get_legend_handles_labels()
    return dict(zip(names, handles, strict=True))


def legend_above(axes: "Axes") -> None:
    """Draw a legend between the panel and the content above it, with each name once, in as many columns as fit."""
    across = axes.get_subplotspec().get_gridspec().ncols if axes.get_subplotspec() else 1  # type: ignore[union-attr]
    room_pt = 72.0 * WIDTH / across - _LABELS_PT
    where: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    axes.legend(**_legend(named(axes), room_pt) | where)


def legend_outside(figure: "Figure", marks: Mapping[str, Any]) -> None:
    """Draw a legend of lines and marks below all panels, in as many columns as fit."""
    figure.legend(**_legend(marks, 72.0 * WIDTH) | {"loc": "outside lower left"})


def _legend(marks: Mapping[str, Any], room_pt: float) -> Any:
    """Return the content of a legend in lines that fit, and the number of columns that fit."""
    labels = [
        _wrapped(name, room_pt - 5.5 * TEXT_PT) for name in marks
    ]  # width of a handle with its gaps, and of the frame
    longest = max(len(line) for label in labels for line in label.split("\n"))
    columns = int(room_pt / ((_LETTER * longest + 4.0) * TEXT_PT))
    style = {"ncols": min(max(columns, 1), len(labels)), "fontsize": TEXT_PT, "columnspacing": 1.2, "frameon": False}
    return {"handles": [*marks.values()], "labels": labels, **style}


def _wrapped(text: str, room_pt: float, size: float = TEXT_PT) -> str:
    """Return a text in lines that fit a width, points."""
    return textwrap.fill(text, max(int(room_pt / (_LETTER * size)), 8))


# ---- courses over time


def envelope(time: FloatArray, values: FloatArray, columns: int = COLUMNS_DRAWN) -> tuple[FloatArray, FloatArray]:
    """Return the points of a curve that a figure needs: the smallest and the largest value per column, in order of time.
    time (N,) s, values (N,) -> (M,) s, (M,).
    """
    if len(values) <= 2 * columns:
        return time, values
    gaps = np.isnan(values)
    edges = np.linspace(0, len(values), columns + 1).astype(np.int64)
    parts = [slice(a, b) for a, b in pairwise(edges.tolist())]
    low, high = np.where(gaps, np.inf, values), np.where(gaps, -np.inf, values)
    ends = [block.start + int(np.argmin(low[block])) for block in parts]
    ends += [block.start + int(np.argmax(high[block])) for block in parts]
    edge = np.flatnonzero(np.diff(gaps))
    indices = np.unique(np.concatenate((ends, edge, edge + 1)))
    return time[indices], values[indices]


def draw_course(axes: "Axes", time: FloatArray, values: FloatArray, label: str = "", **style: Any) -> None:
    """Draw a curve over time, with peaks and gaps of any length."""
    axes.plot(*envelope(time, values), label=label, **style)


def draw_angle(axes: "Axes", time: FloatArray, angle: FloatArray, label: str = "", **style: Any) -> None:
    """Draw an angle, rad, in degrees, without a line at jumps from +180 to -180."""
    angle_deg = angle / RADIAN_PER_DEGREE
    angle_deg[1:][np.abs(np.diff(angle_deg)) > 180.0] = np.nan
    draw_course(axes, time, angle_deg, label, **style)


def draw_record(record: Record) -> "Figure":
    """Draw the readings of a record over time: each triad and the temperature, in the unit of the record."""
    triads = {f"{name} ({getattr(record, f'{name}_unit')})": getattr(record, name) for name in ("gyro", "accel")}
    courses = {label: values for label, values in triads.items() if values is not None}
    if record.temp_c is not None:
        courses["temperature (degC)"] = record.temp_c[:, None]
    title = f"{record.device or 'record'}: {record.state}"
    figure, panels = new_figure(*courses, x="time (s)", title=title, height=1.9)
    for axes, values in zip(panels, courses.values(), strict=True):
        for k, column in enumerate(values.T):
            style = axis_style(k, marked=True) if len(values.T) == 3 else {"color": DEVICE}
            draw_course(axes, record.time, column, AXES[k], linewidth=0.8, **style)
    legend_above(panels[0])
    return figure


def draw_orientation(orientation: "Orientation") -> "Figure":
    """Draw inclination, pitch with its 95 % limit, and heading over time, with the rest shaded."""
    time, limit, still = orientation.time, orientation.pitch_limit, orientation.still
    names, last = ("inclination", "pitch", "heading"), () if limit is None else ("pitch, 95 %\nwithin (deg)",)
    figure, panels = new_figure(*(f"{name} (deg)" for name in names), *last, x="time (s)", height=1.5)
    for axes, name in zip(panels, names, strict=False):
        draw_angle(axes, time, getattr(orientation, name), color=DEVICE)
        if still is not None:
            shade(axes, [(float(time[still.start]), float(time[still.stop - 1]))])
    if limit is not None:
        few = slice(None, None, max(1, len(time) // COLUMNS_DRAWN))  # the band is smooth
        pitch_deg, limit_deg = orientation.pitch[few] / RADIAN_PER_DEGREE, limit[few] / RADIAN_PER_DEGREE
        panels[1].fill_between(
            time[few], pitch_deg - limit_deg, pitch_deg + limit_deg, color=DEVICE, alpha=0.2, linewidth=0.0
        )
        panels[-1].plot(time[few], limit_deg, color=ERROR)
        panels[-1].set_ylim(0.0, None)
    return figure


def trial_figure(trial: "Trial") -> "Figure":
    """Draw a trial over time: pitch of device and optics, and the errors, with the motion shaded."""
    title = f"{trial.recording}: sagittal pitch"
    figure, (angle, error) = new_figure("pitch (deg)", "error (deg)", x="time (s)", title=title)
    draw_angle(angle, trial.time, trial.reference_pitch, "optics", color=OPTICS)
    draw_angle(angle, trial.time, trial.sensor_pitch, "device", color=DEVICE, linestyle="--")
    for name, colour, dash in (("total", ERROR, "-"), ("inclination", DEVICE, "--"), ("pitch", LIMIT, ":")):
        draw_angle(error, trial.time, getattr(trial.error, name), name, color=colour, linestyle=dash)
    error.axhline(0.0, color=OPTICS, linewidth=0.6)
    shade(error, _motion_of(trial))
    legend_above(angle)
    legend_above(error)
    return figure


def draw_levels(trials: Sequence["Trial"]) -> "Figure":
    """Draw the pitch of the demo's worn trial, and its error at each level of correction on two scales. The motion is shaded."""
    title = (
        "Optical pitch of a sit-to-stand task, and the pitch error at each level of correction. The motion is shaded."
    )
    labels = ("pitch (deg)", "error (deg)", "error, to\n0.3 deg (deg)")
    figure, panels = new_figure(*labels, x="time (s)", title=title, height=1.7)
    draw_angle(panels[0], trials[0].time, trials[0].reference_pitch, color=OPTICS)
    for panel in panels[1:]:
        for k, trial in enumerate(trials):
            draw_angle(panel, trial.time, trial.error.pitch, trial.recording, **level_style(k))
        panel.axhline(0.0, color=OPTICS, linewidth=0.6)
    for panel in panels:
        shade(panel, _motion_of(trials[0]))
    panels[2].set_ylim(-0.3, 0.3)
    legend_above(panels[1])
    return figure


def _motion_of(trial: "Trial") -> list[tuple[float, float]]:
    """Return start and end of each motion, s."""
    return [(float(trial.time[start]), float(trial.time[stop - 1])) for start, stop in runs(trial.moving)]


# ---- a recording with its rests and turns

_ROOM = 0.017  # width of a label's letter, relative to the width of the figure
_REASONS = 4  # largest number of entries in the legend
_LEVELS = {"still": 2.0, "turn": 1.0, "left out": 0.0}
_SHOWN_UNIT = {"dps": "deg/s", "count": "counts"}


def draw_recording(records: Sequence[Record], pieces: Sequence["Piece"], *, title: str, used: bool = False) -> "Figure":
    """Draw readings over time with their stills, faces, turns, gaps and saturation. Recordings follow one another. With
    ``used``, phases that a calibration used and phases that it left out are distinguished.
    """
    from matplotlib.lines import Line2D

    units = {
        name: getattr(record, f"{name}_unit")
        for name in ("gyro", "accel")
        for record in records
        if getattr(record, name) is not None
    }
    levels = {name: level for name, level in _LEVELS.items() if name != "left out" or any(p.why for p in pieces)}
    labels = [f"{name} ({_SHOWN_UNIT.get(unit, unit)})" for name, unit in units.items()]
    x = "time (s)" + ", recordings one after the other" * (len(records) > 1)
    ratios = [0.22 * len(levels)] + [1.0] * len(units)
    figure, (strip, *panels) = new_figure("", *labels, x=x, title=title, height_ratios=ratios)
    figure.set_figheight(0.9 + 0.3 * len(levels) + 1.75 * len(units))
    strip.set(yticks=list(levels.values()), yticklabels=list(levels), ylim=(min(levels.values()) - 0.4, 2.95))
    strip.grid(False)
    strip.spines[["left", "bottom"]].set_visible(False)
    strip.tick_params(left=False, bottom=False, labelbottom=False)
    marks: dict[str, Any] = {
        axis: Line2D([], [], **axis_style(k, marked=True) | {"markevery": None}) for k, axis in enumerate(AXES)
    }
    lengths_s = [record.duration_s + 1.0 / record.sample_rate_hz for record in records]
    start = float(records[0].time[0]) if len(records) == 1 else 0.0  # a single recording keeps its clock
    strip.set_xlim(start, start + sum(lengths_s))
    for number, record in enumerate(records):
        time = record.time - record.time[0] + start
        for axes in (strip, *panels) if number else ():
            axes.axvline(start, color=LIMIT, linewidth=0.6, linestyle=":")
        _draw_pieces(strip, panels, time, [piece for piece in pieces if piece.recording == number])
        for panel, name in zip(panels, units, strict=True):
            if (values := getattr(record, name)) is not None:
                marks |= _draw_readings(panel, time, values)
        marks |= _draw_gaps(panels, time, record)
        start += lengths_s[number]
    legend_outside(figure, marks | _counted(pieces, used=used))
    return figure


def _draw_readings(panel: "Axes", time: FloatArray, values: FloatArray) -> dict[str, Any]:
    """Draw three axes (N, 3) and their saturated readings. Return a mark for the legend."""
    marks: dict[str, Any] = {}
    for k, column in enumerate(values.T):
        draw_course(panel, time, column, linewidth=0.7, **axis_style(k, marked=True))
        for limit, stuck in saturated_runs(column):
            at = np.concatenate([np.arange(start, stop) for start, stop in stuck])
            style: Any = {"color": SATURATED, "marker": "s", "linestyle": "none", "markersize": 2.5}
            (marks["saturated"],) = panel.plot(time[at], np.full(len(at), limit), **style)
    return marks


def _draw_gaps(panels: Sequence["Axes"], time: FloatArray, record: Record) -> dict[str, Any]:
    """Draw stretches without readings and gaps in time. Return a mark for the legend."""
    gap = np.zeros(len(record), np.bool_)
    for values in (record.gyro, record.accel):
        gap |= False if values is None else np.isnan(values).any(axis=1)
    steps = np.diff(record.time)
    holes = np.flatnonzero(steps > 1.5 * np.median(steps))
    spans = [*(runs(gap) - (0, 1)).tolist(), *np.stack((holes, holes + 1), axis=1).tolist()]
    for start, stop in spans:
        for panel in panels:
            mark = panel.axvspan(
                float(time[start]), float(time[stop]), color=OPTICS, alpha=0.7, linewidth=0.8, zorder=3
            )
    return {"1 gap" if len(spans) == 1 else f"{len(spans)} gaps": mark} if spans else {}


def _piece_style(piece: "Piece") -> dict[str, Any]:
    """Return the style of a phase. Omitted phases are hatched."""
    style = {"facecolor": DEVICE if piece.kind == "still" else ERROR, "edgecolor": "white", "linewidth": 0.6}
    return style | ({"alpha": 0.5, "hatch": "////"} if piece.why else {})


def _draw_pieces(strip: "Axes", panels: Sequence["Axes"], time: FloatArray, pieces: Sequence["Piece"]) -> None:
    """Draw a bar for each piece of a recording, with its label if there is space, and shade each still."""
    width_s, labelled_to = float(np.ptp(strip.get_xlim())), dict.fromkeys(_LEVELS.values(), float(time[0]) - 1e9)
    for piece in pieces:
        start, stop = float(time[piece.start]), float(time[piece.stop - 1])
        level = _LEVELS["left out" if piece.why else piece.kind]
        bar = (start, max(stop - start, 0.002 * width_s))
        strip.broken_barh([bar], (level - 0.26, 0.52), **_piece_style(piece))
        middle, reach = 0.5 * (start + stop), 0.5 * _ROOM * width_s * len(piece.label)
        if piece.label and not piece.why and middle - reach >= labelled_to[level]:
            strip.text(middle, level + 0.27, piece.label, ha="center", va="bottom", fontsize=7.0)
            labelled_to[level] = middle + reach
        for panel in panels if piece.kind == "still" and not piece.why else ():
            shade(panel, [(start, stop)])


def _counted(pieces: Sequence["Piece"], *, used: bool) -> dict[str, Any]:
    """Return a legend entry for each kind of phase, with its count. Omitted phases have their reasons."""
    from matplotlib.patches import Patch

    groups = dict[tuple[str, bool], list["Piece"]]()
    for piece in pieces:
        groups.setdefault((piece.kind, bool(piece.why)), []).append(piece)
    marks = dict[str, Any]()
    for (kind, out), group in sorted(groups.items()):
        reasons = Counter(piece.why for piece in group).most_common(_REASONS)
        end = "used" if used else "found"
        if out:
            end = "left out: " + ", ".join(f"{reason} ({count})" for reason, count in reasons)
        marks[f"{len(group)} {kind}{'s' * (len(group) > 1)} {end}"] = Patch(**_piece_style(group[0]))
    return marks


# ---- Allan deviation


def draw_allan(fit: "NoiseFit", *, title: str = "Overlapping Allan deviation") -> "Figure":
    """Draw Allan deviation over averaging time, with the band of its intervals and the fitted model."""
    units = {name: getattr(fit, f"{name}_unit") for name in ("gyro", "accel") if getattr(fit, name)}
    figure, panels = new_figure(
        *(f"Allan deviation ({unit})" for unit in units.values()), x="averaging time (s)", height=2.9,
        title=f"{title}, lines: observable terms of the model, band: 95 %",
    )  # fmt: skip
    for panel, name in zip(panels, units, strict=True):
        for k, axis in enumerate(getattr(fit, name)):
            _draw_deviation(panel, axis, name, k)
            taus_s = axis.curve.taus_s
            panel.plot(taus_s, np.sqrt(sum(axis.terms(taus_s).values())), **axis_style(k), linewidth=0.9)
        legend_above(panel)
    return figure


def _draw_deviation(panel: "Axes", axis: "AxisNoise", name: str, k: int) -> None:
    """Draw the deviations of an axis and the band of their intervals."""
    curve, style = axis.curve, {"color": AXIS_COLOURS[k], "linewidth": 0.0}
    panel.fill_between(curve.taus_s, curve.lower, curve.upper, alpha=0.18, **style)  # type: ignore[arg-type]
    marks: Any = style | {"marker": AXIS_MARKERS[k], "markersize": 3.5}
    panel.plot(curve.taus_s, curve.deviation, label=f"{name} {axis.axis}", **marks)
    panel.set(xscale="log", yscale="log")


def draw_allan_fit(fit: "NoiseFit", triad: str, terms: Mapping[str, str]) -> "Figure":
    """Draw each axis of a triad with the fitted line of each term, and a mark where its coefficient is read."""
    figure, panels = new_figure(
        *(f"{triad} {axis} ({getattr(fit, f'{triad}_unit')})" for axis in AXES), x="averaging time (s)", height=2.1,
        title="Allan deviation and its terms. Each mark shows the point at which a coefficient is read.",
    )  # fmt: skip
    dashes = dict(zip(terms, (("-.", "D", 1.0), ("--", "s", None), (":", "^", 3.0)), strict=True))
    for k, (panel, axis) in enumerate(zip(panels, getattr(fit, triad), strict=True)):
        _draw_deviation(panel, axis, triad, k)
        taus_s = axis.curve.taus_s
        parts, low = axis.terms(taus_s), float(np.nanmin(axis.curve.lower))
        total = np.sqrt(sum(parts.values()))
        panel.plot(taus_s, total, color=OPTICS, linewidth=0.9, label="sum of the terms")
        for name, (dash, marker, term_tau_s) in dashes.items():
            if (line := np.sqrt(parts[name])).any():
                at = float(taus_s[total.argmin()]) if term_tau_s is None else term_tau_s
                far = (line > 0.5 * low) | (taus_s >= 0.5 * at if name == "rate_random_walk" else False)
                panel.plot(taus_s, np.where(far, line, np.nan), color=LIMIT, linestyle=dash, label=terms[name])
                panel.plot(at, np.sqrt(axis.terms(np.array([at]))[name]), marker=marker, color=LIMIT, markersize=5.0)
        legend_above(panel)
    return figure


# ---- a study and the note's Figure 3


def draw_sessions(outcome: "StudyOutcome") -> "Figure":
    """Draw the error of each session against its duration: mean and 95th percentile of the devices, with a panel per task."""
    labels = ["error (deg)"] * len(outcome.tasks)
    figure, panels = new_figure(*labels, x="session (min)", height=2.4)
    for panel, task in zip(panels, outcome.tasks, strict=True):
        rows = [row for row in task.sessions if np.isfinite(row.mean_deg)]
        minutes = [max(row.session.length_min, 0.5) for row in rows]
        panel.plot(minutes, [row.mean_deg for row in rows], "o", color=DEVICE, label="mean")
        style: Any = {"color": ERROR, "markersize": 12.0, "label": "95 % of devices below"}
        panel.plot(minutes, [row.quantile_deg for row in rows], "_", **style)
        for place, k in enumerate(np.argsort(minutes, kind="stable")):  # names of neighbours alternate above and below
            text: Any = {"xytext": (4.0, -9.0 if place % 2 else 3.0), "textcoords": "offset points", "fontsize": 7}
            panel.annotate(rows[k].session.name, (minutes[k], rows[k].mean_deg), **text)
        for target in outcome.study.target_deg:
            panel.axhline(target, color=OPTICS, linewidth=0.7, linestyle="--")
        panel.set(xscale="log", yscale="log")
        panel.set_title(task.task.key.replace("_", " "), loc="left", fontsize=9)
    legend_outside(figure, named(panels[0]))
    return figure


def draw_figure3(figure3: "Figure3", names: Sequence[str]) -> "Figure":
    """Draw the note's Figure 3: pitch, errors for each compensation, simulated versus actual, largest errors."""
    labels = ("pitch (deg)", "error (deg)", "difference (deg)", "largest error (deg)")
    figure, panels = new_figure(*labels, x="left: simulated, right: actual", height=1.75, sharex=False)
    pitch, error, difference, largest = panels
    pitch.plot(figure3.time, figure3.reference_pitch, color=OPTICS)
    for limit in (-0.15, 0.15):
        difference.axhline(limit, color=OPTICS, linewidth=0.7, linestyle=":")
    lines = dict[str, Any]()
    for k, name in enumerate(names):
        (lines[name],) = error.plot(figure3.time, figure3.actual[k], **level_style(k))
        error.plot(figure3.time, figure3.simulated[k], **level_style(k), linestyle="--")
        difference.plot(figure3.time, figure3.actual[k] - figure3.simulated[k], **level_style(k))
        mark: Any = {"marker": "D", "markersize": 4.5, "color": LEVEL_COLOURS[k]}
        largest.plot(k - 0.18, figure3.simulated_max_deg[k], markerfacecolor="white", **mark)
        largest.plot(k + 0.18, figure3.actual_max_deg[k], **mark)
    titles = (
        "sit-to-stand by the optics",
        "error: actual solid, simulated dashed",
        "actual minus simulated (dotted: 0.15 deg, from the note)",
        "of the typical unit",
    )
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, loc="left", fontsize=LEAST_SIZE)
    difference.set_xlabel("time (s)")
    largest.set_axisbelow(True)
    largest.set(yscale="log", xticks=range(len(names)), xticklabels=[""] * len(names))
    largest.margins(y=0.1)
    legend_outside(figure, lines)
    return figure


# ---- validation, twin and rig


def draw_bars(names: Sequence[str], values: Mapping[str, Sequence[float]], *, title: str, label: str) -> "Figure":
    """Draw a group of bars for each name, with one bar per row of values (n,)."""
    height = 0.5 + 0.18 * len(names) * (len(values) + 1)
    figure, (axes,) = new_figure("", x=label, title=title, height=height)
    width = 0.8 / len(values)
    styles = zip((LIMIT, ERROR, DEVICE, OPTICS), ("", "///", "", "..."), strict=True)
    bars = dict[str, Any]()
    for k, ((row, lengths), (colour, hatch)) in enumerate(zip(values.items(), styles, strict=False)):
        places = np.arange(len(names)) + (k + 0.5) * width - 0.4
        bars[row] = axes.barh(places, lengths, width, color=colour, hatch=hatch, edgecolor="white", linewidth=0.4)
    _name_rows(axes, names)
    axes.set_axisbelow(True)
    legend_outside(figure, bars)
    return figure


def _name_rows(axes: "Axes", names: Sequence[str]) -> None:
    """Write names at the positions 0, 1, 2 and so on, from the top."""
    axes.set_yticks(range(len(names)), [textwrap.fill(name, 20) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)


def draw_validation(result: "Validation") -> "Figure":
    """Draw the errors of each trial: total, inclination and pitch, root mean square."""
    names = [trial.recording for trial in result.trials]
    keys = {"total": "rmse_total_deg", "inclination": "rmse_inclination_deg", "pitch": "rmse_pitch_deg"}
    values = {name: [getattr(trial.figures, key) for trial in result.trials] for name, key in keys.items()}
    return draw_bars(names, values, title="Errors against the reference", label="rms over the motion (deg)")


def draw_people_agreement(table: "LevelTable", summary: "LevelSummary") -> "Figure":
    """Draw difference against level, one point per person, with the bias and the 95 % limits of Bland and Altman."""
    errors = next(row for row in table.errors if (row.level, row.method) == (summary.level, summary.method))
    people = [trial.person for trial in table.trials]
    judged = np.asarray(np.isfinite(errors.measure_deg).all(axis=1))
    names = dict.fromkeys(person for person, valid in zip(people, judged.tolist(), strict=True) if valid)
    means = np.array([errors.measure_deg[judged & (np.array(people) == name)].mean(axis=0) for name in names])
    if summary.agreement is None:
        raise InputError("agreement: expected ten people or more, got fewer. Add people.")
    bias_deg, limits_deg = summary.agreement.bias, summary.agreement.limits
    x = "mean of device and optics (deg), one point per person"
    figure, (axes,) = new_figure("device - optics (deg)", x=x, height=3.0)
    axes.scatter(means.mean(axis=1), means[:, 0] - means[:, 1], color=DEVICE, s=28)
    axes.axhline(bias_deg, color=ERROR)
    for limit in limits_deg:
        axes.axhline(limit, color=LIMIT, linestyle="--")
    where: Any = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
    axes.annotate(f"bias {bias_deg:+.2f} deg", (1.0, bias_deg), **where)
    return figure


def draw_level_errors(table: "LevelTable") -> "Figure":
    """Draw the errors at each level of correction: every trial with each method, simulated devices, and means over people, 95 %."""
    summaries = [row for row in table.summaries if row.group == "all" and row.people]
    levels = list(dict.fromkeys(row.level for row in summaries))
    title = f"Levels of correction: {table.quantity} error, rms over the motion"
    figure, (panel,) = new_figure("", x="error (deg)", title=title, height=0.7 + 0.45 * len(levels))
    places = {
        (row.level, row.method): levels.index(row.level) + (0.18 if row.method == "vqf" else -0.18) for row in summaries
    }
    for errors in table.errors:
        if (place := places.get((errors.level, errors.method))) is None:
            continue
        vqf, dots = errors.method == "vqf", {"markersize": 3.5, "alpha": 0.6}
        series = [("VQF" if vqf else "gyroscopes", errors.error_deg, place, ERROR if vqf else DEVICE, "o")]
        if not vqf and np.isfinite(errors.simulated_deg).any():
            series.append(("simulated", errors.simulated_deg, place + 0.36, LIMIT, "d"))
        for label, values, at, colour, marker in series:
            panel.plot(values, np.full(len(values), at), marker, color=colour, label=label, **dots)  # type: ignore[arg-type]
    for row in summaries:
        below, above = row.mean_deg - row.interval_deg[0], row.interval_deg[1] - row.mean_deg
        reach = np.nan_to_num([[min(below, 0.9 * row.mean_deg)], [above]])  # a logarithmic axis has no zero
        style: Any = {"fmt": "|", "color": OPTICS, "capsize": 2.0, "label": "mean over people, 95 %"}
        panel.errorbar([row.mean_deg], [places[row.level, row.method]], xerr=reach, **style)
    _name_rows(panel, levels)
    panel.set_xscale("log")
    legend_above(panel)
    return figure


def draw_held_out(trials: Sequence["HeldOutTrial"]) -> "Figure":
    """Draw the largest pitch differences in windows: all windows, and the median of each recording."""
    title = f"Held out: largest pitch difference in windows of {trials[0].window_s:g} s"
    x, height = "pitch, simulated minus real (deg)", 0.6 + 0.35 * len(trials)
    figure, (panel,) = new_figure("", x=x, title=title, height=height)
    for k, trial in enumerate(trials):
        errors = trial.pitch[np.isfinite(trial.pitch)] / RADIAN_PER_DEGREE
        panel.plot(errors, np.full(len(errors), k), "|", color=LIMIT, markersize=8.0, label="window")
        panel.plot(np.median(errors), k, "D", color=DEVICE, label="median")
    _name_rows(panel, [f"{trial.recording} {trial.window_s:g} s" for trial in trials])
    panel.set_xlim(0.0, None)
    legend_above(panel)
    return figure


def draw_rig_run(turns: "Sequence[RecordedDwell]") -> "Figure":
    """Draw achieved minus nominal rate of each dwell of a rig run, with 95 % uncertainty."""
    title = "Achieved minus nominal rate of each dwell, 95 %"
    figure, (panel,) = new_figure("difference (deg/s)", x="nominal rate (deg/s)", title=title, height=2.2)
    for k, axis in enumerate(AXES):
        names = ("nominal_turn_rate", "turn_rate", "turn_rate_uncertainty")
        rows = [[getattr(turn, name) for name in names] for turn in turns if turn.axis == axis]
        style: Any = {"color": AXIS_COLOURS[k], "fmt": AXIS_MARKERS[k], "markersize": 4.0, "capsize": 2.0}
        if rows:
            nominal, achieved, uncertainty = np.array(rows).T / RADIAN_PER_DEGREE
            panel.errorbar(nominal, achieved - nominal, yerr=1.96 * uncertainty, label=f"about {axis}", **style)
    panel.axhline(0.0, color=OPTICS, linewidth=0.6)
    legend_above(panel)
    return figure
