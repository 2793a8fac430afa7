"""npz and mat: arrays by name, (N, 3) or column by column; other lengths and damaged files are refused."""

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given

from testkit.strategies import assert_same, few, one_line, records
from undrift.errors import FileFormatError, InputError
from undrift.io.arrays import mat_arrays, npz_arrays, read_mat, read_npz
from undrift.io.columns import ColumnMap, ReadSettings, native_columns

MAP = ColumnMap(time="t", time_unit="s", gyro=("w",), gyro_unit="rad/s", accel=("a",), accel_unit="m/s2")


def arrays(n=12):
    rng = np.random.default_rng(5)
    return {"t": np.arange(n) / 50, "w": rng.normal(size=(n, 3)), "a": rng.normal(size=(n, 3)), "fs": np.array(50)}


@pytest.mark.slow
@few
@given(record=records(gaps=True, plain=True))
def test_native_names_come_back_to_the_last_bit_from_npz(tmp_path_factory, record):
    path = tmp_path_factory.mktemp("npz") / "r.npz"
    np.savez(path, **dict(zip(*native_columns(record), strict=True)))
    assert_same(read_npz(path, settings=ReadSettings(gaps="keep")).record, record)


@few
@given(record=records(gaps=True, plain=True))
def test_native_names_come_back_to_the_last_bit_from_mat(tmp_path_factory, record):
    path = tmp_path_factory.mktemp("mat") / "r.mat"
    scipy.io.savemat(path, dict(zip(*native_columns(record), strict=True)))
    assert_same(read_mat(path, settings=ReadSettings(gaps="keep")).record, record)


def test_an_array_of_three_columns_is_one_name(tmp_path):
    held = arrays()
    np.savez(tmp_path / "r.npz", **held)
    record = read_npz(tmp_path / "r.npz", MAP).record
    np.testing.assert_array_equal(record.gyro, held["w"])
    swapped = ColumnMap(time="t", time_unit="s", gyro=("w[2]", "w[0]", "w[1]"), gyro_unit="rad/s")
    np.testing.assert_array_equal(read_npz(tmp_path / "r.npz", swapped).record.gyro, held["w"][:, [2, 0, 1]])


def test_a_struct_of_mat_5_is_laid_flat(tmp_path):
    held = arrays()
    scipy.io.savemat(tmp_path / "r.mat", {"imu": {"t": held["t"], "w": held["w"]}, "note": "text"})
    record = read_mat(
        tmp_path / "r.mat", ColumnMap(time="imu.t", time_unit="s", gyro=("imu.w",), gyro_unit="rad/s")
    ).record
    np.testing.assert_array_equal(record.gyro, held["w"])
    np.testing.assert_array_equal(record.time, held["t"])


def test_mat_7_3_reads_as_mat_5(tmp_path):
    # MATLAB writes 7.3 as HDF5 behind a 512-byte block, arrays transposed, the class beside each.
    held = arrays()
    path = tmp_path / "r.mat"
    with h5py.File(path, "w", userblock_size=512) as handle:
        for name in ("t", "w", "a"):
            handle[name] = np.atleast_2d(held[name]) if held[name].ndim == 1 else held[name].T
            handle[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    record = read_mat(path, MAP).record
    np.testing.assert_array_equal(record.gyro, held["w"])
    np.testing.assert_array_equal(record.accel, held["a"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"w": np.zeros((5, 3))}, "wanted arrays of one length, got t 12, w 5, a 12 rows; two clocks need two records"),
        ({"w": np.zeros((3, 12))}, "wanted arrays of one length, got t 12, w 3, a 12"),
        ({"w": np.zeros((12, 4))}, r"wanted an array 'w' of shape \(N, 3\)"),
        ({"w": np.full((12, 3), np.nan)}, r"column 'w\[0\]': .* got 12 empty or NaN"),
        ({"w": np.full((12, 3), 1e9)}, "wanted readings up to 500 rad/s, got 1e\\+09"),
        ({"t": np.array(["a"] * 12)}, "column 't': wanted numbers, got 'a'"),
        ({"t": np.zeros(12)}, "11 steps back or doubled"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_in_one_line(tmp_path, change, words):
    np.savez(tmp_path / "r.npz", **{**arrays(), **change})
    with pytest.raises(InputError, match=words) as caught:
        read_npz(tmp_path / "r.npz", MAP)
    one_line(caught)


def test_an_array_that_is_not_there_lists_those_that_are(tmp_path):
    np.savez(tmp_path / "r.npz", t=np.arange(3.0))
    with pytest.raises(InputError, match=r"wanted array 'w', got t \(3,\)"):
        read_npz(tmp_path / "r.npz", MAP)
    with pytest.raises(InputError, match=r"r.npz: columns: wanted names such as"):
        read_npz(tmp_path / "r.npz")


def test_files_that_are_no_arrays_are_refused(tmp_path):
    np.save(tmp_path / "one.npy", np.arange(3.0))
    with pytest.raises(FileFormatError, match="got a single array"):
        npz_arrays(tmp_path / "one.npy")
    np.savez(tmp_path / "o.npz", a=np.array([{"k": 1}], dtype=object))
    with pytest.raises(FileFormatError, match="wanted a sound npz file of plain arrays"):
        npz_arrays(tmp_path / "o.npz")
    np.savez(tmp_path / "r.npz", **arrays())
    (tmp_path / "cut.npz").write_bytes((tmp_path / "r.npz").read_bytes()[:-200])
    with pytest.raises(FileFormatError, match="wanted a sound npz file"):
        npz_arrays(tmp_path / "cut.npz")
    (tmp_path / "r.mat").write_text("x,y\n1,2\n")
    with pytest.raises(FileFormatError, match="wanted a MAT file") as caught:
        mat_arrays(tmp_path / "r.mat")
    one_line(caught)
