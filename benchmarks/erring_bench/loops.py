"""Hysteresis: half-widths and tables of drawn devices whose loops have a width, a shape and a beginning of their own.

A ramp up and back at two speeds, with thermometer lag, trim error and noise, flicker and a converter. Truth is the half-width of
the simulator's loop; ``reading`` is the offset on a course to come, corrected by the loop from a beginning that is not known.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.drift.fit import DriftFit, DriftSettings, fit_drift
from undrift.drift.hysteresis import follow_loop, state_of, uncertain_share
from undrift.errors import NotObservable
from undrift.sim.device.effects import Past, Scene, ThermalHysteresis
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import RampSettings, ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE as DPS

SHAPES = {"one play": (1.0,), "four plays": (0.4, 0.8, 1.2, 1.6), "eight plays": tuple(np.linspace(0.1, 2.5, 8))}
BITS, PLAY_K = (12, 14, 16), (0.75, 4.0)
COURSE_C = (35.0, 41.0, 38.0, 47.0, 30.0)  # turns of a course to come
_STEP_C, _STEP_S = 0.05, 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plays(ThermalHysteresis):
    """The mean of plays of several widths, which begin at a position from -1 to 1 of their own loop."""

    widths: tuple[float, ...] = (1.0,)  # times ``play_k``
    begin: float = 0.0

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        if past.state is None:
            past.state = [float(scene.temp_c[0]) + self.begin * w * self.play_k for w in self.widths]
        return x + np.outer(self.positions(scene.temp_c, past.state), self.amplitude)

    def positions(self, temp_c: FloatArray, state: list[float]) -> FloatArray:
        """Return where in the loop each of the temperatures is, (n,); the state is moved on."""
        found = np.zeros(len(temp_c))
        for number, width in enumerate(self.widths):
            reach, at = width * self.play_k, state[number]
            held = np.empty(len(temp_c))
            for k, temp in enumerate(temp_c.tolist()):
                at = temp + reach if at > temp + reach else temp - reach if at < temp - reach else at
                held[k] = at
            found += (held - temp_c) / (reach * len(self.widths))
            state[number] = at
        return found


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of each shape."""
    for number, (name, widths) in enumerate(SHAPES.items()):
        tally = Tally("hysteresis", name)
        for device_number in range(devices):
            rng = np.random.default_rng((seed, number, device_number))
            _add_device(rng, widths, tally)
        yield from tally.rows()


def drawn(rng: np.random.Generator, widths: tuple[float, ...]) -> tuple[DeviceModel, Plays]:
    """Draw a device and its loop."""
    device = random_device_of("enc03j_3031", rng)
    usual = device.gyro.hysteresis
    if usual is None or device.gyro.adc is None:
        raise NotObservable("loops: wanted a device with hysteresis and a converter, got none; draw another preset")
    loop = Plays(
        amplitude=usual.amplitude, play_k=float(np.exp(rng.uniform(*np.log(PLAY_K)))), widths=widths,
        begin=float(rng.choice([-1.0, 0.0, 1.0])),
    )  # fmt: skip
    adc = replace(device.gyro.adc, bits=int(rng.choice(BITS)))
    thermometer = replace(device.thermometer, lag_s=float(rng.choice([0.0, 20.0, 80.0])))
    return replace(
        device, gyro=replace(device.gyro, hysteresis=loop, warm_up=None, adc=adc), thermometer=thermometer
    ), loop


def _add_device(rng: np.random.Generator, widths: tuple[float, ...], tally: Tally) -> None:
    device, loop = drawn(rng, widths)
    low, span = rng.uniform(15.0, 20.0), rng.uniform(35.0, 45.0)
    up, down = rng.uniform(1.5, 2.5), rng.uniform(0.6, 1.0)
    ramp = RampSettings(low_c=low, high_c=low + span, up_c_per_min=up, down_c_per_min=down, hold_s=300.0)
    settings = ThermalSettings(bench=BenchSettings(sample_rate_hz=5.0), ramp=ramp)
    session = simulate_thermal_session("ramp", device, rng=rng, settings=settings)
    fit = fit_drift([session], true_calibration(device), settings=DriftSettings(step_c=1.0, tables="none"))
    found = fit.static.gyro
    if found is None or found.curve.loop is None:
        raise NotObservable("loops: wanted a table with a loop, got none; draw another device")
    raw = device.gyro.gain * DPS  # the loop is not scaled by the sensitivity of the unit
    groups = {"half-width": (found.curve.loop.half / raw - loop.amplitude / DPS, found.curve.loop.uncertainty / raw)}
    model = fit.static.table.hysteresis
    if model is not None:
        groups["at ends"] = (model.gyro_half_width / raw - loop.amplitude / DPS, model.gyro_uncertainty / raw)
    if model is not None and len(widths) == 1:
        groups["crossing, K"] = np.array(model.crossing_k - 2.0 * loop.play_k), np.array(model.crossing_uncertainty_k)
    tally.add(fit.verdict, **groups, reading=_readings(fit, device, loop))


def _readings(fit: DriftFit, device: DeviceModel, loop: Plays) -> tuple[FloatArray, FloatArray]:
    """Return errors of table and loop at five moments of a course to come, and what is stated, (5, 3) deg/s."""
    table, found = fit.static.table, fit.static.gyro
    if found is None or found.offset is None:
        raise NotObservable("loops: wanted a table of gyroscopes, got none; draw another device")
    legs = pairwise(COURSE_C)
    true_c = np.concatenate([np.arange(a, b, math.copysign(_STEP_C, b - a)) for a, b in legs])
    position = loop.positions(true_c, [true_c[0] + loop.begin * w * loop.play_k for w in loop.widths])
    shown = true_c + device.thermometer.trim_error_c + device.thermometer.self_heating_c
    at = (np.linspace(0.02, 0.98, 5) * (len(shown) - 1)).astype(int)
    quiet = replace(device, gyro=replace(device.gyro, hysteresis=None))
    models = [true_calibration(quiet, temp_c=float(temp)).gyro for temp in true_c[at]]
    truth = np.array([model.offset for model in models if model is not None])
    truth = truth + np.outer(position[at], loop.amplitude * device.gyro.gain)

    def over(nodes: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(shown[at], nodes, column) for column in values.T])

    value, variance, model = (
        over(table.temp_c, found.offset),
        over(table.temp_c, found.uncertainty**2),
        table.hysteresis,
    )
    if model is not None and table.gyro_hysteresis is not None:
        state, begin, known = state_of(None, model.crossing_k), 0, []
        for end in (at + 1).tolist():
            state = follow_loop(shown[begin:end], _STEP_S * np.arange(begin, end), state=state)[1]
            known.append(uncertain_share(state, model.crossing_uncertainty_k))
            begin = end
        c, share = np.array(known).T[:, :, None]
        half, own = over(model.temp_c, model.gyro_half_width), over(model.temp_c, model.gyro_uncertainty)
        value = value + c * half
        variance = variance - table.gyro_hysteresis**2 + (share * half) ** 2 + (c * own) ** 2
    raw = device.gyro.gain * DPS
    return (value - truth) / raw, np.sqrt(np.maximum(variance, 0.0)) / raw
