"""Sessions made ready for the drift fits: in the calibration's units, codes restored; and nominal models without one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undrift.calibration.adc import without_truncation
from undrift.calibration.model import AdcModel, Calibration, TriadModel, Verdict
from undrift.errors import InputError, NotObservable
from undrift.record import Record
from undrift.session import Session
from undrift.units import Quantity, is_physical, si_factor


def in_units_of(session: Session, calibration: Calibration) -> Session:
    """Return a session in the units that a calibration reads, with the half steps of truncated codes put back.

    Parameters
    ----------
    session : Session
        Each triad in one unit.
    calibration : Calibration
        Of the same device.

    Returns
    -------
    Session
        Readings as step 1 of the correction leaves them.

    Raises
    ------
    InputError
        Corrected readings, or a unit that cannot be turned into the calibration's.
    """
    return replace(session, records=tuple(_ready(record, k, calibration) for k, record in enumerate(session.records)))


def nominal_models(sessions: Sequence[Session]) -> Calibration:
    """Return a calibration that keeps the scale that the readings' units state, and knows no offset.

    Parameters
    ----------
    sessions : sequence of Session
        Of one device, each triad in one unit.

    Returns
    -------
    Calibration
        Gyroscopes in rad/s; no accelerometers, whose offset a log of one pose does not tell.

    Raises
    ------
    NotObservable
        Gyroscopes in counts or volts, or none: nothing says what a count is.
    """
    first = sessions[0]
    unit = next((r.gyro_unit for s in sessions for r in s.records if r.gyro is not None), None)
    if unit is None or not is_physical(unit):
        raise NotObservable(
            f"drift: wanted a calibration, or gyroscope readings in a physical unit, got {unit or 'none'}; give "
            "--calibration, or the scale of the columns"
        )
    gyro = TriadModel(
        method="nominal",
        unit_in=unit,
        unit_out="rad/s",
        matrix=np.eye(3) * si_factor(unit, "rate"),
        offset=np.zeros(3),
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=0,
        rank=0,
        condition=1.0,
        valid_range=(-np.inf, np.inf),
    )
    return Calibration(
        device=first.serial or first.records[0].device,
        reference_temp_c=float("nan"),
        gravity_m_s2=first.gravity_m_s2,
        gyro=gyro,
        verdict=Verdict(
            status="marginal",
            reasons=(
                "no calibration was given: scale and axes of the gyroscopes are the nominal ones, which rests do not tell; turn "
                "the device by known rates or angles and calibrate",
            ),
        ),
    )


def _ready(record: Record, number: int, calibration: Calibration) -> Record:
    if record.state == "corrected":
        raise InputError(
            f"recording {number}: wanted raw readings, got a corrected record; a table is taken off the device's own readings"
        )
    gyro_unit = _unit(record.gyro is not None, record.gyro_unit, calibration.gyro, "rate", number)
    accel_unit = _unit(record.accel is not None, record.accel_unit, calibration.accel, "accel", number)
    if (gyro_unit, accel_unit) != (record.gyro_unit, record.accel_unit):
        record = replace(record.in_units(gyro_unit, accel_unit), gyro_unit=gyro_unit, accel_unit=accel_unit)
    return record if calibration.adc is None else _restored(record, calibration.adc)


def _unit(there: bool, unit: str, model: TriadModel | None, quantity: Quantity, number: int) -> str:
    if not there or model is None or unit == model.unit_in:
        return unit
    if not (is_physical(unit) and is_physical(model.unit_in)):
        what = "gyro" if quantity == "rate" else "accel"
        raise InputError(
            f"recording {number}: wanted {what} readings in {model.unit_in}, the unit of the calibration, got {unit}; record as for "
            "the calibration, or calibrate in this unit"
        )
    return model.unit_in


def _restored(record: Record, adc: AdcModel) -> Record:
    gyro, accel = record.gyro, record.accel
    if gyro is not None and adc.gyro_lsb is not None:
        gyro = without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)
    if accel is not None and adc.accel_lsb is not None:
        accel = without_truncation(accel, adc.accel_lsb, adc.accel_rounding)
    return replace(record, gyro=gyro, accel=accel)
