"""Hysteresis of the offset over temperature: estimated from sweeps both ways, followed where the history is known.

::

    offset(T) = f(T) + h(T) c        dc = -2 dT / w, held within -1 and +1        h(T) straight between the ends of the span

f is the middle of the loop, h its half-width (raw unit), w the change of temperature that crosses it (K); c is -1 after warming by
w and +1 after cooling by w. The model is rate-independent and has closed minor loops: turning points are all that it remembers.

Where c began is not known: two positions are followed, from -1 and from +1. They meet when the temperature has moved by w, or when
a stated history has. Until then the correction takes the middle of the two, which is the middle of the loop at first, and half
their distance is the share of h that stays uncertain. Positions follow the mean of ``SMOOTH_S``, since a noisy thermometer never
stands still.

Estimate: w on a grid, with h a regressor beside the spline; n log(residuals), n the groups of neighbouring temperatures, gives each
w its weight; mean and spread of log w are the estimate and its uncertainty. Set-points further apart than w cannot tell it.
Three models are compared by their errors in bands of temperature left out: the middle of the loop, a constant h, and an h that
changes with temperature, as a thermometer that lags leaves one. A model with more parameters has to be better by 2 %.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from typing import Literal, TypeAlias

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import Cells, TurnOn
from undrift.errors import InputError, NotObservable
from undrift.fit.smooth import SmoothSpline
from undrift.model import Hysteresis

TempHistory: TypeAlias = Literal["warming", "cooling"] | Sequence[float]
Fitted: TypeAlias = tuple[Cells, SmoothSpline, TurnOn | None]
# Fits the rows (n,) of the blocks with regressors (n, p) or none; blocks of different positions (n,) are not averaged
Fit: TypeAlias = Callable[[BoolArray, FloatArray | None, FloatArray], Fitted]

SETTLE_S = 1.0  # readings whose mean begins the course of the temperature
SMOOTH_S = 30.0
_CROSSINGS_K = 2.0 ** np.arange(0.0, 4.1)
_BETTER = 0.98  # times the error of a model with fewer parameters
_BANDS = 12  # of temperature, left out by thirds
_PLACES = 200  # of the curve, between which it is taken as straight


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
    """Return the state before a recording: from which side it came, or the temperatures at which its course turned."""
    if history is None:
        return LoopState(crossing_k=crossing_k)
    if isinstance(history, str):
        if history not in ("warming", "cooling"):
            raise InputError(
                f"temperature history: wanted warming, cooling or temperatures, got '{history}'; state one"
            )
        side = -1.0 if history == "warming" else 1.0
        return LoopState(low=side, high=side, crossing_k=crossing_k)
    turns = np.array(history, dtype=float)
    if turns.ndim != 1 or not len(turns) or not np.isfinite(turns).all():
        raise InputError(
            f"temperature history: wanted one temperature or more, oldest first, degC, got {list(history)}; state where the "
            "device was before the recording"
        )
    low, high = _positions(turns, crossing_k)
    return LoopState(at_c=float(turns[-1]), low=float(low[-1]), high=float(high[-1]), crossing_k=crossing_k)


def follow_loop(temp_c: FloatArray, time: FloatArray, *, state: LoopState) -> tuple[FloatArray, LoopState]:
    """Return the position in the loop at each reading, (N,), and the state after them; temp_c (N,) degC, time (N,) s."""
    from undrift.kernels.hysteresis import follow

    *held, crossing = astuple(state)
    carried, position = np.array(held), np.empty(len(temp_c))
    follow(temp_c, time, crossing, SETTLE_S, SMOOTH_S, carried, position)
    first, last, count, mean, at, low, high = carried.tolist()
    return position, LoopState(
        first=first, last=last, count=count, temp_c=mean, at_c=at, low=low, high=high, crossing_k=crossing
    )


def _positions(temp_c: FloatArray, crossing_k: float) -> FloatArray:
    """Return the positions along a course, from -1 and from +1: (n,) -> (2, n)."""
    found = np.empty((2, len(temp_c)))
    position = np.array([-1.0, 1.0])
    for k, change in enumerate(np.diff(temp_c, prepend=temp_c[0]).tolist()):
        position = np.clip(position - 2.0 * change / crossing_k, -1.0, 1.0)
        found[:, k] = position
    return found


# ---- estimate it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopChoice:
    """The model that predicts best what was left out."""

    fitted: Fitted
    hysteresis: Hysteresis | None  # None where the middle of the loop is as good
    left_out: FloatArray  # (3,), cross-validated error with the model, raw unit
    left_out_middle: FloatArray  # (3,), and of the middle of the loop


def choose_loop(blocks: RestBlocks, value: FloatArray, fitted: Fit) -> LoopChoice | None:
    """Choose among the middle of the loop, a constant and a changing half-width; None where none can be left out.

    value (n, 3) of the blocks, raw unit.
    """
    low_c, high_c = float(blocks.temp_c.min()), float(blocks.temp_c.max())
    scaled = (2.0 * blocks.temp_c - low_c - high_c) / (high_c - low_c)
    try:
        crossing, doubt = _crossing(blocks, value, fitted)
        position = in_loop(blocks, crossing)
        models = (None, position[:, None], np.column_stack((position, position * scaled)))
        errors = [_left_out(blocks, value, fitted, model, position) for model in models]
        best = 0
        for k in (1, 2):
            best = k if np.log(errors[k] / errors[best]).mean() < math.log(_BETTER) else best
        chosen = fitted(np.ones(len(blocks), bool), models[best], position)
    except NotObservable:
        return None
    hysteresis = None
    if best:
        half, own = (x[:best] for x in (chosen[1].coefficient, chosen[1].coefficient_uncertainty))
        ends = np.array([[1.0, -1.0], [1.0, 1.0]])[:, :best]
        hysteresis = Hysteresis(
            crossing_k=crossing,
            crossing_uncertainty_k=doubt,
            temp_c=np.array([low_c, high_c]),
            gyro_half_width=ends @ half,
            gyro_uncertainty=np.sqrt(ends**2 @ own**2),
        )
    return LoopChoice(fitted=chosen, hysteresis=hysteresis, left_out=errors[best], left_out_middle=errors[0])


def _left_out(
    blocks: RestBlocks, value: FloatArray, fitted: Fit, columns: FloatArray | None, position: FloatArray
) -> FloatArray:
    """Return the rms error, (3,), of means of a band of temperature and a side of the loop, every third band left out in turn."""
    low, span = blocks.temp_c.min(), np.ptp(blocks.temp_c)
    band = np.minimum((blocks.temp_c - low) * (_BANDS / span), _BANDS - 1).astype(np.int64)
    means = []
    for turn in range(3):
        held = (band % 3 == turn) & (band > 0) & (band < _BANDS - 1)  # the ends are not extrapolated
        if not held.any():
            continue
        error = _residual(blocks, value, fitted(~held, columns, position)[1], columns)
        parts = 2 * band + (position > 0.0)
        means += [error[held & (parts == part)].mean(axis=0) for part in np.unique(parts[held])]
    if not means:
        raise NotObservable("hysteresis: wanted temperatures between the ends, got none; record more set-points")
    return np.asarray(np.sqrt(np.mean(np.square(means), axis=0)))


def _residual(blocks: RestBlocks, value: FloatArray, spline: SmoothSpline, columns: FloatArray | None) -> FloatArray:
    places = np.linspace(blocks.temp_c.min(), blocks.temp_c.max(), _PLACES)
    middle = [np.interp(blocks.temp_c, places, curve) for curve in spline.at(places).value.T]
    loop = 0.0 if columns is None else columns @ spline.coefficient[: columns.shape[1]]
    return np.asarray(value - np.column_stack(middle) - loop)


def in_loop(blocks: RestBlocks, crossing_k: float) -> FloatArray:
    """Return the position of each block, (n,): the middle of the two that it may have."""
    position = np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        position[rows] = _positions(blocks.temp_c[rows], crossing_k).mean(axis=0)
    return position


def _crossing(blocks: RestBlocks, value: FloatArray, fitted: Fit) -> tuple[float, float]:
    """Return w and its standard uncertainty, K."""
    score, every = np.empty(len(_CROSSINGS_K)), np.ones(len(blocks), bool)
    for k, crossing in enumerate(_CROSSINGS_K.tolist()):
        position = in_loop(blocks, crossing)
        cells, spline, _ = fitted(every, position[:, None], position)
        left = _residual(blocks, value, spline, position[:, None])
        score[k] = -0.5 * len(np.unique(cells.groups)) * np.log((left**2).mean(axis=0)).sum()
    weight = np.exp(score - score.max())
    weight, log = weight / weight.sum(), np.log(_CROSSINGS_K)
    mean = float(weight @ log)
    step = float(log[1] - log[0])
    spread = math.sqrt(float(weight @ (log - mean) ** 2) + step**2 / 12.0)
    return math.exp(mean), math.exp(mean) * spread
