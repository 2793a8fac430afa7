"""The codes of a simulated converter give back its step and whether it cuts toward zero."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from undrift.calibration.codes import identify_adc
from undrift.sim.device.effects import Rounding
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_trial

RATE_HZ = 285.7


@cache
def before_the_converter(seed: int) -> tuple[DeviceModel, np.ndarray]:
    """Return a device and what its converter gets in 16 minutes: over some 8,000 codes two samples a minute, a code and an axis."""
    rng = np.random.default_rng(seed)
    device = random_device(rng, grade="wearable")
    bare = replace(device, gyro=replace(device.gyro, adc=None))
    minutes = [simulate_trial("free", bare, rng=rng, sample_rate_hz=RATE_HZ).record.gyro for _ in range(16)]
    return device, np.concatenate([gyro for gyro in minutes if gyro is not None])


@pytest.mark.parametrize("rounding", ["toward_zero", "nearest", "floor"])
def test_what_a_device_reads_is_what_its_converter_makes_of_what_it_gets(rounding: Rounding) -> None:
    _, analog = before_the_converter(0)
    rng = np.random.default_rng(0)
    device = random_device(rng, grade="wearable")
    device = replace(device, gyro=replace(device.gyro, adc=replace(device.gyro.adc, rounding=rounding)))
    minute = simulate_trial("free", device, rng=rng, sample_rate_hz=RATE_HZ).record.gyro
    assert minute is not None
    np.testing.assert_array_equal(minute, device.gyro.adc.converted(analog[: len(minute)])[0])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("rounding", "told"), [("toward_zero", "toward_zero"), ("nearest", "nearest"), ("floor", "nearest")]
)
def test_step_and_rounding_of_a_logger_in_a_quarter_of_an_hour_of_motion(
    rounding: Rounding, told: str, seed: int
) -> None:
    device, analog = before_the_converter(seed)
    readings = replace(device.gyro.adc, rounding=rounding).converted(analog)[0]
    found = identify_adc(readings)
    assert found.lsb is not None
    np.testing.assert_allclose(found.lsb, device.gyro.adc.step, rtol=1e-6)  # deg/s; floating point alone blurs it
    assert found.rounding == told  # floor is nearest with half a step of offset: codes alone cannot tell


def test_a_minute_of_motion_says_that_it_is_too_short() -> None:
    rng = np.random.default_rng(1)
    found = identify_adc(simulate_trial("free", random_device(rng, grade="wearable"), rng=rng).record.gyro)  # type: ignore[arg-type]
    assert found.rounding is None
    assert "sweep through code 0" in found.reason


def test_readings_that_were_never_codes_lie_on_no_grid() -> None:
    rng = np.random.default_rng(1)
    device = random_device(rng, grade="wearable")
    device = replace(device, gyro=replace(device.gyro, adc=None))
    assert identify_adc(simulate_trial("free", device, rng=rng).record.gyro).lsb is None  # type: ignore[arg-type]
