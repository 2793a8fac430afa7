"""Parts of a course: closed forms, and derivatives that belong to their values."""

import numpy as np
import pytest

from testkit.data import show
from undrift.sim.motion.motion import Burst, CourseTerm, Step, Sway, ViaPoint, course_at, wave

PARTS: dict[str, CourseTerm] = {
    "step": Step(0.4, 1.3, 0.7),
    "via-point": ViaPoint(0.4, 0.9, 1.4, 0.6, -0.5),
    "wave": wave(0.5, 0.8, 0.3, 0.2, 3.6),
    "sway": Sway((0.3, 0.2, 0.1), (0.2, 0.7, 1.9), (0.0, 1.0, 2.0), 0.2, 3.6, 1.5),
    "burst": Burst(0.05, 3.0, 0.5, 0.2),
}


@pytest.mark.parametrize("name", PARTS)
def test_each_derivative_is_the_integral_of_the_next(name: str) -> None:
    time = np.linspace(0.0, 4.0, 40_001)
    value, first, second = PARTS[name].at(time)
    for low, high in ((value, first), (first, second)):
        grown = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (high[1:] + high[:-1]))))
        # trapezium at 0.1 ms: h^2 / 12 times the change of the derivative, some 100 per s3
        assert np.abs(low - low[0] - grown).max() < 1e-6


@pytest.mark.parametrize("name", PARTS)
def test_value_rate_and_acceleration_are_continuous_and_vanish_at_the_start(name: str) -> None:
    for rate in (1_000, 10_000):
        found = PARTS[name].at(np.arange(0.0, 6.0, 1.0 / rate))
        assert np.abs(found[:, 0]).max() == 0.0
        jump = np.abs(np.diff(found, axis=1)).max()
        # the largest jerk, of the burst, is near 650 per s3; a jump would not shrink with the step
        assert jump < 1_200.0 / rate


def test_a_step_of_least_jerk_has_the_published_peaks() -> None:
    change, duration = 32.0, 0.92  # deg, s
    value, first, second = Step(0.0, duration, change).at(np.linspace(0.0, duration, 100_001))
    peak, push = first.max() * duration / change, np.abs(second).max() * duration**2 / change
    show("least jerk: peak rate over A/T", peak, "1.875")
    show("least jerk: peak acceleration over A/T^2", push, "10/sqrt(3) = 5.77")
    assert peak == pytest.approx(1.875, rel=1e-9)  # 15/8 at half time
    assert push == pytest.approx(10.0 / np.sqrt(3.0), rel=1e-8)
    assert value[-1] == pytest.approx(change, rel=1e-12)
    show("32 deg in 0.92 s: deg/s, deg/s2", (first.max(), second.max()), "65, 218")
    assert first.max() == pytest.approx(65.0, abs=0.5)
    assert second.max() == pytest.approx(218.0, abs=0.5)
    _, faster, harder = Step(0.0, 0.8, 40.0).at(np.linspace(0.0, 0.8, 100_001))
    assert faster.max() == pytest.approx(94.0, abs=0.5)
    assert harder.max() == pytest.approx(361.0, abs=0.5)


def test_a_via_point_is_met_at_its_instant_with_the_rate_zero() -> None:
    part = ViaPoint(1.0, 0.9, 1.4, 0.6, -0.5)
    value, first, second = part.at(np.array([1.0, 1.9, 3.3, 5.0]))
    np.testing.assert_allclose(value, [0.0, 0.6, 0.1, 0.1], atol=1e-15)
    np.testing.assert_allclose(first, 0.0, atol=1e-14)
    assert second[1] == pytest.approx(part.acceleration, rel=1e-12)
    even = ViaPoint(0.0, 1.0, 1.0, 1.0, -1.0)
    assert even.acceleration == pytest.approx(-20.0 / 3.0, rel=1e-12)
    peak = even.at(np.linspace(0.0, 1.0, 100_001))[1].max()
    show("there and back: peak rate over A/T", peak, "1.728 to 1.737")
    assert 1.728 <= peak < 1.737


def test_no_other_course_through_the_via_point_has_less_jerk() -> None:
    part = ViaPoint(0.0, 0.9, 1.4, 0.6, -0.5)
    time = np.linspace(0.0, 2.3, 23_001)
    acceleration = part.at(time)[2]
    step = time[1]
    least = np.sum(np.diff(acceleration) ** 2) / step
    rng = np.random.default_rng(0)
    for _ in range(5):  # (1-s)^3 s^3 times (t - via)^2: keeps both ends at rest and the via-point's value and rate
        s = time / 2.3
        shape = (s * (1.0 - s)) ** 3 * (time - 0.9) ** 2 * np.polynomial.Polynomial(rng.normal(size=4))(s)
        other = np.gradient(np.gradient(shape, step), step)
        both = acceleration + 0.1 * other
        assert np.sum(np.diff(both) ** 2) / step > least


def test_a_course_is_the_sum_of_its_parts() -> None:
    time = np.linspace(0.0, 4.0, 101)
    np.testing.assert_allclose(course_at(tuple(PARTS.values()), time), sum(part.at(time) for part in PARTS.values()))
    assert not course_at((), time).any()
