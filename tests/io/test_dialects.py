"""Makers' text exports: the real files with the figures of their SOURCE.md; formats without one, by their documents."""

import struct
import tomllib
import zipfile

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap
from undrift.io.columns import build_record
from undrift.io.dialects import Dialect
from undrift.io.formats import detect, read_counted, read_record
from undrift.io.inspect import describe


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


def test_mt_manager_rates_are_radians_and_its_field_is_left_out_aloud():
    read = read_counted(maker("xsens_mtmanager", "skin_data_xsens.txt"))
    assert read.record.mag_ut is None
    assert read.notes == (
        "units by the manual of Xsens, not in the file: gyro rad/s, accel m/s2",
        "lines before the header skipped: 4",
        "'Mag_X' left out: it has no unit of a magnetic field",
    )


def test_a_packet_counter_that_overflows_goes_on(tmp_path):
    rows = "".join(f"{(65534 + k) % 65536:05d}\t0\t0\t9.8\t0.1\t0\t0\n" for k in (0, 1, 2, 3, 6))
    head = "// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n"
    (tmp_path / "m.txt").write_text(head + rows)
    read = read_counted(tmp_path / "m.txt")
    np.testing.assert_allclose(read.record.time, [0.0, 0.01, 0.02, 0.03, 0.06])
    assert read.notes[1] == "2 of 7 packets lost by PacketCounter, seen as gaps in time"


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
    assert read.notes[0] == "units by the manual of Movella DOT, not in the file: gyro dps, accel m/s2"


def test_a_counter_that_goes_back_is_no_overflow(tmp_path):
    rows = "".join(f"{k},{16667 * (k if k != 2 else 0)},0,0,9.81,0,90,0\n" for k in range(5))
    (tmp_path / "dot.csv").write_text(f"{DOT}PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n{rows}")
    with pytest.raises(
        FileFormatError, match="expected a counter that goes forward, got 16667 and then 0 in data row 3"
    ):
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


@pytest.mark.parametrize(
    ("path", "missing", "words"),
    [
        (("shimmer_consensys", "read_test_data.csv"), "sensor", "The file contains LN, WR"),
        (("delsys_trigno", "truncated_trigno_sample.csv"), "sensor", "Mini sensor 10, Mini sensor 11"),
        (("apdm_csv", "imuData01.csv"), "sensor", "Static, Upper, Middle, Lower"),
        (("stm_mems_logs", "unico_acc_only_driving.txt"), "sample_rate_hz", "sample rate"),
        (("xsens_mtmanager", "MT_01200454_000-000_00B40DE4.txt"), "sample_rate_hz", "sample rate"),
    ],
)
def test_what_a_file_leaves_open_is_asked_in_one_line(path, missing, words):
    with pytest.raises(InputError) as caught:
        read_record(maker(*path))
    assert words in str(caught.value)
    assert caught.value.numbers["missing"] == missing
    found = describe(maker(*path))
    assert found.kind == "table"
    assert found.findings[0].values["missing"] == missing
    assert words in found.summary


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
    assert "units by the manual of Noraxon, not in the file: time s" in read.notes


def test_noraxon_names_one_side_before_and_behind_the_segment(tmp_path):
    names = [f"RT Hand Accel Sensor {x} (mG)" for x in "XYZ"]
    names += [
        f"Noraxon MyoMotion-Segments-{place}-Gyroscope-{x} (deg/s)" for place in ("Hand RT", "Foot LT") for x in "xyz"
    ]
    (tmp_path / "n.csv").write_text(f"time,{','.join(names)}\n" + "0,1,2,990,4,5,6,7,8,9\n0.1,1,2,990,4,5,6,7,8,9\n")
    record = read_record(tmp_path / "n.csv", ColumnMap(sensor="Hand RT"))
    assert (record.accel[0].tolist(), record.gyro[0].tolist()) == ([1.0, 2.0, 990.0], [4.0, 5.0, 6.0])


