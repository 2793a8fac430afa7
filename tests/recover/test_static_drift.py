"""Offset over temperature of simulated devices: does the table find it, and do its intervals hold it?"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from testkit.cohorts import ratio_limit, share_limits
from testkit.data import show
from testkit.simulated_device import motion_of
from undrift.drift.observe import observe_rests
from undrift.drift.offset import StaticSettings, fit_static
from undrift.record import Record, Session, Still
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.units import RADIAN_PER_DEGREE

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
        own = fit.gyro.curve_uncertainty  # the truth is the curve: no visit of its own
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


@pytest.mark.slow
@pytest.mark.parametrize("devices", [25, 100])
@pytest.mark.parametrize(
    ("kind", "low", "high", "widest"),
    [("enc03j_3031", 18.0, 75.0, 2.0), ("enc03j_3031", 20.0, 40.0, 1.5), ("icm20948", 18.0, 75.0, 2.0)],
)
def test_five_set_points_hold_between_them(kind, low, high, widest, devices):
    # Devices of three axes, at nodes a quarter of a step or more from any set-point. Without the parabola the stated
    # uncertainty was four times the error over 18 to 75 degC (ENC-03J), and the error itself three times what it is now.
    points, error, stated = np.linspace(low, high, 5), [], []
    between, _ = share_limits(4 * 3 * devices)  # an axis has four independent places between five set-points
    nodes = np.linspace(low, high, 25)
    far = np.abs(nodes[:, None] - points).min(axis=1) > 0.25 * (points[1] - points[0])
    for seed in range(devices):
        fit, truth, _, per_dps = fitted(seed, tuple(points), kind=kind, nodes=tuple(nodes))
        error.append(((fit.table.gyro_offset - truth) / per_dps)[far])
        stated.append((fit.gyro.curve_uncertainty / per_dps)[far])
    inside = float(np.mean(np.abs(error) <= 1.96 * np.array(stated)))
    rms, u = (1e3 * float(np.sqrt(np.mean(np.square(x)))) for x in (error, stated))
    show(f"{kind}, five set-points {low:g} to {high:g} degC, nodes between: inside", f"{inside:.3f}", between)
    show("root-mean-square error and stated uncertainty, mdeg/s", f"{rms:.1f}, {u:.1f}, ratio {u / rms:.2f}", widest)
    assert inside >= between
    assert u < widest * rms * ratio_limit(4 * 3 * devices)


# Widest: stated uncertainty over error, both root-mean-square over 8 devices. 1 would be right. A loop seen both ways counts
# by half its size, 45 mdeg/s, although the truth here is its very middle: a device in use lies anywhere between, where the error
# is larger. With a warm-up too the same half counts, so the same limit stands.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("points", "effects", "least", "widest"),
    [
        (UP, {"adc": True}, 0.90, 1.5),
        (UP_DOWN, {"hysteresis": True}, 0.93, 20.0),
        (UP_DOWN, {"hysteresis": True, "warm_up": True}, 0.93, 20.0),
        (UP, {"hysteresis": True}, 0.0, 0.5),
        (UP, {"warm_up": True}, 0.0, 0.7),
    ],
)
def test_intervals_with_other_effects_are_reported(points, effects, least, widest):
    # Steps of the converter and a loop seen both ways are in the interval; a loop seen one way and a young device are not.
    inside, error, stated = coverage(8, points, **effects)
    way = "going up" if points is UP else "up and down"
    show(
        f"{way}, {', '.join(effects)}: inside, error, stated", f"{inside:.3f}, {error:.1f}, {stated:.1f} mdeg/s", least
    )
    show("stated uncertainty over error", f"{stated / error:.2f}", widest)
    assert inside >= least
    assert stated < widest * error
    if least == 0.0:
        assert inside < 0.93  # the verdict has to say so: next test


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
