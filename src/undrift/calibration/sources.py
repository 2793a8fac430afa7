"""Sources of error between the pieces of a session: flicker, walk and drift of an offset, and temperature.

Offset and scale of each sensor depend on temperature with slopes of known size only. Piece p, a still or turn, is at w_p kelvin
above the calibration's reference temperature. A sensor reads in it

    s_p = K a_p + b + (a_p . K) beta w_p + alpha w_p        alpha ~ N(0, S^2 c_o^2), beta ~ N(0, c_s^2)

S is the reading per SI unit. c_o and c_s are the sensitivities of offset and scale to temperature, from data sheets
(``record.TemperatureSensitivity``). Beyond their noise, the readings of a sensor have the covariance C C', with two columns C. A
fit with this covariance estimates both slopes with their prior.

w is the recorded temperature, plus lag times its rate of change if the thermometer lags behind the sensors. If a thermometer varies
by one step at most, w increases evenly in time by that step. Without a thermometer it increases by the given span.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.quality import piece_temperatures
from undrift.calibration.session import ONE_TEMPERATURE, Observed, spans_of
from undrift.calibration.settings import CalibrateSettings
from undrift.findings import Finding, above, finding, told_apart
from undrift.fit.gls import GlsFit
from undrift.fit.priors import ACCEL_FLICKER, DRIFT_DPS, GYRO_FLICKER, MILLI_G, REST_DRIFT
from undrift.model import AXES, TriadModel
from undrift.record import Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- flicker and walk of an offset, with a given size, in means over pieces of a session
#
#     F (E, E)        flicker: exponential correlations with time constants from 1 s to 10^4 s, variance 1 in all
#     B (E, E)        random walk (Brownian covariance)

FLICKER_TIMES_S = np.geomspace(1.0, 1e4, 9)


def in_case(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (3 E, 3 E) of M n_e, for independent errors of the sensors with covariance (E, E, 3)."""
    count = len(covariance)
    carried = np.einsum("ik,efk,jk->eifj", matrix, covariance, matrix)
    return np.asarray(carried.reshape(3 * count, 3 * count))


def noise_and_codes(matrix: FloatArray, noise: FloatArray, codes: FloatArray) -> dict[str, FloatArray]:
    """Return the covariances (3 E, 3 E) of means by noise and by codes, for the variances (E, 3) of each sensor.

    ``codes`` is (E, E, 3) if the rounding errors of the means are correlated.
    """
    identity = np.eye(len(noise))[:, :, None]
    covariance = codes if codes.ndim == 3 else identity * np.broadcast_to(codes, noise.shape)[:, None]
    return {"noise": in_case(matrix, identity * noise[:, None]), "adc": in_case(matrix, covariance)}


def flicker_of_means(span: FloatArray) -> FloatArray:
    """Return F of means over stretches (E, 2), s, which may overlap."""
    start, stop = span[:, 0], np.maximum(span[:, 1], span[:, 0] + 1e-3)
    lags = [to[:, None] - of for to, of in ((stop, start), (start, stop), (stop, stop), (start, start))]
    total = np.zeros((len(span), len(span)))
    for time_s in FLICKER_TIMES_S:  # twice the integral of exp(-|t| / time) over t, then its second difference
        late, early, stops, starts = (np.expm1(-np.abs(t) / time_s) + np.abs(t) / time_s for t in lags)
        total += time_s**2 * (late + early - stops - starts)
    return np.asarray(total / len(FLICKER_TIMES_S) / np.outer(stop - start, stop - start))


def flicker_about_mean(span: FloatArray) -> FloatArray:
    """Return F of means over stretches (E, 2), s, minus the mean from the first to the last."""
    every = flicker_of_means(np.vstack((span, (span[:, 0].min(), span[:, 1].max()))))
    centring = np.column_stack((np.eye(len(span)), -np.ones(len(span))))
    return np.asarray(centring @ every @ centring.T)


def walk_about_mean(time: FloatArray) -> FloatArray:
    """Return the covariance (E, E) of a random walk of 1 per root second, minus its mean from the first time to the last."""
    since = time - time.min()
    length = float(since.max())
    mean = since - since**2 / (2.0 * length)
    return np.asarray(np.minimum.outer(since, since) - mean[:, None] - mean + length / 3.0)


def steady_drift(span: FloatArray) -> FloatArray:
    """Return the covariance (E, E) of a steady change, about its mean. The change is 1 over all pieces (E, 2)."""
    since = (span.mean(axis=1) - span.min()) / float(np.ptp(span)) - 0.5
    return np.outer(since, since)


def gyro_drift(span: FloatArray) -> FloatArray:
    """Return the covariance (3 E, 3 E) of the offset of gyroscopes about its mean, (rad/s)^2, for pieces (E, 2), s.

    The sources are flicker and a steady drift.
    """
    return np.kron(GYRO_FLICKER**2 * flicker_about_mean(span) + REST_DRIFT**2 * steady_drift(span), np.eye(3))


