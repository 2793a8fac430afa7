"""undrift export: every target from the demo's calibration, what is printed, and what is refused without a trace."""

import json
import subprocess
import sys

import pytest

from testkit.c_build import STRICT
from testkit.command_line import contents
from undrift.base.codec import tree_of
from undrift.findings import finding
from undrift.io.store import read_calibration
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


@pytest.mark.slow
@pytest.mark.parametrize(("flag", "kind"), [([], "float"), (["-DFOOT_DOUBLE"], "double")])
def test_the_c_source_compiles_in_the_arithmetic_that_was_chosen(undrift, bench, tmp_path, flag, kind):
    words = [
        "export",
        bench / "calibration.json",
        "--target",
        "c",
        "-o",
        tmp_path / "foot-1.h",
        "--prefix",
        "foot",
    ]
    undrift.good(*words)
    body = f"{kind} x = 0;\n    foot_t *y = &x;\n    return (int)*y;"
    (tmp_path / "main.c").write_text(f'#include "foot-1.h"\nint main(void)\n{{\n    {body}\n}}\n')
    subprocess.run(
        ["gcc", *STRICT, *flag, tmp_path / "foot-1.c", tmp_path / "main.c", "-o", tmp_path / "a"], check=True
    )


BOARD = """
from undrift.export import Target
from undrift.export.losses import Exported

def write(calibration, options, name):
    text = f"{calibration.device} {options.prefix} {name}"
    return Exported(text=text, more=("beside",), not_carried=("tables",), notes=("flash it",))

TARGET = Target(endings=(".bin",), more=(".map",), write=write)
"""
POINTS = "[undrift.targets]\nboard = board:TARGET\nc = board:TARGET\nodd = board:write\n"


def test_another_package_adds_a_target_by_an_entry_point(undrift, bench, tmp_path, monkeypatch):
    installed, out = tmp_path / "installed", tmp_path / "out"
    information = installed / "board-1.0.dist-info"
    information.mkdir(parents=True)
    out.mkdir()
    (installed / "board.py").write_text(BOARD)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: board\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(installed)
    calibration = bench / "calibration.json"
    words = ["export", calibration, "-o", out / "a.bin", "--prefix", "left", "--target"]
    made = undrift.good(*words, "board", "--json").json()
    assert contents(out) == {
        "a.bin": f"{read_calibration(calibration).device} left a.bin".encode(),
        "a.map": b"beside",
    }
    assert (made["tables"]["not_contained"], made["notes"]) == ([{"part": "tables"}], ["flash it"])
    assert made["written"] == [str(out / "a.bin"), str(out / "a.map")]
    assert "unknown target 'press'" in undrift.refused(*words, "press")
    assert "odd: expected a Target" in undrift.refused(*words, "odd")
    assert "expected a name ending in .h" in undrift.refused(*words, "c")  # its own targets cannot be replaced
    sys.modules.pop("board")


def test_a_bad_verdict_is_written_and_ends_with_1(undrift, bench, tmp_path):
    held = json.loads((bench / "calibration.json").read_text())
    held["verdict"] = tree_of(Verdict.of(finding("gyro.scale_factor", "fail", "The scale is 12 % off.")))
    (tmp_path / "bad.json").write_text(json.dumps(held))
    answer = undrift("export", tmp_path / "bad.json", "--target", "c", "-o", tmp_path / "a.h")
    assert (answer.code, answer.err) == (1, "")
    assert "The verdict of the calibration is bad" in answer.out
    assert (tmp_path / "a.c").exists()
