"""Makers' text exports: the real files with the figures of their SOURCE.md; formats without one, by their documents."""

import tomllib

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap
from undrift.io.columns import build_record
from undrift.io.dialects import Dialect, dialects
from undrift.io.formats import detect, read_counted, read_record, read_reference
from undrift.io.inspect import describe
from undrift.io.reference import read_reference_map


def maker(*parts):
    return data_path("makers", *parts)


def size(values):
    return float(np.median(np.linalg.norm(values, axis=1)))


# ---- the real files

# SOURCE.md has 1.088 g for sensor 11 with the zeros of its start, and 0.954 to 1.004 g for the eight sensors of Discover
# folder, file, settings, format, rows, Hz, |a| and unit, gyro unit, device
RATE = {"sample_rate_hz": 100.0}
XSENS, DELSYS, STM = "xsens_mtmanager", "delsys_trigno", "stm_mems_logs"
READ = [
    (XSENS, "skin_data_xsens.txt", {}, "xsens", 953, 50.0, (9.764, "m/s2"), "rad/s", ""),
    (XSENS, "MT46_01-000_00B42D4D.txt", {}, "xsens", 5, 100.0, (9.802, "m/s2"), "rad/s", "00B42D4D"),
    (XSENS, "MT_01200454_000-000_00B40DE4.txt", RATE, "xsens", 4, 100.0, (9.979, "m/s2"), "rad/s", "00B40DE4"),
    (XSENS, "MT2022_ACC_GYRO_ROT_EULER_TAB_00B42D4F.txt", RATE, "xsens", 5, 100.0, (9.990, "m/s2"), "rad/s", "00B42D4F"),
    ("shimmer_consensys", "read_test_data.csv", {"sensor": "LN"}, "shimmer", 86, None, (10.11, "m/s2"), "dps", "LN"),
    ("shimmer_consensys", "read_test_data.csv", {"sensor": "wr"}, "shimmer", 86, None, (9.44, "m/s2"), "dps", "WR"),
    (DELSYS, "truncated_trigno_sample.csv", {"sensor": "10"}, "trigno", 281, 148.148, (1.066, "g"), "dps", "Mini sensor 10"),
    (DELSYS, "truncated_trigno_sample.csv", {"sensor": "11"}, "trigno", 281, 148.148, (1.089, "g"), "dps", "Mini sensor 11"),
    (STM, "lsm6dsox_door_open1.csv", {}, "labelled", 137, None, (1.001, "g"), "dps", ""),
    (STM, "unico_acc_only_driving.txt", {"sample_rate_hz": 26.0}, "labelled", 1000, 26.0, (996.2, "mg"), None, ""),
    (STM, "lsm6dsv16x_door_open1.txt", {"sample_rate_hz": 30.0}, "labelled", 183, 30.0, None, "dps", ""),
]  # fmt: skip


@pytest.mark.parametrize(
    ("folder", "file", "settings", "kind", "rows", "rate", "accel", "gyro", "device"), READ, ids=lambda x: str(x)[:40]
)
def test_an_export_reads_with_its_published_figures(folder, file, settings, kind, rows, rate, accel, gyro, device):
    path = maker(folder, file)
    assert detect(path) == kind
    record = read_record(path, ColumnMap(**settings))
    assert (len(record), record.device) == (rows, device)
    if rate is not None:
        assert record.sample_rate_hz == pytest.approx(rate, rel=1e-5)
    if accel is None:
        assert record.accel is None
    else:
        assert record.accel_unit == accel[1]
        assert size(record.accel) == pytest.approx(accel[0], abs=0.5 * 10.0 ** -len(str(accel[0]).split(".")[1]))
    assert (record.gyro is None) == (gyro is None)
    if gyro is not None:
        assert record.gyro_unit == gyro


def test_a_packet_counter_that_overflows_goes_on(tmp_path):
    rows = "".join(f"{(65534 + k) % 65536:05d}\t0\t0\t9.8\t0.1\t0\t0\n" for k in (0, 1, 2, 3, 6))
    head = "// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n"
    (tmp_path / "m.txt").write_text(head + rows)
    read = read_counted(tmp_path / "m.txt")
    np.testing.assert_allclose(read.record.time, [0.0, 0.01, 0.02, 0.03, 0.06])
    assert read.notes[1] == "2 of 7 packets lost according to PacketCounter are gaps in time"


