"""Fusion, imucal and ROS: what they evaluate is what the corrector does at one temperature; imucal's way back is exact."""

import json
import math
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import STRICT
from testkit.data import show
from testkit.full_calibration import STEPS, device, record, tables
from undrift.correction.correct import correct
from undrift.errors import FileFormatError, InputError
from undrift.export.programs import decompose, export_fusion, export_imucal, export_ros, number
from undrift.io.imucal import import_imucal
from undrift.io.store import read_calibration, write_calibration
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, NoiseModel

DEG = np.pi / 180.0
# what Fusion declares, in a few lines of our own: the matrix as present headers have it, and as older ones had it
ELEMENT = "struct { float xx; float xy; float xz; float yx; float yy; float yz; float zx; float zy; float zz; } element"
FUSION = """
typedef union {{ float array{shape}; {element}; }} FusionMatrix;
typedef union {{ float array[3]; }} FusionVector;
static FusionVector FusionModelInertial(FusionVector u, FusionMatrix m, FusionVector s, FusionVector b)
{{
    FusionVector w;
    const float x = s.array[0] * (u.array[0] - b.array[0]), y = s.array[1] * (u.array[1] - b.array[1]);
    const float z = s.array[2] * (u.array[2] - b.array[2]);
    w.array[0] = m.element.xx * x + m.element.xy * y + m.element.xz * z;
    w.array[1] = m.element.yx * x + m.element.yy * y + m.element.yz * z;
    w.array[2] = m.element.zx * x + m.element.zy * y + m.element.zz * z;
    return w;
}}
"""
MAIN = """
#include <stdio.h>
#include "calibration.h"
static void show(FusionVector w)
{
    printf("%.9g\\n%.9g\\n%.9g\\n", (double)w.array[0], (double)w.array[1], (double)w.array[2]);
}
int main(void)
{
    const FusionVector u = {{100.0f, -200.0f, 300.0f}};
    show(FusionModelInertial(u, gyroscopeMisalignment, gyroscopeSensitivity, gyroscopeOffset));
    show(FusionModelInertial(u, accelerometerMisalignment, accelerometerSensitivity, accelerometerOffset));
    return 0;
}
"""


def at_40(calibration):
    """What the corrector makes of one reading at 40 degC, without g-sensitivity and dynamic table."""
    bare = replace(calibration, gyro=replace(calibration.gyro, g_sensitivity=None))
    bare = replace(bare, drift=replace(bare.drift, dynamic=None))
    u = np.tile([100.0, -200.0, 300.0], (2, 1))
    done = correct(record(2, gyro=u, accel=u, temp_c=np.full(2, 40.0)), bare)
    return done.gyro[0], done.accel[0]


@pytest.mark.parametrize("shape", ["[9]", "[3][3]"])
def test_fusion_evaluates_the_same_as_the_corrector(shape, tmp_path):
    made = device(drift=tables(scale=STEPS[::2]))
    exported = export_fusion(made, temp_c=40.0)
    (tmp_path / "Fusion.h").write_text(FUSION.format(shape=shape, element=ELEMENT))
    (tmp_path / "calibration.h").write_text(exported.text)
    (tmp_path / "main.c").write_text(MAIN)
    subprocess.run(["gcc", *STRICT, "-I", tmp_path, tmp_path / "main.c", "-o", tmp_path / "run"], check=True)
    got = np.array(subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True).stdout.split(), float)
    w, a = at_40(made)
    np.testing.assert_allclose(got[:3], w / DEG, rtol=0, atol=1e-5)  # single precision of terms near 30 deg/s
    np.testing.assert_allclose(got[3:], a / 9.80665, rtol=0, atol=1e-6)
    said = " | ".join(exported.not_carried)
    for text in ("g-sensitivity", "static table", "scale table", "dynamic table", "uncertainties"):
        assert text in said
    assert "tables over temperature are read at 40 degC" in exported.notes
    with pytest.raises(
        InputError, match="wanted a temperature from 18 to 75 degC to read the tables at, got 90; give temp_c"
    ):
        export_fusion(made, temp_c=90.0)
    assert "no accelerometer constants" in " ".join(export_fusion(device(accel=None, drift=None)).notes)


