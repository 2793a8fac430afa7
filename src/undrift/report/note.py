"""The note's figures: 1 and 2 as flow drawings with this program's functions, and 3.

``python -m undrift.report.note FOLDER`` draws the flows of docs/note.md. Drawings are 4.6 inches wide, so that their
text keeps 9 pixels on a screen of 390. Our copy of the note has the captions and the text of Figures 1 and 2 without
the drawings. The steps follow the text. The labels "block 2" to "block 9" are placed according to the text, not at
single boxes.
"""

import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from undrift.report import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undrift.study.figure3 import Figure3

# ---- Figures 1 and 2: flows


class NoteStep(NamedTuple):
    """A step of the note's text and the functions that do it here."""

    note: str
    ours: tuple[str, ...]  # Dotted, without the name of the package


class Branch(NamedTuple):
    """A column of Figure 2."""

    blocks: str  # Numbers, as the note's text has them
    steps: tuple[NoteStep, ...]


FIGURE_1 = (
    NoteStep("Task and category of subjects (Tinetti test)", ("study.plan.note_study", "sim.motion.tasks.cohort")),
    NoteStep(
        "Parameters to try: accelerations and angular velocities of the calibration (Δω, ω_m, ω_M), conditioning chain",
        ("study.plan.StudyTask.variations",),
    ),
    NoteStep(
        "Motion at L5 from the optics, input of the simulation",
        ("sim.motion.tasks.draw_task", "study.recorded.read_motion"),
    ),
    NoteStep(
        "Calibration: six faces (eqs. 1 to 3), motor (eqs. 4 to 6)",
        ("study.sessions.calibrate_by", "study.sessions.calibrate_by_means"),
    ),
    NoteStep(
        "Simulation with the model of the device: angle, and its error",
        ("study.case.make_case", "study.case.pitch_errors_deg"),
    ),
    NoteStep(
        "Analysis of variance over the subjects: is p below 0.05?",
        ("study.judge.judge_parameters", "study.statistics.repeated_measures_anova"),
    ),
    NoteStep("Optimised parameters (Table 1)", ("study.judge.find_answers",)),
    NoteStep(
        "Test of the calibrated device on other subjects (Table 2), compared with optics (Figure 3)",
        ("study.run.run_chosen", "study.figure3.figure3"),
    ),
)
LOOP = (5, 1, "no: other values, more subjects")  # from one step of Figure 1 back to another

BEFORE = NoteStep(
    "Gyroscope output in calibrations at 18 to 75 °C", ("drift.fit.fit_drift", "drift.temperature.trusted_temperature")
)
STATIC = Branch(
    "block\N{NO-BREAK SPACE}2, block\N{NO-BREAK SPACE}3, block\N{NO-BREAK SPACE}4, block\N{NO-BREAK SPACE}5",
    (
        NoteStep("Output at rest, at each temperature", ("drift.observe.observe_rests",)),
        NoteStep(
            "Function of the static drift, by splines", ("drift.temperature.estimate_lag", "drift.offset.fit_static")
        ),
        NoteStep("Tuning table, every 0.5 °C", ("drift.fit.table_nodes",)),
    ),
)
DYNAMIC = Branch(
    "block\N{NO-BREAK SPACE}6, block\N{NO-BREAK SPACE}7, block\N{NO-BREAK SPACE}8, block\N{NO-BREAK SPACE}9",
    (
        NoteStep("Output at the imposed angular velocities", ("drift.observe.observe_steps",)),
        NoteStep("Function of the dynamic drift, by splines", ("drift.rates.fit_scale", "drift.rates.fit_dynamic")),
        NoteStep("Tuning table, over velocity and temperature", ("drift.fit.fit_drift",)),
    ),
)
AFTER = (
    NoteStep(
        "In use, each sample: tables at the board temperature",
        ("correction.correct.correct", "correction.correct.Corrector"),
    ),
    NoteStep("Output less static drift, matrix, less dynamic drift", ("orientation.orient",)),
)


STEPS = (*FIGURE_1, BEFORE, *STATIC.steps, *DYNAMIC.steps, *AFTER)

_SIZE, _LINE, _PAD, _GAP, _EDGE = 8.7, 10.8, 5.0, 13.0, 4.0  # points
_LETTER = 0.56 * _SIZE  # mean width of a letter


def draw_figure1() -> "Figure":
    """Draw the note's Figure 1, how the parameters of the calibration are optimised."""
    left_edge, wide = _EDGE + 22.0, 72.0 * figures.WIDTH - 2.0 * _EDGE - 22.0
    boxes, bottom = _stack_boxes(FIGURE_1, left_edge, _EDGE, wide)
    figure, axes = _sheet(bottom + _EDGE, "Figure 1: how the parameters are optimised")
    _draw_boxes(axes, boxes)
    start, stop, word = LOOP
    ends = [0.5 * (boxes[k].top + boxes[k].bottom) for k in (start, stop)]
    axes.plot([left_edge, _EDGE + 11.0, _EDGE + 11.0, left_edge - 6.0], [ends[0], *ends, ends[1]], color=figures.ERROR)
    _arrow(axes, (left_edge - 8.0, ends[1]), (left_edge, ends[1]), figures.ERROR)
    axes.text(
        _EDGE + 8.0, sum(ends) / 2.0, word, rotation=90.0, ha="right", va="center", fontsize=_SIZE, color=figures.ERROR
    )
    return figure


