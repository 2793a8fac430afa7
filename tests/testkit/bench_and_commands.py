"""One simulated bench, made once, and the command line to call."""

import json
from pathlib import Path

import numpy as np
import pytest

from testkit.command_line import Undrift
from testkit.demo_session import demo_session
from undrift.calibration.calibrate import calibrate
from undrift.correction.correct import correct_checked
from undrift.io.formats import write_record
from undrift.io.reference import write_reference
from undrift.io.session import read_session, write_session
from undrift.io.store import write_calibration


@pytest.fixture
def undrift(capsys) -> Undrift:
    return Undrift(capsys)


@pytest.fixture(scope="session")
def bench(tmp_path_factory) -> Path:
    """session/, trial.parquet (counts), reference.parquet, calibration.json, corrected.parquet: read only."""
    return make_bench(tmp_path_factory.mktemp("bench"))


def make_bench(folder: Path) -> Path:
    session = demo_session(np.random.default_rng(2007), quick=True)
    write_session(session.session, folder / "session")
    write_record(session.trial.record, folder / "trial.parquet")
    write_reference(session.trial.reference, folder / "reference.parquet")
    calibration = calibrate(read_session(folder / "session"))
    write_calibration(calibration, folder / "calibration.json")
    write_record(correct_checked(session.trial.record, calibration).record, folder / "corrected.parquet")
    (folder / "summary.json").write_text(json.dumps({"kind": "undrift.demo", "checks": []}))
    (folder / "report.html").write_text("<!doctype html>\n")
    return folder
