"""What is done with a calibration: correct, orient, validate, export; and devices simulated, twinned, and files described."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from characterisation.calls_drift import DEVICE, fitted, thermal, true_file, warm_up_log, warm_up_map
from characterisation.calls_fits import bench
from characterisation.recordings import foot_example
from characterisation.shared import (
    Result,
    c_arrays,
    call,
    channels,
    code_hash,
    folder,
    new,
    numbers_in,
    read_back,
    refused,
    text_file,
    undrift,
)
from testkit.data import DATA, data_path
from testkit.demo_session import demo_session
from testkit.faces import faces_at
from testkit.full_calibration import WILD, device, record, tables
from testkit.motion_of_poses import motion_from_poses
from undrift.correction.correct import Corrector, correct_checked
from undrift.io.formats import read_record, read_reference, write_record
from undrift.io.mocap import read_trc
from undrift.io.reference import device_on, find_body, write_reference
from undrift.io.store import read_calibration, write_calibration
from undrift.model import AdcModel
from undrift.orientation import orient
from undrift.record import FACES
from undrift.segments import find_still, find_turns, still_means
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import PoseSettings
from undrift.sim.sessions import simulate_trial
from undrift.study.virtual_bench import bench_device, worn_trial
from undrift.validation.trial import TrialSettings, compare_orientations, validate_trial

TABLES = {"step_and_gap": tables(), "searched": tables(static=WILD, scale=WILD), "dynamic_alone": tables(static=None)}
ADC = AdcModel(gyro_lsb=[1.0] * 3, gyro_rounding="toward_zero", accel_lsb=[1.0] * 3, accel_rounding="floor")


@cache
def demo() -> Path:
    """The demo's quick session: trial and reference as files, and the calibration."""
    made = demo_session(np.random.default_rng(2007), quick=True)
    path = folder() / "demo"
    path.mkdir()
    write_record(made.trial.record, path / "trial.parquet")
    write_reference(made.trial.reference, path / "reference.parquet")
    undrift("calibrate", bench("bench"), "-o", path / "other.json")
    write_calibration(true_calibration(made.device), path / "calibration.json")
    return path


# ---- correct --------------------------------------------------------------------------------------------------------


@call("correct_matrix", "a trial of the demo's seed corrected by matrix and offset")
def correct_matrix() -> Result:
    out = new("corrected.parquet")
    words = (demo() / "trial.parquet", "--calibration", demo() / "calibration.json", "-o", out)
    return {"said": undrift("correct", *words), "written": read_back(out)}


@call("correct_tables", "a simulated warm-up corrected by fitted tables, held at their ends", "hold")
@call("correct_tables_gaps", "a simulated warm-up corrected by fitted tables, gaps outside them", "nan")
def correct_tables(policy: str) -> Result:
    model, out = folder() / "soak_tables.json", new(f"warm_{policy}.csv")
    if not model.exists():
        fitted(thermal("soak"), "--calibration", true_file(), "-o", model)
    trial = folder() / "warm_trial.parquet"
    if not trial.exists():
        made = simulate_trial("step", DEVICE, rng=np.random.default_rng(3), temp_c=(10.0, 40.0))
        write_record(made.record, trial)
    said = undrift("correct", trial, "--calibration", model, "-o", out, "--policy", policy)
    strict = refused("correct", trial, "--calibration", model, "-o", new("strict.csv"))
    return {"said": said, "written": read_back(out), "strict": strict}


@call(
    "correct_every_term", "every term of the model on made readings: each kind of table, each policy, batch and stream"
)
def correct_every_term() -> Result:
    found: Result = {}
    for name, drift in TABLES.items():
        calibration, readings = device(drift=drift, adc=ADC), record(low=10.0, high=80.0)
        for policy in ("hold", "nan"):
            done = correct_checked(readings, calibration, policy=policy)  # type: ignore[arg-type]
            streamed, pieces = Corrector(calibration, policy), []  # type: ignore[arg-type]
            for start, stop in pairwise((0, 17, 90, 91 + 2, len(readings))):
                pieces.append(streamed.push_checked(readings.part(start, stop)).record)
            found[f"{name}_{policy}"] = {
                **channels(done.record),
                "outside": done.outside,
                "samples_outside": streamed.state.samples_outside,
                "samples_extrapolated": streamed.state.samples_extrapolated,
                "stream_is_batch": np.concatenate([p.gyro for p in pieces]).tobytes() == done.record.gyro.tobytes()
                and np.concatenate([p.accel for p in pieces]).tobytes() == done.record.accel.tobytes(),
            }
    return found


