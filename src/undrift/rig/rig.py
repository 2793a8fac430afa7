"""Common interface of all rate tables, with their limits and addresses.

Angles are in rad and rates in rad/s, positive about the table's own axis. An encoder with N lines gives 4N counts per turn, so one
count is 2 pi / 4N rad. A rig rounds commands to its counts before a byte is sent. Every call returns the ACHIEVED value.

The address of a rig is ``kind:url?option=value&option=value``. To add a kind, write a file with ``open_from(url, settings)`` and
add a row to CONTROLLERS.

    galil:tcp://host:port?encoder_lines=10000     galil:serial:///dev/ttyUSB0?baud=19200
    grbl:serial:///dev/ttyUSB0?axis=A             grbl:tcp://host:port                       manual:
"""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Literal, Protocol

import numpy as np

from undrift.base.clock import HOST, Clock, PacedClock
from undrift.errors import InputError, LimitError, RigFault, check_positive
from undrift.plugins import Types, load_named, names_in, split_address, typed_options
from undrift.programme import Dwell, Programme
from undrift.units import RADIAN_PER_DEGREE as DPS

# ---- Rounding of commands to counts of an encoder.

COUNTS_PER_LINE = 4
# commands of a card in counts, counts/s or counts/s2: step, which is also the smallest value, and largest value
COMMANDS = {"SP": (2, 12_000_000), "AC": (1024, 67_107_840), "PR": (1, 2_147_483_647)}


def to_counts(command: str, value: float) -> int:
    """Return the nearest value that a card accepts for a command."""
    step, largest = COMMANDS[command]
    magnitude = step * math.floor(abs(value) / step + 0.5)
    if not step <= magnitude <= largest:
        raise LimitError(
            f"{command}: the card accepts {step} to {largest} in steps of {step}, got {value:.6g} counts. Choose another rate, "
            "acceleration or angle.",
            counts=value,
        )
    return magnitude if value > 0 else -magnitude


# ---- rig

ROUNDING = 1.0 + 1e-9  # a rate given in degrees may equal a limit given in degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of the commands to a rig. A command beyond them raises LimitError before a byte is sent."""

    turn_rate: float = 2.0 * math.pi  # largest rate in either direction, rad/s
    acceleration: float = 100.0  # largest acceleration, rad/s2
    travel: float | None = None  # largest angle from the start in either direction, rad (None: unlimited)

    def __post_init__(self) -> None:
        check_positive(self, "limits", "Every rig needs limits", "turn_rate", "acceleration", "travel")

    def check_turn_rate(self, turn_rate: float) -> None:
        """Raise LimitError if a rate is beyond the limits."""
        _check_limit("turn rate", "deg/s in either direction", turn_rate, self.turn_rate)

    def check_acceleration(self, acceleration: float) -> None:
        """Raise LimitError if an acceleration is beyond the limits."""
        _check_limit(
            "acceleration", "deg/s2 and more than 0", acceleration, self.acceleration, allowed=acceleration > 0.0
        )

    def check_travel(self, angle: float) -> None:
        """Raise LimitError if an angle is beyond the travel."""
        _check_limit("travel", "deg from the start", angle, math.inf if self.travel is None else self.travel)


