"""The note's method on a simulated bench: table, chamber and device (rig/simulated.py), fits, a worn trial, checks.

    bench      faces and rates at room temperature                   -> calibrate    offset, matrix
    thermal    rates, in the longer plan faces too, at set-points    -> fit_drift    tables
    a sit-to-stand, worn, warmer -> correct, orient, compare with the optics: none, static, static and dynamic

A run drives the bench as it drives hardware, and each protocol makes a run folder. Time is simulated, so the results do not depend
on the load of the host. The chamber heats by 10 K per second, and the board, with its thermometer in moving air, follows within
seconds. Real soaks take hours. Only ``compare_with_truth`` uses the hidden truth.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.fit import DriftFit
from undrift.errors import InputError
from undrift.programme import (
    FacesTable,
    ProgrammeSettings,
    Protocol,
    ProtocolTable,
    RatesTable,
    TemperaturesTable,
    programme_of,
)
from undrift.record import Record, Reference
from undrift.rig.chamber import ChamberSetup
from undrift.rig.folder import RunFolder
from undrift.rig.lock import stopping_on_signals
from undrift.rig.run import Mounted, Progress, RigBench, RunResult, run_programme
from undrift.rig.simulated import AirSettings, SimulatedBench, SimulatedSettings
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.study.figure3 import OPTICS, worn_record
from undrift.study.sessions import ROOM_TEMP_C
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import Trial

# ---- recording on the virtual bench

KIND = "enc03j_3031"
UNIT_SEED = 1  # its pitch gyroscope drifts by 0.1 deg/s per K, well within the spread of this kind
SET_POINTS_C = (18.0, 31.0, 38.0, 45.0)  # (the worn board is at 37.5 degC, the bench at 25 degC)
THERMOMETER_LAG_S = 5.0  # time constant in the chamber's moving air
AIR = AirSettings(ramp_c_per_min=600.0, period_s=8.0, damping=0.8, board_lag_s=4.0)
SOAK, SOAK_C_PER_MIN = ChamberSetup(window_s=20.0), 0.5
SETTLE_S = 35.0  # forecast of the air: overshoot, then the window

Tell = Callable[[str, float], None]  # called with the current activity and the completed share of the recordings


def bench_protocols(*, quick: bool = False) -> tuple[Protocol, Protocol]:
    """Return the protocols of the demo: at room temperature, and at set-points."""
    seconds = 3.0
    faces = FacesTable(seconds=seconds)
    rates = RatesTable(
        turn_rate_min_dps=45.0,
        turn_rate_max_dps=90.0,
        turn_rate_step_dps=45.0,
        seconds=seconds,
        bracket_s=2.0 * seconds,
    )
    set_points_c = SET_POINTS_C[1:3] if quick else SET_POINTS_C
    soaks = TemperaturesTable(set_points_c=set_points_c, soak_c_per_min=SOAK_C_PER_MIN, board_lag_s=AIR.board_lag_s)
    few = Protocol(
        protocol=ProtocolTable(name="thermal"), faces=None if quick else faces, rates=rates, temperatures=soaks
    )
    least = 45.0 if quick else 15.0
    more = rates.but(turn_rate_min_dps=least, turn_rate_step_dps=least, bracket_s=seconds)
    return Protocol(protocol=ProtocolTable(name="bench"), faces=faces, rates=more), few


def bench_device() -> DeviceModel:
    """Return the hidden truth: a unit of the note's kind, with its thermometer in moving air."""
    unit = random_device(np.random.default_rng(UNIT_SEED), grade=KIND, serial=f"{KIND}-{UNIT_SEED}")
    return replace(unit, thermometer=replace(unit.thermometer, lag_s=THERMOMETER_LAG_S))


def record_on_bench(
    protocols: Sequence[Protocol], device: DeviceModel, folder: Path, *, tell: Tell
) -> tuple[RunResult, ...]:
    """Simulate a bench with a device, and record each protocol into a separate folder."""
    bench, results = SimulatedBench((device,), SimulatedSettings(air=AIR, chamber=SOAK)), list[RunResult]()
    settings = ProgrammeSettings(mount_s=0.5, heating_c_per_min=AIR.ramp_c_per_min, settle_s=SETTLE_S)
    with stopping_on_signals():
        for done, protocol in enumerate(protocols):

            def report(progress: Progress, name: str = protocol.name, done: int = done) -> None:
                text = f"{name} {progress.number + 1}/{progress.steps}: {progress.step}, {progress.phase}"
                tell(text, (done + progress.number / progress.steps) / len(protocols))

            chamber = bench.chamber if protocol.temperatures_c else None
            connected = RigBench(rig=bench.table, mounting=bench, chamber=chamber, clock=bench.clock)
            with RunFolder(folder / protocol.name, protocol) as run:
                mounted = Mounted(readings=bench.readings[0], folder=run, serial=device.serial)
                programme = programme_of(protocol, settings)
                results += run_programme(programme, connected, mounted, report=report, gravity_m_s2=STANDARD_GRAVITY)
    return tuple(results)


