"""Low-pass filters for records: second-order Butterworth, causal or zero-phase.

The analogue prototype H(s) = 1 / (s^2 + sqrt(2) s + 1), s in units of the cut-off, by the bilinear transform with the cut-off
prewarped, k = tan(pi f_c / f_s)::

    H(z) = k^2 (1 + z^-1)^2 / (1 + sqrt(2) k + k^2 + 2 (k^2 - 1) z^-1 + (1 - sqrt(2) k + k^2) z^-2)

Zero-phase runs it forward and back. Two passes would be 6 dB down at f_c, so k is divided by (sqrt(2) - 1)^(1/4) = 0.802 [1]_ and
the two together are 3 dB down there.

References
----------
.. [1] D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed., 2009, section 3.4.4.2.
"""

import copy
import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Record

Readings = TypeVar("Readings", Record, FloatArray)

TWO_PASSES = (math.sqrt(2.0) - 1.0) ** 0.25
EDGE = 9  # samples mirrored at each end before a zero-phase pass: three times the section's length
BLOCK = 32_768  # samples
THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves
EVEN_WITHIN = 0.5  # of a step: a longer or shorter one is a drop-out or a doubled sample


class Biquad(NamedTuple):
    """Coefficients of one second-order section, a0 = 1.

    Parameters
    ----------
    b0, b1, b2 : float
        Numerator, 1.
    a1, a2 : float
        Denominator, 1.
    """

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


def butterworth(cutoff_hz: float, sample_rate_hz: float, *, zero_phase: bool = False) -> Biquad:
    """Return the second-order Butterworth low-pass.

    Parameters
    ----------
    cutoff_hz : float
        Where it is 3 dB down, Hz.
    sample_rate_hz : float
        Hz.
    zero_phase : bool
        Whether it will run forward and back.

    Returns
    -------
    Biquad
        Coefficients.

    Raises
    ------
    InputError
        A cut-off that is not between 0 and half the sample rate.
    """
    if not 0.0 < cutoff_hz < 0.5 * sample_rate_hz:
        raise InputError(
            f"low-pass: wanted a cut-off between 0 and {0.5 * sample_rate_hz:g} Hz, half the sample rate, got {cutoff_hz:g} Hz"
            "; lower it"
        )
    k = math.tan(math.pi * cutoff_hz / sample_rate_hz) / (TWO_PASSES if zero_phase else 1.0)
    a0 = 1.0 + math.sqrt(2.0) * k + k * k
    b0 = k * k / a0
    return Biquad(b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) / a0, (1.0 - math.sqrt(2.0) * k + k * k) / a0)


def lowpass(
    x: Readings, cutoff_hz: float, *, sample_rate_hz: float | None = None, zero_phase: bool = False
) -> Readings:
    """Filter readings with a second-order Butterworth low-pass.

    It starts settled on the first sample, so that a constant offset rings nowhere.

    Parameters
    ----------
    x : Record or array, shape (N, 3)
        Both triads of a record, or three channels in any unit.
    cutoff_hz : float
        Where the filter is 3 dB down, Hz; the same for zero-phase.
    sample_rate_hz : float, optional
        Hz; needed for an array, taken from a record.
    zero_phase : bool
        Forward and back: no delay, twice the order.

    Returns
    -------
    Record or array, shape (N, 3)
        As given, filtered.

    Raises
    ------
    InputError
        Gaps, uneven time, no sample rate, or a cut-off beyond half of it.
    """
    if isinstance(x, Record):
        section = butterworth(cutoff_hz, _even_rate_of(x), zero_phase=zero_phase)
        return _filtered_record(x, section, zero_phase)  # type: ignore[return-value]  # mypy imagines an array that is a Record
    if sample_rate_hz is None:
        raise InputError("low-pass: wanted the sample rate of the array, got none; give sample_rate_hz")
    if x.ndim != 2 or x.shape[1] != 3 or len(x) == 0:
        raise InputError(f"low-pass: wanted an array of shape (N, 3), got {x.shape}; time is axis 0")
    return _filtered(x, butterworth(cutoff_hz, sample_rate_hz, zero_phase=zero_phase), zero_phase, "readings")


def _even_rate_of(record: Record) -> float:
    step = record.duration_s / (len(record) - 1)
    blocks = (np.diff(record.time[start : start + BLOCK + 1]) for start in range(0, len(record) - 1, BLOCK))
    ranges = [(block.min(), block.max()) for block in blocks]  # block by block it stays in the processor's cache
    if min(r[0] for r in ranges) < (1.0 - EVEN_WITHIN) * step or max(r[1] for r in ranges) > (1.0 + EVEN_WITHIN) * step:
        steps = np.diff(record.time)
        step = float(np.median(steps))
        uneven = np.flatnonzero(np.abs(steps - step) > EVEN_WITHIN * step)
        at = record.time[uneven[0] if uneven.size else steps.argmax()]
        raise InputError(
            f"low-pass: wanted even time, got {max(uneven.size, 1)} uneven steps, the first at {at:.6g} s; "
            "filter each stretch by itself"
        )
    return 1.0 / step


def _filtered_record(record: Record, section: Biquad, zero_phase: bool) -> Record:
    done = copy.copy(record)
    work: list[tuple[str, FloatArray]] = [
        (name, values) for name, values in (("gyro", record.gyro), ("accel", record.accel)) if values is not None
    ]
    if len(work) == 2 and len(record) >= THREADS_FROM:  # a triad each: the kernel lets the other thread run
        with ThreadPoolExecutor(2) as pool:
            filtered = list(pool.map(lambda item: _filtered(item[1], section, zero_phase, item[0]), work))
    else:
        filtered = [_filtered(values, section, zero_phase, name) for name, values in work]
    for (name, _), values in zip(work, filtered, strict=True):
        values.flags.writeable = False
        object.__setattr__(done, name, values)
    return done


def _filtered(x: FloatArray, section: Biquad, zero_phase: bool, name: str) -> FloatArray:
    if not zero_phase:
        y = _pass(x, section)
    else:
        if len(x) <= EDGE:
            raise InputError(
                f"low-pass: wanted more than {EDGE} samples for zero phase, got {len(x)}; take a longer record"
            )
        mirrored = np.concatenate((2.0 * x[0] - x[EDGE:0:-1], x, 2.0 * x[-1] - x[-2 : -EDGE - 2 : -1]))
        back = _pass(_pass(mirrored, section)[::-1], section)[::-1]
        y = np.ascontiguousarray(back[EDGE:-EDGE])
    if not np.isfinite(y[0 if zero_phase else -1]).all():  # a gap never leaves a recursive filter
        raise InputError(f"low-pass: wanted {name} without gaps, got NaN; filter each stretch by itself")
    return y


def _pass(x: FloatArray, section: Biquad) -> FloatArray:
    from undrift.kernels.filter import biquad

    x = np.ascontiguousarray(x, dtype=np.float64)
    y = np.empty_like(x)
    biquad(x.reshape(-1), y.reshape(-1), *section, np.tile(x[0], 4))
    return y
