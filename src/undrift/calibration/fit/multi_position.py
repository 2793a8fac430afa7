"""Calibration without equipment: hold the device still in many poses, turn it by hand between them.

::

    |M_a (u - o_a)| = g                  accelerometer, over the still poses    multi_position_accel.py
    C(M_g, o_g) n_before = n_after       gyroscopes, over the moves between     multi_position_gyro.py

Where a still begins and ends is a choice: the variance of the accelerometer over a sliding window, as the length of the
vector of its three variances, must stay below a multiple of what it is at rest [1]_. Several multiples are tried:

- ``coverage``: of the multiples that keep nine tenths of the different poses, the one that leaves a corrected reading least
  uncertain. A low threshold loses poses, a high one lets motion in, and both show in that figure.
- ``published``: the one with the smallest summed cost over the first second of each still, the opening rest giving the level
  and the gyroscopes' offset [1]_. A summed cost falls with every pose that is lost, so it may keep few poses.

References
----------
.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU calibration without external
   equipments", ICRA 2014, section IV.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.full_range import check_range
from undrift.calibration.fit.multi_position_accel import check_count, judged
from undrift.calibration.fit.multi_position_gyro import fit_gyro_between_stills
from undrift.calibration.fit.norm import NormFit, fit_norm
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.fit.still_variance import StillVariance, still_variance
from undrift.calibration.model import Verdict
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.record import Record
from undrift.session import Session, Still

SAME_POSE_DEG = 10.0  # directions nearer to each other than this count as one pose
Rule = Literal["coverage", "published"]
GyroPolicy = Literal["if_observable", "required", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiPositionSettings:
    """How stills are found and what is fitted.

    Parameters
    ----------
    window_s : float
        Length of the sliding window, s; each end of a still loses half of it.
    min_still_s : float
        Shortest still, s, after that loss.
    multiples : tuple of float
        Thresholds to try, in units of the level at rest.
    rest_s : float or None
        Length of an opening rest that gives the level at rest, s; None takes the quietest twentieth of all windows.
    rule : str
        coverage or published: how the threshold is chosen, and how poses and turns weigh.
    cross_axis : bool
        False fits the accelerometer's scale and offset alone: for poses on the faces.
    gyro : str
        if_observable leaves the gyroscopes out, with the reason, where the moves do not show them; required raises; none.
    """

    window_s: float = 1.0
    min_still_s: float = 1.0
    multiples: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 15.0, 20.0, 30.0, 50.0)
    rest_s: float | None = None
    rule: Rule = "coverage"
    cross_axis: bool = True
    gyro: GyroPolicy = "if_observable"

    @classmethod
    def published(cls, rest_s: float = 50.0) -> "MultiPositionSettings":
        """Return the settings of the published demonstration.

        Parameters
        ----------
        rest_s : float
            Opening rest, s.

        Returns
        -------
        MultiPositionSettings
            Multiples 2 to 10, rule ``published``.
        """
        return cls(multiples=tuple(float(m) for m in range(2, 11)), rest_s=rest_s, rule="published")


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdTrial:
    """One threshold and what came of it.

    Parameters
    ----------
    multiple : float
        Of the level at rest; NaN where the stills were stated.
    stills : int
        Still phases found.
    poses : int
        Different poses among them, by direction.
    cost : float
        Half the sum of squared residuals, (m/s2)^2; infinite where nothing could be fitted.
    rms_residual : float
        m/s2.
    uncertainty : float
        Standard uncertainty of a corrected reading of gravity, rms over all directions, m/s2.
    """

    multiple: float
    stills: int
    poses: int
    cost: float
    rms_residual: float
    uncertainty: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """Accelerometer and, where the moves show them, gyroscopes.

    Parameters
    ----------
    accel : TriadFit
        Raw to m/s2.
    gyro : TriadFit or None
        Raw to rad/s in the accelerometer's axes.
    stills : tuple of Still
        Those that were used.
    threshold : float
        Threshold on the windowed variance, accelerometer unit squared; NaN where the stills were stated; of the first record.
    trials : tuple of ThresholdTrial
        All thresholds tried.
    verdict : Verdict
        Of both, and why the gyroscopes are missing.
    """

    accel: TriadFit
    gyro: TriadFit | None
    stills: tuple[Still, ...]
    threshold: float
    trials: tuple[ThresholdTrial, ...]
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Attempt:
    trial: ThresholdTrial
    stills: tuple[Still, ...]
    reading: FloatArray
    fit: NormFit | None


def fit_multi_position(
    record: Record,
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    settings: MultiPositionSettings = MultiPositionSettings(),
) -> MultiPositionFit:
    """Calibrate from one recording of free poses and turns between them.

    Parameters
    ----------
    record : Record
        Raw readings, any unit.
    gravity : float
        Local gravity, m/s2.
    stills : sequence of Still, optional
        Stated still phases; None finds them.
    settings : MultiPositionSettings
        How.

    Returns
    -------
    MultiPositionFit
        With all thresholds tried.

    Raises
    ------
    InputError
        No accelerometer readings, a record shorter than its window.
    NotObservable
        Too few poses, or poses or moves that leave a parameter unseen.
    Implausible
        Readings that are not of the size of gravity, gyroscope axes that mirror space, a gain that speaks of a wrong unit,
        range or sample rate.
    PoorFit
        No solution.
    """
    return _fit((record,), None if stills is None else tuple(stills), gravity, settings)


def fit_multi_position_session(
    session: Session, *, settings: MultiPositionSettings = MultiPositionSettings()
) -> MultiPositionFit:
    """Calibrate from all recordings of a session together; a recording may be a single pose.

    Parameters
    ----------
    session : Session
        Its stated stills are used, faces or free poses; without any they are found in every recording.
    settings : MultiPositionSettings
        How.

    Returns
    -------
    MultiPositionFit
        Poses pooled over the recordings; moves only within one.

    Raises
    ------
    InputError
        No accelerometer readings, units that differ, a record shorter than its window.
    NotObservable
        Too few poses, or poses or moves that leave a parameter unseen.
    """
    return _fit(session.records, session.stills or None, session.gravity_m_s2, settings)


def _fit(
    records: tuple[Record, ...], stated: tuple[Still, ...] | None, gravity: float, settings: MultiPositionSettings
) -> MultiPositionFit:
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
    levels = [still_variance(r, window_s=settings.window_s, rest_s=settings.rest_s) for r in records]
    shortest = [max(2, round(settings.min_still_s * r.sample_rate_hz)) for r in records]
    if stated is not None:
        attempts = [_attempt(levels, stated, np.nan, gravity, settings, shortest)]
    else:
        attempts = [
            _attempt(levels, _stills(levels, m, shortest), m, gravity, settings, shortest) for m in settings.multiples
        ]
    chosen = _choose(attempts, settings)
    if chosen.fit is None:
        check_count(chosen.reading, 9 if settings.cross_axis else 6, known_noise=True)
        raise PoorFit(
            "multi-position: wanted poses of one length, got none that a linear sensor could give; check the columns"
        )
    check_range([levels[s.recording].values[s.start : s.stop] for s in chosen.stills], "accelerometer in still poses")
    accel = judged(chosen.fit, chosen.reading, records[0].accel_unit)
    found = stated is None and settings.rule == "coverage"
    cores = _cores(levels, chosen.stills, shortest) if found else chosen.stills
    gyro, missing = _gyro(records, chosen.stills, accel, settings, cores)
    verdict = accel.verdict if gyro is None else accel.verdict.also(gyro.verdict)
    return MultiPositionFit(
        accel=accel,
        gyro=gyro,
        stills=chosen.stills,
        threshold=chosen.trial.multiple * levels[0].at_rest,
        trials=tuple(a.trial for a in attempts),
        verdict=verdict.also(Verdict(status="marginal", reasons=(missing,))) if missing else verdict,
    )


def _stills(levels: list[StillVariance], multiple: float, shortest: list[int]) -> tuple[Still, ...]:
    return tuple(
        Still(start=start, stop=stop, recording=number)
        for number, (level, least) in enumerate(zip(levels, shortest, strict=True))
        for start, stop in level.below(multiple * level.at_rest, least)
    )


def _cores(levels: list[StillVariance], stills: tuple[Still, ...], shortest: list[int]) -> tuple[Still, ...]:
    """Return the part of each still in which the gyroscopes are quiet, in the same order."""
    cores: list[Still] = []
    for number, (level, least) in enumerate(zip(levels, shortest, strict=True)):
        own = [(s.start, s.stop) for s in stills if s.recording == number]
        cores += [Still(start=start, stop=stop, recording=number) for start, stop in level.cores(own, least)]
    return tuple(cores)


def _attempt(
    levels: list[StillVariance],
    stills: tuple[Still, ...],
    multiple: float,
    gravity: float,
    settings: MultiPositionSettings,
    shortest: list[int],
) -> _Attempt:
    variances: FloatArray | None = None
    if settings.rule == "published" and stills:
        reading = np.concatenate(
            [levels[s.recording].values[s.start : s.start + shortest[s.recording]] for s in stills]
        )
    else:
        reading, variances = _poses(levels, stills)
    nothing = ThresholdTrial(
        multiple=multiple, stills=len(stills), poses=0, cost=np.inf, rms_residual=np.inf, uncertainty=np.inf
    )
    if len(stills) < (9 if settings.cross_axis else 6) or not np.ptp(reading, axis=0).any():
        return _Attempt(trial=nothing, stills=stills, reading=reading, fit=None)
    try:
        fit = fit_norm(reading, gravity=gravity, variances=variances, cross_axis=settings.cross_axis)
    except PoorFit:
        return _Attempt(trial=nothing, stills=stills, reading=reading, fit=None)
    means = reading if variances is not None else _poses(levels, stills)[0]
    square = float(fit.residuals @ fit.residuals)
    trial = ThresholdTrial(
        multiple=multiple,
        stills=len(stills),
        poses=_different(fit.corrected(means)),
        cost=0.5 * square,
        rms_residual=float(np.sqrt(square / len(reading))),
        uncertainty=fit.uncertainty,
    )
    return _Attempt(trial=trial, stills=stills, reading=reading, fit=fit)


def _poses(levels: list[StillVariance], stills: tuple[Still, ...]) -> tuple[FloatArray, FloatArray]:
    """Return mean readings and their variances, the noise pooled over the stills of a recording."""
    means, variances = np.zeros((len(stills), 3)), np.zeros((len(stills), 3))
    for number, level in enumerate(levels):
        rows = [k for k, s in enumerate(stills) if s.recording == number]
        if rows:
            means[rows], variances[rows] = level.moments([stills[k] for k in rows])
    return means, variances


def _different(force: FloatArray) -> int:
    """Return how many directions differ from all earlier ones."""
    n = force / np.linalg.norm(force, axis=1)[:, None]
    near = n @ n.T > np.cos(np.radians(SAME_POSE_DEG))
    kept: list[int] = []
    for k in range(len(n)):
        if not near[k, kept].any():
            kept.append(k)
    return len(kept)


def _choose(attempts: list[_Attempt], settings: MultiPositionSettings) -> _Attempt:
    fitted = [a for a in attempts if a.fit is not None]
    if not fitted:
        return max(attempts, key=lambda a: len(a.stills))
    if settings.rule == "published":
        return min(fitted, key=lambda a: a.trial.cost)
    # Thresholds that let motion in are far less certain; their false poses must not set the count to be reached.
    least = min(a.trial.uncertainty for a in fitted)
    most = max(a.trial.poses for a in fitted if a.trial.uncertainty <= 2.0 * least or not np.isfinite(least))
    covered = [a for a in fitted if a.trial.poses >= 0.9 * most]
    return min(covered, key=lambda a: a.trial.uncertainty)


def _gyro(
    records: tuple[Record, ...],
    stills: tuple[Still, ...],
    accel: TriadFit,
    settings: MultiPositionSettings,
    cores: tuple[Still, ...],
) -> tuple[TriadFit | None, str]:
    if settings.gyro == "none" or (settings.gyro == "if_observable" and any(r.gyro is None for r in records)):
        return None, ""
    published = settings.rule == "published"
    try:
        fit = fit_gyro_between_stills(
            records,
            stills,
            accel.model,
            cores=cores,
            weights="equal" if published else "noise",
            rest_s=settings.rest_s if published else None,
        )
    except NotObservable as error:
        if settings.gyro == "required":
            raise
        return None, str(error)
    return fit, ""
