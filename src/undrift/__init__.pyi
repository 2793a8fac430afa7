"""The names of the package for type checkers and for __init__.py, which imports each when it is first asked for."""

# ruff: noqa: I001  # in the order of the flow

from undrift.record import Record as Record, Reference as Reference, Session as Session, Still as Still, Turn as Turn
from undrift.io.formats import (
    read_record as read_record,
    write_record as write_record,
    read_reference as read_reference,
)
from undrift.io.session import read_session as read_session, write_session as write_session
from undrift.segments import (
    find_still as find_still,
    StillSearch as StillSearch,
    find_turns as find_turns,
    TurnSearch as TurnSearch,
    StillSettings as StillSettings,
)
from undrift.calibration.calibrate import (
    calibrate as calibrate,
    calibrate_from_motion as calibrate_from_motion,
    calibrate_to_references as calibrate_to_references,
)
from undrift.calibration.settings import CalibrateSettings as CalibrateSettings
from undrift.model import Calibration as Calibration
from undrift.findings import Finding as Finding, Verdict as Verdict
from undrift.io.store import read_calibration as read_calibration, write_calibration as write_calibration
from undrift.calibration.noise import fit_noise as fit_noise, NoiseFit as NoiseFit
from undrift.drift.fit import fit_drift as fit_drift, DriftSettings as DriftSettings, DriftFit as DriftFit
from undrift.correction.correct import (
    correct as correct,
    correct_checked as correct_checked,
    Corrected as Corrected,
    Corrector as Corrector,
)
from undrift.orientation import orient as orient, Orientation as Orientation, OrientSettings as OrientSettings
from undrift.frames import integrate_strapdown as integrate_strapdown
from undrift.validation.trial import (
    compare_orientations as compare_orientations,
    OrientationError as OrientationError,
    validate_trial as validate_trial,
    Trial as Trial,
)
from undrift.commands.validate import validate as validate, Validated as Validated
from undrift.validation.agreement import (
    validate_trials as validate_trials,
    validate_leave_one_out as validate_leave_one_out,
    Validation as Validation,
)
from undrift.twin.fit import fit_twin as fit_twin, Twin as Twin
from undrift.sim.device.presets import random_device as random_device
from undrift.sim.device.model import DeviceModel as DeviceModel
from undrift.sim.device.simulate import simulate_device as simulate_device, Simulated as Simulated
from undrift.sim.sessions import (
    simulate_session as simulate_session,
    simulate_trial as simulate_trial,
    SimulatedTrial as SimulatedTrial,
)
from undrift.sim.thermal import simulate_thermal_session as simulate_thermal_session
from undrift.export.c import export_c as export_c, ExportedC as ExportedC
from undrift.export.losses import Exported as Exported
from undrift.errors import (
    UndriftError as UndriftError,
    InputError as InputError,
    FileFormatError as FileFormatError,
    CalibrationError as CalibrationError,
    NotObservable as NotObservable,
    PoorFit as PoorFit,
    Implausible as Implausible,
    DriftRangeError as DriftRangeError,
    AlignmentError as AlignmentError,
    RigError as RigError,
)

# ---- commands: functions on files
from undrift.commands.certificate import certificate as certificate
from undrift.commands.demo import demo as demo
from undrift.commands.drift import drift as drift
from undrift.commands.export import export as export
from undrift.commands.info import info as info
from undrift.commands.noise import noise as noise
from undrift.commands.sample import sample as sample
from undrift.commands.simulate import simulate as simulate
from undrift.commands.study import study as study
from undrift.commands.twin import twin as twin

__version__: str
_MODULES: dict[str, list[str]]
