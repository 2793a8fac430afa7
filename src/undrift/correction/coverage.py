"""Find samples that a calibration does not cover, as masks, seconds and findings, without changing readings.

::

    missing        no temperature was recorded, but a table needs one
    outside        the temperature is beyond a table (under policy raise also 3 degC beyond the data of the table)
    extrapolated   it is inside, but the correction uses a node without nearby data
    departure      constant offsets are used far from the temperature at which they were determined
    turn rate      beyond the dynamic table

Temperatures are sensor temperatures, without the thermometer's lag (correction/plan.py).
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.correction.plan import NOWHERE, Carry, LookupTable, Plans, Reach, Span, has_tables
from undrift.errors import DriftRangeError
from undrift.findings import Finding, finding, told_apart
from undrift.model import BEYOND_SEEN_C, Calibration, DriftTables, seen_span
from undrift.record import Record
from undrift.units import si_factor

REFERENCE_SPAN_C = 5.0  # distance from the reference temperature within which constant offsets are assumed to apply
ON_NODE = 1e-9  # in cells: a value this near to a node uses that node only


def seconds_of(mask: BoolArray | None, time: FloatArray, before: float | None) -> float:
    """Return the total duration of marked samples, s. ``before`` is the time of the sample before the first."""
    if mask is None or not mask.any():
        return 0.0
    first = 2.0 * time[0] - time[1] if before is None else before
    return float(np.diff(time, prepend=first)[mask].sum())


# ---- masks, (N,)


def find_outside(
    record: Record, temp_c: FloatArray, plans: Plans, drift: DriftTables, *, allowed: bool, before: float | None
) -> BoolArray | None:
    """Find the samples whose temperature is beyond a tuning table, or return None.

    Unless ``allowed``, raise for such a sample, and for a temperature far beyond the data of the table.
    """
    ranges = [plan.temp_range for plan in plans if plan is not None and plan.tables]
    if not ranges:
        return None
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if drift.static is not None and not allowed:
        marks = drift.static.gyro_extrapolated  # marks of the gyroscopes if both triads have marks
        data = seen_span(drift.static.temp_c, drift.static.accel_extrapolated if marks is None else marks)
        # subtracting a lag amplifies the noise of a thermometer
        margin = BEYOND_SEEN_C * (2.0 if drift.lag_s > 0.0 else 1.0)
        low, high = max(low, data[0] - margin), min(high, data[1] + margin)
    least, greatest = extremes(temp_c)
    mask = (temp_c < low) | (temp_c > high) if least < low or greatest > high else None
    if mask is not None and not allowed:
        raise DriftRangeError(
            f"drift table: expected temperatures from {low:g} to {high:g} degC, got {least:.1f} to {greatest:.1f} degC, "
            f"with {seconds_of(mask, record.time, before):.1f} s outside{_other_unit(least, greatest, (low, high))}. "
            "Extend the table, or choose the policy hold or nan.",
            low=low,
            high=high,
            least=least,
            greatest=greatest,
        )
    return mask


def _other_unit(least: float, greatest: float, table: Span) -> str:
    """Return, as a question, the unit of temperature for which the readings would be inside a table."""
    for unit, scale, zero in (("degF", 1.0 / 1.8, 32.0), ("K", 1.0, 273.15)):
        if table[0] <= (least - zero) * scale and (greatest - zero) * scale <= table[1]:
            return f" (is the temperature in {unit}, not degC?)"
    return ""


def find_extrapolated(temp_c: FloatArray, plans: Plans, corrected: tuple[FloatArray, FloatArray]) -> BoolArray | None:
    """Find the samples whose correction uses nodes without nearby data, or return None. ``corrected`` (N, 3) is in SI units."""
    mask: BoolArray | None = None
    for plan, rates in zip(plans, corrected, strict=True):
        for table in () if plan is None else plan.tables:
            if plan is not None and _meets_marks(table, temp_c):
                used = _weight_of_marks(table, temp_c, rates) > ON_NODE
                used &= (temp_c >= plan.temp_range[0]) & (temp_c <= plan.temp_range[1])
                mask = used if mask is None else mask | used
    return mask


def _meets_marks(table: LookupTable, temp_c: FloatArray) -> bool:
    """Return True if a node next to any of the temperatures is marked as extrapolated."""
    if table.extrapolated is None:
        return False
    nodes, (least, greatest) = table.temp.nodes, extremes(temp_c)
    near = slice(max(int(nodes.searchsorted(least, "right")) - 1, 0), int(nodes.searchsorted(greatest)) + 1)
    return bool(table.extrapolated[near].any())


def _weight_of_marks(table: LookupTable, temp_c: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the interpolation weight (N,) of extrapolated nodes in a table's values."""
    marks = np.asarray(table.extrapolated, dtype=float)
    if table.turn_rate is None:
        return np.asarray(np.interp(temp_c, table.temp.nodes, marks))
    from scipy.interpolate import RegularGridInterpolator

    weight = RegularGridInterpolator((table.temp.nodes, table.turn_rate.nodes), marks, bounds_error=False)
    inside = np.clip(rates, *table.turn_rate.nodes[[0, -1]])
    return np.asarray(np.fmax.reduce([weight((temp_c, rate)) for rate in inside.T]))


