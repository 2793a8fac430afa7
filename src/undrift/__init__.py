"""undrift: calibrate a wearable inertial sensor, compensate its thermal drift, prove what that is worth in degrees.

Data flows left to right, one stage a file or folder::

    record -> segments -> calibration -> drift -> correct -> orientation -> validation -> report

Frames: s sensor axes, b device case, m optical body, n level (z up). ``q_nb`` is scalar first and maps b to n. At rest the
accelerometer axis that points up reads +g. Inside the package values are rad/s, m/s2, s and degC; raw readings keep the
device's unit, named beside them. Time is axis 0: (N,), (N, 3), (N, 4). NaN means a gap and nothing else.

    corrected = matrix @ (raw - offset)            ``correct.py`` is the only place that says so in code
"""

import importlib
from typing import Any

__version__ = "0.1.0"

# In flow order; each name is imported when it is first asked for, so that ``import undrift`` costs nothing.
_HOME = {
    "Record": "undrift.record",
    "Reference": "undrift.record",
    "Session": "undrift.session",
    "read_record": "undrift.io.recording",
    "read_reference": "undrift.io.reference",
    "read_session": "undrift.io.session",
    "find_still": "undrift.segments",
    "find_turns": "undrift.segments",
    "calibrate": "undrift.calibration.procedure",
    "calibrate_to_references": "undrift.calibration.procedure_reference",
    "fit_noise": "undrift.calibration.noise",
    "Calibration": "undrift.calibration.model",
    "read_calibration": "undrift.calibration.store",
    "write_calibration": "undrift.calibration.store",
    "integrate_strapdown": "undrift.orientation.strapdown",
    "validate_trials": "undrift.validation",
    "validate_leave_one_out": "undrift.validation",
    "UndriftError": "undrift.errors",
}
__all__ = [
    "Calibration",
    "Record",
    "Reference",
    "Session",
    "UndriftError",
    "__version__",
    "calibrate",
    "calibrate_to_references",
    "find_still",
    "find_turns",
    "fit_noise",
    "integrate_strapdown",
    "read_calibration",
    "read_record",
    "read_reference",
    "read_session",
    "validate_leave_one_out",
    "validate_trials",
    "write_calibration",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'undrift' has no attribute '{name}'")
