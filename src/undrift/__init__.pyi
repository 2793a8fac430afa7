"""The public names, in the order of the flow. Each is imported when it is first used."""

# ruff: noqa: I001  # in the order of the flow

from .record import Record as Record, Reference as Reference, Session as Session, Still as Still, Turn as Turn
from .io.formats import (
    read_record as read_record,
    write_record as write_record,
    read_reference as read_reference,
)
from .io.session import read_session as read_session, write_session as write_session
from .segments import (
    find_still as find_still,
    StillSearch as StillSearch,
    find_turns as find_turns,
    TurnSearch as TurnSearch,
    StillSettings as StillSettings,
)
from .calibration.calibrate import (
    calibrate as calibrate,
    calibrate_from_motion as calibrate_from_motion,
    calibrate_to_references as calibrate_to_references,
)
from .calibration.settings import CalibrateSettings as CalibrateSettings
from .model import Calibration as Calibration
from .findings import Finding as Finding, Verdict as Verdict
from .io.store import read_calibration as read_calibration, write_calibration as write_calibration
from .calibration.noise import fit_noise as fit_noise, NoiseFit as NoiseFit
from .drift.fit import fit_drift as fit_drift, DriftSettings as DriftSettings, DriftFit as DriftFit
from .correction.correct import (
    correct as correct,
    correct_checked as correct_checked,
    Corrected as Corrected,
    Corrector as Corrector,
)
from .orientation import orient as orient, Orientation as Orientation, OrientSettings as OrientSettings
from .frames import integrate_strapdown as integrate_strapdown
from .validation.trial import (
    compare_orientations as compare_orientations,
    OrientationError as OrientationError,
    validate_trial as validate_trial,
    Trial as Trial,
)
from .validation.agreement import (
    validate_trials as validate_trials,
    validate_leave_one_out as validate_leave_one_out,
    Validation as Validation,
)
from .twin.fit import fit_twin as fit_twin, Twin as Twin
from .sim.device.presets import random_device as random_device
from .sim.device.model import DeviceModel as DeviceModel
from .sim.device.simulate import simulate_device as simulate_device, Simulated as Simulated
from .sim.sessions import (
    simulate_session as simulate_session,
    simulate_trial as simulate_trial,
    SimulatedTrial as SimulatedTrial,
)
from .sim.thermal import simulate_thermal_session as simulate_thermal_session
from .export.c import export_c as export_c, ExportedC as ExportedC
from .errors import (
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

__version__: str
