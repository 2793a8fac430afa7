"""undrift where there is no compiler, and no thread or process can be started, as in a browser."""

import json
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import undrift

BARE = """
import os, subprocess, sys, threading

def refused(*_, **__):
    raise RuntimeError("can't start new thread")

threading.Thread.start = os.fork = subprocess.Popen.__init__ = refused
for name in ("numba", "vqf"):
    sys.modules[name] = None
"""
FLOW = """
import json, sys, time
from contextlib import redirect_stdout
from io import StringIO
from undrift.cli.app import main

def run(*words):
    start, printed = time.perf_counter(), StringIO()
    try:
        with redirect_stdout(printed):
            main([*words, "--json"])
    except SystemExit as end:
        assert end.code in (0, 1), (words, end.code)
    done[words[0] + words[-1]] = json.loads(printed.getvalue()) | {"seconds": time.perf_counter() - start}

done = {}
run("sample")
run("info", "sample/sit_to_stand.parquet")
run("calibrate", "sample/bench", "-o", "calibration.json")
run("correct", "sample/sit_to_stand.parquet", "--calibration", "calibration.json", "-o", "corrected.parquet")
run("orient", "corrected.parquet", "-o", "orientation.parquet")
run("noise", "sample/rest.parquet")
run("calibrate", "motion.parquet", "--from", "motion", "-o", "from_motion.json")
print(json.dumps(done))
"""


def flow(folder: Path, prelude: str) -> dict[str, dict[str, object]]:
    """Run the commands in a folder, in one process that begins with a prelude. Return what each printed."""
    words = [sys.executable, "-c", prelude + textwrap.dedent(FLOW)]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result: dict[str, dict[str, object]] = json.loads(done.stdout)
    return result


def numbers(value: object) -> list[float]:
    """Return all numbers of nested values, but for the seconds."""
    if isinstance(value, dict):
        return [number for key, item in value.items() if key != "seconds" for number in numbers(item)]
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.timeout(120)
def test_results_are_equal_without_compiler_threads_and_processes(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    device = undrift.random_device(rng)
    record = undrift.simulate_trial("free", device, rng=rng).record
    gains = [np.diag(chain.forward_matrix).mean() for chain in (device.gyro, device.accel)]
    record = replace(
        record, gyro=record.gyro / gains[0], accel=record.accel / gains[1], gyro_unit="rad/s", accel_unit="m/s2"
    )
    folders = [tmp_path / name for name in ("usual", "bare")]
    for folder in folders:
        folder.mkdir()
        undrift.write_record(record, folder / "motion.parquet")
    usual, bare = flow(folders[0], ""), flow(folders[1], BARE)
    for words, done in bare.items():
        np.testing.assert_allclose(numbers(done), numbers(usual[words]), rtol=1e-9, atol=1e-9, err_msg=words)
    for name in ("corrected.parquet", "orientation.parquet"):
        expected, got = (pq.read_table(folder / name).to_pandas().to_numpy(float) for folder in folders)
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
    print({words: round(done["seconds"], 2) for words, done in bare.items()})
