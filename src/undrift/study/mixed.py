"""Unbalanced repeated measures: a mixed model with a random level for each subject.

::

    y_r = m_c(r) + u_s(r) + e_r        u ~ N(0, s_u^2), e ~ N(0, s_e^2)

The conditions are tested together by a Wald test of all contrasts, with n - 1 degrees of freedom in the denominator, which is
on the safe side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixedModel:
    """Outcome of a mixed model.

    Parameters
    ----------
    conditions : tuple of str
        In order of first appearance.
    means, uncertainties : array, shape (k,)
        Estimated mean of each condition and its standard uncertainty, unit of the data.
    f : float
        Wald F of all differences together.
    p_value : float
        Of that F.
    subject_sd, residual_sd : float
        s_u and s_e, unit of the data.
    """

    conditions: tuple[str, ...]
    means: FloatArray
    uncertainties: FloatArray
    f: float
    p_value: float
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
        Fewer than two conditions or three subjects, or lists of other lengths.
    """
    import warnings

    from scipy.stats import f as f_distribution
    from statsmodels.regression.mixed_linear_model import MixedLM
    from statsmodels.tools.sm_exceptions import ConvergenceWarning

    values = frozen(y, (None,), "mixed model")
    names, subjects = tuple(dict.fromkeys(condition)), tuple(dict.fromkeys(subject))
    k, n = len(names), len(subjects)
    if not len(values) == len(subject) == len(condition) or k < 2 or n < 3:
        raise InputError(
            f"mixed model: wanted as many subjects and conditions as values, three subjects or more in two conditions or more, got "
            f"{len(values)} values of {n} subjects in {k} conditions"
        )
    design = np.array([[float(c == name) for name in names] for c in condition])
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", ConvergenceWarning
        )  # a subject variance of zero lies on the boundary and is an answer
        fit = MixedLM(values, design, groups=np.array(subject)).fit(reml=True)
    means, covariance = np.asarray(fit.fe_params), np.asarray(fit.cov_params())[:k, :k]
    contrast = np.hstack((np.ones((k - 1, 1)), -np.eye(k - 1)))
    apart = contrast @ means
    f = float(apart @ np.linalg.solve(contrast @ covariance @ contrast.T, apart)) / (k - 1)
    return MixedModel(
        conditions=names,
        means=means,
        uncertainties=np.sqrt(np.diag(covariance)),
        f=f,
        p_value=float(f_distribution.sf(f, k - 1, n - 1)),
        subject_sd=float(np.sqrt(max(float(np.asarray(fit.cov_re)[0, 0]), 0.0))),
        residual_sd=float(np.sqrt(fit.scale)),
    )
