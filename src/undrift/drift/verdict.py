"""Verdict of a thermal fit: quality of the tables, and whether sessions and calibration belong to the same device.

Comparison with the calibration's constants, before tables replace them::

    turns      inv(K_c) K    near identity for K of each soak and K_c of the calibration (another order or sign of axes is refused)
    scale      its diagonal at the node nearest to the reference temperature, minus 1
    offset     table at the reference temperature, or at the nearest observed node, minus the calibration's constant
    gravity    length of the corrected specific force at the rests nearest the reference temperature, minus g
    sessions   standard deviation from session to session

Offsets differ from one switch-on to the next, and the calibration may have used another thermometer. The allowed difference is 2
deg/s, plus the slope over 2 K and over twice the distance between reference and node. A larger difference is reported from three
standard uncertainties of table and calibration together, and can be bad from ten.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.plausibility import check_axis_order
from undrift.drift.observe import RateSteps, RestBlocks, not_observable
from undrift.drift.offset import StaticFit, TriadDrift, specific_force, split_by
from undrift.drift.rates import ScaleFit
from undrift.drift.temperature import LagFit, Temperature
from undrift.errors import Implausible
from undrift.findings import Finding, above, finding, told_apart
from undrift.model import Calibration, TriadModel, Verdict
from undrift.record import Session, TemperatureSensitivity
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

TURN_ON_DPS = 2.0  # shift from one switch-on to the next (data sheets of consumer gyroscopes have smaller limits)
FAR_DPS = 10.0  # no switch-on changes an offset by as much
MOST_BETWEEN_DPS = 5.0  # largest standard deviation between sessions of the same device
MOST_BEND = 0.01  # (deg/s)/K2, five times the value of consumer gyroscopes [assumed]
LEAST_MISS_DPS = 0.25  # smallest bend that is reported
SIGNIFICANT, CERTAIN = 3.0, 10.0  # standard uncertainties from which values differ, and from which they may be bad
LEFT_ACCEL_MG = 10.0  # effect of turn-on and ageing on accelerometers, and of local gravity elsewhere [assumed]
NEAR_C = 5.0  # rests within this of the rest nearest to the reference temperature are compared with gravity
UNKNOWN_DEPARTURE_C = 10.0  # distance to the reference temperature, if the calibration has none
TEMPERATURE_OFF_C = 2.0  # possible difference between the thermometers of calibration and session
SCALE_OFF = (0.02, 0.05)  # limits of marginal and bad
SCALE_PER_C = 1e-3  # allowed change per degree between the reference and the nearest soak: the steepest sensors
NARROW_C = 5.0  # a table over a smaller range is a table of a single temperature
MOST_EXTRAPOLATED = 0.25  # largest share of extrapolated nodes
APART_C, WIDE_C = 1.0, 2.0  # smallest distance to the next set-point, and width above which a set-point is a sweep


def _dps(model: TriadModel) -> FloatArray:
    """Return deg/s per raw unit of each gyroscope, (3,)."""
    return model.si_per_reading("rate") / RADIAN_PER_DEGREE


def without_tables(calibration: Calibration) -> Calibration:
    """Return a calibration with the verdict that it had before an earlier thermal fit."""
    findings = [item for item in calibration.verdict.findings if not item.code.startswith("drift.")]
    return calibration if calibration.drift is None else replace(calibration, verdict=Verdict.of(*findings))


# ---- do sessions and calibration belong to one device?


def check_sessions(static: StaticFit, device: Calibration) -> None:
    """Raise if sessions differ more than sessions of the same device do."""
    if static.gyro is None or device.gyro is None or static.gyro.turn_on is None:
        return
    between = np.sqrt(static.gyro.turn_on.variance) * _dps(device.gyro)
    if between.max() > MOST_BETWEEN_DPS:
        figures = ", ".join(f"{value:.3g}" for value in between)
        raise Implausible(
            f"sessions: offsets differ from session to session by a standard deviation of {figures} deg/s on x, y, z. The limit "
            f"for the same device is {MOST_BETWEEN_DPS:g}. Fit the sessions of each device separately.",
            deg_per_s=float(between.max()),
        )


def check_turns(scale: ScaleFit | None, device: Calibration) -> Iterator[Finding]:
    """Compare the turns with the calibration's matrix: axes, signs, scale."""
    if device.gyro is None or scale is None:
        return
    soaks, constant = scale.soaks, device.gyro.forward_matrix / si_factor(device.gyro.unit_out, "rate")
    against = np.linalg.inv(constant) @ np.where(np.isfinite(soaks.forward), soaks.forward, constant)
    typical = np.median(against, axis=0)
    ratios = ", ".join(f"{value:.3g}" for value in np.diag(typical))
    what = "thermal session's turns against the calibration"
    check_axis_order(typical, f"{what} (scale ratios {ratios} on x, y, z)", against="turns")
    nodes, change = scale.drift.temp_c, (np.linalg.inv(constant) @ scale.forward).diagonal(axis1=1, axis2=2) - 1.0
    known = np.isfinite(device.reference_temp_c)  # otherwise the ratios most favourable to the device
    node = int((np.abs(nodes - device.reference_temp_c) if known else np.abs(change).max(axis=1)).argmin())
    deviation, reference_c = change[node], device.reference_temp_c if known else nodes[node]
    allowed = SCALE_PER_C * np.abs(soaks.temp_c - reference_c).min()
    if device.gyro.method == "nominal":
        return
    limit_percent = 100.0 * SCALE_OFF[0]
    sizes = ", ".join(told_apart(100.0 * size, ".3g", limit_percent) for size in deviation)
    sentence = (
        f"Scale factors from the turns differ from the calibration by {sizes} % on x, y, z (limit {limit_percent:g} %)."
    )
    excess, action = float(np.abs(deviation).max() - allowed), "Check turn_rate_dps, the range setting and the device."
    yield from above("drift.scale_differs", excess, SCALE_OFF, sentence, action)


