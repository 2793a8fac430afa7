"""Where a calibration does not cover a record: temperatures missing, beyond its tables or where they are extrapolated, rates
beyond them, constant offsets stretched. Temperatures are those of the sensors (correction/plan.py), not those of a thermometer that
trails them.

Which corrected readings lie beyond the span of inputs that the fit of a triad has seen.

A fit holds where it was made: M and the offset come from values between ``valid_range``, and a reading outside is corrected by
extrapolation, which non-linearity does not follow. A reading counts as beyond where it leaves the span by more than a tenth of
the span's reach, since noise alone carries a device that lies on a face past +-1 g. Nothing is changed by this; it is told.

How long marked samples last, by their own clock: each stands for the time since the sample before it.

Times are put on a grid of 2^-30 s (about 1 ns) first. Sums of such steps are exact up to 97 days, so that it does not matter in
which pieces they are taken: the chunks of a stream give the bits of the batch.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.correction.plan import NONE_MET, Buffers, Doubt, Plans, Stated, flat, in_pieces, mark_extrapolated
from undrift.errors import DriftRangeError
from undrift.model import Calibration, TriadModel
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, si_factor

# ---- Which corrected readings lie beyond the span of inputs that the fit of a triad has seen.

MARGIN = 0.1  # of the reach, the larger end of the span


@dataclass(frozen=True, slots=True, kw_only=True)
class Beyond:
    """Readings of one triad beyond what its fit has seen; of a record, or of all chunks of a stream so far."""

    sensor: str  # gyro or accel
    seen: tuple[float, float]  # Least and greatest value that the fit has seen, SI
    samples: int = 0  # With a value on any axis that lies beyond by more than a tenth of the reach
    of: int = 0  # Samples looked at
    worst: float = 0.0  # The value that lies furthest beyond, SI; 0 where none does

    @property
    def share(self) -> float:
        """Share of the samples."""
        return self.samples / self.of if self.of else 0.0

    def joined(self, later: "Beyond") -> "Beyond":
        """Return both."""
        worst = max(self.worst, later.worst, key=lambda value: _outside(value, self.seen))
        return Beyond(
            sensor=self.sensor, seen=self.seen, samples=self.samples + later.samples, of=self.of + later.of, worst=worst
        )

    @property
    def text(self) -> str:
        """One sentence, empty where nothing lies beyond."""
        if not self.samples:
            return ""
        what, unit, factor = "gyroscope", "deg/s", RADIAN_PER_DEGREE
        if self.sensor == "accel":
            what, unit, factor = "accelerometer", "g", STANDARD_GRAVITY
        low, high, worst = (value / factor for value in (*self.seen, self.worst))
        return (
            f"{what}: {_percent(self.share)} of the samples lie beyond what the calibration has seen, {low:.3g} to {high:.3g} "
            f"{unit}, by more than a tenth; the worst is {worst:.4g} {unit}: the model is extrapolated there"
        )


def find_beyond(record: Record, calibration: Calibration) -> tuple[Beyond, ...]:
    """Find the corrected readings that lie beyond what the fits have seen."""
    triads: tuple[tuple[str, FloatArray | None, TriadModel | None, Quantity], ...] = (
        ("gyro", record.gyro, calibration.gyro, "rate"),
        ("accel", record.accel, calibration.accel, "accel"),
    )
    found = []
    for name, values, model, quantity in triads:
        if values is None or model is None or not model.valid_range[0] < model.valid_range[1]:
            continue
        factor = si_factor(model.unit_out, quantity)
        low, high = (end * factor for end in model.valid_range)
        found.append(_of_triad(name, values, (low, high)))
    return tuple(found)


def _of_triad(name: str, values: FloatArray, seen: tuple[float, float]) -> Beyond:
    room = MARGIN * max(abs(seen[0]), abs(seen[1]))
    low, high = seen[0] - room, seen[1] + room
    least, greatest = float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))
    if not (least < low or greatest > high):  # one pass, and most recordings end here
        return Beyond(sensor=name, seen=seen, of=len(values))
    mask = (values < low) | (values > high)
    worst = max(least, greatest, key=lambda value: _outside(value, seen))
    samples = int(np.count_nonzero(mask[:, 0] | mask[:, 1] | mask[:, 2]))
    return Beyond(sensor=name, seen=seen, samples=samples, of=len(values), worst=worst)


def _outside(value: float, seen: tuple[float, float]) -> float:
    return max(seen[0] - value, value - seen[1], 0.0)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.0995 else f"{100.0 * share:.0f} %"


# ---- How long marked samples last, by their own clock: each stands for the time since the sample before it.

TICKS_PER_S = 2.0**30


def seconds_of(mask: BoolArray, time: FloatArray, before: float | None) -> float:
    """Return how long the marked samples last: the sum of t_k - t_(k-1) over them.

    Arrays: mask (N,), time (N,) s.
    """
    if not mask.any():
        return 0.0
    first = 2.0 * time[0] - time[1] if before is None else before
    ticks = np.round(np.concatenate(([first], time)) * TICKS_PER_S)
    return float(np.diff(ticks)[mask].sum() / TICKS_PER_S)


# ---- coverage

Span = tuple[float, float]  # least and greatest
NOWHERE: Span = (np.inf, -np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """How far readings went, as far as the calibration cares; of a record, or of all chunks of a stream so far."""

    seconds_outside: float = 0.0  # Time spent beyond the tuning tables, s
    # Least and greatest temperature, degC; infinite the wrong way round where nothing depends on it
    temp_c: Span = NOWHERE
    # How far the temperature left the one at which constant offsets were found, degC; 0 where no offset is constant
    departure_c: float = 0.0
    # Least and greatest measured rate that met the dynamic table, rad/s; infinite the wrong way round without one
    turn_rate: Span = NOWHERE
    seconds_extrapolated: float = 0.0  # Time spent inside the tables at nodes that no data were near, s
    stated: Stated = NONE_MET  # Largest standard uncertainties that the tables state at those nodes
    # Time without the temperature that the tables want, s: the result is a gap there, whatever the policy
    seconds_without_temperature: float = 0.0

    def joined(self, later: "Reach") -> "Reach":
        """Return the reach of both."""
        return Reach(
            seconds_outside=self.seconds_outside + later.seconds_outside,
            temp_c=(min(self.temp_c[0], later.temp_c[0]), max(self.temp_c[1], later.temp_c[1])),
            departure_c=max(self.departure_c, later.departure_c),
            turn_rate=(min(self.turn_rate[0], later.turn_rate[0]), max(self.turn_rate[1], later.turn_rate[1])),
            seconds_extrapolated=self.seconds_extrapolated + later.seconds_extrapolated,
            stated=self.stated.joined(later.stated),
            seconds_without_temperature=self.seconds_without_temperature + later.seconds_without_temperature,
        )


UNMOVED = Reach()  # before the first sample


def find_missing(record: Record, temp_c: FloatArray, plans: Plans) -> BoolArray:
    """Find the samples without the temperature that a tuning table wants.

    Arrays: temp_c (N,) degC -> (N,).
    """
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    if not tables or not np.isnan(temp_c.min()):  # a least value is NaN where any is
        return np.zeros(len(record), dtype=bool)
    return np.isnan(temp_c)


def find_outside(
    record: Record, temp_c: FloatArray, plans: Plans, *, allowed: bool, before: float | None = None
) -> BoolArray:
    """Find the samples whose temperature lies beyond a tuning table.

    Arrays: temp_c (N,) -> (N,).
    """
    ranges = [plan.temp_range for plan in plans if plan is not None and plan.tables is not None]
    if not ranges:
        return np.zeros(len(record), dtype=bool)
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    least, greatest = _extremes(temp_c)
    if least >= low and greatest <= high:
        return np.zeros(len(record), dtype=bool)
    mask = (temp_c < low) | (temp_c > high)
    if mask.any() and not allowed:
        raise DriftRangeError(
            f"drift table: wanted temperatures from {low:g} to {high:g} degC, got {least:.1f} to {greatest:.1f} degC, "
            f"{seconds_of(mask, record.time, before):.1f} s of them outside; extend the table, or choose the policy hold "
            "or nan",
            low=low,
            high=high,
            least=least,
            greatest=greatest,
        )
    return mask


def find_extrapolated(
    record: Record, temp_c: FloatArray, plans: Plans, corrected: Buffers, threads: int | None
) -> tuple[BoolArray, Stated]:
    """Find the samples whose correction draws on nodes that no data were near.

    Arrays: temp_c (N,) degC, corrected (N, 3) -> (N,).
    """
    mask, stated = np.zeros(len(record), dtype=bool), NONE_MET
    if not any(plan is not None and plan.doubts for plan in plans):
        return mask, stated
    least, greatest = _extremes(temp_c)
    for plan, values in zip(plans, corrected, strict=True):
        if plan is None or not plan.doubts:
            continue
        span = (max(plan.temp_range[0], least), min(plan.temp_range[1], greatest))
        work = partial(_mark, plan.doubts, span, temp_c, values, mask)
        for found in in_pieces(work, len(record), threads):
            stated = stated.joined(found)
    return mask, stated


def _mark(
    doubts: tuple[Doubt, ...],
    span: Span,
    temp_c: FloatArray,
    values: FloatArray,
    mask: BoolArray,
    start: int,
    stop: int,
) -> Stated:
    piece = slice(start, stop)
    return mark_extrapolated(doubts, temp_c[piece], span, flat(values, start, stop), mask[piece])


def temperature_reach(temp_c: FloatArray, calibration: Calibration, plans: Plans) -> Reach:
    """Find how far the temperature went, as far as the calibration cares.

    Arrays: temp_c (N,) degC.
    """
    reference = calibration.reference_temp_c
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    constant = np.isfinite(reference) and any(
        plan is not None and model is not None and (plan.tables is None or plan.tables.offset.size == 0)
        for plan, model in zip(plans, (calibration.gyro, calibration.accel), strict=True)
    )
    if not len(temp_c) or not (tables or constant):
        return UNMOVED
    least, greatest = _extremes(temp_c)
    departure_c = max(greatest - reference, reference - least) if constant else 0.0
    return Reach(temp_c=(least, greatest), departure_c=departure_c)


def warnings_on(reach: Reach, calibration: Calibration, reference_span_c: float) -> tuple[str, ...]:
    """Say where readings left the tables, or the span in which constant offsets hold."""
    said: list[str] = []
    drift = calibration.drift
    if reach.seconds_without_temperature > 0.0:
        said.append(
            f"{reach.seconds_without_temperature:.1f} s have no temperature: the drift table cannot be looked up there, and what "
            "it corrects is a gap (NaN) whatever the policy; fill the temperature in"
        )
    if reach.seconds_outside > 0.0:
        lag_s = drift.lag_s if drift else 0.0
        said.append(
            f"{reach.seconds_outside:.1f} s lie outside the drift table: {reach.temp_c[0]:.1f} to {reach.temp_c[1]:.1f} degC "
            "were recorded" + (f", the thermometer's lag of {lag_s:g} s taken off" if lag_s > 0.0 else "")
        )
    if reach.seconds_extrapolated > 0.0:
        said.append(
            f"{reach.seconds_extrapolated:.1f} s lie where the drift table is extrapolated, no data were near: "
            f"{_stated_text(reach.stated)}"
        )
    if reach.departure_c > reference_span_c:
        said.append(
            f"the temperature departs by up to {reach.departure_c:.1f} degC from {calibration.reference_temp_c:.1f} degC, where "
            f"the constant offsets hold; a tuning table is needed beyond {reference_span_c:g} degC"
        )
    rates = drift.dynamic.turn_rate if drift and drift.dynamic else None
    if rates is not None and (reach.turn_rate[0] < rates[0] or reach.turn_rate[1] > rates[-1]):
        least, greatest, low, high = np.degrees((*reach.turn_rate, rates[0], rates[-1]))
        said.append(
            f"rates reached {least:.1f} to {greatest:.1f} deg/s, the dynamic table ends at {low:.1f} and {high:.1f} deg/s and "
            "was held there"
        )
    return tuple(said)


def _stated_text(stated: Stated) -> str:
    values = (
        (np.degrees(stated.rate), "deg/s"),
        (stated.accel / si_factor("mg", "accel"), "mg"),
        (100.0 * stated.scale, "% of the reading"),
    )
    if np.isinf([value for value, _ in values]).any():
        return "it does not state how uncertain it is there"
    return "its standard uncertainty there reaches " + ", ".join(f"{v:.2g} {unit}" for v, unit in values if v > 0.0)


def notes_on(record: Record, calibration: Calibration, *, power_on_known: bool) -> tuple[str, ...]:
    """Say what a reader of the corrected record may not expect."""
    notes = [
        f"{name}: the calibration has no model, nominal values were passed on"
        for name, values, model in (("gyro", record.gyro, calibration.gyro), ("accel", record.accel, calibration.accel))
        if values is not None and model is None
    ]
    if record.device and calibration.device and record.device != calibration.device:
        notes.append(f"the recording is of {record.device}, the calibration of {calibration.device}")
    static = calibration.drift.static if calibration.drift else None
    if record.gyro is None or calibration.gyro is None or static is None:
        return tuple(notes)
    if static.gyro_hysteresis is not None and static.gyro_offset is not None:
        left = _largest_dps(calibration.gyro, static.gyro_hysteresis)
        notes.append(
            f"hysteresis: the table holds the middle of warming and cooling, either is off by up to {left:.2g} deg/s of rate"
        )
    if static.warm_up is not None and not power_on_known:
        most, end = _largest_dps(calibration.gyro, static.warm_up.gyro_offset), static.warm_up.power_on_s[-1]
        notes.append(
            f"no warm-up was subtracted: it reaches {most:.2g} deg/s and is over {end:g} s after power-on; give the time since "
            "power-on at the first sample"
        )
    return tuple(notes)


def _largest_dps(model: TriadModel, offset: FloatArray) -> float:
    """The largest rate that offsets (..., 3) feign, deg/s."""
    rate = np.nan_to_num(offset) @ model.matrix.T * si_factor(model.unit_out, "rate")
    return float(np.degrees(np.abs(rate).max()))


def _extremes(temp: FloatArray) -> tuple[float, float]:
    """Least and greatest, gaps left out; the plain reductions are several times faster and tell when there is a gap."""
    least, greatest = float(temp.min()), float(temp.max())
    if np.isnan(least):
        return float(np.fmin.reduce(temp)), float(np.fmax.reduce(temp))
    return least, greatest
