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
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.axis_order import check_axis_order
from undrift.calibration.model import AXES, MATRIX_NAMES, Calibration, TriadModel, Verdict
from undrift.calibration.plausibility import check_handedness
from undrift.drift.fit.accel import AccelDriftFit
from undrift.drift.fit.scale import SoakMatrices, soak_matrices
from undrift.drift.fit.static import UNKNOWN_SCALE_PER_K, StaticFit, TriadDrift
from undrift.drift.fit.steps import steps_of
from undrift.drift.observe.observations import RateSteps
from undrift.errors import CalibrationError, Implausible
from undrift.units import RADIAN_PER_DEGREE, si_factor

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
    """Hold the turns against the calibration's matrix: axes, signs, scale.

    Parameters
    ----------
    steps : RateSteps
        Dwells at stated rates; may have no rows.
    device : Calibration
        Constant model.
    static : StaticFit
        Offset table.

    Returns
    -------
    Verdict
        Marginal from 2 % of scale at the reference temperature, bad from 5 %.

    Raises
    ------
    Implausible
        Turns about other axes or the other way round than the calibration's.
    """
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
    """Hold the offset table against the calibration's constants.

    Parameters
    ----------
    static : StaticFit
        Offset table and curve.
    device : Calibration
        Constant model; a nominal one knows no offset.

    Returns
    -------
    Verdict
        Beyond what the head of this file grants: marginal from 2 deg/s and three standard uncertainties, bad from 10 deg/s and ten;
        good with a reason where 2 deg/s are exceeded by less than three.
    """
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
            reasons=(
                f"{first}: less than {_TELLING:g} standard uncertainties, so this session is too poor to tell whether it "
                "belongs to the calibration; rest longer, at more temperatures or nearer the calibration's",
            )
        )
    far = (beyond > FAR_DPS) & (np.abs(off) > _SURE * sure)
    reason = (
        f"{first}; a switch-on moves it by {TURN_ON_DPS:g} deg/s at most: another device's session or calibration, or calibrate "
        "anew"
    )
    return Verdict(status="bad" if far.any() else "marginal", reasons=(reason,))


def poses_verdict(accel: AccelDriftFit | None, device: Calibration) -> Verdict:
    """Hold the accelerometers' matrix and offset from poses against the calibration's.

    Parameters
    ----------
    accel : AccelDriftFit or None
        Over temperature; None where poses did not tell.
    device : Calibration
        Constant model; a nominal one knows neither.

    Returns
    -------
    Verdict
        Marginal from 1 % of an element of the matrix or 50 mg of offset, and three standard uncertainties; bad from 5 % or 250 mg.
    """
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
    return Verdict(status="bad" if worst > 1.0 else "marginal", reasons=tuple(reasons))


def check_sessions(static: StaticFit, device: Calibration) -> None:
    """Raise where sessions lie further apart than one device's do.

    Parameters
    ----------
    static : StaticFit
        Of several sessions, or one.
    device : Calibration
        What a reading is worth.

    Raises
    ------
    Implausible
        Over 5 deg/s, standard deviation between sessions.
    """
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
    return Verdict(status="bad" if beyond > _SCALE_OFF[1] else "marginal", reasons=(reason,))


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
