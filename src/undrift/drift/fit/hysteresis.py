"""Thermal hysteresis: offset while cooling against offset while warming.

The middle curve f and half the loop h are told together::

    y = f(T) + h c + e        c = +1 while cooling, -1 while warming, in between straight over ``reversal_c`` after a turn

so that an unequal number of blocks on the way up and on the way down does not pull the middle. Before the temperature has moved
by ``start_c`` the state is not known and c = 0.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.observe.observations import RestBlocks

_SIGNIFICANT = 3.0  # standard uncertainties, on one axis or more


@dataclass(frozen=True, slots=True, kw_only=True)
class HysteresisSettings:
    """When a sweep goes up and when down.

    Parameters
    ----------
    start_c : float
        Temperature has to move by this before a direction is told, degC.
    turn_c : float
        It has to come back by this from its extreme before the direction changes, degC; more than the thermometer's noise.
    reversal_c : float
        After a turn the loop is crossed over this much of temperature, degC.
    overlap_c : float
        Both directions have to have seen a common range as wide as this, degC.
    """

    start_c: float = 1.0
    turn_c: float = 1.0
    reversal_c: float = 4.0
    overlap_c: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """What the sweeps say about hysteresis.

    Parameters
    ----------
    half : array, shape (3,)
        h: offset while cooling minus offset while warming, over two, raw unit.
    uncertainty : array, shape (3,)
        Standard uncertainty.
    """

    half: FloatArray
    uncertainty: FloatArray

    @property
    def significant(self) -> bool:
        """Whether one axis or more exceeds three standard uncertainties."""
        return bool((np.abs(self.half) > _SIGNIFICANT * self.uncertainty).any())


def cooling(blocks: RestBlocks, settings: HysteresisSettings = HysteresisSettings()) -> FloatArray:
    """Return c of each block: where in the loop the device was.

    Parameters
    ----------
    blocks : RestBlocks
        n rows in the order of session and time.
    settings : HysteresisSettings
        What makes a turn.

    Returns
    -------
    array, shape (n,)
        -1 while warming, 1 while cooling, between just after a turn, 0 before the first move.
    """
    state = np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        state[rows] = _followed(blocks.temp_c[rows].tolist(), settings)
    return state


def both_ways(blocks: RestBlocks, state: FloatArray, settings: HysteresisSettings = HysteresisSettings()) -> bool:
    """Tell whether both directions have seen a common range of temperature.

    Parameters
    ----------
    blocks : RestBlocks
        n rows.
    state : array, shape (n,)
        As told by ``cooling``.
    settings : HysteresisSettings
        How wide the range has to be.

    Returns
    -------
    bool
        Whether a half loop can be told.
    """
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    if not len(up) or not len(down):
        return False
    return bool(min(up.max(), down.max()) - max(up.min(), down.min()) >= settings.overlap_c)


def _followed(temp_c: list[float], settings: HysteresisSettings) -> FloatArray:
    state = np.zeros(len(temp_c))
    way, low, high = 0, temp_c[0], temp_c[0]
    turned = False
    for k, temp in enumerate(temp_c):
        low, high = min(low, temp), max(high, temp)
        if way == 0:
            if temp - low >= settings.start_c:
                way, high = 1, temp
            elif high - temp >= settings.start_c:
                way, low = -1, temp
        elif way == 1 and high - temp > settings.turn_c:
            way, low, turned = -1, temp, True
        elif way == -1 and temp - low > settings.turn_c:
            way, high, turned = 1, temp, True
        if way == 0:
            continue
        back = (high - temp) if way == 1 else (temp - low)  # from the extreme of this leg
        gone = (temp - low) if way == 1 else (high - temp)  # since the turn before
        crossed = 2.0 * back / settings.reversal_c
        lacking = 2.0 - 2.0 * gone / settings.reversal_c if turned else 0.0
        state[k] = -way * (1.0 - min(2.0, max(crossed, lacking, 0.0)))
    return state
