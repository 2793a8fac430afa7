"""Gyroscopes that were fitted to turns of their own, held to the accelerometer's gravity."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.calibrate import calibrate
from undrift.calibration.known_rotation import check_turns_gravity
from undrift.errors import Implausible
from undrift.model import TriadModel
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.sessions import simulate_session

MOTION = bench_motion(
    "multi_position", rng=np.random.default_rng(5), settings=BenchSettings(poses=10, first_still_s=5.0)
)
RECORD = Record(time=MOTION.time, accel=MOTION.force_b, gyro=MOTION.mean_rate_b)


def triad(unit_out, matrix):
    return TriadModel(
        method="rate-table/affine" if unit_out == "rad/s" else "six-face/affine",
        unit_in=unit_out,
        unit_out=unit_out,
        matrix=matrix,
        offset=np.zeros(3),
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=12,
        rank=12,
        condition=1.0,
        valid_range=(-10.0, 10.0),
    )


def checked(gyro=None, accel=None, stills=MOTION.stills):
    """The fits believe in their columns; the columns are in another order."""
    record = replace(
        RECORD,
        gyro=RECORD.gyro if gyro is None else RECORD.gyro[:, gyro],
        accel=RECORD.accel if accel is None else RECORD.accel[:, accel],
    )
    check_turns_gravity((record,), stills, triad("m/s2", np.eye(3)), triad("rad/s", 1.02 * np.eye(3)))


def test_axes_that_agree_pass_and_so_do_too_few_moves():
    checked()
    checked(gyro=[1, 0, 2], stills=MOTION.stills[:3])


@pytest.mark.parametrize(
    ("order", "cause"),
    [
        ({"gyro": [1, 0, 2]}, r"\+y, \+x, \+z of the accelerometer: gyroscope columns x and y are exchanged"),
        ({"gyro": [1, 2, 0]}, r"\+y, \+z, \+x of the accelerometer: columns x, y and z are exchanged in a ring"),
        ({"accel": [1, 2, 0]}, r"\+z, \+x, \+y of the accelerometer: columns x, y and z are exchanged in a ring"),
        ({"accel": [1, 0, 2]}, r"-y, -x, -z of the accelerometer: accelerometer columns x and y are exchanged"),
    ],
)
def test_exchanged_columns_miss_gravity_and_are_named(order, cause):
    with pytest.raises(Implausible, match=cause) as caught:
        checked(**order)
    assert caught.value.miss_deg > 30.0


def test_gyroscopes_that_no_order_explains_are_left_to_other_checks():
    noise = np.random.default_rng(3).normal(size=RECORD.gyro.shape)
    record = replace(RECORD, gyro=noise)
    check_turns_gravity((record,), MOTION.stills, triad("m/s2", np.eye(3)), triad("rad/s", np.eye(3)))


@pytest.mark.parametrize("order", [[1, 0, 2], [1, 2, 0]])
def test_a_session_by_known_angles_with_its_turns_named_after_the_columns_is_refused(order):
    device = random_device(np.random.default_rng(21), grade="consumer")
    session = simulate_session("ferraris", device, rng=np.random.default_rng(22), labelled=True, temp_c=25.0)
    assert calibrate(session).gyro.method == "known-rotation/affine"
    record = session.records[0]
    moved = {"xyz"[axis]: "xyz"[column] for column, axis in enumerate(order)}
    wrong = replace(
        session,
        records=(replace(record, gyro=record.gyro[:, order]),),
        turns=tuple(replace(turn, axis=moved[turn.axis]) for turn in session.turns),
    )
    with pytest.raises(Implausible, match="wanted gyroscopes that turn gravity from rest to rest"):
        calibrate(wrong)