@call("correct_lag", "a thermometer's lag taken off while a real warm-up is corrected")
def correct_lag() -> Result:
    model, out = folder() / "real_tables.json", new("real_corrected.parquet")
    fitted(warm_up_log(), "--map", warm_up_map(), "--lag-s", "30", "--step-c", "1.0", "-o", model)
    words = (warm_up_log(), "--map", warm_up_map(), "--calibration", model, "-o", out, "--policy", "hold")
    return {"said": undrift("correct", *words), "written": read_back(out)}


# ---- orient, validate -----------------------------------------------------------------------------------------------


@call("orient_demo", "tilt and strapdown of the demo's trial, heading and axes given")
def orient_demo() -> Result:
    out = new("oriented.parquet")
    words = (demo() / "trial.parquet", "--calibration", demo() / "calibration.json", "-o", out)
    said = undrift("orient", *words, "--offset", "rest", "--heading-deg", "30", "--forward", "+y")
    return {"said": said, "poses": read_reference(out).q_nb}


@call("orient_demo_errors", "inclination, heading and pitch errors of the demo's trial")
def orient_errors() -> Result:
    made = demo_session(np.random.default_rng(2007), quick=True).trial
    done = correct_checked(made.record, read_calibration(demo() / "calibration.json")).record
    found = orient(done)
    errors = compare_orientations(found.q_nb, made.motion.q_nb)
    return {
        "q_nb": found.q_nb,
        "inclination": found.inclination,
        "pitch": found.pitch,
        "total_error": errors.total,
        "inclination_error": errors.inclination,
        "pitch_error": errors.pitch,
    }


def broad(*numbers: str) -> list[Path]:
    return [next(data_path("broad").glob(f"{number}_*.hdf5")) for number in numbers]


@call("validate_rest", "two BROAD trials against their optics, the offset from rest")
def validate_rest() -> Result:
    return undrift("validate", *broad("32", "35"), "--offset", "rest")


@call("validate_none", "a BROAD trial against its optics, as it is, codes left")
def validate_none() -> Result:
    return undrift("validate", *broad("24"), "--offset", "none", "--adc", "none", "--forward", "+y")


@call("validate_leave_one_out", "two BROAD trials, each judged by a fit to the other")
def validate_leave_one_out() -> Result:
    return undrift("validate", *broad("03", "24"), "--calibrate-from", "reference", "--leave-one-out")


@call("validate_demo", "the demo's trial against its simulated optics")
def validate_demo() -> Result:
    words = (demo() / "trial.parquet", "--reference", demo() / "reference.parquet")
    return undrift("validate", *words, "--calibration", demo() / "calibration.json")


@call("worn_trial_levels", "the demo's worn trial by constant calibration, static table, all tables")
def worn_trial_levels() -> Result:
    made = bench_device()
    record, reference = worn_trial(made, seed=2007)
    true = true_calibration(made)
    held = true_tables(made, np.arange(18.0, 50.1, 0.5), np.radians(np.arange(-90.0, 91.0, 15.0)))
    static = replace(held, scale=None, dynamic=None)
    levels = {"constant": true, "static": replace(true, drift=static), "all": replace(true, drift=held)}
    return {
        name: {
            "lag_s": trial.lag.seconds,
            "max_abs_pitch_deg": trial.figures.max_abs_pitch_deg,
            "rmse_pitch_deg": trial.figures.rmse_pitch_deg,
            "rmse_total_deg": trial.figures.rmse_total_deg,
            "end_total_deg": trial.figures.end_total_deg,
        }
        for name, calibration in levels.items()
        for trial in (
            validate_trial(
                record, reference, calibration=calibration, name=name, settings=TrialSettings(policy="hold")
            ),
        )
    }


# ---- twin, simulate -------------------------------------------------------------------------------------------------


@call("twin_one", "the device model fitted to one BROAD trial")
def twin_one() -> Result:
    return undrift("twin", *broad("35"), "--gravity-m-s2", "9.813")


def simulated(*words: object, truth: bool = True) -> Result:
    out, true = new("simulated.parquet"), new("truth.parquet")
    said = undrift("simulate", *words, "-o", out, *(("--truth", true) if truth else ()))
    found = {"said": said, "readings": read_back(out)}
    if truth:
        reference = read_reference(true)
        found |= {"q_nb": reference.q_nb, "position": reference.position}
    return found


