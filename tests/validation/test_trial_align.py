"""Mounting of the device on the reference's body."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.hand_turns import Device, make_recording
from undrift.errors import AlignmentError
from undrift.record import Record, Reference
from undrift.validation.align import Mounting, rotation_by_rates

pytestmark = pytest.mark.usefixtures("computed_once")


def test_any_mounting_is_found():
    mounting = Rotation.from_rotvec((1.1, -0.9, 1.9))
    device = Device(offset=np.array([0.01, 0.02, -0.01]), lag_s=0.003, noise=1e-3)
    record, reference = make_recording(
        np.random.default_rng(1), device, turn_s=30.0, mounting=mounting, optics_noise=3e-4
    )
    found = Mounting(rotation=rotation_by_rates(record, reference, lag_s=0.003), applied=False)
    assert (mounting.inv() * Rotation.from_matrix(found.rotation)).magnitude() < 1e-3
    assert found.angle == pytest.approx(mounting.magnitude(), abs=1e-3)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_one_axis_of_turning_does_not_tell_a_mounting():
    t = np.arange(0.0, 30.0, 0.01)
    angle = np.sin(t)
    q = Rotation.from_rotvec(angle[:, None] * (0.0, 1.0, 0.0)).as_quat(scalar_first=True)
    record = Record(time=t, gyro=np.cos(t)[:, None] * np.array([0.0, 1.0, 0.0]))
    with pytest.raises(AlignmentError, match="about one axis only"):
        rotation_by_rates(record, Reference(time=t, q_nb=q), lag_s=0.0)


def test_a_reversed_axis_is_a_reflection():
    record, reference = make_recording(np.random.default_rng(2), turn_s=20.0)
    mirrored = replace(record, gyro=record.gyro * np.array([1.0, 1.0, -1.0]))
    with pytest.raises(AlignmentError, match="is a reflection"):
        rotation_by_rates(mirrored, reference, lag_s=0.0)
