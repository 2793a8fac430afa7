"""Pictures of the tutorial: a session by hand, and of the packaged sample what the tutorial's own commands draw."""

import contextlib
import io
import re
import sys
import tempfile
from pathlib import Path

import numpy as np

import undrift
from undrift.cli.app import run

COMMANDS = """sample
calibrate sample/bench -o c.json --report calibration.html
drift sample/thermal --calibration c.json -o t.json --report drift.html
validate sample/sit_to_stand.parquet --reference sample/sit_to_stand_optics.parquet --calibration t.json --offset none -o after"""
PICTURES = {  # name: page, and which picture of it
    "session": ("session.html", 0),
    "calibration": ("calibration.html", 0),
    "matrix": ("calibration.html", 1),
    "drift": ("drift.html", 0),
    "trial": ("after/report.html", 0),
}


def draw(folder: Path) -> None:
    """Draw them into a folder."""
    rng = np.random.default_rng(7)
    session = undrift.simulate_session("ferraris", undrift.random_device(rng), rng=rng)
    folder = folder.resolve()
    with tempfile.TemporaryDirectory() as held, contextlib.chdir(held), contextlib.redirect_stdout(io.StringIO()):
        undrift.write_session(session, "session")
        for line in ("info session --report session.html", *COMMANDS.splitlines()):
            if run(line.split()) != 0:
                raise SystemExit(f"undrift {line} failed")
        for name, (page, k) in PICTURES.items():
            (folder / f"page-{name}.svg").write_text(picture(Path(page).read_text("utf-8"), k), "utf-8")


def picture(page: str, k: int) -> str:
    """Return a picture of a report as a file of its own."""
    found = re.findall(r"<svg\b.*?</svg>", page, re.S)
    return found[k].replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
