"""Every public recording reads to the figures published beside it.

Source of each figure: the SOURCE.md in the folder of the recording (origin, commit and licence stand there); read in November 2026.
"""

import numpy as np
import pytest
from benchmarks.broad_files import read_broad

from testkit.column_maps import column_map, reference_map
from testkit.data import DATA, data_path, show
from testkit.npz import read_npz
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ChannelScale, ColumnMap, TextLayout
from undrift.io.formats import read_counted, read_record, read_reference
from undrift.io.inspect import describe, find_symptoms
from undrift.io.mocap import fit_cluster, read_c3d, read_trc
from undrift.io.session import read_session

FACES = {"gyro": ("gyr_x", "gyr_y", "gyr_z"), "accel": ("acc_x", "acc_y", "acc_z")}
BLANKS = TextLayout(delimiter=" ", header=False)


def size(values):
    return np.linalg.norm(values, axis=1)


# ---- inertial recordings ------------------------------------------------------------------------------------------------


def test_the_nilspod_session_reads():
    path = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    record = read_counted(path, column_map(**FACES, gyro_unit="deg/s", accel_unit="m/s^2", sample_rate_hz=102.4)).record
    show("rows", len(record), 10376)
    assert len(record) == 10376
    assert record.gyro[0].tolist() == [-0.6103515625, -0.30517578125, 0.06103515625]
    assert record.sample_rate_hz == pytest.approx(102.4)
    counts = column_map(**FACES, gyro_unit="count", accel_unit="count", sample_rate_hz=102.4)
    assert read_counted(data_path("ferraris_nilspod", "annotated_session.csv"), counts).record.accel[0].tolist() == [
        -2052,
        -28,
        -73,
    ]


@pytest.mark.parametrize("unit", [0, 1, 2])
def test_the_hand_turned_units_read_without_a_time_column(unit):
    columns = column_map(
        accel=(0, 1, 2), gyro=(3, 4, 5), accel_unit="m/s2", gyro_unit="rad/s", sample_rate_hz=100.0, layout=BLANKS
    )
    record = read_counted(data_path("multipos_mpu9150", f"imu{unit}.log.gz"), columns).record
    median = float(np.median(size(record.accel)))
    show(
        f"unit {unit}: duration s, median |a|",
        (round(record.duration_s, 1), round(median, 3)),
        "about 160, 9.83 to 9.87",
    )
    assert record.duration_s == pytest.approx(160.0, abs=1.0)
    assert 9.825 < median < 9.875
    assert np.abs(record.gyro).max() < 5.35
    assert find_symptoms(record) == ()


@pytest.mark.slow
def test_the_xsens_session_joins_its_two_files_side_by_side(tmp_path):
    for name in ("xsens_acc.txt.gz", "xsens_gyro.txt.gz"):
        (tmp_path / name).symlink_to(data_path("multipos_xsens", name))
    (tmp_path / "session.toml").write_text(
        '[session]\nkind = "calibration"\nserial = "MTi"\nlatitude_deg = 45.4\nheight_m = 12.0\n'
        '[[recording]]\nfile = ["xsens_acc.txt.gz", "xsens_gyro.txt.gz"]\ndelimiter = " "\nheader = false\n'
        "columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]\n"
        'units = { time = "s", accel = "count", gyro = "count" }\n'
    )
    (record,) = read_session(tmp_path).records
    show("rows, duration s, rate Hz", (len(record), record.duration_s, record.sample_rate_hz), (51175, 511.7, 100))
    assert len(record) == 51175
    assert record.duration_s == pytest.approx(511.7, abs=0.05)
    assert record.sample_rate_hz == pytest.approx(100.0, abs=0.05)
    assert record.accel[0].tolist() == [33108, 33329, 36429]
    assert record.gyro[0].tolist() == [32786, 32429, 32499]
    still = record.between(5.0, 45.0)  # about 4,018 counts per g, zero near 32,768
    assert np.linalg.norm(still.accel.mean(axis=0) - 32768) == pytest.approx(4018, rel=0.15)


