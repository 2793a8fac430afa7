"""undrift validate with levels of correction: what a person reads, JSON, the page, Python, and what is refused."""

import numpy as np
import pytest
from benchmarks.broad_files import broad_file

from testkit.bench_and_commands import make_bench
from testkit.data import data_path, show
from undrift.report.figures import draw_level_errors
from undrift.validation.levels import LevelErrors, LevelSummary, LevelTable

pytestmark = pytest.mark.usefixtures("computed_once")


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """The bench's trial three times, under the names of three people."""
    folder = tmp_path_factory.mktemp("levels")
    make_bench(folder)
    for person in ("a", "b", "c"):
        (folder / person).mkdir()
        for name in ("trial.parquet", "reference.parquet"):
            (folder / person / name).write_bytes((folder / name).read_bytes())
    return folder


def words(folder, people=("a", "b", "c")):
    records = [folder / person / "trial.parquet" for person in people]
    references = [word for person in people for word in ("--reference", folder / person / "reference.parquet")]
    return [*records, *references, "--calibration", folder / "calibration.json"]


def test_one_trial_has_no_interval_and_no_verdict(undrift, trials):
    answer = undrift.good("validate", *words(trials, "a"), "--compare")
    (rest,) = [line for line in answer.out.splitlines() if line.strip().startswith("rest ") and " 1 (1) " in line]
    assert rest.split()[4] == "–"
    assert rest.split()[-1] == "–"


@pytest.mark.slow
def test_trials_of_a_real_device_by_the_fit_to_the_others(undrift):
    files = [
        broad_file(name) for name in ("03_undisturbed_slow_rotation_C", "24_disturbed_tapping_A") if data_path("broad")
    ]
    how = ["--calibrate-from", "reference", "--leave-one-out", "--compare", "--json"]
    found = undrift.good("validate", *files, *how).json()["levels"]
    rows = {row["level"]: row for row in found["errors"]}
    for name, row in rows.items():
        show(
            f"BROAD C, {name}: actual, simulated, largest difference, deg",
            (row["error_deg"], row["simulated_deg"], row["difference_deg"]),
        )
    assert found["quantity"] == "total"
    assert np.mean(rows["uncalibrated"]["error_deg"]) > 5.0 * np.mean(rows["constants"]["error_deg"])
    assert np.mean(rows["uncalibrated"]["simulated_deg"]) == pytest.approx(
        np.mean(rows["uncalibrated"]["error_deg"]), rel=0.15
    )


def test_the_figure_shows_every_level_that_can_be_made():
    def errors(level, values):
        values = np.array(values)
        return LevelErrors(
            level=level, method="strapdown", error_deg=values, end_deg=values, measure_deg=np.full((2, 2), np.nan),
            simulated_deg=0.2 * values, difference_deg=0.1 * values, findings=(), missing="",
        )  # fmt: skip

    def summary(level, people, mean, interval):
        return LevelSummary(
            group="all", level=level, method="strapdown", trials=people, people=people, mean_deg=mean, interval_deg=interval,
            median_deg=mean, previous="", decision=None, agreement=None, icc=None,
        )  # fmt: skip

    nan = float("nan")
    table = LevelTable(
        trials=(), quantity="total", measure="mean inclination", margin_deg=0.15,
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
