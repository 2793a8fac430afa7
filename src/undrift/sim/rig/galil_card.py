"""Card: an emulated one-axis Galil controller: its settings, its motor, its motions, its numbers and what it tells.

Time is the axis's; `advance` brings both up to a moment and handles what happened on the way, in order. Ranges, steps and defaults
of settings are those of the 1400 class as DOMAIN 3.1 gathers them; codes are those of its TC table. Expressions are worked from
left to right: the card knows no precedence, 1+2*3 is 9. Comparisons give 1 or 0. Numbers lie within +-2147483647.9999.
"""

import math
import operator
import re
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from undrift.kernels import device as k
from undrift.kernels.device import Coefficients
from undrift.sim.rig.axes import Axis, ServoSettings

# ---- Words of the card's language: error texts, and the numbers that its settings take.


class Error(Enum):
    """Codes of TC and their texts."""

    NONE = 0, ""
    UNKNOWN = 1, "Unrecognized command"
    ONLY_IN_PROGRAM = 2, "Command only valid from program"
    NOT_IN_PROGRAM = 3, "Command not valid in program"
    OPERAND = 4, "Operand error"
    BUFFER_FULL = 5, "Input buffer full"
    OUT_OF_RANGE = 6, "Number out of range"
    RUNNING = 7, "Command not valid while running"
    NOT_RUNNING = 8, "Command not valid when not running"
    VARIABLE = 9, "Variable error"
    NO_LABEL = 10, "Empty program line or undefined label"
    JOG_ONLY = 13, "JG only valid when running in jog mode"
    PROGRAM_RUNNING = 17, "ED, BN and DL not valid while program running"
    STRAND_RUNNING = 19, "Application strand already executing"
    MOTOR_OFF = 20, "Begin not valid with motor off"
    BEGIN_RUNNING = 21, "Begin not valid while running"
    AT_LIMIT = 22, "Begin not possible due to Limit Switch"
    NOT_ENOUGH = 50, "Not enough fields"
    NO_QUESTION = 51, "Question mark not valid"
    PARENTHESES = 59, "Mismatched parentheses"
    LINE_TOO_LONG = 60, "Download error - line too long or too many lines"
    NO_ENDIF = 63, "IF statement without ENDIF"
    NO_ROOM = 66, "Array space full"
    RECORDING_RUNS = 80, "Record mode already running"
    NO_ARRAY = 82, "Undefined array"
    NOT_A_NUMBER = 83, "Not a valid number"
    NO_JUMPER = 96, "SM jumper needs to be installed for stepper motor operation"
    SERIAL_TIMEOUT = 131, "Serial port timeout"
    MOTOR_ON = 135, "Motor must be in MO"
    PERIOD_TIMEOUT = 143, "TM timed out"


ERROR_TEXT: dict[int, str] = dict(error.value for error in Error)
STOP_RUNNING, STOP_DONE, STOP_FORWARD, STOP_REVERSE, STOP_ASKED = 0, 1, 2, 3, 4
STOP_ABORT_INPUT, STOP_ABORTED, STOP_ERROR, STOP_HOMED = 6, 7, 8, 10

LARGEST = 2_147_483_647.0
HOME_SPEED, HOME_LOOK_S = 256.0, 1e-3  # counts/s of the second and third stage; between two looks at the switch


class Refused(Exception):
    """The card answers `?`; TC tells the code."""

    def __init__(self, error: Error) -> None:
        self.code, text = error.value
        super().__init__(text)


