"""Warm-up: what a device that was switched on a short while ago adds to its settled offset.

::

    y = f(T) + A exp(-t / tau) + e        t since power-on, A one a sensor, tau of the device

tau is the one with the least squares of residuals on a grid, all axes together, beside a spline over temperature. The curve f
explains any change that goes with temperature, so A is seen only where time and temperature are not the same thing: on a soak at
one temperature, or in several warm-ups from different temperatures.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import WarmUp
from undrift.drift.observe.observations import RestBlocks
from undrift.errors import NotObservable

_LEAST_OWN = 0.05  # of the variance of exp(-t / tau) that temperature does not explain
_KNOTS = 6
_NODES = 13
_SPAN = 5.0  # time constants that a table covers


def warm_up_time(blocks: RestBlocks, value: FloatArray, *, least_s: float = 30.0, most_s: float = 3600.0) -> float:
    """Return the time constant of the warm-up.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    value : array, shape (n, 3)
        Offsets, raw unit; no NaN.
    least_s, most_s : float
        Range to search, s.

    Returns
    -------
    float
        tau, s.

    Raises
    ------
    NotObservable
        Time since power-on and temperature are the same thing in these sessions.
    """
    smooth = _smooth_basis(blocks.temp_c)
    constants = np.geomspace(least_s, most_s, 25)
    misfit, own = np.zeros(len(constants)), np.zeros(len(constants))
    left = _without(smooth, value)
    scale = left.var(axis=0)
    for k, tau in enumerate(constants):
        fading = np.exp(-blocks.power_on_s / tau)[:, None]
        rest = _without(smooth, fading)
        own[k] = rest.var() / max(float(fading.var()), 1e-300)
        explained = (rest.T @ left)[0] ** 2 / max(float((rest**2).sum()), 1e-300)
        misfit[k] = -float((explained / np.maximum(scale, 1e-300)).sum())
    best = int(np.argmin(misfit))
    if own[best] < _LEAST_OWN:
        raise NotObservable(
            f"warm-up: wanted temperature and time since power-on that differ, got {100.0 * (1.0 - own[best]):.1f} % of the one "
            "explained by the other; hold one temperature for half an hour after power-on, or warm up from two temperatures",
            share=float(own[best]),
        )
    return float(constants[best])


def warm_up_table(time_constant_s: float, amplitude: FloatArray) -> WarmUp:
    """Return the warm-up as a table that ends at zero.

    Parameters
    ----------
    time_constant_s : float
        tau, s.
    amplitude : array, shape (3,)
        A, raw unit.

    Returns
    -------
    WarmUp
        Over five time constants, linear between nodes.
    """
    time = time_constant_s * _SPAN * np.linspace(0.0, 1.0, _NODES) ** 1.5
    fading = np.exp(-time / time_constant_s)
    fading[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=fading[:, None] * amplitude)


def _smooth_basis(temp_c: FloatArray) -> FloatArray:
    x = (temp_c - temp_c.min()) / max(float(np.ptp(temp_c)), 1e-9)
    knots = np.linspace(0.0, 1.0, _KNOTS)[1:-1]
    return np.column_stack([x**power for power in range(4)] + [np.maximum(x - knot, 0.0) ** 3 for knot in knots])


def _without(basis: FloatArray, values: FloatArray) -> FloatArray:
    left: FloatArray = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return left
