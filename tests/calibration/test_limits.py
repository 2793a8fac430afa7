"""A verdict says what the kind of session cannot tell and which recording would, and stays good for it."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.calibrate import (
    CASE,
    FACES,
    G_SENSITIVITY,
    NO_ACCEL,
    OTHER_RATES,
    Outcome,
    calibrate,
    limits_of,
)
from undrift.fit.least_squares import TriadFit
from undrift.model import Verdict
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

DEVICE = random_device(np.random.default_rng(21))
KINDS = (CASE, FACES, G_SENSITIVITY, OTHER_RATES, NO_ACCEL)


def made(kind):
    return simulate_session(kind, DEVICE, rng=np.random.default_rng(22), temp_c=25.0)


@pytest.mark.parametrize(
    ("kind", "limits"),
    [
        ("multi_position", (CASE, G_SENSITIVITY)),
        ("ferraris", (FACES, OTHER_RATES)),
        ("bench", (FACES,)),
        ("six_face", (FACES,)),
    ],
)
def test_each_kind_of_session_names_its_own_limits_and_no_other(kind, limits):
    verdict = calibrate(made(kind)).verdict
    assert tuple(reason for reason in verdict.reasons if reason in KINDS) == limits


def test_the_limits_alone_leave_a_verdict_good():
    verdict = calibrate(made("multi_position")).verdict
    assert verdict.status == "good"
    assert verdict.reasons[:2] == (CASE, G_SENSITIVITY)
    assert verdict.reasons[2].startswith("offset and scale were seen at one temperature, ")
    assert len(verdict.reasons) == 3


def test_a_rate_table_without_an_accelerometer_asks_for_one_once():
    session = made("bench")
    numb = replace(session, records=tuple(replace(r, accel=None) for r in session.records), stills=())
    found = calibrate(numb)
    assert (
        sum("g-sensitivity" in reason for reason in found.verdict.reasons) == 1
    )  # the fit saw its effect, and says so
    fit = found.gyro
    triad = TriadFit(
        model=fit, residuals=np.zeros(3), verdict=Verdict(remarks=("which tells the g-sensitivity apart",))
    )
    gyro = Outcome(fit=triad, method="rate-table")
    assert limits_of(Outcome(), gyro, 25.0, thermal=True).reasons == ()
    quiet = replace(gyro, fit=replace(triad, verdict=Verdict()))
    assert limits_of(Outcome(), quiet, 25.0, thermal=True).reasons == (NO_ACCEL,)


def test_a_thermal_session_is_not_sent_to_record_one():
    warm = replace(made("six_face"), kind="thermal")
    assert not any("one temperature" in reason for reason in calibrate(warm).verdict.reasons)


def test_one_temperature_is_told_with_its_figure_or_with_the_lack_of_one():
    session = made("six_face")
    found = calibrate(session)
    told = (
        f"one temperature, {found.reference_temp_c:.1f} degC; at others a thermal session tells them, by undrift drift"
    )
    assert any(told in reason for reason in found.verdict.reasons)
    blind = replace(
        session,
        records=tuple(replace(r, temp_c=None) for r in session.records),
        stills=tuple(replace(s, temp_c=None) for s in session.stills),
        turns=tuple(replace(t, temp_c=None) for t in session.turns),
    )
    assert any("one temperature, which was not recorded;" in reason for reason in calibrate(blind).verdict.reasons)


def test_a_session_of_several_temperatures_is_sent_to_drift_once():
    session = made("bench")
    stills = tuple(replace(s, temp_c=25.0) for s in session.stills)
    turns = tuple(replace(t, temp_c=40.0 if k % 10 == 9 else 25.0) for k, t in enumerate(session.turns))
    reasons = calibrate(replace(session, stills=stills, turns=turns)).verdict.reasons
    assert sum("undrift drift" in reason for reason in reasons) == 1
