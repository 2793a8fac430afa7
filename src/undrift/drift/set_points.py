"""What the set-points and rests of a thermal session let be told: how many there were, and whether rests of one of them agree."""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, Verdict
from undrift.drift.fit.rests import RestScatter
from undrift.drift.fit.static import StaticFit
from undrift.drift.observe.observations import RestBlocks
from undrift.units import RADIAN_PER_DEGREE, si_factor

_APART_C = 1.0  # further from the last one, a temperature is of another set-point
_WIDE_C = 2.0  # a wider one is a sweep
_FEW = 5  # set-points: above, what lies between is known about as well as they are
_ENOUGH = 6
_MORE = 2.0  # times what noise and wander explain: disagreement worth a word
_GRAVITY = "gyroscope offsets hold what gravity feigns"


def set_points_of(temp_c: FloatArray) -> FloatArray:
    """Return the set-points that temperatures were held at.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Of blocks of rest, degC, any order.

    Returns
    -------
    array, shape (s,)
        Mean of each, degC, increasing; empty where the temperature swept.
    """
    rising = np.sort(temp_c)
    held = np.split(rising, np.flatnonzero(np.diff(rising) > _APART_C) + 1)
    if max(float(np.ptp(part)) for part in held) > _WIDE_C:
        return np.zeros(0)
    return np.array([part.mean() for part in held])


def set_points_verdict(static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return what few set-points leave open between them, and which would tell it.

    Parameters
    ----------
    static : StaticFit
        Offsets over temperature.
    rests : RestBlocks
        What they rest on.
    device : Calibration
        What a reading is worth.

    Returns
    -------
    Verdict
        Silent for a sweep, for many set-points, and where their number costs nothing.
    """
    found, points = static.gyro, set_points_of(rests.temp_c)
    if found is None or not 2 <= len(points) <= _FEW:
        return Verdict()
    nodes = static.table.temp_c
    inside = (nodes >= points[0] - 1e-6) & (nodes <= points[-1] + 1e-6)
    if not inside.any():
        return Verdict()
    at = np.array([np.interp(points, nodes, column) for column in found.uncertainty.T]).mean(axis=1)
    between = found.uncertainty[inside].max(axis=0)
    if (between < _MORE * at).all():
        return Verdict()
    factor, unit = _worth(device)
    gaps = np.argsort(-np.diff(points))[: max(_ENOUGH - len(points), 1)]
    middles = np.sort(0.5 * (points[gaps] + points[gaps + 1]))
    less = "two cannot tell a curve from a line" if len(points) == 2 else f"{len(points)} cannot rule out other bends"
    return Verdict(
        reasons=(
            f"{len(points)} set-points ({_list(points, '.1f')} degC): the +- of the gyroscopes' table is {_list(at * factor)} "
            f"{unit} on x, y, z at them and up to {_list(between * factor)} between them, as {less}; soak at "
            f"{_list(middles, '.0f')} degC as well, six set-points or more tell what lies between",
        )
    )


def rests_verdict(static: StaticFit, device: Calibration) -> Verdict:
    """Return how far rests of one set-point disagree beyond their noise, and what is the likely reason.

    Parameters
    ----------
    static : StaticFit
        Offsets over temperature.
    device : Calibration
        What a reading is worth, and whether g-sensitivity was taken off.

    Returns
    -------
    Verdict
        Silent where they agree.
    """
    between = None if static.gyro is None else static.gyro.curve.cells.between
    if between is None:
        return Verdict()
    factor, unit = _worth(device)
    said = []
    if (between.pose > _MORE * between.known).any():
        said.append(_of_poses(between, device, factor, unit))
    if (between.rest > _MORE * between.known).any():
        said.append(
            f"rests of one set-point differ by {_list(between.rest * factor)} {unit} on x, y, z (standard deviation of "
            f"{between.rests} rests; their noise and wander explain {_list(between.known * factor)}), not by their pose alone: the "
            "way the temperature came there (hysteresis), warm-up after power-on, or parts that settle; it counts as uncertainty, "
            "which only more rests lessen"
        )
    return Verdict(reasons=tuple(said))


def with_set_points(told: Verdict, static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return what the offsets' fit is worth with what its set-points and rests tell.

    Parameters
    ----------
    told : Verdict
        Of the offsets' fit; its remark on gravity goes where the rests tell how large that is.
    static : StaticFit
        Offsets over temperature.
    rests : RestBlocks
        What they rest on.
    device : Calibration
        What a reading is worth.

    Returns
    -------
    Verdict
        Each thing once.
    """
    disagree = rests_verdict(static, device)
    if any("from pose to pose" in reason for reason in disagree.reasons):
        kept = tuple(reason for reason in told.reasons if not reason.startswith(_GRAVITY))
        told = Verdict(status=told.status, reasons=kept)
    return told.also(disagree).also(set_points_verdict(static, rests, device))


def _of_poses(between: RestScatter, device: Calibration, factor: FloatArray, unit: str) -> str:
    told = (
        f"the gyroscopes' offset differs from pose to pose by {_list(between.pose * factor)} {unit} on x, y, z (standard deviation "
        f"of {between.poses} poses; the noise and wander of a rest explain {_list(between.known * factor)}), at every temperature "
        "alike"
    )
    counts = "; it counts as uncertainty, which more samples do not lessen: "
    gyro = device.gyro
    if gyro is not None and gyro.g_sensitivity is not None:
        return (
            f"{told}, though the g-sensitivity is taken off{counts}it may be off, or the offset moved while one pose "
            "followed the other: visit each pose several times at each set-point"
        )
    if device.accel is None:
        return (
            f"{told}, as gyroscopes that feel gravity do (g-sensitivity){counts}calibrate the accelerometers on six faces, with "
            "which it can be told and taken off"
        )
    return (
        f"{told}, as gyroscopes that feel gravity do (g-sensitivity){counts}rest on all six faces at one set-point or more, "
        "which tells it, so that it is taken off"
    )


def _worth(device: Calibration) -> tuple[FloatArray, str]:
    if device.gyro is None:
        return np.ones(3), "raw units"
    return si_factor(device.gyro.unit_out, "rate") / device.gyro.scale_factor / RADIAN_PER_DEGREE, "deg/s"


def _list(values: FloatArray, form: str = ".2g") -> str:
    return ", ".join(f"{value:{form}}" for value in values)
