"""Amplifier: ``v = null + gain S x``, held between its rails. S is the sensor's nominal sensitivity."""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.sim.device.fields import quantity, settle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Amplifier:
    """Gain and rails.

    Parameters
    ----------
    gain : float
        Output unit per output unit of the sensor.
    null : float
        Output at zero signal, output unit.
    low, high : float
        Rails, output unit; infinite for none.
    """

    gain: float = quantity("", None, 1.0)
    null: float = quantity("{out}", None, 0.0)
    low: float = quantity("{out}", None, -math.inf)
    high: float = quantity("{out}", None, math.inf)

    def __post_init__(self) -> None:
        settle(self)
        if not (self.gain > 0.0 and self.low < self.null < self.high):
            raise InputError(
                f"amplifier: wanted a gain above 0 and a null between the rails, got gain {self.gain:g} and null {self.null:g} "
                f"between {self.low:g} and {self.high:g}; correct the device"
            )


def amplified(x: FloatArray, effect: Amplifier, sensitivity: float) -> tuple[FloatArray, BoolArray]:
    """Return a signal held to what the amplifier can put out.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : Amplifier
        Gain and rails.
    sensitivity : float
        Nominal, of the sensor, output unit per input unit.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    array of bool, shape (N, 3)
        True where a rail held it.
    """
    total = effect.gain * sensitivity
    low, high = (effect.low - effect.null) / total, (effect.high - effect.null) / total
    held: BoolArray = (x < low) | (x > high)
    return np.clip(x, low, high), held
