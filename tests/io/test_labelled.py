"""Tables that state their units themselves: preambles, unit rows, units in names, several sensors, and what is refused."""

import tomllib

import numpy as np
import pytest
from scipy.io import savemat

from testkit.column_maps import column_map
from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap, read_map
from undrift.io.formats import detect, iter_record, read_counted, read_record
from undrift.io.inspect import describe
from undrift.io.labelled import open_sheet
from undrift.io.labels import Label, label_of


def put(tmp_path, text, name="t.csv"):
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return tmp_path / name


@pytest.mark.parametrize(
    ("name", "unit", "label"),
    [
        ("A_X [mg]", "", Label("", "accel", "x", "mg")),
        ("M_Y [mG]", "", Label("", "mag", "y", "mgauss")),
        ("gyroY[mdps]", "", Label("", "gyro", "y", "dps", 1e-3)),
        ("Shimmer_40AC_Accel_WR_X_CAL", "m/(s^2)", Label("Shimmer 40AC WR", "accel", "x", "m/s2")),
        ("xsens_gyro_x (deg/s)", "", Label("xsens", "gyro", "x", "dps")),
        ("Pelvis Accel Sensor X,mG", "", Label("Pelvis", "accel", "x", "mg")),
        ("field x (nT)", "", Label("", "mag", "x", "ut", 1e-3)),
        ("Linear Acceleration x (m/s^2)", "", Label("", "free", "x", "m/s2")),
        ("acc_x_g", "", Label("", "accel", "x", "g")),
        ("Temperature (°C)", "", Label("", "temp", "", "degc")),
        ("time[ms]", "", Label("", "time", "", "ms")),
        ("acc_x", "", Label("", "accel", "x")),
        ("mag_x [count]", "", Label("", "mag", "x")),
        ("acc_x (rad/s)", "", None),
        ("Mat[1][1]", "", None),
    ],
)
def test_a_column_is_what_its_name_and_unit_say(name, unit, label):
    assert label_of(name, unit) == label


FLAVOURS = [(",", "."), ("\t", "."), (";", "."), ("\t", ","), (";", ",")]


@pytest.mark.parametrize(("delimiter", "decimal"), FLAVOURS)
def test_phyphox_reads_in_every_flavour_of_its_export(tmp_path, delimiter, decimal):
    names = ["Time (s)", *(f"Acceleration {x} (m/s^2)" for x in "xyz"), "Absolute acceleration (m/s^2)"]
    rows = [[f"{k}.5000000E-2", "-1.5E-1", "2.5E-2", "9.805E0", "9.806E0"] for k in range(9)]
    lines = [delimiter.join(f'"{name}"' for name in names)]
    lines += [delimiter.join(cell.replace(".", decimal) for cell in row) for row in rows]
    path = put(tmp_path, "\n".join(lines) + "\n")
    assert detect(path) == "labelled"
    record = read_record(path)
    np.testing.assert_allclose(record.accel, [[-0.15, 0.025, 9.805]] * 9)
    np.testing.assert_allclose(record.time, 0.005 + 0.01 * np.arange(9))
    assert (record.accel_unit, record.gyro) == ("m/s2", None)


def test_a_preamble_is_skipped_and_a_unit_row_is_used_and_both_are_stated(tmp_path):
    text = "Device: 17\nStart: 12:00\n\nt,wx,wy,wz,ax,ay,az,T\ns,deg/s,deg/s,deg/s,g,g,g,degC\n"
    path = put(tmp_path, text + "".join(f"{k / 50:.2f},1,2,3,0,0,1,25\n" for k in range(200)))
    read = read_counted(path)
    assert (read.record.gyro_unit, read.record.accel_unit, read.record.sample_rate_hz) == (
        "dps",
        "g",
        pytest.approx(50.0),
    )
    np.testing.assert_allclose(read.record.temp_c, 25.0)
    assert read.notes == ("lines before the header skipped: 2", "units from the row under the header")
    found = describe(path)
    assert (found.kind, found.rows) == ("recording", 200)
    assert [item.text for item in found.findings[:2]] == list(read.notes)
    assert not any("header" in problem for problem in found.problems)


