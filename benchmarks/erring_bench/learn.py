"""Learning in use: coverage of a switch-on to come, over drawn devices with turn-on shifts, ageing, worn rests, hysteresis, codes.

Truth is the reading at rest of a day that was not learnt from: a new switch-on, without noise, in another pose, its temperature by
the device's own thermometer. ``curve`` is the mean over switch-ons on the last day.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.drift.fit import fit_drift
from undrift.drift.learn import LearnFit, learn_drift
from undrift.model import Calibration
from undrift.sim.daily_use import DailyUseSettings, Day, board_temperature, draw_day, simulate_daily_use
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import Motion
from undrift.sim.thermal import RampSettings, ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE as DPS

START = datetime(2026, 1, 1, tzinfo=UTC)
USE = DailyUseSettings(days=10, rest_s=20.0, worn_s=30.0, sample_rate_hz=12.5)
CHAMBER = RampSettings(low_c=20.0, high_c=40.0, hold_s=120.0)
SHORTER = 10.0
POOL = 8  # motions that days are drawn from


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One line of the table."""

    name: str
    preset: str = "mpu6050"
    days: int = 10
    turn_on_dps: float = 0.03
    ageing_dps: float = 0.02
    hysteresis: bool = False
    chamber: bool = False


CASES = (
    Case(name="no chamber, 1 day", days=1),
    Case(name="no chamber, 10 days"),
    Case(name="no chamber, 30 days, turn-on 5 mdeg/s", days=30, turn_on_dps=0.005, ageing_dps=0.003),
    Case(name="no chamber, 10 days, hysteresis, 12 bits", preset="enc03j_3031", hysteresis=True),
    Case(name="chamber 20-40 degC, 10 days", chamber=True),
)


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of each case."""
    for number, case in enumerate(CASES):
        rng = np.random.default_rng((seed, number))
        use = replace(USE, days=case.days, turn_on=case.turn_on_dps * DPS, ageing=case.ageing_dps * DPS)
        pool = [draw_day(rng, use) for _ in range(POOL)]
        tally = Tally("learn", case.name)
        for _ in range(devices):
            device = drawn_device(case.preset, rng, hysteresis=case.hysteresis)
            calibration = calibrated(device, rng, use, chamber=CHAMBER if case.chamber else None)
            days = list(simulate_daily_use(device, rng=rng, settings=use, motions=pool))
            fit = learnt(calibration, days)
            groups = {"a new day": a_new_day(fit, device, days[-1], rng, use, pool)}
            if not case.hysteresis:
                groups["curve"] = on_the_curve(fit, device, days[-1])
            tally.add(fit.verdict, **groups)
        yield from tally.rows()


def drawn_device(preset: str, rng: np.random.Generator, *, hysteresis: bool) -> DeviceModel:
    """Draw a unit; without hysteresis it has no warm-up either. A day is ten times shorter here, and so are its time constants."""
    device = random_device_of(preset, rng)
    gyro, thermometer = device.gyro, replace(device.thermometer, lag_s=device.thermometer.lag_s / SHORTER)
    if not hysteresis or gyro.warm_up is None:
        return replace(device, gyro=replace(gyro, hysteresis=None, warm_up=None), thermometer=thermometer)
    warm_up = replace(gyro.warm_up, time_constant_s=gyro.warm_up.time_constant_s / SHORTER)
    return replace(device, gyro=replace(gyro, warm_up=warm_up), thermometer=thermometer)


def calibrated(
    device: DeviceModel, rng: np.random.Generator, use: DailyUseSettings, *, chamber: RampSettings | None
) -> Calibration:
    """Return matrix and g-sensitivity as they are, the offset of one switch-on, and tables of a ramp in another."""
    true = true_calibration(device)
    model = true.gyro
    assert model is not None
    raw = model.scale_factor
    covariance = np.array(model.covariance)
    covariance[9:12, 9:12] = np.diag((np.hypot(use.turn_on, 0.003 * DPS) * raw) ** 2)
    offset = model.offset + raw * rng.normal(0.0, np.hypot(use.turn_on, 0.003 * DPS), 3)
    held = replace(true, gyro=replace(model, offset=offset, covariance=covariance))
    held = replace(held, provenance=replace(held.provenance, created=START.isoformat()))
    if chamber is None:
        return held
    heated = replace(device, gyro=device.gyro.shifted(rng.normal(0.0, use.turn_on, 3)))
    settings = ThermalSettings(bench=BenchSettings(sample_rate_hz=10.0), ramp=chamber)
    fit = fit_drift([simulate_thermal_session("ramp", heated, rng=rng, settings=settings)], held)
    made = fit.calibration
    return replace(made, provenance=replace(made.provenance, created=START.isoformat()))


def learnt(calibration: Calibration, days: list[Day]) -> LearnFit:
    """Learn from days, the first on the date of the calibration."""
    dates = [START + timedelta(days=day.number) for day in days]
    return learn_drift([day.session for day in days], calibration, dates=dates)


def a_new_day(
    fit: LearnFit,
    device: DeviceModel,
    last: Day,
    rng: np.random.Generator,
    use: DailyUseSettings,
    pool: list[Motion],
) -> tuple[FloatArray, FloatArray]:
    """Return error and stated deviation at five moments of a day at rest that was not learnt from, (m, 3) deg/s."""
    motion = pool[int(rng.integers(len(pool)))]
    still = replace(
        motion,
        q_nb=np.repeat(motion.q_nb[:1], len(motion), axis=0),
        force_b=np.repeat(motion.force_b[:1], len(motion), axis=0),
        rate_b=np.zeros_like(motion.rate_b),
        mean_rate_b=np.zeros_like(motion.rate_b),
        angular_acceleration_b=np.zeros_like(motion.rate_b),
    )
    shift = last.aged + use.turn_on * rng.standard_normal(3)
    record = simulate_device(
        replace(device, gyro=device.gyro.shifted(shift)).without_noise(),
        still,
        rng=rng,
        temp_c=board_temperature(still, rng, use),
    ).record
    model = fit.calibration.gyro
    assert model is not None
    assert record.gyro is not None
    assert record.temp_c is not None
    at = (np.linspace(0.1, 0.9, 5) * len(record)).astype(int)
    at = at[(record.temp_c[at] >= fit.temp_c[0]) & (record.temp_c[at] <= fit.temp_c[-1])]  # ``correct`` refuses others
    temp, reading = record.temp_c[at], record.gyro[at]
    if model.g_sensitivity is not None:
        reading = reading - still.force_b[0] @ (model.forward_matrix @ model.g_sensitivity).T
    columns = [(fit.after[:, k], fit.after_uncertainty[:, k]) for k in range(3)]
    table = np.stack([np.interp(temp, fit.temp_c, value) for value, _ in columns], axis=1)
    stated = np.stack([np.interp(temp, fit.temp_c, value) for _, value in columns], axis=1)
    return (table - reading / model.scale_factor) / DPS, stated / DPS


def on_the_curve(fit: LearnFit, device: DeviceModel, last: Day) -> tuple[FloatArray, FloatArray]:
    """Return error and stated deviation at the nodes, (n, 3) deg/s, of the mean over switch-ons."""
    return (fit.after - true_offset(device, fit, last.aged)) / DPS, fit.curve_uncertainty / DPS


def true_offset(device: DeviceModel, fit: LearnFit, aged: FloatArray) -> FloatArray:
    """Return the offset at the nodes, (n, 3) rad/s; the thermometer's trim error moves the temperature."""
    model = fit.calibration.gyro
    assert model is not None
    found = []
    for temp in fit.temp_c - device.thermometer.trim_error_c - device.thermometer.self_heating_c:
        held = true_calibration(device, temp_c=float(temp)).gyro
        assert held is not None
        found.append(held.offset / model.scale_factor + aged)
    return np.array(found)
