"""Figures: what an error over time comes to, in degrees, for a table or a person.

Root-mean-square, mean, standard deviation and largest value over the motion, medians after it, and the slope of the total
error over time. Gaps of the reference count nowhere.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.errors import OrientationError, median, rms, slope


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What one recording comes to, or a mean or median over recordings.

    Parameters
    ----------
    lag_ms : float
        How late the record's samples were, ms.
    rmse_total_deg, rmse_inclination_deg, rmse_heading_deg, rmse_pitch_deg : float
        Root-mean-square error over the motion, deg.
    mean_pitch_deg, sd_pitch_deg, max_abs_pitch_deg : float
        Mean signed, standard deviation and largest pitch error over the motion, deg, where pitch is defined; near the edge of
        that, on tumbling motion, the largest grows beyond the error in space.
    range_pitch_error_deg : float
        Range of motion in pitch less that of the reference, deg; needs less than half a turn to mean anything.
    max_total_deg : float
        Largest total error over the motion, deg.
    end_total_deg, end_inclination_deg : float
        Median error after the motion, deg; NaN where the recording ends with it.
    drift_deg_per_min : float
        Slope of the total error over the motion, deg/min.
    rmse_total_before_lag_deg, rmse_total_after_lag_deg : float
        Root-mean-square total error with the lag left in and with it undone, deg; the main figures are one of the two.
    valid_optics : float
        Share of the motion in which the reference saw the body.
    valid_optics_file : float
        Share of all its poses in which the reference saw the body, rests and ends counted.
    pitch_defined : float
        Share of the samples of the motion with an error at all in which sensor and reference have a pitch: the vertical is not
        within 5 deg of the normal of the sagittal plane.
    motion_s : float
        Length of the motion, s.
    turn_rate_rms_dps : float
        Root-mean-square body rate in motion, deg/s.
    """

    lag_ms: float
    rmse_total_deg: float
    rmse_inclination_deg: float
    rmse_heading_deg: float
    rmse_pitch_deg: float
    mean_pitch_deg: float
    sd_pitch_deg: float
    max_abs_pitch_deg: float
    range_pitch_error_deg: float
    max_total_deg: float
    end_total_deg: float
    end_inclination_deg: float
    drift_deg_per_min: float
    rmse_total_before_lag_deg: float
    rmse_total_after_lag_deg: float
    valid_optics: float
    valid_optics_file: float
    pitch_defined: float
    motion_s: float
    turn_rate_rms_dps: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretches:
    """Which samples of a reference count for what.

    Parameters
    ----------
    time : array, shape (N,)
        s, reference clock.
    moving : array, shape (N,)
        Within the motion, pauses left out where the reference marks them.
    after : array, shape (N,)
        The first seconds after the motion.
    valid : array, shape (N,)
        Seen by the reference.
    """

    time: FloatArray
    moving: BoolArray
    after: BoolArray
    valid: BoolArray


def figures_of(
    error: OrientationError, pitches: tuple[FloatArray, FloatArray], stretches: Stretches, *, lag_s: float
) -> Figures:
    """Sum up one recording.

    Parameters
    ----------
    error : OrientationError
        At the reference's samples.
    pitches : tuple of two arrays, shape (N,)
        Sagittal pitch of sensor and reference, rad.
    stretches : Stretches
        Which samples count.
    lag_s : float
        Lag of the record, s.

    Returns
    -------
    Figures
        With the two figures around the lag, the length of the motion and its rate still NaN.
    """
    m = stretches.moving
    pitch = error.pitch[m][np.isfinite(error.pitch[m])]
    both = m & np.isfinite(pitches[0]) & np.isfinite(pitches[1])
    nothing = float("nan")
    total = error.total[m][np.isfinite(error.total[m])]
    return Figures(
        lag_ms=lag_s * 1e3,
        rmse_total_deg=degrees(rms(total)),
        rmse_inclination_deg=degrees(rms(error.inclination[m])),
        rmse_heading_deg=degrees(rms(error.heading[m])),
        rmse_pitch_deg=degrees(rms(pitch)),
        mean_pitch_deg=degrees(float(pitch.mean())) if len(pitch) else nothing,
        sd_pitch_deg=degrees(float(pitch.std())) if len(pitch) else nothing,
        max_abs_pitch_deg=degrees(float(np.abs(pitch).max())) if len(pitch) else nothing,
        range_pitch_error_deg=degrees(float(np.ptp(pitches[0][both]) - np.ptp(pitches[1][both])))
        if both.any()
        else nothing,
        max_total_deg=degrees(float(total.max())) if len(total) else nothing,
        end_total_deg=degrees(median(error.total[stretches.after])),
        end_inclination_deg=degrees(median(error.inclination[stretches.after])),
        drift_deg_per_min=degrees(60.0 * slope(stretches.time, error.total, m)),
        rmse_total_before_lag_deg=nothing,
        rmse_total_after_lag_deg=nothing,
        pitch_defined=len(pitch) / len(total) if len(total) else nothing,
        valid_optics=float(stretches.valid[m].mean()) if m.any() else 0.0,
        valid_optics_file=float(stretches.valid.mean()),
        motion_s=nothing,
        turn_rate_rms_dps=nothing,
    )


def degrees(angle: float) -> float:
    """Return an angle in degrees.

    Parameters
    ----------
    angle : float
        rad.

    Returns
    -------
    float
        deg.
    """
    return angle / RADIAN_PER_DEGREE
