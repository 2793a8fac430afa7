"""Drift of the gyroscopes' rest offsets between start and end of a session.

Means m_r of rests at times t_r, one axis at a time::

    m_r = o + d (t_r - mean t) / T + h a_r + e_r        T from the first rest to the last, d the change over the session

by least squares; h a_r, g-sensitivity times specific force, for the directions of gravity that the poses change, where eight
rests or more bear it. var e is the scatter of the rests that is left, no less than what noise within the rests makes. A change
counts where chance alone makes one as large on any of three axes in less than one session in a hundred.

Recordings have no common clock; they are taken to follow each other without pauses.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.observe import Observed, piece_temperatures
from undrift.findings import Finding, Level, finding
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import AXES
from undrift.units import RADIAN_PER_DEGREE

_LEAST_RESTS = 4
_LEAST_WITH_POSES = 8
_LEAST_CHANGE = 0.5  # g, root sum of squares over the rests: poses that differ less show no g-sensitivity
_CHANCE = 0.01
_LARGE = (
    0.05 * RADIAN_PER_DEGREE
)  # rad/s: what 1 K makes of a consumer part; a mean offset is off by half of it at either end
_WARMER_C = 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Rests of a session with gyroscope readings, P of them."""

    time: FloatArray  # (P,), s
    gyro: FloatArray  # (P, 3), mean reading
    accel: FloatArray  # (P, 3), mean reading; NaN where there is none
    temp_c: FloatArray  # (P,), degC; NaN likewise
    noise: FloatArray  # (3,), usual noise of the mean gyroscope reading, zero where unknown

    @property
    def poses(self) -> FloatArray:
        """Orthonormal columns (P, 0 to 3): specific force less its mean along the directions that the poses change."""
        if len(self.time) < _LEAST_WITH_POSES or np.isnan(self.accel).any():
            return np.empty((len(self.time), 0))
        force = self.accel / np.median(np.linalg.norm(self.accel, axis=1))
        left, size, _ = np.linalg.svd(force - force.mean(axis=0), full_matrices=False)
        return np.asarray(left[:, size > _LEAST_CHANGE])


def offset_drift(seen: Observed, gain: float) -> tuple[Finding, ...]:
    """Return the finding of rest offsets that changed significantly over a session; gain in rad/s per unit of the readings."""
    from scipy.special import stdtr, stdtrit

    rests = None if seen.session.kind == "thermal" else rests_of(seen)
    if rests is None or np.ptp(rests.time) <= 0.0:
        return ()
    count, span, dps = len(rests.time), float(np.ptp(rests.time)), gain / RADIAN_PER_DEGREE
    design = np.column_stack(((rests.time - rests.time.mean()) / span, np.ones(count), rests.poses))
    free, inverse = count - design.shape[1], np.linalg.inv(design.T @ design)
    theta = inverse @ design.T @ rests.gyro
    scatter = ((rests.gyro - design @ theta) ** 2).sum(axis=0) / free
    change, sigma = theta[0], np.sqrt(np.maximum(scatter, rests.noise**2) * inverse[0, 0])
    sure = 3.0 * 2.0 * stdtr(free, -np.abs(change) / np.maximum(sigma, 1e-300)) < _CHANCE
    if not sure.any():
        return ()
    axis = int(np.argmax(np.where(sure, np.abs(change), 0.0)))
    values = {
        "axis": AXES[axis],
        "change_dps": change[axis] * dps,
        "uncertainty_dps": float(stdtrit(free, 0.975)) * sigma[axis] * dps,
        "rests": count,
        "minutes": span / 60.0,
    }
    level: Level = "warn" if abs(change[axis]) * gain > _LARGE else "info"
    first, last = rests.temp_c[0], rests.temp_c[-1]
    if not abs(last - first) >= _WARMER_C:  # or unknown
        return (finding("session.offset_drift", level, **values),)
    return (finding("session.offset_drift_warming", level, first_c=first, last_c=last, **values),)


def rests_of(seen: Observed) -> RestMeans | None:
    """Return the rests of a session; None where they are too few."""
    session, times = seen.session, list[float]()
    begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in session.records])))
    windows, sizes, force, kept = list[FloatArray](), list[int](), list[FloatArray](), []
    for still in seen.stills:
        record, rows = session.records[still.recording], slice(still.start, still.stop)
        window = np.empty((0, 3)) if record.gyro is None else record.gyro[rows]
        window = window[np.isfinite(window).all(axis=1)]
        if not len(window):
            continue
        accel = np.empty((0, 3)) if record.accel is None else record.accel[rows]
        accel = accel[np.isfinite(accel).all(axis=1)]
        force.append(accel.mean(axis=0) if len(accel) else np.full(3, np.nan))
        windows.append(window)
        sizes.append(block_size(record.sample_rate_hz))
        times.append(
            float(begins[still.recording] + 0.5 * (record.time[rows][0] + record.time[rows][-1]) - record.time[0])
        )
        kept.append(still)
    if len(kept) < _LEAST_RESTS:
        return None
    noise = noise_of_means(windows, sizes)
    return RestMeans(
        time=np.array(times),
        gyro=np.array([window.mean(axis=0) for window in windows]),
        accel=np.array(force),
        temp_c=piece_temperatures(session, kept),
        noise=np.zeros(3) if noise is None else np.sqrt((noise**2).mean(axis=0)),
    )
