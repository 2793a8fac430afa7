"""undrift validate with levels of correction: what a person reads, JSON, the page, Python, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.broad_files import broad_file

from testkit.bench_and_commands import make_bench
from testkit.data import data_path, show
from undrift.report.figures import draw_compared
from undrift.study.compare import ComparedRow, LevelComparison

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
    (rest,) = [
        line for line in answer.out.splitlines() if line.strip().startswith("rest offset ") and "decidable" in line
    ]
    assert rest.split()[3] == "–"
    assert rest.rstrip().endswith("not decidable")


@pytest.mark.slow
def test_trials_of_a_real_device_by_the_fit_to_the_others(undrift):
    files = [
        broad_file(name) for name in ("03_undisturbed_slow_rotation_C", "24_disturbed_tapping_A") if data_path("broad")
    ]
    how = ["--calibrate-from", "reference", "--leave-one-out", "--compare", "--json"]
    found = undrift.good("validate", *files, *how).json()["compared"]
    rows = {row["level"]: row for row in found["rows"]}
    for name, row in rows.items():
        show(
            f"BROAD C, {name}: actual, simulated, largest difference, deg",
            (row["actual_deg"], row["simulated_deg"], row["apart_deg"]),
        )
    assert found["quantity"] == "total"
    assert rows["uncalibrated"]["mean_deg"] > 5.0 * rows["constants"]["mean_deg"]
    assert rows["uncalibrated"]["simulated_deg"] == pytest.approx(rows["uncalibrated"]["actual_deg"], rel=0.15)


def test_the_figure_shows_every_level_that_can_be_made():
    row = {"simulated_deg": np.array([0.2, 0.3]), "apart_deg": np.array([0.1, 0.1]), "decision": None}
    nothing = {name: np.full(2, np.nan) for name in ("actual_deg", "simulated_deg", "apart_deg")} | {"decision": None}
    rows = (
        ComparedRow(
            level="constants",
            actual_deg=np.array([1.0, 2.0]),
            missing="",
            mean_deg=1.5,
            interval_deg=(-4.9, 7.9),
            **row,
        ),
        ComparedRow(level="all tables", missing="none", mean_deg=np.nan, interval_deg=(np.nan, np.nan), **nothing),
        ComparedRow(
            level="rest offset",
            actual_deg=np.array([0.1, np.nan]),
            missing="one",
            mean_deg=0.1,
            interval_deg=(np.nan, np.nan),
            **row,
        ),
    )
    made = LevelComparison(quantity="total", margin_deg=0.15, recordings=("a", "b"), tasks=(), people=(), rows=rows)
    (panel,) = draw_compared(SimpleNamespace(compared=made)).axes
    assert [label.get_text() for label in panel.get_yticklabels()] == ["constants", "rest offset"]
    assert panel.get_xscale() == "log"
    assert panel.get_xlim()[0] > 0.0