def refuse_if(wrong: object, error: Error) -> None:
    """Refuse where something is wrong."""
    if wrong:
        raise Refused(error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One number that a command sets."""

    default: float  # At power-up
    low: float  # Range; beyond is error 6
    high: float
    step: float = 1.0  # The card rounds down to a multiple of it
    digits: int = 8  # How `?` shows it
    decimals: int = 0
    while_running: bool = True  # False is refused with error 7 during a motion


SETTINGS = {
    "KP": Setting(default=6.0, low=0.0, high=1023.875, step=0.125, digits=4, decimals=2),
    "KI": Setting(default=0.0, low=0.0, high=2047.875, step=1.0 / 128.0, digits=4, decimals=4),
    "KD": Setting(default=64.0, low=0.0, high=4095.875, step=0.125, digits=4, decimals=2),
    "AC": Setting(default=256_000.0, low=1024.0, high=67_107_840.0, step=1024.0),
    "DC": Setting(default=256_000.0, low=1024.0, high=67_107_840.0, step=1024.0),
    "SP": Setting(default=25_000.0, low=0.0, high=12_000_000.0, step=2.0),
    "ER": Setting(default=16_384.0, low=0.0, high=32_767.0),
    "FL": Setting(default=LARGEST, low=-LARGEST - 1.0, high=LARGEST, digits=10),
    "BL": Setting(default=-LARGEST - 1.0, low=-LARGEST - 1.0, high=LARGEST, digits=10),
    "OE": Setting(default=0.0, low=0.0, high=3.0, digits=1),
    "TL": Setting(default=9.9988, low=0.0, high=9.9988, step=20.0 / 65536.0, digits=1, decimals=4),
    "TW": Setting(default=32_766.0, low=-1.0, high=32_766.0, digits=5),
    "MT": Setting(default=1.0, low=-2.5, high=2.5, step=0.5, digits=1, decimals=1, while_running=False),
    "CE": Setting(default=0.0, low=0.0, high=15.0, digits=2, while_running=False),
    "IT": Setting(default=1.0, low=0.004, high=1.0, step=1.0 / 256.0, digits=1, decimals=4),
    "TM": Setting(default=1000.0, low=31.25, high=20_000.0, step=0.5, digits=5, while_running=False),
    "CN": Setting(default=-1.0, low=-1.0, high=1.0, digits=1),
    "LZ": Setting(default=0.0, low=0.0, high=1.0, digits=1),
    "PF": Setting(default=10.0, low=1.0, high=10.4, step=0.1, digits=2, decimals=1),
    "VF": Setting(default=10.4, low=1.0, high=10.4, step=0.1, digits=2, decimals=1),
    "EO": Setting(default=0.0, low=0.0, high=1.0, digits=1),
    "CW": Setting(default=2.0, low=1.0, high=2.0, digits=1),
}


def shown(value: float, digits: int, decimals: int, bare: bool) -> str:
    """Return a number as the card prints it: a sign or a blank, leading zeros unless LZ1, a fixed count of decimals."""
    whole, point, fraction = f"{abs(value):.{decimals}f}".partition(".")
    if len(whole) > digits:
        whole, fraction = "9" * digits, "9" * len(fraction)
    if not bare:
        whole = whole.rjust(digits, "0")
    sign = "-" if value < 0.0 and (whole + fraction).strip("0") else " "
    return f"{sign}{whole}{point}{fraction}"


# ---- Card: a one-axis motion controller: its settings, its motor, its motions and what ends them.


@dataclass(frozen=True, slots=True, kw_only=True)
class CardSettings:
    """What kind of card it is."""

    revision: str = "DMC1415 Rev 1.0u"  # Answer to ^R^V
    speed_step: int = 1  # Resolution of JG, counts/s: 2 on older cards
    array_elements: int = 1000  # In all arrays together [known-low for the 1400 class; 8000 on a DMC-2x00]
    minimum_sample_us: float = 62.5  # Shortest TM that the card can keep, us; shorter is error 143
    speeds_follow_sample_time: bool = False  # True for old firmware: speeds scale with TM and are not corrected
    line_length: int = 80  # Longest command, characters; longer is error 5
    # A line begun over a serial link and not ended for so long is dropped with error 131, emulated s
    serial_timeout_s: float = 5.0
    # Axis angles at which the reverse and the forward limit switch close
    switches_deg: tuple[float, float] | None = None
    home_deg: float | None = None  # Axis angle up to which the home switch is pressed; None: nothing is wired
    echo_serial: bool = False  # EO at power-up on a serial link


@dataclass(slots=True)
class Motion:
    """What the next BG starts, and what the last motion did."""

    kind: str = "PR"  # JG, PR or PA: the one commanded last
    jog: float = 25_000.0  # counts/s
    distance: float = 0.0  # Of PR and PA, counts
    target: float = 0.0
    running: bool = False  # A motion is in progress
    stage: int = 0  # Of homing: 1 to the switch, 2 back to its edge, 3 to the index
    reason: int = STOP_DONE  # Stop code that the present motion will end with
    stop_code: int = STOP_DONE  # What SC tells


@dataclass(slots=True)
class Recording:
    """What RA, RD and RC have the card record by itself."""

    arrays: tuple[str, ...] = ()
    operands: tuple[str, ...] = ()  # "TP", "TE", ..., one for each array
    every: int = 2  # Samples from one record to the next
    wanted: int = 0  # Records
    taken: int = 0  # Records
    next_sample: float = 0.0
    running: bool = False


@dataclass(slots=True)
class Wiring:
    """What is broken or pressed, named as the faults are."""

    amplifier_fault: bool = False  # No torque; a count that does not change
    encoder_loss: bool = False
    limit_switch: bool = False  # Forward, pressed
    limit_switch_reverse: bool = False
    powered: bool = True  # False after a power cut


class Card:
    """The controller's state and what may be done to it; the language stands in galil.py."""

    def __init__(self, servo: ServoSettings, settings: CardSettings, history_s: float = 1200.0) -> None:
        self.servo = servo
        self.settings = settings
        self.axis = Axis(servo, history_s)
        self.wiring = Wiring()
        self.unsolicited: deque[str] = deque(maxlen=1000)
        self.program_status: Callable[[], tuple[int, int]] = lambda: (0, -1)  # operands _HX0 and _XQ0
        self.set_up()

    def set_up(self) -> None:
        """Set everything to what it is at power-up: motor off, the burned gains, position zero where the axis stands."""
        self.values = {name: setting.default for name, setting in SETTINGS.items()}
        self.values |= dict(zip(("KP", "KD", "KI"), self.servo.gains, strict=True))
        self.values |= {"TM": self.servo.period_s * 1e6, "TL": min(self.servo.voltage_limit, SETTINGS["TL"].high)}
        self.motion = Motion()
        self.motor_on = False
        self.variables: dict[str, float] = {}
        self.arrays: dict[str, list[float]] = {}
        self.recording = Recording()
        self.error_code = 0
        self.auxiliary = 0
        self.time_offset = self.axis.values[k.SAMPLES]
        self.axis.values[k.MODE] = k.REST
        self.axis.change(motor_on=False)
        self.axis.set_period(self.servo.period_s)
        self.apply()
        self.axis.define(0)

    def apply(self) -> None:
        """Hand settings and wiring on to the loop."""
        before = self.axis.coefficients.counts_per_rad
        self.axis.coefficients = _coefficients(self)
        if before * self.axis.coefficients.counts_per_rad < 0.0:  # the register goes on from where it is
            self.axis.change(offset=self.axis.coefficients.offset + 2.0 * self.axis.values[k.COUNT])
            self.axis.values[k.COUNT] *= -1.0
        if self.motion.running and self.motion.kind in ("JG", "HM") and self.axis.values[k.MODE] == k.JOG:
            self.axis.values[k.TARGET] = self.motion.jog * _speed_scale(self)

    @property
    def ticks(self) -> int:
        """Operand TIME: samples since reset in units of TM/1000, which are ms only to 2.4 % on cards that count 1/1024 s."""
        return int((self.axis.values[k.SAMPLES] - self.time_offset) * self.values["TM"] / 1000.0)

    def advance(self, time: float) -> None:
        """Bring the card up to a moment, and record on the way."""
        recording, axis = self.recording, self.axis
        while recording.running:
            due = axis.time + (recording.next_sample - axis.values[k.SAMPLES]) * axis.coefficients.period
            if due > time:
                break
            self._advance(due)
            for array, operand in zip(recording.arrays, recording.operands, strict=True):
                self.arrays[array][recording.taken] = value_of(self, operand)
            recording.taken += 1
            recording.next_sample += recording.every
            recording.running = recording.taken < recording.wanted
        self._advance(time)

    def _advance(self, time: float) -> None:
        self._watch_amplifier()
        while self.motion.stage in (1, 2) and self.axis.time + self.axis.coefficients.period <= time:
            looked = at_home(self)
            self._run(min(time, self.axis.time + max(HOME_LOOK_S, self.axis.coefficients.period)))
            if at_home(self) != looked and self.motion.stage:
                self._home_edge()
        self._run(time)

    def _run(self, time: float) -> None:
        while (event := self.axis.advance(time)) != k.NOTHING:
            if event == k.DONE and self.motion.stage:
                self._home_on()
            elif event == k.DONE and self.motion.running:
                self.motion.running, self.motion.stop_code = False, self.motion.reason
            elif event in (k.FORWARD_LIMIT, k.REVERSE_LIMIT):
                self.motion.stage = 0
                self.motion.reason = STOP_FORWARD if event == k.FORWARD_LIMIT else STOP_REVERSE
                if self.values["OE"] >= 2.0:
                    self._off(self.motion.reason)
            elif event == k.ERROR_LIMIT and self.values["OE"] in (1.0, 3.0):
                self._off(STOP_ERROR)

    def motor(self, on: bool) -> None:
        """Switch the servo on where the axis stands, or off."""
        if not on:
            refuse_if(self.motion.running, Error.RUNNING)
            self._off(self.motion.stop_code)
            return
        if self.motor_on:
            return
        values = self.axis.values
        values[k.REFERENCE], values[k.SPEED], values[k.BEHIND] = self.axis.register, 0.0, 0.0
        values[k.SUM] = values[k.LAST] = values[k.ERROR] = values[k.OVER] = 0.0
        values[k.MODE] = k.REST
        self.motor_on = True
        self.axis.change(motor_on=True)
        self._watch_amplifier()

    def jog(self, speed: float) -> None:
        """Take a jog speed; a jog that runs takes it at once."""
        refuse_if(self.motion.running and self.motion.kind != "JG", Error.JOG_ONLY)
        refuse_if(abs(speed) > SETTINGS["SP"].high, Error.OUT_OF_RANGE)
        self.motion.jog = float(math.trunc(speed / self.settings.speed_step) * self.settings.speed_step)
        self.motion.kind = "JG"
        self.apply()

    def aim(self, kind: str, counts: float) -> None:
        """Take the target of a positioning move, or where the axis stands (DP)."""
        refuse_if(self.motion.running, Error.RUNNING)
        refuse_if(abs(counts) > LARGEST, Error.OUT_OF_RANGE)
        if kind == "DP":
            self.axis.define(math.trunc(counts))
            return
        self.motion.kind = kind
        setattr(self.motion, "distance" if kind == "PR" else "target", float(math.trunc(counts)))

    def home(self) -> None:
        """Have the next BG look for the home switch and the encoder's index."""
        refuse_if(self.motion.running, Error.RUNNING)
        self.motion.kind = "HM"

    def _home_edge(self) -> None:
        """The home switch changed: slow down from the first approach, stop at once from the second."""
        if self.motion.stage == 1:
            self.axis.values[k.MODE] = k.STOPPING
            return
        self.axis.values[k.MODE], self.axis.values[k.SPEED] = k.REST, 0.0
        self._home_on()

    def _home_on(self) -> None:
        """Begin the next stage of homing, or end it."""
        values, motion, turn = self.axis.values, self.motion, float(self.servo.counts_per_turn)
        motion.stage += 1
        if motion.stage == 2:
            values[k.MODE], motion.jog = k.JOG, -math.copysign(HOME_SPEED, motion.jog)
        elif motion.stage == 3:  # the index: where the encoder's own count is whole turns
            own = math.ceil((values[k.REFERENCE] - self.axis.coefficients.offset) / turn) * turn
            values[k.MODE], values[k.TARGET] = k.MOVE, own + self.axis.coefficients.offset
        else:
            motion.stage, motion.running, motion.stop_code, motion.kind = 0, False, STOP_HOMED, "PR"
            self.axis.define(self.axis.register - round(values[k.REFERENCE]))
        self.apply()

    def begin(self) -> None:
        """Start the motion commanded last."""
        refuse_if(not self.motor_on, Error.MOTOR_OFF)
        refuse_if(self.motion.running, Error.BEGIN_RUNNING)
        values = self.axis.values
        target = self.motion.target if self.motion.kind == "PA" else values[k.REFERENCE] + self.motion.distance
        homing = self.motion.kind == "HM"
        if homing:
            self.motion.jog = math.copysign(self.values["SP"], 0.5 - at_home(self))
        way = self.motion.jog if homing or self.motion.kind == "JG" else target - values[k.REFERENCE]
        at_forward, at_reverse = limits_closed(self)
        refuse_if((way > 0.0 and at_forward) or (way < 0.0 and at_reverse), Error.AT_LIMIT)
        self.motion.running, self.motion.reason, self.motion.stop_code = True, STOP_DONE, STOP_RUNNING
        values[k.MODE] = k.JOG if homing or self.motion.kind == "JG" else k.MOVE
        self.motion.stage = int(homing)
        values[k.TARGET] = target
        self.apply()

    def stop(self) -> None:
        """Slow down to rest; the motor stays on."""
        if self.motion.running:
            self.axis.values[k.MODE], self.motion.stage = k.STOPPING, 0
            self.motion.reason = STOP_ASKED

    def abort(self, stop_code: int = STOP_ABORTED) -> None:
        """Stop the profile at once; the motor stays on."""
        self.axis.values[k.MODE], self.axis.values[k.SPEED] = k.REST, 0.0
        self.axis.values[k.BEHIND] = 0.0
        self.motion.stage = 0
        if self.motion.running:
            self.motion.running, self.motion.stop_code = False, stop_code

    def _off(self, stop_code: int) -> None:
        self.motor_on, self.motion.running = False, True
        self.axis.change(motor_on=False)
        self.abort(stop_code)

    def _watch_amplifier(self) -> None:
        if self.wiring.amplifier_fault and self.motor_on and self.values["OE"] in (1.0, 3.0):
            self._off(STOP_ERROR)


def set_sample_time(card: Card, microseconds: float) -> None:
    """Change TM. Multiples of 125 us are counted in 1/1024 s: TM 1000 is 976.6 us."""
    refuse_if(microseconds < card.settings.minimum_sample_us, Error.PERIOD_TIMEOUT)
    ticks = card.ticks
    old_card = microseconds % 125.0 == 0.0
    card.axis.set_period(microseconds * (1e-3 / 1024.0 if old_card else 1e-6))
    card.values["TM"] = microseconds
    card.time_offset = card.axis.values[k.SAMPLES] - ticks * 1000.0 / microseconds
    card.apply()


def check_motor_type(card: Card, value: float) -> None:
    """Refuse a stepper on a card without its jumper, what is no type, and any change while the motor is on."""
    refuse_if(abs(value) not in (1.0, 1.5, 2.0, 2.5), Error.OUT_OF_RANGE)
    refuse_if(card.motor_on, Error.MOTOR_ON)
    refuse_if(abs(value) >= 2.0, Error.NO_JUMPER)


def at_home(card: Card) -> int:
    """Return operand _HM: 1 while the home switch is open, as an input to which nothing is wired."""
    pressed = card.settings.home_deg
    return int(pressed is None or math.degrees(float(card.axis.values[k.ANGLE])) > pressed)


def limits_closed(card: Card) -> tuple[bool, bool]:
    """Tell whether the card may not go forward, or back: a switch is active, or the reference is beyond FL or BL."""
    c, count, reference = card.axis.coefficients, card.axis.values[k.COUNT], card.axis.values[k.REFERENCE]
    forward = c.forward_closed or count >= c.forward_at or reference > c.forward
    return bool(forward), bool(c.reverse_closed or count <= c.reverse_at or reference < c.reverse)


def _speed_scale(card: Card) -> float:
    return card.servo.period_s / card.axis.coefficients.period if card.settings.speeds_follow_sample_time else 1.0


def _coefficients(card: Card) -> Coefficients:
    v, w, scale = card.values, card.wiring, _speed_scale(card)
    low, high = card.settings.switches_deg or (-math.inf, math.inf)
    reversed_encoder = (int(v["CE"]) & 2) != 0
    high_level = v["CN"] == 1.0  # then a switch that is not pressed counts as active
    return card.axis.coefficients._replace(
        proportional=4.0 * v["KP"],
        derivative=4.0 * v["KD"],
        integral=0.5 * v["KI"],
        clip=card.servo.voltage_limit if v["TL"] >= SETTINGS["TL"].high else v["TL"],
        acceleration=v["AC"] * scale**2,
        deceleration=v["DC"] * scale**2,
        slew=max((v["SP"] if card.motion.stage == 0 else HOME_SPEED) * scale, 1e-9),
        smoothing=v["IT"],
        volts_per_count=math.copysign(card.servo.volts_per_count, v["MT"]),
        counts_per_rad=card.servo.counts_per_rad * (-1.0 if reversed_encoder else 1.0),
        error_limit=v["ER"] if v["ER"] > 0.0 else math.inf,
        forward=v["FL"],
        reverse=v["BL"],
        powered=w.powered,
        amplifier_good=not w.amplifier_fault,
        encoder_good=not w.encoder_loss,
        forward_closed=w.limit_switch != high_level,
        reverse_closed=w.limit_switch_reverse != high_level,
        # turning away from them by a reversed encoder closes neither
        forward_at=math.inf if reversed_encoder else math.radians(high) * card.servo.counts_per_rad,
        reverse_at=-math.inf if reversed_encoder else math.radians(low) * card.servo.counts_per_rad,
    )


# ---- Expressions of the card's language: numbers, operands, variables and functions, worked from left to right.

BOUND = 2_147_483_648.0
DEEPEST = 20  # nested parentheses

_NUMBER = re.compile(r"\$[0-9A-F]+(?:\.[0-9A-F]+)?|\d+(?:\.\d*)?|\.\d+")
_WORD = re.compile(r"_?[A-Z][A-Z0-9]*")
_OPERATORS: dict[str, Callable[[float, float], float]] = {  # two letters before one
    "<=": operator.le, ">=": operator.ge, "<>": operator.ne, "+": operator.add, "-": operator.sub, "*": operator.mul,
    "/": operator.truediv, "&": lambda a, b: int(a) & int(b), "|": lambda a, b: int(a) | int(b), "%": math.fmod,
    "<": operator.lt, ">": operator.gt, "=": operator.eq,
}  # fmt: skip
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "@ABS": abs,
    "@INT": lambda x: float(math.trunc(x)),
    "@FRAC": lambda x: x - math.trunc(x),
    "@RND": lambda x: float(math.floor(x + 0.5)),
    "@SQR": lambda x: math.sqrt(abs(x)),
    "@SIN": lambda x: math.sin(math.radians(x)),
    "@COS": lambda x: math.cos(math.radians(x)),
    "@COM": lambda x: float(~int(x)),
    "@IN": lambda x: 1.0,  # inputs are pulled up
}


