"""Errors over several recordings, leave-one-out, agreement of two methods, and differences against a margin.

Agreement of methods over n people and k methods, with mean squares MSR of rows, MSC of columns and MSE of the residuals [1]_::

    ICC(2,1) = (MSR - MSE) / (MSR + (k-1) MSE + k (MSC - MSE) / n)      absolute agreement, methods drawn at random
    SEM      = sqrt(max(MSC - MSE, 0) / n + MSE)                        standard error of one measurement
    MDC95    = 1.96 sqrt(2) SEM                                         smallest detectable change

The interval follows from F distributions [2]_. An ICC depends on how much the people differ. Report it together with the limits
[3]_.

A difference d of two mean errors is judged against a margin M by the three-sided test [4]_: better if d <= M is rejected, worse if
d >= -M is rejected, equivalent if d <= -M and d >= M are both rejected (two one-sided tests), otherwise not decidable. One of the
three is true, so the probability of a wrong verdict is at most the level of the test. With m differences, each is tested at level
/ m.

References
----------
.. [1] P. E. Shrout, J. L. Fleiss, "Intraclass correlations: uses in assessing rater reliability", 1979.
.. [2] K. O. McGraw, S. P. Wong, "Forming inferences about some intraclass correlation coefficients", 1996.
.. [3] J. M. Bland, D. G. Altman, "Measuring agreement in method comparison studies", 1999.
.. [4] J. J. Goeman, A. Solari, T. Stijnen, "Three-sided hypothesis testing", 2010.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import HeldOut, leave_one_out
from undrift.calibration.reference_accel import turned_like
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.model import Calibration
from undrift.record import Mounting, Record, Reference
from undrift.shown import Shown
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.expected import OffsetSource
from undrift.validation.trial import Figures, Trial, TrialSettings, of_finite, rows_of, validate_trial

# ---- two methods, or several raters

Interval = tuple[float, float]
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True, kw_only=True)
class BlandAltman:
    """Difference of two methods over subjects."""

    bias: float  # mean of first minus second, unit of the data
    limits: Interval  # bias -+ 1.96 standard deviations: 95 % of single differences
    count: int  # subjects


@dataclass(frozen=True, slots=True, kw_only=True)
class IntraclassCorrelation:
    """ICC(2,1) of single measurements."""

    value: float  # estimate, which can be negative
    interval: Interval  # 95 % interval
    minimal_detectable_change: float  # MDC95, unit of the data


def bland_altman(first: FloatArray, second: FloatArray) -> BlandAltman:
    """Compare two methods over subjects, with one value per subject (n,)."""
    difference = first - second
    bias, reach = float(difference.mean()), Z95 * float(difference.std(ddof=1))
    return BlandAltman(bias=bias, limits=(bias - reach, bias + reach), count=len(difference))


def intraclass_correlation(ratings: FloatArray) -> IntraclassCorrelation:
    """Return ICC(2,1) of ratings (n, k), with its 95 % interval: reference 2, table 7, case 2A."""
    from scipy.special import fdtri

    n, k = ratings.shape
    row_effects, column_effects = (ratings.mean(axis=axis) - ratings.mean() for axis in (1, 0))
    residual = ratings - ratings.mean() - row_effects[:, None] - column_effects
    rows = float(k * (row_effects**2).sum() / (n - 1))
    columns = float(n * (column_effects**2).sum() / (k - 1))
    rest = float((residual**2).sum() / ((n - 1) * (k - 1)))
    denominator = rows + (k - 1) * rest + k * (columns - rest) / n
    value = (rows - rest) / denominator if denominator else float("nan")
    interval = (value, value)
    if rest > 0.0:  # otherwise the methods agree exactly, and the value is 1
        a = k * value / (n * (1.0 - value))
        b = 1.0 + k * value * (n - 1) / (n * (1.0 - value))
        v = (a * columns + b * rest) ** 2 / ((a * columns) ** 2 / (k - 1) + (b * rest) ** 2 / ((n - 1) * (k - 1)))
        low_f, high_f = float(fdtri(n - 1, v, 0.975)), float(fdtri(v, n - 1, 0.975))
        mixed = k * columns + (k * n - k - n) * rest
        interval = (
            n * (rows - low_f * rest) / (low_f * mixed + n * rows),
            n * (high_f * rows - rest) / (mixed + n * high_f * rows),
        )
    mdc95 = Z95 * float(np.sqrt(2.0 * (max(columns - rest, 0.0) / n + rest)))
    return IntraclassCorrelation(value=value, interval=interval, minimal_detectable_change=mdc95)


def mean_interval(values: FloatArray) -> tuple[float, Interval]:
    """Return a mean and Student's 95 % interval, or NaN with too few values."""
    from scipy.special import stdtrit

    nan, n = float("nan"), len(values)
    mean = float(values.mean()) if n else nan
    if n < 2:
        return mean, (nan, nan)
    reach = float(stdtrit(n - 1, 0.975) * values.std(ddof=1) / np.sqrt(n))
    return mean, (mean - reach, mean + reach)


