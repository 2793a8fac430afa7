"""Do thermal sessions and the calibration given speak of one device? Asked of the constants, before tables take their place.

::

    turns      inv(K_c) K    K of each soak, K_c of the calibration: near one; another order or sign of axes is refused
    scale      its diagonal at the reference temperature, less 1
    offset     table at the reference temperature, or at the nearest node seen, less the calibration's constant
    sessions   standard deviation from session to session
    accel      P = M_a(T_ref) M_c^-1 of the accelerometers' poses: near one; and their offset, M_c (o_a - o_c)

Offsets move from one switch-on to the next, and the calibration's temperature may have been read on another thermometer: 2 deg/s
and the slope over 2 K (and over what lies between reference and node, doubled) are granted. What exceeds that counts from three
standard uncertainties, of table and calibration together, and can be bad from ten; below three it is said, and that the table is
too poor to tell. Accelerometers hold better: 1 % of a matrix' elements and 50 mg are granted, and three standard uncertainties.

The verdict of a thermal fit: what it is worth, each thing said once, and which recording would tell more.

A table is marginal where its stated uncertainty cannot hold what is to come: one way of temperature only (half the loop is
missing), many nodes without data, a temperature that looks wrong or is a set-point, no turns (scale over temperature), a scale
that cannot be gravity, accelerometers of one pose whose unknown change of scale is most of the uncertainty. What one session
more would add is said and costs nothing.

What a thermal fit comes to, in SI units and per sensor: what a page, a picture and a terminal show.

A reading's departure from the constant offset (from zero where none was calibrated), turned into the physical unit by the sensor's
own scale factor::

    y = (u - offset) / scale_factor        scale_factor = row length of K = M^-1, raw unit per rad/s or m/s2

Accelerometers that were seen in one pose show gravity too: theirs is the change since the reference temperature, or, where none
is known, since the middle of the temperatures seen.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.checks import check_axis_order, check_handedness
from undrift.drift.accel import AccelDriftFit
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.rests import Offsets, RestScatter, accel_offsets, gyro_offsets
from undrift.drift.scale import ScaleFit, SoakMatrices, soak_matrices, steps_of
from undrift.drift.select import Choice
from undrift.drift.static import UNKNOWN_SCALE_PER_K, StaticFit, StaticSettings, TriadDrift, cooling
from undrift.drift.temperature import Temperature
from undrift.drift.thermometer_lag import LagFit
from undrift.errors import CalibrationError, Implausible
from undrift.model import AXES, MATRIX_NAMES, Calibration, ScaleDrift, StaticDrift, Status, TriadModel, Verdict
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- What the set-points and rests of a thermal session let be told: how many there were, and whether rests of one of them agree.

_APART_C = 1.0  # further from the last one, a temperature is of another set-point
_WIDE_C = 2.0  # a wider one is a sweep
_FEW = 5  # set-points: above, what lies between is known about as well as they are
_ENOUGH = 6
_MORE = 2.0  # times what noise and wander explain: disagreement worth a word
_GRAVITY = "gyroscope offsets hold what gravity feigns"


def set_points_of(temp_c: FloatArray) -> FloatArray:
    """Return the set-points that temperatures were held at.

    Arrays: temp_c (n,) degC -> (s,) degC.
    """
    rising = np.sort(temp_c)
    held = np.split(rising, np.flatnonzero(np.diff(rising) > _APART_C) + 1)
    if max(float(np.ptp(part)) for part in held) > _WIDE_C:
        return np.zeros(0)
    return np.array([part.mean() for part in held])


def set_points_verdict(static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return what few set-points leave open between them, and which would tell it."""
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
        remarks=(
            f"{len(points)} set-points ({_list(points, '.1f')} degC): the +- of the gyroscopes' table is {_list(at * factor)} "
            f"{unit} on x, y, z at them and up to {_list(between * factor)} between them, as {less}; soak at "
            f"{_list(middles, '.0f')} degC as well, six set-points or more tell what lies between",
        )
    )


