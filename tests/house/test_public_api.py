"""What ``import undrift`` offers: the whole flow, few names, with types, commands, and nothing loaded before it is asked for."""

import ast
import importlib
import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import undrift
from undrift.commands import GROUPS, VERBS

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
    "validate",
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


def test_names_for_the_type_checker_are_the_names_that_are_loaded() -> None:
    tree = ast.parse((ROOT / "src" / "undrift" / "__init__.pyi").read_text())
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert all(
        alias.asname == alias.name for node in nodes for alias in node.names
    )  # else a type checker hides the name
    seen = {alias.name: (node.module or "").removeprefix("undrift.") for node in nodes for alias in node.names}
    commands = {name: f"commands.{name}" for name in VERBS if name not in undrift._HOME}
    assert {name: module for name, module in seen.items() if name not in commands} == undrift._HOME
    assert {name: module for name, module in seen.items() if name in commands}.items() <= commands.items()


def test_every_command_is_reachable_and_a_package_of_its_name_stays_a_package() -> None:
    for name in VERBS:
        assert callable(getattr(undrift, name))
        assert callable(getattr(importlib.import_module("undrift.commands"), name, undrift.twin))
    for name, functions in GROUPS.items():
        assert all(callable(getattr(getattr(undrift, name), function)) for function in functions.values())
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        undrift.nothing  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("first", ["assert callable(undrift.twin)", "import undrift.twin.fit as fit", "pass"])
def test_a_command_and_a_package_of_one_name_are_the_same_in_every_order(first: str) -> None:
    code = (
        f"import undrift; {first}; import undrift.twin.fit; from undrift.twin import fit; import undrift.export.c;"
        "assert undrift.twin.fit is fit and callable(undrift.twin) and callable(undrift.export);"
        "import undrift.commands.correct as correct; assert callable(correct);"
        "from undrift.commands.twin import twin; assert twin is not undrift.twin;"
        "undrift.twin('a.csv', device='b')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "TypeError: got an unexpected keyword argument 'device'" in done.stderr, done.stderr


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
    assert "the pitch is good to" in lines[0]
    assert "verdict" in lines[1]
