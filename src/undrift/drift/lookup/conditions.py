"""What the tables are looked up with, sample by sample: the temperature of the sensors and the time since power-on.

The tables are over the temperature that the sensors have. Where the calibration says that the thermometer trails them (lag_s > 0),
lag.py takes that off, looking back only, and hands its state from chunk to chunk. The record keeps what was recorded; lookup, range
check and warnings look at the temperature without lag.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.drift.lookup.plan import Plans
from undrift.drift.temperature.lag import LagState, without_lag
from undrift.errors import InputError
from undrift.record import Record

NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Carry:
    """What one chunk of a stream hands to the next.

    Parameters
    ----------
    power_on_time : float or None
        When the device was switched on, on the recording's clock, s; None where that is not known.
    lag : LagState or None
        Where taking off the thermometer's lag has come to; None before the first sample, or without lag.
    last_time : float or None
        Time of the last sample, s; None before the first.
    """

    power_on_time: float | None = None
    lag: LagState | None = None
    last_time: float | None = None


UNKNOWN = Carry()  # before the first sample, when power-on is not known


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """What the tables are looked up with.

    Parameters
    ----------
    temp_c : array, shape (N,), or (0,)
        Temperature of the sensors, degC; empty where none was recorded.
    power_on_s : array, shape (N,), or (0,)
        Time since power-on, s; empty where it is not known, no table asks for it, or the warm-up is over.
    carry : Carry
        For the chunk that follows.
    """

    temp_c: FloatArray
    power_on_s: FloatArray
    carry: Carry


def switched_on(first_time: float, power_on_s: float | None) -> Carry:
    """Begin a record or a stream.

    Parameters
    ----------
    first_time : float
        Time of the first sample on the recording's clock, s.
    power_on_s : float or None
        Time since power-on at the first sample, s; None where it is not known.

    Returns
    -------
    Carry
        As before the first sample.

    Raises
    ------
    InputError
        A time since power-on below zero or not finite.
    """
    if power_on_s is None:
        return UNKNOWN
    if not 0.0 <= power_on_s < np.inf:
        raise InputError(
            f"power_on_s: wanted the time since power-on at the first sample, 0 s or more, got {power_on_s:g}; leave it out "
            "where it is not known",
            got=power_on_s,
        )
    return Carry(power_on_time=first_time - power_on_s)


def conditions_of(record: Record, calibration: Calibration, plans: Plans, carry: Carry) -> Conditions:
    """Find what the tables are looked up with.

    Parameters
    ----------
    record : Record
        Raw readings.
    calibration : Calibration
        The device's model.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    carry : Carry
        From the chunk before, or from ``switched_on``.

    Returns
    -------
    Conditions
        Of these samples, with the carry for those that follow; the one given is left as it is.
    """
    drift, lag = calibration.drift, carry.lag
    temp_c = NOTHING if record.temp_c is None else record.temp_c
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    if tables and drift is not None and drift.lag_s > 0.0:
        led, lag = without_lag(temp_c, record.time, lag_s=drift.lag_s, smooth_s=drift.lag_smooth_s, state=lag)
        led[np.isnan(temp_c)] = np.nan  # a gap stays a gap
        temp_c = led
    since: FloatArray = NOTHING
    if carry.power_on_time is not None and plans[0] is not None and plans[0].warm_up is not None:
        since = record.time - carry.power_on_time
        if since[0] >= plans[0].warm_up[0].nodes[-1]:
            since = NOTHING
    coming = Carry(power_on_time=carry.power_on_time, lag=lag, last_time=float(record.time[-1]))
    return Conditions(temp_c=temp_c, power_on_s=since, carry=coming)
