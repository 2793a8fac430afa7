"""Protocol of a calibration session (protocol.toml), and its expansion to a programme of steps with times.

    mount (operator)  ->  at each temperature: soak (chamber)  ->  rest on the face  ->  rest, dwells, rest (a block of rates)

Mounting disturbs a device more than a chamber does, so the programme has as few mountings as possible. Each face is mounted once,
for all temperatures. Rates about an axis are recorded with its + side up. Soaks take most of the time. Faces are read at every
set-point, or in separate mountings before the chamber is used, as in the study. A programme can be made without a rig.

    grid     paper (omega_m, omega_M], inclusive [omega_m, omega_M], both directions on three axes: N = 102 or 108 in sit-to-stand
    settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: a second-order low-pass is within 0.1 % of a step

Keys of protocol.toml: docs/rig.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self, TypeAlias

import numpy as np
from annotated_types import Ge, MinLen
from pydantic import NonNegativeFloat, PositiveFloat, model_validator

from undrift.arrays import FloatArray
from undrift.base.codec import FileTable, read_toml, toml_text, tree_of
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.record import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

# ---- Protocol: faces, rates and temperatures, with their durations and order. A class is a table of protocol.toml.

GridRule = Literal["paper", "inclusive"]
FacesAt = Literal["every", "room"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
DPS = RADIAN_PER_DEGREE
ACCELERATION_DPS2 = 40.0 / DPS  # 40 rad/s2
DAMPING = math.sqrt(0.5)  # Butterworth, as in the note's filters
SomeAxes = Annotated[tuple[Axis, ...], MinLen(1)]


class ProtocolTable(FileTable):
    """Name and low-pass."""

    name: str = ""  # free text
    # bandwidth of the device's low-pass, Hz, which determines the settling time
    cutoff_hz: Annotated[float, Ge(1e-3)] = 11.1
    damping: Annotated[float, Ge(1e-3)] = DAMPING  # damping of the low-pass, 1


class FacesTable(FileTable):
    """Faces. Without this table, the accelerometers are omitted."""

    order: tuple[Face, ...] = FACES  # sensor axes that point up, in order
    seconds: NonNegativeFloat = 6.0  # rest on each face, s
    at: FacesAt = "every"  # set-points at which the faces are read: every, or room (before the chamber is used)


class RatesTable(FileTable):
    """Steady rates of the table."""

    # smallest rate, largest rate and step (omega_m, omega_M and d of the note), deg/s
    turn_rate_min_dps: float
    turn_rate_max_dps: float
    turn_rate_step_dps: PositiveFloat
    # paper omits omega_m itself, as in the note's count, and inclusive includes it
    grid: GridRule = "inclusive"
    axes: SomeAxes = AXES  # case axes of the turns, in order (the device is mounted once for each axis)
    seconds: PositiveFloat = 6.0  # steady part of each rate, s
    bracket_s: NonNegativeFloat = 6.0  # rest before and after each block of rates, s, which determines the drift
    acceleration_dps2: PositiveFloat = ACCELERATION_DPS2  # acceleration of the table, deg/s2


class TurnsTable(FileTable):
    """Turns by hand through a known angle."""

    # angle of each turn, deg (the angle that the operator reports is recorded)
    angle_deg: float = 360.0
    axes: SomeAxes = AXES  # case axes of these turns, in order
    rest_s: Annotated[float, Ge(0.5)] = 3.0  # rest before and after each of these turns, s


class TemperaturesTable(FileTable):
    """Temperatures. Without this table, the chamber stays at room temperature."""

    set_points_c: Annotated[tuple[float, ...], MinLen(1)]  # set-points of the chamber in increasing order, degC
    soak_c_per_min: Annotated[float, Ge(1e-6)] = 0.1  # slope below which a set-point counts as reached, K/min
    # time constant of the device in the chamber, s, for the forecast only (about 600 in a box, 60 for a bare board in moving air)
    board_lag_s: NonNegativeFloat = 600.0


class Protocol(FileTable):
    """Protocol of a calibration session, with the tables of protocol.toml."""

    protocol: ProtocolTable = ProtocolTable()  # name and low-pass
    faces: FacesTable | None = None
    rates: RatesTable | None = None
    turns: TurnsTable | None = None
    temperatures: TemperaturesTable | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not (self.face_order or self.rates or self.turns):
            raise InputError("protocol: faces, rates and turns are all missing. Add at least one of them.")
        if self.rates is not None:
            rate_grid(self.rates.turn_rate_min_dps, self.rates.turn_rate_max_dps, self.rates.turn_rate_step_dps)
        if self.turns is not None and self.turns.angle_deg == 0.0:
            raise InputError("protocol: the angle of a turn must not be 0. Enter 360, for example.")
        if any(b <= a for a, b in pairwise(self.temperatures_c)):
            raise InputError("protocol: temperatures must increase. Sort them and list each once.")
        return self

    @property
    def name(self) -> str:
        """Return the free text that names the protocol."""
        return self.protocol.name

    @property
    def face_order(self) -> tuple[Face, ...]:
        """Faces that point up, in order."""
        return () if self.faces is None else self.faces.order

    @property
    def temperatures_c(self) -> tuple[float, ...]:
        """Set-points of the chamber, degC."""
        return () if self.temperatures is None else self.temperatures.set_points_c

    def turn_rates(self) -> FloatArray:
        """Return the rates about an axis, with both signs, (N / 3,) rad/s."""
        rates = self.rates
        if rates is None:
            return np.empty(0)
        limits = (rates.turn_rate_min_dps, rates.turn_rate_max_dps, rates.turn_rate_step_dps)
        return rate_grid(*(limit * DPS for limit in limits), rule=rates.grid)

    def with_faces_at_room(self) -> Self:
        """Return the protocol with its faces read before the chamber is used."""
        return self if self.faces is None else self.but(faces=self.faces.but(at="room"))

    def named(self, name: str) -> Self:
        """Return the protocol with another name."""
        return self.but(protocol=self.protocol.but(name=name))


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
    return read_toml(Protocol, path)[0]


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol file. It is read back without loss."""
    write_whole(Path(path), toml_text(tree_of(protocol)))


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
    # settling time of the air (160 s in the simulated chamber) plus the time for which the temperature must be steady, s
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
    rates, by_hand = protocol.rates, protocol.turns
    rate_axes = () if rates is None else tuple(dict.fromkeys(rates.axes))
    hand_axes = () if by_hand is None else by_hand.axes
    steps: list[Step] = []
    before_c = settings.room_c
    for up, visits in _mountings(protocol, tuple(PLUS[axis] for axis in (*rate_axes, *hand_axes))):
        steps.append(Mount(up=up, duration_s=settings.mount_s))
        for temp_c, with_face, with_turns in visits:
            if temp_c is not None and protocol.temperatures is not None:
                seconds = soak_time(protocol.temperatures, abs(temp_c - before_c), settings)
                slope = protocol.temperatures.soak_c_per_min
                steps.append(Soak(temp_c=temp_c, slope_c_per_min=slope, duration_s=seconds))
                before_c = temp_c
            if with_face and protocol.faces is not None:
                steps.append(_rest("face", up, None, protocol.faces.seconds, protocol, temp_c))
            if rates is not None and with_turns:
                for axis in rate_axes:
                    steps += _block(axis, rates, protocol, temp_c) if up == PLUS[axis] else ()
            if by_hand is not None and with_turns:
                for axis in hand_axes:
                    steps += _hand_turn(axis, by_hand, protocol, temp_c) if up == PLUS[axis] else ()
    return Programme(
        steps=tuple(step for step in steps if not isinstance(step, Dwell) or step.dwell_s > 0.0),
        acceleration=DPS * (ACCELERATION_DPS2 if rates is None else rates.acceleration_dps2),
    )


