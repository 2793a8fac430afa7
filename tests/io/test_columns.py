"""A map says which column is which, states every unit, and guesses nothing."""

import numpy as np
import pytest
from pydantic import ValidationError

import undrift
from undrift.errors import InputError
from undrift.io.column_map import ColumnMap, TempFile, native_map
from undrift.io.formats import iter_record, read_counted
from undrift.record import Record


def test_native_names_need_no_map():
    names = (
        "time_s",
        "gyro_x_dps",
        "gyro_y_dps",
        "gyro_z_dps",
        "accel_x_m_s2",
        "accel_y_m_s2",
        "accel_z_m_s2",
        "temp_c",
    )
    found = native_map(names)
    assert found.columns_of("time") == ("time_s",)
    assert (found.columns_of("gyro"), found.columns_of("accel")) == (names[1:4], names[4:7])
    assert (found.unit_of("gyro"), found.unit_of("accel"), found.unit_of("temp")) == ("dps", "m/s2", "degc")
    assert found.mapped() == ("time", "gyro", "accel", "temp")


@pytest.mark.parametrize(("suffix", "unit"), [("rad_s", "rad/s"), ("dps", "dps"), ("count", "count"), ("v", "v")])
def test_every_native_gyro_unit_is_recognised(suffix, unit):
    names = ("time_s", *(f"gyro_{axis}_{suffix}" for axis in "xyz"))
    assert native_map(names).unit_of("gyro") == unit


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("time_s", "gyro_x_dps", "gyro_y_dps"), "got only gyro_x_dps, gyro_y_dps. Add the missing axes"),
        (("time_s", *(f"gyro_{a}_{u}" for u in ("dps", "rad_s") for a in "xyz")), "gyro in one unit, got rad/s and dps"),
        (tuple(f"gyro_{a}_dps" for a in "xyz"), "expected a time column or sample_rate_hz, got neither"),
        (tuple(f"c{k}" for k in range(20)), r"... \(20 columns\)"),
        ((), "got no columns"),
    ],
)  # fmt: skip
def test_native_names_that_do_not_add_up_are_refused(names, words):
    with pytest.raises(InputError, match=words):
        native_map(names)


@pytest.mark.parametrize(
    "keys",
    [
        {"delimiter": ",,"},
        {"delimiter": "\n"},
        {"decimal": "x"},
        {"skip_rows": -1},
        {"gaps": "fill"},
        {"clock": "host"},
    ],
)
def test_a_value_that_cannot_be_is_refused(keys):
    with pytest.raises(ValidationError, match=next(iter(keys))):
        ColumnMap(**keys)


# ---- a thermometer in a file of its own


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
    assert read.notes == ("temperature from t.csv, interpolated onto the samples",)
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
    words = r"far.csv: expected temperatures from 5 to 14.9 s on the recording's clock, got 107 to 108 s. Set temp_file.shift_s"
    with pytest.raises(InputError, match=words):
        read_counted(folder / "r.csv", ColumnMap(temp_file=TempFile(file=str(folder / "far.csv"))))
    (folder / "none.csv").write_text("time_s,temp_c\n7,NaN\n8,NaN\n")
    with pytest.raises(InputError, match=r"none.csv: temperature: expected one reading or more, got none"):
        read_counted(folder / "r.csv", ColumnMap(temp_file=TempFile(file=str(folder / "none.csv"))))