def check_offsets(static: StaticFit, device: Calibration, gravity_rate: FloatArray | float = 0.0) -> Iterator[Finding]:
    """Compare the offset table with the calibration's constants. Gravity adds ``gravity_rate`` (3,) to readings at rest."""
    model, triad, offset = device.gyro, static.gyro, static.table.gyro_offset
    if model is None or model.method == "nominal" or triad is None or offset is None:
        return
    nodes, reference_c = static.table.temp_c, device.reference_temp_c
    nodes_in_span = np.flatnonzero((nodes >= triad.span_c[0] - 1.0) & (nodes <= triad.span_c[1] + 1.0))
    distance = np.abs(nodes[nodes_in_span] - reference_c)
    if not np.isfinite(reference_c):  # the node most favourable to the device
        distance = np.abs(offset - model.offset)[nodes_in_span].max(axis=1)
    node = int(nodes_in_span[distance.argmin()])
    away_c = float(distance.min()) if np.isfinite(reference_c) else 0.0
    deviation = (offset[node] - model.offset) * _dps(model)
    uncertainty = np.hypot(triad.uncertainty[node], model.standard_uncertainty[9:12]) * _dps(model)
    excess = np.abs(deviation) - np.abs(triad.slope) * _dps(model) * (2.0 * away_c + TEMPERATURE_OFF_C)
    if not ((excess > TURN_ON_DPS) & (np.abs(deviation) > SIGNIFICANT * uncertainty)).any():
        return
    is_large = ((excess > FAR_DPS) & (np.abs(deviation) > CERTAIN * uncertainty)).any()
    sizes = ", ".join(told_apart(size, "+.3g", TURN_ON_DPS) for size in deviation)
    sigmas = ", ".join(f"{sigma:.2g}" for sigma in uncertainty)
    cause = _guess_unit(offset[node] + gravity_rate, model.offset + gravity_rate)
    yield finding(
        "drift.offset_differs",
        "fail" if is_large else "warn",
        f"The offset at {nodes[node]:.1f} degC differs from the calibration by {sizes} deg/s on x, y, z (+- {sigmas}), "
        f"more than the {TURN_ON_DPS:g} deg/s that a switch-on can cause{cause}.",
        "Check which device was recorded, or calibrate again.",
        offset_dps=deviation,
    )


def check_gravity(rests: RestBlocks, device: Calibration) -> Iterator[Finding]:
    """Compare the length of the corrected specific force at rest with gravity, rms over the poses."""
    model, rests = device.accel, rests.taken(np.isfinite(rests.accel).all(axis=1))
    force = specific_force(rests, device)
    if model is None or model.method == "nominal" or force is None or not len(rests):
        return
    away_c = np.abs(rests.temp_c - device.reference_temp_c)
    away_c = away_c if np.isfinite(away_c).all() else np.full(len(rests), UNKNOWN_DEPARTURE_C)
    near_reference = away_c <= away_c.min() + NEAR_C
    poses = split_by(np.flatnonzero(near_reference), rests.session[near_reference], rests.pose[near_reference])
    length = np.linalg.norm([force[rows].mean(axis=0) for rows in poses], axis=1)
    local_gravity = device.gravity_m_s2  # parameters of other programs do not contain an uncertainty
    gravity = local_gravity if np.isfinite(local_gravity) else STANDARD_GRAVITY
    miss_mg = 1e3 * float(np.sqrt(np.mean((length / gravity - 1.0) ** 2)))
    matrix, offset = model.standard_uncertainty[:9].reshape(3, 3), model.standard_uncertainty[9:12]
    sigma_terms = np.nan_to_num(
        np.hypot(matrix @ model.forward_matrix * gravity, np.diag(offset * model.si_per_reading("accel")))
    )
    drift_mg = TemperatureSensitivity().accel_offset_mg_per_k * float(away_c[near_reference].mean())
    usual_mg = float(np.sqrt(1e6 * np.sum(sigma_terms**2) / gravity**2 + LEFT_ACCEL_MG**2 + drift_mg**2))
    temp_c = rests.temp_c[near_reference].mean()
    yield from above(
        "drift.accel_differs",
        miss_mg,
        (SIGNIFICANT * usual_mg, CERTAIN * usual_mg),
        f"With the calibration, {len(poses)} poses near {temp_c:.1f} degC miss gravity by {miss_mg:.0f} mg rms "
        f"(usual: {usual_mg:.0f} mg).",
        "Check the calibration file, the unit, the range setting and the device.",
    )


