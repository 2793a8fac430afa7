"""Programme: what a calibration session is to do (protocol.toml), and the same written out step by step, with times.

    mount (operator)  ->  at each temperature: soak (chamber)  ->  rest on the face  ->  rest, dwells, rest (a block of rates)

A person or a door disturbs more than a chamber does, so the device is mounted as seldom as can be: each face once, every
temperature in it, and the rates about an axis where its + side is up. No rig is needed to make a programme.

    grid     paper (omega_m, omega_M], inclusive [omega_m, omega_M], both ways on three axes: N = 102 or 108 in sit-to-stand
    settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: a second-order low-pass is within 0.1 % of a step
    dwell    u^2 = (q / t)^2 + N^2 / t: one count q over the dwell, and white noise of density N

Keys of protocol.toml: docs/rig.md.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import Entry, read_toml, write_whole
from undrift.record import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

# ---- Protocol: faces, rates, temperatures, for how long and in which order.

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
    turn_rate_max: float = 0.0
    turn_rate_step: float = 0.0
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
    turn_angle: float = 0.0  # Turn by a known angle about each of `turn_axes`, rad; 0 leaves the turns out
    turn_axes: tuple[Axis, ...] = ()  # Case axes of those turns, in order
    turn_rest_s: float = 3.0  # Rest before and after each of those turns, s

    def __post_init__(self) -> None:
        least_of = {"turn_rest_s": 0.5, "face_s": 0.0, "bracket_s": 0.0, "cutoff_hz": 1e-3, "soak_c_per_min": 1e-6}
        for name, least in least_of.items():
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
        elif not (self.faces or self.turn_axes):
            raise InputError("protocol: wanted faces, rates or turns, got none; there is nothing to do")
        if self.turn_axes and not (math.isfinite(self.turn_angle) and self.turn_angle != 0.0):
            raise InputError(f"protocol: wanted a turn by an angle other than 0, got {self.turn_angle:g} rad")
        if any(b <= a for a, b in pairwise(self.temperatures_c)):
            raise InputError("protocol: wanted rising temperatures, got others; sort them and name each once")

    def turn_rates(self) -> FloatArray:
        """Return the rates of one axis, both signs, (N / 3,) rad/s."""
        if self.turn_rate_step <= 0.0:
            return np.empty(0)
        return rate_grid(self.turn_rate_min, self.turn_rate_max, self.turn_rate_step, rule=self.grid)


def rate_grid(rate_min: float, rate_max: float, step: float, *, rule: GridRule = "inclusive") -> FloatArray:
    """Return the rates of one axis, both signs; three axes make the note's N columns, (N / 3,)."""
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
    positive = rate_min + step * np.arange(1 if rule == "paper" else 0, steps + 1)
    return np.concatenate((-positive[::-1], positive))


# ---- protocol.toml: what a calibration session is to do.

Finite = Annotated[float, Field(allow_inf_nan=False)]
DEFAULTS = Protocol()
RATES = ("turn_rate_min", "turn_rate_max", "turn_rate_step")


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
    turn_rate_max_dps: Finite
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


class TurnsEntry(Entry):
    """[turns]."""

    angle_deg: Finite = 360.0  # Of each turn; what the operator then states is recorded
    axes: list[Axis] = Field(default_factory=lambda: list(AXES), min_length=1)  # Axes to turn about
    rest_s: Finite = DEFAULTS.turn_rest_s  # Rest before and after each, s


class TemperaturesEntry(Entry):
    """[temperatures]."""

    set_points_c: list[Finite] = Field(min_length=1)  # degC, rising
    soak_c_per_min: Finite = DEFAULTS.soak_c_per_min  # Slope below which a set-point counts as reached, K/min


class ProtocolFile(Entry):
    """The whole file."""

    protocol: HeadEntry = HeadEntry()  # Name and filter
    faces: FacesEntry | None = None  # For the accelerometers
    rates: RatesEntry | None = None  # For the gyroscopes
    turns: TurnsEntry | None = None  # For the gyroscopes, without a rate table
    temperatures: TemperaturesEntry | None = None  # For the drift tables


