"""Wearable formats in their text form: written small and read back."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.io.column_map import ColumnMap
from undrift.io.dialects import dialects
from undrift.io.formats import detect, read_record

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
