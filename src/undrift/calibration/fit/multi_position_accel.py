"""Accelerometer from free poses: at rest the reading has the length of gravity, whichever way the device lies.

::

    |M (u_k - o)| = g        k = 1 .. K still poses, u_k mean raw reading, M upper triangular

A common rotation of all readings does not change their length, so three of the twelve parameters are a choice of axes: M is
upper triangular, that is, the sensor's z axis is the case's z axis and its y axis lies in the case's y-z plane. Written as
scale and misalignment [1]_, M = T D with T unit upper triangular and D diagonal: D_j = M_jj, T_ij = M_ij / M_jj.

The equations are solved in :mod:`undrift.calibration.fit.norm`; here the answer is judged and put in the sensor's units.

References
----------
.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU calibration without external
   equipments", ICRA 2014, eqs. 2-4 and 8-10.
"""

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.calibration.fit.norm import NAMES, WEAKEST, NormFit, fit_norm
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.fit.words import in_words
from undrift.calibration.model import AXES, Status, TriadModel, Verdict
from undrift.calibration.plausibility import check_gravity, check_scale_factor
from undrift.errors import InputError, NotObservable
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

SEEN = np.array([0, 1, 2, 4, 5, 8, 9, 10, 11])  # of m_xx .. m_zz, offset_x ..: those that the length of gravity shows
TOLERANCE = 0.25  # of the sensitivity that the unit states; raw parts are within 0.2
MG = STANDARD_GRAVITY * 1e-3
HELD_AT_ZERO = "cross-axis terms were held at zero: the poses were not asked to show them"


def fit_poses(
    means: ArrayLike,
    *,
    gravity: float,
    standard_errors: ArrayLike | None = None,
    unit_in: str = "count",
    cross_axis: bool = True,
) -> TriadFit:
    """Fit an accelerometer to its mean readings in still poses of any direction.

    Model |M (u - o)| = g, M upper triangular, weighted by the variance of each pose's length: module docstring.

    Parameters
    ----------
    means : array_like, shape (K, 3)
        Mean reading of each pose, ``unit_in``, frame s.
    gravity : float
        Local gravity, m/s2.
    standard_errors : array_like, shape (K, 3), optional
        Standard error of each mean, ``unit_in``. Without them all poses weigh the same and the residuals alone tell the
        noise, which needs one pose more than there are parameters.
    unit_in : str
        Unit of the readings: m/s2, g, mg, count or v.
    cross_axis : bool
        False holds the three off-diagonal elements at zero and fits scale and offset alone, six parameters: for poses
        that lie on the faces and leave the cross-axis terms unseen.

    Returns
    -------
    TriadFit
        Maps ``unit_in`` in s to m/s2 in b; residuals (K,) are length less gravity, m/s2.

    Raises
    ------
    InputError
        Gaps, or standard errors that are negative or of another shape.
    NotObservable
        Too few poses, or poses that leave a parameter unseen.
    Implausible
        The readings are in a physical unit and are not of the size of gravity.
    PoorFit
        No solution was found.
    """
    reading = frozen(means, (None, 3), "means")
    error = None if standard_errors is None else frozen(standard_errors, (len(reading), 3), "standard_errors")
    if np.isnan(reading).any() or (error is not None and (np.isnan(error).any() or (error < 0.0).any())):
        raise InputError(
            "poses: wanted means and standard errors without gaps, got NaN or negatives; leave those poses out"
        )
    check_count(reading, 9 if cross_axis else 6, known_noise=error is not None)
    fit = fit_norm(reading, gravity=gravity, variances=None if error is None else error**2, cross_axis=cross_axis)
    return judged(fit, reading, unit_in)


def check_count(reading: FloatArray, parameters: int, *, known_noise: bool) -> None:
    """Raise unless there are poses enough.

    Parameters
    ----------
    reading : array, shape (K, 3)
        Mean reading of each pose.
    parameters : int
        9, or 6 without cross-axis terms.
    known_noise : bool
        Whether the standard errors are known; else one pose more is needed to tell the noise.

    Raises
    ------
    NotObservable
        Fewer poses, or all the same.
    """
    wanted = parameters + (not known_noise)
    names = in_words(NAMES if parameters == 9 else [NAMES[i] for i in (0, 3, 5, 6, 7, 8)])
    different = len(np.unique(reading, axis=0))
    if different < wanted:
        raise NotObservable(
            f"multi-position: wanted {wanted} still poses or more for {names}, got {different}; record more poses, "
            "each with another side, edge or corner up, and hold each still for two seconds",
            poses=different,
            wanted=wanted,
        )


