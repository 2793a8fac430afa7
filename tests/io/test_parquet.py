"""Parquet: every bit and every mark comes back, whole or in chunks."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.column_maps import column_map
from testkit.strategies import assert_same, few
from undrift.errors import FileFormatError, InputError
from undrift.io.arrow import from_arrow, to_arrow
from undrift.io.formats import read_counted
from undrift.io.parquet import ParquetWriter, iter_parquet, write_parquet
from undrift.record import Record


def ramp(n, **more):
    return Record(time=np.arange(n) / 100, gyro=np.arange(3.0 * n).reshape(n, 3), **more)


def test_columns_are_those_of_pyarrow():
    values = np.array([1.5, np.nan, -2.0])
    assert to_arrow(values, empty=True).equals(pa.array(values, from_pandas=True))
    assert to_arrow(values).null_count == 0
    for kind in (pa.int16(), pa.uint8(), pa.float32(), pa.string()):
        column = pa.chunked_array([pa.array([1, None, 3]).cast(kind), pa.array([4, 5]).cast(kind)]).slice(1)
        np.testing.assert_array_equal(from_arrow(column), column.to_numpy())
    assert from_arrow(pa.chunked_array([pa.array([b"\xb0", None]).view("string")])).tolist() == ["\ufffd", None]


@pytest.mark.slow
@few
@given(n=st.integers(2, 60), rows=st.integers(2, 25), group=st.integers(1, 30))
def test_chunks_are_the_whole_in_order_and_none_is_a_single_sample(tmp_path_factory, n, rows, group):
    path = tmp_path_factory.mktemp("parquet") / "r.parquet"
    table = pa.table({"time_s": np.arange(n) / 7, **{f"gyro_{a}_dps": np.arange(n) * 1.0 for a in "xyz"}})
    pq.write_table(table, path, row_group_size=group)
    chunks = list(iter_parquet(path, rows=rows))
    assert all(2 <= len(chunk) <= rows + 1 for chunk in chunks)
    np.testing.assert_array_equal(np.concatenate([chunk.time for chunk in chunks]), np.arange(n) / 7)


@pytest.mark.parametrize("group", [20_000, 10**9])
def test_reading_in_chunks_takes_a_fraction_of_the_memory_of_the_file(tmp_path, group):
    rng = np.random.default_rng(0)
    columns = {"time_s": np.arange(400_000) / 100, **{f"gyro_{a}_dps": rng.normal(size=400_000) for a in "xyz"}}
    pq.write_table(pa.table(columns), tmp_path / "f.parquet", row_group_size=group, use_dictionary=False)
    columns.clear()
    held = pa.total_allocated_bytes()
    most = max(pa.total_allocated_bytes() - held for _ in iter_parquet(tmp_path / "f.parquet", rows=10_000))
    size = (tmp_path / "f.parquet").stat().st_size
    # a few chunks of 10,000 rows, a megabyte of read buffer for each of four columns, and a page of each
    assert most < 0.7 * size
    assert size > 10e6


def test_the_schema_carries_units_frame_state_and_device(tmp_path):
    write_parquet(ramp(5, gyro_unit="dps", frame="b", state="corrected", device="A1"), tmp_path / "r.parquet")
    held = json.loads(pq.read_schema(tmp_path / "r.parquet").metadata[b"undrift"])
    assert held == {
        "kind": "undrift.record", "format": 1, "gyro_unit": "dps", "accel_unit": None,
        "frame": "b", "state": "corrected", "device": "A1",
    }  # fmt: skip


def test_a_writer_takes_chunks_and_the_file_appears_only_at_the_end(tmp_path):
    path = tmp_path / "r.parquet"
    record = ramp(100)
    with ParquetWriter(path) as writer:
        for start in range(0, 100, 30):
            writer.write(record.part(start, min(start + 30, 100)))
        assert not path.exists()
    assert_same(read_counted(path).record, record)
    assert [p.name for p in tmp_path.iterdir()] == ["r.parquet"]


def write_parts(path, *parts, fail=False):
    with ParquetWriter(path) as writer:
        for part in parts:
            writer.write(part)
        if fail:
            raise RuntimeError("stop")


def test_a_writer_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError, match="stop"):
        write_parts(tmp_path / "r.parquet", ramp(10), fail=True)
    assert not list(tmp_path.iterdir())


def test_a_writer_refuses_another_record_and_time_that_goes_back(tmp_path):
    record, path = ramp(20), tmp_path / "r.parquet"
    with pytest.raises(InputError, match=r"expected chunks in order of time, got 0.05 s after 0.09 s"):
        write_parts(path, record.part(0, 10), record.part(5, 15))
    with pytest.raises(InputError, match="expected chunks of one record"):
        write_parts(path, record.part(0, 10), Record(time=record.time[10:], accel=record.gyro[10:]))
    with pytest.raises(InputError, match="expected a folder to write to"):
        write_parquet(record, tmp_path / "none" / "r.parquet")
    assert not list(tmp_path.iterdir())


def test_foreign_parquet_reads_through_a_map(tmp_path):
    pq.write_table(
        pa.table({"t": [0, 10, 20], "a": [1, 2, 3], "b": [4, 5, 6], "c": [7.0, None, 9.0]}), tmp_path / "f.parquet"
    )
    keys = {"time": "t", "time_unit": "ms", "gyro": ("a", "b", "c"), "gyro_unit": "count"}
    record = read_counted(tmp_path / "f.parquet", column_map(**keys, gaps="keep")).record
    np.testing.assert_allclose(record.time, [0.0, 0.01, 0.02])
    assert np.isnan(record.gyro[1, 2])
    with pytest.raises(InputError, match=r"column 'c': .* got 1 empty or NaN cells"):
        read_counted(tmp_path / "f.parquet", column_map(**keys))
    with pytest.raises(InputError, match=r"f.parquet: columns: expected names such as"):
        read_counted(tmp_path / "f.parquet")


def test_time_that_goes_back_between_chunks_is_refused(tmp_path):
    columns = {"time_s": [0.0, 1.0, 0.5, 2.0], **{f"gyro_{a}_dps": [0.0] * 4 for a in "xyz"}}
    pq.write_table(pa.table(columns), tmp_path / "f.parquet")
    with pytest.raises(InputError, match=r"strictly increasing time, got 1 s then 0\.5"):
        list(iter_parquet(tmp_path / "f.parquet", rows=2))
    with pytest.raises(InputError, match="two samples or more in a chunk, got 1"):
        list(iter_parquet(tmp_path / "f.parquet", rows=1))


def test_an_unknown_version_a_cut_file_and_other_content_are_refused(tmp_path):
    path = tmp_path / "r.parquet"
    write_parquet(ramp(500), path)
    held = pq.read_table(path)
    pq.write_table(
        held.replace_schema_metadata({b"undrift": b'{"kind": "undrift.record", "format": 9}'}), tmp_path / "v.parquet"
    )
    with pytest.raises(FileFormatError, match=r"undrift\.record format 1, got undrift\.record format"):
        read_counted(tmp_path / "v.parquet")
    (tmp_path / "cut.parquet").write_bytes(path.read_bytes()[:-30])
    with pytest.raises(FileFormatError, match="expected a Parquet file"):
        read_counted(tmp_path / "cut.parquet")
    damaged = bytearray(path.read_bytes())
    damaged[8:400] = b"\xff" * 392
    (tmp_path / "d.parquet").write_bytes(damaged)
    with pytest.raises(FileFormatError, match="expected a sound Parquet file"):
        read_counted(tmp_path / "d.parquet")
    with pytest.raises(FileFormatError, match="expected a sound Parquet file"):
        list(iter_parquet(tmp_path / "d.parquet"))
