"""Fused trials (W5) against the same stages in numpy and scipy, on one thread and on two."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.figure import Figure, stopwatch
from undrift.calibration.model import Calibration, DriftTables
from undrift.frames import quaternion_product
from undrift.orientation.angles import sagittal_pitch
from undrift.sim.device.low_pass import difference_equation
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.noise import RandomWalk
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.library import draw_task
from undrift.sim.motion.motion import Motion
from undrift.trial import Trial, TrialBench, TrialSettings, run_trials, trial_bench, trial_device
from undrift.units import STANDARD_GRAVITY

BLOCK, N, TRIALS, RATE_HZ, TEMP_C, SLOPE = 75, 6_000, 512, 286.0, 22.0, 0.05


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        W5, ns/sample on one core, ratio to numpy, two threads over one, and whether the bits agree.
    """
    rng = np.random.default_rng(1)
    walk = RandomWalk(bias_walk=np.full(3, 2e-4))
    devices = [trial_device(random_device_of("enc03j_3031", rng)) for _ in range(8)]
    devices = [replace(device, gyro=replace(device.gyro, random_walk=walk)) for device in devices]
    motions, calibrations = [_motion(rng) for _ in range(4)], [_table_of(device) for device in devices]
    plan = [Trial(k % 4, k % 8, k % 8, k, TEMP_C, SLOPE) for k in range(TRIALS)]
    one, two = (trial_bench(motions, devices, calibrations, TrialSettings(threads=n, batch=TRIALS)) for n in (1, 2))
    quiet = [replace(d, gyro=replace(d.gyro, white_noise=None, random_walk=None)) for d in devices]
    silent = trial_bench(motions, quiet, calibrations)
    s = stopwatch(
        {name: _runner(bench, plan) for name, bench in {"one": one, "two": two, "silent": silent}.items()}, rounds=7
    )
    slow = stopwatch({"numpy": lambda: _in_numpy(motions[0], devices[0], calibrations[0], rng)}, rounds=5)
    each, numpy_each = s["one"] / (N * TRIALS), slow["numpy"] / N
    same = all(
        np.array_equal(a.rms, b.rms) and np.array_equal(a.maximum, b.maximum)
        for a, b in zip(run_trials(one, plan), run_trials(two, plan), strict=True)
    )
    return [
        Figure("W5 trial with all noise, one thread", each * 1e9, "ns/sample", "<= 35"),
        Figure("W5 trial without noise, one thread", s["silent"] / (N * TRIALS) * 1e9, "ns/sample"),
        Figure("W5 numpy and scipy over trial", numpy_each / each, "x", ">= 20"),
        Figure("W5 two threads over one", s["one"] / s["two"], "x", ">= 1.85"),
        Figure("W5 two threads give the bits of one (1 = yes)", float(same), "", ">= 1"),
    ]


def _runner(bench: TrialBench, plan: list[Trial]) -> object:
    return lambda: list(run_trials(bench, plan))


def _motion(rng: np.random.Generator) -> Motion:
    return draw_task("posturography", rng=rng).at(np.arange(N) / RATE_HZ, STANDARD_GRAVITY)


def _table_of(device: DeviceModel) -> Calibration:
    tables = true_tables(device, np.linspace(5.0, 45.0, 9), np.array([-3.0, 0.0, 3.0]))
    calibration = true_calibration(device)
    gyro = replace(calibration.gyro, g_sensitivity=None)
    return replace(calibration, gyro=gyro, drift=DriftTables(static=tables.static))


def _in_numpy(motion: Motion, device: DeviceModel, calibration: Calibration, rng: np.random.Generator) -> float:
    """The same trial by whole arrays."""
    chain, n, step = device.gyro, len(motion), 1.0 / RATE_HZ
    temp = TEMP_C + SLOPE * motion.time
    warmth = (temp - device.reference_temp_c)[:, None]
    x = motion.rate_b @ chain.scale.matrix.T
    x = x + chain.offset.constant + (chain.offset.per_k[1] * warmth + chain.offset.per_k[0]) * warmth
    x = x * (1.0 + chain.thermal_scale.per_k[0] * warmth)
    x = x + chain.rate_drift.coefficients[2, 1] * warmth * x**3
    x = x + rng.standard_normal((n, 3)) * (chain.white_noise.random_walk / np.sqrt(step))
    x = x + np.cumsum(rng.standard_normal((n, 3)) * (chain.random_walk.bias_walk * np.sqrt(step)), axis=0)
    total = chain.amplifier.gain * chain.scale.nominal_sensitivity
    x = np.clip(x, -chain.amplifier.null / total, chain.amplifier.null / total)
    for axis in range(3):
        b, a = difference_equation(float(chain.low_pass.cutoff_hz[axis]), float(chain.low_pass.quality[axis]), step)
        zi = np.array([1.0 - b[0], b[2] - a[2]]) * x[0, axis]
        x[:, axis] = lfilter(b, a, x[:, axis], zi=zi)[0]
    code = np.clip(np.rint((chain.amplifier.null + total * x) / chain.adc.step), *chain.adc.code_limits)
    static = calibration.drift.static
    offset = np.column_stack([np.interp(temp, static.temp_c, static.gyro_offset[:, axis]) for axis in range(3)])
    rate = (code - offset) @ calibration.gyro.matrix.T
    error = sagittal_pitch(_running_product(rate * (0.5 * step), motion.q_nb[0])) - sagittal_pitch(motion.q_nb)
    return float(np.sqrt(np.mean(error**2)))


def _running_product(half: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Running product of the steps in blocks: within all blocks at once, then from block to block."""
    angle = np.linalg.norm(half, axis=1)
    turn = np.column_stack((np.cos(angle), np.sinc(angle / np.pi)[:, None] * half))
    turn[0] = start
    q = turn.reshape(-1, BLOCK, 4)
    for k in range(1, BLOCK):
        q[:, k] = quaternion_product(q[:, k - 1], q[:, k])
    before = np.empty((len(q), 4))
    before[0] = 1.0, 0.0, 0.0, 0.0
    for k in range(1, len(q)):
        before[k] = quaternion_product(before[k - 1], q[k - 1, -1])
    return quaternion_product(np.repeat(before, BLOCK, axis=0), q.reshape(-1, 4))
