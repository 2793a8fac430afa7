"""What a session contains: the mean rate of its rests, the pieces of one temperature, and the sources of error between them."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cohorts import COHORTS, share_limits
from undrift.calibration.calibrate import calibrate
from undrift.calibration.quality import piece_temperatures
from undrift.calibration.session import Observed, at_one_temperature, mean_of_rests, observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.sources import creep_of, flicker_about_mean, temperature_span, walk_about_mean
from undrift.record import RateTable, Record, Session, Still, TemperatureSensitivity
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_session
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session
from undrift.units import STANDARD_GRAVITY

# ---- mean of rests: its stated variance is the one that repeated experiments show


def covered(rng, count, between, *, correlated=0.0, length=2000, trials):
    """Return the share of 95 % intervals that hold the truth, here zero."""
    held = 0
    for _ in range(trials):
        windows = []
        for _ in range(count):
            noise = rng.standard_normal((length, 3))
            if correlated:
                noise += correlated * np.repeat(rng.standard_normal((length // 50, 3)), 50, axis=0)
            windows.append(noise + between * rng.standard_normal(3))
        mean, variance = mean_of_rests(windows, [50] * count)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
    return held / (3 * trials)


@pytest.mark.parametrize("trials", COHORTS)
@pytest.mark.parametrize(
    ("count", "between", "correlated"),
    [(1, 0.0, 0.0), (1, 0.0, 1.0), (11, 0.0, 0.0), (11, 1.0, 0.0), (4, 1.0, 0.0), (11, 0.1, 1.0)],
)
def test_intervals_hold_whether_rests_scatter_or_not(count, between, correlated, trials):
    share = covered(np.random.default_rng(41), count, between, correlated=correlated, trials=trials)
    print(f"{count} rests, scatter {between}, correlated {correlated}: {100 * share:.1f} % of 95 % intervals hold")
    low, high = share_limits(3 * trials)
    assert low <= share <= max(high, 0.995)  # the larger of two block lengths is a little too wide on white noise


def test_readings_without_any_scatter_have_none():
    mean, variance = mean_of_rests([np.ones((200, 3)), np.ones((300, 3))], [50, 50])
    np.testing.assert_allclose(mean, 1.0, rtol=1e-14)
    assert (variance < 1e-20).all()


@pytest.mark.slow
@pytest.mark.parametrize("warmth", [(-0.6, -0.5, -0.1, 1.2), (0.1, 0.5, 0.9, 1.3)])
def test_creeping_offsets_cost_what_their_slope_leaves_unknown(warmth):
    rng, held, stated, scatter = np.random.default_rng(43), 0, [], []
    away = np.array(warmth)  # K above the reference, of each rest
    for _ in range(100):
        slope = rng.normal(0.0, 0.5, 3)
        windows = [rng.standard_normal((2000, 3)) + item * slope for item in away]
        mean, variance = mean_of_rests(windows, [50] * 4, 0.5 * away)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
        stated.append(variance)
        scatter.append(mean_of_rests(windows, [50] * 4)[1])
    assert share_limits(300)[0] <= held / 300 <= 0.995  # as above
    # Taken for scatter, 0.5 per K over a span near 1 K leaves 0.1 to 0.2; known as a slope little more than noise, 0.01 to 0.03
    assert np.sqrt(np.mean(stated) / np.mean(scatter)) < 0.25


# ---- a session of several set-points: the constant model is that of one of them


@pytest.mark.slow
def test_faces_at_room_temperature_go_with_the_nearest_rates() -> None:
    rng = np.random.default_rng(3)
    device = random_device(rng, grade="bmi270")
    settings = ThermalSettings(set_points_c=(15.0, 22.0, 30.0, 45.0), faces="six")
    whole = simulate_thermal_session("soak", device, rng=rng, settings=settings)
    temps = piece_temperatures(whole, whole.stills)
    session = replace(whole, stills=tuple(s for s, c in zip(whole.stills, temps, strict=True) if abs(c - 22.0) < 2.0))
    turns = piece_temperatures(whole, whole.turns)
    session = replace(session, turns=tuple(t for t, c in zip(whole.turns, turns, strict=True) if abs(c - 22.0) > 2.0))
    kept, _ = at_one_temperature(session)
    assert {still.face for still in kept.stills} == {"+x", "-x", "+y", "-y", "+z", "-z"}
    assert abs(piece_temperatures(kept, kept.turns) - 30.0).max() < 1.5
    calibration = calibrate(session)
    assert calibration.accel is not None
    truth = true_calibration(device, temp_c=22.0).accel
    assert truth is not None
    off = np.abs(np.diag(calibration.accel.matrix @ np.linalg.inv(truth.matrix)) - 1.0)
    assert off.max() < 2e-3
    assert "session.temperature" in {item.code for item in calibration.verdict.findings}


def test_a_session_that_warms_a_little_is_left_as_it_is() -> None:
    rng = np.random.default_rng(4)
    session = simulate_session("bench", random_device(rng, grade="bmi270"), rng=rng, temp_c=(24.0, 29.0))
    kept, findings = at_one_temperature(session)
    assert kept is session
    assert findings == ()


# ---- Temperature creep: what it adds to the covariance of readings, and that a steady thermometer adds nothing

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


def test_lag_of_a_thermometer_on_a_ramp_is_added_back() -> None:
    per_s, lag_s = 1.2 / (STILL_S * len(UP)), 80.0
    seen = seen_of(np.linspace(24.0, 25.2, N))  # as read: the sensors are warmer by lag times the rate
    lagging = replace(seen, session=replace(seen.session, sensitivity=TemperatureSensitivity(thermometer_lag_s=lag_s)))
    plain, added = (creep_of(item, item.stills, "gyro") for item in (seen, lagging))
    np.testing.assert_allclose(added.warmth - plain.warmth, lag_s * per_s, rtol=1e-3)
    stated = replace(
        lagging.session, stills=tuple(replace(s, temp_c=24.0 + 0.1 * k) for k, s in enumerate(seen.stills))
    )
    of_points = creep_of(replace(lagging, session=stated, stills=stated.stills), stated.stills, "gyro")
    np.testing.assert_allclose(
        of_points.warmth, 0.1 * (np.arange(12) - 5.5), atol=2e-3
    )  # stated set-points have no lag


def test_thermometer_of_one_step_hides_a_rise_by_one_step() -> None:
    seen = seen_of(np.where(np.arange(N) < 900, 25.0, 25.5))
    creep = creep_of(seen, seen.stills, "gyro")
    np.testing.assert_allclose(creep.warmth, 0.5 * np.linspace(-0.5, 0.5, 12), atol=1e-9)


def test_session_without_temperatures_has_the_stated_span() -> None:
    seen = seen_of(None)
    creep = creep_of(seen, seen.stills, "accel")
    np.testing.assert_allclose(creep.warmth, np.linspace(-0.5, 0.5, 12), atol=1e-9)
    assert temperature_span(seen) == ()


def test_a_span_above_the_limit_is_a_finding() -> None:
    seen = seen_of(np.linspace(24.0, 24.0 + 3.6 * 12 / 11, N))
    (result,) = temperature_span(seen)
    assert result.code == "session.temperature"
    assert result.values["span_k"] == pytest.approx(3.6, rel=1e-3)
    wide = replace(seen, session=replace(seen.session, sensitivity=TemperatureSensitivity(span_limit_k=4.0)))
    assert temperature_span(wide) == ()


# ---- flicker: its covariance is that of exponential correlations, and rests that flicker show its size

SPAN = np.array([[0.0, 6.0], [8.0, 14.0], [50.0, 54.0]])


def correlation(time: np.ndarray) -> np.ndarray:
    """Return the correlation of a process at times (N,), nine time constants evenly from 1 s to 10^4 s on a log scale."""
    apart = np.abs(time[:, None] - time)
    return np.asarray(np.mean([np.exp(-apart / 10.0**power) for power in np.linspace(0.0, 4.0, 9)], axis=0))


def averages(span: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the rows (E, N) that average over stretches."""
    inside = np.array([(time > start) & (time < stop) for start, stop in span], float)
    return np.asarray(inside / inside.sum(axis=1)[:, None])


def test_mean_over_all_stretches_is_subtracted() -> None:
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


# ---- a source of stated size that no residual shows


@pytest.mark.parametrize(
    ("rate", "with_accel", "named"),
    [(1e-3, True, {"rate"}), (1e-6, True, set()), (1e-3, False, {"rate", "mounting"})],
)
def test_a_source_of_stated_size_that_no_residual_shows_is_named(
    rate: float, with_accel: bool, named: set[str]
) -> None:
    device = random_device(np.random.default_rng(7))
    session = simulate_session("bench", device, rng=np.random.default_rng(8))
    records = session.records if with_accel else tuple(replace(record, accel=None) for record in session.records)
    verdict = calibrate(replace(session, records=records, rate_table=RateTable(rate_uncertainty=rate))).verdict
    of_gyros = [item for item in verdict.findings if item.code == "session.stated" and "gyroscopes" in item.text]
    assert {item.values["source"] for item in of_gyros} - {"temperature"} == named
    assert {item.level for item in of_gyros} <= {"info"}
