"""undrift export: every target from the demo's calibration, what is printed, and what is refused without a trace."""

import pytest

from testkit.command_line import contents


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
