"""undrift study: from a study.toml to surface, summary and page; gone on with, refused, on a scheduler."""

import inspect
import json
import math
import re
from dataclasses import replace
from shutil import rmtree

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from testkit.command_line import contents
from testkit.data import data_path
from testkit.pages import faults_of
from undrift.commands.study import study
from undrift.sim.device.truth import true_calibration
from undrift.study import figure3 as figure3_module
from undrift.study import outcome as outcome_module
from undrift.study.figure3 import COMPARED, DrawnRow
from undrift.study.rivals import compare_rivals

pytestmark = pytest.mark.usefixtures("computed_once")

TEXT = """
[study]
name = "small"
subjects = 3
[[task]]
name = "sit_to_stand"
[task.space]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [5.0]
turn_rate_min_dps = [5.0]
turn_rate_max_dps = [50.0, 70.0, 90.0]
[task.protocol]
dwell_s = 1.0
"""


def done(undrift, *words):
    """Return the answer to a study that succeeds; where stderr is no terminal it has a line for each stage."""
    answer = undrift(*words)
    assert answer.code == 0, answer
    assert all(line.startswith("undrift study: ") for line in answer.err.splitlines())
    return answer


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "study.toml"
    path.write_text(TEXT)
    return path


@pytest.mark.slow
def test_a_plan_comes_to_a_surface_a_summary_and_a_page(undrift, plan, tmp_path):
    out = tmp_path / "out"
    copy = tmp_path / "copy.html"
    answer = done(undrift, "study", plan, "-o", out, "--workers", "1", "--no-rivals", "--report", copy)
    assert faults_of(copy.read_text()) == []
    assert re.search(
        r"Sit to stand: [\d.]+ Hz and rates of .* deg/s are (enough|the best that were tried), ", copy.read_text()
    )
    first, *stages = (line.removeprefix("undrift study: ") for line in answer.err.splitlines())
    assert "small: 18 runs (sit_to_stand; 3 subjects) on 1 worker, in all about" in first
    assert [line.split(", about")[0] for line in stages] == [
        "calibration sessions",
        "the other cohort",
        "what the error is made of",
    ]
    # its values are at the ends of what is tried
    assert "task: sit to stand\n  the note: not decidable\n" in answer.out
    assert "0.048, its own" in answer.out
    before, shares = (out / "surface.parquet").read_bytes(), []
    first_told = json.loads((out / "summary.json").read_text())
    studied = study(
        plan, output=out, workers=2, no_rivals=True, progress=lambda what, share: shares.append((share, what))
    )
    assert [share for share, _ in shares] == sorted(share for share, _ in shares)
    told = [what for _, what in shares]
    assert {"calibration sessions: 6 of 6 units of work", "what the error is made of: 62 of 62 units of work"} <= {
        *told
    }
    assert studied.summary().answer in answer.out
    assert {path.name for path in out.iterdir()} >= {"surface.parquet", "summary.json", "report.html"}
    table = pq.read_table(out / "surface.parquet")
    assert table.num_rows == 18
    told = json.loads((out / "summary.json").read_text())
    assert (told["objective"], told["timing"]) == ("rms", "real time")
    (task,) = told["tasks"]
    assert set(task["errors"]) == {name for name in table.column_names if name.startswith("error_")}
    assert task["errors"]["error_rms_deg"] == pytest.approx(task["error_rms_deg"])
    (split, *_) = task["made_of"]
    assert split["together"] + sum(term["share"] for term in split["terms"]) == pytest.approx(1.0)
    assert {term["effect"] for term in split["terms"]} >= {"delay", "gyroscope offset", "accelerometer offset"}
    assert "study.error_split" in {item["code"] for item in task["findings"]}
    wanted = {"task", "optimum", "error_rms_deg", "error_max_deg", "p_value", "equivalent_protocols", "rig_minutes"}
    assert task.keys() >= wanted
    assert task["equivalent_protocols"] + task["worse_protocols"] + task["undecided_protocols"] == task["protocols"]
    assert (told["margin_deg"], task["one_way"]["values"]) == (0.087, 18)
    judged = next(effect["judged"] for effect in task["effects"] if effect["judged"])
    assert judged["verdict"] in ("better", "equivalent", "not decidable")
    assert judged["decisions"][0]["margin"] == 0.087
    assert {value["parameter"] for value in task["note"]["values"]} == task["optimum"].keys()
    assert task["optimum"].keys() == {"cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps"}
    best = task["optimum"]
    rows = np.all([np.isclose(table.column(name).to_numpy(), value) for name, value in best.items()], axis=0)
    assert table.column("error_rms_deg").to_numpy()[rows].mean() == pytest.approx(task["error_rms_deg"])
    assert told["figure3"].keys() >= {
        "none_max_deg",
        "static_max_deg",
        "full_max_deg",
        "rest_max_deg",
        "full_and_rest_max_deg",
        "decrease_deg",
        "simulated_actual_max_deg",
    }
    assert told["figure3"]["decrease_deg"] > 3.2  # the note's figure, on the typical device
    assert (first_told["tasks"], first_told["designs"]) == (told["tasks"], told["designs"])  # by one worker
    assert [(row["degree"], row["criterion"]) for row in told["designs"]] == [
        (degree, name) for degree in (1, 3) for name in ("uniform", "D", "I")
    ]
    assert (told["rivals"], told["rivals_missing"], told["real"]) == (None, "not asked for", None)
    assert (out / "surface.parquet").read_bytes() == before


