"""Corners of the readers: missing extras, folders told apart, files that end where they should begin."""

import numpy as np
import pytest

from testkit.column_maps import column_map
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.io.columns import two_rates
from undrift.io.formats import detect, read_counted
from undrift.io.inspect import describe

XYZ = column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g")


def test_a_row_as_long_as_a_file_is_read(tmp_path):
    (tmp_path / "r.csv").write_text(f"t,x,y,z,note\n0,1,2,3,{'x' * 13_000_000}\n1,1,2,3,\n")
    assert len(read_counted(tmp_path / "r.csv", XYZ).record) == 2


def test_a_column_of_empty_cells_is_all_gaps(tmp_path):
    (tmp_path / "r.csv").write_text("t,u,v,w,x,y,z\n0,4,5,,1,2,3\n1,4,5,,1,2,3\n")
    assert read_counted(tmp_path / "r.csv", XYZ).record.accel.tolist() == [[1, 2, 3], [1, 2, 3]]
    unmapped = column_map(
        time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g", gyro=("u", "v", "w"), gyro_unit="dps"
    )
    with pytest.raises(InputError, match="a number in every row, got 2 empty"):
        read_counted(tmp_path / "r.csv", unmapped)


def test_json_is_told_without_its_ending_and_a_brace_alone_is_text(tmp_path):
    (tmp_path / "a").write_text('{"k": 1}')
    (tmp_path / "b").write_text("{ not json\nmore words here\nand more\n")
    assert detect(tmp_path / "a") == "json"
    assert detect(tmp_path / "b") == "text"


def test_a_file_without_rights_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "r.csv").write_text("x")

    def refuse(self, *args, **keys):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(InputError, match="cannot be read: Permission denied"):
        read_bytes(tmp_path / "r.csv")


def test_a_single_slow_block_is_a_drop_out_and_not_a_second_rate():
    steps = np.full(2000, 0.01)
    steps[500:520] = 0.02
    assert two_rates(np.cumsum(steps)) is None
    steps[500:] = 0.02
    first, second, begins = two_rates(np.cumsum(steps))
    assert (first, second) == pytest.approx((100.0, 50.0))
    assert begins == pytest.approx(5.0, abs=0.7)


def test_nothing_but_blank_lines_is_no_table(tmp_path):
    (tmp_path / "blank.csv").write_text("\n \n\n")
    assert describe(tmp_path / "blank.csv").kind == "text"
