"""Programme: what a calibration session is to do (protocol.toml), and the same written out step by step, with times.

    mount (operator)  ->  at each temperature: soak (chamber)  ->  rest on the face  ->  rest, dwells, rest (a block of rates)

A person or a door disturbs more than a chamber does, so the device is mounted as seldom as can be: each face once, every
temperature in it, and the rates about an axis where its + side is up. No rig is needed to make a programme. Soaks take most of
the time, and faces need few: they are read at every set-point, at the first alone, or in mountings of their own before the chamber
is used, as the study lays its sessions out.

    grid     paper (omega_m, omega_M], inclusive [omega_m, omega_M], both ways on three axes: N = 102 or 108 in sit-to-stand
    settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: a second-order low-pass is within 0.1 % of a step
    dwell    u^2 = (q / t)^2 + N^2 / t: one count q over the dwell, and white noise of density N

Keys of protocol.toml: docs/rig.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from annotated_types import Gt, MinLen

from undrift.arrays import FloatArray
from undrift.base.codec import Key, read, stored, tree_by_keys, write
from undrift.errors import InputError
from undrift.record import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

# ---- Protocol: faces, rates, temperatures, for how long and in which order.

GridRule = Literal["paper", "inclusive"]
Order = Literal["alternating", "random"]
FacesAt = Literal["every", "first", "room"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
DPS = RADIAN_PER_DEGREE
DAMPING = math.sqrt(0.5)  # Butterworth, as the note's filters


def _as_stated(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of protocol.toml with what a table, there or not, means."""
    tree = {name: dict(table) if isinstance(table, dict) else table for name, table in tree.items()}
    tree.setdefault("faces", {"order": []})  # without it the accelerometers are left out
    rates, turns = tree.get("rates"), tree.get("turns")
    if isinstance(turns, dict):
        tree["turns"] = {"angle_deg": 360.0, "axes": list(AXES)} | turns
    if isinstance(rates, dict):
        if "turn_rate_uncertainty_dps" in rates:
            rates.setdefault("seconds", None)  # a dwell is as long as that needs
        stated = [rates.get(f"{name}_dps") for name in ("turn_rate_min", "turn_rate_max", "turn_rate_step")]
        known = [float(v) for v in stated if isinstance(v, int | float) and not isinstance(v, bool)]
        if len(known) == 3 and all(map(math.isfinite, known)) and known[2] > 0.0:
            rate_grid(*known)  # an error message in deg/s, as in the file
    return tree


def _tables(protocol: "Protocol") -> dict[str, Any]:
    """Return the tables of protocol.toml that say something."""
    stated = {"faces": protocol.faces, "rates": protocol.turn_rate_step > 0.0, "turns": protocol.turn_axes}
    stated |= {"temperatures": protocol.temperatures_c}
    return {name: table for name, table in tree_by_keys(protocol).items() if stated.get(name, True)}


@stored(complete=_as_stated, write=_tables)
@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """What a calibration session is to do; its keys are those of protocol.toml."""

    name: Annotated[str, Key("protocol.name")] = ""  # For people
    # Bandwidth of the device's low-pass, Hz: says how long it settles
    cutoff_hz: Annotated[float, Key("protocol.cutoff_hz")] = 11.1
    damping: Annotated[float, Key("protocol.damping", later=True)] = DAMPING  # Of that low-pass, 1; it settles by both
    # Sensor axis that points up, one face after the other; without the table the accelerometers are left out
    faces: Annotated[tuple[Face, ...], Key("faces.order")] = FACES
    face_s: Annotated[float, Key("faces.seconds")] = 6.0  # Rest on each, s
    # Set-points at which the faces are read: every, the first alone, or room, before the chamber is used
    faces_at: Annotated[FacesAt, Key("faces.at", later=True)] = "every"
    # Least and greatest rate and the step, omega_m, omega_M and d of the note; a step of 0 leaves the rates out
    turn_rate_min: Annotated[float, Key("rates.turn_rate_min_dps", unit=DPS, needed=True)] = 0.0
    turn_rate_max: Annotated[float, Key("rates.turn_rate_max_dps", unit=DPS, needed=True)] = 0.0
    turn_rate_step: Annotated[float, Key("rates.turn_rate_step_dps", unit=DPS, needed=True), Gt(0.0)] = 0.0
    # paper leaves omega_m itself out, as the note's count does; inclusive keeps it
    grid: Annotated[GridRule, Key("rates.grid")] = "inclusive"
    # Case axes to turn about, in order; the device is mounted anew for each
    axes: Annotated[tuple[Axis, ...], MinLen(1), Key("rates.axes")] = AXES
    # alternating takes the rates upward, each both ways; random draws the order
    order: Annotated[Order, Key("rates.order")] = "alternating"
    seed: Annotated[int, Key("rates.seed")] = 0  # Of the random order
    # Steady part of each rate, s; without it as long as turn_rate_uncertainty_dps needs
    dwell_s: Annotated[float | None, Key("rates.seconds")] = 6.0
    # Wanted standard uncertainty of a dwell's mean rate
    turn_rate_uncertainty: Annotated[float | None, Key("rates.turn_rate_uncertainty_dps", unit=DPS)] = None
    # Rest at zero rate before and after each block of rates, s: shows the drift
    bracket_s: Annotated[float, Key("rates.bracket_s")] = 6.0
    # Lengthen dwells to whole turns, where gravity or the Earth's rate would not average out
    whole_turns: Annotated[bool, Key("rates.whole_turns")] = False
    acceleration: Annotated[float, Key("rates.acceleration_dps2", unit=DPS)] = 40.0  # Of the table
    # Of each turn by a known angle; what the operator then states is recorded; 360 deg where the table says none
    turn_angle: Annotated[float, Key("turns.angle_deg", unit=DPS)] = 0.0
    turn_axes: Annotated[tuple[Axis, ...], MinLen(1), Key("turns.axes")] = ()  # Case axes of those turns, in order
    turn_rest_s: Annotated[float, Key("turns.rest_s")] = 3.0  # Rest before and after each of those turns, s
    # Chamber set-points, degC, rising; without the table the chamber stays at room temperature
    temperatures_c: Annotated[tuple[float, ...], MinLen(1), Key("temperatures.set_points_c", needed=True)] = ()
    # A set-point counts as reached below this slope, K/min
    soak_c_per_min: Annotated[float, Key("temperatures.soak_c_per_min")] = 0.1
    # With which the device follows the chamber, s: only for the forecast; 600 of a board in its box, 60 of a bare one in moving air
    board_lag_s: Annotated[float, Key("temperatures.board_lag_s", later=True)] = 600.0

    def __post_init__(self) -> None:
        least_of = {"turn_rest_s": 0.5, "face_s": 0.0, "bracket_s": 0.0, "cutoff_hz": 1e-3, "soak_c_per_min": 1e-6}
        least_of |= {"damping": 1e-3, "board_lag_s": 0.0}
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