@pytest.mark.parametrize("delimiter", [";", ",", " "])
def test_mt_manager_reads_with_each_delimiter_and_missing_cells_are_gaps(tmp_path, delimiter):
    names = ["PacketCounter", "SampleTimeFine", *(f"{kind}_{x}" for kind in ("Acc", "Gyr") for x in "XYZ")]
    rows = [[f"{51400 + k}", "NaN", "NaN" if k == 0 else "0.1", "0.2", "9.8", "0.01", "0.02", "0.03"] for k in range(4)]
    lines = ["// General information: ", "// Update Rate: 100.0Hz", *(delimiter.join(row) for row in (names, *rows))]
    (tmp_path / "m.txt").write_text("\r\n".join(lines) + "\r\n")
    with pytest.raises(InputError, match="a number in every row, got 1 empty or NaN cells"):
        read_record(tmp_path / "m.txt")
    record = read_record(tmp_path / "m.txt", ColumnMap(gaps="keep"))
    assert np.isnan(record.accel[:, 0]).tolist() == [True, False, False, False]
    np.testing.assert_allclose(record.gyro, [[0.01, 0.02, 0.03]] * 4)


DOT = "sep=,\nDeviceTag:,Left\nOutputRate:,60Hz\n© Xsens\n\n"


def test_a_dot_recording_with_sensors_has_metres_and_degrees_and_its_clock_overflows(tmp_path):
    start = (1 << 32) - 16667
    rows = "".join(f"{k},{(start + 16667 * k) % (1 << 32)},0,0,9.81,0,90,0\n" for k in range(4))
    path = tmp_path / "dot.csv"
    path.write_text(f"{DOT}PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n{rows}")
    read = read_counted(path)
    assert (read.record.accel_unit, read.record.gyro_unit, read.record.device) == ("m/s2", "dps", "Left")
    np.testing.assert_allclose(np.diff(read.record.time), 0.016667)
    assert read.notes[0] == "units from the manual of Movella DOT, not from the file: gyro dps, accel m/s2"


def test_a_counter_that_goes_back_is_no_overflow(tmp_path):
    rows = "".join(f"{k},{16667 * (k if k != 2 else 0)},0,0,9.81,0,90,0\n" for k in range(5))
    (tmp_path / "dot.csv").write_text(f"{DOT}PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n{rows}")
    with pytest.raises(FileFormatError, match="expected a counter that increases, got 16667 and then 0 in data row 3"):
        read_record(tmp_path / "dot.csv")


def test_free_acceleration_is_no_accelerometer():
    for name in ("LFemur_20210820_202113_831.csv", "Pelvis_20210820_202113_836.csv"):
        with pytest.raises(FileFormatError, match=r"got 'FreeAcc_X', acceleration without gravity. Record or export"):
            read_record(maker("xsens_dot", name))
    with pytest.raises(FileFormatError, match=r"got 'Linear Acceleration x \(m/s\^2\)', acceleration without gravity"):
        read_record(maker("phyphox_csv", "Raw_Data.csv"))
    found = describe(maker("phyphox_csv", "Raw_Data.csv"))
    assert (found.kind, "without gravity" in found.summary) == ("table", True)
    with pytest.raises(FileFormatError, match="expected gyroscope or accelerometer columns"):
        read_record(maker("xsens_mtmanager", "MT_012005D6-000_sit_to_stand-000_00B421ED.txt"))


def test_shimmer_stamps_that_repeat_are_counted_and_the_two_accelerometers_are_never_merged():
    low, wide = (
        read_counted(maker("shimmer_consensys", "read_test_data.csv"), ColumnMap(sensor=name)) for name in ("LN", "WR")
    )
    assert low.repaired_rows == wide.repaired_rows == 4
    np.testing.assert_allclose(np.median(low.record.accel, axis=0), [-1.42, 10.00, 0.53], atol=0.03)
    np.testing.assert_allclose(np.median(wide.record.accel, axis=0), [-3.93, 8.43, -1.62], atol=0.03)
    assert np.median(low.record.temp_c) == pytest.approx(33.4, abs=0.1)
    assert low.record.mag_ut is None
    assert "'Shimmer_40AC_Mag_X_CAL' left out: it has no unit of a magnetic field" in low.notes


