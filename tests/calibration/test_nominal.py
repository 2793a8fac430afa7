"""Counts from motion alone: the scale of real readings comes out, intervals hold, and mistaken columns are named."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import trial
from scipy.stats import binom

from calibration.test_in_motion import SEEN, handled
from testkit.data import needs_data, show
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.calibration.in_motion import fit_in_motion
from undrift.errors import Implausible, NotObservable
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

PER_DPS, PER_G, ZERO = 131.0, 16384.0, np.array([40.0, -25.0, 300.0])


def in_counts(record: Record) -> Record:
    """Return a recording in SI as a part of these scales and zeros sends it."""
    gyro = np.round(np.asarray(record.gyro) / RADIAN_PER_DEGREE * PER_DPS + ZERO)
    accel = np.round(np.asarray(record.accel) / STANDARD_GRAVITY * PER_G + 10.0 * ZERO)
    return replace(record, gyro=gyro, gyro_unit="count", accel=accel, accel_unit="count")


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("number", ["02", "03", "24"])
def test_a_real_device_in_counts_is_calibrated_as_in_its_units(number: str) -> None:
    record, _ = trial(number)
    plain, counted = fit_in_motion([record]), fit_in_motion([in_counts(record)])
    for one, other, per_unit, zero in (
        (plain.gyro.model, counted.gyro.model, PER_DPS / RADIAN_PER_DEGREE, ZERO),
        (plain.accel.model, counted.accel.model, PER_G / STANDARD_GRAVITY, 10.0 * ZERO),
    ):
        assert other.unit_in == "count"
        spread = one.standard_uncertainty
        apart = np.concatenate(
            ((other.matrix * per_unit - one.matrix).ravel(), (other.offset - zero) / per_unit - one.offset)
        )
        show(f"{number}, {one.unit_out}, largest difference over uncertainty", float(np.abs(apart / spread).max()))
        assert (np.abs(apart) < 0.5 * spread).all()
    texts = {item.code: item.text for item in counted.gyro.verdict.findings}
    show(texts["motion.gyro_unit"], texts["motion.accel_unit"])
    assert "131 count" in texts["motion.gyro_unit"] or "130." in texts["motion.gyro_unit"]


@pytest.mark.slow
@pytest.mark.parametrize("devices", [12, 100])
def test_nineteen_of_twenty_intervals_hold_devices_in_counts(devices: int) -> None:
    over = []
    for seed in range(200, 200 + devices):
        records, true, units = handled(seed)
        raw = [
            replace(
                one, gyro=np.asarray(one.gyro) / units[0], accel=np.asarray(one.accel) / units[1], gyro_unit="count",
                accel_unit="count",
            )
            for one in records
        ]  # fmt: skip
        fit = fit_in_motion(raw)
        assert true.gyro is not None
        assert true.accel is not None
        for made, right in ((fit.gyro.model, true.gyro), (fit.accel.model, true.accel)):
            spread = np.sqrt(np.diag(SEEN @ made.covariance[:9, :9] @ SEEN.T))
            over.append((SEEN @ (made.matrix - right.matrix).ravel() / spread)[:3])
    gyro, accel = np.abs(over[::2]), np.abs(over[1::2])
    for name, ratio in (("gyroscopes", gyro), ("accelerometers", accel)):
        inside = int((ratio < 1.96).all(axis=1).sum())
        show(name, f"{inside} of {devices} scales inside, rms over stated {float(np.sqrt((ratio**2).mean())):.2f}")
        assert binom.cdf(int((ratio < 1.96).sum()), 3 * devices, 0.95) > 0.01


@pytest.mark.slow
@needs_data
def test_exchanged_and_reversed_columns_in_counts_are_named() -> None:
    record = in_counts(trial("02")[0])
    for order, words in (
        ((1, 0, 2), "gyroscope columns x and y are exchanged|columns x and y and all their signs"),
        ((0, 1, 2), "gyroscope column z is reversed"),
    ):
        signs = np.array([1.0, 1.0, -1.0 if order == (0, 1, 2) else 1.0])
        with pytest.raises(Implausible, match=words):
            calibrate_from_motion([replace(record, gyro=signs * np.asarray(record.gyro)[:, list(order)])])


@needs_data
@pytest.mark.parametrize("number", ["07", "35"])
def test_motion_that_does_not_show_a_scale_is_refused_with_the_motion_that_does(number: str) -> None:
    with pytest.raises(NotObservable, match=r"turn the device slowly about every axis|hold each side up"):
        fit_in_motion([in_counts(trial(number)[0])])
