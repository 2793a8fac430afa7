"""BROAD trials read whole, gaps kept, and anything else is refused in one line."""

import h5py
import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.errors import FileFormatError, InputError
from undrift.io.mocap import read_broad


def write_trial(path, n=20, *, rate=100.0, leave_out=(), change=None):
    rng = np.random.default_rng(1)
    quat = rng.normal(size=(n, 4))
    arrays = {
        "imu_gyr": rng.normal(size=(n, 3)),
        "imu_acc": rng.normal(size=(n, 3)),
        "imu_mag": rng.normal(size=(n, 3)),
        "opt_quat": quat / np.linalg.norm(quat, axis=1)[:, None],
        "opt_pos": rng.normal(size=(n, 3)),
        "movement": np.arange(n) > n // 2,
    } | (change or {})
    with h5py.File(path, "w") as handle:
        for name, values in arrays.items():
            if name not in leave_out:
                handle[name] = values
        if rate is not None:
            handle.attrs["sampling_rate"] = rate
    return arrays


def test_a_trial_reads_to_its_published_length_rate_and_gaps():
    # SOURCE.md of the trials: 285.714 Hz, NaN where the optics lost the body, gaps up to 12.6 s.
    record, reference = read_broad(data_path("broad", "02_undisturbed_slow_rotation_B.hdf5"))
    show("rows", len(record), 53240)
    show("rate Hz", record.sample_rate_hz, 285.714)
    show("valid optics %", 100 * reference.valid.mean())
    assert len(record) == len(reference) == 53240
    assert record.sample_rate_hz == pytest.approx(285.7142857, abs=1e-6)
    assert (record.time == reference.time).all()
    assert record.gyro_unit == "rad/s"
    assert record.accel_unit == "m/s2"
    rest = record.between(0.0, 20.0)
    assert np.linalg.norm(rest.accel.mean(axis=0)) == pytest.approx(9.81, abs=0.1)
    assert 0.5 < reference.valid.mean() <= 1.0
    assert reference.moving[0] == 0.0
    assert 0.3 < reference.moving.mean() < 0.95


def test_what_was_written_comes_back(tmp_path):
    wrote = write_trial(tmp_path / "t.hdf5", rate=250.0)
    record, reference = read_broad(tmp_path / "t.hdf5")
    np.testing.assert_array_equal(record.gyro, wrote["imu_gyr"])
    np.testing.assert_array_equal(record.accel, wrote["imu_acc"])
    np.testing.assert_array_equal(record.mag_ut, wrote["imu_mag"])
    np.testing.assert_allclose(reference.q_nb, wrote["opt_quat"], atol=1e-15)
    np.testing.assert_array_equal(reference.position, wrote["opt_pos"])
    np.testing.assert_array_equal(reference.moving, wrote["movement"])
    assert record.sample_rate_hz == pytest.approx(250.0)


def test_a_half_lost_quaternion_is_a_whole_gap(tmp_path):
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    quat[3, 2] = np.nan
    write_trial(tmp_path / "t.hdf5", change={"opt_quat": quat})
    _, reference = read_broad(tmp_path / "t.hdf5")
    assert np.flatnonzero(~reference.valid).tolist() == [3]
    assert np.isnan(reference.q_nb[3]).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rate": None}, "sampling_rate"),
        ({"rate": -1.0}, "above 0"),
        ({"leave_out": ("opt_quat",)}, "wanted dataset opt_quat, got imu_acc"),
        ({"change": {"imu_acc": np.zeros((3, 20))}}, r"wanted shape \(N, 3\), got \(3, 20\)"),
        ({"change": {"imu_gyr": np.bytes_(b"text")}}, "wanted readable numbers"),
    ],
)
def test_a_file_that_is_not_a_trial_is_refused_in_one_line(tmp_path, changes, words):
    write_trial(tmp_path / "t.hdf5", **changes)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_broad(tmp_path / "t.hdf5")
    assert "\n" not in str(caught.value)


def test_a_missing_file_a_folder_and_a_text_file_are_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="nothing of that name"):
        read_broad(tmp_path / "none.hdf5")
    with pytest.raises(InputError, match="got a directory"):
        read_broad(tmp_path)
    (tmp_path / "t.hdf5").write_text("not hdf5")
    with pytest.raises(FileFormatError, match="wanted an HDF5 file"):
        read_broad(tmp_path / "t.hdf5")
    (tmp_path / "e.hdf5").write_text("")
    with pytest.raises(FileFormatError, match="empty file"):
        read_broad(tmp_path / "e.hdf5")
