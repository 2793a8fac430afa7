"""Trials: many devices in many motions, corrected by many calibrations, for the error of the sagittal pitch alone.

A trial is what ``simulate_device``, ``correct`` and ``integrate_strapdown`` make of it one after the other, in one kernel that
keeps no array in between. The kernel knows these effects: scale, offset over temperature, thermal scale, rate drift, white
noise, random walk, rails, low-pass, converter, and a thermometer with lag and self-heating; ``trial_device`` switches off the
others. Noise comes from counters: number j of a trial is a hash of (seed, effect, trial, sample), whatever the batch, the order
and the number of threads.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.model import Calibration
from undrift.drift.plan import plan_triad
from undrift.errors import InputError
from undrift.orientation.angles import sagittal_pitch
from undrift.session import Face
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.low_pass import difference_equation
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.motion import Motion

UNKNOWN = ("nonlinearity", "g_sensitivity", "warm_up", "hysteresis", "instability", "lever_arm")
WORD = 2**64 - 1


class Trial(NamedTuple):
    """One trial: which motion, device and calibration, by their places in the bench.

    Parameters
    ----------
    motion, device, calibration : int
        Places.
    number : int
        Names the trial's noise: the same number, the same noise.
    temp_c : float
        Temperature of the board at the first sample, degC.
    warming_k_per_s : float
        Its slope, K/s.
    """

    motion: int
    device: int
    calibration: int
    number: int
    temp_c: float = 25.0
    warming_k_per_s: float = 0.0


class TrialErrors(NamedTuple):
    """Errors of a batch of trials, in their order.

    Parameters
    ----------
    number : array, shape (B,)
        Of the trials.
    rms, maximum : array, shape (B,)
        Of the pitch error, rad; NaN where the pitch was lost.
    """

    number: IntArray
    rms: FloatArray
    maximum: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSettings:
    """How trials are run.

    Parameters
    ----------
    forward, up : str
        Device axes that point forward and up in an upright segment.
    seed : int
        Of the noise.
    batch : int
        Trials whose errors come out together.
    threads : int
        Of the processor. The bits of the result depend neither on it nor on the batch.
    power_on_s : float
        Time since power-on at the first sample, s.
    """

    forward: Face = "+x"
    up: Face = "+z"
    seed: int = 0
    batch: int = 256
    threads: int = 1
    power_on_s: float = 0.0


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


def trial_device(device: DeviceModel) -> DeviceModel:
    """Return a device with those effects alone that the kernel of trials knows.

    Parameters
    ----------
    device : DeviceModel
        Any device.

    Returns
    -------
    DeviceModel
        Without non-linearity, g-sensitivity, warm-up, hysteresis, flicker, lever arm and noise of the thermometer.
    """
    return replace(
        device,
        gyro=replace(
            device.gyro,
            nonlinearity=None,
            g_sensitivity=None,
            warm_up=None,
            hysteresis=None,
            instability=None,
            lever_arm=None,
        ),
        thermometer=replace(device.thermometer, noise_c=0.0),
    )


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
        np.array([_device(device, step_s) for device in devices]),
        lacking,
        np.array(made),
        np.concatenate(table),
    )


def run_trials(bench: TrialBench, trials: Iterable[Trial]) -> Iterator[TrialErrors]:
    """Run trials and hand out their errors batch by batch; memory does not grow with their number.

    Parameters
    ----------
    bench : TrialBench
        What they are made of.
    trials : iterable of Trial
        May be a generator.

    Yields
    ------
    TrialErrors
        Of the next ``settings.batch`` trials.
    """
    from concurrent.futures import ThreadPoolExecutor

    from undrift.kernels.trial import LANES

    threads, stream = bench.settings.threads, iter(trials)
    with ThreadPoolExecutor(threads) as pool:
        while batch := list(islice(stream, bench.settings.batch)):
            groups = [batch[i : i + LANES] for i in range(0, len(batch), LANES)]
            if threads == 1:
                errors = [_run(bench, group) for group in groups]
            else:
                errors = list(pool.map(lambda group: _run(bench, group), groups))
            found = np.concatenate(errors, axis=1)
            yield TrialErrors(np.array([trial.number for trial in batch]), found[0], found[1])


def trial_noise(seed: int, number: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """Return the normal numbers that a trial draws: what the twin of the kernel takes in place of its own.

    Parameters
    ----------
    seed : int
        Of the settings.
    number : int
        Of the trial.
    samples : int
        N.

    Returns
    -------
    white, walk : array, shape (N, 3)
        Unit variance.
    """
    from undrift.kernels.trial import LANES, NOISE_1, NOISE_2, SIZE, WIDE, normals

    key, out = _keys(seed, [number] * LANES), np.empty(SIZE)
    z = np.empty(3 * WIDE, dtype=np.uint64)
    found = np.empty((2, samples, 3))
    for k in range(samples):
        normals(key, np.uint64(k), z, z.view(np.float64), out, NOISE_1, NOISE_2)
        for i, at in enumerate((int(NOISE_1), int(NOISE_2))):
            found[i, k] = out[at : at + WIDE : LANES]
    return found[0], found[1]


def _run(bench: TrialBench, group: list[Trial]) -> FloatArray:
    """Return RMS and greatest error of at most 32 trials, shape (2, B)."""
    from undrift.kernels.trial import LANES
    from undrift.kernels.trial import trials as kernel

    lanes = group + group[-1:] * (LANES - len(group))
    motion, device, calibration = (np.array([trial[i] for trial in lanes]) for i in range(3))
    columns = bench.devices[device]
    columns[:, MATRIX] = bench.calibrations[calibration][:, :9]
    columns[:, ZERO] = bench.calibrations[calibration][:, 9:12]
    columns[:, START] = bench.calibrations[calibration][:, 12:]
    columns[:, TEMP] = [trial.temp_c for trial in lanes]
    columns[:, TEMP + 1] = [trial.warming_k_per_s * bench.step_s for trial in lanes]
    start = np.concatenate((bench.start[motion].T.ravel(), bench.lacking[device]))
    forward, up = _unit(bench.settings.forward), _unit(bench.settings.up)
    out = np.empty(2 * LANES)
    kernel(
        bench.rows,
        bench.first[motion].astype(np.int64),
        bench.length[motion].astype(np.float64),
        np.ascontiguousarray(columns.T).ravel(),
        _keys(bench.settings.seed, [trial.number for trial in lanes]),
        start,
        bench.table,
        np.concatenate((forward, up)),
        bench.step_s,
        bool(columns[:, NOISE].any()),
        out,
    )
    return out.reshape(2, LANES)[:, : len(group)]


# Columns of a trial's parameters, three to a field, in the order of kernels/trial.py.
NOISE, MATRIX, ZERO, TEMP, START = slice(30, 36), slice(81, 90), slice(90, 93), 93, slice(105, 109)


def _device(device: DeviceModel, step_s: float) -> FloatArray:
    """Return the 111 parameters of a device, those of trial and correction left at zero."""
    chain, clock, thermometer = device.gyro, device.sampling, device.thermometer
    for name in UNKNOWN:
        if getattr(chain, name) is not None:
            raise InputError(
                f"trials: wanted effects that the kernel knows, got {name}; use trial_device or simulate_device"
            )
    if not clock.on_grid or thermometer.noise_c > 0.0 or thermometer.rounding != "nearest":
        raise InputError(
            "trials: wanted readings at the samples of the motion and a thermometer without noise that rounds to nearest, got "
            "others; use simulate_device"
        )
    p = np.zeros((37, 3))
    p[:4] = _thermal(chain)
    p[4:10] = _rate_drift(chain)
    p[10] = chain.white_noise.random_walk / math.sqrt(step_s) if chain.white_noise else 0.0
    p[11] = chain.random_walk.bias_walk * math.sqrt(step_s) if chain.random_walk else 0.0
    p[12:14] = _rails(chain)
    p[14] = 1.0
    if chain.low_pass:
        for axis in range(3):
            b, a = difference_equation(
                float(chain.low_pass.cutoff_hz[axis]), float(chain.low_pass.quality[axis]), step_s
            )
            p[14:19, axis] = *b, *a[1:]
    p[19:24] = _converter(chain)
    p[24:27] = chain.scale.matrix
    p[31, 2] = device.reference_temp_c
    p[32:35] = _thermometer(device, step_s)
    return p.ravel()


def _thermal(chain: SensorChain) -> FloatArray:
    found = np.zeros((4, 3))
    offset = chain.offset.per_k if chain.offset else np.zeros((0, 3))
    scale = chain.thermal_scale.per_k if chain.thermal_scale else np.zeros((0, 3))
    if len(offset) > 2 or len(scale) > 1:
        raise InputError(
            f"trials: wanted an offset of at most 2 powers of temperature and a scale of 1, got {len(offset)} and {len(scale)}; "
            "use simulate_device"
        )
    if chain.offset:
        found[0] = chain.offset.constant
    found[1 : 1 + len(offset)], found[3 : 3 + len(scale)] = offset, scale
    return found


def _rate_drift(chain: SensorChain) -> FloatArray:
    found = np.zeros((3, 2, 3))
    if chain.rate_drift:
        powers = chain.rate_drift.coefficients
        if powers.shape[0] > 3 or powers.shape[1] > 2:
            raise InputError(
                f"trials: wanted a rate drift of at most 3 powers of rate and 2 of warmth, got {powers.shape[:2]}; "
                "use simulate_device"
            )
        found[: powers.shape[0], : powers.shape[1]] = powers
    return found.reshape(6, 3)


def _rails(chain: SensorChain) -> FloatArray:
    amplifier = chain.amplifier
    if amplifier is None:
        return np.array([[-math.inf], [math.inf]])
    total = amplifier.gain * chain.scale.nominal_sensitivity
    return np.array([[(amplifier.low - amplifier.null) / total], [(amplifier.high - amplifier.null) / total]])


def _converter(chain: SensorChain) -> FloatArray:
    """Return gain and null in steps, the codes' limits, and how it rounds: 0 not, 1 to nearest, 2 down. One step is 1 code."""
    sensitivity = chain.scale.nominal_sensitivity * (chain.amplifier.gain if chain.amplifier else 1.0)
    null = chain.amplifier.null if chain.amplifier else 0.0
    if chain.adc is None:
        return np.array([[sensitivity], [null], [-math.inf], [math.inf], [0.0]])
    if chain.adc.rounding == "toward_zero" or chain.adc.inl_lsb.any() or not chain.adc.codes:
        raise InputError(
            "trials: wanted a straight converter that gives codes, to nearest or down, got another; use simulate_device"
        )
    step, (low, high) = chain.adc.step, chain.adc.code_limits
    how = 1.0 if chain.adc.rounding == "nearest" else 2.0
    return np.array([[sensitivity / step], [null / step], [low], [high], [how]])


