"""Tables over temperature: real logs, simulated soaks, ramps and warm-ups; lag of a thermometer; what tables are chosen."""

import gzip
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from characterisation.calls_fits import written
from characterisation.recordings import bicycle as bicycle_session
from characterisation.shared import Result, call, folder, text_file, undrift
from testkit.data import data_path
from undrift.drift.fit import fit_drift
from undrift.drift.observe import observe_rests
from undrift.drift.temperature import (
    default_smooth_s,
    estimate_lag,
    trusted_temperature,
    without_lag,
    without_lag_smooth,
)
from undrift.io.session import read_session
from undrift.io.store import calibration_json, write_calibration
from undrift.record import Record, Session, Still
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import Motion
from undrift.sim.thermal import ChamberSettings, RampSettings, ThermalSettings, WarmUpSettings, simulate_thermal_session
from undrift.units import STANDARD_GRAVITY

WARM_UP_MAP = f"""columns = {{ time = "Time", gyro = ["Gx", "Gy", "Gz"], accel = ["Ax", "Ay", "Az"], temp = "dTemp" }}
units = {{ time = "ms", gyro = "dps", accel = "g", temp = "degC" }}
scale = {{ gyro = {{ gain = {1 / 16.4} }}, accel = {{ gain = {1 / 16384} }}, temp = {{ gain = {1 / 340}, offset = 36.53 }} }}
"""
TWO_POINT_MAP = """columns = { temp = 0, accel = [1, 2, 3], gyro = [4, 5, 6] }
units = { temp = "degC", accel = "g", gyro = "dps" }
header = false
skip_rows = 1
sample_rate_hz = 50.0
drop_bad_rows = true
"""
DEVICE = preset("enc03j_3031")
CHAMBER = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=300.0)
BENCH = BenchSettings(
    sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=tuple(np.radians((30.0, 60.0, 90.0))), dwell_s=1.5
)
SOAKS = ThermalSettings(bench=BENCH, chamber=CHAMBER, set_points_c=(18.0, 33.0, 47.0, 61.0, 75.0))


def fitted(*words: object) -> Result:
    """Return what drift says, and what it wrote, which holds the same."""
    return undrift("drift", *words)


@cache
def warm_up_map() -> Path:
    return text_file("warm_up.toml", WARM_UP_MAP)


@cache
def warm_up_log() -> Path:
    """Every third row of the log of a real warm-up."""
    path = folder() / "warm_up_log.csv"
    with gzip.open(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), "rt") as file:
        head, *rows = file.readlines()
    path.write_text(head + "".join(rows[::3]))
    return path


@call("warm_up_real", "offsets over temperature from the log of a real warm-up")
@call(
    "warm_up_real_knots",
    "the log of a real warm-up through its set-points, a thermometer 20 s late",
    "--spline",
    "not-a-knot",
    "--lag-s",
    "20",
)
@call(
    "warm_up_real_power_on",
    "the log of a real warm-up with an offset that decays after power-on",
    "--warm-up",
    "--step-c",
    "1.0",
)
def warm_up_real(*more: object) -> Result:
    return fitted(warm_up_log(), "--map", warm_up_map(), *more)


@call("two_point_real", "offsets from two plateaus of a real board, torn lines left out")
def two_point() -> Result:
    source = data_path("thermal_bmi270_two_point")
    logs = (source / "BMI_270_cold_test.csv.gz", source / "BMI_270_hot_test.csv.gz")
    return fitted(*logs, "--map", text_file("two_point.toml", TWO_POINT_MAP))


@call("bicycle_drift", "offsets from eleven short recordings over two degrees")
def bicycle() -> Result:
    calibration = folder() / "bicycle.json"
    path = written(replace(bicycle_session(), kind="thermal"), "bicycle_thermal")
    undrift("calibrate", path, "-o", calibration)
    return fitted(path, "--calibration", calibration)


@cache
def true_file() -> Path:
    path = folder() / "true.json"
    write_calibration(true_calibration(DEVICE), path)
    return path


