"""The error tree: one root, numbers as attributes, one line of text."""

import pickle

import numpy as np
import pytest

from testkit.walking import perfect_calibration
from undrift import errors
from undrift.calibration.reference import fit_reference
from undrift.correction.correct import Corrector, correct
from undrift.drift.fit import DriftSettings
from undrift.orientation import OrientSettings
from undrift.record import Record
from undrift.validation.trial import TrialSettings

CALIBRATION = perfect_calibration()
STILL = Record(time=np.arange(100) / 50.0, gyro=np.zeros((100, 3)), accel=np.tile((0.0, 0.0, 9.8), (100, 1)))


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


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: OrientSettings(method="madgwick"), "method"),
        (lambda: OrientSettings(forward="x"), "forward"),
        (lambda: TrialSettings(offset="whatever"), "offset"),
        (lambda: fit_reference([], [], mounting="twice"), "mounting"),
        (lambda: DriftSettings(tables="all"), "tables"),
        (lambda: correct(STILL, CALIBRATION, policy="whatever"), "policy"),
        (lambda: correct(STILL, CALIBRATION, offset="whatever"), "offset"),
        (lambda: Corrector(CALIBRATION, "whatever"), "policy"),
    ],
)
def test_unknown_choice_is_refused_with_the_choices(make, name):
    with pytest.raises(errors.InputError, match=f"`{name}` must"):
        make()
