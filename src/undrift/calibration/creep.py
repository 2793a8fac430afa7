"""What moves within a session: flicker of offsets, drift that rests show, and creep with temperature.

Creep: offset and scale of each axis follow the temperature by slopes that are known by a prior alone. The reading of one sensor in
piece p, a still or turn at w_p kelvin above the calibration's reference temperature, is

    s_p = K a_p + b + (a_p . K) beta w_p + alpha w_p        alpha ~ N(0, S^2 c_o^2), beta ~ N(0, c_s^2)

S is the reading per SI unit; c_o and c_s are the standard deviations of the sensitivities of offset and scale to temperature, from
data sheets (``record.TemperatureSensitivity``). So the readings of one sensor have the covariance P = C C' beyond their noise, with
two columns C. A fit that weighs by noise + P estimates both slopes with their prior: rests at several temperatures narrow them.

w comes from the temperature column or from stated set-points. A thermometer with a first-order lag reads less than the sensors have
by lag times its rate of change; w adds that back: the reference is a reading of this thermometer. Its step, where no noise dithers
it, stays unknown of the reference. Where the pieces differ by no more than the thermometer's noise and steps make, w is even in
time and rises by what these hide. Without temperatures w is even in time where the gyroscopes' rests drift. Its span is then the
drift of three axes over the prior of their slope, widened for three observations. In counts, and without gyroscopes, it is the
stated span.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.quality import mean_reading, piece_temperatures, whole_readings
from undrift.calibration.session import Observed, middles
from undrift.findings import Finding, Level, finding
from undrift.fit.gls import student_factor
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import AXES
from undrift.record import Still, TemperatureSensitivity, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# ---- flicker and walk of an offset, of a stated size, in means over pieces of a session
#
#     F (E, E)        flicker: exponential correlations with time constants from 1 s to 10^4 s, variance 1 in all
#     B (E, E)        random walk (Brownian covariance)


_TIMES_S = np.geomspace(1.0, 1e4, 9)


def in_case(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (3 E, 3 E) of M n_e, for sensors that err on their own: covariance (E, E, 3)."""
    count = len(covariance)
    carried = np.einsum("ik,efk,jk->eifj", matrix, covariance, matrix)
    return np.asarray(carried.reshape(3 * count, 3 * count))


def flicker_of_means(span: FloatArray) -> FloatArray:
    """Return F of means over stretches (E, 2), s, which may overlap."""
    start, stop = span[:, 0], np.maximum(span[:, 1], span[:, 0] + 1e-3)
    apart = [to[:, None] - of for to, of in ((stop, start), (start, stop), (stop, stop), (start, start))]
    total = np.zeros((len(span), len(span)))
    for time_s in _TIMES_S:  # twice the integral of exp(-|t| / time) over t, then its second difference
        late, early, stops, starts = (np.expm1(-np.abs(t) / time_s) + np.abs(t) / time_s for t in apart)
        total += time_s**2 * (late + early - stops - starts)
    return np.asarray(total / len(_TIMES_S) / np.outer(stop - start, stop - start))


def flicker_about_mean(span: FloatArray) -> FloatArray:
    """Return F of means over stretches (E, 2), s, minus the mean from the first to the last."""
    every = flicker_of_means(np.vstack((span, (span[:, 0].min(), span[:, 1].max()))))
    away = np.column_stack((np.eye(len(span)), -np.ones(len(span))))
    return np.asarray(away @ every @ away.T)


def walk_about_mean(time: FloatArray) -> FloatArray:
    """Return the covariance (E, E) of a random walk of 1 per root second, minus its mean from the first time to the last."""
    since = time - time.min()
    length = float(since.max())
    mean = since - since**2 / (2.0 * length)
    return np.asarray(np.minimum.outer(since, since) - mean[:, None] - mean + length / 3.0)


# ---- drift of the gyroscopes' rest offsets between start and end of a session
#
# Means m_r of rests at times t_r, one axis at a time::
#
#     m_r = o + d (t_r - mean t) / T + h a_r + e_r        T from the first rest to the last, d the change over the session
#
# by least squares; h a_r, g-sensitivity times specific force, for the directions of gravity that the poses change, where six
# rests or more bear it. var e is the scatter of the rests that is left, no less than what noise within the rests makes. A change
# counts where chance alone makes one as large on any of three axes in less than one session in a hundred.
#
# Recordings have no common clock; they are taken to follow each other without pauses.


