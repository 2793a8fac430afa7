"""Errors over several recordings, leave-one-out, agreement of two methods, and differences against a margin.

Agreement of methods over n people and k methods, with mean squares MSR of rows, MSC of columns and MSE of the rest [1]_::

    ICC(2,1) = (MSR - MSE) / (MSR + (k-1) MSE + k (MSC - MSE) / n)      absolute agreement, methods drawn from many
    SEM      = sqrt(max(MSC - MSE, 0) / n + MSE)                        standard error of one measurement
    MDC95    = 1.96 sqrt(2) SEM                                         smallest detectable change

The interval follows from F distributions [2]_. An ICC depends on how much the people differ: report it with the limits [3]_.

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
from undrift.base.summary import Shown
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import HeldOut, ReferenceSettings, leave_one_out
from undrift.calibration.reference_accel import turned_like
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.expected import OffsetSource
from undrift.validation.trial import TRIAL_SETTINGS, Figures, Trial, TrialSettings, of_known, rows_of, validate_trial

# ---- two methods, or several raters

Interval = tuple[float, float]
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True, kw_only=True)
class BlandAltman:
    """Difference of two methods over subjects."""

    bias: float  # mean of first minus second, unit of the data
    standard_deviation: float  # of the differences
    limits: Interval  # bias -+ 1.96 standard deviations: 95 % of single differences
    count: int  # subjects


@dataclass(frozen=True, slots=True, kw_only=True)
class IntraclassCorrelation:
    """ICC(2,1) of single measurements, with its 95 % interval."""

    value: float  # estimate, which can be negative
    interval: Interval  # 95 % confidence interval
    standard_error_of_measurement: float  # SEM, unit of the data
    minimal_detectable_change: float  # MDC95, unit of the data


def bland_altman(first: FloatArray, second: FloatArray) -> BlandAltman:
    """Compare two methods over subjects, one value each (n,)."""
    table = _table(np.stack((first, second), axis=1) if len(first) == len(second) else np.empty((0, 2)))
    difference = table[:, 0] - table[:, 1]
    bias, sd = float(difference.mean()), float(difference.std(ddof=1))
    limits = (bias - Z95 * sd, bias + Z95 * sd)
    return BlandAltman(bias=bias, standard_deviation=sd, limits=limits, count=len(difference))


def intraclass_correlation(ratings: FloatArray) -> IntraclassCorrelation:
    """Return ICC(2,1) of ratings (n, k), with its 95 % interval."""
    table = _table(ratings)
    n, k = table.shape
    rows, columns, rest = _mean_squares(table)
    bottom = rows + (k - 1) * rest + k * (columns - rest) / n
    value = (rows - rest) / bottom if bottom else float("nan")
    sem = float(np.sqrt(max(columns - rest, 0.0) / n + rest))
    return IntraclassCorrelation(
        value=value,
        interval=_interval(value, n, k, rows=rows, columns=columns, rest=rest),
        standard_error_of_measurement=sem,
        minimal_detectable_change=Z95 * float(np.sqrt(2.0)) * sem,
    )


def _table(ratings: FloatArray) -> FloatArray:
    table = np.asarray(ratings, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] < 3 or table.shape[1] < 2 or not np.isfinite(table).all():
        raise InputError(
            f"agreement: at least three subjects and two methods without gaps are required, got shape {table.shape}. "
            "Provide a value per subject and method."
        )
    return table


def _mean_squares(table: FloatArray) -> tuple[float, float, float]:
    n, k = table.shape
    mean = table.mean()
    row_effects, column_effects = table.mean(axis=1), table.mean(axis=0)
    rest = table - row_effects[:, None] - column_effects + mean
    return (
        float(k * ((row_effects - mean) ** 2).sum() / (n - 1)),
        float(n * ((column_effects - mean) ** 2).sum() / (k - 1)),
        float((rest**2).sum() / ((n - 1) * (k - 1))),
    )


def _interval(value: float, n: int, k: int, *, rows: float, columns: float, rest: float) -> Interval:
    """Return the 95 % interval of ICC(2,1): reference 2, table 7, case 2A."""
    from scipy.special import fdtri

    if not np.isfinite(value) or value >= 1.0 or rest <= 0.0:
        return (value, value)
    a = k * value / (n * (1.0 - value))
    b = 1.0 + k * value * (n - 1) / (n * (1.0 - value))
    v = (a * columns + b * rest) ** 2 / ((a * columns) ** 2 / (k - 1) + (b * rest) ** 2 / ((n - 1) * (k - 1)))
    low_f, high_f = float(fdtri(n - 1, v, 0.975)), float(fdtri(v, n - 1, 0.975))
    mixed = k * columns + (k * n - k - n) * rest
    low = n * (rows - low_f * rest) / (low_f * mixed + n * rows)
    high = n * (high_f * rows - rest) / (mixed + n * high_f * rows)
    return (low, high)


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

MIN_PEOPLE = 3  # of a verdict
MIN_PEOPLE_FOR_AGREEMENT = 10  # with fewer, a limit of agreement is less certain than the limits are wide
Verdict95 = Literal["better", "equivalent", "worse", "not decidable"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedDifference:
    """A mean error compared with another one over the same people."""

    difference: float  # other mean error minus this one, unit of the data: positive if this one is better
    interval: Interval  # 95 %, not corrected for the number of tests
    margin: float  # smallest difference that matters
    p_better: float  # p values of the three hypotheses, after Bonferroni
    p_equivalent: float
    p_worse: float
    verdict: Verdict95


def three_sided(difference: float, uncertainty: float, dof: int, *, margin: float) -> tuple[float, float, float]:
    """Return the p values of better, equivalent and worse for a difference and its standard uncertainty."""
    from scipy.special import stdtr

    if uncertainty == 0.0:
        return float(difference <= margin), float(abs(difference) >= margin), float(difference >= -margin)
    above, below = ((sign * difference - margin) / uncertainty for sign in (1.0, -1.0))
    # better and worse are the two tails of one test, so each is doubled
    better, worse = (min(2.0 * float(stdtr(dof, -t)), 1.0) for t in (above, below))
    return better, float(max(stdtr(dof, above), stdtr(dof, below))), worse


def decide_between(
    errors: FloatArray, others: FloatArray, *, margin: float, level: float = 0.05, tests: int = 1
) -> PairedDifference:
    """Test errors (n,) against other errors (n,) of the same people. ``tests`` is the number of differences tested together."""
    if len(errors) < MIN_PEOPLE or len(errors) != len(others):
        raise InputError(
            f"comparison: expected the errors of {MIN_PEOPLE} people or more, got {len(errors)} and {len(others)}. Add people."
        )
    mean, interval = mean_interval(others - errors)
    uncertainty = float((others - errors).std(ddof=1)) / float(np.sqrt(len(errors)))
    better, equivalent, worse = (
        min(tests * p, 1.0) for p in three_sided(mean, uncertainty, len(errors) - 1, margin=margin)
    )
    verdicts: dict[Verdict95, float] = {"better": better, "equivalent": equivalent, "worse": worse}
    return PairedDifference(
        difference=mean,
        interval=interval,
        margin=margin,
        p_better=better,
        p_equivalent=equivalent,
        p_worse=worse,
        verdict=next((name for name, p in verdicts.items() if p <= level), "not decidable"),
    )


# ---- several recordings

ONE_DEVICE_DPS = 0.1  # BROAD: one warm device repeats its reading at rest within 0.01-0.02 deg/s over a session
MOUNTING_ABOVE = 1.0 * RADIAN_PER_DEGREE  # a recording in a mounting of its own is turned back from here on, rad
REFERENCE_SETTINGS = ReferenceSettings()

Pair = tuple[Record, Reference]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """Coverage: number of observed errors within the expected 95 % limit."""

    trials: int  # With an expectation
    rmse_inside: int
    rmse_above: int
    ends: int  # number of recordings with an end error
    end_inside: int
    end_above: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation(Shown):
    """Recordings compared with their references."""

    trials: tuple[Trial, ...]  # One for each recording, in order
    mean: Figures  # Over the trials, gaps left out
    median: Figures
    held_out: tuple[HeldOut, ...] = ()  # The fit that corrected each recording, in leave-one-out

    @property
    def coverage(self) -> Coverage | None:
        """Observed errors compared with the expected errors, or None without expected errors."""
        pairs = [(t.expected, t.figures) for t in self.trials if t.expected is not None]
        if not pairs:
            return None
        ends = [s.end_total_deg <= expected.end_at_most_deg for expected, s in pairs if np.isfinite(s.end_total_deg)]
        totals = [figures.rmse_total_deg <= expected.rmse_at_most_deg for expected, figures in pairs]
        rmse_counts = {"rmse_inside": sum(totals), "rmse_above": len(totals) - sum(totals)}
        end_counts = {"ends": len(ends), "end_inside": sum(ends), "end_above": len(ends) - sum(ends)}
        return Coverage(trials=len(pairs), **rmse_counts, **end_counts)

    def _rows(self) -> dict[str, str]:
        each = {trial.recording: f"total {trial.figures.rmse_total_deg:.2f} deg rms" for trial in self.trials}
        return each | {f"mean {name}": text for name, text in rows_of(self.mean).items()}


def validate_trials(
    pairs: Sequence[Pair],
    *,
    calibrations: Sequence[Calibration | None] = (None,),
    settings: TrialSettings = TRIAL_SETTINGS,
    names: Sequence[str] = (),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Validation:
    """Compare several recordings with their references.

    Parameters
    ----------
    pairs : sequence of (Record, Reference)
        One or more.
    calibrations : sequence of Calibration or None
        One for all, or one for each.
    settings : TrialSettings
        Of ``validate_trial``.
    names : sequence of str
        What to call each; empty for the references' names.
    progress : callable
        Called with what is done and the share that is.

    Returns
    -------
    Validation
        Trials, mean and median.

    Raises
    ------
    InputError
        No recording, or a number of calibrations or names that fits nothing; and all that ``validate_trial`` raises.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> pairs = [(trial.record, trial.reference)]
    >>> found = undrift.validate_trials(pairs, calibrations=[calibration])
    >>> len(found.trials)
    1
    """
    if not pairs or len(calibrations) not in (1, len(pairs)) or len(names) not in (0, len(pairs)):
        raise InputError(
            f"validate: the numbers of recordings, calibrations and names do not match, got {len(pairs)} recordings, "
            f"{len(calibrations)} calibrations, {len(names)} names. Provide one calibration or one per recording, and all names "
            "or none."
        )
    each = list(calibrations) * len(pairs) if len(calibrations) == 1 else list(calibrations)
    called = list(names) or [""] * len(pairs)
    trials = list[Trial]()
    for k, (record, reference) in enumerate(pairs):
        progress(f"aligning and integrating recording {k + 1} of {len(pairs)}", k / len(pairs))
        trials.append(validate_trial(record, reference, calibration=each[k], settings=settings, name=called[k]))
    return summed(tuple(trials))


_FITS = 0.8  # share of the time of leave-one-out that its fits take


def validate_leave_one_out(
    pairs: Sequence[Pair],
    *,
    settings: TrialSettings = TRIAL_SETTINGS,
    fit_settings: ReferenceSettings = REFERENCE_SETTINGS,
    names: Sequence[str] = (),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Validation:
    """Compare recordings of a device, each corrected with a gyroscope fit to the references of the others.

    From the omitted recording, the fit uses only the rest before the motion, not the reference.

    Parameters
    ----------
    pairs : sequence of (Record, Reference)
        Two or more recordings of one device.
    settings : TrialSettings
        Of ``validate_trial``; the fit brings the offset, beside which ``offset`` "motion" takes what gravity shows.
    fit_settings : ReferenceSettings
        Of the fit.
    names : sequence of str
        What to call each; empty for the references' names.
    progress : callable
        Called with what is being done and the share that is done, 0 to 1.

    Returns
    -------
    Validation
        Trials, mean, median, and the fits.

    Raises
    ------
    InputError
        Fewer than two recordings; and all that ``leave_one_out`` and ``validate_trial`` raise.
    """
    calibrations, fits = calibrations_by_others(
        pairs, settings=settings, fit_settings=fit_settings, progress=lambda what, share: progress(what, _FITS * share)
    )
    progress("integrating each recording by the fit to the others", _FITS)
    trial_settings = replace(settings, offset="motion" if settings.offset == "motion" else "none")
    if fit_settings.mounting == "each":
        trial_settings = replace(trial_settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
    called = list(names) or [""] * len(pairs)
    source = OffsetSource(
        rest="shown" if trial_settings.offset == "motion" else "own",
        in_motion=True,
        recordings=len(pairs) - 1,
    )
    apart, trials = _told_apart(fits), list[Trial]()
    for pair, calibration, name in zip(pairs, calibrations, called, strict=True):
        trial = validate_trial(*pair, calibration=calibration, settings=trial_settings, name=name, source=source)
        trials.append(replace(trial, findings=(*trial.findings, *([apart] if apart else []))))
    return replace(summed(tuple(trials)), held_out=fits)


def calibrations_by_others(
    pairs: Sequence[Pair],
    *,
    settings: TrialSettings = TRIAL_SETTINGS,
    fit_settings: ReferenceSettings = REFERENCE_SETTINGS,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[tuple[Calibration, ...], tuple[HeldOut, ...]]:
    """Return a calibration per recording, from the other references and the offset of its own rest, and the fits."""
    records, references = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    _check_different(records)
    adc = device_adc(records) if settings.adc == "auto" else None
    fits = leave_one_out(
        records, references, settings=fit_settings, adc=adc, lag_settings=settings.lag, progress=progress
    )
    calibrations = (
        Calibration(
            device=record.device,
            reference_temp_c=float("nan"),
            gravity_m_s2=STANDARD_GRAVITY,
            gyro=h.model,
            accel=None if record.accel is None else turned_like(h.model, record.accel_unit),
            adc=adc,
            verdict=h.fit.triad.verdict,
        )
        for record, h in zip(records, fits, strict=True)
    )
    return tuple(calibrations), fits


def _check_different(records: Sequence[Record]) -> None:
    for (earlier, one), (later, other) in combinations(enumerate(record.gyro for record in records), 2):
        if one is not None and other is not None and np.array_equal(one, other, equal_nan=True):
            raise InputError(
                f"leave-one-out: recording {later + 1} has the same readings as recording {earlier + 1}. "
                "List each recording once."
            )


def _told_apart(folds: tuple[HeldOut, ...]) -> Finding | None:
    """Return a finding where the recordings do not look like one device, by what each reads at rest."""
    rest = np.array([h.model.offset - h.fit.motion_offset * (h.model.moving_offset is None) for h in folds])
    spread = float(np.linalg.norm(folds[0].model.matrix @ (rest.max(axis=0) - rest.min(axis=0)))) / RADIAN_PER_DEGREE
    return finding("validate.devices_apart", "warn", spread_dps=spread) if spread > ONE_DEVICE_DPS else None


def summed(trials: tuple[Trial, ...]) -> Validation:
    """Return trials with their mean, median and agreement."""
    table = {
        field.name: np.array([getattr(trial.figures, field.name) for trial in trials]) for field in fields(Figures)
    }
    mean, median = (
        Figures(**{name: of_known(summary, column) for name, column in table.items()})
        for summary in (np.mean, np.median)
    )
    return Validation(trials=trials, mean=mean, median=median)
