"""What a person reads on a terminal of 60, 80 or 120 columns: tables and lines whole, whatever is in them.

Every call by the fixture ``undrift`` compares what those terminals show; here are tables of anything, a real terminal, and the
numbers of the JSON.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.data import data_path
from testkit.terminal import WIDTHS, Terminal, differences, on
from undrift import cli
from undrift.cli import common
from undrift.cli.app import run
from undrift.commands.validate import SHOWN

pytestmark = pytest.mark.usefixtures("computed_once")

WORDS = st.text(st.characters(exclude_categories=("C", "Z", "M"), exclude_characters="─:"), min_size=1, max_size=30)
CELLS = st.lists(WORDS, min_size=0, max_size=4).map(" ".join)


@st.composite
def tables(draw: st.DrawFn) -> tuple[str, list[str], list[list[str]]]:
    """A title, heads and rows; every head has a cell."""
    heads = draw(st.lists(CELLS, min_size=1, max_size=9))
    rows = draw(st.lists(st.lists(CELLS, min_size=len(heads), max_size=len(heads)), max_size=3))
    return draw(CELLS), heads, [*rows, ["0"] * len(heads)]


@pytest.mark.slow
@given(tables(), st.integers(40, 120))
def test_every_cell_of_any_table_is_there_in_one_piece(table, width):
    place, (title, heads, rows) = Terminal(), table
    with on(place, width):
        common.show_table(title, heads, rows)
    assert (
        differences(place.getvalue(), " ".join((title, *heads, *(cell for row in rows for cell in row))), width) == []
    )


@pytest.mark.slow
@given(st.lists(CELLS, max_size=3), st.integers(40, 120))
def test_every_word_of_any_line_is_there_in_one_piece_and_brackets_and_colons_are_no_markup(lines, width):
    place, lines = Terminal(), [*lines, "  a[b]c [red] x:100:y.csv"]
    with on(place, width):
        common.say(*lines)
        common.say(*lines, err=True)
    assert differences(place.getvalue(), "\n".join(lines * 2), width) == []
    assert "  a[b]c [red] x:100:y.csv\n" in place.getvalue()


def test_a_table_that_almost_fits_is_closer_and_one_that_does_not_is_stacked():
    heads, rows = ("name", "lean (deg)", "greatest error", "any", ""), [(" sit", "5.58", "4.1", "", "3.9-4.3")]
    shown = {}
    for width in (47, 46, 38, 32):
        with on(place := Terminal(), width):
            common.show_table("turns", heads, rows)
        shown[width] = [line.rstrip() for line in place.getvalue().splitlines() if line.strip(" ─")]
    assert shown[47][1:3] == ["         lean", " name   (deg)   greatest error   any"]
    assert shown[46][1:3] == ["       lean", " name (deg) greatest error any"]
    assert shown[38][1:3] == ["       lean greatest", " name (deg)    error any"]
    assert shown[32] == ["turns", "name: sit", "  lean (deg): 5.58", "  greatest error: 4.1 3.9-4.3"]


def test_a_line_that_is_written_over_keeps_whole_words_and_says_that_there_is_more():
    place = Terminal()
    with on(place, 40):
        common.Terminal().over("[3/120] 0:12:01 left  dwell x, soaking  gyro 123.456 deg/s")
        common.Terminal().over("gyro 123.456 deg/s")
    assert place.getvalue() == "\r\x1b[J[3/120] 0:12:01 left  dwell x, …\r\x1b[Jgyro 123.456 deg/s"


def test_every_command_shows_what_it_shows_in_one_way():
    for path in sorted(Path(cli.__file__).parent.glob("*.py")):
        text = path.read_text()
        if path.name != "common.py":
            assert re.search(r"\bconsole\(|rich\.(console|table)|\bprint\(|\[:150\]", text) is None, path.name


def in_a_terminal(width: int, *words: object) -> str:
    """What a command writes to a real terminal, without its escapes."""
    pty, fcntl, termios = (pytest.importorskip(name) for name in ("pty", "fcntl", "termios"))
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, np.array([50, width, 0, 0], np.uint16).tobytes())
    given = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES", "NO_COLOR")}
    call = [sys.executable, "-m", "undrift", *map(str, words)]
    made = subprocess.Popen(call, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, env=given | {"TERM": "xterm"})
    os.close(theirs)
    parts = []
    try:
        while part := os.read(ours, 65536):
            parts.append(part)
    except OSError:  # Linux: the other end is closed
        pass
    os.close(ours)
    assert made.communicate()[1] == b""
    assert made.returncode == 0
    return re.sub(r"\x1b\[[0-9;]*m", "", b"".join(parts).decode()).replace("\r\n", "\n")


@pytest.mark.slow
@pytest.mark.parametrize("width", WIDTHS)
def test_a_real_terminal_shows_every_number_of_a_calibration(undrift, bench, width):
    shown = in_a_terminal(width, "calibrate", bench / "session")
    assert differences(shown, undrift.good("calibrate", bench / "session").out, width) == []


def on_a_terminal(width: int, *words: object) -> list[str]:
    """The words that a command writes to a terminal."""
    with on(place := Terminal(), width):
        assert run([str(word) for word in words]) == 0
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", place.getvalue()).split()


@pytest.mark.slow
@pytest.mark.parametrize("width", WIDTHS)
def test_each_number_of_the_json_that_a_table_shows_is_there_to_its_last_digit(undrift, bench, width):
    words = ("calibrate", bench / "session")
    told, pattern = undrift.good(*words, "--json").json(), re.compile(r"(-?\d+\.?\d*)\(\d+\)")
    shown = [found[1] for word in on_a_terminal(width, *words) if (found := pattern.fullmatch(word))]
    wanted = []
    for name in ("accel", "gyro"):
        for row, offset in zip(told[name]["matrix"], told[name]["offset"], strict=True):
            wanted += [*row, offset]
    assert [f"{value:.{len(text.partition('.')[2])}f}" for value, text in zip(wanted, shown, strict=True)] == shown

    words = ("validate", bench / "corrected.parquet", "--reference", bench / "reference.parquet")
    (trial,) = undrift.good(*words, "--json").json()["trials"]
    assert {trial["recording"], *(f"{trial[key]:.2f}" for key in SHOWN)} <= set(on_a_terminal(width, *words))

    words = ("noise", bench / "corrected.parquet", "--stop-s", "5")
    rows, shown = undrift.good(*words, "--json").json(), {word.strip("[],") for word in on_a_terminal(width, *words)}
    walks = [row["angle_random_walk"] for row in (*rows["gyro"], *rows["accel"])]
    assert {f"{value:.3g}" for walk in walks for value in (walk["value"], *walk["interval"])} <= shown


@pytest.mark.slow
def test_a_twin_and_a_simulation_show_the_same_on_every_terminal(undrift, tmp_path):
    made = undrift.good("simulate", "step", "--device", "mpu6050", "-o", tmp_path / "a.parquet").out
    assert "contribution of each effect (rms)" in made
    files = ("32_disturbed_attached_magnet_1cm.hdf5", "35_disturbed_attached_magnet_4cm.hdf5")
    told = undrift("twin", *(data_path("broad", file) for file in files))
    assert told.code == 0
    titles = (
        "parameters of the device",
        "residual against",
        "held out: largest",
        "its contributions",
        "end error, deg",
    )
    assert [title for title in titles if title not in told.out] == []