@pytest.mark.slow
def test_the_bicycle_board_reads_from_eleven_files():
    keys = {"time": "t_s", "time_unit": "s", "gyro": ("gyro_rad_s",), "gyro_unit": "rad/s", "accel": ("acc_raw",)}
    columns = column_map(**keys, accel_unit="count", temp="temp_degC", temp_unit="degC")
    paths = sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz"))
    records = [read_npz(path, columns) for path in paths]
    lengths = [record.duration_s for record in records]
    show("files, shortest and longest s", (len(records), round(min(lengths)), round(max(lengths))), (11, 24, 90))
    assert len(records) == 11
    assert 23.5 < min(lengths) < 24.5
    assert 89.5 < max(lengths) < 90.5
    temps = [float(t) for record in records for t in (record.temp_c.min(), record.temp_c.max())]
    assert min(temps) > 21.4
    assert max(temps) < 24.1
    assert all(record.sample_rate_hz == pytest.approx(200.0, abs=0.01) for record in records)


def test_the_rate_table_files_hold_two_clocks():
    keys = {"gyro": ("gyro_bno_dps",), "gyro_unit": "dps", "accel": ("acc_bno_g",), "accel_unit": "g"}
    for name, seconds in (("giro_test_filt", 120.0), ("giro_test_non_filt", 120.0), ("slow_range_data", 75.0)):
        path = data_path("ratetable_jig", f"{name}.npz")
        record = read_npz(path, column_map(**keys, time="t_imu", time_unit="s"))
        show(name, (record.sample_rate_hz, record.duration_s), (100, seconds))
        assert record.sample_rate_hz == pytest.approx(100.0)
        assert record.duration_s == pytest.approx(seconds, abs=0.05)
        with pytest.raises(InputError, match=r"expected arrays of one length, got t_jig .* separate records"):
            read_npz(path, column_map(**keys, time="t_jig", time_unit="s"))


def test_a_header_of_settings_is_skipped_as_stated():
    columns = column_map(
        accel=("ax", "ay", "az"),
        gyro=("gx", "gy", "gz"),
        accel_unit="g",
        gyro_unit="dps",
        accel_scale=ChannelScale(1 / 16384),
        gyro_scale=ChannelScale(1 / 131),
        sample_rate_hz=100.0,
        skip_rows=4,
    )
    record = read_counted(data_path("static_mpu6050", "example_data_tinit_calc.csv.gz"), columns).record
    show("duration s", record.duration_s, 449)
    assert record.duration_s == pytest.approx(449.0, abs=0.5)
    assert 0.85 < np.median(size(record.accel)) < 1.0


@pytest.mark.parametrize(
    ("name", "rows", "temps", "g"), [("hot", 6533, (47.2, 49.4), 0.252), ("cold", 3255, (13.0, 13.3), 0.254)]
)
def test_the_dirty_logs_read_and_their_wrong_scale_is_named(name, rows, temps, g):
    path = data_path("thermal_bmi270_two_point", f"BMI_270_{name}_test.csv.gz")
    keys = {
        "temp": 0,
        "accel": (1, 2, 3),
        "gyro": (4, 5, 6),
        "temp_unit": "degC",
        "accel_unit": "g",
        "gyro_unit": "dps",
    }
    columns = column_map(**keys, sample_rate_hz=50.0, header=False, drop_bad_rows=True)
    built = read_counted(path, columns)
    record = built.record
    show("rows, dropped", (len(record), built.dropped_rows), rows)
    show("degC", (record.temp_c.min(), record.temp_c.max()), temps)
    show("median |a| g", np.median(size(record.accel)), g)
    assert len(record) == rows
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx(temps, abs=0.05)
    assert np.median(size(record.accel)) == pytest.approx(g, abs=0.0005)
    found = {item.code: item.values for item in describe(path, columns).findings}
    assert found["recording.rows_left_out"]["count"] == built.dropped_rows
    assert found["recording.gravity"]["median_g"] == pytest.approx(g, abs=0.0005)
    assert found["recording.gravity"]["direction"] == "small"
    with pytest.raises(FileFormatError, match="set drop_bad_rows = true in a map"):
        read_counted(path, column_map(**keys, sample_rate_hz=50.0, header=False))


