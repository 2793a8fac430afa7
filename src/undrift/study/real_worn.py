"""A simulated device worn in captured motions: the pitch it would show, against the optics that captured them.

The device goes through ``figure3.calibrated``; the capture is what it is worn in, at a board temperature above the bench's.
Captures begin in motion or nearly so: six seconds of rest in the first pose are put before each, so that the tilt at the start
can be taken.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.frames import quaternion_conjugate, rotate
from undrift.orientation.angles import sagittal_pitch
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import fit_pose_spline
from undrift.study.case import Case, pitch_error
from undrift.study.figure3 import LEVELS, ROOM_TEMP_C, SAMPLE_RATE_HZ, SETTLED_S, calibrated
from undrift.study.real import Pairwise, agreement_of
from undrift.study.real_motion import SKIN, Capture
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

REST_S = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WornRow:
    """Pitch error in a captured motion.

    Parameters
    ----------
    trial, level : str
        Which capture, and none, static or full correction.
    error_rms_deg, error_max_deg : float
        Over the motion, deg.
    lean_optics_deg, lean_device_deg : float
        Largest pitch less the first, as the optics and the device have it, deg.
    length_s : float
        Of the motion, s.
    saturated : float
        Share of the samples in which the gyroscopes were at the end of their range.
    """

    trial: str
    level: str
    error_rms_deg: float
    error_max_deg: float
    lean_optics_deg: float
    lean_device_deg: float
    length_s: float
    saturated: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Worn:
    """Errors in captured motions and agreement over them.

    Parameters
    ----------
    rows : tuple of WornRow
        By capture, then level.
    agreement : tuple of (str, Pairwise)
        Of the largest lean, device less optics, for each level; empty with fewer than three captures.
    """

    rows: tuple[WornRow, ...]
    agreement: tuple[tuple[str, Pairwise], ...]


def worn_in(
    captures: tuple[Capture, ...],
    device: DeviceModel | None = None,
    *,
    seed: int = 0,
    excursion_k: float = 12.5,
) -> Worn:
    """Wear a device in captured motions.

    Parameters
    ----------
    captures : tuple of Capture
        Real trials.
    device : DeviceModel, optional
        The typical one of the note's kind where not given.
    seed : int
        Draws sessions and noise.
    excursion_k : float
        Board temperature above that of the bench, K.

    Returns
    -------
    Worn
        For none, static and full correction.
    """
    held = device or preset("enc03j_3031")
    levels = calibrated(held, rng=np.random.default_rng([seed, 0]))
    rows = [
        row
        for number, capture in enumerate(captures)
        for row in _rows(capture, held, levels, excursion_k, np.random.default_rng([seed, 1, number]))
    ]
    agreement = []
    for level in LEVELS:
        leans = np.array([(row.lean_device_deg, row.lean_optics_deg) for row in rows if row.level == level])
        pairwise = agreement_of("largest lean, deg", leans[:, 0], leans[:, 1]) if len(leans) else None
        if pairwise is not None:
            agreement.append((level, pairwise))
    return Worn(rows=tuple(rows), agreement=tuple(agreement))


def _rows(
    capture: Capture,
    device: DeviceModel,
    levels: tuple[Calibration, ...],
    excursion_k: float,
    rng: np.random.Generator,
) -> list[WornRow]:
    case, pitch, saturated = _case(capture, device, excursion_k, rng)
    start, stop = case.moving
    seen = pitch[start:stop] / RADIAN_PER_DEGREE
    rows = []
    for name, level in zip(LEVELS, levels, strict=True):
        error = pitch_error(case, level) / RADIAN_PER_DEGREE
        shown = case.pitch[start:stop] / RADIAN_PER_DEGREE + error
        rows.append(
            WornRow(
                trial=capture.name,
                level=name,
                error_rms_deg=float(np.sqrt(np.nanmean(error**2))),
                error_max_deg=float(np.nanmax(np.abs(error))),
                lean_optics_deg=float(np.nanmax(seen) - seen[0]),
                lean_device_deg=float(np.nanmax(shown) - shown[0]),
                length_s=(stop - start) / SAMPLE_RATE_HZ,
                saturated=saturated,
            )
        )
    return rows


def _case(
    capture: Capture, device: DeviceModel, excursion_k: float, rng: np.random.Generator
) -> tuple[Case, FloatArray, float]:
    """Return the trial, the pitch that was captured, rad, and the share of readings at the end of the range."""
    spline = fit_pose_spline(capture.device, SKIN)
    first, last = spline.pieces[0].start_s, spline.pieces[0].stop_s  # up to the first long gap
    low_pass = device.gyro.low_pass
    delay_s = 0.0 if low_pass is None else float(np.median(low_pass.group_delay_s))
    delay_s -= 0.5 / SAMPLE_RATE_HZ  # strapdown holds each reading over the step before its stamp
    time = first + np.arange(int((last - first) * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    motion = _after_rest(spline.at(time, STANDARD_GRAVITY))
    before = len(motion) - len(time)
    made = simulate_device(device, motion, rng=rng, temp_c=ROOM_TEMP_C + excursion_k, power_on_s=SETTLED_S)
    pitch = np.unwrap(sagittal_pitch(motion.q_nb))
    case = Case(
        device=device,
        record=made.record,
        pitch=np.interp(motion.time - delay_s, motion.time, pitch),
        still=(0, before - round(0.2 * SAMPLE_RATE_HZ)),
        moving=(before, len(motion)),
    )
    return case, pitch, float(made.gyro.saturated.any(axis=1).mean())


def _after_rest(motion: Motion) -> Motion:
    """Return a motion with a rest in its first pose before it."""
    count = round(REST_S * SAMPLE_RATE_HZ)
    gravity = rotate(quaternion_conjugate(motion.q_nb[:1]), np.array([0.0, 0.0, motion.gravity_m_s2]))

    def behind(rest: FloatArray, x: FloatArray) -> FloatArray:
        return np.concatenate((np.repeat(rest[:1], count, axis=0), x))

    still, step_s = np.zeros((1, 3)), 1.0 / SAMPLE_RATE_HZ
    swing = motion.angular_acceleration_b
    return Motion(
        time=np.concatenate((motion.time[0] - np.arange(count, 0, -1) * step_s, motion.time)),
        q_nb=behind(motion.q_nb, motion.q_nb),
        rate_b=behind(still, motion.rate_b),
        mean_rate_b=behind(still, motion.mean_rate_b),
        force_b=behind(gravity, motion.force_b),
        gravity_m_s2=motion.gravity_m_s2,
        moving=behind(np.zeros(1), np.ones(len(motion))),
        angular_acceleration_b=None if swing is None else behind(still, swing),
    )
