"""Sessions made ready for the drift fits: in the calibration's units, codes restored; and nominal models without one.

A session in several recordings whose clock runs on from one to the next was switched on once, when the first began; a clock that
begins anew is another switch-on.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import without_truncation
from undrift.calibration.model import AdcModel, Calibration, TriadModel, Verdict
from undrift.drift.observe.observations import RestBlocks
from undrift.drift.temperature.lag import without_lag
from undrift.drift.temperature.trusted import Temperature
from undrift.errors import InputError, NotObservable
from undrift.record import Record
from undrift.session import Session
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

_STRAY = 6.0  # standard deviations of a reading: further from the smooth course is a stray
_LEAST_NOISE_C = 0.05
_RESTLESS = 0.5 * RADIAN_PER_DEGREE  # rad/s, standard uncertainty of the mean of a block


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


def accel_unit_of(sessions: Sequence[Session], device: Calibration) -> str:
    """Return the unit of the accelerometers' readings.

    Parameters
    ----------
    sessions : sequence of Session
        Made ready.
    device : Calibration
        Whose unit they are in where it has accelerometers.

    Returns
    -------
    str
        count where nothing says more, or where sessions differ.
    """
    if device.accel is not None:
        return device.accel.unit_in
    units = {record.accel_unit for session in sessions for record in session.records if record.accel is not None}
    return units.pop() if len(units) == 1 else "count"


def since_power_on(rests: RestBlocks, sessions: Sequence[Session]) -> RestBlocks:
    """Return the blocks with the time since their device was switched on, not since their recording began.

    Parameters
    ----------
    rests : RestBlocks
        Of the sessions; times since their recording began.
    sessions : sequence of Session
        The same, in the same order.

    Returns
    -------
    RestBlocks
        Recordings whose clock runs on belong to one switch-on.
    """
    power_on_s = rests.power_on_s.copy()
    for number, session in enumerate(sessions):
        begins = np.cumsum([0.0, *(record.duration_s for record in session.records[:-1])])
        rows = np.flatnonzero(rests.session == number)
        recording = np.searchsorted(begins, rests.time[rows], side="right") - 1
        power_on_s[rows] += _ages(session.records)[recording]
    return replace(rests, power_on_s=power_on_s)


def check_at_rest(rests: RestBlocks, device: Calibration) -> None:
    """Refuse blocks of rest in which the device moved all the time: a log that never lies still looks even throughout.

    Parameters
    ----------
    rests : RestBlocks
        With the variance of their means, raw unit squared.
    device : Calibration
        What a reading is worth.

    Raises
    ------
    NotObservable
        Means over a block that are known to half a deg/s at best; noise of a device at rest leaves a tenth of that.
    """
    if device.gyro is None or not np.isfinite(rests.gyro_variance).any():
        return
    factor = si_factor(device.gyro.unit_out, "rate") / device.gyro.scale_factor
    known = np.sqrt(np.nanmedian(rests.gyro_variance, axis=0)) * factor
    if np.nanmax(known) > _RESTLESS:
        dps = float(np.nanmax(known)) / RADIAN_PER_DEGREE
        raise NotObservable(
            f"rests: wanted stretches at rest, got none: readings move so much that the mean of ten seconds is known to {dps:.2g} "
            "deg/s only; leave the device still while its temperature changes",
            deg_per_s=dps,
        )


def met_in_use(
    sessions: Sequence[Session],
    trusted: Sequence[Sequence[Temperature]],
    course: Sequence[Sequence[FloatArray]],
    lag_s: float,
    smooth_s: float,
) -> list[FloatArray]:
    """Return the extremes of what ``correct`` would look up for these sessions: readings are noisier than their smooth course.

    Parameters
    ----------
    sessions : sequence of Session
        Made ready.
    trusted : sequence of sequence of Temperature
        Of each recording.
    course : sequence of sequence of array, shape (N,)
        Smooth, lag taken off, degC.
    lag_s, smooth_s : float
        What is taken off in use, s.

    Returns
    -------
    list of array, shape (2,)
        Least and greatest of each recording with a column, degC; readings far from their course are left out.
    """
    ends: list[FloatArray] = []
    for session, own, smooth in zip(sessions, trusted, course, strict=True):
        for record, found, settled in zip(session.records, own, smooth, strict=True):
            if record.temp_c is None or found.source != "column":
                continue
            met, gain = record.temp_c, 1.0
            if lag_s > 0.0:
                met, gain = without_lag(met, record.time, lag_s=lag_s, smooth_s=smooth_s)[0], lag_s / smooth_s
            far = _STRAY * gain * max(found.noise_c, found.step_c, _LEAST_NOISE_C)
            near = met[np.abs(met - settled) <= far]  # a gap is near nothing
            if len(near):
                ends.append(np.array([near.min(), near.max()]))
    return ends


def _ages(records: Sequence[Record]) -> FloatArray:
    """Return how long before each record its device was switched on, s."""
    ages, first = np.zeros(len(records)), records[0].time[0]
    for k in range(1, len(records)):
        if records[k].time[0] <= records[k - 1].time[-1]:
            first = records[k].time[0]
        ages[k] = records[k].time[0] - first
    return ages


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
            f"recording {number}: wanted {what} readings in {model.unit_in}, the unit of the calibration, got {unit}; record as "
            "for the calibration, or calibrate in this unit"
        )
    return model.unit_in


def _restored(record: Record, adc: AdcModel) -> Record:
    gyro, accel = record.gyro, record.accel
    if gyro is not None and adc.gyro_lsb is not None:
        gyro = without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)
    if accel is not None and adc.accel_lsb is not None:
        accel = without_truncation(accel, adc.accel_lsb, adc.accel_rounding)
    return replace(record, gyro=gyro, accel=accel)
