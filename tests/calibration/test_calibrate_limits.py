"""A verdict names what the kind of session does not show and which recording would, and stays good for it."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import codes, only
from undrift.calibration.calibrate import Outcome, calibrate, each_once, limits_of
from undrift.findings import finding
from undrift.fit.least_squares import TriadFit
from undrift.model import Verdict
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

DEVICE = random_device(np.random.default_rng(21))
MOUNTING, G_SENSITIVITY = "multi_position.mounting", "multi_position.g_sensitivity"
FIXTURE, OTHER_RATES, NO_ACCEL = "six_face.fixture", "known_rotation.other_rates", "rate_table.no_accel"
KINDS = (MOUNTING, FIXTURE, G_SENSITIVITY, OTHER_RATES, NO_ACCEL)


def made(kind):
    return simulate_session(kind, DEVICE, rng=np.random.default_rng(22), temp_c=25.0)


@pytest.mark.parametrize(
    ("kind", "limits"),
    [
        ("multi_position", (MOUNTING, G_SENSITIVITY)),
        ("ferraris", (FIXTURE, OTHER_RATES)),
        ("bench", (FIXTURE,)),
        ("six_face", (FIXTURE,)),
    ],
)
def test_each_kind_of_session_names_its_own_limits_and_no_other(kind, limits):
    verdict = calibrate(made(kind)).verdict
    assert tuple(code for code in codes(verdict.findings) if code in KINDS) == limits


def test_the_limits_alone_leave_a_verdict_good():
    verdict = calibrate(made("multi_position")).verdict
    assert verdict.status == "good"
    assert codes(verdict.findings) == [MOUNTING, G_SENSITIVITY, "session.one_temperature"]
    assert {item.level for item in verdict.findings} == {"info"}


def test_a_rate_table_without_an_accelerometer_asks_for_one_once():
    session = made("bench")
    numb = replace(session, records=tuple(replace(r, accel=None) for r in session.records), stills=())
    found = calibrate(numb)
    asks = [code for code in codes(found.verdict.findings) if code in (NO_ACCEL, "rate_table.axis_offset")]
    assert asks == ["rate_table.axis_offset"]  # the fit saw its effect, and that asks for the same recording
    triad = TriadFit(model=found.gyro, residuals=np.zeros(3), verdict=found.verdict)
    gyro = Outcome(fit=triad, method="rate-table")
    assert codes(limits_of(Outcome(), gyro, 25.0, thermal=True)) == []
    quiet = replace(gyro, fit=replace(triad, verdict=Verdict()))
    assert codes(limits_of(Outcome(), quiet, 25.0, thermal=True)) == [NO_ACCEL]


def test_a_thermal_session_is_not_sent_to_record_one():
    warm = replace(made("six_face"), kind="thermal")
    assert not any("temperature" in code for code in codes(calibrate(warm).verdict.findings))


def test_one_temperature_is_named_with_its_figure_or_with_the_lack_of_one():
    session = made("six_face")
    found = calibrate(session)
    assert only(found.verdict.findings, "session.one_temperature").values["temp_c"] == found.reference_temp_c
    blind = replace(
        session,
        records=tuple(replace(r, temp_c=None) for r in session.records),
        stills=tuple(replace(s, temp_c=None) for s in session.stills),
        turns=tuple(replace(t, temp_c=None) for t in session.turns),
    )
    unknown = calibrate(blind).verdict.findings
    assert only(unknown, "session.unknown_temperature").detail == "no temperature was recorded"
    assert "session.one_temperature" not in codes(unknown)


def test_a_session_of_several_temperatures_is_sent_to_drift_once():
    session = made("bench")
    stills = tuple(replace(s, temp_c=25.0) for s in session.stills)
    turns = tuple(replace(t, temp_c=40.0 if k % 10 == 9 else 25.0) for k, t in enumerate(session.turns))
    reasons = calibrate(replace(session, stills=stills, turns=turns)).verdict.reasons
    assert sum("undrift drift" in reason for reason in reasons) == 1


def test_a_finding_of_both_triads_is_given_once_with_both():
    reason = "multi-position: wanted poses that change the length by 0.02 g or more, got less; add poses"
    accel = finding("session.fit_failed", "warn", triad="accelerometer", reason=reason)
    gyro = finding("session.fit_failed", "warn", triad="gyroscope", reason=reason)
    other = finding("session.fit_failed", "warn", triad="gyroscope", reason="no turns")
    both, rest = each_once((accel, gyro, other, gyro))
    assert both.text == f"Full fit not possible: accelerometer and gyroscope: {reason}"
    assert rest == other
