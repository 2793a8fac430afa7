"""Wearable formats in their text form: written small and read back."""

import numpy as np
import pytest

from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap
from undrift.io.dialects import dialects
from undrift.io.formats import detect, read_record

GYRO = [f"Gyroscope {a} (deg/s)" for a in "XYZ"]
ACCEL = [f"Accelerometer {a} (g)" for a in "XYZ"]


def csv(header, rows):
    return "\n".join([",".join(header), *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def apdm(sensors, n=6, rate="128"):
    kinds = [("Acceleration", "m/s^2"), ("Angular Velocity", "rad/s"), ("Magnetic Field", "uT")]
    names = [f"{s}/{kind}/{axis}" for s in sensors for kind, _ in kinds for axis in "XYZ"]
    units = [unit for _ in sensors for _, unit in kinds for _ in "XYZ"]
    names += [f"{s}/Temperature/Scalar" for s in sensors]
    units += ["deg C"] * len(sensors)
    values = np.arange(n * len(names)).reshape(n, len(names)) * 0.01 + 1.0
    rows = [",".join([repr(k / 128), *map(repr, map(float, values[k]))]) for k in range(n)]
    head = ["Test Name:,x", f"Sample Rate:,{rate},Hz", ",".join(["Time", *names]), ",".join(["s", *units])]
    return "\n".join([*head, *rows]) + "\n", values


@pytest.mark.parametrize("sensors", [["Static"], ["Static", "Upper", "L5 left"]])
def test_each_apdm_sensor_has_its_own_columns(tmp_path, sensors):
    text, values = apdm(sensors)
    (tmp_path / "a.csv").write_text(text)
    assert detect(tmp_path / "a.csv") == "apdm"
    for k, sensor in enumerate(sensors):
        record = read_record(tmp_path / "a.csv", ColumnMap(sensor=sensor))
        np.testing.assert_array_equal(record.accel, values[:, 9 * k : 9 * k + 3])
        np.testing.assert_array_equal(record.gyro, values[:, 9 * k + 3 : 9 * k + 6])
        np.testing.assert_array_equal(record.mag_ut, values[:, 9 * k + 6 : 9 * k + 9])
        np.testing.assert_array_equal(record.temp_c, values[:, 9 * len(sensors) + k])
        assert (record.gyro_unit, record.accel_unit, record.device) == ("rad/s", "m/s2", sensor)


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


def test_ximu3_microseconds_become_seconds(tmp_path):
    values = np.random.default_rng(2).normal(size=(5, 6))
    clock = 392_093_562 + 20_000 * np.arange(5)
    (tmp_path / "Inertial.csv").write_text(csv(["Timestamp (us)", *GYRO, *ACCEL], np.column_stack((clock, values))))
    (tmp_path / "Temperature.csv").write_text("Timestamp (us),Temperature (degC)\n392093562,30\n392173562,34\n")
    record = read_record(tmp_path)
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
    with pytest.raises(InputError, match="sample rate"):
        read_record(tmp_path)
    record = read_record(tmp_path, ColumnMap(sample_rate_hz=256.0))
    np.testing.assert_allclose(record.temp_c, [30, 31, 32, 33, 34])
    np.testing.assert_allclose(record.mag_ut, values[:, 6:] * 100)
    assert record.sample_rate_hz == pytest.approx(256.0)
    (tmp_path / "8_CalInertialAndMag.csv").write_text("x")
    with pytest.raises(InputError, match="7_CalInertialAndMag"):
        read_record(tmp_path)


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
    record = read_record(tmp_path / "a.csv")
    np.testing.assert_allclose(record.time, np.arange(250) / 100, atol=1e-9)
    np.testing.assert_array_equal(record.accel, values[:, :3])
    np.testing.assert_array_equal(record.gyro, values[:, 3:6])
    np.testing.assert_array_equal(record.temp_c, values[:, 9])
    assert (record.device, record.gyro_unit, record.accel_unit) == ("TAS1E31150129", "dps", "g")


def test_actigraph_rate_and_dates_are_checked(tmp_path):
    (tmp_path / "b.csv").write_text(actigraph(4, clock=["noon", "later", "x", "y"])[0])
    with pytest.raises(FileFormatError, match="expected dates"):
        read_record(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text(actigraph(50, rate=30)[0])
    with pytest.raises(InputError, match="the specified 30 Hz, got 100 Hz"):
        read_record(tmp_path / "c.csv")


def test_shipped_maps_name_a_maker_and_recognise_no_table_of_undrift(tmp_path):
    head = b"time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n0,1,2,3\n"
    for name, dialect in dialects().items():
        assert dialect.maker, name
        assert not dialect.recognises(tmp_path, head), name
