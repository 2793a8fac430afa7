"""XDF, ROS bags, PX4 ULog, NilsPod and Mobilise-D: example files with the figures of their SOURCE.md, and small ones."""

import struct
import sys
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

import undrift
from testkit.column_maps import column_map
from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap
from undrift.io.formats import detect, read_counted, read_record
from undrift.io.inspect import describe
from undrift.io.libraries import library

COUNTS = column_map(time="time_s", time_unit="s", gyro=(0, 1, 2), gyro_unit="count")


def sensor(name):
    return ColumnMap(sensor=name)


def median_size(record):
    return float(np.median(np.linalg.norm(record.accel, axis=1)))


# ---- XDF


def test_an_xdf_stream_is_read_by_a_map_and_the_treatment_of_its_clock_is_said():
    read = read_counted(data_path("makers", "xdf", "minimal.xdf"), COUNTS)
    assert (len(read.record), read.record.time[0], read.record.time[-1]) == (9, 5.0, pytest.approx(5.8))
    assert read.record.sample_rate_hz == pytest.approx(10.0)
    assert read.notes == (
        "stream SendDataC: clocks synchronised, time stamps as recorded (not de-jittered), nominal rate 10 Hz",
    )


def test_an_xdf_clock_that_was_reset_keeps_its_rate_and_shows_the_gap():
    record = read_record(data_path("makers", "xdf", "clock_resets.xdf"), COUNTS)
    assert (len(record), record.sample_rate_hz) == (27815, pytest.approx(92.93, abs=0.01))
    assert np.diff(record.time).max() > 100.0


def chunk(tag, content):
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content


def xdf(path, streams, rows=20):
    """Write streams of (name, [(label, type, unit)], first time)."""
    out = b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
    for k, (name, channels, start) in enumerate(streams, start=1):
        desc = "".join(f"<channel><label>{a}</label><type>{b}</type><unit>{c}</unit></channel>" for a, b, c in channels)
        info = (
            f"<info><name>{name}</name><type>IMU</type><channel_count>{len(channels)}</channel_count><nominal_srate>100"
            f"</nominal_srate><channel_format>double64</channel_format><desc><channels>{desc}</channels></desc></info>"
        )
        out += chunk(2, struct.pack("<I", k) + info.encode())
        samples = [
            b"\x08"
            + struct.pack("<d", start + n / 100)
            + struct.pack(f"<{len(channels)}d", *(n + np.arange(len(channels))))
            for n in range(rows)
        ]
        out += chunk(3, struct.pack("<I", k) + b"\x04" + struct.pack("<I", rows) + b"".join(samples))
        out += chunk(6, struct.pack("<I", k) + b"<info></info>")
    path.write_bytes(out)
    return path


IMU = [(f"acc_{a}", "ACC", "m/s^2") for a in "xyz"] + [(f"gyr_{a}", "GYRO", "deg/s") for a in "xyz"]


def test_an_xdf_stream_with_labels_and_units_needs_no_map(tmp_path):
    path = xdf(tmp_path / "a.xdf", [("Shimmer", [*IMU, ("temp", "Temperature", "celsius")], 500.0)])
    record = read_record(path)
    assert (record.accel_unit, record.gyro_unit, record.device) == ("m/s2", "dps", "Shimmer")
    assert (record.time[0], record.sample_rate_hz) == (500.0, pytest.approx(100.0))
    assert (record.accel[2].tolist(), record.gyro[2].tolist(), record.temp_c[2]) == ([2, 3, 4], [5, 6, 7], 8)
    named = column_map(time="time_s", time_unit="s", accel=tuple(f"acc_{a}" for a in "xyz"), accel_unit="g")
    assert read_record(path, named).accel_unit == "g"  # a map overrules


# ---- ROS: figures of makers/ros_bag_imu/SOURCE.md

BAGS = ("test2.bag", "derived_ros2/test2_imu_only.db3", "derived_ros2/test2_imu_only.mcap")


