"""Card: an emulated one-axis Galil controller: its settings, its motor, its motions, its numbers and what it tells.

Time is the axis's; `advance` brings both up to a moment and handles what happened on the way, in order. Ranges, steps and defaults
of settings are those of the 1400 class as DOMAIN 3.1 gathers them; codes are those of its TC table. Expressions are worked from
left to right: the card knows no precedence, 1+2*3 is 9. Comparisons give 1 or 0. Numbers lie within +-2147483647.9999.
"""

import math
import operator
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from testkit.emulated import servo_kernel as k
from testkit.emulated.axes import MotorAxis, ServoSettings
from testkit.emulated.servo_kernel import Coefficients

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
    NO_ROOM = 66, "Array space full"
    RECORDING_RUNS = 80, "Record mode already running"
    NO_ARRAY = 82, "Undefined array"
    NOT_A_NUMBER = 83, "Not a valid number"
    SERIAL_TIMEOUT = 131, "Serial port timeout"
    PERIOD_TIMEOUT = 143, "TM timed out"


ERROR_TEXT: dict[int, str] = dict(error.value for error in Error)
STOP_RUNNING, STOP_DONE, STOP_FORWARD, STOP_REVERSE, STOP_ASKED = 0, 1, 2, 3, 4
STOP_ABORT_INPUT, STOP_ABORTED, STOP_ERROR = 6, 7, 8

LARGEST = 2_147_483_647.0


class CardError(Exception):
    """The card answers `?`; TC tells the code."""

    def __init__(self, error: Error) -> None:
        self.code, text = error.value
        super().__init__(text)


def refuse_if(wrong: object, error: Error) -> None:
    """Refuse where something is wrong."""
    if wrong:
        raise CardError(error)


@dataclass(frozen=True, slots=True, kw_only=True)
class CardSetting:
    """One number that a command sets."""

    default: float  # At power-up
    low: float  # Range; beyond is error 6
    high: float
    step: float = 1.0  # The card rounds down to a multiple of it
    digits: int = 8  # How `?` shows it
    decimals: int = 0
    while_running: bool = True  # False is refused with error 7 during a motion


