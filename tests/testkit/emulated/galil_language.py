r"""Galil: the ASCII language of a one-axis card, read by a parser of its own, and the machine that clients share.

Two upper-case letters and arguments; `;` or a carriage return ends a command. Each command is answered by its text, if it has
one, with CR LF, and `:`; or by `?`, after which the rest of the line is dropped and TC tells why.

A program is lines kept on the card and run there, with trippoints: DL .. \ loads, LS lists, XQ runs from a label, HX halts,
as ST and AB without an argument do. JP, EN, AM and WT mean something only here. What a program prints nobody
asked for; a command that fails ends it with `?`, the line number and the line.
"""

import math
import re
from collections.abc import Callable
from typing import cast

from testkit.emulated import servo_kernel as k
from testkit.emulated.axes import ServoSettings
from testkit.emulated.galil_card import (
    ERROR_TEXT,
    SETTINGS,
    STOP_ABORT_INPUT,
    TELL,
    VARIABLE_NAME,
    Card,
    CardError,
    CardRecording,
    CardSettings,
    Error,
    evaluate,
    refuse_if,
    reported,
    set_sample_time,
    shown,
    variable_value,
)
from testkit.emulated.server import ClientSession, Machine
from undrift.arrays import FloatArray
from undrift.base.clock import Clock

ONLY_PROGRAM_WORDS = ("AM", "WT", "MC", "JP", "EN")
NOT_PROGRAM_WORDS = ("DL", "LS", "RS")
REVISION = "\x12\x16"
CRLF = "\r\n"
VARIABLE_FORMAT = 10, 4  # digits before and behind the point

_AXIS_EQUALS = re.compile(r"\s*([A-Z*])\s*=(.*)", re.S)
_ITEM = re.compile(r'(?:[^,"]|"[^"]*")+')
_SHOWN = re.compile(r'("[^"]*"|[^"{}]+)(?:\{F(\d{1,2})(?:\.(\d))?\})?')
_ASSIGNMENT = re.compile(r"([A-Z][A-Z0-9]*)\s*=(.*)", re.S)
_WITH_VALUE = (*SETTINGS, "JG", "PR", "PA", "DP")


def execute(card: Card, command: str, in_program: bool = False) -> str:
    """Do one command."""
    text = command.strip(" ")
    if not text:
        return ""
    if text == REVISION:
        return card.settings.revision + CRLF
    word, rest = text[:2], text[2:]
    refuse_if(in_program and word in NOT_PROGRAM_WORDS, Error.NOT_IN_PROGRAM)
    refuse_if(not in_program and word in ONLY_PROGRAM_WORDS, Error.ONLY_IN_PROGRAM)
    known = word in _WORDS or word in _ACTS or word in _WITH_VALUE or word in TELL
    if not known or (re.match(r"[A-Z0-9]{2,}\s*=", rest) is not None):
        return _assign(card, text)
    if word in _WITH_VALUE:
        return _valued(card, word, rest)
    if word in _WORDS:
        return _WORDS[word](card, rest)
    _axes(rest)
    if word in TELL:
        return reported(card, word) + CRLF
    _ACTS[word](card)
    return ""


def _assign(card: Card, text: str) -> str:
    match = _ASSIGNMENT.fullmatch(text)
    if match is None or not VARIABLE_NAME.fullmatch(match.group(1)):
        raise CardError(Error.UNKNOWN)
    name, expression = match.group(1), match.group(2).strip()
    if expression:
        card.variables[name] = evaluate(card, expression)
        return ""
    return shown(variable_value(card, name), *VARIABLE_FORMAT, card.values["LZ"] == 1.0) + CRLF


def _argument(rest: str) -> str:
    # the field of the only axis: "1000", " 1000,,", "X=1000", "*=1000" or "?"
    match = _AXIS_EQUALS.fullmatch(rest)
    if match is not None:
        refuse_if(match.group(1) not in "AX*", Error.OPERAND)
        fields = [match.group(2)]
    else:
        fields = rest.lstrip(" =").split(",")
    refuse_if(any(field.strip() for field in fields[1:]), Error.OPERAND)
    field = fields[0].strip()
    refuse_if(not field, Error.NOT_ENOUGH)
    return field


