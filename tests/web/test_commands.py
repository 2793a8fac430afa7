"""Commands as the bench calls them: one envelope, or one line of what went wrong."""

import asyncio
import json
import time
from pathlib import Path

import pytest

from undrift.web.commands import CommandOutcome, outcome_of, remarks_of, run_command


def test_a_command_answers_with_its_envelope(tmp_path: Path) -> None:
    outcome = asyncio.run(run_command(["sample", "first"], tmp_path, lambda line: None))
    assert outcome.code == 0
    assert outcome.done
    assert outcome.answer["kind"] == "undrift.sample"
    assert outcome.answer["folder"] == "first"


@pytest.mark.slow
def test_a_command_that_refuses_gives_its_line(tmp_path: Path) -> None:
    outcome = asyncio.run(run_command(["info", "none.csv"], tmp_path, lambda line: None))
    assert (outcome.code, outcome.done) == (2, False)
    assert "none.csv" in outcome.error
    assert "\n" not in outcome.error


@pytest.mark.slow
def test_no_text_of_a_command_names_the_folders_of_the_bench(tmp_path: Path) -> None:
    place = tmp_path / "uploads" / "0123456789ab"
    place.mkdir(parents=True)
    (place / "Gehversuch März.csv").write_text("nothing\n")
    for path in (place / "Gehversuch März.csv", Path("uploads/0123456789ab/Gehversuch März.csv")):
        outcome = asyncio.run(run_command(["info", path, "--report", place / "a.bmp"], tmp_path, lambda line: None))
        assert outcome.error.startswith(("a.bmp: expected a name ending", "Gehversuch März.csv: "))
        assert str(tmp_path) not in json.dumps(outcome.answer, ensure_ascii=False)
        assert "uploads" not in json.dumps(outcome.answer, ensure_ascii=False)


def test_all_that_a_command_noticed_is_a_remark_once_the_gravest_first() -> None:
    warning = {"level": "warn", "text": "Signs differ: y", "action": "say which"}
    outside = {"level": "warn", "text": "20 s outside", "action": ""}
    answer = {
        "findings": [warning],
        "recordings": [{"findings": [warning, outside], "notes": ["left out", "20 s outside"]}],
        "trials": [{"findings": [{"level": "info", "text": "aligned", "action": ""}], "notes": ["aligned"]}],
        "verdict": {"findings": [{"level": "fail", "text": "no faces", "action": "record six"}]},
        "problems": ["gap"],
        "notes": "no list",
        "result": {"recordings": [{"notes": ["left out"]}]},
    }
    found = [(one.level, one.text, one.action) for one in remarks_of(answer)]
    assert found[:3] == [
        ("fail", "no faces", "record six"),
        ("warn", "Signs differ: y", "say which"),
        ("warn", "20 s outside", ""),
    ]
    assert sorted(text for level, text, _ in found if level == "info") == ["aligned", "gap", "left out"]
    assert len(found) == 6


def test_a_command_that_does_not_end_is_ended(tmp_path: Path) -> None:
    began = time.monotonic()
    words = ["rig", "check", "--rig", "simulated:?clock_speed=1", "--seconds", "600"]
    outcome = asyncio.run(run_command(words, tmp_path, lambda line: None, longest_s=3.0))
    assert outcome == CommandOutcome(
        code=2, error="rig: the command did not finish within 3 s. Use a shorter recording."
    )
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize(
    ("code", "text", "lines", "error"),
    [
        (0, "", [], "the command ended without an answer (exit 0)"),
        (0, "no json", [], "the command ended without an answer (exit 0)"),
        (-9, "", [], "the command ended without an answer (exit -9)"),
        (2, "", ["working", "undrift: a: wanted b, got c; do d", ""], "a: wanted b, got c; do d"),
        (3, json.dumps({"error": {"text": "rig: lost"}}), ["undrift: other"], "rig: lost"),
    ],
)
def test_whatever_a_command_leaves_becomes_one_line(code: int, text: str, lines: list[str], error: str) -> None:
    outcome = outcome_of(code, text, lines)
    assert not outcome.done
    assert outcome.error.startswith(error)
