"""What a person reads on a terminal: narrow tables, and lines that are written over."""

from testkit.terminal import Terminal, on
from undrift.cli import screen
from undrift.report.terminal import print_cells


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
