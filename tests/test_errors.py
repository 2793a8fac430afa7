"""The error tree: one root, numbers as attributes, one line of text."""

import pickle

import pytest

from undrift import errors


def test_every_error_is_of_the_tree_and_input_errors_are_value_errors():
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert len(kinds) == 15
    assert all(issubclass(kind, errors.UndriftError) for kind in kinds)
    assert issubclass(errors.FileFormatError, errors.InputError)
    assert issubclass(errors.InputError, ValueError)
    assert {k.__name__ for k in errors.CalibrationError.__subclasses__()} == {"NotObservable", "PoorFit", "Implausible"}


def test_numbers_ride_along_as_attributes():
    error = errors.PoorFit("wanted 1, got 2; do 3", got=2.0)
    assert str(error) == "wanted 1, got 2; do 3"
    assert error.got == 2.0
    assert error.numbers == {"got": 2.0}
    with pytest.raises(AttributeError, match="other"):
        _ = error.other


def test_an_error_travels_between_processes():
    back = pickle.loads(pickle.dumps(errors.InputError("text", row=3)))
    assert str(back) == "text"
    assert back.row == 3
