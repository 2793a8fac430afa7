"""ADC: step and rounding from the codes; correct by construction, and never guessed."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.calibration.calibrate import calibrate
from undrift.calibration.codes import (
    code_grid,
    code_variance,
    identify_adc,
    rounding_correlation,
    unknown_rounding,
    without_truncation,
)
from undrift.calibration.settings import CalibrateSettings
from undrift.record import Record
from undrift.sim.device.effects import Adc
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

LSB = 0.061
ROUNDINGS = {"nearest": np.round, "floor": np.floor, "toward_zero": np.trunc}


def sweeping(rng, samples=40000):
    """Readings of a device that keeps sweeping through zero, in codes before rounding."""
    time = np.arange(samples)[:, None]
    return 600.0 * np.sin(time / np.array([30.0, 37.0, 41.0])) + rng.normal(0.0, 5.0, (samples, 3))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("scale", [1.0, LSB, LSB * np.pi / 180.0])
@pytest.mark.parametrize("name", ROUNDINGS)
def test_step_and_rounding_are_found_in_codes_and_in_floats(name, scale, dtype):
    codes = ROUNDINGS[name](sweeping(np.random.default_rng(1)))
    adc = identify_adc((codes * scale).astype(dtype).astype(float))
    np.testing.assert_allclose(adc.lsb, scale, rtol=1e-6)
    assert adc.rounding == ("toward_zero" if name == "toward_zero" else "nearest"), adc.reason


def test_continuous_readings_have_no_step():
    adc = identify_adc(sweeping(np.random.default_rng(2)))
    assert adc.lsb is None
    assert adc.rounding is None
    assert "not on a grid" in adc.reason


def test_a_resting_device_does_not_tell_its_rounding():
    adc = identify_adc(np.trunc(np.random.default_rng(3).normal(0.0, 1.5, (20000, 3))))
    assert adc.rounding is None
    assert "fewer than two" in adc.reason
    np.testing.assert_allclose(adc.lsb, 1.0)


def test_offset_subtracted_from_the_codes_hides_the_rounding():
    codes = np.trunc(sweeping(np.random.default_rng(4))) + 0.37
    step, phase = code_grid(codes[:, 0])
    assert step == pytest.approx(1.0)
    assert phase == pytest.approx(0.37, abs=1e-6)
    adc = identify_adc(codes)
    assert adc.rounding is None
    assert "offset was subtracted" in adc.reason


@pytest.mark.parametrize(
    ("gyro", "step"),
    [
        (lambda rng: np.trunc(sweeping(rng)), 0.0),
        (lambda rng: np.trunc(rng.normal(0.0, 3.0, (20000, 3))), 1.0),
        (lambda rng: np.trunc(rng.normal(40.0, 3.0, (20000, 3))), 0.0),
        (sweeping, 0.0),
    ],
)
def test_only_codes_on_both_sides_of_zero_have_an_unknown_rounding(gyro, step):
    readings = gyro(np.random.default_rng(8))
    assert unknown_rounding([Record(time=np.arange(len(readings)) / 100.0, gyro=readings)]) == pytest.approx(step)


def test_putting_the_half_step_back_undoes_truncation_on_average():
    values = sweeping(np.random.default_rng(6))
    back = without_truncation(np.trunc(values), np.ones(3), "toward_zero")
    away = np.abs(values) > 1.0
    # Mean of 120,000 rounding errors of 0.29: 0.001; truncation would leave 0.5 along the sign.
    assert np.mean(((back - values) * np.sign(values))[away]) == pytest.approx(0.0, abs=0.01)
    floor = without_truncation(np.floor(values), np.ones(3), "floor")
    assert np.mean(floor - values) == pytest.approx(0.0, abs=0.01)
    np.testing.assert_array_equal(without_truncation(values, np.ones(3), "nearest"), values)


@pytest.mark.parametrize(
    "trial", ["02_undisturbed_slow_rotation_B", "07_undisturbed_fast_rotation_B", "35_disturbed_attached_magnet_4cm"]
)
def test_the_broad_gyroscopes_truncate_toward_zero(trial):
    h5py = pytest.importorskip("h5py")
    with h5py.File(data_path("broad", f"{trial}.hdf5")) as file:
        gyro, accel = file["imu_gyr"][:], file["imu_acc"][:]
    result, force = identify_adc(gyro), identify_adc(accel)
    step = np.degrees(result.lsb)
    show(f"BROAD {trial[:2]} gyro step, deg/s", np.round(step, 5), "0.061")
    show(f"BROAD {trial[:2]} accel step, m/s2", np.round(force.lsb, 5), "0.0049 within 3 %")
    np.testing.assert_allclose(step, 2000.0 / 32767.0, rtol=1e-4)
    assert result.rounding == "toward_zero"
    np.testing.assert_allclose(force.lsb, 0.0049, rtol=0.03)


def test_code_zero_stays_zero() -> None:
    lsb = np.full(3, 0.061)
    codes = np.array([[1e-17, -1e-17, 0.0], [0.061, -0.061, 0.122]])
    given_back = without_truncation(codes, lsb, "toward_zero")
    assert np.array_equal(given_back[0], codes[0])
    assert given_back[1] == pytest.approx([0.0915, -0.0915, 0.1525], abs=1e-15)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_variance_of_a_mean_of_codes_is_that_of_rounded_noise(noise: float) -> None:
    # 4,000 places between two codes, 4,000 readings each: squares of means scatter by 2.2 %, the readings by 1 in 4,000
    rng = np.random.default_rng(4)
    place = rng.uniform(-0.5, 0.5, 4000)
    codes = np.round(place[:, None] + noise * rng.standard_normal((4000, 4000)))
    square = float(((codes.mean(axis=1) - place) ** 2).mean())
    scatter = float(codes.var(axis=1, ddof=1).mean())
    residual = code_variance(np.array([3.0, np.nan, 0.0]), 9.0 * np.full(3, scatter))
    window = 3.0 * np.tile(codes[0][:, None], 3)
    with_window = code_variance(np.array([3.0, np.nan, 0.0]), 9.0 * np.full(3, scatter), [window])
    for variance in (residual, with_window):
        np.testing.assert_array_equal(variance[1:], 0.0)  # a step that is not known, and none
    assert residual[0] / 9.0 == pytest.approx(square - scatter / 4000, rel=0.1, abs=3e-5)


@pytest.mark.parametrize("noise", [0.15, 0.2, 0.25, 0.3])
def test_offset_of_readings_that_toggle_between_two_codes_is_inside_its_interval(noise):
    rng, time, step = np.random.default_rng(7), np.arange(6000) / 100.0, 0.57
    for _ in range(8):
        offset = rng.uniform(-3.0, 3.0, 3)
        gyro = step * np.round(offset / step + noise * rng.standard_normal((len(time), 3)))
        model = calibrate(Record(time=time, gyro=gyro, gyro_unit="dps")).gyro
        assert (np.abs(model.offset - offset) <= 2.0 * model.standard_uncertainty[9:12]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "methods", "triads"),
    [
        ("bench", {}, {"gyroscope", "accelerometer"}),
        ("multi_position", {"accel": "multi-position", "gyro": "multi-position"}, {"gyroscope"}),
        ("ferraris", {}, {"gyroscope", "accelerometer"}),
    ],
)
def test_coarse_converter_is_named_by_every_fit_to_rests(kind, methods, triads):
    result = {}
    for bits in (10, 16):
        device = random_device(np.random.default_rng(5))
        gyro, accel = (
            replace(chain, adc=Adc(bits=bits, reference=span * chain.gain, codes=False))
            for chain, span in ((device.gyro, np.radians(500.0)), (device.accel, 19.6))
        )
        session = simulate_session(kind, replace(device, gyro=gyro, accel=accel), rng=np.random.default_rng(6))
        calibration = calibrate(session, settings=CalibrateSettings(identify_adc=False), **methods)
        result[bits] = [
            item.values["triad"] for item in calibration.verdict.findings if item.code == "session.rounding"
        ]
    finding = {word for text in result[10] for word in text.split(" and ")}
    assert finding == triads
    assert result[16] == []


@pytest.mark.parametrize(("noise", "spread"), [(0.0, 0.0), (0.0, 0.2), (0.2, 0.0), (0.3, 0.1)])
def test_rounding_errors_of_two_means_correlate_as_stated(noise: float, spread: float) -> None:
    rng = np.random.default_rng(2)
    first = rng.uniform(-50.0, 50.0, 2_000)
    for distance in (0.0, 0.15, 0.5, 1.0):
        second = first + distance + spread * rng.standard_normal(len(first))
        errors = [
            np.round(x[:, None] + noise * rng.standard_normal((len(x), 4_000))).mean(axis=1) - x
            for x in (first, second)
        ]
        share = np.array([np.mean(np.square(errors))])
        stated = rounding_correlation(np.array([distance]), np.array([spread]), share)
        # sampling error of a correlation of 2,000 pairs: 0.02
        assert stated[0] == pytest.approx(np.corrcoef(errors)[0, 1], abs=0.08)
