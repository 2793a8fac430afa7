"""The verdict of a thermal fit: what it is worth, and whether sessions and calibration belong to one device.

Checked against the calibration's constants, before tables take their place::

    turns      inv(K_c) K    K of each soak, K_c of the calibration: near one; another order or sign of axes is refused
    scale      its diagonal at the reference temperature, minus 1
    offset     table at the reference temperature, or at the nearest node seen, minus the calibration's constant
    sessions   standard deviation from session to session
    accel      P = M_a(T_ref) M_c^-1 of the accelerometers' poses: near one; and their offset, M_c (o_a - o_c)

Offsets move from one switch-on to the next, and the calibration's temperature may have been read on another thermometer: 2 deg/s
and the slope over 2 K (and over the distance between reference and node, doubled) are allowed. A larger difference counts from
three standard uncertainties, of table and calibration together, and can be bad from ten. Accelerometers are more stable: 1 % of a
matrix' elements and 50 mg are allowed, and three standard uncertainties.
"""

from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.plausibility import check_axis_order, check_handedness
from undrift.drift.accel import AccelDriftFit
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.offset import UNKNOWN_SCALE_PER_K, StaticFit, TriadDrift, cooling
from undrift.drift.rates import ScaleFit, prepared, soak_matrices
from undrift.drift.temperature import Temperature
from undrift.errors import CalibrationError, Implausible
from undrift.findings import Finding, finding
from undrift.model import AXES, Calibration, TriadModel, Verdict, level_of
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

STATUS_BEFORE = "drift_status_before"  # setting: the calibration's status before a thermal fit
TURN_ON_DPS = 2.0  # a shift from one switch-on to the next; consumer gyroscopes state less
FAR_DPS = 10.0  # no switch-on moves an offset so far
MOST_BETWEEN_DPS = 5.0  # standard deviation between sessions of one device
MOST_BEND = 0.01  # (deg/s)/K2, five times that of consumer gyroscopes [assumed]
LEAST_MISS_DPS = 0.25  # smallest one reported
NARROW_C = 5.0  # a table over less is one of one temperature
_SIGNIFICANT, _CERTAIN = (
    3.0,
    10.0,
)  # standard uncertainties: two values differ from the first on, may be bad from the second
_TEMPERATURE_OFF_C = 2.0  # between the thermometer of the calibration and that of the session
_SCALE_OFF = (0.02, 0.05)  # marginal, and bad
_SCALE_PER_C = 1e-3  # allowed for each degree between the reference and the nearest soak: the steepest sensors
_ACCEL_SCALE_OFF, _ACCEL_OFFSET_OFF = (0.01, 0.05), (0.05, 0.25)  # marginal, and bad; of gravity
_MOST_EXTRAPOLATED = 0.25  # of the nodes
_SHORTLY_S = 600.0  # after a recording began, with which power-on may have come
_APART_C, _WIDE_C = 1.0, 2.0  # from the last temperature: another set-point; a wider set-point is a sweep

