"""Every public recording reads to the figures published beside it.

Source of each figure: the SOURCE.md in the folder of the recording (origin, commit and licence stand there); read in November 2026.
"""

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.data import DATA, data_path, show
from undrift.io.column_map import ChannelScale, ColumnMap, TextLayout
from undrift.io.columns import build_record
from undrift.io.formats import read_counted, read_record
from undrift.io.inspect import describe
from undrift.io.libraries import table_of_arrays
from undrift.io.mocap import read_c3d, read_trc


def read_npz(path, columns):
    """Return the record of the arrays of an npz file, through a map."""
    with np.load(path) as held:
        arrays = tuple((name, held[name]) for name in held.files)
    return build_record(table_of_arrays(arrays, path, columns.wanted()), columns).record


approx = pytest.approx
FACES = {"gyro": ("gyr_x", "gyr_y", "gyr_z"), "accel": ("acc_x", "acc_y", "acc_z")}
BLANKS = TextLayout(delimiter=" ", header=False)


def size(values):
    return np.linalg.norm(values, axis=1)


def counted(folder, file, **keys):
    return read_counted(data_path(folder, file), column_map(**keys)).record


# ---- inertial recordings ------------------------------------------------------------------------------------------------

HAND_TURNED = {"accel": (0, 1, 2), "gyro": (3, 4, 5), "accel_unit": "m/s2", "gyro_unit": "rad/s", "layout": BLANKS}
DIRTY = {"temp": 0, "accel": (1, 2, 3), "gyro": (4, 5, 6), "temp_unit": "degC", "accel_unit": "g", "gyro_unit": "dps",
         "sample_rate_hz": 50.0, "header": False}  # fmt: skip
WARM_UP = {"time": "Time", "time_unit": "ms", "temp_unit": "degC", "accel": ("Ax", "Ay", "Az"), "accel_unit": "g",
           "accel_scale": ChannelScale(1 / 16384)}  # fmt: skip
DIE = {**WARM_UP, "gyro": ("Gx", "Gy", "Gz"), "gyro_unit": "dps", "gyro_scale": ChannelScale(1 / 16.4), "temp": "dTemp",
       "temp_scale": ChannelScale(1 / 340, 36.53)}  # fmt: skip
JIG = {"gyro": ("gyro_bno_dps",), "gyro_unit": "dps", "accel": ("acc_bno_g",), "accel_unit": "g", "time_unit": "s"}


AXIVITY = {"time": "time", "time_unit": "s", "gyro": ("gyro",), "gyro_unit": "dps", "accel": ("accel",), "accel_unit": "g",
           "temp": "temperature", "temp_unit": "degC"}  # fmt: skip
MPU6050 = {"accel": ("ax", "ay", "az"), "gyro": ("gx", "gy", "gz"), "accel_unit": "g", "gyro_unit": "dps",
           "accel_scale": ChannelScale(1 / 16384), "gyro_scale": ChannelScale(1 / 131), "sample_rate_hz": 100.0,
           "skip_rows": 4}  # fmt: skip
BMI270, WEARABLES = "thermal_bmi270_two_point", "wearable_formats"

