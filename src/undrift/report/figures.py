"""Pictures: each function draws a result as a matplotlib Figure. :func:`svg_of` converts it to text for a page or a
file.

Colours keep one meaning throughout: the device in blue, the optics in black, errors in orange, limits in grey. Axes x,
y and z and levels of compensation also have a dash or a marker, because some readers cannot distinguish the colours.
Figures are 4.8 inches wide, so that their text keeps 9 pixels on a screen of 390.
"""

import io
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import escape

from undrift.arrays import BoolArray, FloatArray, runs
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
    from undrift.study.judge import StudyOutcome
    from undrift.twin.held_out import HeldOutTrial
    from undrift.validation.agreement import Validation
    from undrift.validation.levels import LevelSummary, LevelTable
    from undrift.validation.trial import Trial

# ---- envelope: few enough points to draw, with the least and largest value of every column

COLUMNS_DRAWN = 1200  # more than a picture shows apart


def envelope(time: FloatArray, values: FloatArray, columns: int = COLUMNS_DRAWN) -> tuple[FloatArray, FloatArray]:
    """Return the points of a curve that its picture needs: the least and the largest of each column, in order of time.
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


# ---- figures

DEVICE, OPTICS, ERROR, LIMIT = "#1f5fa8", "#222222", "#c2500f", "#767676"
SHADE = "#f1efe8"  # behind a stretch that the figures are taken over

_UNDATED: Any = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same bytes for the same figure
AXIS_COLOURS = ("#cc3311", "#007d5e", "#2b62b3")  # x, y, z
AXIS_DASHES, AXIS_MARKERS = ("-", "--", ":"), ("o", "s", "^")
WIDTH, LEAST_SIZE = 4.8, 8.7  # inches, and points of the smallest text
_LABELS_PT = 56.0  # width of the labels of an axis next to a panel
_STYLE: Any = {  # matplotlib types every key by name
    "font.size": 9.0,
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


def new_figure(
    rows: int, *, height: float = 2.0, columns: int = 1, share_x: bool = True, width: float = WIDTH
) -> tuple["Figure", list["Axes"]]:
    """Return an empty figure in the house style."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        figure = _notebook_figure()(figsize=(width, 0.4 + height * rows), layout="constrained")
        grid = np.asarray(figure.subplots(rows, columns, sharex="col" if share_x else False, squeeze=False))
    return figure, list(grid.ravel())


