"""Column maps in TOML mean what they say, and a slip is named by its line."""

import pytest

from undrift.errors import FileFormatError, InputError
from undrift.io.columns import ColumnMap, Scale, TextLayout
from undrift.io.mapping import read_column_map
from undrift.io.toml import entry_name, line_of

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
    assert read_column_map(tmp_path / "map.toml") == ColumnMap(
        gyro=(3, 4, "gz"),
        accel=("acc",),
        temp=0,
        gyro_unit="dps",
        accel_unit="g",
        temp_unit="degC",
        gyro_scale=Scale((1.0, 1.0, -1.0), 0.0),
        temp_scale=Scale(0.5, 23.0),
        sample_rate_hz=50.0,
        layout=TextLayout(delimiter="\t", header=False, skip_rows=2, drop_bad_rows=True),
        gaps="keep",
        repair_time=True,
        frame="b",
        device="A1",
    )


@pytest.mark.parametrize(
    ("old", "new", "kind", "words"),
    [
        ("skip_rows", "skiprows", FileFormatError, "line 7: skiprows: wanted a known key"),
        ("header = false", 'header = "no"', FileFormatError, "line 6: header: wanted a valid boolean, got 'no'"),
        (
            "sample_rate_hz = 50",
            'sample_rate_hz = "50"',
            FileFormatError,
            "line 1: sample_rate_hz: wanted a valid number, got '50'",
        ),
        ("offset = 23", "ofset = 23", FileFormatError, r"line 4: \[scale\], temp, ofset: wanted a known key"),
        ("[1.0, 1.0, -1.0]", "[1.0, 1.0]", InputError, "scale.gyro: wanted one number or three for x, y, z, got 2"),
        (
            'columns = { gyro = [3, 4, "gz"], accel = "acc", temp = 0 }\n',
            "",
            InputError,
            "wanted one table of columns, got 0",
        ),
        ('gyro = "dps", ', "", InputError, "units.gyro: wanted the unit of gyro"),
    ],
)
def test_a_slip_is_named(tmp_path, old, new, kind, words):
    (tmp_path / "map.toml").write_text(TEXT.replace(old, new))
    with pytest.raises(kind, match=words):
        read_column_map(tmp_path / "map.toml")


def test_lines_and_entries_are_found_in_the_text():
    text = "[session]\nkind = 1\n[[still]]\nface = 2\n[[still]]\nstart_s = 1\nface = 3\n[[turn]]\nface = 4\n"
    assert line_of(text, ("still", 1, "face")) == 7
    assert line_of(text, ("still", 0)) == 3
    assert line_of(text, ("still", 1, "none")) == 5
    assert line_of(text, ("nowhere",)) == 1
    assert entry_name(("still", 1, "face")) == "[[still]] 2, face"
    assert entry_name(("session", "kind")) == "[session], kind"
    assert entry_name(("columns",)) == "columns"