def temperature_reach(temp_c: FloatArray, calibration: Calibration, plans: Plans) -> tuple[Span, float]:
    """Return minimum and maximum temperature, degC, and the largest distance to the temperature of constant offsets."""
    reference = calibration.reference_temp_c
    constant = np.isfinite(reference) and any(
        plan is not None and triad.model is not None and plan.offset_table is None
        for plan, triad in zip(plans, calibration.triads, strict=True)
    )
    if not len(temp_c) or not (has_tables(plans) or constant):
        return NOWHERE, 0.0
    least, greatest = extremes(temp_c)
    return (least, greatest), max(greatest - reference, reference - least) if constant else 0.0


def extremes(values: FloatArray) -> Span:
    """Return minimum and maximum without gaps. The plain reductions are several times faster, but return NaN if there are gaps."""
    least, greatest = float(values.min()), float(values.max())
    if np.isnan(least):
        return float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))
    return least, greatest


# ---- findings


def coverage_findings(reach: Reach, calibration: Calibration) -> tuple[Finding, ...]:
    """Return findings about readings beyond the tables, or beyond the temperatures of constant offsets."""
    drift, findings = calibration.drift, list[Finding]()
    extend = "Extend the thermal session to these temperatures and rates."
    if (seconds := reach.seconds_without_temperature) > 0.0:
        sentence = f"The drift table has no temperature for {seconds:.1f} s, so the result is a gap (NaN) there."
        findings.append(
            finding("correct.no_temperature", "warn", sentence, "Fill in the temperature.", seconds=seconds)
        )
    if (seconds := reach.seconds_outside) > 0.0:
        low, high, lag_s = *reach.temp_c, drift.lag_s if drift else 0.0
        lag = f", after subtraction of {lag_s:g} s of thermometer lag" if lag_s else ""
        sentence = f"{seconds:.1f} s are outside the drift table: {low:.1f} to {high:.1f} degC were recorded{lag}."
        findings.append(finding("correct.outside", "warn", sentence, extend, seconds=seconds))
    if (seconds := reach.seconds_extrapolated) > 0.0:
        sentence = (
            f"The drift table is extrapolated for {seconds:.1f} s: it has no data near these temperatures and rates."
        )
        findings.append(finding("correct.outside", "warn", sentence, extend, seconds=seconds))
    if (departure := reach.departure_c) > REFERENCE_SPAN_C:
        size, reference_c = told_apart(departure, ".1f", REFERENCE_SPAN_C), calibration.reference_temp_c
        sentence = f"The temperature differs by up to {size} degC from the reference, {reference_c:.1f} degC. Constant offsets are "
        sentence += f"valid within {REFERENCE_SPAN_C:g} degC."
        action = "Fit a drift table (undrift drift)."
        findings.append(finding("correct.departure", "warn", sentence, action, departure_c=departure))
    rates = drift.dynamic.turn_rate if drift and drift.dynamic else None
    if rates is not None and (reach.turn_rate[0] < rates[0] or reach.turn_rate[1] > rates[-1]):
        least, greatest, first, last = np.degrees((*reach.turn_rate, rates[0], rates[-1]))
        recorded = f"{told_apart(least, '.1f', first)} to {told_apart(greatest, '.1f', last)} deg/s"
        covered = f"{told_apart(first, '.1f', least)} to {told_apart(last, '.1f', greatest)} deg/s"
        sentence = (
            f"The turn rates {recorded} are outside the dynamic drift table ({covered}). Its end values were used."
        )
        findings.append(finding("correct.outside", "warn", sentence, extend, least_dps=least, greatest_dps=greatest))
    return tuple(findings)


def model_findings(record: Record, calibration: Calibration, carry: Carry) -> tuple[Finding, ...]:
    """Return findings about errors that the calibration does not correct, and about device names that differ."""
    findings = [
        finding("correct.sensors_differ", "info", f"The calibration has no {triad.sensor}: nominal values were used.")
        for triad, values in zip(calibration.triads, (record.gyro, record.accel), strict=True)
        if values is not None and triad.model is None
    ]
    if record.device and calibration.device and record.device != calibration.device:
        sentence = f"The recording is of device {record.device}, and the calibration is of device {calibration.device}."
        findings.append(finding("correct.device", "warn", sentence, "Check that they belong together."))
    gyro, warm_up = calibration.gyro, calibration.triad("gyro").warm_up
    if record.gyro is not None and gyro is not None and warm_up is not None and carry.power_on_time is None:
        rates = warm_up.gyro_offset @ gyro.matrix.T * si_factor(gyro.unit_out, "rate")
        largest_dps, end_s = np.degrees(np.abs(rates).max()), warm_up.power_on_s[-1]
        findings.append(
            finding(
                "correct.warm_up",
                "info",
                f"No warm-up was subtracted: up to {largest_dps:.2g} deg/s, zero from {end_s:g} s after power-on.",
                "Correct the raw recording with `power_on_s`, the time from power-on to its first sample.",
                largest_dps=largest_dps,
            )
        )
    return tuple(findings)