def walks_of(span: FloatArray | None) -> dict[str, FloatArray]:
    """Return the covariance (3 E, 3 E) of a unit walk of each sensor's offset, for pieces (E, 2) on a common clock, s."""
    if span is None or not np.ptp(middle := span.mean(axis=1)) > 0.0:
        return {}
    walk = walk_about_mean(middle)
    return {f"instability {axis}": np.kron(walk, np.diag(np.eye(3)[k])) for k, axis in enumerate(AXES)}


def offset_drift(fit: GlsFit) -> tuple[Finding, ...]:
    """Return a finding if the excess variances of ``walks_of`` show that an offset of the gyroscopes walked in the session."""
    walk = max((variance for kind, variance in fit.excess.items() if kind.startswith("instability")), default=0.0)
    dps = (60.0 * walk) ** 0.5 / RADIAN_PER_DEGREE
    return above(
        "session.offset_drift",
        dps,
        DRIFT_DPS,
        f"The gyroscope offset walked by {told_apart(dps, '.2g', DRIFT_DPS[0])} deg/s in a minute (1 sigma, limit "
        f"{DRIFT_DPS[0]:g}).",
        "Warm up the device beforehand, and rest before and after the turns.",
        dps_per_minute=dps,
    )


def uncertain(what: str, size: float, limits: tuple[float, float], unit: str, action: str) -> tuple[Finding, ...]:
    """Return a finding if a standard uncertainty exceeds the first of two limits in the same unit."""
    sentence = f"{what} has a standard uncertainty of {told_apart(size, '.2g', limits[0])} {unit} (limit {limits[0]:g} {unit})."
    return above("session.uncertain", size, limits, sentence, action, size=size)


# ---- jitter of the clock
#
# A sum of readings u_k (t_k - t_(k-1)) changes by d_k (u_k - u_(k+1)) if time stamp k is off by d_k. Time steps have twice the
# variance of d.


