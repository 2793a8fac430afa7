"""Both triads from motion only, on an imperfect bench: three hand-held recordings of a device on three days, half
without a rest.

Readings are scaled by the data sheet. Their errors: turn-on offset of each recording, random walk of the grade,
flicker, cross-axis terms, g-sensitivity, and truncated codes, depending on the grade. Gravity is assumed. The true
offset of a recording is the mean of these errors of its rates. A common rotation of both triads is not observable.
Therefore only the symmetric part of cross-axis terms counts.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.calibration.calibrate import from_motion
from undrift.model import TriadModel
from undrift.record import Record, Session
from undrift.sim.device.effects import BiasInstability
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import GRADES, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

RATE_HZ, RECORDINGS, WITHOUT_REST = 50.0, 3, 0.5
TURN_ON = 0.05 * RADIAN_PER_DEGREE  # rad/s, of each recording
GRAVITY = 0.02  # m/s2, error of the assumed gravity
FLICKER = {"gyro": 8.0 / 3600.0 * RADIAN_PER_DEGREE, "accel": 5e-5 * STANDARD_GRAVITY}  # of an MPU-6050's data sheet
SLOW = ("offset", "g_sensitivity", "instability", "random_walk")  # effects whose mean is a recording's offset
SCALE = np.eye(9)[[0, 4, 8]]
CROSS = 0.5 * (np.eye(9)[[1, 2, 5]] + np.eye(9)[[3, 6, 7]])


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of each grade."""
    for grade in GRADES:
        rng, tally = np.random.default_rng(seed), Tally("motion alone", f"{grade} part, three recordings in hands")
        for _ in range(devices):
            device = erring(random_device(rng, grade=grade))
            records, offsets = handled(device, rng)
            session = Session(
                kind="calibration", serial="", records=records, gravity_m_s2=STANDARD_GRAVITY, gravity_source="standard"
            )
            calibration, fit = from_motion(session)
            true = true_calibration(device)
            groups = {
                f"{triad[0]}. {name}": _against(observable, *models)
                for triad, models in (
                    ("gyro", (calibration.gyro, true.gyro, device.gyro.gain)),
                    ("accel", (calibration.accel, true.accel, device.accel.gain)),
                )
                for name, observable in (("scale", SCALE), ("cross", CROSS))
            }
            assert calibration.accel is not None
            assert true.accel is not None
            away = calibration.accel.offset - (true.accel.offset - device.accel.null) / device.accel.gain
            tally.add(
                calibration.verdict, **groups, **{"a. offset": (away, calibration.accel.standard_uncertainty[9:12])},
                recordings=((fit.offsets - offsets) / RADIAN_PER_DEGREE, fit.offset_uncertainty / RADIAN_PER_DEGREE),
            )  # fmt: skip
        yield from tally.rows()


def erring(device: DeviceModel) -> DeviceModel:
    """Return a device with flicker. Walk, g-sensitivity and codes depend on its grade."""
    gyro, accel = (
        replace(chain, instability=BiasInstability(instability=np.full(3, FLICKER[kind])))
        for kind, chain in (("gyro", device.gyro), ("accel", device.accel))
    )
    return replace(device, gyro=gyro, accel=accel)


def handled(device: DeviceModel, rng: np.random.Generator) -> tuple[tuple[Record, ...], FloatArray]:
    """Return recordings of a device in hands, in rad/s and m/s2 by its data sheet, and the offset of each, (R, 3) rad/s."""
    records, offsets, gravity = [], [], STANDARD_GRAVITY + GRAVITY * rng.standard_normal()
    for _ in range(RECORDINGS):
        task = draw_task("free", rng=rng)
        today = replace(device, gyro=device.gyro.shifted(TURN_ON * rng.standard_normal(3)))
        motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, gravity)
        simulated = simulate_device(today, motion, rng=rng)
        cut_s = task.moving_s if rng.uniform() < WITHOUT_REST else (0.0, np.inf)
        recorded = (simulated.record.time >= cut_s[0]) & (simulated.record.time < cut_s[1])
        offsets.append(sum(simulated.gyro.of(effect)[recorded].mean(axis=0) for effect in SLOW))
        gyro, accel = (
            (np.asarray(getattr(simulated.record, name)) - chain.null) / chain.gain
            for name, chain in (("gyro", device.gyro), ("accel", device.accel))
        )
        si = replace(simulated.record, gyro=gyro, accel=accel, gyro_unit="rad/s", accel_unit="m/s2")
        records.append(si.between(*cut_s))
    return tuple(records), np.array(offsets)


def _against(
    observable: FloatArray, model: TriadModel | None, true: TriadModel | None, gain: float
) -> tuple[FloatArray, FloatArray]:
    """Return errors of the observable elements of a matrix and their standard uncertainties. The true matrix is for raw
    readings.
    """
    assert model is not None
    assert true is not None
    error = observable @ (model.matrix - gain * true.matrix).ravel()
    return error, np.sqrt(np.diag(observable @ model.covariance[:9, :9] @ observable.T))
