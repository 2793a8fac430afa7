"""Galil: the ASCII language of a one-axis card, read by a parser of its own.

Two upper-case letters and arguments; `;` or a carriage return ends a command. Each command is answered by its text, if it has
one, with CR LF, and `:`; or by `?`, after which the rest of the line is dropped and TC tells why.
"""

import math
import re
from collections.abc import Callable

from undrift.sim.rig.galil.card import Card, set_sample_time
from undrift.sim.rig.galil.numbers import VARIABLE_NAME, evaluate
from undrift.sim.rig.galil.tell import TELL, operand_value, places, record, told, variable_value
from undrift.sim.rig.galil.words import (
    ERROR_TEXT,
    LARGEST,
    NO_QUESTION,
    NOT_A_NUMBER,
    NOT_ENOUGH,
    NOT_IN_PROGRAM,
    ONLY_IN_PROGRAM,
    OPERAND,
    OUT_OF_RANGE,
    RUNNING,
    SETTINGS,
    UNKNOWN,
    Refused,
    shown,
)

ONLY_PROGRAM_WORDS = ("AM", "WT", "MC", "AD", "AT", "JP", "JS", "EN", "RE")
NOT_PROGRAM_WORDS = ("DL", "LS", "UL", "ED", "RS", "QR")
REVISION = "\x12\x16"
CRLF = "\r\n"

_AXIS_EQUALS = re.compile(r"\s*([A-Z*])\s*=(.*)", re.S)
_MESSAGE_ITEM = re.compile(r"(\"[^\"]*\"|[^\"{}]*)((?:\{[^{}]*\}\s*)*)")
_FORM = re.compile(r"\{([^{}]*)\}")
_ASSIGNMENT = re.compile(r"([A-Z][A-Z0-9]*)\s*=(.*)", re.S)
_WITH_VALUE = (*SETTINGS, "JG", "PR", "PA", "DP", "DE")


def execute(card: Card, command: str, in_program: bool = False) -> str:
    """Do one command.

    Parameters
    ----------
    card : Card
        Brought up to now.
    command : str
        Without its `;` or carriage return.
    in_program : bool
        True when a program on the card gives it.

    Returns
    -------
    str
        Text of the answer with its CR LF; empty where there is none.

    Raises
    ------
    Refused
        The card answers `?`.
    """
    text = command.strip(" ")
    if not text:
        return ""
    if text == REVISION:
        return card.settings.revision + CRLF
    word, rest = text[:2], text[2:]
    if in_program and word in NOT_PROGRAM_WORDS:
        raise Refused(NOT_IN_PROGRAM)
    if not in_program and word in ONLY_PROGRAM_WORDS:
        raise Refused(ONLY_IN_PROGRAM)
    known = word in _WORDS or word in _WITH_VALUE or word in TELL
    if not known or (re.match(r"[A-Z0-9]{2,}\s*=", rest) is not None):
        return _assign(card, text)
    if word in _WITH_VALUE:
        return _valued(card, word, rest)
    if word in TELL:
        _axes(rest)
        return told(card, word) + CRLF
    return _WORDS[word](card, rest)


def _assign(card: Card, text: str) -> str:
    match = _ASSIGNMENT.fullmatch(text)
    if match is None or not VARIABLE_NAME.fullmatch(match.group(1)):
        raise Refused(UNKNOWN)
    name, expression = match.group(1), match.group(2).strip()
    if expression:
        card.variables[name] = _number(card, expression)
        return ""
    value = variable_value(card, name)
    return shown(value, *places(card.values["VF"]), card.values["LZ"] == 1.0) + CRLF


def _number(card: Card, text: str) -> float:
    return evaluate(text, lambda name: operand_value(card, name), lambda name: variable_value(card, name))


def _argument(rest: str) -> str:
    # the field of the only axis: "1000", " 1000,,", "X=1000", "*=1000" or "?"
    match = _AXIS_EQUALS.fullmatch(rest)
    if match is not None:
        if match.group(1) not in "AX*":
            raise Refused(OPERAND)
        fields = [match.group(2)]
    else:
        fields = rest.lstrip(" =").split(",")
    if any(field.strip() for field in fields[1:]):
        raise Refused(OPERAND)
    field = fields[0].strip()
    if not field:
        raise Refused(NOT_ENOUGH)
    return field


def _axes(rest: str) -> None:
    letters = rest.strip().replace(",", "")
    if "?" in letters:
        raise Refused(NO_QUESTION)
    if any(letter not in "AX" for letter in letters):
        raise Refused(OPERAND)


