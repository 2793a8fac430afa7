"""What a person reads on a terminal of 60, 80 or 120 columns: tables and lines whole, whatever is in them.

Every call by the fixture ``undrift`` compares what those terminals show; here are tables of anything, a real terminal, and the
numbers of the JSON.
"""

import pytest
from hypothesis import strategies as st

from testkit.terminal import Terminal, on
from undrift.cli import screen
from undrift.report.terminal import print_cells

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
            print_cells("turns", heads, rows)
        shown[width] = [line.rstrip() for line in place.getvalue().splitlines() if line.strip(" ─")]
    assert shown[47][1:3] == ["         lean", " name   (deg)   greatest error   any"]
    assert shown[46][1:3] == ["       lean", " name (deg) greatest error any"]
    assert shown[38][1:3] == ["       lean greatest", " name (deg)    error any"]
    assert shown[32] == ["turns", "name: sit", "  lean (deg): 5.58", "  greatest error: 4.1 3.9-4.3"]


def test_a_line_that_is_written_over_keeps_whole_words_and_says_that_there_is_more():
    place = Terminal()
    with on(place, 40):
        shown = screen.Terminal("rig run")
        shown.over("[3/120] 0:12:01 left  dwell x, soaking  gyro 123.456 deg/s")
        shown.over("gyro 123.456 deg/s")
    assert place.getvalue() == "\r\x1b[J[3/120] 0:12:01 left  dwell x, …\r\x1b[Jgyro 123.456 deg/s"
