"""undrift: calibrate a wearable inertial sensor, compensate its thermal drift, prove what that is worth in degrees.

Data flows left to right, one stage a file or folder::

    record -> segments -> calibration -> drift -> correction -> orientation -> validation -> report

Frames: s sensor axes, b device case, m optical body, n level (z up). ``q_nb`` is scalar first and maps b to n. At rest the
accelerometer axis that points up reads +g. Inside the package values are rad/s, m/s2, s and degC; raw readings keep the
device's unit, named beside them. Time is axis 0: (N,), (N, 3), (N, 4). NaN means a gap and nothing else.

    corrected = matrix @ (raw - offset)            ``correction/correct.py`` is the only place that says so in code

Stages are functions on values: ``correct(record, calibration)``. Commands are functions on files, with the names and options of
the command line: ``undrift.info("walk.csv")``, ``undrift.session.new("walk.csv", output="session")``. Where a stage has the name
of one, it is ``undrift.commands.correct``. Commands return what the command line shows.
"""

import importlib
import sys
from typing import TYPE_CHECKING, Any

from undrift.commands import GROUPS, VERBS, Commands

if TYPE_CHECKING:
    from undrift.calibration.calibrate import calibrate as calibrate
    from undrift.calibration.calibrate import calibrate_from_motion as calibrate_from_motion
    from undrift.calibration.calibrate import calibrate_to_references as calibrate_to_references
    from undrift.calibration.noise import NoiseFit as NoiseFit
    from undrift.calibration.noise import fit_noise as fit_noise
    from undrift.calibration.observe import CalibrateSettings as CalibrateSettings
    from undrift.commands.certificate import certificate as certificate
    from undrift.commands.demo import demo as demo
    from undrift.commands.drift import drift as drift
    from undrift.commands.export import export as export
    from undrift.commands.info import info as info
    from undrift.commands.learn import learn as learn
    from undrift.commands.noise import noise as noise
    from undrift.commands.simulate import simulate as simulate
    from undrift.commands.study import study as study
    from undrift.commands.sync import sync as sync
    from undrift.commands.twin import twin as twin
    from undrift.commands.validate import Validated as Validated
    from undrift.commands.validate import validate as validate
    from undrift.correction.correct import Corrected as Corrected
    from undrift.correction.correct import Corrector as Corrector
    from undrift.correction.correct import correct as correct
    from undrift.correction.correct import correct_checked as correct_checked
    from undrift.drift.fit import DriftFit as DriftFit
    from undrift.drift.fit import DriftSettings as DriftSettings
    from undrift.drift.fit import fit_drift as fit_drift
    from undrift.errors import AlignmentError as AlignmentError
    from undrift.errors import CalibrationError as CalibrationError
    from undrift.errors import DriftRangeError as DriftRangeError
    from undrift.errors import FileFormatError as FileFormatError
    from undrift.errors import Implausible as Implausible
    from undrift.errors import InputError as InputError
    from undrift.errors import NotObservable as NotObservable
    from undrift.errors import PoorFit as PoorFit
    from undrift.errors import RigError as RigError
    from undrift.errors import UndriftError as UndriftError
    from undrift.export.autopilots import export_ardupilot as export_ardupilot
    from undrift.export.autopilots import export_px4 as export_px4
    from undrift.export.c import ExportedC as ExportedC
    from undrift.export.c import export_c as export_c
    from undrift.export.losses import Exported as Exported
    from undrift.export.programs import export_fusion as export_fusion
    from undrift.export.programs import export_imucal as export_imucal
    from undrift.export.programs import export_ros as export_ros
    from undrift.findings import Finding as Finding
    from undrift.findings import Verdict as Verdict
    from undrift.io.formats import read_record as read_record
    from undrift.io.formats import read_reference as read_reference
    from undrift.io.formats import write_record as write_record
    from undrift.io.session import read_session as read_session
    from undrift.io.session import write_session as write_session
    from undrift.io.store import read_calibration as read_calibration
    from undrift.io.store import write_calibration as write_calibration
    from undrift.model import Calibration as Calibration
    from undrift.orientation import Orientation as Orientation
    from undrift.orientation import OrientSettings as OrientSettings
    from undrift.orientation import integrate_strapdown as integrate_strapdown
    from undrift.orientation import orient as orient
    from undrift.record import Record as Record
    from undrift.record import Reference as Reference
    from undrift.record import Session as Session
    from undrift.record import Still as Still
    from undrift.record import Turn as Turn
    from undrift.segments import StillSearch as StillSearch
    from undrift.segments import StillSettings as StillSettings
    from undrift.segments import TurnSearch as TurnSearch
    from undrift.segments import find_still as find_still
    from undrift.segments import find_turns as find_turns
    from undrift.sim.device.model import DeviceModel as DeviceModel
    from undrift.sim.device.presets import random_device as random_device
    from undrift.sim.device.simulate import Simulated as Simulated
    from undrift.sim.device.simulate import simulate_device as simulate_device
    from undrift.sim.sessions import SimulatedTrial as SimulatedTrial
    from undrift.sim.sessions import simulate_session as simulate_session
    from undrift.sim.sessions import simulate_trial as simulate_trial
    from undrift.sim.thermal import simulate_thermal_session as simulate_thermal_session
    from undrift.twin.fit import Twin as Twin
    from undrift.twin.fit import fit_twin as fit_twin
    from undrift.validation.agreement import Validation as Validation
    from undrift.validation.agreement import validate_leave_one_out as validate_leave_one_out
    from undrift.validation.agreement import validate_trials as validate_trials
    from undrift.validation.trial import OrientationError as OrientationError
    from undrift.validation.trial import Trial as Trial
    from undrift.validation.trial import compare_orientations as compare_orientations
    from undrift.validation.trial import validate_trial as validate_trial