@call("simulate_sit_to_stand", "a drawn analogue unit in a sit-to-stand", "sit_to_stand", "enc03j_3031", 3)
@call("simulate_step", "a drawn bmi160 in a step", "step", "bmi160", 4)
@call("simulate_posturography", "a drawn icm20948 in quiet stance", "posturography", "icm20948", 5)
@call("simulate_free", "a drawn lsm6dso in free motion", "free", "lsm6dso", 6)
def simulate(task: str, device: str, seed: int) -> Result:
    return simulated(task, "--device", device, "--draw", "--seed", seed, "--temp-c", "31")


@call("simulate_presets", "every preset, typical, in a step")
def simulate_presets() -> Result:
    names = ("mpu6050", "bmi270", "bmi088", "xsens_mti1", "shimmer3")
    return {name: simulated("step", "--device", name, "--seed", "1", truth=False) for name in names}


@call("simulate_poses", "a device worn in a captured sit-to-stand, from markers")
def simulate_poses() -> Result:
    markers = read_trc(data_path("mocap_sit_to_stand", "STS1.trc.gz"), up="y")
    body = find_body(markers, "pelvis")
    motion = motion_from_poses(
        device_on(body),
        gravity_m_s2=9.81,
        sample_rate_hz=286.0,
        settings=PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0),
    )
    poses = new("poses.parquet")
    write_reference(device_on(body), poses)
    return {
        "residual": body.residual,
        "rate_b": motion.rate_b,
        "force_b": motion.force_b,
        "valid": motion.valid,
        "worn": simulated(poses, "--device", "mpu6050", "--seed", "2", truth=False),
    }


@call("simulate_drawn_units", "units drawn of a kind, their calibrations and tables")
def drawn_units() -> Result:
    found: Result = {}
    for kind in ("enc03j_3031", "mpu6050", "bmi088"):
        made = random_device_of(kind, np.random.default_rng(11))
        true = true_calibration(made)
        held = true_tables(made, np.arange(10.0, 61.0, 5.0), np.radians(np.arange(-90.0, 91.0, 15.0)))
        assert true.gyro is not None
        assert true.accel is not None
        assert held.static is not None
        assert held.scale is not None
        found[kind] = {
            "gyro": {"matrix": true.gyro.matrix, "offset": true.gyro.offset, "g": true.gyro.g_sensitivity},
            "accel": {"matrix": true.accel.matrix, "offset": true.accel.offset},
            "static": {"gyro": held.static.gyro_offset, "accel": held.static.accel_offset},
            "scale": {"gyro": held.scale.gyro_matrix, "accel": held.scale.accel_matrix},
            "dynamic": None if held.dynamic is None else held.dynamic.error,
        }
    return found


# ---- exports --------------------------------------------------------------------------------------------------------


@cache
def to_export() -> Path:
    path = folder() / "to_export.json"
    write_calibration(device(drift=tables(scale=np.linspace(18.0, 75.0, 58))), path)
    return path


@cache
def to_export_si() -> Path:
    path = folder() / "to_export_si.json"
    write_calibration(device(unit="si", drift=tables(dynamic=None)), path)
    return path


@call("export_c_float", "C source of a device with every table, built as float", "--prefix", "knee")
@call("export_c_double", "C source of a device with every table, built as double", "--double")
@call(
    "export_c_fixed",
    "C source of a device with every table, in fixed point, bits given",
    "--fixed",
    "--gyro-raw-bits",
    "4",
)
def export_c(*more: str) -> Result:
    out = folder() / "calibration.h"
    said = undrift("export", to_export(), "--target", "c", "-o", out, *more)
    texts = [out.read_text(), out.with_suffix(".c").read_text()]
    return {
        "said": said,
        "header": {**c_arrays(texts[0]), "code_sha256": code_hash(texts[0])},
        "source": {**c_arrays(texts[1]), "code_sha256": code_hash(texts[1])},
    }


@call("export_c_constant", "C source of matrix and offset alone")
def export_c_constant() -> Result:
    write_calibration(device(adc=ADC), folder() / "constant.json")
    out = folder() / "constant.h"
    said = undrift("export", folder() / "constant.json", "--target", "c", "-o", out)
    text = out.with_suffix(".c").read_text()
    return {"said": said, "source": {**c_arrays(text), "code_sha256": code_hash(text)}}


