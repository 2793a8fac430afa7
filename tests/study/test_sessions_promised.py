"""Promised against delivered: the simulated rig runs a session's protocol, and its error lies inside the study's interval."""

import pytest
from benchmarks.promised import NAMES, NEW, deliver, promise, study_of

from testkit.data import show

STUDY = study_of(20)


@pytest.fixture(scope="module")
def promised():
    return promise(STUDY)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_run_of_the_rig_delivers_what_the_study_promises(promised, name, tmp_path):
    delivered = deliver(STUDY, name, NEW, tmp_path / "run")
    low, high = promised[name].single_deg
    show(f"{name}: delivered, promised interval of a single device, deg", (delivered, low, high))
    assert low <= delivered <= high  # python -m benchmarks.promised counts several new devices