def judged(fit: NormFit, reading: FloatArray, unit_in: str) -> TriadFit:
    """Return a solution as a fit with verdict, or refuse it where the poses leave a parameter unseen.

    Parameters
    ----------
    fit : NormFit
        Solution.
    reading : array, shape (K, 3)
        What it was fitted to, ``unit_in``.
    unit_in : str
        Unit of the readings.

    Returns
    -------
    TriadFit
        The model with its covariance in ``unit_in`` and m/s2.

    Raises
    ------
    NotObservable
        Names the parameters, and the poses that would show them.
    Implausible
        The readings are in a physical unit and are not of the size of gravity.
    """
    unit = canonical_unit(unit_in, "accel")
    if is_physical(unit):
        check_gravity(reading * si_factor(unit, "accel"), fit.gravity)
    corrected = fit.corrected(reading)
    if fit.weakest < WEAKEST:
        raise NotObservable(
            f"multi-position: wanted poses that change the length by {WEAKEST:g} g or more per unit of every parameter, got "
            f"{fit.weakest:.2g} for {in_words(fit.unseen)}; {_advice(corrected, fit.unseen)}",
            weakest=fit.weakest,
            parameters=fit.unseen,
        )
    carry = np.zeros((12, 9))  # d (m_xx .. m_zz, offset) / d p
    carry[SEEN, np.arange(9)] = [fit.scale] * 6 + [1.0 / fit.scale] * 3
    model = TriadModel(
        method="multi-position",
        unit_in=unit,
        unit_out="m/s2",
        matrix=fit.matrix,
        offset=fit.offset,
        covariance=carry @ fit.covariance @ carry.T,
        rms_residual=float(np.sqrt(np.mean(fit.residuals**2))),
        count=len(reading),
        rank=int((np.diag(fit.covariance) > 0.0).sum()),
        condition=fit.condition,
        valid_range=(float(corrected.min()), float(corrected.max())),
    )
    if is_physical(unit):
        check_scale_factor(model.scale_factor * si_factor(unit, "accel"), 1.0, TOLERANCE, "accel")
    return TriadFit(model=model, residuals=fit.residuals, verdict=_verdict(fit))


def _verdict(fit: NormFit) -> Verdict:
    reasons: list[str] = []
    status: Status = "good"
    rms, doubt = float(np.sqrt(np.mean(fit.residuals**2))) / MG, fit.uncertainty / MG
    if rms > 3.0:
        status = "bad" if rms > 20.0 else "marginal"
        reasons.append(
            f"poses miss gravity by {rms:.2g} mg rms (wanted 3): the device moved in some of them, or the sensor is not linear"
        )
    if doubt > 2.0:
        status = "bad" if doubt > 20.0 else "marginal" if status == "good" else status
        reasons.append(
            f"a corrected reading of gravity is uncertain by {doubt:.2g} mg (wanted 2): record more poses, held longer"
        )
    if fit.p[1] == fit.p[2] == fit.p[4] == 0.0:
        reasons.append(HELD_AT_ZERO)
    return Verdict(status=status, reasons=tuple(reasons))


def _advice(corrected: FloatArray, unseen: tuple[str, ...]) -> str:
    n = corrected / np.linalg.norm(corrected, axis=1)[:, None]
    values, vectors = np.linalg.eigh(n.T @ n / len(n))
    if values[0] < 0.02:
        axis = AXES[int(np.abs(vectors[:, 0]).argmax())]
        return f"all poses lie near one plane: add poses with the {axis} axis up and with it down"
    if set(unseen) <= {"m_xy", "m_xz", "m_yz"}:
        return "add poses between the faces (edges and corners up)"
    return "add poses on the sides, edges and corners that are missing"
