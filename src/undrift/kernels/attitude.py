"""Attitude by VQF [1]_, offline, over a whole recording.

.. [1] D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
   rejection", Information Fusion 91, 187-204, 2023, and the package ``vqf``.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

MIN_OFFSET_SIGMA_DPS = 1e-3  # smallest prior of the offset (below it, the filter follows changes too slowly)
ACC_S = 3.0  # time constant with which the inclination follows the accelerometers, s
UNEVEN = 0.1  # largest deviation from the median step without interpolation to an even grid


def filtered_attitude(
    time: FloatArray, rate: FloatArray, force: FloatArray, mag_ut: FloatArray | None = None, *, offset_sigma: float
) -> tuple[FloatArray, float]:
    """Return q_nb (N, 4), and the share of time in which the magnetic field was disturbed.

    Rates (N, 3) are in rad/s, specific force (N, 3) in m/s2. Without the field (N, 3) the heading drifts. ``offset_sigma`` is the
    standard uncertainty of the rate's offset, rad/s.
    """
    from scipy.spatial.transform import Rotation, Slerp

    try:
        from vqf import offlineVQF
    except ImportError as error:
        raise InputError(
            "the filter needs the package vqf, which is not installed. Use `method` strapdown, or run pip install vqf with Python "
            "3.11 to 3.13."
        ) from error

    values = np.hstack((rate, force) if mag_ut is None else (rate, force, mag_ut))
    steps, even = np.diff(time), time
    step = float(np.median(steps))
    if uneven := bool((np.abs(steps - step) > UNEVEN * step).any()):
        even = np.arange(time[0], time[-1] + step, step)
        values = np.stack([np.interp(even, time, column) for column in values.T], axis=1)
    else:
        step = float(time[-1] - time[0]) / len(steps)
    sigma_dps = max(offset_sigma / RADIAN_PER_DEGREE, MIN_OFFSET_SIGMA_DPS)
    gyr, acc, *mag = (
        np.ascontiguousarray(columns) for columns in np.split(values, range(3, values.shape[1], 3), axis=1)
    )
    out = offlineVQF(gyr, acc, mag[0] if mag else None, step, {"biasSigmaInit": sigma_dps, "tauAcc": ACC_S})
    q: FloatArray = out["quat9D" if mag else "quat6D"]
    disturbed = float(out["magDistDetected"].mean()) if mag else 0.0
    if uneven:
        between = Slerp(even, Rotation.from_quat(q, scalar_first=True))
        q = np.asarray(between(np.minimum(time, even[-1])).as_quat(scalar_first=True))
    return q, disturbed