@pytest.mark.slow
def test_the_warm_up_reads_in_spite_of_its_drop_outs():
    keys = {"time": "Time", "time_unit": "ms", "temp_unit": "degC", "accel": ("Ax", "Ay", "Az"), "accel_unit": "g"}
    path = data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")
    die = column_map(
        **keys,
        accel_scale=ChannelScale(1 / 16384),
        gyro=("Gx", "Gy", "Gz"),
        gyro_unit="dps",
        gyro_scale=ChannelScale(1 / 16.4),
        temp="dTemp",
        temp_scale=ChannelScale(1 / 340, 36.53),
    )
    record = read_counted(path, die).record
    board = read_counted(path, column_map(**keys, accel_scale=ChannelScale(1 / 16384), temp="Temp ")).record
    mean_hz = (len(record) - 1) / record.duration_s
    steps = np.diff(record.time)
    show("rows, s, mean Hz", (len(record), record.duration_s, mean_hz), (63792, 2158, 29.56))
    show("median step ms, longest s", (1e3 * np.median(steps), steps.max()), (17, 2.8))
    show("die degC", (record.temp_c.min(), record.temp_c.max()), (10.38, 28.94))
    assert len(record) == 63792
    assert record.duration_s == pytest.approx(2158, abs=0.5)
    assert mean_hz == pytest.approx(29.56, abs=0.005)
    assert np.median(steps) == pytest.approx(0.017)
    assert steps.max() == pytest.approx(2.8, abs=0.05)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((10.38, 28.94), abs=0.005)
    assert np.median(record.temp_c - board.temp_c) == pytest.approx(0.95, abs=0.06)
    (lost,) = (item for item in describe(path, die).findings if item.code == "recording.uneven_sampling")
    assert lost.values["count"] == 378
    assert lost.values["longest_s"] == pytest.approx(2.835, abs=0.0005)


def test_the_worn_sensor_reads():
    columns = column_map(**FACES, gyro_unit="dps", accel_unit="g", sample_rate_hz=100.0)
    record = read_counted(data_path("worn_lowback", "HA_001_Test11.csv.gz"), columns).record
    show("s", record.duration_s, 137)
    assert record.duration_s == pytest.approx(137.0, abs=1.0)
    assert find_symptoms(record) == ()


# ---- wearable formats ---------------------------------------------------------------------------------------------------


def test_the_apdm_file_holds_four_sensors_and_its_bias_is_as_published():
    path = data_path("wearable_formats", "opensim_apdm_imuData01.csv.gz")
    sensors = ("Static", "Upper", "Middle", "Lower")
    records = [read_record(path, ColumnMap(sensor=sensor)) for sensor in sensors]
    temps = [float(record.temp_c.mean()) for record in records]
    show("rows, s", (len(records[0]), records[0].duration_s), (1024, 8.0))
    show("degC", (min(temps), max(temps)), (20.7, 23.1))
    assert len(records[0]) == 1024
    assert records[0].sample_rate_hz == pytest.approx(128.0, abs=0.01)
    assert (min(temps), max(temps)) == pytest.approx((20.7, 23.1), abs=0.1)
    bias = np.degrees(records[0].gyro.mean(axis=0))
    show("Static bias deg/s", bias, (0.25, 0.42, -0.47))
    assert bias == pytest.approx((0.25, 0.42, -0.47), abs=0.01)


def test_the_x_io_folders_read_with_their_temperatures():
    folder = data_path("wearable_formats")
    ngimu, ximu3 = read_record(folder / "ngimu"), read_record(folder / "ximu3")
    ximu = read_record(folder / "ximu", ColumnMap(sample_rate_hz=256.0))
    for name, record, wanted in (("NGIMU", ngimu, 37.1), ("x-IMU3", ximu3, 30.0), ("x-IMU", ximu, 31.0)):
        show(f"{name}: rows, first degC", (len(record), record.temp_c[0]), wanted)
        assert record.temp_c[0] == pytest.approx(wanted, abs=0.1)
        assert np.median(size(record.accel)) == pytest.approx(1.0, abs=0.02)
    assert ngimu.sample_rate_hz == pytest.approx(50.0, abs=0.2)
    assert ximu.temp_c.max() == pytest.approx(31.9, abs=0.05)


def test_the_actigraph_is_warmer_than_a_room_and_that_is_said():
    path = data_path("wearable_formats", "agread_gt9x_example-IMU.csv.gz")
    record = read_record(path)
    show("rows, bias deg/s", (len(record), record.gyro.mean(axis=0)), (2300, (-0.772, 0.245, 0.108)))
    assert len(record) == 2300
    assert record.sample_rate_hz == pytest.approx(100.0)
    assert record.gyro.mean(axis=0) == pytest.approx((-0.772, 0.245, 0.108), abs=0.001)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((51.6, 54.7), abs=0.05)
    (warm,) = (item for item in describe(path).findings if item.code != "recording.how_read")
    assert warm.code == "recording.temperature"
    assert (warm.values["low_c"], warm.values["high_c"]) == pytest.approx((51.6, 54.7), abs=0.05)


