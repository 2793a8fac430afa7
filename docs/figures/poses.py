"""The poses of a calibration: a box on each of its six faces, and three full turns along a straight edge."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from undrift.report.figures import save_figure

SIZE = {"x": 1.0, "y": 0.7, "z": 0.35}  # half lengths of the box along the axes of the device
TOWARDS_VIEWER = {  # axes of the device that point to the left front and to the right front, by the face that points up
    "+x": "yz", "-x": "zy", "+y": "zx", "-y": "xz", "+z": "xy", "-z": "yx",
}  # fmt: skip
SHADES = ("#e8e8e4", "#cfcfca", "#f5f5f2")  # left, right, top
EDGE, ARROW = "#222222", "#1f5fa8"


def draw(folder: Path) -> None:
    """Draw both pictures into a folder."""
    save_figure(faces(), folder / "pose-faces.svg")
    save_figure(turns(), folder / "pose-turns.svg")


def faces() -> Figure:
    """Return the six faces, in two rows."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    for axes, face in zip(figure.subplots(2, 3).flat, TOWARDS_VIEWER, strict=True):
        top = _draw_box(axes, face)
        _draw_arrow(axes, (top + np.array([0.0, 0.15]), top + np.array([0.0, 0.6])))
        axes.set_title(f"{face} up", fontsize=11)
    return figure


def turns() -> Figure:
    """Return the three turns, each about the axis that points up."""
    figure = Figure(figsize=(7.0, 2.5), layout="constrained")
    for axes, face in zip(figure.subplots(1, 3).flat, ("+z", "+x", "+y"), strict=True):
        top = _draw_box(axes, face)
        angle = np.radians(np.linspace(-60.0, 230.0, 60))
        circle = np.column_stack((0.75 * np.cos(angle), 0.75 * np.sin(angle), np.zeros(60)))
        _draw_arrow(axes, _projected(circle) + top)
        axes.set_title(f"one full turn with {face} up", fontsize=11)
    return figure


def _draw_box(axes: Axes, face: str) -> np.ndarray:
    """Draw a box whose face points up, and return the middle of its top."""
    left, right = TOWARDS_VIEWER[face]
    half = np.array([SIZE[left], SIZE[right], SIZE[face[1]]])
    for k, (name, shade) in enumerate(zip((f"+{left}", f"+{right}", face), SHADES, strict=True)):
        signs = np.insert(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), k, 1, axis=1)
        axes.fill(*_projected(signs * half).T, facecolor=shade, edgecolor=EDGE)
        middle = _projected(half * np.eye(3)[k])
        axes.text(*middle, name, ha="center", va="center", fontsize=10)
    axes.set(xlim=(-1.8, 1.8), ylim=(-1.7, 2.1), aspect="equal")
    axes.set_axis_off()
    return _projected(half * np.array([0.0, 0.0, 1.0]))


def _draw_arrow(axes: Axes, course: np.ndarray | tuple[np.ndarray, ...]) -> None:
    """Draw a line with an arrow head at its end."""
    points = np.asarray(course)
    axes.plot(*points.T, color=ARROW, linewidth=2.0)
    axes.annotate(
        "", points[-1] + (points[-1] - points[-2]) * 0.5, points[-2], arrowprops={"arrowstyle": "-|>", "color": ARROW}
    )


def _projected(points: np.ndarray) -> np.ndarray:
    """Return points of a room, left front, right front and up, as seen from the front and above."""
    return points @ np.array([[-0.87, -0.5], [0.87, -0.5], [0.0, 1.0]])


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
