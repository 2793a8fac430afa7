"""What a skew mounting costs and gives: scale over temperature from one mounting in place of three.

The device is turned about (1, 1, 1) of its case: all gyroscopes turn at 0.58 of the table's rate (drift/rate_steps.py). The plain
session turns about x, y and z at every set-point; the skew one does so at room temperature, which needs no soak, and turns about
(1, 1, 1) there and at every set-point, in one mounting. Both are mounted off by the bench's tilt, each mounting anew, and go
through the fit that `drift` uses. ``python -m benchmarks.skew_mounting`` prints minutes, errors and coverage.
"""

import argparse
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.observe import RateSteps
from undrift.drift.rate_steps import CROSS_PER_K, fit_scale
from undrift.rig.programme import Dwell, Protocol, programme_of
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import unit_vector
from undrift.sim.table_sessions import ImposedDwells, mean_readings, numbers_of_dwell
from undrift.study.plan import NOTE_BENCH, SET_POINTS_C
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
ROOM_C = 25.0
STEP_S, SOAK_S = 3.0, 1800.0
NOTES = Protocol(
    turn_rate_min=5.0 * DPS,
    turn_rate_max=90.0 * DPS,
    turn_rate_step=5.0 * DPS,
    grid="paper",
    dwell_s=2.0,
    temperatures_c=SET_POINTS_C,
    faces_at="room",
)
SKEW = replace(NOTES, heated_axis="xyz")
NODES_C = np.array(SET_POINTS_C)


def minutes() -> tuple[float, float]:
    """Return the forecast of the plain session and of the skew one."""
    plain, skew = (programme_of(protocol).duration_s / 60.0 for protocol in (NOTES, SKEW))
    return plain, skew


def with_changes(device: DeviceModel, change: FloatArray, temp_c: float) -> DeviceModel:
    """Return a device at a temperature with its cross-axis terms changed by so much a kelvin, (3, 3)."""
    scale = device.gyro.scale
    scale = replace(scale, cross_axis=scale.cross_axis + change * (temp_c - ROOM_C))
    return replace(device, gyro=replace(device.gyro, scale=scale))


def steps_of(
    protocol: Protocol, device: DeviceModel, change: FloatArray, errors: BenchErrors, rng: np.random.Generator
) -> RateSteps:
    """Return the rates of a protocol as encoder and device read them; each mounting is off as drawn, each soak as well."""
    start_s, axis_b, visit, board_c, parts = SOAK_S, np.zeros(3), ("", None), ROOM_C, []
    block: list[Dwell] = []
    dwells = [dwell for dwell in programme_of(protocol).dwells if dwell.purpose == "rate"]
    for place, dwell in enumerate(dwells):
        if dwell.up != visit[0]:
            nominal = unit_vector(dwell.up)
            axis_b = nominal + np.cross(errors.mount_tilt * rng.standard_normal(3), nominal)
            axis_b /= np.linalg.norm(axis_b)
        if (dwell.up, dwell.temp_c) != visit:
            start_s += SOAK_S
            off = 0.0 if dwell.temp_c is None else errors.soak_k * rng.standard_normal()
            board_c, block = (dwell.temp_c or ROOM_C) + off, []
        visit = (dwell.up, dwell.temp_c)
        block.append(dwell)
        after = dwells[place + 1] if place + 1 < len(dwells) else None
        if after is None or (after.up, after.temp_c) != visit:
            parts.append(_read(block, with_changes(device, change, board_c), axis_b, board_c, start_s, errors, rng))
    soaks = np.concatenate([np.full(len(part[0]), k) for k, part in enumerate(parts)])
    rate_b, gyro, accel, temp_c, time = (np.concatenate(column) for column in zip(*parts, strict=True))
    return RateSteps(
        session=np.zeros(len(soaks), int),
        soak=soaks,
        time=time,
        temp_c=temp_c,
        rate_b=rate_b,
        gyro=gyro,
        accel=accel,
        gyro_variance=np.full(gyro.shape, np.nan),
    )


