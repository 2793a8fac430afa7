"""The note's Figure 3 on the typical simulated device: simulated and actual errors with each compensation."""

import sys
from pathlib import Path

from undrift.report.figures import draw_figure3, save_figure
from undrift.study.figure3 import COMPARED, figure3


def draw(folder: Path) -> None:
    """Draw it into a folder."""
    save_figure(draw_figure3(figure3(seed=0), COMPARED), folder / "note-figure-3.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
