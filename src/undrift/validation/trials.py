"""Several recordings: each judged, means and medians, agreement over trials, and fits judged where they were not made."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.reference import HeldOut, ReferenceSettings, leave_one_out
from undrift.calibration.model import Calibration
from undrift.calibration.procedure_reference import device_adc
from undrift.errors import InputError
from undrift.record import Record, Reference
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.agreement import BlandAltman, IntraclassCorrelation, bland_altman, intraclass_correlation
from undrift.validation.figures import Figures
from undrift.validation.trial import TRIAL_SETTINGS, Trial, TrialSettings, validate_trial

LEAST_FOR_AGREEMENT = 3
ONE_DEVICE_DPS = 0.1  # what one warm device reads at rest repeats within 0.01-0.02 deg/s over a session, BROAD
REFERENCE_SETTINGS = ReferenceSettings()

Pair = tuple[Record, Reference]


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Agreement of sensor and reference over trials, on the mean inclination of each trial.

    Parameters
    ----------
    limits : BlandAltman
        Bias and limits, deg.
    absolute : IntraclassCorrelation
        ICC(2,1), SEM and MDC95 in deg.
    consistency : IntraclassCorrelation
        ICC(3,1).
    """

    limits: BlandAltman
    absolute: IntraclassCorrelation
    consistency: IntraclassCorrelation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation:
    """Recordings judged.

    Parameters
    ----------
    trials : tuple of Trial
        One for each recording, in order.
    mean, median : Figures
        Over the trials, gaps left out.
    agreement : Agreement or None
        None with fewer than three trials.
    held_out : tuple of HeldOut
        The fits that judged each recording, in leave-one-out; empty otherwise.
    """

    trials: tuple[Trial, ...]
    mean: Figures
    median: Figures
    agreement: Agreement | None
    held_out: tuple[HeldOut, ...] = ()


def validate_trials(
    pairs: Sequence[Pair],
    *,
    calibrations: Sequence[Calibration | None] = (None,),
    settings: TrialSettings = TRIAL_SETTINGS,
    names: Sequence[str] = (),
) -> Validation:
    """Judge several recordings against their references.

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

    Returns
    -------
    Validation
        Trials, mean, median, agreement.

    Raises
    ------
    InputError
        No recording, or a number of calibrations or names that fits nothing; and all that ``validate_trial`` raises.
    """
    if not pairs or len(calibrations) not in (1, len(pairs)) or len(names) not in (0, len(pairs)):
        raise InputError(
            f"validate: wanted one or more recordings, one calibration for all or each, names for all or none, got {len(pairs)} "
            f"recordings, {len(calibrations)} calibrations, {len(names)} names"
        )
    each = list(calibrations) * len(pairs) if len(calibrations) == 1 else list(calibrations)
    called = list(names) or [""] * len(pairs)
    trials = tuple(
        validate_trial(record, reference, calibration=calibration, settings=settings, name=name)
        for (record, reference), calibration, name in zip(pairs, each, called, strict=True)
    )
    return _summed(trials)


def validate_leave_one_out(
    pairs: Sequence[Pair],
    *,
    settings: TrialSettings = TRIAL_SETTINGS,
    fit_settings: ReferenceSettings = REFERENCE_SETTINGS,
    names: Sequence[str] = (),
) -> Validation:
    """Judge recordings of one device, each by a gyroscope fit to the others' references.

    Of the held-out recording the fit knows its own rest before the motion, and nothing of its reference.

    Parameters
    ----------
    pairs : sequence of (Record, Reference)
        Two or more recordings of one device in one mounting.
    settings : TrialSettings
        Of ``validate_trial``; its ``offset`` is not used: the fit brings the offset.
    fit_settings : ReferenceSettings
        Of the fit.
    names : sequence of str
        What to call each; empty for the references' names.

    Returns
    -------
    Validation
        Trials, mean, median, agreement, and the fits.

    Raises
    ------
    InputError
        Fewer than two recordings; and all that ``leave_one_out`` and ``validate_trial`` raise.
    """
    records, references = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    _check_different(records)
    adc = device_adc(records) if settings.adc == "auto" else None
    held = leave_one_out(records, references, settings=fit_settings, adc=adc, lag_settings=settings.lag)
    calibrations = [
        Calibration(
            device=record.device,
            reference_temp_c=float("nan"),
            gravity_m_s2=STANDARD_GRAVITY,
            gyro=h.model,
            adc=adc,
            verdict=h.fit.triad.verdict,
        )
        for record, h in zip(records, held, strict=True)
    ]
    trials = []
    called = list(names) or [""] * len(pairs)
    for (record, reference), calibration, h, name in zip(pairs, calibrations, held, called, strict=True):
        trial = validate_trial(
            record, reference, calibration=calibration, settings=replace(settings, offset="none"), name=name
        )
        trials.append(replace(trial, notes=(*trial.notes, h.extrapolation)) if h.extrapolation else trial)
    apart = _told_apart(held)
    if apart:
        trials = [replace(trial, notes=(*trial.notes, apart)) for trial in trials]
    return _summed(tuple(trials), held)


def _check_different(records: Sequence[Record]) -> None:
    for later in range(1, len(records)):
        for earlier in range(later):
            one, other = records[earlier].gyro, records[later].gyro
            if one is not None and other is not None and np.array_equal(one, other, equal_nan=True):
                raise InputError(
                    f"leave-one-out: wanted different recordings, got number {later + 1} with the readings of number "
                    f"{earlier + 1}; a recording cannot judge itself: name each once"
                )


def _told_apart(held: tuple[HeldOut, ...]) -> str:
    """Return a sentence where the recordings do not look like one device, by what each reads at rest."""
    rest = np.array([(h.model.offset - h.fit.motion_offset) for h in held])
    spread = float(np.linalg.norm(held[0].model.matrix @ (rest.max(axis=0) - rest.min(axis=0)))) / RADIAN_PER_DEGREE
    if spread <= ONE_DEVICE_DPS:
        return ""
    return (
        f"the recordings read up to {spread:.2g} deg/s apart at rest: several devices, or one that was not warmed up; "
        "leave-one-out speaks of one device only"
    )


def _summed(trials: tuple[Trial, ...], held_out: tuple[HeldOut, ...] = ()) -> Validation:
    table = np.array([astuple(trial.figures) for trial in trials])
    names = [field.name for field in fields(Figures)]
    return Validation(
        trials=trials,
        mean=Figures(**dict(zip(names, _over_trials(table, "mean"), strict=True))),
        median=Figures(**dict(zip(names, _over_trials(table, "median"), strict=True))),
        agreement=_agreement(trials),
        held_out=held_out,
    )


def _over_trials(table: FloatArray, how: str) -> list[float]:
    summary = np.mean if how == "mean" else np.median
    seen = [column[np.isfinite(column)] for column in table.T]
    return [float(summary(column)) if len(column) else float("nan") for column in seen]


def _agreement(trials: tuple[Trial, ...]) -> Agreement | None:
    pairs = np.array([trial.mean_inclination for trial in trials]) / RADIAN_PER_DEGREE
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    if len(pairs) < LEAST_FOR_AGREEMENT:
        return None
    return Agreement(
        limits=bland_altman(pairs[:, 0], pairs[:, 1]),
        absolute=intraclass_correlation(pairs, "ICC(2,1)"),
        consistency=intraclass_correlation(pairs, "ICC(3,1)"),
    )