def _axes(rest: str) -> None:
    letters = rest.strip().replace(",", "")
    refuse_if("?" in letters, Error.NO_QUESTION)
    refuse_if(any(letter not in "AX" for letter in letters), Error.OPERAND)


def _valued(card: Card, word: str, rest: str) -> str:
    field = _argument(rest)
    if field == "?":
        return reported(card, word) + CRLF
    value = evaluate(card, field)
    if word == "JG":
        card.jog(value)
    elif word in ("PR", "PA", "DP"):
        card.aim(word, value)
    else:
        _set(card, word, value)
    return ""


def _set(card: Card, word: str, value: float) -> None:
    setting = SETTINGS[word]
    refuse_if(not setting.low <= value <= setting.high, Error.OUT_OF_RANGE)
    refuse_if(card.motion.running and not setting.while_running, Error.RUNNING)
    rounded = math.trunc(value / setting.step + math.copysign(1e-9, value)) * setting.step
    if word == "TM":
        set_sample_time(card, rounded)
        return
    card.values[word] = rounded
    card.apply()


def _reset(card: Card) -> None:
    card.abort()
    card.set_up()


_ACTS: dict[str, Callable[[Card], None]] = {
    "SH": lambda card: card.motor(True),
    "MO": lambda card: card.motor(False),
    "BG": Card.begin,
    "ST": Card.stop,
    "RS": _reset,
}


def _abort(card: Card, rest: str) -> str:
    if rest.strip() not in ("", "0", "1"):
        raise CardError(Error.OUT_OF_RANGE if rest.strip().isdigit() else Error.OPERAND)
    card.abort()
    return ""


def _tell_code(card: Card, rest: str) -> str:
    argument = rest.strip()
    if argument not in ("", "0", "1"):
        raise CardError(Error.NO_QUESTION if argument == "?" else Error.OUT_OF_RANGE)
    code, card.error_code = card.error_code, 0
    return (f"{code} {ERROR_TEXT[code]}".rstrip() if argument == "1" else str(code)) + CRLF


def _message(card: Card, rest: str) -> str:
    refuse_if(rest.count('"') % 2, Error.NOT_A_NUMBER)
    text, items = "", [item.strip() for item in _ITEM.findall(rest) if item.strip()]
    refuse_if(not items, Error.NOT_ENOUGH)
    for item in items:  # "text", a value, or a value with its digits: _TPX{F10.0}
        match = _SHOWN.fullmatch(item)
        if match is None:
            raise CardError(Error.OPERAND)
        body, digits, decimals = match.groups()
        if body.startswith('"'):
            text += body[1:-1]
        elif digits is None:
            text += shown(evaluate(card, body), *VARIABLE_FORMAT, True)
        else:
            text += shown(evaluate(card, body), int(digits), int(decimals or 0), False)
    return text + CRLF


# ---- Arrays, and what the card records into them (manuals DMC-1700/1800 p. 159, DMC-1600 p. 142).

_ARRAY = re.compile(r"([A-Z][A-Z0-9]{0,7})\[(\d{0,4})\]")


def _arrays(rest: str, sized: bool) -> list[tuple[str, int]]:
    found = [_ARRAY.fullmatch(item.strip()) for item in rest.split(",")]
    refuse_if(not all(match and bool(match.group(2)) == sized for match in found), Error.OPERAND)
    return [(match.group(1), int(match.group(2) or 0)) for match in found if match]


def _define_arrays(card: Card, rest: str) -> str:
    wanted = _arrays(rest, sized=True)
    held = sum(map(len, card.arrays.values()))
    refuse_if(held + sum(size for _, size in wanted) > card.settings.array_elements, Error.NO_ROOM)
    _no_longer_recorded(card)
    card.arrays |= {name: [0.0] * size for name, size in wanted}
    return ""