def test_a_clock_since_1970_starts_at_zero(tmp_path):
    rows = "".join(f"{1700000000000 + 20 * k},0,0,1\n" for k in range(4))
    record = read_record(put(tmp_path, f"time (ms),ax (g),ay (g),az (g)\n{rows}"))
    np.testing.assert_allclose(record.time, [0.0, 0.02, 0.04, 0.06], atol=1e-9)


def test_several_sensors_in_one_table_ask_for_one_and_share_no_channel(tmp_path):
    names = [
        f"{place}_{kind}_{x} ({unit})"
        for place in ("left", "right")
        for kind, unit in (("acc", "g"), ("gyr", "dps"))
        for x in "xyz"
    ]
    path = put(
        tmp_path, ",".join(["t (s)", *names]) + "\n" + "".join(f"{k},0,0,1,5,5,5,0,1,0,7,7,7\n" for k in range(4))
    )
    with pytest.raises(InputError, match="The file contains left, right"):
        read_record(path)
    right = read_record(path, ColumnMap(sensor="right"))
    assert (right.accel[0].tolist(), right.gyro[0].tolist(), right.device) == (
        [0.0, 1.0, 0.0],
        [7.0, 7.0, 7.0],
        "right",
    )


# ---- what is proposed for a table that states too little

PROPOSED = [
    ("multipos_mpu9150/imu0.log.gz", {"accel": "m/s2", "gyro": "rad/s"}, "gyro by the largest rate 5.268"),
    ("multipos_xsens/xsens_gyro.txt.gz", {"time": "s", "gyro": "count"}, "gyro by whole numbers up to 4.855e+04"),
    ("multipos_xsens/xsens_acc.txt.gz", {"time": "s", "accel": "count"}, "accel by the median |a| 5.745e+04"),
    ("ferraris_nilspod/example_ferraris_session.csv", {"gyro": "dps", "accel": "m/s2"}, "gyro by the largest rate 895.3"),
    ("ferraris_nilspod/annotated_session.csv", {"gyro": "count", "accel": "count"}, "accel by the median |a| 2060"),
    (
        "thermal_bmi270_two_point/BMI_270_cold_test.csv.gz", {"temp": "degC", "accel": "?", "gyro": "?"},
        "temp by the median 13.06",
    ),
    (
        "thermal_mpu6050_warmup/Tempdata01-02-14.csv.gz", {"time": "ms", "gyro": "count", "accel": "count", "temp": "degC"},
        "time by the median step 17",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "units", "why"), PROPOSED, ids=[name for name, *_ in PROPOSED])
def test_units_of_the_public_recordings_are_proposed_with_the_figure_that_suggests_them(name, units, why):
    line = describe(data_path(*name.split("/"))).example[1]
    assert tomllib.loads(line)["units"] == units
    assert why in line.partition("  # proposed: ")[2]


def test_a_file_of_a_gyroscope_is_never_proposed_as_an_accelerometer(tmp_path):
    rows = "".join(f"{k / 100} 0 0.2 9.8\n" for k in range(9))
    assert describe(put(tmp_path, rows, "xsens_gyro.txt")).example[0] == "columns = { time = 0, gyro = [1, 2, 3] }"
    assert describe(put(tmp_path, rows, "xsens_acc.txt")).example[0] == "columns = { time = 0, accel = [1, 2, 3] }"
    named = put(tmp_path, "t,x,y,z\n" + rows.replace(" ", ","), "xsens_gyro.csv")
    assert describe(named).example[0] == 'columns = { time = "t", gyro = ["x", "y", "z"] }'


def test_neither_a_counter_nor_a_slow_gyroscope_gets_a_unit(tmp_path):
    rows = "".join(f"{k},0.01,0.{k % 7}2,9.8,{k % 5}.5,0.25,3\n" for k in range(300))
    example = describe(put(tmp_path, f"time,ax,ay,az,gx,gy,gz\n{rows}")).example
    assert tomllib.loads(example[1])["units"] == {"time": "?", "gyro": "?", "accel": "m/s2"}


