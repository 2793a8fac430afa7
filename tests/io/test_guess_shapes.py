"""Shapes of tables that are read, or asked about in one question."""

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from testkit.column_maps import column_map, reference_map
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import read_map
from undrift.io.formats import read_counted, read_reference
from undrift.io.inspect import describe

N = 300
RNG = np.random.default_rng(1)
TIME = np.arange(N) / 100.0
ACCEL = RNG.normal([0.0, 0.0, 9.8], 0.02, (N, 3))
GYRO = RNG.normal(0.0, 20.0, (N, 3))
ROWS = np.column_stack((TIME, ACCEL, GYRO))


def read_as_proposed(path):
    """Return what is read by the map that info proposes."""
    where = path.with_name("map.toml")
    where.write_text(describe(path).proposal.text("a", units={"gyro": "dps"}))
    return read_counted(path, read_map(where))


@pytest.mark.parametrize("end", [";;;;;;;\n", "\n \n", " ; ;;;;;;\n\n"])
@pytest.mark.parametrize("header", ["t;ax;ay;az;gx;gy;gz", "t;ax;ay;az;gx;gy;gz;"])
def test_rows_end_with_a_separator_and_the_last_is_blank(tmp_path, header, end):
    rows = "".join(";".join(f"{x:.3f}" for x in row) + ";\n" for row in ROWS)
    (tmp_path / "a.csv").write_text(f"{header}\n{rows}{end}")
    read = read_as_proposed(tmp_path / "a.csv")
    assert (len(read.record), read.dropped_rows) == (N, 0)
    np.testing.assert_allclose(read.record.accel, ACCEL, atol=6e-4)


def test_one_of_two_sensors_is_taken_and_the_other_is_named(tmp_path):
    names = "t," + ",".join(f"{kind}{axis}{k}" for k in (1, 2) for kind in "ag" for axis in "xyz")
    np.savetxt(tmp_path / "a.csv", np.column_stack((ROWS, ROWS[:, 1:])), "%.4f", ",", header=names, comments="")
    found = describe(tmp_path / "a.csv")
    assert found.example[0].endswith("# one sensor; not used: ax2, gx2")
    record = read_as_proposed(tmp_path / "a.csv").record
    np.testing.assert_allclose(record.gyro, GYRO, atol=1e-4)


@pytest.mark.parametrize("arrays", [{"imu": ROWS[:, 1:].T, "t": TIME}, {"imu": ROWS}], ids=["six rows", "time and six"])
def test_an_array_holds_accelerometers_and_gyroscopes(tmp_path, arrays):
    savemat(tmp_path / "a.mat", arrays)
    record = read_as_proposed(tmp_path / "a.mat").record
    np.testing.assert_array_equal(record.accel, ACCEL)
    np.testing.assert_array_equal(record.gyro, GYRO)


@pytest.mark.parametrize(("row", "stamp", "count"), [(100, TIME[99], N), (100, TIME[50], N - 49)])
def test_a_map_of_stamps_that_repeat_or_step_back_is_read(tmp_path, row, stamp, count):
    time = TIME.copy()
    time[row] = stamp
    time[row + 1 :] -= TIME[row] - stamp - (stamp < TIME[99]) * 0.01
    savemat(tmp_path / "a.mat", {"all_time": time, "acc": ACCEL, "gyr": GYRO})
    assert len(read_as_proposed(tmp_path / "a.mat").record) == count


def test_names_that_repeat_are_not_proposed(tmp_path):
    (tmp_path / "a.csv").write_text("X,Y,Z,X,Y,Z\n" + "1,2,3,4,5,6\n" * 9)
    assert "needs a map by positions" in describe(tmp_path / "a.csv").summary


def test_rotation_matrices_are_a_reference(tmp_path):
    truth = Rotation.random(N, random_state=1)
    savemat(tmp_path / "r.mat", {"R": np.moveaxis(truth.as_matrix(), 0, 2), "t": TIME})
    keys = {"time": "t", "time_unit": "s", "matrix": "R"}
    found = read_reference(tmp_path / "r.mat", reference_map(**keys))
    assert np.abs((Rotation.from_quat(found.q_nb, scalar_first=True) * truth.inv()).magnitude()).max() < 1e-12
    savemat(tmp_path / "r.mat", {"R": 1.1 * np.moveaxis(truth.as_matrix(), 0, 2), "t": TIME})
    with pytest.raises(FileFormatError, match="not rotation matrices"):
        read_reference(tmp_path / "r.mat", reference_map(**keys))


def test_the_angle_of_an_encoder_is_a_reference_about_its_axis(tmp_path):
    angle_deg = 30.0 * np.sin(TIME)
    np.savetxt(tmp_path / "e.csv", np.column_stack((TIME, angle_deg)), "%.9f", ",", header="t,angle", comments="")
    keys = {"time": "t", "time_unit": "s", "angle": "angle"}
    found = read_reference(tmp_path / "e.csv", reference_map(**keys, angle_unit="deg", axis=(0.0, 2.0, 0.0)))
    half = np.radians(angle_deg) / 2.0
    np.testing.assert_allclose(found.q_nb, np.column_stack((np.cos(half), 0 * half, np.sin(half), 0 * half)), atol=1e-9)
    for wrong, words in (({}, "axis"), ({"axis": (0.0, 0.0, 1.0)}, "units.angle")):
        with pytest.raises(InputError, match=words):
            read_reference(tmp_path / "e.csv", reference_map(**keys, **wrong))


def test_stamps_of_a_host_are_made_regular_in_a_reference(tmp_path):
    late = TIME + np.abs(np.random.default_rng(2).normal(0.0, 0.002, N))
    stamps = np.maximum.accumulate(late)
    table = np.column_stack((stamps, np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))))
    np.savetxt(tmp_path / "q.csv", table, "%.6f", ",", header="t,w,x,y,z", comments="")
    keys = {"time": "t", "time_unit": "s", "quaternion": ("w", "x", "y", "z")}
    steps = np.diff(read_reference(tmp_path / "q.csv", reference_map(**keys, clock="regular")).time)
    np.testing.assert_allclose(steps, 0.01, atol=2e-5)


def test_a_map_of_several_files_is_refused_for_one(tmp_path):
    one = column_map(time="t", time_unit="s", accel=("ax", "ay", "az"), accel_unit="m/s2")
    with pytest.raises(InputError, match="2 files"):
        read_counted(tmp_path / "a.csv", one.but(columns=[one.columns, one.columns]))
