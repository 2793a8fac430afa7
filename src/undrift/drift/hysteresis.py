"""Hysteresis of the offset over temperature: estimated from sweeps both ways, followed where the history is known.

::

    offset(T) = f(T) + h(T) c        dc = -2 dT / w, held within -1 and +1        h(T) straight between the ends of the span

f is the middle of the loop, h its half-width (raw unit), w the change of temperature that crosses it (K); c is -1 after warming by
w and +1 after cooling by w. The model is rate-independent and has closed minor loops: turning points are all that it remembers.

Where c began is not known: two positions are followed, from -1 and from +1. They meet when the temperature has moved by w, or when
a stated history has. Until then the correction takes their mean, which is the middle of the loop at first, and d, half their
distance, is the share of h that stays uncertain. Positions follow the mean of ``SMOOTH_S``, since a noisy thermometer never
stands still.

Estimate: with m the mean position of a cell, the readings are

    y = f + h (m + d u + v + g) + f' T' l + e

u    where recording s began: variance 1, since a device comes from one end or the other; forgotten as d is
v    what the doubt about w does: the mean of (m_w - m)(m_w - m)' over its weights
g    misfit of the loop's shape: standard deviation a after a turn, falling as exp(-way / w) to a fifth of it; alike on one branch
     over ``_ALIKE_C`` of temperature, not on the other
l    lag of the thermometer that the fit of it may have missed; T' the slope of the temperature

Each pair of w and a on a grid is weighted by its restricted likelihood, all axes together, at the covariance of f and e that a
first fit has found (fit/smooth.py). Mean and spread of log w are the estimate and its uncertainty, and what is beside h m goes into
the covariance of the last fit: half-widths and table state it. Set-points further apart than w cannot tell it.
Three models are compared by their errors in bands of temperature left out: the middle of the loop, a constant h, and an h that
changes with temperature. A model with more parameters has to be better by 2 %, and what it adds larger than three times its
uncertainty.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import Cells, TurnOn
from undrift.errors import InputError, NotObservable
from undrift.fit.smooth import Column, SmoothSpline, bending, parabola
from undrift.model import Hysteresis

TempHistory: TypeAlias = Literal["none", "warming", "cooling"] | Sequence[float]
Fitted: TypeAlias = tuple[Cells, SmoothSpline, TurnOn | None]
Fit: TypeAlias = Callable[[Cells, FloatArray], Fitted]  # fits cells with a known covariance beside their own, (3, n, n)

SETTLE_S = 1.0  # readings whose mean begins the course of the temperature
SMOOTH_S = 30.0
CROSSINGS_K = 2.0 ** np.arange(0.0, 4.6, 0.25)
_MISFITS = np.array([0.02, 0.05, 0.1, 0.2, 0.4])  # a
_ALIKE_C = 5.0
_CLOSED = 0.2  # of a: the misfit that is left far from a turn
_BETTER = 0.98  # times the error of a model with fewer parameters
SIGNIFICANT = 3.0  # standard uncertainties, on one axis or more
_BANDS = 12  # of temperature, left out by thirds


# ---- follow a loop


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopState:
    """What following a loop carries from chunk to chunk."""

    first: float = math.nan  # time of the first reading, s
    last: float = math.nan  # and of the last one
    count: float = 0.0  # readings so far
    temp_c: float = math.nan  # their smoothed course, degC
    at_c: float = math.nan  # where the positions were moved to, degC
    low: float = -1.0  # position in the loop if it began at -1
    high: float = 1.0  # and if it began at +1
    crossing_k: float  # w, K

    @property
    def unknown(self) -> float:
        """Share of the half-width that is not known, 1 without history, 0 after the temperature has moved by w."""
        return 0.5 * (self.high - self.low)


def state_of(history: TempHistory | None, crossing_k: float) -> LoopState:
    """Return the state before a recording: from which side it came, or the temperatures at which its course turned.

    None: not known; "none" is for the caller, who then follows no loop.
    """
    if history is None:
        return LoopState(crossing_k=crossing_k)
    if isinstance(history, str):
        if history not in ("warming", "cooling"):
            raise InputError(
                f"temperature history: wanted none, warming, cooling or temperatures, got '{history}'; state one"
            )
        side = -1.0 if history == "warming" else 1.0
        return LoopState(low=side, high=side, crossing_k=crossing_k)
    turns = np.array(history, dtype=float)
    if turns.ndim != 1 or not len(turns) or not np.isfinite(turns).all():
        raise InputError(
            f"temperature history: wanted one temperature or more, oldest first, degC, got {list(history)}; state where the "
            "device was before the recording"
        )
    low, high = positions(turns, np.array([crossing_k]))[:, 0]
    return LoopState(at_c=float(turns[-1]), low=float(low[-1]), high=float(high[-1]), crossing_k=crossing_k)


def follow_loop(temp_c: FloatArray, time: FloatArray, *, state: LoopState) -> tuple[FloatArray, LoopState]:
    """Return the position in the loop at each reading, (N,), and the state after them; temp_c (N,) degC, time (N,) s."""
    from undrift.kernels.correct import follow

    *held, crossing = astuple(state)
    carried, position = np.array(held), np.empty(len(temp_c))
    follow(temp_c, time, crossing, SETTLE_S, SMOOTH_S, carried, position)
    first, last, count, mean, at, low, high = carried.tolist()
    return position, LoopState(
        first=first, last=last, count=count, temp_c=mean, at_c=at, low=low, high=high, crossing_k=crossing
    )


def uncertain_share(state: LoopState, crossing_uncertainty_k: float) -> FloatArray:
    """Return the position and its standard uncertainty, by what is not known of the beginning and of the crossing; (2,)."""
    position = 0.5 * (state.low + state.high)
    crossed = (1.0 - position**2) * crossing_uncertainty_k / state.crossing_k
    return np.array([position, math.hypot(state.unknown, crossed)])


def positions(temp_c: FloatArray, crossing_k: FloatArray) -> FloatArray:
    """Return the positions along a course in loops of each crossing, from -1 and from +1: (n,) and (W,) -> (2, W, n)."""
    found = np.empty((len(temp_c), 2, len(crossing_k)))
    at = np.array([[-1.0], [1.0]]) * np.ones(len(crossing_k))
    for k, change in enumerate(np.diff(temp_c, prepend=temp_c[0])[:, None] * (2.0 / crossing_k)):
        at = np.minimum(np.maximum(at - change, -1.0), 1.0)
        found[k] = at
    return np.moveaxis(found, 0, 2)


# ---- estimate it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopChoice:
    """The model that predicts best what was left out."""

    fitted: Fitted  # with the loop
    hysteresis: Hysteresis | None  # None where the middle of the loop is as good
    left_out: FloatArray  # (3,), cross-validated error with the model, raw unit
    left_out_middle: FloatArray  # (3,), and of the middle of the loop


def courses(blocks: RestBlocks) -> FloatArray:
    """Return of each block the way since the last turn, K, and its positions in loops of each crossing, (n, 1 + 2 W)."""
    places, way_k = np.zeros((2, len(CROSSINGS_K), len(blocks))), np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        places[:, :, rows] = positions(blocks.temp_c[rows], CROSSINGS_K)
        side, begin = np.sign(places[:, 0, rows].mean(axis=0)), blocks.temp_c[rows[0]]
        for leg in np.split(rows, np.flatnonzero(np.diff(side)) + 1):
            way_k[leg] = np.abs(blocks.temp_c[leg] - begin)
            begin = blocks.temp_c[leg][np.argmax(way_k[leg])]
    return np.vstack((way_k, places.reshape(-1, len(blocks)))).T


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Loops:
    """Loops of W crossings along n cells."""

    middle: FloatArray  # (W, n), m
    began: FloatArray  # (W, n, n), covariance of d u
    misfit: FloatArray  # (W, n, n), of g, where a is 1

    @classmethod
    def of(cls, cells: Cells, course: FloatArray) -> "_Loops":
        """Return the loops of cells, by the means of ``courses`` in each, (n, 1 + 2 W)."""
        low, high = course[:, 1:].T.reshape(2, len(CROSSINGS_K), -1)
        lately = np.exp(-course[:, 0] / CROSSINGS_K[:, None])
        apart, way = 0.5 * (high - low), 0.5 * (low + high)[0]
        alike = np.exp(-np.abs(cells.temp_c[:, None] - cells.temp_c) / _ALIKE_C)
        same = cells.session[:, None] == cells.session
        return cls(
            middle=0.5 * (low + high),
            began=same * apart[:, :, None] * apart[:, None, :],
            misfit=alike * 0.5 * (1.0 + np.outer(way, way)) * (_CLOSED**2 + lately[:, :, None] * lately[:, None, :]),
        )


def choose_loop(
    cells: Cells, course: FloatArray, first: SmoothSpline, missed: FloatArray, fit: Fit
) -> LoopChoice | None:
    """Choose among the middle of the loop, a constant and a changing half-width; None where none can be left out.

    course (n, 1 + 2 W): ``courses`` of the cells; first: a fit whose first regressor is a loop; missed (3, n): by lag that is left.
    """
    loops, half = _Loops.of(cells, course), first.coefficient[0]
    others = cells.regressors[:, 1:]
    lag = missed[:, :, None] * missed[:, None, :]
    weight = _weights(first.columns, loops, half, others, lag)
    of_crossing, log = weight.sum(axis=1), np.log(CROSSINGS_K)
    mean = float(of_crossing @ log)
    doubt = math.sqrt(float(of_crossing @ (log - mean) ** 2) + (log[1] - log[0]) ** 2 / 12.0)
    place = (mean - log[0]) / (log[1] - log[0])
    near = np.maximum(1.0 - np.abs(np.arange(len(log)) - place), 0.0)  # straight between two crossings
    position, away = near @ loops.middle, loops.middle - near @ loops.middle
    covariance = np.tensordot(near, loops.began + (weight.sum(axis=0) @ _MISFITS**2) * loops.misfit, 1)
    covariance = (half**2)[:, None, None] * (covariance + (of_crossing * away.T) @ away) + lag
    scaled = 2.0 * first.columns[0].x
    models = [position[:, None][:, :0], position[:, None], np.column_stack((position, position * scaled))]
    try:
        errors = [
            _left_out(cells, first.columns, np.hstack((model, others)), (covariance, lag), position) for model in models
        ]
    except NotObservable:
        return None
    best = 0
    for k in (1, 2):
        ratio = np.maximum(errors[k], 1e-300) / np.maximum(errors[best], 1e-300)
        best = k if np.log(ratio).mean() < math.log(_BETTER) else best
    fitted = fit(replace(cells, regressors=np.hstack((models[max(best, 1)], others))), covariance)
    if best == 2 and not shows(fitted[1], 1):
        best, fitted = 1, fit(replace(cells, regressors=np.hstack((models[1], others))), covariance)
    hysteresis = None
    if best and shows(fitted[1], 0):
        mid, deviation = (x[:best] for x in (fitted[1].coefficient, fitted[1].coefficient_uncertainty))
        ends = np.array([[1.0, -1.0], [1.0, 1.0]])[:, :best]
        hysteresis = Hysteresis(
            crossing_k=math.exp(mean),
            crossing_uncertainty_k=math.exp(mean) * doubt,
            temp_c=np.array([cells.temp_c.min(), cells.temp_c.max()]),
            gyro_half_width=ends @ mid,
            gyro_uncertainty=np.sqrt(ends**2 @ deviation**2),
        )
    return LoopChoice(fitted=fitted, hysteresis=hysteresis, left_out=errors[best], left_out_middle=errors[0])


def shows(spline: SmoothSpline, effect: int) -> bool:
    """Tell whether an effect shows on an axis or more."""
    return bool((np.abs(spline.coefficient[effect]) > SIGNIFICANT * spline.coefficient_uncertainty[effect]).any())


def _weights(
    columns: Sequence[Column], loops: _Loops, half: FloatArray, others: FloatArray, lag: FloatArray
) -> FloatArray:
    """Return the weight of each crossing and misfit, (W, M)."""
    score = np.zeros((len(CROSSINGS_K), len(_MISFITS)))
    for k, column in enumerate(columns):
        trend = np.column_stack((np.ones(len(column.x)), column.x, others, column.y))
        given = np.concatenate((loops.middle[:, :, None], np.broadcast_to(trend, (len(score), *trend.shape))), axis=2)
        for j, misfit in enumerate(_MISFITS.tolist()):
            own = half[k] ** 2 * (loops.began + misfit**2 * loops.misfit)
            root = np.linalg.cholesky(column.covariance + lag[k] + own)
            white = np.linalg.solve(root, given)
            left = np.linalg.qr(white, mode="r")  # the last column holds y: its last element is the residual
            size = np.abs(np.diagonal(left, axis1=1, axis2=2))
            logs = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.log(size[:, :-1]).sum(axis=1)
            score[:, j] -= logs + 0.5 * size[:, -1] ** 2
    weight = np.exp(score - score.max())
    return np.asarray(weight / weight.sum())


def _left_out(
    cells: Cells,
    columns: Sequence[Column],
    regressors: FloatArray,
    errors: tuple[FloatArray, FloatArray],
    position: FloatArray,
) -> FloatArray:
    """Return the rms error, (3,), of means of a band of temperature and a side of the loop, every third band left out in turn.

    Predicted are the curve, the loop and the lag, not what a visit or a branch adds; errors: all that is beside the curve, and lag.
    """
    low, span = cells.temp_c.min(), np.ptp(cells.temp_c)
    band = np.minimum((cells.temp_c - low) * (_BANDS / span), _BANDS - 1).astype(np.int64)
    parts = 2 * band + (position > 0.0)
    means = list[list[FloatArray]]()
    for k, column in enumerate(columns):
        basis = np.column_stack((np.ones(len(column.x)), column.x, regressors))
        bow, whole = parabola(column.x), column.covariance + errors[0][k]
        signal = column.weight.sum(axis=0) @ column.bend * bending(column.x, column.x) + column.bow * np.outer(bow, bow)
        signal = signal + errors[1][k]
        means.append([])
        for turn in range(3):
            test = (band % 3 == turn) & (band > 0) & (band < _BANDS - 1)  # the ends are not extrapolated
            train = np.flatnonzero(~test)
            inverse = np.linalg.inv(whole[np.ix_(train, train)])
            weighted = basis[train].T @ inverse
            if not test.any() or np.linalg.matrix_rank(weighted @ basis[train]) < basis.shape[1]:
                continue
            left = column.y - basis @ np.linalg.solve(weighted @ basis[train], weighted @ column.y[train])
            error = left[test] - signal[np.ix_(test, ~test)] @ inverse @ left[train]
            means[k] += [error[parts[test] == part].mean() for part in np.unique(parts[test])]
    if not means[0]:
        raise NotObservable("hysteresis: wanted temperatures between the ends, got none; record more set-points")
    return np.asarray(np.sqrt(np.mean(np.square(means), axis=1)))
