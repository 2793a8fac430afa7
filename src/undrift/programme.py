"""Protocol of a calibration session (protocol.toml), and its expansion to a programme of steps with times.

    mount (operator)  ->  at each temperature: soak (chamber)  ->  rest on the face  ->  rest, dwells, rest (a block of rates)

Mounting disturbs a device more than a chamber does, so the programme has as few mountings as possible. Each face is mounted once,
for all temperatures. The rates about an axis are read while its + side is up. Soaks take most of the time. Faces are read at every
set-point, or in separate mountings before the chamber is used, as in the study. A programme can be made without a rig.

    grid     paper (omega_m, omega_M], inclusive [omega_m, omega_M], both ways on three axes: N = 102 or 108 in sit-to-stand
    settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: a second-order low-pass is within 0.1 % of a step

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
from undrift.errors import InputError, check_positive
from undrift.record import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

# ---- Protocol: faces, rates and temperatures, with their durations and order.

GridRule = Literal["paper", "inclusive"]
FacesAt = Literal["every", "room"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
DPS = RADIAN_PER_DEGREE
DAMPING = math.sqrt(0.5)  # Butterworth, as in the note's filters


def _as_stated(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of protocol.toml, completed with the defaults of present and missing tables."""
    tree = {name: dict(table) if isinstance(table, dict) else table for name, table in tree.items()}
    tree.setdefault("faces", {"order": []})  # without this table the accelerometers are omitted
    rates, turns = tree.get("rates"), tree.get("turns")
    if isinstance(turns, dict):
        tree["turns"] = {"angle_deg": 360.0, "axes": list(AXES)} | turns
    if isinstance(rates, dict):
        limits = [rates.get(f"{name}_dps") for name in ("turn_rate_min", "turn_rate_max", "turn_rate_step")]
        numbers = [float(v) for v in limits if isinstance(v, int | float) and not isinstance(v, bool)]
        if len(numbers) == 3 and all(map(math.isfinite, numbers)) and numbers[2] > 0.0:
            rate_grid(*numbers)  # raises an error in deg/s, as in the file
    return tree


def _tables(protocol: "Protocol") -> dict[str, Any]:
    """Return the tables of protocol.toml that are used."""
    is_used = {"faces": protocol.faces, "rates": protocol.turn_rate_step > 0.0, "turns": protocol.turn_axes}
    is_used |= {"temperatures": protocol.temperatures_c}
    return {name: table for name, table in tree_by_keys(protocol).items() if is_used.get(name, True)}


