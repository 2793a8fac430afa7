"""Calibrations: six faces, known rotation, rate table, many poses, a reference, the converter; noise. Real and simulated."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from characterisation.recordings import bicycle as bicycle_session
from characterisation.recordings import (
    broad,
    broad_beginning,
    foot_annotated,
    foot_example,
    foot_pieces,
    jig_dwells,
    jig_lag,
    nist_points,
)
from characterisation.shared import Result, call, new, text_file, undrift
from testkit.data import data_path
from undrift.calibration.adc import identify_adc, identify_record_adc, without_truncation
from undrift.calibration.calibrate import calibrate_to_references
from undrift.calibration.checks import face_vectors
from undrift.calibration.dwells import dwell_means
from undrift.calibration.noise import allan_deviation
from undrift.calibration.rate_table import fit_rate_axis, fit_rate_table
from undrift.calibration.reference import fit_reference
from undrift.calibration.six_face import FaceMeans, fit_six_face
from undrift.fit.least_squares import TriadFit
from undrift.io.session import read_session, write_session
from undrift.io.store import calibration_json
from undrift.record import FACES, Session
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session

MODES = ("paper", "affine", "levelled")
TURNS = (0.5, 1.0, 1.5)


def written(session: Session, name: str) -> Path:
    """Return the folder of a session that was written."""
    path = new(name)
    write_session(session, path)
    return path


@cache
def foot_sensor(name: str) -> Path:
    """Six faces and three turns of a foot sensor."""
    record, ranges = foot_example() if name == "example" else foot_annotated()
    stills, turns = foot_pieces(ranges, -360.0 if name == "example" else 360.0)
    held = Session(
        kind="calibration",
        serial="foot",
        gravity_m_s2=9.81,
        records=(record,),
        stills=stills,
        turns=turns,
    )
    return written(held, f"foot_{name}")


@call("foot_example_paper", "a foot sensor's public session by the paper's equations", "example", "paper")
@call("foot_example_affine", "a foot sensor's public session by affine fits", "example", "affine")
@call("foot_example_levelled", "a foot sensor's public session with levelled faces", "example", "levelled")
@call("foot_annotated_paper", "a foot sensor's session in counts by the paper's equations", "annotated", "paper")
@call("foot_annotated_affine", "a foot sensor's session in counts by affine fits", "annotated", "affine")
def foot(name: str, mode: str) -> Result:
    return undrift("calibrate", foot_sensor(name), "--mode", mode)


@cache
def bench(kind: str) -> Path:
    """A simulated session of a consumer device."""
    rng = np.random.default_rng(5)
    settings = BenchSettings(errors=BenchErrors(face_tilt=np.radians(0.05)), turn_rates=TURNS, dwell_s=2.0)
    return written(simulate_session(kind, random_device(rng), rng=rng, settings=settings), f"sim_{kind}")  # type: ignore[arg-type]


@call("bench_paper", "a simulated bench of faces and rates by the paper's equations", "bench", "paper")
@call("bench_affine", "a simulated bench of faces and rates by affine fits with rests", "bench", "affine")
@call("bench_levelled", "a simulated bench of faces and rates with levelled faces", "bench", "levelled")
@call("six_face_paper", "simulated six faces alone by the paper's equations", "six_face", "paper")
@call("six_face_levelled", "simulated six faces alone with levelled faces", "six_face", "levelled")
@call("rate_table_affine", "simulated rates alone by affine fits", "rate_table", "affine")
@call("ferraris_affine", "a simulated Ferraris session by affine fits", "ferraris", "affine")
def simulated(kind: str, mode: str) -> Result:
    return undrift("calibrate", bench(kind), "--mode", mode)


@call("bench_latitude", "a simulated bench with the Earth's rotation taken off")
def bench_latitude() -> Result:
    return undrift("calibrate", bench("bench"), "--latitude-deg", "45.4")


@call("bench_found", "a simulated bench whose stills and turns are to be found")
def bench_found() -> Result:
    rng = np.random.default_rng(5)
    settings = BenchSettings(turn_rates=TURNS, dwell_s=2.0)
    session = simulate_session("six_face", random_device(rng), rng=rng, settings=settings, labelled=False)
    return undrift("calibrate", written(session, "sim_found"))


@call("rate_table_without_rests", "simulated rates whose rests were taken away")
def without_rests() -> Result:
    rng = np.random.default_rng(6)
    settings = BenchSettings(turn_rates=TURNS, dwell_s=2.0)
    session = simulate_session("rate_table", random_device(rng), rng=rng, settings=settings)
    return undrift("calibrate", written(replace(session, stills=()), "sim_no_rests"))


@call("hand_turned_simulated", "many simulated poses turned by hand")
def hand_turned() -> Result:
    return undrift("calibrate", bench("multi_position"))


@call("xsens_calibrated", "the published multi-position set by the whole procedure")
def xsens() -> Result:
    path = new("xsens")
    path.mkdir()
    for name in ("xsens_acc.txt.gz", "xsens_gyro.txt.gz"):
        (path / name).symlink_to(data_path("multipos_xsens", name))
    (path / "session.toml").write_text(
        '[session]\nkind = "calibration"\nserial = "MTi"\nlatitude_deg = 45.4\nheight_m = 12.0\n'
        '[[recording]]\nfile = ["xsens_acc.txt.gz", "xsens_gyro.txt.gz"]\ndelimiter = " "\nheader = false\n'
        "columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]\n"
        'units = { time = "s", accel = "count", gyro = "count" }\n'
    )
    return undrift("calibrate", path)


@call("hand_turned_real", "a board turned by hand, by the whole procedure")
def hand_turned_real() -> Result:
    path = new("mpu9150")
    path.mkdir()
    (path / "imu1.log.gz").symlink_to(data_path("multipos_mpu9150", "imu1.log.gz"))
    (path / "session.toml").write_text(
        '[session]\nkind = "calibration"\nserial = "imu1"\ngravity_m_s2 = 9.81\n'
        '[[recording]]\nfile = "imu1.log.gz"\ndelimiter = " "\nheader = false\nsample_rate_hz = 100.0\n'
        'columns = { accel = [0, 1, 2], gyro = [3, 4, 5] }\nunits = { accel = "m/s2", gyro = "rad/s" }\n'
    )
    return undrift("calibrate", path)


@call("bicycle_calibrated", "eleven still recordings of a bicycle's board")
def bicycle() -> Result:
    return undrift("calibrate", written(bicycle_session(), "bicycle"))


@call("fit_residuals", "residuals of faces and of dwells in every mode, tilt and linearity")
def fit_residuals() -> Result:
    forward = np.array([[1.02, 0.01, -0.008], [0.004, 0.97, 0.012], [-0.006, 0.009, 1.01]])
    rng, up = np.random.default_rng(9), 9.81 * face_vectors(FACES)
    reading = up @ forward.T + np.array([0.3, -0.2, 0.1]) + rng.normal(0.0, 0.01, (6, 3))
    poses = FaceMeans(reading=reading, faces=FACES, noise=np.full((6, 3), 0.002))
    found: Result = {}
    for mode in MODES:
        faces = fit_six_face(poses, gravity=9.81, mode=mode)  # type: ignore[arg-type]
        found[f"faces_{mode}"] = triad(faces) | {"tilt": faces.tilt}
    session = read_session(bench("rate_table"))
    dwells = dwell_means(session.records, session.turns)
    for mode in ("paper", "affine"):
        rates = fit_rate_table(dwells, mode=mode, latitude_deg=45.0)  # type: ignore[arg-type]
        found[f"rates_{mode}"] = triad(rates) | {
            "turn_rate": rates.turn_rate,
            "nonlinearity": [line.scale_factor_nonlinearity for line in rates.linearity],
        }
    return found


def triad(fit: TriadFit) -> Result:
    return {
        "matrix": fit.model.matrix,
        "offset": fit.model.offset,
        "covariance": fit.model.covariance,
        "condition": fit.model.condition,
        "residuals": fit.residuals,
        "status": fit.verdict.status,
    }


@call("broad_reference_windows", "what stands behind a fit to poses: lags, offsets at rest and in motion, windows")
def reference_windows() -> Result:
    pairs = [broad_beginning(number, 120.0) for number in (32, 35)]
    fit = fit_reference([p[0] for p in pairs], [p[1] for p in pairs])
    return triad(fit.triad) | {
        "motion_offset": fit.motion_offset,
        "rest_offsets": fit.rest_offsets,
        "lags_s": fit.lags_s,
        "lag_uncertainties_s": fit.lag_uncertainties_s,
        "turn_rates_rms": fit.turn_rates_rms,
        "window_s": fit.window_s,
        "window_rms": fit.window_rms,
    }


@call("rate_table_jig", "one axis of a public stepper rate table: lag of the clocks, scale, linearity")
def jig() -> Result:
    found: Result = {}
    for run in ("giro_test_filt", "giro_test_non_filt"):
        lag = jig_lag(run)
        dwells = jig_dwells(run, lag)
        fit = fit_rate_axis(dwells)
        found[run] = {
            "lag_s": lag,
            "scale_factor": fit.scale_factor,
            "offset": fit.offset,
            "covariance": fit.covariance,
            "residuals": fit.residuals,
            "nonlinearity": fit.linearity.scale_factor_nonlinearity,
            "status": fit.verdict.status,
        }
    return found


@call("broad_reference_fit", "gyroscopes fitted to the poses of two real trials, two minutes of each")
def reference_fit() -> Result:
    pairs = [broad_beginning(number, 120.0) for number in (3, 24)]
    return calibration_json(calibrate_to_references([p[0] for p in pairs], [p[1] for p in pairs]))


@call("adc_identified", "steps and rounding of converters, real and simulated, and codes put back")
def adc() -> Result:
    found: Result = {}
    for number in (5, 32):
        record, _ = broad(number)
        model = identify_record_adc(record.between(0.0, 90.0))
        found[f"broad_{number}"] = None if model is None else {
            "gyro_lsb": model.gyro_lsb,
            "gyro_rounding": model.gyro_rounding,
            "accel_lsb": model.accel_lsb,
            "accel_rounding": model.accel_rounding,
        }  # fmt: skip
    time, rng = np.arange(40_000)[:, None], np.random.default_rng(1)
    swept = 600.0 * np.sin(time / np.array([30.0, 37.0, 41.0])) + rng.normal(0.0, 5.0, (40_000, 3))
    for name, rounded in (("nearest", np.round(swept)), ("floor", np.floor(swept)), ("toward_zero", np.trunc(swept))):
        made = identify_adc(0.061 * rounded)
        found[name] = {"lsb": made.lsb, "rounding": made.rounding}
        if made.lsb is not None and made.rounding is not None:
            found[name]["put_back"] = without_truncation(0.061 * rounded, made.lsb, made.rounding)
    return found


STATIC_MAP = f"""columns = {{ accel = ["ax", "ay", "az"], gyro = ["gx", "gy", "gz"] }}
units = {{ accel = "g", gyro = "dps" }}
scale = {{ accel = {{ gain = {1 / 16384} }}, gyro = {{ gain = {1 / 131} }} }}
sample_rate_hz = 100.0
skip_rows = 4
"""


@call("noise_static", "noise of a real device at rest, seven minutes")
def noise() -> Result:
    source = data_path("static_mpu6050", "example_data_tinit_calc.csv.gz")
    return undrift("noise", source, "--map", text_file("static.toml", STATIC_MAP))


@call("allan_deviation", "overlapping Allan deviation of the published thousand points")
def allan() -> Result:
    points, taus = nist_points(), [1.0, 3.0, 10.0, 30.0, 100.0]
    return {"deviation": allan_deviation(points, 1.0, taus=taus).deviation}
