"""Low-pass: Butterworth, run forward and back over evenly spaced samples.

Order n in each direction, so n-th order poles twice and no delay. Two passes would be 6 dB down at the cut-off f_c, so each is
designed for f_c / (sqrt(2) - 1)^(1 / 2n) [1]_ and the two together are 3 dB down there::

    |H(f)|^2 = 1 / (1 + (sqrt(2) - 1) (f / f_c)^(2n))        amplitude of both passes, analogue prototype

References
----------
.. [1] D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed., 2009, section 3.4.4.2.
"""

import math

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

ORDER = 4  # in each direction: a quarter of the cut-off passes within 1e-5, so a signal is not booked as scale factor
_PAD = 3.0  # periods of the cut-off mirrored at each end


def zero_phase(x: FloatArray, cutoff_hz: float, *, sample_rate_hz: float, order: int = ORDER) -> FloatArray:
    """Return the columns of x low-pass filtered without delay.

    Parameters
    ----------
    x : array, shape (N, C)
        Evenly spaced samples without gaps, any unit.
    cutoff_hz : float
        Where both passes together are 3 dB down, Hz.
    sample_rate_hz : float
        Hz.
    order : int
        In each direction.

    Returns
    -------
    array, shape (N, C)
        As given, filtered.

    Raises
    ------
    InputError
        A cut-off that is not between 0 and half the sample rate.
    """
    from scipy.signal import butter, sosfiltfilt

    each = cutoff_hz / (math.sqrt(2.0) - 1.0) ** (0.5 / order)
    if not 0.0 < each < 0.5 * sample_rate_hz:
        highest = 0.5 * sample_rate_hz * cutoff_hz / each if cutoff_hz > 0.0 else 0.5 * sample_rate_hz
        raise InputError(
            f"low-pass: wanted a cut-off between 0 and {highest:.3g} Hz at {sample_rate_hz:.6g} samples/s, got {cutoff_hz:g} "
            "Hz; lower it, or filter nothing with None"
        )
    sections = butter(order, each, fs=sample_rate_hz, output="sos")
    pad = min(len(x) - 1, math.ceil(_PAD * sample_rate_hz / cutoff_hz))
    filtered: FloatArray = np.ascontiguousarray(sosfiltfilt(sections, x, axis=0, padtype="odd", padlen=pad))
    return filtered