def test_any_matrix_is_taken_apart_and_put_together():
    for matrix in (device().gyro.matrix, np.array([[0.0, -2.0, 0.1], [3.0, 0.0, 0.0], [0.0, 0.2, -1.0]])):
        m, s = decompose(matrix)
        np.testing.assert_allclose(m * s, matrix, rtol=1e-15)
        np.testing.assert_allclose(np.linalg.norm(m, axis=0), 1.0, rtol=1e-15)
        assert (s > 0.0).all()


# gains, axes and offsets of imucal's annotated session (raw counts, 204.8 Hz): its own snapshot
SNAPSHOT = {
    "acc_unit": "m/s^2", "gyr_unit": "deg/s", "from_acc_unit": "a.u.", "from_gyr_unit": "a.u.", "comment": None,
    "K_a": np.diag([208.54567263762615, 208.0011341167055, 214.78455364603022]).tolist(),
    "R_a": [[0.9999125214, 0.0071220561, -0.0111456629], [-0.0079473785, 0.9996887358, 0.0236489034],
            [0.0213429007, -0.0107818795, 0.9997140750]],
    "b_a": [-6.018868019671572, -48.287874016760156, -28.96636637224333],
    "K_g": np.diag([16.67769558952488, 16.187895200550262, 16.253362639451936]).tolist(),
    "R_g": [[-0.9999143757, -0.0006142301, 0.0130714988], [0.0055057031, -0.9992594967, -0.0380807747],
            [-0.0131465091, 0.0365074525, -0.9992469040]],
    "K_ga": [[0.0022926499, -0.0161346324, 0.0184654357], [0.0138737050, 0.0054436103, -0.0088124809],
             [-0.0092591057, 0.0085063065, -0.0039353822]],
    "b_g": [1.960686204431737, -4.472837741243746, -3.6511794138670477], "cal_type": "Ferraris",
}  # fmt: skip


def by_imucal(file, acc, gyr):
    """What imucal's documentation says that it evaluates, in the file's own units."""
    f = {key: np.array(file[key]) for key in ("K_a", "R_a", "b_a", "K_g", "R_g", "K_ga", "b_g")}
    a = np.linalg.inv(f["R_a"]) @ np.linalg.inv(f["K_a"]) @ (acc - f["b_a"])
    return a, np.linalg.inv(f["R_g"]) @ np.linalg.inv(f["K_g"]) @ (gyr - f["K_ga"] @ a - f["b_g"])


def test_a_calibration_of_imucal_corrects_as_imucal_does():
    made = import_imucal(json.dumps(SNAPSHOT), device="foot")
    u = np.array([[2000.0, 100.0, -300.0], [-50.0, 1500.0, 900.0]])
    done = correct(record(2, gyro=u, accel=u[::-1], temp_c=None, device="foot"), made)
    for k in range(2):
        a, w = by_imucal(SNAPSHOT, u[1 - k], u[k])
        np.testing.assert_allclose(done.accel[k], a, rtol=1e-13)
        np.testing.assert_allclose(done.gyro[k] / DEG, w, rtol=1e-12)
    assert made.device == "foot"
    assert (made.gyro.unit_in, made.gyro.unit_out, made.gravity_m_s2) == ("count", "rad/s", 9.81)