# ---- the worn trial


def worn_trial(device: DeviceModel, *, seed: int) -> tuple[Record, Reference]:
    """Simulate a sit-to-stand with a device warmed by its wearer, and return its readings and the poses from the optics."""
    person, noise = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    performed = draw_task("sit_to_stand", rng=person)
    reference = see(performed, rng=person, settings=OPTICS)
    return worn_record(device, performed, rng=noise), reference


# ---- comparison with the hidden truth

MATRIX_LIMIT = 3e-3  # half a step of 12 bits is 1e-3 of gravity, and there are three axes
WARM_MATRIX_LIMIT = 6e-3  # there are fewer and shorter turns at each set-point
GYRO_LIMIT_DPS = 0.25  # hysteresis of this kind is up to 0.1, the remaining warm-up 0.05, and the rest random walk
ACCEL_LIMIT_MG = 5.0  # three steps of 12 bits
STATIC_SHARE, FULL_SHARE = 0.5, 0.25  # limits relative to the error without tables


class Check(NamedTuple):
    """A measured value and its limit."""

    name: str  # name of the quantity, with its unit
    value: float
    limit: float  # largest accepted value

    @property
    def passed(self) -> bool:
        """True if the value does not exceed the limit."""
        return bool(self.value <= self.limit)


def compare_with_truth(fit: DriftFit, trials: tuple[Trial, ...], device: DeviceModel) -> tuple[Check, ...]:
    """Compare the fits with the hidden truth, and the errors of the trial with each other."""
    estimate, true = fit.calibration, true_calibration(device, temp_c=ROOM_TEMP_C)
    tables, observed = estimate.drift, fit.static.gyro
    triads = (estimate.gyro, estimate.accel, true.gyro, true.accel)
    if tables is None or tables.static is None or observed is None or any(triad is None for triad in triads):
        raise InputError("demo: a matrix or the offsets over temperature are missing. Run both programmes.")
    nodes = tables.static.temp_c
    covered = (nodes >= observed.span_c[0]) & (nodes <= observed.span_c[1])
    thermometer = device.thermometer  # settled: the difference between thermometer reading and board temperature
    board = nodes[covered] - thermometer.trim_error_c - thermometer.self_heating_c
    warm = true_tables(device, board, np.array([-1.0, 0.0, 1.0]))
    matrices, offsets = list[Check](), list[Check]()
    for name, triad, unit, limit in (
        ("accelerometers", "accel", "mg", ACCEL_LIMIT_MG), ("gyroscopes", "gyro", "deg/s", GYRO_LIMIT_DPS),
    ):  # fmt: skip
        model, per_unit = getattr(estimate, triad), RADIAN_PER_DEGREE if triad == "gyro" else 1e-3 * STANDARD_GRAVITY
        text = f"{name}: matrix against the true one, largest element (1)"
        matrices.append(Check(text, _apart(model.matrix, getattr(true, triad).matrix), MATRIX_LIMIT))
        table, hidden = (getattr(drift.static, f"{triad}_offset") for drift in (tables, warm))
        error = float(np.abs((table[covered] - hidden) @ model.matrix.T).max()) / per_unit
        offsets.insert(0, Check(f"{name}: offset over temperature, largest error ({unit})", error, limit))
    rows = [*matrices, *offsets]
    scale, hidden_scale = tables.scale, warm.scale
    if scale is not None and scale.gyro_matrix is not None and hidden_scale is not None:
        pairs = zip(scale.gyro_matrix[covered], np.asarray(hidden_scale.gyro_matrix), strict=True)
        difference = max(_apart(*pair) for pair in pairs)
        rows.append(Check("gyroscopes: matrix over temperature, largest element (1)", difference, WARM_MATRIX_LIMIT))
    none, static, full = (trial.figures for trial in trials[:3])
    largest, what = none.max_abs_pitch_deg, "worn sit-to-stand, pitch against the optics"
    rows.append(Check(f"{what}, largest error, static table (deg)", static.max_abs_pitch_deg, STATIC_SHARE * largest))
    rows.append(Check(f"{what}, largest error, all tables (deg)", full.max_abs_pitch_deg, FULL_SHARE * largest))
    rows.append(Check(f"{what}, rms, all tables (deg)", full.rmse_pitch_deg, FULL_SHARE * none.rmse_pitch_deg))
    return tuple(rows)


def _apart(estimate: FloatArray, true: FloatArray) -> float:
    """Return the largest element of M_found M_true^-1 - I."""
    return float(np.abs(estimate @ np.linalg.inv(true) - np.eye(3)).max())