# Record, and its published figures: rows, duration in s, samples a second, lowest and highest temperature, median force.
PUBLISHED = {
    "nilspod": (
        lambda: counted("ferraris_nilspod", "example_ferraris_session.csv", **FACES, gyro_unit="deg/s",
                        accel_unit="m/s^2", sample_rate_hz=102.4),
        {"rows": 10376, "rate_hz": approx(102.4)},
    ),
    **{
        f"hand-turned {unit}": (
            lambda unit=unit: counted("multipos_mpu9150", f"imu{unit}.log.gz", **HAND_TURNED, sample_rate_hz=100.0),
            {"seconds": approx(160.0, abs=1.0), "force": approx(9.85, abs=0.025)},
        )
        for unit in (0, 1, 2)
    },
    **{
        run: (
            lambda run=run: read_npz(data_path("ratetable_jig", f"{run}.npz"), column_map(**JIG, time="t_imu")),
            {"rate_hz": approx(100.0), "seconds": approx(seconds, abs=0.05)},
        )
        for run, seconds in (("giro_test_filt", 120.0), ("giro_test_non_filt", 120.0), ("slow_range_data", 75.0))
    },
    "header of settings": (
        lambda: counted("static_mpu6050", "example_data_tinit_calc.csv.gz", **MPU6050),
        {"seconds": approx(449.0, abs=0.5), "force": approx(0.925, abs=0.075)},
    ),
    **{
        f"dirty log, {name}": (
            lambda name=name: counted(BMI270, f"BMI_270_{name}_test.csv.gz", **DIRTY, drop_bad_rows=True),
            {"rows": rows, "low_c": approx(low, abs=0.05), "high_c": approx(high, abs=0.05),
             "force": approx(force, abs=0.0005)},
        )
        for name, rows, low, high, force in (("hot", 6533, 47.2, 49.4, 0.252), ("cold", 3255, 13.0, 13.3, 0.254))
    },
    "warm-up": (
        lambda: counted("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz", **DIE),
        {"rows": 63792, "seconds": approx(2158, abs=0.5), "low_c": approx(10.38, abs=0.005),
         "high_c": approx(28.94, abs=0.005), "step_s": approx(0.017), "longest_step_s": approx(2.8, abs=0.05)},
    ),
    "worn": (
        lambda: counted("worn_lowback", "HA_001_Test11.csv.gz", **FACES, gyro_unit="dps", accel_unit="g",
                        sample_rate_hz=100.0),
        {"seconds": approx(137.0, abs=1.0)},
    ),
    "APDM": (
        lambda: read_record(data_path(WEARABLES, "opensim_apdm_imuData01.csv.gz"), ColumnMap(sensor="Static")),
        {"rows": 1024, "rate_hz": approx(128.0, abs=0.01)},
    ),
    "NGIMU": (
        lambda: read_record(data_path(WEARABLES, "ngimu")),
        {"rate_hz": approx(50.0, abs=0.2), "first_c": approx(37.1, abs=0.1), "force": approx(1.0, abs=0.02)},
    ),
    "x-IMU3": (
        lambda: read_record(data_path(WEARABLES, "ximu3")),
        {"first_c": approx(30.0, abs=0.1), "force": approx(1.0, abs=0.02)},
    ),
    "x-IMU": (
        lambda: read_record(data_path(WEARABLES, "ximu"), ColumnMap(sample_rate_hz=256.0)),
        {"rows": 12626, "first_c": approx(31.0, abs=0.1), "high_c": approx(31.9, abs=0.05), "force": approx(1.0, abs=0.02)},
    ),
    "ActiGraph": (
        lambda: read_record(data_path(WEARABLES, "agread_gt9x_example-IMU.csv.gz")),
        {"rows": 2300, "rate_hz": approx(100.0), "low_c": approx(51.6, abs=0.05), "high_c": approx(54.7, abs=0.05)},
    ),
    "Axivity": (
        lambda: read_npz(data_path(WEARABLES, "skdh_ax6_data.npz"), column_map(**AXIVITY)),
        {"rows": 10360, "seconds": approx(105.0, abs=0.5), "low_c": approx(28.0, abs=0.05), "high_c": approx(30.9, abs=0.05)},
    ),
}  # fmt: skip


def figures_of(record):
    temp_c, step_s = record.temp_c, np.diff(record.time)
    temperatures = {} if temp_c is None else {"low_c": temp_c.min(), "high_c": temp_c.max(), "first_c": temp_c[0]}
    return temperatures | {
        "rows": len(record),
        "seconds": record.duration_s,
        "rate_hz": record.sample_rate_hz,
        "force": np.median(size(record.accel)),
        "step_s": np.median(step_s),
        "longest_step_s": step_s.max(),
    }


@pytest.mark.parametrize(("read", "published"), PUBLISHED.values(), ids=PUBLISHED)
def test_recording_has_the_published_figures(read, published):
    figures = figures_of(read())
    show("figures", {name: figures[name] for name in published}, published)
    for name, value in published.items():
        assert figures[name] == value, name


@pytest.mark.parametrize(
    ("read", "mean_dps"),
    [
        (lambda: np.degrees(PUBLISHED["APDM"][0]().gyro), (0.25, 0.42, -0.47)),
        (lambda: PUBLISHED["ActiGraph"][0]().gyro, (-0.772, 0.245, 0.108)),
    ],
)
def test_resting_sensor_has_the_published_offset(read, mean_dps):
    assert read().mean(axis=0) == approx(mean_dps, abs=0.01)


def test_first_codes_of_a_session_are_the_published_ones():
    assert PUBLISHED["nilspod"][0]().gyro[0].tolist() == [-0.6103515625, -0.30517578125, 0.06103515625]
    codes = counted(
        "ferraris_nilspod",
        "annotated_session.csv",
        **FACES,
        gyro_unit="count",
        accel_unit="count",
        sample_rate_hz=102.4,
    )
    assert codes.accel[0].tolist() == [-2052, -28, -73]


