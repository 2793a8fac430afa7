"""Arrays as values: copied, read-only, checked once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.strategies import few, numbers
from undrift.arrays import frozen
from undrift.errors import InputError


@few
@given(x=st.integers(1, 9).flatmap(lambda n: numbers((n, 3), gaps=True)), order=st.sampled_from("CF"))
def test_a_frozen_array_is_a_read_only_copy_of_the_same_numbers(x, order):
    given_ = np.asarray(x, order=order)
    array = frozen(given_, (None, 3), "gyro")
    np.testing.assert_array_equal(array, x)
    assert array.dtype == np.float64
    assert array.flags.c_contiguous
    assert not array.flags.writeable
    assert not np.shares_memory(array, given_)
    assert given_.flags.writeable


@pytest.mark.parametrize(
    ("x", "shape", "words"),
    [
        (np.zeros((3, 9)), (None, 3), r"got \(3, 9\)"),
        (np.zeros((4, 1)), (None,), r"got \(4, 1\)"),
        ([1.0, np.inf], (2,), "got infinity"),
        (["a"], (None,), "got list"),
        ([[1.0], [1.0, 2.0]], (None, 1), "got list"),
    ],
)
def test_what_is_no_such_array_is_refused(x, shape, words):
    with pytest.raises(InputError, match=words):
        frozen(x, shape, "gyro")


def test_what_nothing_else_can_write_to_is_not_copied_again():
    once = frozen(np.arange(3.0), (3,), "x")
    assert frozen(once, (3,), "x") is once
    writeable, view, counts = np.arange(3.0), np.arange(6.0)[:3], np.arange(3)
    view.flags.writeable = counts.flags.writeable = False
    for other in (writeable, view, counts):
        array = frozen(other, (3,), "x")
        assert not np.shares_memory(array, other)
        assert not array.flags.writeable
    assert writeable.flags.writeable