# ---- summary of a thermal fit in SI units, per sensor: y = (u - offset) / scale_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors: n nodes, k blocks of rest; values in ``unit``."""

    unit: str  # rad/s or m/s2; the raw unit if the scale factor is not known
    seen_c: tuple[float, float]  # least and greatest temperature seen, degC
    temp_c: FloatArray  # (n,), nodes, degC
    against: str  # reference of the departure: the constant offset, zero, or the reading at a temperature
    departure: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), True if no data were near
    in_table: bool  # False if only the change is known, so that there is no table
    slope: FloatArray  # (3,), mean over the temperatures seen, per K
    slope_uncertainty: FloatArray  # (3,)
    left_out_rms: FloatArray  # (3,), cross-validated error; NaN for too few temperatures
    half_loop: FloatArray | None = None  # (3,), hysteresis half-width, cooling minus warming; None if not observable
    half_loop_uncertainty: FloatArray | None = None  # (3,)
    turn_on: FloatArray | None = None  # (3,), standard deviation from session to session; None for one session
    block_temp_c: FloatArray = field(default_factory=lambda: np.zeros(0))  # (k,), degC; may be empty
    block_departure: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (k, 3)
    block_cooling: FloatArray = field(default_factory=lambda: np.zeros(0))  # (k,), 1 while cooling, -1 while warming

    @property
    def usual_uncertainty(self) -> FloatArray:
        """Median standard uncertainty of the nodes near data, or of all nodes if none is, shape (3,), ``unit``."""
        near = self.uncertainty[~self.extrapolated] if not self.extrapolated.all() else self.uncertainty
        return np.asarray(np.median(near, axis=0))

    def loop_shown(self, k: int) -> bool:
        """Return True if the loop of an axis is significant."""
        half, uncertainty = self.half_loop, self.half_loop_uncertainty
        return half is not None and uncertainty is not None and abs(half[k]) > _SIGNIFICANT * uncertainty[k]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleSummary:
    """Scale factors over temperature minus the calibration's, %, at n nodes and S soaks."""

    temp_c: FloatArray  # (n,), nodes, degC
    percent: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), True if no data were near
    soak_temp_c: FloatArray  # (S,), degC
    soak_percent: FloatArray  # (S, 3), of each soak; NaN for an axis that did not turn
    soak_uncertainty: FloatArray  # (S, 3)


def summarise_gyro(static: StaticFit, device: Calibration) -> TriadSummary | None:
    """Return the gyroscopes' offsets over temperature."""
    triad, model = static.gyro, device.gyro
    if triad is None or triad.offset is None:
        return None
    zero, against = np.zeros(3) if model is None else model.offset, "zero"
    if model is not None and model.method != "nominal":
        against = "the constant offset"
    return _summary_of(triad, static.table.temp_c, triad.offset - zero, zero, against, _factor(model, "rate", ""))


def summarise_accel(
    static: StaticFit, poses: AccelDriftFit | None, device: Calibration, unit: str
) -> TriadSummary | None:
    """Return the accelerometers' offsets over temperature: from several poses if possible, otherwise from one."""
    model, triad, nodes = device.accel, static.accel, static.table.temp_c
    factor, name = _factor(model, "accel", unit)
    if poses is not None and model is not None:
        near = np.flatnonzero(~poses.extrapolated)
        first, last = (near[0], near[-1]) if len(near) > 1 else (0, -1)
        span, uncertainty = poses.temp_c[last] - poses.temp_c[first], poses.offset_uncertainty * factor
        return TriadSummary(
            unit=name,
            seen_c=(float(poses.temp_c[first]), float(poses.temp_c[last])),
            temp_c=poses.temp_c,
            against="the constant offset",
            departure=(poses.offset - model.offset) * factor,
            uncertainty=uncertainty,
            extrapolated=poses.extrapolated,
            in_table=True,
            slope=(poses.offset[last] - poses.offset[first]) / span * factor,
            slope_uncertainty=np.hypot(uncertainty[last], uncertainty[first]) / span,
            left_out_rms=np.full(3, np.nan),
        )
    if triad is None:
        return None
    reference = device.reference_temp_c if model is not None else np.nan
    reference = reference if np.isfinite(reference) else float(np.mean(triad.span_c))
    zero, against = triad.curve.at(np.array([reference])).value[0], f"that at {reference:.1f} degC"
    return _summary_of(triad, nodes, triad.curve.at(nodes).value - zero, zero, against, (factor, name))


def _summary_of(
    triad: TriadDrift,
    nodes: FloatArray,
    departure: FloatArray,
    zero: FloatArray,
    against: str,
    units: tuple[FloatArray, str],
) -> TriadSummary:
    (factor, unit), blocks = units, triad.offsets.blocks
    half, half_uncertainty = triad.hysteresis, triad.hysteresis_uncertainty
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
        left_out_rms=triad.curve.left_out(triad.cells.groups)[0] * factor,
        half_loop=None if half is None else half * factor,
        half_loop_uncertainty=None if half_uncertainty is None else half_uncertainty * factor,
        turn_on=None if triad.turn_on is None else np.sqrt(triad.turn_on.variance) * factor,
        block_temp_c=blocks.temp_c,
        block_departure=(triad.offsets.value - zero) * factor,
        block_cooling=cooling(blocks),
    )


