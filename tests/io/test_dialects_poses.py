"""Poses and markers in text: OpenSim and Xsens on their real files."""

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.frames import rotate
from undrift.io.column_map import ColumnMap
from undrift.io.formats import read_record, read_reference
from undrift.io.inspect import describe
from undrift.io.reference import ReferenceMap

STO = ("makers", "opensim_sto_mot", "myComplexTasksTrial_orientations.sto")
IMUS = "pelvis_imu, tibia_r_imu, femur_r_imu, tibia_l_imu, femur_l_imu, calcn_l_imu, calcn_r_imu"


def put(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return tmp_path / name


# ---- OpenSim


def test_one_sensor_of_an_opensense_table_is_a_reference():
    path = data_path(*STO)
    poses = read_reference(path, labels=["femur_r_imu"])
    assert (len(poses), poses.sample_rate_hz, poses.name) == (6, pytest.approx(100.0), f"{path.name} femur_r_imu")
    np.testing.assert_allclose(
        poses.q_nb[0], [0.5452838971693046, 0.6582951337533763, 0.3496155891730705, 0.3835126180083864]
    )
    np.testing.assert_allclose(poses.time, 0.01 * np.arange(6))
    found = describe(path)
    assert (found.kind, found.columns, found.rows) == ("reference", tuple(IMUS.split(", ")), 6)
    assert "of each of 7 bodies" in found.summary


def test_a_laboratory_with_y_up_is_turned_level():
    path = data_path(*STO)
    z_up, y_up = (read_reference(path, labels=["pelvis_imu"], up=up) for up in ("z", "y"))
    np.testing.assert_allclose(
        rotate(y_up.q_nb, np.eye(3)[0]), rotate(z_up.q_nb, np.eye(3)[0])[:, [0, 2, 1]] * [1, -1, 1]
    )


def test_an_opensense_table_wants_the_name_of_one_sensor():
    with pytest.raises(InputError, match=rf"expected the name of one body, got none. The file contains {IMUS}"):
        read_reference(data_path(*STO))
    with pytest.raises(InputError, match="expected the name of one body, got 'torso'"):
        read_reference(data_path(*STO), labels=["torso"])
    with pytest.raises(InputError, match="expected the name of one body, got a, b"):
        read_reference(data_path(*STO), labels=["a", "b"])
    with pytest.raises(FileFormatError, match="expected a recording, got orientations"):
        read_record(data_path(*STO))


@pytest.mark.parametrize("name", ["std_subject01_walk1_ik.mot", "gait10dof18musc_ik_CRLF_line_ending.mot"])
def test_coordinates_of_a_model_are_named_for_what_they_are(name):
    path = data_path("makers", "opensim_sto_mot", name)
    with pytest.raises(FileFormatError, match="got an OpenSim table of coordinates or forces of a model"):
        read_record(path)
    assert describe(path).kind == "text"
    assert "undrift validate is the .sto file of orientations" in describe(path).summary


HEAD = "DataRate=100\nDataType=Quaternion\nversion=3\nendheader\n"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("Frame\ta\n0\t1,0,0,0\n1\t1,0,0,0\n", "expected 'time' and sensor names after endheader, got b'Frame"),
        ("time\ta\n0\t1,0,0,0\n", "expected two frames or more, got 1. The file is truncated"),
        ("time\ta\n", "expected two frames or more, got 0. The file is truncated"),
        ("time\ta\n0\t1,1,1,1\n1\t1,1,1,1\n", "expected unit quaternions, got length 2. Check the export"),
        ("time\ta\n1\t1,0,0,0\n0\t1,0,0,0\n", "strictly increasing seconds"),
    ],
)
def test_damaged_opensense_tables_are_named(tmp_path, rows, words):
    with pytest.raises(InputError, match=words):
        read_reference(put(tmp_path, "a.sto", HEAD + rows))


# ---- Xsens


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("skin_data_xsens.txt", [-0.06, -0.03, 9.75]),  # SOURCE.md, quaternion
        ("MT46_01-000_00B42D4D.txt", [0.09, 0.0, 9.81]),
        ("MT2022_ACC_GYRO_ROT_EULER_TAB_00B42D4F.txt", [-0.03, -0.1, 9.99]),  # roll, pitch, yaw
        ("MT_01200454_000-000_00B40DE4.txt", [0.34, -1.35, 9.89]),  # matrix, in motion
    ],
)
def test_gravity_points_up_through_the_orientations_of_xsens(name, level):
    path = data_path("makers", "xsens_mtmanager", name)
    poses = read_reference(path, ReferenceMap(sample_rate_hz=100.0))
    record = read_record(path, ColumnMap(sample_rate_hz=100.0))
    np.testing.assert_allclose(rotate(poses.q_nb, record.accel).mean(axis=0), level, atol=0.006)


def test_xsens_orientations_without_a_rate_or_without_angles_are_refused(tmp_path):
    with pytest.raises(InputError, match="sample rate is missing"):
        read_reference(data_path("makers", "xsens_mtmanager", "MT_01200454_000-000_00B40DE4.txt"))
    text = (
        "// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\n" + "1\t0\t0\t9.8\n2\t0\t0\t9.8\n3\t0\t0\t9.8\n"
    )
    with pytest.raises(FileFormatError, match="expected columns of orientations, got none"):
        read_reference(put(tmp_path, "m.txt", text))
