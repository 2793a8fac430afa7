"""Parameters are named as a laboratory names them."""

import pytest

from undrift.fit.least_squares import parameter_names
from undrift.model import MATRIX_NAMES, OFFSET_NAMES


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (("m_xy", "m_xz"), "cross-axis terms xy and xz"),
        (("m_yz",), "cross-axis term yz"),
        (("m_yy", "offset_y"), "scale of y, offset of y"),
        (("offset_x", "offset_y", "offset_z"), "offset of x, y and z"),
        (
            (*MATRIX_NAMES, *OFFSET_NAMES),
            "scale of x, y and z, cross-axis terms xy, xz, yx, yz, zx and zy, offset of x, y and z",
        ),
    ],
)
def test_names_of_one_kind_are_listed_together(names, shown):
    assert parameter_names(names) == shown