def read_protocol(path: str | Path) -> Protocol:
    """Read a protocol."""
    held = read_toml(path, ProtocolFile)
    faces, rates, heat = held.faces, held.rates, held.temperatures
    dps = RADIAN_PER_DEGREE
    fields: dict[str, Any] = {"name": held.protocol.name, "cutoff_hz": held.protocol.cutoff_hz, "faces": ()}
    if faces is not None:
        fields |= {"faces": tuple(faces.order), "face_s": faces.seconds}
    if heat is not None:
        fields |= {"temperatures_c": tuple(heat.set_points_c), "soak_c_per_min": heat.soak_c_per_min}
    if rates is not None:
        uncertainty_dps = rates.turn_rate_uncertainty_dps
        stated = rates.seconds is not None or uncertainty_dps is not None
        fields |= {name: getattr(rates, name) for name in ("grid", "order", "seed", "bracket_s", "whole_turns")}
        fields |= {name: getattr(rates, f"{name}_dps") * dps for name in RATES}
        fields |= {
            "axes": tuple(rates.axes),
            "dwell_s": rates.seconds if stated else DEFAULTS.dwell_s,
            "turn_rate_uncertainty": None if uncertainty_dps is None else uncertainty_dps * dps,
            "acceleration": rates.acceleration_dps2 * dps,
        }
    if held.turns is not None:
        turns = held.turns
        fields |= {"turn_angle": turns.angle_deg * dps, "turn_axes": tuple(turns.axes), "turn_rest_s": turns.rest_s}
    try:
        if rates is not None:  # an error message in deg/s, as in the file
            rate_grid(rates.turn_rate_min_dps, rates.turn_rate_max_dps, rates.turn_rate_step_dps)
        return Protocol(**fields)
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol; it reads back as it was, to the rounding of rad/s in deg/s."""
    p, dps = protocol, RADIAN_PER_DEGREE
    uncertainty_dps = None if p.turn_rate_uncertainty is None else p.turn_rate_uncertainty / dps
    tables: dict[str, dict[str, Any]] = {"protocol": {"name": p.name, "cutoff_hz": p.cutoff_hz}}
    if p.faces:
        tables["faces"] = {"order": p.faces, "seconds": p.face_s}
    if p.turn_rate_step > 0.0:
        tables["rates"] = {f"{name}_dps": round(getattr(p, name) / dps, 12) for name in RATES}
        tables["rates"] |= {"grid": p.grid, "axes": p.axes, "order": p.order, "seed": p.seed, "seconds": p.dwell_s}
        tables["rates"] |= {"turn_rate_uncertainty_dps": uncertainty_dps, "bracket_s": p.bracket_s}
        tables["rates"] |= {"whole_turns": p.whole_turns, "acceleration_dps2": p.acceleration / dps}
    if p.turn_axes:
        tables["turns"] = {"angle_deg": p.turn_angle / dps, "axes": p.turn_axes, "rest_s": p.turn_rest_s}
    if p.temperatures_c:
        tables["temperatures"] = {"set_points_c": p.temperatures_c, "soak_c_per_min": p.soak_c_per_min}
    parts = []
    for name, table in tables.items():
        keys = (f"{key} = {json.dumps(value)}\n" for key, value in table.items() if value is not None)
        parts.append(f"[{name}]\n" + "".join(keys))
    write_whole(Path(path), "\n".join(parts))


# ---- How long a device settles after the rate changed, and how long a dwell must be.

DAMPING = math.sqrt(0.5)  # Butterworth, as the note's filters
LEAST_SETTLE_S = 0.3  # also the table's own servo
REMAINDER = 1000.0


def settle_time(cutoff_hz: float, damping: float = DAMPING) -> float:
    """Return how long to wait after a change of rate."""
    if not (cutoff_hz > 0.0 and damping > 0.0):
        raise InputError(f"settle time: wanted cutoff_hz and damping above 0, got {cutoff_hz:g} and {damping:g}")
    return max(LEAST_SETTLE_S, math.log(REMAINDER) / (damping * 2.0 * math.pi * cutoff_hz))


def dwell_time(uncertainty: float, *, count: float, noise_density: float = 0.0) -> float:
    """Return how long a dwell must be for its mean rate to be known so well.

    The positive root of u^2 t^2 - N^2 t - q^2 = 0.
    """
    if not uncertainty > 0.0:
        raise InputError(f"dwell time: wanted an uncertainty above 0 rad/s, got {uncertainty:g}")
    square = noise_density * noise_density
    return (square + math.hypot(square, 2.0 * uncertainty * count)) / (2.0 * uncertainty * uncertainty)


def whole_turns_time(turn_rate: float, least_s: float) -> float:
    """Return the shortest time of whole turns that is no shorter than asked for."""
    turn_s = 2.0 * math.pi / abs(turn_rate)
    return turn_s * max(1, math.ceil(least_s / turn_s - 1e-9))


# ---- programme

PLUS: dict[Axis, Face] = {"x": "+x", "y": "+y", "z": "+z"}
Purpose = Literal["face", "bracket", "rate", "turn"]
TURN_S = 10.0  # how long an operator takes for a turn, s: only for the forecast


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgrammeSettings:
    """What a protocol does not say."""

    encoder_lines: int = 10_000  # Of the table, 4 counts a line
    noise_density: float = 0.0  # Of the device's rate, rad/s/sqrt(Hz)
    mount_s: float = 30.0  # How long a person takes to mount the device, s: only for the forecast
    room_c: float = 25.0  # Temperature of the chamber at the start, degC: only for the forecast
    heating_c_per_min: float = 2.0  # Slope of the chamber, K/min: only for the forecast
    soak_s: float = 1200.0  # How long the device takes to follow, s: only for the forecast


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """The device is mounted by hand; the table rests and its motor is off."""

    up: Face  # Device axis that points up, along the table's axis
    duration_s: float  # Forecast, s

    def __str__(self) -> str:
        return f"mount {self.up} up"


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """The chamber goes to a temperature and the device follows; the table rests."""

    temp_c: float  # Set-point, degC
    slope_c_per_min: float  # Reached when it changes less, K/min
    duration_s: float  # Forecast, s

    def __str__(self) -> str:
        return f"soak at {self.temp_c:g} degC"


@dataclass(frozen=True, slots=True, kw_only=True)
class Dwell:
    """The device is read at a steady rate, or at rest."""

    purpose: Purpose  # face (rest), bracket (rest before and after a block), rate, or turn (by a known angle)
    up: Face  # Device axis that points up
    axis: Axis | None  # Device axis that the table turns about; None for a face
    turn_rate: float  # Nominal, rad/s about +axis; 0 at rest
    ramp_s: float  # Run-up, and as long again to slow down, s
    settle_s: float  # Wait before reading, s
    dwell_s: float  # Reading, s
    temp_c: float | None = None  # Set-point, degC; None at room temperature
    angle: float = 0.0  # Turned while it is read, between two rests, rad about +axis

    @property
    def duration_s(self) -> float:
        """Whole time, s."""
        return 2.0 * self.ramp_s + self.settle_s + self.dwell_s

    @property
    def travel(self) -> float:
        """Angle turned, rad, signed."""
        return self.turn_rate * (self.ramp_s + self.settle_s + self.dwell_s)

    def __str__(self) -> str:
        warm = "" if self.temp_c is None else f" at {self.temp_c:g} degC"
        if self.purpose == "turn":
            return f"turn by {self.angle / RADIAN_PER_DEGREE:+g} deg about {self.axis}{warm}"
        if self.purpose == "rate":
            return f"{self.turn_rate / RADIAN_PER_DEGREE:+g} deg/s about {self.axis}{warm}"
        return (
            f"rest, {self.up} up{warm}"
            if self.purpose == "face"
            else f"rest before or after turns about {self.axis}{warm}"
        )


Step: TypeAlias = Mount | Soak | Dwell


@dataclass(frozen=True, slots=True, kw_only=True)
class Programme:
    """Steps in order."""

    steps: tuple[Step, ...]  # At least one dwell; each with the mounting and the temperature of the steps before it
    acceleration: float  # Of the table, rad/s2

    def __post_init__(self) -> None:
        if not any(isinstance(step, Dwell) for step in self.steps):
            raise InputError("programme: wanted one dwell or more, got none; there is nothing to read")
        up: Face | None = None
        temp_c: float | None = None
        for number, step in enumerate(self.steps):
            if isinstance(step, Mount):
                up = step.up
            elif isinstance(step, Soak):
                temp_c = step.temp_c
            else:
                _check_dwell(number, step, up, temp_c)

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """What is read, in order."""
        return tuple(step for step in self.steps if isinstance(step, Dwell))

    @property
    def duration_s(self) -> float:
        """Forecast of the whole, s."""
        return sum(step.duration_s for step in self.steps)


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """What is left of a programme."""

    dwells: int
    mountings: int
    rig_s: float  # time of the dwells
    total_s: float  # with mountings and the chamber
    turn_rate: float  # highest, rad/s


def forecast_of(programme: Programme, done: frozenset[int] = frozenset()) -> Forecast:
    """Return how much is left, and how long it takes."""
    left = [step for number, step in enumerate(programme.steps) if number not in done]
    dwells = [step for step in left if isinstance(step, Dwell)]
    return Forecast(
        dwells=len(dwells),
        mountings=sum(isinstance(step, Mount) for step in left),
        rig_s=sum(dwell.duration_s for dwell in dwells),
        total_s=sum(step.duration_s for step in left),
        turn_rate=max((abs(dwell.turn_rate) for dwell in dwells), default=0.0),
    )


def programme_of(protocol: Protocol, settings: ProgrammeSettings = ProgrammeSettings()) -> Programme:
    """Write a protocol out."""
    turning = protocol.axes if protocol.turn_rate_step > 0.0 else ()
    mountings = tuple(dict.fromkeys((*protocol.faces, *(PLUS[axis] for axis in (*turning, *protocol.turn_axes)))))
    rng = np.random.default_rng(protocol.seed)
    steps: list[Step] = []
    before_c = settings.room_c
    for up in mountings:
        steps.append(Mount(up=up, duration_s=settings.mount_s))
        for temp_c in protocol.temperatures_c or (None,):
            if temp_c is not None:
                seconds = 60.0 * abs(temp_c - before_c) / settings.heating_c_per_min + settings.soak_s
                steps.append(Soak(temp_c=temp_c, slope_c_per_min=protocol.soak_c_per_min, duration_s=seconds))
                before_c = temp_c
            if up in protocol.faces:
                steps.append(_rest("face", up, None, protocol.face_s, protocol, temp_c))
            for axis in turning:
                if up == PLUS[axis]:
                    steps += _block(axis, protocol, settings, temp_c, rng)
            for axis in protocol.turn_axes:
                if up == PLUS[axis]:
                    rest = _rest("bracket", up, axis, protocol.turn_rest_s, protocol, temp_c)
                    turn = replace(
                        rest, purpose="turn", dwell_s=2.0 * protocol.turn_rest_s + TURN_S, angle=protocol.turn_angle
                    )
                    steps += (rest, turn, rest)
    return Programme(
        steps=tuple(step for step in steps if not isinstance(step, Dwell) or step.dwell_s > 0.0),
        acceleration=protocol.acceleration,
    )


def _block(
    axis: Axis, protocol: Protocol, settings: ProgrammeSettings, temp_c: float | None, rng: np.random.Generator
) -> Iterator[Dwell]:
    bracket = _rest("bracket", PLUS[axis], axis, protocol.bracket_s, protocol, temp_c)
    yield bracket
    for turn_rate in _ordered(protocol, rng):
        dwell_s, ramp_s = _dwell_s(turn_rate, protocol, settings), abs(turn_rate) / protocol.acceleration
        yield replace(bracket, purpose="rate", turn_rate=turn_rate, ramp_s=ramp_s, dwell_s=dwell_s)
    yield bracket


def _ordered(protocol: Protocol, rng: np.random.Generator) -> list[float]:
    rates = protocol.turn_rates()
    if protocol.order == "random":
        return [float(rate) for rate in rng.permutation(rates)]
    return [float(sign * rate) for rate in rates[rates > 0.0] for sign in (1.0, -1.0)]


def _dwell_s(turn_rate: float, protocol: Protocol, settings: ProgrammeSettings) -> float:
    """Return the longer of what is stated and what the uncertainty needs, in whole turns where asked."""
    seconds = protocol.dwell_s or 0.0
    if protocol.turn_rate_uncertainty is not None:
        count = 2.0 * np.pi / (4.0 * settings.encoder_lines)
        needed = dwell_time(protocol.turn_rate_uncertainty, count=count, noise_density=settings.noise_density)
        seconds = max(seconds, needed)
    return whole_turns_time(turn_rate, seconds) if protocol.whole_turns else seconds


def _rest(
    purpose: Purpose, up: Face, axis: Axis | None, seconds: float, protocol: Protocol, temp_c: float | None
) -> Dwell:
    settle_s = settle_time(protocol.cutoff_hz)
    return Dwell(
        purpose=purpose, up=up, axis=axis, turn_rate=0.0, ramp_s=0.0, settle_s=settle_s, dwell_s=seconds, temp_c=temp_c
    )


def _check_dwell(number: int, dwell: Dwell, up: Face | None, temp_c: float | None) -> None:
    what, upright = f"programme: step {number} ({dwell})", dwell.axis is not None and dwell.up == PLUS[dwell.axis]
    if dwell.up != up:
        raise InputError(f"{what}: wanted the device mounted {dwell.up} up, got {up or 'no mounting'}; mount it first")
    if dwell.temp_c != temp_c:
        raise InputError(f"{what}: wanted a soak at its temperature before it, got {temp_c}; soak first")
    if dwell.purpose != "rate" and dwell.turn_rate != 0.0:
        raise InputError(f"{what}: wanted a rest at 0 rad/s, got {dwell.turn_rate:g}; a rest does not turn")
    if dwell.purpose == "rate" and (dwell.turn_rate == 0.0 or not upright):
        raise InputError(
            f"{what}: wanted a rate about the axis that is up, got {dwell.turn_rate:g} rad/s; correct the step"
        )
    if (dwell.purpose == "turn") != (dwell.angle != 0.0) or (dwell.angle and not upright):
        raise InputError(
            f"{what}: wanted an angle about the axis that is up, got {dwell.angle:g} rad; correct the step"
        )
    if not (np.isfinite(dwell.dwell_s) and dwell.dwell_s > 0.0 and dwell.settle_s >= 0.0 and dwell.ramp_s >= 0.0):
        raise InputError(f"{what}: wanted times above 0 s, got a dwell of {dwell.dwell_s:g} s; correct the step")
