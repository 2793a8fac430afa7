"""The lead that takes a thermometer's lag off, as firmware evaluates it: the same filter as drift/temperature/lag.py, rewritten.

With d = x - z, how far the reading x is from its low-passed z, a = dt / smooth, and g = lag / smooth::

    d = e^-a d + m (x - x_before)     m = (1 - e^-a) / a          y = x + (g - 1) d

so that two numbers are carried, and d is small where the temperature is steady: float loses little.
"""

import math
from dataclasses import dataclass

from undrift.calibration.model import Calibration
from undrift.errors import InputError

STEP_BITS = 20  # behind the point of a step of time: 1 us, up to 2047 s
SHORTEST_S, LONGEST_S = 1e-3, 1e5  # smoothing that 32 bits hold with their accuracy
MOST_GAIN = 2.0**15


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """Constants of the lead.

    Parameters
    ----------
    lag_s, smooth_s : float
        The thermometer's time constant and what is left of it, s.
    """

    lag_s: float
    smooth_s: float

    @property
    def gain(self) -> float:
        """g - 1."""
        return self.lag_s / self.smooth_s - 1.0

    @property
    def rate(self) -> float:
        """One over the smoothing, 1/s."""
        return 1.0 / self.smooth_s

    @property
    def fixed_gain(self) -> int:
        """g - 1 with 16 bits behind the point."""
        return round(self.gain * 2**16)

    @property
    def rate_bits(self) -> int:
        """Bits behind the point of ``fixed_rate``."""
        return 30 - math.frexp(self.rate)[1]

    @property
    def fixed_rate(self) -> int:
        """One over the smoothing with ``rate_bits`` behind the point: 30 significant bits."""
        return round(self.rate * 2.0**self.rate_bits)

    @property
    def rate_shift(self) -> int:
        """How far the product of a step and ``fixed_rate`` is moved down to have 31 bits behind the point."""
        return self.rate_bits + STEP_BITS - 31


def lead_of(calibration: Calibration) -> Lead | None:
    """Return the lead that a calibration asks for.

    Parameters
    ----------
    calibration : Calibration
        The device's model.

    Returns
    -------
    Lead or None
        None without tables or without a lag.

    Raises
    ------
    InputError
        A smoothing or a ratio that fixed point does not hold.
    """
    drift = calibration.drift
    if drift is None or not drift.lag_s > 0.0 or (drift.static, drift.scale, drift.dynamic) == (None, None, None):
        return None
    smooth = drift.lag_smooth_s
    if not (SHORTEST_S <= smooth <= LONGEST_S and drift.lag_s / smooth <= MOST_GAIN):
        raise InputError(
            f"export c: wanted a lag smoothed over {SHORTEST_S:g} to {LONGEST_S:g} s, of at most {MOST_GAIN:g} times that, got "
            f"{drift.lag_s:g} s over {smooth:g} s; fit the lag again"
        )
    return Lead(lag_s=drift.lag_s, smooth_s=smooth)
