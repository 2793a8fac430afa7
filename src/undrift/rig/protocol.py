"""Protocol: what a calibration session is to do: faces, rates, temperatures, for how long and in which order.

Grid of rates, as the note counts them (omega_m, omega_M, step d)::

    paper       (rate_min, rate_max] both ways on three axes: N = 6 (rate_max - rate_min) / step       102, 84, 294
    inclusive   [rate_min, rate_max]                                                                   108, 90, 300

protocol.toml: what a calibration session is to do.

[protocol]
name = "sit-to-stand"
cutoff_hz = 11.1                    # the device's low-pass: how long it settles
[faces]                             # leave out for none
order = ["+x", "-x", "+y", "-y", "+z", "-z"]
seconds = 6.0
[rates]                             # leave out for none
turn_rate_min_dps = 5.0
turn_rate_max_dps = 90.0
turn_rate_step_dps = 5.0
grid = "paper"                      # paper leaves the least rate out | inclusive
axes = ["x", "y", "z"]
order = "alternating"               # or random, with seed
seconds = 6.0                       # of a dwell, or turn_rate_uncertainty_dps
bracket_s = 6.0                     # rest before and after each block
whole_turns = false
acceleration_dps2 = 2300.0
[temperatures]                      # leave out for room temperature
set_points_c = [18.0, 30.0, 45.0, 60.0, 75.0]
soak_c_per_min = 0.1
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import Entry, read_toml, write_whole
from undrift.record import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

GridRule = Literal["paper", "inclusive"]
Order = Literal["alternating", "random"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """What a calibration session is to do."""

    name: str = ""  # For people
    faces: tuple[Face, ...] = FACES  # Faces to rest on, in order; none leaves the accelerometers out
    face_s: float = 6.0  # Rest on each, s
    turn_rate_min: float = 0.0  # omega_m, omega_M and d of the note, rad/s; a step of 0 leaves the rates out
    turn_rate_max: float = 0.0  # omega_m, omega_M and d of the note, rad/s; a step of 0 leaves the rates out
    turn_rate_step: float = 0.0  # omega_m, omega_M and d of the note, rad/s; a step of 0 leaves the rates out
    grid: GridRule = "inclusive"  # paper leaves omega_m itself out, as the note's count does; inclusive keeps it
    axes: tuple[Axis, ...] = AXES  # Case axes to turn about, in order; the device is mounted anew for each
    order: Order = "alternating"  # alternating takes the rates upward, each both ways; random draws the order
    dwell_s: float | None = 6.0  # Steady part of each rate, s; None is as long as ``turn_rate_uncertainty`` needs
    turn_rate_uncertainty: float | None = None  # Wanted standard uncertainty of a dwell's mean rate, rad/s
    # Lengthen dwells to whole turns, where gravity or the Earth's rate would not average out
    whole_turns: bool = False
    bracket_s: float = 6.0  # Rest at zero rate before and after each block of rates, s: shows the drift
    cutoff_hz: float = 11.1  # Bandwidth of the device's low-pass, Hz: says how long it settles
    temperatures_c: tuple[float, ...] = ()  # Chamber set-points, degC; none stays at room temperature
    soak_c_per_min: float = 0.1  # A set-point counts as reached below this slope, K/min
    acceleration: float = 40.0  # Of the table, rad/s2
    seed: int = 0  # Of the random order

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

        Arrays:  -> (N / 3,) rad/s.
        """
        if self.turn_rate_step <= 0.0:
            return np.empty(0)
        return rate_grid(self.turn_rate_min, self.turn_rate_max, self.turn_rate_step, rule=self.grid)


