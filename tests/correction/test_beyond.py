"""Corrected readings beyond what a fit has seen: counted, with the worst, in chunks as at once."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.full_calibration import device, record
from undrift.correction.correct import correct
from undrift.correction.coverage import MARGIN, find_beyond
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


def seen(calibration, gyro, accel=None):
    """The calibration with other spans: what its fits have seen."""
    other = calibration if accel is None else replace(calibration, accel=replace(calibration.accel, valid_range=accel))
    return replace(other, gyro=replace(other.gyro, valid_range=gyro))


def corrected(n=500):
    calibration = device(unit="si", drift=None)
    gyro = np.random.default_rng(2).normal(size=(n, 3)) * 0.5
    accel = np.random.default_rng(3).normal([0.0, 0.0, 9.8], 1.0, (n, 3))
    return correct(
        replace(record(n, unit="si", gyro=gyro, accel=accel), temp_c=np.full(n, 25.0)), calibration
    ), calibration


def test_the_count_and_the_worst_are_those_of_a_plain_look_at_every_sample():
    done, calibration = corrected()
    calibration = seen(calibration, (-0.7, 0.5), (-STANDARD_GRAVITY, STANDARD_GRAVITY))
    gyro, accel = find_beyond(done, calibration)
    room = MARGIN * 0.7  # of the larger end
    plain = [any(w < -0.7 - room or w > 0.5 + room for w in row) for row in done.gyro]
    assert gyro.samples == sum(plain) > 0
    assert gyro.share == sum(plain) / 500
    assert (gyro.sensor, gyro.seen, gyro.of) == ("gyro", (-0.7, 0.5), 500)
    assert gyro.worst in (done.gyro.min(), done.gyro.max())
    assert max(gyro.worst - 0.5, -0.7 - gyro.worst) == max(done.gyro.max() - 0.5, -0.7 - done.gyro.min())
    assert accel.samples == int((np.abs(done.accel) > 1.1 * STANDARD_GRAVITY).any(axis=1).sum()) > 0


def test_chunks_come_to_what_the_whole_comes_to():
    done, calibration = corrected()
    calibration = seen(calibration, (-0.6, 0.6))
    whole = find_beyond(done, calibration)[0]
    parts = [find_beyond(done.between(a, b), calibration)[0] for a, b in ((0.0, 1.0), (1.0, 1.5), (1.5, 9.0))]
    joined = parts[0].joined(parts[1]).joined(parts[2])
    assert (joined.samples, joined.of, joined.worst) == (whole.samples, whole.of, whole.worst)
    assert len({part.worst for part in parts}) > 1


def test_gaps_and_noise_at_the_end_of_the_span_do_not_count():
    done, calibration = corrected()
    calibration = seen(calibration, (-0.5, 0.5))
    gyro = np.full_like(done.gyro, 0.549)  # within a tenth
    gyro[7] = np.nan
    assert find_beyond(replace(done, gyro=gyro), calibration)[0].samples == 0
    assert find_beyond(replace(done, gyro=np.full_like(gyro, np.nan)), calibration)[0].samples == 0
    gyro[8, 1] = -0.551
    found = find_beyond(replace(done, gyro=gyro), calibration)[0]
    assert (found.samples, found.worst) == (1, -0.551)
    assert found.text == (
        "gyroscope: 0.2 % of samples exceed the calibrated range: by more than a tenth: range -28.6 to 28.6 deg/s, "
        f"worst {-0.551 / RADIAN_PER_DEGREE:.4g} deg/s; the model is extrapolated; calibrate over a wider range"
    )


@pytest.mark.parametrize("span", [(0.0, 0.0), (np.nan, np.nan), (-np.inf, np.inf)])
def test_a_fit_without_a_span_gives_no_warning(span):
    done, calibration = corrected()
    found = find_beyond(done, seen(calibration, span))
    assert [one.text for one in found if one.sensor == "gyro" and one.samples] == []
    bare = replace(done, gyro=None)
    assert [one.sensor for one in find_beyond(bare, replace(calibration, accel=None))] == []


def test_a_span_in_another_unit_is_made_si():
    done, calibration = corrected()
    whole = find_beyond(done, seen(calibration, (-0.6, 0.6)))[0]
    degrees = seen(calibration, (-0.6 / RADIAN_PER_DEGREE, 0.6 / RADIAN_PER_DEGREE))
    degrees = replace(degrees, gyro=replace(degrees.gyro, unit_out="deg/s"))
    assert find_beyond(done, degrees)[0].samples == whole.samples > 0
