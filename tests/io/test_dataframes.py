"""DataFrames as records: names and units stated, every value checked, and back again without a loss."""

import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given

from testkit.strategies import assert_same, few, records
from undrift.errors import FileFormatError, InputError
from undrift.record import Record

N = 30
PLAIN = {f"{sensor}_{axis}": np.linspace(0.0, 1.0, N) for sensor in ("gyro", "accel") for axis in "xyz"}
UNITS = {"gyro": "dps", "accel": "g"}


@few
@given(record=records(gaps=True))
def test_a_record_comes_back_from_its_frame_to_the_last_bit(record):
    if "v" in (record.gyro_unit, record.accel_unit):  # volts are a unit of columns like the others
        assert any(name.endswith("_v") for name in record.to_frame())
    assert_same(Record.from_frame(record.to_frame(), gaps="keep"), record)


class Polars:
    """What a polars DataFrame offers to a reader: its columns by Arrow, and no more."""

    def __init__(self, columns):
        self.table = pa.table(columns)

    def __arrow_c_stream__(self, requested_schema=None):
        return self.table.__arrow_c_stream__(requested_schema)


def test_frames_of_polars_and_tables_of_arrow_are_those_of_pandas():
    days = pd.date_range("2026-11-22", periods=N, freq="20ms")
    columns = PLAIN | {"gyro_z": np.arange(N), "time": days}
    wanted = Record.from_frame(pd.DataFrame(columns), units=UNITS)
    for frame in (pa.table(columns), Polars(columns)):
        assert_same(Record.from_frame(frame, units=UNITS), wanted)
    empty = columns | {"accel_x": [None, *PLAIN["accel_x"][1:]]}
    with pytest.raises(InputError, match="accel"):
        Record.from_frame(Polars(empty), units=UNITS)
    assert np.isnan(Record.from_frame(Polars(empty), units=UNITS, gaps="keep").accel[0, 0])
    with pytest.raises(FileFormatError, match="DataFrame"):
        Record.from_frame(Polars(columns | {"accel_x": ["a"] * N}), units=UNITS)
    with pytest.raises(InputError, match="a table of pandas, polars or Arrow, got int"):
        Record.from_frame(7)


def test_plain_names_need_units_and_a_clock_alone():
    record = Record.from_frame(pd.DataFrame(PLAIN), units=UNITS, sample_rate_hz=10.0, device="A1")
    assert (record.gyro_unit, record.accel_unit, record.device, record.state) == ("dps", "g", "A1", "raw")
    np.testing.assert_array_equal(record.gyro[:, 2], PLAIN["gyro_z"])
    assert record.sample_rate_hz == pytest.approx(10.0)


def test_foreign_names_are_mapped_and_times_converted():
    frame = pd.DataFrame({"ms": np.arange(N) * 20.0, "a": 1.0, "b": 2.0, "c": 3.0, "T": 25.0})
    record = Record.from_frame(
        frame,
        columns={"time": "ms", "accel": ["a", "b", "c"], "temp": "T"},
        units={"time": "ms", "accel": "g", "temp": "degC"},
    )
    assert record.sample_rate_hz == pytest.approx(50.0)
    assert record.gyro is None
    np.testing.assert_array_equal(record.accel[5], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(record.temp_c, 25.0)


@pytest.mark.parametrize(
    "index",
    [
        pd.date_range("2026-11-22", periods=N, freq="20ms"),
        pd.date_range("2026-11-22", periods=N, freq="20ms", tz="Europe/Rome"),
        pd.to_timedelta(np.arange(N) * 20, unit="ms"),
    ],
    ids=["dates", "dates in a zone", "differences"],
)
def test_dates_in_the_index_are_the_clock(index):
    record = Record.from_frame(pd.DataFrame(PLAIN, index=index), units=UNITS)
    np.testing.assert_allclose(record.time, np.arange(N) * 0.02, atol=1e-12)


def test_without_pandas_a_frame_is_refused_and_the_rest_works(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    record = Record.from_arrays(gyro=np.zeros((3, 3)), gyro_unit="dps", sample_rate_hz=10.0)
    with pytest.raises(InputError, match="to_frame:"):
        record.to_frame()
