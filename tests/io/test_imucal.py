"""Calibrations of imucal: what they correct to is what imucal evaluates, and what is refused."""

import json
import math

import numpy as np
import pytest

from testkit.ferraris import ferraris_text
from testkit.full_calibration import device, record
from undrift.correction.correct import correct
from undrift.errors import FileFormatError
from undrift.io.imucal import import_imucal
from undrift.io.store import read_calibration, write_calibration

DEG = np.pi / 180.0
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


def test_a_file_of_imucal_gives_the_constants_that_it_was_made_of():
    made = device(drift=None)
    back = import_imucal(ferraris_text(made))
    for name in ("gyro", "accel"):
        ours, theirs = getattr(made, name), getattr(back, name)
        assert np.abs(theirs.matrix - ours.matrix).max() < 1e-14 * np.abs(ours.matrix).max()
        np.testing.assert_array_equal(theirs.offset, ours.offset)
    np.testing.assert_allclose(back.gyro.g_sensitivity, made.gyro.g_sensitivity, rtol=1e-12, atol=1e-17)


def test_an_imported_calibration_says_that_its_uncertainty_is_not_known(tmp_path):
    made = import_imucal(json.dumps(SNAPSHOT))
    assert np.isnan(made.gyro.covariance).all()
    assert np.isnan(made.accel.standard_uncertainty).all()
    assert made.verdict.status == "marginal"
    assert [(f.code, f.level) for f in made.verdict.findings] == [("imported.uncertainty", "warn")]
    assert "a calibration of imucal contains none" in made.verdict.reasons[0]
    write_calibration(made, tmp_path / "c.json")
    read = read_calibration(tmp_path / "c.json")
    assert np.isnan(read.gyro.covariance).all()
    np.testing.assert_array_equal(read.gyro.matrix, made.gyro.matrix)
    assert math.isnan(read.reference_temp_c)


def test_what_imucal_refuses():
    def refused(text, **changes):
        content = json.dumps({**SNAPSHOT, **changes})
        with pytest.raises(FileFormatError, match=text):
            import_imucal(content)

    refused("expected cal_type 'Ferraris', got 'Turntable'", cal_type="Turntable")
    refused("expected format 2.0.0, got '1.0.0'. Convert it with imucal's legacy helpers", _format_version="1.0.0")
    refused(r"K_a as finite numbers of shape \(3, 3\)", K_a=[1.0])
    refused("expected b_g as finite numbers", b_g=[1.0, 2.0, None])
    refused("expected b_g as finite numbers", b_g=[1.0, 2.0, "x"])
    refused("expected a unit for from_gyr_unit, got None. Write it into the file", from_gyr_unit=None)
    refused("expected a unit for gyr_unit, got 'a.u.'", gyr_unit="a.u.")
    refused("expected a unit for acc_unit, got 'furlong'", acc_unit="furlong")
    refused("matrix K_g R_g has no inverse", K_g=np.zeros((3, 3)).tolist())
    for text in ("{", "[1]", '"a"'):
        with pytest.raises(FileFormatError, match=r"expected JSON, got|expected cal_type"):
            import_imucal(text)
    assert import_imucal(json.dumps({**SNAPSHOT, "comment": "undrift {"})).device == ""
    assert import_imucal(json.dumps({**SNAPSHOT, "comment": "a note"}), device="B").device == "B"
