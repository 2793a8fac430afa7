"""The export of a phone: a file for each sensor, in a folder or a zip."""

import zipfile

import numpy as np
import pytest

from undrift.errors import FileFormatError
from undrift.io.formats import detect, read_counted, read_record
from undrift.io.inspect import describe
from undrift.io.phone import UNKNOWN_SIGN
from undrift.io.session import session_from_files

OFF, ON = "ios,1.36,{},false,17.5", "iOS,1.36,{},true,17.5"  # "Standardise Units & Frames"


METADATA = "platform,appVersion,sensors,standardisation,platform version\n"


@pytest.mark.parametrize(
    ("name", "row", "stated", "unit", "sign"),
    [
        ("TotalAcceleration.csv", "9.8,0.1,0.2", "", "m/s2", 1.0),
        ("TotalAcceleration.csv", "9.8,0.1,0.2", "android,1.36,{},false,14", "m/s2", 1.0),
        ("TotalAcceleration.csv", "-9.8,0.1,0.2", OFF, "m/s2", -1.0),
        ("TotalAcceleration.csv", "9.8,0.1,0.2", ON, "m/s2", 1.0),
        ("AccelerometerUncalibrated.csv", "-0.99,0.1,0.2", "", "g", -1.0),  # g: iOS, and not standardised
        ("AccelerometerUncalibrated.csv", "-0.99,0.1,0.2", OFF, "g", -1.0),
        ("AccelerometerUncalibrated.csv", "9.7,0.1,0.2", "", "m/s2", 1.0),
        ("AccelerometerUncalibrated.csv", "9.7,0.1,0.2", ON, "m/s2", 1.0),
    ],
)
def test_sensor_logger_reads_specific_force_whatever_the_platform_and_states_unit_and_sign(
    tmp_path, name, row, stated, unit, sign
):
    rows = "".join(f"{1700000000000000000 + 10000000 * k},{0.01 * k:.2f},{row}\n" for k in range(4))
    (tmp_path / name).write_text(f"time,seconds_elapsed,z,y,x\n{rows}")
    if stated:
        (tmp_path / "Metadata.csv").write_text(METADATA + stated.format("Accelerometer|Gyroscope") + "\n")
    read = read_counted(tmp_path / name)
    z, y, x = map(float, row.split(","))
    assert (read.record.accel[0].tolist(), read.record.accel_unit) == ([sign * x, sign * y, sign * z], unit)
    assert read.record.sample_rate_hz == pytest.approx(100.0)
    assert ("iOS writes this file in g" in read.notes[0]) == (unit == "g")
    unsure = name.startswith("Total") and not stated
    assert any("sign of acceleration" in note for note in read.notes) == unsure
    assert any("acceleration multiplied by -1" in note for note in read.notes) == (sign < 0.0)
    assert any("sign of acceleration" in item.text for item in describe(tmp_path / name).findings) == unsure


def test_a_sensor_logger_file_that_contradicts_its_metadata_is_refused(tmp_path):
    (tmp_path / "Metadata.csv").write_text(METADATA + OFF + "\n")
    path = tmp_path / "AccelerometerUncalibrated.csv"
    path.write_text(sensor_logger([(k / 100, 9.8, 0.1) for k in range(4)]))
    with pytest.raises(FileFormatError, match=r"g by platform and standardisation in Metadata\.csv, got a"):
        read_record(path)
    (tmp_path / "Metadata.csv").write_bytes(b"")
    assert read_record(path).accel[0].tolist() == [0.1, 0.0, 9.8]


def test_sensor_logger_s_accelerometer_has_no_gravity_and_its_gyroscope_reads(tmp_path):
    rows = "".join(f"{k},{0.01 * k:.2f},1,2,3\n" for k in range(4))
    for name in ("Accelerometer.csv", "Gyroscope.csv", "Gravity.csv"):
        (tmp_path / name).write_text(f"time,seconds_elapsed,z,y,x\n{rows}")
    with pytest.raises(FileFormatError, match="got 'Linear acceleration z', acceleration without gravity"):
        read_record(tmp_path / "Accelerometer.csv")
    with pytest.raises(FileFormatError, match="expected gyroscope or accelerometer columns x, y, z with a unit, got"):
        read_record(tmp_path / "Gravity.csv")
    record = read_record(tmp_path / "Gyroscope.csv")
    assert (record.gyro[0].tolist(), record.gyro_unit, record.accel) == ([3.0, 2.0, 1.0], "rad/s", None)