def test_trigno_starts_without_its_zeros_and_ends_where_the_slow_channel_ends():
    read = read_counted(maker("delsys_trigno", "truncated_trigno_sample.csv"), ColumnMap(sensor="10"))
    assert "16 rows of zeros at the start left out" in read.notes
    assert len(read.record) + 16 == 297
    assert (read.record.accel[0] != 0.0).all()
    assert read.record.time[0] == pytest.approx(16 * 0.00675)


def test_trigno_channels_whose_times_differ_are_refused(tmp_path):
    lines = maker("delsys_trigno", "truncated_trigno_sample.csv").read_text().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line[0].isdigit())
    cells = lines[first + 100].split(",")
    cells[4] = f"{float(cells[4]) + 0.001}"
    lines[first + 100] = ",".join(cells)
    (tmp_path / "t.csv").write_text("".join(lines))
    with pytest.raises(FileFormatError, match="one time for all channels"):
        read_record(tmp_path / "t.csv", ColumnMap(sensor="10"))


# ---- formats without a file that may be shared, by their documents

SENSORS = ("Pelvis Accel Sensor {} (mG)", "Noraxon MyoMotion-Segments-Pelvis-Gyroscope-{} (deg/s)")


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), (",", ".")])
def test_noraxon_reads_with_both_delimiters_and_the_decimal_comma(tmp_path, delimiter, decimal):
    names = [
        "time",
        "Activity",
        "Marker",
        *(SENSORS[0].format(x) for x in "XYZ"),
        *(SENSORS[1].format(x) for x in "xyz"),
    ]
    names.append("Noraxon MyoMotion-Segments-Pelvis-Acceleration-x (mG)")
    row = ["rest", "", "12.5", "-3.25", "998.5", "0.5", "-0.25", "1.5", "7.5"]
    rows = [[f"{k / 200:.3f}", *row] for k in range(5)]
    lines = ["Type,Noraxon", "Name,x", "", delimiter.join(names)]
    lines += [delimiter.join(cell.replace(".", decimal) for cell in cells) for cells in rows]
    (tmp_path / "n.csv").write_text("\n".join(lines) + "\n")
    assert detect(tmp_path / "n.csv") == "noraxon"
    read = read_counted(tmp_path / "n.csv")
    np.testing.assert_allclose(read.record.accel[0], [12.5, -3.25, 998.5])
    np.testing.assert_allclose(read.record.gyro[0], [0.5, -0.25, 1.5])
    assert (read.record.accel_unit, read.record.gyro_unit) == ("mg", "dps")
    assert read.record.sample_rate_hz == pytest.approx(200.0)
    assert "units from the manual of Noraxon, not from the file: time s" in read.notes


# ---- makers that this version does not know: a map in one line reads the same rows


STEP_LOGGER = """
maker = "StepLogger"
head = '\\A# StepLogger \\d'
units = { gyro = "dps", accel = "g" }
device = '^# unit (\\w+)'
rate = '^# rate (\\d+)'
"""


def test_a_new_maker_is_a_file_without_code(tmp_path):
    dialect = Dialect.model_validate(tomllib.loads(STEP_LOGGER))
    head = "# StepLogger 2\n# unit A7\n# rate 50\n"
    rows = "".join("1,2,3,0,0,1\n" for _ in range(4))
    (tmp_path / "s.csv").write_text(f"{head}gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z\n{rows}")
    assert dialect.recognises(tmp_path / "s.csv", head.encode())
    result = build_record(dialect.read(tmp_path / "s.csv"))
    assert (result.record.device, result.record.sample_rate_hz, result.record.gyro_unit) == ("A7", 50.0, "dps")
    assert result.notes[0] == "units from the manual of StepLogger, not from the file: gyro dps, accel g"


# ---- clocks and folders


