"""Bench: motions, devices and calibrations made ready once, for any number of trials."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.model import Calibration
from undrift.drift.lookup.plan import plan_triad
from undrift.errors import InputError
from undrift.orientation.angles import sagittal_pitch
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import Motion
from undrift.trial.device import device_parameters
from undrift.trial.values import TrialSettings


@dataclass(frozen=True, slots=True, eq=False)
class TrialBench:
    """Motions, devices and calibrations made ready for the kernel; see ``trial_bench``.

    Parameters
    ----------
    settings : TrialSettings
        As given.
    step_s : float
        Sample period, s.
    rows : array
        Motions, flat.
    first, length : array, shape (motions,)
        Their rows.
    start : array, shape (motions, 4)
        First orientation, w-x-y-z.
    devices : array, shape (devices, F)
        Parameters of the devices, a column each.
    lacking : array, shape (devices,)
        What the self-heating lacks at the first sample, relative.
    calibrations : array, shape (calibrations, G)
        The same of the corrections.
    table : array
        Offset tables, flat.
    """

    settings: TrialSettings
    step_s: float
    rows: FloatArray
    first: IntArray
    length: IntArray
    start: FloatArray
    devices: FloatArray
    lacking: FloatArray
    calibrations: FloatArray
    table: FloatArray


def trial_bench(
    motions: Sequence[Motion],
    devices: Sequence[DeviceModel],
    calibrations: Sequence[Calibration],
    settings: TrialSettings = TrialSettings(),
) -> TrialBench:
    """Make motions, devices and calibrations ready.

    Parameters
    ----------
    motions : sequence of Motion
        All at one sample rate, evenly sampled, without gaps.
    devices : sequence of DeviceModel
        Effects that the kernel knows; see ``trial_device``. All with the same averaging of the gyroscopes.
    calibrations : sequence of Calibration
        Matrix, offset and table of offsets of the gyroscopes, in the unit of the devices' readings.
    settings : TrialSettings
        Axes, seed, threads.

    Returns
    -------
    TrialBench
        Good for any number of runs.

    Raises
    ------
    InputError
        Motions of several sample rates or with gaps; an effect or a correction that the kernel does not know.
    """
    step_s = _common_step(motions)
    averaging = {device.sampling.gyro_averaging for device in devices}
    if len(averaging) != 1:
        raise InputError(
            f"trials: wanted devices of one way of averaging, got {len(averaging)}; run those of each apart"
        )
    means = "interval" in averaging
    rows = [_rows(motion, settings, means=means) for motion in motions]
    units = {device.gyro.unit for device in devices}
    if len(units) != 1:
        raise InputError(
            f"trials: wanted devices with one unit of the readings, got {', '.join(sorted(units))}; run apart"
        )
    table: list[FloatArray] = [np.zeros(6)]
    made = [_calibration(calibration, next(iter(units)), table) for calibration in calibrations]
    length = np.array([len(motion) for motion in motions])
    lags = np.array([device.thermometer.lag_s for device in devices])
    with np.errstate(divide="ignore", invalid="ignore"):
        lacking = np.where(lags > 0.0, np.exp(-settings.power_on_s / lags), 0.0)
    return TrialBench(
        settings,
        step_s,
        np.concatenate(rows),
        5 * (np.cumsum(length) - length),
        length,
        np.array([motion.q_nb[0] for motion in motions]),
        np.array([device_parameters(device, step_s) for device in devices]),
        lacking,
        np.array(made),
        np.concatenate(table),
    )


def _calibration(calibration: Calibration, unit: str, table: list[FloatArray]) -> FloatArray:
    """Return matrix, offset, start, inverse step, cells and place of the table; the table's cells go to the end of the list."""
    plan = plan_triad(calibration, "rate", unit)
    tables = plan.tables
    lag_s = calibration.drift.lag_s if calibration.drift else 0.0
    if plan.warm_up is not None or lag_s > 0.0:
        got = (
            "a warm-up over time since power-on" if plan.warm_up is not None else f"a thermometer's lag of {lag_s:g} s"
        )
        raise InputError(
            f"trials: wanted a correction by temperature as it is read, got {got}; use correct", lag_s=lag_s
        )
    if plan.g_sensitivity is not None or plan.half_step.any() or (tables and (tables.matrix.size or tables.error.size)):
        raise InputError(
            "trials: wanted a correction by matrix, offset and table of offsets, got g-sensitivity, codes cut toward zero or "
            "another table; use correct"
        )
    grid, place = np.zeros(3), 0
    if tables:
        if tables.offset_temp.inverse == 0.0:
            raise InputError(
                "trials: wanted evenly spaced temperatures in the table of offsets, got uneven ones; resample it"
            )
        place = sum(len(cells) for cells in table)
        table.append(tables.offset)
        grid[:] = tables.offset_temp.start, tables.offset_temp.inverse, tables.offset_temp.cells
    return np.concatenate((plan.matrix, plan.offset, grid, [place]))


def _common_step(motions: Sequence[Motion]) -> float:
    steps = [np.diff(motion.time) for motion in motions]
    step_s = float((motions[0].time[-1] - motions[0].time[0]) / (len(motions[0]) - 1))
    if any(np.abs(s - step_s).max() > 1e-6 * step_s for s in steps):
        raise InputError("trials: wanted motions with one even sample period, got several; make them on one grid")
    if any((motion.valid == 0.0).any() for motion in motions):
        raise InputError("trials: wanted motions that are known throughout, got gaps; cut them out")
    return step_s


def _rows(motion: Motion, settings: TrialSettings, *, means: bool) -> FloatArray:
    pitch = sagittal_pitch(motion.q_nb, forward=settings.forward, up=settings.up)
    rate = motion.mean_rate_b if means else motion.rate_b
    return np.column_stack((rate, np.cos(pitch), np.sin(pitch))).ravel()
