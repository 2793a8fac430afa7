"""Tables made ready for the correction kernels: steps made even, cells turned into coefficients.

A table over nodes t_0 < ... < t_n is linear between them and held at its ends. In cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r the fraction along the second axis

Nodes that are whole multiples of one step (a rate grid with a gap around zero) are filled up to an even grid, which changes no
value and finds the cell by one multiplication; others are searched.
"""

from typing import TYPE_CHECKING

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import DynamicDrift

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid

MOST_NODES = 4096  # an even grid finer than this is not worth its memory
EVEN_WITHIN = 1e-9  # of a step


def even_nodes(nodes: FloatArray) -> FloatArray | None:
    """Return the even grid that holds all nodes, or None where there is none of a sensible size.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.

    Returns
    -------
    array, shape (m,), or None
        m >= n, from the first node to the last.
    """
    span = nodes[-1] - nodes[0]
    cells = span / np.diff(nodes).min()
    for parts in (1, 2, 3):  # the smallest gap may itself be two or three steps
        count = round(float(cells) * parts)
        if count + 1 > MOST_NODES:
            return None
        places = (nodes - nodes[0]) * (count / span)
        if np.abs(places - np.round(places)).max() < EVEN_WITHIN:
            grid: FloatArray = np.linspace(nodes[0], nodes[-1], count + 1)
            return grid
    return None


def grid_of(nodes: FloatArray) -> "Grid":
    """Return how the kernel finds the cell: by one multiplication on the even grid, where there is one, else by bisection.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.

    Returns
    -------
    Grid
        Of the even grid, or of the nodes as they are.
    """
    from undrift.kernels.correct import Grid

    fine = even_nodes(nodes)
    held = np.array(nodes) if fine is None else fine
    cells = len(held) - 1
    return Grid(held, float(held[0]), 0.0 if fine is None else cells / float(held[-1] - held[0]), cells)


def line_cells(nodes: FloatArray, values: FloatArray) -> "tuple[Grid, FloatArray]":
    """Return the grid of a one-dimensional table and its cell coefficients.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.
    values : array, shape (n, c)
        c values at each node.

    Returns
    -------
    grid : Grid
        How the kernel finds the cell.
    coefficients : array, shape (cells * c * 2,)
        Value and slope per cell, flat.
    """
    grid = grid_of(nodes)
    values = _filled(grid.nodes, nodes, values)
    return grid, np.stack((values[:-1], np.diff(values, axis=0)), axis=-1).reshape(-1)


def plane_cells(dynamic: DynamicDrift) -> "tuple[Grid, Grid, FloatArray]":
    """Return the grids of the dynamic table and its cell coefficients.

    Parameters
    ----------
    dynamic : DynamicDrift
        Rate error over temperature and measured rate, rad/s.

    Returns
    -------
    temperature, turn_rate : Grid
        How the kernel finds the cell.
    coefficients : array, shape (temperature cells * rate cells * 12,)
        c0, c1, c2, c3 for each axis, flat.
    """
    error, grids = dynamic.error, []
    for axis, nodes in enumerate((dynamic.temp_c, dynamic.turn_rate)):
        grids.append(grid_of(nodes))
        error = np.moveaxis(_filled(grids[axis].nodes, nodes, np.moveaxis(error, axis, 0)), 0, axis)
    corner = error[:-1, :-1]
    over_temp, over_rate = error[1:, :-1] - corner, error[:-1, 1:] - corner
    both = error[1:, 1:] - error[1:, :-1] - over_rate
    return grids[0], grids[1], np.stack((corner, over_temp, over_rate, both), axis=-1).reshape(-1)


def _filled(fine: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values on the grid: the given ones at the given nodes, the straight line between them."""
    flat = values.reshape(len(nodes), -1)
    if len(fine) == len(nodes):
        return values
    filled = np.column_stack([np.interp(fine, nodes, column) for column in flat.T])
    filled[np.abs(fine[:, None] - nodes).argmin(axis=0)] = flat
    return filled.reshape(len(fine), *values.shape[1:])
