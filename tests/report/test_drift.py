"""Pages and pictures of thermal fits: drawn without a warning, with their names and units, and cells to the right digit."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from testkit.pictures import cut_texts
from undrift.base.summary import plus_minus
from undrift.commands.drift import choice_rows, offset_rows, offset_title, shown_unit
from undrift.drift.fit import Choice
from undrift.drift.verdict import ScaleSummary, TriadSummary
from undrift.findings import finding
from undrift.model import DynamicDrift, Verdict
from undrift.report.drift import draw_alternatives, draw_dynamic, draw_offsets, draw_scale
from undrift.report.figures import svg_of

NODES = np.arange(18.0, 30.1, 0.5)


def summary(**changes):
    n, k = len(NODES), 40
    made = TriadSummary(
        unit="rad/s",
        seen_c=(20.0, 28.0),
        temp_c=NODES,
        against="the constant offset",
        departure=np.radians(np.outer(NODES - 18.0, [0.1, -0.1, 0.2])),
        uncertainty=np.radians(np.full((n, 3), 0.01)),
        extrapolated=(NODES < 19.5) | (NODES > 28.5),
        slope=np.radians([0.1, -0.1, 0.2]),
        slope_uncertainty=np.radians([0.012, 0.0012, 0.1]),
        half_loop=np.radians([0.05, 0.0, -0.05]),
        half_loop_uncertainty=np.radians([0.004, 0.004, 0.004]),
        turn_on=np.radians([0.1, 0.1, 0.1]),
        block_temp_c=np.linspace(20.0, 28.0, k),
        block_departure=np.radians(np.random.default_rng(1).normal(0.0, 0.1, (k, 3))),
        block_cooling=np.repeat([0.0, -1.0, 1.0, 0.5], 10),
    )
    return replace(made, **changes)


def test_rows_are_in_the_units_that_people_read():
    rows = offset_rows(summary())
    assert [*rows[0]][1] == "slope (deg/s per degC)"
    assert all(row.keys() == rows[0].keys() for row in rows)
    assert [*rows[0].values()] == ["x", "+0.100 +- 0.012", "0.01", "+0.0500 +- 0.0040", "0.1"]
    short = summary(half_loop=None, half_loop_uncertainty=None, turn_on=None)
    assert [len(row) for row in offset_rows(short)] == [3] * 3
    assert shown_unit("m/s2")[0] == "mg"
    assert shown_unit("count") == ("count", 1.0)


def test_the_title_counts_the_nodes_that_no_data_were_near():
    assert offset_title("gyroscope", summary()) == (
        "gyroscope offset over temperature: 20.0 to 28.0 degC seen, 25 nodes 18 to 30 degC by 0.5, 6 of them extrapolated"
    )


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (0.0279, 0.00123, "+0.0279 +- 0.0012"),
        (-8.2, 13.4, "-8 +- 13"),
        (0.5, 0.0, "+0.5"),
        (np.nan, np.nan, "not seen"),
    ],
)
def test_a_value_is_written_to_the_second_digit_of_its_uncertainty(value, uncertainty, text):
    assert plus_minus(value, uncertainty) == text


def choice():
    return Choice(
        fits={},
        verdict=Verdict(),
        fitted_rms_dps=np.array([1.6, 0.01, np.nan, 0.008]),
        left_out_rms_dps=np.array([1.6, 0.01, np.nan, 0.009]),
        standard_error_dps=np.array([0.1, 0.001, np.nan, 0.0]),
        chosen="scale",
        why=finding(
            "drift.tables_selected",
            "info",
            tables="scale",
            error_dps=0.01,
            held_out=2,
            soaks=4,
            set_points=4,
        ),
    )


def test_the_choice_says_what_was_chosen_and_what_could_not_be_fitted():
    rows = choice_rows(choice())
    assert [row["chosen"] for row in rows] == ["", "chosen", "", ""]
    assert (rows[2]["fitted (deg/s rms)"], rows[2]["held out (deg/s rms)"]) == ("not fitted", "not seen")
    assert rows[1]["held out (deg/s rms)"] == "0.0100 +- 0.0010"


def scales():
    return ScaleSummary(
        temp_c=NODES,
        percent=np.zeros((len(NODES), 3)),
        uncertainty=np.where(np.arange(3) == 1, np.nan, np.full((len(NODES), 3), 0.1)),
        extrapolated=NODES < 20.0,
        soak_temp_c=np.array([20.0, 25.0, 30.0]),
        soak_percent=np.where(np.arange(3) == 1, np.nan, np.zeros((3, 3))),
        soak_uncertainty=np.where(np.arange(3) == 1, np.nan, np.full((3, 3), 0.1)),
    )


DRAWN = {
    "offsets": lambda: draw_offsets(summary()),
    "offsets without blocks": lambda: draw_offsets(
        summary(block_temp_c=np.zeros(0), block_departure=np.zeros((0, 3)), block_cooling=np.zeros(0), against="zero")
    ),
    "scale": lambda: draw_scale(scales()),
    "dynamic": lambda: draw_dynamic(
        DynamicDrift(
            temp_c=np.array([20.0, 30.0]),
            turn_rate=np.array([-1.0, 0.0, 1.0]),
            error=np.where(np.arange(3) == 1, 0.0, np.full((2, 3, 3), 0.01)),
            extrapolated=np.array([[True, False, True], [False] * 3]),
        )
    ),
    "choice": lambda: draw_alternatives(choice()),
}
WORDS = {
    "offsets": ("offset less the constant offset", "x (deg/s)", "extrapolated", "warming", "cooling branch", "95 %"),
    "offsets without blocks": (">offset<", "uncertainty of the table", "a pose has no single offset"),
    "change alone": ("x (count)", "offset minus the fit"),
    "scale": ("scale factor against", "z (%)", "soaks, 95 %"),
    "dynamic": ("measured rate (deg/s)", "20 degC", "correction (deg/s)"),
    "choice": ("scale (chosen)", "scale + dynamic"),
}


@pytest.mark.parametrize("name", DRAWN)
def test_every_picture_names_what_it_shows_and_is_the_same_twice(name):
    text = svg_of(DRAWN[name]())
    for word in WORDS[name]:
        assert word in text, word
    assert text == svg_of(DRAWN[name]())
    assert cut_texts(DRAWN[name]()) == []


def test_an_axis_that_was_not_turned_is_not_drawn():
    assert "y (%)" not in svg_of(draw_scale(scales()))
    labels = [axes.get_ylabel()[0] for axes in DRAWN["dynamic"]().axes]
    assert labels == ["x", "z"]


def test_the_legend_s_soaks_have_the_colour_of_those_in_every_panel():
    figure = draw_scale(scales())
    drawn = {line.get_color() for axes in figure.axes for line in axes.lines if line.get_marker() == "o"}
    legend = figure.legends[0]
    named = dict(zip([text.get_text() for text in legend.get_texts()], legend.legend_handles, strict=True))
    assert len(drawn) == 1
    assert to_hex(named["soaks, 95 %"].get_color()[0]) in {to_hex(colour) for colour in drawn}
