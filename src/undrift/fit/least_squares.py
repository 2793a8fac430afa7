"""What the fits share: weighted least squares of s = K a + b, its covariance, excess variance, noise of means.

Each sensor is a row of its own, with the standard deviation of every equation given; i = x, y, z::

    minimise  sum_p ((s_pi - K_i . a_p - b_i) / sigma_pi)^2
    a = M (s - o)        M = K^-1, o = b;   dM = -M dK M,   do = db

Where sigma is not known it is estimated from the residuals, and the covariance is widened by v / (v - 2), v the spare
equations: the variance of Student's t, so that 95 % intervals of 1.96 standard uncertainties still hold (JCGM 101, 6.4.9).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, NotObservable
from undrift.findings import Level, finding
from undrift.fit.equations import Inverse, joined
from undrift.model import TriadModel, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadFit:
    """A fitted triad, its residuals, and what it is worth."""

    model: TriadModel  # The inverse model, with covariance, count, rank, condition and range
    residuals: FloatArray  # (E,), residual of each equation, unit_out
    verdict: Verdict


@contextmanager
def determined(what: str) -> Iterator[None]:
    """Turn equations without a solution into one line: the readings do not determine what was asked for."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NotObservable(
            f"{what}: wanted readings that determine it, got equations without a solution ({error}); record more temperatures, "
            "and check that no axis repeats one reading"
        ) from error


def triad_fit(residuals: FloatArray, verdict: Verdict = Verdict(), **of_model: Any) -> TriadFit:
    """Return a fit by its residuals (E,), unit_out, its verdict, and the fields of its TriadModel that these do not give."""
    rms = float(np.sqrt((residuals**2).mean()))
    return TriadFit(
        model=TriadModel(rms_residual=rms, count=residuals.size, **of_model), residuals=residuals, verdict=verdict
    )


def scaled_condition(design: FloatArray) -> tuple[int, float]:
    """Return rank and condition number of a design (E, P) whose columns were scaled to one."""
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(design / length, compute_uv=False)
    rank = int((singular > singular[0] * max(design.shape) * np.finfo(float).eps * 10.0).sum())
    return rank, float(singular[0] / singular[-1]) if rank == design.shape[1] else float("inf")


# ---- excess variance: what the residuals show beyond the stated noise


def excess_variance(residuals: FloatArray, variances: FloatArray, freedom: float) -> float:
    """Return s2 >= 0 such that sum r_k^2 / (v_k + s2) = degrees of freedom, for residuals r and variances v (E,).

    The stated variances know the noise within a rest. A hand that sways, a table that is not quite still or a nonlinearity
    moves whole poses and shows in the residuals alone (Paule and Mandel, "Consensus values and weighting factors", 1982).
    """
    square = residuals**2
    if freedom <= 0 or not square.any():
        return 0.0
    high = float(square.sum()) / freedom  # there the weighted sum is at most the degrees of freedom
    if (variances > 0.0).all() and float((square / variances).sum()) <= freedom:
        return 0.0
    excess = max(high - float(variances.mean()), 1e-9 * high)
    for _ in range(50):  # Newton's method on 1 / sum, which is nearly linear in s2
        weight = 1.0 / (variances + excess)
        total = float((square * weight).sum())
        step = (total * total / freedom - total) / float((square * weight * weight).sum())
        before, excess = excess, min(max(excess + step, 0.01 * excess), high)
        if abs(excess - before) <= 1e-9 * high:
            break
    return excess


# ---- robust least squares: a residual beyond k standard deviations s counts k s / |r|, s from the median of all
#
# P. J. Huber, "Robust estimation of a location parameter", 1964. To first order the estimate follows the rows within the bound.

HUBER = 1.345  # k: for normal residuals as good as 95 % of the rows by least squares


def huber_weight(size: FloatArray, scale: float) -> FloatArray:
    """Return the weight of residuals of a size (n,) whose robust standard deviation is ``scale``."""
    return np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-15))


