"""Remaining offset of the gyroscopes at a rest, and uncertainty of the direction of gravity there.

The mean rate that remains at a rest after the calibration is subtracted from the whole recording.

::

    w'(t) = w(t) - r        r = mean of w over the rest        var r = var of the mean, with the correlation between samples

This removes the offset at that time whatever its cause (turn-on, ageing, hysteresis), and also any true slow turn. It does not
remove scale errors, rate-dependent errors, or later changes of the offset. The rest is the first still phase in the first half hour
of the corrected readings, or a given stretch.
"""

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np

from undrift.arrays import FloatArray, Shape, freeze
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.model import MOVING_NAMES, TriadModel, Vector
from undrift.record import ForceUncertainty, Record, Still
from undrift.segments import find_still, unpadded
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

FOUND_IN_S = 1800.0  # limit of the search, so that a stream in chunks finds the same rest as the whole recording
LEAST_IN_MOTION_S = 20.0  # shortest recording whose motion determines the vertical and the remaining offset
FEWEST = 10  # smallest number of samples from which their scatter is estimated
# change of an axis' offset from rest to motion, rad/s: two thirds of half a step of 16 bits over +-2000 deg/s [assumed]
MOVED = 0.02 * RADIAN_PER_DEGREE
# deviation of a recording's change from the fitted change of its device, rad/s: BROAD, three devices, rounded up
MOVED_AGAIN = 0.005 * RADIAN_PER_DEGREE
KEPT = 0.7  # share of the prior deviation above which the motion does not determine an axis
IN_MOTION = ("reference/motion", "reference/common")  # methods of a triad whose offset already applies in motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RemainingOffset:
    """Offset of the gyroscopes that remains in a corrected record: one value from a rest, or one for each stretch of a motion."""

    time: Annotated[FloatArray, Shape("s")]  # middle of the rest or of each stretch, s
    rate: Annotated[FloatArray, Shape("s", 3)]  # rad/s, frame b
    covariance: Annotated[FloatArray, Shape("s", 3, 3)]  # covariance of the rate, (rad/s)^2
    rest_s: tuple[float, float] | None  # first and last sample of the rest, or None without a rest
    stills: tuple[Still, ...] | None = None  # all rests found in the search, or None for a given stretch
    moved: float  # standard uncertainty of the change from rest to motion, all axes together, rad/s
    prior: Vector = None  # standard deviation before the motion was used, rad/s, or None for the mean of a rest

    def __post_init__(self) -> None:
        freeze(self)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the offset at times (N,), linear between stretches, (N, 3)."""
        if len(self.time) == 1:
            return np.broadcast_to(self.rate, (len(time), 3))
        return np.stack([np.interp(time, self.time, axis) for axis in self.rate.T], axis=1)

    @property
    def mean(self) -> FloatArray:
        """Mean offset, (3,), rad/s."""
        return np.asarray(self.rate.mean(axis=0))

    @property
    def uncertainty(self) -> float:
        """Return the standard uncertainty in motion in the worst stretch, all axes together, rad/s."""
        return float(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2).max() + self.moved**2))

    @property
    def deviation(self) -> FloatArray:
        """Return the standard uncertainty of each axis in motion in the worst stretch, (3,), rad/s."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2).max(axis=0) + self.moved**2 / 3.0))

    @property
    def figures(self) -> dict[str, Any]:
        """Return the subtracted offset for JSON."""
        rate, uncertainty = self.mean / RADIAN_PER_DEGREE, self.deviation / RADIAN_PER_DEGREE
        return {"rest_s": self.rest_s, "offset_dps": rate, "offset_uncertainty_dps": uncertainty}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return findings about the subtracted offset, and about axes whose offset the motion does not determine."""
        rate, uncertainty = (
            ", ".join(f"{axis / RADIAN_PER_DEGREE:.{digits}g}" for axis in values)
            for values, digits in ((self.mean, 3), (self.deviation, 2))
        )
        sentence = f"The remaining offset was subtracted: {rate} deg/s on x, y, z, with a standard uncertainty of "
        sentence += f"{uncertainty} deg/s."
        offset_dps = self.mean / RADIAN_PER_DEGREE
        subtracted = finding("correct.offset_subtracted", "info", sentence, offset_dps=offset_dps)
        if self.rest_s is not None or self.prior is None or not (self.deviation > KEPT * self.prior).any():
            return (subtracted,)
        open_axes = np.flatnonzero(self.deviation > KEPT * self.prior)
        axes, size = ", ".join("xyz"[k] for k in open_axes), float(self.prior[open_axes].max()) / RADIAN_PER_DEGREE
        return subtracted, finding(
            "correct.motion_offset_kept",
            "warn",
            f"The motion does not determine the gyroscope offset about {axes}. It was not subtracted there, and is known to +- "
            f"{size:.2g} deg/s.",
            "Begin the recording with 6 s at rest.",
            axes=axes,
        )


def moved_by(model: TriadModel | None) -> float:
    """Return the standard uncertainty of the offset's change from rest to motion, all axes together, rad/s: fitted, or assumed."""
    if model is None or model.moving_offset is None:
        return math.sqrt(3.0) * MOVED
    variance = float(np.trace(model.covariance_of(MOVING_NAMES)))
    return math.sqrt(variance * si_factor(model.unit_out, "rate") ** 2 + 3.0 * MOVED_AGAIN**2)