def test_the_axivity_arrays_read():
    keys = {
        "time": "time",
        "time_unit": "s",
        "gyro": ("gyro",),
        "gyro_unit": "dps",
        "accel": ("accel",),
        "accel_unit": "g",
    }
    columns = column_map(**keys, temp="temperature", temp_unit="degC")
    record = read_npz(data_path("wearable_formats", "skdh_ax6_data.npz"), columns)
    show("rows, s", (len(record), record.duration_s), (10360, 105))
    assert len(record) == 10360
    assert record.duration_s == pytest.approx(105.0, abs=0.5)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((28.0, 30.9), abs=0.05)


# ---- optics -------------------------------------------------------------------------------------------------------------


def test_integer_and_real_storage_of_intel_read_equal():
    integer, real = read_c3d(data_path("c3d", "Eb015pi.c3d")), read_c3d(data_path("c3d", "Eb015pr.c3d"))
    difference = np.nanmax(np.abs(integer.points - real.points))
    show("frames, Hz, markers", (len(integer), integer.sample_rate_hz, len(integer.labels)), (450, 50, 26))
    show("largest difference m", difference, 1e-6)
    assert integer.points.shape == (450, 26, 3)
    assert integer.sample_rate_hz == 50.0
    assert integer.labels == real.labels
    np.testing.assert_array_equal(np.isnan(integer.points), np.isnan(real.points))
    # single precision of a 2.5 m range is 2.4e-7 m
    assert difference < 2.5e-7


def test_integer_and_real_storage_of_dec_read_equal():
    integer, real = read_c3d(data_path("c3d", "dec_int.c3d")), read_c3d(data_path("c3d", "dec_real.c3d"))
    difference = np.nanmax(np.abs(integer.points - real.points))
    show("frames, Hz, largest difference m", (len(real), real.sample_rate_hz, difference), (89, 50, 2.5e-7))
    assert real.points.shape == (89, 36, 3)
    assert difference < 2.5e-7
    assert 0.0 < np.nanmin(real.points[..., 2]) < np.nanmax(real.points[..., 2]) < 2.0  # a person, z up


def test_repeated_labels_are_numbered():
    found = read_c3d(data_path("c3d", "duplicate_labels.c3d"))
    assert (len(found.labels), found.sample_rate_hz) == (48, 100.0)
    assert len(set(found.labels)) == 48
    assert {"XYP", "XYP#2", "XYP#3"} <= set(found.labels)


def test_a_pelvis_of_the_squat_is_a_rigid_cluster():
    markers = read_c3d(data_path("c3d", "squat.c3d.gz"), up="y")
    assert markers.points.shape == (2539, 53, 3)
    assert markers.sample_rate_hz == 120.0
    found = fit_cluster(markers, [f"SehoonVSK35:{name}" for name in ("RBWT", "LBWT", "RMWT", "LMWT")])
    show("frames with a pose, rms mm", (int(found.reference.valid.sum()), 1e3 * found.rms))
    assert found.reference.valid.mean() > 0.95
    assert found.rms < 0.01


SIT = [("STS1", 1399, 14.0, 51), ("STSAsym1", 1345, 13.4, 51), ("squats1", 1346, 13.4, 51), ("static1", 517, 5.2, 55)]


@pytest.mark.parametrize(("name", "frames", "seconds", "count"), SIT)
def test_the_sit_to_stand_trials_read(name, frames, seconds, count):
    markers = read_trc(data_path("mocap_sit_to_stand", f"{name}.trc.gz"), up="y")
    assert markers.points.shape == (frames, count, 3)
    assert markers.sample_rate_hz == pytest.approx(100.0)
    assert frames / 100 == pytest.approx(seconds, abs=0.1)
    assert np.isnan(markers.points).any() == (name == "STSAsym1")


def test_the_neck_rises_as_published():
    height = read_trc(data_path("mocap_sit_to_stand", "STS1.trc.gz"), up="y").pick(["C7"])[:, 0, 2]
    show("C7 rise m", height.max() - height.min(), 0.468)
    assert height.max() - height.min() == pytest.approx(0.468, abs=0.001)


def test_irregular_headers_read_and_the_stairs_are_climbed_as_published():
    markers = read_trc(data_path("mocap_stair_up", "markers_StairUp3.trc.gz"), up="y")
    assert markers.points.shape == (440, 61, 3)
    trunk = markers.pick(["C7", "T10", "CLAV", "STRN", "RBAK"])
    moved = np.ptp(trunk, axis=0)
    show("forward, sway, up m", (moved.mean(axis=0)), "1.47, 0.12 to 0.19, 0.67")
    assert moved[:, 0].mean() == pytest.approx(1.47, abs=0.01)
    assert moved[:, 2].mean() == pytest.approx(0.67, abs=0.005)
    assert 0.115 < moved[:, 1].min() < moved[:, 1].max() < 0.195
    # the head's back marker is written as 0, 0, 0 where it was lost
    assert np.isnan(markers.pick(["LBHD"])[:, 0, 0]).sum() == 52
    for name, frames in (("markers", 281), ("markers_Squat2", 460)):
        assert len(read_trc(data_path("mocap_stair_up", f"{name}.trc.gz"), up="y")) == frames


