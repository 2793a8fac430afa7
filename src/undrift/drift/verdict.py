"""The verdict of a thermal fit: what it is worth, each thing said once, and which recording would tell more.

A table is marginal where its stated uncertainty cannot hold what is to come: one way of temperature only (half the loop is
missing), many nodes without data, a temperature that looks wrong or is a set-point, no turns (scale over temperature), a scale
that cannot be gravity, accelerometers of one pose whose unknown change of scale is most of the uncertainty. What one session
more would add is said and costs nothing.
"""

import numpy as np

from undrift.calibration.model import Calibration, Status, Verdict
from undrift.drift.fit.accel import AccelDriftFit
from undrift.drift.fit.choose import Choice
from undrift.drift.fit.static import UNKNOWN_SCALE_PER_K, StaticFit
from undrift.drift.observe.observations import RestBlocks
from undrift.drift.summary import TriadSummary
from undrift.drift.temperature.lag_fit import LagFit
from undrift.drift.temperature.trusted import Temperature
from undrift.units import RADIAN_PER_DEGREE

_MOST_EXTRAPOLATED = 0.25  # of the nodes
_SUPPOSED_LAG_S = 10.0
_SHORTLY_S = 600.0  # after a recording began, with which power-on may have come
_LAG_WORTH_A_WORD_S = 1.0
_DOUBTFUL = ("implausible", "set-point")  # what makes a temperature a poor one
_BEFORE = "drift_reasons_before"


def verdict_before(calibration: Calibration) -> Verdict:
    """Return the verdict of a calibration without what an earlier thermal fit said.

    Parameters
    ----------
    calibration : Calibration
        As given, with or without tables.

    Returns
    -------
    Verdict
        Of the constant model.
    """
    held = dict(calibration.provenance.settings).get(_BEFORE, "")
    status, _, count = held.partition(" ")
    if status not in ("good", "marginal", "bad") or not count.isdigit():
        return calibration.verdict
    known: dict[str, Status] = {"good": "good", "marginal": "marginal", "bad": "bad"}
    return Verdict(status=known[status], reasons=calibration.verdict.reasons[: int(count)])


def mark_before(verdict: Verdict) -> tuple[str, str]:
    """Return the entry of the settings by which :func:`verdict_before` knows where a thermal fit begins.

    Parameters
    ----------
    verdict : Verdict
        Of the constant model.

    Returns
    -------
    (str, str)
        Name and value.
    """
    return _BEFORE, f"{verdict.status} {len(verdict.reasons)}"


def static_verdict(static: StaticFit, accel: AccelDriftFit | None, poses: int) -> Verdict:
    """Return what the offsets' fit is worth.

    Parameters
    ----------
    static : StaticFit
        Offsets over temperature.
    accel : AccelDriftFit or None
        Accelerometers from poses, which take the place of those of one pose.
    poses : int
        How many the rests were in.

    Returns
    -------
    Verdict
        Each thing once.
    """
    own = [reason for reason in static.verdict.reasons if not reason.startswith(("accelerometer", "of "))]
    reasons, status = [reason for reason in own if "half the loop between" not in reason], static.verdict.status
    found = static.gyro
    if found is not None:
        few = found.extrapolated.mean() <= _MOST_EXTRAPOLATED
        status = status if found.curve.loop is not None and few else _worse(status)
        reasons = [reason for reason in reasons if not few or "are marked extrapolated" not in reason]
        if found.curve.kept_loop:
            reasons.append(
                "hysteresis: the table holds the middle of warming and cooling, and half the loop counts as uncertainty"
            )
    if accel is None:
        reasons += _of_one_pose(static, poses)
        unknown = (
            static.table.accel_offset is not None and static.accel is not None and static.accel.mostly_unknown_scale
        )
        status = _worse(status) if unknown else status
    return Verdict(status=status, reasons=tuple(reasons))


def one_way_verdict(gyro: TriadSummary | None, rests: RestBlocks, *, warm_up_fitted: bool) -> Verdict:
    """Return what a temperature that went one way hides, as large as this log lets it be told.

    A thermometer that trails by tau shifts the table by ``slope * dT/dt * tau``; the size for 10 s is stated, at the ramp that
    one block in twenty exceeds.

    Parameters
    ----------
    gyro : TriadSummary or None
        Offsets over temperature.
    rests : RestBlocks
        What they rest on.
    warm_up_fitted : bool
        Whether what dies away after power-on has a table of its own.

    Returns
    -------
    Verdict
        Marginal with its figures; good and silent where both ways were seen.
    """
    if gyro is None or gyro.half_loop is not None:
        return Verdict()
    ramp = float(np.quantile(np.abs(rests.ramp_c_per_min), 0.95))
    rad = gyro.unit == "rad/s"
    shift = np.abs(gyro.slope) * (ramp / 60.0) * _SUPPOSED_LAG_S / (RADIAN_PER_DEGREE if rad else 1.0)
    sizes, unit = ", ".join(f"{size:.2g}" for size in shift), "deg/s" if rad else gyro.unit
    reasons = [
        f"not in the stated +-: each {_SUPPOSED_LAG_S:g} s by which the thermometer trails makes {sizes} {unit} on x, y, z at this "
        f"log's {ramp:.2g} degC/min, and the loop is unknown; record a sweep back"
    ]
    if not warm_up_fitted and (float(rests.power_on_s.min()) < _SHORTLY_S or _relaxes(rests)):
        reasons.append(
            "what dies away after power-on may be in the table, as the log may begin there: hold one temperature for half an hour "
            "after power-on, or warm up from two temperatures, and give --warm-up"
        )
    return Verdict(status="marginal", reasons=tuple(reasons))