def test_both_ways_of_imucal_are_exact():
    again = json.loads(export_imucal(import_imucal(json.dumps(SNAPSHOT))).text)
    for key in ("K_a", "R_a", "b_a", "K_g", "R_g", "K_ga", "b_g"):  # R printed to ten digits: rows of length 1 to 1e-10
        np.testing.assert_allclose(again[key], SNAPSHOT[key], rtol=2e-10, atol=2e-10, err_msg=key)
    made = device(drift=None)
    back = import_imucal(export_imucal(made).text)
    for name in ("gyro", "accel"):
        ours, theirs = getattr(made, name), getattr(back, name)
        worst = float(np.abs(theirs.matrix / ours.matrix - 1.0).max())
        show(f"{name}: matrix after export and import, relative", worst, 1e-12)
        assert worst < 1e-12  # two inversions; small elements beside large ones
        assert np.abs(theirs.matrix - ours.matrix).max() < 1e-14 * np.abs(ours.matrix).max()
        np.testing.assert_array_equal(theirs.offset, ours.offset)
    np.testing.assert_allclose(back.gyro.g_sensitivity, made.gyro.g_sensitivity, rtol=1e-12, atol=1e-17)
    assert (back.device, back.reference_temp_c, back.gravity_m_s2) == ("A", 25.0, 9.81)


def test_an_imported_calibration_says_that_its_uncertainty_is_not_known(tmp_path):
    made = import_imucal(json.dumps(SNAPSHOT))
    assert np.isnan(made.gyro.covariance).all()
    assert np.isnan(made.accel.standard_uncertainty).all()
    assert made.verdict.status == "marginal"
    assert [(f.code, f.level) for f in made.verdict.findings] == [("imported.uncertainty", "warn")]
    assert "a calibration of imucal states none" in made.verdict.reasons[0]
    write_calibration(made, tmp_path / "c.json")
    read = read_calibration(tmp_path / "c.json")
    assert np.isnan(read.gyro.covariance).all()
    np.testing.assert_array_equal(read.gyro.matrix, made.gyro.matrix)
    assert math.isnan(read.reference_temp_c)


def test_what_imucal_refuses():
    with pytest.raises(InputError, match="export imucal: wanted gyroscopes and accelerometers, got one of them"):
        export_imucal(device(accel=None, drift=None))

    def refused(text, **changes):
        content = json.dumps({**SNAPSHOT, **changes})
        with pytest.raises(FileFormatError, match=text):
            import_imucal(content)

    refused("wanted cal_type 'Ferraris', got 'Turntable'; other kinds are not read", cal_type="Turntable")
    refused("wanted format 2.0.0, got '1.0.0'; convert it with imucal's legacy helpers", _format_version="1.0.0")
    refused(r"wanted K_a as finite numbers of shape \(3, 3\)", K_a=[1.0])
    refused("wanted b_g as finite numbers", b_g=[1.0, 2.0, None])
    refused("wanted b_g as finite numbers", b_g=[1.0, 2.0, "x"])
    refused("wanted a unit for from_gyr_unit, got None; write it into the file", from_gyr_unit=None)
    refused("wanted a unit for gyr_unit, got 'a.u.'", gyr_unit="a.u.")
    refused("wanted a unit for acc_unit, got 'furlong'", acc_unit="furlong")
    refused("wanted a matrix K_g R_g that has an inverse", K_g=np.zeros((3, 3)).tolist())
    for text in ("{", "[1]", '"a"'):
        with pytest.raises(FileFormatError, match=r"wanted JSON, got|wanted cal_type"):
            import_imucal(text)
    assert import_imucal(json.dumps({**SNAPSHOT, "comment": "undrift {"})).device == ""
    assert import_imucal(json.dumps({**SNAPSHOT, "comment": "a note"}), device="B").device == "B"


