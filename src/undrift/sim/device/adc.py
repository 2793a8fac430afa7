"""ADC: ``code = round(v / step + inl(v))``, held to the codes there are.

step = span / 2^bits; signed converters span -reference to reference, unsigned ones 0 to reference. The integral
non-linearity is a bow of 4 p (1 - p) times its height, p the place in the span.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.sim.device.fields import quantity, settle

Rounding = Literal["nearest", "floor", "toward_zero"]
ROUNDINGS = ("nearest", "floor", "toward_zero")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adc:
    """Converter of one triad.

    Parameters
    ----------
    bits : int
        Width of a code.
    reference : float
        Output unit of the stage before it.
    signed : bool
        Codes run from -2^(bits - 1) to 2^(bits - 1) - 1, else from 0 to 2^bits - 1.
    rounding : str
        nearest, floor or toward_zero.
    inl_lsb : array, shape (3,)
        Height of the bow of the integral non-linearity, steps.
    codes : bool
        The reading is the code (count); else the code times the step, in the unit of the stage before it.
    """

    bits: int = quantity("", least=1)
    reference: float = quantity("{out}", least=1e-300)
    signed: bool = quantity("", None, True)
    rounding: Rounding = quantity("", None, "nearest")
    inl_lsb: FloatArray = quantity("", (3,), 0.0)
    codes: bool = quantity("", None, True)

    def __post_init__(self) -> None:
        settle(self)
        if self.rounding not in ROUNDINGS:
            raise InputError(f"adc: wanted rounding {', '.join(ROUNDINGS)}, got '{self.rounding}'; name one of them")

    @property
    def step(self) -> float:
        """One code step, output unit of the stage before it."""
        return (2.0 if self.signed else 1.0) * self.reference / 2.0**self.bits

    @property
    def code_limits(self) -> tuple[float, float]:
        """Least and greatest code."""
        half = 2.0 ** (self.bits - 1)
        return (-half, half - 1.0) if self.signed else (0.0, 2.0 * half - 1.0)


def converted(v: FloatArray, effect: Adc) -> tuple[FloatArray, BoolArray]:
    """Return the readings of a converter.

    Parameters
    ----------
    v : array, shape (N, 3)
        Output unit of the stage before it.
    effect : Adc
        The converter.

    Returns
    -------
    array, shape (N, 3)
        Codes, or codes times the step.
    array of bool, shape (N, 3)
        True where the code was held to the end of the range.
    """
    steps = v / effect.step
    low, high = effect.code_limits
    if effect.inl_lsb.any():
        place = (steps - low) / (high + 1.0 - low)
        steps = steps + effect.inl_lsb * 4.0 * place * (1.0 - place)
    code = rounded(steps, effect.rounding)
    held: BoolArray = (code < low) | (code > high)
    code = np.clip(code, low, high)
    return (code if effect.codes else code * effect.step), held


def rounded(steps: FloatArray, rounding: Rounding) -> FloatArray:
    """Return whole steps.

    Parameters
    ----------
    steps : array
        Values in steps.
    rounding : str
        nearest, floor or toward_zero.

    Returns
    -------
    array
        Whole numbers, same shape.
    """
    if rounding == "nearest":
        return np.rint(steps)
    whole: FloatArray = np.floor(steps) if rounding == "floor" else np.trunc(steps)
    return whole