def sensor_logger(rows):
    return "time,seconds_elapsed,z,y,x\n" + "".join(f"{10**18 + k},{t},{z},0,{x}\n" for k, (t, z, x) in enumerate(rows))


def phone(folder, accel="TotalAcceleration.csv", shift=0.005):
    (folder / "Gyroscope.csv").write_text(sensor_logger([(k / 100, 0.1, 0.0) for k in range(9)]))
    (folder / accel).write_text(sensor_logger([(k / 100 + shift, 9.8, k) for k in range(9)]))
    return folder


def test_the_folder_of_a_phone_is_one_recording(tmp_path):
    read = read_counted(phone(tmp_path))
    assert detect(tmp_path) == "phone"
    np.testing.assert_allclose(read.record.time, np.arange(1, 9) / 100)  # the first stamp precedes the accelerometer's
    np.testing.assert_allclose(read.record.accel[:, 0], np.arange(8) + 0.5)  # half a step between its samples
    assert (read.record.gyro[0].tolist(), read.record.gyro_unit, read.record.accel_unit) == (
        [0.0, 0.0, 0.1],
        "rad/s",
        "m/s2",
    )
    assert read.notes[-1] == "TotalAcceleration.csv interpolated onto the time stamps of Gyroscope.csv"


def zipped(folder, path, inside=""):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as held:
        for file in sorted(folder.glob("*.csv")):
            held.write(file, f"{inside}{file.name}")
        held.writestr(f"{inside}meta/device.csv", "property,value\n")
    return path


@pytest.mark.parametrize("inside", ["", "2026-11-27_10-00-00/"])
def test_the_zip_of_a_phone_reads_as_its_folder(tmp_path, inside):
    whole = read_counted(phone(tmp_path))
    read = read_counted(zipped(tmp_path, tmp_path / "walk.zip", inside))
    assert detect(tmp_path / "walk.zip") == "phone_zip"
    assert read.notes == whole.notes
    for name in ("time", "gyro", "accel"):
        np.testing.assert_array_equal(getattr(read.record, name), getattr(whole.record, name))


def test_gyroscope_and_accelerometer_of_a_phone_given_together_are_one_recording(tmp_path):
    folder = phone(tmp_path)
    whole = read_record(folder)
    session = session_from_files([folder / "TotalAcceleration.csv", folder / "Gyroscope.csv"])  # in any order
    (record,) = session.records
    for name in ("time", "gyro", "accel"):
        np.testing.assert_array_equal(getattr(record, name), getattr(whole, name))
    assert [name for name, _ in session.inputs] == ["TotalAcceleration.csv", "Gyroscope.csv"]
    assert UNKNOWN_SIGN in session.notes


def test_phone_without_gravity_in_its_acceleration_is_refused(tmp_path):
    folder = phone(tmp_path, accel="Accelerometer.csv")
    for path in (folder, zipped(folder, tmp_path / "walk.zip")):
        with pytest.raises(FileFormatError, match=r"acceleration without gravity\. Record"):
            read_record(path)
        assert "acceleration without gravity" in describe(path).summary


def test_drop_outs_of_a_phones_accelerometer_are_gaps(tmp_path):
    folder = phone(tmp_path)
    file = next(path for path in folder.iterdir() if path.name in ("TotalAcceleration.csv", "Accelerometer.csv"))
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[: len(lines) // 3] + lines[2 * len(lines) // 3 :]) + "\n")
    read = read_counted(folder)
    assert 0 < np.isnan(read.record.accel[:, 0]).sum() < len(read.record)
    assert any("in drop-outs of" in note for note in read.notes)
