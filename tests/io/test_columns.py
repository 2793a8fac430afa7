"""A map says which column is which, states every unit, and guesses nothing."""

import pytest
from pydantic import ValidationError

from undrift.errors import InputError
from undrift.io.column_map import ColumnMap, native_map


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
