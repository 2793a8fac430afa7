"""Knee angle of two simulated sensors on people who were filmed, with and without the axes that `mount` finds.

Poses of thigh and shank come from the markers of a person (mocap_sit_to_stand). Each segment wears a device of its own, misplaced
by 20 deg, calibrated on a simulated bench; cameras give the true angle: that of the shank against the thigh about the axis it turns
most about, 0 where the leg is straightest. Without axes the angle is the difference of both pitches by the sides of the devices
that were meant to point forward and up.

    python -m benchmarks.knee_angle            # prints a table, deg
"""

from typing import NamedTuple

import numpy as np

import undrift
from testkit.data import data_path
from testkit.motion_of_poses import motion_from_poses
from undrift.frames import (
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation,
    rotation_vector,
    signed,
)
from undrift.io.mocap import pose_from_cluster, read_trc
from undrift.model import BodyMounting
from undrift.mounting import OFFSET, fit_hinge
from undrift.orientation import filtered, sagittal_pitch
from undrift.record import Reference
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import turn_quaternion
from undrift.sim.motion.poses import PoseSettings


class Row(NamedTuple):
    """What comes out of a trial, deg."""

    span: float
    found: float
    plain: float
    stated: float
    off: float
    stated_off: float
    codes: tuple


THIGH = [f"{{side}}_thigh{k}" for k in (1, 2, 3, 4)]
SHANK = ["{side}_sh2", "{side}_sh3", "{side}_shank_antsup"]
TRIALS = tuple((name, side) for name in ("STS1", "squats1") for side in ("L", "r"))
RATE = 100.0
MARKERS = PoseSettings(
    cutoff_hz=6.0, position_cutoff_hz=6.0
)  # skin markers jitter above what a knee does in these tasks


def segments(name, side):
    """Return the poses of thigh and shank whose axes are forward, left and up of the upright person."""
    markers = read_trc(data_path("mocap_sit_to_stand", f"{name}.trc.gz"), up="y")
    poses = [pose_from_cluster(markers, [one.format(side=side) for one in group]) for group in (THIGH, SHANK)]
    hip, knee, ankle = (markers.pick([f"{side}_{one}"])[:, 0] for one in ("thigh1", "knee", "ankle"))
    flexed = _between(knee - hip, ankle - knee)
    straight = int(np.nanargmin(flexed))
    toe, heel = (markers.pick([f"{side}_{one}"])[straight, 0] for one in ("toe", "calc"))
    forward = (toe - heel) * [1.0, 1.0, 0.0]
    heading = np.arctan2(forward[1], forward[0])
    body = turn_quaternion(np.array([0.0, 0.0, 1.0]), np.array([heading]))[0]
    turned = []
    for pose in poses:  # axes of the segment are those of the person in the straight posture
        q_ma = quaternion_product(quaternion_conjugate(pose.q_nb[straight]), body)
        turned.append(
            Reference(time=pose.time, q_nb=quaternion_product(pose.q_nb, q_ma), position=pose.position, name=pose.name)
        )
    return turned


def _between(a, b):
    return np.arccos((a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1))


def true_angle(thigh, shank):
    """Return the angle of the shank against the thigh about the axis it turns most about, rad, 0 upright, and that axis."""
    vector = rotation_vector(signed(quaternion_product(quaternion_conjugate(thigh), shank)))
    axis = np.linalg.eigh(vector.T @ vector)[1][:, -1]
    axis = axis if axis[1] > 0.0 else -axis
    return vector @ axis, axis


def record_of(pose, rng, degrees):
    """Return the corrected readings of a calibrated device that is misplaced on a segment, and its true motion."""
    device = undrift.random_device(rng)
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    axis = rng.standard_normal(3)
    q_ab = turn_quaternion(axis / np.linalg.norm(axis), np.radians([degrees]))[0]
    worn = Reference(time=pose.time, q_nb=quaternion_product(pose.q_nb, q_ab), position=pose.position, name=pose.name)
    motion = motion_from_poses(worn, gravity_m_s2=9.80665, sample_rate_hz=RATE, settings=MARKERS)
    known = motion.valid > 0.0
    record = simulate_device(device, motion, rng=rng).record
    return undrift.correct(record.between(motion.time[known][0], motion.time[known][-1]), calibration), motion, q_ab


def mounting_of(q_ab, rng):
    """Return the mounting of a device as posture and walking show it: off by what they leave."""
    error = np.diag(np.radians([0.7, 0.9, 1.5]) ** 2)
    off = quaternion_of(rng.multivariate_normal(np.zeros(3), error))
    return BodyMounting(
        place="thigh", matrix=rotation(quaternion_product(off, q_ab)).as_matrix(), covariance=error, basis="drawn"
    )


def judged(name, side, degrees, seed=1):
    """Return the row of a trial: span, rms error with the axes found and without, stated uncertainty, axis off and stated, deg."""
    rng = np.random.default_rng(seed)
    poses = segments(name, side)
    (upper, motion, q_1), (lower, other, q_2) = (record_of(pose, rng, degrees) for pose in poses)
    fit = fit_hinge(upper, lower, "knee", worn=(mounting_of(q_1, rng), mounting_of(q_2, rng)))
    rows = [np.searchsorted(one.time, fit.time - 1e-6) for one in (motion, other)]
    bones = [
        quaternion_product(one.q_nb[k], quaternion_conjugate(q))
        for one, q, k in ((motion, q_1, rows[0]), (other, q_2, rows[1]))
    ]
    truth, axis = true_angle(*bones)
    pitches = [sagittal_pitch(filtered(one, one.gyro, OFFSET, magnetometer=False)[0]) for one in (upper, lower)]
    plain = pitches[1][: len(truth)] - pitches[0][: len(truth)]
    inner = slice(50, -50)
    errors = [np.degrees(np.sqrt(np.nanmean((one[inner] - truth[inner]) ** 2))) for one in (fit.angle, plain)]
    off = np.degrees(np.arccos(min(1.0, abs(float(rotate(q_2, fit.axes[1]) @ axis)))))
    return Row(
        span=np.degrees(np.ptp(truth)), found=errors[0], plain=errors[1], stated=np.degrees(fit.angle_uncertainty), off=off,
        stated_off=np.degrees(fit.uncertainty), codes=tuple(one.code for one in fit.verdict.findings),
    )  # fmt: skip


if __name__ == "__main__":
    heads = ("trial", "off by", "span", "with axes", "stated", "without", "axis off", "stated")
    print("".join(f"{head:>10}" for head in heads) + "   (deg)")
    for name, side in TRIALS:
        for degrees in (0.0, 20.0):
            row = judged(name, side, degrees)
            figures = (degrees, row.span, row.found, row.stated, row.plain, row.off, row.stated_off)
            print(f"{name + ' ' + side:>10}" + "".join(f"{one:10.2f}" for one in figures), *row.codes)
