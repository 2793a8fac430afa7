"""People rising, squatting and climbing, marker files as published: lean, rates and ways as measured on the same files.

Sit-to-stand and squat: 100 Hz OpenSim TRC files of a laboratory set (repository nimblephysics, 2025-09-14); stairs: TRC files of
the same repository; squat.c3d: a 120 Hz full-body capture of the same repository. Figures to reproduce stand in the data's own
description: C7 rises 0.468 m, trunk lean 0-43 deg, peak trunk pitch rate 136 deg/s; stairs 1.47 m forward and 0.67 m up.
"""

import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.frames import rotate
from undrift.io.mocap import Markers, read_c3d, read_trc
from undrift.io.reference import Body, device_on, find_body
from undrift.record import Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline

FILES = {
    "STS1": ("mocap_sit_to_stand", "STS1.trc.gz"),
    "STSAsym1": ("mocap_sit_to_stand", "STSAsym1.trc.gz"),
    "squats1": ("mocap_sit_to_stand", "squats1.trc.gz"),
    "StairUp3": ("mocap_stair_up", "markers_StairUp3.trc.gz"),
    "Squat2": ("mocap_stair_up", "markers_Squat2.trc.gz"),
    "squat.c3d": ("c3d", "squat.c3d.gz"),
}
MOST_LEAN_DEG = {"squat.c3d": 115.0}  # it bows until the head is below the belt, before and after the squat
SETTINGS = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone
G = 9.81


def read(trial: str) -> Markers:
    path = data_path(*FILES[trial])
    return read_c3d(path, up="y") if trial.endswith("c3d") else read_trc(path, up="y")


def motion_at(reference: Reference, rate_hz: float = 286.0) -> Motion:
    """Return the motion through poses at a sample rate."""
    spline = fit_pose_spline(reference, SETTINGS)
    start, stop = spline.span_s
    return spline.at(start + np.arange(int((stop - start) * rate_hz + 1e-6) + 1) / rate_hz, G)


def lean_deg(body: Body):
    return np.degrees(np.arccos(rotate(body.reference.q_nb, np.array([0.0, 0.0, 1.0]))[:, 2]))


def test_trunk_leans_43_deg_and_pitches_at_136_deg_per_s():
    markers = read("STS1")
    trunk = find_body(markers, "trunk")
    c7 = markers.pick(["C7"])[:, 0]
    motion = motion_at(trunk.reference)
    lean = lean_deg(trunk)
    rate = np.degrees(np.abs(motion.rate_b).max(axis=0))
    show("C7 rises, m", f"{np.ptp(c7[:, 2]):.3f}", "0.468")
    show("trunk lean, deg", f"{lean.min():.1f} to {lean.max():.1f}", "0 to 43")
    show("peak trunk rate roll, pitch, yaw, deg/s (10 Hz)", np.round(rate, 1).tolist(), "pitch 136")
    assert np.ptp(c7[:, 2]) == pytest.approx(0.468, abs=0.001)
    assert lean.min() < 0.5
    assert lean.max() == pytest.approx(43.0, abs=0.5)  # printed to a degree
    assert rate[1] == pytest.approx(136.0, abs=1.5)  # theirs from differences of a smoothed angle
    assert rate[1] > 3.0 * max(rate[0], rate[2])  # rising is pitch


def test_the_stairs_lead_1_47_m_forward_and_0_67_m_up():
    markers = read("StairUp3")
    for name in ("C7", "T10", "CLAV"):
        way = np.ptp(markers.pick([name])[:, 0], axis=0)
        show(f"{name}: forward, sway, up, m", np.round(way, 3).tolist(), "1.47, 0.12-0.19, 0.67")
        assert way[0] == pytest.approx(1.46, abs=0.015)
        assert 0.12 <= way[1] <= 0.19
        assert way[2] == pytest.approx(0.67, abs=0.005)
    device = device_on(find_body(markers, "pelvis"))
    motion = motion_at(device)
    show("device at L5 forward, left, up, m", np.round(np.ptp(device.position, axis=0), 2).tolist())
    assert (motion.valid == 1.0).all()


@pytest.mark.parametrize("trial", FILES)
def test_every_trial_becomes_the_motion_of_a_device_at_l5(trial):
    markers = read(trial)
    pelvis, trunk = find_body(markers, "pelvis"), find_body(markers, "trunk")
    device = device_on(pelvis)
    motion = motion_at(device)
    known = motion.valid > 0.0
    rate, force = np.degrees(np.abs(motion.rate_b[known]).max(axis=0)), np.linalg.norm(motion.force_b[known], axis=1)
    lean = lean_deg(trunk)
    show(
        f"{trial}: pelvis rigid within, mm; known, %",
        f"{1e3 * pelvis.residual:.1f}; {100.0 * known.mean():.1f}",
        "5; 95",
    )
    show("   trunk lean, deg", f"{np.nanmin(lean):.1f} to {np.nanmax(lean):.1f}", MOST_LEAN_DEG.get(trial, 60.0))
    show("   peak rate at L5, deg/s; specific force, m/s2", f"{np.round(rate)}; {force.min():.1f} to {force.max():.1f}")
    assert known.mean() > 0.95
    assert pelvis.residual < 5e-3  # skin
    assert np.nanmax(lean) < MOST_LEAN_DEG.get(trial, 60.0)
    assert rate.max() < 300.0  # a person, not a throw
    # The mean of a start and end at rest is gravity: what the body's way adds cancels but for its final speed.
    start_to_end = rotate(motion.q_nb[known], motion.force_b[known]).mean(axis=0)
    assert start_to_end[2] == pytest.approx(G, abs=0.35)
    assert np.abs(start_to_end[:2]).max() < 0.35