def parameters(text):
    """The parameters of a ROS 2 file, by a reader that knows no more YAML than it needs."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert lines[:2] == ["/**:", "  ros__parameters:"]
    return {name.strip(): json.loads(value) for name, value in (line.split(": ", 1) for line in lines[2:])}


def test_ros_parameters_correct_as_the_corrector_does():
    three = np.array([1e-4, 2e-4, np.nan])
    noise = NoiseModel(
        angle_random_walk=three, bias_instability=three, rate_random_walk=np.full(3, np.nan),
        velocity_random_walk=three, accel_bias_instability=three, accel_random_walk=three,
    )  # fmt: skip
    made = device(drift=tables(scale=STEPS[::2]), noise=noise)
    exported = export_ros(made, temp_c=40.0)
    held = parameters(exported.text)
    u = np.array([100.0, -200.0, 300.0])
    w, a = at_40(made)
    np.testing.assert_allclose(np.reshape(held["gyro_matrix"], (3, 3)) @ (u - held["gyro_offset"]), w, rtol=1e-12)
    np.testing.assert_allclose(np.reshape(held["SM"], (3, 3)) @ u - held["bias"], a, rtol=1e-12)
    np.testing.assert_array_equal(np.reshape(held["gyro_g_sensitivity"], (3, 3)), made.gyro.g_sensitivity)
    assert held["gyroscope_noise_density"] == 2e-4
    assert "gyroscope_random_walk" not in held
    assert (held["device"], held["temperature_c"], held["gyro_unit_in"]) == ("A", 40.0, "count")
    assert "no standard names these keys: map them to those of your node" in exported.notes
    assert "static table" in " ".join(exported.not_carried)
    only = parameters(export_ros(device(accel=None, drift=None)).text)
    assert "SM" not in only


def test_ros_covariances_are_those_of_drawn_calibrations_and_of_noise_for_each_hz():
    rng = np.random.default_rng(3)
    three = np.array([1e-4, 2e-4, 3e-4])
    noise = NoiseModel(
        angle_random_walk=three, bias_instability=three, rate_random_walk=three,
        velocity_random_walk=2 * three, accel_bias_instability=three, accel_random_walk=three,
    )  # fmt: skip
    made = device(drift=None, noise=noise)
    root = rng.normal(size=(12, 12))
    size = np.concatenate((np.full(9, 1e-3 * np.abs(made.accel.matrix).max()), np.full(3, 2.0)))
    accel = replace(
        made.accel,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        covariance=size[:, None] * (root @ root.T) * size,
        budget=None,
    )
    held = parameters(export_ros(replace(made, accel=accel)).text)
    draws, true = rng.multivariate_normal(np.zeros(12), accel.covariance, 40_000), rng.normal(size=(40_000, 3))
    true *= 9.80665 / np.linalg.norm(true, axis=1, keepdims=True)
    readings = true @ np.linalg.inv(accel.matrix).T  # less the offset
    errors = np.einsum("nij,nj->ni", draws[:, :9].reshape(-1, 3, 3), readings) - draws[:, 9:] @ accel.matrix.T
    found = np.reshape(held["linear_acceleration_covariance"], (3, 3))
    np.testing.assert_allclose(found, errors.T @ errors / len(errors), atol=0.03 * np.trace(found))
    np.testing.assert_allclose(
        np.reshape(held["linear_acceleration_covariance_per_hz"], (3, 3)), np.diag((2 * three) ** 2)
    )
    np.testing.assert_allclose(np.reshape(held["angular_velocity_covariance_per_hz"], (3, 3)), np.diag(three**2))
    assert len(held["angular_velocity_covariance"]) == 9
    in_g = replace(accel, unit_out="g", matrix=accel.matrix / 9.80665, covariance=by_g(accel.covariance))
    same = parameters(export_ros(replace(made, accel=in_g)).text)
    np.testing.assert_allclose(same["linear_acceleration_covariance"], np.ravel(found), rtol=1e-9)
    unknown = replace(accel, covariance=np.full((12, 12), np.nan))
    assert "linear_acceleration_covariance" not in parameters(export_ros(replace(made, accel=unknown)).text)


def by_g(covariance):
    """Return the covariance of a matrix in g and the same offset, of one in m/s2."""
    factor = np.concatenate((np.full(9, 1.0 / 9.80665), np.ones(3)))
    return factor[:, None] * covariance * factor


@pytest.mark.parametrize(
    ("x", "text"), [(1e-5, "1.0e-05"), (3.0, "3.0"), (-2e22, "-2.0e+22"), (0.25, "0.25"), (-1.5e-9, "-1.5e-09")]
)
def test_every_number_has_a_point(x, text):
    assert number(x) == text
    assert float(text) == x
