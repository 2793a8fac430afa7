"""Temperature creep: offset and scale of each axis move within a session, by slopes that are known by a prior alone.

The reading of one sensor in piece p, a still or turn at w_p kelvin above the calibration's reference temperature, is

    s_p = K a_p + b + (a_p . K) beta w_p + alpha w_p        alpha ~ N(0, S^2 c_o^2), beta ~ N(0, c_s^2)

S is the reading per SI unit; c_o and c_s are the standard deviations of the sensitivities of offset and scale to temperature, from
data sheets (``record.TemperatureSensitivity``). So the readings of one sensor have the covariance P = C C' beyond their noise, with
two columns C. A fit that weighs by noise + P estimates both slopes with their prior: rests at several temperatures narrow them.

w comes from the temperature column or from stated set-points. Where the pieces differ by no more than the thermometer's noise and
steps make, w is 0. Without temperatures w is even in time where the gyroscopes' rests drift. Its span is then the drift of three
axes over the prior of their slope, widened for three observations. In counts, and without gyroscopes, it is the stated span.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.observe import Observed, middles, piece_temperatures
from undrift.calibration.offset_drift import rest_drift
from undrift.findings import Finding, finding
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.fit.smooth import widening_of
from undrift.record import Still, TemperatureSensitivity, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

_SHOWS = 3.0  # standard deviations of a mean square by which pieces differ in temperature
_DITHER = 0.3  # of a step of the thermometer: with less noise the mean keeps the error of rounding
_DRIFTS = 7.81  # 95 %: chi-square of three axes
_WITH_FORCE = 6  # rests: with fewer, drift and g-sensitivity cannot be separated
_FEW = 2  # rests beyond the unknowns: with no more, their scatter is too uncertain to widen by

Kind = Literal["accel", "gyro"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Creep:
    """Temperature of each piece of a session, and how far offset and scale of one sensor may follow it."""

    warmth: FloatArray  # (P,), temperature of each piece less the reference, K
    offset_per_k: float  # c_o, rad/s/K or m/s2/K
    scale_per_k: float  # c_s, relative, 1/K
    span_k: float = 0.0  # Of all pieces, K
    limit_k: float = np.inf  # A larger span is a finding, K
    kind: Kind = "accel"
    recorded: bool = True  # False where the drift of the rests stands for a temperature

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

    def averaged(self, groups: Sequence[Sequence[Any]], weight: FloatArray) -> "Creep":
        """Return the same of weighted means over groups of pieces."""
        return replace(
            self, warmth=np.array([np.average(self.warmth[g], weights=weight[g]) for g in map(list, groups)])
        )

    def findings(self) -> tuple[Finding, ...]:
        """Return what a span above the limit costs, and what to do."""
        if self.span_k <= self.limit_k:
            return ()
        accel = self.kind == "accel"
        unit = 1e-3 * STANDARD_GRAVITY if accel else RADIAN_PER_DEGREE
        cost: dict[str, Any] = {
            "offset": 0.5 * self.span_k * self.offset_per_k / unit,
            "unit": "mg" if accel else "deg/s",
            "scale_percent": 50.0 * self.span_k * self.scale_per_k,
        }
        shown = {
            "span_k": self.span_k,
            "limit_k": self.limit_k,
            "triad": "accelerometer" if accel else "gyroscope",
            **cost,
        }
        if self.recorded:
            return (finding("session.temperature_creep", "warn", **shown),)
        return (finding("session.offset_creep", "warn", **shown),)


def creep_of(seen: Observed, pieces: Sequence[Still | Turn], kind: Kind) -> Creep:
    """Return the creep of a session in some of its stills and turns."""
    prior = seen.settings.sensitivity(seen.session.sensitivity)
    offset, percent = (
        (prior.accel_offset_mg_per_k * 1e-3 * STANDARD_GRAVITY, prior.accel_scale_percent_per_k)
        if kind == "accel"
        else (prior.gyro_offset_dps_per_k * RADIAN_PER_DEGREE, prior.gyro_scale_percent_per_k)
    )
    every: tuple[Still | Turn, ...] = (*seen.stills, *seen.session.turns)
    every = every or tuple(pieces)
    reference = seen.mean_temperature()
    recorded, widened = bool(np.isfinite(reference)), 1.0
    if recorded:
        temps = np.concatenate([piece_temperatures(seen.session, part) for part in (every, pieces)])
        away: FloatArray = np.nan_to_num(temps - reference)
        away = away * _share_of_temperature(away[: len(every)], _thermometer_variance(seen, every)) ** 0.5
    else:
        away, widened = _even_in_time(seen, every, pieces, prior)
    span = float(np.ptp(away[: len(every)])) / widened if every else 0.0
    return Creep(
        warmth=away[len(every) :], offset_per_k=offset, scale_per_k=0.01 * percent, span_k=span,
        limit_k=prior.span_limit_k, kind=kind, recorded=recorded,
    )  # fmt: skip


def _share_of_temperature(away: FloatArray, variance: FloatArray) -> float:
    """Return the share of the mean square of pieces' temperatures (P,) that noise of their means, (P,), does not make."""
    square, noise = float((away**2).sum()), float(variance.mean()) * max(1, len(away) - 1)
    ratio = square / max(noise, 1e-300)
    return 1.0 - 1.0 / ratio if ratio > 1.0 + _SHOWS * (2.0 / max(1, len(away) - 1)) ** 0.5 else 0.0