@cache
def _notebook_figure() -> type["Figure"]:
    """Return matplotlib's Figure in a form that notebooks show without pyplot."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    class NotebookFigure(Figure):
        def draw(self, renderer: Any) -> None:
            # the saved figure has a fixed layout, because a second layout would waste the first drawing
            if isinstance(layout := self.get_layout_engine(), ConstrainedLayoutEngine) and self.canvas.is_saving():
                layout.execute(self)
            else:
                super().draw(renderer)

        def _repr_png_(self) -> bytes:
            return _saved(self, format="png", dpi=80)

    return NotebookFigure


def svg_of(figure: "Figure", *, outlines: bool = False) -> str:
    """Return a figure as SVG text with a description. The same figure gives the same bytes. Letters are outlines,
    independent of fonts.
    """
    from matplotlib.text import Text

    for label in figure.findobj(Text):
        label.set_fontsize(max(label.get_fontsize(), LEAST_SIZE))
    fonts = {"svg.fonttype": "path"} if outlines else {}
    text = _saved(figure, fonts, format="svg", metadata={"Date": None, "Creator": "undrift"}).decode()
    opening_tag = f'<svg role="img" aria-label="{escape(_describe_figure(figure))}" '
    return text[text.index("<svg") :].replace("<svg ", opening_tag, 1)


def _describe_figure(figure: "Figure") -> str:
    """Return the description of a figure: its title, and the labels of its axes."""
    heads = [
        str(figure.get_label()),
        figure.get_suptitle(),
        *(axes.get_title(loc) for axes in figure.axes for loc in ("left", "center")),
    ]
    title = next((head for head in heads if head), "")
    labels = (
        dict.fromkeys(filter(None, (getattr(axes, get)() for axes in figure.axes)))
        for get in ("get_ylabel", "get_xlabel")
    )
    described = " against ".join(filter(None, map(", ".join, labels)))
    return " ".join(": ".join(filter(None, (title, described))).split())


def axis_style(k: int, *, marked: bool = False) -> dict[str, Any]:
    """Return colour, and dash or a few markers, of the line of axis x, y or z."""
    marker: dict[str, Any] = {"marker": AXIS_MARKERS[k], "markevery": (0.05 * k, 0.15), "markersize": 4.0}
    return {"color": AXIS_COLOURS[k]} | (marker if marked else {"linestyle": AXIS_DASHES[k]})


def entitle(figure: "Figure", title: str) -> None:
    """Write a title over the whole figure, in lines that fit."""
    lines, _ = _wrap_text(title, 0.98 * 72.0 * figure.get_figwidth(), 10.0)
    figure.suptitle(lines, x=0.01, ha="left", fontsize=10)


def legend_above(axes: "Axes") -> None:
    """Write a legend between the panel and the content above it, each name once, in as many columns as fit."""
    handles, names = axes.get_legend_handles_labels()
    once = dict(zip(reversed(names), reversed(handles), strict=True))
    names = [*reversed(once)]
    handles = [once[name] for name in names]
    across = axes.get_subplotspec().get_gridspec().ncols if axes.get_subplotspec() else 1  # type: ignore[union-attr]
    room_pt = 72.0 * axes.figure.bbox.width / axes.figure.dpi / across - _LABELS_PT
    where: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, "frameon": False}
    axes.legend(handles=handles, **_fit_legend(names, room_pt), **where)


def legend_outside(figure: "Figure", handles: Sequence[Any], names: Sequence[str], where: str = "lower left") -> None:
    """Write a legend next to all panels, in as many columns as fit."""
    style: Any = _fit_legend(names, 72.0 * figure.get_figwidth()) | {"loc": f"outside {where}", "frameon": False}
    figure.legend(handles=list(handles), **style)


def _fit_legend(names: Sequence[str], room_pt: float) -> dict[str, Any]:
    """Return the labels of a legend in lines that fit, and how many columns of them do."""
    size = 9.0  # legend spaces are in units of the font size: a handle with its gaps 4, the frame 1.5
    labels, widths = zip(*(_wrap_text(name, room_pt - 5.5 * size, size) for name in names), strict=True)
    columns = int((room_pt - 0.3 * size) / (max(widths) + 4.0 * size))
    return {"labels": labels, "ncols": min(max(columns, 1), len(labels)), "fontsize": size, "columnspacing": 1.2}


def _wrap_text(text: str, room_pt: float, size: float) -> tuple[str, float]:
    """Return a text in lines that fit a width, and the longest of them, points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size)
    for letters in range(max(len(text), 9), 7, -1):
        wrapped = textwrap.fill(text, letters)
        widths = [text_to_path.get_text_width_height_descent(line, font, False)[0] for line in wrapped.splitlines()]
        if max(widths, default=0.0) <= room_pt:
            break
    return wrapped, max(widths, default=0.0)


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as SVG, PNG or PDF, by the ending of the name."""
    if path.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise InputError(f"{path}: expected a name ending in .svg, .png or .pdf. Change the ending.")
    kind = path.suffix[1:].lower()
    write_whole(path, _saved(figure, dpi=130, format=kind, metadata=_UNDATED.get(kind)))


def _plain_log(axes: "Axes") -> None:
    """Label logarithmic axes by plain numbers: the powers of a formula are too small to read."""
    from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        if isinstance(axis.get_major_formatter(), LogFormatter):
            axis.set_major_locator(LogLocator(numticks=7))
            low, high = axis.get_view_interval()
            plain = FuncFormatter(lambda x, _: f"{x:g}")
            axis.set_major_formatter(plain)
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            axis.set_minor_formatter(plain if high < 100.0 * low else NullFormatter())


def _saved(figure: "Figure", style: Any = None, **how: Any) -> bytes:
    import matplotlib as mpl
    from matplotlib.text import Text

    for axes in figure.axes:
        _plain_log(axes)
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # a dollar in the name of a file is a dollar
    buffer = io.BytesIO()
    with mpl.rc_context(_STYLE | (style or {})):
        figure.savefig(buffer, **how)
    return buffer.getvalue()


def draw_comparison(
    time: FloatArray,
    device_deg: FloatArray,
    optics_deg: FloatArray,
    errors_deg: Sequence[tuple[str, FloatArray]],
    *,
    title: str,
    moving: BoolArray | None = None,
) -> "Figure":
    """Draw an angle measured with device and optics, with the errors below. time (N,) s, device_deg (N,) deg,
    optics_deg (N,) deg, errors_deg (N,) deg, moving (N,).
    """
    figure, (angle, error) = new_figure(2)
    angle.plot(*envelope(time, _without_wraps(optics_deg)), color=OPTICS, label="optics")
    angle.plot(*envelope(time, _without_wraps(device_deg)), color=DEVICE, label="device", linestyle="--")
    angle.set_ylabel("pitch (deg)")
    entitle(figure, title)
    legend_above(angle)
    styles = zip((ERROR, DEVICE, LIMIT, OPTICS), ("-", "--", ":", "-."), strict=True)
    for (name, course), (colour, dash) in zip(errors_deg, styles, strict=False):
        error.plot(*envelope(time, course), color=colour, linestyle=dash, label=name)
    for start, stop in () if moving is None else runs(moving):
        error.axvspan(float(time[start]), float(time[stop - 1]), color=SHADE, linewidth=0.0, zorder=0)
    error.axhline(0.0, color=OPTICS, linewidth=0.6)
    error.set(xlabel="time (s)", ylabel="error (deg)")
    legend_above(error)
    return figure


def _without_wraps(angle_deg: FloatArray) -> FloatArray:
    """Return the angle with a gap where it jumps from +180 to -180 deg, so that no line is drawn across."""
    angle = np.array(angle_deg)
    angle[1:][np.abs(np.diff(angle_deg)) > 180.0] = np.nan
    return angle


# ---- a recording, and what was found in it

SATURATED = "#b0198f"
_ROOM = 0.0088  # of the width of the picture, for each letter of a label
_REASONS = 4  # that the caption lists
_LEVELS = {"still": 2.0, "turn": 1.0, "left out": 0.0}
_SHOWN_UNIT = {"dps": "deg/s", "count": "counts"}


def draw_recording(records: Sequence[Record], pieces: Sequence["Piece"], *, title: str, used: bool = False) -> "Figure":
    """Draw readings over time with their stills, faces, turns, gaps and saturation. Recordings follow one another. With
    ``used``, phases that a calibration used and phases that it left out are distinguished.
    """
    from matplotlib.lines import Line2D

    names = [name for name in ("gyro", "accel") if any(getattr(record, name) is not None for record in records)]
    figure, (strip, *panels) = _strip_and_panels(len(names), pieces)
    starts, marks = _one_after_the_other(records), dict[str, Any]()
    labelled_to = dict.fromkeys(_LEVELS.values(), -np.inf)
    for number, record in enumerate(records):
        time = record.time - record.time[0] + starts[number]
        phases = [piece for piece in pieces if piece.recording == number]
        _draw_pieces(strip, panels, time, phases, starts[-1] - starts[0], labelled_to)
        for panel, name in zip(panels, names, strict=True):
            marks |= {} if getattr(record, name) is None else _draw_readings(panel, time, getattr(record, name))
        marks |= _draw_gaps(panels, time, record)
        for axes in (strip, *panels) if number else ():
            axes.axvline(starts[number], color=LIMIT, linewidth=0.6, linestyle=":")
    for panel, name in zip(panels, names, strict=True):
        unit = next(getattr(record, f"{name}_unit") for record in records if getattr(record, name) is not None)
        panel.set_ylabel(f"{name} ({_SHOWN_UNIT.get(unit, unit)})")
    panels[-1].set(xlabel="time (s)" + ", recordings one after the other" * (len(records) > 1))
    panels[-1].set_xlim(starts[0], starts[-1])
    room_pt = 72.0 * figure.get_figwidth() - _LABELS_PT
    strip.set_title(_wrap_text(title, room_pt, 10.0)[0], loc="left", fontsize=10)
    lines = {axis: Line2D([], [], **axis_style(k, marked=True) | {"markevery": None}) for k, axis in enumerate(AXES)}
    _add_legend(figure, pieces, lines | marks, used=used)
    return figure


def _strip_and_panels(panels: int, pieces: Sequence["Piece"]) -> tuple["Figure", list["Axes"]]:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    levels = {name: level for name, level in _LEVELS.items() if name != "left out" or any(p.why for p in pieces)}
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(8.2, 0.9 + 0.3 * len(levels) + 1.75 * panels), layout="constrained")
        ratios = {"height_ratios": [0.22 * len(levels)] + [1.0] * panels}
        grid = figure.subplots(1 + panels, 1, sharex=True, squeeze=False, gridspec_kw=ratios)[:, 0]
    grid[0].set(yticks=list(levels.values()), yticklabels=list(levels), ylim=(min(levels.values()) - 0.4, 2.95))
    grid[0].grid(False)
    grid[0].spines[["left", "bottom"]].set_visible(False)
    grid[0].tick_params(left=False, bottom=False, labelbottom=False)
    return figure, list(grid)


def _one_after_the_other(records: Sequence[Record]) -> list[float]:
    """Return the drawing time of each recording, and the end of the last, s. A single recording keeps its clock."""
    starts = [float(records[0].time[0]) if len(records) == 1 else 0.0]
    for record in records:
        starts.append(starts[-1] + float(record.time[-1] - record.time[0]) + 1.0 / record.sample_rate_hz)
    return starts


def _draw_readings(panel: "Axes", time: FloatArray, values: FloatArray) -> dict[str, Any]:
    """Draw three axes (N, 3) and their saturated readings. Return a mark for the legend."""
    from matplotlib.lines import Line2D

    style: Any = {"color": SATURATED, "marker": "s", "linestyle": "none"}
    marks: dict[str, Any] = {}
    for k, column in enumerate(values.T):
        panel.plot(*envelope(time, column), linewidth=0.7, **axis_style(k, marked=True))
        for limit, stuck in saturated_runs(column):
            at = np.concatenate([np.arange(start, stop) for start, stop in stuck])
            panel.plot(time[at], np.full(len(at), limit), markersize=2.5, **style)
            marks["saturated"] = Line2D([], [], markersize=4.0, **style)
    return marks


def _draw_gaps(panels: Sequence["Axes"], time: FloatArray, record: Record) -> dict[str, Any]:
    """Draw stretches without readings and gaps in time. Return a mark for the legend."""
    from matplotlib.patches import Patch

    gap = np.zeros(len(record), np.bool_)
    for values in (record.gyro, record.accel):
        gap |= False if values is None else np.isnan(values).any(axis=1)
    steps = np.diff(record.time)
    holes = np.flatnonzero(steps > 1.5 * np.median(steps))
    spans = [*(runs(gap) - (0, 1)).tolist(), *np.stack((holes, holes + 1), axis=1).tolist()]
    for start, stop in spans:
        for panel in panels:
            panel.axvspan(float(time[start]), float(time[stop]), color=OPTICS, alpha=0.7, linewidth=0.8, zorder=3)
    return {"1 gap" if len(spans) == 1 else f"{len(spans)} gaps": Patch(color=OPTICS, alpha=0.7)} if spans else {}


def _draw_pieces(
    strip: "Axes",
    panels: Sequence["Axes"],
    time: FloatArray,
    pieces: Sequence["Piece"],
    duration_s: float,
    labelled_to: dict[float, float],
) -> None:
    """Draw a bar for each piece, its label where there is room, and a shade behind each still.

    The end of the last label at each level, s, is updated.
    """
    for piece in pieces:
        start, stop = float(time[piece.start]), float(time[piece.stop - 1])
        level = _LEVELS["left out" if piece.why else piece.kind]
        bar: Any = {"facecolor": DEVICE if piece.kind == "still" else ERROR, "edgecolor": "white", "linewidth": 0.6}
        bar |= {"alpha": 0.5, "hatch": "////"} if piece.why else {}
        strip.broken_barh([(start, max(stop - start, 0.002 * duration_s))], (level - 0.26, 0.52), **bar)
        middle, reach = 0.5 * (start + stop), 0.5 * _ROOM * duration_s * len(piece.label)
        if piece.label and not piece.why and middle - reach >= labelled_to[level]:
            strip.text(middle, level + 0.27, piece.label, ha="center", va="bottom", fontsize=7.0)
            labelled_to[level] = middle + reach
        if piece.kind == "still" and not piece.why:
            for panel in panels:
                panel.axvspan(start, stop, color=SHADE, linewidth=0.0, zorder=0)


def _add_legend(figure: "Figure", pieces: Sequence["Piece"], marks: dict[str, Any], *, used: bool) -> None:
    """Add a legend with counts. Add the reasons for omitted phases below the picture."""
    from matplotlib.patches import Patch

    reasons = Counter[tuple[str, str]]()
    for kind, colour in (("still", DEVICE), ("turn", ERROR)):
        accepted = [piece for piece in pieces if piece.kind == kind and not piece.why]
        out = [piece for piece in pieces if piece.kind == kind and piece.why]
        style: Any = {"facecolor": colour, "edgecolor": "white"}
        if accepted:
            marks[f"{len(accepted)} {kind}{'s' * (len(accepted) > 1)} {'used' if used else 'found'}"] = Patch(**style)
        if out:
            hatched = Patch(**style, hatch="////", alpha=0.5)
            marks[f"{len(out)} {kind}{'s' * (len(out) > 1)} left out"] = hatched
        reasons.update((kind, piece.why) for piece in out)
    legend_outside(figure, [*marks.values()], [*marks], "upper left")
    if reasons:
        listed = "; ".join(f"{n} {kind}{'s' * (n > 1)} ({why})" for (kind, why), n in reasons.most_common(_REASONS))
        figure.supxlabel(textwrap.fill(f"left out: {listed}", 110), fontsize=8, x=0.01, ha="left")


def draw_record(record: "Record") -> "Figure":
    """Draw the readings of a record over time: each triad and the temperature, in the unit of the record."""
    triads = (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit))
    triples: list[tuple[str, FloatArray, Sequence[str]]]
    triples = [(f"{name} ({unit})", np.asarray(values).T, AXES) for name, values, unit in triads if values is not None]
    if record.temp_c is not None:
        triples.append(("temperature (degC)", record.temp_c[None], ("",)))
    figure, panels = new_figure(len(triples), height=1.9)
    for axes, (label, courses, names) in zip(panels, triples, strict=True):
        for k, (course, name) in enumerate(zip(courses, names, strict=True)):
            style = axis_style(k, marked=True) if name else {"color": DEVICE}
            axes.plot(*envelope(record.time, course), label=name, linewidth=0.8, **style)
        axes.set_ylabel(label)
    legend_above(panels[0])
    entitle(figure, f"{record.device or 'record'}: {record.state}")
    panels[-1].set_xlabel("time (s)")
    return figure


def draw_orientation(orientation: "Orientation") -> "Figure":
    """Draw inclination, pitch with its 95 % limit, and heading over time, with the rest shaded."""
    band = orientation.pitch_limit
    angles = (("inclination", orientation.inclination), ("pitch", orientation.pitch), ("heading", orientation.heading))
    figure, panels = new_figure(3 if band is None else 4, height=1.5)
    for axes, (name, angle) in zip(panels, angles, strict=False):
        axes.plot(*envelope(orientation.time, degrees := _without_wraps(angle / RADIAN_PER_DEGREE)), color=DEVICE)
        if name == "pitch" and band is not None:
            few = slice(None, None, max(1, len(degrees) // COLUMNS_DRAWN))  # a band is smooth but where the pitch is
            low, high = (degrees[few] + sign * band[few] / RADIAN_PER_DEGREE for sign in (-1.0, 1.0))
            axes.fill_between(orientation.time[few], low, high, color=DEVICE, alpha=0.2, linewidth=0.0)
            panels[-1].plot(orientation.time[few], band[few] / RADIAN_PER_DEGREE, color=ERROR)
            panels[-1].set(ylabel="pitch, 95 %\nwithin (deg)", ylim=(0.0, None))
        axes.set_ylabel(f"{name} (deg)")
        if orientation.still is not None:
            rest_s = (float(orientation.time[k]) for k in (orientation.still.start, orientation.still.stop - 1))
            axes.axvspan(*rest_s, color=SHADE, zorder=0)
    panels[-1].set_xlabel("time (s)")
    return figure


def draw_bars(names: Sequence[str], values: Mapping[str, Sequence[float]], *, title: str, label: str) -> "Figure":
    """Draw a group of bars for each name, a bar for each row of values (n,)."""
    figure, (axes,) = new_figure(1, height=0.5 + 0.18 * len(names) * (len(values) + 1))
    width = 0.8 / len(values)
    styles = zip((LIMIT, ERROR, DEVICE, OPTICS), ("", "///", "", "..."), strict=True)
    for k, ((row, lengths), (colour, hatch)) in enumerate(zip(values.items(), styles, strict=False)):
        places = np.arange(len(names)) + (k + 0.5) * width - 0.4
        axes.barh(places, lengths, width, color=colour, hatch=hatch, edgecolor="white", linewidth=0.4, label=row)
    axes.set_yticks(np.arange(len(names)), [textwrap.fill(name, 20) for name in names])
    axes.set_axisbelow(True)
    axes.set(xlabel=label, ylim=(len(names) - 0.5, -0.5))
    entitle(figure, title)
    legend_outside(figure, *axes.get_legend_handles_labels())
    return figure


# ---- Allan deviation


def draw_allan(fit: "NoiseFit", *, title: str = "Overlapping Allan deviation") -> "Figure":
    """Draw Allan deviation over averaging time, with the band of its intervals and the fitted model."""
    triads = [name for name in ("gyro", "accel") if getattr(fit, name)]
    figure, panels = new_figure(len(triads), height=2.9)
    for panel, name in zip(panels, triads, strict=True):
        for k, axis in enumerate(getattr(fit, name)):
            _draw_deviation(panel, axis, name, k)
            taus_s = axis.curve.taus_s
            panel.plot(taus_s, np.sqrt(sum(axis.terms(taus_s).values())), **axis_style(k), linewidth=0.9)
        panel.set(xscale="log", yscale="log", ylabel=f"Allan deviation ({getattr(fit, f'{name}_unit')})")
        legend_above(panel)
    entitle(figure, f"{title}, lines: observable terms of the model, band: 95 %")
    panels[-1].set_xlabel("averaging time (s)")
    return figure


def _draw_deviation(panel: "Axes", axis: "AxisNoise", name: str, k: int) -> None:
    """Draw the deviations of an axis and the band of their intervals."""
    curve = axis.curve
    style: dict[str, Any] = {"color": AXIS_COLOURS[k], "linewidth": 0.0}
    panel.fill_between(curve.taus_s, curve.lower, curve.upper, alpha=0.18, **style)
    panel.plot(
        curve.taus_s, curve.deviation, marker=AXIS_MARKERS[k], markersize=3.5, label=f"{name} {axis.axis}", **style
    )


def draw_allan_fit(fit: "NoiseFit", triad: str, terms: Mapping[str, str]) -> "Figure":
    """Draw each axis of a triad with the fitted line of each term, and a mark where its coefficient is read."""
    figure, panels = new_figure(3, height=2.1)
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
                asymptote = np.where(far, line, np.nan)
                panel.plot(taus_s, asymptote, color=LIMIT, linestyle=dash, label=terms[name])
                panel.plot(at, np.sqrt(axis.terms(np.array([at]))[name]), marker=marker, color=LIMIT, markersize=5.0)
        panel.set(xscale="log", yscale="log", ylabel=f"{triad} {axis.axis} ({getattr(fit, f'{triad}_unit')})")
        legend_above(panel)
    entitle(figure, "Allan deviation and its terms. Each mark shows the point at which a coefficient is read.")
    panels[-1].set_xlabel("averaging time (s)")
    return figure


# ---- pictures of a study

COMPARED_COLOURS = (LIMIT, ERROR, DEVICE, "#9a6a00", "#3f8f4f")
COMPARED_MARKERS = ("o", "s", "^", "D", "v")


def compared_style(k: int) -> dict[str, Any]:
    """Return colour and a few markers of the line of a level of compensation."""
    style = {"color": COMPARED_COLOURS[k], "marker": COMPARED_MARKERS[k]}
    return {**style, "markevery": (0.03 * k, 0.15), "markersize": 4.0}


def draw_levels(trials: Sequence["Trial"]) -> "Figure":
    """Draw the pitch of the demo's worn trial, and its error at each level of correction, large and small: the motion shaded."""
    figure, (angle, error, small) = new_figure(3, height=1.7)
    angle.plot(*envelope(trials[0].time, trials[0].reference_pitch / RADIAN_PER_DEGREE), color=OPTICS)
    angle.set_ylabel("pitch (deg)")
    entitle(
        figure,
        "Optical pitch of a sit-to-stand task, and the pitch error at each level of correction. The motion is shaded.",
    )
    for k, trial in enumerate(trials):
        for panel in (error, small):
            course = envelope(trial.time, trial.error.pitch / RADIAN_PER_DEGREE)
            panel.plot(*course, label=trial.recording, **compared_style(k))
    for panel in (angle, error, small):
        for start, stop in runs(trials[0].moving):
            panel.axvspan(
                float(trials[0].time[start]), float(trials[0].time[stop - 1]), color=SHADE, linewidth=0.0, zorder=0
            )
    for panel in (error, small):
        panel.axhline(0.0, color=OPTICS, linewidth=0.6)
        panel.set_ylabel("error (deg)")
    small.set(xlabel="time (s)", ylim=(-0.3, 0.3), ylabel="error, to\n0.3 deg (deg)")
    legend_above(error)
    return figure


