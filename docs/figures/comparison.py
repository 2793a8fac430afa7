"""End error of BROAD's trials by each calibration and filter, from docs/comparison.json."""

import json
import sys
from pathlib import Path

from matplotlib.figure import Figure

from undrift.report.figures import save_figure

RESULT = Path(__file__).parents[1] / "comparison.json"


def draw(folder: Path) -> None:
    """Draw it into a folder: a dot for each trial, a bar at the mean."""
    table = json.loads(RESULT.read_text(encoding="utf-8"))["tables"][0]
    programs = list(dict.fromkeys(row["program"] for row in table["rows"]))
    methods = list(dict.fromkeys(row["method"] for row in table["rows"]))
    figure = Figure(figsize=(8.2, 0.9 + 0.95 * len(methods)), layout="constrained")
    axes = figure.subplots()
    for row in table["rows"]:
        at = methods.index(row["method"]) + 0.11 * (programs.index(row["program"]) - 0.5 * (len(programs) - 1))
        colour = f"C{programs.index(row['program'])}"
        axes.plot(row["values"], [at] * len(row["values"]), ".", color=colour, markersize=4, alpha=0.6)
        axes.plot([row["mean"]], [at], "|", color=colour, markersize=9, markeredgewidth=2.5)
    for k, program in enumerate(programs):
        axes.plot([], [], "|", color=f"C{k}", markersize=9, markeredgewidth=2.5, label=program)
    axes.set_xscale("log")
    axes.set_yticks(range(len(methods)), [_broken(method) for method in methods])
    axes.invert_yaxis()
    axes.set_xlabel("error after two minutes (deg): dots are trials, bars their mean")
    axes.grid(axis="x", which="both", alpha=0.3)
    figure.legend(loc="outside upper left", ncols=3, frameon=False, fontsize=8)
    save_figure(figure, folder / "comparison.svg")


def _broken(method: str) -> str:
    return method.replace(", ", ",\n")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
