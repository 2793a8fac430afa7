"""Drift of the gyroscopes' rest offsets between start and end of a session.

Means m_r of rests at times t_r, one axis at a time::

    m_r = o + d (t_r - mean t) / T + h a_r + e_r        T from the first rest to the last, d the change over the session

by least squares; h a_r, g-sensitivity times specific force, for the directions of gravity that the poses change, where six
rests or more bear it. var e is the scatter of the rests that is left, no less than what noise within the rests makes. A change
counts where chance alone makes one as large on any of three axes in less than one session in a hundred.

Recordings have no common clock; they are taken to follow each other without pauses.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.observe import Observed, middles, piece_temperatures
from undrift.findings import Finding, Level, finding
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import AXES
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

_LEAST_RESTS = 4
_LEAST_WITH_POSES = 6
_LEAST_CHANGE = 0.5  # g, root sum of squares over the rests: poses that differ less show no g-sensitivity
_CHANCE = 0.01
_LARGE = (
    0.05 * RADIAN_PER_DEGREE
)  # rad/s: what 1 K makes of a consumer part; a mean offset is off by half of it at either end
_WARMER_C = 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestDrift:
    """Drift of the rest offsets of a session, P rests."""

    time: FloatArray  # (P,), middle of each, s
    temp_c: FloatArray  # (P,), degC; NaN where unknown
    change: FloatArray  # (3,), d, unit of the readings
    scatter: FloatArray  # (3,), variance of a rest by the residuals
    noise: FloatArray  # (3,), variance of a mean by the readings within a rest, 0 where unknown
    lever: float  # Variance of d for rests of unit variance
    free: int  # Degrees of freedom of the scatter


def rest_drift(seen: Observed) -> RestDrift | None:
    """Fit the drift of the gyroscopes' rest offsets; None where the rests are too few, or all at one time."""
    records = seen.session.records
    windows, force, kept = list[FloatArray](), list[FloatArray](), []
    for still in seen.stills:
        record, rows = records[still.recording], slice(still.start, still.stop)
        window = np.empty((0, 3)) if record.gyro is None else record.gyro[rows]
        window = window[np.isfinite(window).all(axis=1)]
        if len(window):
            accel = np.empty((0, 3)) if record.accel is None else record.accel[rows]
            accel = accel[np.isfinite(accel).all(axis=1)]
            force.append(accel.mean(axis=0) if len(accel) else np.full(3, np.nan))
            windows.append(window)
            kept.append(still)
    time, unit = middles(records, kept), records[0].accel_unit
    if not kept or np.ptp(time) <= 0.0:
        return None
    design = np.column_stack(((time - time.mean()) / np.ptp(time), np.ones(len(kept)), _poses(np.array(force), unit)))
    free = len(kept) - design.shape[1]
    if free < 1 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    gyro, inverse = np.array([window.mean(axis=0) for window in windows]), np.linalg.inv(design.T @ design)
    theta = inverse @ design.T @ gyro
    noise = noise_of_means(windows, [block_size(records[still.recording].sample_rate_hz) for still in kept])
    return RestDrift(
        time=time,
        temp_c=piece_temperatures(seen.session, kept),
        change=theta[0],
        scatter=((gyro - design @ theta) ** 2).sum(axis=0) / free,
        noise=np.zeros(3) if noise is None else (noise**2).mean(axis=0),
        lever=float(inverse[0, 0]),
        free=free,
    )


def _poses(force: FloatArray, unit: str) -> FloatArray:
    """Return orthonormal columns (P, 0 to 3): specific force (P, 3) less its mean along the directions that the poses change."""
    if len(force) < _LEAST_WITH_POSES or np.isnan(force).any():
        return np.empty((len(force), 0))
    left, size, _ = np.linalg.svd(force - force.mean(axis=0), full_matrices=False)
    gravity = (
        STANDARD_GRAVITY / si_factor(unit, "accel") if is_physical(unit) else size[0]
    )  # counts may have any offset
    return np.asarray(left[:, size > _LEAST_CHANGE * gravity])


def offset_drift(seen: Observed, gain: float) -> tuple[Finding, ...]:
    """Return the finding of rest offsets that changed significantly over a session; gain in rad/s per unit of the readings."""
    from scipy.special import stdtr, stdtrit

    made = None if seen.session.kind == "thermal" else rest_drift(seen)
    if made is None or len(made.time) < _LEAST_RESTS:
        return ()
    change, dps = made.change, gain / RADIAN_PER_DEGREE
    sigma = np.sqrt(np.maximum(made.scatter, made.noise) * made.lever)
    sure = 3.0 * 2.0 * stdtr(made.free, -np.abs(change) / np.maximum(sigma, 1e-300)) < _CHANCE
    if not sure.any():
        return ()
    axis = int(np.argmax(np.where(sure, np.abs(change), 0.0)))
    values = {
        "axis": AXES[axis],
        "change_dps": change[axis] * dps,
        "uncertainty_dps": float(stdtrit(made.free, 0.975)) * sigma[axis] * dps,
        "rests": len(made.time),
        "minutes": float(np.ptp(made.time)) / 60.0,
    }
    level: Level = "warn" if abs(change[axis]) * gain > _LARGE else "info"
    first, last = made.temp_c[0], made.temp_c[-1]
    if not abs(last - first) >= _WARMER_C:  # or unknown
        return (finding("session.offset_drift", level, **values),)
    return (finding("session.offset_drift_warming", level, first_c=first, last_c=last, **values),)