@pytest.mark.parametrize("name", BAGS)
def test_a_ros_bag_reads_its_imu_by_header_stamp(name):
    path = data_path("makers", "ros_bag_imu", *name.split("/"))
    read = read_counted(path)
    record = read.record
    assert (detect(path), len(record), record.device) == ("ros", 3061, "base_link")
    assert np.diff(record.time) == pytest.approx(0.02, abs=1e-6)
    assert median_size(record) == pytest.approx(9.820, abs=0.0005)
    assert record.accel[0] == pytest.approx((-0.594, 0.157, 9.704), abs=0.0005)
    assert (record.gyro_unit, record.accel_unit, record.temp_c) == ("rad/s", "m/s2", None)
    assert (
        read.notes[0]
        == "topic /imu/data, frame base_link, time from header.stamp, units as ROS defines them (rad/s, m/s2)"
    )


def bag(folder, topics, *, start=1_700_000_000):
    """Write a ROS 2 bag of (topic, message type, fields of each message)."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with Writer(folder, version=8) as writer:
        for topic, kind, messages in topics:
            connection = writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=store)
            for k, fields in enumerate(messages):
                stamp = types["builtin_interfaces/msg/Time"](sec=start + k // 10, nanosec=100_000_000 * (k % 10))
                header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu_link")
                message = types[f"sensor_msgs/msg/{kind}"](header=header, **fields)
                writer.write(connection, k, store.serialize_cdr(message, connection.msgtype))
    return folder


def imu_messages(count=20, *, gyro=0.0, accel=0.0):
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return [
        {
            "orientation": turn,
            "orientation_covariance": np.zeros(9),
            "angular_velocity": vector(x=0.1 * k, y=0.0, z=0.0),
            "angular_velocity_covariance": np.full(9, gyro),
            "linear_acceleration": vector(x=0.0, y=0.0, z=9.81),
            "linear_acceleration_covariance": np.full(9, accel),
        }
        for k in range(count)
    ]


def test_the_folder_of_a_ros_2_bag_reads_with_the_temperature_beside_its_imu(tmp_path):
    temps = [{"temperature": 20.0 + k, "variance": 0.0} for k in range(11)]
    path = bag(tmp_path / "walk", [("/imu/data", "Imu", imu_messages()), ("/imu/temp", "Temperature", temps)])
    read = read_counted(path)
    assert read.record.temp_c[[0, 5, 10, 19]] == pytest.approx([20, 25, 30, 30])
    assert read.record.gyro[3] == pytest.approx((0.3, 0, 0))
    assert read.record.time[[0, 19]] == pytest.approx([0, 1.9], abs=1e-9)
    assert read.notes[1:] == (
        "time 0 is the time stamp 1700000000.000000 s",
        "temperature from /imu/temp, interpolated",
    )


def test_a_covariance_of_minus_one_means_that_the_channel_is_absent(tmp_path):
    topics = [("/a", "Imu", imu_messages(gyro=-1.0)), ("/b", "Imu", imu_messages(gyro=-1.0, accel=-1.0))]
    path = bag(tmp_path / "walk", topics)
    read = read_counted(path, sensor("/a"))
    assert (read.record.gyro, read.record.accel[0, 2]) == (None, 9.81)
    assert "gyro left out: its covariance marks it as not available (-1)" in read.notes
    with pytest.raises(InputError, match=r"expected readings in /b, got none \(covariance -1\). Choose another topic"):
        read_record(path, sensor("/b"))
    with pytest.raises(InputError, match=r"expected the name of one topic, got a file with /a, /b. Choose one with"):
        read_record(path)


# ---- PX4: figures of makers/px4_ulog/SOURCE.md

LOG = ("makers", "px4_ulog", "sample_log_small.ulg")


def test_sensor_combined_is_corrected_already_and_says_so():
    read = read_counted(data_path(*LOG), sensor("sensor_combined"))
    record = read.record
    assert (len(record), record.state, record.frame) == (1298, "corrected", "b")
    assert record.temp_c is None  # an autopilot corrects for temperature itself
    assert (len(record) - 1) / record.duration_s == pytest.approx(199.7, abs=0.05)
    assert (record.time[0], record.time[-1]) == pytest.approx((20.33, 26.82), abs=0.005)
    assert median_size(record) == pytest.approx(9.62, abs=0.005)
    assert np.median(record.accel[:, 2]) < -9.0  # forward-right-down
    assert "already corrected by the autopilot (board rotation, CAL_ parameters): frame b" in read.notes


@pytest.mark.parametrize(("number", "size", "temp_c"), [("0", 9.758, 40.0), ("1", 9.922, 28.3), ("2", 9.836, 29.6)])
def test_each_imu_of_a_ulog_has_its_own_readings_and_temperature(number, size, temp_c):
    record = read_record(data_path(*LOG), sensor(number))
    assert (len(record), record.state, record.gyro_unit, record.accel_unit) == (6, "raw", "rad/s", "m/s2")
    assert record.sample_rate_hz == pytest.approx(1.0, abs=0.001)
    assert median_size(record) == pytest.approx(size, abs=0.0005)
    assert float(np.median(record.temp_c)) == pytest.approx(temp_c, abs=0.25)  # it drifts 0.3 K in the log


def test_a_log_that_lost_its_end_is_read_as_far_as_it_is_whole_when_that_is_asked_for(tmp_path):
    content = data_path(*LOG).read_bytes()
    (tmp_path / "a.ulg").write_bytes(content[: len(content) // 2])
    with pytest.raises(FileFormatError, match=r"messages are truncated .* drop_bad_rows = true in a map"):
        read_record(tmp_path / "a.ulg", sensor("sensor_combined"))
    settings = ColumnMap(sensor="sensor_combined", drop_bad_rows=True)
    assert 500 < len(read_record(tmp_path / "a.ulg", settings)) < 800
    broken = bytearray(content)
    broken[500_000:500_400] = b"\xff" * 400
    (tmp_path / "b.ulg").write_bytes(broken)
    with pytest.raises(FileFormatError, match="damaged or truncated"):
        read_record(tmp_path / "b.ulg", sensor("sensor_combined"))


# ---- NilsPod: figures of makers/nilspod_bin/SOURCE.md and ferraris_nilspod


def test_a_nilspod_reads_in_the_units_of_its_factory():
    read = read_counted(data_path("makers", "nilspod_bin", "NilsPodX-6F13_20210109_162824.bin"))
    record = read.record
    assert (len(record), record.sample_rate_hz, record.device) == (635, pytest.approx(102.4), "NilsPod 6f13")
    assert (median_size(record), np.median(record.accel[:, 2])) == pytest.approx((10.186, 10.18), abs=0.005)
    assert record.gyro.mean(axis=0) == pytest.approx((-0.22, -0.06, 0.60), abs=0.005)
    assert (record.gyro_unit, record.accel_unit) == ("dps", "m/s2")
    assert record.temp_c.mean() == pytest.approx(24.34, abs=0.005)
    assert "factory scale applied" in read.notes[0]


def test_a_nilspod_whose_samples_are_lost_says_how_many_and_one_that_disagrees_is_refused(tmp_path):
    whole = data_path("makers", "nilspod_bin", "NilsPodX-6F13_20210109_162824.bin").read_bytes()
    head, size = whole[0], whole[1]
    lost, place = 40, head + 200 * size
    content = bytearray(whole[:place] + whole[place + lost * size :])
    content[23:27] = struct.pack("<I", 635 - lost)
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    found = describe(path)
    assert any("40 of 635 samples are missing according to the counter" in item.sentence for item in found.findings)
    assert any("longest 0.4004 s" in text for text in found.problems)
    path.write_bytes(whole[:place] + whole[place : place + size] + whole[place:])
    with pytest.raises(FileFormatError, match="the header gives 20372 bytes"):
        read_record(path)
    content = bytearray(whole)
    content[19:23] = struct.pack("<I", struct.unpack_from("<I", whole, 19)[0] + 5)
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"the header gives 12 s, but the file has 6.191 s"):
        read_record(path)


def test_a_library_that_is_missing_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(InputError, match=r"pip install 'undrift\[formats\]'"):
        library("pyulog")


WHOLE = ColumnMap(drop_bad_rows=True)


def at_rest(accel, values, size=200):
    """Return the mean over the `size` samples in a row in which the accelerometer varies least."""
    spread = [accel[k : k + size].std(axis=0).sum() for k in range(0, len(accel) - size, size // 4)]
    start = int(np.argmin(spread)) * (size // 4)
    return values[start : start + size].mean(axis=0)


# ---- Axivity: figures of makers/axivity_cwa/SOURCE.md


def test_an_ax3_reads_its_17400_samples():
    read = read_counted(data_path("makers", "axivity_cwa", "ax3_testfile.cwa"))
    record = read.record
    assert (len(record), record.device, record.accel_unit, record.gyro) == (17400, "AX3 39434", "g", None)
    assert (len(record) - 1) / record.duration_s == pytest.approx(98.87, abs=0.02)  # effective; SOURCE rounds the ends
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(0.988, abs=0.001)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((25.59, 26.46), abs=0.005)
    assert np.diff(record.time).max() < 0.0103  # no gap
    assert read.notes[0].startswith("time 0 is 2019-02-26T10:55:06.000 on the logger's clock")


def test_an_ax6_reads_its_gyroscope_too():
    record = read_record(data_path("wearable_formats", "ggirread_ax6_testfile.cwa"))
    assert (len(record), record.device, record.gyro_unit) == (11320, "AX6 6011834", "dps")  # 91 * 65536 + 48058
    assert (len(record) - 1) / record.duration_s == pytest.approx(99.04, abs=0.02)
    assert at_rest(record.accel, record.gyro) == pytest.approx(
        (-0.07, 1.08, 0.11), abs=0.05
    )  # SOURCE does not say which seconds
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(1.0106, abs=0.01)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((27.05, 28.22), abs=0.005)


def test_a_cut_cwa_file_is_refused_or_read_to_its_last_whole_sector(tmp_path):
    whole = data_path("makers", "axivity_cwa", "ax3_testfile.cwa").read_bytes()
    (tmp_path / "a.cwa").write_bytes(whole[: 1024 + 512 * 10 + 100])
    with pytest.raises(FileFormatError, match="ends within a sector"):
        read_record(tmp_path / "a.cwa")
    assert len(read_record(tmp_path / "a.cwa", WHOLE)) == 1200


# ---- GENEActiv: figures of makers/geneactiv_bin/SOURCE.md


def test_a_geneactiv_reads_its_900_samples():
    record = read_record(data_path("makers", "geneactiv_bin", "gnactv_sample.bin"))
    assert (len(record), record.device, record.accel_unit) == (900, "GENEActiv 051386", "g")
    assert record.sample_rate_hz == pytest.approx(50.0)
    np.testing.assert_allclose(np.diff(record.time), 0.02, rtol=1e-6)
    assert np.median(np.linalg.norm(record.accel, axis=1)) == pytest.approx(1.003, abs=0.0005)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((28.1, 29.1), abs=1e-4)
    # the first words of the first page, F22 027 00B, by the header's gains and offsets
    assert record.accel[0] == pytest.approx(
        [(-222 * 100 - 272) / 25522, (39 * 100 + 1129) / 25457, (11 * 100 - 101) / 24829], rel=1e-5
    )


def test_a_cut_geneactiv_file_is_refused_or_read_as_far_as_it_goes():
    path = data_path("makers", "geneactiv_bin", "GENEActiv_testfile.bin")
    with pytest.raises(FileFormatError, match="222048 pages are missing"):
        read_record(path)
    record = read_record(path, WHOLE)
    assert len(record) >= 4800
    assert record.sample_rate_hz == pytest.approx(85.7, rel=1e-3)


# ---- ActiGraph: records after the maker's documents

EXAMPLE = bytes.fromhex("006008EBD007009EBF007008EBF0")  # activity.bin.md: three samples
SAMPLES_LOGGERS = np.array([[8, 6, -323], [9, 7, -321], [8, 7, -321]]) / 341.0  # x, y, z


SCALE = 9 << 24 | 341 << 14  # ACCEL_SCALE: 341/512 of 2^9 counts/g, a fraction of 24 bits and an exponent of 8


def entry(kind, payload, when=1_000):
    body = struct.pack("<BBIH", 0x1E, kind, when, len(payload)) + payload
    return body + bytes([0xFF ^ int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))])


def test_the_log_of_a_gt3x_reads_its_accelerometer(tmp_path):
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as held:
        held.writestr("info.txt", "Serial Number: NEO1\r\nSample Rate: 30\r\n")
        scale = entry(21, struct.pack("<HHI", 0, 55, SCALE))
        held.writestr("log.bin", scale + entry(0, EXAMPLE))
    assert detect(path) == "gt3x"
    record = read_record(path)
    assert record.device.endswith("NEO1")
    np.testing.assert_allclose(record.accel, SAMPLES_LOGGERS, atol=2e-3)  # actfast rounds to 0.001 g


# ---- mATLAB files

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