WIDE = """
[study]
name = "wide"
subjects = 6
[[task]]
name = "step"
[task.space]
cutoff_hz = [1.0, 2.0, 4.0, 11.4]
turn_rate_step_dps = [6.0]
turn_rate_min_dps = [9.0]
turn_rate_max_dps = [15.0, 21.0, 27.0, 33.0]
[task.protocol]
dwell_s = 1.0
bracket_s = 3.0
set_points_c = [18.0, 36.0, 54.0, 75.0]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "rounds",
    [((16, 3), (8, 6)), ((16, 3), (8, 6), (4, 12))],
    ids=["6 subjects", "12 subjects"],
)
def test_halving_finds_the_optimum_of_the_grid_with_fewer_runs(undrift, rounds, tmp_path):
    plan, subjects, of_grid = tmp_path / "study.toml", rounds[-1][1], 16 * rounds[-1][1]
    plan.write_text(WIDE.replace("subjects = 6", f"subjects = {subjects}"))
    words = "study", plan, "-o", tmp_path / "grid", "--workers", "1", "--no-rivals", "--json"
    grid = done(undrift, *words).json()
    assert (grid["search"], grid["runs"], grid["tasks"][0]["halving"]) == ("grid", of_grid, None)
    answer = done(undrift, "study", plan, "-o", tmp_path / "h", "--workers", "1", "--no-rivals", "--search", "halving")
    halved = json.loads((tmp_path / "h" / "summary.json").read_text())
    (task,), (whole,) = halved["tasks"], grid["tasks"]
    assert task["optimum"] == whole["optimum"]
    for name in ("error_rms_deg", "error_max_deg", "rig_minutes"):  # a protocol has the same noise in both searches
        assert task[name] == pytest.approx(whole[name], rel=1e-12)
    counts = [(len(each["protocols"]), each["subjects"]) for each in task["halving"]["rounds"]]
    assert counts == list(rounds)
    met = sum(count * (each - before) for (count, each), before in zip(rounds, (0, 3, 6), strict=False))
    front = halved["runs"] - met  # what seems to be on the front of error against minutes meets everyone
    assert halved["search"] == "halving"
    assert front in range(0, 8 * subjects + 1, subjects)
    assert (task["halving"]["runs"], task["halving"]["runs_of_grid"]) == (met + front, of_grid)
    assert all(low < row["error_rms_deg"] < high for row in task["pareto"] for low, high in [row["interval_deg"]])
    first, *_, last = (each["protocols"] for each in task["halving"]["rounds"])
    best = min(last, key=lambda row: row["mean_deg"])
    assert {name: best[name] for name in task["optimum"]} == task["optimum"]
    assert {tuple(row.values())[:4] for row in last} <= {tuple(row.values())[:4] for row in first}
    table = pq.read_table(tmp_path / "h" / "surface.parquet")
    assert table.num_rows == met + front
    assert f"undrift study: step, round 2 of {len(rounds)}: 8 protocols on 6 subjects" in answer.err.splitlines()
    protocols, people = (", ".join(map(str, column)) for column in zip(*rounds, strict=True))
    wanted = f"Successive halving: {protocols} protocols met {people} subjects; {met + front} runs, full grid {of_grid}"
    assert wanted in (tmp_path / "h" / "report.html").read_text().replace("</strong>", "")


@pytest.mark.slow
def test_a_halving_resumes_and_keeps_to_its_folder(undrift, tmp_path):
    text = WIDE.replace("subjects = 6", 'subjects = 6\nsearch = "halving"').replace("[1.0, 2.0, 4.0, 11.4]", "[11.4]")
    plan = tmp_path / "study.toml"
    plan.write_text(text)
    words = ["study", plan, "-o", tmp_path / "h", "--workers", "1", "--no-rivals", "--json"]
    whole = done(undrift, *words)
    pieces = sorted((tmp_path / "h" / "halving").glob("step/round-*/runs/*.parquet"))
    assert len(pieces) == 6
    kept = {piece: piece.stat().st_mtime_ns for piece in pieces[:4]}
    for piece in pieces[4:]:
        piece.unlink()
    again = done(undrift, *words)
    assert again.json() == whole.json()
    assert {piece: piece.stat().st_mtime_ns for piece in pieces[:4]} == kept
    assert all(piece.exists() for piece in pieces)
    line = undrift.refused(*words[:-1], "--search", "grid")
    assert "wanted an empty folder or one of this study" in line
    plan.write_text(text.replace('"halving"', '"guess"'))
    assert "grid" in undrift.refused(*words)


@pytest.mark.parametrize("search", ["grid", "halving", "cma"])
def test_a_study_of_the_dwell_and_the_gain_comes_to_its_end_by_every_search(undrift, tmp_path, search):
    if search == "cma":
        pytest.importorskip("cma")
    path, out = tmp_path / "study.toml", tmp_path / "out"
    lists = "[50.0, 70.0, 90.0]\ngain = [10.0, 20.0]\nfaces = [5, 6]\ndwell_s = [0.5, 1.0]"
    fixed = "subjects = 3\n[study.trial]\ntissue_deg_per_m_s2 = 0\nimpact_g = 0"  # other draws, other finalists
    text = TEXT.replace("subjects = 3", fixed).replace("sit_to_stand", "step")
    path.write_text(text.replace("[50.0, 70.0, 90.0]", lists))
    words = ("study", path, "-o", out, "--workers", "1", "--no-rivals", "--search", search, "--candidates", "24")
    answer = done(undrift, *words)
    assert re.search(r"\bstep: optimum \(.*dwell \(s\) ", answer.out, re.M)
    for heading in ("gain of the gyroscopes&#39; amplifier", "faces", "dwell (s)"):
        assert heading in (out / "report.html").read_text()
    (task,) = json.loads((out / "summary.json").read_text())["tasks"]
    assert {"gain", "faces", "dwell_s"} <= set(task["optimum"])
    assert {"gain", "faces", "dwell_s"} & {row["parameter"] for row in task["made_of"]}


@pytest.mark.slow
def test_values_that_no_protocol_has_are_named_with_the_reason(undrift, plan, tmp_path):
    text = TEXT.replace("step_dps = [5.0]", "step_dps = [5.0, 70.0]").replace("[50.0, 70.0, 90.0]", "[5.0, 50.0, 90.0]")
    path = tmp_path / "more.toml"
    path.write_text(text)
    words = ("study", path, "-o", tmp_path / "out", "--workers", "1", "--no-rivals")
    answer, details = done(undrift, *words), done(undrift, *words, "--details").out
    for reason in (
        "step d 70 deg/s (divides no span from an omega_m to an omega_M)",
        "omega_M 5 deg/s (not above any omega_m)",
    ):
        assert f"sit_to_stand: Not tried: {reason}" in answer.err
        assert reason in details
        assert f"<strong>Not tried</strong>: {reason}" in (tmp_path / "out" / "report.html").read_text()
    (task,) = json.loads((tmp_path / "out" / "summary.json").read_text())["tasks"]
    assert [(row["parameter"], row["value"]) for row in task["untried"]] == [
        ("turn_rate_step_dps", 70.0),
        ("turn_rate_max_dps", 5.0),
    ]
    assert task["untried"][1]["reason"] == "not above any omega_m"


def test_a_stated_rest_that_is_none_ends_with_two_and_one_line(undrift, tmp_path):
    file = data_path("c3d", "squat.c3d.gz")
    path = tmp_path / "squat.toml"
    motion = f'[task.motion]\nfile = "{file}"\nbody = "pelvis"\nup = "y"\nrest_s = 1.0\n'
    path.write_text(TEXT.replace('"sit_to_stand"', '"squat"') + motion)
    line = undrift.refused("study", path, "-o", tmp_path / "out", "--no-rivals")
    assert "wanted a body at rest for its first rest_s = 1 s, got one that turns at up to 67.3 deg/s" in line
    assert "it is still for 0 s: take a recording that begins with 0.5 s at rest or more, or set hold = true" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_another_seed_and_number_of_subjects(undrift, plan, tmp_path):
    step = tmp_path / "step.toml"
    step.write_text(plan.read_text().replace("sit_to_stand", "step"))
    words = ["study", step, "-o", tmp_path / "a", "--quick", "--seed", "3", "--subjects", "4", "--workers", "1"]
    told = done(undrift, *words, "--json").json()
    assert (told["seed"], told["subjects"], told["runs"]) == (3, 4, 16)
    assert (told["rivals"], told["rivals_missing"]) == (None, "not asked for")  # of a quick study
    assert told["figure3"] is None
    assert told["figure3_missing"] == "the study has no sit-to-stand of the library"


@pytest.mark.slow
def test_a_unit_without_runs_is_told_and_judged_by_a_mixed_model(undrift, plan, tmp_path):
    step = tmp_path / "step.toml"
    step.write_text(plan.read_text().replace("sit_to_stand", "step"))
    words = ["study", step, "-o", tmp_path / "a", "--subjects", "5", "--workers", "1", "--no-rivals", "--json"]
    (whole,) = done(undrift, *words).json()["tasks"]
    cutoff, *_, greatest = whole["effects"]
    assert (cutoff["missing"], cutoff["mixed_model"], whole["failed_runs"], whole["left_out"]) == (0, None, 0, [])
    assert cutoff["anova"]["dof"] == [1.0, 4.0]
    assert greatest["anova"].keys() >= {
        "p_greenhouse_geisser",
        "p_huynh_feldt",
        "generalized_eta_squared",
        "sphericity",
    }
    assert greatest["anova"]["sphericity"].keys() >= {"mauchly_w", "p_value", "greenhouse_geisser", "huynh_feldt"}
    piece = tmp_path / "a" / "runs" / "step-0002-5.parquet"
    table = pq.read_table(piece)  # as the unit leaves it when a protocol cannot calibrate its device
    for name in ("error_rms_deg", "error_max_deg"):
        place = table.schema.get_field_index(name)
        table = table.set_column(place, name, pa.array(np.full(table.num_rows, np.nan)))
    pq.write_table(table, piece)
    rmtree(tmp_path / "a" / "testing")  # of the optimum that the whole study had
    answer = done(undrift, *words[:-1])
    (task,) = json.loads((tmp_path / "a" / "summary.json").read_text())["tasks"]
    cutoff, *_, greatest = task["effects"]
    assert (task["failed_runs"], cutoff["missing"], cutoff["anova"]) == (3, 1, None)
    assert cutoff["mixed_model"]["values"] == 9
    assert cutoff["f"] == cutoff["mixed_model"]["f"]
    assert greatest["anova"]["subjects"] == 5
    codes = {item["code"]: item["values"] for item in task["findings"]}
    assert codes["study.runs_missing"] == {"missing": 3, "runs": 30}
    assert codes["study.mixed_model"] == {"parameters": ["cut-off"]}
    page = (tmp_path / "a" / "report.html").read_text()
    assert "<strong>Runs missing</strong>: 3 of 30" in page
    assert "<strong>Mixed model for parameters with missing runs</strong>: cut-off." in page
    assert "Optional stopping: adding subjects until p falls below the level" in page
    assert "- Runs missing 3 of 30" in " ".join(answer.out.split())


@pytest.mark.slow
def test_rivals_are_compared_unless_told_otherwise_and_come_to_the_summary(undrift, plan, tmp_path, monkeypatch):
    asked = []

    def few(planned, **words):
        asked.append((planned.kind, planned.seed, planned.tasks, planned.margin_deg))
        return compare_rivals(
            replace(planned, units=1, minutes=3.0, methods=("data_sheet", "rate_table", "mocap")), **words
        )

    monkeypatch.setattr(outcome_module, "compare_rivals", few)

    def drawn(kind, **words):
        assert (kind, words["seed"], words["excursion_k"]) == ("enc03j_3031", 0, 12.5)
        spread = {"lower_deg": 0.1, "median_deg": 0.2, "upper_deg": 0.3, "simulated_deg": (0.1, 0.15, 0.2)}
        apart = {"apart_deg": (0.01, 0.02, 0.03), "within": 2, "correlation": 0.9, "correlation_interval": (0.8, 0.95)}
        over_units = {"largest_correlation": 1.0, "largest_interval": (math.nan, math.nan)}
        return tuple(DrawnRow(correction=name, units=2, **spread, **apart, **over_units) for name in COMPARED)

    monkeypatch.setattr(outcome_module, "drawn_cohort", drawn)  # drawn_cohort itself: study/test_figure3.py
    # no thermal fit, half a minute of wearing: the figure and its effects themselves are of study/test_figure3.py
    monkeypatch.setattr(figure3_module, "calibrated", lambda device, **_: (true_calibration(device, temp_c=25.0),) * 3)
    monkeypatch.setattr(figure3_module, "WORN_S", 30.0)
    for name in ("figure3", "effect_table"):
        monkeypatch.setattr(outcome_module, name, inspect.unwrap(getattr(outcome_module, name)))
    told = done(undrift, "study", plan, "-o", tmp_path / "out", "--workers", "1", "--json").json()
    assert [row["correction"] for row in told["figure3_drawn"]] == told["figure3"]["compared"]
    assert asked == [("enc03j_3031", 0, ("sit_to_stand",), pytest.approx(0.15))]
    assert [row["method"] for row in told["rivals"]] == ["data_sheet", "rate_table", "mocap"]
    assert told["rivals"][1]["error_rms_deg"]["median"] < told["rivals"][2]["error_rms_deg"]["median"]
    assert told["rivals_missing"] is None
    triads = {(row["triad"], row["method"]): row for row in told["rival_triads"]}
    assert triads["accel", "mocap"]["calibrated"] == triads["gyro", "rate_table"]["calibrated"] == 1
    assert triads["accel", "data_sheet"]["worth"][0]["decision"] is None  # of one unit there is no verdict
    claims = {row["claim"]: row for row in told["claims"]}
    arm = claims["A robot arm is sufficiently accurate"]
    assert (arm["verdict"], arm["evidence"]) == ("not decidable", [])
    assert "this method and the rate table on three units" in arm["lacks"]
    alone = {row["effect"]: row["simulated_actual_max_deg"] for row in told["figure3_effects"]}
    assert list(alone) == ["noise alone", "hysteresis", "thermometer", "adc_inl", "g_sensitivity", "all"]
    assert alone["all"] == told["figure3"]["simulated_actual_by_level_deg"]  # the figure is the last of its own table
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Discussion as an experiment: other ways to calibrate" in page
    assert "Accelerometers alone" in page
    assert "Claims of the note" in page
    assert "Not in this study: prices" in page
    assert "Figure 3: simulated against actual, effect by effect" in page
    assert "Drawn units: 2 units of the kind" in page
    assert "0.90 [0.80 to 0.95]" in page
    assert len(told["figure3"]["correlation"]) == 5
    assert all(-1.0 <= r <= 1.0 for r in told["figure3"]["correlation"])
    assert "Figure 2: how the drift is compensated" in page
    assert "slope over temperature was inferred from the note" in page


@pytest.mark.slow
def test_real_recordings_are_judged_beside_the_study(undrift, plan, tmp_path):
    names = "32_disturbed_attached_magnet_1cm.hdf5", "35_disturbed_attached_magnet_4cm.hdf5"
    trials = [f'[[trial]]\nrecording = "{data_path("broad", name)}"\ndevice = "D"\n' for name in names]
    sit, stance = data_path("mocap_sit_to_stand", "STS1.trc.gz"), data_path("posturography", "PDS13OF1grf.txt.gz")
    real = tmp_path / "real.toml"
    real.write_text(
        "".join(trials)
        + f'[[capture]]\nfile = "{sit}"\ntask = "sit_to_stand"\nbody = "pelvis"\nup = "y"\n'
        + f'[[stance]]\nfile = "{stance}"\nmass_kg = 65.35\ncondition = "open on foam"\n'
    )
    answer = done(undrift, "study", plan, "-o", tmp_path / "out", "--workers", "1", "--quick", "--real", real)
    told = json.loads((tmp_path / "out" / "summary.json").read_text())["real"]
    none, rest, calibrated, *left_in = told["trials"]
    assert [(level["level"], level["rounding"]) for level in told["trials"]] == [
        (name, rounding) for rounding in ("undone", "left in") for name in ("none", "rest", "calibrated")
    ]
    for level, other in zip((none, rest, calibrated), left_in, strict=True):
        assert level["median"] != other["median"]
    assert calibrated["median"]["rmse_total_deg"] < 0.67 * rest["median"]["rmse_total_deg"]  # as tests/authority holds
    assert rest["median"]["rmse_total_deg"] < none["median"]["rmse_total_deg"]
    assert {row["measure"] for row in told["captures"]} >= {"lean", "duration"}
    assert [row["level"] for row in told["worn"]["rows"]] == ["none", "static", "full"]
    assert any("eyes closed on foam" in row["note"] == row["said"] for row in told["stances"])
    assert "agreement over trials: 3 trials or more are needed, 2 were given" in told["lacks"]
    page = (tmp_path / "out" / "report.html").read_text()
    for name in names:
        rows = re.findall(
            rf"^ {name.split('.')[0]} +(none|rest|calibrated) +(undone|left in) +[\d.]+ ", answer.out, re.M
        )
        assert rows == [(level, how) for how in ("undone", "left in") for level in ("none", "rest", "calibrated")]
    assert re.findall(r"^ STS1 +(none|static|full) +[\d.]+ ", answer.out, re.M) == ["none", "static", "full"]
    assert re.search(r"^ PDS13OF1grf +posturography +.* (yes|no) *$", answer.out, re.M)
    assert "Real recordings: devices worn beside optics" in page
    assert "Real recordings: what is not there" in page


def test_real_recordings_that_cannot_be_read_stop_the_study_before_it_runs(undrift, plan, tmp_path):
    real = tmp_path / "real.toml"

    def refused(text):
        real.write_text(text)
        line = undrift.refused("study", plan, "-o", tmp_path / "out", "--real", real)
        assert not (tmp_path / "out").exists()
        return line

    assert "check the path" in undrift.refused("study", plan, "-o", tmp_path / "out", "--real", tmp_path / "none.toml")
    assert "wanted a [[trial]], a [[capture]], a [[stance]] or [actual], got none" in refused("# none\n")
    assert "one of 'B'; a fit that judges a trial must come from others" in refused(
        '[[trial]]\nrecording = "a.hdf5"\ndevice = "B"\n'
    )
    assert "a.hdf5" in refused('[[trial]]\nrecording = "a.hdf5"\ndevice = "B"\n' * 2)
    assert "STS.trc" in refused('[[capture]]\nfile = "STS.trc"\ntask = "squat"\nbody = "pelvis"\nup = "y"\n')
    assert "wanted a body and up, got no up" in refused(
        '[[capture]]\nfile = "STS.trc"\ntask = "squat"\nbody = "pelvis"\n'
    )
    assert "foot.txt" in refused('[[stance]]\nfile = "foot.txt"\nmass_kg = 60.0\ncondition = "open on firm"\n')
    (tmp_path / "bare.csv").write_text("time,gyro_x\n0.0,0.0\n")
    assert "got none and no BROAD file, which holds its own" in refused(
        '[[trial]]\nrecording = "bare.csv"\ndevice = "B"\n' * 2
    )
    poses = "".join(f"{0.01 * k:.2f},1,0,0,0\n" for k in range(200))
    (tmp_path / "poses.csv").write_text("time_s,q_w,q_x,q_y,q_z\n" + poses)
    assert "wanted poses with positions, got none; risings are found by the height" in refused(
        '[[capture]]\nfile = "poses.csv"\ntask = "squat"\n'
    )


def test_what_study_refuses(undrift, plan, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("kept")
    before = contents(tmp_path)

    def refused(*words):
        line = undrift.refused("study", *words)
        assert contents(tmp_path) == before
        return line

    assert "wanted a study.toml or --preset note, got neither" in refused()
    assert "got both" in refused(plan, "--preset", "note")
    assert "wanted a new folder, or that of this study" in refused(plan, "-o", tmp_path / "mine")
    assert "wanted 0 or more, got -1" in refused(plan, "--seed", "-1", "-o", tmp_path / "a")
    assert "three subjects or more" in refused(plan, "--subjects", "2", "-o", tmp_path / "a")
    assert "--scheduler or --workers, got both" in refused(
        plan, "--scheduler", "tcp://127.0.0.1:9", "--workers", "2", "-o", tmp_path / "a"
    )
    assert "check the path" in refused(tmp_path / "none.toml", "-o", tmp_path / "a")
    assert "make it first" in refused(plan, "-o", tmp_path / "no" / "folder")


def test_a_study_that_is_refused_starts_no_process(undrift, tmp_path, monkeypatch):
    from undrift.study.run import Pool

    monkeypatch.setattr(Pool, "start", lambda *_: pytest.fail("a process was started"))
    (tmp_path / "walk.csv").write_text("mine")
    assert "wanted a new folder" in undrift.refused("study", "--preset", "note", "--workers", 2, "-o", tmp_path)
