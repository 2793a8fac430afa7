"""Offset over temperature of simulated devices: does the table find it, and do its intervals hold it?"""

from dataclasses import replace

import numpy as np
import pytest

from data import show
from devices import device_of, motion_of
from undrift.drift.fit.curve import CurveSettings
from undrift.drift.fit.static import StaticSettings, fit_static
from undrift.drift.observe import observe_rests
from undrift.record import Record
from undrift.session import Session, Still
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.units import RADIAN_PER_DEGREE

UP = np.append(np.arange(18.0, 75.0, 5.0), 75.0)
UP_DOWN = np.concatenate((UP, UP[-2::-1]))
NODES = np.arange(18.0, 75.1, 2.5)


def soaks(points, hold_s=900, ramp_s=300, rest_s=300):
    """One sample a second: ramps of five minutes, holds of fifteen, the last five of them stated as rest."""
    temp, stills, n, before = [], [], 0, points[0]
    for k, point in enumerate(points):
        ramp = np.linspace(before, point, ramp_s, endpoint=False) if k else np.zeros(0)
        temp += [ramp, np.full(hold_s, point)]
        n += len(ramp) + hold_s
        stills.append(Still(start=n - rest_s, stop=n))
        before = point
    return np.concatenate(temp), tuple(stills)


def fitted(seed, points, *, hysteresis=False, warm_up=False, adc=False, fit_warm_up=False):
    """Return the fit of one drawn ENC-03J and the truth at its thermometer's nodes."""
    rng = np.random.default_rng(seed)
    device = random_device_of("enc03j_3031", rng)
    gyro = replace(device.gyro, low_pass=None)  # one sample a second sees no filter
    gyro = replace(
        gyro,
        hysteresis=gyro.hysteresis if hysteresis else None,
        warm_up=gyro.warm_up if warm_up else None,
        adc=gyro.adc if adc else None,
    )
    accel = replace(device.accel, low_pass=None, adc=None, lever_arm=None)
    device = replace(device, gyro=gyro, accel=accel)
    temp, stills = soaks(points, *((2400, 300, 2100) if fit_warm_up else (900, 300, 300)))
    motion = motion_of(np.arange(len(temp)) * 1.0, np.zeros((len(temp), 3)))
    record = simulate_device(device, motion, rng=rng, temp_c=temp).record
    session = Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=(record,), stills=stills)
    blocks = observe_rests([session], temperatures=[[record.temp_c]])
    fit = fit_static(
        blocks,
        nodes=NODES,
        calibration=true_calibration(device),
        settings=StaticSettings(curve=CurveSettings(warm_up=fit_warm_up)),
    )
    board = NODES - device.thermometer.trim_error_c - device.thermometer.self_heating_c
    truth = np.array([true_calibration(device, temp_c=float(t)).gyro.offset for t in board])
    return fit, truth, device.gyro.gain * RADIAN_PER_DEGREE


def coverage(devices, points, **effects):
    inside, square, stated = [], [], []
    for seed in range(devices):
        fit, truth, per_dps = fitted(seed, points, **effects)
        seen = ~fit.table.gyro_extrapolated
        error = (fit.table.gyro_offset - truth)[seen]
        inside.append((np.abs(error) <= 1.96 * fit.table.gyro_uncertainty[seen]).mean())
        square.append((error**2).mean() / per_dps**2)
        stated.append((fit.table.gyro_uncertainty[seen] ** 2).mean() / per_dps**2)
    return float(np.mean(inside)), 1e3 * float(np.sqrt(np.mean(square))), 1e3 * float(np.sqrt(np.mean(stated)))
