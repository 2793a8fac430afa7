"""Real recordings that begin and end in motion, each judged by the fit to the others of its device (benchmarks/in_motion.py)."""

import numpy as np
import pytest
from benchmarks.in_motion import SETS, pairs, table

from testkit.data import data_path, show
from testkit.findings import only
from undrift.calibration.reference import fit_reference
from undrift.correction.correct import correct_checked
from undrift.errors import InputError
from undrift.model import Calibration
from undrift.twin.fit import fit_twin
from undrift.twin.held_out import compare_held_out

FOLDERS = {"chain": "chain_with_optics", "carpus": "robot_arm_reference"}
# Means over the recordings of a device, deg: end total raw (at least), by the fit to the others, with offset from motion
LIMITS = {"chain": (40.0, 1.0, 2.5), "carpus": (1.5, 0.5, 0.5)}


@pytest.mark.parametrize("name", LIMITS)
def test_fit_to_another_recording_corrects_it(name):
    data_path(FOLDERS[name], "SOURCE.md")
    ends = {what: result.mean.end_total_deg for what, result in table(name)}
    raw, fitted, moved = LIMITS[name]
    for what, end in ends.items():
        show(f"{name}, {what}: end total, deg", f"{end:.2f}", LIMITS[name])
    assert ends["raw"] > raw
    assert ends["fit to the others"] < fitted
    assert ends["fit to the others + offset from motion"] < moved


def test_correct_subtracts_the_offset_without_a_rest():
    data_path("chain_with_optics", "SOURCE.md")
    (record, _), other = pairs("chain")
    gyro = fit_reference([other[0]], [other[1]]).triad.model
    calibration = Calibration(device="chain", gyro=gyro, reference_temp_c=25.0, gravity_m_s2=9.80665)
    plain, moved = (correct_checked(record, calibration, offset=offset, check=False) for offset in ("none", "motion"))
    assert moved.rest.rest_s is None
    np.testing.assert_allclose(plain.record.gyro - moved.record.gyro, moved.rest.at(record.time), atol=1e-12)
    # Turn-on repeatability is a tenth of a degree per second: what two recordings of one device differ by
    assert np.abs(np.degrees(moved.rest.rate)).max() < 0.3
    with pytest.raises(InputError, match=r"no still phase"):
        correct_checked(record, calibration, offset="rest", check=False)


@pytest.mark.slow
def test_planar_paths_of_a_robot_keep_a_prior_about_one_axis():
    data_path("robot_arm_reference", "SOURCE.md")
    fit = fit_reference(*zip(*pairs("carpus"), strict=True))
    assert only(fit.triad.verdict.findings, "motion.prior").values["axes"] == ("x",)
    # 3 mg of resampled readings, 30 s: what is shown lies within the part's data sheet (1 %, 0.6 deg)
    shown = fit.triad.model.standard_uncertainty[:9].reshape(3, 3)[:, 1:]
    assert shown.max() < 0.02
    assert np.linalg.det(fit.triad.model.matrix) == pytest.approx(1.0, abs=0.05)


def test_twin_predicts_the_end_error_of_raw_readings():
    data_path("chain_with_optics", "SOURCE.md")
    twin = fit_twin(*zip(*pairs("chain"), strict=True), names=SETS["chain"])
    rng = np.random.default_rng(0)
    pitch = [np.degrees(np.nanmedian(item.pitch)) for item in compare_held_out(twin, rng=rng, lengths_s=(5.0,))]
    show("held out, largest pitch difference in 5 s, deg", np.round(pitch, 2), 0.7)
    assert max(pitch) < 0.7  # poses at 30 Hz under rates of 150 deg/s
