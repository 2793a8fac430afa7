"""Kiel's validation set, on files that are made here after its published description."""

import numpy as np
import pytest
from scipy.io import savemat

from undrift.errors import FileFormatError, InputError
from undrift.io.columns import ReadSettings
from undrift.io.formats import detect, read_markers, read_record
from undrift.io.mocap import pose_from_cluster

PLACES, LABELS = ("pelvis", "sternum"), ("l_psis", "r_psis", "l_asis")


def imu(path, n=400, **changed):
    rng = np.random.default_rng(1)
    acc, gyro = np.zeros((2, n, 3, len(PLACES)))
    acc[:, 2] = 1.0
    gyro[:, 1] = [10.0, 20.0]
    acc += 1e-3 * rng.normal(size=acc.shape)
    data = {"calibration_file": "imu_calibration_1.mat", "acc": acc, "gyro": gyro, "magn": gyro, "fs": 200.0}
    data["imu_location"] = np.array(PLACES, dtype=object)
    savemat(path, {"data": data | changed}, do_compression=True)
    return path


def optics(path, n=400, residual=0.5, **changed):
    points = np.zeros((n, 4, len(LABELS)))
    points[:, :3, :] = np.array([[0.0, 100.0, 0.0], [0.0, 0.0, 80.0], [900.0, 900.0, 905.0]])
    points[:, 3] = residual
    data = {"calibration_file": "omc_calibration_1.mat", "pos": points, "fs": 200.0}
    data["marker_location"] = np.array(LABELS, dtype=object)
    savemat(path, {"data": data | changed}, do_compression=True)
    return path


def test_one_sensor_is_read_by_where_it_is_worn(tmp_path):
    path = imu(tmp_path / "imu_tug.mat")
    assert detect(path) == "kiel_imu"
    with pytest.raises(InputError, match="got a file with pelvis, sternum; name one of them"):
        read_record(path)
    record = read_record(path, settings=ReadSettings(sensor="sternum"))
    assert (record.gyro_unit, record.accel_unit, record.device, len(record)) == ("dps", "g", "sternum", 400)
    np.testing.assert_allclose(record.gyro[:, 1], 20.0)
    np.testing.assert_allclose(np.diff(record.time), 1.0 / 200.0)


def test_markers_are_in_metres_with_z_up_and_a_lost_one_is_a_gap(tmp_path):
    path = optics(tmp_path / "omc_tug.mat", residual=np.where(np.arange(400) < 10, -1.0, 0.5)[:, None])
    assert detect(path) == "kiel_markers"
    markers = read_markers(path)
    assert markers.labels == LABELS
    np.testing.assert_allclose(markers.points[20, :, 2], [0.9, 0.9, 0.905])
    assert np.isnan(markers.points[:10]).all()
    reference = pose_from_cluster(markers, LABELS)
    assert not reference.valid[:10].any()
    assert reference.valid[10:].all()


@pytest.mark.parametrize(
    ("made", "changed", "refused"),
    [
        (imu, {"fs": 0.0}, r"wanted data.fs in Hz above 0, got 0.0; copy the file again"),
        (imu, {"gyro": np.zeros((399, 3, 2))}, r"wanted arrays of one length, got acc 400, gyro 399 rows; copy"),
        (
            imu,
            {"acc": np.zeros((400, 3, 3))},
            r"wanted data.acc with rows, axes and 2 places of imu_location, got shape",
        ),
        (optics, {"pos": np.zeros((400, 2, 3))}, r"wanted data.pos with rows, axes and 3 places of marker_location"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(tmp_path, made, changed, refused):
    path = made(tmp_path / "damaged.mat", **changed)
    with pytest.raises(FileFormatError, match=refused):
        read_markers(path) if made is optics else read_record(path, settings=ReadSettings(sensor="pelvis"))
