"""What a person reads on a terminal of 60, 80 or 120 columns: tables and lines whole, whatever is in them.

Every call by the fixture ``undrift`` compares what those terminals show; here are tables of anything, a real terminal, and the
numbers of the JSON.
"""

import re

import pytest
from hypothesis import strategies as st

from testkit.terminal import WIDTHS, Terminal, on
from undrift.cli import common
from undrift.cli.app import run

pytestmark = pytest.mark.usefixtures("computed_once")

WORDS = st.text(st.characters(exclude_categories=("C", "Z", "M"), exclude_characters="─:"), min_size=1, max_size=30)
CELLS = st.lists(WORDS, min_size=0, max_size=4).map(" ".join)


@st.composite
def tables(draw: st.DrawFn) -> tuple[str, list[str], list[list[str]]]:
    """A title, heads and rows; every head has a cell."""
    heads = draw(st.lists(CELLS, min_size=1, max_size=9))
    rows = draw(st.lists(st.lists(CELLS, min_size=len(heads), max_size=len(heads)), max_size=3))
    return draw(CELLS), heads, [*rows, ["0"] * len(heads)]


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

    words = ("noise", bench / "corrected.parquet", "--rest-s", "0:5")
    rows, shown = undrift.good(*words, "--json").json(), {word.strip("[],") for word in on_a_terminal(width, *words)}
    walks = [row["angle_random_walk"] for row in (*rows["gyro"], *rows["accel"])]
    assert {f"{value:.3g}" for walk in walks for value in (walk["value"], *walk["interval"])} <= shown
