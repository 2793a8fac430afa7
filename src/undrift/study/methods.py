"""Compare the methods of undrift and the note's rivals on the same devices and trials.

The rivals use short motions, one assumed instrument error each, and the fits of undrift::

    data sheet        no recording, but nominal sensitivities and zero-rate outputs
    inclined plane    stills at nominal angles about each axis, and a least-squares fit of the accelerometers to the nominal force
    trolley, piston   a sinusoid with nominal frequency and stroke along each axis, and the same fit of the accelerometers
    optics            a minute of turns by hand and six rests in front of optics, and a fit to the references
    robot arm         as with optics, with an arm whose poses are known

If a rival can calibrate only one triad, the other triad uses the data sheet and the offset of a rest. The error of the tilt depends
only on the accelerometers. According to the note, a static calibration is as good as a dynamic one.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate_to_references
from undrift.errors import AlignmentError, CalibrationError, NotObservable
from undrift.fit.gls import solve_inverse
from undrift.fit.triad import first_matrix, fit_of, parameters_of
from undrift.model import Calibration, TriadModel
from undrift.record import Record, Reference
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import grade_of
from undrift.sim.device.simulate import draw_streams, simulate_device
from undrift.sim.device.truth import nominal_calibration, true_calibration
from undrift.sim.motion.poses import OpticsSettings, disturbed
from undrift.study.case import pitch_errors_deg, stream
from undrift.study.plan import NOTE_BENCH, Study
from undrift.study.run import StudyDevice
from undrift.study.sessions import ROOM_TEMP_C, SESSIONS, SETTLED_S, free_motion
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.agreement import mean_interval

Rival = Literal["data sheet", "inclined plane", "trolley", "piston", "optics", "robot arm"]
RIVALS: tuple[Rival, ...] = get_args(Rival)
OWN = ("hand", "free poses", "motion", "three rates", "note rates")  # sessions of undrift at room temperature
INSTRUMENTS: dict[Rival, str] = {
    "data sheet": "none", "inclined plane": "plane with inclinometer", "trolley": "rail with crank drive",
    "piston": "servohydraulic piston", "optics": "optical motion capture", "robot arm": "robot arm",
}  # fmt: skip
MINUTES: dict[Rival, float] = {
    "data sheet": 0.0, "inclined plane": 6.0, "trolley": 3.0, "piston": 3.0, "optics": 4.0, "robot arm": 4.0,
}  # fmt: skip
# Error of each instrument, all assumed: a digital inclinometer, a crank set with a ruler (1 mm of 150), a transducer of
# class 0.5, a flexible cluster of markers, and an arm that repeats within 0.05 mm and bends with its pose.
PLANE_ANGLE, TROLLEY_STROKE, PISTON_STROKE = 0.05 * RADIAN_PER_DEGREE, 0.01, 0.005
POSES = {
    "optics": OpticsSettings(slow_sd=0.05 * RADIAN_PER_DEGREE),
    "robot arm": OpticsSettings(angle_sd=5e-5, position_sd=5e-5, slow_sd=0.01 * RADIAN_PER_DEGREE),
}
RATE_HZ = 100.0
STILL_S = 2.0
SINUSOID_S = 10.0
BLOCK, BLOCK_AT_REST = 10, 100  # number of samples that are averaged


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodRow:
    """One method over all devices."""

    method: str
    minutes: float
    instruments: str
    triads: str  # triads that the method calibrates
    error_deg: tuple[float, ...]  # mean rms error of the pitch in each task
    interval_deg: tuple[tuple[float, float], ...]  # 95 %
    tilt_deg: float  # rms error of the tilt at rest from the accelerometers, over 26 directions
    failed: int  # number of devices that the method could not calibrate


# ---- motions of the rivals: true and nominal specific force in the frame of the case


def _known_forces(rival: Rival, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return true and nominal specific force (N, 3), m/s2, of a device that is mounted once per axis."""
    true, reference = list[FloatArray](), list[FloatArray]()
    for axis in range(3):
        mount = rng.normal(0.0, NOTE_BENCH.errors.mount_tilt, 3)
        up, along = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
        if rival == "inclined plane":
            for angle in np.radians(np.arange(-90.0, 91.0, 15.0)):
                lain = angle + rng.normal(0.0, PLANE_ANGLE)
                shape = np.ones((round(STILL_S * RATE_HZ), 1))
                reference.append(shape * STANDARD_GRAVITY * (np.cos(angle) * up + np.sin(angle) * along))
                actual = STANDARD_GRAVITY * (np.cos(lain) * up + np.sin(lain) * along)
                true.append(shape * (actual + np.cross(mount, actual)))
            continue
        frequency_hz, stroke, error = (0.8, 0.15, TROLLEY_STROKE) if rival == "trolley" else (4.0, 0.02, PISTON_STROKE)
        time = np.arange(round(SINUSOID_S * RATE_HZ)) / RATE_HZ
        swing = -stroke * (2.0 * np.pi * frequency_hz) ** 2 * np.sin(2.0 * np.pi * frequency_hz * time)[:, None]
        way = along if rival == "trolley" else up
        reference.append(STANDARD_GRAVITY * up + swing * way)
        actual = STANDARD_GRAVITY * up + (1.0 + rng.normal(0.0, error)) * swing * way
        true.append(actual + np.cross(mount, actual))
    return np.concatenate(true), np.concatenate(reference)


