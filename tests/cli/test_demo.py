"""undrift demo: what it writes, says and holds itself to."""

import json

from cli_bench import contents
from undrift.calibration.store import read_calibration
from undrift.io.session import read_session


def test_demo_says_its_summary_as_one_object_and_writes_the_same(demo_answer):
    folder, answer = demo_answer
    assert (answer.code, answer.err) == (0, "")
    told = answer.json()
    assert told == json.loads((folder / "summary.json").read_text())
    assert set(told) == {"calibration", "study", "checks"}
    assert told["calibration"]["kind"] == "undrift.calibration"
    assert told["study"] is None
    assert all(set(check) == {"name", "value", "limit", "pass"} for check in told["checks"])
    assert len(told["checks"]) == 4
    assert all(check["pass"] is True and check["value"] <= check["limit"] for check in told["checks"])


def test_what_demo_writes_reads_back_and_leaves_no_scraps(bench):
    assert read_calibration(bench / "calibration.json").verdict.status == "good"
    assert read_session(bench / "session").turns
    assert {path.name for path in bench.iterdir()} == {
        "session", "trial.parquet", "reference.parquet", "calibration.json", "corrected.parquet", "report.html", "summary.json",
    }  # fmt: skip
    page = (bench / "report.html").read_text()
    assert page.count("<svg") == 2
    assert "Verdict: good" in page


def test_demo_again_in_its_own_folder_gives_the_same_numbers(undrift, tmp_path):
    first = undrift.good("demo", "--quick", "--out", tmp_path / "d")
    trial = (tmp_path / "d" / "trial.parquet").read_bytes()
    second = undrift.good("demo", "--quick", "--out", tmp_path / "d")
    assert first.out == second.out
    assert trial == (tmp_path / "d" / "trial.parquet").read_bytes()
    lines = first.out.splitlines()
    assert sum(line.startswith("pass ") for line in lines) == 4
    assert "calibrated" in lines[4]
    assert lines[-1].endswith("report.html")


def test_demo_keeps_off_a_folder_with_other_files(undrift, tmp_path):
    (tmp_path / "walk.csv").write_text("mine")
    before = contents(tmp_path)
    assert "wanted a new folder, or that of an earlier demo" in undrift.refused("demo", "--out", tmp_path)
    assert "got a file of that name" in undrift.refused("demo", "--out", tmp_path / "walk.csv")
    assert "make it first" in undrift.refused("demo", "--out", tmp_path / "a" / "b")
    assert contents(tmp_path) == before


def test_a_failed_check_ends_with_one(undrift, tmp_path, monkeypatch):
    from undrift.cli import demo

    monkeypatch.setattr(demo, "_checks", lambda *_: [demo.Check("never", 2.0, 1.0)])
    answer = undrift("demo", "--quick", "--out", tmp_path / "d")
    assert answer.code == 1
    assert answer.out.startswith("FAIL  never: 2 (at most 1)")