def _guess_unit(reading: FloatArray, constant: FloatArray) -> str:
    """Return the unit error that explains the ratio of two offsets (3,) in the same direction."""
    ratio = float(reading @ constant) / max(float(constant @ constant), 1e-300)
    same_direction = np.linalg.norm(reading - ratio * constant) <= 0.2 * np.linalg.norm(reading)
    for factor, text in ((1.0 / RADIAN_PER_DEGREE, "deg/s, not rad/s"), (RADIAN_PER_DEGREE, "rad/s, not deg/s")):
        if same_direction and abs(ratio / factor - 1.0) < 0.2:
            return f". It is {ratio:.3g} times the offset of the calibration on every axis: gyroscope is in {text}"
    return ""


# ---- benefit of the tables


def check_lag(lag: LagFit | None) -> Iterator[Finding]:
    """Yield a finding if the lag was estimated but is not observable."""
    if lag is not None and not np.isfinite(lag.uncertainty_s):
        action = "Record ramps up and down at two speeds, for example 0.5 and 3 degC/min."
        yield not_observable("info", "Thermometer lag", "it cannot be separated from hysteresis.", action)


def check_rests(sessions: Sequence[Session], rests: RestBlocks, steps: RateSteps) -> Iterator[Finding]:
    """Yield a finding about recordings that do not contribute to the fit because they contain no rest."""
    used = {*rests.session.tolist(), *steps.session.tolist()}
    names = [s.inputs[0][0] if s.inputs else f"session {k + 1}" for k, s in enumerate(sessions) if k not in used]
    if names:
        sentence = f"{len(names)} recordings have no rest and were left out: {', '.join(names[:5])}."
        yield finding("drift.left_out", "warn", sentence, "Let the device rest for ten seconds in each.")


def check_temperatures(
    static: StaticFit, device: Calibration, temperatures: Sequence[Temperature]
) -> Iterator[Finding]:
    """Yield findings about the temperatures, their span, and bends of the offsets over them."""
    yield from (item for temperature in temperatures for item in temperature.findings)
    if all(temperature.source == "set-points" for temperature in temperatures):
        yield finding(
            "drift.set_points_only",
            "warn",
            "No recording has a temperature column, so the tables use the set-points. A device's thermometer reads differently.",
            "Map the temperature column, also in recordings to correct.",
        )
    triad = static.gyro
    if triad is None:
        return
    (low_c, high_c), share = triad.span_c, float(triad.extrapolated.mean())
    if share > MOST_EXTRAPOLATED or high_c - low_c < NARROW_C:
        sentence = f"The temperatures cover {low_c:.1f} to {high_c:.1f} degC only, and {100.0 * share:.0f} % of the nodes have "
        sentence += "no data near them."
        action = "Record over the temperatures at which the device is used, 20 K or more."
        yield finding("drift.narrow_span", "warn", sentence, action)
    yield from _check_bends(triad, device.gyro)


def _check_bends(triad: TriadDrift, model: TriadModel | None) -> Iterator[Finding]:
    """Yield a finding if a set-point is farther off the line between its neighbours than is plausible for a sound device.

    Set-points t of a session with mean offset y, with the second divided difference::

        bend = 2 (dy_2 / dt_2 - dy_1 / dt_1) / (dt_1 + dt_2)        miss = bend dt_1 dt_2 / 2
    """
    blocks, worst = triad.offsets.blocks, (0.0, 0.0, 0.0)
    if model is None:
        return
    for rows in split_by(np.arange(len(blocks)), blocks.session):
        rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
        parts = np.split(rows, np.flatnonzero(np.diff(blocks.temp_c[rows]) > APART_C) + 1)
        if len(parts) < 4 or max(float(np.ptp(blocks.temp_c[group])) for group in parts) > WIDE_C:  # few, or a sweep
            continue
        points = np.array([blocks.temp_c[group].mean() for group in parts])
        means = np.array([triad.offsets.value[group].mean(axis=0) for group in parts]) * _dps(model)
        steps = np.diff(points)[:, None]
        bend = 2.0 * np.diff(np.diff(means, axis=0) / steps, axis=0) / (steps[1:] + steps[:-1])
        miss = np.where(np.abs(bend) > MOST_BEND, np.abs(bend) * steps[1:] * steps[:-1] / 2.0, 0.0).max(axis=1)
        k = int(miss.argmax())
        worst = max(worst, (float(miss[k]), float(points[k + 1]), float(np.abs(bend[k]).max())))
    miss_dps, temp_c, largest_bend = worst
    if miss_dps >= LEAST_MISS_DPS:
        yield finding(
            "drift.bends",
            "warn",
            f"The offset at {temp_c:.1f} degC is {miss_dps:.2g} deg/s off the line between its neighbours: it bends by "
            f"{told_apart(largest_bend, '.2g', MOST_BEND)} (deg/s)/K2 (limit {MOST_BEND:g}).",
            "Check for two devices, set-points in the wrong order or a slow turn, and record this soak again.",
        )
