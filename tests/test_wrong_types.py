"""Values of a wrong type are refused in one line, before any work."""

from collections.abc import Callable

import numpy as np
import pytest

import undrift
from undrift import InputError, Record

RECORD = Record(time=np.arange(3) / 10.0, gyro=np.zeros((3, 3)), accel=np.ones((3, 3)))
CALLS: dict[str, Callable[[], object]] = {
    "calibrate: a path": lambda: undrift.calibrate("session"),  # type: ignore[arg-type]
    "calibrate: a list": lambda: undrift.calibrate([RECORD]),  # type: ignore[arg-type]
    "calibrate: settings": lambda: undrift.calibrate(RECORD, settings={}),  # type: ignore[arg-type]
    "calibrate: gravity": lambda: undrift.calibrate(RECORD, gravity_m_s2="9.81"),  # type: ignore[arg-type]
    "correct: a path": lambda: undrift.correct(RECORD, "calibration.json"),  # type: ignore[arg-type]
    "orient: a path": lambda: undrift.orient("a.csv"),  # type: ignore[arg-type]
    "orient: settings": lambda: undrift.orient(RECORD, settings={}),  # type: ignore[arg-type]
    "validate: a path": lambda: undrift.validate_trial(RECORD, "b.csv"),  # type: ignore[arg-type]
    "compare: records": lambda: undrift.compare_orientations(RECORD, RECORD),  # type: ignore[arg-type]
    "read: a record": lambda: undrift.read_record(RECORD),  # type: ignore[arg-type]
    "device: a seed": lambda: undrift.random_device(7),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_type_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"expected .+, got "):
        CALLS[name]()
