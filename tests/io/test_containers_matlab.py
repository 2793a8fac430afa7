"""MATLAB files: time along the columns, and BROAD trials as MATLAB saves them."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import undrift
from testkit.data import data_path
from undrift.errors import FileFormatError
from undrift.io.columns import ColumnMap
from undrift.io.formats import detect

MAP = ColumnMap(gyro=("w",), gyro_unit="dps", accel=("a",), accel_unit="g", time="t", time_unit="s")


def test_arrays_with_time_along_their_columns_are_turned(tmp_path):
    rng = np.random.default_rng(4)
    w, a, t = rng.normal(size=(3, 50)), rng.normal(size=(3, 50)), np.arange(50)[None] / 10
    savemat(tmp_path / "a.mat", {"w": w, "a": a, "t": t})
    np.savez(tmp_path / "a.npz", w=w, a=a.T, t=t[0])
    for name in ("a.mat", "a.npz"):
        record = undrift.read_record(tmp_path / name, MAP)
        np.testing.assert_array_equal(record.gyro, w.T)
        np.testing.assert_array_equal(record.accel, a.T)


def test_poses_with_time_along_their_columns_are_turned(tmp_path):
    q = np.tile([[1.0], [0.0], [0.0], [0.0]], 40)
    names = dict(zip(("q_w", "q_x", "q_y", "q_z"), q, strict=True))
    savemat(tmp_path / "a.mat", {"time_s": np.arange(40)[None] / 10, **names})
    assert len(undrift.read_reference(tmp_path / "a.mat")) == 40


BROAD = ("broad", "03_undisturbed_slow_rotation_C.hdf5")


@pytest.fixture(scope="module")
def trial():
    path = data_path(*BROAD)
    with h5py.File(path) as held:
        arrays = {name: held[name][()] for name in held}
        return path, arrays, float(held.attrs["sampling_rate"])


def same(path, like):
    record, wanted = undrift.read_record(path), undrift.read_record(like)
    for name in ("time", "gyro", "accel", "mag_ut"):
        np.testing.assert_array_equal(getattr(record, name), getattr(wanted, name))
    seen, truth = undrift.read_reference(path), undrift.read_reference(like)
    np.testing.assert_array_equal(seen.q_nb, truth.q_nb)
    np.testing.assert_array_equal(seen.position, truth.position)
    np.testing.assert_array_equal(seen.moving, truth.moving)


def test_a_broad_trial_in_a_matlab_file_reads_as_its_hdf5_does_optics_too(tmp_path, trial):
    path, arrays, rate = trial
    savemat(tmp_path / "a.mat", {**arrays, "sampling_rate": rate}, do_compression=True)
    assert detect(tmp_path / "a.mat") == "broad"
    same(tmp_path / "a.mat", path)


@pytest.mark.slow
def test_a_broad_trial_in_matlab_7_3_is_turned_back(tmp_path, trial):
    path, arrays, rate = trial
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as held:
        for name, values in {**arrays, "sampling_rate": np.array([[rate]])}.items():
            held.create_dataset(name, data=np.atleast_2d(values).T if values.ndim == 2 else values[None])
            held[name].attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    same(tmp_path / "a.mat", path)


def test_a_broad_file_without_its_rate_or_optics_is_refused(tmp_path, trial):
    _, arrays, rate = trial
    savemat(tmp_path / "a.mat", arrays)
    with pytest.raises(FileFormatError, match=r"wanted sampling_rate, got none; this is not a BROAD trial"):
        undrift.read_record(tmp_path / "a.mat")
    savemat(tmp_path / "b.mat", {**{k: v for k, v in arrays.items() if k != "opt_pos"}, "sampling_rate": rate})
    with pytest.raises(FileFormatError, match=r"wanted opt_pos, got none; this is not a BROAD trial"):
        undrift.read_record(tmp_path / "b.mat")