@stored(complete=_as_stated, write=_tables)
@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Protocol of a calibration session, with the keys of protocol.toml."""

    name: Annotated[str, Key("protocol.name")] = ""  # free text
    # bandwidth of the device's low-pass, Hz, which determines the settling time
    cutoff_hz: Annotated[float, Key("protocol.cutoff_hz")] = 11.1
    damping: Annotated[float, Key("protocol.damping", later=True)] = DAMPING  # damping of that low-pass, 1
    # sensor axes that point up, in order (without the table the accelerometers are omitted)
    faces: Annotated[tuple[Face, ...], Key("faces.order")] = FACES
    face_s: Annotated[float, Key("faces.seconds")] = 6.0  # rest on each face, s
    # set-points at which the faces are read: every, or room (before the chamber is used)
    faces_at: Annotated[FacesAt, Key("faces.at", later=True)] = "every"
    # smallest rate, largest rate and step (omega_m, omega_M and d of the note), rad/s (a step of 0 omits the rates)
    turn_rate_min: Annotated[float, Key("rates.turn_rate_min_dps", unit=DPS, needed=True)] = 0.0
    turn_rate_max: Annotated[float, Key("rates.turn_rate_max_dps", unit=DPS, needed=True)] = 0.0
    turn_rate_step: Annotated[float, Key("rates.turn_rate_step_dps", unit=DPS, needed=True), Gt(0.0)] = 0.0
    # paper omits omega_m itself, as in the note's count, and inclusive includes it
    grid: Annotated[GridRule, Key("rates.grid")] = "inclusive"
    # case axes of the turns, in order (the device is mounted once for each axis)
    axes: Annotated[tuple[Axis, ...], MinLen(1), Key("rates.axes")] = AXES
    dwell_s: Annotated[float, Key("rates.seconds")] = 6.0  # steady part of each rate, s
    # rest before and after each block of rates, s, which determines the drift
    bracket_s: Annotated[float, Key("rates.bracket_s")] = 6.0
    acceleration: Annotated[float, Key("rates.acceleration_dps2", unit=DPS)] = 40.0  # acceleration of the table, rad/s2
    # angle of each turn by hand, rad (360 deg by default, and the angle that the operator reports is recorded)
    turn_angle: Annotated[float, Key("turns.angle_deg", unit=DPS)] = 0.0
    turn_axes: Annotated[tuple[Axis, ...], MinLen(1), Key("turns.axes")] = ()  # case axes of those turns, in order
    turn_rest_s: Annotated[float, Key("turns.rest_s")] = 3.0  # rest before and after each of those turns, s
    # set-points of the chamber in increasing order, degC (without the table the chamber stays at room temperature)
    temperatures_c: Annotated[tuple[float, ...], MinLen(1), Key("temperatures.set_points_c", needed=True)] = ()
    # slope below which a set-point counts as reached, K/min
    soak_c_per_min: Annotated[float, Key("temperatures.soak_c_per_min")] = 0.1
    # time constant of the device in the chamber, s, for the forecast only (about 600 in a box, 60 for a bare board in moving air)
    board_lag_s: Annotated[float, Key("temperatures.board_lag_s", later=True)] = 600.0

    def __post_init__(self) -> None:
        least_of = {"turn_rest_s": 0.5, "face_s": 0.0, "bracket_s": 0.0, "cutoff_hz": 1e-3, "soak_c_per_min": 1e-6}
        least_of |= {"damping": 1e-3, "board_lag_s": 0.0}
        for name, least in least_of.items():
            if not least <= getattr(self, name) < np.inf:
                raise InputError(f"protocol: {name} must be {least:g} or more, got {getattr(self, name):g}.")
        check_positive(self, "protocol", "Set a positive value", "acceleration", "dwell_s")
        if self.turn_rate_step > 0.0:
            self.turn_rates()
        elif not (self.faces or self.turn_axes):
            raise InputError("protocol: faces, rates and turns are all missing. Add at least one of them.")
        if self.turn_axes and not (math.isfinite(self.turn_angle) and self.turn_angle != 0.0):
            raise InputError(f"protocol: the angle of a turn must not be 0, got {self.turn_angle:g} rad.")
        if any(b <= a for a, b in pairwise(self.temperatures_c)):
            raise InputError("protocol: temperatures must increase. Sort them and list each once.")

    def turn_rates(self) -> FloatArray:
        """Return the rates about an axis, with both signs, (N / 3,) rad/s."""
        if self.turn_rate_step <= 0.0:
            return np.empty(0)
        return rate_grid(self.turn_rate_min, self.turn_rate_max, self.turn_rate_step, rule=self.grid)


def rate_grid(rate_min: float, rate_max: float, step: float, *, rule: GridRule = "inclusive") -> FloatArray:
    """Return the rates about an axis, with both signs, (N / 3,). Three axes give the N columns of the note."""
    if not (0.0 < rate_min < rate_max and step > 0.0):
        raise InputError(
            f"rate grid: 0 < rate_min < rate_max and a positive step are required, got {rate_min:g}, {rate_max:g}, {step:g}."
        )
    steps = round((rate_max - rate_min) / step)
    if abs(steps * step - (rate_max - rate_min)) > 1e-6 * step:
        raise InputError(
            f"rate grid: the step must divide {rate_max - rate_min:g}, got {step:g}. "
            f"Use for example {(rate_max - rate_min) / max(1, steps):g}."
        )
    positive = rate_min + step * np.arange(1 if rule == "paper" else 0, steps + 1)
    return np.concatenate((-positive[::-1], positive))


def read_protocol(path: str | Path) -> Protocol:
    """Read a protocol file."""
    return read(Protocol, path)


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol file. It reads back unchanged, except for rounding between rad/s and deg/s."""
    write(protocol, path)


# ---- Settling time after a change of rate.

LEAST_SETTLE_S = 0.3  # shortest settling time, which also covers the table's servo, s
REMAINDER = 1000.0


def settle_time(cutoff_hz: float, damping: float = DAMPING) -> float:
    """Return the settling time after a change of rate, s."""
    return max(LEAST_SETTLE_S, math.log(REMAINDER) / (damping * 2.0 * math.pi * cutoff_hz))


# ---- Programme.

PLUS: dict[Axis, Face] = {"x": "+x", "y": "+y", "z": "+z"}
Purpose = Literal["face", "bracket", "rate", "turn"]
TURN_S = 10.0  # duration of a turn by an operator, s, for the forecast only


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgrammeSettings:
    """Durations and slopes for the forecast, which a protocol does not contain."""

    mount_s: float = 30.0  # duration of a mounting, s
    room_c: float = 25.0  # initial temperature of the chamber, degC
    heating_c_per_min: float = 2.0  # slope of the chamber, K/min
    # settling time of the air (160 s in the simulated chamber) plus the time that the temperature must be steady, s
    settle_s: float = 160.0 + 300.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """Mounting of the device by hand, with the table at rest and its motor off."""

    up: Face  # device axis that points up, along the table's axis
    duration_s: float  # forecast, s

    def __str__(self) -> str:
        return f"mount {self.up} up"


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """Wait until chamber and device are steady at a temperature, with the table at rest."""

    temp_c: float  # set-point, degC
    slope_c_per_min: float  # slope below which the set-point counts as reached, K/min
    duration_s: float  # forecast, s

    def __str__(self) -> str:
        return f"soak at {self.temp_c:g} degC"


