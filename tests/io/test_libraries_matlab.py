"""MATLAB files: time along the columns, and BROAD trials as MATLAB saves them."""

import numpy as np
from scipy.io import savemat

import undrift
from testkit.column_maps import column_map

MAP = column_map(gyro=("w",), gyro_unit="dps", accel=("a",), accel_unit="g", time="t", time_unit="s")


def test_arrays_with_time_along_their_columns_are_turned(tmp_path):
    rng = np.random.default_rng(4)
    w, a, t = rng.normal(size=(3, 50)), rng.normal(size=(3, 50)), np.arange(50)[None] / 10
    savemat(tmp_path / "a.mat", {"w": w, "a": a, "t": t})
    record = undrift.read_record(tmp_path / "a.mat", MAP)
    np.testing.assert_array_equal(record.gyro, w.T)
    np.testing.assert_array_equal(record.accel, a.T)


def test_poses_with_time_along_their_columns_are_turned(tmp_path):
    q = np.tile([[1.0], [0.0], [0.0], [0.0]], 40)
    names = dict(zip(("q_w", "q_x", "q_y", "q_z"), q, strict=True))
    savemat(tmp_path / "a.mat", {"time_s": np.arange(40)[None] / 10, **names})
    assert len(undrift.read_reference(tmp_path / "a.mat")) == 40


def same(path, like):
    record, wanted = undrift.read_record(path), undrift.read_record(like)
    for name in ("time", "gyro", "accel", "mag_ut"):
        np.testing.assert_array_equal(getattr(record, name), getattr(wanted, name))
    seen, truth = undrift.read_reference(path), undrift.read_reference(like)
    np.testing.assert_array_equal(seen.q_nb, truth.q_nb)
    np.testing.assert_array_equal(seen.position, truth.position)
    np.testing.assert_array_equal(seen.moving, truth.moving)
