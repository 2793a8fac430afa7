"""Rate-dependent drift, the note's dynamic drift: ``y = x + e(x, T)`` with ``e = sum_pq c_pq x^p D^q``, p = 1, 2, ..."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateDrift:
    """Error that grows with the rate and changes with temperature.

    Parameters
    ----------
    coefficients : array, shape (P, Q, 3)
        c_pq: power p = 1..P of the rate, q = 0..Q-1 of the warmth; rad/s over (rad/s)^p K^q.
    """

    coefficients: FloatArray = quantity("{x}_by_powers_of_{x}_and_k", (None, None, 3))

    def __post_init__(self) -> None:
        settle(self)

    def error(self, x: FloatArray, warmth: FloatArray) -> FloatArray:
        """Return e(x, T).

        Parameters
        ----------
        x : array, shape (N, 3)
            Rate, nominal input units.
        warmth : array, shape (N,)
            Temperature above reference, K.

        Returns
        -------
        array, shape (N, 3)
            Nominal input units.
        """
        total = np.zeros_like(x)
        for powers in self.coefficients[::-1]:
            inner = np.zeros_like(x)
            for row in powers[::-1]:
                inner = inner * warmth[:, None] + row
            total = (total + inner) * x
        return total
