"""Tables in the form that the correction kernels use."""

from typing import NamedTuple

from undrift.arrays import FloatArray


class Grid(NamedTuple):
    """Nodes of a table: ``inverse`` is the inverse of the step, or 0 if the steps differ and nodes are searched."""

    nodes: FloatArray
    start: float
    inverse: float
    cells: int

    @property
    def stop(self) -> float:
        """Return the last node."""
        return float(self.nodes[-1])


class Tables(NamedTuple):
    """Cell coefficients of a triad's tables, flat, with an empty array for a missing table."""

    offset_temp: Grid
    offset: FloatArray
    matrix_temp: Grid
    matrix: FloatArray
    error_temp: Grid
    error_rate: Grid
    error: FloatArray
