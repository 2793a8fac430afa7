"""Pictures: each function draws one result as a matplotlib Figure; :func:`svg_of` turns it into text for a page or a file.

Colours keep one meaning throughout: the device in blue, the optics in black, errors in orange, limits in grey.
"""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.report.envelope import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEVICE, OPTICS, ERROR, LIMIT = "#1f5fa8", "#222222", "#d9641e", "#8a8a8a"
SHADE = "#f1efe8"  # behind a stretch that the figures are taken over
PICTURES = (".svg", ".png", ".pdf")
_UNDATED: Any = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}  # the same bytes for the same figure
AXIS_COLOURS = ("#c23b3b", "#2f8f4e", "#2b62b3")  # x, y, z
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
    rows: int, *, height: float = 2.3, columns: int = 1, share_x: bool = True
) -> tuple["Figure", list["Axes"]]:
    """Return an empty figure in the house style.

    Parameters
    ----------
    rows, height : int, float
        Panels one above the other, and the height of each in inches.
    columns : int
        Panels beside each other.
    share_x : bool
        One time axis for all.

    Returns
    -------
    figure : Figure
        8.2 inches wide.
    axes : list of Axes
        Row by row.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(8.2, 0.4 + height * rows), layout="constrained")
        made = np.asarray(figure.subplots(rows, columns, sharex="col" if share_x else False, squeeze=False))
    return figure, list(made.ravel())


def svg_of(figure: "Figure") -> str:
    """Return a figure as SVG text, the same bytes for the same figure.

    Parameters
    ----------
    figure : Figure
        What to draw.

    Returns
    -------
    str
        An <svg> element.
    """
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": "undrift"})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as SVG, PNG or PDF, by the ending of the name.

    Parameters
    ----------
    figure : Figure
        What to draw.
    path : Path
        Where to. It appears whole or not at all.

    Raises
    ------
    InputError
        Another ending.
    """
    import matplotlib as mpl

    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: wanted a name ending in .svg, .png or .pdf, got another; name the format so")
    buffer = io.BytesIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(buffer, dpi=130, format=path.suffix[1:].lower(), metadata=_UNDATED.get(path.suffix.lower()))
    write_whole(path, buffer.getvalue())


def draw_comparison(
    time: FloatArray,
    device_deg: FloatArray,
    optics_deg: FloatArray,
    errors_deg: Sequence[tuple[str, FloatArray]],
    *,
    title: str,
    moving: FloatArray | None = None,
) -> "Figure":
    """Draw an angle as the device and as the optics saw it, and the errors under it.

    A course longer than the picture shows apart is drawn by the least and the largest value of each column: a peak of one
    sample is in the picture.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    device_deg, optics_deg : array, shape (N,)
        The angle, deg; NaN where the optics saw nothing.
    errors_deg : sequence of (str, array of shape (N,))
        Name and course of each error, deg.
    title : str
        Heading.
    moving : array, shape (N,), or None
        1 within the motion, which is shaded in the errors' panel.

    Returns
    -------
    Figure
        Two panels.
    """
    figure, (angle, error) = new_figure(2)
    angle.plot(*envelope(time, _without_wraps(optics_deg)), color=OPTICS, label="optics")
    angle.plot(*envelope(time, _without_wraps(device_deg)), color=DEVICE, label="device", alpha=0.85)
    angle.set_ylabel("pitch (deg)")
    angle.set_title(title, loc="left", fontsize=10)
    angle.legend(loc="lower left", bbox_to_anchor=(0.75, 1.0), ncols=2, borderaxespad=0.2, frameon=False)
    colours = (ERROR, DEVICE, LIMIT, OPTICS)
    for (name, course), colour in zip(errors_deg, colours, strict=False):
        error.plot(*envelope(time, course), color=colour, label=name)
    for start, stop in _runs(time, moving):
        error.axvspan(start, stop, color=SHADE, linewidth=0.0, zorder=0)
    error.axhline(0.0, color=OPTICS, linewidth=0.6)
    error.set_ylabel("error (deg)")
    error.set_xlabel("time (s)")
    error.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(errors_deg), borderaxespad=0.2, frameon=False)
    return figure


def _runs(time: FloatArray, moving: FloatArray | None) -> list[tuple[float, float]]:
    """Return first and last instant of each stretch of motion, s."""
    if moving is None:
        return []
    marks = np.diff(np.concatenate(([0.0], moving > 0.0, [0.0])))
    starts, stops = np.flatnonzero(marks > 0.0), np.flatnonzero(marks < 0.0) - 1
    return [(float(time[a]), float(time[b])) for a, b in zip(starts, stops, strict=True)]


def _without_wraps(angle_deg: FloatArray) -> FloatArray:
    """Return the angle with a gap where it jumps from +180 to -180 deg, so that no line is drawn across."""
    shown = np.array(angle_deg)
    shown[1:][np.abs(np.diff(angle_deg)) > 180.0] = np.nan
    return shown


def draw_agreement(
    level_deg: FloatArray, difference_deg: FloatArray, bias_deg: float, limits_deg: tuple[float, float], *, unit: str
) -> "Figure":
    """Draw a Bland-Altman plot: difference against level, with the bias and its 95 % limits of agreement.

    Parameters
    ----------
    level_deg, difference_deg : array, shape (n,)
        One point a trial, deg.
    bias_deg : float
        Mean difference, deg.
    limits_deg : (float, float)
        Lower and upper limit, deg.
    unit : str
        What one point stands for.

    Returns
    -------
    Figure
        One panel.
    """
    figure, (axes,) = new_figure(1, height=3.0)
    axes.scatter(level_deg, difference_deg, color=DEVICE, s=28)
    axes.axhline(bias_deg, color=ERROR)
    for limit in limits_deg:
        axes.axhline(limit, color=LIMIT, linestyle="--")
    axes.annotate(
        f"bias {bias_deg:+.2f} deg", (1.0, bias_deg), xycoords=("axes fraction", "data"), ha="right", va="bottom"
    )
    axes.set_xlabel(f"mean of device and optics (deg), one point a {unit}")
    axes.set_ylabel("device - optics (deg)")
    return figure
