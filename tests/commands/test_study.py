"""undrift study: from a study.toml to surface, summary and page; gone on with, refused, on a scheduler."""

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest

from testkit.command_line import contents
from testkit.data import data_path
from testkit.pages import faults_of
from undrift.commands.study import study

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
    assert "small: 18 runs (sit_to_stand; 3 subjects) on 1 worker" in first
    assert stages == [
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
    assert {"calibration sessions: 6 of 6 units of work", "what the error is made of: 49 of 49 units of work"} <= {
        *told
    }
    assert studied.summary().answer in answer.out
    assert {path.name for path in out.iterdir()} >= {"surface.parquet", "summary.json", "report.html"}
    table = pq.read_table(out / "surface.parquet")
    assert table.num_rows == 18
    told = json.loads((out / "summary.json").read_text())
    assert (told["objective"], told["timing"]) == ("rms", "offline")
    (task,) = told["tasks"]
    assert set(task["errors"]) == {name for name in table.column_names if name.startswith("error_")}
    assert task["errors"]["error_offline_rms_deg"] == pytest.approx(task["error_rms_deg"])
    (split, *_) = task["made_of"]
    assert split["together"] + sum(term["share"] for term in split["terms"]) == pytest.approx(1.0)
    assert {term["effect"] for term in split["terms"]} >= {"delay", "gyroscope offset", "accelerometer offset"}
    assert "study.error_split" in {item["code"] for item in task["findings"]}
    wanted = {"task", "optimum", "error_rms_deg", "error_max_deg", "p_value", "equivalent_protocols", "rig_minutes"}
    assert task.keys() >= wanted
    assert task["equivalent_protocols"] + task["worse_protocols"] + task["undecided_protocols"] == task["protocols"]
    assert told["margin_deg"] == 0.087
    judged = next(effect["judged"] for effect in task["effects"] if effect["judged"])
    assert judged["verdict"] in ("better", "equivalent", "not decidable")
    assert judged["decisions"][0]["margin"] == 0.087
    assert {value["parameter"] for value in task["note"]["values"]} == task["optimum"].keys()
    assert task["optimum"].keys() == {"cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps"}
    best = task["optimum"]
    rows = np.all([np.isclose(table.column(name).to_numpy(), value) for name, value in best.items()], axis=0)
    assert table.column("error_offline_rms_deg").to_numpy()[rows].mean() == pytest.approx(task["error_rms_deg"])
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
    assert first_told["tasks"] == told["tasks"]  # with one worker
    assert (told["rivals"], told["rivals_missing"]) == (None, "not asked for")
    assert (out / "surface.parquet").read_bytes() == before


def test_a_stated_rest_that_is_none_ends_with_two_and_one_line(undrift, tmp_path):
    file = data_path("c3d", "squat.c3d.gz")
    path = tmp_path / "squat.toml"
    motion = f'[task.motion]\nfile = "{file}"\nbody = "pelvis"\nup = "y"\nrest_s = 1.0\n'
    path.write_text(TEXT.replace('"sit_to_stand"', '"squat"') + motion)
    line = undrift.refused("study", path, "-o", tmp_path / "out", "--no-rivals")
    assert "wanted a body at rest for its first rest_s = 1 s, got one that turns at up to 67.3 deg/s" in line
    assert "it is still for 0 s: take a recording that begins with 0.5 s at rest or more, or set hold = true" in line
    assert not (tmp_path / "out").exists()


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
