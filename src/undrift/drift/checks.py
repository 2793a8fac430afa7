"""The verdict of a thermal fit: what it is worth, do sessions and calibration belong to one device, what else to record.

Checked against the calibration's constants, before tables take their place::

    turns      inv(K_c) K    K of each soak, K_c of the calibration: near one; another order or sign of axes is refused
    scale      its diagonal at the reference temperature, less 1
    offset     table at the reference temperature, or at the nearest node seen, less the calibration's constant
    sessions   standard deviation from session to session
    accel      P = M_a(T_ref) M_c^-1 of the accelerometers' poses: near one; and their offset, M_c (o_a - o_c)

Offsets move from one switch-on to the next, and the calibration's temperature may have been read on another thermometer: 2 deg/s
and the slope over 2 K (and over what lies between reference and node, doubled) are allowed. What exceeds that counts from three
standard uncertainties, of table and calibration together, and can be bad from ten. Accelerometers are more stable: 1 % of a
matrix' elements and 50 mg are allowed, and three standard uncertainties.

A table is marginal where its stated uncertainty cannot cover future readings: temperature in one direction only (hysteresis
unknown), many nodes without data, a temperature that looks wrong or is a set-point, no turns (scale over temperature), a scale
that cannot be gravity, accelerometers of one pose whose unknown change of scale is most of the uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, interpolated
from undrift.calibration.plausibility import check_axis_order, check_handedness
from undrift.drift.accel import AccelDriftFit
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.offset import UNKNOWN_SCALE_PER_K, StaticFit, TriadDrift, cooling
from undrift.drift.rate_steps import ScaleFit, SoakMatrices, soak_matrices, steps_of
from undrift.drift.temperature import LagFit, Temperature
from undrift.errors import CalibrationError, Implausible
from undrift.findings import Finding, finding
from undrift.model import AXES, Calibration, TriadModel, Verdict, level_of
from undrift.record import Session
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

# ---- Summary of a thermal fit in SI units, per sensor: y = (u - offset) / scale_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors: n nodes, k blocks of rest; values in ``unit``."""

    unit: str  # rad/s or m/s2; the raw unit where the scale factor is not known
    seen_c: tuple[float, float]  # least and greatest temperature seen, degC
    temp_c: FloatArray  # (n,), nodes, degC
    against: str  # what the departure refers to: the constant offset, zero, or the reading at a temperature
    departure: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), true where no data were near
    in_table: bool  # False where only the change is known, so that no table was made
    slope: FloatArray  # (3,), mean over the temperatures seen, per K
    slope_uncertainty: FloatArray  # (3,)
    left_out_rms: FloatArray  # (3,), cross-validated error; NaN where there are too few temperatures
    half_loop: FloatArray | None = None  # (3,), hysteresis half-width, cooling less warming; None where it did not show
    half_loop_uncertainty: FloatArray | None = None  # (3,)
    turn_on: FloatArray | None = None  # (3,), standard deviation from session to session; None for one session
    block_temp_c: FloatArray = field(default_factory=lambda: np.zeros(0))  # (k,), degC; may be empty
    block_departure: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (k, 3)
    block_cooling: FloatArray = field(default_factory=lambda: np.zeros(0))  # (k,), 1 while cooling, -1 while warming

    @property
    def usual_uncertainty(self) -> FloatArray:
        """Median standard uncertainty of the nodes that data were near, shape (3,), ``unit``; of all where none were."""
        near = self.uncertainty[~self.extrapolated] if not self.extrapolated.all() else self.uncertainty
        return np.asarray(np.median(near, axis=0))

    def loop_shown(self, k: int) -> bool:
        """Whether the loop of an axis is part of the table, and significant."""
        half, own = self.half_loop, self.half_loop_uncertainty
        return half is not None and own is not None and abs(half[k]) > _SIGNIFICANT * own[k]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleSummary:
    """Scale factors over temperature less the calibration's, %, at n nodes and S soaks."""

    temp_c: FloatArray  # (n,), nodes, degC
    percent: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), true where no data were near
    soak_temp_c: FloatArray  # (S,), degC
    soak_percent: FloatArray  # (S, 3), of each soak; NaN where it did not turn about the axis
    soak_uncertainty: FloatArray  # (S, 3)


