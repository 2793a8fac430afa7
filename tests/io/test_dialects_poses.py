"""Poses and markers in text: OpenSim and Xsens on their real files."""

import numpy as np
import pytest

from testkit.column_maps import reference_map
from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.frames import rotate
from undrift.io.column_map import TextLayout
from undrift.io.formats import read_record, read_reference
from undrift.io.inspect import describe
from undrift.io.reference import read_reference_map

STO = ("makers", "opensim_sto_mot", "myComplexTasksTrial_orientations.sto")
IMUS = "pelvis_imu, tibia_r_imu, femur_r_imu, tibia_l_imu, femur_l_imu, calcn_l_imu, calcn_r_imu"


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


# ---- makers' tables


def test_quaternions_of_a_maker_are_read_with_the_map_that_info_proposes(tmp_path):
    path = data_path("makers", "xsens_dot", "LFemur_20210820_202113_831.csv")
    proposed = describe(path)
    assert (proposed.kind, "orientations" in proposed.summary) == ("table", True)
    (tmp_path / "map.toml").write_text(proposed.proposal.text(proposed.path))
    poses = read_reference(path, read_reference_map(tmp_path / "map.toml"))
    assert len(poses) == 195
    assert poses.time[-1] == pytest.approx(351 / 60.0)  # the counter shows the 157 of 352 packets that were lost


def test_quaternions_beside_readings_of_a_maker_are_read_with_a_map():
    path = data_path("makers", "xsens_mtmanager", "skin_data_xsens.txt")
    layout = TextLayout(delimiter="\t", skip_rows=5, header=False)  # rows end with a tab that the header lacks
    poses = read_reference(path, reference_map(quaternion=(10, 11, 12, 13), sample_rate_hz=50.0, layout=layout))
    level = rotate(poses.q_nb, read_record(path).accel).mean(axis=0)
    np.testing.assert_allclose(level, [-0.06, -0.03, 9.75], atol=0.006)  # SOURCE.md
