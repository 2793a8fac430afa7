"""Temperature cells: blocks of rest gathered so that every degree counts alike.

A warm-up spends most of its blocks at the hot end. Blocks of one session and one direction of sweep within a narrow range of
temperature make one cell: mean value, variance of that mean from the noise inside the blocks. What wanders from block to block
(bias instability) does not average out inside a cell. Its correlation over time is taken as that of flicker noise, a sum of
first-order processes of equal variance with time constants tau_j half a decade apart::

    rho(t) = mean over j of exp(-t / tau_j)        C = mean of rho over the pairs of blocks of two cells, 0 across sessions

and its size s2, before the curve is fitted, comes from second differences of neighbouring blocks, which no smooth ramp moves::

    mean (y_(k+1) - 2 y_k + y_(k-1))^2 = 6 v + s2 (6 - 8 rho(h) + 2 rho(2 h))

where the temperature is smooth as well: a jump to the next set-point between two blocks is no wander. Where too few blocks follow
each other, s2 comes from pairs of blocks of one rest, else of one cell and pose, the usual slope taken off:
mean (y_j - y_i)^2 = 2 v + 2 s2 (1 - rho(t)).
Poses and rests of one set-point that disagree by more than that are in ``rests.py``.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.fit.rests import RestMembers, RestScatter, rest_scatter, rests_of
from undrift.drift.observe.observations import RestBlocks

_TIME_CONSTANTS_S = 10.0 ** np.arange(1.0, 4.1, 0.5)
_FAR = 6.0  # robust standard deviations: a block further from its cell is left out
_ROBUST = 1.4826
_MOST_PAIRED = 30  # blocks of a cell that its correlation is taken from
_LEAST_TRIPLES = 8
_LEAST_PAIRS = 4
_LEAST_JUDGED = 5  # blocks of a cell and pose: fewer do not tell which one is wrong
_SMOOTH_C = 0.5  # second difference of the temperature: above, a new set-point lies between blocks
_STEP_PER_ERROR = 12.0**0.5  # step of a converter over the error that it leaves without noise


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSettings:
    """How blocks are gathered.

    Parameters
    ----------
    least_width_c : float
        Narrowest cell, degC.
    most_cells : int
        Cells are widened until there are about as many; the fit takes the cube of their number.
    most_groups : int
        Groups of neighbouring cells that are left out in turn.
    chunk_s : float
        Cells are cut where the time since power-on passes this, twice this, four times, ...; infinite for no cut.
    """

    least_width_c: float = 0.5
    most_cells: int = 100
    most_groups: int = 20
    chunk_s: float = np.inf


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Cells of one triad, n rows.

    Parameters
    ----------
    session : array of int, shape (n,)
        Which session.
    temp_c : array, shape (n,)
        Mean temperature, degC.
    value, variance : array, shape (n, 3)
        Mean and its variance from the noise inside the blocks, raw unit and its square.
    regressors : array, shape (n, p)
        Means of what was given for each block.
    correlation : array, shape (n, n)
        C.
    groups : array of int, shape (n,)
        Neighbours in temperature.
    scatter : array, shape (3,), or None
        s2, raw unit squared; None where too few blocks follow each other or share a cell and a pose.
    pairs : int
        Of blocks of one cell and pose that s2 rests on; 0 where it comes from blocks that follow each other, or is None.
    between : RestScatter or None
        How rests of one cell disagree; part of ``variance`` and of ``shared``. None where no cell has two.
    """

    session: IntArray
    temp_c: FloatArray
    value: FloatArray
    variance: FloatArray
    regressors: FloatArray
    correlation: FloatArray
    groups: IntArray
    scatter: FloatArray | None
    pairs: int = 0
    between: RestScatter | None = None


