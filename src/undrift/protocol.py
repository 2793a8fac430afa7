"""Protocol: what a calibration session is to do: faces, rates, temperatures, for how long and in which order.

Grid of rates, as the note counts them (omega_m, omega_M, step d)::

    paper       (rate_min, rate_max] both ways on three axes: N = 6 (rate_max - rate_min) / step       102, 84, 294
    inclusive   [rate_min, rate_max]                                                                   108, 90, 300
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.session import FACES, Axis, Face

GridRule = Literal["paper", "inclusive"]
Order = Literal["alternating", "random"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """What a calibration session is to do.

    Parameters
    ----------
    name : str
        For people.
    faces : tuple of str
        Faces to rest on, in order; none leaves the accelerometers out.
    face_s : float
        Rest on each, s.
    turn_rate_min, turn_rate_max, turn_rate_step : float
        omega_m, omega_M and d of the note, rad/s; a step of 0 leaves the rates out.
    grid : str
        paper leaves omega_m itself out, as the note's count does; inclusive keeps it.
    axes : tuple of str
        Case axes to turn about, in order; the device is mounted anew for each.
    order : str
        alternating takes the rates upward, each both ways; random draws the order.
    dwell_s : float or None
        Steady part of each rate, s; None is as long as ``turn_rate_uncertainty`` needs.
    turn_rate_uncertainty : float or None
        Wanted standard uncertainty of a dwell's mean rate, rad/s.
    whole_turns : bool
        Lengthen dwells to whole turns, where gravity or the Earth's rate would not average out.
    bracket_s : float
        Rest at zero rate before and after each block of rates, s: shows the drift.
    cutoff_hz : float
        Bandwidth of the device's low-pass, Hz: says how long it settles.
    temperatures_c : tuple of float
        Chamber set-points, degC; none stays at room temperature.
    soak_c_per_min : float
        A set-point counts as reached below this slope, K/min.
    acceleration : float
        Of the table, rad/s2.
    seed : int
        Of the random order.
    """

    name: str = ""
    faces: tuple[Face, ...] = FACES
    face_s: float = 6.0
    turn_rate_min: float = 0.0
    turn_rate_max: float = 0.0
    turn_rate_step: float = 0.0
    grid: GridRule = "inclusive"
    axes: tuple[Axis, ...] = AXES
    order: Order = "alternating"
    dwell_s: float | None = 6.0
    turn_rate_uncertainty: float | None = None
    whole_turns: bool = False
    bracket_s: float = 6.0
    cutoff_hz: float = 11.1
    temperatures_c: tuple[float, ...] = ()
    soak_c_per_min: float = 0.1
    acceleration: float = 40.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("face_s", 0.0), ("bracket_s", 0.0), ("cutoff_hz", 1e-3), ("soak_c_per_min", 1e-6)):
            if not least <= getattr(self, name) < np.inf:
                raise InputError(f"protocol: wanted {name} of {least:g} or more, got {getattr(self, name):g}")
        if not 0.0 < self.acceleration < np.inf:
            raise InputError(f"protocol: wanted an acceleration above 0, got {self.acceleration:g} rad/s2")
        if self.dwell_s is not None and not 0.0 < self.dwell_s < np.inf:
            raise InputError(f"protocol: wanted dwell_s above 0, got {self.dwell_s:g} s")
        if self.turn_rate_step > 0.0:
            self.turn_rates()
            if self.dwell_s is None and self.turn_rate_uncertainty is None:
                raise InputError("protocol: wanted dwell_s or turn_rate_uncertainty, got neither; state one of them")
        elif not self.faces:
            raise InputError("protocol: wanted faces or rates, got neither; there is nothing to do")
        if any(b <= a for a, b in pairwise(self.temperatures_c)):
            raise InputError("protocol: wanted rising temperatures, got others; sort them and name each once")

    def turn_rates(self) -> FloatArray:
        """Return the rates of one axis, both signs.

        Returns
        -------
        array, shape (N / 3,)
            rad/s, increasing; empty where the protocol has no rates.
        """
        if self.turn_rate_step <= 0.0:
            return np.empty(0)
        return rate_grid(self.turn_rate_min, self.turn_rate_max, self.turn_rate_step, rule=self.grid)


def rate_grid(rate_min: float, rate_max: float, step: float, *, rule: GridRule = "inclusive") -> FloatArray:
    """Return the rates of one axis, both signs; three axes make the note's N columns.

    Parameters
    ----------
    rate_min, rate_max, step : float
        Least and greatest rate and the increment, all in one unit.
    rule : str
        paper leaves rate_min itself out, as the note's count of 102 does; inclusive keeps it.

    Returns
    -------
    array, shape (N / 3,)
        Increasing, negative rates first, in the unit given.

    Raises
    ------
    InputError
        Limits that are not 0 < rate_min < rate_max, or a step that does not divide the span.
    """
    if not (0.0 < rate_min < rate_max and step > 0.0):
        raise InputError(
            f"rate grid: wanted 0 < rate_min < rate_max and a positive step, got {rate_min:g}, {rate_max:g}, {step:g}"
        )
    steps = round((rate_max - rate_min) / step)
    if abs(steps * step - (rate_max - rate_min)) > 1e-6 * step:
        raise InputError(
            f"rate grid: wanted a step that divides {rate_max - rate_min:g}, got {step:g}; "
            f"try {(rate_max - rate_min) / max(1, steps):g}"
        )
    first = 1 if rule == "paper" else 0
    positive = rate_min + step * np.arange(first, steps + 1)
    return np.concatenate((-positive[::-1], positive))