def rate_grid(rate_min: float, rate_max: float, step: float, *, rule: GridRule = "inclusive") -> FloatArray:
    """Return the rates of one axis, both signs; three axes make the note's N columns.

    Arrays:  -> (N / 3,).
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


# ---- protocol.toml: what a calibration session is to do.

Finite = Annotated[float, Field(allow_inf_nan=False)]
DEFAULTS = Protocol()


class HeadEntry(Entry):
    """[protocol]."""

    name: str = ""  # For people
    cutoff_hz: Finite = DEFAULTS.cutoff_hz  # Bandwidth of the device's low-pass, Hz


class FacesEntry(Entry):
    """[faces]."""

    order: list[Face] = Field(default_factory=lambda: list(FACES))  # Sensor axis that points up, one after the other
    seconds: Finite = DEFAULTS.face_s  # Rest on each, s


class RatesEntry(Entry):
    """[rates]."""

    turn_rate_min_dps: Finite  # Least and greatest rate and the step, deg/s
    turn_rate_max_dps: Finite  # Least and greatest rate and the step, deg/s
    # Least and greatest rate and the step, deg/s
    turn_rate_step_dps: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    grid: GridRule = DEFAULTS.grid  # paper or inclusive
    axes: list[Axis] = Field(default_factory=lambda: list(AXES), min_length=1)  # Axes to turn about
    order: Order = DEFAULTS.order  # alternating or random
    seed: int = 0  # Of the random order
    seconds: Finite | None = None  # Of a dwell, s
    turn_rate_uncertainty_dps: Finite | None = None  # Wanted standard uncertainty of a dwell, deg/s
    bracket_s: Finite = DEFAULTS.bracket_s  # Rest before and after each block, s
    whole_turns: bool = False  # Lengthen dwells to whole turns
    acceleration_dps2: Finite = DEFAULTS.acceleration / RADIAN_PER_DEGREE  # Of the table, deg/s2


class TemperaturesEntry(Entry):
    """[temperatures]."""

    set_points_c: list[Finite] = Field(min_length=1)  # degC, rising
    soak_c_per_min: Finite = DEFAULTS.soak_c_per_min  # Slope below which a set-point counts as reached, K/min


class ProtocolFile(Entry):
    """The whole file."""

    protocol: HeadEntry = HeadEntry()  # Name and filter
    faces: FacesEntry | None = None  # For the accelerometers
    rates: RatesEntry | None = None  # For the gyroscopes
    temperatures: TemperaturesEntry | None = None  # For the drift tables


def read_protocol(path: str | Path) -> Protocol:
    """Read a protocol."""
    held = read_toml(path, ProtocolFile)
    faces, rates, heat = held.faces, held.rates, held.temperatures
    dps = RADIAN_PER_DEGREE
    try:
        if rates is not None:  # said in deg/s, as the file has it
            rate_grid(rates.turn_rate_min_dps, rates.turn_rate_max_dps, rates.turn_rate_step_dps)
        made = Protocol(
            name=held.protocol.name,
            cutoff_hz=held.protocol.cutoff_hz,
            faces=() if faces is None else tuple(faces.order),
            face_s=DEFAULTS.face_s if faces is None else faces.seconds,
            temperatures_c=() if heat is None else tuple(heat.set_points_c),
            soak_c_per_min=DEFAULTS.soak_c_per_min if heat is None else heat.soak_c_per_min,
            turn_rate_min=0.0 if rates is None else rates.turn_rate_min_dps * dps,
            turn_rate_max=0.0 if rates is None else rates.turn_rate_max_dps * dps,
            turn_rate_step=0.0 if rates is None else rates.turn_rate_step_dps * dps,
            grid=DEFAULTS.grid if rates is None else rates.grid,
            axes=AXES if rates is None else tuple(rates.axes),
            order=DEFAULTS.order if rates is None else rates.order,
            seed=0 if rates is None else rates.seed,
            dwell_s=_dwell_s(rates),
            turn_rate_uncertainty=None
            if rates is None or rates.turn_rate_uncertainty_dps is None
            else rates.turn_rate_uncertainty_dps * dps,
            bracket_s=DEFAULTS.bracket_s if rates is None else rates.bracket_s,
            whole_turns=False if rates is None else rates.whole_turns,
            acceleration=DEFAULTS.acceleration if rates is None else rates.acceleration_dps2 * dps,
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
    return made


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol; it reads back as it was, to the rounding of rad/s in deg/s."""
    import json

    p, dps = protocol, RADIAN_PER_DEGREE
    lines = ["[protocol]", f"name = {json.dumps(p.name)}", f"cutoff_hz = {p.cutoff_hz!r}"]
    if p.faces:
        lines += ["", "[faces]", f"order = {json.dumps(list(p.faces))}", f"seconds = {p.face_s!r}"]
    if p.turn_rate_step > 0.0:
        lines += ["", "[rates]"]
        for name in ("turn_rate_min", "turn_rate_max", "turn_rate_step"):
            lines.append(f"{name}_dps = {round(getattr(p, name) / dps, 12)!r}")
        lines += [
            f'grid = "{p.grid}"',
            f"axes = {json.dumps(list(p.axes))}",
            f'order = "{p.order}"',
            f"seed = {p.seed}",
        ]
        lines += [] if p.dwell_s is None else [f"seconds = {p.dwell_s!r}"]
        if p.turn_rate_uncertainty is not None:
            lines.append(f"turn_rate_uncertainty_dps = {p.turn_rate_uncertainty / dps!r}")
        lines += [f"bracket_s = {p.bracket_s!r}", f"whole_turns = {json.dumps(p.whole_turns)}"]
        lines.append(f"acceleration_dps2 = {p.acceleration / dps!r}")
    if p.temperatures_c:
        lines += ["", "[temperatures]", f"set_points_c = {json.dumps(list(p.temperatures_c))}"]
        lines.append(f"soak_c_per_min = {p.soak_c_per_min!r}")
    write_whole(Path(path), "\n".join(lines) + "\n")


def _dwell_s(rates: RatesEntry | None) -> float | None:
    if rates is None:
        return DEFAULTS.dwell_s
    if rates.seconds is None and rates.turn_rate_uncertainty_dps is None:
        return DEFAULTS.dwell_s
    return rates.seconds
