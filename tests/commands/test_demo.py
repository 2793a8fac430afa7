"""undrift demo: simulate, run, calibrate, drift and correct, in a process of its own."""

import errno
import importlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from testkit.remembered import folder_made_once, run_folder
from undrift.base.summary import Section
from undrift.io import store as store_module
from undrift.io.session import read_session
from undrift.model import Verdict
from undrift.report import page as page_module
from undrift.rig.folder import disk_errors
from undrift.study import virtual_bench
from undrift.study.virtual_bench import Check, bench_device, bench_plan, record_on_bench

CODE = "from undrift.cli.app import main; main(['demo', '--quick', '--json', '--out', {!r}])"


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Folder and answer of `undrift demo --quick --json`, which runs once."""

    def call(folder):
        words = [sys.executable, "-c", CODE.format(str(folder / "d"))]
        done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=900)
        (folder / "answer.json").write_text(json.dumps([done.returncode, done.stdout, done.stderr]))

    folder = folder_made_once(run_folder(tmp_path_factory), "demo", call)
    code, out, err = json.loads((folder / "answer.json").read_text())
    return folder / "d", SimpleNamespace(returncode=code, stdout=out, stderr=err)


@pytest.mark.slow
def test_the_bench_finds_the_hidden_parameters_and_the_tables_take_the_pitch_error_away(quick, capsys):
    out, answer = quick
    assert answer.returncode == 0, answer.stdout[-2000:] + answer.stderr[-2000:]
    told = json.loads(answer.stdout)["result"]
    assert told == json.loads((out / "summary.json").read_text())
    assert set(told) == {"calibration", "checks"}
    assert all(set(check) == {"name", "value", "limit", "pass"} for check in told["checks"])
    with capsys.disabled():
        for check in told["checks"]:
            print(f"\n{check['name']}: {check['value']:.2g} (at most {check['limit']:.2g})", end="")
        print()
    assert all(check["pass"] and check["value"] <= check["limit"] for check in told["checks"])
    named = " ".join(check["name"] for check in told["checks"])
    for word in ("accelerometers: matrix", "gyroscopes: matrix", "gyroscopes: offset over temperature", "pitch"):
        assert word in named


def short_plan():
    """Return a plan about one axis, at one set-point."""
    plan = bench_plan(quick=True)
    thermal = replace(plan.thermal, axes=("z",), temperatures_c=plan.thermal.temperatures_c[:1])
    return replace(plan, bench=replace(plan.bench, faces=("+z",), axes=("z",)), thermal=thermal)


def test_a_full_disk_under_its_table_is_no_run_to_resume(undrift, tmp_path, monkeypatch):
    def full(*args, **words):
        with disk_errors(tmp_path / "demo" / "bench"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("undrift.study.virtual_bench.record_on_bench", full)
    said = undrift.refused("demo", "--out", tmp_path / "demo", "--quick")
    assert "(No space left on device). Free disk space and run the demo again" in said
    assert "resume" not in said


def test_a_bench_that_is_interrupted_keeps_what_was_done(tmp_path):
    def interrupt(what: str, share: float) -> None:
        if "dwelling" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_on_bench(short_plan(), bench_device(), tmp_path, tell=interrupt)
    assert read_session(tmp_path / "bench").stills  # what was done is on the disk


def test_a_failed_check_ends_with_one(undrift, tmp_path, monkeypatch):
    demo = importlib.import_module("undrift.commands.demo")
    worst = (Check(name="never", value=2.0, limit=1.0),)
    monkeypatch.setattr(virtual_bench, "record_on_bench", lambda *_, **__: None)
    monkeypatch.setattr(virtual_bench, "compare_with_truth", lambda *_: worst)
    monkeypatch.setattr(store_module, "calibration_json", lambda _: {})
    monkeypatch.setattr(page_module, "write_page", lambda *_: None)
    figures = SimpleNamespace(max_abs_pitch_deg=1.0, motion_s=1.0)
    drift = SimpleNamespace(calibration=None, verdict=Verdict.of())
    trials = (SimpleNamespace(figures=figures, findings=()),) * 5
    monkeypatch.setattr(demo, "_judge_trials", lambda *_: (SimpleNamespace(drift=drift), trials))
    monkeypatch.setattr(demo, "_worn_section", lambda _: Section(title="worn"))
    monkeypatch.setattr(demo, "_details", lambda *_: ())
    monkeypatch.setattr(demo, "_tables", lambda _: None)
    answer = undrift("demo", "--quick", "--out", tmp_path / "d")
    assert answer.code == 1
    assert "1 of 1 FAIL." in answer.out
    assert ["never", "2", "1", "NO"] in [line.split() for line in answer.out.splitlines()]
