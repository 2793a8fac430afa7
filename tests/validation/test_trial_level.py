"""A body whose axes mean nothing: how the device sits on it, by the vertical at rest and one level axis of turning."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.frames import quaternion_of, quaternion_product, rotation_vector
from undrift.validation.trial import TrialSettings, validate_trial
from validation.test_levels import FULL, worn

PLAIN = replace(FULL, drift=None)


def judged(turned_deg, **settings):
    record, reference = worn(1)
    body = quaternion_of(np.radians(turned_deg))
    turned = replace(reference, q_nb=quaternion_product(reference.q_nb, body))
    return validate_trial(
        record, turned, calibration=PLAIN, settings=TrialSettings(**{"offset": "rest"} | settings)
    ), body


@pytest.mark.parametrize("turned_deg", [(0.0, 4.0, 0.0), (20.0, -30.0, 100.0), (0.0, 0.0, 175.0)])
def test_a_sit_to_stand_shows_how_the_device_sits_on_a_cluster_of_any_axes(turned_deg):
    trial, body = judged(turned_deg, align="level")
    expected = np.linalg.norm(rotation_vector(body))
    show(f"turned by {turned_deg}: angle found, deg", np.degrees(trial.mounting.angle), np.degrees(expected))
    show("error left, deg", trial.figures.rmse_total_deg, 0.2)
    assert trial.mounting.applied
    assert trial.mounting.angle == pytest.approx(expected, abs=np.radians(0.3))
    assert trial.figures.rmse_total_deg < 0.2


def test_without_it_a_small_turn_of_the_axes_is_left_in_as_error():
    assert judged((0.0, 4.0, 0.0), align="auto")[0].figures.rmse_total_deg == pytest.approx(4.0, abs=0.2)


def test_a_recording_that_begins_in_motion_takes_the_rates_as_always():
    record, reference = worn(1)
    begun = replace(record.between(7.0, record.time[-1]), device="")
    level, rates = (
        validate_trial(begun, reference, calibration=PLAIN, settings=TrialSettings(align=align))
        for align in ("level", "auto")
    )
    assert level.figures == rates.figures


@pytest.mark.slow
def test_the_filter_holds_the_inclination_where_the_offset_is_left_in_and_states_no_error_to_expect():
    raw, filtered = (judged((0.0, 0.0, 0.0), method=method, offset="none")[0] for method in ("strapdown", "vqf"))
    angles = [one.figures.rmse_inclination_deg for one in (raw, filtered)]
    show("inclination by gyroscopes and by the filter, deg", np.round(angles, 3))
    assert filtered.expected is None
    assert angles[1] < 0.5 * angles[0]
