"""undrift study: from a study.toml to surface, summary and page; gone on with, refused, on a scheduler."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from cli_bench import contents

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


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "study.toml"
    path.write_text(TEXT)
    return path


def test_a_plan_comes_to_a_surface_a_summary_and_a_page(undrift, plan, tmp_path):
    out = tmp_path / "out"
    answer = undrift.good("study", plan, "-o", out, "--workers", "1")
    assert "small: 18 runs (sit_to_stand; 3 subjects), about" in answer.out.splitlines()[0]
    assert "the note agrees: " in answer.out
    assert {path.name for path in out.iterdir()} >= {"surface.parquet", "summary.json", "report.html"}
    table = pq.read_table(out / "surface.parquet")
    assert table.num_rows == 18
    told = json.loads((out / "summary.json").read_text())
    (task,) = told["tasks"]
    wanted = {"task", "optimum", "error_rms_deg", "error_max_deg", "p_value", "equivalent_protocols", "rig_minutes"}
    assert task.keys() >= wanted
    assert task["optimum"].keys() == {"cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps"}
    best = task["optimum"]
    rows = np.all([np.isclose(table.column(name).to_numpy(), value) for name, value in best.items()], axis=0)
    assert table.column("error_rms_deg").to_numpy()[rows].mean() == pytest.approx(task["error_rms_deg"])
    assert told["figure3"].keys() >= {
        "none_max_deg",
        "static_max_deg",
        "full_max_deg",
        "decrease_deg",
        "simulated_actual_max_deg",
    }
    assert told["figure3"]["decrease_deg"] > 3.2  # the note's figure, on the typical device
    before = (out / "surface.parquet").read_bytes()
    again = undrift.good("study", plan, "-o", out, "--workers", "2", "--json").json()
    assert again["tasks"] == told["tasks"]
    assert (out / "surface.parquet").read_bytes() == before


def test_another_seed_and_number_of_subjects(undrift, plan, tmp_path):
    step = tmp_path / "step.toml"
    step.write_text(plan.read_text().replace("sit_to_stand", "step"))
    words = ["study", step, "-o", tmp_path / "a", "--quick", "--seed", "3", "--subjects", "4", "--workers", "1"]
    told = undrift.good(*words, "--json").json()
    assert (told["seed"], told["subjects"], told["runs"]) == (3, 4, 16)
    assert told["figure3"] is None
    assert told["figure3_missing"] == "the study has no sit-to-stand of the library"


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
