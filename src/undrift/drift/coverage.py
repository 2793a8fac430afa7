"""Where a calibration does not cover a record: temperatures beyond its tables, rates beyond them, constant offsets stretched."""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration
from undrift.drift.plan import Plans, TriadPlan
from undrift.errors import DriftRangeError
from undrift.record import Record


def find_outside(record: Record, plans: Plans, *, allowed: bool) -> BoolArray:
    """Find the samples whose temperature lies beyond a tuning table.

    Parameters
    ----------
    record : Record
        Raw readings.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    allowed : bool
        Whether such samples may be.

    Returns
    -------
    array, shape (N,)
        True outside; a gap in temperature is not outside.

    Raises
    ------
    DriftRangeError
        Such samples where none are allowed.
    """
    mask = np.zeros(len(record), dtype=bool)
    ranges = [plan.temp_range for plan in plans if plan is not None and plan.tables is not None]
    if record.temp_c is None or not ranges:
        return mask
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    least, greatest = _extremes(record.temp_c)
    if least >= low and greatest <= high:
        return mask
    mask = (record.temp_c < low) | (record.temp_c > high)
    if mask.any() and not allowed:
        raise DriftRangeError(
            f"drift table: wanted temperatures from {low:g} to {high:g} degC, got {least:.1f} to {greatest:.1f} degC, "
            f"{mask.sum() / record.sample_rate_hz:.1f} s of them outside; extend the table, or choose the policy hold or nan",
            low=low,
            high=high,
            least=least,
            greatest=greatest,
        )
    return mask


def temperature_warnings(
    record: Record, calibration: Calibration, plans: Plans, outside: BoolArray, reference_span_c: float
) -> tuple[str, ...]:
    """Say where the temperature left the tables, or the span in which constant offsets hold.

    Parameters
    ----------
    record : Record
        Raw readings.
    calibration : Calibration
        The device's model.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    outside : array, shape (N,)
        As found by ``find_outside``.
    reference_span_c : float
        How far from the reference temperature constant offsets hold, degC.

    Returns
    -------
    tuple of str
        Nothing, or a sentence each.
    """
    said: list[str] = []
    temp = record.temp_c
    if temp is None:
        return ()
    if outside.any():
        least, greatest = _extremes(temp)
        said.append(
            f"{outside.sum() / record.sample_rate_hz:.1f} s lie outside the drift table: {least:.1f} to {greatest:.1f} degC "
            "were recorded"
        )
    constant = any(
        plan is not None and model is not None and (plan.tables is None or plan.tables.offset.size == 0)
        for plan, model in zip(plans, (calibration.gyro, calibration.accel), strict=True)
    )
    reference = calibration.reference_temp_c
    if constant and np.isfinite(reference):
        least, greatest = _extremes(temp)
        departure = max(greatest - reference, reference - least)
        if departure > reference_span_c:
            said.append(
                f"the temperature departs by up to {departure:.1f} degC from {reference:.1f} degC, where the constant offsets "
                f"hold; a tuning table is needed beyond {reference_span_c:g} degC"
            )
    return tuple(said)


def rate_warnings(gyro: TriadPlan | None, least: float, greatest: float) -> tuple[str, ...]:
    """Say where the rate left the dynamic table.

    Parameters
    ----------
    gyro : TriadPlan or None
        The gyroscopes.
    least, greatest : float
        Least and greatest measured rate, rad/s.

    Returns
    -------
    tuple of str
        Nothing, or one sentence.
    """
    if gyro is None or (least >= gyro.rate_range[0] and greatest <= gyro.rate_range[1]):
        return ()
    low, high = (np.degrees(r) for r in gyro.rate_range)
    return (
        f"rates reached {np.degrees(least):.1f} to {np.degrees(greatest):.1f} deg/s, the dynamic table ends at {low:.1f} and "
        f"{high:.1f} deg/s and was held there",
    )


def notes_on(record: Record, calibration: Calibration) -> tuple[str, ...]:
    """Say what a reader of the corrected record may not expect.

    Parameters
    ----------
    record : Record
        Raw readings.
    calibration : Calibration
        The device's model.

    Returns
    -------
    tuple of str
        A triad without a model; another serial number.
    """
    notes = [
        f"{name}: the calibration has no model, nominal values were passed on"
        for name, values, model in (("gyro", record.gyro, calibration.gyro), ("accel", record.accel, calibration.accel))
        if values is not None and model is None
    ]
    if record.device and calibration.device and record.device != calibration.device:
        notes.append(f"the recording is of {record.device}, the calibration of {calibration.device}")
    return tuple(notes)


def _extremes(temp: FloatArray) -> tuple[float, float]:
    """Least and greatest, gaps left out; the plain reductions are several times faster and tell when there is a gap."""
    least, greatest = float(temp.min()), float(temp.max())
    if np.isnan(least):
        return float(np.fmin.reduce(temp)), float(np.fmax.reduce(temp))
    return least, greatest
