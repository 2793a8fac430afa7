"""What ``import undrift`` offers: every result type, full types for a checker, and nothing loaded before it is used."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import undrift

ROOT = Path(__file__).parents[2]
SNIPPET = """
import undrift

record = undrift.read_record("walk.csv")
calibration = undrift.read_calibration("calibration.json")
reveal_type(undrift.calibrate(undrift.read_session("session")))
reveal_type(undrift.correct(record, calibration))
reveal_type(undrift.orient(record))
undrift.correct(record, calibration, polcy="hold")
undrift.correct(record, calibration, policy="stretch")
undrift.corect(record, calibration)
"""


def test_every_type_that_an_exported_function_returns_is_exported() -> None:
    functions = [value for name in undrift.__all__ if inspect.isfunction(value := getattr(undrift, name))]
    types = {inspect.signature(function).return_annotation for function in functions}
    own = {item for item in types if isinstance(item, type) and item.__module__.startswith("undrift")}
    assert len(own) >= 18
    assert {item.__name__ for item in own} <= {*undrift.__all__}
    assert {*undrift.__all__} <= {*dir(undrift)}


def test_the_import_loads_nothing_heavy() -> None:
    code = "import sys, json, undrift; print(json.dumps(sorted({n.split('.')[0] for n in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(json.loads(done.stdout)) & {"numpy", "scipy", "numba", "pandas", "pyarrow", "matplotlib", "pydantic"}


def test_a_users_snippet_is_checked_by_mypy(tmp_path: Path) -> None:
    (tmp_path / "snippet.py").write_text(SNIPPET)
    cache = f"--cache-dir={ROOT / '.mypy_cache' / 'snippet'}"
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file=", cache, "snippet.py"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "MYPYPATH": str(ROOT / "src")},
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("snippet.py")]
    revealed = " ".join(line for line in lines if "Revealed type" in line)
    for name in ("undrift.model.Calibration", "undrift.record.Record", "undrift.orientation.Orientation"):
        assert name in revealed, done.stdout
    errors = {int(line.split(":")[1]): line for line in lines if ": error:" in line}
    assert set(errors) == {9, 10, 11}, done.stdout
    for number, word in ((9, "polcy"), (10, "stretch"), (11, "corect")):
        assert word in errors[number]


def test_a_calibration_prints_its_answer_and_verdict() -> None:
    device = undrift.random_device(np.random.default_rng(7))
    session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    answer, verdict = repr(undrift.calibrate(session)).splitlines()
    assert "pitch within" in answer
    assert "verdict" in verdict
