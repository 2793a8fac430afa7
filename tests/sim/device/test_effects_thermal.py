"""Offset and scale over temperature, warm-up, hysteresis, and the thermometer that is to tell of it."""

import numpy as np
import pytest

from testkit.simulated_device import chain, device_of, motion_of, run, still_motion
from undrift.errors import InputError
from undrift.sim.device.effects import Offset, PowerOnTransient, ThermalHysteresis, ThermalScale, Thermometer, play


def test_the_offset_is_a_polynomial_of_the_warmth_and_the_thermal_scale_acts_on_all_before_it() -> None:
    n = 61
    temp = np.linspace(10.0, 70.0, n)
    rate = np.tile([1.0, 0.0, -1.0], (n, 1))
    motion = motion_of(np.arange(n) / 10.0, rate)
    offset = Offset(constant=np.full(3, 0.1), per_k=np.array([[0.01, 0.02, 0.0], [1e-4, 0.0, 0.0], [0.0, 0.0, 1e-6]]))
    scale = ThermalScale(per_k=np.array([[2e-3, 0.0, 1e-3]]))
    made = run(device_of(chain(offset=offset, thermal_scale=scale)), motion, temp_c=temp)
    d = temp - 25.0
    shift = np.stack((0.1 + 0.01 * d + 1e-4 * d**2, 0.1 + 0.02 * d, 0.1 + 1e-6 * d**3), axis=1)
    factor = np.stack((1.0 + 2e-3 * d, np.ones(n), 1.0 + 1e-3 * d), axis=1)
    np.testing.assert_allclose(made.gyro.of("offset"), shift, atol=1e-14)
    np.testing.assert_allclose(made.record.gyro, (rate + shift) * factor, atol=1e-14)


def test_a_young_device_settles_exponentially_from_power_on() -> None:
    motion = still_motion(1001, 10.0)
    warm_up = PowerOnTransient(amplitude=[0.1, 0.0, -0.2], time_constant_s=30.0)  # type: ignore[arg-type]
    device = device_of(chain(warm_up=warm_up))
    gyro = run(device, motion, temp_c=35.0).record.gyro
    np.testing.assert_allclose(gyro[:, 0], -0.1 * np.exp(-motion.time / 30.0), atol=1e-15)  # type: ignore[index]
    np.testing.assert_allclose(gyro[:, 2], 0.2 * np.exp(-motion.time / 30.0), atol=1e-15)  # type: ignore[index]
    later = run(device, motion, temp_c=35.0, power_on_s=50.0).record.gyro
    np.testing.assert_allclose(later[:500], gyro[500:1000], atol=1e-15)  # type: ignore[index]


def test_warming_and_cooling_trace_a_loop_of_the_stated_width_at_any_speed() -> None:
    device = device_of(chain(hysteresis=ThermalHysteresis(amplitude=[0.01, 0.0, -0.02], play_k=1.0)))  # type: ignore[arg-type]
    for samples in (400, 4000):
        up = np.linspace(20.0, 60.0, samples)
        temp = np.concatenate((up, up[::-1], up))
        made = run(device, still_motion(len(temp)), temp_c=temp).gyro.of("hysteresis")
        middle = [samples // 2, samples + samples // 2, 2 * samples + samples // 2]  # 40 degC, upward, downward, upward
        np.testing.assert_allclose(made[middle, 0], [-0.01, 0.01, -0.01], atol=1e-12)
        np.testing.assert_allclose(made[middle, 2], [0.02, -0.02, 0.02], atol=1e-12)
        turning = made[samples : 2 * samples, 0]
        fallen = 60.0 - temp[samples : 2 * samples]
        np.testing.assert_allclose(turning, 0.01 * np.clip(fallen - 1.0, -1.0, 1.0), atol=1e-12)
    np.testing.assert_array_equal(play(np.full(5, 30.0), 1.0), 30.0)


def test_a_thermometer_answers_a_step_with_its_lag_and_warms_itself() -> None:
    motion = still_motion(3001, 10.0)
    slow = Thermometer(lag_s=80.0, trim_error_c=1.0)
    step = np.where(motion.time < 10.0, 20.0, 30.0)
    said = run(device_of(thermometer=slow), motion, temp_c=step).record.temp_c
    assert said is not None
    # Between the samples at 9.9 and 10.0 s the temperature rises straight: the answer is exact for that.
    h, since = 0.1, motion.time[101:] - 10.0
    risen = 1.0 - 80.0 / h * (1.0 - np.exp(-h / 80.0))
    felt = 30.0 - 10.0 * (1.0 - risen) * np.exp(-since / 80.0)
    np.testing.assert_allclose(said[101:], felt + 1.0, atol=1e-9)
    assert said[50] == pytest.approx(20.0 + 1.0)
    own = run(device_of(thermometer=Thermometer(lag_s=80.0, self_heating_c=0.6)), motion, temp_c=25.0).record.temp_c
    np.testing.assert_allclose(own, 25.0 + 0.6 * (1.0 - np.exp(-motion.time / 80.0)), atol=1e-12)


def test_an_lm335_counts_kelvins_by_the_step_of_its_converter() -> None:
    board = Thermometer(step_c=5.0 / 2**12 / 0.010, zero_c=-273.15)  # 12 bits of 5 V, 10 mV/K
    said = run(device_of(thermometer=board), still_motion(3), temp_c=25.0).record.temp_c
    assert said is not None
    assert said[0] == pytest.approx(round(298.15 / board.step_c) * board.step_c - 273.15)
    assert abs(said[0] - 25.0) <= board.step_c / 2.0
    noisy = run(device_of(thermometer=Thermometer(noise_c=0.1)), still_motion(20_000), temp_c=25.0).record.temp_c
    assert np.std(noisy) == pytest.approx(0.1, rel=4.0 / np.sqrt(2.0 * 20_000))  # type: ignore[arg-type]


def test_an_uneven_grid_and_a_negative_lag_are_refused() -> None:
    motion = motion_of(np.array([0.0, 0.1, 0.3, 0.4]), np.zeros((4, 3)))
    with pytest.raises(InputError, match=r"thermometer: .*evenly spaced"):
        run(device_of(thermometer=Thermometer(lag_s=1.0)), motion, temp_c=np.array([20.0, 21.0, 22.0, 23.0]))
    with pytest.raises(InputError, match=r"Thermometer.lag_s: .*0 or more, got -1"):
        Thermometer(lag_s=-1.0)