def evaluate(card: Card, text: str) -> float:
    """Return the value of an expression."""
    reader = _Reader(card, text)
    value = reader.expression(0)
    if reader.rest():
        raise Refused(Error.PARENTHESES if reader.rest()[0] in ")]" else Error.NOT_A_NUMBER)
    return value


class _Reader:
    def __init__(self, card: Card, text: str) -> None:
        self._card, self._text = card, text.strip()

    def rest(self, taken: int = 0) -> str:
        self._text = self._text[taken:].lstrip(" ")
        return self._text

    def expression(self, depth: int) -> float:
        refuse_if(depth > DEEPEST, Error.PARENTHESES)
        value = self._term(depth)
        while (sign := next((s for s in _OPERATORS if self.rest().startswith(s)), None)) is not None:
            self.rest(len(sign))
            other = self._term(depth)
            refuse_if(sign in "/%" and other == 0.0, Error.OUT_OF_RANGE)
            value = _bounded(float(_OPERATORS[sign](value, other)))
        return value

    def _term(self, depth: int) -> float:
        rest = self.rest()
        if rest.startswith(("-", "+")):
            self.rest(1)
            value = self._term(depth + 1) if depth < DEEPEST else 0.0
            return -value if rest[0] == "-" else value
        if rest.startswith("("):
            self.rest(1)
            return self._closed(")", depth)
        if rest.startswith("@"):
            name = rest.split("[", 1)[0]
            refuse_if(name not in _FUNCTIONS or "[" not in rest, Error.UNKNOWN)
            self.rest(len(name) + 1)
            return _bounded(_FUNCTIONS[name](self._closed("]", depth)))
        if match := _NUMBER.match(rest):
            self.rest(match.end())
            return _bounded(_number(match.group()))
        if match := _WORD.match(rest):
            self.rest(match.end())
            name = match.group()
            wanted = operand_value if name.startswith("_") or name == "TIME" else variable_value
            return wanted(self._card, name)
        raise Refused(Error.OPERAND if rest.startswith("_") else Error.NOT_A_NUMBER)

    def _closed(self, end: str, depth: int) -> float:
        value = self.expression(depth + 1)
        refuse_if(not self.rest().startswith(end), Error.PARENTHESES)
        self.rest(1)
        return value


