"""Temperature creep: what it adds to the covariance of readings, and that a steady thermometer adds nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

import undrift
from testkit.cohorts import COHORTS, FALSE_ALARM, share_limits
from testkit.data import show
from testkit.findings import codes, only
from undrift.calibration.session import Observed, observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.sources import (
    creep_of,
    flicker_about_mean,
    flicker_of_means,
    offset_drift,
    walk_about_mean,
)
from undrift.record import Record, Session, Still, TemperatureSensitivity
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

RATE_HZ, STILL_S = 50.0, 8.0
UP = np.repeat(np.vstack((np.eye(3), -np.eye(3))), 2, axis=0)  # twelve rests


def seen_of(temp_c: np.ndarray | None, gyro_drift_dps: float = 0.0) -> Observed:
    """Return twelve stated rests end to end at a temperature of each sample, gyroscopes drifting evenly."""
    count = round(STILL_S * RATE_HZ)
    n = count * len(UP)
    noise = np.random.default_rng(5).normal(0.0, 0.01, (2, n, 3))
    drift = gyro_drift_dps * (np.arange(n) / n - 0.5)
    record = Record(
        time=np.arange(n) / RATE_HZ,
        gyro=noise[0] + drift[:, None] * [1.0, -1.0, 1.0],
        accel=STANDARD_GRAVITY * np.repeat(UP, count, axis=0) + noise[1],
        temp_c=temp_c,
        gyro_unit="dps",
    )
    stills = tuple(Still(start=k * count, stop=(k + 1) * count) for k in range(len(UP)))
    session = Session(kind="calibration", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=stills)
    return observe(session, CalibrateSettings())


N = round(STILL_S * RATE_HZ) * len(UP)


def test_the_covariance_is_that_of_slopes_drawn_from_the_prior() -> None:
    seen = seen_of(np.linspace(24.0, 25.2, N))
    creep = creep_of(seen, seen.stills, "accel")
    np.testing.assert_allclose(creep.warmth, np.linspace(-0.55, 0.55, 12), atol=2e-3)
    rng, signal, gain = np.random.default_rng(6), STANDARD_GRAVITY * UP[:, 0], 417.0
    offset = rng.normal(0.0, 0.5e-3 * STANDARD_GRAVITY, (20_000, 1))
    scale = rng.normal(0.0, 2e-4, (20_000, 1))
    drawn = gain * creep.warmth * (offset + scale * signal)
    expected = creep.columns(signal, gain) @ creep.columns(signal, gain).T
    # the standard error of a variance of 20,000 draws is 1 %, that of a covariance no more: five of them
    np.testing.assert_allclose(drawn.T @ drawn / 20_000, expected, atol=0.05 * expected.max())


def test_what_a_thermometer_lags_behind_on_a_ramp_is_added_back_and_counts_in_the_reference() -> None:
    per_s, lag_s = 1.2 / (STILL_S * len(UP)), 80.0
    seen = seen_of(np.linspace(24.0, 25.2, N))  # as read: the sensors are warmer by lag times the rate
    lagging = replace(seen, session=replace(seen.session, sensitivity=TemperatureSensitivity(thermometer_lag_s=lag_s)))
    plain, added = (creep_of(each, each.stills, "gyro") for each in (seen, lagging))
    np.testing.assert_allclose(added.warmth - plain.warmth, lag_s * per_s, rtol=1e-3)
    assert added.span_k == pytest.approx(plain.span_k, rel=1e-6)  # the lag moves all alike
    stated = replace(
        lagging.session, stills=tuple(replace(s, temp_c=24.0 + 0.1 * k) for k, s in enumerate(seen.stills))
    )
    of_points = creep_of(replace(lagging, session=stated, stills=stated.stills), stated.stills, "gyro")
    np.testing.assert_allclose(
        of_points.warmth, 0.1 * (np.arange(12) - 5.5), atol=2e-3
    )  # stated set-points have no lag


def test_thermometer_that_shows_one_step_hides_a_rise_by_one_step() -> None:
    seen = seen_of(np.where(np.arange(N) < 900, 25.0, 25.5))
    creep = creep_of(seen, seen.stills, "gyro")
    np.testing.assert_allclose(creep.warmth, 0.5 * np.linspace(-0.5, 0.5, 12), atol=1e-9)


def test_session_without_temperatures_has_the_stated_span() -> None:
    seen = seen_of(None)
    creep = creep_of(seen, seen.stills, "accel")
    np.testing.assert_allclose(creep.warmth, np.linspace(-0.5, 0.5, 12), atol=1e-9)
    assert creep.findings() == ()


def test_a_real_creep_shows_through_the_noise_and_steps() -> None:
    true = np.linspace(-0.5, 0.5, N)
    shown = np.round((true + np.random.default_rng(7).normal(25.0, 0.05, N)) / 0.125) * 0.125
    seen = seen_of(shown)
    warmth = creep_of(seen, seen.stills, "accel").warmth
    np.testing.assert_allclose(warmth, true.reshape(12, -1).mean(axis=1), atol=0.125 / 2)


def test_a_span_above_the_limit_is_a_finding() -> None:
    seen = seen_of(np.linspace(24.0, 24.0 + 3.6 * 12 / 11, N))
    (found,) = creep_of(seen, seen.stills, "accel").findings()
    assert found.code == "session.temperature"
    assert found.values["span_k"] == pytest.approx(3.6, rel=1e-3)
    wide = replace(seen, session=replace(seen.session, sensitivity=TemperatureSensitivity(span_limit_k=4.0)))
    assert creep_of(wide, seen.stills, "accel").findings() == ()


def test_a_session_states_the_sensitivity() -> None:
    stated = TemperatureSensitivity(accel_offset_mg_per_k=0.1, gyro_offset_dps_per_k=0.01)
    seen = seen_of(np.linspace(24.0, 25.0, N))
    seen = replace(seen, session=replace(seen.session, sensitivity=stated))
    assert creep_of(seen, seen.stills, "gyro").offset_per_k == pytest.approx(0.01 * RADIAN_PER_DEGREE)


# ---- flicker: its covariance is that of exponential correlations, and rests that flicker show its size

FLICKER_HZ = 10.0
SPAN = np.array([[0.0, 6.0], [8.0, 14.0], [50.0, 54.0]])


def correlation(time: np.ndarray) -> np.ndarray:
    """Return the correlation of a process at times (N,), nine time constants evenly from 1 s to 10^4 s on a log scale."""
    apart = np.abs(time[:, None] - time)
    return np.asarray(np.mean([np.exp(-apart / 10.0**power) for power in np.linspace(0.0, 4.0, 9)], axis=0))


def averages(span: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the rows (E, N) that average over stretches."""
    inside = np.array([(time > start) & (time < stop) for start, stop in span], float)
    return np.asarray(inside / inside.sum(axis=1)[:, None])


