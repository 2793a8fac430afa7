"""Scale, lever arm, non-linearity, g-sensitivity, rate drift: each alone against a closed form."""

import numpy as np
import pytest

from testkit.simulated_device import chain, device_of, motion_of, run, still_motion
from undrift.errors import InputError
from undrift.sim.device.effects import GSensitivity, LeverArm, Nonlinearity, RateDrift, Scale

TIME = np.arange(101) / 100.0
RAMP = np.linspace(-3.0, 3.0, 101)[:, None] * np.array([1.0, 0.5, -1.0])


def test_scale_and_axes_are_one_matrix() -> None:
    lean = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    scale = Scale(nominal_sensitivity=2.0, error=np.array([0.1, 0.0, -0.1]), axes=lean)
    made = run(device_of(chain(scale=scale)), motion_of(TIME, RAMP))
    x, y, z = RAMP.T
    wanted = 2.0 * np.stack((1.1 * x, y, 0.9 * (0.6 * x + 0.8 * z)), axis=1)
    np.testing.assert_allclose(made.record.gyro, wanted, atol=1e-14)
    np.testing.assert_allclose(made.gyro.of("scale"), wanted / 2.0 - RAMP, atol=1e-14)


def test_each_accelerometer_of_a_body_that_turns_while_it_travels_feels_its_own_place() -> None:
    step = 1e-4
    time = np.arange(20001) * step
    angle, rate, spin = 0.8 * np.sin(5.0 * time), 4.0 * np.cos(5.0 * time), -20.0 * np.sin(5.0 * time)
    travel = np.stack((0.3 * np.sin(3.0 * time), 0.1 * time**3, 0.2 * np.cos(2.0 * time)), axis=1)
    pull = np.stack((-2.7 * np.sin(3.0 * time), 0.6 * time, 9.81 - 0.8 * np.cos(2.0 * time)), axis=1)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    hat = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turn = np.eye(3) + np.sin(angle)[:, None, None] * hat + (1.0 - np.cos(angle))[:, None, None] * (hat @ hat)
    arms = np.array([[0.02, 0.0, 0.01], [0.0, -0.03, 0.0], [0.05, 0.05, 0.05]])
    motion = motion_of(
        time,
        np.outer(rate, axis),
        np.einsum("nji,nj->ni", turn, pull),
        angular_acceleration_b=np.outer(spin, axis),
    )
    felt = run(device_of(accel=chain("m/s2", lever_arm=LeverArm(arms=arms))), motion).record.accel
    assert felt is not None
    weights = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * step**2)
    for sensor in range(3):
        place = travel + turn @ arms[sensor]
        pulled = sum(w * place[k : len(place) - 4 + k] for k, w in enumerate(weights)) + np.array([0.0, 0.0, 9.81])
        seen = np.einsum("nj,nj->n", turn[2:-2, :, sensor], pulled)
        # Fourth-order differences of doubles near 1 at 0.1 ms: 30 / 12 * 1e-16 / 1e-8 = 1e-7 of rounding, m/s2.
        np.testing.assert_allclose(felt[2:-2, sensor], seen, atol=1e-6)


def test_a_leaning_sensor_feels_its_own_lever_arm_along_its_own_axis() -> None:
    rate = np.tile([0.0, 0.0, 2.0], (5, 1))
    motion = motion_of(TIME[:5], rate, angular_acceleration_b=np.zeros((5, 3)))
    scale = Scale(nominal_sensitivity=1.0, axes=np.array([[0.8, 0.6, 0.0], [0, 1, 0], [0, 0, 1]]))
    arms = np.array([[0.1, 0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    made = run(device_of(accel=chain("m/s2", scale=scale, lever_arm=LeverArm(arms=arms))), motion)
    np.testing.assert_allclose(made.record.accel[:, 0], -4.0 * (0.8 * 0.1 + 0.6 * 0.2), atol=1e-14)  # type: ignore[index]
    np.testing.assert_allclose(made.accel.of("lever_arm")[:, 0], -0.4)


def test_non_linearity_bends() -> None:
    bend = Nonlinearity(quadratic=[0.01, 0.0, -0.02])  # type: ignore[arg-type]
    made = run(device_of(chain(nonlinearity=bend)), motion_of(TIME, RAMP))
    x, y, z = RAMP.T
    added = made.gyro.of("nonlinearity")
    np.testing.assert_allclose(added[:, 0], 0.01 * x**2, atol=1e-15)
    np.testing.assert_allclose(added[:, 2], -0.02 * z**2, atol=1e-15)
    np.testing.assert_allclose(made.record.gyro[:, 1], y, atol=1e-15)  # type: ignore[index]


def test_specific_force_feigns_a_rate() -> None:
    made = run(
        device_of(chain(g_sensitivity=GSensitivity(matrix=np.outer([0.0, 1e-3, 0.0], [0, 0, 1])))), still_motion(3)
    )
    np.testing.assert_allclose(made.record.gyro, np.tile([0.0, 9.81e-3, 0.0], (3, 1)))


def test_rate_drift_grows_with_rate_and_warmth() -> None:
    c = np.zeros((3, 2, 3))
    c[0, 0, 0], c[1, 1, 1], c[2, 1, 2] = 0.01, 0.002, 0.003
    made = run(device_of(chain(rate_drift=RateDrift(coefficients=c))), motion_of(TIME, RAMP), temp_c=35.0)
    x, y, z = RAMP.T
    wanted = np.stack((0.01 * x, 0.002 * y**2 * 10.0, 0.003 * z**3 * 10.0), axis=1)
    np.testing.assert_allclose(made.gyro.of("rate_drift"), wanted, atol=1e-15)


def test_what_no_device_can_be_is_refused() -> None:
    with pytest.raises(InputError, match="unit vectors"):
        Scale(nominal_sensitivity=1.0, axes=2.0 * np.eye(3))
    with pytest.raises(InputError, match="sensitivity must be positive"):
        Scale(nominal_sensitivity=0.0)
    with pytest.raises(InputError, match="no angular acceleration"):
        run(device_of(accel=chain("m/s2", lever_arm=LeverArm(arms=np.eye(3)))), motion_of(TIME, RAMP))
