"""Lag: how late the record's samples are, against the poses of a reference, to a fraction of a sample.

With w the body rate of the reference and u the readings, the model over all neighbouring poses, both sides averaged over
the same stretches, is::

    w(t) = A u(t + lag) + c                    A (3 x 3) and c free: scale, mounting and offset do not disturb the lag

First the length of u is correlated with the length of w at every lag of a wide search: no mounting is needed for that. Then
Gauss-Newton on A, c and lag together: the change of u with time is one more column of the design.

A reading is the rate at its time stamp. Where each sample instead holds over the interval before it, as in strapdown, the
lag that is left is half a sample shorter.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import AlignmentError, InputError
from undrift.record import Record, Reference
from undrift.sync.coarse import coarse_lag
from undrift.sync.native import native_poses
from undrift.sync.rates import LONGEST_STEP, PoseRates, RunningIntegral, box_sums, pose_rates

_STEPS = 12  # Gauss-Newton steps at most; the last ones move the lag by less than a microsecond
_BLOCK_S = 0.5  # residuals this far apart count as independent


@dataclass(frozen=True, slots=True, kw_only=True)
class LagSettings:
    """How the lag is looked for.

    Parameters
    ----------
    longest_lag_s : float
        Half-width of the search, s.
    average_s : float
        Both sides are averaged over this long, s. Longer takes more pose noise away and blurs fast motion.
    least_correlation : float
        Between the rates after alignment; less means that the two did not see the same motion.
    """

    longest_lag_s: float = 5.0
    average_s: float = 0.05
    least_correlation: float = 0.7


# Steps of a stepper or a servo ring; one axis tells one direction of the readings, the others are noise.
AXIS_SETTINGS = LagSettings(average_s=0.1)
_ONE_AXIS, _THREE_AXES = 0.05, 1e-6  # least singular value kept, of the largest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lag:
    """How the clock of a record stands against that of a reference.

    Parameters
    ----------
    seconds : float
        A reading stamped t was true at t - seconds on the reference's clock, s.
    standard_uncertainty : float
        Of ``seconds``, s, from half-second blocks of residuals.
    method : str
        "vector rate" or "axis rate".
    correlation_before, correlation_after : float
        Multiple correlation between reference rate and readings without a shift and with it; 0 where a shift of 0
        leaves no overlap.
    matrix : array, shape (A, 3)
        Reference rate per reading: scale and mounting as seen on the way, rad/s per unit of the readings.
    constant : array, shape (A,)
        Reference rate at zero reading, rad/s.
    residual_rms : float
        Between the averaged rates after alignment, rad/s.
    """

    seconds: float
    standard_uncertainty: float
    method: str
    correlation_before: float
    correlation_after: float
    matrix: FloatArray
    constant: FloatArray
    residual_rms: float


def find_lag(record: Record, reference: Reference, settings: LagSettings = LagSettings()) -> Lag:
    """Find how late the readings of a gyroscope are against poses of the same body.

    Parameters
    ----------
    record : Record
        With a gyroscope, any unit; gaps allowed.
    reference : Reference
        Poses on their own clock; gaps allowed.
    settings : LagSettings
        Search width, averaging, least correlation.

    Returns
    -------
    Lag
        To a fraction of a sample, with uncertainty.

    Raises
    ------
    InputError
        The record has no gyroscope.
    AlignmentError
        Too little overlap, or no common motion.
    """
    if record.gyro is None:
        raise InputError("lag: wanted a record with a gyroscope, got none; map its columns")
    rates = pose_rates(native_poses(reference))
    return _lag_of(record.time, record.gyro, rates, settings, "vector rate")


def find_axis_lag(record: Record, time: FloatArray, angle: FloatArray, settings: LagSettings = AXIS_SETTINGS) -> Lag:
    """Find how late the readings of a gyroscope are against the angle of a table with one axis.

    Parameters
    ----------
    record : Record
        With a gyroscope, any unit, mounted anyhow on the table.
    time : array, shape (M,)
        s, on the table's clock, increasing.
    angle : array, shape (M,)
        rad, as commanded or as an encoder saw it, not wrapped; NaN is a gap.
    settings : LagSettings
        Search width, averaging, least correlation.

    Returns
    -------
    Lag
        ``matrix`` has one row: table rate per reading.

    Raises
    ------
    InputError
        The record has no gyroscope.
    AlignmentError
        Too little overlap, or no common motion.
    """
    if record.gyro is None:
        raise InputError("lag: wanted a record with a gyroscope, got none; map its columns")
    step = np.diff(time)
    valid = np.isfinite(np.diff(angle)) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid, np.diff(angle) / step, 0.0)[:, None]
    rates = PoseRates(start=time[:-1], stop=time[1:], rate=rate, valid=valid)
    return _lag_of(record.time, record.gyro, rates, settings, "axis rate")


def _lag_of(time: FloatArray, gyro: FloatArray, rates: PoseRates, settings: LagSettings, method: str) -> Lag:
    start = coarse_lag(time, gyro, rates, settings.longest_lag_s)
    known = RunningIntegral(time, gyro)
    wanted = _Averages.of(rates, settings.average_s)
    before, _ = _aligned(known, wanted, 0.0)
    lag, fit = start, None
    for _ in range(_STEPS):
        fit, step = _aligned(known, wanted, lag)
        if fit is None or not abs(step) < settings.longest_lag_s:
            break
        limit = settings.average_s  # the linear model reaches about one averaging length
        step = float(np.clip(step, -limit, limit))
        lag += step
        if abs(step) < 1e-7:
            break
    correlation = 0.0 if fit is None else fit.correlation
    if fit is None or correlation < settings.least_correlation or abs(lag) > settings.longest_lag_s + 1.0:
        raise AlignmentError(
            f"lag: wanted a correlation of {settings.least_correlation:g} or more between the record's rates and the "
            f"reference's, got {correlation:.2f} within {settings.longest_lag_s:g} s: no common motion; check that the two "
            "files belong together, or widen longest_lag_s (--longest-lag-s)",
            correlation=correlation,
        )
    return Lag(
        seconds=lag,
        standard_uncertainty=fit.standard_uncertainty,
        method=method,
        correlation_before=0.0 if before is None else before.correlation,
        correlation_after=correlation,
        matrix=fit.matrix,
        constant=fit.constant,
        residual_rms=fit.residual_rms,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Averages:
    """Reference rates averaged over runs of neighbouring steps: start, stop (K,), s; rate (K, A), rad/s; run length."""

    start: FloatArray
    stop: FloatArray
    rate: FloatArray

    @classmethod
    def of(cls, rates: PoseRates, average_s: float) -> "_Averages":
        step = rates.stop - rates.start
        width = max(1, round(average_s / float(np.median(step))))
        turn = box_sums(rates.rate * step[:, None], width)
        whole = box_sums(rates.valid[:, None].astype(float), width)[:, 0] > width - 0.5
        start, stop = rates.start[: len(whole)][whole], rates.stop[width - 1 :][whole]
        return cls(start=start, stop=stop, rate=turn[whole] / (stop - start)[:, None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """A, c, correlation, residual rms and the lag's standard uncertainty at one lag."""

    matrix: FloatArray
    constant: FloatArray
    correlation: float
    residual_rms: float
    standard_uncertainty: float


