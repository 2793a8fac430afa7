"""Calibrations of other programs and devices: what export writes is read back; a Shimmer's dump by its firmware's layout."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

import undrift
from testkit.full_calibration import device, tables
from undrift.errors import FileFormatError, InputError
from undrift.export.autopilots import export_ardupilot, export_px4
from undrift.export.programs import export_fusion, export_imucal
from undrift.io.inspect import describe
from undrift.io.store import read_calibration
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY

GAIN, OFFSET = np.diag([1.01, 0.99, 1.02]), np.array([0.11, -0.07, 0.05])


def read(tmp_path, content, name="other.param"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    made = read_calibration(path)
    assert describe(path).kind == "calibration"
    assert made.verdict.status == "marginal"
    for triad in (made.gyro, made.accel):
        assert triad is None or np.isnan(triad.covariance).all()
    return made


def codes(made):
    return [one.code for one in made.verdict.findings]


def in_si(**changes):
    made = device(unit="si", g=False, **changes)
    gyro = replace(made.gyro, matrix=np.eye(3), offset=OFFSET / 10.0)
    return replace(made, gyro=gyro, accel=replace(made.accel, matrix=GAIN, offset=OFFSET))


@pytest.mark.parametrize(("export", "program"), [(export_px4, "PX4"), (export_ardupilot, "ArduPilot")])
def test_parameters_of_an_autopilot_are_read_back(tmp_path, export, program):
    made = in_si()
    back = read(tmp_path, export(made).text)
    assert (back.accel.method, back.gyro.unit_in, back.accel.unit_in) == (f"imported/{program}", "rad/s", "m/s2")
    for triad in ("gyro", "accel"):
        np.testing.assert_allclose(getattr(back, triad).matrix, getattr(made, triad).matrix, rtol=1e-6)
        np.testing.assert_allclose(getattr(back, triad).offset, getattr(made, triad).offset, rtol=1e-6)
    assert codes(back) == ["imported.uncertainty"]


@pytest.mark.parametrize("export", [export_px4, export_ardupilot])
def test_offsets_of_a_table_are_those_of_the_temperature_that_the_parameters_name(tmp_path, export):
    drift = tables(scale=None, dynamic=None)
    made = in_si(drift=replace(drift, static=replace(drift.static, gyro_offset=drift.static.gyro_offset * 1e-4)))
    back = read(tmp_path, export(made).text)
    at = np.array([np.interp(back.reference_temp_c, drift.static.temp_c, c) for c in drift.static.gyro_offset.T * 1e-4])
    assert codes(back) == ["imported.uncertainty", "imported.temperature"]
    assert np.abs(back.gyro.offset - made.gyro.offset - at).max() < 4.0 * np.std(
        drift.static.gyro_offset * 1e-4
    )  # a cubic


def test_a_board_of_several_sensors_names_the_one_that_was_taken(tmp_path):
    more = (
        export_px4(in_si()).text
        + "1\t1\tCAL_ACC1_XOFF\t0.3\t9\n1\t1\tCAL_GYRO2_ZOFF\t0.01\t9\n1\t1\tCAL_ACC3_XOFF\t0.0\t9\n"
    )
    back = read(tmp_path, more)
    assert codes(back) == ["imported.uncertainty", "imported.sensor"]
    assert "first of 3 sensors" in back.verdict.findings[1].text
    assert codes(read(tmp_path, export_ardupilot(in_si()).text + "INS_ACC2OFFS_Y,0.2\n"))[1:] == ["imported.sensor"]


# Where the sensor's x, y and z point in the airframe: what the names of MAVLink's list say, turned by hand
@pytest.mark.parametrize(
    ("program", "number", "x", "y", "z"),
    [
        ("PX4", 2, "+y", "-x", "+z"),  # yaw 90
        ("PX4", 8, "+x", "-y", "-z"),  # roll 180
        ("PX4", 12, "-x", "+y", "-z"),  # pitch 180
        ("PX4", 14, "-y", "-x", "-z"),  # roll 180, yaw 270
        ("PX4", 18, "+y", "+z", "+x"),  # roll 90, yaw 90
        ("PX4", 20, "+x", "-z", "+y"),  # roll 270
        ("PX4", 24, "-z", "+y", "+x"),  # pitch 90
        ("PX4", 28, "-z", "+x", "-y"),  # roll 90, pitch 90
        ("PX4", 35, "+z", "+x", "+y"),  # roll 270, pitch 270
        ("PX4", 36, "-y", "-z", "+x"),  # roll 90, pitch 180, yaw 90
        ("PX4", 43, "-z", "-y", "-x"),  # pitch 90, yaw 180
        ("ArduPilot", 2, "+y", "-x", "+z"),
        ("ArduPilot", 37, "-y", "+z", "-x"),  # roll 90, yaw 270
    ],
)
def test_the_rotation_of_the_sensor_turns_readings_to_the_airframe(tmp_path, program, number, x, y, z):
    export, name = {
        "PX4": (export_px4, "SENS_BOARD_ROT"), "ArduPilot": (export_ardupilot, "AHRS_ORIENTATION")
    }[program]  # fmt: skip
    plain = export(in_si()).text
    row = f"1\t1\t{name}\t{number}\t6\n" if program == "PX4" else f"{name},{number}\n"
    back, before = read(tmp_path, plain + row), read(tmp_path, plain)
    axes = np.array([[(1.0 if way[0] == "+" else -1.0) * (way[1] == axis) for way in (x, y, z)] for axis in "xyz"])
    np.testing.assert_allclose(back.accel.matrix, axes @ before.accel.matrix, atol=1e-12)
    np.testing.assert_allclose(back.gyro.matrix, axes @ before.gyro.matrix, atol=1e-12)
    np.testing.assert_array_equal(back.accel.offset, before.accel.offset)


def test_an_external_sensor_has_a_rotation_of_its_own_and_the_board_is_levelled(tmp_path):
    rows = "CAL_ACC0_XOFF,0.1\nCAL_ACC0_ROT,{}\nCAL_GYRO0_ROT,4\nSENS_BOARD_ROT,8\nSENS_BOARD_X_OFF,{}\n"
    back = read(tmp_path, rows.format(-1, 0))  # -1: internal, as the board
    np.testing.assert_allclose(back.accel.matrix, np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(back.gyro.matrix, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    back, sine = read(tmp_path, rows.format(0, 2.0)), np.sin(np.radians(2.0))
    np.testing.assert_allclose(back.accel.matrix[1:, 1], [np.sqrt(1.0 - sine**2), sine])


def test_turns_by_45_deg_come_in_order_and_all_are_rotations(tmp_path):
    for number in (*range(38), 39, 40, *range(41, 48)):
        turned = read(tmp_path, f"CAL_ACC0_XOFF,0.1\nSENS_BOARD_ROT,{number}\n").gyro.matrix
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turned) > 0.0
        if number < 8:
            np.testing.assert_allclose(
                turned[:2, 0], [np.cos(number * np.pi / 4), np.sin(number * np.pi / 4)], atol=1e-12
            )


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("CAL_ACC0_XOFF,0.1\nSENS_BOARD_ROT,38\n", "PX4 .* SENS_BOARD_ROT 38"),
        ("CAL_ACC0_XOFF,0.1\nCAL_GYRO0_ROT,48\n", "PX4 .* CAL_GYRO0_ROT 48"),
        ("INS_ACCOFFS_X,0.1\nAHRS_ORIENTATION,101\n", "ArduPilot .* AHRS_ORIENTATION 101"),
    ],
)
def test_rotations_whose_angles_are_not_listed_are_refused_with_the_mend(tmp_path, text, name):
    with pytest.raises(FileFormatError, match=name + "; set it to 0 in a copy of the file"):
        read(tmp_path, text)


def test_offsets_whose_temperature_is_not_known_are_refused(tmp_path):
    for text, got in (
        ("TC_G_ENABLE,1\nCAL_GYRO0_XOFF,0.1\n", "wanted TC_G0_TREF, where the offsets hold, got none"),
        ("INS_TCAL1_ENABLE,1\nINS_GYR1_CALTEMP,-300\nINS_GYROFFS_X,0.1\n", "wanted INS_GYR1_CALTEMP.*got -300 degC"),
    ):
        (tmp_path / "p.param").write_text(text)
        with pytest.raises(FileFormatError, match=got):
            read_calibration(tmp_path / "p.param")


def test_printed_parameters_of_a_shell_are_read(tmp_path):
    shell = (
        "Symbols: x = used, + = saved\nx + CAL_ACC0_XOFF [110,402] : 0.2500\nx + CAL_ACC0_ZSCALE [118,410] : 1.0100\n"
    )
    back = read(tmp_path, shell, "params.txt")
    assert back.accel.offset.tolist() == [0.25, 0.0, 0.0]
    assert np.diag(back.accel.matrix).tolist() == [1.0, 1.0, 1.01]


def test_fusion_in_c_and_settings_of_an_x_imu3_are_read(tmp_path):
    made = device(g=False)
    back = read(tmp_path, export_fusion(made).text, "calibration.h")
    assert (back.gyro.unit_in, back.accel.unit_in) == ("count", "count")
    for triad in ("gyro", "accel"):
        np.testing.assert_allclose(getattr(back, triad).matrix, getattr(made, triad).matrix, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(getattr(back, triad).offset, getattr(made, triad).offset, rtol=1e-6)
    settings = {
        "gyroscopeMisalignment": np.eye(3).ravel().tolist(),
        "gyroscopeSensitivity": [1.0, 1.0, 1.25],
        "gyroscopeOffset": [0.5, 0.0, -1e-1],
        "accelerometerOffset": [0.0, 0.0, 0.01],
    }
    back = read(tmp_path, json.dumps(settings), "settings.json")
    assert (back.gyro.unit_in, back.accel.unit_in) == ("dps", "g")
    np.testing.assert_allclose(back.gyro.matrix, np.diag([1.0, 1.0, 1.25]) * DPS)
    np.testing.assert_allclose(back.accel.matrix, np.eye(3) * STANDARD_GRAVITY)
    with pytest.raises(FileFormatError, match="gyroscope sensitivity: wanted 3 numbers, got 2; write the file anew"):
        read(tmp_path, json.dumps(settings | {"gyroscopeSensitivity": [1.0, 1.0]}), "settings.json")


def test_imucal_is_read_wherever_a_calibration_is(tmp_path):
    made = device(g=False)
    back = read(tmp_path, export_imucal(made).text, "imucal.json")
    np.testing.assert_allclose(back.gyro.matrix, made.gyro.matrix, rtol=1e-9)


def entry(sensor, which, stamp, offset, gain, axes=(100, 0, 0, 0, 100, 0, 0, 0, 100)):
    held = struct.pack(">6h9b", *offset, *gain, *axes)
    return struct.pack("<HBBQ", sensor, which, len(held), stamp) + held


def dump(*entries):
    body = struct.pack("<HHHBB", 3, 2, 0, 13, 7) + b"".join(entries)
    return struct.pack("<H", len(body)) + body


GYRO, LOW_NOISE, WIDE, PRESSURE = 30, 2, 31, 36


def test_the_dump_of_a_shimmer_is_read_by_the_layout_of_its_firmware(tmp_path):
    axes = (0, -100, 0, -100, 2, 0, 0, 0, -100)
    made = read(
        tmp_path,
        dump(
            entry(LOW_NOISE, 0, 5, (2047, 2047, 2040), (83, 83, 92), axes),
            entry(GYRO, 0, 0, (0, 0, 0), (13100, 13100, 13100)),
            entry(GYRO, 1, 9, (12, -7, 3), (6550, 6600, 6550), axes),
            entry(WIDE, 0, 0, (0, 0, 0), (1631, 1631, 1631)),
        ),
        "calib_36ad",
    )
    forward = np.diag([83.0, 83.0, 92.0]) @ np.array(axes).reshape(3, 3) / 100.0
    counts = forward @ [0.3, -0.2, 9.8] + [2047, 2047, 2040]
    np.testing.assert_allclose(made.accel.matrix @ (counts - made.accel.offset), [0.3, -0.2, 9.8])
    forward = np.diag([65.5, 66.0, 65.5]) @ np.array(axes).reshape(3, 3) / 100.0  # counts per deg/s
    counts = forward @ [10.0, 20.0, -30.0] + [12, -7, 3]
    np.testing.assert_allclose(made.gyro.matrix @ (counts - made.gyro.offset) / DPS, [10.0, 20.0, -30.0])
    assert (made.gyro.unit_in, made.accel.unit_in, made.device) == ("count", "count", "calib_36ad")
    assert codes(made) == ["imported.uncertainty", "imported.range"]
    assert "range 1" in made.verdict.findings[1].text


def test_a_dump_of_defaults_alone_is_refused_and_a_cut_one_is_none(tmp_path):
    defaults = dump(*(entry(GYRO, k, 0, (0, 0, 0), (13100, 13100, 13100)) for k in range(4)))
    (tmp_path / "calib").write_bytes(defaults)
    with pytest.raises(FileFormatError, match=r"calib: wanted a range that was calibrated, got defaults of 4 ranges"):
        read_calibration(tmp_path / "calib")
    (tmp_path / "calib").write_bytes(defaults[:-5])
    with pytest.raises(FileFormatError, match="wanted JSON"):
        read_calibration(tmp_path / "calib")
    flat = dump(entry(GYRO, 1, 3, (0, 0, 0), (13100, 0, 13100)))
    (tmp_path / "calib").write_bytes(flat)
    with pytest.raises(FileFormatError, match="wanted gains and axes that have an inverse"):
        read_calibration(tmp_path / "calib")


def test_an_imported_calibration_corrects_and_gets_no_certificate(tmp_path):
    (tmp_path / "px4.params").write_text(export_px4(in_si()).text)
    rate = 100.0
    still = np.tile([0.0, 0.0, 9.81], (400, 1)) @ np.linalg.inv(GAIN) + OFFSET
    record = Record(time=np.arange(400) / rate, gyro=np.tile(OFFSET / 10.0, (400, 1)), accel=still)
    back = undrift.correct(record, read_calibration(tmp_path / "px4.params"))
    np.testing.assert_allclose(back.accel, np.tile([0.0, 0.0, 9.81], (400, 1)), atol=1e-5)
    np.testing.assert_allclose(back.gyro, 0.0, atol=1e-8)
    with pytest.raises(InputError, match="wanted"):
        undrift.certificate(tmp_path / "px4.params", output=tmp_path / "c.pdf")
    assert not (tmp_path / "c.pdf").exists()