def summarise_scale(fit: ScaleFit, device: Calibration) -> ScaleSummary | None:
    """Return scale factors over temperature against those of the calibration."""
    drift, soaks = fit.drift, fit.soaks
    if device.gyro is None or drift.gyro_matrix is None or drift.gyro_uncertainty is None:
        return None
    unit = si_factor(device.gyro.unit_out, "rate")
    constant = device.gyro.forward_matrix.diagonal() / unit
    scale = np.linalg.inv(drift.gyro_matrix).diagonal(axis1=1, axis2=2) / unit
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
    """Return the physical unit per raw unit of each sensor, and its name; the raw unit if no scale factor is known."""
    si = "rad/s" if quantity == "rate" else "m/s2"
    if model is not None:
        return model.si_per_reading(quantity), si
    if is_physical(unit):
        return np.full(3, si_factor(unit, quantity)), si
    return np.ones(3), unit or "raw unit"


def _dps(model: TriadModel) -> FloatArray:
    """Return deg/s per raw unit of each gyroscope, (3,)."""
    return model.si_per_reading("rate") / RADIAN_PER_DEGREE


def verdict_before(calibration: Calibration) -> Verdict:
    """Return the verdict of a calibration without the findings of an earlier thermal fit."""
    status = calibration.provenance.status(STATUS_BEFORE)
    if status is None:
        return calibration.verdict
    kept = tuple(item for item in calibration.verdict.findings if not item.code.startswith("drift."))
    return Verdict(status=status, findings=kept)


# ---- do sessions and calibration belong to one device?


def check_sessions(static: StaticFit, device: Calibration) -> None:
    """Raise if sessions lie further apart than those of one device."""
    if static.gyro is None or device.gyro is None or static.gyro.turn_on is None:
        return
    between = np.sqrt(static.gyro.turn_on.variance) * _dps(device.gyro)
    if between.max() > MOST_BETWEEN_DPS:
        figures = ", ".join(f"{value:.3g}" for value in between)
        raise Implausible(
            f"sessions: offsets differ from session to session by a standard deviation of {figures} deg/s on x, y, z; one device "
            f"stays within {MOST_BETWEEN_DPS:g}. Are they of one device? Fit each device by itself.",
            deg_per_s=float(between.max()),
        )


def turns_verdict(steps: RateSteps, device: Calibration, static: StaticFit) -> Verdict:
    """Compare the turns with the calibration's matrix: axes, signs, scale."""
    if device.gyro is None or static.table.gyro_offset is None or not len(steps):
        return Verdict()
    constant = device.gyro.forward_matrix / si_factor(device.gyro.unit_out, "rate")
    try:
        soaks = soak_matrices(prepared(steps, device, static=static.table), device)
    except CalibrationError:
        return Verdict()  # the selection of tables reports why
    against = np.linalg.inv(constant) @ np.where(np.isfinite(soaks.forward), soaks.forward, constant)
    typical = np.median(against, axis=0)
    ratios = ", ".join(f"{value:.3g}" for value in np.diag(typical))
    what = "thermal session's turns against the calibration"
    check_axis_order(typical, f"{what} (scale ratios {ratios} on x, y, z)", against="turns")
    check_handedness(typical, what)
    off, allowed = np.zeros(3), np.zeros(3)
    for j in range(3):
        rows = np.flatnonzero(np.isfinite(soaks.forward[:, 0, j]))
        if len(rows):
            temp_c, ratio = soaks.temp_c[rows], against[rows, j, j]
            known = np.isfinite(device.reference_temp_c)
            reference_c = device.reference_temp_c if known else temp_c[np.abs(ratio - 1.0).argmin()]
            off[j] = np.interp(reference_c, temp_c, ratio) - 1.0
            allowed[j] = _SCALE_PER_C * np.abs(temp_c - reference_c).min()
    level = level_of(float((np.abs(off) - allowed).max()), _SCALE_OFF)
    if level == "info" or device.gyro.method == "nominal":
        return Verdict()
    return Verdict.of(finding("drift.scale_differs", level, percent=100.0 * off, limit_percent=100.0 * _SCALE_OFF[0]))