_LEAST_RESTS = 4
_LEAST_WITH_POSES = 6
_LEAST_CHANGE = 0.5  # g, root sum of squares over the rests: poses that differ less show no g-sensitivity
_CHANCE = 0.01
# rad/s: what 1 K makes of a consumer part; a mean offset is off by half of it at either end
_LARGE = 0.05 * RADIAN_PER_DEGREE
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
    windows, force, stills = list[FloatArray](), list[FloatArray](), []
    for still in seen.stills:
        record = records[still.recording]
        window = whole_readings(record.gyro, still.start, still.stop)
        if len(window):
            force.append(mean_reading(record.accel, still.start, still.stop))
            windows.append(window)
            stills.append(still)
    time, unit = middles(records, stills), records[0].accel_unit
    if not stills or np.ptp(time) <= 0.0:
        return None
    design = np.column_stack(((time - time.mean()) / np.ptp(time), np.ones(len(stills)), _poses(np.array(force), unit)))
    free = len(stills) - design.shape[1]
    if free < 1 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    gyro, inverse = np.array([window.mean(axis=0) for window in windows]), np.linalg.inv(design.T @ design)
    theta = inverse @ design.T @ gyro
    noise = noise_of_means(windows, [block_size(records[still.recording].sample_rate_hz) for still in stills])
    return RestDrift(
        time=time,
        temp_c=piece_temperatures(seen.session, stills),
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
    # counts may have any offset
    gravity = STANDARD_GRAVITY / si_factor(unit, "accel") if is_physical(unit) else size[0]
    return np.asarray(left[:, size > _LEAST_CHANGE * gravity])


def offset_drift(seen: Observed, gain: float) -> tuple[Finding, ...]:
    """Return the finding of rest offsets that changed significantly over a session; gain in rad/s per unit of the readings."""
    from scipy.special import stdtr, stdtrit

    drift = None if seen.session.kind == "thermal" else rest_drift(seen)
    if drift is None or len(drift.time) < _LEAST_RESTS:
        return ()
    change, dps = drift.change, gain / RADIAN_PER_DEGREE
    sigma = np.sqrt(np.maximum(drift.scatter, drift.noise) * drift.lever)
    sure = 3.0 * 2.0 * stdtr(drift.free, -np.abs(change) / np.maximum(sigma, 1e-300)) < _CHANCE
    if not sure.any():
        return ()
    axis = int(np.argmax(np.where(sure, np.abs(change), 0.0)))
    values = {
        "axis": AXES[axis],
        "change_dps": change[axis] * dps,
        "uncertainty_dps": float(stdtrit(drift.free, 0.975)) * sigma[axis] * dps,
        "rests": len(drift.time),
        "minutes": float(np.ptp(drift.time)) / 60.0,
    }
    level: Level = "warn" if abs(change[axis]) * gain > _LARGE else "info"
    first, last = drift.temp_c[0], drift.temp_c[-1]
    if not abs(last - first) >= _WARMER_C:  # or unknown
        return (finding("session.offset_drift", level, **values),)
    return (finding("session.offset_drift_warming", level, first_c=first, last_c=last, **values),)


# ---- creep with temperature

_SHOWS = 3.0  # standard deviations of a mean square by which pieces differ in temperature
_DITHER = 0.3  # of a step of the thermometer: with less noise the mean keeps the error of rounding
_DRIFTS = 7.81  # 95 %: chi-square of three axes
_FEW = 2  # rests beyond the unknowns: with no more, their scatter is too uncertain to widen by

Kind = Literal["accel", "gyro"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Creep:
    """Temperature of each piece of a session, and how far offset and scale of one sensor may follow it."""

    warmth: FloatArray  # (P,), temperature of each piece less the reference, K
    offset_per_k: float  # c_o, rad/s/K or m/s2/K
    scale_per_k: float  # c_s, relative, 1/K
    reference_k: float = 0.0  # Standard uncertainty of the reference by the thermometer's step, K
    span_k: float = 0.0  # Of all pieces, K
    limit_k: float = np.inf  # A larger span is a finding, K
    kind: Kind = "accel"
    recorded: bool = True  # False where the drift of the rests stands for a temperature

    def covariance_in_case(self, value: FloatArray) -> FloatArray:
        """Return the covariance (3 P, 3 P) of warmth (alpha + beta value), each axis with slopes of its own; value (P, 3), SI."""
        slopes = np.stack((self.offset_per_k * np.ones_like(value), self.scale_per_k * value))
        columns = (self.warmth[:, None] * slopes)[:, :, :, None] * np.eye(3)  # slope, piece, row, axis
        reference = (self.reference_k * slopes[1:])[:, :, :, None] * np.eye(3)
        both = np.concatenate((columns, reference)).transpose(1, 2, 0, 3).reshape(value.size, -1)
        return np.asarray(both @ both.T)

    def columns(self, of_scale: FloatArray, gain: float = 1.0, of_offset: FloatArray | float = 1.0) -> FloatArray:
        """Return C (P, 2) of one sensor, unit of the reading: of offset and of scale, one standard deviation each.

        ``of_scale`` (P,) is what the sensor measures in each piece, SI; ``of_offset`` what a unit offset adds to the reading, 1 for
        a mean. For the integral over a turn they are its angle and its duration. ``gain`` is S, unit of the reading per SI unit.
        """
        parts = np.stack((self.offset_per_k * of_offset * np.ones(len(self.warmth)), self.scale_per_k * of_scale))
        return np.asarray((gain * self.warmth * parts).T)

    def covariance(self, of_scale: FloatArray, gain: float = 1.0, of_offset: FloatArray | float = 1.0) -> FloatArray:
        """Return P (P, P) of one sensor, unit of the reading squared; arguments as of ``columns``."""
        columns = self.columns(of_scale, gain, of_offset)
        return np.asarray(columns @ columns.T)

    @property
    def none(self) -> bool:
        """True where no piece is off the reference temperature."""
        return not self.warmth.any()

    def findings(self) -> tuple[Finding, ...]:
        """Return what a span above the limit costs, and what to do."""
        if self.span_k <= self.limit_k:
            return ()
        accel = self.kind == "accel"
        unit = 1e-3 * STANDARD_GRAVITY if accel else RADIAN_PER_DEGREE
        shown: dict[str, Any] = {
            "span_k": self.span_k,
            "limit_k": self.limit_k,
            "triad": "accelerometer" if accel else "gyroscope",
            "offset": 0.5 * self.span_k * self.offset_per_k / unit,
            "unit": "mg" if accel else "deg/s",
            "scale_percent": 50.0 * self.span_k * self.scale_per_k,
        }
        return (finding("session.temperature_creep" if self.recorded else "session.offset_creep", "warn", **shown),)


def creep_of(seen: Observed, pieces: Sequence[Still | Turn], kind: Kind) -> Creep:
    """Return the creep of a session in some of its stills and turns."""
    prior = seen.session.sensitivity
    offset, percent = (
        (prior.accel_offset_mg_per_k * 1e-3 * STANDARD_GRAVITY, prior.accel_scale_percent_per_k)
        if kind == "accel"
        else (prior.gyro_offset_dps_per_k * RADIAN_PER_DEGREE, prior.gyro_scale_percent_per_k)
    )
    every: tuple[Still | Turn, ...] = (*seen.stills, *seen.session.turns)
    every = every or tuple(pieces)
    reference = seen.mean_temperature()
    recorded, widened, step_k = bool(np.isfinite(reference)), 1.0, 0.0
    if recorded:
        temps = np.concatenate([piece_temperatures(seen.session, part) for part in (every, pieces)])
        away: FloatArray = np.nan_to_num(temps - reference)
        noise, rounding = _thermometer_variance(seen, every)
        share = _share_of_temperature(away[: len(every)], noise + rounding)
        # Where no change shows, an even rise by what the thermometer hides: one step, of variance step^2 / 12
        shown, step_k = away * share**0.5, float(rounding.mean()) ** 0.5
        away = shown if share else _even_rise(seen, every, pieces) * 12.0**0.5 * step_k
        if share and prior.thermometer_lag_s:
            away = away + prior.thermometer_lag_s * _rise(seen, every, pieces, shown)
    else:
        away, widened = _even_in_time(seen, every, pieces, prior)
    span = float(np.ptp(away[: len(every)])) / widened if every else 0.0
    return Creep(
        warmth=away[len(every) :], offset_per_k=offset, scale_per_k=0.01 * percent, reference_k=step_k, span_k=span,
        limit_k=prior.span_limit_k, kind=kind, recorded=recorded,
    )  # fmt: skip


def _rise(
    seen: Observed, every: Sequence[Still | Turn], pieces: Sequence[Still | Turn], away: FloatArray
) -> FloatArray:
    """Return how fast the thermometer rises in every piece, then in the chosen ones, K/s, by a parabola in time; 0 where stated."""
    time, read = middles(seen.session.records, (*every, *pieces)), [p.temp_c is None for p in (*every, *pieces)]
    course = np.polynomial.Polynomial.fit(time[: len(every)], away[: len(every)], min(2, len(every) - 1))
    return np.where(read, course.deriv()(time), 0.0)


def _share_of_temperature(away: FloatArray, variance: FloatArray) -> float:
    """Return the share of the mean square of pieces' temperatures (P,) that noise of their means, (P,), does not make."""
    square, noise = float((away**2).sum()), float(variance.mean()) * max(1, len(away) - 1)
    ratio = square / max(noise, 1e-300)
    return 1.0 - 1.0 / ratio if ratio > 1.0 + _SHOWS * (2.0 / max(1, len(away) - 1)) ** 0.5 else 0.0


def _thermometer_variance(seen: Observed, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the variance of the mean temperature of each piece (2, P), K^2: noise, and rounding where no noise dithers it."""
    variance = np.zeros((2, len(pieces)))
    for number, record in enumerate(seen.session.records):
        rows = [k for k, piece in enumerate(pieces) if piece.recording == number and piece.temp_c is None]
        if record.temp_c is None or not rows:
            continue
        parts = [record.temp_c[pieces[k].start : pieces[k].stop] for k in rows]
        parts = [temps[np.isfinite(temps)] for temps in parts]
        windows = [np.repeat(temps[:, None], 3, axis=1) for temps in parts]
        noise = noise_of_means(windows, [block_size(record.sample_rate_hz)] * len(rows))
        steps = np.diff(np.unique(np.concatenate(parts)))
        steps = steps[steps > 1e-6]
        step = float(steps.min()) if len(steps) else 0.0
        within = float(np.sqrt(np.mean([temps.var() for temps in parts if len(temps)] or [0.0])))
        variance[0, rows] = 0.0 if noise is None else noise[:, 0] ** 2
        variance[1, rows] = step**2 / 12.0 if within < _DITHER * step else 0.0
    return variance


# ---- without temperatures: an even rise, as large as the drift of the gyroscopes' rests shows


def _even_in_time(
    seen: Observed, every: Sequence[Still | Turn], pieces: Sequence[Still | Turn], prior: TemperatureSensitivity
) -> tuple[FloatArray, float]:
    """Return the temperature less its mean, K, of an even rise in every piece, then in the chosen ones, and how it is widened."""
    length = float(np.ptp(middles(seen.session.records, every))) if every else 0.0
    span, widened = _rest_span(seen, length, prior) if length else (0.0, 1.0)
    return _even_rise(seen, every, pieces) * span * widened, widened


def _even_rise(seen: Observed, every: Sequence[Still | Turn], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the time of every piece, then of the chosen ones, less the mean of the former and over their span."""
    time = middles(seen.session.records, (*every, *pieces))
    own = time[: len(every)]
    return np.asarray((time - own.mean()) / (float(np.ptp(own)) or np.inf)) if every else np.zeros(len(time))


def _rest_span(seen: Observed, length_s: float, prior: TemperatureSensitivity) -> tuple[float, float]:
    """Return the span that the drift of the gyroscopes' rests stands for, K, else the stated one, and how uncertain: a factor."""
    units = [record.gyro_unit for record in seen.session.records if record.gyro is not None]
    if not units or not seen.stills:
        return prior.unrecorded_span_k, 1.0
    fit = rest_drift(seen)
    if fit is None:
        return 0.0, 1.0
    few = fit.noise.any() and fit.free <= _FEW
    scatter = fit.scatter * (1.0 if few else student_factor(fit.free))
    if float((fit.change**2 / np.maximum(fit.lever * np.fmax(scatter, fit.noise), 1e-300)).sum()) <= _DRIFTS:
        return 0.0, 1.0
    if not is_physical(units[0]) or prior.gyro_offset_dps_per_k == 0.0:
        return prior.unrecorded_span_k, 1.0
    drift = fit.change * length_s / float(np.ptp(fit.time))
    slope = prior.gyro_offset_dps_per_k * RADIAN_PER_DEGREE / si_factor(units[0], "rate")
    return float(np.sqrt(np.mean(drift**2))) / slope, student_factor(3) ** 0.5