def slip_covariance(time: FloatArray, reading: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of the integral of readings (N, 3) due to the scatter of their time stamps, (unit s)^2."""
    change = np.diff(reading, axis=0)
    return np.asarray(0.5 * np.diff(time).var() * change.T @ change)


# ---- temperature

Kind = Literal["accel", "gyro"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Creep:
    """Temperature of each piece of a session, and the temperature sensitivity of offset and scale of a sensor."""

    warmth: FloatArray  # (P,), temperature of each piece minus the reference, K
    offset_per_k: float  # c_o, rad/s/K or m/s2/K
    scale_per_k: float  # c_s, relative, 1/K

    def columns(self, value: FloatArray, gain: float = 1.0) -> FloatArray:
        """Return C (P, 2) of a sensor, unit of the reading: offset and scale columns, one standard deviation each.

        ``value`` (P,) is the true input in each piece, SI units. ``gain`` is S, unit of the reading per SI unit.
        """
        slopes = np.stack((np.full(len(self.warmth), self.offset_per_k), self.scale_per_k * value))
        return np.asarray((gain * self.warmth * slopes).T)

    def columns_in_case(self, value: FloatArray) -> FloatArray:
        """Return the columns (3 P, 6) warmth (alpha + beta value) for offset and scale of each axis, value (P, 3), SI."""
        columns = np.zeros((len(value), 3, 3, 2))
        for axis in range(3):
            columns[:, axis, axis] = self.columns(value[:, axis])
        return columns.reshape(value.size, 6)

    def covariance_in_case(self, value: FloatArray) -> FloatArray:
        """Return their covariance (3 P, 3 P)."""
        columns = self.columns_in_case(value)
        return np.asarray(columns @ columns.T)


def creep_of(observed: Observed, pieces: Sequence[Still | Turn], kind: Kind) -> Creep:
    """Return the temperature of stills and turns of a session, and its effect on a sensor."""
    prior = observed.session.sensitivity
    offset, scale = (
        (prior.accel_offset_mg_per_k * 1e-3 * STANDARD_GRAVITY, prior.accel_scale_percent_per_k)
        if kind == "accel"
        else (prior.gyro_offset_dps_per_k * RADIAN_PER_DEGREE, prior.gyro_scale_percent_per_k)
    )
    return Creep(warmth=_warmth(observed, pieces), offset_per_k=offset, scale_per_k=0.01 * scale)


def temperature_span(observed: Observed) -> tuple[Finding, ...]:
    """Return a finding if the temperature of the stills and turns of a session changed by more than the limit."""
    limit_k = observed.session.sensitivity.span_limit_k
    span_k = float(np.ptp(_warmth(observed, (*observed.stills, *observed.session.turns))))
    sentence = (
        f"The temperature changed by {told_apart(span_k, '.1f', limit_k)} K within the session (limit {limit_k:g} K)."
    )
    return above("session.temperature", span_k, (limit_k, np.inf), sentence, ONE_TEMPERATURE, span_k=span_k)


def _warmth(observed: Observed, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the temperature of pieces minus the mean temperature of the session, (P,), K."""
    prior = observed.session.sensitivity
    session_pieces: tuple[Still | Turn, ...] = (*observed.stills, *observed.session.turns)
    if not session_pieces:
        return np.zeros(len(pieces))
    all_pieces, count = (*session_pieces, *pieces), len(session_pieces)
    time = spans_of(observed.session.records, all_pieces).mean(axis=1)
    temps = piece_temperatures(observed.session, all_pieces)
    warmth: FloatArray = np.nan_to_num(temps - observed.mean_temperature())
    has_set_point = np.array([piece.temp_c is not None for piece in all_pieces])
    least_k = prior.unrecorded_span_k
    if np.isfinite(temps[:count]).any():
        least_k = 0.0 if has_set_point.any() else _thermometer_step(observed)
    if np.ptp(warmth[:count]) <= least_k:
        warmth = least_k * (time - time[:count].mean()) / (float(np.ptp(time[:count])) or np.inf)
    elif prior.thermometer_lag_s:
        course = np.polynomial.Polynomial.fit(time[:count], warmth[:count], min(2, count - 1)).deriv()
        warmth = warmth + prior.thermometer_lag_s * np.where(has_set_point, 0.0, course(time))
    return np.asarray(warmth[count:])


def _thermometer_step(observed: Observed) -> float:
    """Return the smallest step between recorded temperatures, K."""
    columns = [record.temp_c for record in observed.session.records if record.temp_c is not None]
    steps = np.diff(np.unique(np.concatenate([column[np.isfinite(column)] for column in columns])))
    return float(steps.min()) if len(steps) else 0.0


# ---- sources with a given size that no residual reveals: if the actual size is larger, nothing shows it

LARGE_SHARE = 0.25  # share of a variance: if such a source is three times its given size, 74 % of intervals contain the true value
GROUPS = {"scale": [0, 4, 8], "cross-axis terms": [1, 2, 3, 5, 6, 7], "offset": [9, 10, 11]}  # indices of parameters


def name_stated_sources(
    kind: Kind, model: TriadModel, session: Session, settings: CalibrateSettings, *, visible: Sequence[str] = ()
) -> Iterator[Finding]:
    """Yield a finding for each source with a given size that causes much of a triad's uncertainty, but that no residual reveals.

    ``visible`` are sources that the residuals of this fit reveal.
    """
    if model.budget is None:
        return
    table, slopes, gyro = session.rate_table, session.sensitivity, kind == "gyro"
    per_k = f"{slopes.accel_scale_percent_per_k:g} % and {slopes.accel_offset_mg_per_k:g} mg per kelvin"
    if gyro:
        per_k = f"{slopes.gyro_scale_percent_per_k:g} % and {slopes.gyro_offset_dps_per_k:g} deg/s per kelvin"
    texts = {  # source, its given size, and a way to check it
        "rate": ("rate of the table", f"{100.0 * table.rate_uncertainty:g} %", "Turn by known angles"),
        "mounting": ("mounting on the table", f"{table.mount_tilt_deg:g} deg", "Record accelerometers on six faces"),
        "angle": ("angle of a turn", f"{settings.angle_uncertainty_deg:g} deg", "Turn twice about each axis"),
        "axis": (
            "axis of the turns",
            f"{settings.axis_uncertainty_deg:g} deg",
            "Also record accelerometers during the turns",
        ),
        "temperature": ("dependence on temperature", per_k, "Record soaks at several temperatures"),
        "instability": ("flicker", f"{ACCEL_FLICKER / MILLI_G:g} mg", "Record an hour at rest"),
    }
    axes = [turn.axis for turn in session.turns if turn.angle is not None]
    repeats, exact = len(axes) > len(set(axes)), table.mount_tilt_deg == 0.0
    visible = (*visible, *["instability"] * gyro, *["angle"] * repeats, *["mounting"] * exact)
    variance = np.diag(model.covariance)
    for source, part in zip(model.budget.sources, model.budget.uncertainty**2, strict=True):
        groups = [name for name, at in GROUPS.items() if part[at].sum() > LARGE_SHARE * variance[at].sum()]
        if groups and source in texts.keys() - {*visible}:
            what, size, check = texts[source]
            yield finding(
                "session.stated",
                "info",
                f"The {what}, stated to {size}, causes much of the uncertainty of the {' and the '.join(groups)} of the "
                f"{'gyroscopes' if gyro else 'accelerometers'}. No residual can reveal its size.",
                f"{check} to check it.",
                source=source,
                parameters=tuple(groups),
            )
