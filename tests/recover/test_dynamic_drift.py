"""Scale over temperature and dynamic drift of simulated devices: what is left after correction, against the true tables.

The device is the note's (ENC-03J), soaked every 5 degC from 18 to 75 degC, turned both ways at 5 to 90 deg/s by 5 about three
axes. Its thermometer has noise and no trim error, so that the true tables, which are over the true temperature, are not put at
a disadvantage. The rate that a correction is held to is what the same low-pass makes of the true rate.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.rate_steps import GRAVITY, GRID, SOAKS, computed, reading, soaked, table_motion
from undrift.calibration.calibrate import calibrate
from undrift.correction.correct import correct_checked
from undrift.drift.observe import RestBlocks
from undrift.drift.rates import DynamicFit, fit_dynamic, fit_scale, prepared
from undrift.fit.curve import not_a_knot
from undrift.model import Calibration, DriftTables, StaticDrift
from undrift.sim.device.effects import Scale, SensorChain, Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import draw_task
from undrift.sim.sessions import simulate_session

NODES = np.arange(18.0, 75.01, 0.5)
BOTH_WAYS = np.concatenate((-GRID[::-1], [0.0], GRID))
LIMIT = 1.2  # of the true tables' error: the promise


def quiet_floor(device: DeviceModel) -> float:
    """Return two standard deviations of the offset's flicker, deg/s: each soak holds one draw of it, and no table can know it."""
    flicker = device.gyro.instability
    processes = len(flicker.time_constants_s)
    return 2.0 * float(np.degrees(flicker.instability.max()) * np.sqrt(processes * np.log(10.0**0.5) / np.pi))


def note_device(seed: int) -> DeviceModel:
    model = random_device(np.random.default_rng(seed), grade="enc03j_3031")
    return replace(model, thermometer=Thermometer(noise_c=0.05))


def static_of(rests: RestBlocks) -> StaticDrift:
    """Return the note's static table: a not-a-knot spline through the mean of the three mountings at each soak."""
    temp, value = rests.temp_c.reshape(-1, 3).mean(axis=1), rests.gyro.reshape(-1, 3, 3).mean(axis=1)
    return StaticDrift(temp_c=NODES, gyro_offset=not_a_knot(temp, value, np.zeros_like(value), NODES).value)


def errors(
    device: DeviceModel,
    motion: Motion,
    temp_c: float,
    calibrations: list[Calibration],
    rows: np.ndarray,
    volts_per_count: float = 1.0,
) -> list[float]:
    """Return the rms rate error of each calibration, deg/s; of a device without converter its step makes counts of volts."""
    passed = SensorChain(unit="rad/s", scale=Scale(nominal_sensitivity=1.0), low_pass=device.gyro.low_pass)
    record = simulate_device(device, motion, rng=np.random.default_rng(7), temp_c=temp_c, power_on_s=7200.0).record
    record = replace(record, gyro=record.gyro / volts_per_count, gyro_unit=calibrations[0].gyro.unit_in)
    ideal = simulate_device(replace(device, gyro=passed), motion, rng=np.random.default_rng(7), temp_c=temp_c).record
    return [
        float(
            np.degrees(
                np.sqrt(np.mean((correct_checked(record, c, policy="hold").record.gyro - ideal.gyro)[rows] ** 2))
            )
        )
        for c in calibrations
    ]


def sit_to_stand(seed: int) -> Motion:
    task = draw_task("sit_to_stand", rng=np.random.default_rng(seed))
    return task.at(np.arange(round(task.duration_s * 100.0)) / 100.0, GRAVITY)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_compensated_rate_error_is_near_the_true_tables(seed: int) -> None:
    motion = table_motion(dwell_s=1.5)
    dwells = np.concatenate([np.arange(turn.start + 50, turn.stop) for turn in motion.turns])
    rng = np.random.default_rng(seed)
    device = note_device(seed)
    quiet = replace(device, gyro=replace(device.gyro, white_noise=None, instability=None, random_walk=None, adc=None))
    steps, rests = soaked(device, motion, SOAKS, rng)
    bench = BenchSettings(turn_rates=tuple(GRID[::4]), dwell_s=1.5)
    constant = calibrate(simulate_session("bench", device, rng=rng, settings=bench))
    static = static_of(rests)
    clean = prepared(steps, constant.gyro, static=static)
    scale = fit_scale(clean, constant.gyro, temp_c=NODES).drift
    dynamic = fit_dynamic(clean, constant.gyro, span_c=(18.0, 75.0), scale=scale).drift
    tables = DriftTables(static=static, scale=scale, dynamic=dynamic)
    calibrations = [
        constant,
        replace(constant, drift=DriftTables(static=static)),
        replace(constant, drift=tables),
        replace(true_calibration(device), drift=true_tables(device, NODES, 1.05 * BOTH_WAYS)),
    ]
    for temp_c in (21.0, 38.0, 62.0):
        both = ("sit-to-stand", sit_to_stand(seed), slice(None)), ("grid", motion, dwells)
        for name, moved, rows in both if seed else both[temp_c == 38.0 :][:1]:  # all of each in `make test-long`
            residual = errors(device, moved, temp_c, calibrations, rows)
            figures = "constant {:.3f}, static {:.3f}, all tables {:.4f}, true tables {:.4f}".format(*residual)
            show(f"device {seed}, {temp_c:g} degC, {name}, deg/s rms", figures, f"{LIMIT} x the last")
            quiet_left = errors(quiet, moved, temp_c, calibrations[2:], rows, device.gyro.adc.step)
            show(
                f"device {seed}, {temp_c:g} degC, {name}, readings without noise, deg/s rms",
                "all tables {:.4f}, true tables {:.4f}".format(*quiet_left)
                + f", ratio {quiet_left[0] / quiet_left[1]:.2f}",
                f"hypot of {quiet_floor(device):.4f} and {LIMIT} x the last",
            )
            assert quiet_left[0] < np.hypot(quiet_floor(device), LIMIT * quiet_left[1])
            assert residual[2] < LIMIT * residual[3]
            assert residual[2] < residual[1] < residual[0]


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
        static = true_tables(device, NODES, np.array([-1.0, 1.0])).static
        rng = np.random.default_rng(100 + seed)
        # The matrix on a device of straight lines: on a bent one the best line over the grid is no single truth.
        fit = fit_scale(
            prepared(computed(straight, SOAKS, rng, rates=GRID[1::2]), true_calibration(straight).gyro, static=static),
            true_calibration(straight).gyro,
            temp_c=NODES,
        )
        truth = true_tables(straight, NODES, np.array([-1.0, 1.0])).scale
        z_scale.append((fit.drift.gyro_matrix - truth.gyro_matrix) / fit.drift.gyro_uncertainty)
        if seed % 3:
            continue
        steps = computed(device, SOAKS, rng, rates=GRID[1::2])
        calibration = true_calibration(device)
        dynamic = fit_dynamic(prepared(steps, calibration.gyro, static=static), calibration.gyro, span_c=(15.0, 75.0))
        seen = ~dynamic.drift.extrapolated & (dynamic.drift.turn_rate != 0.0)
        for axis in range(3):
            off = dynamic.drift.error[..., axis] - _truth_of_e(device, dynamic, axis)
            z_dynamic.append((off / dynamic.drift.uncertainty[..., axis])[seen])
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
