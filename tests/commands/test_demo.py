"""undrift demo: simulate, run, calibrate, drift and correct."""

import errno
import importlib
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from testkit.long_calls import long_call
from undrift.io.session import read_session
from undrift.model import Verdict
from undrift.report import Table
from undrift.rig.folder import disk_errors
from undrift.study.virtual_bench import Check, bench_device, bench_plan, record_on_bench


@pytest.mark.slow
def test_the_bench_finds_the_hidden_parameters_and_the_tables_take_the_pitch_error_away(tmp_path_factory, capsys):
    told = json.loads((long_call(tmp_path_factory, "demo") / "out" / "summary.json").read_text())["data"]
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

    monkeypatch.setattr(importlib.import_module("undrift.commands.demo"), "record_on_bench", full)
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


def test_a_failed_check_ends_with_one(tmp_path, monkeypatch):
    demo = importlib.import_module("undrift.commands.demo")
    worst = (Check(name="never", value=2.0, limit=1.0),)
    figures = SimpleNamespace(max_abs_pitch_deg=1.0, rmse_pitch_deg=1.0, motion_s=1.0)
    error = SimpleNamespace(pitch=np.zeros(2))
    drift = SimpleNamespace(calibration=None, verdict=Verdict.of())
    trials = (SimpleNamespace(recording="none", figures=figures, findings=(), error=error),) * 5
    monkeypatch.setattr(demo, "calibration_json", lambda _: {})
    monkeypatch.setattr(demo, "_bench", lambda _: Table(title="The simulated bench"))
    report = demo._report(tmp_path, SimpleNamespace(), SimpleNamespace(drift=drift), trials, worst)
    assert report.exit_code == 1
    assert [item.code for item in report.findings] == ["demo.check"]
