"""undrift export: every target from the demo's calibration, what is printed, and what is refused without a trace."""

import json

import pytest

from testkit.command_line import contents
from undrift.base.codec import tree_of
from undrift.findings import finding
from undrift.model import Verdict


@pytest.mark.parametrize(("target", "name"), [("c", "a.h"), ("constants", "a.json"), ("constants", "b.h")])
def test_every_target_is_written_and_says_what_it_cannot_carry(undrift, bench, tmp_path, target, name):
    output = tmp_path / name
    words = ["export", bench / "calibration.json", "--target", target, "-o", output]
    told = undrift.good(*words, "--json").json()
    assert told["data"]["target"] == target
    assert told["written"] == [str(output), *([str(tmp_path / "a.c")] if target == "c" else [])]
    assert sorted(contents(tmp_path)) == sorted(name.rsplit("/", 1)[1] for name in told["written"])
    parts = [row["part"] for row in told["tables"]["not_contained"]]
    assert any("uncertainties" in part for part in parts)
    answer = undrift.good(*words)
    for text in (*parts, *told["notes"]):
        assert text in answer.out
    assert f"Wrote {output}" in answer.out


def test_a_bad_verdict_is_written_and_ends_with_1(undrift, bench, tmp_path):
    held = json.loads((bench / "calibration.json").read_text())
    held["verdict"] = tree_of(Verdict.of(finding("gyro.scale_factor", "fail", "The scale is 12 % off.")))
    (tmp_path / "bad.json").write_text(json.dumps(held))
    answer = undrift("export", tmp_path / "bad.json", "--target", "c", "-o", tmp_path / "a.h")
    assert (answer.code, answer.err) == (1, "")
    assert "The verdict of the calibration is bad" in answer.out
    assert (tmp_path / "a.c").exists()