def _free_arrays(card: Card, rest: str) -> str:
    names = _arrays(rest, sized=False)
    _no_longer_recorded(card)
    for name, _ in names:
        card.arrays.pop(name, None)
    return ""


def _no_longer_recorded(card: Card) -> None:
    refuse_if(card.recording.running, Error.RECORDING_RUNS)
    card.recording = CardRecording()


def _record_into(card: Card, rest: str) -> str:
    names = tuple(name for name, _ in _arrays(rest, sized=False))
    refuse_if(any(name not in card.arrays for name in names), Error.NO_ARRAY)
    card.recording = CardRecording(arrays=names)
    return ""


def _record_what(card: Card, rest: str) -> str:
    operands = [item.strip() for item in rest.split(",")]
    if any(item[:1] != "_" or item[1:3] not in TELL or item[3:] not in ("A", "X") for item in operands):
        raise CardError(Error.OPERAND)
    card.recording.operands = tuple(item[1:3] for item in operands)
    return ""


def _record(card: Card, rest: str) -> str:
    recording = card.recording
    exponent, _, count = rest.partition(",")
    power = int(evaluate(card, exponent))
    refuse_if(not 0 <= power <= 8, Error.OUT_OF_RANGE)
    if power == 0:
        recording.running = False
        return ""
    refuse_if(recording.running, Error.RECORDING_RUNS)
    refuse_if(not recording.arrays or len(recording.arrays) != len(recording.operands), Error.NO_ARRAY)
    room = min(len(card.arrays[name]) for name in recording.arrays)
    wanted = int(evaluate(card, count)) if count.strip() else room
    refuse_if(not 1 <= wanted <= room, Error.OUT_OF_RANGE)
    recording.every, recording.wanted, recording.taken, recording.running = 2**power, wanted, 0, True
    recording.next_sample = card.axis.values[k.SAMPLES] + recording.every
    return ""


def _upload(card: Card, rest: str) -> str:
    name, *numbers = rest.split(",")
    ((array, _),) = _arrays(name, sized=False)
    refuse_if(array not in card.arrays, Error.NO_ARRAY)
    refuse_if(len(numbers) != 3, Error.NOT_ENOUGH)
    first, last, commas = (int(evaluate(card, text)) for text in numbers)
    values = card.arrays[array][max(first, 0) : last + 1]
    refuse_if(not values or commas != 1, Error.OUT_OF_RANGE)
    return ", ".join(shown(value, *VARIABLE_FORMAT, True) for value in values) + CRLF


_WORDS: dict[str, Callable[[Card, str], str]] = {
    "AB": _abort, "TC": _tell_code, "MG": _message, "DM": _define_arrays, "DA": _free_arrays, "RA": _record_into,
    "RD": _record_what, "RC": _record, "QU": _upload, "CF": lambda card, rest: "", "EO": lambda card, rest: "",
}  # fmt: skip


# ---- Program: lines kept on the card and run there, with trippoints.

SLICE_S = 1e-3  # emulated time between looks at a program
AT_ONCE = 50  # commands in a slice
LONGEST, MOST = 80, 250  # characters of a line, lines

_STATEMENT = re.compile(r'(?:[^;"]|"[^"]*")+')


