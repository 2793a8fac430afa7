"""What a session contains: the mean rate of its rests, and the pieces of one temperature."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cohorts import COHORTS, share_limits
from testkit.findings import only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.quality import piece_temperatures
from undrift.calibration.session import at_one_temperature, mean_of_rests
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_session
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session

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


def test_scatter_between_rests_is_not_taken_for_noise_of_samples():
    rng = np.random.default_rng(42)
    windows = [0.01 * rng.standard_normal((2400, 3)) + shift for shift in np.linspace(-0.1, 0.1, 11)]
    variance = mean_of_rests(windows, [50] * 11)[1]
    white = 0.01**2 / (11 * 2400)
    # standard deviation of the shifts 0.066 over sqrt(11), times Student's factor 1.14
    np.testing.assert_allclose(np.sqrt(variance), 0.0663 / np.sqrt(11) * 1.137, rtol=0.02)
    assert (variance > 100.0 * white).all()


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
def test_thermal_session_is_calibrated_near_room_temperature() -> None:
    rng = np.random.default_rng(3)
    device = random_device(rng, grade="bmi270")
    session = simulate_thermal_session(
        "soak", device, rng=rng, settings=ThermalSettings(set_points_c=(15.0, 27.0, 45.0), faces="six")
    )
    calibration = calibrate(session)
    assert abs(calibration.reference_temp_c - 27.0) < 1.5  # the thermometer's trim and the soak's tolerance
    visited = only(calibration.verdict.findings, "session.temperature")
    assert (visited.level, visited.values["groups"]) == ("warn", 3)
    truth = true_calibration(device, temp_c=27.0)
    assert calibration.gyro is not None
    assert truth.gyro is not None
    np.testing.assert_allclose(
        calibration.gyro.matrix / truth.gyro.matrix.max(), truth.gyro.matrix / truth.gyro.matrix.max(), atol=2e-3
    )


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