def fit_huber(
    design: FloatArray,
    reading: FloatArray,
    *,
    together: int = 1,
    to_sigma: float = 1.4826,
    passes: int = 15,
    prior: int = 0,
) -> tuple[FloatArray, FloatArray, float]:
    """Return parameters (P,), weights (E,) and robust scale; ``together`` neighbouring rows weigh alike, by their rms.

    The last ``prior`` rows are no readings: they keep their weight and say nothing of the scale.
    """
    length = np.linalg.norm(design, axis=0)
    scaled, weight = design / length, np.ones(len(reading))
    x, scale = np.zeros(design.shape[1]), 0.0
    for _ in range(passes):
        previous = x
        x = np.linalg.solve((scaled.T * weight) @ scaled, scaled.T @ (weight * reading))
        size = np.sqrt(((reading - scaled @ x) ** 2).reshape(-1, together).mean(axis=1))
        scale = to_sigma * float(np.median(size[: len(size) - prior]))
        weight = np.repeat(huber_weight(size, scale), together) if scale > 0.0 else weight
        weight[len(weight) - prior :] = 1.0
        if np.abs(x - previous).max() <= 1e-9 * max(float(np.abs(x).max()), 1e-12):
            break
    return x / length, weight, scale


# ---- noise of a mean reading, from the scatter of short block means within the windows

BLOCK_S = 0.5  # means of this length count as independent of each other
_LEAST_SPARE_BLOCKS = 6  # with fewer, the estimate is too uncertain to use


def noise_of_means(windows: Sequence[FloatArray], sizes: Sequence[int], removed: int = 1) -> FloatArray | None:
    """Return the standard deviation (P, 3) of the mean of each window (N, 3); None where there are too few blocks."""
    square, spare = np.zeros(3), 0
    for values, size in zip(windows, sizes, strict=True):
        count = len(values) // size
        if count > removed:
            means = values[: count * size].reshape(count, size, 3).mean(axis=1)
            square += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
            spare += count - removed
    if spare < _LEAST_SPARE_BLOCKS:
        return None
    share = np.array([size / max(1, len(values)) for values, size in zip(windows, sizes, strict=True)])
    return np.asarray(np.sqrt(square / spare * share[:, None]))


def block_size(sample_rate_hz: float) -> int:
    """Return the samples in one block."""
    return max(1, round(BLOCK_S * sample_rate_hz))


# ---- names of parameters: m_xx is the scale of x, m_xy a cross-axis term, offset_y the offset of y


def parameter_names(names: Sequence[str]) -> str:
    """Return names of parameters as a laboratory says them, those of one kind together."""
    ends = [(name.partition("_")[0], name.rpartition("_")[2]) for name in names]
    scales = [end[0] for head, end in ends if head == "m" and end[0] == end[-1]]
    crossed = [end for head, end in ends if head == "m" and end[0] != end[-1]]
    offsets = [end for head, end in ends if head == "offset"]
    kinds = (("scale of", scales), (f"cross-axis term{'s' * (len(crossed) > 1)}", crossed), ("offset of", offsets))
    return ", ".join(
        f"{kind} {' and '.join((', '.join(of[:-1]), of[-1])).removeprefix(' and ')}" for kind, of in kinds if of
    )


# ---- forward model s = K a + b


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForwardFit:
    """Forward model of a triad by least squares."""

    inputs: FloatArray  # (E, 3)
    matrix: FloatArray  # (3, 3), K, reading per input
    offset: FloatArray  # (3,), b, reading
    covariance: FloatArray  # (12, 12), of K row by row, then b
    residuals: FloatArray  # (E, 3), reading less model
    rank: int  # Of the design with columns scaled to one
    condition: float

    @property
    def inverse(self) -> Inverse:
        """The model that corrects readings."""
        return Inverse.of(np.column_stack((self.matrix, self.offset)))


