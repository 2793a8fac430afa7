"""undrift study: from a plan to the answer, the page and the protocol; the same numbers with any number of workers."""

import json

import pyarrow.parquet as pq
import pytest

from testkit.long_calls import STUDY, long_call
from testkit.pages import faults_of
from undrift.commands.study import study
from undrift.programme import read_protocol
from undrift.study.case import EFFECTS


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.mark.slow
def test_a_plan_comes_to_an_answer_a_page_and_a_protocol(plan, tmp_path_factory, tmp_path):
    out = long_call(tmp_path_factory, "study") / "out"
    assert faults_of((out / "report.html").read_text()) == []
    summary = json.loads((out / "summary.json").read_text())
    told = summary["data"]
    (task,) = told["tasks"]
    assert [row["session"] for row in task["sessions"]] == ["hand", "three rates", "three rates, warm"]
    assert task["answers"][1]["session"] == "hand"
    assert task["answers"][1]["tested"] == 4
    low, high = task["sessions"][0]["single_deg"]
    assert low < task["sessions"][0]["mean_deg"] < high
    assert {effect["parameter"] for effect in task["effects"]} == {"cutoff_hz"}
    assert set(task["made_of"]) == set(EFFECTS)
    runs = pq.read_table(out / "runs.parquet").to_pandas()
    assert (runs["role"] == "session").sum() == 12
    for path in out.glob("session-*.toml"):
        assert read_protocol(path).turn_rate_max > 0.0
    again = study(plan, output=tmp_path / "again", workers=2)
    assert again.answer == summary["answer"]  # the same numbers on two processes
    assert pq.read_table(tmp_path / "again" / "runs.parquet").to_pandas().equals(runs)  # gaps (NaN) are equal in pandas


def test_what_cannot_be_run_is_refused(undrift, plan, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    for words, said in (
        ((), "study.toml"),
        ((plan, "--preset", "note"), "both"),
        ((plan, "--subjects", "2"), "3 or more"),
        ((plan, "--target-deg", "-1"), "above 0"),
        ((plan, "--categories", "ancient"), "ancient"),
        ((plan, "-o", tmp_path / "other"), "other files"),
        ((plan, "--workers", "0", "-o", tmp_path / "new"), "1 or more"),
        ((plan, "--workers", "2", "--scheduler", "tcp://127.0.0.1:9", "-o", tmp_path / "new"), "own workers"),
    ):
        answer = undrift("study", *words)
        assert answer.code == 2, answer
        assert said in answer.err
    assert not (tmp_path / "new").exists()