@dataclass(frozen=True, slots=True, kw_only=True)
class Dwell:
    """Reading of the device at a steady rate, or at rest."""

    purpose: Purpose  # face (rest), bracket (rest before and after a block), rate, or turn (by a known angle)
    up: Face  # device axis that points up
    axis: Axis | None  # device axis of the turn, or None for a face
    turn_rate: float  # nominal rate about +axis, rad/s (0 at rest)
    ramp_s: float  # duration of the run-up, equal to the slow-down, s
    settle_s: float  # settling time before the reading, s
    dwell_s: float  # duration of the reading, s
    temp_c: float | None = None  # set-point, degC, or None at room temperature
    angle: float = 0.0  # angle of a turn between two rests, rad about +axis

    @property
    def duration_s(self) -> float:
        """Total duration, s."""
        return 2.0 * self.ramp_s + self.settle_s + self.dwell_s

    @property
    def travel(self) -> float:
        """Signed angle of the move, rad."""
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
    """Steps of a session, in order."""

    steps: tuple[Step, ...]  # steps with at least one dwell, each after its mounting and its soak
    acceleration: float  # acceleration of the table, rad/s2

    def __post_init__(self) -> None:
        if not any(isinstance(step, Dwell) for step in self.steps):
            raise InputError("programme: at least one dwell is required. Add a dwell.")

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """Dwells, in order."""
        return tuple(step for step in self.steps if isinstance(step, Dwell))

    @property
    def duration_s(self) -> float:
        """Forecast of the total duration, s."""
        return sum(step.duration_s for step in self.steps)


def programme_of(protocol: Protocol, settings: ProgrammeSettings = ProgrammeSettings()) -> Programme:
    """Return the programme of a protocol, step by step."""
    turning = tuple(dict.fromkeys(protocol.axes)) if protocol.turn_rate_step > 0.0 else ()
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
                    steps += _block(axis, protocol, temp_c)
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


# set-point, degC, True if the face is read there, and True if the device is turned there
Visit: TypeAlias = tuple[float | None, bool, bool]


def _mountings(protocol: Protocol, turn_faces: tuple[Face, ...]) -> Iterator[tuple[Face, list[Visit]]]:
    """Yield the face of each mounting, with its visits to set-points."""
    temps_c: tuple[float | None, ...] = protocol.temperatures_c or (None,)
    if protocol.faces_at == "room":
        for up in dict.fromkeys(protocol.faces):
            yield up, [(None, True, False)]
        for up in dict.fromkeys(turn_faces):
            yield up, [(temp_c, False, True) for temp_c in temps_c]
        return
    for up in dict.fromkeys((*protocol.faces, *turn_faces)):
        yield up, [(temp_c, up in protocol.faces, up in turn_faces) for temp_c in temps_c]


def soak_time(protocol: Protocol, change_c: float, settings: ProgrammeSettings) -> float:
    """Return the duration of a soak after a change of ``change_c``, until the device's slope is below the limit, s.

    The chamber's air changes with r K/min for the time h = change / r. The device follows with the time constant tau. Its slope is
    then r (1 - exp(-h / tau)), and it reaches the limit after tau ln(r (1 - exp(-h / tau)) / limit).
    """
    slope, lag_s = settings.heating_c_per_min, protocol.board_lag_s
    heating_s = 60.0 * change_c / slope
    slope_at_end = slope if lag_s == 0.0 else -slope * math.expm1(-heating_s / lag_s)
    return heating_s + lag_s * math.log(max(slope_at_end / protocol.soak_c_per_min, 1.0)) + settings.settle_s


def _block(axis: Axis, protocol: Protocol, temp_c: float | None) -> Iterator[Dwell]:
    """Yield increasing rates, each in both directions, between two rests."""
    bracket = _rest("bracket", PLUS[axis], axis, protocol.bracket_s, protocol, temp_c)
    yield bracket
    rates = protocol.turn_rates()
    for turn_rate in (float(sign * rate) for rate in rates[rates > 0.0] for sign in (1.0, -1.0)):
        ramp_s = abs(turn_rate) / protocol.acceleration
        yield replace(bracket, purpose="rate", turn_rate=turn_rate, ramp_s=ramp_s, dwell_s=protocol.dwell_s)
    yield bracket


def _rest(
    purpose: Purpose, up: Face, axis: Axis | None, seconds: float, protocol: Protocol, temp_c: float | None
) -> Dwell:
    settle_s = settle_time(protocol.cutoff_hz, protocol.damping)
    return Dwell(
        purpose=purpose, up=up, axis=axis, turn_rate=0.0, ramp_s=0.0, settle_s=settle_s, dwell_s=seconds, temp_c=temp_c
    )