@pytest.mark.slow
def test_the_covariance_of_means_is_the_correlation_averaged_over_both_stretches() -> None:
    span = np.vstack((SPAN, [3.0, 52.0]))  # the last overlaps the others
    time = np.arange(0.01, 54.0, 0.02)
    rows = averages(span, time)
    # the sum over steps of 0.02 s misses the integral by (0.02 s / 1 s)^2 / 12 or less
    np.testing.assert_allclose(flicker_of_means(span), rows @ correlation(time) @ rows.T, atol=4e-5)


def test_the_mean_from_the_first_to_the_last_stretch_is_taken_off() -> None:
    time = np.arange(0.01, 54.0, 0.02)
    rows = averages(SPAN, time) - averages(np.array([[0.0, 54.0]]), time)
    np.testing.assert_allclose(flicker_about_mean(SPAN), rows @ correlation(time) @ rows.T, atol=2e-4)
    assert flicker_about_mean(np.array([[5.0, 9.0]])) == 0.0  # one stretch is its own mean


def test_a_walk_about_its_mean_has_the_covariance_of_drawn_walks() -> None:
    rng, time = np.random.default_rng(4), np.linspace(0.0, 100.0, 401)
    walks = np.cumsum(rng.normal(0.0, 0.5, (4000, 401)), axis=1)  # 0.25 s a step: variance 1 per second
    picked = [0, 80, 200, 400]
    drawn = (walks - walks.mean(axis=1)[:, None])[:, picked]
    # 4,000 walks know a variance to 2.2 %, of which the largest is 33
    np.testing.assert_allclose(walk_about_mean(time[picked]), drawn.T @ drawn / 4000, atol=0.1 * 33.0)


# ---- rest offsets that differ between start and end of a session: found where they drift, not where they scatter

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


@pytest.mark.slow
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


@pytest.mark.slow
def test_calibrate_tells_of_a_bench_session_that_drifts():
    device = undrift.random_device(np.random.default_rng(7))
    session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    assert not [code for code in codes(undrift.calibrate(session).verdict.findings) if "offset_drift" in code]
    records = [replace(r, gyro=r.gyro + 2.0 * r.time[:, None] / r.time[-1] * [0.0, 0.0, 1.0]) for r in session.records]
    drifting = undrift.calibrate(replace(session, records=tuple(records)))
    found = only(drifting.verdict.findings, "session.offset_drift")
    assert drifting.verdict.status != "good"
    assert found.values["axis"] == "z"
