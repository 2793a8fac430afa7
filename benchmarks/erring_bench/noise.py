"""Coefficients of ``fit_noise``: white noise, flicker, random walk and a converter of 10 to 16 bit, 10 or 60 min at rest.

The converter's rounding is white at these noise levels, LSB^2 / 12 over the sample rate: it belongs to N, as the readings have it.
A term that is not observable has the interval from zero to its upper limit, which counts as any other.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.erring_bench import NORMAL_95, Row
from undrift.arrays import FloatArray
from undrift.calibration.noise import AxisNoise, fit_noise
from undrift.record import Record

RATE_HZ, RANGE_DPS, WHITE_DPS = 50.0, 250.0, 0.25  # N in deg/s/sqrt(Hz): rounding of 10 bit is 0.14 deg/s
NAMES = {"N": "angle_random_walk", "B": "bias_instability", "K": "rate_random_walk"}
# seconds, flicker B in deg/s, random walk K in deg/s/sqrt(s), bits (K is observable from 860 s (0.0005) or 170 s
# (0.0025))
CASES = (
    (600.0, 0.0, 0.01, 0), (600.0, 0.0, 0.025, 10), (600.0, 0.2, 0.025, 0), (600.0, 0.2, 0.1, 12),
    (3600.0, 0.0, 0.01, 16), (3600.0, 0.2, 0.01, 0), (3600.0, 0.2, 0.025, 10), (3600.0, 0.2, 0.1, 16),
)  # fmt: skip


def readings(rng: np.random.Generator, seconds: float, flicker: float, walk: float, bits: int) -> FloatArray:
    """Return three axes at rest, (N, 3), rad/s."""
    count = round(seconds * RATE_HZ)
    rate_dps = WHITE_DPS * RATE_HZ**0.5 * rng.standard_normal((count, 3))
    rate_dps += np.cumsum(walk / RATE_HZ**0.5 * rng.standard_normal((count, 3)), axis=0)
    frequency = np.fft.rfftfreq(2 * count, 1.0 / RATE_HZ)[1:, None]
    spectrum = np.zeros((count + 1, 3), complex)  # one-sided density B^2 / (pi f)
    size = np.sqrt(flicker**2 / np.pi / frequency * RATE_HZ * 2 * count / 4.0)
    spectrum[1:] = size * (rng.standard_normal((count, 3)) + 1j * rng.standard_normal((count, 3)))
    rate_dps += np.fft.irfft(spectrum, 2 * count, axis=0)[:count]
    step = 2.0 * RANGE_DPS / 2.0**bits
    return np.asarray(np.radians(np.rint(rate_dps / step) * step if bits else rate_dps))


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield one row a coefficient and case."""
    for number, (seconds, flicker, walk, bits) in enumerate(CASES):
        step = 2.0 * RANGE_DPS / 2.0**bits if bits else 0.0
        truth = np.radians([np.hypot(WHITE_DPS, step / np.sqrt(12.0 * RATE_HZ)), flicker, walk])
        fits: list[tuple[AxisNoise, ...]] = []
        for device in range(devices):
            gyro = readings(np.random.default_rng((seed, number, device)), seconds, flicker, walk, bits)
            fits.append(fit_noise(Record(time=np.arange(len(gyro)) / RATE_HZ, gyro=gyro)).gyro)
        case = f"{seconds:g} s, B {flicker:g}, K {walk:g} deg/s, {bits or 'no'} bit"
        for (group, name), true in zip(NAMES.items(), truth, strict=True):
            coefficients = [getattr(axis, name) for fit in fits for axis in fit]
            values = np.array([coefficient.value for coefficient in coefficients if not coefficient.reason])
            limits = np.array([coefficient.interval for coefficient in coefficients])
            yield Row(
                fit="noise", case=case, group=group, devices=devices, good_percent=100.0 * len(values) / len(coefficients),
                inside_percent=100.0 * float(np.mean((limits[:, 0] <= true) & (true <= limits[:, 1]))),
                rmse=float(np.sqrt(np.mean((values - true) ** 2))) if len(values) else float("nan"),
                stated=float(np.sqrt(np.mean((np.diff(limits, axis=1) / (2.0 * NORMAL_95)) ** 2))),
                named=not len(values), reasons="" if len(values) == len(coefficients) else "session.not_observable",
            )  # fmt: skip
