"""undrift validate: levels of correction on the terminal and in the figure."""

import numpy as np
import pytest

from undrift.report.figures import draw_level_errors
from undrift.validation.levels import LevelErrors, LevelSummary, LevelTable

pytestmark = pytest.mark.usefixtures("computed_once")


def test_one_trial_is_told_before_and_after_without_interval_and_verdict(undrift, bench):
    words = (bench / "trial.parquet", "--reference", bench / "reference.parquet")
    answer = undrift.good("validate", *words, "--calibration", bench / "calibration.json")
    lines = " ".join(answer.out.split())
    assert "calibrated with calibration.json, offset of the rest subtracted (rms over the motion)." in lines
    assert "Within the predicted limits: yes." in lines
    (rest,) = [line for line in answer.out.splitlines() if line.strip().startswith("rest ")]
    assert len(rest.split()) == 4  # level, people, trials, error
    assert "less than above" not in lines


def test_the_figure_shows_every_level_that_can_be_made():
    def errors(level, values):
        values = np.array(values)
        return LevelErrors(
            level=level, method="strapdown", error_deg=values, measure_deg=np.full((2, 2), np.nan),
            simulated_deg=0.2 * values, difference_deg=0.1 * values, findings=(), missing="",
        )  # fmt: skip

    def summary(level, people, mean, interval):
        return LevelSummary(
            group="all", level=level, method="strapdown", trials=people, people=people, mean_deg=mean, interval_deg=interval,
            previous="", decision=None, agreement=None, icc=None,
        )  # fmt: skip

    nan = float("nan")
    table = LevelTable(
        trials=(), quantity="total", margin_deg=0.15,
        errors=(errors("constants", [1.0, 2.0]), errors("all tables", [nan, nan]), errors("rest", [0.1, nan])),
        summaries=(
            summary("constants", 2, 1.5, (-4.9, 7.9)),
            summary("all tables", 0, nan, (nan, nan)),
            summary("rest", 1, 0.1, (nan, nan)),
        ),
    )  # fmt: skip
    (panel,) = draw_level_errors(table).axes
    assert [label.get_text() for label in panel.get_yticklabels()] == ["constants", "rest"]
    assert panel.get_xscale() == "log"
    assert panel.get_xlim()[0] > 0.0