def mean_variance(x: FloatArray) -> float:
    """Estimate the variance of the mean of correlated samples.

    The autocovariances c_k are summed up to the first negative pair c_(2k) + c_(2k+1), which for a reversible process is noise: var
    = (c_0 + 2 sum c_k) / n (C. J. Geyer, "Practical Markov chain Monte Carlo", Statistical Science 7, 1992, section 3.3).
    """
    n = len(x)
    spectrum = np.fft.rfft(x - x.mean(), 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n] / n
    pairs = covariance[: n - n % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    initial_pairs = pairs[: negative[0]] if negative.size else pairs
    total = 2.0 * float(initial_pairs.sum()) - float(covariance[0])
    return max(total, float(covariance[0])) / (n - 1)


def rest_offset(
    record: Record, still: Still, model: TriadModel | None = None, stills: tuple[Still, ...] | None = None
) -> RemainingOffset:
    """Return the mean rate of a corrected record at a rest."""
    rates = np.empty((0, 3)) if record.gyro is None else record.gyro[still.start : still.stop]
    if len(rates) < FEWEST or np.isnan(rates).any():
        got = f"{len(rates)} samples" if len(rates) < FEWEST else f"{int(np.isnan(rates).any(axis=1).sum())} gaps (NaN)"
        raise InputError(
            f"rest: expected {FEWEST} samples at rest or more, without gaps, got {got}. Give another stretch, or use offset none."
        )
    start_s, stop_s = float(record.time[still.start]), float(record.time[still.stop - 1])
    return RemainingOffset(
        time=np.array([0.5 * (start_s + stop_s)]),
        rate=rates.mean(axis=0)[None],
        covariance=np.diag([mean_variance(axis) for axis in rates.T])[None],
        rest_s=(start_s, stop_s),
        stills=stills,
        moved=moved_by(model),
    )


def find_rest_offset(record: Record, model: TriadModel | None = None) -> RemainingOffset:
    """Return the mean rate of a corrected record at its first rest, which must be in the first half hour of the record."""
    if record.gyro is None:
        raise InputError("rest: gyroscope readings and their calibration are needed. Omit `offset` rest.")
    stills = _first_rests(record, "correct")
    return rest_offset(record, stills[0], model, stills)


def find_offset(
    record: Record, offset: Literal["rest", "motion"], model: TriadModel | None, still: Still | None = None
) -> RemainingOffset:
    """Return the offset that remains in a corrected record: at a rest, or from its motion and from a rest if there is one.

    The rest is ``still``, or by default the first still phase.
    """
    try:
        rest = find_rest_offset(record, model) if still is None else rest_offset(record, still, model)
    except InputError as error:
        if offset == "rest" or error.numbers.get("missing") != "rest":
            raise
        rest = None
    if offset == "rest" and rest is not None:
        return rest
    from undrift.correction.motion import fit_motion  # imports scipy and a kernel

    return fit_motion(record, rest, model).offset


def rests_from_first(record: Record, what: str) -> tuple[Still, ...]:
    """Return the first still phase of a record, at which every offset "rest" is computed, and the later still phases."""
    stills = _first_rests(record, what)
    later_stills = stills if record.duration_s < FOUND_IN_S else find_still(record).stills
    return stills[0], *(still for still in later_stills if still.start >= stills[0].stop)


def _first_rests(record: Record, what: str) -> tuple[Still, ...]:
    first_s = float(record.time[0])
    head = unpadded(record if record.duration_s < FOUND_IN_S else record.between(first_s, first_s + FOUND_IN_S))
    first = int(record.time.searchsorted(head.time[0]))
    search = find_still(head)
    if not search.stills:
        raise InputError(
            f"{what}: no still phase was found: {search.reason.removeprefix('no still phase: ')}. Give a stretch at rest "
            "(`rest_s`), use `offset` motion, or record with a pause.",
            missing="rest",
        )
    return tuple(replace(still, start=still.start + first, stop=still.stop + first) for still in search.stills)


# ---- covariance (3, 3) of the mean specific force at a rest, (m/s2)^2, by source
#
# ``scatter``      scatter of the mean, with the correlation between samples
# ``sway``         sway of a standing person: the tilt at the end of the rest differs from the mean by the spread of means over
#                  a second beyond white noise. In simulated stance, 3 to 10 s, 97 % of errors are within the 95 % limit
# ``calibration``  E f + d (``record.ForceUncertainty``): f = M (s - o), so that E = dM M^-1 and d = -M do
# ``temperature``  change of offsets and scale factors, for the distance to their reference temperatures
# ``ageing``       change of the offsets since the calibration, and their repeatability from one switch-on to the next
# ``codes``        half a step, uniform, if the readings at rest scatter by less, because their mean then has the same error

# m/s2 after a year: bias repeatability for a year, MTi 10- and 100-series (Xsens MT0605P) [figure not compared]. Other devices
# are assumed to age in the same way, with the square root of the time
AGEING = 0.03
TURN_ON = 5e-4 * STANDARD_GRAVITY  # m/s2, from one switch-on to the next [assumed]
UNKNOWN_K = 5.0  # K, distance for an unknown temperature, within which constant offsets are assumed to apply [assumed]
CLOCK_S = (1e9, 4e9)  # range of seconds since 1970 (a recording with a time outside this range has no date)
UNKNOWN_YEARS = 1.0  # time from calibration to recording, if either has no date [assumed]
_SWAY_S = 1.0  # width of means that are insensitive to accelerations of a body
_ABOVE = 3.0  # limit relative to the variance of means of white noise, which one rest in a hundred reaches


def force_covariances(record: Record, still: Still, force: FloatArray) -> dict[str, FloatArray]:
    """Return the covariance of the mean of a record's specific force at rest, m/s2 (N, 3), source by source."""
    mean, error = force.mean(axis=0), record.accel_uncertainty
    width = max(1, min(round(_SWAY_S * record.sample_rate_hz), len(force) // 4))
    means = np.lib.stride_tricks.sliding_window_view(force, width, axis=0).mean(axis=-1)
    white = np.diff(force, axis=0).var(axis=0) / 2.0 / width
    covariances = {
        "scatter": np.diag([mean_variance(axis) for axis in force.T]),
        "sway": np.diag(np.where(means.var(axis=0) > _ABOVE * white, means.var(axis=0), 0.0)),
    }
    if error is None:
        return covariances
    temp_c = np.nan if record.temp_c is None else float(np.mean(record.temp_c[still.start : still.stop]))
    years = _years_between(error.calibrated, float(record.time[still.start]))
    noise = force.var(axis=0) / np.maximum(error.step, 1e-12) ** 2
    steady = np.exp(-2.0 * np.pi**2 * np.maximum(noise - 0.25, 0.0))  # remaining share with dither
    covariances |= calibrated_force_covariances(error, mean, temp_c, years)
    return covariances | {"codes": np.diag((error.step * steady) ** 2 / 12.0)}


def calibrated_force_covariances(
    error: ForceUncertainty, mean: FloatArray, temp_c: float, years: float
) -> dict[str, FloatArray]:
    """Return the covariance of a specific force (3,), m/s2, for each uncertainty of the calibration, ``years`` after it."""
    design = np.hstack((np.kron(np.eye(3), mean), np.eye(3)))  # (3, 12): E f + d
    offset, scale = error.per_k * [_beyond(temp_c, span) for span in (error.offset_temp_c, error.matrix_temp_c)]
    return {
        "calibration": design @ error.covariance @ design.T,
        "temperature": np.diag(offset**2 + (scale * mean) ** 2),
        "ageing": np.eye(3) * (TURN_ON**2 + AGEING**2 * years),
    }


def _beyond(temp_c: float, span: FloatArray) -> float:
    """Return the distance of a temperature from the range of a table or a constant, K."""
    distance = np.max([span[0] - temp_c, temp_c - span[1], 0.0])
    return UNKNOWN_K if np.isnan(distance) else float(distance)


def _years_between(date: str, recorded_s: float) -> float:
    """Return the years from a date, ISO 8601, to a moment of a recording, whose clock counts seconds since 1970."""
    try:
        when = datetime.fromisoformat(date)
    except ValueError:
        return UNKNOWN_YEARS
    if not CLOCK_S[0] < recorded_s < CLOCK_S[1]:
        return UNKNOWN_YEARS
    since_1970 = (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
    return max(0.0, (recorded_s - since_1970) / (365.25 * 86400.0))