@pytest.mark.slow
def test_drop_outs_of_a_warm_up_are_named():
    path = data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")
    die = PUBLISHED["warm-up"][0]()
    board = read_counted(path, column_map(**WARM_UP, temp="Temp ")).record
    assert np.median(die.temp_c - board.temp_c) == approx(0.95, abs=0.06)
    (lost,) = (item for item in describe(path, column_map(**DIE)).findings if item.code == "recording.uneven_sampling")
    assert lost.values["count"] == 378
    assert lost.values["longest_s"] == approx(2.835, abs=0.0005)


# ---- optics -------------------------------------------------------------------------------------------------------------

MARKERS = {  # file, frames, frames a second, markers
    "c3d/Eb015pi.c3d": (450, 50.0, 26),
    "c3d/dec_real.c3d": (89, 50.0, 36),
    "c3d/squat.c3d.gz": (2539, 120.0, 53),
    "mocap_sit_to_stand/STS1.trc.gz": (1399, 100.0, 51),
    "mocap_sit_to_stand/STSAsym1.trc.gz": (1345, 100.0, 51),
    "mocap_sit_to_stand/squats1.trc.gz": (1346, 100.0, 51),
    "mocap_sit_to_stand/static1.trc.gz": (517, 100.0, 55),
    "mocap_stair_up/markers_StairUp3.trc.gz": (440, None, 61),  # irregular headers
    "mocap_stair_up/markers.trc.gz": (281, None, None),
    "mocap_stair_up/markers_Squat2.trc.gz": (460, None, None),
    "posturography/BMC_static_run_10s_markers.trc.gz": (1500, 150.0, 78),
}


def markers_of(name, **keys):
    return (read_c3d if ".c3d" in name else read_trc)(data_path(*name.split("/")), **keys)


@pytest.mark.parametrize("name", MARKERS)
def test_markers_have_the_published_size(name):
    frames, rate_hz, count = MARKERS[name]
    markers = markers_of(name, **({} if name.startswith("c3d/") and "squat" not in name else {"up": "y"}))
    assert len(markers) == frames
    assert count is None or markers.points.shape == (frames, count, 3)
    assert rate_hz is None or markers.sample_rate_hz == approx(rate_hz, abs=0.01)


@pytest.mark.parametrize(("integer", "real"), [("Eb015pi", "Eb015pr"), ("dec_int", "dec_real")])
def test_integer_and_real_storage_read_equal(integer, real):
    one, other = (markers_of(f"c3d/{name}.c3d") for name in (integer, real))
    assert one.labels == other.labels
    np.testing.assert_array_equal(np.isnan(one.points), np.isnan(other.points))
    assert np.nanmax(np.abs(one.points - other.points)) < 2.5e-7  # m, single precision of a range of 2.5 m
    assert np.nanmax(other.points[..., 2]) < 2.5  # a person, z up


def test_lost_markers_are_gaps():
    lost = {name: np.isnan(markers_of(name, up="y").points).any() for name in MARKERS if "sit_to_stand" in name}
    assert [name for name, gaps in lost.items() if gaps] == ["mocap_sit_to_stand/STSAsym1.trc.gz"]
    # the head's back marker is written as 0, 0, 0 where it was lost
    head = markers_of("mocap_stair_up/markers_StairUp3.trc.gz", up="y").pick(["LBHD"])
    assert np.isnan(head[:, 0, 0]).sum() == 52


# ---- every file ---------------------------------------------------------------------------------------------------------

FORCES = ("PDS13", "BDS000")


def every_file():
    files = sorted(path for path in DATA.rglob("*") if path.is_file()) if DATA.is_dir() else []
    return [path for path in files if path.name != "GENEActiv_testfile.bin"]  # cut by its author


@pytest.mark.parametrize("path", every_file(), ids=lambda path: str(path.relative_to(DATA)))
def test_every_file_is_described_in_one_line(path):
    description = describe(path)
    print(f"  {description.kind}, {description.format}: {description.summary}")
    assert description.summary
    assert "\n" not in description.summary
    if description.kind in ("recording", "markers", "reference"):
        assert description.rows > 1
        assert description.sample_rate_hz > 1.0
    if path.name.startswith(FORCES):
        assert "other quantities" in description.summary
    if path.suffix == ".md" or path.name == "LICENSE":
        assert description.kind == "text"