def _relaxes(rests: RestBlocks) -> bool:
    """Tell whether the temperature moves fastest at the start."""
    order = np.lexsort((rests.time, rests.session))
    ramp = np.abs(rests.ramp_c_per_min[order])
    part = max(len(ramp) // 4, 1)
    return bool(ramp[:part].mean() > 2.0 * ramp[-part:].mean())


def temperature_verdict(temperatures: tuple[Temperature, ...]) -> Verdict:
    """Return what the temperatures are worth.

    Parameters
    ----------
    temperatures : tuple of Temperature
        Of all recordings.

    Returns
    -------
    Verdict
        Notes of all, each once.
    """
    notes = tuple(dict.fromkeys(note for temperature in temperatures for note in temperature.notes))
    stated = all(temperature.source == "set-points" for temperature in temperatures)
    if stated:
        notes = (
            "no recording has a temperature column: the tables are over the chamber's set-points, which a thermometer on the board "
            "reads with its own trim and warmth; what is to be corrected needs a temperature column, map it in the thermal session "
            "too",
        )
    poor = any(word in note for note in notes for word in _DOUBTFUL)
    return Verdict(status="marginal" if poor else "good", reasons=notes)


def choice_verdict(choice: Choice | None, told: str) -> Verdict:
    """Return what the matrix and dynamic tables are worth.

    Parameters
    ----------
    choice : Choice or None
        What was fitted and taken.
    told : str
        Why there is no choice; empty where no table was asked for.

    Returns
    -------
    Verdict
        Without the figures that the tables themselves show.
    """
    if choice is None:
        return Verdict(status="marginal" if told else "good", reasons=(told,) if told else ())
    return Verdict(status=choice.verdict.status, reasons=_without_figures(choice.verdict.reasons))


def accel_verdict(accel: AccelDriftFit | None) -> Verdict:
    """Return what the accelerometers' tables from poses are worth.

    Parameters
    ----------
    accel : AccelDriftFit or None
        None where poses did not tell.

    Returns
    -------
    Verdict
        Without the figures that the table itself shows.
    """
    if accel is None:
        return Verdict()
    return Verdict(status=accel.verdict.status, reasons=_without_figures(accel.verdict.reasons))


def lag_verdict(lag: LagFit | None, taken_s: float) -> Verdict:
    """Return what is to be said of the thermometer's lag.

    Parameters
    ----------
    lag : LagFit or None
        As estimated; None where it was stated or there is no thermometer.
    taken_s : float
        What was taken off, s.

    Returns
    -------
    Verdict
        Good: a lag that is left in widens the loop, which counts as uncertainty.
    """
    if lag is None:
        return Verdict()
    if taken_s > 0.0:
        said = f"the thermometer trails the sensors by {taken_s:.3g} +- {lag.uncertainty_s:.2g} s, which was taken off"
        return Verdict(reasons=(said, *lag.notes))
    if len(lag.lags_s) and lag.lag_s < _LAG_WORTH_A_WORD_S and np.isinf(lag.uncertainty_s) and not lag.observable:
        return Verdict()  # no lag explains the loop: nothing to tell apart
    return Verdict(reasons=lag.notes)


def _of_one_pose(static: StaticFit, poses: int) -> list[str]:
    own = [reason for reason in static.verdict.reasons if reason.startswith("accelerometer")]
    if static.table.accel_offset is None:  # why there is no table, and nothing about the table that there is not
        return [reason for reason in own if "is of one pose" not in reason and "nodes" not in reason][:1]
    span = static.accel.span_c[1] - static.accel.span_c[0] if static.accel else 0.0
    which = "the only pose" if poses == 1 else f"one of {poses} poses, that over {span:.1f} degC"
    return [
        f"accelerometer offset over temperature is of {which}: a change of scale along gravity cannot be told from it, and "
        f"{100.0 * UNKNOWN_SCALE_PER_K:g} % per degC of gravity counts as uncertainty; rest on all six faces at three temperatures"
    ]


def _without_figures(reasons: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(reason for reason in reasons if "%/K (95 %)" not in reason)


def _worse(status: Status) -> Status:
    return "marginal" if status == "good" else status
