"""What ``import undrift`` offers: the whole flow, few names, with types, commands, and nothing loaded before it is asked for."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import undrift

ROOT = Path(__file__).parents[2]
FLOW = {
    "read_record",
    "read_reference",
    "read_session",
    "Record",
    "Reference",
    "Session",
    "Still",
    "Turn",
    "find_still",
    "find_turns",
    "calibrate",
    "CalibrateSettings",
    "Calibration",
    "read_calibration",
    "write_calibration",
    "fit_drift",
    "fit_noise",
    "correct",
    "Corrector",
    "orient",
    "validate_trials",
    "fit_twin",
    "simulate_device",
    "simulate_session",
    "simulate_trial",
    "export_c",
    "UndriftError",
}


def returned_types() -> set[type]:
    """Return the package's own types that exported functions return."""
    functions = [value for name in undrift.__all__ if inspect.isfunction(value := getattr(undrift, name))]
    types = {inspect.signature(function).return_annotation for function in functions}
    return {one for one in types if isinstance(one, type) and one.__module__.startswith("undrift")}


def test_every_type_that_an_exported_function_returns_is_exported() -> None:
    types = returned_types()
    assert len(types) >= 18
    assert [one for one in types if getattr(undrift, one.__name__, None) is not one] == []
    assert {one.__name__ for one in types} <= {*undrift.__all__}


def test_the_flow_is_there_and_the_names_are_few() -> None:
    assert len({*undrift.__all__} - {one.__name__ for one in returned_types()}) <= 55
    assert set(undrift.__all__) >= FLOW
    for name in undrift.__all__:
        assert getattr(undrift, name) is not None
    assert set(undrift.__all__) <= set(dir(undrift))
    assert callable(undrift.correct)


def test_a_stage_and_a_package_of_one_name_stay_apart() -> None:
    code = (
        "import undrift; undrift.fit_twin; import undrift.twin.fit; from undrift.twin import fit;"
        "assert undrift.twin.fit is fit and undrift.twin.fit.fit_twin is undrift.fit_twin"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_import_loads_nothing_heavy() -> None:
    code = "import sys, json, undrift; print(json.dumps(sorted({n.split('.')[0] for n in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(json.loads(done.stdout)) & {"numpy", "scipy", "numba", "pandas", "pyarrow", "matplotlib", "pydantic"}


SNIPPET = """
import undrift

record = undrift.read_record("walk.csv")
calibration = undrift.read_calibration("calibration.json")
reveal_type(undrift.calibrate(undrift.read_session("session")))
reveal_type(undrift.correct(record, calibration))
reveal_type(undrift.orient(record))
"""


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", None),
        ('undrift.correct(record, calibration, polcy="hold")\n', "polcy"),
        ('undrift.correct(record, calibration, policy="stretch")\n', "stretch"),
        ("undrift.corect(record, calibration)\n", "corect"),
    ],
)
def test_a_users_snippet_is_checked_by_mypy(tmp_path: Path, line: str, complaint: str | None) -> None:
    script = tmp_path / "snippet.py"
    script.write_text(SNIPPET + line)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            "--strict",
            "--config-file=",
            f"--cache-dir={ROOT / '.mypy_cache' / 'snippet'}",
            str(script),
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "MYPYPATH": str(ROOT / "src")},
    )
    shown = [text for text in done.stdout.splitlines() if "snippet.py" in text]
    errors = [text for text in shown if ": error:" in text]
    revealed = " ".join(text for text in shown if "Revealed type" in text)
    for wanted in ("undrift.model.Calibration", "undrift.record.Record", "undrift.orientation.Orientation"):
        assert wanted in revealed, done.stdout
    assert "Any" not in revealed
    if complaint is None:
        assert not errors, errors
    else:
        assert any(complaint in text for text in errors), done.stdout


def test_a_calibration_prints_its_answer_and_verdict() -> None:
    import numpy as np

    made = undrift.calibrate(
        undrift.simulate_session("bench", undrift.random_device(np.random.default_rng(7)), rng=np.random.default_rng(8))
    )
    lines = repr(made).splitlines()
    assert len(lines) == 2
    assert "Good for a sit-to-stand after a rest: pitch within" in lines[0]
    assert "verdict" in lines[1]