class Program:
    """The one program of a card."""

    def __init__(self, card: Card) -> None:
        self._card = card
        self._lines: list[str] = []
        self._todo: list[tuple[int, str]] = []
        self._next: int | None = None  # next line; None when nothing runs
        self._until: float | None = None  # operand TIME that WT waits for
        self._waiting = False  # AM
        card.program_status = self._status

    @property
    def running(self) -> bool:
        """Whether lines are being executed."""
        return self._next is not None

    def halt(self) -> None:
        """Stop executing lines."""
        self._next, self._todo, self._until, self._waiting = None, [], None, False

    def _status(self) -> int:
        """Return operand _HX0: 0 at rest, 1 runs, 2 at a trippoint."""
        return 0 if self._next is None else 2 if self._waiting or self._until is not None else 1

    def load(self, text: str) -> None:
        """Replace the program."""
        lines = text.strip("\r").split("\r")
        refuse_if(len(lines) > MOST or any(len(line) > LONGEST for line in lines), Error.LINE_TOO_LONG)
        self._lines = lines

    def command(self, line: str) -> str | None:
        """Do a command about the program."""
        text = line.strip()
        word, rest = text[:2], text[2:].strip()
        if word == "DL" and not rest:
            refuse_if(self.running, Error.PROGRAM_RUNNING)
            return "DL"
        if word == "LS" and not rest:
            return "".join(f"{number} {line}{CRLF}" for number, line in enumerate(self._lines))
        if word == "XQ":
            label, _, thread = rest.partition(",")
            refuse_if(self.running, Error.STRAND_RUNNING)
            refuse_if(thread.strip() not in ("", "0"), Error.OUT_OF_RANGE)  # there is one
            self._next = self._label(label) if label else 0
            return ""
        if word == "HX" and rest in ("", "0"):
            refuse_if(not self.running, Error.NOT_RUNNING)
            self.halt()
            return ""
        if (word == "AB" and rest not in ("1", "?")) or (word == "ST" and not rest):
            self.halt()
        return None

    def advance(self, time: float) -> None:
        """Bring card and program up to a moment."""
        card = self._card
        while self.running and card.axis.time < time - SLICE_S:
            card.advance(min(card.axis.time + max(SLICE_S, self._waits_s() - SLICE_S), time))
            self._step()
        card.advance(time)
        if self.running:
            self._step()

    def _waits_s(self) -> float:
        """Return how long it does nothing, s of the card."""
        ticks = 0.0 if self._until is None else self._until - self._card.ticks
        return ticks * 1000.0 / self._card.values["TM"] * self._card.axis.coefficients.period

    def _step(self) -> None:
        for _ in range(AT_ONCE):
            due = self._until is None or self._card.ticks >= self._until
            if self._next is None or (self._waiting and self._card.motion.running) or not due:
                return
            self._waiting, self._until = False, None
            if not self._todo:
                if self._next >= len(self._lines):
                    self.halt()
                    return
                number, self._next = self._next, self._next + 1
                found = _STATEMENT.findall(self._lines[number])
                self._todo = [(number, text.strip()) for text in found if not text.strip().startswith(("#", "'"))]
                continue
            self._do(*self._todo.pop(0))

    def _do(self, number: int, text: str) -> None:
        word, rest = text[:2], text[2:].strip()
        try:
            if word == "EN":
                self.halt()
            elif word in ("AM", "MC"):
                self._waiting = True
            elif word == "WT":
                self._until = self._card.ticks + evaluate(self._card, rest)
            elif word == "JP":
                label, _, condition = rest.partition(",")
                if not condition or evaluate(self._card, condition):
                    self._next, self._todo = self._label(label), []
            elif text:
                answer = execute(self._card, text, in_program=True)
                if answer:
                    self._card.unsolicited.append(answer)
        except CardError as refusal:
            self._card.error_code = refusal.code
            self._card.unsolicited.append(f"?{number:03d} {text}{CRLF}")
            self.halt()

    def _label(self, text: str) -> int:
        for number, line in enumerate(self._lines):
            if line.strip().split(";")[0].strip() == text.strip() and text.strip().startswith("#"):
                return number
        raise CardError(Error.NO_LABEL)


# ---- Session: the bytes of one client of a card, in both directions, and the machine that clients share.


