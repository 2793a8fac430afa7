"""Static drift: left-out soaks of drawn devices whose offset differs from visit to visit, and the scale from one rate one way round."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.drift.observe import RestBlocks, observe_rests
from undrift.drift.static import StaticFit, fit_static
from undrift.errors import NotObservable
from undrift.model import Calibration
from undrift.record import Record, Session, Still
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import Motion
from undrift.units import STANDARD_GRAVITY

SCATTER_DPS = (0.0, 0.002, 0.005, 0.02)  # from visit to visit
SOAK_S = (1, 60, 600)  # rows at 1 Hz
POINTS = np.append(np.arange(18.0, 75.0, 5.0), 75.0)
_HOLD_S, _RAMP_S = 120, 600  # before the rest of a soak, and between two


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield a row for each scatter, length of soak and number of visits; hysteresis, converter, filter and noise are on."""
    for visits in (1, 2):
        for length_s in SOAK_S:
            for scatter_dps in SCATTER_DPS:
                way = "up" if visits == 1 else "up and down"
                tally = Tally("static drift", f"{way}, {length_s} s a soak, {1e3 * scatter_dps:g} mdeg/s")
                for number in range(devices):
                    rng = np.random.default_rng((seed, visits, length_s, int(1e6 * scatter_dps), number))
                    _soak_left_out(rng, length_s, visits, scatter_dps, tally)
                yield from tally.rows()


def _soak_left_out(rng: np.random.Generator, length_s: int, visits: int, scatter_dps: float, tally: Tally) -> None:
    """Fit all soaks of a drawn device but one between others, and predict it."""
    device = random_device_of("enc03j_3031", rng)
    blocks, calibration = _soaks(rng, device, length_s, visits, scatter_dps)
    points = POINTS[np.abs(blocks.temp_c[:, None] - POINTS).argmin(axis=1)]
    of_visit = np.cumsum(np.abs(np.diff(points, prepend=points[0])) > 0.0)
    inner = np.unique(of_visit[(points > POINTS[0]) & (points < POINTS[-1])])
    left = of_visit == rng.choice(inner)
    fit = fit_static(
        blocks.taken(~left), nodes=np.sort(np.append(POINTS, blocks.temp_c[left].mean())), calibration=calibration
    )
    _judged(fit, blocks.taken(left), calibration, tally)


def _judged(fit: StaticFit, left: RestBlocks, calibration: Calibration, tally: Tally) -> None:
    if fit.gyro is None or fit.table.gyro_uncertainty is None or calibration.gyro is None:
        raise NotObservable("static drift: wanted gyroscopes, got none; draw another device")
    at, per_raw = left.temp_c.mean(), np.degrees(1.0) / calibration.gyro.scale_factor
    node = int(np.abs(fit.table.temp_c - at).argmin())
    noise = np.nan_to_num(left.gyro_variance).mean(axis=0) / len(left)
    stated = np.sqrt(fit.table.gyro_uncertainty[node] ** 2 + noise)
    offset = fit.table.gyro_offset
    error = left.gyro.mean(axis=0) - (0.0 if offset is None else offset[node])
    tally.add(fit.verdict, offset=(error * per_raw, stated * per_raw))


def _soaks(
    rng: np.random.Generator, device: DeviceModel, length_s: int, visits: int, scatter_dps: float
) -> tuple[RestBlocks, Calibration]:
    """Return the rests of a device that goes up through all set-points, and down again for two visits."""
    device = replace(device, gyro=replace(device.gyro, warm_up=None), accel=replace(device.accel, lever_arm=None))
    calibration = true_calibration(device)
    way = POINTS if visits == 1 else np.concatenate((POINTS, POINTS[-2::-1]))
    temp, stills, shift = list[FloatArray](), list[Still](), list[FloatArray]()
    n, hold = 0, _HOLD_S + length_s
    for k, point in enumerate(way):
        ramp = np.linspace(way[k - 1], point, _RAMP_S, endpoint=False) if k else np.zeros(0)
        temp += [ramp, np.full(hold, point)]
        n += len(ramp) + hold
        stills.append(Still(start=n - max(length_s, 2), stop=n))
        own = scatter_dps * rng.normal(size=3)
        shift.append(np.tile(own, (len(ramp) + hold, 1)))
    course = np.concatenate(temp)
    record = simulate_device(device, _lying(len(course)), rng=rng, temp_c=course, power_on_s=7200.0).record
    gain = np.eye(3) if calibration.gyro is None else calibration.gyro.forward_matrix
    record = replace(record, gyro=record.gyro + np.radians(np.concatenate(shift)) @ gain.T)
    session = Session(kind="thermal", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=tuple(stills))
    return observe_rests([session], temperatures=[[_known(record)]]), calibration


def _known(record: Record) -> FloatArray:
    return np.zeros(len(record)) if record.temp_c is None else record.temp_c


def _lying(count: int) -> Motion:
    """Return a device that lies for so many seconds, at 1 Hz."""
    zero = np.zeros((count, 3))
    return Motion(
        time=np.arange(count) * 1.0, q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), rate_b=zero, mean_rate_b=zero,
        force_b=np.tile([0.0, 0.0, STANDARD_GRAVITY], (count, 1)), gravity_m_s2=STANDARD_GRAVITY, moving=np.zeros(count),
    )  # fmt: skip