def draw_sessions(outcome: "StudyOutcome") -> "Figure":
    """Draw the error of each session against its duration: mean and 95th percentile of the devices, with a panel per
    task.
    """
    figure, panels = new_figure(len(outcome.tasks), height=2.4, share_x=True)
    for panel, task in zip(panels, outcome.tasks, strict=True):
        rows = [row for row in task.sessions if np.isfinite(row.mean_deg)]
        minutes = np.array([max(row.session.length_min, 0.5) for row in rows])
        panel.plot(minutes, [row.mean_deg for row in rows], "o", color=DEVICE, label="mean")
        panel.plot(
            minutes,
            [row.quantile_deg for row in rows],
            "_",
            color=ERROR,
            markersize=12.0,
            label="95 % of devices below",
        )
        for place, k in enumerate(np.argsort(minutes, kind="stable")):  # names of neighbours above and below
            at, above = (minutes[k], rows[k].mean_deg), place % 2 == 0
            panel.annotate(
                rows[k].session.name, at, xytext=(4.0, 3.0 if above else -9.0), textcoords="offset points", fontsize=7
            )
        for target in outcome.study.target_deg:
            panel.axhline(target, color=OPTICS, linewidth=0.7, linestyle="--")
        panel.set(xscale="log", yscale="log", ylabel="error (deg)")
        panel.set_title(task.task.key.replace("_", " "), loc="left", fontsize=9)
    panels[-1].set_xlabel("session (min)")
    legend_outside(figure, *panels[0].get_legend_handles_labels())
    return figure