def summarise_gyro(static: StaticFit, device: Calibration) -> TriadSummary | None:
    """Return the gyroscopes' offsets over temperature."""
    found, model = static.gyro, device.gyro
    if found is None or found.offset is None:
        return None
    constant = model is not None and model.method != "nominal"
    zero, against = np.zeros(3) if model is None else model.offset, "the constant offset" if constant else "zero"
    return _summary_of(found, static.table.temp_c, found.offset - zero, zero, against, _factor(model, "rate", ""))


def summarise_accel(
    static: StaticFit, poses: AccelDriftFit | None, device: Calibration, unit: str
) -> TriadSummary | None:
    """Return the accelerometers' offsets over temperature: from several poses where possible, else from one."""
    model, triad, nodes = device.accel, static.accel, static.table.temp_c
    factor, name = _factor(model, "accel", unit)
    if poses is None or model is None:
        if triad is None:
            return None
        reference = device.reference_temp_c if model is not None else np.nan
        if not np.isfinite(reference):
            reference = 0.5 * (triad.span_c[0] + triad.span_c[1])
        curve = triad.curve.curve
        zero = curve.at(np.array([reference])).value[0]
        against = f"that at {reference:.1f} degC"
        return _summary_of(triad, nodes, curve.at(nodes).value - zero, zero, against, (factor, name))
    near = np.flatnonzero(~poses.extrapolated)
    first, last = (near[0], near[-1]) if len(near) > 1 else (0, -1)
    span, doubt = poses.temp_c[last] - poses.temp_c[first], poses.offset_uncertainty
    return TriadSummary(
        unit=name,
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
    )


def _summary_of(
    triad: TriadDrift,
    nodes: FloatArray,
    departure: FloatArray,
    zero: FloatArray,
    against: str,
    units: tuple[FloatArray, str],
) -> TriadSummary:
    factor, unit = units
    loop, turn_on, blocks = triad.curve.loop, triad.curve.turn_on, triad.offsets.blocks
    return TriadSummary(
        unit=unit,
        seen_c=triad.span_c,
        temp_c=nodes,
        against=against,
        departure=departure * factor,
        uncertainty=triad.uncertainty * factor,
        extrapolated=triad.extrapolated,
        in_table=triad.offset is not None,
        slope=triad.slope * factor,
        slope_uncertainty=triad.slope_uncertainty * factor,
        left_out_rms=triad.curve.curve.left_out(triad.curve.cells.groups)[0] * factor,
        half_loop=None if loop is None else loop.half * factor,
        half_loop_uncertainty=None if loop is None else loop.uncertainty * factor,
        turn_on=None if turn_on is None else np.sqrt(turn_on.variance) * factor,
        block_temp_c=blocks.temp_c,
        block_departure=(triad.offsets.value - zero) * factor,
        block_cooling=cooling(blocks),
    )


def summarise_scale(fit: ScaleFit, device: Calibration) -> ScaleSummary | None:
    """Return scale factors over temperature against those of the calibration."""
    drift, soaks = fit.drift, fit.soaks
    if device.gyro is None or drift.gyro_matrix is None or drift.gyro_uncertainty is None:
        return None
    constant = device.gyro.forward_matrix.diagonal() / si_factor(device.gyro.unit_out, "rate")
    scale = np.linalg.inv(drift.gyro_matrix).diagonal(axis1=1, axis2=2) / si_factor(device.gyro.unit_out, "rate")
    share = drift.gyro_uncertainty.diagonal(axis1=1, axis2=2) / drift.gyro_matrix.diagonal(axis1=1, axis2=2)
    return ScaleSummary(
        temp_c=drift.temp_c,
        percent=100.0 * (scale / constant - 1.0),
        uncertainty=100.0 * np.abs(share),
        extrapolated=np.zeros(len(scale), bool) if drift.gyro_extrapolated is None else drift.gyro_extrapolated,
        soak_temp_c=soaks.temp_c,
        soak_percent=100.0 * (soaks.forward.diagonal(axis1=1, axis2=2) / constant - 1.0),
        soak_uncertainty=100.0 * np.sqrt(soaks.variance.diagonal(axis1=1, axis2=2)) / np.abs(constant),
    )


