"""Where a record meets nodes that no data were near, and how uncertain the tables say they are there.

A value between two nodes draws on both, a value on a node on that one alone. A table is therefore looked at in halves: 2 i stands
for node i, 2 i + 1 for what lies between nodes i and i + 1, and a half is extrapolated where any node that it draws on is.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import DriftTables, DynamicDrift, TriadModel
from undrift.drift.lookup.cells import EVEN_WITHIN, grid_of
from undrift.units import si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid

Kind = Literal["rate", "accel", "scale"]
Triad = Literal["rate", "accel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """Largest standard uncertainties that tables state at the extrapolated nodes that were met; 0 where none was met.

    Infinite where such a node was met and the table states nothing.

    Parameters
    ----------
    rate : float
        Of the rate, rad/s: offsets of the gyroscopes and the dynamic table.
    accel : float
        Of the specific force, m/s2: offsets of the accelerometers.
    scale : float
        Of either as a share of itself, 1: matrices over temperature.
    """

    rate: float = 0.0
    accel: float = 0.0
    scale: float = 0.0

    def joined(self, other: "Stated") -> "Stated":
        """Return the larger of both.

        Parameters
        ----------
        other : Stated
            Of other samples, or of another table.

        Returns
        -------
        Stated
            Of them together.
        """
        return Stated(
            rate=max(self.rate, other.rate), accel=max(self.accel, other.accel), scale=max(self.scale, other.scale)
        )


NONE_MET = Stated()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Doubt:
    """A table with extrapolated nodes, as the kernels take it.

    Parameters
    ----------
    kind : str
        What its uncertainty is of: rate, accel or scale.
    temp : Grid
        Temperatures.
    rate : Grid or None
        Measured rates, rad/s; None for a table over temperature alone.
    stated : array, shape (halves,), or (temperature halves * rate halves,)
        Standard uncertainty, -1 where data were near, infinite where none is stated; rad/s, m/s2 or 1.
    """

    kind: Kind
    temp: "Grid"
    rate: "Grid | None"
    stated: FloatArray


def triad_doubts(drift: DriftTables | None, model: TriadModel, quantity: Triad) -> tuple[Doubt, ...]:
    """Make a triad's tables ready for the kernels that look for extrapolated nodes.

    Uncertainties u of offsets become those of the result by the constant matrix M, sqrt(M^2 u^2), those U of a matrix a share of
    the result, sqrt(U^2 K^2) with K = M^-1 (squares by element); the largest axis counts.

    Parameters
    ----------
    drift : DriftTables or None
        The device's tables.
    model : TriadModel
        The triad's model.
    quantity : str
        "rate" for the gyroscopes, "accel" for the accelerometers.

    Returns
    -------
    tuple of Doubt
        The tables that have such nodes, and only these.
    """
    found: tuple[Doubt, ...] = ()
    if drift is None:
        return found
    gyro, static, scale, dynamic = quantity == "rate", drift.static, drift.scale, drift.dynamic
    if static is not None and (static.gyro_offset if gyro else static.accel_offset) is not None:
        marks = static.gyro_extrapolated if gyro else static.accel_extrapolated
        u = static.gyro_uncertainty if gyro else static.accel_uncertainty
        squares = (model.matrix * si_factor(model.unit_out, quantity)).T ** 2
        found += _line(quantity, static.temp_c, marks, None if u is None else np.sqrt(u**2 @ squares).max(axis=1))
    if scale is not None and (scale.gyro_matrix if gyro else scale.accel_matrix) is not None:
        marks = scale.gyro_extrapolated if gyro else scale.accel_extrapolated
        u = scale.gyro_uncertainty if gyro else scale.accel_uncertainty
        squares = model.forward_matrix**2
        found += _line("scale", scale.temp_c, marks, None if u is None else np.sqrt(u**2 @ squares).max(axis=(1, 2)))
    return found + _plane(dynamic) if gyro and dynamic is not None else found


def mark_extrapolated(
    doubts: tuple[Doubt, ...], temp_c: FloatArray, span_c: tuple[float, float], corrected: FloatArray, mask: BoolArray
) -> Stated:
    """Mark the samples that draw on extrapolated nodes of one triad's tables.

    Parameters
    ----------
    doubts : tuple of Doubt
        The triad's tables that have such nodes.
    temp_c : array, shape (N,)
        What the tables are looked up with, degC.
    span_c : tuple of float
        From the least to the greatest temperature that the record has and the tables hold, degC; samples beyond are outside,
        not extrapolated.
    corrected : array, shape (3 N,)
        Corrected rate, rad/s, by which the cell of the dynamic table is found; it differs from the measured one by the error
        that the table holds, far less than a cell.
    mask : array of bool, shape (N,)
        Set to True there.

    Returns
    -------
    Stated
        The largest uncertainty that the tables state there.
    """
    from undrift.kernels.correct import mark_line, mark_plane

    met = NONE_MET
    low, high = span_c
    for doubt in doubts:
        if not _may_meet(doubt, low, high):  # most records stay where data were near
            continue
        if doubt.rate is None:
            largest = mark_line(temp_c, low, high, doubt.temp, doubt.stated, mask)
        else:
            largest = mark_plane(temp_c, corrected, low, high, doubt.temp, doubt.rate, doubt.stated, mask)
        met = met.joined(Stated(**{doubt.kind: max(float(largest), 0.0)}))
    return met


def _may_meet(doubt: Doubt, low: float, high: float) -> bool:
    """Whether any half from the least to the greatest temperature is extrapolated."""
    from undrift.kernels.correct import half

    if not low <= high:  # all outside, or gaps alone
        return False
    rows = doubt.stated.reshape(2 * doubt.temp.cells + 1, -1)
    return bool((rows[int(half(doubt.temp, low)) : int(half(doubt.temp, high)) + 1] >= 0.0).any())


def _line(kind: Kind, temp_c: FloatArray, marks: BoolArray | None, u: FloatArray | None) -> tuple[Doubt, ...]:
    """A table over temperature, where a node of it is extrapolated."""
    if marks is None or not marks.any():
        return ()
    grid = grid_of(temp_c)
    return (Doubt(kind=kind, temp=grid, rate=None, stated=_halves(grid, temp_c, _at_nodes(marks, u))),)


def _plane(dynamic: DynamicDrift) -> tuple[Doubt, ...]:
    """The dynamic table, where a node of it is extrapolated."""
    if dynamic.extrapolated is None or not dynamic.extrapolated.any():
        return ()
    stated = _at_nodes(dynamic.extrapolated, None if dynamic.uncertainty is None else dynamic.uncertainty.max(axis=2))
    temp, rate = grid_of(dynamic.temp_c), grid_of(dynamic.turn_rate)
    stated = _halves(rate, dynamic.turn_rate, _halves(temp, dynamic.temp_c, stated).T).T
    return (Doubt(kind="rate", temp=temp, rate=rate, stated=np.ravel(stated)),)


def _at_nodes(marks: BoolArray, uncertainty: FloatArray | None) -> FloatArray:
    """Uncertainty at the marked nodes, -1 at the others."""
    stated = (
        np.full(marks.shape, np.inf) if uncertainty is None else np.nan_to_num(uncertainty, nan=np.inf, posinf=np.inf)
    )
    return np.where(marks, stated, -1.0)


def _halves(grid: "Grid", nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values on and between the grid's nodes, along the first axis: the larger of the given nodes that each draws on."""
    fine = grid.nodes
    at = np.empty(2 * len(fine) - 1)
    at[::2], at[1::2] = fine, 0.5 * (fine[1:] + fine[:-1])
    near = 2.0 * EVEN_WITHIN * float(np.diff(fine).min())
    left = np.searchsorted(nodes, at + near, side="right") - 1
    right = np.searchsorted(nodes, at - near, side="left")
    drawn: FloatArray = np.maximum(values[left], values[right])
    return drawn