def gather(
    blocks: RestBlocks,
    value: FloatArray,
    variance: FloatArray,
    *,
    direction: FloatArray,
    regressors: FloatArray,
    step_error: FloatArray | None = None,
    settings: CellSettings = CellSettings(),
) -> Cells:
    """Gather blocks into temperature cells.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    value, variance : array, shape (n, 3)
        What is gathered, raw unit and its square; no NaN.
    direction : array, shape (n,)
        Of the sweep, -1 to 1; cells do not mix directions.
    regressors : array, shape (n, p)
        Averaged along.
    step_error : array, shape (n, 3), or None
        What the converter's steps leave in each block, raw unit: averages out only as far as a cell's values cross steps.
    settings : CellSettings
        Widths.

    Returns
    -------
    Cells
        In the order of session, direction, time and temperature.
    """
    key = _keys(blocks, direction, settings.chunk_s)
    width = max(
        settings.least_width_c,
        sum(float(np.ptp(blocks.temp_c[key == k])) for k in range(key.max() + 1)) / settings.most_cells,
    )
    members: list[IntArray] = []
    for k in range(key.max() + 1):
        rows = np.flatnonzero(key == k)
        rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
        bins = walk(blocks.temp_c[rows], width)
        members.extend(rows[bins == b] for b in range(bins.max() + 1))
    members = [rows[_good(value[rows], blocks.pose[rows])] for rows in members]
    temp_c = np.array([blocks.temp_c[rows].mean() for rows in members])
    group_width = max(1.5 * width, float(np.ptp(temp_c)) / settings.most_groups)
    order = np.argsort(temp_c, kind="stable")
    groups = np.empty(len(members), np.int64)
    groups[order] = walk(temp_c[order], group_width)
    found = np.array(
        [_variance(value[rows], variance[rows], None if step_error is None else step_error[rows]) for rows in members]
    )
    middle = np.array([value[rows].mean(axis=0) for rows in members])
    level = value - _slope(temp_c, middle) * blocks.temp_c[:, None]
    rests = rests_of(blocks, members)
    scatter, pairs = wander(blocks, value, variance), 0
    if scatter is None:
        scatter, pairs = _from_pairs(blocks, rests, level, variance)
    between = rest_scatter(rests, *_rest_means(blocks, rests, level, variance, scatter))
    return Cells(
        session=np.array([blocks.session[rows[0]] for rows in members], np.int64),
        temp_c=temp_c,
        value=middle,
        variance=found if between is None else found + between.own,
        regressors=np.array([regressors[rows].mean(axis=0) for rows in members]),
        correlation=_correlation(blocks, members),
        groups=groups,
        scatter=scatter,
        pairs=pairs,
        between=between,
    )


def walk(temp_c: FloatArray, width: float) -> IntArray:
    """Return numbers of bins: each begins at a value and holds what lies within a width above it.

    Parameters
    ----------
    temp_c : array, shape (n,)
        degC, not decreasing.
    width : float
        degC.

    Returns
    -------
    array of int, shape (n,)
        From 0; soaks narrower than the width stay whole.
    """
    bins = np.zeros(len(temp_c), np.int64)
    begin = temp_c[0]
    for k in range(1, len(temp_c)):
        new = temp_c[k] - begin > width
        begin = temp_c[k] if new else begin
        bins[k] = bins[k - 1] + new
    return bins


def wander(blocks: RestBlocks, value: FloatArray, variance: FloatArray) -> FloatArray | None:
    """Return the variance of what wanders from block to block, as flicker noise would have it.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    value, variance : array, shape (n, 3)
        Raw unit and its square.

    Returns
    -------
    array, shape (3,), or None
        s2, raw unit squared, at least what the noise of the estimate itself would feign; None for too few blocks in a row.
    """
    step = np.diff(blocks.time)
    usual = float(np.median(step)) if len(step) else 0.0
    follows = (np.abs(step - usual) < 0.2 * usual) & (np.diff(blocks.session) == 0) & (np.diff(blocks.pose) == 0)
    smooth = np.abs(np.diff(blocks.temp_c, 2)) < _SMOOTH_C if len(blocks) > 2 else np.zeros(0, bool)
    middle = np.flatnonzero(follows[1:] & follows[:-1] & smooth) + 1
    if len(middle) < _LEAST_TRIPLES:
        return None
    second = (value[middle + 1] - 2.0 * value[middle] + value[middle - 1]) ** 2
    usual_second = np.median(second, axis=0) / 0.455  # median of chi-square with one degree of freedom
    second = np.minimum(second, _FAR**2 * usual_second)
    noise = 6.0 * variance[middle].mean(axis=0)
    error = noise * np.sqrt(4.0 / len(middle))  # neighbouring differences share blocks
    share = 6.0 - 8.0 * _rho(np.array(usual)) + 2.0 * _rho(np.array(2.0 * usual))
    return np.asarray(np.maximum(second.mean(axis=0) - noise, error) / share)


def _slope(temp_c: FloatArray, value: FloatArray) -> FloatArray:
    """Return the usual slope over temperature, shape (k,); 0 for one temperature."""
    x = temp_c - temp_c.mean()
    return np.asarray(x @ value / max(float(x @ x), 1e-9))