def _check_limit(name: str, unit: str, value: float, largest: float, *, allowed: bool = True) -> None:
    if not (allowed and abs(value) <= largest * ROUNDING):
        raise LimitError(
            f"{name}: at most {largest / DPS:.6g} {unit} is allowed, got {value / DPS:.6g}. Choose another value, or set another "
            "limit.",
            value=value,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Angle of the axis at a time."""

    angle: float  # rad
    time: float  # clock of the table, s (only differences are meaningful)
    within_s: float = 0.0  # largest error of the time, s: half of the round trip


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoReport:
    """Gains and sample period of a controller's servo, in the controller's units."""

    kp: float  # Galil: 0 to 1023.875 in steps of 1/8
    ki: float  # Galil: 0 to 2047.875 in steps of 1/128
    kd: float  # Galil: 0 to 4095.875 in steps of 1/8
    sample_s: float  # sample period of the servo, s


class Rig(Protocol):
    """One axis that turns a device."""

    limits: Limits  # limits of the commands to the rig

    def identify(self) -> str:
        """Return make, model and firmware."""

    def enable(self, on: bool) -> None:
        """Switch the motor on or off."""

    def set_acceleration(self, acceleration: float) -> float:
        """Set the acceleration of both ramps and return the achieved acceleration."""

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps. The controller ends the move itself.

        Return the rate that the controller has set, without waiting for the end of the move.
        """

    def stop(self) -> None:
        """Slow down and wait until the axis is at rest. The motor stays on."""

    def position(self) -> Position:
        """Return the current position of the axis."""

    def fault(self) -> str | None:
        """Return a description of the fault, or None."""

    def close(self) -> None:
        """Stop, switch the motor off and close the link. A second call has no effect."""


# ---- Achieved rate from encoder positions over a dwell.

FLOOR = 0.5  # lower limit of a delay, as a fraction of the median delay
EXPECTED = 3  # weight of the delays in the uncertainty, as a number of residuals


@dataclass(frozen=True, slots=True, kw_only=True)
class Achieved:
    """Achieved rate of a dwell."""

    turn_rate: float  # rad/s
    uncertainty: float  # standard uncertainty, rad/s
    between_ends: float  # mean rate between the first and the last position, rad/s
    # largest deviation from steady motion that the delays of the link cannot explain, rad
    misfit: float
    span_s: float  # time from the first position to the last, s
    delay_s: float  # largest of three delays: the median, the first and the last, s


def achieved_turn_rate(positions: Sequence[Position]) -> Achieved:
    """Return the mean rate over a dwell: the slope of a weighted least-squares line through (t_i, phi_i), weights 1 / d^2.

    The time of a position is uncertain by d, the round trip of the link. Half the median d is added in quadrature, so that a few
    quick answers do not dominate the fit. With S = sum w (t - tm)^2 and r = sum w residual^2, the standard uncertainty is sqrt(r /
    ((n - 2) S)). It includes counts and delays, and every other error increases it. Two other numbers therefore test whether the
    table turned steadily. The first is the misfit, max |residual_i| - |slope| (d_i + median d). The second is the rate between the
    first and the last position.
    """
    if len(positions) < 3:
        raise InputError(
            f"achieved rate: at least three positions are required, got {len(positions)}. Use a longer dwell."
        )
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


# ---- A steady turn of a given duration, as a finite move.


def steady_angle(turn_rate: float, seconds: float, acceleration: float) -> float:
    """Return the angle of a move with a given steady rate and total duration, ramps included.

    The two ramps cover half of the angle that the steady rate covers in the same time. Therefore angle = w (T - |w| / a), in the
    angle unit of the arguments.
    """
    ramp_s = abs(turn_rate) / acceleration
    if not 2.0 * ramp_s <= seconds:
        raise LimitError(
            f"turn: {seconds:g} s are too short, the two ramps take {2.0 * ramp_s:.3g} s. Turn for longer, or choose "
            "a larger acceleration.",
            seconds=seconds,
            ramp_s=ramp_s,
        )
    return turn_rate * (seconds - ramp_s)


# ---- Check of a programme against the limits of a rig, before anything moves.

TRAVEL_MARGIN = 1.1  # a move is planned longer than its dwell by this factor and ended early, because waits can overrun


def check_programme(
    programme: Programme, limits: Limits, done: frozenset[int] = frozenset(), *, by_hand: bool = False
) -> None:
    """Raise InputError if a programme is beyond the limits of a rig."""
    pending = [(n, step) for n, step in enumerate(programme.steps) if isinstance(step, Dwell) and n not in done]
    if by_hand:
        if turning := [(number, step) for number, step in pending if step.turn_rate != 0.0]:
            number, step = turning[0]
            raise InputError(
                f"manual rig: an operator cannot turn at a steady rate, got {len(turning)} dwells at one (step {number}: "
                f"{step}). Replace [rates] with [turns] in the protocol."
            )
        return
    for number, step in pending:
        if step.purpose == "turn":
            raise InputError(
                f"rig: step {number} ({step}) requires an operator. Use `manual:`, or replace [turns] with [rates]."
            )
    try:
        where = ""
        limits.check_acceleration(programme.acceleration)
        angle = 0.0
        for number, step in pending:
            where = f"step {number} ({step}): "
            limits.check_turn_rate(step.turn_rate)
            limits.check_travel(angle + TRAVEL_MARGIN * step.travel)
            angle += step.travel
    except LimitError as error:
        raise InputError(f"{where}{error}", **error.numbers) from error


# ---- Error and stop codes of controllers.


@cache
def in_words(kind: str, code: int) -> str:
    """Return the meaning of a code: galil_error (TC), galil_stop (SC) or grbl_error."""
    meanings: dict[str, str] = tomllib.loads((files("undrift.rig") / "codes.toml").read_text(encoding="utf-8"))[kind]
    return meanings.get(str(code), meanings["other"])


# ---- Addresses.

# function that opens a rig, by kind
CONTROLLERS = {
    "galil": "undrift.rig.galil:GalilRig",
    "grbl": "undrift.rig.grbl:GrblRig",
    "manual": "undrift.rig.manual:open_from",
    "simulated": "undrift.rig.simulated:open_from",
}
GROUP = "undrift.rigs"
OPTIONS: Types = {"encoder_lines": int, "axis": str.upper, "baud": int, "reply_timeout_s": float}
SIMULATED_OPTIONS: Types = {"encoder_lines": int, "clock_speed": float}


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """Settings that apply if the address does not set an option of the same name."""

    # limits of the commands (not an option, so that no address can relax them)
    limits: Limits = field(default_factory=Limits)
    encoder_lines: int = 10_000  # lines of a servo's encoder, 4 counts each
    axis: str = ""  # letter of the axis ("" selects the rig's default)
    baud: int = 0  # bits per second of a serial port (0 selects the rig's default)
    reply_timeout_s: float = 2.0  # longest wait for an answer, s
    accept: Literal["off", "on", "moving"] = "moving"  # state of the motor in which a table may be opened
    clock: Clock = HOST  # clock of the table
    # prints a line for a person and returns the typed answer (required for a manual rig)
    ask: Callable[[str], str] | None = None

    def __post_init__(self) -> None:
        check_positive(self, "rig", "Correct the address", "encoder_lines", "reply_timeout_s")

    @property
    def count(self) -> float:
        """Angle of one count of the encoder, rad."""
        return 2.0 * math.pi / (COUNTS_PER_LINE * self.encoder_lines)


def open_rig(address: str, settings: RigSettings = RigSettings()) -> Rig:
    """Open a rig without moving it."""
    kind, url, settings = parse_address(address, settings)
    rig: Rig = load_named(kind, CONTROLLERS, GROUP)(url, settings)
    return rig


def check_free(name: str, state: str, settings: RigSettings) -> None:
    """Raise RigFault if a table moves ("moving") or its motor is on ("its motor on"), and the settings do not accept that."""
    accepted = {"off": ("",), "on": ("", "its motor on"), "moving": ("", "its motor on", "moving")}[settings.accept]
    if state not in accepted:
        raise RigFault(
            f"rig: the table at {name} must be at rest with its motor off, got {state}. Another program uses it or has left it "
            "in this state. Wait for that program, or call undrift rig stop."
        )


def parse_address(address: str, settings: RigSettings = RigSettings()) -> tuple[str, str, RigSettings]:
    """Return the kind, the URL and the settings that an address contains."""
    kind, url, texts = split_address(address, "rig", names_in(CONTROLLERS, GROUP), "Name the kind of rig")
    options = typed_options(texts, SIMULATED_OPTIONS if kind == "simulated" else OPTIONS, "rig")
    clock_speed = options.pop("clock_speed", 1.0)
    if kind == "simulated" and settings.clock is HOST:
        if not clock_speed > 0.0:
            raise InputError(f"rig: clock_speed must be positive, got {clock_speed:g}. Correct the address.")
        options["clock"] = PacedClock(clock_speed)
    return kind, url, replace(settings, **options)