def test_two_rates_in_one_trigno_sensor_are_refused(tmp_path):
    kinds = (("ACC", "g", "1.0e+002"), ("GYRO", "deg/s", "2.0e+002"))
    label = "Label: S 1: {}.{} Sampling frequency: {} Number of points: 9 start: 0 Unit: {} Domain Unit: s"
    lines = [label.format(kind, axis, rate, unit) for kind, unit, rate in kinds for axis in "XYZ"]
    header = ",".join(f'X[s],"S 1: {kind}.{axis}"' for kind, _, _ in kinds for axis in "XYZ")
    rows = "".join(",".join([f"{0.01 * k:.2f},1"] * 6) + "\n" for k in range(4))
    (tmp_path / "t.csv").write_text("\n".join([*lines, header]) + "\n" + rows)
    with pytest.raises(InputError, match="expected one sample rate in one sensor, got 100 Hz, 200 Hz"):
        read_record(tmp_path / "t.csv")


def test_a_zip_is_to_be_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "walk.zip", "w") as held:
        held.writestr("Gyroscope.csv", "time,seconds_elapsed,z,y,x\n")
    with pytest.raises(FileFormatError, match=r"got a zip archive or an Excel workbook. Unpack it and name the folder"):
        read_record(tmp_path / "walk.zip")


# ---- damage


@pytest.mark.parametrize("folder", sorted({row[0] for row in READ} | {"xsens_dot", "phyphox_csv", "opensim_sto_mot"}))
def test_a_file_cut_or_spoilt_anywhere_is_read_or_refused_in_one_line(tmp_path, folder):
    rng, refusals = np.random.default_rng(3), []
    for path in sorted(maker(folder).iterdir()):
        if path.suffix == ".mat" or path.name == "SOURCE.md":
            continue
        content = path.read_bytes()[:6000]
        for at in rng.integers(10, len(content), 6):
            spoilt = content[:at] + (
                bytes(rng.integers(1, 256, 3, dtype=np.uint8)) + content[at + 3 :] if at % 2 else b""
            )
            (tmp_path / f"a{path.suffix}").write_bytes(spoilt)
            try:
                assert describe(tmp_path / f"a{path.suffix}").summary
            except InputError as error:
                refusals.append(str(error))
    assert not any("\n" in refusal for refusal in refusals)


# ---- makers that this version does not know: a map in one line reads the same rows

BY_MAP = [
    (
        ("apdm_csv", "apdm_format7.csv"),
        column_map(
            time=0, accel=(1, 2, 3), gyro=(4, 5, 6), mag=(7, 8, 9), time_unit="us", accel_unit="m/s2", gyro_unit="rad/s",
            mag_unit="uT", header=False, skip_rows=3,
        ),
        3, 128.0, 10.29,
    ),
    (
        ("delsys_trigno", "discover164_basic_first12rows.csv"),
        column_map(accel=(5, 6, 7), accel_unit="g", sample_rate_hz=74.0741, header=False, skip_rows=7),
        12, 74.0741, 0.979,
    ),
    (
        ("mobilised_mat", "mobgap_csv_HA001_TimeMeasure1_Test5_Trial1.csv"),
        column_map(
            accel=("acc_x", "acc_y", "acc_z"), gyro=("gyr_x", "gyr_y", "gyr_z"), accel_unit="g", gyro_unit="dps",
            sample_rate_hz=100.0,
        ),
        1246, 100.0, 0.9816,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("path", "columns", "rows", "rate", "accel"), BY_MAP, ids=["apdm7", "discover", "mobgap"])
def test_a_map_reads_an_export_without_a_dialect(path, columns, rows, rate, accel):
    record = read_record(maker(*path), columns)
    assert len(record) == rows
    assert record.sample_rate_hz == pytest.approx(rate, rel=1e-5)
    assert size(record.accel) == pytest.approx(accel, abs=0.006)


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
    assert result.notes[0] == "units by the manual of StepLogger, not in the file: gyro dps, accel g"


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


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def test_timetables_in_a_mat_file_are_refused_with_their_mend(tmp_path):
    def timetable(name):  # as the format's documents have objects: flags, name, system, class, a reference of uint32
        reference = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
        reference += element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
        words = element(1, name) + element(1, b"MCOS") + element(1, b"timetable")
        return element(14, element(6, struct.pack("<II", 17, 0)) + words + element(14, reference))

    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    path = tmp_path / "sensorlog.mat"
    path.write_bytes(head + timetable(b"Acceleration") + timetable(b"AngularVelocity"))
    with pytest.raises(FileFormatError, match="expected arrays, got MATLAB objects"):
        read_record(path)
