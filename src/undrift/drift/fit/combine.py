"""Several sessions of one device in one table: how much the offset moves from one switch-on to the next.

::

    y = f(T) + d_s + e        d_s the shift of session s, variance tau2

The shifts are told first with no prior, their sum held at zero; tau2 is what makes their weighted scatter equal its expectation
(Paule and Mandel, ``calibration/fit/excess.py``), but no less than the shifts are known to: sessions that agree by chance do not
prove that nothing moves. Shifts are told among sessions that share temperatures, within 1 degC; between others a shift looks like
drift. Then the curve is fitted with tau2 in the covariance of the rows, and each node
gets tau2 k besides: a session to come has a shift of its own. Few sessions know tau2 badly, so k = (t / z)^2 with the 97.5 %
points of Student's distribution for one session less than there are, and of the normal.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.drift.fit.cells import Cells
from undrift.drift.fit.spline import Wander, fit_smooth
from undrift.drift.fit.weigh import SmoothSettings
from undrift.errors import NotObservable

_SHARED_C = 1.0  # cells of two sessions nearer than this are of one temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions.

    Parameters
    ----------
    sessions : int
        How many there are.
    shift : array, shape (s, 3)
        Of each session against the mean of those that share its temperatures, raw unit; NaN where none does.
    variance : array, shape (3,)
        tau2, or the square of what the shifts are known to where that is more, raw unit squared; NaN where it is not observable.
    variance_to_come : array, shape (3,)
        What a node's variance gets for a session to come, raw unit squared; 0 where tau2 is not observable.
    bounded : array of bool, shape (3,)
        Whether ``variance`` is only what the shifts are known to.
    """

    sessions: int
    shift: FloatArray
    variance: FloatArray
    variance_to_come: FloatArray
    bounded: BoolArray

    @property
    def observable(self) -> bool:
        """Whether sessions share temperatures, so that their shifts can be told."""
        return bool(np.isfinite(self.variance).all())

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
        shared: FloatArray = np.nan_to_num(self.variance)[:, None, None] * same
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
        NaN where no two sessions share a temperature, or where the shifts cannot be told from the curve.
    """
    from scipy.stats import norm, t

    numbers = np.unique(cells.session)
    of_group = _together(cells, numbers)
    held = _held(cells.session[:, None] == numbers[None, :], of_group)
    free = held.shape[1]
    try:
        if free == 0:
            return _not_observable(len(numbers))
        made = fit_smooth(
            cells.temp_c,
            cells.value,
            cells.variance,
            regressors=np.column_stack((held, regressors)),
            groups=cells.groups,
            wander=Wander(
                correlation=cells.correlation,
                scatter=cells.scatter,
            ),
            settings=settings,
        )
    except NotObservable:
        return _not_observable(len(numbers))
    shift = _shifts(made.coefficient[:free], of_group)
    own = _shifts(made.coefficient_uncertainty[:free] ** 2, of_group, last_is_mean=True)
    seen = np.isfinite(shift[:, 0])
    told = np.array([excess_variance(shift[seen, axis], own[seen, axis], free) for axis in range(3)])
    known = own[seen].mean(axis=0)
    variance = np.maximum(told, known)
    factor = float((t.ppf(0.975, free) / norm.ppf(0.975)) ** 2)
    return TurnOn(
        sessions=len(numbers), shift=shift, variance=variance, variance_to_come=factor * variance, bounded=told < known
    )


def _not_observable(count: int) -> TurnOn:
    return TurnOn(
        sessions=count,
        shift=np.full((count, 3), np.nan),
        variance=np.full(3, np.nan),
        variance_to_come=np.zeros(3),
        bounded=np.zeros(3, bool),
    )


def _together(cells: Cells, numbers: IntArray) -> IntArray:
    """Return for each session the least number of those that it is tied to by shared temperatures, one to the next."""
    of_group = np.arange(len(numbers))
    for a in range(len(numbers)):
        for b in range(a):
            ours, theirs = cells.temp_c[cells.session == numbers[a]], cells.temp_c[cells.session == numbers[b]]
            if np.abs(ours[:, None] - theirs[None, :]).min() <= _SHARED_C:
                joined = of_group[[a, b]]
                of_group[np.isin(of_group, joined)] = joined.min()
    return of_group


def _held(of_session: BoolArray, of_group: IntArray) -> FloatArray:
    """Return the columns of the shifts, whose sum is zero in each group: its last session is less all others."""
    columns = [np.zeros((len(of_session), 0))]
    for group in np.unique(of_group):
        members = np.flatnonzero(of_group == group)
        dummies = of_session[:, members].astype(float)
        columns.append(dummies[:, :-1] - dummies[:, -1:])
    return np.column_stack(columns)


def _shifts(found: FloatArray, of_group: IntArray, *, last_is_mean: bool = False) -> FloatArray:
    """Return a row for each session from the columns of ``_held``; NaN for one that shares no temperature."""
    rows, begin = np.full((len(of_group), 3), np.nan), 0
    for group in np.unique(of_group):
        members = np.flatnonzero(of_group == group)
        own = found[begin : begin + len(members) - 1]
        begin += len(own)
        if len(own):
            rows[members[:-1]] = own
            rows[members[-1]] = own.mean(axis=0) if last_is_mean else -own.sum(axis=0)
    return rows
