"""Real recordings judged as the study judges simulated ones: BROAD trials with and without calibration, agreement over trials.

Three levels of calibration, of one set of recordings::

    none         no offset taken off
    rest         less the mean rate of the first rest
    calibrated   a gyroscope fit to the other trials of the same device, which never saw the one that is judged

What the converter's rounding took is worth as much as a level: half a step of truncated codes is an offset. So all three are
judged twice, with the rounding undone and with it left in, and levels are compared with others of the same treatment alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import BlandAltman, IntraclassCorrelation, bland_altman, intraclass_correlation
from undrift.validation.trial import Adc, Trial, TrialSettings
from undrift.validation.trials import LEAST_FOR_AGREEMENT, Pair, validate_leave_one_out, validate_trials

Rounding = Literal["undone", "left in", "none found"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceTrials:
    """Trials of one device with their optics.

    Parameters
    ----------
    device : str
        What to call it.
    names : tuple of str
        Of the trials.
    pairs : tuple of (Record, Reference)
        Two or more.
    """

    device: str
    names: tuple[str, ...]
    pairs: tuple[Pair, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairwise:
    """Agreement of two ways to measure one quantity over trials.

    Parameters
    ----------
    quantity : str
        What, with its unit.
    limits : BlandAltman
        Bias and limits.
    icc : IntraclassCorrelation
        Absolute agreement, ICC(2,1).
    """

    quantity: str
    limits: BlandAltman
    icc: IntraclassCorrelation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealErrors:
    """Errors of real trials at one level.

    Parameters
    ----------
    level : str
        none, rest or calibrated.
    rounding : str
        What became of the converter's rounding: undone, left in, or none found in the codes of any trial.
    trials : tuple of Trial
        Each judged.
    rmse_total_deg, rmse_inclination_deg, max_abs_pitch_deg, end_total_deg : float
        Medians over the trials, deg.
    agreement : Pairwise or None
        Of mean inclination, sensor and optics; None with fewer than three trials.
    """

    level: str
    rounding: Rounding
    trials: tuple[Trial, ...]
    rmse_total_deg: float
    rmse_inclination_deg: float
    max_abs_pitch_deg: float
    end_total_deg: float
    agreement: Pairwise | None


def real_errors(devices: Sequence[DeviceTrials]) -> tuple[RealErrors, ...]:
    """Judge real trials without calibration, with their rest alone, and with a calibration from the device's other trials.

    Parameters
    ----------
    devices : sequence of DeviceTrials
        One or more; a device with a single trial cannot be calibrated from others.

    Returns
    -------
    tuple of RealErrors
        Levels none, rest, calibrated with the converter's rounding undone, then the same three with it left in; the first three
        alone where no rounding is found.

    Raises
    ------
    InputError
        No device, or one with fewer than two trials; and all that the validation raises.
    """
    few = [device.device for device in devices if len(device.pairs) < 2]
    if not devices or few:
        raise InputError(
            f"real trials: wanted devices with two trials or more, got {'none' if not devices else 'one of ' + few[0]}; a fit "
            "that judges a trial must come from others"
        )
    undone, left_in = _levels(devices, "auto"), _levels(devices, "none")
    errors = [
        [trial.figures.rmse_total_deg for _, trials in levels for trial in trials] for levels in (undone, left_in)
    ]
    if np.array_equal(errors[0], errors[1], equal_nan=True):
        return tuple(_told(level, "none found", trials) for level, trials in undone)
    return (
        *(_told(level, "undone", trials) for level, trials in undone),
        *(_told(level, "left in", trials) for level, trials in left_in),
    )


def _levels(devices: Sequence[DeviceTrials], adc: Adc) -> tuple[tuple[str, tuple[Trial, ...]], ...]:
    """Return the trials at the three levels, the codes treated alike in all."""
    pairs = [pair for device in devices for pair in device.pairs]
    names = [name for device in devices for name in device.names]
    settings = TrialSettings(adc=adc)
    bare = validate_trials(pairs, settings=settings, names=names).trials
    rest = validate_trials(pairs, settings=TrialSettings(adc=adc, offset="rest"), names=names).trials
    held = [validate_leave_one_out(device.pairs, settings=settings, names=device.names).trials for device in devices]
    return ("none", bare), ("rest", rest), ("calibrated", tuple(trial for of_device in held for trial in of_device))


def agreement_of(quantity: str, first: FloatArray, second: FloatArray) -> Pairwise | None:
    """Return the agreement of two ways to measure.

    Parameters
    ----------
    quantity : str
        What, with its unit.
    first, second : array, shape (n,)
        One value a trial from each.

    Returns
    -------
    Pairwise or None
        None with fewer than three trials.
    """
    if len(first) < LEAST_FOR_AGREEMENT:
        return None
    return Pairwise(
        quantity=quantity,
        limits=bland_altman(first, second),
        icc=intraclass_correlation(np.stack((first, second), axis=1), "ICC(2,1)"),
    )


def _told(level: str, rounding: Rounding, trials: tuple[Trial, ...]) -> RealErrors:
    def median(name: str) -> float:
        return float(np.nanmedian([getattr(trial.figures, name) for trial in trials]))

    tilts = np.array([trial.mean_inclination for trial in trials]) / RADIAN_PER_DEGREE
    tilts = tilts[np.isfinite(tilts).all(axis=1)]
    return RealErrors(
        level=level,
        rounding=rounding,
        trials=trials,
        rmse_total_deg=median("rmse_total_deg"),
        rmse_inclination_deg=median("rmse_inclination_deg"),
        max_abs_pitch_deg=median("max_abs_pitch_deg"),
        end_total_deg=median("end_total_deg"),
        agreement=agreement_of("mean inclination, deg", tilts[:, 0], tilts[:, 1]),
    )