def _factor(model: TriadModel | None, quantity: Quantity, unit: str) -> tuple[FloatArray, str]:
    """Return the physical unit per raw unit of each sensor, and its name; the raw unit where no scale factor is known."""
    si = "rad/s" if quantity == "rate" else "m/s2"
    if model is not None:
        return model.si_per_reading(quantity), si
    if is_physical(unit):
        return np.full(3, si_factor(unit, quantity)), si
    return np.ones(3), unit or "raw unit"


TURN_ON_DPS = 2.0  # a shift from one switch-on to the next; consumer gyroscopes state less
FAR_DPS = 10.0  # no switch-on moves an offset so far
MOST_BEND, LEAST_MISS_DPS = 0.01, 0.25  # (deg/s)/K2, five times what consumer gyroscopes do [assumed]; what is reported
MOST_BETWEEN_DPS = 5.0  # standard deviation between sessions of one device
STATUS_BEFORE = "drift_status_before"  # setting: the calibration's status before a thermal fit
_SIGNIFICANT = 3.0  # standard uncertainties, from which a difference is taken as one
_CERTAIN = 10.0  # from which it may be bad
_TEMPERATURE_OFF_C = 2.0  # between the thermometer of the calibration and that of the session
_SCALE_OFF = (0.02, 0.05)  # marginal, and bad
_ACCEL_SCALE_OFF = (0.01, 0.05)  # marginal, and bad; capacitive sensors keep 1 % for years
_ACCEL_OFFSET_OFF = (0.05, 0.25)  # of gravity
_SCALE_PER_C = 1e-3  # allowed for each degree between the reference and the nearest soak: the steepest sensors
_MOST_EXTRAPOLATED = 0.25  # of the nodes
_SHORTLY_S = 600.0  # after a recording began, with which power-on may have come
_LEAST_LAG_S = 1.0  # a smaller one is not reported
NARROW_C = 5.0  # a table over less is one of one temperature
_APART_C = 1.0  # further from the last one, a temperature belongs to another set-point
_WIDE_C = 2.0  # a wider one is a sweep
_FEW = 5  # set-points: above, what lies between is known about as well as they are
_TOO_FEW = 3  # a parabola through these leaves nothing to judge it by
_ENOUGH = 6
_MORE = 2.0  # times what noise and bias instability explain: disagreement that is reported


def verdict_before(calibration: Calibration) -> Verdict:
    """Return the verdict of a calibration without the findings of an earlier thermal fit."""
    status = calibration.provenance.status(STATUS_BEFORE)
    if status is None:
        return calibration.verdict
    kept = tuple(item for item in calibration.verdict.findings if not item.code.startswith("drift."))
    return Verdict(status=status, findings=kept)


# ---- do sessions and calibration belong to one device?


def check_turns(steps: RateSteps, device: Calibration, static: StaticFit) -> Verdict:
    """Compare the turns with the calibration's matrix: axes, signs, scale."""
    if device.gyro is None or static.table.gyro_offset is None or not len(steps):
        return Verdict()
    kept = device.gyro.forward_matrix / si_factor(device.gyro.unit_out, "rate")
    try:
        soaks = soak_matrices(steps_of(steps), device, static=static.table)
    except CalibrationError:
        return Verdict()  # the selection of tables reports why
    against = np.linalg.inv(kept) @ np.where(np.isfinite(soaks.forward), soaks.forward, kept)
    typical = np.median(against, axis=0)
    what = "thermal session's turns against the calibration"
    check_axis_order(typical, f"{what} (scale ratios {_figures(np.diag(typical))} on x, y, z)", against="turns")
    check_handedness(typical, what)
    return Verdict() if device.gyro.method == "nominal" else _scale_verdict(against, soaks, device.reference_temp_c)


