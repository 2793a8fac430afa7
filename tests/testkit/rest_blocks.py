"""Blocks of rest by their temperatures and readings, with all other columns at their plainest."""

import numpy as np

from undrift.drift.observe import RestBlocks


def rest_blocks(temp_c, gyro, *, accel=None, noise=1e-3, time=None, **columns):
    """Return blocks 10 s apart in one pose, with noise of a standard deviation in every mean. ``columns`` replace others."""
    n = len(temp_c)
    clock = 10.0 * np.arange(n) if time is None else time
    plain = {
        "session": np.zeros(n, np.int64),
        "pose": np.zeros(n, np.int64),
        "time": clock,
        "power_on_s": clock,
        "temp_c": np.asarray(temp_c, float),
        "ramp_c_per_min": np.zeros(n),
        "gyro": gyro,
        "accel": np.full((n, 3), np.nan) if accel is None else accel,
        "gyro_variance": np.full((n, 3), noise**2),
        "accel_variance": np.full((n, 3), noise**2),
        "gyro_step_error": np.zeros((n, 3)),
        "accel_step_error": np.zeros((n, 3)),
    }
    return RestBlocks(**plain | columns)


def curve_uncertainty(triad):
    """Return the standard uncertainty of the curve of a triad itself, the mean over visits, (n, 3)."""
    return np.sqrt(np.maximum(triad.uncertainty**2 - triad.visit**2, 0.0))
