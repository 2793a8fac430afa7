"""Is it the device of the calibration? At rest, corrected readings leave gravity only, and no rate."""

import math
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.triads import check_agreement
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.model import Calibration
from undrift.record import Record, Still, TemperatureSensitivity
from undrift.segments import StillSettings, find_still, unpadded
from undrift.sync import padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

REST_LOOKED_AT_S = 600.0
FAR_SIGMAS = 4.0
# One standard deviation of what a sound device leaves at a rest beside the calibration's own uncertainty: turn-on and ageing by
# data sheets of consumer parts [assumed], local gravity elsewhere (0.15 %), and the Earth's rate.
LEFT_ACCEL, LEFT_RATE = 0.010 * STANDARD_GRAVITY, 0.25 * RADIAN_PER_DEGREE
LEAST_LEFT, REVERSED = 0.02 * STANDARD_GRAVITY, 0.25  # m/s2 as read, and the share of it that the opposite sign leaves
UNKNOWN_DEPARTURE_K = 10.0  # where recording or calibration has no temperature


def check_corrected(
    record: Record, calibration: Calibration, raw: Record, stills: tuple[Still, ...] | None = None
) -> tuple[Finding, ...]:
    """Return what speaks against a corrected record's columns, its range or its calibration; raise where it is clear.

    The size of the specific force is not looked at but at rest: the readings may be of a model, not of a motion. ``stills`` are
    its still phases where they are known.
    """
    from undrift.io.inspect import find_saturated

    both = calibration.gyro is not None and calibration.accel is not None  # else they are in frames of their own
    named = (*find_saturated(raw), *padding(raw, unpadded(raw)))
    return (*named, *(check_agreement(record) if both else ()), *check_device(record, calibration, stills))


def check_device(
    record: Record, calibration: Calibration, stills: tuple[Still, ...] | None = None
) -> tuple[Finding, ...]:
    """Return what rests of a corrected record say against its calibration: |a| - g and the mean rate, by their uncertainty."""
    record = record.in_si().between(record.time[0], record.time[0] + REST_LOOKED_AT_S)
    if stills is None:
        try:
            stills = find_still(record, StillSettings()).stills
        except InputError:  # shorter than a window
            return ()
    rests = tuple(one for one in stills if one.stop <= len(record) and _whole(record, one))
    if not rests:
        return ()
    if not np.isfinite(calibration.gravity_m_s2):  # parameters of other programs do not state it
        calibration = replace(calibration, gravity_m_s2=STANDARD_GRAVITY)
    departure = _departure_k(record, calibration)
    usual = TemperatureSensitivity()
    residuals: dict[str, tuple[float, float]] = {}
    means = {
        name: np.array([values[one.start : one.stop].mean(axis=0) for one in rests])
        for name, values in (("accel", record.accel), ("gyro", record.gyro))
        if values is not None
    }
    per_k = usual.gyro_offset_dps_per_k * RADIAN_PER_DEGREE, usual.accel_offset_mg_per_k * 1e-3 * STANDARD_GRAVITY
    tabled = calibration.drift is not None and calibration.drift.static is not None
    for triad, own, of_temp in zip(calibration.triads, (LEFT_RATE, LEFT_ACCEL), per_k, strict=True):
        name, model = triad.sensor, triad.model
        if model is None or name not in means:
            continue
        size = np.linalg.norm(means[name], axis=1) - (calibration.gravity_m_s2 if name == "accel" else 0.0)
        columns = [k for k, parameter in enumerate(model.parameters) if parameter.startswith("offset_")]
        offsets = model.matrix @ model.covariance[np.ix_(columns, columns)] @ model.matrix.T
        fit = float(np.sqrt(np.nansum(np.diag(offsets)))) * triad.si  # constants of other programs state none
        residuals[name] = float(np.sqrt(np.mean(size**2))), math.hypot(fit, own, 0.0 if tabled else of_temp * departure)
    far = [name for name, (seen, expected) in residuals.items() if seen > FAR_SIGMAS * expected]
    accel_left = residuals.get("accel", (0.0, 0.0))[0]
    reversed_ = "gyro" not in far and accel_left > LEAST_LEFT and _reversed(means["accel"], calibration, accel_left)
    if not far and not reversed_:
        return ()
    nothing = (float("nan"), float("nan"))
    (accel, accel_usual), (rate, rate_usual) = residuals.get("accel", nothing), residuals.get("gyro", nothing)
    values = {"left_mg": accel / STANDARD_GRAVITY * 1e3, "usual_mg": accel_usual / STANDARD_GRAVITY * 1e3}
    values |= {"left_dps": rate / RADIAN_PER_DEGREE, "usual_dps": rate_usual / RADIAN_PER_DEGREE, "rests": len(rests)}
    return (finding("correct.accel_reversed" if reversed_ else "correct.other_device", "warn", **values),)


def _whole(record: Record, rest: Still) -> bool:
    """Tell whether a rest has no gaps."""
    triads = (values[rest.start : rest.stop] for values in (record.gyro, record.accel) if values is not None)
    return all(np.isfinite(values).all() for values in triads)


def _departure_k(record: Record, calibration: Calibration) -> float:
    if record.temp_c is None or not np.isfinite(calibration.reference_temp_c):
        return UNKNOWN_DEPARTURE_K
    away = np.abs(record.temp_c - calibration.reference_temp_c)
    return float(np.nanmean(away)) if np.isfinite(away).any() else UNKNOWN_DEPARTURE_K


def _reversed(force: FloatArray, calibration: Calibration, residual: float) -> bool:
    """Tell whether readings with the opposite sign would be gravity: M (-u - o) = -f - 2 M o, of f = M (u - o)."""
    model = calibration.accel
    if model is None:
        return False
    turned = -force - 2.0 * model.matrix @ model.offset * si_factor(model.unit_out, "accel")
    size = np.linalg.norm(turned, axis=1) - calibration.gravity_m_s2
    return bool(np.sqrt(np.mean(size**2)) < REVERSED * residual)