def offsets_verdict(static: StaticFit, device: Calibration, felt: FloatArray | float = 0.0) -> Verdict:
    """Compare the offset table with the calibration's constants; ``felt`` (3,) is what gravity adds to readings at rest."""
    model, triad, offset = device.gyro, static.gyro, static.table.gyro_offset
    if model is None or model.method == "nominal" or triad is None or offset is None:
        return Verdict()
    nodes, reference_c = static.table.temp_c, device.reference_temp_c
    seen = np.flatnonzero((nodes >= triad.span_c[0] - 1.0) & (nodes <= triad.span_c[1] + 1.0))
    seen = seen if len(seen) else np.arange(len(nodes))
    apart = np.abs(nodes[seen] - reference_c)
    if not np.isfinite(reference_c):  # the best case for the device
        apart = np.abs(offset - model.offset)[seen].max(axis=1)
    node = int(seen[apart.argmin()])
    away_c = float(apart.min()) if np.isfinite(reference_c) else 0.0
    off = (offset[node] - model.offset) * _dps(model)
    uncertainty = np.hypot(triad.uncertainty[node], model.standard_uncertainty[9:12]) * _dps(model)
    beyond = np.abs(off) - np.abs(triad.slope) * _dps(model) * (2.0 * away_c + _TEMPERATURE_OFF_C)
    if not ((beyond > TURN_ON_DPS) & (np.abs(off) > _SIGNIFICANT * uncertainty)).any():
        return Verdict()
    far = ((beyond > FAR_DPS) & (np.abs(off) > _CERTAIN * uncertainty)).any()
    values = {"temp_c": float(nodes[node]), "offset_dps": off, "uncertainty_dps": uncertainty}
    cause = _unit_of(offset[node] + felt, model.offset + felt)
    return Verdict.of(
        finding("drift.offset_differs", "fail" if far else "warn", **values, cause=cause, turn_on_dps=TURN_ON_DPS)
    )


def _unit_of(seen: FloatArray, constant: FloatArray) -> str:
    """Return which unit explains one offset (3,) by the other, along the same direction."""
    square = max(float(constant @ constant), 1e-300)
    along = float(seen @ constant) / square
    if np.linalg.norm(seen - along * constant) > 0.2 * np.linalg.norm(seen):
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
    away = np.nan_to_num(np.abs(accel.temp_c[near] - device.reference_temp_c))  # 0 if no reference is known
    node, inverse = int(near[away.argmin()]), model.forward_matrix
    off = accel.matrix[node] @ inverse - np.eye(3)
    constant_variance = model.standard_uncertainty[:9].reshape(3, 3) ** 2
    off_uncertainty = np.sqrt((accel.matrix_uncertainty[node] ** 2 + constant_variance) @ inverse**2)
    allowed = UNKNOWN_SCALE_PER_K * float(away.min()) * np.eye(3)
    scale = np.where(np.abs(off) > _SIGNIFICANT * off_uncertainty, np.abs(off) - allowed, 0.0).max()
    per_g = model.si_per_reading("accel") / device.gravity_m_s2
    shift = (accel.offset[node] - model.offset) * per_g
    shift_uncertainty = np.hypot(accel.offset_uncertainty[node], model.standard_uncertainty[9:12]) * per_g
    moved = np.where(np.abs(shift) > _SIGNIFICANT * shift_uncertainty, np.abs(shift), 0.0).max()
    if scale <= _ACCEL_SCALE_OFF[0] and moved <= _ACCEL_OFFSET_OFF[0]:
        return Verdict()
    i, j = np.unravel_index(int(np.abs(off).argmax()), (3, 3))
    return Verdict.of(
        finding(
            "drift.accel_differs",
            "fail" if scale > _ACCEL_SCALE_OFF[1] or moved > _ACCEL_OFFSET_OFF[1] else "warn",
            temp_c=float(accel.temp_c[node]),
            largest_percent=100.0 * off[i, j],
            element=AXES[i] + AXES[j],
            limit_percent=100.0 * _ACCEL_SCALE_OFF[0],
            offset_mg=1e3 * shift,
            limit_mg=1e3 * _ACCEL_OFFSET_OFF[0],
        )
    )


