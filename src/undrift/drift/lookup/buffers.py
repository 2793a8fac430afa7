"""Where corrected readings are written: fresh arrays or the caller's, and the record that takes them over uncopied."""

import copy
from typing import TypeAlias

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.lookup.plan import Plans
from undrift.errors import InputError
from undrift.record import Record

Buffers: TypeAlias = tuple[FloatArray, FloatArray]  # rate, rad/s, and specific force, m/s2


def out_buffers(n: int, plans: Plans, out: Buffers | None) -> Buffers:
    """Return the arrays to write to.

    Parameters
    ----------
    n : int
        Samples.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    out : tuple of two arrays, shape (N, 3), or None
        The caller's own.

    Returns
    -------
    tuple of two arrays, shape (N, 3)
        The caller's, or fresh ones; an empty one for a triad that the record does not have.

    Raises
    ------
    InputError
        Buffers of another shape, type or order, or read-only ones.
    """
    if out is None:
        gyro, accel = (np.empty((0 if plan is None else n, 3)) for plan in plans)
        return gyro, accel
    for plan, buffer in zip(plans, out, strict=True):
        wanted = buffer.shape == (n, 3) and buffer.dtype == np.float64 and buffer.flags.c_contiguous
        if plan is not None and not (wanted and buffer.flags.writeable):
            raise InputError(
                f"correct: wanted writeable float64 buffers of shape ({n}, 3) in C order, got {buffer.dtype} {buffer.shape}; "
                "make them with numpy.empty"
            )
    return out


def flat(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return samples as the kernels take them.

    Parameters
    ----------
    values : array, shape (N, 3), or None
        Readings, any unit.
    start, stop : int
        Samples [start, stop).

    Returns
    -------
    array, shape (3 (stop - start),)
        A view, the same unit; empty for None.
    """
    return np.empty(0) if values is None else values[start:stop].reshape(-1)


def adopt(record: Record, plans: Plans, buffers: Buffers) -> Record:
    """Return the record with corrected readings. The kernels wrote them in the right shape, so they are neither copied nor checked.

    Parameters
    ----------
    record : Record
        Raw readings.
    plans : tuple of two TriadPlan or None
        Gyroscopes and accelerometers.
    buffers : tuple of two arrays, shape (N, 3)
        rad/s and m/s2.

    Returns
    -------
    Record
        rad/s and m/s2 in frame b, state corrected; it lives on the buffers.
    """
    done = copy.copy(record)
    for name, plan, buffer in zip(("gyro", "accel"), plans, buffers, strict=True):
        values = None
        if plan is not None:
            values = buffer.view()
            values.flags.writeable = False
        object.__setattr__(done, name, values)
    for name, text in (("gyro_unit", "rad/s"), ("accel_unit", "m/s2"), ("frame", "b"), ("state", "corrected")):
        object.__setattr__(done, name, text)
    return done
