"""Steady turns on a rate table give back the gyroscope; the error is the least that the noise allows."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cohorts import COHORTS
from testkit.cramer_rao import Array, Tally, carried, information, inverse_model, jacobian, white_device
from testkit.quiet import without_noise
from undrift.calibration.rate_table import fit_rate_table
from undrift.calibration.settings import Mode
from undrift.calibration.table import DwellMeans, dwell_means
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import unit_vector

BENCH = BenchSettings(
    sample_rate_hz=20.0,
    still_s=0.5,
    move_s=0.5,
    ramp_s=0.2,
    dwell_s=1.35,
    turn_rates=(0.3, 0.9, 1.5),
    latitude_deg=None,
)
MOTION = bench_motion("rate_table", rng=np.random.default_rng(0), settings=BENCH)
SETTLE_S = 0.3
RATES = np.array([turn.turn_rate * unit_vector(turn.axis) for turn in MOTION.turns])  # type: ignore[operator, arg-type]


def settled(start: int) -> int:
    return start + round(SETTLE_S * BENCH.sample_rate_hz)


def means_of(device: DeviceModel, rng: np.random.Generator) -> DwellMeans:
    """Return plain means of the settled dwells, with the noise that is in them: a spline filter leaves the mean alone."""
    gyro = simulate_device(device, MOTION, rng=rng).record.gyro
    assert gyro is not None
    sd = (device.gyro.gain * device.gyro.white_noise.random_walk) * np.sqrt(BENCH.sample_rate_hz)
    counts = np.array([[t.stop - settled(t.start)] for t in MOTION.turns])
    return DwellMeans(
        reading=np.array([gyro[settled(t.start) : t.stop].mean(axis=0) for t in MOTION.turns]),
        turn_rate=np.array([t.turn_rate for t in MOTION.turns], float),
        axis=tuple(t.axis for t in MOTION.turns if t.axis is not None),
        noise=sd / np.sqrt(counts),
        up=np.ones(len(MOTION.turns)),
        unit="count",
    )


def truth(device: DeviceModel) -> Array:
    return np.concatenate((device.gyro.forward_matrix.ravel(), device.gyro.raw_offset))


def bound(device: DeviceModel, dwells: DwellMeans, free: int = 12) -> Array:
    theta = truth(device)[:free]

    def mean(x: Array) -> Array:
        return RATES @ x[:9].reshape(3, 3).T + np.append(x, np.zeros(12 - len(x)))[9:]

    assert dwells.noise is not None
    inverse = np.linalg.inv(information(jacobian(mean, theta, 1.0), (dwells.noise**2).ravel()))
    report = inverse_model if free == 12 else lambda k: np.linalg.inv(k.reshape(3, 3)).ravel()
    return carried(report, theta, 1e-4 * theta[0], inverse)


@pytest.mark.parametrize("mode", ["paper", "affine"])
def test_dwells_give_back_the_device_without_noise(mode: Mode) -> None:
    rng = np.random.default_rng(1)
    device = without_noise(white_device(rng))
    if mode == "paper":
        device = replace(device, gyro=replace(device.gyro, offset=None))
    record = simulate_device(device, MOTION, rng=rng).record
    model = fit_rate_table(dwell_means((record,), MOTION.turns), mode=mode).model
    # The spline solves normal equations of condition 1e6: 1e-10 of the reading.
    np.testing.assert_allclose(model.forward_matrix, device.gyro.forward_matrix, atol=1e-8 * 940)
    np.testing.assert_allclose(model.offset, device.gyro.raw_offset, atol=1e-6)


def test_the_earth_rate_is_taken_out_where_the_latitude_is_known() -> None:
    rng = np.random.default_rng(1)
    device = without_noise(white_device(rng))
    bench = BenchSettings(sample_rate_hz=50.0, still_s=0.5, dwell_s=2.32, turn_rates=(np.pi,), latitude_deg=41.9)
    # Settled dwells last 2 s, one whole turn: what is level averages out.
    motion = bench_motion("rate_table", rng=rng, settings=bench)
    record = simulate_device(device, motion, rng=rng).record
    dwells = dwell_means((record,), motion.turns, settle_s=SETTLE_S)
    with_earth = fit_rate_table(dwells, latitude_deg=41.9).model
    without = fit_rate_table(dwells).model
    missed = np.abs(with_earth.offset - device.gyro.raw_offset).max()
    assert missed < 1e-3  # counts; the Earth is 0.07
    assert missed < 0.02 * np.abs(without.offset - device.gyro.raw_offset).max()


@pytest.mark.slow
@pytest.mark.parametrize("devices", COHORTS)
def test_errors_reach_the_bound_and_intervals_hold(devices: int) -> None:
    rng = np.random.default_rng(2)
    affine, paper = Tally.of("rate table affine"), Tally.of("rate table paper")
    for _ in range(devices):
        device = white_device(rng)
        dwells = means_of(device, rng)
        model = fit_rate_table(dwells).model
        error = np.concatenate((model.matrix.ravel(), model.offset)) - inverse_model(truth(device))
        affine.add(error, bound(device, dwells), model.standard_uncertainty)
        bare = replace(dwells, reading=dwells.reading - device.gyro.raw_offset)  # the note's premise: offset removed
        model = fit_rate_table(bare, mode="paper").model
        error = model.matrix.ravel() - inverse_model(truth(device))[:9]
        paper.add(error, bound(device, dwells, 9), model.standard_uncertainty[:9])
    affine.check(devices)
    paper.check(devices)
