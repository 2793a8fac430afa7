"""The note's Figure 3: errors of a simulated and of an actual device at each level of compensation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from undrift.report import figures
from undrift.study.figure3 import Figure3

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = 8.7  # points


def draw_figure3(figure3: Figure3, names: Sequence[str]) -> "Figure":
    """Draw the note's Figure 3: pitch, errors for each compensation, simulated against actual, largest errors."""
    from matplotlib.lines import Line2D

    figure, (pitch, error, difference, largest) = figures.new_figure(4, height=1.75, width=figures.WIDTH, share_x=False)
    pitch.plot(figure3.time, figure3.reference_pitch, color=figures.OPTICS)
    for k in range(len(figures.COMPARED_COLOURS)):
        error.plot(figure3.time, figure3.actual[k], **figures.compared_style(k))
        error.plot(figure3.time, figure3.simulated[k], **figures.compared_style(k), linestyle="--")
        difference.plot(figure3.time, figure3.actual[k] - figure3.simulated[k], **figures.compared_style(k))
    for limit in (-0.15, 0.15):
        difference.axhline(limit, color=figures.OPTICS, linewidth=0.7, linestyle=":")
    _draw_largest(largest, figure3)
    for panel, label, title in (
        (pitch, "pitch (deg)", "sit-to-stand by the optics"),
        (error, "error (deg)", "error: actual solid, simulated dashed"),
        (difference, "difference (deg)", "actual minus simulated (dotted: 0.15 deg, from the note)"),
        (largest, "largest error (deg)", "of the typical unit"),
    ):
        panel.set_ylabel(label)
        panel.set_title(title, loc="left", fontsize=_SIZE)
    difference.set_xlabel("time (s)")
    lines = [
        Line2D([], [], **figures.compared_style(k) | {"markevery": None}) for k in range(len(figures.COMPARED_COLOURS))
    ]
    figures.legend_outside(figure, lines, names)
    return figure


def _draw_largest(panel: "Axes", figure3: Figure3) -> None:
    """Draw the largest error of each compensation, for the simulated (left) and the actual device (right)."""
    for k, colour in enumerate(figures.COMPARED_COLOURS):
        for side, name in enumerate(("simulated_max_deg", "actual_max_deg")):
            x, face = k + 0.36 * side - 0.18, colour if side else "white"
            style: Any = {"markersize": 4.5, "markerfacecolor": face, "markeredgecolor": colour}
            panel.plot(x, getattr(figure3, name)[k], marker="D", **style)
    panel.set_axisbelow(True)
    panel.set(
        yscale="log", xticks=range(len(figures.COMPARED_COLOURS)), xticklabels=[""] * len(figures.COMPARED_COLOURS)
    )
    low, high = panel.get_ylim()
    ticks = [tick for tick in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if low / 1.2 < tick < 1.2 * high]
    panel.set(ylim=(low / 1.2, 1.2 * high))
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_yticks([], minor=True)
    panel.set_xlabel("left: simulated, right: actual")
