"""Real recordings judged as the study judges simulated ones: BROAD trials with and without calibration, agreement over trials.

Three levels, of one set of recordings::

    none         readings as they come
    rest         less the mean rate of the first rest, half a step given back to truncated codes
    calibrated   a gyroscope fit to the other trials of the same device, which never saw the one that is judged
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import BlandAltman, IntraclassCorrelation, bland_altman, intraclass_correlation
from undrift.validation.trial import Trial, TrialSettings
from undrift.validation.trials import LEAST_FOR_AGREEMENT, Pair, validate_leave_one_out, validate_trials


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
    trials : tuple of Trial
        Each judged.
    rmse_total_deg, rmse_inclination_deg, max_abs_pitch_deg, end_total_deg : float
        Medians over the trials, deg.
    agreement : Pairwise or None
        Of mean inclination, sensor and optics; None with fewer than three trials.
    """

    level: str
    trials: tuple[Trial, ...]
    rmse_total_deg: float
    rmse_inclination_deg: float
    max_abs_pitch_deg: float
    end_total_deg: float
    agreement: Pairwise | None


def real_errors(devices: Sequence[DeviceTrials]) -> tuple[RealErrors, RealErrors, RealErrors]:
    """Judge real trials without calibration, with their rest alone, and with a calibration from the device's other trials.

    Parameters
    ----------
    devices : sequence of DeviceTrials
        One or more; a device with a single trial cannot be calibrated from others.

    Returns
    -------
    tuple of RealErrors
        Levels none, rest, calibrated.

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
    pairs = [pair for device in devices for pair in device.pairs]
    names = [name for device in devices for name in device.names]
    bare = validate_trials(pairs, settings=TrialSettings(adc="none"), names=names).trials
    rest = validate_trials(pairs, settings=TrialSettings(offset="rest"), names=names).trials
    held = [validate_leave_one_out(device.pairs, names=device.names).trials for device in devices]
    calibrated = tuple(trial for of_device in held for trial in of_device)
    return _told("none", bare), _told("rest", rest), _told("calibrated", calibrated)


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


def _told(level: str, trials: tuple[Trial, ...]) -> RealErrors:
    def median(name: str) -> float:
        return float(np.nanmedian([getattr(trial.figures, name) for trial in trials]))

    tilts = np.array([trial.mean_inclination for trial in trials]) / RADIAN_PER_DEGREE
    tilts = tilts[np.isfinite(tilts).all(axis=1)]
    return RealErrors(
        level=level,
        trials=trials,
        rmse_total_deg=median("rmse_total_deg"),
        rmse_inclination_deg=median("rmse_inclination_deg"),
        max_abs_pitch_deg=median("max_abs_pitch_deg"),
        end_total_deg=median("end_total_deg"),
        agreement=agreement_of("mean inclination, deg", tilts[:, 0], tilts[:, 1]),
    )