# ---- a difference against a margin

MIN_PEOPLE = 3  # smallest number of people for a verdict
LEVEL = 0.05  # significance level of all differences that are tested together
MIN_PEOPLE_FOR_AGREEMENT = 10  # with fewer people, a limit of agreement is less certain than the limits are wide
Verdict95 = Literal["better", "equivalent", "worse", "not decidable"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedDifference:
    """A mean error compared with another mean error over the same people."""

    difference: float  # other mean error minus this mean error, unit of the data (positive if this error is smaller)
    interval: Interval  # 95 % interval, not corrected for the number of tests
    verdict: Verdict95  # decision against a margin, at 5 % over all tests


def decide_between(errors: FloatArray, others: FloatArray, *, margin: float, tests: int = 1) -> PairedDifference:
    """Test errors (n,) against other errors of the same people, three or more. ``tests`` differences are tested together."""
    from scipy.special import stdtrit

    n = len(errors)
    difference, interval = mean_interval(others - errors)
    uncertainty = (others - errors).std(ddof=1) / np.sqrt(n)
    # better and worse: the two tails of one test; equivalent: two one-sided tests
    two_sided, one_sided = (float(stdtrit(n - 1, 1.0 - p / tests) * uncertainty) for p in (0.5 * LEVEL, LEVEL))
    verdict: Verdict95 = "not decidable"
    if difference - two_sided > margin:
        verdict = "better"
    elif difference + two_sided < -margin:
        verdict = "worse"
    elif abs(difference) + one_sided < margin:
        verdict = "equivalent"
    return PairedDifference(difference=difference, interval=interval, verdict=verdict)


# ---- several recordings

ONE_DEVICE_DPS = 0.1  # BROAD: one warm device repeats its reading at rest within 0.01-0.02 deg/s over a session
MOUNTING_ABOVE = 1.0 * RADIAN_PER_DEGREE  # mounting angle from which a recording's readings are turned back, rad

Pair = tuple[Record, Reference]
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation(Shown):
    """Recordings compared with their references."""

    trials: tuple[Trial, ...]  # one trial per recording
    mean: Figures  # mean and median over the trials, without gaps
    median: Figures
    held_out: tuple[HeldOut, ...] = ()  # fit that corrected each recording, in leave-one-out

    @classmethod
    def of(cls, trials: Sequence[Trial], held_out: tuple[HeldOut, ...] = ()) -> "Validation":
        """Return trials with their mean and median."""
        columns = {f.name: np.array([getattr(trial.figures, f.name) for trial in trials]) for f in fields(Figures)}
        mean, median = (
            Figures(**{name: of_finite(summary, values) for name, values in columns.items()})
            for summary in (np.mean, np.median)
        )
        return cls(trials=tuple(trials), mean=mean, median=median, held_out=held_out)

    def facts(self) -> dict[str, str]:
        """Return the rows of the table of values: name, and value with unit."""
        totals = {trial.recording: f"total {trial.figures.rmse_total_deg:.2f} deg rms" for trial in self.trials}
        return totals | {f"mean {name}": text for name, text in rows_of(self.mean).items()}


def validate_trials(
    pairs: Sequence[Pair],
    *,
    calibrations: Sequence[Calibration | None] = (None,),
    settings: TrialSettings = TrialSettings(),
    names: Sequence[str] = (),
    progress: Progress = lambda what, share: None,
) -> Validation:
    """Compare several recordings with their references.

    Parameters
    ----------
    pairs : sequence of (Record, Reference)
        One or more.
    calibrations : sequence of Calibration or None
        One for all, or one for each.
    settings : TrialSettings
        Settings of ``validate_trial``.
    names : sequence of str
        Name of each trial, by default the name of its reference.
    progress : callable
        Called with a description of the work and the completed share.

    Returns
    -------
    Validation
        Trials, mean and median.

    Raises
    ------
    InputError
        The numbers of recordings, calibrations and names do not match. ``validate_trial`` lists further causes.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> result = undrift.validate_trials([(trial.record, trial.reference)], calibrations=[calibration])
    >>> len(result.trials)
    1
    """
    if not pairs or len(calibrations) not in (1, len(pairs)) or len(names) not in (0, len(pairs)):
        raise InputError(
            f"validate: the numbers of recordings, calibrations and names do not match, got {len(pairs)} recordings, "
            f"{len(calibrations)} calibrations, {len(names)} names. Provide one calibration or one per recording, and all names "
            "or none."
        )
    calibrations = [*calibrations] * (len(pairs) if len(calibrations) == 1 else 1)
    trials = list[Trial]()
    for k, (pair, calibration, name) in enumerate(zip(pairs, calibrations, names or [""] * len(pairs), strict=True)):
        progress(f"aligning and integrating recording {k + 1} of {len(pairs)}", k / len(pairs))
        trials.append(validate_trial(*pair, calibration=calibration, settings=settings, name=name))
    return Validation.of(trials)


def validate_leave_one_out(
    pairs: Sequence[Pair],
    *,
    settings: TrialSettings = TrialSettings(),
    mounting: Mounting = "each",
    names: Sequence[str] = (),
    progress: Progress = lambda what, share: None,
) -> Validation:
    """Compare recordings of a device, each corrected with a gyroscope fit to the references of the others.

    From the omitted recording, the fit uses only the rest before the motion, not the reference.

    Parameters
    ----------
    pairs : sequence of (Record, Reference)
        Two or more recordings of one device.
    settings : TrialSettings
        Settings of ``validate_trial``. The fit contains the offset, so the only value of ``offset`` with an effect is "motion".
    mounting : str
        "each" if the device was put on the reference body again for each recording, or "one".
    names : sequence of str
        Name of each trial, by default the name of its reference.
    progress : callable
        Called with a description of the work and the completed share, 0 to 1.

    Returns
    -------
    Validation
        Trials, mean, median, and the fits.

    Raises
    ------
    InputError
        There are fewer than two recordings. ``leave_one_out`` and ``validate_trial`` list further causes.
    """
    calibrations, fits = calibrations_by_others(pairs, settings=settings, mounting=mounting, progress=progress)
    shown = settings.offset == "motion"
    settings = replace(settings, offset="motion" if shown else "none")
    if mounting == "each":
        settings = replace(settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
    source = OffsetSource(rest="shown" if shown else "own", in_motion=True, recordings=len(pairs) - 1)
    findings = _check_one_device(fits)
    trials = [
        validate_trial(*pair, calibration=calibration, settings=settings, name=name, source=source)
        for pair, calibration, name in zip(pairs, calibrations, names or [""] * len(pairs), strict=True)
    ]
    return Validation.of([replace(trial, findings=(*trial.findings, *findings)) for trial in trials], fits)


def calibrations_by_others(
    pairs: Sequence[Pair],
    *,
    settings: TrialSettings = TrialSettings(),
    mounting: Mounting = "each",
    progress: Progress = lambda what, share: None,
) -> tuple[tuple[Calibration, ...], tuple[HeldOut, ...]]:
    """Return a calibration for each recording, from the other references and the offset of its own rest, and the fits."""
    records, references = [record for record, _ in pairs], [reference for _, reference in pairs]
    for (i, first), (k, second) in combinations(enumerate(record.gyro for record in records), 2):
        if first is not None and second is not None and np.array_equal(first, second, equal_nan=True):
            raise InputError(
                f"leave-one-out: recording {k + 1} has the same readings as recording {i + 1}. List each recording once."
            )
    adc = device_adc(records)
    fits = leave_one_out(
        records, references, mounting=mounting, adc=adc, longest_lag_s=settings.longest_lag_s, progress=progress
    )
    calibrations = (
        Calibration(
            device=record.device,
            reference_temp_c=float("nan"),
            gravity_m_s2=STANDARD_GRAVITY,
            gyro=held_out.model,
            accel=None if record.accel is None else turned_like(held_out.model, record.accel_unit),
            adc=adc,
            verdict=held_out.fit.triad.verdict,
        )
        for record, held_out in zip(records, fits, strict=True)
    )
    return tuple(calibrations), fits


def _check_one_device(fits: Sequence[HeldOut]) -> tuple[Finding, ...]:
    """Return a finding if the readings at rest are not plausible for a single device."""
    rest = np.array([h.model.offset - h.fit.motion_offset * (h.model.moving_offset is None) for h in fits])
    spread = float(np.linalg.norm(fits[0].model.matrix @ np.ptp(rest, axis=0))) / RADIAN_PER_DEGREE
    if spread <= ONE_DEVICE_DPS:
        return ()
    sentence = f"Readings at rest are up to {spread:.2g} deg/s apart (limit {ONE_DEVICE_DPS:g} deg/s): these are several devices, "
    sentence += "or one that was not warmed up."
    action = "Use leave-one-out for recordings of a single device only."
    return (finding("validate.devices_apart", "warn", sentence, action),)
