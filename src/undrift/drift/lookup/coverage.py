"""Where a calibration does not cover a record: temperatures missing, beyond its tables or where they are extrapolated, rates
beyond them, constant offsets stretched. Temperatures are those of the sensors (conditions.py), not those of a thermometer that
trails them."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration, TriadModel
from undrift.drift.lookup.buffers import Buffers, flat
from undrift.drift.lookup.duration import seconds_of
from undrift.drift.lookup.extrapolated import NONE_MET, Doubt, Stated, mark_extrapolated
from undrift.drift.lookup.pieces import in_pieces
from undrift.drift.lookup.plan import Plans
from undrift.errors import DriftRangeError
from undrift.record import Record
from undrift.units import si_factor

Span = tuple[float, float]  # least and greatest
NOWHERE: Span = (np.inf, -np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """How far readings went, as far as the calibration cares; of a record, or of all chunks of a stream so far.

    Parameters
    ----------
    seconds_outside : float
        Time spent beyond the tuning tables, s.
    temp_c : tuple of float
        Least and greatest temperature, degC; infinite the wrong way round where nothing depends on it.
    departure_c : float
        How far the temperature left the one at which constant offsets were found, degC; 0 where no offset is constant.
    turn_rate : tuple of float
        Least and greatest measured rate that met the dynamic table, rad/s; infinite the wrong way round without one.
    seconds_extrapolated : float
        Time spent inside the tables at nodes that no data were near, s.
    stated : Stated
        Largest standard uncertainties that the tables state at those nodes.
    seconds_without_temperature : float
        Time without the temperature that the tables want, s: the result is a gap there, whatever the policy.
    """

    seconds_outside: float = 0.0
    temp_c: Span = NOWHERE
    departure_c: float = 0.0
    turn_rate: Span = NOWHERE
    seconds_extrapolated: float = 0.0
    stated: Stated = NONE_MET
    seconds_without_temperature: float = 0.0

    def joined(self, later: "Reach") -> "Reach":
        """Return the reach of both.

        Parameters
        ----------
        later : Reach
            Of the chunk that follows.

        Returns
        -------
        Reach
            Of the stream with it.
        """
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

    Parameters
    ----------
    record : Record
        Raw readings.
    temp_c : array, shape (N,), or (0,)
        What the tables are looked up with, degC; NaN where there is none.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.

    Returns
    -------
    array, shape (N,)
        True there; the triads that have tables cannot be corrected there.
    """
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    if not tables or not np.isnan(temp_c.min()):  # a least value is NaN where any is
        return np.zeros(len(record), dtype=bool)
    return np.isnan(temp_c)


def find_outside(
    record: Record, temp_c: FloatArray, plans: Plans, *, allowed: bool, before: float | None = None
) -> BoolArray:
    """Find the samples whose temperature lies beyond a tuning table.

    Parameters
    ----------
    record : Record
        Raw readings.
    temp_c : array, shape (N,), or (0,)
        What the tables are looked up with, degC: the thermometer's lag taken off where the calibration knows one.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    allowed : bool
        Whether such samples may be.
    before : float or None
        Time of the sample before the first, s; None where there is none.

    Returns
    -------
    array, shape (N,)
        True outside; a gap in temperature is not outside.

    Raises
    ------
    DriftRangeError
        Such samples where none are allowed.
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

    Parameters
    ----------
    record : Record
        Raw readings.
    temp_c : array, shape (N,), or (0,)
        What the tables are looked up with, degC.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    corrected : tuple of two arrays, shape (N, 3)
        rad/s and m/s2.
    threads : int or None
        As for ``in_pieces``.

    Returns
    -------
    mask : array, shape (N,)
        True there; a temperature outside the tables is not.
    stated : Stated
        Largest standard uncertainties that the tables state there.
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

    Parameters
    ----------
    temp_c : array, shape (N,), or (0,)
        Temperature of the sensors, degC; empty where none was recorded.
    calibration : Calibration
        The device's model.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.

    Returns
    -------
    Reach
        Its span, and its departure from where constant offsets hold.
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
    """Say where readings left the tables, or the span in which constant offsets hold.

    Parameters
    ----------
    reach : Reach
        How far they went.
    calibration : Calibration
        The device's model.
    reference_span_c : float
        How far from the reference temperature constant offsets hold, degC.

    Returns
    -------
    tuple of str
        Nothing, or a sentence each.
    """
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
    """Say what a reader of the corrected record may not expect.

    Parameters
    ----------
    record : Record
        Raw readings.
    calibration : Calibration
        The device's model.
    power_on_known : bool
        Whether the time since power-on is.

    Returns
    -------
    tuple of str
        A triad without a model; another serial number; hysteresis that is left; a warm-up that was not subtracted.
    """
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
