"""Static drift: soaks left out of the fit, of drawn devices whose offset differs between visits to a set-point.

Truth is the mean reading of a soak that the fit did not use, between the first and the last. It is compared with the
table at its temperature, on its branch of the loop. The uncertainty is that for a future visit, plus the noise of the
soak's rows.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.drift.observe import RestBlocks, observe_rests
from undrift.drift.offset import StaticFit, cooling, fit_static, variance_of_mean
from undrift.errors import NotObservable
from undrift.model import Calibration, Verdict
from undrift.record import Session, Still
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import Motion
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY

SCATTER_DPS = (0.0, 0.002, 0.005, 0.02)  # standard deviation from visit to visit
SOAK_ROWS = (1, 60, 600)  # at 1 Hz
POINTS = np.append(np.arange(18.0, 75.0, 5.0), 75.0)
FEW = np.linspace(POINTS[0], POINTS[-1], 6)
_HOLD_S, _RAMP_S = 400, 600  # before the rest of a soak, and between two


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield a row for each course, length of soak and scatter. One draw of devices serves all rows of a course."""
    up_and_down = np.concatenate((POINTS, POINTS[-2::-1]))
    courses = (("six soaks of an ICM-20948", FEW), ("once", POINTS), ("twice", up_and_down))
    for visits, (name, course) in enumerate(courses):
        for effects in (False, True) if visits else (False,):
            name = name + (", loop, ADC, filter" if effects else "")
            tallies = {
                (n, s): Tally("static drift", f"{name}: {n} rows, {1e3 * s:g} mdeg/s")
                for n in SOAK_ROWS
                for s in SCATTER_DPS
            }
            for number in range(devices):
                rng = np.random.default_rng((seed, visits, effects, number))
                _add_device(rng, course, effects, tallies)
            for tally in tallies.values():
                yield from tally.rows()


def _add_device(
    rng: np.random.Generator, course: FloatArray, effects: bool, tallies: dict[tuple[int, float], Tally]
) -> None:
    device = random_device(rng, grade="icm20948" if course is FEW else "enc03j_3031")
    disabled = {} if effects else {"hysteresis": None, "adc": None, "low_pass": None}
    device = replace(
        device, gyro=replace(device.gyro, warm_up=None, **disabled), accel=replace(device.accel, lever_arm=None)
    )
    calibration = true_calibration(device)
    if calibration.gyro is None:
        raise NotObservable("soaks: wanted gyroscopes, got none; draw another device")
    soaks = _soaks(rng, device, course)
    way = cooling(soaks[max(SOAK_ROWS)][0])
    branch = np.array([way[soaks[max(SOAK_ROWS)][1] == k].mean() for k in range(len(course))])
    inner = np.flatnonzero((course > POINTS[0]) & (course < POINTS[-1]))
    for (length, scatter_dps), tally in tallies.items():
        blocks, visit = soaks[length]
        shift = scatter_dps * DPS * rng.normal(size=(len(course), 3)) @ calibration.gyro.forward_matrix.T
        blocks = replace(blocks, gyro=blocks.gyro + shift[visit])
        out = int(rng.choice(inner))
        left_out = blocks.taken(visit == out)
        nodes = np.unique(np.append(POINTS, left_out.temp_c.mean()))
        fit = fit_static(blocks.taken(visit != out), nodes=nodes, calibration=calibration)
        _add_left_out(fit, left_out, branch[out], calibration, tally)


def _add_left_out(fit: StaticFit, left_out: RestBlocks, branch: float, calibration: Calibration, tally: Tally) -> None:
    gyro_fit = fit.gyro
    if gyro_fit is None or gyro_fit.offset is None or calibration.gyro is None:
        raise NotObservable("soaks: wanted a table of gyroscopes, got none; draw another device")
    node = int(np.abs(fit.table.temp_c - left_out.temp_c.mean()).argmin())
    noise = variance_of_mean(np.nan_to_num(left_out.gyro_variance), left_out.gyro_step_error)
    error, variance = left_out.gyro.mean(axis=0) - gyro_fit.offset[node], gyro_fit.uncertainty[node] ** 2 + noise
    if gyro_fit.hysteresis is not None and gyro_fit.hysteresis_uncertainty is not None:
        # the branch is known, so the half-width is not an uncertainty
        error = error - branch * gyro_fit.hysteresis
        variance = variance - gyro_fit.hysteresis**2 + gyro_fit.hysteresis_uncertainty**2
    per_raw = 1.0 / (DPS * calibration.gyro.scale_factor)
    judged = [item for item in fit.findings if item.code != "drift.hysteresis_unknown"]  # a course up knows none
    tally.add(Verdict.of(*judged), offset=(error * per_raw, np.sqrt(variance) * per_raw))


def _soaks(
    rng: np.random.Generator, device: DeviceModel, course: FloatArray
) -> dict[int, tuple[RestBlocks, np.ndarray[tuple[int], np.dtype[np.int64]]]]:
    """Return the rests of a course through set-points for each length of soak, and the visit of each block."""
    temp, ends, n, longest = list[FloatArray](), list[int](), 0, max(SOAK_ROWS)
    for k, point in enumerate(course):
        ramp = np.linspace(course[k - 1], point, _RAMP_S, endpoint=False) if k else np.zeros(0)
        temp += [ramp, np.full(_HOLD_S + longest, point)]
        n += len(ramp) + _HOLD_S + longest
        ends.append(n)
    true_c = np.concatenate(temp)
    record = simulate_device(device, _lying(n), rng=rng, temp_c=true_c, power_on_s=7200.0).record
    record = replace(record, accel=None)
    read_c = np.zeros(n) if record.temp_c is None else record.temp_c
    soaks = {}
    for length in SOAK_ROWS:
        stills = tuple(Still(start=end - max(length, 2), stop=end) for end in ends)
        session = Session(kind="thermal", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=stills)
        blocks = observe_rests([session], temperatures=[[read_c]])
        visit = np.searchsorted(record.time[np.array(ends) - 1], blocks.time)
        if length == 1:  # a table of single readings has no information about noise
            last = np.array(ends) - 1
            first = np.unique(visit, return_index=True)[1]
            unknown = np.full((len(last), 3), np.nan)
            blocks = replace(
                blocks.taken(first), gyro=np.array(record.gyro)[last], temp_c=read_c[last], gyro_variance=unknown,
                gyro_step_error=np.zeros_like(unknown),
            )  # fmt: skip
            visit = np.arange(len(last))
        soaks[length] = blocks, visit
    return soaks


def _lying(count: int) -> Motion:
    """Return a device that lies for so many seconds, at 1 Hz."""
    zero = np.zeros((count, 3))
    return Motion(
        time=np.arange(count) * 1.0, q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), rate_b=zero, mean_rate_b=zero,
        force_b=np.tile([0.0, 0.0, STANDARD_GRAVITY], (count, 1)), gravity_m_s2=STANDARD_GRAVITY, moving=np.zeros(count),
    )  # fmt: skip
