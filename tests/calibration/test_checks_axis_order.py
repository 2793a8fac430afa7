"""What the columns of a gyroscope see, in words."""

import itertools

import numpy as np
import pytest

from undrift.calibration.checks import cause_by_gravity, cause_by_turns, check_axis_order, nearest_signed_permutation
from undrift.errors import Implausible

SKEW = np.array([[1.0, 0.1, -0.05], [0.02, 0.9, 0.12], [-0.08, 0.03, 1.1]])


def rows(*axes):
    """Signed permutation whose row i sees the axis named."""
    seen = np.zeros((3, 3))
    for i, axis in enumerate(axes):
        seen[i, "xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    return seen


def test_every_one_of_the_48_orders_is_found_behind_a_skewed_triad():
    for order in itertools.permutations("xyz"):
        for signs in itertools.product("+-", repeat=3):
            seen = rows(*(s + a for s, a in zip(signs, order, strict=True)))
            np.testing.assert_array_equal(nearest_signed_permutation(800.0 * seen @ SKEW), seen)


def test_the_order_as_it_should_be_passes():
    check_axis_order(SKEW, "rate table", against="turns")
    check_axis_order(SKEW, "gyro", against="accelerometer")


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        (rows("+x", "-y", "+z"), "gyroscope column y is reversed"),
        (rows("-x", "-y", "+z"), "gyroscope columns x and y are reversed, or accelerometer column z is"),
        (
            rows("-x", "-y", "-z"),
            "all gyroscope columns are reversed, or the same two columns of both triads are exchanged",
        ),
        (rows("+y", "+x", "+z"), "gyroscope columns x and y are exchanged"),
        (
            rows("-y", "-x", "-z"),
            "accelerometer columns x and y are exchanged, or gyroscope columns x and y and all their",
        ),
        (
            rows("+y", "+z", "+x"),
            "columns x, y and z are exchanged in a ring, those of the gyroscope or those of the acc",
        ),
        (rows("+y", "-z", "-x"), "gyroscope columns x, y and z are exchanged in a ring, and y and z reversed"),
    ],
)
def test_gravity_names_the_columns_of_either_triad(seen, cause):
    assert cause_by_gravity(seen).startswith(cause)


def test_exchanged_accelerometer_columns_show_as_the_cause_says():
    exchanged = rows("+y", "+x", "+z")  # a' = A a; a turn seen in that frame is det(A) A w
    forward = np.linalg.inv(np.linalg.det(exchanged) * exchanged)
    assert cause_by_gravity(nearest_signed_permutation(forward)).startswith(
        "accelerometer columns x and y are exchanged"
    )


def test_turns_name_the_columns_or_the_turns():
    assert cause_by_turns(rows("+y", "+x", "+z")) == "columns x and y exchanged, or the axes of the turns"
    assert cause_by_turns(rows("+y", "+z", "+x")) == "columns x, y and z exchanged in a ring, or the axes of the turns"
    assert cause_by_turns(rows("+x", "+y", "-z")) == "column z reversed, or the sign of the turns about z"


def test_an_even_exchange_is_right_handed_and_refused_all_the_same():
    ring = rows("+y", "+z", "+x") @ SKEW
    assert np.linalg.det(ring) > 0.0
    with pytest.raises(
        Implausible, match=r"of the accelerometer axes, got \+y, \+z, \+x: columns x, y and z"
    ) as caught:
        check_axis_order(ring, "gyro against accel", against="accelerometer")
    assert caught.value.seen == "+y, +z, +x"
    with pytest.raises(
        Implausible, match=r"as stated, got \+y, \+z, \+x: .* or the axes of the turns; correct the order"
    ):
        check_axis_order(ring, "rate table", against="turns")