# ---- validation


def trial_figure(trial: "Trial") -> "Figure":
    """Draw a trial over time: pitch of device and optics, and the errors, with the motion shaded."""
    return draw_comparison(
        trial.time,
        trial.sensor_pitch / RADIAN_PER_DEGREE,
        trial.reference_pitch / RADIAN_PER_DEGREE,
        [(name, getattr(trial.error, name) / RADIAN_PER_DEGREE) for name in ("total", "inclination", "pitch")],
        title=f"{trial.recording}: sagittal pitch",
        moving=trial.moving,
    )


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
    figure, (axes,) = new_figure(1, height=3.0)
    axes.scatter(means.mean(axis=1), means[:, 0] - means[:, 1], color=DEVICE, s=28)
    axes.axhline(bias_deg, color=ERROR)
    for limit in limits_deg:
        axes.axhline(limit, color=LIMIT, linestyle="--")
    where: Any = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
    axes.annotate(f"bias {bias_deg:+.2f} deg", (1.0, bias_deg), **where)
    axes.set(xlabel="mean of device and optics (deg), one point a person", ylabel="device - optics (deg)")
    return figure


def draw_level_errors(table: "LevelTable") -> "Figure":
    """Draw the errors at each level of correction: every trial by each method, simulated devices, and means over people, 95 %."""
    summaries = [row for row in table.summaries if row.group == "all" and row.people]
    levels = list(dict.fromkeys(row.level for row in summaries))
    methods = list(dict.fromkeys(row.method for row in summaries))
    figure, (panel,) = new_figure(1, height=0.7 + 0.45 * len(levels))
    entitle(figure, f"Levels of correction: {table.quantity} error, rms over the motion")
    series = [(name, "error_deg", -0.18 + 0.36 * k, (DEVICE, ERROR)[k], "o") for k, name in enumerate(methods)]
    if any(np.isfinite(row.simulated_deg).any() for row in table.errors):
        series.append((methods[0], "simulated_deg", 0.18, LIMIT, "d"))
    for method, column, shift, colour, marker in series:
        rows = [row for row in table.errors if row.method == method and row.level in levels]
        values = np.array([getattr(row, column) for row in rows])
        places = np.repeat([levels.index(row.level) + shift for row in rows], values.shape[1])
        label = "simulated" if column == "simulated_deg" else {"strapdown": "gyroscopes", "vqf": "VQF"}[method]
        panel.plot(values.ravel(), places, marker, color=colour, markersize=3.5, alpha=0.6, label=label)
    for number, row in enumerate(summaries):
        place = levels.index(row.level) - 0.18 + 0.36 * methods.index(row.method)
        below, above = (row.mean_deg - row.interval_deg[0], row.interval_deg[1] - row.mean_deg)
        # an axis of logarithms has no zero
        reach = np.nan_to_num([[min(below, 0.9 * row.mean_deg)], [above]])
        style: Any = {
            "fmt": "|",
            "color": OPTICS,
            "capsize": 2.0,
            "label": None if number else "mean over people, 95 %",
        }
        panel.errorbar([row.mean_deg], [place], xerr=reach, **style)
    panel.set_yticks(range(len(levels)), levels)
    panel.set(xlabel="error (deg)", xscale="log", ylim=(len(levels) - 0.5, -0.5))
    legend_above(panel)
    return figure


