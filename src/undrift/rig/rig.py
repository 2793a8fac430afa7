"""Rig: what every rate table can do, whichever controller stands behind it, and how it is opened.

Angles are rad, rates rad/s, positive about the table's own axis. An encoder of N lines gives 4N counts per turn, one count is
2 pi / 4N rad. A rig rounds commands to its counts before a byte is sent; every call returns the value it ACHIEVED.

A rig has an address, ``kind:url?option=value&option=value``. Adding one is a file with ``open_from(url, settings)`` and a row in
CONTROLLERS.

    galil:tcp://host:port?encoder_lines=10000     galil:serial:///dev/ttyUSB0?baud=19200
    grbl:serial:///dev/ttyUSB0?axis=A             grbl:tcp://host:port                       manual:
"""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Protocol

import numpy as np

from undrift.base.clock import Clock, PacedClock
from undrift.errors import InputError, LimitError, check_positive
from undrift.plugins import load_named, split_address
from undrift.programme import Dwell, Programme
from undrift.units import RADIAN_PER_DEGREE

# ---- Counts and angles: an encoder's lines or a stepper's steps in rad, and how a card rounds commands.

COUNTS_PER_LINE = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class CountScale:
    """How many counts make a turn."""

    counts_per_turn: float  # Counts (or steps) in 2 pi

    def __post_init__(self) -> None:
        if not (math.isfinite(self.counts_per_turn) and self.counts_per_turn > 0.0):
            raise InputError(
                f"encoder: wanted counts per turn above 0, got {self.counts_per_turn:g}; look at its data sheet"
            )

    @classmethod
    def from_lines(cls, encoder_lines: int) -> "CountScale":
        """Make it from the lines on an encoder's disc."""
        return cls(counts_per_turn=float(COUNTS_PER_LINE * encoder_lines))

    def angle(self, counts: float) -> float:
        """Return the angle of counts (or the rate of counts/s)."""
        return counts * (2.0 * math.pi / self.counts_per_turn)

    def counts(self, angle: float) -> float:
        """Return the counts of an angle, not rounded."""
        if not math.isfinite(angle):
            raise InputError(f"rig: wanted a finite angle or rate, got {angle}; check what computed it")
        return angle * (self.counts_per_turn / (2.0 * math.pi))


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandRange:
    """The values one command of a card accepts: multiples of a step within a range."""

    name: str  # The command, for messages: "JG", "AC",
    step: int  # Counts, counts/s or counts/s2 between two values
    smallest: int  # Smallest magnitude that does something
    largest: int  # Largest magnitude

    def round(self, counts: float) -> int:
        """Return the nearest value the card can hold."""
        magnitude = self.step * math.floor(abs(counts) / self.step + 0.5)
        if not self.smallest <= magnitude <= self.largest:
            raise LimitError(
                f"{self.name}: wanted {self.smallest} to {self.largest} in steps of {self.step}, got {counts:.6g} counts; "
                "choose another rate, acceleration or angle",
                counts=counts,
                smallest=self.smallest,
                largest=self.largest,
            )
        return magnitude if counts > 0 else -magnitude


LONGEST_MOVE = 2_147_483_647  # counts, a signed word of 32 bits
SLEW = CommandRange(name="SP", step=2, smallest=2, largest=12_000_000)
ACCELERATION = CommandRange(name="AC", step=1024, smallest=1024, largest=67_107_840)
MOVE = CommandRange(name="PR", step=1, smallest=1, largest=LONGEST_MOVE)


# ---- rig

