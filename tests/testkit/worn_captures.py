"""Captured people with a simulated device at the low back: what is true, what the device reads, what is measured of both.

The course that is true comes from the poses alone: pitch and rates of the spline, the way of the device's origin. The readings are
those of a simulated device, calibrated by a simulated session and worn as stated but for an error drawn from the mounting's
covariance; offsets have drifted since the calibration, as much as is assumed. The same definitions are applied to both, so that the
difference is the instrument's.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import undrift
from testkit.data import data_path
from undrift.correction.rest import TURN_ON
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.io.mocap import Markers, pose_from_cluster, read_trc
from undrift.io.reference import device_on, find_body
from undrift.measures.tasks import TaskName, measure_of
from undrift.measures.uncertainty import GYRO_OFFSET, instrument, take
from undrift.measures.worn import DRIFT_HZ, SMOOTH_HZ, Course, smooth
from undrift.model import BodyMounting
from undrift.record import Reference
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline

SETTINGS = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone
G, RATE_HZ = 9.80665, 100.0
MOUNTING = np.radians(1.0)  # rad, of each axis: what undrift mount states for the low back


def times(spline) -> np.ndarray:
    """Instants of a device's samples."""
    start, stop = spline.span_s
    return start + np.arange(int((stop - start) * RATE_HZ)) / RATE_HZ


@cache
def captured(*parts: str, q_bd=(1.0, 0.0, 0.0, 0.0)) -> PoseSpline:
    """The motion of a device on a captured pelvis."""
    return fit_pose_spline(device_on(find_body(read_trc(data_path(*parts), up="y"), "pelvis"), q_bd=q_bd), SETTINGS)


def captured_leg(markers: Markers, labels: list[str], forward, *, up: str = "", down: str = "") -> Motion:
    """The motion of a device on a segment of a leg by a cluster of markers; its axes by the way ahead and a line of markers, or,
    without one, by its mean posture."""
    pose = pose_from_cluster(markers, labels)
    line = (
        markers.pick([up])[:, 0] - markers.pick([down])[:, 0] if up else np.tile([0.0, 0.0, 1.0], (len(pose.time), 1))
    )
    known = np.isfinite(pose.q_nb).all(axis=1) & np.isfinite(line).all(axis=1)
    back = quaternion_conjugate(pose.q_nb[known])
    z, x = (
        rotate(back, np.broadcast_to(way, (known.sum(), 3))).mean(axis=0) for way in (line[known], np.asarray(forward))
    )
    z = z / np.linalg.norm(z)
    y = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
    q = Rotation.from_matrix(np.stack((np.cross(y, z), y, z), axis=1)).as_quat(scalar_first=True)
    turned = Reference(time=pose.time, q_nb=quaternion_product(pose.q_nb, q), position=pose.position, name=pose.name)
    spline = fit_pose_spline(turned, SETTINGS)
    return spline.at(times(spline), G)


def true_course(motion: Motion) -> Course:
    """The course of the body in a motion, by its poses; axes of the motion's b are the segment's."""
    up = rotate(motion.q_nb, motion.force_b)[:, 2]
    z = rotate(motion.q_nb * [1.0, -1.0, -1.0, -1.0], np.array([0.0, 0.0, 1.0]))
    up = smooth(up - up.mean(), SMOOTH_HZ, RATE_HZ)
    fall = np.concatenate(([0.0], np.cumsum(0.5 * (up[1:] + up[:-1])))) / RATE_HZ
    return Course(
        time=motion.time - motion.time[0],
        pitch=np.arctan2(-z[:, 0], z[:, 2]),
        roll=np.arctan2(z[:, 1], z[:, 2]),
        rate=smooth(motion.rate_b, SMOOTH_HZ, RATE_HZ),
        turning=smooth((motion.rate_b * z).sum(axis=1), SMOOTH_HZ, RATE_HZ),
        up=up,
        velocity=smooth(fall, DRIFT_HZ, RATE_HZ, order=2, kind="highpass"),
        force=motion.force_b,
    )


def worn_device(motion: Motion, seed: int, place: str = "lower-back"):
    """A simulated device in a motion: what is known of it, its calibration and its mounting."""
    rng = np.random.default_rng([21, seed])
    device = random_device(rng)
    model = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    x, y, z = MOUNTING * rng.normal(size=3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    stated = np.linalg.qr(np.eye(3) + cross)
    matrix = stated[0] * np.sign(np.diag(stated[1]))
    worn = BodyMounting(place=place, matrix=matrix, covariance=MOUNTING**2 * np.eye(3), basis="drawn")
    record = undrift.correct(simulate_device(device, motion, rng=rng).record, model)
    shift = GYRO_OFFSET * rng.normal(size=3), TURN_ON * rng.normal(size=3)  # since the calibration of this day
    record = replace(record, gyro=record.gyro + shift[0], accel=record.accel + shift[1])
    return instrument(record, replace(model, mounting=worn), worn, seed=seed)


def errors(
    motion: Motion, task: TaskName, seeds, place: str = "lower-back"
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors and standard uncertainties (D, K) of each measure of a task, by devices D."""
    truth, found = measure_of(task, place)(true_course(motion)).values, {}
    for seed in seeds:
        for one in take(worn_device(motion, seed, place), measure_of(task, place))[1]:
            found.setdefault(one.name, []).append((one.values - truth[one.name], one.uncertainties))
    return {name: tuple(np.stack(part) for part in zip(*rows, strict=True)) for name, rows in found.items()}