# ---- what the tables are worth


def static_verdict(
    static: StaticFit, accel: AccelDriftFit | None, device: Calibration, temperatures: tuple[Temperature, ...]
) -> Verdict:
    """Return what the offsets are worth; accelerometers of one pose count only if no poses determined them."""
    findings = [f for f in static.verdict.findings if accel is None or not _of_accelerometers(f)]
    triad = static.gyro
    if triad is None:
        return Verdict.of(*findings)
    (low_c, high_c), share = triad.span_c, float(triad.extrapolated.mean())
    if share > _MOST_EXTRAPOLATED:
        findings.append(finding("drift.nodes_extrapolated", "warn", percent=100.0 * share, low_c=low_c, high_c=high_c))
    if high_c - low_c < NARROW_C:
        findings.append(finding("drift.narrow_span", "warn", low_c=low_c, high_c=high_c))
    if all(temperature.source == "set-points" for temperature in temperatures):
        findings.append(finding("drift.set_points_only", "warn"))
    measured = any(temperature.source != "means" for temperature in temperatures)
    if triad.hysteresis is None and triad.warm_up is None and measured and _starts_fast(triad.offsets.blocks):
        findings.append(finding("drift.power_on_transient", "warn"))
    findings += [item for temperature in temperatures for item in temperature.findings]
    return Verdict.of(*findings).also(bends_verdict(triad, device.gyro))


def _of_accelerometers(item: Finding) -> bool:
    """Return True if a finding is about the offset of the accelerometers in one pose."""
    return item.code.startswith("drift.accel_") or item.values.get("sensor") == "accelerometer"


def _starts_fast(rests: RestBlocks) -> bool:
    """Return True if a temperature that went one way may include a power-on transient."""
    ramps = np.abs(rests.ramp_c_per_min[np.lexsort((rests.time, rests.session))])
    part = max(len(ramps) // 4, 1)
    return bool(rests.power_on_s.min() < _SHORTLY_S or ramps[:part].mean() > 2.0 * ramps[-part:].mean())


def bends_verdict(triad: TriadDrift, model: TriadModel | None) -> Verdict:
    """Return which set-point is off the line between its neighbours by more than the offset of one device at rest bends.

    Set-points t of a session with mean offset y, by the second divided difference::

        bend = 2 (dy_2 / dt_2 - dy_1 / dt_1) / (dt_1 + dt_2)        miss = bend dt_1 dt_2 / 2
    """
    blocks, worst = triad.offsets.blocks, (0.0, 0.0, 0.0)
    if model is None:
        return Verdict()
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
        temp_c, value = blocks.temp_c[rows], triad.offsets.value[rows] * _dps(model)
        parts = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(temp_c) > _APART_C) + 1)
        if len(parts) < 4 or max(float(np.ptp(temp_c[part])) for part in parts) > _WIDE_C:  # few, or a sweep
            continue
        points = np.array([temp_c[part].mean() for part in parts])
        means, steps = np.array([value[part].mean(axis=0) for part in parts]), np.diff(points)[:, None]
        bend = 2.0 * np.diff(np.diff(means, axis=0) / steps, axis=0) / (steps[1:] + steps[:-1])
        miss = np.where(np.abs(bend) > MOST_BEND, np.abs(bend) * steps[1:] * steps[:-1] / 2.0, 0.0).max(axis=1)
        k = int(miss.argmax())
        worst = max(worst, (float(miss[k]), float(points[k + 1]), float(np.abs(bend[k]).max())))
    if worst[0] < LEAST_MISS_DPS:
        return Verdict()
    values = {"miss_dps": worst[0], "temp_c": worst[1], "bend": worst[2], "limit": MOST_BEND}
    return Verdict.of(finding("drift.bends", "warn", **values))