def _valued(card: Card, word: str, rest: str) -> str:
    field = _argument(rest)
    if field == "?":
        return told(card, word) + CRLF
    value = _number(card, field)
    if word == "JG":
        card.jog(value)
    elif word in ("PR", "PA"):
        card.aim(word, value)
    elif word == "DP":
        if card.motion.running:
            raise Refused(RUNNING)
        if abs(value) > LARGEST:
            raise Refused(OUT_OF_RANGE)
        card.axis.define(math.trunc(value))
    elif word == "DE":
        card.auxiliary = math.trunc(value)
    else:
        _set(card, word, value)
    return ""


def _set(card: Card, word: str, value: float) -> None:
    setting = SETTINGS[word]
    if not setting.low <= value <= setting.high:
        raise Refused(OUT_OF_RANGE)
    if card.motion.running and not setting.while_running:
        raise Refused(RUNNING)
    rounded = math.trunc(value / setting.step + 1e-9) * setting.step
    if word == "TM":
        set_sample_time(card, rounded)
        return
    card.values[word] = rounded
    card.apply()


def _switch(on: bool) -> Callable[[Card, str], str]:
    def act(card: Card, rest: str) -> str:
        _axes(rest)
        card.motor(on)
        return ""

    return act


def _begin(card: Card, rest: str) -> str:
    _axes(rest)
    card.begin()
    return ""


def _stop(card: Card, rest: str) -> str:
    _axes(rest)
    card.stop()
    return ""


def _abort(card: Card, rest: str) -> str:
    if rest.strip() == "?":
        return told(card, "AB") + CRLF
    if rest.strip() not in ("", "0", "1"):
        raise Refused(OUT_OF_RANGE if rest.strip().isdigit() else OPERAND)
    card.abort()
    return ""


def _tell_code(card: Card, rest: str) -> str:
    argument = rest.strip()
    if argument not in ("", "0", "1"):
        raise Refused(NO_QUESTION if argument == "?" else OUT_OF_RANGE)
    code, card.error_code = card.error_code, 0
    return (f"{code} {ERROR_TEXT[code]}".rstrip() if argument == "1" else str(code)) + CRLF


def _reset(card: Card, rest: str) -> str:
    _axes(rest)
    card.abort()
    card.set_up()
    return ""


def _nothing(_card: Card, rest: str) -> str:
    if "?" in rest:
        raise Refused(NO_QUESTION)
    return ""


def _no_editor(_card: Card, _rest: str) -> str:
    raise Refused(UNKNOWN)


def _message(card: Card, rest: str) -> str:
    text, end = "", CRLF
    items = _split(rest)
    if not items:
        raise Refused(NOT_ENOUGH)
    for item in items:
        match = _MESSAGE_ITEM.fullmatch(item)
        if match is None:
            raise Refused(OPERAND)
        forms = _FORM.findall(match.group(2))
        if "N" in forms:
            end = ""
        text += _item(card, match.group(1).strip(), [form for form in forms if form != "N"])
    return text + end


def _item(card: Card, body: str, forms: list[str]) -> str:
    form = forms[0] if forms else ""
    if body.startswith('"'):
        return body[1:-1]
    if not body:
        if form.startswith("^") and form[1:].isdigit() and int(form[1:]) < 256:
            return chr(int(form[1:]))
        return ""  # {N}, or the name of a port, of which there is one
    value = _number(card, body)
    if not form or form[0] in "PEU":
        return shown(value, *places(card.values["VF"]), True)
    match = re.fullmatch(r"([FZ])(\d{1,2})(?:\.(\d))?", form)
    if match is None:
        raise Refused(OPERAND)
    return shown(value, int(match.group(2)), int(match.group(3) or 0), match.group(1) == "Z")


def _split(rest: str) -> list[str]:
    # at commas, but not within quotes
    items, quoted = [""], False
    for letter in rest.strip():
        if letter == '"':
            quoted = not quoted
        if letter == "," and not quoted:
            items.append("")
        else:
            items[-1] += letter
    if quoted:
        raise Refused(NOT_A_NUMBER)
    return [item.strip() for item in items if item.strip()]


_WORDS: dict[str, Callable[[Card, str], str]] = {
    "SH": _switch(True),
    "MO": _switch(False),
    "BG": _begin,
    "ST": _stop,
    "AB": _abort,
    "TC": _tell_code,
    "RS": _reset,
    "MG": _message,
    "QR": lambda card, rest: record(card) + _nothing(card, rest),
    "ID": lambda card, rest: card.settings.revision + CRLF + _nothing(card, rest),
    "BN": _nothing,
    "BV": _nothing,
    "CF": _nothing,
    "ED": _no_editor,
}
