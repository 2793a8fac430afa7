"""Unbalanced repeated measures: a mixed model with a random level for each subject.

::

    y_r = m_c(r) + u_s(r) + e_r        u ~ N(0, s_u^2), e ~ N(0, s_e^2)

The ratio g = s_u^2 / s_e^2 is the one that makes the restricted likelihood greatest. For a given g, with n_i values of subject i
and a_i = 1 / sqrt(1 + n_i g), the means m are those of ordinary least squares of ``y - (1 - a_i) mean_i(y)``; this form stays exact
where subjects differ a million times more than they respond. The conditions are tested together by a Wald test of all contrasts,
with n - 1 degrees of freedom in the denominator, which is on the safe side. What is missing is taken as missing by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, IntArray, frozen
from undrift.errors import InputError

LOG_RATIO = np.linspace(-14.0, 34.0, 97)  # of s_u^2 / s_e^2; a ratio of 0 is tried besides


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixedModel:
    """Outcome of a mixed model.

    Parameters
    ----------
    conditions : tuple of str
        In order of first appearance.
    subjects, values : int
        How many subjects, and how many values they gave.
    means, uncertainties : array, shape (k,)
        Estimated mean of each condition and its standard uncertainty, unit of the data.
    covariance : array, shape (k, k)
        Of the means, that unit squared.
    f : float
        Wald F of all differences together.
    dof : tuple of float
        k - 1 and n - 1.
    p_value : float
        Of that F.
    partial_eta_squared : float
        Share of the conditions in what is left without the subjects' own levels, from F and the residual's degrees of freedom; that
        of the analysis of variance where nothing is missing.
    subject_sd, residual_sd : float
        s_u and s_e, unit of the data.
    """

    conditions: tuple[str, ...]
    subjects: int
    values: int
    means: FloatArray
    uncertainties: FloatArray
    covariance: FloatArray
    f: float
    dof: tuple[float, float]
    p_value: float
    partial_eta_squared: float
    subject_sd: float
    residual_sd: float


def compare_unbalanced(y: ArrayLike, subject: Sequence[str], condition: Sequence[str]) -> MixedModel:
    """Compare conditions that not every subject met, or met as often.

    Parameters
    ----------
    y : array_like, shape (r,)
        One value a row; any unit.
    subject, condition : sequence of str, length r
        Whose it is, and under which condition.

    Returns
    -------
    MixedModel
        Means, their uncertainty and the test.

    Raises
    ------
    InputError
        Fewer than two conditions or three subjects, lists of other lengths, or no variance to test against.
    """
    from scipy.stats import f as f_distribution

    values = frozen(y, (None,), "mixed model")
    names, subjects = tuple(dict.fromkeys(condition)), tuple(dict.fromkeys(subject))
    r, k, n = len(values), len(names), len(subjects)
    if not r == len(subject) == len(condition) or k < 2 or n < 3:
        raise InputError(
            f"mixed model: wanted as many subjects and conditions as values, three subjects or more in two conditions or more, got "
            f"{r} values of {n} subjects in {k} conditions"
        )
    whose, which = (
        np.array([known.index(each) for each in told]) for known, told in ((subjects, subject), (names, condition))
    )
    design = np.eye(k)[which]
    residual_dof = r - n - (k - 1)
    if residual_dof < 1 or _within(values, design, whose) <= 1e-24 * float(values.var()) * r:
        raise InputError(
            "mixed model: wanted subjects that differ in how they respond, met more than once each, got none that do; add subjects"
        )
    ratio = _ratio(values, design, whose)
    means, root, error = _means(values, design, whose, ratio)
    scale = error / (r - k)
    covariance = scale * root @ root.T
    contrast = np.hstack((np.ones((k - 1, 1)), -np.eye(k - 1)))
    apart = contrast @ means
    f = float(apart @ np.linalg.solve(contrast @ covariance @ contrast.T, apart)) / (k - 1)
    return MixedModel(
        conditions=names,
        subjects=n,
        values=r,
        means=means,
        uncertainties=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        f=f,
        dof=(float(k - 1), float(n - 1)),
        p_value=float(f_distribution.sf(f, k - 1, n - 1)),
        partial_eta_squared=f * (k - 1) / (f * (k - 1) + residual_dof),
        subject_sd=float(np.sqrt(ratio * scale)),
        residual_sd=float(np.sqrt(scale)),
    )


def _shrunk(values: FloatArray, whose: IntArray, ratio: float) -> FloatArray:
    """Return ``v - (1 - a_i) mean_i(v)`` of each column."""
    count = np.bincount(whose)
    mean = np.stack([np.bincount(whose, column) / count for column in values.T], axis=1)[whose]
    shrunk: FloatArray = (values - mean) + (1.0 / np.sqrt(1.0 + count * ratio))[whose, None] * mean
    return shrunk


def _means(
    values: FloatArray, design: FloatArray, whose: IntArray, ratio: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the means for a ratio, the root of their covariance in units of s_e, and the sum of squares that is left."""
    centre = float(values.mean())  # the level all share is no one's error
    q, root = np.linalg.qr(_shrunk(design, whose, ratio))
    y = _shrunk((values - centre)[:, None], whose, ratio)[:, 0]
    inverse = np.linalg.inv(root)
    means = inverse @ (q.T @ y)
    left = y - q @ (q.T @ y)
    return means + centre, inverse, float(left @ left)


def _within(values: FloatArray, design: FloatArray, whose: IntArray) -> float:
    """Return the sum of squares that is left once each subject has a level of its own."""
    count = np.bincount(whose)
    own = np.eye(len(count))[whose]
    y = values - (np.bincount(whose, values) / count)[whose]
    x = design - (own.T @ design / count[:, None])[whose]
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(left @ left)


def _ratio(values: FloatArray, design: FloatArray, whose: IntArray) -> float:
    """Return s_u^2 / s_e^2 of the greatest restricted likelihood."""
    from scipy.optimize import minimize_scalar

    count = np.bincount(whose)
    dof = len(values) - design.shape[1]

    def unlikely(ratio: float) -> float:
        _, inverse, error = _means(values, design, whose, ratio)
        spread = float(np.log(np.abs(np.diag(inverse))).sum())  # of the inverse root: minus half a log determinant
        return float(dof * np.log(error) + np.log1p(count * ratio).sum() - 2.0 * spread)

    tried = [unlikely(float(np.exp(x))) for x in LOG_RATIO]
    least = int(np.argmin(tried))
    low, high = LOG_RATIO[max(least - 1, 0)], LOG_RATIO[min(least + 1, len(LOG_RATIO) - 1)]
    found = minimize_scalar(
        lambda x: unlikely(float(np.exp(x))), bounds=(low, high), method="bounded", options={"xatol": 1e-9}
    )
    ratio = float(np.exp(found.x))
    return 0.0 if unlikely(0.0) <= unlikely(ratio) else ratio