def _from_pairs(
    blocks: RestBlocks, rests: RestMembers, level: FloatArray, variance: FloatArray
) -> tuple[FloatArray | None, int]:
    """Return s2 from neighbouring blocks of one cell and pose, and how many pairs there are."""
    one, two = _pairs(list(rests.rows))
    if len(one) < _LEAST_PAIRS:  # what differs from rest to rest is taken for wander then
        of_pose: dict[tuple[int, int], list[IntArray]] = {}
        for rows, cell, pose in zip(rests.rows, rests.cell.tolist(), rests.pose.tolist(), strict=True):
            of_pose.setdefault((cell, pose), []).append(rows)
        one, two = _pairs([np.concatenate(parts) for parts in of_pose.values()])
    if len(one) < _LEAST_PAIRS:
        return None, 0
    noise = (variance[one] + variance[two]).mean(axis=0)
    square = ((level[two] - level[one]) ** 2).mean(axis=0) - noise
    share = 2.0 * float(np.mean(1.0 - _rho(np.abs(blocks.time[two] - blocks.time[one]))))
    return np.asarray(np.maximum(square, noise * np.sqrt(2.0 / len(one))) / share), len(one)


def _pairs(rests: list[IntArray]) -> tuple[IntArray, IntArray]:
    return np.concatenate([rows[:-1] for rows in rests]), np.concatenate([rows[1:] for rows in rests])


def _rest_means(
    blocks: RestBlocks, rests: RestMembers, level: FloatArray, variance: FloatArray, scatter: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return the mean of each rest and the covariance of these means by noise and wander."""
    mean = np.array([level[rows].mean(axis=0) for rows in rests.rows])
    own = np.array([variance[rows].mean(axis=0) / len(rows) for rows in rests.rows])
    covariance = own.T[:, :, None] * np.eye(len(mean))
    if scatter is not None:
        covariance = covariance + scatter[:, None, None] * _correlation(blocks, list(rests.rows))
    return mean, covariance


def _variance(value: FloatArray, variance: FloatArray, step_error: FloatArray | None) -> FloatArray:
    noise: FloatArray = variance.mean(axis=0) / len(value)
    if step_error is None:
        return noise
    left = np.nanmean(step_error, axis=0)
    crossed = np.ptp(value, axis=0) / np.maximum(_STEP_PER_ERROR * left, 1e-300)
    total: FloatArray = noise + left**2 / (1.0 + np.where(left > 0.0, crossed, 0.0))
    return total


def _rho(lag_s: FloatArray) -> FloatArray:
    kept: FloatArray = np.exp(-np.asarray(lag_s)[..., None] / _TIME_CONSTANTS_S).mean(axis=-1)
    return kept


def _keys(blocks: RestBlocks, direction: FloatArray, chunk_s: float) -> IntArray:
    way = np.round(direction).astype(np.int64)
    chunk = np.zeros(len(blocks), np.int64)
    if np.isfinite(chunk_s):
        chunk = np.floor(np.log2(np.maximum(blocks.power_on_s / chunk_s, 0.5))).astype(np.int64)
    return np.unique(np.column_stack((blocks.session, way, chunk)), axis=0, return_inverse=True)[1].reshape(-1)


def _good(value: FloatArray, pose: IntArray) -> BoolArray:
    """Tell which blocks of a cell are near the others of their pose: a whole pose that differs is no outlier."""
    good = np.ones(len(value), bool)
    for number in np.unique(pose):
        own = np.flatnonzero(pose == number)
        off = np.abs(value[own] - np.median(value[own], axis=0))
        near = (off <= _FAR * _ROBUST * np.median(off, axis=0)).all(axis=1)
        if len(own) >= _LEAST_JUDGED and near.mean() > 0.5:
            good[own] = near
    return good


def _correlation(blocks: RestBlocks, members: list[IntArray]) -> FloatArray:
    sampled = [rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_PAIRED)).astype(int)] for rows in members]
    ends = np.concatenate(([0], np.cumsum([len(rows) for rows in sampled])))
    time = blocks.time[np.concatenate(sampled)]
    session = np.array([blocks.session[rows[0]] for rows in members])
    correlation = np.zeros((len(members), len(members)))
    for k in range(len(members)):
        pairs = _rho(np.abs(time[ends[k] : ends[k + 1], None] - time[None, :])).mean(axis=0)
        correlation[k] = np.add.reduceat(pairs, ends[:-1]) / np.diff(ends)
    correlation[session[:, None] != session[None, :]] = 0.0
    return 0.5 * (correlation + correlation.T)
