"""Wearable formats in their text form: written small, read back, and refused when they are something else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.strategies import few, one_line
from undrift.errors import FileFormatError, InputError
from undrift.io.columns import ReadSettings
from undrift.io.makers import DIALECTS, apdm_sensors, read_apdm


def csv(header, rows):
    return "\n".join([",".join(header), *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def apdm(sensors, n=6, rate="128", temp=True):
    kinds = [("Acceleration", "m/s^2"), ("Angular Velocity", "rad/s"), ("Magnetic Field", "uT")]
    names = [f"{s}/{kind}/{axis}" for s in sensors for kind, _ in kinds for axis in "XYZ"]
    units = [unit for _ in sensors for _, unit in kinds for _ in "XYZ"]
    if temp:
        names += [f"{s}/Temperature/Scalar" for s in sensors]
        units += ["deg C"] * len(sensors)
    values = np.arange(n * len(names)).reshape(n, len(names)) * 0.01
    rows = [",".join([repr(k / 128), *map(repr, map(float, values[k]))]) for k in range(n)]
    head = ["Test Name:,x", f"Sample Rate:,{rate},Hz", ",".join(["Time", *names]), ",".join(["s", *units])]
    return "\n".join([*head, *rows]) + "\n", values


@few
@given(n=st.integers(2, 20), sensors=st.sets(st.sampled_from(["Static", "Upper", "L5 a"]), min_size=1))
def test_each_apdm_sensor_gets_its_own_columns(tmp_path_factory, n, sensors):
    path = tmp_path_factory.mktemp("apdm") / "a.csv"
    text, values = apdm(sorted(sensors), n)
    path.write_text(text)
    assert apdm_sensors(path) == tuple(sorted(sensors))
    for k, sensor in enumerate(sorted(sensors)):
        record = read_apdm(path, sensor)
        np.testing.assert_array_equal(record.accel, values[:, 9 * k : 9 * k + 3])
        np.testing.assert_array_equal(record.gyro, values[:, 9 * k + 3 : 9 * k + 6])
        np.testing.assert_array_equal(record.mag_ut, values[:, 9 * k + 6 : 9 * k + 9])
        np.testing.assert_array_equal(record.temp_c, values[:, 9 * len(sensors) + k])
        assert (record.gyro_unit, record.accel_unit, record.device) == ("rad/s", "m/s2", sensor)


def test_an_apdm_file_of_several_sensors_lists_them_when_none_is_named(tmp_path):
    (tmp_path / "a.csv").write_text(apdm(["Upper", "Lower"])[0])
    with pytest.raises(
        InputError, match="wanted the name of one sensor, got a file with Upper, Lower; name one of them"
    ):
        read_apdm(tmp_path / "a.csv")
    with pytest.raises(InputError, match="wanted sensor 'Middle', got a file with Upper, Lower"):
        read_apdm(tmp_path / "a.csv", "Middle")
    (tmp_path / "one.csv").write_text(apdm(["Upper"], temp=False)[0])
    assert read_apdm(tmp_path / "one.csv").temp_c is None


def test_apdm_files_that_are_not_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("\n".join(apdm(["Upper"])[0].split("\n")[:3]))
    with pytest.raises(FileFormatError, match="wanted a row of units under the header, got the end of the file"):
        read_apdm(tmp_path / "a.csv", "Upper")
    (tmp_path / "a.csv").write_text("a,b\n1,2\n3,4\n5,6\n")
    with pytest.raises(FileFormatError, match="wanted an APDM header in line 3"):
        apdm_sensors(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(apdm(["U"], rate="fast")[0])
    with pytest.raises(FileFormatError, match="wanted 'Sample Rate:,128,Hz' in line 2"):
        read_apdm(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text(apdm(["U"], rate="64")[0])
    with pytest.raises(InputError, match="wanted 64 Hz as stated, got 128 Hz"):
        read_apdm(tmp_path / "c.csv")


def test_an_apdm_header_without_one_axis_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text(apdm(["Upper"])[0].replace("Velocity/Y", "Velocitx/Y"))
    with pytest.raises(FileFormatError, match="wanted all axes of Upper/Angular Velocity, got some; repair the header"):
        read_apdm(tmp_path / "a.csv")


def test_an_apdm_row_of_units_that_ends_early_names_the_column_without_one(tmp_path):
    lines = apdm(["Upper", "Lower"], temp=False)[0].split("\n")
    cells = lines[2].split(",")
    lines[3] = ",".join(lines[3].split(",")[: cells.index("Lower/Angular Velocity/X")])
    (tmp_path / "a.csv").write_text("\n".join(lines))
    with pytest.raises(FileFormatError, match="wanted the unit of Lower/Angular Velocity/X in line 4, got none"):
        read_apdm(tmp_path / "a.csv", "Lower")
    assert len(read_apdm(tmp_path / "a.csv", "Upper")) == 6


GYRO = [f"Gyroscope {a} (deg/s)" for a in "XYZ"]
ACCEL = [f"Accelerometer {a} (g)" for a in "XYZ"]


@few
@given(n=st.integers(2, 40), start=st.floats(-5.0, 5.0), count=st.integers(1, 5))
def test_temperature_of_its_own_rate_is_interpolated_and_held_at_the_ends(tmp_path_factory, n, start, count):
    folder = tmp_path_factory.mktemp("ngimu")
    rng = np.random.default_rng(n)
    time, values = np.arange(n) * 0.02, rng.normal(size=(n, 10))
    header = ["Time (s)", *GYRO, *ACCEL, *(f"Magnetometer {a} (uT)" for a in "XYZ"), "Barometer (hPa)"]
    (folder / "sensors.csv").write_text(csv(header, np.column_stack((time, values))))
    clock, temp = start + np.arange(count), 30.0 + np.arange(count)
    names = ["Time (s)", "Processor (degC)", "Gyroscope And Accelerometer (degC)", "Environmental Sensor (degC)"]
    (folder / "temperature.csv").write_text(csv(names, np.column_stack((clock, temp + 20, temp, temp - 5))))
    record = DIALECTS["ngimu"].read(folder).record
    np.testing.assert_array_equal(record.gyro, values[:, :3])
    np.testing.assert_array_equal(record.accel, values[:, 3:6])
    np.testing.assert_array_equal(record.mag_ut, values[:, 6:9])
    np.testing.assert_allclose(record.temp_c, np.interp(time, clock, temp))
    assert len(DIALECTS["ngimu"].read(folder / "sensors.csv").record) == n


def test_ngimu_reads_without_a_temperature_file_and_refuses_other_folders(tmp_path):
    with pytest.raises(InputError, match=r"wanted a folder with sensors.csv, got none there"):
        DIALECTS["ngimu"].read(tmp_path)
    (tmp_path / "sensors.csv").write_text("Time,W\n0,1\n1,1\n")
    with pytest.raises(FileFormatError, match=r"wanted column 'Time \(s\)', got Time, W; not the expected format"):
        DIALECTS["ngimu"].read(tmp_path)
    header = ["Time (s)", *GYRO, *ACCEL, *(f"Magnetometer {a} (uT)" for a in "XYZ")]
    (tmp_path / "sensors.csv").write_text(csv(header, np.column_stack((np.arange(3), np.ones((3, 9))))))
    assert DIALECTS["ngimu"].read(tmp_path).record.temp_c is None
    (tmp_path / "temperature.csv").write_text("Time (s),Gyroscope And Accelerometer (degC)\n")
    with pytest.raises(InputError, match="temperature: wanted one reading or more, got none"):
        DIALECTS["ngimu"].read(tmp_path)


def test_ximu3_microseconds_become_seconds(tmp_path):
    values = np.random.default_rng(2).normal(size=(5, 6))
    clock = 392_093_562 + 20_000 * np.arange(5)
    (tmp_path / "Inertial.csv").write_text(csv(["Timestamp (us)", *GYRO, *ACCEL], np.column_stack((clock, values))))
    assert DIALECTS["ximu3"].read(tmp_path).record.temp_c is None
    (tmp_path / "Temperature.csv").write_text("Timestamp (us),Temperature (degC)\n392093562,30\n392173562,34\n")
    record = DIALECTS["ximu3"].read(tmp_path).record
    np.testing.assert_allclose(record.time, clock * 1e-6)
    np.testing.assert_allclose(record.temp_c, [30, 31, 32, 33, 34], atol=1e-6)
    np.testing.assert_array_equal(record.gyro, values[:, :3])


def test_ximu_packets_place_the_temperature_and_the_rate_is_stated(tmp_path):
    values = np.random.default_rng(2).normal(size=(5, 9))
    header = ["Packet number", *GYRO, *ACCEL, *(f"Magnetometer {a} (G)" for a in "XYZ")]
    (tmp_path / "7_CalInertialAndMag.csv").write_text(csv(header, np.column_stack((10 + 2 * np.arange(5), values))))
    (tmp_path / "7_CalBattAndTherm.csv").write_text(
        "Packet number,Battery voltage (V),Thermometer (degrees C)\n10,4,30\n18,4,34\n"
    )
    record = DIALECTS["ximu"].read(tmp_path, settings=ReadSettings(sample_rate_hz=256.0)).record
    np.testing.assert_allclose(record.temp_c, [30, 31, 32, 33, 34])
    np.testing.assert_allclose(record.mag_ut, values[:, 6:] * 100)
    assert record.sample_rate_hz == pytest.approx(256.0)
    (tmp_path / "8_CalInertialAndMag.csv").write_text("x")
    with pytest.raises(InputError, match=r"wanted one \*_CalInertialAndMag.csv, got 7_CalInertialAndMag.csv, 8_Cal"):
        DIALECTS["ximu"].read(tmp_path, settings=ReadSettings(sample_rate_hz=256.0))


def actigraph(n=5, rate=100, clock=None):
    head = [f"--- Data File Created By ActiGraph Link at {rate} Hz ---", "Serial Number: TAS1E31150129", *["-"] * 8]
    names = [f"{kind} {a}" for kind in ("Accelerometer", "Gyroscope", "Magnetometer") for a in "XYZ"]
    values = np.random.default_rng(4).normal(size=(n, 10))
    stamps = clock or [f"2019-02-14T08:58:{k / 100:010.7f}" for k in range(n)]
    rows = [",".join([stamps[k], *map(repr, map(float, values[k]))]) for k in range(n)]
    return "\n".join([*head, ",".join(["Timestamp", *names, "Temperature"]), *rows]) + "\n", values


def test_actigraph_timestamps_become_seconds_and_the_serial_is_the_device(tmp_path):
    text, values = actigraph(250)
    (tmp_path / "a.csv").write_text(text)
    record = DIALECTS["actigraph"].read(tmp_path / "a.csv").record
    np.testing.assert_allclose(record.time, np.arange(250) / 100, atol=1e-9)
    np.testing.assert_array_equal(record.accel, values[:, :3])
    np.testing.assert_array_equal(record.gyro, values[:, 3:6])
    np.testing.assert_array_equal(record.temp_c, values[:, 9])
    assert (record.device, record.gyro_unit, record.accel_unit) == ("TAS1E31150129", "dps", "g")


def test_actigraph_files_that_are_not_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n" * 20)
    with pytest.raises(
        FileFormatError, match="wanted column 'Timestamp', got a, b; not the expected format of ActiGraph"
    ) as caught:
        DIALECTS["actigraph"].read(tmp_path / "a.csv")
    one_line(caught)
    (tmp_path / "b.csv").write_text(actigraph(2, clock=["noon", "later"])[0])
    with pytest.raises(FileFormatError, match=r"column 'Timestamp': wanted dates such as .*, got 'noon'"):
        DIALECTS["actigraph"].read(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text(actigraph(50, rate=30)[0])
    with pytest.raises(InputError, match="wanted 30 Hz as stated, got 100 Hz"):
        DIALECTS["actigraph"].read(tmp_path / "c.csv")