def _scale_verdict(against: FloatArray, soaks: SoakMatrices, reference_temp_c: float) -> Verdict:
    off, allowed = np.zeros(3), np.zeros(3)
    for j in range(3):
        rows = np.flatnonzero(soaks.seen[:, j])
        if len(rows):
            temp_c, ratio = soaks.temp_c[rows], against[rows, j, j]
            at = reference_temp_c if np.isfinite(reference_temp_c) else temp_c[np.abs(ratio - 1.0).argmin()]
            off[j] = np.interp(at, temp_c, ratio) - 1.0
            allowed[j] = _SCALE_PER_C * np.abs(temp_c - at).min()
    level = level_of(float((np.abs(off) - allowed).max()), _SCALE_OFF)
    if level == "info":
        return Verdict()
    return Verdict.of(finding("drift.scale_differs", level, percent=100.0 * off, limit_percent=100.0 * _SCALE_OFF[0]))


def offsets_verdict(static: StaticFit, device: Calibration, felt: FloatArray | float = 0.0) -> Verdict:
    """Compare the offset table with the calibration's constants; ``felt`` (3,) is what gravity adds to readings at rest."""
    model, triad, offset = device.gyro, static.gyro, static.table.gyro_offset
    if model is None or model.method == "nominal" or triad is None or offset is None:
        return Verdict()
    nodes, reference, low_high = static.table.temp_c, device.reference_temp_c, np.array(triad.span_c)
    seen = np.flatnonzero((nodes >= low_high[0] - 1.0) & (nodes <= low_high[1] + 1.0))
    seen = seen if len(seen) else np.arange(len(nodes))
    if np.isfinite(reference):
        node = int(seen[np.abs(nodes[seen] - reference).argmin()])
        away_c = float(abs(nodes[node] - reference))
    else:  # the best case for the device
        node, away_c = int(seen[np.abs(offset - model.offset)[seen].max(axis=1).argmin()]), 0.0
    per_raw = _in_dps(model)[0]
    off = (offset[node] - model.offset) * per_raw
    sure = np.hypot(triad.uncertainty[node], model.standard_uncertainty[9:12]) * per_raw
    beyond = np.abs(off) - np.abs(triad.slope) * per_raw * (2.0 * away_c + _TEMPERATURE_OFF_C)
    at = {
        "temp_c": float(nodes[node]),
        "offset_dps": off,
        "uncertainty_dps": sure,
        "cause": _unit_of(offset[node] + felt, model.offset + felt),
    }
    if beyond.max() <= TURN_ON_DPS:
        return Verdict()
    if not ((beyond > TURN_ON_DPS) & (np.abs(off) > _SIGNIFICANT * sure)).any():
        return Verdict.of(finding("drift.offset_unclear", "info", **at, least_uncertainties=_SIGNIFICANT))
    far = ((beyond > FAR_DPS) & (np.abs(off) > _CERTAIN * sure)).any()
    return Verdict.of(finding("drift.offset_differs", "fail" if far else "warn", **at, turn_on_dps=TURN_ON_DPS))


def _unit_of(seen: FloatArray, own: FloatArray) -> str:
    """Return which unit makes a device's own offset (3,) of another one, along the same direction."""
    size, along = float(np.linalg.norm(own)), float(seen @ own) / max(float(own @ own), 1e-300)
    if size == 0.0 or np.linalg.norm(seen - along * own) > 0.2 * np.linalg.norm(seen):
        return ""
    for factor, text in ((1.0 / RADIAN_PER_DEGREE, "deg/s, not rad/s"), (RADIAN_PER_DEGREE, "rad/s, not deg/s")):
        if abs(along / factor - 1.0) < 0.2:
            return f"; the offset is {along:.3g} times the calibration's on every axis: gyroscope is in {text}"
    return ""


