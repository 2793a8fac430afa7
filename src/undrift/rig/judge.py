"""Whether a dwell may be kept: the table turned steadily, the device spoke, air and board kept their temperature.

With rate w, dwell T, time d in which a position may have been taken (the link's delay, or a tick) and a = angle_tolerance, a dwell
is refused unless

    |slope - w|           <= tolerance |w| + (a + 2 |w| d) / T
    |between ends - w|    <= tolerance |w| + 2 (a + |w| d) / T
    misfit                <= a                                    no stop, no jump: achieved.py
    2 d / T               <= link_tolerance, where w is not 0     else the link hides what the table does: read once more
    finite readings       >= least_part * rate * T                gaps are no readings
    air, at every look    within the tolerance of the set-point
    board, in eighths     medians within the tolerance of each other, a step of the thermometer more
"""

from dataclasses import dataclass

import numpy as np

from undrift.errors import InputError, RigFault, RigTimeout
from undrift.record import Record
from undrift.rig.achieved import Achieved
from undrift.units import RADIAN_PER_DEGREE

PARTS = 8  # of a dwell, for the board
COARSEST_C = 1.0  # step of a thermometer, K: more is a jump


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """When a run gives up.

    Parameters
    ----------
    turn_rate_tolerance : float
        Achieved against set rate, 1.
    angle_tolerance : float
        A few counts: on top of it, over a dwell, and farthest from a steady turn, rad.
    link_tolerance : float
        Part of a rate that the link's delays may hide, 1.
    least_part : float
        Part of a dwell's readings that must come, 1.
    soak_timeout_s : float
        Longest soak, table s.
    device_lag_s : float
        Time constant with which a device without thermometer follows the air, s; five of them are waited for.
    """

    turn_rate_tolerance: float = 0.03
    angle_tolerance: float = 0.05 * RADIAN_PER_DEGREE
    link_tolerance: float = 0.1
    least_part: float = 0.8
    soak_timeout_s: float = 6.0 * 3600.0
    device_lag_s: float = 120.0

    def __post_init__(self) -> None:
        if not self.device_lag_s >= 0.0:
            raise InputError(
                f"run: wanted a device lag of 0 s or more, got {self.device_lag_s}; state how late it follows the air"
            )


def link_hides(achieved: Achieved, settings: RunSettings) -> bool:
    """Tell whether the positions came too late to say how fast the table turned.

    Parameters
    ----------
    achieved : Achieved
        By the encoder.
    settings : RunSettings
        Tolerances.

    Returns
    -------
    bool
        2 d / T beyond the tolerance.
    """
    return 2.0 * achieved.delay_s > settings.link_tolerance * achieved.span_s


def covers(record: Record, dwell_s: float, settings: RunSettings) -> bool:
    """Tell whether readings span a dwell; readings that came too late to be certain are missing at its start.

    Parameters
    ----------
    record : Record
        Readings.
    dwell_s : float
        As asked for, s.
    settings : RunSettings
        Least part.

    Returns
    -------
    bool
        Whether the first and the last are far enough apart.
    """
    return record.duration_s + 1.0 / record.sample_rate_hz >= settings.least_part * dwell_s


def check_rate(achieved: Achieved, held: float, settings: RunSettings, where: str) -> None:
    """Refuse a dwell in which the table did not hold its rate all the time.

    Parameters
    ----------
    achieved : Achieved
        By the encoder.
    held : float
        What the controller was set to, rad/s.
    settings : RunSettings
        Tolerances.
    where : str
        Step, in words.

    Raises
    ------
    RigFault
        Another rate, or not a steady one.
    """
    off = settings.turn_rate_tolerance * abs(held)
    slip = settings.angle_tolerance / achieved.span_s
    late = 2.0 * abs(held) * achieved.delay_s / achieved.span_s
    found = ((achieved.turn_rate, off + slip + late), (achieved.between_ends, off + 2.0 * slip + late))
    for rate, allowed in found:
        if not abs(rate - held) <= allowed:
            raise RigFault(
                f"rig: wanted {held:.6g} rad/s held within {allowed:.2g} in {where}, got {rate:.6g}; look at the table, its "
                "amplifier and its encoder",
                turn_rate=rate,
            )
    if not achieved.misfit <= settings.angle_tolerance:
        raise RigFault(
            f"rig: wanted a steady turn within {settings.angle_tolerance / RADIAN_PER_DEGREE:.2g} deg in {where}, got "
            f"{achieved.misfit / RADIAN_PER_DEGREE:.2g} deg off a straight line; it stopped, jumped or was pushed: look "
            "at the table",
            misfit=achieved.misfit,
        )


def check_readings(record: Record, dwell_s: float, settings: RunSettings, where: str) -> int:
    """Refuse a dwell in which the device said too little.

    Parameters
    ----------
    record : Record
        Readings, NaN where one is missing.
    dwell_s : float
        As asked for, s.
    settings : RunSettings
        Least part.
    where : str
        Step, in words.

    Returns
    -------
    int
        Readings that are missing.

    Raises
    ------
    RigTimeout
        Too few.
    """
    came = np.ones(len(record), bool)
    for values in (record.gyro, record.accel):
        if values is not None:
            came &= np.isfinite(values).all(axis=1)
    finite, rate = int(came.sum()), record.sample_rate_hz
    wanted = rate * max(dwell_s, record.duration_s)
    if finite < settings.least_part * wanted:
        raise RigTimeout(
            f"device: wanted {settings.least_part:.0%} of {wanted:.0f} readings in {where}, got {finite}, the others missing; look "
            "at the device and its link, then go on with --resume",
            readings=finite,
        )
    return len(record) - finite


def check_air(air_c: float, set_point_c: float, tolerance_c: float, where: str) -> None:
    """Refuse a dwell in air that left its set-point.

    Parameters
    ----------
    air_c : float
        What the chamber reads, degC.
    set_point_c : float
        Asked for, degC.
    tolerance_c : float
        Largest distance, K.
    where : str
        Step, in words.

    Raises
    ------
    RigFault
        Too far, or not a number.
    """
    if not abs(air_c - set_point_c) <= tolerance_c:
        raise RigFault(
            f"chamber: wanted {set_point_c:g} degC within {tolerance_c:g} K throughout {where}, got {air_c:.2f} degC; look at door "
            "and heater, then go on with --resume",
            temp_c=air_c,
        )


def check_board(record: Record, tolerance_c: float, where: str) -> None:
    """Refuse a dwell in which the device's own thermometer drifts or jumps; without one nothing is checked.

    Parameters
    ----------
    record : Record
        Readings.
    tolerance_c : float
        Largest change, K; the thermometer's step is added.
    where : str
        Step, in words.

    Raises
    ------
    RigFault
        It changed more.
    """
    if record.temp_c is None:
        return
    temp_c = record.temp_c[np.isfinite(record.temp_c)]
    if len(temp_c) < 2:
        return
    middles = [float(np.median(part)) for part in np.array_split(temp_c, min(PARTS, len(temp_c)))]
    steps = np.diff(np.unique(temp_c))
    step_c = min(float(steps.min()), COARSEST_C) if len(steps) else 0.0
    change_c = max(middles) - min(middles)
    if change_c > tolerance_c + step_c:
        raise RigFault(
            f"device: wanted its thermometer steady within {tolerance_c:g} K throughout {where}, got a change of {change_c:.2f} K; "
            "look at the chamber and at the air around the device, then go on with --resume",
            change_c=change_c,
        )
