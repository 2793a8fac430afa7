"""Outcome: sentences are said once."""

from undrift.calibration.calibrate import said_once

LONG = "multi-position: wanted poses that change the length by 0.02 g or more, got less; add poses"


def test_what_ails_both_triads_is_told_once_and_heads_are_not_doubled():
    said = said_once((
        f"accelerometer: scale alone was fitted: {LONG}",
        f"gyroscope by {LONG}",
        "gyroscope: gyroscope: no turns",
        "gyroscope: no turns",
    ))  # fmt: skip
    assert said == (
        f"accelerometer: scale alone was fitted: {LONG}",
        "gyroscope by multi-position: not observable, for the reason said of the accelerometer",
        "gyroscope: no turns",
    )
