"""Where a calibration does not cover a record: temperatures beyond its tables, rates beyond them, constant offsets stretched."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration
from undrift.drift.plan import Plans
from undrift.errors import DriftRangeError
from undrift.record import Record

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
    """

    seconds_outside: float = 0.0
    temp_c: Span = NOWHERE
    departure_c: float = 0.0
    turn_rate: Span = NOWHERE

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
        )


UNMOVED = Reach()  # before the first sample


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


def reach_of(record: Record, calibration: Calibration, plans: Plans, outside: BoolArray, turn_rate: Span) -> Reach:
    """Find how far a record went.

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
    turn_rate : tuple of float
        Least and greatest measured rate that met the dynamic table, rad/s.

    Returns
    -------
    Reach
        Of these samples.
    """
    reference = calibration.reference_temp_c
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    constant = np.isfinite(reference) and any(
        plan is not None and model is not None and (plan.tables is None or plan.tables.offset.size == 0)
        for plan, model in zip(plans, (calibration.gyro, calibration.accel), strict=True)
    )
    if record.temp_c is None or not (tables or constant):
        return Reach(turn_rate=turn_rate)
    least, greatest = _extremes(record.temp_c)
    return Reach(
        seconds_outside=float(outside.sum()) / record.sample_rate_hz if outside.any() else 0.0,
        temp_c=(least, greatest),
        departure_c=max(greatest - reference, reference - least) if constant else 0.0,
        turn_rate=turn_rate,
    )


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
    if reach.seconds_outside > 0.0:
        said.append(
            f"{reach.seconds_outside:.1f} s lie outside the drift table: {reach.temp_c[0]:.1f} to {reach.temp_c[1]:.1f} degC "
            "were recorded"
        )
    if reach.departure_c > reference_span_c:
        said.append(
            f"the temperature departs by up to {reach.departure_c:.1f} degC from {calibration.reference_temp_c:.1f} degC, where "
            f"the constant offsets hold; a tuning table is needed beyond {reference_span_c:g} degC"
        )
    dynamic = calibration.drift.dynamic if calibration.drift else None
    if dynamic is not None and (
        reach.turn_rate[0] < dynamic.turn_rate[0] or reach.turn_rate[1] > dynamic.turn_rate[-1]
    ):
        least, greatest, low, high = np.degrees((*reach.turn_rate, dynamic.turn_rate[0], dynamic.turn_rate[-1]))
        said.append(
            f"rates reached {least:.1f} to {greatest:.1f} deg/s, the dynamic table ends at {low:.1f} and {high:.1f} deg/s and "
            "was held there"
        )
    return tuple(said)


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
