"""From recordings with an orientation reference to a Calibration of the gyroscopes: no rig, no poses, only motion."""

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from undrift.calibration.adc import identify_record_adc
from undrift.calibration.fit.reference import ReferenceSettings, fit_reference
from undrift.calibration.model import AdcModel, Calibration
from undrift.record import Record, Reference
from undrift.sync import LagSettings
from undrift.units import STANDARD_GRAVITY

REFERENCE_SETTINGS = ReferenceSettings()
LAG_SETTINGS = LagSettings()


def calibrate_to_references(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    adc: Literal["auto", "none"] = "auto",
    settings: ReferenceSettings = REFERENCE_SETTINGS,
    lag_settings: LagSettings = LAG_SETTINGS,
) -> Calibration:
    """Calibrate the gyroscopes of one device from its recordings beside a reference.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in one mounting; each begins with a rest.
    references : sequence of Reference
        One for each record.
    adc : str
        "auto" gives back what the ADC's rounding took, where it shows; "none" leaves the codes.
    settings : ReferenceSettings
        Of the fit.
    lag_settings : LagSettings
        Of the search for the lag between the clocks.

    Returns
    -------
    Calibration
        Gyroscopes only: a reference of orientation does not see specific force.

    Raises
    ------
    InputError
        All that ``fit_reference`` raises.
    """
    rounding = device_adc(records) if adc == "auto" else None
    fit = fit_reference(records, references, settings=settings, adc=rounding, lag_settings=lag_settings)
    temps = [float(np.nanmean(record.temp_c)) for record in records if record.temp_c is not None]
    return Calibration(
        device=records[0].device,
        reference_temp_c=float(np.mean(temps)) if temps else float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=fit.triad.model,
        adc=rounding,
        verdict=fit.triad.verdict,
    )


def device_adc(records: Sequence[Record]) -> AdcModel | None:
    """Find how the gyroscope codes of one device were rounded, from all its recordings.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device.

    Returns
    -------
    AdcModel or None
        What most recordings say, with the smallest step seen; None where none can tell, or where they disagree evenly.
    """
    found = [model for model in map(identify_record_adc, records) if model is not None and model.gyro_lsb is not None]
    if not found:
        return None
    ranked = Counter(model.gyro_rounding for model in found).most_common()
    if len(ranked) > 1 and ranked[0][1] == ranked[1][1]:
        return None
    chosen = [model for model in found if model.gyro_rounding == ranked[0][0]]
    return min(chosen, key=lambda model: float(np.sum(np.asarray(model.gyro_lsb))))
