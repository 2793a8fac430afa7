"""What each command prints on a terminal of 80 columns, with a mark in place of each number: approved in ``transcripts``.

``UNDRIFT_APPROVE=1`` writes the texts anew. Read the changes before you commit them.
"""

import os
import re
import shlex
import textwrap
from pathlib import Path

import pytest

from cli.test_app_envelope import GOOD, WARM
from testkit.command_line import at_rest
from testkit.data import data_path
from testkit.long_calls import CALLS, long_call
from testkit.rig_bench import PROTOCOL
from testkit.terminal import Terminal, on
from undrift.cli.app import run

FOLDER = Path(__file__).parent / "transcripts"


@pytest.mark.parametrize("name", sorted(GOOD))
def test_a_command_prints_its_approved_transcript(name, bench, tmp_path, monkeypatch):
    for file, text in {"warm.toml": WARM, "protocol.toml": PROTOCOL}.items():
        (tmp_path / file).write_text(text)
    at_rest(tmp_path, "rest.csv")
    monkeypatch.setattr("undrift.web.app.serve", lambda _, ready: ready("http://127.0.0.1:8765/"))
    monkeypatch.setattr("undrift.commands.bench.source.serial_ports", lambda: [("/dev/ttyUSB0", "Arduino Uno")])
    monkeypatch.setattr("undrift.commands.bench.source.lsl_streams", list)
    names = {"bench": bench, "here": tmp_path, "warm": data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")}
    with on(place := Terminal(), 80):
        assert run(shlex.split(GOOD[name].format(**names))) in (0, 1)
    text = place.getvalue().replace(str(names["warm"]), "WARM").replace(str(bench), "BENCH")
    compare(name, text.replace(str(tmp_path), "HERE"))


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_a_long_command_prints_its_approved_transcript(name, tmp_path_factory):
    folder = long_call(tmp_path_factory, name)
    compare(name, (folder / "terminal.txt").read_text(encoding="utf-8").replace(str(folder), "HERE"))


def compare(name: str, text: str) -> None:
    """Compare what a command printed with its approved transcript, or approve it."""
    approved, text = FOLDER / f"{name.replace(' ', '-')}.txt", anonymous(text)
    if os.environ.get("UNDRIFT_APPROVE"):
        approved.write_text(text, encoding="utf-8")
    assert text == approved.read_text(encoding="utf-8")


def anonymous(text: str) -> str:
    """Return the words without control characters, numbers, rules and line breaks, which depend on the numbers.

    Of a line that is written over, only its last state counts.
    """
    text = re.sub(r"[^\n]*\r(?:\x1b\[\d+A)?\x1b\[J", "", text)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r|─", "", text)
    text = re.sub(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", "#", text)
    return textwrap.fill(" ".join(text.split()), 100, break_long_words=False, break_on_hyphens=False) + "\n"