SETTINGS = {
    "KP": CardSetting(default=6.0, low=0.0, high=1023.875, step=0.125, digits=4, decimals=2),
    "KI": CardSetting(default=0.0, low=0.0, high=2047.875, step=1.0 / 128.0, digits=4, decimals=4),
    "KD": CardSetting(default=64.0, low=0.0, high=4095.875, step=0.125, digits=4, decimals=2),
    "AC": CardSetting(default=256_000.0, low=1024.0, high=67_107_840.0, step=1024.0),
    "DC": CardSetting(default=256_000.0, low=1024.0, high=67_107_840.0, step=1024.0),
    "SP": CardSetting(default=25_000.0, low=0.0, high=12_000_000.0, step=2.0),
    "ER": CardSetting(default=16_384.0, low=0.0, high=32_767.0),
    "FL": CardSetting(default=LARGEST, low=-LARGEST - 1.0, high=LARGEST, digits=10),
    "BL": CardSetting(default=-LARGEST - 1.0, low=-LARGEST - 1.0, high=LARGEST, digits=10),
    "OE": CardSetting(default=0.0, low=0.0, high=3.0, digits=1),
    "TM": CardSetting(default=1000.0, low=31.25, high=20_000.0, step=0.5, digits=5, while_running=False),
    "LZ": CardSetting(default=0.0, low=0.0, high=1.0, digits=1),
    "PF": CardSetting(default=10.0, low=1.0, high=10.4, step=0.1, digits=2, decimals=1),
    "CW": CardSetting(default=2.0, low=1.0, high=2.0, digits=1),
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
    line_length: int = 80  # Longest command, characters; longer is error 5
    # A line begun over a serial link and not ended for so long is dropped with error 131, emulated s
    serial_timeout_s: float = 5.0


@dataclass(slots=True)
class CardMotion:
    """What the next BG starts, and what the last motion did."""

    kind: str = "PR"  # JG, PR or PA: the one commanded last
    jog: float = 25_000.0  # counts/s
    distance: float = 0.0  # Of PR and PA, counts
    target: float = 0.0
    running: bool = False  # A motion is in progress
    reason: int = STOP_DONE  # Stop code that the present motion will end with
    stop_code: int = STOP_DONE  # What SC tells


@dataclass(slots=True)
class CardRecording:
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
        self.axis = MotorAxis(servo, history_s)
        self.wiring = Wiring()
        self.unsolicited: deque[str] = deque(maxlen=1000)
        self.program_status: Callable[[], int] = lambda: 0  # operand _HX0
        self.set_up()

    def set_up(self) -> None:
        """Set everything to what it is at power-up: motor off, the burned gains, position zero where the axis stands."""
        self.values = {name: setting.default for name, setting in SETTINGS.items()}
        self.values |= dict(zip(("KP", "KD", "KI"), self.servo.gains, strict=True))
        self.values["TM"] = self.servo.period_s * 1e6
        self.motion = CardMotion()
        self.motor_on = False
        self.variables: dict[str, float] = {}
        self.arrays: dict[str, list[float]] = {}
        self.recording = CardRecording()
        self.error_code = 0
        self.time_offset = self.axis.values[k.SAMPLES]
        self.axis.values[k.MODE] = k.REST
        self.axis.change(motor_on=False, period=self.servo.period_s)
        self.apply()
        self.axis.define(0)

    def apply(self) -> None:
        """Hand settings and wiring on to the loop."""
        self.axis.coefficients = _coefficients(self)
        if self.motion.running and self.motion.kind == "JG" and self.axis.values[k.MODE] == k.JOG:
            self.axis.values[k.TARGET] = self.motion.jog

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
        while (event := self.axis.advance(time)) != k.NOTHING:
            if event == k.DONE and self.motion.running:
                self.motion.running, self.motion.stop_code = False, self.motion.reason
            elif event in (k.FORWARD_LIMIT, k.REVERSE_LIMIT):
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
        values[k.REFERENCE], values[k.SPEED] = self.axis.register, 0.0
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

    def begin(self) -> None:
        """Start the motion commanded last."""
        refuse_if(not self.motor_on, Error.MOTOR_OFF)
        refuse_if(self.motion.running, Error.BEGIN_RUNNING)
        values = self.axis.values
        target = self.motion.target if self.motion.kind == "PA" else values[k.REFERENCE] + self.motion.distance
        jogs = self.motion.kind == "JG"
        way = self.motion.jog if jogs else target - values[k.REFERENCE]
        at_forward, at_reverse = limits_closed(self)
        refuse_if((way > 0.0 and at_forward) or (way < 0.0 and at_reverse), Error.AT_LIMIT)
        self.motion.running, self.motion.reason, self.motion.stop_code = True, STOP_DONE, STOP_RUNNING
        values[k.MODE] = k.JOG if jogs else k.MOVE
        values[k.TARGET] = target
        self.apply()

    def stop(self) -> None:
        """Slow down to rest; the motor stays on."""
        if self.motion.running:
            self.axis.values[k.MODE] = k.STOPPING
            self.motion.reason = STOP_ASKED

    def abort(self, stop_code: int = STOP_ABORTED) -> None:
        """Stop the profile at once; the motor stays on."""
        self.axis.values[k.MODE], self.axis.values[k.SPEED] = k.REST, 0.0
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
    card.axis.change(period=microseconds * (1e-3 / 1024.0 if old_card else 1e-6))
    card.values["TM"] = microseconds
    card.time_offset = card.axis.values[k.SAMPLES] - ticks * 1000.0 / microseconds
    card.apply()


def limits_closed(card: Card) -> tuple[bool, bool]:
    """Tell whether the card may not go forward, or back: a switch is active, or the reference is beyond FL or BL."""
    c, reference = card.axis.coefficients, card.axis.values[k.REFERENCE]
    return bool(c.forward_closed or reference > c.forward), bool(c.reverse_closed or reference < c.reverse)


def _coefficients(card: Card) -> Coefficients:
    v, w = card.values, card.wiring
    return card.axis.coefficients._replace(
        proportional=4.0 * v["KP"],
        derivative=4.0 * v["KD"],
        integral=0.5 * v["KI"],
        acceleration=v["AC"],
        deceleration=v["DC"],
        slew=max(v["SP"], 1e-9),
        error_limit=v["ER"] if v["ER"] > 0.0 else math.inf,
        forward=v["FL"],
        reverse=v["BL"],
        powered=w.powered,
        amplifier_good=not w.amplifier_fault,
        encoder_good=not w.encoder_loss,
        forward_closed=w.limit_switch,
        reverse_closed=w.limit_switch_reverse,
    )


# ---- Expressions of the card's language: numbers, operands and variables, worked from left to right.

_TOKEN = re.compile(r"<=|>=|<>|[-+*/<>=()]|\d+(?:\.\d*)?|\.\d+|_?[A-Z][A-Z0-9]*")
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "<=": operator.le, ">=": operator.ge, "<>": operator.ne, "+": operator.add, "-": operator.sub, "*": operator.mul,
    "/": operator.truediv, "<": operator.lt, ">": operator.gt, "=": operator.eq,
}  # fmt: skip