class GalilMachine(Machine):
    """A card, its clock and its programs, for any number of clients."""

    def __init__(self, servo: ServoSettings, settings: CardSettings, clock: Clock, history_s: float = 1200.0) -> None:
        super().__init__(clock)
        self.card = Card(servo, settings, history_s)
        self.program = Program(self.card)

    def new_session(self, serial: bool) -> "GalilSession":
        """Make what a client talks to."""
        return GalilSession(self, serial)

    def tick(self) -> None:
        """Bring card and programs up to now, and hand out what nobody asked for."""
        with self.lock:
            self.program.advance(self.clock.now())
            while self.card.unsolicited:
                self.tell(self.card.unsolicited.popleft())

    @property
    def powered(self) -> bool:
        """Whether it has power."""
        return self.card.wiring.powered

    @property
    def motor_on(self) -> bool:
        """Whether the servo holds the axis."""
        with self.lock:
            self.tick()
            return self.card.motor_on and self.card.wiring.powered

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate of the axis, rad and rad/s, shape (n,): times (n,) s."""
        with self.lock:
            self.tick()
            return self.card.axis.states(times)

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return time and angle of the kept past, s and rad, shape (n,)."""
        with self.lock:
            self.tick()
            time, angle, _ = self.card.axis.history(last_s)
            return time, angle

    def set_fault(self, name: str, on: bool) -> None:
        """Break or mend a part of the card or of its wiring."""
        with self.lock:
            self.tick()
            card = self.card
            if hasattr(card.wiring, name):
                setattr(card.wiring, name, on)
            elif name == "power_cut":
                card.wiring.powered = not on
                self.program.halt()
                _reset(card)
                for session in self.sessions:
                    cast(GalilSession, session).forget()
            elif name == "message" and on:
                card.unsolicited.append("EMULATED MESSAGE\r\n")
            elif name == "abort_input" and on:
                self.program.halt()
                card.abort(STOP_ABORT_INPUT)
                if card.values["OE"] in (1.0, 3.0):
                    card.motor(False)
            card.apply()
            self.tick()


class GalilSession(ClientSession):
    """One client's bytes."""

    def __init__(self, machine: GalilMachine, serial: bool) -> None:
        super().__init__(machine)
        self._card, self._program, self._serial = machine.card, machine.program, serial
        self.forget()

    def forget(self) -> None:
        """Drop the line in progress."""
        self._line = ""
        self._quoted = self._dropping = self._downloading = False
        self._begun: float | None = None

    def unasked(self) -> bytes:
        """Return what the card says without being asked, since the last look."""
        machine = self._machine
        with machine.lock:
            open_s = 0.0 if self._begun is None else machine.clock.now() - self._begun
            if self._serial and open_s > self._card.settings.serial_timeout_s:
                self._unasked += self._refuse(Error.SERIAL_TIMEOUT.value[0], "\r").encode()
            return super().unasked()

    def tell(self, data: bytes) -> None:
        """Queue a message; CW1 sets the high bit of each character."""
        super().tell(bytes(byte | 0x80 for byte in data) if self._card.values["CW"] == 1.0 else data)

    def _take(self, letter: str) -> str:
        if letter == "\n":
            return ""
        if self._downloading:
            return self._download(letter)
        if letter == "\r" or (letter == ";" and not self._quoted):
            line, self._line, self._quoted, self._begun = self._line, "", False, None
            dropped, self._dropping = self._dropping, self._dropping and letter == ";"
            return "" if dropped else self._reply(line, letter)
        if self._dropping:
            return ""
        if not self._line:
            self._begun = self._machine.clock.now()
        self._line += letter
        self._quoted ^= letter == '"'
        full = len(self._line) > self._card.settings.line_length
        return self._refuse(Error.BUFFER_FULL.value[0], ";") if full else ""

    def _reply(self, line: str, end: str) -> str:
        try:
            text = self._program.command(line)
            if text == "DL":  # no prompt until the program has come
                self._downloading = True
                return ""
            return (execute(self._card, line) if text is None else text) + ":"
        except CardError as refusal:
            return self._refuse(refusal.code, end)

    def _refuse(self, code: int, end: str) -> str:
        self._card.error_code = code
        self._line, self._quoted, self._begun = "", False, None
        self._dropping = end == ";"
        return "?"

    def _download(self, letter: str) -> str:
        if letter not in "\\\x1a":
            self._line += letter
            return ""
        text, self._line, self._downloading = self._line, "", False
        try:
            self._program.load(text)
        except CardError as refusal:
            return self._refuse(refusal.code, "\r")
        return ":"
