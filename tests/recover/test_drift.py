"""Thermal tables of simulated devices: the truth is found, and the intervals hold it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from testkit.cohorts import share_limits
from testkit.data import show
from testkit.rate_steps import GRID, SOAKS, computed, reading
from testkit.rest_blocks import curve_uncertainty
from testkit.simulated_device import motion_of
from undrift.drift.observe import observe_rests
from undrift.drift.offset import StaticSettings, fit_static
from undrift.drift.rates import DynamicFit, fit_dynamic, fit_scale, prepared
from undrift.drift.temperature import estimate_lag, trusted_temperature
from undrift.record import Record, Session, Still
from undrift.sim.device.effects import Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.motion import Motion
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- Offset over temperature of simulated devices: does the table find it, and do its intervals hold it?

UP = (*np.arange(18.0, 75.0, 5.0), 75.0)
UP_DOWN = (*UP, *UP[-2::-1])
NODES = tuple(np.arange(18.0, 75.1, 2.5))


def soaks(points, hold_s=700, ramp_s=60, rest_s=300):
    """One sample a second: ramps, holds long enough for the thermometer, the last five minutes of each stated as rest."""
    temp, stills, n, before = [], [], 0, points[0]
    for k, point in enumerate(points):
        ramp = np.linspace(before, point, ramp_s, endpoint=False) if k else np.zeros(0)
        temp += [ramp, np.full(hold_s, point)]
        n += len(ramp) + hold_s
        stills.append(Still(start=n - rest_s, stop=n))
        before = point
    return np.concatenate(temp), tuple(stills)


@cache
def fitted(
    seed, points, *, hysteresis=False, warm_up=False, adc=False, fit_warm_up=False, kind="enc03j_3031", nodes=NODES
):
    """Return the fit of a drawn device's gyroscopes, the truth at its thermometer's nodes, half the loop, units per deg/s."""
    rng = np.random.default_rng(seed)
    device = random_device(rng, grade=kind)
    gyro = replace(device.gyro, low_pass=None, g_sensitivity=None)  # one sample a second sees no filter; one pose
    gyro = replace(
        gyro,
        hysteresis=gyro.hysteresis if hysteresis else None,
        warm_up=gyro.warm_up if warm_up else None,
        adc=gyro.adc if adc else None,
    )
    device = replace(device, gyro=gyro, accel=replace(device.accel, low_pass=None, adc=None, lever_arm=None))
    temp, stills = soaks(points, *((2400, 300, 2100) if fit_warm_up else ()))
    motion = motion_of(np.arange(len(temp)) * 1.0, np.zeros((len(temp), 3)))
    record = replace(simulate_device(device, motion, rng=rng, temp_c=temp).record, accel=None)
    session = Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=(record,), stills=stills)
    blocks = observe_rests([session], temperatures=[[record.temp_c]])
    fit = fit_static(
        blocks,
        nodes=np.array(nodes),
        calibration=true_calibration(device),
        settings=StaticSettings(warm_up=fit_warm_up),
    )
    board = np.array(nodes) - device.thermometer.trim_error_c - device.thermometer.self_heating_c
    truth = np.array([true_calibration(device, temp_c=float(t)).gyro.offset for t in board])
    half_loop = device.gyro.hysteresis.amplitude * device.gyro.gain if hysteresis else np.zeros(3)
    return fit, truth, half_loop, device.gyro.gain * RADIAN_PER_DEGREE


def coverage(devices, points, **effects):
    """Compare with the truth in the middle of the loop."""
    inside, square, stated = [], [], []
    for seed in range(devices):
        fit, truth, _, per_dps = fitted(seed, points, **effects)
        seen = ~fit.table.gyro_extrapolated
        error = (fit.table.gyro_offset - truth)[seen]
        own = curve_uncertainty(fit.gyro)  # the truth is the curve: no visit of its own
        inside.append((np.abs(error) <= 1.96 * own[seen]).mean())
        square.append((error**2).mean() / per_dps**2)
        stated.append((own[seen] ** 2).mean() / per_dps**2)
    return float(np.mean(inside)), 1e3 * float(np.sqrt(np.mean(square))), 1e3 * float(np.sqrt(np.mean(stated)))


@pytest.mark.slow
@pytest.mark.parametrize("devices", [25, 300])
def test_intervals_of_the_nodes_hold_the_truth_of_many_axes(devices):
    # Truth: settled offset at the board temperature that belongs to the thermometer's reading; instability and noise are on.
    inside, error, stated = coverage(devices, UP)
    low, high = share_limits(4 * 3 * devices)  # nodes of a curve stand together: about four of an axis are independent
    show(
        f"nodes inside their 95 % interval, {devices} devices of three axes, soaks going up",
        f"{inside:.3f}",
        (low, high),
    )
    show("root-mean-square error and stated uncertainty, mdeg/s", f"{error:.2f}, {stated:.2f}")
    assert low <= inside <= high
    assert error < 6.0  # the wander of the offset in a run alone is 7: B sqrt(11 ln(sqrt(10)) / pi)


# Widest: stated uncertainty over error, both root-mean-square over 8 devices. 1 would be right. A loop seen both ways counts
# by half its size, 45 mdeg/s, although the truth here is its very middle: a device in use lies anywhere between, where the error
# is larger. With a warm-up too the same half counts, so the same limit stands.


def test_half_the_loop_is_found_with_its_sign():
    fit, *_ = fitted(3, UP_DOWN, hysteresis=True)
    device = random_device(np.random.default_rng(3), grade="enc03j_3031")
    true = device.gyro.hysteresis.amplitude * device.gyro.scale.nominal_sensitivity * device.gyro.amplifier.gain
    half, uncertainty = fit.gyro.hysteresis, fit.gyro.hysteresis_uncertainty
    # while cooling the offset is higher by it; without a converter the reading is in volts
    show("half the loop, V", f"{np.round(half, 5)} (true {np.round(true, 5)}, u {uncertainty})")
    np.testing.assert_array_less(np.abs(half - true), 4.0 * uncertainty)
    assert (np.abs(true) > 3.0 * uncertainty).any()
    np.testing.assert_array_equal(fit.table.gyro_hysteresis, half)
    assert (fit.table.gyro_uncertainty >= np.abs(half)).all()


@pytest.mark.slow
def test_warm_up_is_told_from_temperature():
    fit, *_, per_dps = fitted(5, UP_DOWN, warm_up=True, fit_warm_up=True)
    device = random_device(np.random.default_rng(5), grade="enc03j_3031")
    table = fit.table.warm_up
    result = np.array([np.interp(300.0, table.power_on_s, column) for column in table.gyro_offset.T]) / per_dps
    true = -device.gyro.warm_up.amplitude * np.exp(-300.0 / 600.0) / RADIAN_PER_DEGREE
    show("extra offset 5 min after power-on, deg/s", f"{np.round(result, 3)} (true {np.round(true, 3)})", 0.02)
    np.testing.assert_allclose(result, true, atol=0.02)  # beside an offset that wanders by 0.007


def rising(rng, temp_noise, step):
    """The fixture of GOLDENS 4e: one warm-up, and what its thermometer says."""
    time = np.arange(0.0, 2699.95, 0.1)
    true = 18.0 + 57.0 * (1.0 - np.exp(-time / 600.0)) / (1.0 - np.exp(-4.5))
    said = true + temp_noise * rng.normal(size=len(time))
    said = np.round(said / step) * step if step else said
    gyro = np.repeat(curve(true)[:, None], 3, axis=1) + 0.1 * rng.normal(size=(len(time), 3))
    return Record(time=time, gyro=gyro, temp_c=said, gyro_unit="dps")


def curve(temp_c):
    x = temp_c - 35.0
    return 0.30 + 0.012 * x - 2e-4 * x**2 + 1.5e-6 * x**3


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "step", "limit"), [(0.05, 0.0, 0.009), (0.5, 0.0, 0.028), (0.0, 1.0, 0.048)])
def test_noisy_temperatures_of_a_warm_up_do_not_hurt(noise, step, limit):
    # The rule that keeps only samples above the running maximum reaches these limits. Three seeds of three axes each.
    nodes, worst = np.arange(20.0, 73.1, 0.5), []
    for seed in range(3):
        record = rising(np.random.default_rng(seed), noise, step)
        session = Session(
            kind="thermal", serial="A", gravity_m_s2=9.81, records=(record,), stills=(Still(start=0, stop=len(record)),)
        )
        blocks = observe_rests([session], temperatures=[[record.temp_c]])
        table = fit_static(blocks, nodes=nodes).table
        worst.append(np.abs(table.gyro_offset - curve(nodes)[:, None]).max(axis=0))
    mean = float(np.mean(worst))
    show(
        f"largest error, temperature noise {noise} step {step} degC, deg/s",
        f"{mean:.4f} (worst {np.max(worst):.4f})",
        limit,
    )
    assert mean < limit


# ---- Scale over temperature and dynamic drift of simulated devices: the intervals of the tables hold the truth
#
# The device is the note's (ENC-03J), soaked every 5 degC from 18 to 75 degC and turned both ways about three axes. Its
# thermometer has noise and no trim error, because the true tables are over the true temperature.

FINE_NODES = np.arange(18.0, 75.01, 0.5)


def note_device(seed: int) -> DeviceModel:
    model = random_device(np.random.default_rng(seed), grade="enc03j_3031")
    return replace(model, thermometer=Thermometer(noise_c=0.05))


def _truth_of_e(device: DeviceModel, fit: DynamicFit, axis: int) -> np.ndarray:
    """Return e of one axis at the nodes by turning it alone, with the device's own offset and constant matrix."""
    rate = np.zeros((801, 3))
    rate[:, axis] = np.linspace(-2.2, 2.2, 801)
    inverse = np.linalg.inv(device.gyro.forward_matrix)
    rows = []
    for temp_c in fit.drift.temp_c:
        warmth = np.full(801, temp_c - device.reference_temp_c)
        rest = reading(device.gyro, np.zeros((1, 3)), warmth[:1])
        measured = ((reading(device.gyro, rate, warmth) - rest) @ inverse.T)[:, axis]
        rows.append(np.interp(fit.drift.turn_rate, measured, measured - rate[:, axis]))
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("devices", [12, 20])
def test_intervals_of_matrix_and_dynamic_drift_hold_the_truth(devices: int) -> None:
    z_scale, z_dynamic = [], []
    for seed in range(devices):
        device = note_device(seed)
        straight = replace(device, gyro=replace(device.gyro, nonlinearity=None, rate_drift=None))
        static = true_tables(device, FINE_NODES, np.array([-1.0, 1.0])).static
        rng = np.random.default_rng(100 + seed)
        # The matrix on a device of straight lines: on a bent one the best line over the grid is no single truth.
        fit = fit_scale(
            prepared(computed(straight, SOAKS, rng, rates=GRID[1::2]), true_calibration(straight).gyro, static=static),
            true_calibration(straight).gyro,
            temp_c=FINE_NODES,
        )
        truth = true_tables(straight, FINE_NODES, np.array([-1.0, 1.0])).scale
        z_scale.append((fit.drift.gyro_matrix - truth.gyro_matrix) / fit.drift.gyro_uncertainty)
        if seed % 3:
            continue
        steps = computed(device, SOAKS, rng, rates=GRID[1::2])
        calibration = true_calibration(device)
        dynamic = fit_dynamic(prepared(steps, calibration.gyro, static=static), calibration.gyro, span_c=(15.0, 75.0))
        seen = ~dynamic.drift.extrapolated & (dynamic.drift.turn_rate != 0.0)
        for axis in range(3):
            off = dynamic.drift.error[..., axis] - _truth_of_e(device, dynamic, axis)
            z_dynamic.append(off[seen] / dynamic.drift.uncertainty[..., axis][seen])
    scale = float(np.mean(np.abs(z_scale) < 1.96))
    dynamic_share = float(np.mean(np.abs(np.concatenate(z_dynamic)) < 1.96))
    show("95 % intervals of M(T) nodes hold the truth", f"{scale:.3f}", (0.93, 1.0))
    show("95 % intervals of e nodes hold the truth", f"{dynamic_share:.3f}", (0.90, 1.0))
    # 20 devices of 9 curves of about 2.5 free values: standard error 1 %; 7 devices of 3 surfaces of about 12: 1.4 %. Both err
    # on the wide side: twelve soaks cannot rule out that they scatter by a part of their noise beyond it.
    assert scale > 0.93
    assert dynamic_share > 0.90
    # Wide, yet not twice too wide: then 95 of 100 would lie within one standard uncertainty.
    assert float(np.mean(np.abs(z_scale) < 1.0)) < 0.95