def rests_verdict(static: StaticFit, device: Calibration) -> Verdict:
    """Return how far rests of one set-point disagree beyond their noise, and what is the likely reason."""
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
    return Verdict(remarks=tuple(said))


def with_set_points(told: Verdict, static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return what the offsets' fit is worth with what its set-points and rests tell."""
    disagree = rests_verdict(static, device)
    if any("from pose to pose" in reason for reason in disagree.reasons):
        kept = tuple(reason for reason in told.reasons if not reason.startswith(_GRAVITY))
        told = Verdict(status=told.status, remarks=kept)
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


# ---- What a thermal fit comes to, in SI units and per sensor: what a page, a picture and a terminal show.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors: n nodes, k blocks of rest."""

    unit: str  # rad/s or m/s2; the raw unit where nothing says what it is worth
    seen_c: tuple[float, float]  # Least and greatest temperature seen, degC
    temp_c: FloatArray  # (n,), nodes, degC
    against: str  # What the departure is from: the constant offset, zero, or the reading at a temperature
    departure: FloatArray  # (n, 3), of each node, ``unit``
    uncertainty: FloatArray  # (n, 3), of each node, ``unit``
    extrapolated: BoolArray  # (n,), true where no data were near
    in_table: bool  # False where only the change is known, so that no table was made
    slope: FloatArray  # (3,), mean over the temperatures seen, ``unit`` per K
    slope_uncertainty: FloatArray  # (3,), mean over the temperatures seen, ``unit`` per K
    # (3,), error of temperatures that the others foretell, ``unit``; NaN where there are too few
    left_out_rms: FloatArray
    # (3,), cooling minus warming, over two, ``unit``; None where not both directions were seen
    half_loop: FloatArray | None
    # (3,), cooling minus warming, over two, ``unit``; None where not both directions were seen
    half_loop_uncertainty: FloatArray | None
    loop_kept: bool  # Whether the loop is significant and part of the table
    turn_on: FloatArray | None  # (3,), standard deviation from session to session, ``unit``; None for one session
    block_temp_c: FloatArray  # (k,), of the blocks, degC; may be empty
    block_departure: FloatArray  # (k, 3), of the blocks, ``unit``
    block_cooling: FloatArray  # (k,), 1 while cooling, -1 while warming

    @property
    def usual_uncertainty(self) -> FloatArray:
        """Median standard uncertainty of the nodes that data were near, shape (3,), ``unit``; of all where none were."""
        near = self.uncertainty[~self.extrapolated] if not self.extrapolated.all() else self.uncertainty
        return np.asarray(np.median(near, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleSummary:
    """Scale factors over temperature against the calibration's, n nodes and S soaks."""

    temp_c: FloatArray  # (n,), nodes, degC
    # (n, 3), departure of each axis' scale factor from the calibration's, %, with standard uncertainty
    percent: FloatArray
    # (n, 3), departure of each axis' scale factor from the calibration's, %, with standard uncertainty
    uncertainty: FloatArray
    extrapolated: BoolArray  # (n,), true where no data were near
    soak_temp_c: FloatArray  # (S,), degC
    soak_percent: FloatArray  # (S, 3), what each soak says, %; NaN where it did not turn about the axis
    soak_uncertainty: FloatArray  # (S, 3), what each soak says, %; NaN where it did not turn about the axis


def summarise_gyro(
    static: StaticFit, rests: RestBlocks, device: Calibration, settings: StaticSettings
) -> TriadSummary | None:
    """Return what the gyroscopes' offsets come to."""
    found, model = static.gyro, device.gyro
    offsets = gyro_offsets(rests, device, settings.latitude_deg)
    if found is None or found.offset is None or offsets is None:
        return None
    factor, unit = _factor(model, "rate", "")
    constant = model is not None and model.method != "nominal"
    zero = (np.zeros(3) if model is None else model.offset, "the constant offset" if constant else "zero")
    return _summary(found, offsets, static.table, found.offset, zero, (factor, unit))


def summarise_accel(
    static: StaticFit, poses: AccelDriftFit | None, rests: RestBlocks, device: Calibration, settings: StaticSettings
) -> TriadSummary | None:
    """Return what the accelerometers' offsets come to: from poses where these told them, else from one pose."""
    model = device.accel
    factor, unit = _factor(model, "accel", settings.accel_unit)
    if poses is not None and model is not None:
        return _of_poses_summary(poses, model, factor)
    offsets, found = accel_offsets(rests, device, settings.accel_unit), static.accel
    if found is None or isinstance(offsets, str):
        return None
    reference = device.reference_temp_c if model is not None else np.nan
    if not np.isfinite(reference):
        reference = 0.5 * (found.span_c[0] + found.span_c[1])
    zero = (found.curve.spline.at(np.array([reference])).value[0], f"that at {reference:.1f} degC")
    value = found.curve.spline.at(static.table.temp_c).value
    return _summary(found, offsets, static.table, value, zero, (factor, unit))


def summarise_scale(fit: ScaleFit, device: Calibration) -> ScaleSummary | None:
    """Return scale factors over temperature against those of the calibration."""
    drift: ScaleDrift = fit.drift
    if device.gyro is None or drift.gyro_matrix is None:
        return None
    kept = device.gyro.forward_matrix.diagonal() / si_factor(device.gyro.unit_out, "rate")
    own = np.linalg.inv(drift.gyro_matrix).diagonal(axis1=1, axis2=2) / si_factor(device.gyro.unit_out, "rate")
    matrix = drift.gyro_matrix.diagonal(axis1=1, axis2=2)
    doubt = drift.gyro_uncertainty
    n = len(drift.temp_c)
    return ScaleSummary(
        temp_c=drift.temp_c,
        percent=100.0 * (own / kept - 1.0),
        uncertainty=np.full((n, 3), np.nan)
        if doubt is None
        else 100.0 * np.abs(doubt.diagonal(axis1=1, axis2=2) / matrix),
        extrapolated=np.zeros(n, bool) if drift.gyro_extrapolated is None else drift.gyro_extrapolated,
        soak_temp_c=fit.soaks.temp_c,
        soak_percent=100.0 * (fit.soaks.forward.diagonal(axis1=1, axis2=2) / kept - 1.0),
        soak_uncertainty=100.0 * np.sqrt(fit.soaks.variance.diagonal(axis1=1, axis2=2)) / np.abs(kept),
    )


def _factor(model: TriadModel | None, quantity: str, unit: str) -> tuple[FloatArray, str]:
    """Return the physical unit per raw unit of each sensor, and its name; the raw unit where nothing tells it."""
    rate = quantity == "rate"
    if model is not None:
        return si_factor(model.unit_out, "rate" if rate else "accel") / model.scale_factor, "rad/s" if rate else "m/s2"
    if is_physical(unit):
        return np.full(3, si_factor(unit, "rate" if rate else "accel")), "rad/s" if rate else "m/s2"
    return np.ones(3), unit or "raw unit"


def _summary(
    found: TriadDrift,
    offsets: Offsets,
    table: StaticDrift,
    value: FloatArray,
    reference: tuple[FloatArray, str],
    units: tuple[FloatArray, str],
) -> TriadSummary:
    zero, factor = reference[0], units[0]
    loop, turn_on = found.curve.loop, found.curve.turn_on
    return TriadSummary(
        unit=units[1],
        seen_c=found.span_c,
        temp_c=table.temp_c,
        against=reference[1],
        departure=(value - zero) * factor,
        uncertainty=found.uncertainty * factor,
        extrapolated=found.extrapolated,
        in_table=found.offset is not None,
        slope=found.slope * factor,
        slope_uncertainty=found.slope_uncertainty * factor,
        left_out_rms=found.leave_out_rms * factor,
        half_loop=None if loop is None else loop.half * factor,
        half_loop_uncertainty=None if loop is None else loop.uncertainty * factor,
        loop_kept=found.curve.kept_loop,
        turn_on=None if turn_on is None else np.sqrt(turn_on.variance) * factor,
        block_temp_c=offsets.blocks.temp_c,
        block_departure=(offsets.value - zero) * factor,
        block_cooling=cooling(offsets.blocks),
    )


def _of_poses_summary(poses: AccelDriftFit, model: TriadModel, factor: FloatArray) -> TriadSummary:
    near = np.flatnonzero(~poses.extrapolated)
    first, last = (near[0], near[-1]) if len(near) > 1 else (0, -1)
    span = poses.temp_c[last] - poses.temp_c[first]
    doubt = poses.offset_uncertainty
    return TriadSummary(
        unit="m/s2",
        seen_c=(float(poses.temp_c[first]), float(poses.temp_c[last])),
        temp_c=poses.temp_c,
        against="the constant offset",
        departure=(poses.offset - model.offset) * factor,
        uncertainty=doubt * factor,
        extrapolated=poses.extrapolated,
        in_table=True,
        slope=(poses.offset[last] - poses.offset[first]) / span * factor,
        slope_uncertainty=np.hypot(doubt[last], doubt[first]) / span * factor,
        left_out_rms=np.full(3, np.nan),
        half_loop=None,
        half_loop_uncertainty=None,
        loop_kept=False,
        turn_on=None,
        block_temp_c=np.zeros(0),
        block_departure=np.zeros((0, 3)),
        block_cooling=np.zeros(0),
    )


# ---- The verdict of a thermal fit: what it is worth, each thing said once, and which recording would tell more.

_MOST_EXTRAPOLATED = 0.25  # of the nodes
_SUPPOSED_LAG_S = 10.0
_SHORTLY_S = 600.0  # after a recording began, with which power-on may have come
_LAG_WORTH_A_WORD_S = 1.0
_DOUBTFUL = ("implausible", "set-point")  # what makes a temperature a poor one
_BEFORE = "drift_reasons_before"


def verdict_before(calibration: Calibration) -> Verdict:
    """Return the verdict of a calibration without what an earlier thermal fit said."""
    held = dict(calibration.provenance.settings).get(_BEFORE, "")
    status, _, count = held.partition(" ")
    if status not in ("good", "marginal", "bad") or not count.isdigit():
        return calibration.verdict
    known: dict[str, Status] = {"good": "good", "marginal": "marginal", "bad": "bad"}
    return Verdict(status=known[status], remarks=calibration.verdict.reasons[: int(count)])


def mark_before(verdict: Verdict) -> tuple[str, str]:
    """Return the entry of the settings by which :func:`verdict_before` knows where a thermal fit begins."""
    return _BEFORE, f"{verdict.status} {len(verdict.reasons)}"


def static_verdict(static: StaticFit, accel: AccelDriftFit | None, poses: int) -> Verdict:
    """Return what the offsets' fit is worth."""
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
    return Verdict(status=status, remarks=tuple(reasons))


def one_way_verdict(gyro: TriadSummary | None, rests: RestBlocks, *, warm_up_fitted: bool) -> Verdict:
    """Return what a temperature that went one way hides, as large as this log lets it be told."""
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
    return Verdict(status="marginal", remarks=tuple(reasons))


def _relaxes(rests: RestBlocks) -> bool:
    """Tell whether the temperature moves fastest at the start."""
    order = np.lexsort((rests.time, rests.session))
    ramp = np.abs(rests.ramp_c_per_min[order])
    part = max(len(ramp) // 4, 1)
    return bool(ramp[:part].mean() > 2.0 * ramp[-part:].mean())


def temperature_verdict(temperatures: tuple[Temperature, ...]) -> Verdict:
    """Return what the temperatures are worth."""
    notes = tuple(dict.fromkeys(note for temperature in temperatures for note in temperature.notes))
    stated = all(temperature.source == "set-points" for temperature in temperatures)
    if stated:
        notes = (
            "no recording has a temperature column: the tables are over the chamber's set-points, which a thermometer on the board "
            "reads with its own trim and warmth; what is to be corrected needs a temperature column, map it in the thermal session "
            "too",
        )
    poor = any(word in note for note in notes for word in _DOUBTFUL)
    return Verdict(status="marginal" if poor else "good", remarks=notes)


def choice_verdict(choice: Choice | None, told: str) -> Verdict:
    """Return what the matrix and dynamic tables are worth."""
    if choice is None:
        return Verdict(status="marginal" if told else "good", remarks=(told,) if told else ())
    return Verdict(status=choice.verdict.status, remarks=_without_figures(choice.verdict.reasons))


def accel_verdict(accel: AccelDriftFit | None) -> Verdict:
    """Return what the accelerometers' tables from poses are worth."""
    if accel is None:
        return Verdict()
    return Verdict(status=accel.verdict.status, remarks=_without_figures(accel.verdict.reasons))


def lag_verdict(lag: LagFit | None, taken_s: float) -> Verdict:
    """Return what is to be said of the thermometer's lag."""
    if lag is None:
        return Verdict()
    if taken_s > 0.0:
        said = f"the thermometer trails the sensors by {taken_s:.3g} +- {lag.uncertainty_s:.2g} s, which was taken off"
        return Verdict(remarks=(said, *lag.notes))
    if len(lag.lags_s) and lag.lag_s < _LAG_WORTH_A_WORD_S and np.isinf(lag.uncertainty_s) and not lag.observable:
        return Verdict()  # no lag explains the loop: nothing to tell apart
    return Verdict(remarks=lag.notes)


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


# ---- checks

TURN_ON_DPS = 2.0  # a shift from one switch-on to the next; consumer gyroscopes state less
FAR_DPS = 10.0  # no switch-on moves an offset so far
MOST_BETWEEN_DPS = 5.0  # standard deviation between sessions of one device
_TELLING = 3.0  # standard uncertainties, from which a difference is taken as one
_SURE = 10.0  # from which it may be bad
_TEMPERATURE_OFF_C = 2.0  # between the thermometer of the calibration and that of the session
_SCALE_OFF = (0.02, 0.05)  # marginal, and bad
_ACCEL_SCALE_OFF = (0.01, 0.05)  # marginal, and bad; capacitive sensors keep 1 % for years
_ACCEL_OFFSET_OFF = (0.05, 0.25)  # of gravity
_SCALE_PER_C = 1e-3  # granted for each degree between the reference and the nearest soak: the steepest sensors


def check_turns(steps: RateSteps, device: Calibration, static: StaticFit) -> Verdict:
    """Hold the turns against the calibration's matrix: axes, signs, scale."""
    if device.gyro is None or static.table.gyro_offset is None or not len(steps):
        return Verdict()
    kept = device.gyro.forward_matrix / si_factor(device.gyro.unit_out, "rate")
    try:
        soaks = soak_matrices(steps_of(steps), device, static=static.table)
    except CalibrationError:
        return Verdict()  # the choice of tables says why
    against = np.linalg.inv(kept) @ np.where(np.isfinite(soaks.forward), soaks.forward, kept)
    typical = np.median(against, axis=0)
    what = "thermal session's turns against the calibration"
    check_axis_order(typical, f"{what} (scale ratios {_figures(np.diag(typical))} on x, y, z)", against="turns")
    check_handedness(typical, what)
    return Verdict() if device.gyro.method == "nominal" else _scale(against, soaks, device.reference_temp_c)


def offsets_verdict(static: StaticFit, device: Calibration) -> Verdict:
    """Hold the offset table against the calibration's constants."""
    model, found, offset = device.gyro, static.gyro, static.table.gyro_offset
    if model is None or model.method == "nominal" or found is None or offset is None:
        return Verdict()
    per_raw = _dps_per_raw(model)
    node, away_c = _nearest(static.table.temp_c, found, device.reference_temp_c, offset - model.offset)
    off = (offset[node] - model.offset) * per_raw
    names = [model.parameters.index(f"offset_{axis}") for axis in AXES]
    sure = np.hypot(found.uncertainty[node], np.sqrt(np.diag(model.covariance)[names])) * per_raw
    granted = np.abs(found.slope) * per_raw * (2.0 * away_c + _TEMPERATURE_OFF_C)
    beyond = np.abs(off) - granted
    if beyond.max() <= TURN_ON_DPS:
        return Verdict()
    told = ", ".join(f"{d:+.3g} +- {u:.2g}" for d, u in zip(off, sure, strict=True))
    first = f"the table's offset at {static.table.temp_c[node]:.1f} degC is {told} deg/s on x, y, z off the calibration's constant"
    telling = (beyond > TURN_ON_DPS) & (np.abs(off) > _TELLING * sure)
    if not telling.any():
        return Verdict(
            remarks=(
                f"{first}: less than {_TELLING:g} standard uncertainties, so this session is too poor to tell whether it "
                "belongs to the calibration; rest longer, at more temperatures or nearer the calibration's",
            )
        )
    far = (beyond > FAR_DPS) & (np.abs(off) > _SURE * sure)
    reason = (
        f"{first}; a switch-on moves it by {TURN_ON_DPS:g} deg/s at most: another device's session or calibration, or calibrate "
        "anew"
    )
    return Verdict(status="bad" if far.any() else "marginal", remarks=(reason,))


def poses_verdict(accel: AccelDriftFit | None, device: Calibration) -> Verdict:
    """Hold the accelerometers' matrix and offset from poses against the calibration's."""
    model = device.accel
    if accel is None or model is None or model.method == "nominal" or accel.extrapolated.all():
        return Verdict()
    near = np.flatnonzero(~accel.extrapolated)
    away = (
        np.abs(accel.temp_c[near] - device.reference_temp_c)
        if np.isfinite(device.reference_temp_c)
        else np.zeros(len(near))
    )
    node, away_c = int(near[away.argmin()]), float(away.min())
    inverse, deviation = model.forward_matrix, np.sqrt(np.diag(model.covariance))
    own = deviation[[model.parameters.index(name) for name in MATRIX_NAMES]].reshape(3, 3)
    off = accel.matrix[node] @ inverse - np.eye(3)
    sure = np.sqrt((accel.matrix_uncertainty[node] ** 2 + own**2) @ inverse**2)
    beyond = np.where(np.abs(off) > _TELLING * sure, np.abs(off) - UNKNOWN_SCALE_PER_K * away_c * np.eye(3), 0.0)
    own_offset = deviation[[model.parameters.index(f"offset_{axis}") for axis in AXES]]
    per_g = 1.0 / (model.scale_factor * device.gravity_m_s2 / si_factor(model.unit_out, "accel"))
    shift = (accel.offset[node] - model.offset) * per_g
    shift_sure = np.hypot(accel.offset_uncertainty[node], own_offset) * per_g
    moved = np.where(np.abs(shift) > _TELLING * shift_sure, np.abs(shift), 0.0)
    reasons, worst = [], max(beyond.max() / _ACCEL_SCALE_OFF[1], moved.max() / _ACCEL_OFFSET_OFF[1])
    where = f"at {accel.temp_c[node]:.1f} degC"
    if beyond.max() > _ACCEL_SCALE_OFF[0]:
        i, j = np.unravel_index(int(beyond.argmax()), (3, 3))
        reasons.append(
            f"the poses make the accelerometers' matrix {where} differ from the calibration's by "
            f"{_figures(100.0 * np.diag(off))} % on x, y, z, by {100.0 * off[i, j]:+.3g} +- {100.0 * sure[i, j]:.2g} % at most, in "
            f"{AXES[i]}{AXES[j]} (wanted "
            f"{100.0 * _ACCEL_SCALE_OFF[0]:g}): check the range setting and which device it is, or calibrate anew"
        )
    if moved.max() > _ACCEL_OFFSET_OFF[0]:
        told = ", ".join(f"{1e3 * d:+.3g} +- {1e3 * u:.2g}" for d, u in zip(shift, shift_sure, strict=True))
        reasons.append(
            f"the poses make the accelerometers' offset {where} {told} mg on x, y, z off the calibration's (wanted "
            f"{1e3 * _ACCEL_OFFSET_OFF[0]:g}): another device's session or calibration, or calibrate anew"
        )
    if not reasons:
        return Verdict()
    return Verdict(status="bad" if worst > 1.0 else "marginal", remarks=tuple(reasons))


def check_sessions(static: StaticFit, device: Calibration) -> None:
    """Raise where sessions lie further apart than one device's do."""
    found, model = static.gyro, device.gyro
    if found is None or model is None or found.curve.turn_on is None:
        return
    between = np.sqrt(found.curve.turn_on.variance) * _dps_per_raw(model)
    if between.max() > MOST_BETWEEN_DPS:
        raise Implausible(
            f"sessions: wanted offsets of one device, within {MOST_BETWEEN_DPS:g} deg/s from session to session, got a standard "
            f"deviation of {_figures(between)} deg/s on x, y, z; are they of one device? fit each device by itself",
            deg_per_s=float(between.max()),
        )


def _scale(against: FloatArray, soaks: SoakMatrices, reference_temp_c: float) -> Verdict:
    off, granted = np.zeros(3), np.zeros(3)
    for j in range(3):
        rows = np.flatnonzero(soaks.seen[:, j])
        if len(rows):
            temp_c, ratio = soaks.temp_c[rows], against[rows, j, j]
            at = reference_temp_c if np.isfinite(reference_temp_c) else temp_c[np.abs(ratio - 1.0).argmin()]
            off[j] = np.interp(at, temp_c, ratio) - 1.0
            granted[j] = _SCALE_PER_C * np.abs(temp_c - at).min()
    beyond = float((np.abs(off) - granted).max())
    if beyond <= _SCALE_OFF[0]:
        return Verdict()
    reason = (
        f"the turns of the session make the scale factors at the reference temperature {_figures(100.0 * off)} % on x, y, z off "
        f"the calibration's (wanted {100.0 * _SCALE_OFF[0]:g}): check turn_rate_dps, the range setting, and which device it is"
    )
    return Verdict(status="bad" if beyond > _SCALE_OFF[1] else "marginal", remarks=(reason,))


def _nearest(nodes: FloatArray, found: TriadDrift, reference_temp_c: float, off: FloatArray) -> tuple[int, float]:
    """Return the node to compare at, and how far from the reference it lies, degC."""
    low, high = found.span_c
    seen = np.flatnonzero((nodes >= low - 1.0) & (nodes <= high + 1.0))
    seen = seen if len(seen) else np.arange(len(nodes))
    if not np.isfinite(reference_temp_c):  # whichever speaks best for the device
        return int(seen[np.abs(off[seen]).max(axis=1).argmin()]), 0.0
    node = int(seen[np.abs(nodes[seen] - reference_temp_c).argmin()])
    return node, float(abs(nodes[node] - reference_temp_c))


def _dps_per_raw(model: TriadModel) -> FloatArray:
    return np.asarray(si_factor(model.unit_out, "rate") / model.scale_factor / RADIAN_PER_DEGREE)


def _figures(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