def test_the_sample_rate_of_a_line_before_the_header_or_of_an_array_is_proposed(tmp_path):
    example = describe(data_path("static_mpu6050", "example_data_tinit_calc.csv.gz")).example
    assert 'sample_rate_hz = 100  # by the line "Fs,100"' in example
    savemat(tmp_path / "a.mat", {"acc": np.ones((9, 3)), "fs": np.array([102.4])})
    assert "sample_rate_hz = 102.4  # by fs" in describe(tmp_path / "a.mat").example


# ---- dates


@pytest.mark.parametrize(
    "stamps",
    [
        ["2026-01-31 23:59:59.990", "2026-02-01 00:00:00.000", "2026-02-01 00:00:00.010"],
        ["2026-01-31T23:59:59.990Z", "2026-02-01T00:00:00.000Z", "2026-02-01T00:00:00.010Z"],
        ["2026/1/31 23:59:59:990", "2026/2/1 00:00:00:000", "2026/2/1 00:00:00:010"],
        ["2026-01-31 23:59:59.990+01:00", "2026-02-01 00:00:00.000+01:00", "2026-02-01 00:00:00.010+01:00"],
    ],
)
def test_dates_are_seconds_from_the_first(tmp_path, stamps):
    rows = "".join(f"{stamp},0,0,1\n" for stamp in stamps)
    stated = read_record(put(tmp_path, f"timestamp,ax (g),ay (g),az (g)\n{rows}"))
    np.testing.assert_allclose(stated.time, [0.0, 0.01, 0.02], atol=1e-9)
    bare = put(tmp_path, f"when,ax,ay,az\n{rows}", "bare.csv")
    columns = column_map(time="when", time_unit="date", accel=("ax", "ay", "az"), accel_unit="g")
    np.testing.assert_allclose(read_record(bare, columns).time, [0.0, 0.01, 0.02], atol=1e-9)
    assert np.concatenate([part.time for part in iter_record(bare, columns, rows=2)]).tolist() == stated.time.tolist()


def test_a_table_that_states_one_unit_of_two_is_not_read_by_halves(tmp_path):
    rows = "".join(f"{k / 100},0,0,9.8,1,2,3\n" for k in range(4))
    path = put(tmp_path, f"time (s),ax,ay,az,gx (dps),gy (dps),gz (dps)\n{rows}")
    assert detect(path) == "csv"
    assert tomllib.loads(describe(path).example[1])["units"] == {"time": "s", "gyro": "dps", "accel": "m/s2"}


@pytest.mark.parametrize("delimiter", [";", "\t"])
@pytest.mark.parametrize("header", ["time,ax,ay,az,gx,gy,gz", ""])
def test_a_decimal_comma_is_seen_and_stands_in_the_proposed_map(tmp_path, delimiter, header):
    rows = "".join(f"{k / 100:.2f},0.12,0.21,9.79,{40.5 * np.sin(k)},1.5,2.5\n" for k in range(99))
    text = "".join([header, "\n"][: 2 * bool(header)]).replace(",", delimiter) + rows.replace(",", delimiter).replace(
        ".", ","
    )
    example = describe(put(tmp_path, text)).example
    assert 'decimal = ","' in example
    assert tomllib.loads(example[1])["units"] == {"time": "s", "gyro": "dps", "accel": "m/s2"}
    put(tmp_path, "\n".join(example), "map.toml")
    record = read_record(tmp_path / "t.csv", read_map(tmp_path / "map.toml"))
    assert (record.accel[0].tolist(), record.sample_rate_hz) == ([0.12, 0.21, 9.79], pytest.approx(100.0))


def test_a_header_with_fewer_names_than_columns_is_refused(tmp_path):
    rows = "".join(f"{k},{k}.5,1,2,3\n" for k in range(4))
    path = put(tmp_path, "n and t (s),gyro x (dps),gyro y (dps),gyro z (dps)\n" + rows)
    with pytest.raises(FileFormatError, match="expected a name for each of 5 columns, got fewer"):
        open_sheet(path)


def test_a_channel_of_which_an_axis_is_not_named_is_left_out_with_a_note(tmp_path):
    rows = "".join(f"{k / 100},1,2,3,0,0,1\n" for k in range(4))
    path = put(tmp_path, "t (s),gyro x (dps),gyro ? (dps),gyro z (dps),acc x (g),acc y (g),acc z (g)\n" + rows)
    assert "turn rate left out: it has only axes x, z" in read_counted(path).notes
