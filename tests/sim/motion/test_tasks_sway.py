"""Sway: the spectrum is that of the pendulum, and the sinusoids have the spectrum."""

import numpy as np
import pytest

from testkit.data import show
from undrift.sim.motion.tasks import BAND_HZ, GYRATION, Balance, draw_sway, sway_spectrum

BALANCE = Balance(centre_height=0.9)


def stepped_response(balance: Balance, frequency_hz: float) -> float:
    """Amplitude of the angle when the noise is a sinusoid: the delayed pendulum stepped through time by Heun's rule."""
    h = 1e-3
    inertia, lag = GYRATION * balance.centre_height / 9.80665, round(balance.delay_s / h)
    count = round(120.0 / h)
    torque = np.sin(2.0 * np.pi * frequency_hz * np.arange(count + 1) * h)
    noise = angle = rate = total = 0.0
    past = np.zeros((count + 1, 3))
    said = np.zeros(count)
    for k in range(count):
        past[k] = angle, rate, total
        held = past[max(k - lag, 0)] if k >= lag else np.zeros(3)
        control = balance.kp * held[0] + balance.kd * held[1] + balance.ki * held[2]
        mean_noise = noise + 0.5 * h * (torque[k] - noise) / balance.noise_s
        push = (angle + 0.5 * h * rate - control + mean_noise) / inertia
        noise += h * (0.5 * (torque[k] + torque[k + 1]) - mean_noise) / balance.noise_s
        angle, rate, total = angle + h * rate + 0.5 * h * h * push, rate + h * push, total + h * angle
        said[k] = angle
    tail = said[-round(40.0 / h) :]
    turn = 2.0 * np.pi * frequency_hz * np.arange(count - len(tail) + 1, count + 1) * h
    return float(np.hypot(2.0 * np.mean(tail * np.sin(turn)), 2.0 * np.mean(tail * np.cos(turn))))


@pytest.mark.slow
def test_the_spectrum_is_that_of_a_delayed_pendulum_stepped_through_time() -> None:
    for frequency_hz in (0.1, 0.35, 1.0):
        stepped = stepped_response(BALANCE, frequency_hz)
        closed = float(np.sqrt(sway_spectrum(BALANCE, np.array([frequency_hz]))[0]))
        show(f"{frequency_hz} Hz: angle over torque, stepped and closed form", (stepped, closed), "1 %")
        assert stepped == pytest.approx(closed, rel=0.01)  # steps of 1 ms beside a delay of 170 ms


@pytest.mark.slow
def test_sinusoids_have_the_wanted_rms_and_on_average_the_spectrum() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 50.0, 0.05)
    shares = []
    for _ in range(200):
        sway = draw_sway(rng, BALANCE, rms=0.016, span=(0.0, 50.0))
        assert np.std(sway.at(time)[0]) == pytest.approx(0.016, rel=0.01)
        power = np.array(sway.amplitudes) ** 2
        shares.append(power[np.array(sway.frequencies_hz) > 0.2].sum() / power.sum())
    grid = np.geomspace(*BAND_HZ, 5_001)
    middle, density = np.sqrt(grid[1:] * grid[:-1]), np.diff(grid)
    power = sway_spectrum(BALANCE, middle) * density
    wanted = power[middle > 0.2].sum() / power.sum()
    show("share of power above 0.2 Hz: drawn, of the spectrum", (np.mean(shares), wanted), "4 sigma")
    assert np.mean(shares) == pytest.approx(
        wanted, abs=4.0 * np.std(shares) / np.sqrt(len(shares)) + 0.02
    )  # ratio of sums


def test_the_controller_holds_every_subject_up() -> None:
    """Nyquist: the loop gain of an unstable pole must go once round -1; for this loop it means a gain over 1 at rest
    and a positive margin where it falls to 1."""
    frequency = np.geomspace(1e-3, 20.0, 200_001)
    s = 2.0j * np.pi * frequency
    for height in (1.50, 1.85):
        for kp in (1.25, 1.60):
            pendulum = GYRATION * 0.54 * height / 9.80665 * s * s - 1.0
            gain = (kp + 0.40 * s + 0.05 / s) * np.exp(-0.17 * s) / pendulum
            crossing = np.flatnonzero(np.diff(np.sign(np.abs(gain) - 1.0)))
            assert len(crossing) == 1
            margin = float(np.degrees(np.angle(-gain[crossing[0]])))
            show(f"height {height} m, kp {kp}: phase margin, deg", round(margin, 1), "> 5")
            assert abs(gain[0]) > 1.0
            assert margin > 5.0
