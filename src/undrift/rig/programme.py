"""Programme: a protocol written out step by step, with how long each takes. No rig is needed to make one.

    mount (hands)  ->  at each temperature: soak (chamber)  ->  rest on the face  ->  rest, dwells, rest (a block of rates)

A person or a door disturbs more than a chamber does, so the device is mounted as seldom as can be: each face once, every
temperature in it, and the rates about an axis where its + side is up.

How long a device settles after the rate changed, and how long a dwell must be.

settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: the step response of a second-order low-pass is within 0.1 %
dwell    u^2 = (q / t)^2 + N^2 / t: one count q over the dwell, and white noise of density N
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from undrift.errors import InputError
from undrift.record import Axis, Face
from undrift.rig.protocol import Protocol
from undrift.units import RADIAN_PER_DEGREE

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

Purpose = Literal["face", "bracket", "rate"]


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

    purpose: Purpose  # face (rest), bracket (rest before and after a block) or rate
    up: Face  # Device axis that points up
    axis: Axis | None  # Device axis that the table turns about; None for a face
    turn_rate: float  # Nominal, rad/s about +axis; 0 at rest
    ramp_s: float  # Run-up, and as long again to slow down, s
    settle_s: float  # Wait before reading, s
    dwell_s: float  # Reading, s
    temp_c: float | None = None  # Set-point, degC; None at room temperature

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

    @property
    def rig_s(self) -> float:
        """Time in which the table and the device work, hands and chamber left out, s."""
        return sum(step.duration_s for step in self.dwells)


def programme_of(protocol: Protocol, settings: ProgrammeSettings = ProgrammeSettings()) -> Programme:
    """Write a protocol out."""
    turning = protocol.axes if protocol.turn_rate_step > 0.0 else ()
    mountings: list[Face] = list(protocol.faces)
    mountings += [up for axis in turning if (up := _plus(axis)) not in mountings]
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
                if up == _plus(axis):
                    steps += _block(axis, protocol, settings, temp_c, rng)
    return Programme(
        steps=tuple(step for step in steps if not isinstance(step, Dwell) or step.dwell_s > 0.0),
        acceleration=protocol.acceleration,
    )


def _block(
    axis: Axis, protocol: Protocol, settings: ProgrammeSettings, temp_c: float | None, rng: np.random.Generator
) -> Iterator[Dwell]:
    up = _plus(axis)
    yield _rest("bracket", up, axis, protocol.bracket_s, protocol, temp_c)
    for turn_rate in _ordered(protocol, rng):
        yield Dwell(
            purpose="rate",
            up=up,
            axis=axis,
            turn_rate=turn_rate,
            ramp_s=abs(turn_rate) / protocol.acceleration,
            settle_s=settle_time(protocol.cutoff_hz),
            dwell_s=_dwell_s(turn_rate, protocol, settings),
            temp_c=temp_c,
        )
    yield _rest("bracket", up, axis, protocol.bracket_s, protocol, temp_c)


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


def _plus(axis: Axis) -> Face:
    faces: dict[Axis, Face] = {"x": "+x", "y": "+y", "z": "+z"}
    return faces[axis]


def _check_dwell(number: int, dwell: Dwell, up: Face | None, temp_c: float | None) -> None:
    what = f"programme: step {number} ({dwell})"
    if dwell.up != up:
        raise InputError(f"{what}: wanted the device mounted {dwell.up} up, got {up or 'no mounting'}; mount it first")
    if dwell.temp_c != temp_c:
        raise InputError(f"{what}: wanted a soak at its temperature before it, got {temp_c}; soak first")
    if dwell.purpose != "rate" and dwell.turn_rate != 0.0:
        raise InputError(f"{what}: wanted a rest at 0 rad/s, got {dwell.turn_rate:g}; a rest does not turn")
    if dwell.purpose == "rate" and (dwell.turn_rate == 0.0 or dwell.axis is None or dwell.up != _plus(dwell.axis)):
        raise InputError(
            f"{what}: wanted a rate about the axis that is up, got {dwell.turn_rate:g} rad/s; mend the step"
        )
    if not (np.isfinite(dwell.dwell_s) and dwell.dwell_s > 0.0 and dwell.settle_s >= 0.0 and dwell.ramp_s >= 0.0):
        raise InputError(f"{what}: wanted times above 0 s, got a dwell of {dwell.dwell_s:g} s; mend the step")