# ---- A simulated ENC-03J beside a thermometer that trails: its lag is found

RATE_HZ = 10.0
LOW, HIGH = 20.0, 40.0
SLOW, FAST = 0.5, 3.0  # degC/min


def at_rest(n):
    still, ones = np.zeros((n, 3)), np.ones((n, 1))
    return Motion(
        time=np.arange(n) / RATE_HZ,
        q_nb=ones * [1.0, 0.0, 0.0, 0.0],
        rate_b=still,
        mean_rate_b=still,
        force_b=ones * [0.0, 0.0, STANDARD_GRAVITY],
        gravity_m_s2=STANDARD_GRAVITY,
        moving=np.zeros(n),
    )


def device(lag_s):
    model = preset("enc03j_3031")
    return replace(
        model,
        gyro=replace(model.gyro, low_pass=None, warm_up=None),
        accel=replace(model.accel, low_pass=None, lever_arm=None),
        thermometer=replace(model.thermometer, lag_s=lag_s, self_heating_c=0.0),
    )


def ramped(lag_s, ramp, seed):
    """Return a session of one ramp up and down, degC/min."""
    half = round(60.0 * (HIGH - LOW) / ramp * RATE_HZ)
    temp = np.concatenate((np.linspace(LOW, HIGH, half), np.linspace(HIGH, LOW, half)))
    record = simulate_device(device(lag_s), at_rest(len(temp)), rng=np.random.default_rng(seed), temp_c=temp).record
    rest = (Still(start=0, stop=len(temp)),)
    return Session(kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=rest)


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [10.0, 20.0, 40.0, 80.0])
def test_lag_is_found(lag_s):
    sessions = ramped(lag_s, SLOW, 1), ramped(lag_s, FAST, 2)
    temperatures = [[trusted_temperature(session, 0).temp_c] for session in sessions]
    lag = estimate_lag(observe_rests(sessions, temperatures=temperatures))
    show(f"lag {lag_s:g} s: estimated, s", f"{lag.lag_s:.1f} +- {lag.uncertainty_s:.1f}", "4 standard deviations + 1")
    assert np.isfinite(lag.uncertainty_s)
    assert abs(lag.lag_s - lag_s) <= 4.0 * lag.uncertainty_s + 1.0
