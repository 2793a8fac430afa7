"""Initial tilt from the averaged accelerometer, and how well it is known.

At rest the specific force f in b points up. The tilt is the shortest rotation that takes f to n's z::

    q_nb ~ (1 + f_z, f_y, -f_x, 0) for f of length one, then a turn about n's z to the wanted heading

Its quaternion has no z part, so heading = 2 atan2(z, w) is zero before that turn. To first order the tilt errs by the part of
the error of f that is level, over |f|. That error has the scatter of the mean (with the correlation between samples: a mean of
n samples is worth n / (1 + 2 sum of autocorrelations)) and what the calibration leaves uncertain.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.calibration.model import AXES, TriadModel
from undrift.errors import InputError
from undrift.frames import quaternion_product
from undrift.record import Record
from undrift.session import Still
from undrift.units import STANDARD_GRAVITY, si_factor

GRAVITY_WITHIN = 0.2  # of standard gravity: beyond it the readings are no specific force at rest in m/s2
FEWEST = 10  # samples: below it their scatter says nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tilt:
    """Orientation at rest.

    Parameters
    ----------
    q_nb : array, shape (4,)
        b to n, w-x-y-z.
    specific_force : array, shape (3,)
        Mean over the still phase, m/s2, frame b.
    covariance : array, shape (3, 3)
        Of that mean, (m/s2)^2: its scatter and the calibration's uncertainty.
    inclination_uncertainty : float
        Standard uncertainty of the direction of gravity, both level axes together, rad.
    scatter_uncertainty : float
        The share of it that comes from the scatter of the samples, rad.
    """

    q_nb: FloatArray
    specific_force: FloatArray
    covariance: FloatArray
    inclination_uncertainty: float
    scatter_uncertainty: float

    def __post_init__(self) -> None:
        for name, shape in (("q_nb", (4,)), ("specific_force", (3,)), ("covariance", (3, 3))):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Tilt.{name}"))


def initial_tilt(record: Record, still: Still, *, heading: float = 0.0, accel_model: TriadModel | None = None) -> Tilt:
    """Find the orientation of a device at rest.

    Parameters
    ----------
    record : Record
        In m/s2, corrected or not.
    still : Still
        Where the device stood still.
    heading : float
        Wanted heading, rad: an accelerometer does not see it.
    accel_model : TriadModel, optional
        The accelerometer's model, whose covariance then counts in the uncertainty.

    Returns
    -------
    Tilt
        Orientation and uncertainty.

    Raises
    ------
    InputError
        No accelerometer, gaps, too few samples, or a mean that is not near gravity.
    """
    force = _readings_at_rest(record, still)
    mean = force.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if abs(length / STANDARD_GRAVITY - 1.0) > GRAVITY_WITHIN:
        raise InputError(
            f"tilt: wanted a mean specific force within {GRAVITY_WITHIN:.0%} of gravity, got {length:.3g} m/s2; "
            "check the unit of the accelerometer and that the device stood still",
            length=length,
        )
    scatter = np.diag([mean_variance(axis) for axis in force.T])
    covariance = scatter if accel_model is None else scatter + _model_covariance(accel_model, mean)
    half = 0.5 * heading
    turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    return Tilt(
        q_nb=quaternion_product(turn, shortest_rotation_up(mean)),
        specific_force=mean,
        covariance=covariance,
        inclination_uncertainty=_direction_uncertainty(mean, covariance),
        scatter_uncertainty=_direction_uncertainty(mean, scatter),
    )


def shortest_rotation_up(force: FloatArray) -> FloatArray:
    """Return the shortest rotation that takes a vector to n's z.

    Parameters
    ----------
    force : array, shape (3,)
        Any length but zero, frame b.

    Returns
    -------
    array, shape (4,)
        q_nb, w-x-y-z, with z part zero; half a turn about x where the vector points straight down.
    """
    x, y, z = force / np.linalg.norm(force)
    level = math.hypot(x, y)
    if z > -0.5:
        q = np.array([1.0 + z, y, -x, 0.0])
    elif (
        level > 0.0
    ):  # near half a turn 1 + z cancels: multiply by (1 - z) / level, which leaves the direction as it is
        q = np.array([level, y / level * (1.0 - z), -x / level * (1.0 - z), 0.0])
    else:
        q = np.array([0.0, 1.0, 0.0, 0.0])
    unit: FloatArray = q / np.linalg.norm(q)
    return unit


def mean_variance(x: FloatArray) -> float:
    """Estimate the variance of the mean of correlated samples.

    The autocovariances c_k are summed up to the first negative pair c_(2k) + c_(2k+1), which for a reversible process is
    noise [1]_: var = (c_0 + 2 sum c_k) / n.

    Parameters
    ----------
    x : array, shape (N,)
        Samples in order of time, even steps, any unit.

    Returns
    -------
    float
        Unit squared.

    References
    ----------
    .. [1] C. J. Geyer, "Practical Markov chain Monte Carlo", Statistical Science 7 (1992), section 3.3.
    """
    n = len(x)
    spectrum = np.fft.rfft(x - x.mean(), 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n] / n
    pairs = covariance[: n - n % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    kept = pairs[: negative[0]] if negative.size else pairs
    total = 2.0 * float(kept.sum()) - float(covariance[0])
    return max(total, float(covariance[0])) / (n - 1)


def _readings_at_rest(record: Record, still: Still) -> FloatArray:
    if record.accel is None:
        raise InputError("tilt: wanted accelerometer readings, got none; map the columns that hold them")
    force = record.accel[still.start : still.stop] * si_factor(record.accel_unit, "accel")
    if len(force) < FEWEST:
        raise InputError(f"tilt: wanted {FEWEST} samples at rest or more, got {len(force)}; give a longer still phase")
    if np.isnan(force).any():
        raise InputError("tilt: wanted readings without gaps, got NaN in the still phase; choose another one")
    return force


def _direction_uncertainty(mean: FloatArray, covariance: FloatArray) -> float:
    up = mean / np.linalg.norm(mean)
    level = np.eye(3) - np.outer(up, up)
    return float(np.sqrt(np.trace(level @ covariance @ level)) / np.linalg.norm(mean))


def _model_covariance(model: TriadModel, force: FloatArray) -> FloatArray:
    """Covariance of the corrected mean that comes from the model: f = M (s - o), df = dM (s - o) - M do."""
    matrix = model.matrix * si_factor(model.unit_out, "accel")
    centred = np.linalg.solve(matrix, force)
    factor = si_factor(model.unit_out, "accel")
    jacobian = np.zeros((3, len(model.parameters)))
    for column, name in enumerate(model.parameters):
        kind, _, axes = name.partition("_")
        if kind == "m":
            jacobian[AXES.index(axes[0]), column] = factor * centred[AXES.index(axes[1])]
        elif kind == "offset":
            jacobian[:, column] = -matrix[:, AXES.index(axes)]
    covariance: FloatArray = jacobian @ model.covariance @ jacobian.T
    return covariance
