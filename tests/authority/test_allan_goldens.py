"""Overlapping Allan deviation of the NBS14 1000-point set, and of a real device at rest.

The set is the linear congruential sequence of NIST SP 1065 section 12.4: n_(i+1) = 16807 n_i mod 2147483647 from
n_0 = 1234567890, divided by 2147483647. Golden figures: allantools 2024.6, run once.
"""

import gzip

import numpy as np

from testkit.data import data_path, show
from undrift.calibration.noise import allan_deviation, fit_noise
from undrift.record import Record
from undrift.units import STANDARD_GRAVITY

GOLDEN = (0.29223188, 0.09159953, 0.03241343)


def nbs14() -> np.ndarray:
    n = [1234567890]
    for _ in range(999):
        n.append(16807 * n[-1] % 2147483647)
    return np.array(n) / 2147483647.0


def test_the_thousand_point_set_gives_the_published_deviations() -> None:
    got = allan_deviation(nbs14(), 1.0, taus=[1.0, 10.0, 100.0]).deviation
    show("overlapping Allan deviation", np.round(got, 8), GOLDEN)
    np.testing.assert_allclose(got, GOLDEN, atol=5.1e-9)  # printed to eight decimals


def test_a_resting_mpu6050_has_the_noise_its_maker_states() -> None:
    with gzip.open(data_path("static_mpu6050", "example_data_tinit_calc.csv.gz"), "rt") as file:
        log = np.loadtxt(file, delimiter=",", skiprows=5)
    record = Record(
        time=np.arange(len(log)) / 100.0,
        accel=log[:, :3] / 16384.0,
        gyro=log[:, 3:] / 131.0,
        accel_unit="g",
        gyro_unit="dps",
    )
    fit = fit_noise(record)
    walk = np.degrees([a.angle_random_walk.value for a in fit.gyro])
    force = np.array([a.angle_random_walk.value for a in fit.accel]) / STANDARD_GRAVITY * 1e6
    show("angle random walk, deg/s/sqrt(Hz)", np.round(walk, 4), "0.005 at 10 Hz, one-sided density (data sheet)")
    show("velocity random walk, ug/sqrt(Hz)", np.round(force), "400, one-sided density (data sheet)")
    assert (walk > 0.003).all()
    assert (walk < 0.015).all()
    assert (force > 150.0).all()
    assert (force < 600.0).all()
    for axis in fit.gyro:  # 449 s show no floor: a number here would be invented
        assert np.isnan(axis.bias_instability.value)
        assert "record longer" in axis.bias_instability.reason