# set-point, degC, True if the face is recorded there, and True if the device is turned there
Visit: TypeAlias = tuple[float | None, bool, bool]


def _mountings(protocol: Protocol, turn_faces: tuple[Face, ...]) -> Iterator[tuple[Face, list[Visit]]]:
    """Yield the face of each mounting, with its visits to set-points."""
    temps_c: tuple[float | None, ...] = protocol.temperatures_c or (None,)
    if protocol.faces is not None and protocol.faces.at == "room":
        for up in dict.fromkeys(protocol.faces.order):
            yield up, [(None, True, False)]
        for up in dict.fromkeys(turn_faces):
            yield up, [(temp_c, False, True) for temp_c in temps_c]
        return
    for up in dict.fromkeys((*protocol.face_order, *turn_faces)):
        yield up, [(temp_c, up in protocol.face_order, up in turn_faces) for temp_c in temps_c]


def soak_time(temperatures: TemperaturesTable, change_c: float, settings: ProgrammeSettings) -> float:
    """Return the duration of a soak after a change of ``change_c``, until the device's slope is below the limit, s.

    The chamber's air changes with r K/min for the time h = change / r. The device follows with the time constant tau. Its slope is
    then r (1 - exp(-h / tau)), and it reaches the limit after tau ln(r (1 - exp(-h / tau)) / limit).
    """
    slope, lag_s = settings.heating_c_per_min, temperatures.board_lag_s
    heating_s = 60.0 * change_c / slope
    slope_at_end = slope if lag_s == 0.0 else -slope * math.expm1(-heating_s / lag_s)
    return heating_s + lag_s * math.log(max(slope_at_end / temperatures.soak_c_per_min, 1.0)) + settings.settle_s


def _block(axis: Axis, rates: RatesTable, protocol: Protocol, temp_c: float | None) -> Iterator[Dwell]:
    """Yield increasing rates, each in both directions, between two rests."""
    bracket = _rest("bracket", PLUS[axis], axis, rates.bracket_s, protocol, temp_c)
    yield bracket
    both = protocol.turn_rates()
    for turn_rate in (float(sign * rate) for rate in both[both > 0.0] for sign in (1.0, -1.0)):
        ramp_s = abs(turn_rate) / (DPS * rates.acceleration_dps2)
        yield replace(bracket, purpose="rate", turn_rate=turn_rate, ramp_s=ramp_s, dwell_s=rates.seconds)
    yield bracket


def _hand_turn(axis: Axis, turns: TurnsTable, protocol: Protocol, temp_c: float | None) -> Iterator[Dwell]:
    """Yield a turn by hand between two rests."""
    rest = _rest("bracket", PLUS[axis], axis, turns.rest_s, protocol, temp_c)
    yield rest
    yield replace(rest, purpose="turn", dwell_s=2.0 * turns.rest_s + TURN_S, angle=DPS * turns.angle_deg)
    yield rest


def _rest(
    purpose: Purpose, up: Face, axis: Axis | None, seconds: float, protocol: Protocol, temp_c: float | None
) -> Dwell:
    settle_s = settle_time(protocol.protocol.cutoff_hz, protocol.protocol.damping)
    return Dwell(
        purpose=purpose, up=up, axis=axis, turn_rate=0.0, ramp_s=0.0, settle_s=settle_s, dwell_s=seconds, temp_c=temp_c
    )
