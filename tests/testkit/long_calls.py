"""Long commands, each called once in a run of the suite for all tests that look at its output."""

import shlex
from pathlib import Path

import pytest
from benchmarks.broad_files import broad_file

from testkit.remembered import folder_made_once, run_folder
from testkit.terminal import Terminal, on
from undrift.cli.app import run

CALLS = {
    "demo": "demo --quick --out {here}/out",
    "study": "study {here}/study.toml -o {here}/out --workers 1",
    "twin": "twin {broad} -o {here}/device.json --report {here}/page.html",
}
STUDY = """
[study]
name = "small"
subjects = 4
subjects_max = 4
target_deg = [0.8, 5.0]
sessions = ["hand", "three rates", "three rates, warm"]
[[task]]
name = "sit_to_stand"
[task.tried]
cutoff_hz = [11.1, 20.0]
"""


def long_call(factory: pytest.TempPathFactory, name: str) -> Path:
    """Return the folder of a long call: what it wrote, and terminal.txt as a terminal of 80 columns shows it."""

    def call(folder: Path) -> None:
        (folder / "study.toml").write_text(STUDY)
        broad = broad_file("32_disturbed_attached_magnet_1cm") if name == "twin" else ""
        with on(place := Terminal(), 80):
            code = run(shlex.split(CALLS[name].format(here=folder, broad=broad)))
        assert code == 0, place.getvalue()[-2000:]
        (folder / "terminal.txt").write_text(place.getvalue(), encoding="utf-8")

    return folder_made_once(run_folder(factory), f"{name}-call", call)
