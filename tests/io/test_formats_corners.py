"""Corners of the readers: missing extras, folders told apart, files that end where they should begin."""

import numpy as np
import pytest

from testkit.column_maps import column_map
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.io.columns import two_rates
from undrift.io.formats import read_counted

XYZ = column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g")


def test_a_column_of_empty_cells_is_all_gaps(tmp_path):
    (tmp_path / "r.csv").write_text("t,u,v,w,x,y,z\n0,4,5,,1,2,3\n1,4,5,,1,2,3\n")
    assert read_counted(tmp_path / "r.csv", XYZ).record.accel.tolist() == [[1, 2, 3], [1, 2, 3]]
    unmapped = column_map(
        time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g", gyro=("u", "v", "w"), gyro_unit="dps"
    )
    with pytest.raises(InputError, match="a number in every row, got 2 empty"):
        read_counted(tmp_path / "r.csv", unmapped)


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