__version__ = "0.1.0"

# In flow order. Each name is imported when it is first asked for, so that ``import undrift`` costs nothing.
_MODULES = {
    "record": ("Record", "Reference", "Session", "Still", "Turn"),
    "io.formats": ("read_record", "write_record", "read_reference"),
    "io.session": ("read_session", "write_session"),
    "segments": ("find_still", "StillSearch", "find_turns", "TurnSearch", "StillSettings"),
    "calibration.calibrate": ("calibrate", "calibrate_from_motion", "calibrate_to_references"),
    "calibration.observe": ("CalibrateSettings",),
    "model": ("Calibration",),
    "findings": ("Finding", "Verdict"),
    "io.store": ("read_calibration", "write_calibration"),
    "calibration.noise": ("fit_noise", "NoiseFit"),
    "drift.fit": ("fit_drift", "DriftSettings", "DriftFit"),
    "correction.correct": ("correct", "correct_checked", "Corrected", "Corrector"),
    "orientation": ("orient", "Orientation", "OrientSettings", "integrate_strapdown"),
    "validation.trial": ("compare_orientations", "OrientationError", "validate_trial", "Trial"),
    "commands.validate": ("validate", "Validated"),
    "validation.agreement": ("validate_trials", "validate_leave_one_out", "Validation"),
    "twin.fit": ("fit_twin", "Twin"),
    "sim.device.presets": ("random_device",),
    "sim.device.model": ("DeviceModel",),
    "sim.device.simulate": ("simulate_device", "Simulated"),
    "sim.sessions": ("simulate_session", "simulate_trial", "SimulatedTrial"),
    "sim.thermal": ("simulate_thermal_session",),
    "export.c": ("export_c", "ExportedC"),
    "export.losses": ("Exported",),
    "export.autopilots": ("export_px4", "export_ardupilot"),
    "export.programs": ("export_fusion", "export_imucal", "export_ros"),
    "errors": (
        "UndriftError",
        "InputError",
        "FileFormatError",
        "CalibrationError",
        "NotObservable",
        "PoorFit",
        "Implausible",
        "DriftRangeError",
        "AlignmentError",
        "RigError",
    ),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [*_HOME]  # noqa: PLE0604


if not TYPE_CHECKING:  # a type checker takes the names above, and no other

    def __getattr__(name: str) -> Any:
        from importlib.util import find_spec

        if name in _HOME:
            value = getattr(importlib.import_module(f"undrift.{_HOME[name]}"), name)
        elif name in (*VERBS, *GROUPS):  # where a package has the name of a command, that package is called
            home = name if find_spec(f"undrift.{name}") else f"commands.{name}"
            module = importlib.import_module(f"undrift.{home}")
            value = module if home == name or name in GROUPS else getattr(module, name)
        else:
            raise AttributeError(f"module 'undrift' has no attribute '{name}'")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return [*_HOME, *VERBS, *GROUPS, "__version__"]


sys.modules[__name__].__class__ = Commands