ROUNDING = 1.0 + 1e-9  # a limit given in degrees is met exactly by a rate given in degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of the commands to a rig; anything beyond raises LimitError before a byte is sent."""

    turn_rate: float = 2.0 * math.pi  # Largest rate either way, rad/s
    acceleration: float = 100.0  # Largest acceleration, rad/s2
    travel: float | None = None  # Largest angle either way from where it was connected, rad; None turns without end

    def __post_init__(self) -> None:
        check_positive(self, "limits", "a rig without limits is not driven", "turn_rate", "acceleration", "travel")

    def check_turn_rate(self, turn_rate: float) -> None:
        """Refuse a rate beyond the limits."""
        if not abs(turn_rate) <= self.turn_rate * ROUNDING:
            raise LimitError(
                f"turn rate: wanted at most {self.turn_rate:g} rad/s either way, got {turn_rate:g}; choose a slower one",
                turn_rate=turn_rate,
            )

    def check_acceleration(self, acceleration: float) -> None:
        """Refuse an acceleration beyond the limits."""
        if not 0.0 < acceleration <= self.acceleration * ROUNDING:
            raise LimitError(
                f"acceleration: wanted above 0 and at most {self.acceleration:g} rad/s2, got {acceleration:g}; "
                "choose a smaller one",
                acceleration=acceleration,
            )

    def check_travel(self, angle: float) -> None:
        """Refuse an angle that the rig may not be turned to."""
        if self.travel is not None and not abs(angle) <= self.travel * ROUNDING:
            raise LimitError(
                f"travel: wanted to stay within {self.travel:g} rad of the start, got a move to {angle:g}; "
                "choose a shorter one",
                angle=angle,
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where the axis stands."""

    angle: float  # rad
    time: float  # The host's monotonic clock, s; only differences count where a controller's own clock is in it
    # It may be off by that much either way, s: half the time between question and answer, or half a tick of the
    # controller
    within_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoReport:
    """Gains and sample period that a controller runs, in its own units."""

    kp: float  # Galil: 0 to 1023.875 in steps of 1/8
    ki: float  # Galil: 0 to 2047.875 in steps of 1/128
    kd: float  # Galil: 0 to 4095.875 in steps of 1/8
    sample_s: float  # s, from one sample of the servo to the next


class Rig(Protocol):
    """One axis that turns a device."""

    @property
    def limits(self) -> Limits:
        """Limits of its commands."""

    def identify(self) -> str:
        """Return make, model and firmware."""

    def read_servo(self) -> ServoReport | None:
        """Return the servo's gains and sample period, None for a stepper without encoder or a person."""

    def enable(self, on: bool) -> None:
        """Switch the motor on or off."""

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up and slow-down."""

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for so long, ramps included; the controller ends the move by itself.

        Return at once, with the rate that the controller holds.
        """

    def move_by(self, angle: float) -> float:
        """Turn by an angle and come to rest."""

    def stop(self) -> None:
        """Slow down and wait until the axis is at rest; the motor stays on."""

    def position(self) -> Position:
        """Return where the axis stands now."""

    def following_error(self) -> float:
        """Return commanded minus actual angle, rad."""

    def fault(self) -> str | None:
        """Return what is wrong with it, or None."""

    def close(self, *, as_found: bool = False) -> None:
        """Stop, switch the motor off (or leave it as it was found), let go of the link; harmless when called again."""


# ---- The rate that was achieved, from positions of the encoder over a dwell.

FLOOR = 0.5  # of the median delay
EXPECTED = 3  # residuals that the delays alone stand for


@dataclass(frozen=True, slots=True, kw_only=True)
class Achieved:
    """A rate as it was."""

    turn_rate: float  # rad/s
    uncertainty: float  # Standard, rad/s
    between_ends: float  # Way from the first position to the last over its time, rad/s
    # Farthest from steady that a position is, delays of the link left out, rad; 0 where they explain it all
    misfit: float
    span_s: float  # From the first position to the last, s
    delay_s: float  # Largest of the median time in which a position may have been taken and of those at both ends, s


def achieved_turn_rate(positions: Sequence[Position]) -> Achieved:
    """Return the mean rate over a dwell: the slope of a line through (t_i, phi_i), by least squares with weights 1 / d^2.

    When a position was taken is known no better than d, between question and answer of the link or a tick of the controller's own
    clock; a floor of half the median d keeps a few quick answers from counting alone. S = sum w (t - tm)^2, and the standard
    uncertainty sqrt(r / ((n - 2) S)), r the sum of w times squared residuals, has counts and delays in it. It grows with whatever
    is wrong, so whether the table turned steadily shows in the misfit, max |residual_i| - |slope| (d_i + median d), and in the
    rate between the first position and the last.
    """
    if len(positions) < 3:
        raise InputError(f"achieved rate: wanted three positions or more, got {len(positions)}; dwell longer")
    delay = 2.0 * np.array([p.within_s for p in positions])
    floor = FLOOR * float(np.median(delay))
    weight = np.ones_like(delay) if floor <= 0.0 else 1.0 / (delay * delay + floor * floor)
    weight /= weight.sum()
    time = np.array([p.time for p in positions]) - positions[0].time
    angle = np.array([p.angle for p in positions]) - positions[0].angle
    t, phi = time - weight @ time, angle - weight @ angle
    square = float(weight @ (t * t))
    slope = float(weight @ (t * phi)) / square
    residual = phi - slope * t
    count, r = len(time), float(weight @ (residual * residual))
    expected = EXPECTED * slope**2 * float(weight @ (delay * delay)) / (12.0 * count)
    spread = max(r / (count - 2), (r + expected) / (count - 2 + EXPECTED)) / square
    beyond = np.abs(residual) - abs(slope) * (delay + np.median(delay))
    return Achieved(
        turn_rate=slope,
        uncertainty=float(np.sqrt(spread)),
        between_ends=float((angle[-1] - angle[0]) / (time[-1] - time[0])),
        misfit=max(0.0, float(beyond.max())),
        span_s=float(time[-1] - time[0]),
        delay_s=float(max(np.median(delay), delay[0], delay[-1])),
    )


# ---- A steady turn of a stated duration, as a finite move.


def steady_angle(turn_rate: float, seconds: float, acceleration: float) -> float:
    """Return the angle of a move at a steady rate that takes so long, run-up and slow-down included.

    Both ramps together cover half of what the steady rate would in that time: angle = w (T - |w| / a), in any one unit of angle.
    """
    ramp_s = abs(turn_rate) / acceleration
    if not ramp_s < seconds:
        raise LimitError(
            f"turn: {seconds:g} s are too short, run-up and slow-down alone take {2.0 * ramp_s:.3g} s. Turn for longer, or choose "
            "a larger acceleration.",
            seconds=seconds,
            ramp_s=ramp_s,
        )
    return turn_rate * (seconds - ramp_s)


# ---- Whether a programme may be run on a rig: asked before anything moves.

TRAVEL_MARGIN = 1.1  # a wait is never shorter than requested, so a dwell's move is planned longer, and ended early


def check_programme(
    programme: Programme, limits: Limits, done: frozenset[int] = frozenset(), *, by_hand: bool = False
) -> None:
    """Refuse a programme that the rig may not run."""
    left = [(n, step) for n, step in enumerate(programme.steps) if isinstance(step, Dwell) and n not in done]
    turning = [(number, step) for number, step in left if step.turn_rate != 0.0]
    if by_hand:
        if turning:
            number, step = turning[0]
            raise InputError(
                f"manual rig: wanted rests and turns by known angles, got {len(turning)} dwells at a steady rate (step {number}: "
                f"{step}), which no operator holds; replace [rates] by [turns] in the protocol"
            )
        return

    def check(name: str, value: float, unit: str, where: str = "") -> None:
        """Say a limit as a protocol states it, in degrees."""
        most = getattr(limits, name)
        try:
            getattr(limits, f"check_{name}")(value)
        except LimitError as error:
            highest = "no end" if most is None else f"{most / RADIAN_PER_DEGREE:.6g}"
            raise InputError(
                f"{where}{name.replace('_', ' ')}: wanted at most {highest} {unit}, got {value / RADIAN_PER_DEGREE:.6g}; mend "
                "the protocol or state another limit",
                **error.numbers,
            ) from error

    check("acceleration", programme.acceleration, "deg/s2")
    for number, step in left:
        if step.angle != 0.0:
            check("travel", step.angle, "deg from the start", f"step {number} ({step}): ")
    angle = 0.0
    for number, step in turning:
        where = f"step {number} ({step}): "
        check("turn_rate", step.turn_rate, "deg/s", where)
        check("travel", angle + TRAVEL_MARGIN * step.travel, "deg from the start", where)
        angle += step.travel


# ---- What the numbers of controllers mean.


@cache
def codes(kind: str) -> dict[str, str]:
    """Return a table of codes in words: galil_error (TC), galil_stop (SC), grbl_error, grbl_alarm."""
    table: dict[str, str] = tomllib.loads((files("undrift.rig") / "codes.toml").read_text(encoding="utf-8"))[kind]
    return table


def in_words(kind: str, code: int) -> str:
    """Say what a code means."""
    return codes(kind).get(str(code), codes(kind)["other"])


# ---- Addresses.

# kind -> the function that opens a rig
CONTROLLERS = {kind: f"undrift.rig.{kind}:open_from" for kind in ("galil", "grbl", "manual", "simulated")}
GROUP = "undrift.rigs"


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """What an address does not say; an option of the same name in the address wins."""

    # Limits of the commands; never an option, so that no address can widen it
    limits: Limits = field(default_factory=Limits)
    encoder_lines: int = 10_000  # Lines of a servo's encoder, 4 counts each
    axis: str = ""  # Letter of the axis; "" is the rig's usual one
    baud: int = 0  # Bits per second of a serial port; 0 is the rig's usual
    hardware_handshake: bool = False  # RTS/CTS of a serial port
    reply_timeout_s: float = 2.0  # Longest wait for an answer, s
    clock_speed: float = 1.0  # Table seconds per host second: 1 for hardware, what a simulated table is given otherwise
    clock: Clock | None = None  # The table's; None is the host's, at clock_speed
    # Shows a person a line and returns what they typed; a manual rig needs it
    ask: Callable[[str], str] | None = None

    @property
    def timing(self) -> Clock:
        """The table's clock."""
        return self.clock or Clock(self.clock_speed)


OPTIONS: dict[str, Callable[[str], object]] = {
    "encoder_lines": int,
    "axis": str.upper,
    "baud": int,
    "hardware_handshake": lambda text: {"yes": True, "no": False}[text],
    "reply_timeout_s": float,
    "clock_speed": float,
}


def open_rig(address: str, settings: RigSettings = RigSettings()) -> Rig:
    """Open a rig; nothing moves."""
    kind, url, settings = parse_address(address, settings)
    rig: Rig = load_named(kind, CONTROLLERS, GROUP)(url, settings)
    return rig


def parse_address(address: str, settings: RigSettings = RigSettings()) -> tuple[str, str, RigSettings]:
    """Take an address apart."""
    kind, url, given = split_address(address, "rig", CONTROLLERS, GROUP, "name the kind of rig")
    for name, text in given:
        if name not in OPTIONS:
            raise InputError(f"rig: wanted options out of {', '.join(OPTIONS)}, got '{name}'; mend the address")
        try:
            settings = replace(settings, **{name: OPTIONS[name](text)})  # type: ignore[arg-type]
        except (ValueError, KeyError) as error:
            raise InputError(f"rig: wanted a value for {name}, got '{text}'; mend the address") from error
    if kind == "simulated" and settings.clock is None:
        if not settings.clock_speed > 0.0:
            raise InputError(f"rig: wanted a clock_speed above 0, got {settings.clock_speed:g}; mend the address")
        settings = replace(settings, clock=PacedClock(settings.clock_speed))
    return kind, url, settings
