"""One simulated bench, made once by ``undrift demo``, and the command line to call."""

import contextlib
import io
import json
from pathlib import Path

import pytest

from cli_bench import Answer, Undrift
from undrift.cli.app import run


@pytest.fixture
def undrift(capsys) -> Undrift:
    return Undrift(capsys)


@pytest.fixture(scope="session")
def demo_answer(tmp_path_factory) -> tuple[Path, Answer]:
    """What ``undrift demo --quick --json`` wrote and said."""
    folder = tmp_path_factory.mktemp("bench") / "demo"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(["demo", "--quick", "--json", "--out", str(folder)])
    return folder, Answer(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def bench(demo_answer) -> Path:
    """session/, trial.parquet (counts), reference.parquet, calibration.json, corrected.parquet: read only."""
    folder, answer = demo_answer
    assert answer.code == 0
    assert json.loads(answer.out)["checks"]
    return folder