def poses_verdict(accel: AccelDriftFit | None, device: Calibration) -> Verdict:
    """Compare the accelerometers' matrix and offset from poses with the calibration's."""
    model = device.accel
    if accel is None or model is None or model.method == "nominal" or accel.extrapolated.all():
        return Verdict()
    near = np.flatnonzero(~accel.extrapolated)
    away = np.nan_to_num(np.abs(accel.temp_c[near] - device.reference_temp_c))  # 0 where no reference is known
    node, temp_c = int(near[away.argmin()]), float(accel.temp_c[near[away.argmin()]])
    inverse = model.forward_matrix
    off = accel.matrix[node] @ inverse - np.eye(3)
    own = model.standard_uncertainty[:9].reshape(3, 3)
    sure = np.sqrt((accel.matrix_uncertainty[node] ** 2 + own**2) @ inverse**2)
    allowed = UNKNOWN_SCALE_PER_K * float(away.min()) * np.eye(3)
    beyond = np.where(np.abs(off) > _SIGNIFICANT * sure, np.abs(off) - allowed, 0.0)
    per_g = model.si_per_reading("accel") / device.gravity_m_s2
    shift = (accel.offset[node] - model.offset) * per_g
    shift_sure = np.hypot(accel.offset_uncertainty[node], model.standard_uncertainty[9:12]) * per_g
    moved = np.where(np.abs(shift) > _SIGNIFICANT * shift_sure, np.abs(shift), 0.0)
    findings: list[Finding] = []
    bad = bool(max(beyond.max() / _ACCEL_SCALE_OFF[1], moved.max() / _ACCEL_OFFSET_OFF[1]) > 1.0)
    if beyond.max() > _ACCEL_SCALE_OFF[0]:
        i, j = np.unravel_index(int(beyond.argmax()), (3, 3))
        findings.append(
            finding(
                "drift.accel_matrix_differs",
                "fail" if bad else "warn",
                temp_c=temp_c,
                percent=100.0 * np.diag(off),
                largest_percent=100.0 * off[i, j],
                uncertainty_percent=100.0 * sure[i, j],
                element=AXES[i] + AXES[j],
                limit_percent=100.0 * _ACCEL_SCALE_OFF[0],
            )
        )
    if moved.max() > _ACCEL_OFFSET_OFF[0]:
        findings.append(
            finding(
                "drift.accel_offset_differs",
                "fail" if bad else "warn",
                temp_c=temp_c,
                offset_mg=1e3 * shift,
                uncertainty_mg=1e3 * shift_sure,
                limit_mg=1e3 * _ACCEL_OFFSET_OFF[0],
            )
        )
    return Verdict.of(*findings)


def check_sessions(static: StaticFit, device: Calibration) -> None:
    """Raise where sessions lie further apart than one device's do."""
    found, model = static.gyro, device.gyro
    if found is None or model is None or found.curve.turn_on is None:
        return
    between = np.sqrt(found.curve.turn_on.variance) * _in_dps(model)[0]
    if between.max() > MOST_BETWEEN_DPS:
        raise Implausible(
            f"sessions: wanted offsets of one device, within {MOST_BETWEEN_DPS:g} deg/s from session to session, got a standard "
            f"deviation of {_figures(between)} deg/s on x, y, z; are they of one device? fit each device by itself",
            deg_per_s=float(between.max()),
        )


# ---- what the tables are worth


def static_verdict(static: StaticFit, accel: AccelDriftFit | None) -> Verdict:
    """Return what the offsets' fit is worth; accelerometers of one pose count where no poses determined them."""
    gyro, hidden, narrow = static.gyro, set[str](), tuple[Finding, ...]()
    marginal = static.verdict.status != "good"
    if gyro is not None:
        few = gyro.extrapolated.mean() <= _MOST_EXTRAPOLATED
        marginal |= gyro.curve.loop is None or not few
        hidden |= {"drift.nodes_extrapolated"} if few else set()
        low_c, high_c = gyro.span_c
        narrow = (
            (finding("drift.narrow_span", "warn", low_c=low_c, high_c=high_c),) if high_c - low_c < NARROW_C else ()
        )
    of_accel = [item for item in static.verdict.findings if item.code.startswith("drift.accel_")]
    findings = [
        item
        for item in static.verdict.findings
        if item not in of_accel and item.values.get("sensor") != "accelerometer" and item.code not in hidden
    ]
    if accel is None and static.table.accel_offset is None:  # why there is no table, and nothing about the table
        findings += [item for item in of_accel if item.code != "drift.accel_one_pose"][:1]
    elif accel is None:
        findings += [item for item in of_accel if item.code == "drift.accel_one_pose"]
        marginal |= static.accel is not None and static.accel.mostly_unknown_scale
    return Verdict(status="marginal" if marginal or narrow else "good", findings=(*narrow, *findings))