def draw_figure2() -> "Figure":
    """Draw the note's Figure 2, how the drift of the gyroscopes is compensated."""
    width = 72.0 * figures.WIDTH
    wide, half = width - 2.0 * _EDGE, 0.5 * (width - 3.0 * _EDGE)
    before, bottom = _stack_boxes((BEFORE,), _EDGE, _EDGE, wide)
    top = bottom + _GAP
    sides, ends = [], []
    for k, branch in enumerate((STATIC, DYNAMIC)):
        left_edge = _EDGE + k * (half + _EDGE)
        inner, end = _stack_boxes(branch.steps, left_edge + _EDGE, top + _LINE * 2.6 + _EDGE, half - 2.0 * _EDGE)
        sides.append(inner)
        ends.append(end + _EDGE)
    low = max(ends)
    after, bottom = _stack_boxes(AFTER, _EDGE, low + _GAP, wide)
    figure, axes = _sheet(bottom + _EDGE, "Figure 2: how the drift is compensated")
    for k, (branch, inner) in enumerate(zip((STATIC, DYNAMIC), sides, strict=True)):
        left_edge = _EDGE + k * (half + _EDGE)
        middle = left_edge + 0.5 * half
        axes.add_patch(_patch(left_edge, top, half, low - top, face=figures.SHADE, edge=figures.LIMIT))
        heads = textwrap.fill(f"{('static', 'dynamic')[k]} drift: {branch.blocks}", int((half - 8.0) / _LETTER))
        axes.text(left_edge + _EDGE, top + 3.0, heads, va="top", fontsize=_SIZE, color=figures.OPTICS, weight="bold")
        _arrow(axes, (middle, before[0].bottom), (middle, top))
        _arrow(axes, (middle, low), (middle, after[0].top))
        _draw_boxes(axes, inner)
    _draw_boxes(axes, before)
    _draw_boxes(axes, after)
    return figure


class _NoteBox(NamedTuple):
    left: float  # points, from the upper left corner
    top: float
    width: float
    bottom: float
    note: tuple[str, ...]  # lines
    ours: tuple[str, ...]


def place_of(dotted: str) -> tuple[str, str]:
    """Return the name of a function, and its file."""
    parts = dotted.split(".")
    first = next((k for k, name in enumerate(parts) if name[0].isupper()), len(parts) - 1)
    return ".".join(parts[first:]), "/".join(parts[:first]) + ".py"


def _stack_boxes(steps: Sequence[NoteStep], left_edge: float, top: float, width: float) -> tuple[list[_NoteBox], float]:
    """Arrange boxes below each other. Return them and the end of the last."""
    boxes, letters = [], int((width - 2.0 * _PAD) / _LETTER)
    for step in steps:
        note = tuple(textwrap.wrap(step.note, letters))
        places = [place_of(dotted) for dotted in step.ours]
        ours = tuple(line for name, file in places for line in textwrap.wrap(f"{name}  {file}", letters))
        bottom = top + 2.0 * _PAD + _LINE * (len(note) + len(ours))
        boxes.append(_NoteBox(left_edge, top, width, bottom, note, ours))
        top = bottom + _GAP
    return boxes, boxes[-1].bottom


def _sheet(height: float, label: str) -> tuple["Figure", "Axes"]:
    """Return an empty figure with data coordinates in points from its upper left corner. The label is its description."""
    figure, (axes,) = figures.new_figure(1, height=height / 72.0 - 0.4, width=figures.WIDTH)
    figure.set_layout_engine("none")
    figure.set_label(label)
    axes.set_position((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, 72.0 * figures.WIDTH), ylim=(height, 0.0))
    axes.set_axis_off()
    return figure, axes


def _patch(left_edge: float, top: float, width: float, height: float, *, face: str, edge: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((left_edge, top), width, height, facecolor=face, edgecolor=edge, linewidth=0.8)


def _draw_boxes(axes: "Axes", boxes: Sequence[_NoteBox]) -> None:
    """Draw boxes with the note's words in black and this program's functions in blue, and arrows between them."""
    for k, box in enumerate(boxes):
        axes.add_patch(_patch(box.left, box.top, box.width, box.bottom - box.top, face="white", edge=figures.OPTICS))
        for row, line in enumerate((*box.note, *box.ours)):
            at = box.left + _PAD, box.top + _PAD + row * _LINE
            axes.text(
                *at, line, va="top", fontsize=_SIZE, color=figures.OPTICS if row < len(box.note) else figures.DEVICE
            )
        if k:
            middle = box.left + 0.5 * box.width
            _arrow(axes, (middle, boxes[k - 1].bottom), (middle, box.top))


def _arrow(axes: "Axes", start: tuple[float, float], stop: tuple[float, float], colour: str = figures.OPTICS) -> None:
    style: Any = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0.0, "shrinkB": 0.0, "linewidth": 0.9}
    axes.annotate("", stop, start, arrowprops=style)


FLOWS = {"note-figure-1.svg": draw_figure1, "note-figure-2.svg": draw_figure2}


# ---- Figure 3


def draw_figure3(figure3: "Figure3", names: Sequence[str]) -> "Figure":
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


def _draw_largest(panel: "Axes", figure3: "Figure3") -> None:
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


def main(folder: str) -> int:
    """Draw Figures 1 and 2 into a folder."""
    for name, draw in FLOWS.items():
        figures.save_figure(draw(), Path(folder) / name)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