def evaluate(card: Card, text: str) -> float:
    """Return the value of an expression."""
    refuse_if("@" in text, Error.UNKNOWN)  # a function
    tokens = deque(_TOKEN.findall(text))
    refuse_if("".join(tokens) != text.replace(" ", ""), Error.NOT_A_NUMBER)
    value = _expression(card, tokens)
    if tokens:
        raise CardError(Error.PARENTHESES if tokens[0] == ")" else Error.NOT_A_NUMBER)
    return value


def _expression(card: Card, tokens: deque[str]) -> float:
    value = _term(card, tokens)
    while tokens and tokens[0] in _OPERATORS:
        sign, other = tokens.popleft(), _term(card, tokens)
        refuse_if(sign == "/" and other == 0.0, Error.OUT_OF_RANGE)
        value = _bounded(float(_OPERATORS[sign](value, other)))
    return value


def _term(card: Card, tokens: deque[str]) -> float:
    token = tokens.popleft() if tokens else ""
    if token == "-":
        return -_term(card, tokens)
    if token == "(":
        value = _expression(card, tokens)
        refuse_if(not tokens or tokens.popleft() != ")", Error.PARENTHESES)
        return value
    refuse_if(token in ("", ")", *_OPERATORS), Error.NOT_A_NUMBER)
    if token[0] in ".0123456789":
        return _bounded(float(token))
    return (operand_value if token[0] == "_" or token == "TIME" else variable_value)(card, token)


def _bounded(value: float) -> float:
    refuse_if(not abs(value) <= LARGEST + 0.9999, Error.OUT_OF_RANGE)
    return value


VARIABLE_NAME = re.compile(r"[A-Z][A-Z0-9]{0,7}")


# ---- Tell: what the card says about itself, as words and as operands of MG.

TELL = ("TP", "TE", "RP", "TS", "SC")


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
        True,  # nothing is wired to the home input
    )
    return sum(bool(bit) << (7 - place) for place, bit in enumerate(bits))


def value_of(card: Card, word: str) -> float:
    """Return the number that a two-letter word stands for."""
    motion, values = card.motion, card.axis.values
    if word in card.values:
        return card.values[word]
    known = {
        "TP": card.axis.register, "TE": round(values[k.ERROR]), "RP": int(values[k.REFERENCE] // 1),
        "TS": switches(card), "SC": motion.stop_code, "TC": card.error_code, "BG": motion.running, "MO": not card.motor_on,
        "JG": motion.jog, "PR": motion.distance, "PA": motion.target,
        "RC": card.recording.running, "RD": card.recording.taken,
        "LF": not limits_closed(card)[0], "LR": not limits_closed(card)[1], "HM": 1, "MT": 1,
    }  # fmt: skip
    refuse_if(word not in known, Error.OPERAND)
    return float(known[word])


def operand_value(card: Card, name: str) -> float:
    """Return an operand such as _TPX, or TIME."""
    if name == "TIME":
        return float(card.ticks)
    word, axis = name[1:3], name[3:]
    if name in ("_HX", "_HX0"):
        return float(card.program_status())
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
    if word in ("TP", "TE", "RP", "PR", "PA"):
        return shown(value, *divmod(round(card.values["PF"] * 10.0), 10), bare)
    return shown(value, 8 if word == "JG" else 3, 0, bare)
