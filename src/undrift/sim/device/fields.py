"""Fields of effects: every number knows its unit and shape, so that files can say the unit in the key.

In a unit, ``{x}`` stands for what the sensor measures (rad_s or m_s2) and ``{out}`` for the unit it puts out (v, count,
dps, g ...). Scalars are spread over the three axes.
"""

from dataclasses import MISSING, field, fields
from typing import Any

import numpy as np

from undrift.arrays import frozen
from undrift.errors import InputError

Shape = tuple[int | None, ...]


def quantity(unit: str = "", shape: Shape | None = None, default: Any = MISSING, *, least: float | None = None) -> Any:
    """Return a dataclass field that knows its unit and shape.

    Parameters
    ----------
    unit : str
        Written behind the name in a file; "" for a number without unit or for text.
    shape : tuple of int or None, optional
        Shape of an array; a plain value where not given.
    default : object
        Value where none is given; the field is required without it.
    least : float, optional
        Smallest value allowed.

    Returns
    -------
    Field
        For a frozen dataclass that calls ``settle``.
    """
    return field(default=default, metadata={"unit": unit, "shape": shape, "least": least})


def settle(value: Any) -> None:
    """Check the fields of an effect and make its arrays read-only; to be called at its birth.

    Parameters
    ----------
    value : dataclass
        Whose fields were made by ``quantity``.

    Raises
    ------
    InputError
        A shape or a value that is not allowed.
    """
    for f in fields(value):
        shape, least, given = f.metadata.get("shape"), f.metadata.get("least"), getattr(value, f.name)
        name = f"{type(value).__name__}.{f.name}"
        if shape is not None:
            spread = given if None in shape or np.ndim(given) else np.full(shape, given)
            spread = spread if np.size(spread) else np.zeros([n or 0 for n in shape])
            given = frozen(spread, shape, name)
            object.__setattr__(value, f.name, given)
        if least is not None and given is not None and not np.all(np.asarray(given) >= least):
            raise InputError(f"{name}: wanted {least:g} or more, got {np.min(given):g}; correct the device")