@call("export_px4", "parameters of PX4", "px4", ".params")
@call("export_ardupilot", "parameters of ArduPilot", "ardupilot", ".param", "--sensor", "1", "--temp-c", "40")
@call("export_fusion", "the header of Fusion", "fusion", ".h", "--temp-c", "40")
@call("export_imucal", "the JSON of imucal", "imucal", ".json", "--temp-c", "40")
@call("export_ros", "the YAML of ROS", "ros", ".yaml", "--temp-c", "40")
def export(target: str, ending: str, *more: str) -> Result:
    out = new(f"exported_{target}{ending}")
    said = undrift("export", to_export_si(), "--target", target, "-o", out, *more)
    return {"said": said, "numbers": numbers_in(out.read_text())}


# ---- segments, files ------------------------------------------------------------------------------------------------


@call("segments", "stills, their faces and turns found in a real session and in a simulated one")
def segments() -> Result:
    found: Result = {}
    simulated_session = demo_session(np.random.default_rng(2007), quick=True).session
    for name, readings in (("foot", foot_example()[0]), ("demo", simulated_session.records[0])):
        search = find_still(readings)
        turns = find_turns(readings, search.stills)
        found[name] = {
            "stills": [[s.start, s.stop] for s in search.stills],
            "means": still_means(readings.accel, search.stills),
            "faces": [FACES.index(face) if face else -1 for face in faces_at(readings, search.stills)],
            "plateaus": [[t.start, t.stop] for t in turns.plateaus],
            "plateau_rate": turns.plateau_rate,
            "rotations": [[t.start, t.stop] for t in turns.rotations],
            "rotation_angle": turns.rotation_angle,
        }
    return found


FOLDERS = (
    "makers",
    "wearable_formats",
    "c3d",
    "mocap_stair_up",
    "multipos_mpu9150",
    "ferraris_nilspod",
    "posturography",
)
FEW = ("xsens_mtmanager/skin", "BDS", "PDS13C", "PDS13OR", "example_calibration")  # alike, or too many
CUT = ("GENEActiv_testfile.bin",)  # in the middle of a page, as its SOURCE.md says


@call("info_formats", "what info says of every file of makers, wearables, optics and force plates")
def info_formats() -> Result:
    found: Result = {}
    for name in FOLDERS:
        for path in sorted(data_path(name).rglob("*")):
            if path.is_file() and path.suffix != ".md" and not any(few in str(path) for few in FEW):
                said = refused("info", path) if path.name in CUT else said_of(path)
                found[str(path.relative_to(DATA)).replace(".", "_")] = said
    for path in (data_path("wearable_formats", "ngimu"), data_path("wearable_formats", "ximu3")):
        found[f"{path.name}_folder"] = said_of(path)
    return found


def said_of(path: Path, *more: object) -> Result:
    said = undrift("info", path, *more)
    return {
        key: said.get(key)
        for key in ("exit", "rows", "sample_rate_hz", "usual_rate_hz", "duration_s", "gaps", "temp_c", "stills")
    }


READ = {
    "ngimu": (("wearable_formats", "ngimu"), ()),
    "ximu3": (("wearable_formats", "ximu3"), ()),
    "ximu": (("wearable_formats", "ximu"), ("--sample-rate-hz", "256")),
    "actigraph": (("wearable_formats", "agread_gt9x_example-IMU.csv.gz"), ()),
    "apdm": (("wearable_formats", "opensim_apdm_imuData01.csv.gz"), ("--sensor", "Upper")),
    "broad": (("broad", "02_undisturbed_slow_rotation_B.hdf5"), ()),
}
AX6_MAP = """columns = { time = "time", gyro = "gyro", accel = "accel", temp = "temperature" }
units = { time = "s", gyro = "dps", accel = "g", temp = "degC" }
"""


@call("info_recordings", "what info says of recordings that need options or a map")
def info_recordings() -> Result:
    found = {name: said_of(data_path(*parts), *more) for name, (parts, more) in READ.items()}
    ax6 = data_path("wearable_formats", "skdh_ax6_data.npz")
    found["ax6"] = said_of(ax6, "--map", text_file("ax6.toml", AX6_MAP))
    found["session"] = said_of(bench("bench"))
    found["calibration"] = said_of(to_export())
    return found


@call("read_recordings", "the readings of wearables as they are read")
def read_recordings() -> Result:
    return {name: channels(read_record(data_path(*parts))) for name, (parts, more) in READ.items() if not more}
