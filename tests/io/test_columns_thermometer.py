"""A thermometer in a file of its own: on the recording's clock, interpolated, held at the ends; by settings, map and session."""

import numpy as np
import pytest

import undrift
from undrift.errors import InputError
from undrift.io.column_map import ColumnMap, TempFile
from undrift.io.formats import iter_record, read_counted
from undrift.record import Record


@pytest.fixture
def folder(tmp_path):
    """A recording of 10 s at 10 Hz from 5 s on, and a thermometer at 1 Hz from 7 to 11 s: 20 to 24 degC."""
    record = Record(time=5 + np.arange(100) / 10, gyro=np.zeros((100, 3)), gyro_unit="dps")
    undrift.write_record(record, tmp_path / "r.csv")
    undrift.write_record(record, tmp_path / "r.parquet")
    (tmp_path / "t.csv").write_text("time_s,temp_c\n" + "".join(f"{7 + k},{20 + k}\n" for k in range(5)))
    return tmp_path


def truth(time):
    return np.interp(time, [7, 11], [20, 24])


def test_a_thermometers_file_is_interpolated_and_held_at_the_ends(folder):
    settings = ColumnMap(temp_file=TempFile(file=str(folder / "t.csv")))
    read = read_counted(folder / "r.csv", settings)
    np.testing.assert_allclose(read.record.temp_c, truth(read.record.time))
    assert read.notes == ("temperature of t.csv, interpolated onto the samples",)
    parts = list(iter_record(folder / "r.parquet", column_map=settings, rows=30))
    np.testing.assert_allclose(np.concatenate([part.temp_c for part in parts]), truth(read.record.time))


def test_names_units_and_another_clock_are_stated(folder):
    rows = "".join(f"{1000 * k + 500};{20 + k},0;x\n" for k in range(5))
    (folder / "t.txt").write_text("logger 3\nms;T;note\n" + rows)
    held = TempFile(
        file=str(folder / "t.txt"), time="ms", temp="T", time_unit="ms", shift_s=6.5,
        delimiter=";", decimal=",", skip_rows=1,
    )  # fmt: skip
    record = undrift.read_record(folder / "r.csv", ColumnMap(temp_file=held))
    np.testing.assert_allclose(record.temp_c, truth(record.time))


def test_a_thermometer_of_another_clock_or_without_readings_is_refused(folder):
    (folder / "far.csv").write_text("time_s,temp_c\n107,20\n108,21\n")
    words = r"far.csv: expected temperatures from 5 to 14.9 s, the recording's clock, got 107 to 108 s. Set temp_file.shift_s"
    with pytest.raises(InputError, match=words):
        read_counted(folder / "r.csv", ColumnMap(temp_file=TempFile(file=str(folder / "far.csv"))))
    (folder / "none.csv").write_text("time_s,temp_c\n7,NaN\n8,NaN\n")
    with pytest.raises(InputError, match=r"none.csv: temperature: expected one reading or more, got none"):
        read_counted(folder / "r.csv", ColumnMap(temp_file=TempFile(file=str(folder / "none.csv"))))


def test_a_session_names_the_thermometer_of_a_recording(folder):
    (folder / "session.toml").write_text(
        '[session]\nkind = "thermal"\nserial = "A"\ngravity_m_s2 = 9.81\n'
        '[[recording]]\nfile = "r.csv"\ntemp_file = { file = "t.csv" }\n'
    )
    (record,) = undrift.read_session(folder).records
    np.testing.assert_allclose(record.temp_c, truth(record.time))
