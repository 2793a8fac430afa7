"""Parameters of a twin: what each is, how well it is known, and why it is not where it is not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import AXES, G_NAMES, MATRIX_NAMES, TriadModel

SIGNIFICANT = 4.0  # standard errors from zero that set an effect apart from none: nine elements are tried at once


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinParameter:
    """One parameter of the device model.

    Parameters
    ----------
    name : str
        What it is.
    value : float or str
        Best value; NaN where there is none.
    standard_error : float
        Same unit; NaN where it has no meaning.
    unit : str
        "1" for a ratio, "" for a word.
    identifiable : bool
        Whether the recordings tell it.
    reason : str
        Why they do not; "" where they do.
    """

    name: str
    value: float | str
    standard_error: float
    unit: str
    identifiable: bool = True
    reason: str = ""


def known(name: str, value: float, error: float, unit: str) -> TwinParameter:
    """Return a parameter that the recordings tell.

    Parameters
    ----------
    name : str
        What it is.
    value, error : float
        With its standard error.
    unit : str
        Of both.

    Returns
    -------
    TwinParameter
        Identifiable.
    """
    return TwinParameter(name=name, value=float(value), standard_error=float(error), unit=unit)


def unknown(name: str, unit: str, reason: str) -> TwinParameter:
    """Return a parameter that the recordings do not tell.

    Parameters
    ----------
    name : str
        What it is.
    unit : str
        Its unit.
    reason : str
        Why, and what would tell it.

    Returns
    -------
    TwinParameter
        NaN, not identifiable.
    """
    nothing = float("nan")
    return TwinParameter(name=name, value=nothing, standard_error=nothing, unit=unit, identifiable=False, reason=reason)


def triad_parameters(prefix: str, model: TriadModel, covariance: FloatArray, unit: str) -> list[TwinParameter]:
    """Return rotation, matrix and offset of a fitted triad.

    The rotation is that of the polar decomposition M = R S: the axes of the sensor against those of the optical body.

    Parameters
    ----------
    prefix : str
        "gyro" or "accel".
    model : TriadModel
        Corrected = M (reading - o).
    covariance : array, shape (12 or more, 12 or more)
        Of matrix row by row, then offset.
    unit : str
        Of the offset.

    Returns
    -------
    list of TwinParameter
        Fifteen.
    """
    turn, jacobian = polar_rotation(model.matrix)
    error = np.sqrt(np.einsum("ip,pq,iq->i", jacobian, covariance[:9, :9], jacobian))
    sigma = np.sqrt(np.diag(covariance))
    found = [known(f"{prefix}_rotation_{a}", turn[i], error[i], "rad") for i, a in enumerate(AXES)]
    cells = model.matrix.ravel()
    found += [known(f"{prefix}_matrix_{n[-2:]}", cells[i], sigma[i], "1") for i, n in enumerate(MATRIX_NAMES)]
    found += [known(f"{prefix}_offset_{a}", model.offset[i], sigma[9 + i], unit) for i, a in enumerate(AXES)]
    return found


def polar_rotation(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation vector of the polar part of a matrix, and its change with the matrix.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Right-handed.

    Returns
    -------
    vector : array, shape (3,)
        rad.
    jacobian : array, shape (3, 9)
        By central differences, rad per element, row by row.
    """
    from scipy.spatial.transform import Rotation

    def of(m: FloatArray) -> FloatArray:
        left, _, right = np.linalg.svd(m)
        vector: FloatArray = Rotation.from_matrix(left @ right).as_rotvec()
        return vector

    step = 1e-6
    columns = [(of(matrix + d) - of(matrix - d)) / (2.0 * step) for d in step * np.eye(9).reshape(9, 3, 3)]
    return of(matrix), np.stack(columns, axis=1)


def g_sensitivity_parameters(values: FloatArray, errors: FloatArray) -> list[TwinParameter]:
    """Return the nine elements of the g-sensitivity, those that cannot be told from zero marked so.

    Parameters
    ----------
    values, errors : array, shape (9,)
        rad/s per m/s2, with standard errors.

    Returns
    -------
    list of TwinParameter
        Nine.
    """
    reason = (
        "within four standard errors of zero: gravity alone pushed on the device; shake or swing it harder, or turn it over "
        "on a tumbling table"
    )
    found = []
    for name, value, error in zip(G_NAMES, values, errors, strict=True):
        told = bool(abs(value) > SIGNIFICANT * error)
        found.append(
            TwinParameter(
                name=f"gyro_g_sensitivity_{name[-2:]}",
                value=float(value),
                standard_error=float(error),
                unit="rad/s per m/s2",
                identifiable=told,
                reason="" if told else reason,
            )
        )
    return found


def spread_of(values: FloatArray, prior: float, weight: float = 2.0) -> FloatArray:
    """Return the standard deviation between recordings, held by a prior where there are few.

    s^2 = (sum (x - mean)^2 + k s0^2) / (n - 1 + k): a single recording gives the prior s0.

    Parameters
    ----------
    values : array, shape (R, 3)
        One row for each recording.
    prior : float
        s0, same unit.
    weight : float
        k, as many degrees of freedom as the prior is worth.

    Returns
    -------
    array, shape (3,)
        Same unit.
    """
    square = ((values - values.mean(axis=0)) ** 2).sum(axis=0)
    spread: FloatArray = np.sqrt((square + weight * prior**2) / (len(values) - 1 + weight))
    return spread


def mean_with_error(values: Sequence[float] | FloatArray, errors: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Return the mean of several findings and its standard error, the larger of what they claim and what they scatter.

    Parameters
    ----------
    values, errors : array, shape (R,)
        With their own standard errors.

    Returns
    -------
    tuple of float
        Mean and standard error.
    """
    x, e = np.asarray(values, float), np.asarray(errors, float)
    claimed = float(np.sqrt((e**2).sum())) / len(x)
    scatter = float(x.std(ddof=1) / np.sqrt(len(x))) if len(x) > 1 else 0.0
    return float(x.mean()), max(claimed, scatter)