def _by_known_forces(
    rival: Rival, device: DeviceModel, kind: str, streams: Callable[[str], np.random.Generator]
) -> Calibration:
    """Fit the accelerometers to the nominal force by least squares. The gyroscopes use the data sheet and a rest."""
    from undrift.sim.motion.motion import Motion

    true, reference = _known_forces(rival, streams(rival))
    still = np.zeros_like(true)
    time = np.arange(len(true)) / RATE_HZ
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(true), 1))
    motion = Motion(
        time=time, gravity_m_s2=STANDARD_GRAVITY, q_nb=level, rate_b=still, mean_rate_b=still, force_b=true,
        angular_acceleration_b=still, moving=np.zeros(len(true)),
    )  # fmt: skip
    # without low-pass, because only settled readings are fitted
    settled = replace(device, accel=replace(device.accel, low_pass=None))
    record = simulate_device(
        settled, motion, rng=streams(f"{rival} noise"), temp_c=ROOM_TEMP_C, power_on_s=SETTLED_S
    ).record
    block = BLOCK_AT_REST if rival == "inclined plane" else BLOCK
    force, reading = _block_means(reference, block), _block_means(np.asarray(record.accel), block)
    matrix = first_matrix(force, reading)
    scatter = (reading @ matrix.T - force).var(axis=0).mean()
    gls = solve_inverse(reading, force, None, matrix, {"noise": np.full(force.size, scatter)})
    accel = fit_of(
        parameters_of(gls), force, -gls.residuals.reshape(-1, 3),
        method=f"known-force/{rival}", unit_in=record.accel_unit, unit_out="m/s2",
    ).model  # fmt: skip
    return replace(_data_sheet(device, kind, record), accel=accel)


def _block_means(values: FloatArray, block: int) -> FloatArray:
    """Return the means (N / block, 3) of successive blocks, which reduces the number of equations for the dense solver."""
    return np.asarray(values.reshape(-1, block, 3).mean(axis=1))


def _data_sheet(device: DeviceModel, kind: str, rest: Record | None = None) -> Calibration:
    """Return the data sheet as a calibration, with the mean rate of a rest as offset if there is one."""
    nominal = nominal_calibration(grade_of(kind))
    gyro = nominal.gyro
    if rest is not None and rest.gyro is not None and gyro is not None:
        gyro = replace(gyro, offset=np.nanmean(rest.gyro, axis=0))
    return replace(nominal, device=device.serial, gyro=gyro, reference_temp_c=ROOM_TEMP_C)