@cache
def thermal(kind: str, faces: str = "one", seed: int = 1) -> Path:
    """A simulated thermal session; with six faces its soaks go up and down again."""
    warm_up = WarmUpSettings(start_c=12.0, end_c=32.0, duration_s=1500.0)
    ramp = RampSettings(low_c=20.0, high_c=60.0, up_c_per_min=4.0, down_c_per_min=2.0, hold_s=120.0)
    bench = BENCH if kind in ("soak", "multi_position") else replace(BENCH, sample_rate_hz=20.0)
    settings = replace(SOAKS, bench=bench, faces=faces, back=faces == "six", warm_up=warm_up, ramp=ramp)
    made = simulate_thermal_session(kind, DEVICE, rng=np.random.default_rng(seed), settings=settings)  # type: ignore[arg-type]
    return written(made, f"thermal_{kind}_{faces}_{seed}")


@call("soaks", "simulated soaks: the tables that are chosen")
@call("soaks_dynamic", "simulated soaks: offsets and dynamic drift", "--tables", "dynamic", "--step-c", "1.0")
@call(
    "soaks_both",
    "simulated soaks: scale and dynamic drift over a range",
    "--tables",
    "scale+dynamic",
    "--range-c",
    "18:75",
)
@call(
    "soaks_knots",
    "simulated soaks: through the set-points, with a table of the scale",
    "--spline",
    "not-a-knot",
    "--lag-s",
    "0",
    "--tables",
    "scale",
    "--step-c",
    "1.0",
)
def soaks(*more: object) -> Result:
    return fitted(thermal("soak"), "--calibration", true_file(), *more)


@call("ramp", "a simulated ramp")
def ramp() -> Result:
    return fitted(thermal("ramp"), "--calibration", true_file())


@call("warm_up", "two simulated warm-ups with an offset that decays after power-on")
def warm_up() -> Result:
    return fitted(thermal("warm_up"), thermal("warm_up", seed=2), "--calibration", true_file(), "--warm-up")


@call("poses_warm", "simulated free poses at several temperatures")
def poses_warm() -> Result:
    return fitted(thermal("multi_position"), "--calibration", true_file())


def late_ramp(c_per_min: float, seed: int) -> Session:
    """Return a device at rest whose temperature goes from 20 to 40 degC and back, its thermometer 20 s late."""
    half = round(60.0 * 20.0 / c_per_min * 10.0)
    temp = np.concatenate((np.linspace(20.0, 40.0, half), np.linspace(40.0, 20.0, half)))
    model = replace(
        DEVICE,
        gyro=replace(DEVICE.gyro, low_pass=None, warm_up=None),
        accel=replace(DEVICE.accel, low_pass=None, lever_arm=None),
        thermometer=replace(DEVICE.thermometer, lag_s=20.0, self_heating_c=0.0),
    )
    n, ones = len(temp), np.ones((len(temp), 1))
    motion = Motion(
        time=np.arange(n) / 10.0,
        q_nb=ones * [1.0, 0.0, 0.0, 0.0],
        rate_b=np.zeros((n, 3)),
        mean_rate_b=np.zeros((n, 3)),
        force_b=ones * [0.0, 0.0, STANDARD_GRAVITY],
        gravity_m_s2=STANDARD_GRAVITY,
        moving=np.zeros(n),
    )
    record = simulate_device(model, motion, rng=np.random.default_rng(seed), temp_c=temp).record
    rest = (Still(start=0, stop=n),)
    return Session(kind="thermal", serial=DEVICE.serial, gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=rest)


@call("thermometer_lag", "the lag of a simulated thermometer, found and taken off")
def thermometer_lag() -> Result:
    ramps = (late_ramp(1.0, 1), late_ramp(3.0, 2))
    trusted = [trusted_temperature(ramp, 0) for ramp in ramps]
    fit = estimate_lag(observe_rests(ramps, temperatures=[[t.temp_c] for t in trusted]))
    record = ramps[1].records[0]
    smooth_s = default_smooth_s(20.0, noise_c=0.03, interval_s=0.1, step_c=0.1)
    assert record.temp_c is not None
    return {
        "lag_s": fit.lag_s,
        "uncertainty_s": fit.uncertainty_s,
        "observable": fit.observable,
        "two_speeds": fit.two_speeds,
        "misfit": fit.misfit,
        "smooth_s": smooth_s,
        "trusted": [t.temp_c for t in trusted],
        "without_lag": without_lag(record.temp_c, record.time, lag_s=20.0, smooth_s=smooth_s)[0],
        "without_lag_smooth": without_lag_smooth(record.temp_c, record.time, lag_s=20.0),
    }


