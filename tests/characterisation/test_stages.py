"""One call of each stage gives the numbers that were recorded of it, within tolerances far below what a user can notice.

A difference that is meant: ``python -m pytest tests/characterisation --record`` writes them anew; say in the commit why they moved.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from benchmarks.broad_files import read_broad

from testkit.data import DATA, data_path
from testkit.demo_session import demo_session
from undrift.calibration.calibrate import calibrate, calibrate_to_references
from undrift.calibration.codes import device_adc
from undrift.calibration.noise import fit_noise
from undrift.correction.correct import correct
from undrift.drift.fit import DriftFit, fit_drift
from undrift.model import Calibration, TriadModel
from undrift.orientation import orient
from undrift.record import Record, Reference, Session, Still, Turn
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings
from undrift.sim.sessions import simulate_session, simulate_trial
from undrift.sim.thermal import ChamberSettings, ThermalSettings, simulate_thermal_session
from undrift.twin.fit import fit_twin
from undrift.units import STANDARD_GRAVITY
from undrift.validation.agreement import validate_leave_one_out

pytestmark = [
    pytest.mark.usefixtures("computed_once"),
    pytest.mark.skipif(not DATA.is_dir(), reason="the public recordings are not there: set UNDRIFT_DATA"),
]

Numbers = dict[str, Any]
RECORDED = Path(__file__).with_name("recorded.json")
TOLERANCE = {  # by the last word of a name: absolute in its unit, or relative to the largest value
    "deg": 1e-3,
    "dps": 1e-4,
    "accel": 1e-3,  # m/s2, 0.1 mg
    "seconds": 1e-4,
    "matrix": 1e-5,  # relative: 10 parts in a million
    "codes": 1e-6,  # relative: a step is a property of the logger
    "uncertainty": 0.02,  # relative
    "noise": 0.02,  # relative
}
ABSOLUTE = ("deg", "dps", "accel", "seconds")


def triad(name: str, model: TriadModel | None) -> Numbers:
    """Return what a triad is corrected with: matrix, offset in SI, and the standard uncertainty of all of them."""
    if model is None:
        return {}
    offset = model.matrix @ model.offset
    unit = {"gyro": ("dps", np.degrees(offset)), "accel": ("accel", offset)}[name]
    sd = np.sqrt(np.diag(model.covariance)) if model.covariance is not None else np.empty(0)
    return {f"{name} matrix": model.matrix, f"{name} offset {unit[0]}": unit[1], f"{name} uncertainty": sd}


def constants(made: Calibration) -> Numbers:
    return {"status": made.verdict.status} | triad("gyro", made.gyro) | triad("accel", made.accel)


# ---- calibrate


def foot_sensor() -> Session:
    """Return the public Ferraris session of a foot sensor, in deg/s and m/s2."""
    values = np.loadtxt(data_path("ferraris_nilspod", "example_ferraris_session.csv"), delimiter=",", skiprows=1)
    record = Record(time=np.arange(len(values)) / 102.4, gyro=values[:, 1:4], accel=values[:, 4:7], gyro_unit="dps")
    listed = json.loads(data_path("ferraris_nilspod", "example_ferraris_session_list.json").read_text())
    parts = {name: (part["start"], part["end"]) for name, part in listed.items()}
    return Session(
        kind="calibration",
        serial="foot",
        gravity_m_s2=9.81,
        records=(record,),
        stills=tuple(
            Still(start=start, stop=stop, face=("+" if name[2] == "p" else "-") + name[0])  # type: ignore[arg-type]
            for name, (start, stop) in parts.items()
            if not name.endswith("rot")
        ),
        turns=tuple(
            Turn(start=start, stop=stop, axis=name[0], angle=-2.0 * np.pi)  # type: ignore[arg-type]
            for name, (start, stop) in parts.items()
            if name.endswith("rot")
        ),
    )


def rate_table() -> Session:
    """Return a simulated bench of faces and rates about every axis."""
    rng = np.random.default_rng(5)
    errors = BenchErrors(face_tilt=np.radians(0.05))
    settings = BenchSettings(errors=errors, turn_rates=(0.5, 1.0, 1.5), dwell_s=2.0)
    return simulate_session("bench", random_device(rng), rng=rng, settings=settings)


def turned_by_hand() -> Session:
    """Return a board turned by hand through many poses."""
    values = np.loadtxt(data_path("multipos_mpu9150", "imu1.log.gz"))
    record = Record(time=np.arange(len(values)) / 100.0, accel=values[:, :3], gyro=values[:, 3:6])
    return Session(kind="calibration", serial="imu1", gravity_m_s2=9.81, records=(record,))


def free_poses() -> Session:
    """Return the published multi-position set, in counts."""
    accel, gyro = (np.loadtxt(data_path("multipos_xsens", f"xsens_{name}.txt.gz")) for name in ("acc", "gyro"))
    record = Record(time=accel[:, 0], accel=accel[:, 1:], gyro=gyro[:, 1:], accel_unit="count", gyro_unit="count")
    return Session(kind="calibration", serial="MTi", gravity_m_s2=9.8064, records=(record,))


def broad(number: int, stop_s: float | None = None) -> tuple[Record, Reference]:
    """Return a BROAD trial, or its beginning."""
    record, reference = read_broad(next(data_path("broad").glob(f"{number:02d}_*.hdf5")))
    if stop_s is None:
        return record, reference
    keep = reference.time < stop_s
    position, moving = (None if a is None else a[keep] for a in (reference.position, reference.moving))
    return record.between(0.0, stop_s), Reference(
        time=reference.time[keep], q_nb=reference.q_nb[keep], position=position, moving=moving
    )


def references() -> Numbers:
    pairs = [broad(number, 120.0) for number in (3, 24)]
    return constants(calibrate_to_references([record for record, _ in pairs], [poses for _, poses in pairs]))


def codes() -> Numbers:
    found = device_adc([broad(32, 90.0)[0]])
    assert found is not None
    return {"gyro rounding": found.gyro_rounding, "gyro codes": found.gyro_lsb, "accel codes": found.accel_lsb}


def noise() -> Numbers:
    values = pd.read_csv(data_path("static_mpu6050", "example_data_tinit_calc.csv.gz"), skiprows=4)
    record = Record(
        time=np.arange(len(values)) / 100.0,
        gyro=np.radians(values[["gx", "gy", "gz"]].to_numpy() / 131.0),
        accel=values[["ax", "ay", "az"]].to_numpy() / 16384.0 * STANDARD_GRAVITY,
    )
    fit = fit_noise(record)
    return {
        "gyro white noise": [axis.angle_random_walk.value for axis in fit.gyro],
        "gyro bias instability noise": [axis.bias_instability.value for axis in fit.gyro],
        "accel white noise": [axis.angle_random_walk.value for axis in fit.accel],
    }


# ---- drift, correct


DEVICE = preset("enc03j_3031")


def soaks() -> DriftFit:
    """Return the tables of simulated soaks at five set-points."""
    chamber = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=300.0)
    rates = tuple(np.radians((30.0, 60.0, 90.0)))
    bench = BenchSettings(sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=rates, dwell_s=1.5)
    settings = ThermalSettings(bench=bench, chamber=chamber, set_points_c=(18.0, 33.0, 47.0, 61.0, 75.0))
    made = simulate_thermal_session("soak", DEVICE, rng=np.random.default_rng(1), settings=settings)
    return fit_drift([made], true_calibration(DEVICE))


def tables(fit: DriftFit) -> Numbers:
    """Return the offsets of a thermal fit at some nodes, in deg/s, and which tables were chosen."""
    drift, model = fit.calibration.drift, fit.calibration.gyro
    assert drift is not None
    assert drift.static is not None
    assert model is not None
    chosen = [name for name in ("static", "scale", "dynamic") if getattr(drift, name) is not None]
    places = np.linspace(0, len(drift.static.temp_c) - 1, 5).round().astype(int)
    offsets = drift.static.gyro_offset[places] @ model.matrix.T
    return {
        "tables": chosen,
        "status": fit.verdict.status,
        "nodes deg": drift.static.temp_c[places],
        "gyro offsets dps": np.degrees(offsets),
        "gyro uncertainty": drift.static.gyro_uncertainty[places],
    }


def warm_up() -> Numbers:
    values = pd.read_csv(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"))[::3]
    record = Record(
        time=values["Time"].to_numpy() / 1000.0,
        gyro=np.radians(values[["Gx", "Gy", "Gz"]].to_numpy() / 16.4),
        accel=values[["Ax", "Ay", "Az"]].to_numpy() / 16384.0 * STANDARD_GRAVITY,
        temp_c=values["dTemp"].to_numpy() / 340.0 + 36.53,
    )
    return tables(
        fit_drift([Session(kind="thermal", serial="board", gravity_m_s2=STANDARD_GRAVITY, records=(record,))])
    )


def corrected() -> Numbers:
    trial = simulate_trial("step", DEVICE, rng=np.random.default_rng(3), temp_c=(20.0, 40.0))
    done = correct(trial.record, soaks().calibration, check=False)
    at = np.linspace(0, len(done.time) - 1, 5).astype(int)
    return {
        "gyro dps": np.degrees(done.gyro[at]),
        "mean gyro dps": np.degrees(done.gyro.mean(axis=0)),
        "accel": done.accel[at],
    }


# ---- orient, validate, twin


def oriented() -> Numbers:
    made = demo_session(np.random.default_rng(2007), quick=True)
    found = orient(correct(made.trial.record, true_calibration(made.device)))
    at = np.linspace(0, len(found.pitch) - 1, 7).astype(int)
    return {"pitch deg": np.degrees(found.pitch[at]), "inclination deg": np.degrees(found.inclination[at])}


def validated() -> Numbers:
    pairs = [broad(number) for number in (3, 24)]
    trials = validate_leave_one_out(pairs).trials
    figures = [trial.figures for trial in trials]
    return {
        "end deg": [each.end_total_deg for each in figures],
        "rms deg": [each.rmse_total_deg for each in figures],
        "largest pitch deg": [each.max_abs_pitch_deg for each in figures],
    }


def twin() -> Numbers:
    record, reference = broad(35)
    made = fit_twin([record], [reference], gravity_m_s2=9.813)
    return {
        "gyro delay seconds": made.delay,
        "gyro matrix": made.gyro.triad.model.matrix,
        "gyro offset dps": np.degrees(made.gyro.triad.model.matrix @ made.gyro.triad.model.offset),
    }


STAGES: dict[str, Callable[[], Numbers]] = {
    "six faces and turns by the paper": lambda: constants(calibrate(foot_sensor(), mode="paper")),
    "six faces and turns, affine": lambda: constants(calibrate(foot_sensor())),
    "rate table": lambda: constants(calibrate(rate_table())),
    "poses by hand": lambda: constants(calibrate(turned_by_hand())),
    "free poses in counts": lambda: constants(calibrate(free_poses())),
    "references": references,
    "codes of a converter": codes,
    "noise": noise,
    "soaks": lambda: tables(soaks()),
    "warm-up": warm_up,
    "correct": corrected,
    "orient": oriented,
    "validate": validated,
    "twin": twin,
}


@pytest.mark.parametrize("stage", STAGES)
def test_gives_the_recorded_numbers(stage: str, request: pytest.FixtureRequest) -> None:
    found = STAGES[stage]()
    held = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    if request.config.getoption("--record"):
        RECORDED.write_text(written(held | {stage: as_recorded(found)}))
        return
    assert found.keys() == held[stage].keys()
    for name, value in found.items():
        agree(name, value, held[stage][name])


def written(stages: dict[str, Numbers]) -> str:
    """Return the numbers as JSON, a line for each quantity."""
    texts = []
    for stage, numbers in stages.items():
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in numbers.items())
        texts.append(f" {json.dumps(stage)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(texts) + "\n}\n"


def as_recorded(found: Numbers) -> Numbers:
    """Return numbers with ten digits, and words as they are."""

    def rounded(value: Any) -> Any:
        if isinstance(value, str) or value is None:
            return value
        array = np.asarray(value)
        if array.dtype.kind in "US":
            return array.tolist()
        return [float(f"{number:.10g}") for number in array.ravel().astype(float)]

    return {name: rounded(value) for name, value in found.items()}


def agree(name: str, value: Any, recorded: Any) -> None:
    """Compare by the last word of the name; words have to be equal."""
    kind = name.split()[-1]
    if kind not in TOLERANCE or recorded is None:
        assert as_recorded({name: value})[name] == recorded, name
        return
    limit = TOLERANCE[kind] if kind in ABSOLUTE else 0.0
    relative = TOLERANCE[kind] if kind in ("uncertainty", "noise") else 0.0
    held = np.asarray(recorded, dtype=float)
    if kind in ("matrix", "codes"):
        limit = TOLERANCE[kind] * float(np.nanmax(np.abs(held)))
    np.testing.assert_allclose(np.ravel(value), held, rtol=relative, atol=limit, err_msg=name)


def test_a_change_beyond_its_tolerance_is_noticed() -> None:
    agree("gyro offset dps", np.array([1.0, 2.0]), [1.00005, 2.0])
    for name, value, recorded in (
        ("gyro offset dps", [1.0002], [1.0]),
        ("gyro matrix", np.eye(2) * 1.00002, np.eye(2).ravel()),
        ("gyro uncertainty", [1.03], [1.0]),
        ("status", "good", "marginal"),
    ):
        with pytest.raises(AssertionError):
            agree(name, value, recorded)