def _thermometer_variance(seen: Observed, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the variance of the mean temperature of each piece (P,), K^2: noise, and rounding where no noise dithers it."""
    variance = np.zeros(len(pieces))
    for number, record in enumerate(seen.session.records):
        rows = [k for k, piece in enumerate(pieces) if piece.recording == number and piece.temp_c is None]
        if record.temp_c is None or not rows:
            continue
        parts = [record.temp_c[pieces[k].start : pieces[k].stop] for k in rows]
        parts = [part[np.isfinite(part)] for part in parts]
        windows = [np.repeat(part[:, None], 3, axis=1) for part in parts]
        noise = noise_of_means(windows, [block_size(record.sample_rate_hz)] * len(rows))
        steps = np.diff(np.unique(np.concatenate(parts)))
        steps = steps[steps > 1e-6]
        step = float(steps.min()) if len(steps) else 0.0
        within = float(np.sqrt(np.mean([part.var() for part in parts if len(part)] or [0.0])))
        variance[rows] = (0.0 if noise is None else noise[:, 0] ** 2) + (
            step**2 / 12.0 if within < _DITHER * step else 0.0
        )
    return variance


# ---- without temperatures: an even rise, as large as the drift of the gyroscopes' rests shows (offset_drift.py)


def _even_in_time(
    seen: Observed, every: Sequence[Still | Turn], pieces: Sequence[Still | Turn], prior: TemperatureSensitivity
) -> tuple[FloatArray, float]:
    """Return the temperature less its mean, K, of an even rise in every piece, then in the chosen ones, and how it is widened."""
    time = middles(seen.session.records, (*every, *pieces))
    own = time[: len(every)]
    length = float(np.ptp(own)) if len(own) else 0.0
    if length == 0.0:
        return np.zeros(len(time)), 1.0
    span, widened = _rest_span(seen, length, prior)
    return np.asarray((time - own.mean()) / length * span * widened), widened


def _rest_span(seen: Observed, length_s: float, prior: TemperatureSensitivity) -> tuple[float, float]:
    """Return the span that the drift of the gyroscopes' rests stands for, K, else the stated one, and how uncertain: a factor."""
    units = [record.gyro_unit for record in seen.session.records if record.gyro is not None]
    if not units or not seen.stills:
        return prior.unrecorded_span_k, 1.0
    made = rest_drift(seen)
    if made is None:
        return 0.0, 1.0
    few = made.noise.any() and made.free <= _FEW
    scatter = made.scatter * (1.0 if few else widening_of(made.free))
    if float((made.change**2 / np.maximum(made.lever * np.fmax(scatter, made.noise), 1e-300)).sum()) <= _DRIFTS:
        return 0.0, 1.0
    if not is_physical(units[0]) or prior.gyro_offset_dps_per_k == 0.0:
        return prior.unrecorded_span_k, 1.0
    drift = made.change * length_s / float(np.ptp(made.time))
    slope = prior.gyro_offset_dps_per_k * RADIAN_PER_DEGREE / si_factor(units[0], "rate")
    return float(np.sqrt(np.mean(drift**2))) / slope, widening_of(3) ** 0.5