def _read(
    block: list[Dwell],
    device: DeviceModel,
    axis_b: FloatArray,
    board_c: float,
    start_s: float,
    errors: BenchErrors,
    rng: np.random.Generator,
) -> tuple[FloatArray, ...]:
    """Return nominal axis times the encoder's rate, readings, specific force, temperature and time of a block, one row a dwell."""
    length = np.array([dwell.dwell_s for dwell in block])
    true = np.array([dwell.turn_rate for dwell in block]) + errors.servo * rng.standard_normal(len(block)) / length
    count = 2.0 * np.pi / (4.0 * errors.encoder_lines)
    encoder = np.floor(rng.random(len(block)) + true * length / count) * count / length
    about = axis_b + np.cross(errors.wobble * rng.standard_normal((len(block), 3)), axis_b)
    time, temp_c = start_s + np.cumsum(length + STEP_S), np.full(len(block), board_c)
    force = np.tile(STANDARD_GRAVITY * axis_b, (len(block), 1))
    dwells = ImposedDwells(
        start_s=time - length, duration_s=length, rate_b=true[:, None] * about, force_b=force, temp_c=temp_c
    )
    normals = rng.standard_normal((len(block), 3, numbers_of_dwell(device.gyro)))
    reading = mean_readings(device, "gyro", dwells, normals, np.arange(len(block)))
    return encoder[:, None] * unit_vector(block[0].up), reading, force, temp_c, time


def scale_of(device: DeviceModel, temp_c: float, most: float) -> FloatArray:
    """Return the best straight line through noiseless readings of each sensor up to a rate about its own axis, (3,)."""
    rates = most * np.linspace(-1.0, 1.0, 35)
    ones, slopes = np.ones(len(rates)), []
    for axis, nominal in enumerate(np.eye(3)):
        dwells = ImposedDwells(
            start_s=1e5 + 2.0 * np.arange(len(rates)),
            duration_s=ones,
            rate_b=rates[:, None] * nominal,
            force_b=STANDARD_GRAVITY * ones[:, None] * nominal,
            temp_c=temp_c * ones,
        )
        normals = np.zeros((len(rates), 3, numbers_of_dwell(device.gyro)))
        reading = mean_readings(device, "gyro", dwells, normals, np.arange(len(rates)))
        slopes.append(np.polyfit(rates, reading[:, axis], 1)[0])
    return np.array(slopes)


def unit(seed: int, cross_per_k: float) -> tuple[FloatArray, FloatArray]:
    """Return error and standard uncertainty of each scale factor at the set-points (2, 5, 3), plain and skew, relative.

    The truth is a line as well, over the rates that the sensor turns at: what bends belongs to the dynamic table.
    """
    rng = np.random.default_rng(seed)
    device = random_device_of("enc03j_3031", rng)
    change = cross_per_k * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))
    found, stated = [], []
    for protocol, share in ((NOTES, 1.0), (SKEW, 1.0 / np.sqrt(3.0))):
        steps = steps_of(protocol, device, change, NOTE_BENCH, rng)
        fit = fit_scale(steps, true_calibration(device, temp_c=ROOM_C), static=None, temp_c=NODES_C).drift
        assert fit.gyro_matrix is not None
        assert fit.gyro_uncertainty is not None
        line = [scale_of(device, temp_c, share * NOTES.turn_rate_max) for temp_c in (ROOM_C, *SET_POINTS_C)]
        own = scale_of(device, ROOM_C, NOTES.turn_rate_max) + np.array(line[1:]) - line[0]
        matrix = fit.gyro_matrix
        found.append(np.diagonal(np.linalg.inv(matrix), axis1=1, axis2=2) / own - 1.0)
        stated.append(np.diagonal(fit.gyro_uncertainty / matrix, axis1=1, axis2=2))
    return np.array(found), np.array(stated)


def main() -> None:
    """Print minutes, errors and how often they lie inside what is stated."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--units", type=int, default=60, help="Simulated devices, enc03j_3031")
    units = parser.parse_args().units
    plain, skew = minutes()
    print(f"forecast: plain {plain:.0f} min with 15 soaks, skew {skew:.0f} min with 5")
    for cross in (0.0, CROSS_PER_K):
        drawn = [unit(seed, cross) for seed in range(units)]
        found, stated = (np.array(part) for part in zip(*drawn, strict=True))
        print(f"cross-axis terms change by {cross:g} /K (standard deviation); {units} devices, 18 to 75 degC:")
        for which, name in enumerate(("plain", "skew")):
            error, sd = found[:, which], stated[:, which]
            inside = float((np.abs(error) <= 1.96 * sd).mean())
            rms, at_75 = 100.0 * np.sqrt((error**2).mean()), 100.0 * np.sqrt((error[:, -1] ** 2).mean())
            print(
                f"  {name:5}  scale factor over that at room temperature: error {rms:.4f} % rms, at 75 degC {at_75:.4f} %, stated "
                f"{100.0 * np.sqrt((sd**2).mean()):.4f} %; inside 95 % limits: {100.0 * inside:.1f} %"
            )


if __name__ == "__main__":
    main()
