"""Where a calibration does not cover a record, as masks, seconds and findings; nothing is changed by it.

::

    missing        no temperature was recorded, and a table needs one
    outside        the temperature lies beyond a table; under policy raise also 3 degC beyond what was seen
    extrapolated   it lies inside, at nodes that no data were near
    departure      constant offsets are used far from the temperature at which they were found
    turn rate      beyond the dynamic table
    beyond range   a corrected reading leaves ``valid_range``, the inputs that the fit of its triad has seen

Temperatures are those of the sensors, the thermometer's lag subtracted (correction/plan.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.correction.plan import Carry, Kind, MarkedTable, Plans, flat, has_tables, in_pieces
from undrift.errors import DriftRangeError
from undrift.findings import Finding, finding
from undrift.model import BEYOND_SEEN_C, Calibration, DriftTables, StaticDrift, TriadModel, seen_span
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

Span = tuple[float, float]  # least and greatest
NOWHERE: Span = (np.inf, -np.inf)
KINDS: tuple[Kind, ...] = ("rate", "accel", "scale")
TICKS_PER_S = 2.0**30
MARGIN = 0.1  # of the larger end of valid_range: noise alone carries a device that lies on a face past +-1 g


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """How far readings went, as far as the calibration cares; of a record, or of all chunks of a stream so far."""

    seconds_outside: float = 0.0  # beyond the tuning tables
    temp_c: Span = NOWHERE  # degC; infinite the wrong way round where nothing depends on it
    departure_c: float = 0.0  # from the temperature of the constant offsets, degC; 0 where no offset is constant
    turn_rate: Span = NOWHERE  # measured, that met the dynamic table, rad/s; infinite the wrong way round without one
    seconds_extrapolated: float = 0.0  # inside the tables at nodes that no data were near
    # Largest standard uncertainties that tables state at those nodes: rate, rad/s; accel, m/s2; scale, a share of either, 1
    stated: Mapping[Kind, float] = field(default_factory=lambda: dict.fromkeys(KINDS, 0.0))
    seconds_without_temperature: float = 0.0  # that the tables need: the result is a gap there, whatever the policy

    def joined(self, later: "Reach") -> "Reach":
        """Return the reach of both."""
        sums = ("seconds_outside", "seconds_extrapolated", "seconds_without_temperature")
        return Reach(
            **{name: getattr(self, name) + getattr(later, name) for name in sums},
            temp_c=(min(self.temp_c[0], later.temp_c[0]), max(self.temp_c[1], later.temp_c[1])),
            departure_c=max(self.departure_c, later.departure_c),
            turn_rate=(min(self.turn_rate[0], later.turn_rate[0]), max(self.turn_rate[1], later.turn_rate[1])),
            stated={kind: max(self.stated[kind], later.stated[kind]) for kind in KINDS},
        )


def seconds_of(mask: BoolArray | None, time: FloatArray, before: float | None) -> float:
    """Return how long marked samples last, each t_k - t_(k-1) by their own clock; mask and time (N,), time s.

    Times are put on a grid of 2^-30 s first. Sums of such steps are exact up to 97 days: chunks of a stream give the batch's bits.
    """
    if mask is None or not mask.any():
        return 0.0
    first = 2.0 * time[0] - time[1] if before is None else before
    ticks = np.round(np.concatenate(([first], time)) * TICKS_PER_S)
    return float(np.diff(ticks)[mask].sum() / TICKS_PER_S)


# ---- masks, (N,)


def find_outside(
    record: Record, temp_c: FloatArray, plans: Plans, drift: DriftTables, *, allowed: bool, before: float | None
) -> BoolArray | None:
    """Find the samples whose temperature lies beyond a tuning table; where that is refused, also beyond what the table saw.

    None where there is no such sample.
    """
    ranges = [plan.temp_range for plan in plans if plan is not None and plan.tables is not None]
    if not ranges:
        return None
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if drift.static is not None and not allowed:
        seen = _seen(drift.static)
        beyond = BEYOND_SEEN_C * (2.0 if drift.lag_s > 0.0 else 1.0)  # subtracting a lag makes a thermometer noisier
        low, high = max(low, seen[0] - beyond), min(high, seen[1] + beyond)
    least, greatest = _extremes(temp_c)
    if least >= low and greatest <= high:
        return None
    mask = (temp_c < low) | (temp_c > high)
    if mask.any() and not allowed:
        raise DriftRangeError(
            f"drift table: wanted temperatures from {low:g} to {high:g} degC, got {least:.1f} to {greatest:.1f} degC, "
            f"{seconds_of(mask, record.time, before):.1f} s of them outside{_other_unit(least, greatest, (low, high))}; "
            "extend the table, or choose the policy hold or nan",
            low=low,
            high=high,
            least=least,
            greatest=greatest,
        )
    return mask


def _other_unit(least: float, greatest: float, table: Span) -> str:
    """Return the unit of temperature that would put the readings inside a table, as a question."""
    for unit, scale, zero in (("degF", 1.0 / 1.8, 32.0), ("K", 1.0, 273.15)):
        if table[0] <= (least - zero) * scale and (greatest - zero) * scale <= table[1]:
            return f" (is the temperature in {unit}, not degC?)"
    return ""


def _seen(static: StaticDrift) -> Span:
    """Return the first and last node that data were near; without marks, all; offsets of gyroscopes where there are some."""
    marks = static.gyro_extrapolated if static.gyro_extrapolated is not None else static.accel_extrapolated
    return seen_span(static.temp_c, marks)


def find_extrapolated(
    record: Record, temp_c: FloatArray, plans: Plans, corrected: tuple[FloatArray, FloatArray], threads: int | None
) -> tuple[BoolArray | None, dict[Kind, float]]:
    """Find the samples whose correction draws on nodes that no data were near, None without such; corrected (N, 3), SI."""
    stated = dict.fromkeys(KINDS, 0.0)
    tables = [
        (plan, table, values) for plan, values in zip(plans, corrected, strict=True) if plan for table in plan.marked
    ]
    if not tables:
        return None, stated
    mask, (least, greatest) = np.zeros(len(record), dtype=bool), _extremes(temp_c)
    for plan, table, values in tables:
        low, high = max(plan.temp_range[0], least), min(plan.temp_range[1], greatest)
        if not _may_meet(table, low, high):  # most records stay where data were near
            continue

        def mark(
            start: int, stop: int, table: MarkedTable = table, values: FloatArray = values, ends: Span = (low, high)
        ) -> float:
            from undrift.kernels.correct import mark_line, mark_plane

            temp, marks = temp_c[start:stop], mask[start:stop]
            if table.rate is None:
                return float(mark_line(temp, *ends, table.temp, table.stated, marks))
            rates = flat(values, start, stop)
            return float(mark_plane(temp, rates, *ends, table.temp, table.rate, table.stated, marks))

        stated[table.kind] = max(stated[table.kind], *in_pieces(mark, len(record), threads))
    return mask, stated


def _may_meet(table: MarkedTable, low: float, high: float) -> bool:
    """Whether any half from the least to the greatest temperature is extrapolated."""
    from undrift.kernels.correct import half

    if not low <= high:  # all outside, or gaps alone
        return False
    rows = table.stated.reshape(2 * table.temp.cells + 1, -1)
    return bool((rows[int(half(table.temp, low)) : int(half(table.temp, high)) + 1] >= 0.0).any())


def temperature_reach(temp_c: FloatArray, calibration: Calibration, plans: Plans) -> tuple[Span, float]:
    """Return the least and greatest temperature, and how far they depart from that of constant offsets, degC."""
    reference = calibration.reference_temp_c
    constant = np.isfinite(reference) and any(
        plan is not None and triad.model is not None and (plan.tables is None or plan.tables.offset.size == 0)
        for plan, triad in zip(plans, calibration.triads, strict=True)
    )
    if not len(temp_c) or not (has_tables(plans) or constant):
        return NOWHERE, 0.0
    least, greatest = _extremes(temp_c)
    return (least, greatest), max(greatest - reference, reference - least) if constant else 0.0


def _extremes(temp: FloatArray) -> Span:
    """Least and greatest, gaps left out; the plain reductions are several times faster, and NaN where there is a gap."""
    least, greatest = float(temp.min()), float(temp.max())
    if np.isnan(least):
        return float(np.fmin.reduce(temp)), float(np.fmax.reduce(temp))
    return least, greatest


# ---- findings


def coverage_findings(reach: Reach, calibration: Calibration, reference_span_c: float) -> tuple[Finding, ...]:
    """Return where readings left the tables, or the temperatures at which constant offsets hold."""
    drift, findings = calibration.drift, list[Finding]()
    if reach.seconds_without_temperature > 0.0:
        findings.append(finding("correct.no_temperature", "warn", seconds=reach.seconds_without_temperature))
    if (seconds := reach.seconds_outside) > 0.0:
        low, high, lag_s = *reach.temp_c, drift.lag_s if drift else 0.0
        findings.append(finding("correct.outside", "warn", seconds=seconds, low_c=low, high_c=high, lag_s=lag_s))
    if reach.seconds_extrapolated > 0.0:
        findings.append(_extrapolated(reach))
    if (away := reach.departure_c) > reference_span_c:
        at, span = calibration.reference_temp_c, reference_span_c
        findings.append(finding("correct.departure", "warn", departure_c=away, reference_c=at, span_c=span))
    rates = drift.dynamic.turn_rate if drift and drift.dynamic else None
    if rates is not None and (reach.turn_rate[0] < rates[0] or reach.turn_rate[1] > rates[-1]):
        least, greatest, first, last = np.degrees((*reach.turn_rate, rates[0], rates[-1]))
        findings.append(
            finding("correct.turn_rate", "warn", least_dps=least, greatest_dps=greatest, first_dps=first, last_dps=last)
        )
    return tuple(findings)


def _extrapolated(reach: Reach) -> Finding:
    rate, accel, scale = (reach.stated[kind] for kind in KINDS)
    values = np.array((np.degrees(rate), accel / si_factor("mg", "accel"), 100.0 * scale))
    if np.isinf(values).any():
        return finding("correct.extrapolated_unstated", "warn", seconds=reach.seconds_extrapolated)
    units = ("deg/s", "mg", "% of the reading")
    met = tuple(f"{value:.2g} {unit}" for value, unit in zip(values, units, strict=True) if value > 0.0)
    return finding("correct.extrapolated", "warn", seconds=reach.seconds_extrapolated, uncertainty=met)


def model_findings(record: Record, calibration: Calibration, carry: Carry) -> tuple[Finding, ...]:
    """Return what a reader of the corrected record may not expect."""
    findings = [
        finding("correct.no_model", "info", sensor=triad.sensor)
        for triad, values in zip(calibration.triads, (record.gyro, record.accel), strict=True)
        if values is not None and triad.model is None
    ]
    if record.device and calibration.device and record.device != calibration.device:
        findings.append(finding("correct.device", "warn", recorded=record.device, calibrated=calibration.device))
    gyro, static = calibration.gyro, calibration.drift.static if calibration.drift else None
    if record.gyro is None or gyro is None or static is None:
        return tuple(findings)
    if static.gyro_hysteresis is not None and static.gyro_offset is not None:
        widest = _largest_dps(gyro, static.gyro_hysteresis)
        findings.append(finding("correct.hysteresis", "info", half_width_dps=widest))
    if static.warm_up is not None and carry.power_on_time is None:
        largest, end = _largest_dps(gyro, static.warm_up.gyro_offset), static.warm_up.power_on_s[-1]
        findings.append(finding("correct.warm_up", "info", largest_dps=largest, end_s=end))
    return tuple(findings)


def _largest_dps(model: TriadModel, offset: FloatArray) -> float:
    """The largest rate that offsets (..., 3) cause, deg/s."""
    rate = np.nan_to_num(offset) @ model.matrix.T * si_factor(model.unit_out, "rate")
    return float(np.degrees(np.abs(rate).max()))


# ---- corrected readings beyond the inputs that the fit of a triad has seen


@dataclass(frozen=True, slots=True, kw_only=True)
class Beyond:
    """Readings of one triad beyond ``valid_range``; of a record, or of all chunks of a stream so far."""

    sensor: str  # gyro or accel
    seen: Span  # least and greatest value in the fit, SI
    samples: int = 0  # with a value on any axis that lies beyond by more than a tenth of the larger end
    of: int = 0  # samples looked at
    worst: float = 0.0  # the value that lies furthest beyond, SI; 0 where none does

    @property
    def share(self) -> float:
        """Share of the samples."""
        return self.samples / self.of if self.of else 0.0

    def joined(self, later: "Beyond") -> "Beyond":
        """Return both."""
        samples, of, worst = self.samples + later.samples, self.of + later.of, (self.worst, later.worst)
        return replace(self, samples=samples, of=of, worst=_furthest(*worst, self.seen))

    @property
    def text(self) -> str:
        """One sentence, empty where nothing lies beyond."""
        return "".join(one.text for one in self.findings)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The finding, none where nothing lies beyond."""
        if not self.samples:
            return ()
        gyro = self.sensor == "gyro"
        unit = RADIAN_PER_DEGREE if gyro else STANDARD_GRAVITY
        low, high, worst = (value / unit for value in (*self.seen, self.worst))
        sensor, shown = ("gyroscope", "deg/s") if gyro else ("accelerometer", "g")
        values = {"percent": 100.0 * self.share, "low": low, "high": high, "worst": worst}
        return (finding("correct.beyond_range", "warn", sensor=sensor, unit=shown, **values),)


