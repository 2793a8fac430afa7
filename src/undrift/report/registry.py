"""How a device changed between its calibrations: the picture and the page of ``undrift registry trend``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.base.summary import Origin, Section, table_section
from undrift.model import AXES
from undrift.registry.trend import Change, Dated, Step, headline
from undrift.report.figures import AXIS_COLOURS, AXIS_DASHES, AXIS_MARKERS, LIMIT, entitle, new_figure, svg_of
from undrift.report.page import write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"gyro": "gyroscopes", "accel": "accelerometers"}


def draw_trend(serial: str, first: Dated, course: Sequence[Step]) -> "Figure":
    """Draw scale factors and offsets of later calibrations less those of the first, with expanded uncertainty (k = 2) as bars."""
    from matplotlib import rc_context

    panels = [
        (sensor, what)
        for sensor in NAMES
        for what in ("scale", "offset")
        if any(one.sensor == sensor and one.parameter.startswith(what) for step in course for one in step.changes)
    ]
    figure, axes = new_figure(max(1, len(panels)), height=1.6)
    for panel, (sensor, what) in zip(axes, panels, strict=False):
        unit = ""
        for k, axis in enumerate(AXES):
            held = [
                (step, one)
                for step in course
                for one in step.changes
                if (one.sensor, one.parameter) == (sensor, f"{what} {axis}")
            ]
            unit = held[0][1].unit if held else unit
            dates = (first.made_at, *(step.until.made_at for step, _ in held))
            days = np.array([date.replace(tzinfo=None) for date in dates], dtype="datetime64[s]")
            values, spreads = (
                [0.0, *(one.change for _, one in held)],
                [0.0, *(2.0 * one.uncertainty for _, one in held)],
            )
            style: Any = {
                "color": AXIS_COLOURS[k],
                "linestyle": AXIS_DASHES[k],
                "marker": AXIS_MARKERS[k],
                "markersize": 3.5,
            }
            panel.errorbar(days, values, yerr=spreads, capsize=2.0, label=axis, **style)
        panel.axhline(0.0, color=LIMIT, linewidth=0.8)
        panel.set_ylabel(f"{what} ({unit})")
        panel.set_title(NAMES[sensor], loc="left", fontsize=9)
    if panels:
        axes[0].legend(ncols=3, loc="best")
    else:
        axes[0].text(0.5, 0.5, "no calibrations to compare", ha="center", transform=axes[0].transAxes)
    axes[-1].tick_params(axis="x", rotation=30)
    with rc_context({"text.parse_math": False}):  # a serial number is no formula
        entitle(figure, f"{serial}: change since {first.made_at:%Y-%m-%d} (bars: k = 2)")
    return figure


def write_trend_report(
    serial: str, first: Dated, steps: Sequence[Step], course: Sequence[Step], path: Path, origin: Origin
) -> None:
    """Write the page: what moved last, the picture, a table for each step, and what is not compared."""
    cells = (
        ("parameter", lambda one: f"{one.sensor} {one.parameter}"),
        ("change", lambda one: f"{one.change:+.3g}"),
        ("standard uncertainty", lambda one: f"{one.uncertainty:.2g}"),
        ("unit", lambda one: one.unit),
        ("change / uncertainty", lambda one: f"{one.sigmas:.1f}"),
    )
    since_first = Section(
        title=f"Since {first.made_at:%Y-%m-%d}", text=_read(course[-1].sentences) if len(course) > 1 else ()
    )
    sections: list[Section] = [since_first] if since_first.text else []
    for step in reversed(steps):
        title = f"{step.since.made_at:%Y-%m-%d} to {step.until.made_at:%Y-%m-%d}"
        text = _read((*step.sentences, *(f"not compared: {one}" for one in step.not_compared)))
        changes: tuple[Change, ...] = step.changes
        sections.append(table_section(title, changes, cells, text=text))
    write_page(
        path,
        title=f"Trend of {serial}",
        answer=f"{serial}: {headline(steps, course)}.",
        pictures=(svg_of(draw_trend(serial, first, course)),),
        sections=tuple(sections),
        origin=origin,
    )


def _read(words: Sequence[str]) -> tuple[str, ...]:
    """Return what was found as sentences."""
    return tuple(f"{one[:1].upper()}{one[1:]}." for one in words)