def _by_poses(
    rival: Literal["optics", "robot arm"], device: DeviceModel, streams: Callable[[str], np.random.Generator]
) -> Calibration:
    """Record a minute of turns and rests on six sides with the reference, twice, and fit the device to the poses."""
    records, references = list[Record](), list[Reference]()
    for turn in ("first", "second"):
        performed, record = free_motion(device, streams, f"{rival} {turn}", six_rests=True)
        motion = performed.at(record.time, STANDARD_GRAVITY)
        camera = draw_streams(streams(f"{rival} {turn} poses"))
        q_nb, position = disturbed(motion.q_nb, performed.position(record.time), streams=camera, settings=POSES[rival])
        records.append(record)
        references.append(Reference(time=record.time, q_nb=q_nb, position=position, moving=motion.moving))
    fitted = calibrate_to_references(records, references, mounting="one")
    if fitted.accel is None:
        raise NotObservable(f"{rival}: the rests do not determine the accelerometers.")
    return replace(fitted, reference_temp_c=ROOM_TEMP_C)


# ---- the table


def calibrate_rival(
    rival: Rival, device: DeviceModel, kind: str, streams: Callable[[str], np.random.Generator]
) -> Calibration:
    """Calibrate a device with one of the note's rivals."""
    if rival == "data sheet":
        return _data_sheet(device, kind)
    if rival in ("optics", "robot arm"):
        return _by_poses(rival, device, streams)
    return _by_known_forces(rival, device, kind, streams)


def fit_rival(rival: Rival, device: StudyDevice) -> Calibration | None:
    """Calibrate a device of a study with a rival method. Return None if the method cannot calibrate the device."""
    streams = partial(stream, device.study.seed, device.study.group, "method", device.number)
    with suppress(CalibrationError, AlignmentError):
        return calibrate_rival(rival, device.worn, device.study.device, streams)
    return None


def _one_device(study: Study, number: int) -> list[tuple[list[float], float]]:
    """Return the errors of each method in the tasks and in the tilt, deg, or NaN if the method could not calibrate the device."""
    device = StudyDevice(study, number)
    truth = true_calibration(device.worn, temp_c=ROOM_TEMP_C).accel
    own = [device.calibration(SESSIONS[method]) for method in OWN]
    fits = own + [device.recall(rival, partial(fit_rival, rival, device)) for rival in RIVALS]
    errors = np.array([pitch_errors_deg(device.cases(task)[0], fits, study.offset)[:, 0] for task in study.tasks])
    failed = np.isnan(errors).any(axis=0)  # not calibrated, or the accelerometers do not measure gravity
    tilts = [_tilt_deg(None if bad or fit is None else fit.accel, truth) for fit, bad in zip(fits, failed, strict=True)]
    return list(zip(errors.T.tolist(), tilts, strict=True))


DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])


def _tilt_deg(model: TriadModel | None, truth: TriadModel | None) -> float:
    """Return the rms angle between true and measured gravity over all directions, deg."""
    if model is None or truth is None:
        return float("nan")
    up = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    readings = STANDARD_GRAVITY * up @ np.linalg.inv(truth.matrix).T + truth.offset
    measured = (readings - model.offset) @ model.matrix.T
    angle = np.arctan2(np.linalg.norm(np.cross(measured, up), axis=1), (measured * up).sum(axis=1))
    return float(np.sqrt(np.mean(angle**2))) / RADIAN_PER_DEGREE


def compare_methods(study: Study, spread: Callable[..., Iterator[Any]] = map, units: int = 12) -> tuple[MethodRow, ...]:
    """Calibrate the same devices with every method, and compare the methods in the same trials."""
    devices = list(spread(partial(_one_device, study), range(units)))
    rows = []
    for place, method in enumerate((*OWN, *RIVALS)):
        errors = np.array([device[place][0] for device in devices])
        tilts = np.array([device[place][1] for device in devices])
        valid = np.isfinite(errors).all(axis=1)
        means = [mean_interval(column[valid]) for column in errors.T]
        session = SESSIONS.get(method)
        rows.append(
            MethodRow(
                method=method,
                minutes=session.length_min if session else MINUTES[method],  # type: ignore[index]
                instruments=session.instruments if session else INSTRUMENTS[method],  # type: ignore[index]
                triads="none" if method == "data sheet" else "both" if session or method in POSES else "accelerometers",
                error_deg=tuple(mean for mean, _ in means),
                interval_deg=tuple(interval for _, interval in means),
                tilt_deg=float(np.nanmean(tilts)) if np.isfinite(tilts).any() else float("nan"),
                failed=int((~valid).sum()),
            )
        )
    return tuple(rows)
