"""Real recordings that begin and end in motion, each judged by the fit to the others of its device (benchmarks/in_motion.py)."""

import numpy as np
import pytest
from benchmarks.in_motion import pairs, table

from testkit.data import data_path, show
from testkit.findings import only
from undrift.calibration.reference import fit_reference

FOLDERS = {"chain": "chain_with_optics", "carpus": "robot_arm_reference"}
# Means over the recordings of a device, deg: end total raw (at least), by the fit to the others, with offset from motion
LIMITS = {"chain": (40.0, 1.0, 2.5), "carpus": (1.5, 0.5, 0.5)}


@pytest.mark.parametrize("name", LIMITS)
def test_the_fit_to_another_recording_and_the_offset_from_motion_correct_it(name):
    data_path(FOLDERS[name], "SOURCE.md")
    ends = {what: found.mean.end_total_deg for what, found in table(name)}
    raw, fitted, moved = LIMITS[name]
    for what, end in ends.items():
        show(f"{name}, {what}: end total, deg", f"{end:.2f}", LIMITS[name])
    assert ends["raw"] > raw
    assert ends["fit to the others"] < fitted
    assert ends["fit to the others + offset from motion"] < moved


def test_planar_paths_of_a_robot_keep_a_prior_about_one_axis():
    data_path("robot_arm_reference", "SOURCE.md")
    fit = fit_reference(*zip(*pairs("carpus"), strict=True))
    assert only(fit.triad.verdict.findings, "reference.prior").values["axes"] == ("x",)
    # 3 mg of resampled readings, 30 s: what is shown lies within the part's data sheet (1 %, 0.6 deg)
    shown = fit.triad.model.standard_uncertainty[:9].reshape(3, 3)[:, 1:]
    assert shown.max() < 0.02
    assert np.linalg.det(fit.triad.model.matrix) == pytest.approx(1.0, abs=0.05)
