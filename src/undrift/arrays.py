"""Arrays as values: checked once at birth, read-only from then on. Time is always axis 0."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undrift.errors import InputError

FloatArray: TypeAlias = NDArray[np.floating[Any]]  # float64 in practice: numpy's own functions promise no more
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]


def frozen(x: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Copy into a read-only float64 array of a stated shape."""
    try:
        array = np.array(x, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: wanted numbers, got {type(x).__name__}; {error}") from error
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
        raise InputError(
            f"{name}: wanted shape {wanted}, got {array.shape}; time is axis 0", wanted=shape, got=array.shape
        )
    if np.isinf(array).any():
        raise InputError(f"{name}: wanted finite numbers or NaN for a gap, got infinity; repair the file")
    array.flags.writeable = False
    return array


def interpolated(x: ArrayLike, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (n, ...) over nodes (n,) at points x (N,) or one point: straight lines between, held at the ends."""
    points = np.asarray(x, dtype=np.float64)
    columns = [np.interp(points, nodes, column) for column in values.reshape(len(nodes), -1).T]
    return np.stack(columns, axis=-1).reshape(*points.shape, *values.shape[1:])


def window_sums(values: FloatArray, width: int) -> FloatArray:
    """Return the sum over every window of ``width`` neighbouring rows of values (N, C): (N - width + 1, C)."""
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return np.asarray(total[width:] - total[:-width])
