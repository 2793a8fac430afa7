"""Arrays as values: they are checked once when they are created, and are read-only afterwards. Time is always axis 0."""

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, TypeAlias, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undrift.errors import InputError

FloatArray: TypeAlias = NDArray[np.floating[Any]]  # float64 in practice, which numpy's types do not guarantee
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]


def frozen(x: ArrayLike, shape: tuple[int | None, ...], name: str, kind: Any = np.float64) -> NDArray[Any]:
    """Return a read-only array of the given shape. The input is copied unless it is read-only and owns its data."""
    reusable = isinstance(x, np.ndarray) and x.flags.owndata and not x.flags.writeable
    try:
        array = np.array(x, dtype=kind, order="C", copy=None if reusable else True)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected numbers, got {type(x).__name__}. {error}.") from error
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
        advice = "Time is axis 0" if kind is np.float64 else "One mark is required for each node"
        raise InputError(
            f"{name}: expected shape {wanted}, got {array.shape}. {advice}.", wanted=shape, got=array.shape
        )
    if kind is np.float64 and np.isinf(array).any():
        raise InputError(f"{name}: expected finite numbers or NaN for a gap, got infinity. Repair the file.")
    array.flags.writeable = False
    return array


def bridged(time: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns (N, c) with gaps (NaN) filled by linear interpolation and end values extended.

    A row counts as a gap if any of its columns is NaN. At least one row must be complete.
    """
    finite = np.isfinite(columns).all(axis=1)
    return np.column_stack([np.interp(time, time[finite], column) for column in columns[finite].T])


def interpolated(x: ArrayLike, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate values (n, ...) over nodes (n,) linearly at points x, (N,) or scalar. Beyond the nodes, the end values apply."""
    points = np.asarray(x, dtype=np.float64)
    columns = [np.interp(points, nodes, column) for column in values.reshape(len(nodes), -1).T]
    return np.stack(columns, axis=-1).reshape(*points.shape, *values.shape[1:])


def runs(flag: BoolArray) -> IntArray:
    """Return the ranges [start, stop), (R, 2), in which a flag (N,) is set."""
    change = np.flatnonzero(np.diff(np.concatenate(([False], flag, [False])).astype(np.int8)))
    return change.reshape(-1, 2)


def window_sums(values: FloatArray, width: int) -> FloatArray:
    """Return the sum over every window of ``width`` neighbouring rows of values (N, C): (N - width + 1, C)."""
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return np.asarray(total[width:] - total[:-width])


@dataclass(frozen=True, slots=True, init=False)
class Shape:
    """Shape of an array field: ``Annotated[FloatArray, Shape("n", 3)]``. Within one value, equal letters mean equal lengths."""

    dims: tuple[int | str, ...]
    rising: bool  # True if the array has two or more increasing nodes
    gaps: bool  # True if a file may contain null, for NaN

    def __init__(self, *dims: int | str, rising: bool = False, gaps: bool = True) -> None:
        for name, value in (("dims", dims), ("rising", rising), ("gaps", gaps and not rising)):
            object.__setattr__(self, name, value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the nested lists in a file. Null marks a gap."""
        from pydantic_core import core_schema as cs

        kind = _kind_of(source)
        schema: Any = {bool: cs.bool_schema(), int: cs.int_schema(ge=0), float: cs.float_schema()}[kind]
        schema = cs.nullable_schema(schema) if self.gaps and kind is float else schema
        for length in reversed(self.dims):
            most = length if isinstance(length, int) else None
            schema = cs.list_schema(schema, min_length=2 if self.rising else most, max_length=most)
        schema = schema if type(None) not in get_args(source) else cs.nullable_schema(schema)
        return {**schema, "serialization": cs.plain_serializer_function_ser_schema(_nested_lists)}


def _nested_lists(array: NDArray[Any] | None) -> Any:
    """Return an array as nested lists, with null for NaN."""
    if array is None or array.dtype.kind != "f":
        return None if array is None else array.tolist()
    values: Any = array.astype(object)
    values[np.isnan(array)] = None
    return values.tolist()


def freeze(value: Any, **lengths: int) -> None:
    """Check the shapes of a dataclass's arrays and make the arrays read-only. ``lengths`` sets known lengths by letter."""
    cls: Any = type(value)
    for name, shape, kind in _shaped(cls):
        content = getattr(value, name)
        if content is None:
            continue
        what = f"{type(value).__name__}.{name}"
        wanted = tuple(lengths.get(d) if isinstance(d, str) else d for d in shape.dims)
        if isinstance(content, list) and not content and not wanted[0]:  # an empty list has no row length
            content = np.zeros((0, *(n or 0 for n in wanted[1:])))
        array = frozen(content, wanted, what, {float: np.float64, int: np.int64}.get(kind, kind))
        lengths |= {d: n for d, n in zip(shape.dims, array.shape, strict=True) if isinstance(d, str)}
        if shape.rising and (len(array) < 2 or not (np.diff(array) > 0.0).all()):
            raise InputError(
                f"{what}: expected two or more increasing nodes, got {len(array)}. Sort and merge the nodes."
            )
        object.__setattr__(value, name, array)


@cache
def _shaped(cls: Any) -> tuple[tuple[str, Shape, type], ...]:
    """Return name, shape and element type of each array field of a dataclass."""
    hints = get_type_hints(cls, include_extras=True)
    marks = (
        (f.name, next((m for m in get_args(hints[f.name])[1:] if isinstance(m, Shape)), None)) for f in fields(cls)
    )
    return tuple((name, mark, _kind_of(get_args(hints[name])[0])) for name, mark in marks if mark is not None)


def _kind_of(hint: Any) -> type:
    arrays = (hint, *get_args(hint))
    return bool if BoolArray in arrays else int if IntArray in arrays else float
