"""Several sessions of one device in one table: how much the offset moves from one switch-on to the next.

::

    y = f(T) + d_s + e        d_s the shift of session s, variance tau2

The shifts are told first with no prior, their sum held at zero; tau2 is what makes their weighted scatter equal its expectation
(Paule and Mandel, ``calibration/fit/excess.py``). Then the curve is fitted with tau2 in the covariance of the rows, and each node
gets tau2 k besides: a session to come has a shift of its own. Few sessions know tau2 badly, so k = (t / z)^2 with the 97.5 %
points of Student's distribution for one session less than there are, and of the normal.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.drift.fit.cells import Cells
from undrift.drift.fit.spline import SmoothSettings, fit_smooth
from undrift.errors import NotObservable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions.

    Parameters
    ----------
    sessions : int
        How many there are.
    shift : array, shape (s, 3)
        Of each session against the mean of all, raw unit; zero where they cannot be told from the curve.
    variance : array, shape (3,)
        tau2, raw unit squared.
    variance_to_come : array, shape (3,)
        What a node's variance gets for a session to come, raw unit squared.
    """

    sessions: int
    shift: FloatArray
    variance: FloatArray
    variance_to_come: FloatArray

    def shared(self, session: IntArray) -> FloatArray:
        """Return the covariance that rows of one session have in common.

        Parameters
        ----------
        session : array of int, shape (n,)
            Which session each row is of.

        Returns
        -------
        array, shape (3, n, n)
            Raw unit squared.
        """
        same = session[:, None] == session[None, :]
        shared: FloatArray = self.variance[:, None, None] * same
        return shared


def between_sessions(cells: Cells, regressors: FloatArray, settings: SmoothSettings = SmoothSettings()) -> TurnOn:
    """Tell how much the offset moves between sessions.

    Parameters
    ----------
    cells : Cells
        Of two sessions or more, n rows.
    regressors : array, shape (n, p)
        Other effects.
    settings : SmoothSettings
        Of the curve.

    Returns
    -------
    TurnOn
        Zero variance where the shifts cannot be told from the curve: then the scatter of the cells holds it.
    """
    from scipy.stats import norm, t

    numbers = np.unique(cells.session)
    count = len(numbers)
    shift, variance = np.zeros((count, 3)), np.zeros(3)
    factor = float((t.ppf(0.975, count - 1) / norm.ppf(0.975)) ** 2) if count > 1 else 0.0
    dummies = (cells.session[:, None] == numbers[None, :]).astype(float)
    held = dummies[:, :-1] - dummies[:, -1:]  # their sum is zero: the last one is less all others
    try:
        made = fit_smooth(
            cells.temp_c,
            cells.value,
            cells.variance,
            regressors=np.column_stack((held, regressors)),
            groups=cells.groups,
            correlation=cells.correlation,
            scatter=cells.scatter,
            settings=settings,
        )
    except NotObservable:
        return TurnOn(sessions=count, shift=shift, variance=variance, variance_to_come=variance)
    shift[:-1] = made.coefficient[: count - 1]
    shift[-1] = -shift[:-1].sum(axis=0)
    for axis in range(3):
        own = made.coefficient_uncertainty[: count - 1, axis] ** 2
        own = np.append(own, own.mean())
        variance[axis] = excess_variance(shift[:, axis], own, count - 1)
    return TurnOn(sessions=count, shift=shift, variance=variance, variance_to_come=factor * variance)
