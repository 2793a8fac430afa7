"""What a study tries: a parameter is a name and a list of values, a candidate one value of each.

The first four are the note's: cut-off, step d, omega_m and omega_M; the step has to divide the span. The further ones keep the one
value of the device or of the plan's protocol unless a list is given. Cut-off, gain, quality, sampling rate and bits change the
device, and so the trial; the rest changes the session or its fit alone. A point is a candidate's values in the order of
``Space.names``. Sessions are read at 100 Hz, whatever the rate of the trial.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

Grid = tuple[float, float, float]
TURN_RATES = ("turn_rate_step", "turn_rate_min", "turn_rate_max")


class Kind(NamedTuple):
    """A further parameter."""

    heading: str  # With its unit, for tables
    least: float
    most: float = np.inf
    whole: bool = False  # Of whole numbers


FURTHER: dict[str, Kind] = {
    "gain": Kind("gain of the gyroscopes' amplifier", 1e-6),  # clipped motion against few codes
    "quality": Kind("Q of the low-pass", 0.5, 10.0),  # 0.58 Bessel, 0.71 Butterworth
    "sample_rate_hz": Kind("sampling rate (Hz)", 25.0, 400.0),
    "bits": Kind("bits of the converter", 4, 24, whole=True),
    "dwell_s": Kind("dwell (s)", 0.1),
    "bracket_s": Kind("rest around rates (s)", 0.1),
    "face_s": Kind("rest on a face (s)", 0.1),
    "faces": Kind("faces", 5, 6, whole=True),  # five leave out -z
    "poses": Kind("poses (number of the set)", 1, whole=True),  # of the plan's sets: faces, inclined ones, any number
    "places": Kind("set-points (number of the list)", 1, whole=True),  # of the plan's lists of temperatures
    "set_points": Kind("set-points", 1, whole=True),  # evenly from the plan's first to the warmest; 1: room temperature
    "warmest_c": Kind("warmest set-point (degC)", -40.0, 150.0),  # the plan's last where not given
    "soak_c_per_min": Kind("slope at the end of a soak (K/min)", 0.005, 1.0),
    "order": Kind("order of the rates (1 rising, 2 random)", 1, 2, whole=True),
    "static_step_c": Kind("static table step (K)", 0.01),
    "dynamic_step_c": Kind("dynamic table step (K)", 0.01),
}
OF_NOTE = {  # the first four, by their columns of a surface
    "cutoff_hz": "cut-off (Hz)",
    "turn_rate_step_dps": "step d (deg/s)",
    "turn_rate_min_dps": "omega_m (deg/s)",
    "turn_rate_max_dps": "omega_M (deg/s)",
}
# Every parameter that can be searched, as tables, figures and findings name it
HEADINGS = OF_NOTE | {name: kind.heading for name, kind in FURTHER.items()}
COMPARED_NAMES = (  # of the compensations of Figure 3, those of study/figure3.py
    "no compensation",
    "static",
    "static and dynamic",
    "offset re-zeroed at a rest",
    "static and dynamic, re-zeroed at a rest",
)
OF_DEVICE = ("gain", "quality", "sample_rate_hz", "bits")  # the first of them


class Setting(NamedTuple):
    """What is varied of the device; None keeps its own."""

    cutoff_hz: float
    gain: float | None = None
    quality: float | None = None
    sample_rate_hz: float | None = None
    bits: float | None = None

    @property
    def words(self) -> str:
        """The values, good for the name of a file."""
        more = (f"-{name}{value:g}" for name, value in zip(OF_DEVICE, self[1:], strict=True) if value is not None)
        return f"{self.cutoff_hz:g}{''.join(more)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Untried:
    """A value of the plan that no protocol has."""

    parameter: str  # turn_rate_step, turn_rate_min or turn_rate_max
    value: float  # rad/s
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The values that are tried."""

    cutoff_hz: tuple[float, ...]  # Of the low-pass
    turn_rate_step: tuple[float, ...]  # d, rad/s
    turn_rate_min: tuple[float, ...]  # omega_m, rad/s
    turn_rate_max: tuple[float, ...]  # omega_M, rad/s
    further: tuple[tuple[str, tuple[float, ...]], ...] = ()  # Names of ``FURTHER`` and their values, in its order
    # Of the combinations of the rates and what is further, but not of the device, these and no others, where given
    only: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if [name for name in FURTHER if name in dict(self.further)] != [name for name, _ in self.further]:
            names = ", ".join(name for name, _ in self.further)
            raise InputError(f"study: wanted further parameters among {', '.join(FURTHER)} in this order, got {names}")
        for name, values in self.further:
            kind = FURTHER[name]
            wrong = [v for v in values if not kind.least <= v <= kind.most or (kind.whole and v != round(v))]
            if wrong or not values:
                what = "whole numbers" if kind.whole else "numbers"
                got = f"{wrong[0]:g}" if wrong else "none"
                raise InputError(f"study: wanted {name} as {what} from {kind.least:g} to {kind.most:g}, got {got}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of a point's values."""
        return ("cutoff_hz", *TURN_RATES, *(name for name, _ in self.further))

    @property
    def values(self) -> tuple[tuple[float, ...], ...]:
        """What is listed for each of the names."""
        return (self.cutoff_hz, *(getattr(self, name) for name in TURN_RATES), *(values for _, values in self.further))

    def grids(self) -> Iterator[Grid]:
        """Return the combinations of step, omega_m and omega_M that are tried: the step divides the span."""
        if self.only:
            yield from dict.fromkeys((row[0], row[1], row[2]) for row in self.only)
            return
        for step, low, high in product(self.turn_rate_step, self.turn_rate_min, self.turn_rate_max):
            count = (high - low) / step
            if high > low and abs(count - round(count)) < 1e-6:
                yield step, low, high

    def settings(self) -> tuple[Setting, ...]:
        """Return what is tried of the device."""
        held = dict(self.further)
        of_device = [held.get(name, (None,)) for name in OF_DEVICE]
        return tuple(Setting(cutoff, *each) for cutoff in self.cutoff_hz for each in product(*of_device))

    def _others(self) -> list[tuple[float, ...]]:
        return [values for name, values in self.further if name not in OF_DEVICE]

    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Return the combinations of what is not of the device."""
        return self.only or tuple((*grid, *more) for grid in self.grids() for more in product(*self._others()))

    @property
    def count(self) -> int:
        """How many candidates there are."""
        grids = len(self.only) or sum(1 for _ in self.grids()) * prod(map(len, self._others()))
        return len(self.settings()) * grids

    @property
    def first(self) -> FloatArray:
        """The first candidate, (1, n)."""
        return np.array([[self.cutoff_hz[0], *next(self.grids()), *(values[0] for _, values in self.further)]])

    def points_at(self, setting: Setting) -> FloatArray:
        """Return the candidates with a setting of the device, (P, n)."""
        of_device = [value for value in setting[1:] if value is not None]
        return np.array([(setting.cutoff_hz, *row[:3], *of_device, *row[3:]) for row in self.rows()])

    def points(self) -> FloatArray:
        """Return all candidates, by setting, then by row, (P, n)."""
        return np.concatenate([self.points_at(setting) for setting in self.settings()])

    def setting_of(self, point: Sequence[float]) -> Setting:
        """Return what a candidate has of the device."""
        held = dict(zip(self.names, map(float, point), strict=True))
        return Setting(held["cutoff_hz"], *(held.get(name) for name in OF_DEVICE))

    def narrowed(self, points: FloatArray) -> "Space":
        """Return the space of some candidates (P, n) with one setting of the device."""
        setting = self.setting_of(points[0])
        first = 4 + sum(value is not None for value in setting[1:])
        own = {name: (value,) for name, value in setting._asdict().items() if value is not None}
        return replace(
            self,
            cutoff_hz=own.pop("cutoff_hz"),
            further=tuple((name, own.get(name, values)) for name, values in self.further),
            only=tuple((*map(float, point[1:4]), *map(float, point[first:])) for point in points),
        )

    def untried(self) -> tuple[Untried, ...]:
        """Return the rates and steps that no combination has, and why."""
        if self.only:
            return ()
        tried = list(self.grids())
        lows, highs = self.turn_rate_min, self.turn_rate_max
        rows = []
        for place, name in enumerate(TURN_RATES):
            for value in getattr(self, name):
                if any(grid[place] == value for grid in tried):
                    continue
                if name == "turn_rate_min" and value >= max(highs):
                    reason = "not below any omega_M"
                elif name == "turn_rate_max" and value <= min(lows):
                    reason = "not above any omega_m"
                elif name == "turn_rate_step":
                    reason = "divides no span from an omega_m to an omega_M"
                else:
                    reason = "no step divides a span that it ends"
                rows.append(Untried(parameter=name, value=value, reason=reason))
        return tuple(rows)