def test_the_still_stance_reads_in_millimetres():
    markers = read_trc(data_path("posturography", "BMC_static_run_10s_markers.trc.gz"), up="y")
    assert markers.points.shape == (1500, 78, 3)
    assert markers.sample_rate_hz == pytest.approx(150.0, abs=0.01)
    neck = markers.pick(["C7"])[:, 0]
    wander = 1e3 * (neck.max(axis=0) - neck.min(axis=0)).max()
    show("C7 wanders mm", wander, 18)
    assert wander == pytest.approx(18, abs=1.0)


@pytest.mark.parametrize(
    "name", ["02_undisturbed_slow_rotation_B", "24_disturbed_tapping_A", "35_disturbed_attached_magnet_4cm"]
)
def test_the_broad_trials_rest_before_and_after_and_their_optics_have_gaps(name):
    record, reference = read_broad(data_path("broad", f"{name}.hdf5"))
    moving = np.flatnonzero(reference.moving)
    before, after = record.time[moving[0]], record.duration_s - record.time[moving[-1]]
    lost = 100 * (1 - reference.valid.mean())
    show(
        f"{name}: Hz, rest before, after s, lost %",
        (record.sample_rate_hz, before, after, lost),
        "285.714, 26-48, 21-40, 0.1-8.7",
    )
    assert record.sample_rate_hz == pytest.approx(285.714, abs=0.001)
    assert 25.5 < before < 48.5
    assert 20.5 < after < 40.5
    assert 0.1 <= lost <= 8.75


# ---- every file ---------------------------------------------------------------------------------------------------------

FORCES = ("PDS13", "BDS000")


def every_file():
    files = sorted(path for path in DATA.rglob("*") if path.is_file()) if DATA.is_dir() else []
    return [path for path in files if path.name != "GENEActiv_testfile.bin"]  # cut by its author


@pytest.mark.parametrize("path", every_file(), ids=lambda path: str(path.relative_to(DATA)))
def test_every_file_is_described_in_one_line(path):
    found = describe(path)
    print(f"  {found.kind}, {found.format}: {found.summary}")
    assert found.summary
    assert "\n" not in found.summary
    if found.kind in ("recording", "markers", "reference"):
        assert found.rows > 1
        assert found.sample_rate_hz > 1.0
    if path.name.startswith(FORCES):
        assert "force plate" in found.summary
    if path.suffix == ".md" or path.name == "LICENSE":
        assert found.kind == "text"


@pytest.mark.slow
def test_foreign_tables_say_which_map_they_need_and_binaries_need_none():
    for parts in (("multipos_mpu9150", "imu0.log.gz"), ("static_mpu6050",)):
        path = data_path(*parts)
        path = next(path.glob("*.gz")) if path.is_dir() else path
        assert "needs a map with the true units, for example columns = { " in describe(path).summary
    assert describe(data_path("wearable_formats", "ggirread_ax6_testfile.cwa")).kind == "recording"
    assert describe(data_path("ferraris_nilspod", "example_calibration.bin")).kind == "recording"
    assert "name of one of them" in describe(data_path("wearable_formats", "opensim_apdm_imuData01.csv.gz")).summary
    assert "sample rate" in describe(data_path("wearable_formats", "ximu")).summary
    assert "sample rate" in describe(data_path("worn_lowback", "HA_001_Test11.csv.gz")).summary


def test_a_force_plate_is_no_record_and_a_device_s_quaternions_are_a_reference():
    with pytest.raises(InputError, match="expected names such as gyro_x_dps"):
        read_record(data_path("posturography", "PDS13OR1grf.txt.gz"))
    columns = reference_map(time="Time (s)", time_unit="s", quaternion=("W", "X", "Y", "Z"))
    reference = read_reference(data_path("wearable_formats", "ngimu", "quaternion.csv"), columns)
    assert reference.sample_rate_hz == pytest.approx(50.0, abs=0.2)
    assert len(read_record(data_path("wearable_formats", "ximu"), ColumnMap(sample_rate_hz=256.0))) == 12626