def _number(text: str) -> float:
    if not text.startswith("$"):
        return float(text)
    whole, _, fraction = text[1:].partition(".")
    return float(int(whole, 16)) + (int(fraction, 16) / 16.0 ** len(fraction) if fraction else 0.0)


def _bounded(value: float) -> float:
    refuse_if(not abs(value) < BOUND, Error.OUT_OF_RANGE)
    return value


VARIABLE_NAME = re.compile(r"[A-Z][A-Z0-9]{0,7}")


# ---- Tell: what the card says about itself, as words, as operands of MG and as the binary record of QR.

TELL = ("TP", "TE", "TV", "TT", "RP", "TD", "TS", "SC", "TB", "TI")


def switches(card: Card) -> int:
    """Return the byte of TS."""
    forward, reverse = limits_closed(card)
    bits = (
        card.motion.running,
        card.axis.values[k.OVER],
        not card.motor_on,
        False,
        not forward,
        not reverse,
        at_home(card),
    )
    return sum(bool(bit) << (7 - place) for place, bit in enumerate(bits))


def value_of(card: Card, word: str) -> float:
    """Return the number that a two-letter word stands for."""
    motion, values = card.motion, card.axis.values
    if word in card.values:
        return card.values[word]
    known = {
        "TP": card.axis.register, "DP": card.axis.register, "TE": round(values[k.ERROR]), "TV": card.axis.velocity_counts,
        "TT": values[k.VOLTAGE], "RP": int(values[k.REFERENCE] // 1), "TD": card.auxiliary, "DE": card.auxiliary,
        "TS": switches(card), "SC": motion.stop_code, "TC": card.error_code, "BG": motion.running, "MO": not card.motor_on,
        "JG": motion.jog, "PR": motion.distance, "PA": motion.target,
        "RC": card.recording.running, "RD": card.recording.taken,
        "LF": not limits_closed(card)[0], "LR": not limits_closed(card)[1], "HM": at_home(card), "TI": 255, "AB": 1,
        "TB": (card.program_status()[0] > 0) << 7 | int(card.values["EO"]),
    }  # fmt: skip
    refuse_if(word not in known, Error.OPERAND)
    return float(known[word])


def operand_value(card: Card, name: str) -> float:
    """Return an operand such as _TPX, or TIME."""
    if name == "TIME":
        return float(card.ticks)
    word, axis = name[1:3], name[3:]
    if name in ("_HX", "_HX0", "_XQ", "_XQ0"):
        return float(card.program_status()[word == "XQ"])
    refuse_if(len(word) < 2 or axis not in ("X", "A", ""), Error.OPERAND)
    return value_of(card, word)


def variable_value(card: Card, name: str) -> float:
    """Return a variable."""
    refuse_if(name not in card.variables, Error.VARIABLE)
    return card.variables[name]


def reported(card: Card, word: str) -> str:
    """Return the answer to a tell word or to `word ?`, in its own format."""
    bare = card.values["LZ"] == 1.0
    value = value_of(card, word)
    if word in SETTINGS:
        return shown(value, SETTINGS[word].digits, SETTINGS[word].decimals, bare)
    if word in ("TP", "TE", "RP", "TD", "PR", "PA", "DP", "DE"):
        return shown(value, *places(card.values["PF"]), bare)
    digits = {"TV": (7, 0), "JG": (8, 0), "TT": (1, 4)}.get(word, (3, 0))
    return shown(value, *digits, bare)


def places(number: float) -> tuple[int, int]:
    """Return digits and decimals of a format such as 10.4."""
    tenths = round(number * 10.0)
    return tenths // 10, tenths % 10


def record(card: Card) -> str:
    """Return the binary record of QR: a header, the sample number, the inputs, one block of 28 bytes for the axis."""
    block = struct.pack(
        "<HBBiiiiihH",
        (int(card.motion.running) << 15) | int(not card.motor_on), switches(card), card.motion.stop_code,
        *(max(-(2**31), min(2**31 - 1, round(value_of(card, word)))) for word in ("RP", "TP", "TE", "TD", "TV")),
        max(-32_768, min(32_767, round(card.axis.values[k.VOLTAGE] * 32_767.0 / 10.0))), 0,
    )  # fmt: skip
    body = struct.pack("<HBBBB", card.ticks & 0xFFFF, 0xFF, 0, card.error_code & 0xFF, 0) + block
    return (struct.pack("<BBH", 0x85, 0x01, len(body) + 4) + body).decode("latin-1")