def fit_forward(
    inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None, in_common: FloatArray | None = None
) -> ForwardFit:
    """Fit K and b to readings (E, 3) of known inputs (E, 3) with standard deviations sigma (E, 3), where known.

    ``in_common`` (3, E, E) is the covariance of what moves the readings of one sensor together.
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
    weighed = np.zeros((3, 1, 1)) if in_common is None or sigma is None else in_common
    fits = [_solve(design, readings[:, k], spread[:, k], weighed[k]) for k in range(3)]
    theta, gains = (np.array(part) for part in zip(*fits, strict=True))
    stated = [np.diag(spread[:, k] ** 2) + weighed[k] for k in range(3)]
    covariances = np.array([gain @ part @ gain.T for gain, part in zip(gains, stated, strict=True)])
    residuals = readings - design @ theta.T
    if sigma is None:
        covariances *= np.reshape([student_variance(column, len(inputs) - 4) for column in residuals.T], (3, 1, 1))
        if in_common is not None:
            covariances += [gain @ part @ gain.T for gain, part in zip(gains, in_common, strict=True)]
    return ForwardFit(
        inputs=inputs,
        matrix=theta[:, :3],
        offset=theta[:, 3],
        covariance=joined(covariances),
        residuals=residuals,
        rank=3 * rank,
        condition=condition,
    )


def _solve(
    design: FloatArray, reading: FloatArray, sigma: FloatArray, in_common: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters (P,) of one sensor and their gains (P, E), for noise sigma (E,) and a covariance (E, E) beside it."""
    factor = np.linalg.cholesky(np.diag(sigma**2) + in_common)
    white, length = np.linalg.solve(factor, design), np.linalg.norm(design, axis=0)
    gain = np.linalg.solve(factor.T, np.linalg.pinv(white / length).T).T / length[:, None]
    theta = gain @ reading
    return theta + gain @ (reading - design @ theta), gain


def student_variance(residuals: FloatArray, spare: int) -> float:
    """Return the residual variance, widened for its own uncertainty; NaN below three spare equations."""
    return float((residuals**2).sum() / (spare - 2)) if spare > 2 else float("nan")


def triad_from_forward(forward: ForwardFit, *, valid_range: tuple[float, float], **names: Any) -> TriadFit:
    """Turn a forward fit into the inverse model that corrects readings; names are method, unit_in and unit_out."""
    inverse = forward.inverse
    return triad_fit(
        forward.residuals @ inverse.matrix.T,
        matrix=inverse.matrix,
        offset=forward.offset,
        covariance=inverse.carried(forward.covariance),
        rank=forward.rank,
        condition=forward.condition,
        valid_range=valid_range,
        **names,
    )


def fit_paper(
    inputs: FloatArray,
    readings: FloatArray,
    sigma: FloatArray | None,
    in_common: FloatArray | None = None,
    **names: Any,
) -> TriadFit:
    """Fit the note's calibration matrix, which has no offset column, to inputs and readings (N, 3).

    C = L S^T (S S^T)^-1 with L (3, N) the imposed and S (3, N) the measured quantities (note, eqs. 3 and 6). To first order in
    the noise of S its covariance is (C V C^T) (x) (S S^T)^-1, V the variance of one reading.
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
    if in_common is not None:
        solver = readings @ gram  # dC = -C dS (S^T) (S S^T)^-1, row by row
        for column, errors in zip(matrix.T, in_common, strict=True):
            covariance[:9, :9] += np.kron(np.outer(column, column), solver.T @ errors @ solver)
    return triad_fit(
        residuals,
        matrix=matrix,
        offset=np.zeros(3),
        covariance=covariance,
        rank=3 * rank,
        condition=condition,
        valid_range=(float(inputs.min()), float(inputs.max())),
        **names,
    )


def offset_verdict(fit: TriadFit, inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> Verdict:
    """Return what an offset left in the readings costs a matrix that was fitted without an offset column.

    With an offset b' in units of the measurand, C = (I + k b' b'^T)^-1 K^-1, k = N / sigma and sigma the sum of squared inputs on
    one axis: the gain along b' shrinks by k b'^2 / (1 + k b'^2).
    """
    forward = fit_forward(inputs, readings, sigma)
    uncertain = np.sqrt(np.diag(forward.covariance)[9:])
    if not (np.abs(forward.offset) > 4.0 * np.nan_to_num(uncertain)).any():
        return Verdict()
    left = np.linalg.solve(forward.matrix, forward.offset)
    share = len(inputs) / float((inputs**2).sum(axis=0).mean()) * float(left @ left)
    loss = share / (1.0 + share)
    level: Level = "fail" if loss > 0.01 else "warn" if loss > 1e-4 else "info"
    unit, percent = fit.model.unit_out, 100.0 * loss
    return Verdict.of(finding("paper_mode.offset_left", level, offset=left, unit=unit, loss_percent=percent))