def read_protocol(path: str | Path) -> Protocol:
    """Read a protocol."""
    return read(Protocol, path)


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol; it reads back as it was, to the rounding of rad/s in deg/s."""
    write(protocol, path)


# ---- How long a device settles after the rate changed, and how long a dwell must be.

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
    # How long the air takes to settle (160 s of the simulated chamber) and the temperature to hold still, s: only for the forecast
    settle_s: float = 160.0 + 300.0


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
    turning = tuple(dict.fromkeys(protocol.axes)) if protocol.turn_rate_step > 0.0 else ()
    rng = np.random.default_rng(protocol.seed)
    steps: list[Step] = []
    before_c = settings.room_c
    for up, visits in _mountings(protocol, tuple(PLUS[axis] for axis in (*turning, *protocol.turn_axes))):
        steps.append(Mount(up=up, duration_s=settings.mount_s))
        for temp_c, with_face, turns in visits:
            if temp_c is not None:
                seconds = soak_time(protocol, abs(temp_c - before_c), settings)
                steps.append(Soak(temp_c=temp_c, slope_c_per_min=protocol.soak_c_per_min, duration_s=seconds))
                before_c = temp_c
            if with_face:
                steps.append(_rest("face", up, None, protocol.face_s, protocol, temp_c))
            for axis in turning if turns else ():
                if up == PLUS[axis]:
                    steps += _block(axis, protocol, settings, temp_c, rng)
            for axis in protocol.turn_axes if turns else ():
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


Visit: TypeAlias = tuple[
    float | None, bool, bool
]  # Set-point, degC; whether the face is read there; whether it is turned


def _mountings(protocol: Protocol, turned: tuple[Face, ...]) -> Iterator[tuple[Face, list[Visit]]]:
    """Return how the device is mounted, one mounting after the other, and what is done at which set-point of it."""
    temps_c: tuple[float | None, ...] = protocol.temperatures_c or (None,)
    if protocol.faces_at == "room":
        for up in dict.fromkeys(protocol.faces):
            yield up, [(None, True, False)]
        for up in dict.fromkeys(turned):
            yield up, [(temp_c, False, True) for temp_c in temps_c]
        return
    ups: dict[Face, None] = dict.fromkeys((*protocol.faces, *turned))
    last = protocol.faces_at == "first"  # a chamber cools down once less
    for up in sorted(ups, key=lambda up: last and up in turned):
        visits = [(temp_c, up in protocol.faces and not (last and k), up in turned) for k, temp_c in enumerate(temps_c)]
        yield up, [visit for visit in visits if visit[1] or visit[2]]


def soak_time(protocol: Protocol, change_c: float, settings: ProgrammeSettings) -> float:
    """Return how long a device takes to a set-point ``change_c`` away, until it changes as slowly as is asked, s.

    The chamber's air changes by r K/min for h = change / r; the device follows with one time constant tau. It then changes by
    r (1 - exp(-h / tau)), and tau ln(r (1 - exp(-h / tau)) / limit) later by the limit.
    """
    slope, lag_s = settings.heating_c_per_min, protocol.board_lag_s
    heating_s = 60.0 * change_c / slope
    left = slope if lag_s == 0.0 else -slope * math.expm1(-heating_s / lag_s)
    return heating_s + lag_s * math.log(max(left / protocol.soak_c_per_min, 1.0)) + settings.settle_s


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
    settle_s = settle_time(protocol.cutoff_hz, protocol.damping)
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
    moves = (("rate", dwell.turn_rate, "a rate", "rad/s"), ("turn", dwell.angle, "an angle", "rad"))
    for purpose, value, name, unit in moves:
        if (dwell.purpose == purpose) != (value != 0.0) or (value and not upright):
            raise InputError(f"{what}: wanted {name} about the axis that is up, got {value:g} {unit}; correct the step")
    if not (np.isfinite(dwell.dwell_s) and dwell.dwell_s > 0.0 and dwell.settle_s >= 0.0 and dwell.ramp_s >= 0.0):
        raise InputError(f"{what}: wanted times above 0 s, got a dwell of {dwell.dwell_s:g} s; correct the step")
