"""Weighted least squares of the forward model s = K a + b, shared by the fits whose inputs are known.

Each sensor is a row of its own, with the standard deviation of every equation given::

    minimise  sum_p ((s_pi - K_i . a_p - b_i) / sigma_pi)^2          i = x, y, z

Where sigma is not known beforehand it is estimated from the residuals, and the covariance is widened by v / (v - 2), v the
spare equations: the variance of Student's t, so that 95 % intervals of 1.96 standard uncertainties still hold (JCGM 101,
6.4.9).
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.result import TriadFit, inverse_jacobian, scaled_condition
from undrift.calibration.model import MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.errors import InputError, NotObservable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForwardFit:
    """Forward model of a triad by least squares.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        K, reading per input.
    offset : array, shape (3,)
        b, reading.
    covariance : array, shape (12, 12)
        Of K row by row, then b.
    residuals : array, shape (E, 3)
        Reading less model.
    rank, condition : int, float
        Of the design with columns scaled to one.
    """

    matrix: FloatArray
    offset: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    rank: int
    condition: float


def fit_forward(inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> ForwardFit:
    """Fit K and b to readings of known inputs.

    Parameters
    ----------
    inputs : array, shape (E, 3)
        True input of each equation, frame b.
    readings : array, shape (E, 3)
        Mean readings.
    sigma : array, shape (E, 3), or None
        Standard deviation of each reading; None to estimate one for each axis from the residuals.

    Returns
    -------
    ForwardFit
        Parameters with covariance.

    Raises
    ------
    InputError
        Shapes that disagree.
    NotObservable
        The inputs do not span three axes and an offset.
    """
    if inputs.shape != readings.shape or inputs.ndim != 2 or inputs.shape[1] != 3:
        raise InputError(f"fit: wanted inputs and readings (E, 3), got {inputs.shape} and {readings.shape}")
    design = np.column_stack((inputs, np.ones(len(inputs))))
    rank, condition = scaled_condition(design)
    if rank < 4:
        raise NotObservable(
            f"fit: wanted inputs that span three axes and an offset (rank 4), got rank {rank} from {len(inputs)} equations; "
            "record the axes or signs that are missing",
            rank=rank,
        )
    spread = np.ones_like(readings) if sigma is None else np.broadcast_to(sigma, readings.shape)
    spread = np.maximum(spread, 1e-9 * np.abs(readings).max())  # a channel without any scatter still has a last digit
    theta = np.empty((3, 4))
    covariance = np.zeros((12, 12))
    for row in range(3):
        weighted = design / spread[:, row, None]
        theta[row] = np.linalg.lstsq(weighted, readings[:, row] / spread[:, row], rcond=None)[0]
        covariance[np.ix_(_places(row), _places(row))] = np.linalg.inv(weighted.T @ weighted)
    residuals = readings - design @ theta.T
    if sigma is None:
        scale = np.repeat([student_variance(residuals[:, row], len(inputs) - 4) for row in range(3)], 4)
        order = np.concatenate([_places(row) for row in range(3)])
        covariance[np.ix_(order, order)] *= scale[:, None]
    return ForwardFit(
        matrix=theta[:, :3],
        offset=theta[:, 3],
        covariance=covariance,
        residuals=residuals,
        rank=3 * rank,
        condition=condition,
    )


def student_variance(residuals: FloatArray, spare: int) -> float:
    """Return the residual variance widened for its own uncertainty.

    Parameters
    ----------
    residuals : array
        Residuals of a fit, standardised or not.
    spare : int
        Equations less parameters.

    Returns
    -------
    float
        Sum of squares / (spare - 2) where spare > 2; NaN where the spare equations are too few to tell.
    """
    return float((residuals**2).sum() / (spare - 2)) if spare > 2 else float("nan")


def triad_from_forward(
    forward: ForwardFit, *, method: str, unit_in: str, unit_out: str, valid_range: tuple[float, float], verdict: Verdict
) -> TriadFit:
    """Turn a forward fit into the inverse model that corrects readings.

    Parameters
    ----------
    forward : ForwardFit
        K, b and their covariance.
    method : str
        Name of the procedure and mode.
    unit_in, unit_out : str
        Unit of the readings and of the inputs.
    valid_range : tuple of float
        Least and greatest input on an axis, unit_out.
    verdict : Verdict
        In words.

    Returns
    -------
    TriadFit
        With residuals in unit_out.
    """
    matrix = np.linalg.inv(forward.matrix)
    jacobian = np.eye(12)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    residuals = forward.residuals @ matrix.T
    model = TriadModel(
        method=method,
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=matrix,
        offset=forward.offset,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        covariance=jacobian @ forward.covariance @ jacobian.T,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=forward.rank,
        condition=forward.condition,
        valid_range=valid_range,
    )
    return TriadFit(model=model, residuals=residuals, verdict=verdict)


def fit_paper(
    inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None, *, method: str, unit_in: str, unit_out: str
) -> TriadFit:
    """Fit the note's calibration matrix, which has no offset column.

    C = L S^T (S S^T)^-1 with L (3, N) the imposed and S (3, N) the measured quantities [1]_, eqs. 3 and 6. To first order in
    the noise of S its covariance is (C V C^T) (x) (S S^T)^-1, V the variance of one reading.

    Parameters
    ----------
    inputs : array, shape (N, 3)
        L transposed, frame b.
    readings : array, shape (N, 3)
        S transposed, offset already removed.
    sigma : array, shape (N, 3), or None
        Standard deviation of each reading; None to estimate it from the residuals.
    method : str
        Name of the procedure and mode.
    unit_in, unit_out : str
        Unit of the readings and of the inputs.

    Returns
    -------
    TriadFit
        Offset zero, with zero variance: it was not fitted.

    Raises
    ------
    NotObservable
        The readings do not span three axes.

    References
    ----------
    .. [1] D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with rate-gyroscopes
       and accelerometers", 2007.
    """
    rank, condition = scaled_condition(readings)
    if rank < 3:
        raise NotObservable(
            f"fit: wanted readings that span three axes, got rank {rank} from {len(readings)} columns; record the missing axes",
            rank=rank,
        )
    gram = np.linalg.inv(readings.T @ readings)
    matrix = inputs.T @ readings @ gram  # eq. 3, eq. 6
    residuals = readings @ matrix.T - inputs
    if sigma is None:
        noise = np.eye(3) * student_variance(residuals, residuals.size - 9)
    else:
        noise = matrix @ np.diag((np.broadcast_to(sigma, readings.shape) ** 2).mean(axis=0)) @ matrix.T
    covariance = np.zeros((12, 12))
    covariance[:9, :9] = np.kron(noise, gram)
    model = TriadModel(
        method=method,
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=matrix,
        offset=np.zeros(3),
        covariance=covariance,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3 * rank,
        condition=condition,
        valid_range=(float(inputs.min()), float(inputs.max())),
    )
    return TriadFit(model=model, residuals=residuals, verdict=Verdict())


def offset_warning(fit: TriadFit, inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> Verdict:
    """Say what an offset that was left in the readings costs a matrix fitted without offset column.

    With an offset b' in units of the measurand, C = (I + k b' b'^T)^-1 K^-1, k = N / sigma and sigma the sum of squared inputs on
    one axis: the gain along b' shrinks by k b'^2 / (1 + k b'^2).

    Parameters
    ----------
    fit : TriadFit
        Result of ``fit_paper``.
    inputs, readings : array, shape (N, 3)
        What it was fitted to.
    sigma : array, shape (N, 3), or None
        Standard deviation of the readings.

    Returns
    -------
    Verdict
        marginal with the loss in per cent when the offset is there (over 4 standard uncertainties), else good.
    """
    forward = fit_forward(inputs, readings, sigma)
    left = np.linalg.solve(forward.matrix, forward.offset)
    uncertain = np.sqrt(np.diag(forward.covariance)[9:])
    if not (np.abs(forward.offset) > 4.0 * np.nan_to_num(uncertain)).any():
        return Verdict()
    k = len(inputs) / float((inputs**2).sum(axis=0).mean())
    share = k * float(left @ left)
    loss = share / (1.0 + share)
    unit = fit.model.unit_out
    values = ", ".join(f"{v:.4g}" for v in left)
    return Verdict(
        status="bad" if loss > 0.01 else "marginal" if loss > 1e-4 else "good",
        reasons=(
            f"mode paper has no offset column and an offset of ({values}) {unit} is left in the readings: the gain along it is "
            f"{100 * loss:.2g} % too small; remove the offset first, or use mode affine",
        ),
    )


def _places(row: int) -> IntArray:
    return np.array([3 * row, 3 * row + 1, 3 * row + 2, 9 + row], dtype=np.int64)
