"""Strapdown: integrate rate into orientation by the exact exponential of each step.

::

    q_nb[k] = q_nb[k-1] (x) exp(w_b[k] (t[k] - t[k-1]))

The rate of sample k holds on (k-1, k]. With bounded rates the error of this rule against the true motion is one half-sample
lag, which the lag search of validation takes up.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError


def check_gaps(gyro_b: FloatArray, time: FloatArray, what: str) -> None:
    """Refuse a rate with gaps: no orientation can be carried over one.

    Parameters
    ----------
    gyro_b : array, shape (N, 3)
        rad/s, NaN where there is none.
    time : array, shape (N,)
        s.
    what : str
        Begins the message.

    Raises
    ------
    InputError
        Any gap; says how many samples, and where the first stretch of them lies.
    """
    gap: BoolArray = ~np.isfinite(gyro_b).all(axis=1).reshape(-1)
    if not gap.any():
        return
    first = int(gap.argmax())
    after = np.flatnonzero(~gap[first:])
    last = first + int(after[0]) - 1 if len(after) else len(gap) - 1
    raise InputError(
        f"{what}: wanted a rate at every sample, got a gap (NaN) at {int(gap.sum())} of {len(gap)}, the first stretch from "
        f"{time[first]:.6g} to {time[last]:.6g} s; after a gap the orientation is unknown: correct without gaps (policy hold, "
        "temperatures filled in), or take each stretch between gaps with a rest of its own",
        gaps=int(gap.sum()),
        first_s=float(time[first]),
        last_s=float(time[last]),
    )


def integrate_strapdown(
    gyro_b: FloatArray, time: FloatArray, q_nb: FloatArray, *, out: FloatArray | None = None
) -> FloatArray:
    """Integrate angular rate from an initial orientation.

    Parameters
    ----------
    gyro_b : array, shape (N, 3)
        Corrected rate, rad/s, frame b, no gaps.
    time : array, shape (N,)
        s, strictly increasing.
    q_nb : array, shape (4,)
        Orientation at the first sample, w-x-y-z.
    out : array, shape (N, 4), optional
        Where to write, float64 in C order; saves a fresh array.

    Returns
    -------
    array, shape (N, 4)
        q_nb at every sample, unit length.

    Raises
    ------
    InputError
        Shapes that disagree, or gaps in the rate.

    References
    ----------
    .. [1] J. E. Bortz, "A new mathematical formulation for strapdown inertial navigation", 1971: constant-axis case.
    """
    from undrift.kernels.rotation import strapdown

    if gyro_b.shape != (len(time), 3) or np.shape(q_nb) != (4,):
        raise InputError(
            f"strapdown: wanted gyro (N, 3), time (N,), q (4,), got {gyro_b.shape}, {time.shape}, {np.shape(q_nb)}"
        )
    q = np.empty((len(time), 4)) if out is None else out
    if q.shape != (len(time), 4) or q.dtype != np.float64 or not q.flags.c_contiguous:
        raise InputError(
            f"strapdown: wanted a float64 buffer of shape ({len(time)}, 4) in C order, got {q.dtype} {q.shape}; make it "
            "with numpy.empty"
        )
    gyro = np.ascontiguousarray(gyro_b, dtype=np.float64).reshape(-1)
    strapdown(gyro, np.ascontiguousarray(time, dtype=np.float64), np.array(q_nb, dtype=np.float64), q.reshape(-1))
    if not np.isfinite(q[-1]).all():  # a gap never leaves the product, so the last sample tells of all
        raise InputError(
            "strapdown: wanted a rate at every sample, got gaps; integrate each stretch between gaps by itself"
        )
    return q