def single_sweep_verdict(
    gyro: TriadSummary | None, rests: RestBlocks, temperatures: tuple[Temperature, ...], *, warm_up_fitted: bool
) -> Verdict:
    """Return whether a power-on transient may be in a table of a temperature that went in one direction only."""
    if gyro is None or gyro.half_loop is not None or all(temperature.source == "means" for temperature in temperatures):
        return Verdict()
    ordered = np.abs(rests.ramp_c_per_min[np.lexsort((rests.time, rests.session))])
    part = max(len(ordered) // 4, 1)
    fastest_first = ordered[:part].mean() > 2.0 * ordered[-part:].mean()
    if not warm_up_fitted and (float(rests.power_on_s.min()) < _SHORTLY_S or fastest_first):
        return Verdict.of(finding("drift.power_on_transient", "warn"))
    return Verdict()


def temperature_verdict(temperatures: tuple[Temperature, ...]) -> Verdict:
    """Return what the temperatures are worth."""
    if all(temperature.source == "set-points" for temperature in temperatures):
        return Verdict.of(finding("drift.set_points_only", "warn"))
    if all(temperature.source == "means" for temperature in temperatures):
        return Verdict.of(finding("drift.temperature_of_table", "info"))
    return Verdict.of(*(item for temperature in temperatures for item in temperature.findings))


def lag_verdict(lag: LagFit | None, subtracted_s: float) -> Verdict:
    """Return the findings on the thermometer's lag."""
    # No lag explains the loop: nothing to separate
    if lag is None or (subtracted_s == 0.0 and len(lag.lags_s) and lag.lag_s < _LEAST_LAG_S and not lag.observable):
        return Verdict()
    if subtracted_s == 0.0:
        return Verdict(findings=lag.findings)
    done = finding("drift.lag_subtracted", "info", lag_s=subtracted_s, uncertainty_s=lag.uncertainty_s)
    return Verdict(findings=(done, *lag.findings))


# ---- few set-points, and rests of one set-point that disagree


def with_set_points(verdict: Verdict, static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return the verdict on the offsets' fit with what its set-points and rests show."""
    disagree = rests_verdict(static, device)
    if any(item.code.startswith("drift.poses_") for item in disagree.findings):  # says more than g_unknown
        verdict = replace(verdict, findings=tuple(f for f in verdict.findings if f.code != "drift.g_unknown"))
    return verdict.also(disagree).also(bends_verdict(static, device)).also(set_points_verdict(static, rests, device))


def bends_verdict(static: StaticFit, device: Calibration) -> Verdict:
    """Return which set-point is off the line between its neighbours by more than the offset of one device at rest bends.

    Set-points t of a session with mean offset y, by the second divided difference::

        bend = 2 (dy_2 / dt_2 - dy_1 / dt_1) / (dt_1 + dt_2)        miss = bend dt_1 dt_2 / 2
    """
    triad, model = static.gyro, device.gyro
    if triad is None or model is None:
        return Verdict()
    blocks, worst = triad.offsets.blocks, (0.0, 0.0, 0.0)
    for session in np.unique(blocks.session):
        own = blocks.session == session
        temp_c, value = blocks.temp_c[own], triad.offsets.value[own] * _in_dps(model)[0]
        points = set_points_of(temp_c)
        if len(points) <= _TOO_FEW:
            continue
        nearest = np.abs(temp_c[:, None] - points).argmin(axis=1)
        means = np.array([value[nearest == k].mean(axis=0) for k in range(len(points))])
        steps = np.diff(points)[:, None]
        bend = 2.0 * np.diff(np.diff(means, axis=0) / steps, axis=0) / (steps[1:] + steps[:-1])
        miss = np.abs(bend) * steps[1:] * steps[:-1] / 2.0
        miss = np.where(np.abs(bend) > MOST_BEND, miss, 0.0).max(axis=1)
        k = int(miss.argmax())
        worst = max(worst, (float(miss[k]), float(points[k + 1]), float(np.abs(bend[k]).max())))
    if worst[0] < LEAST_MISS_DPS:
        return Verdict()
    shown = {"miss_dps": worst[0], "temp_c": worst[1], "bend": worst[2], "limit": MOST_BEND}
    return Verdict.of(finding("drift.bends", "warn", **shown))


def rests_verdict(static: StaticFit, device: Calibration) -> Verdict:
    """Return how far rests of one set-point disagree beyond their noise, and what is the likely reason."""
    scatter = None if static.gyro is None else static.gyro.curve.cells.scatter
    if scatter is None:
        return Verdict()
    factor, unit = _in_dps(device.gyro)
    expected, findings = scatter.known * factor, list[Finding]()
    if (scatter.pose > _MORE * scatter.known).any():
        g_known = device.gyro is not None and device.gyro.g_sensitivity is not None
        size, poses, no_accel = scatter.pose * factor, scatter.poses, device.accel is None
        findings.append(
            finding(
                "drift.poses_disagree" if g_known else "drift.poses_g_no_accel" if no_accel else "drift.poses_g",
                "info",
                deviation=size,
                unit=unit,
                poses=poses,
                known=expected,
            )
        )
    if (scatter.rest > _MORE * scatter.known).any():
        size, rests = scatter.rest * factor, scatter.rests
        findings.append(finding("drift.rests_disagree", "info", deviation=size, unit=unit, rests=rests, known=expected))
    return Verdict(findings=tuple(findings))


def set_points_verdict(static: StaticFit, rests: RestBlocks, device: Calibration) -> Verdict:
    """Return what few set-points leave open between them, and where to soak as well."""
    found, points, nodes = static.gyro, set_points_of(rests.temp_c), static.table.temp_c
    if found is None or not 2 <= len(points) <= _FEW:
        return Verdict()
    at = interpolated(points, nodes, found.uncertainty).mean(axis=0)
    between = found.uncertainty[(nodes >= points[0] - 1e-6) & (nodes <= points[-1] + 1e-6)].max(axis=0, initial=0.0)
    if len(points) > _TOO_FEW and (between < _MORE * at).all():
        return Verdict()
    factor, unit = _in_dps(device.gyro)
    gaps = np.argsort(-np.diff(points))[: max(_ENOUGH - len(points), 1)]
    few = finding(
        "drift.few_set_points",
        "info",
        count=len(points),
        set_points_c=points,
        at=at * factor,
        between=between * factor,
        unit=unit,
        also_c=np.sort(0.5 * (points[gaps] + points[gaps + 1])),
    )
    return Verdict(findings=(few,))


def set_points_of(temp_c: FloatArray) -> FloatArray:
    """Return the set-points that temperatures (n,) were held at, degC; none for a sweep."""
    rising = np.sort(temp_c)
    held = np.split(rising, np.flatnonzero(np.diff(rising) > _APART_C) + 1)
    if max(float(np.ptp(part)) for part in held) > _WIDE_C:
        return np.zeros(0)
    return np.array([part.mean() for part in held])


def _in_dps(model: TriadModel | None) -> tuple[FloatArray, str]:
    """Return deg/s per raw unit of each gyroscope, and that unit; the raw unit where no scale factor is known."""
    return (np.ones(3), "raw units") if model is None else (model.si_per_reading("rate") / RADIAN_PER_DEGREE, "deg/s")


def _figures(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def set_point_verdict(sessions: Sequence[Session]) -> Verdict:
    """Return what tables of set-points do not state."""
    findings: list[Finding] = []
    for session in sessions:
        for record, means in zip(session.records, session.means, strict=bool(session.means)):
            for name, values, stated in (
                ("gyroscope", record.gyro, means.gyro_uncertainty),
                ("accelerometer", record.accel, means.accel_uncertainty),
            ):
                missing = int(np.isnan(stated).any(axis=1).sum())
                if values is not None and missing:
                    findings.append(
                        finding("drift.rows_without_uncertainty", "warn", sensor=name, rows=missing, of=len(record))
                    )
            if np.isnan(means.count).any() and not means.from_spread and np.isfinite(means.gyro_uncertainty).any():
                findings.append(finding("drift.rows_without_count", "info"))
            if means.from_spread:
                findings.append(finding("drift.rows_by_spread", "info"))
    return Verdict.of(*findings) if findings else Verdict()
