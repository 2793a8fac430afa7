"""Fit to references on an imperfect bench: markers put on again, cameras with noise and slow errors, sensors with all
effects.

The mounting of each recording is drawn and not known, so scale and cross-axis terms are compared as M'M, which no
rotation changes. The true offset of the accelerometers is the mean over the recording, including flicker. The
gyroscopes' offset applies to these recordings in motion, with g-sensitivity and the offset of that day. It is not a
constant of the device and is not compared. ``benchmarks.broad`` judges its effect on errors in degrees.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.erring_bench import Row, Tally, chain_that_errs, drawn_slope, even_rise, times, tripled
from undrift.arrays import FloatArray
from undrift.calibration.reference import CODE_PRIOR, MOVING_PRIOR, fit_reference
from undrift.calibration.reference_accel import fit_reference_accel
from undrift.errors import NotObservable
from undrift.fit.priors import REFERENCE_LEVEL
from undrift.fit.triad import TriadFit
from undrift.frames import quaternion_of, quaternion_product
from undrift.model import AdcModel, TriadModel
from undrift.record import Record, Reference
from undrift.segments import find_turning
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task, with_six_rests
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

RATE_HZ = 100.0
RANGE = {"gyro": 500.0 * RADIAN_PER_DEGREE, "accel": 4.0 * STANDARD_GRAVITY}
FLICKER = {"gyro": 8.0 / 3600.0 * RADIAN_PER_DEGREE, "accel": 5e-5 * STANDARD_GRAVITY}
SLOW_SD, SLOW_S = 0.05 * RADIAN_PER_DEGREE, 5.0  # poses: error about each axis, rad, and how long it lasts, s
CREEP_C, JITTER_S = 1.0, 1e-3


@dataclass(frozen=True)
class Case:
    """One bench."""

    grade: str
    optics: OpticsSettings
    tripled: str = ""  # source at three times its size: creep, codes, flicker, slow, level, noise or mounting
    errs: bool = False  # 12 bit, flicker, creep, time stamps that jitter, slow errors and a common tilt of the poses


STATED = Case("consumer", OpticsSettings(angle_sd=1e-3, mount_sd=9e-3), errs=True)
CASES = {
    "industrial part, cameras 0.02 deg": Case("industrial", OpticsSettings()),
    "consumer part, 0.06 deg, mounting 0.5 deg": Case("consumer", OpticsSettings(angle_sd=1e-3, mount_sd=9e-3)),
    "the same with all errors": STATED,
    **tripled(STATED, ("creep", "codes", "flicker", "slow", "level", "noise", "mounting")),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of the gyroscopes and of the accelerometers."""
    for name in CASES:
        yield from rows_of(name, devices, seed)
    yield from moving_rows(devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of a bench."""
    case, rng = CASES[name], np.random.default_rng(seed)
    gyro, accel = (Tally(f"reference, {triad}", name) for triad in ("gyroscope", "accelerometer"))
    for _ in range(devices):
        device = random_device(rng, grade=case.grade)
        device = _erring(device, rng, case) if case.errs else device
        fits = _fits(device, rng, case)
        truth = true_calibration(device)
        groups = _groups(fits[0], truth.gyro, np.zeros(3))
        gyro.add(fits[0].verdict, **{group: groups[group] for group in ("scale", "cross-axis")})
        if fits[1] is not None:
            accel.add(fits[1].verdict, **_groups(fits[1], truth.accel, fits[2]))
    yield from gyro.rows()
    yield from accel.rows()


def moving_rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of the change to motion d and of what codes lose, c, both drawn from their priors.

    Without g-sensitivity and creep, which change the offset from rest to motion in their own way: they are d of these recordings.
    """
    for bits in (12, 15):
        rng, tally = (
            np.random.default_rng(seed),
            Tally("reference, motion and codes", f"consumer part, {bits} bits cut off"),
        )
        case = CASES["consumer part, 0.06 deg, mounting 0.5 deg"]
        lsb = 2.0 * RANGE["gyro"] / 2**bits
        for _ in range(devices):
            device = random_device(rng, grade=case.grade)
            device = replace(device, gyro=replace(device.gyro, g_sensitivity=None))
            true, change = true_calibration(device).gyro, MOVING_PRIOR * rng.standard_normal(3)
            lost = lsb * (0.5 + CODE_PRIOR * rng.standard_normal(3))
            pairs = [_seen(device, rng, case)[:2] for _ in range(3)]
            records = [_moved(record, true, change, (lsb, lost)) for record, _ in pairs]
            adc = AdcModel(gyro_lsb=np.full(3, lsb), gyro_rounding="toward_zero")
            fit = fit_reference(records, [p[1] for p in pairs], adc=adc).triad
            left_vectors, _, right = np.linalg.svd(fit.model.matrix @ true.forward_matrix)  # the mean mounting turns d
            sigma = fit.model.standard_uncertainty
            moving, codes = fit.model.moving_offset - left_vectors @ right @ change, fit.model.code_offset - lost
            tally.add(fit.verdict, moving=(moving, sigma[12:15]), codes=(codes, sigma[15:]))
        yield from tally.rows()


def _moved(record: Record, true: TriadModel, change: FloatArray, code: tuple[float, FloatArray]) -> Record:
    """Return readings with a change of the offset while the device turns, as codes cut off toward zero that lose more or less."""
    (lsb, lost), gyro = code, np.asarray(record.gyro)
    turning = find_turning((gyro - true.offset) @ true.matrix.T, record.time)[0]
    codes = np.trunc((gyro + turning[:, None] * (true.forward_matrix @ change)) / lsb)
    return replace(record, gyro=codes * lsb - np.sign(codes) * (lost - 0.5 * lsb))


def _erring(device: DeviceModel, rng: np.random.Generator, case: Case) -> DeviceModel:
    codes, flicker = times(case, "codes"), times(case, "flicker")
    gyro, accel = (
        chain_that_errs(
            chain, bits=12, span=codes * RANGE[kind], flicker=flicker * FLICKER[kind], thermal_scale=drawn_slope(rng)
        )
        for kind, chain in (("gyro", device.gyro), ("accel", device.accel))
    )
    return replace(device, gyro=gyro, accel=accel)


def _seen(
    device: DeviceModel, rng: np.random.Generator, case: Case, *, six_rests: bool = False
) -> tuple[Record, Reference, FloatArray]:
    """Return a recording, the camera poses, and the mean flicker (3,) of the accelerometers in it, raw unit."""
    from scipy.signal import lfilter

    task = draw_task("free", rng=rng)
    task = with_six_rests(task) if six_rests else task
    motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
    temp_c = even_rise(CREEP_C * case.errs * times(case, "creep"), len(motion))
    simulated = simulate_device(device, motion, rng=rng, temp_c=temp_c)
    record, flicker = simulated.record, device.accel.gain * simulated.accel.of("instability").mean(axis=0)
    optics = replace(
        case.optics,
        angle_sd=case.optics.angle_sd * times(case, "noise"),
        mount_sd=case.optics.mount_sd * times(case, "mounting"),
    )
    reference = see(task, rng=rng, settings=optics)
    if not case.errs:
        return record, reference, flicker
    correlation = np.exp(-1.0 / (SLOW_S * case.optics.sample_rate_hz))
    slow_error = SLOW_SD * times(case, "slow") * rng.standard_normal((len(reference), 3))
    slow_error[1:] *= np.sqrt(1.0 - correlation**2)
    off = lfilter([1.0], [1.0, -correlation], slow_error, axis=0)
    record = replace(record, time=record.time + JITTER_S * rng.standard_normal(len(record)))
    level = REFERENCE_LEVEL * times(case, "level")
    tilt = quaternion_of(np.append(level * rng.standard_normal(2), 0.0))
    q_nb = quaternion_product(tilt, quaternion_product(reference.q_nb, quaternion_of(off)))
    return record, replace(reference, q_nb=q_nb), flicker


def _fits(device: DeviceModel, rng: np.random.Generator, case: Case) -> tuple[TriadFit, TriadFit | None, FloatArray]:
    """Return the gyroscopes from three recordings, the accelerometers from one with rests on six sides, and its mean
    flicker.

    If errors hide some of the rests, the fit of the accelerometers is refused, and n of their rows is smaller.
    """
    gyro = fit_reference(*zip(*(_seen(device, rng, case)[:2] for _ in range(3)), strict=True)).triad
    *pair, flicker = _seen(device, rng, case, six_rests=True)
    fit = fit_reference(*([item] for item in pair))
    alone = {"mountings": fit.mountings, "gravity_m_s2": STANDARD_GRAVITY, "lags_s": fit.lags_s}
    try:
        return gyro, fit_reference_accel(*([item] for item in pair), **alone), flicker
    except NotObservable:
        return gyro, None, flicker


def _groups(fit: TriadFit, true: TriadModel, shift: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return errors and standard deviations of M'M, relative, and of the offset moved by a shift (3,), in units of the output."""
    matrix, size = fit.model.matrix, float(np.linalg.norm(true.matrix, 2))
    element = np.eye(9).reshape(9, 3, 3)
    change = (np.swapaxes(element, 1, 2) @ matrix + matrix.T @ element).reshape(9, 9).T / size**2
    sigma = np.sqrt(np.diag(change @ fit.model.covariance[:9, :9] @ change.T)).reshape(3, 3)
    error = (matrix.T @ matrix - true.matrix.T @ true.matrix) / size**2
    upper = np.triu_indices(3, 1)
    offset = size * (fit.model.offset - true.offset - shift)
    return {
        "scale": (np.diag(error) / 2.0, np.diag(sigma) / 2.0),
        "cross-axis": (error[upper], sigma[upper]),
        "offset": (offset, size * fit.model.standard_uncertainty[9:12]),
    }
