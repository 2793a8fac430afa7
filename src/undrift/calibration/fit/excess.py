"""Excess variance: what the residuals show beyond the noise that was put in.

::

    sum r_k^2 / (v_k + s2) = degrees of freedom,   s2 >= 0

The stated variances v_k know the noise within a still. Hands that sway, a table that is not quite still, a nonlinearity:
these move whole poses and show only in the residuals. s2 is what makes the weighted sum of squares equal its expectation [1]_.

References
----------
.. [1] R. C. Paule and J. Mandel, "Consensus values and weighting factors", J. Res. NBS 87, 1982, 377-385.
"""

from undrift.arrays import FloatArray


def excess_variance(residuals: FloatArray, variances: FloatArray, freedom: int) -> float:
    """Return the common variance to add so that residuals and variances agree.

    Parameters
    ----------
    residuals : array, shape (E,)
        Residuals of a fit, uncorrelated.
    variances : array, shape (E,)
        Variances they should have, square of their unit; zeros where nothing is known.
    freedom : int
        Equations less parameters.

    Returns
    -------
    float
        s2, square of the residuals' unit; 0 where the residuals are no larger than stated, or where none are to spare.
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