def _thermometer(device: DeviceModel, step_s: float) -> FloatArray:
    t = device.thermometer
    keep, mean = 0.0, 0.0
    if t.lag_s > 0.0:
        keep = math.exp(-step_s / t.lag_s)
        mean = -math.expm1(-step_s / t.lag_s) / (step_s / t.lag_s)
    inverse = 1.0 / t.step_c if t.step_c > 0.0 else 0.0
    return np.array(
        [
            [keep, 1.0 - mean, mean - keep],
            [t.self_heating_c, t.trim_error_c, t.slope_error],
            [t.step_c, inverse, t.zero_c],
        ]
    )


def _calibration(calibration: Calibration, unit: str, table: list[FloatArray]) -> FloatArray:
    """Return matrix, offset, start, inverse step, cells and place of the table; the table's cells go to the end of the list."""
    plan = plan_triad(calibration, "rate", unit)
    tables = plan.tables
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


def _unit(face: Face) -> FloatArray:
    axis = np.zeros(3)
    axis["xyz".index(face[1])] = 1.0 if face[0] == "+" else -1.0
    return axis


def _keys(seed: int, numbers: Sequence[int]) -> NDArray[np.uint64]:
    """Return one key per axis and lane: a hash of seed, effect and trial."""
    words = np.array([1, 2, 3, *(number & WORD for number in numbers), seed & WORD], dtype=np.uint64)
    mixed = _mixed(words)
    effects = _mixed(mixed[-1:] ^ mixed[:3])
    return _mixed(effects[:, None] ^ mixed[3:-1]).ravel()


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Finish of splitmix64."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
