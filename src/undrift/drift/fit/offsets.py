"""What the blocks of rest say about offset, before temperature is looked at.

::

    gyroscopes       y = u - K (G a + Earth rate)      K = M^-1, a = M_a (u_a - o_a): what specific force feigns is no offset
    accelerometers   y = u, of the one pose that has seen the widest range of temperature

Of the Earth rate only the part along the vertical is known without a heading, 7.29e-5 rad/s * sin(latitude); the rest,
cos(latitude) in an unknown direction, goes into the uncertainty.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import G_NAMES, Calibration, TriadModel
from undrift.calibration.plausibility import check_gravity
from undrift.drift.observe.observations import RestBlocks
from undrift.earth import EARTH_RATE
from undrift.errors import Implausible, InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offsets:
    """Offset readings of one triad.

    Parameters
    ----------
    blocks : RestBlocks
        The n blocks that they are of.
    value, variance : array, shape (n, 3)
        Offset and the variance of its noise, raw unit and its square.
    step_error : array, shape (n, 3), or None
        What the converter's steps leave in each, raw unit.
    common_variance : array, shape (3,)
        Of what all of them have in common, raw unit squared.
    reasons : tuple of str
        What is in them that is no offset, one sentence each.
    """

    blocks: RestBlocks
    value: FloatArray
    variance: FloatArray
    step_error: FloatArray | None
    common_variance: FloatArray
    reasons: tuple[str, ...] = ()


def gyro_offsets(blocks: RestBlocks, calibration: Calibration | None, latitude_deg: float | None) -> Offsets | None:
    """Return the gyroscopes' readings at rest, less what specific force and Earth put into them.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    calibration : Calibration or None
        Matrix, g-sensitivity and accelerometers.
    latitude_deg : float or None
        Where the device lay, deg; None leaves the Earth rate in.

    Returns
    -------
    Offsets or None
        None without gyroscope readings.

    Raises
    ------
    InputError
        Earth rate asked for without a calibration of both triads.
    """
    seen = np.flatnonzero(np.isfinite(blocks.gyro).all(axis=1))
    if not len(seen):
        return None
    blocks = blocks.taken(seen)
    model = None if calibration is None else calibration.gyro
    force = specific_force(blocks, calibration)
    value, common, reasons = np.array(blocks.gyro), np.zeros(3), []
    if latitude_deg is not None and (model is None or force is None):
        raise InputError(
            "Earth rate: wanted a calibration of both triads, got one of fewer; calibrate them, or give no latitude"
        )
    if model is not None and model.g_sensitivity is not None and force is not None:
        value -= force @ (model.forward_matrix @ model.g_sensitivity).T
        common += _of_gravity(model, force.mean(axis=0))
    else:
        reasons.append(
            "gyroscope offsets hold what gravity feigns in the pose recorded: no g-sensitivity is known; calibrate it with turns "
            "by known rates or angles"
        )
    if latitude_deg is not None and model is not None and force is not None:
        up = force / np.linalg.norm(force, axis=1, keepdims=True)
        latitude = latitude_deg * RADIAN_PER_DEGREE
        value -= EARTH_RATE * np.sin(latitude) * up @ model.forward_matrix.T
        common += (EARTH_RATE * np.cos(latitude)) ** 2 / 2.0 * (model.forward_matrix**2).sum(axis=1)
    return Offsets(
        blocks=blocks,
        value=value,
        variance=known_variance(blocks.gyro_variance),
        step_error=blocks.gyro_step_error,
        common_variance=common,
        reasons=tuple(reasons),
    )


def accel_offsets(blocks: RestBlocks, calibration: Calibration | None, accel_unit: str) -> Offsets | str:
    """Return the accelerometers' readings in the pose with the widest range of temperature.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    calibration : Calibration or None
        Its accelerometer model tells gravity; without one a physical unit does.
    accel_unit : str
        Unit of the readings where no calibration states it.

    Returns
    -------
    Offsets or str
        A sentence where there are none, or where their length cannot be gravity.
    """
    seen = np.flatnonzero(np.isfinite(blocks.accel).all(axis=1))
    if not len(seen):
        return "accelerometer offset over temperature: no readings; map the accel columns"
    blocks = blocks.taken(seen)
    poses = np.unique(blocks.pose)
    spans = [float(np.ptp(blocks.temp_c[blocks.pose == pose])) for pose in poses]
    told = _wrong_gravity(blocks, calibration, accel_unit)
    if told:
        return told
    chosen = blocks.taken(np.flatnonzero(blocks.pose == poses[int(np.argmax(spans))]))
    reasons = [
        "accelerometer offset over temperature is of one pose: a change of scale along gravity cannot be told from it"
    ]
    if len(poses) > 1:
        reasons.append(
            f"of {len(poses)} poses the one over {max(spans):.1f} degC served; six faces at several temperatures tell scale and "
            "offset apart"
        )
    return Offsets(
        blocks=chosen,
        value=np.array(chosen.accel),
        variance=known_variance(chosen.accel_variance),
        step_error=chosen.accel_step_error,
        common_variance=np.zeros(3),
        reasons=tuple(reasons),
    )


def _of_gravity(model: TriadModel, force: FloatArray) -> FloatArray:
    """Return the variance that the g-sensitivity's own makes of a mean specific force, shape (3,), raw unit squared."""
    if G_NAMES[0] not in model.parameters:
        return np.zeros(3)
    start = model.parameters.index(G_NAMES[0])
    own = model.covariance[start : start + len(G_NAMES), start : start + len(G_NAMES)].reshape(3, 3, 3, 3)
    k = model.forward_matrix
    return np.asarray(np.einsum("ka,kb,i,j,aibj->k", k, k, force, force, own))


def known_variance(variance: FloatArray) -> FloatArray:
    """Return variances with the usual one where none is known.

    Parameters
    ----------
    variance : array, shape (n, 3)
        Raw unit squared; NaN where it is not known.

    Returns
    -------
    array, shape (n, 3)
        Zero where none is known at all.
    """
    usual = np.nanmean(variance, axis=0) if np.isfinite(variance).any() else np.zeros(3)
    return np.where(np.isfinite(variance), variance, usual)


def specific_force(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray | None:
    """Return the corrected specific force of blocks.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    calibration : Calibration or None
        With accelerometers.

    Returns
    -------
    array, shape (n, 3), or None
        m/s2, frame b; None without accelerometers, in the calibration or in any block.
    """
    model = None if calibration is None else calibration.accel
    if model is None or not np.isfinite(blocks.accel).all():
        return None
    force: FloatArray = (blocks.accel - model.offset) @ model.matrix.T
    return force


def _wrong_gravity(blocks: RestBlocks, calibration: Calibration | None, accel_unit: str) -> str:
    force = specific_force(blocks, calibration)
    if force is None:
        if not is_physical(accel_unit):
            return ""
        force = blocks.accel * si_factor(accel_unit, "accel")
    try:
        check_gravity(force, STANDARD_GRAVITY if calibration is None else calibration.gravity_m_s2)
    except Implausible as error:
        return f"accelerometer offset over temperature is left out: {error}"
    return ""