def test_an_mt_export_without_a_rate_takes_its_fine_clock_of_10_khz(tmp_path):
    rows = "".join(f"{k:05d};{(4294967290 + 100 * k) % 2**32};0;0;9.8;0.1;0;0\n" for k in range(4))
    head = "//  MT Manager version: 2022.2\nPacketCounter;SampleTimeFine;Acc_X;Acc_Y;Acc_Z;Gyr_X;Gyr_Y;Gyr_Z\n"
    (tmp_path / "m.txt").write_text(head + rows)
    read = read_counted(tmp_path / "m.txt")
    np.testing.assert_allclose(read.record.time, [0.0, 0.01, 0.02, 0.03])
    assert read.notes[1] == "time from SampleTimeFine, 10 kHz by the manual of Xsens"
    stated = read_counted(tmp_path / "m.txt", ColumnMap(sample_rate_hz=50.0))
    np.testing.assert_allclose(stated.record.time, [0.0, 0.02, 0.04, 0.06])


# ---- wearable formats in their text form

GYRO = [f"Gyroscope {a} (deg/s)" for a in "XYZ"]
ACCEL = [f"Accelerometer {a} (g)" for a in "XYZ"]


def csv(header, rows):
    return "\n".join([",".join(header), *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def test_temperature_of_its_own_rate_is_interpolated_and_held_at_the_ends(tmp_path):
    rng, n = np.random.default_rng(7), 200
    time, values = np.arange(n) * 0.02, rng.normal(size=(n, 10))
    header = ["Time (s)", *GYRO, *ACCEL, *(f"Magnetometer {a} (uT)" for a in "XYZ"), "Barometer (hPa)"]
    (tmp_path / "sensors.csv").write_text(csv(header, np.column_stack((time, values))))
    assert read_record(tmp_path).temp_c is None
    clock, temp = -0.5 + np.arange(4), 30.0 + np.arange(4)
    names = ["Time (s)", "Processor (degC)", "Gyroscope And Accelerometer (degC)", "Environmental Sensor (degC)"]
    (tmp_path / "temperature.csv").write_text(csv(names, np.column_stack((clock, temp + 20, temp, temp - 5))))
    record = read_record(tmp_path)
    assert detect(tmp_path) == "ngimu"
    np.testing.assert_array_equal(record.gyro, values[:, :3])
    np.testing.assert_array_equal(record.accel, values[:, 3:6])
    np.testing.assert_array_equal(record.mag_ut, values[:, 6:9])
    np.testing.assert_allclose(record.temp_c, np.interp(time, clock, temp))
    (tmp_path / "temperature.csv").write_text("Time (s),Gyroscope And Accelerometer (degC)\n")
    with pytest.raises(InputError, match="one reading or more"):
        read_record(tmp_path)


def test_ximu_packets_place_the_temperature_and_the_rate_is_stated(tmp_path):
    values = np.random.default_rng(2).normal(size=(5, 9))
    header = ["Packet number", *GYRO, *ACCEL, *(f"Magnetometer {a} (G)" for a in "XYZ")]
    (tmp_path / "7_CalInertialAndMag.csv").write_text(csv(header, np.column_stack((10 + 2 * np.arange(5), values))))
    (tmp_path / "7_CalBattAndTherm.csv").write_text(
        "Packet number,Battery voltage (V),Thermometer (degrees C)\n10,4,30\n18,4,34\n"
    )
    with pytest.raises(InputError, match="sample rate"):
        read_record(tmp_path)
    record = read_record(tmp_path, ColumnMap(sample_rate_hz=256.0))
    np.testing.assert_allclose(record.temp_c, [30, 31, 32, 33, 34])
    np.testing.assert_allclose(record.mag_ut, values[:, 6:] * 100)
    assert record.sample_rate_hz == pytest.approx(256.0)
    (tmp_path / "8_CalInertialAndMag.csv").write_text("x")
    with pytest.raises(InputError, match="7_CalInertialAndMag"):
        read_record(tmp_path)


def test_shipped_maps_name_a_maker_and_recognise_no_table_of_undrift(tmp_path):
    head = b"time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n0,1,2,3\n"
    for name, dialect in dialects().items():
        assert dialect.maker, name
        assert not dialect.recognises(tmp_path, head), name


# ---- poses and markers in text

STO = ("makers", "opensim_sto_mot", "myComplexTasksTrial_orientations.sto")
IMUS = "pelvis_imu, tibia_r_imu, femur_r_imu, tibia_l_imu, femur_l_imu, calcn_l_imu, calcn_r_imu"


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