# ---- twin


def draw_held_out(trials: Sequence["HeldOutTrial"]) -> "Figure":
    """Draw the largest pitch differences in windows: every window, and the median of each recording."""
    figure, (panel,) = new_figure(1, height=0.6 + 0.35 * len(trials))
    entitle(figure, f"Held out: largest pitch difference in windows of {trials[0].window_s:g} s")
    for k, trial in enumerate(trials):
        errors = trial.pitch[np.isfinite(trial.pitch)] / RADIAN_PER_DEGREE
        panel.plot(
            errors, np.full(len(errors), k), "|", color=LIMIT, markersize=8.0, label="window" if k == 0 else None
        )
        panel.plot(np.median(errors), k, "D", color=DEVICE, label="median" if k == 0 else None)
    panel.set_yticks(
        range(len(trials)), [textwrap.fill(f"{trial.recording} {trial.window_s:g} s", 20) for trial in trials]
    )
    panel.set(xlabel="pitch, simulated minus real (deg)", xlim=(0.0, None), ylim=(len(trials) - 0.4, -0.6))
    legend_above(panel)
    return figure


# ---- rig


def draw_rig_run(turns: "Sequence[RecordedDwell]") -> "Figure":
    """Draw achieved minus nominal rate of each dwell of a rig run, with 95 % uncertainty."""
    figure, (panel,) = new_figure(1, height=2.2)
    entitle(figure, "Achieved minus nominal rate of each dwell, 95 %")
    for k, axis in enumerate(AXES):
        about = [piece for piece in turns if piece.axis == axis]
        nominal, achieved, uncertainty = (
            np.array([getattr(piece, name) for piece in about]) / RADIAN_PER_DEGREE
            for name in ("nominal_turn_rate", "turn_rate", "turn_rate_uncertainty")
        )
        style: Any = {"color": AXIS_COLOURS[k], "fmt": AXIS_MARKERS[k], "markersize": 4.0, "capsize": 2.0}
        if about:
            panel.errorbar(nominal, achieved - nominal, yerr=1.96 * uncertainty, label=f"about {axis}", **style)
    panel.axhline(0.0, color=OPTICS, linewidth=0.6)
    panel.set(xlabel="nominal rate (deg/s)", ylabel="difference (deg/s)")
    legend_above(panel)
    return figure
