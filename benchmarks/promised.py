"""Promised and delivered errors: new devices on the simulated rig, compared with the interval of a single device in a
study.

``python -m benchmarks.promised [--devices 30] [--new 8]`` prints a row per session: the interval, the delivered errors,
and the number of errors inside. The expected share inside is (n - 1) / (n + 1) for n devices, and 95 % from 39 devices
on.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from undrift.base.workers import executor
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import fit_drift
from undrift.io.session import read_session
from undrift.model import Calibration
from undrift.programme import ProgrammeSettings, programme_of
from undrift.rig.folder import RunFolder
from undrift.rig.run import Mounted, RigBench, run_programme
from undrift.rig.simulated import SimulatedBench, SimulatedSettings
from undrift.sim.device.model import DeviceModel
from undrift.study.case import make_case, pitch_errors_deg, simulate_worn, stream, with_cutoff
from undrift.study.judge import SessionErrors, judge_sessions
from undrift.study.plan import Study, StudyTask
from undrift.study.run import perform, run_study
from undrift.study.sessions import ROOM_TEMP_C, SESSIONS
from undrift.study.virtual_bench import AIR, SETTLE_S, SOAK
from undrift.units import STANDARD_GRAVITY

NAMES = ("three rates", "note rates", "two set-points")
NEW = 1000  # number of the first device that the study does not have


def study_of(devices: int) -> Study:
    """Return a study of a sit-to-stand task with the three sessions."""
    sessions = tuple(SESSIONS[name] for name in NAMES)
    return Study(tasks=(StudyTask(name="sit_to_stand"),), sessions=sessions, subjects=devices, subjects_max=devices)


def promise(study: Study) -> dict[str, SessionErrors]:
    """Return the result of a study for each session."""
    with executor() as spread:
        runs = run_study(study, spread)
    return {row.session.name: row for row in judge_sessions(study, runs, study.tasks[0])}


def calibrate_on_rig(name: str, device: DeviceModel, folder: Path) -> Calibration:
    """Return the calibration that a run of the session's protocol on the simulated rig gives."""
    protocol = SESSIONS[name].protocol
    assert protocol is not None
    protocol = protocol.named("run").with_faces_at_room()
    if protocol.temperatures is not None:
        soaks = protocol.temperatures.but(soak_c_per_min=0.5, board_lag_s=AIR.board_lag_s)
        protocol = protocol.but(temperatures=soaks)
    programme = programme_of(
        protocol, ProgrammeSettings(mount_s=0.5, heating_c_per_min=AIR.ramp_c_per_min, settle_s=SETTLE_S)
    )
    bench = SimulatedBench((device,), SimulatedSettings(air=AIR, chamber=SOAK))
    with RunFolder(folder, protocol) as opened:
        chamber = bench.chamber if protocol.temperatures_c else None
        connected = RigBench(rig=bench.table, mounting=bench, chamber=chamber, clock=bench.clock)
        mounted = Mounted(readings=bench.readings[0], folder=opened, serial=device.serial)
        run_programme(programme, connected, mounted, report=lambda progress: None, gravity_m_s2=STANDARD_GRAVITY)
    session = read_session(folder)
    calibration = calibrate(session)
    return fit_drift((session,), calibration).calibration if protocol.temperatures_c else calibration


def deliver(study: Study, name: str, number: int, folder: Path) -> float:
    """Return the error of the pitch of a device that was calibrated on the rig and worn by a person, deg."""
    device = with_cutoff(study.unit(number), None)
    calibration = calibrate_on_rig(name, device, folder)
    (performed,) = perform(study, study.tasks[0], number)
    rise = float(stream(study.seed, study.group, "temperature", number).uniform(*study.excursion_k))
    rng = stream(study.seed, "promised", number)
    case = make_case(simulate_worn(device, performed, temp_c=ROOM_TEMP_C + rise, rng=rng))
    return float(pitch_errors_deg(case, [calibration], study.offset)[0, 0])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=30)
    parser.add_argument("--new", type=int, default=8)
    options = parser.parse_args()
    study = study_of(options.devices)
    promised = promise(study)
    for name in NAMES:
        low, high = promised[name].single_deg
        with tempfile.TemporaryDirectory() as folder:
            errors = [deliver(study, name, NEW + k, Path(folder) / f"run-{k}") for k in range(options.new)]
        inside = sum(low <= error <= high for error in errors)
        listed = ", ".join(f"{error:.3f}" for error in errors)
        print(f"{name}: promised {low:.3f} to {high:.3f} deg, inside {inside} of {len(errors)}: {listed}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
