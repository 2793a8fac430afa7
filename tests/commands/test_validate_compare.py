"""undrift validate with levels of correction: what a person reads, JSON, the page, Python, and what is refused."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import undrift as package
from testkit.bench_and_commands import make_bench
from testkit.data import data_path, show
from undrift.report.figures import draw_compared
from undrift.study.compare import ComparedRow, LevelComparison

pytestmark = pytest.mark.usefixtures("computed_once")

LEVELS = ["uncalibrated", "constants", "static tables", "all tables", "rest offset", "motion offset"]


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """The bench's trial three times, under the names of three people."""
    folder = tmp_path_factory.mktemp("levels")
    make_bench(folder)
    for person in ("a", "b", "c"):
        (folder / person).mkdir()
        for name in ("trial.parquet", "reference.parquet"):
            (folder / person / name).write_bytes((folder / name).read_bytes())
    (folder / "labels.csv").write_text("recording,task,person\na/*,rise,Ann\nb/*,rise,Bea\nc/trial.parquet,step,Cleo\n")
    return folder


def words(folder, people=("a", "b", "c")):
    records = [folder / person / "trial.parquet" for person in people]
    references = [word for person in people for word in ("--reference", folder / person / "reference.parquet")]
    return [*records, *references, "--calibration", folder / "calibration.json"]


@pytest.mark.slow
def test_levels_are_printed_with_verdicts_reasons_and_the_twin(undrift, trials):
    answer = undrift.good("validate", *words(trials), "--compare", "--labels", trials / "labels.csv")
    for said in (
        "Levels of correction",
        "Simulated against actual",
        "static tables: missing in 3 of 3 trials: no static table",
        "mean over people; less: than in the row before, paired",
        "by a margin of 0.15 deg, at 5 % over all rows, from three people on",
        "the note states 0.15 deg over 4 s",
        "mean of rise",
        "mean of step",
    ):
        assert said in answer.out
    assert "error against the reference in deg" in answer.out  # what validate says without a comparison stays


@pytest.mark.slow
def test_json_holds_each_trial_at_each_level_and_python_has_the_same(undrift, trials, tmp_path):
    told = undrift.good(
        "validate", *words(trials), "--compare", "--labels", trials / "labels.csv", "-o", tmp_path / "r", "--json"
    ).json()
    found = told["compared"]
    assert [row["level"] for row in found["rows"]] == LEVELS
    assert (found["quantity"], found["margin_deg"], found["people"]) == ("pitch", 0.15, ["Ann", "Bea", "Cleo"])
    assert (found["tasks"], found["recordings"]) == (["rise", "rise", "step"], ["trial"] * 3)
    rest = found["rows"][4]
    assert len(rest["actual_deg"]) == len(rest["simulated_deg"]) == len(rest["apart_deg"]) == 3
    assert rest["decision"]["verdict"] in ("better", "equivalent", "worse", "not decidable")
    kept = json.loads((tmp_path / "r" / "validation.json").read_text())["compared"]
    for one in (
        *kept["rows"],
        *found["rows"],
    ):  # the reasons name an option on the command line, an argument in the file
        one["missing"] = one["missing"].replace("--offset", "`offset`")
    assert kept == found
    page = (tmp_path / "r" / "report.html").read_text()
    assert "Levels of correction: pitch error, rms over the motion" in page
    again = package.validate(
        *(trials / person / "trial.parquet" for person in "abc"),
        reference=[trials / person / "reference.parquet" for person in "abc"],
        calibration=trials / "calibration.json",
        compare=True,
        labels=trials / "labels.csv",
    )
    assert again.compared is not None
    for row, said in zip(again.compared.rows, found["rows"], strict=True):
        np.testing.assert_array_equal(row.actual_deg, [np.nan if x is None else x for x in said["actual_deg"]])


@pytest.mark.slow
def test_without_labels_trials_of_one_name_count_apart(undrift, trials):
    found = undrift.good("validate", *words(trials), "--compare", "--json").json()["compared"]
    assert (found["tasks"], found["people"]) == ([], [])
    assert found["rows"][4]["decision"] is not None  # three subjects, though they have one name


def test_one_trial_has_no_interval_and_no_verdict(undrift, trials):
    answer = undrift.good("validate", *words(trials, "a"), "--compare")
    (rest,) = [
        line for line in answer.out.splitlines() if line.strip().startswith("rest offset ") and "decidable" in line
    ]
    assert rest.split()[3] == "–"
    assert rest.rstrip().endswith("not decidable")


def test_other_calibrations_stand_beside_the_own_one_with_the_paired_difference(undrift, trials, tmp_path):
    (trials / "maker.params").write_text("1\t1\tCAL_ACC0_XOFF\t0.1\t9\n1\t1\tCAL_GYRO0_ZOFF\t0.004\t9\n")
    own = package.read_calibration(trials / "calibration.json")
    worse = replace(own, gyro=replace(own.gyro, offset=own.gyro.offset + np.array([0.0, 0.0, 12.0])))
    package.write_calibration(worse, tmp_path / "older.json")
    beside = ("--against", tmp_path / "older.json")
    alone = undrift.good("validate", *words(trials), "--json").json()
    answer = undrift.good("validate", *words(trials), *beside, "-o", tmp_path / "v")
    told = json.loads((tmp_path / "v" / "validation.json").read_text())
    assert [trial["rmse_total_deg"] for trial in told["trials"]] == [x["rmse_total_deg"] for x in alone["trials"]]
    (other,) = told["against"]
    assert other["calibration"] == "older.json"
    totals = [trial["rmse_total_deg"] for trial in other["trials"]]
    apart = np.mean(totals) - alone["mean"]["rmse_total_deg"]
    assert other["decision"]["difference"] == pytest.approx(apart)
    assert (other["decision"]["verdict"], apart > 0.15) == ("better", True)
    said = f"In total older.json leaves {other['mean']['rmse_total_deg']:.2g} deg, calibration.json "
    for text in (answer.out.replace("\n", " "), (tmp_path / "v" / "report.html").read_text()):
        assert said in text
        assert "Calibrations side by side" in text
    judged = package.validate(
        trials / "a" / "trial.parquet", reference=trials / "a" / "reference.parquet", against=str(tmp_path / "older.json"),
        calibration=trials / "calibration.json",
    )  # fmt: skip
    assert judged.rivals[0].decision is None  # one recording shows no scatter
    assert judged.rivals[0].result.mean.rmse_total_deg == pytest.approx(totals[0])
    wrong = undrift.refused("validate", *words(trials), "--against", trials / "maker.params")  # readings are codes
    assert f"{trials / 'maker.params'}: " in wrong


def test_what_cannot_be_is_refused(undrift, trials, tmp_path):
    short = tmp_path / "labels.csv"
    short.write_text("recording,person\na/trial.parquet,Ann\n")
    bad = undrift.refused("validate", *words(trials), "--compare", "--labels", short)
    assert "wanted columns recording and task or person, with a row for each recording, got none for" in bad
    assert f"{trials / 'b' / 'trial.parquet'}; add it" in bad
    assert "want --compare" in undrift.refused("validate", *words(trials), "--margin-deg", "0.3")
    assert "wanted more than 0 deg, got 0" in undrift.refused(
        "validate", *words(trials), "--compare", "--margin-deg", "0"
    )


@pytest.mark.slow
def test_trials_of_a_real_device_by_the_fit_to_the_others(undrift):
    files = [
        data_path("broad", name) for name in ("03_undisturbed_slow_rotation_C.hdf5", "24_disturbed_tapping_A.hdf5")
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
