"""Column maps in TOML mean what they say, and a slip is named by its line."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from testkit.column_maps import column_map
from undrift.base.codec import entry_name, line_of
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ChannelScale, ColumnMap, read_map
from undrift.io.formats import iter_record, read_record

TEXT = """sample_rate_hz = 50
columns = { gyro = [3, 4, "gz"], accel = "acc", temp = 0 }
units = { gyro = "dps", accel = "g", temp = "degC" }
scale = { temp = { gain = 0.5, offset = 23 }, gyro = { gain = [1.0, 1.0, -1.0] } }
delimiter = "\\t"
header = false
skip_rows = 2
drop_bad_rows = true
gaps = "keep"
repair_time = true
frame = "b"
device = "A1"
"""


def test_a_map_in_toml_is_the_map_in_python(tmp_path):
    (tmp_path / "map.toml").write_text(TEXT)
    assert read_map(tmp_path / "map.toml") == column_map(
        gyro=[3, 4, "gz"],
        accel="acc",
        temp=0,
        gyro_unit="dps",
        accel_unit="g",
        temp_unit="degC",
        gyro_scale=ChannelScale((1.0, 1.0, -1.0), 0.0),
        temp_scale=ChannelScale(0.5, 23.0),
        sample_rate_hz=50.0,
        delimiter="\t",
        header=False,
        skip_rows=2,
        drop_bad_rows=True,
        gaps="keep",
        repair_time=True,
        frame="b",
        device="A1",
    )


@pytest.mark.parametrize(
    ("old", "new", "kind", "words"),
    [
        ("skip_rows", "skiprows", FileFormatError, "line 7: skiprows: this key is unknown"),
        ("header = false", 'header = "no"', FileFormatError, "a valid boolean, got 'no'"),
        (
            "sample_rate_hz = 50", 'sample_rate_hz = "50"', FileFormatError,
            "a valid number, got '50'",
        ),
        ("offset = 23", "ofset = 23", FileFormatError, r"line 4: \[scale\], temp, ofset: this key is unknown"),
        ("[1.0, 1.0, -1.0]", "[1.0, 1.0]", FileFormatError, r"line 4: \[scale\], gyro, gain:"),
        ("gain = 0.5", "gain = [1.0, 1.0, 1.0]", InputError, "scale.temp: expected one number"),
        ('columns = { gyro = [3, 4, "gz"], accel = "acc", temp = 0 }\n', "", InputError, "expected one table of columns, got 0"),
        ('gyro = "dps", ', "", InputError, "the unit of gyro"),
    ],
)  # fmt: skip
def test_a_slip_is_named(tmp_path, old, new, kind, words):
    (tmp_path / "map.toml").write_text(TEXT.replace(old, new))
    with pytest.raises(kind, match=words):
        read_map(tmp_path / "map.toml")


def test_lines_and_entries_are_found_in_the_text():
    text = "[session]\nkind = 1\n[[still]]\nface = 2\n[[still]]\nstart_s = 1\nface = 3\n[[turn]]\nface = 4\n"
    assert line_of(text, ("still", 1, "face")) == 7
    assert line_of(text, ("still", 0)) == 3
    assert line_of(text, ("still", 1, "none")) == 5
    assert line_of(text, ("nowhere",)) == 1
    assert entry_name(("still", 1, "face")) == "[[still]] 2, face"
    assert entry_name(("session", "kind")) == "[session], kind"
    assert entry_name(("columns",)) == "columns"


def test_a_map_without_columns_says_what_own_names_leave_unsaid(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text("repair_time = true\n")
    assert read_map(path) == ColumnMap(repair_time=True)
    path.write_text('gaps = "keep"\nsample_rate_hz = 50.0\ndrop_bad_rows = true\n')
    assert read_map(path) == ColumnMap(gaps="keep", sample_rate_hz=50.0, drop_bad_rows=True)
    for text, got in (("skip_rows = 2", "skip_rows"), ("# nothing", "no key")):
        path.write_text(text)
        with pytest.raises(InputError, match=f"expected one table of columns, got 0 and {got}. Add columns"):
            read_map(path)


@pytest.mark.parametrize("name", ["r.csv", "r.parquet"])
def test_rows_whose_time_goes_back_are_left_out_of_own_names_on_request(tmp_path, name):
    time = np.array([0.0, 0.01, 0.02, 0.015, 0.03, 0.04])
    table = pa.table({"time_s": time} | {f"gyro_{axis}_dps": time for axis in "xyz"})
    (csv.write_csv if name == "r.csv" else parquet.write_table)(table, tmp_path / name)
    with pytest.raises(InputError, match=r"Set repair_time = true in a map \(`column_map` FILE\)"):
        read_record(tmp_path / name)
    settings = ColumnMap(repair_time=True)
    kept = [0.0, 0.01, 0.02, 0.03, 0.04]
    np.testing.assert_array_equal(read_record(tmp_path / name, settings).time, kept)
    np.testing.assert_array_equal(next(iter_record(tmp_path / name, settings)).time, kept)
