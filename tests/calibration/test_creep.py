"""Temperature creep: what it adds to the covariance of readings, and that a steady thermometer adds nothing."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.creep import Creep, creep_of
from undrift.calibration.observe import CalibrateSettings, Observed, observe
from undrift.errors import InputError
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
    expected = creep.covariance(signal, gain)
    # the standard error of a variance of 20,000 draws is 1 %, that of a covariance no more: five of them
    np.testing.assert_allclose(drawn.T @ drawn / 20_000, expected, atol=0.05 * expected.max())


def test_an_integral_takes_the_angle_for_the_scale_and_the_duration_for_the_offset() -> None:
    creep = Creep(warmth=np.array([1.0, -2.0]), offset_per_k=1e-3, scale_per_k=1e-4, kind="gyro")
    columns = creep.columns(np.array([6.0, 3.0]), 10.0, np.array([4.0, 5.0]))
    np.testing.assert_allclose(columns, [[4e-2, 6e-3], [-1e-1, -6e-3]])


@pytest.mark.parametrize(("noise_c", "step_c"), [(0.05, 0.125), (0.0, 0.125), (0.3, 0.0), (0.01, 0.5)])
def test_noise_and_steps_of_a_thermometer_are_no_creep(noise_c: float, step_c: float) -> None:
    shown = 0
    for seed in range(20):
        temp_c = np.random.default_rng(seed).normal(25.06, noise_c, N)
        seen = seen_of(np.round(temp_c / step_c) * step_c if step_c else temp_c)
        shown += not creep_of(seen, seen.stills, "gyro").none
    assert (
        shown <= 3
    )  # at three standard errors of a chi-square of 11 about 1 % show: more than 3 of 20 have a chance of 5e-5


def test_a_real_creep_shows_through_the_noise_and_steps() -> None:
    true = np.linspace(-0.5, 0.5, N)
    shown = np.round((true + np.random.default_rng(7).normal(25.0, 0.05, N)) / 0.125) * 0.125
    seen = seen_of(shown)
    warmth = creep_of(seen, seen.stills, "accel").warmth
    np.testing.assert_allclose(warmth, true.reshape(12, -1).mean(axis=1), atol=0.125 / 2)


def test_without_a_temperature_the_rests_drift_tells() -> None:
    steady = seen_of(None)
    assert creep_of(steady, steady.stills, "accel").none
    seen = seen_of(None, gyro_drift_dps=0.15)  # as 3 K would by the data sheet's 0.05 deg/s/K, in all three axes
    creep = creep_of(seen, seen.stills, "accel")
    # 11 of 12 parts of 3 K from the first middle to the last; three observations: 3.18, Student's 97.5 % point, over 1.96
    assert creep.span_k == pytest.approx(3.0 * 11.0 / 12.0, rel=0.05)
    assert np.ptp(creep.warmth) == pytest.approx(creep.span_k * 3.182 / 1.96, rel=1e-3)
    assert not creep.recorded
    (found,) = creep.findings()
    assert (found.code, found.level) == ("session.offset_creep", "warn")
    blind = replace(seen, session=replace(seen.session, records=(replace(seen.session.records[0], gyro=None),)))
    assert creep_of(blind, blind.stills, "accel").span_k == pytest.approx(1.0)  # as stated: nothing could show it


def test_a_span_above_the_limit_is_a_finding_with_its_cost() -> None:
    seen = seen_of(np.linspace(24.0, 24.0 + 3.6 * 12 / 11, N))
    (found,) = creep_of(seen, seen.stills, "accel").findings()
    assert found.code == "session.temperature_creep"
    assert found.values["span_k"] == pytest.approx(3.6, rel=1e-3)
    assert found.values["offset"] == pytest.approx(0.9, rel=1e-3)  # half the span at 0.5 mg/K
    assert found.values["scale_percent"] == pytest.approx(0.036, rel=1e-3)
    wide = replace(seen, settings=CalibrateSettings(span_limit_k=4.0))
    assert creep_of(wide, seen.stills, "accel").findings() == ()


def test_settings_overrule_the_session_and_are_checked() -> None:
    stated = TemperatureSensitivity(accel_offset_mg_per_k=0.1, gyro_offset_dps_per_k=0.01)
    used = CalibrateSettings(accel_offset_mg_per_k=0.3).sensitivity(stated)
    assert (used.accel_offset_mg_per_k, used.gyro_offset_dps_per_k) == (0.3, 0.01)
    seen = seen_of(np.linspace(24.0, 25.0, N))
    seen = replace(seen, session=replace(seen.session, sensitivity=stated))
    assert creep_of(seen, seen.stills, "gyro").offset_per_k == pytest.approx(0.01 * RADIAN_PER_DEGREE)
    with pytest.raises(InputError, match="span_limit_k from 0 to 100, got -1"):
        CalibrateSettings(span_limit_k=-1.0)
