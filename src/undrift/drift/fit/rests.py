"""Rests of one set-point that disagree: by their pose at every temperature alike, or each by itself.

Blocks of one cell and one pose that follow each other make a rest. Means of rests, the usual slope within a cell taken off, are ::

    y_r = m_cell + P_pose + E_r + noise and wander          var P = p2, var E = r2

p2 and r2 are what makes the squares of the pose effects, and of what is left, equal their expectation under what is known of noise
and wander; below zero counts as zero. P averages out over poses alone and E over rests alone, however many samples they have, so
that the covariance of two cells gets ::

    p2 k_P sum over poses of s_cell s_cell'          and each cell  r2 k_E sum over its rests of s^2        s the share of blocks

Few poses know p2 badly: it is drawn towards the mean of the three axes, of weight 2, and k = (t / z)^2 with the 97.5 % points of
Student's distribution for that many degrees of freedom and of the normal.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.drift.fit.weigh import widening_of
from undrift.drift.observe.observations import RestBlocks

_APART_S = 60.0  # in one cell and pose: a later block is of another rest
_NONE = 1e-6  # singular value of shares: poses that no cell compares
_ALIKE = 2.0  # degrees of freedom by which the axes of a triad are taken to be alike


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestScatter:
    """How rests of one set-point disagree, n cells.

    Parameters
    ----------
    poses, rests : int
        How many there are.
    pose : array, shape (3,)
        Standard deviation from pose to pose, the same at every temperature, raw unit.
    rest : array, shape (3,)
        From rest to rest besides, beyond noise and wander, raw unit.
    known : array, shape (3,)
        To what one rest is known, by noise and wander, raw unit.
    shared : array, shape (3, n, n)
        Covariance that poses give the cells, raw unit squared.
    own : array, shape (n, 3)
        Variance that rests give each cell, raw unit squared.
    members : RestMembers
        Which blocks make which rest, N rests.
    mean : array, shape (N, 3)
        Of each rest, the slope within its cell taken off, raw unit.
    covariance : array, shape (3, N, N)
        Of these means by noise and wander, raw unit squared.
    """

    poses: int
    rests: int
    pose: FloatArray
    rest: FloatArray
    known: FloatArray
    shared: FloatArray
    own: FloatArray
    members: "RestMembers"
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMembers:
    """Which blocks make which rest: N rests.

    Parameters
    ----------
    rows : tuple of array
        Blocks of each.
    cell, pose : array of int, shape (N,)
        Of each.
    """

    rows: tuple[IntArray, ...]
    cell: IntArray
    pose: IntArray


def rests_of(blocks: RestBlocks, cells: list[IntArray]) -> RestMembers:
    """Return the rests that cells are made of.

    Parameters
    ----------
    blocks : RestBlocks
        Of all cells.
    cells : list of array of int
        Blocks of each cell.

    Returns
    -------
    RestMembers
        Blocks of one cell and pose without a gap of a minute.
    """
    rows: list[IntArray] = []
    cell: list[int] = []
    for k, members in enumerate(cells):
        for pose in np.unique(blocks.pose[members]):
            own = members[blocks.pose[members] == pose]
            own = own[np.argsort(blocks.time[own], kind="stable")]
            runs = np.split(own, np.flatnonzero(np.diff(blocks.time[own]) > _APART_S) + 1)
            rows.extend(runs)
            cell.extend([k] * len(runs))
    return RestMembers(
        rows=tuple(rows), cell=np.array(cell, np.int64), pose=np.array([blocks.pose[r[0]] for r in rows], np.int64)
    )


def rest_scatter(members: RestMembers, mean: FloatArray, covariance: FloatArray) -> RestScatter | None:
    """Tell how rests of one set-point disagree beyond what is known of them.

    Parameters
    ----------
    members : RestMembers
        N rests of n cells.
    mean : array, shape (N, 3)
        Of each rest, the slope within its cell taken off, raw unit.
    covariance : array, shape (3, N, N)
        Of these means by noise and wander, raw unit squared.

    Returns
    -------
    RestScatter or None
        None where no cell has two rests.
    """
    count = len(members.rows)
    in_cell, in_pose = _columns(members.cell), in_poses(members)
    about = about_cells(members)
    poses = about @ in_pose
    told = int(np.linalg.matrix_rank(poses, tol=_NONE))
    left = about - (poses @ np.linalg.pinv(poses, rcond=_NONE) if told else 0.0)
    freedom = count - in_cell.shape[1] - told
    if told + freedom < 1:
        return None
    rest: FloatArray = np.zeros(3)
    if freedom > 0:
        rest = pooled(excess(left, None, mean, covariance, freedom), freedom)
    pose: FloatArray = np.zeros(3)
    if told > 0:
        taken = np.linalg.pinv(poses, rcond=_NONE) @ about
        with_rests = covariance + rest[:, None, None] * np.eye(count)
        pose = pooled(excess(taken, taken @ in_pose, mean, with_rests), told)
    size = np.array([len(rows) for rows in members.rows], float)
    share = size[:, None] * in_cell
    share /= share.sum(axis=0)
    by_pose = share.T @ in_pose
    return RestScatter(
        poses=in_pose.shape[1],
        rests=count,
        pose=np.sqrt(pose),
        rest=np.sqrt(rest),
        known=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=1)),
        shared=(pose * widening_of(told + _ALIKE))[:, None, None] * (by_pose @ by_pose.T),
        own=(share**2).sum(axis=0)[:, None] * rest * widening_of(freedom + _ALIKE),
        members=members,
        mean=mean,
        covariance=covariance,
    )


def about_cells(members: RestMembers) -> FloatArray:
    """Return what takes the mean of its cell from each rest.

    Parameters
    ----------
    members : RestMembers
        N rests.

    Returns
    -------
    array, shape (N, N)
        A projector.
    """
    in_cell = _columns(members.cell)
    about: FloatArray = np.eye(len(in_cell)) - in_cell @ (in_cell / in_cell.sum(axis=0)).T
    return about


def in_poses(members: RestMembers) -> FloatArray:
    """Return which rest is in which pose.

    Parameters
    ----------
    members : RestMembers
        N rests.

    Returns
    -------
    array, shape (N, p)
        1 where it is, 0 elsewhere.
    """
    return _columns(members.pose)


def excess(
    taken: FloatArray,
    effect: FloatArray | None,
    mean: FloatArray,
    covariance: FloatArray,
    freedom: int = 1,
) -> FloatArray:
    """Return the variance of an effect: the squares of what is taken of the means, less what their covariance makes of them.

    Parameters
    ----------
    taken : array, shape (q, N)
        Rows that are taken of the means.
    effect : array, shape (q, p), or None
        What independent effects of variance one leave in them; None where it is ``freedom`` squares of one.
    mean : array, shape (N, 3)
        Any unit.
    covariance : array, shape (3, N, N)
        Of the means, unit squared.
    freedom : int
        Of ``taken``, where ``effect`` is None.

    Returns
    -------
    array, shape (3,)
        Unit squared; 0 where chance explains it.
    """
    square = ((taken @ mean) ** 2).sum(axis=0)
    expected = np.einsum("ij,kjl,il->k", taken, covariance, taken)
    size = float(freedom) if effect is None else float((effect**2).sum())
    return np.asarray(np.maximum(square - expected, 0.0) / size)


def pooled(variance: FloatArray, freedom: int) -> FloatArray:
    """Return variances of the three axes, drawn towards their mean: sensors of one triad are alike.

    Parameters
    ----------
    variance : array, shape (3,)
        Any unit squared.
    freedom : int
        Degrees of freedom of each.

    Returns
    -------
    array, shape (3,)
        The mean has the weight of 2 degrees of freedom.
    """
    drawn: FloatArray = (freedom * variance + _ALIKE * variance.mean()) / (freedom + _ALIKE)
    return drawn


def _columns(number: IntArray) -> FloatArray:
    columns: FloatArray = (number[:, None] == np.unique(number)[None, :]).astype(float)
    return columns
