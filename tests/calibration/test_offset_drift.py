"""Rest offsets that differ between start and end of a session: found where they drift, not where they scatter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

import undrift
from testkit.cohorts import COHORTS, FALSE_ALARM, share_limits
from testkit.data import show
from testkit.findings import codes, only
from undrift.calibration.creep import offset_drift
from undrift.calibration.observe import CalibrateSettings, observe
from undrift.record import Record, Session, Still

RATE, RESTS, HOLD, PAUSE = 50.0, 8, 400, 1600  # rests of 8 s, 40 s apart
DPS = np.pi / 180.0


def seen(rng, drift_dps=0.0, scatter_dps=0.002, temps=None, unit="rad/s", parts=1):
    """Return rests between moves; their offset drifts in z by so much from the first to the last and scatters by rest."""
    n = RESTS * PAUSE
    gyro = 0.0002 * rng.standard_normal((n, 3))
    accel = np.tile([0.0, 0.0, 9.81], (n, 1)) + 0.01 * rng.standard_normal((n, 3))
    stills = [Still(start=k * PAUSE, stop=k * PAUSE + HOLD) for k in range(RESTS)]
    for k, still in enumerate(stills):
        rest = slice(still.start, still.stop)
        gyro[rest] += DPS * scatter_dps * rng.standard_normal(3)
        gyro[rest, 2] += DPS * drift_dps * k / (RESTS - 1)
    scale = 1000.0 if unit == "count" else 1.0
    temp = None if temps is None else np.linspace(*temps, n)
    whole = Record(time=np.arange(n) / RATE, gyro=scale * gyro, accel=accel, temp_c=temp, gyro_unit=unit)
    step = RESTS // parts
    records = tuple(whole.between(k * step * PAUSE / RATE, (k + 1) * step * PAUSE / RATE) for k in range(parts))
    stills = tuple(
        Still(start=(k % step) * PAUSE, stop=(k % step) * PAUSE + HOLD, recording=k // step) for k in range(RESTS)
    )
    session = Session(kind="calibration", serial="A", gravity_m_s2=9.81, records=records, stills=stills)
    return observe(session, CalibrateSettings())


def test_a_drift_over_the_session_is_found_with_its_size():
    (found,) = offset_drift(seen(np.random.default_rng(1), drift_dps=0.05), 1.0)
    assert (found.code, found.level) == ("session.offset_drift", "warn")
    assert found.values["axis"] == "z"
    assert abs(found.values["change_dps"] - 0.05) < 1.5 * found.values["uncertainty_dps"]
    assert found.values["rests"] == RESTS
    assert found.values["minutes"] == pytest.approx((RESTS - 1) * PAUSE / RATE / 60.0)
    assert found.action.startswith("switch on 20 min before the session")


def test_a_significant_drift_that_is_small_leaves_the_verdict():
    (found,) = offset_drift(seen(np.random.default_rng(2), drift_dps=-0.015, scatter_dps=0.0005), 1.0)
    assert found.level == "info"
    assert found.values["change_dps"] < 0.0


@pytest.mark.parametrize("sessions", COHORTS)
def test_offsets_that_only_scatter_are_no_drift_more_often_than_stated(sessions):
    rng, false, covered = np.random.default_rng(3), 0, 0
    for _ in range(sessions):
        false += bool(offset_drift(seen(rng, scatter_dps=0.02), 1.0))
        for item in offset_drift(seen(rng, drift_dps=0.5, scatter_dps=0.02), 1.0):
            covered += abs(item.values["change_dps"] - 0.5) <= item.values["uncertainty_dps"]
    most, (low, high) = binom.ppf(1.0 - FALSE_ALARM, sessions, 0.01), share_limits(sessions)
    show(f"sessions of {sessions} without drift that are called drifting", false, most)
    show("share of intervals that hold the drift", covered / sessions, (low, high))
    assert false <= most  # one in a hundred by design
    assert low <= covered / sessions <= high


def test_the_temperature_is_told_where_it_changed():
    rng = np.random.default_rng(4)
    (warmer,) = offset_drift(seen(rng, drift_dps=0.05, temps=(24.0, 26.0)), 1.0)
    assert warmer.code == "session.offset_drift_warming"
    assert warmer.values["first_c"] == pytest.approx(24.03, abs=0.01)
    assert warmer.values["last_c"] == pytest.approx(25.78, abs=0.01)
    assert "undrift drift" in warmer.action
    (steady,) = offset_drift(seen(rng, drift_dps=0.05, temps=(24.0, 24.2)), 1.0)
    assert steady.code == "session.offset_drift"


def test_counts_are_told_in_degrees_and_recordings_follow_each_other():
    (one,) = offset_drift(seen(np.random.default_rng(1), drift_dps=0.05), 1.0)
    (counts,) = offset_drift(seen(np.random.default_rng(1), drift_dps=0.05, unit="count", parts=4), 1e-3)
    assert counts.values["change_dps"] == pytest.approx(one.values["change_dps"], rel=1e-4)
    assert counts.values["minutes"] == pytest.approx(one.values["minutes"], rel=1e-3)  # a recording ends a sample early


@pytest.mark.parametrize("unit", ["m/s2", "g", "count"])
def test_poses_that_change_a_reading_by_g_sensitivity_are_no_drift_in_any_unit(unit):
    made = seen(np.random.default_rng(5))
    record, poses = made.session.records[0], np.vstack((np.eye(3), -np.eye(3), np.ones((2, 3)) / 3.0**0.5))
    accel, gyro = np.array(record.accel), np.array(record.gyro)
    for still, up in zip(made.stills, poses, strict=True):
        accel[still.start : still.stop] = 9.81 * up
        gyro[still.start : still.stop] += (
            DPS * 0.1 * up[::-1]
        )  # 0.1 deg/s/g: the last poses read otherwise than the first
    scale, shift = {"m/s2": (1.0, 0.0), "g": (1.0 / 9.81, 0.0), "count": (330.0, 32768.0)}[unit]
    turned = replace(record, accel=scale * accel + shift, gyro=gyro, accel_unit=unit)
    assert offset_drift(replace(made, session=replace(made.session, records=(turned,))), 1.0) == ()
    still_drifts = replace(turned, gyro=gyro + DPS * 0.5 * np.outer(record.time / record.time[-1], [0.0, 0.0, 1.0]))
    (found,) = offset_drift(replace(made, session=replace(made.session, records=(still_drifts,))), 1.0)
    assert found.values["axis"] == "z"


def test_thermal_sessions_and_few_rests_have_no_such_finding():
    made = seen(np.random.default_rng(1), drift_dps=0.5)
    assert offset_drift(replace(made, session=replace(made.session, kind="thermal")), 1.0) == ()
    assert offset_drift(replace(made, stills=made.stills[:3]), 1.0) == ()


def test_calibrate_tells_of_a_bench_session_that_drifts():
    device = undrift.random_device(np.random.default_rng(7))
    session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    assert not [code for code in codes(undrift.calibrate(session).verdict.findings) if "offset_drift" in code]
    records = [replace(r, gyro=r.gyro + 2.0 * r.time[:, None] / r.time[-1] * [0.0, 0.0, 1.0]) for r in session.records]
    drifting = undrift.calibrate(replace(session, records=tuple(records)))
    found = only(drifting.verdict.findings, "session.offset_drift")
    assert drifting.verdict.status != "good"
    assert found.values["axis"] == "z"
