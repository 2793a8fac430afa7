"""Records and orientations in the files of undrift and of other programs, each judged by a reader that is not its writer's."""

import re

import numpy as np
import pytest

from undrift.io.formats import read_reference, write_record
from undrift.io.write import write_orientation
from undrift.record import Record


def orientation(n=50, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    angles = tuple(rng.uniform(-np.pi, np.pi, n) for _ in range(3))
    return np.arange(n) / 100.0 + 7.0, q, angles


@pytest.mark.parametrize("name", ["a.parquet", "a.csv", "a.csv.gz", "A.CSV"])
def test_quaternions_come_back_as_a_reference(tmp_path, name):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / name)
    back = read_reference(tmp_path / name)
    np.testing.assert_array_equal(back.time, time)
    # the reader takes the length to one: a rounding error each
    np.testing.assert_allclose(np.sum(back.q_nb * q, axis=1) ** 2, 1.0, atol=1e-14)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_pitch_with_gaps_is_an_empty_or_nan_cell_and_the_poses_still_read(tmp_path):
    time, q, angles = orientation()
    pitch = angles[2].copy()
    pitch[10:20] = np.nan
    write_orientation(time, q, (angles[0], angles[1], pitch), tmp_path / "a.csv")
    cells = [line.split(",")[-1] for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert all(cell in ("", "nan") for cell in cells[10:20])
    assert read_reference(tmp_path / "a.csv").valid.all()


# ---- other programs


def recording(n=40, *, gaps=False):
    rng = np.random.default_rng(5)
    gyro = rng.normal(size=(n, 3))
    if gaps:
        gyro[3:6, 1] = np.nan
    return Record(
        time=np.arange(n) / 50.0 + 3.0,
        gyro=gyro,
        accel=rng.normal(size=(n, 3)),
        mag_ut=rng.normal(size=(n, 3)),
        temp_c=np.full(n, 25.0),
        frame="b",
        state="corrected",
        device="MTi-1",
    )


def test_opensense_gets_a_header_a_named_column_and_quaternions_scalar_first(tmp_path):
    """The header and the cells as in the example of "OpenSense - Kinematics with IMU Data", OpenSim documentation, read 2026-11."""
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / "o.sto", body="pelvis")
    head, _, body = (tmp_path / "o.sto").read_text().partition("endheader\n")
    keys = dict(line.split("=") for line in head.splitlines())
    assert float(keys["DataRate"]) == 100.0  # Hz
    assert (keys["DataType"], keys["version"]) == ("Quaternion", "3")
    names, *rows = body.splitlines()
    assert names == "time\tpelvis_imu"
    table = np.array([[float(cell) for cell in re.split("[\t,]", row)] for row in rows])
    np.testing.assert_allclose(table[:, 0], time, rtol=1e-8)  # nine digits are written
    np.testing.assert_allclose(table[:, 1:], q, atol=1e-11)  # twelve digits are written


def test_a_file_has_the_mode_that_the_umask_gives_and_keeps_its_own(tmp_path):
    import os

    time, q, angles = orientation()
    before = os.umask(0o077)
    try:
        for name in ("a.csv", "a.parquet"):
            write_orientation(time, q, angles, tmp_path / name)
        write_record(recording(), tmp_path / "r.parquet")
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in tmp_path.glob("*.*")} == {0o600}
    (tmp_path / "a.csv").chmod(0o640)
    write_orientation(time, q, angles, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").stat().st_mode & 0o777 == 0o640