@call("lag_of_ramps", "tables from two ramps with the lag found and taken off")
def lag_of_ramps() -> Result:
    paths = [written(late_ramp(speed, seed), f"late_{seed}") for seed, speed in ((1, 1.0), (2, 3.0))]
    return fitted(*paths, "--calibration", true_file())


@call("trusted_real", "what is believed of the temperatures of a real warm-up")
def trusted_real() -> Result:
    rows = np.genfromtxt(warm_up_log(), delimiter=",", skip_header=1)
    record = Record(
        time=1e-3 * rows[:, 12], gyro=rows[:, 3:6] / 16.4, temp_c=rows[:, 9] / 340.0 + 36.53, gyro_unit="dps"
    )
    session = Session(kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=(record,))
    found = trusted_temperature(session, 0)
    return {
        "temp_c": found.temp_c,
        "uncertainty_c": found.uncertainty_c,
        "noise_c": found.noise_c,
        "step_c": found.step_c,
    }


@call(
    "soak_fit_details",
    "soaks on six faces up and down, and what stands behind their tables",
)
def details() -> Result:
    fit = fit_drift([read_session(thermal("soak", "six"))], true_calibration(DEVICE))
    nodes = np.array([18.0, 30.0, 46.5, 75.0])
    found: Result = {"blocks": len(fit.rests), "steps": len(fit.steps), "status": fit.verdict.status}
    found["calibration"] = calibration_json(fit.calibration)
    for name, triad in (("gyro", fit.static.gyro), ("accel", fit.static.accel)):
        assert triad is not None
        at, loop = triad.curve.spline.at(nodes), triad.curve.loop
        found[name] = {
            "slope": triad.slope,
            "slope_uncertainty": triad.slope_uncertainty,
            "leave_out_rms": triad.curve.spline.left_out[0],
            "scatter": triad.curve.spline.visit_deviation,
            "span_c": triad.span_c,
            "value": at.value,
            "covariance_at_nodes": at.covariance,
            "loop_half": None if loop is None else loop.half,
            "loop_uncertainty": None if loop is None else loop.uncertainty,
            "kept_loop": triad.curve.kept_loop,
        }
    choice, accel = fit.choice, fit.accel
    assert choice is not None
    assert accel is not None
    rows = choice.alternatives
    found["choice"] = {
        "fitted_rms_dps": rows.fitted_rms_dps,
        "soak_rms_dps": rows.soak_rms_dps,
        "rate_rms_dps": rows.rate_rms_dps,
        "left_out_rms_dps": rows.left_out_rms_dps,
        "standard_error_dps": rows.standard_error_dps,
        "status": choice.verdict.status,
    }
    if choice.scale is not None:
        found["scale"] = {
            "temp_c": choice.scale.soaks.temp_c,
            "forward": choice.scale.soaks.forward,
            "variance": choice.scale.soaks.variance,
            "rms": choice.scale.soaks.rms,
            "percent_per_k": choice.scale.percent_per_k,
            "percent_per_k_uncertainty": choice.scale.percent_per_k_uncertainty,
        }
    for name, dynamic in (("dynamic", choice.dynamic), ("both", choice.both)):
        if dynamic is not None:
            found[name] = {"error": dynamic.drift.error, "before": dynamic.before, "after": dynamic.after}
    found["accel_drift"] = {
        "temp_c": accel.temp_c,
        "offset": accel.offset,
        "offset_uncertainty": accel.offset_uncertainty,
        "matrix": accel.matrix,
        "matrix_uncertainty": accel.matrix_uncertainty,
        "percent_per_k": accel.percent_per_k,
        "percent_per_k_uncertainty": accel.percent_per_k_uncertainty,
    }
    return found
