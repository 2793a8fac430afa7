"""Check that a record comes from the device of its calibration: at rest, corrected readings contain gravity only, and no rate."""

import math

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.triads import check_agreement
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.model import SENSORS, Calibration
from undrift.record import Record, Still, TemperatureSensitivity
from undrift.segments import find_still, unpadded
from undrift.sync import padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

REST_LOOKED_AT_S = 600.0
FAR_SIGMAS = 4.0
# Standard deviation at rest of a sound device in addition to the calibration's uncertainty: turn-on and ageing from
# data sheets of consumer parts [assumed], local gravity elsewhere (0.15 %), and the Earth's rate.
LEFT_ACCEL, LEFT_RATE = 0.010 * STANDARD_GRAVITY, 0.25 * RADIAN_PER_DEGREE
LEAST_LEFT, REVERSED = 0.02 * STANDARD_GRAVITY, 0.25  # raw deviation, m/s2, and remaining share with the opposite sign
UNKNOWN_DEPARTURE_K = 10.0  # assumed distance if recording or calibration has no temperature


def check_corrected(
    record: Record, calibration: Calibration, raw: Record, stills: tuple[Still, ...] | None = None
) -> tuple[Finding, ...]:
    """Return findings about columns, range or calibration of a corrected record. Raise if an error is clear.

    The size of the specific force is checked only at rest, because the readings may come from a model. ``stills`` are the still
    phases of the record, if known.
    """
    from undrift.io.symptoms import find_saturated

    has_both = calibration.gyro is not None and calibration.accel is not None  # otherwise frames differ
    agreement = check_agreement(record) if has_both else ()
    return (*find_saturated(raw), *padding(raw, unpadded(raw)), *agreement, *check_device(record, calibration, stills))


def check_device(
    record: Record, calibration: Calibration, stills: tuple[Still, ...] | None = None
) -> tuple[Finding, ...]:
    """Return a finding if, at rests of a corrected record, |a| - g or the mean rate exceeds its uncertainty."""
    record = record.in_si().between(record.time[0], record.time[0] + REST_LOOKED_AT_S)
    if stills is None:
        try:
            stills = find_still(record).stills
        except InputError:  # shorter than a window
            return ()
    readings = {name: values for name in SENSORS if (values := getattr(record, name)) is not None}
    whole = np.isfinite(np.hstack([*readings.values()])).all(axis=1)
    rests = [still for still in stills if still.stop <= len(record) and whole[still.start : still.stop].all()]
    if not rests:
        return ()
    local_gravity = calibration.gravity_m_s2  # parameters of other programs do not contain an uncertainty
    gravity = local_gravity if np.isfinite(local_gravity) else STANDARD_GRAVITY
    departure_k, usual = _departure_k(record, calibration), TemperatureSensitivity()
    tabled = calibration.drift is not None and calibration.drift.static is not None
    per_k = usual.gyro_offset_dps_per_k * RADIAN_PER_DEGREE, usual.accel_offset_mg_per_k * 1e-3 * STANDARD_GRAVITY
    deviation, expected, reversed_ = {"gyro": np.nan, "accel": np.nan}, {"gyro": np.nan, "accel": np.nan}, False
    for triad, ideal, residual_sigma, sigma_per_k in zip(
        calibration.triads, (0.0, gravity), (LEFT_RATE, LEFT_ACCEL), per_k, strict=True
    ):
        name, model = triad.sensor, triad.model
        if model is None or name not in readings:
            continue
        means = np.array([readings[name][rest.start : rest.stop].mean(axis=0) for rest in rests])
        fit = float(np.sqrt(np.nansum(np.diag(model.offset_covariance)))) * triad.si  # 0 from other programs
        rms = deviation[name] = _rms(np.linalg.norm(means, axis=1) - ideal)
        expected[name] = math.hypot(fit, residual_sigma, 0.0 if tabled else sigma_per_k * departure_k)
        # readings with the opposite sign: M (-u - o) = -f - 2 M o, of f = M (u - o)
        reversed_force = -means - 2.0 * model.matrix @ model.offset * triad.si
        reversed_ = rms > LEAST_LEFT and _rms(np.linalg.norm(reversed_force, axis=1) - gravity) < REVERSED * rms
    doubtful = [sensor for sensor, rms in deviation.items() if rms > FAR_SIGMAS * expected[sensor]]
    reversed_ = reversed_ and record.accel is not None and calibration.accel is not None and "gyro" not in doubtful
    if not doubtful and not reversed_:
        return ()
    mg, dps = 1e-3 * STANDARD_GRAVITY, RADIAN_PER_DEGREE
    force = f"|a| is off by {deviation['accel'] / mg:.3g} mg rms (usual: {expected['accel'] / mg:.2g})"
    if reversed_:
        sentence = f"Acceleration has the opposite sign of the calibration's recordings: at {len(rests)} rests {force}."
        action = "Reverse the accelerometer columns: at rest the axis that points up reads +1 g."
        return (finding("correct.accel_reversed", "warn", sentence, action),)
    rate = f"the rate by {deviation['gyro'] / dps:.3g} deg/s (usual: {expected['gyro'] / dps:.2g})"
    sentence = f"This may be the calibration of another device: at {len(rests)} rests {force} and {rate}."
    action = "Give the calibration of this device, or calibrate the device again."
    return (finding("correct.other_device", "warn", sentence, action),)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _departure_k(record: Record, calibration: Calibration) -> float:
    """Return the mean difference between the temperatures of recording and calibration."""
    temp_c = np.full(1, np.nan) if record.temp_c is None else record.temp_c
    distance = np.abs(temp_c - calibration.reference_temp_c)
    return float(np.nanmean(distance)) if np.isfinite(distance).any() else UNKNOWN_DEPARTURE_K