def _aligned(known: RunningIntegral, wanted: _Averages, lag: float) -> tuple[_Fit | None, float]:
    """Fit A and c at a lag; return them with the step of the lag that reduces the residual most."""
    mean, inside = known.mean(wanted.start + lag, wanted.stop + lag)
    if inside.sum() < 30:
        return None, 0.0
    width = 0.25 * float(np.median(wanted.stop - wanted.start))
    late, late_in = known.mean(wanted.start + lag + width, wanted.stop + lag + width)
    early, early_in = known.mean(wanted.start + lag - width, wanted.stop + lag - width)
    inside &= late_in & early_in
    u, w = mean[inside], wanted.rate[inside]
    slope = (late[inside] - early[inside]) / (2.0 * width)
    centre_u, centre_w = u.mean(axis=0), w.mean(axis=0)
    rcond = _ONE_AXIS if w.shape[1] == 1 else _THREE_AXES
    a, *_ = np.linalg.lstsq(u - centre_u, w - centre_w, rcond=rcond)
    residual = w - centre_w - (u - centre_u) @ a
    power = float(((w - centre_w) ** 2).sum())
    unexplained = float((residual**2).sum())
    if not power > 0.0:
        return None, 0.0
    step, uncertainty = _lag_step(slope @ a, u - centre_u, residual, wanted.start[inside])
    fit = _Fit(
        matrix=a.T,
        constant=centre_w - a.T @ centre_u,
        correlation=float(np.sqrt(max(0.0, 1.0 - unexplained / power))),
        residual_rms=float(np.sqrt(unexplained / residual.size)),
        standard_uncertainty=uncertainty,
    )
    return fit, step


def _lag_step(slope: FloatArray, u: FloatArray, residual: FloatArray, t: FloatArray) -> tuple[float, float]:
    # The column of the lag, cleared of what A and c could explain; one equation is left: step = sum(s r) / sum(s s).
    slope = slope - slope.mean(axis=0)
    clear = slope - u @ np.linalg.lstsq(u, slope, rcond=1e-6)[0]
    square = float((clear * clear).sum())
    if not square > 0.0:
        return 0.0, float("inf")
    step = float((clear * residual).sum()) / square
    score = (clear * (residual - step * clear)).sum(axis=1)
    block: BoolArray = np.concatenate(([True], np.diff(np.floor(t / _BLOCK_S)) > 0.0))
    sums = np.add.reduceat(score, np.flatnonzero(block))
    return step, float(np.sqrt((sums**2).sum()) / square)