def find_beyond(record: Record, calibration: Calibration) -> tuple[Beyond, ...]:
    """Find the corrected readings beyond what the fits have seen: extrapolation, which non-linearity does not follow."""
    beyond = []
    for triad, values in zip(calibration.triads, (record.gyro, record.accel), strict=True):
        model = triad.model
        if values is None or model is None or not model.valid_range[0] < model.valid_range[1]:
            continue
        seen = (model.valid_range[0] * triad.si, model.valid_range[1] * triad.si)
        margin = MARGIN * max(abs(seen[0]), abs(seen[1]))
        low, high = seen[0] - margin, seen[1] + margin
        least, greatest = _extremes(values.ravel())
        samples, worst = 0, 0.0
        if least < low or greatest > high:  # most recordings end before this second pass
            mask = (values < low) | (values > high)
            samples = int(np.count_nonzero(mask[:, 0] | mask[:, 1] | mask[:, 2]))
            worst = _furthest(least, greatest, seen)
        beyond.append(Beyond(sensor=triad.sensor, seen=seen, samples=samples, of=len(values), worst=worst))
    return tuple(beyond)


def _furthest(one: float, two: float, seen: Span) -> float:
    """The value that lies further beyond."""
    return max(one, two, key=lambda value: max(seen[0] - value, value - seen[1], 0.0))
