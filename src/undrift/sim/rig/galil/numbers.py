"""Expressions of the card's language: numbers, operands, variables and functions, worked from left to right.

The card knows no precedence: 1+2*3 is 9. Comparisons give 1 or 0. Numbers lie within +-2147483647.9999.
"""

import math
import re
from collections.abc import Callable

from undrift.sim.rig.galil.words import NOT_A_NUMBER, OPERAND, OUT_OF_RANGE, PARENTHESES, UNKNOWN, VARIABLE, Refused

Look = Callable[[str], float]

BOUND = 2_147_483_648.0
DEEPEST = 20  # nested parentheses

_NUMBER = re.compile(r"\$[0-9A-F]+(?:\.[0-9A-F]+)?|\d+(?:\.\d*)?|\.\d+")
_WORD = re.compile(r"_?[A-Z][A-Z0-9]*")
_SIGNS = ("<=", ">=", "<>", "+", "-", "*", "/", "&", "|", "%", "<", ">", "=")
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


def evaluate(text: str, operand: Look, variable: Look) -> float:
    """Return the value of an expression.

    Parameters
    ----------
    text : str
        The expression.
    operand : callable
        Value of an operand such as "_TPX" or "TIME"; raises Refused.
    variable : callable
        Value of a variable; raises Refused.

    Returns
    -------
    float
        Its value, within the card's range.

    Raises
    ------
    Refused
        4 unknown operand, 6 out of range, 9 unknown variable, 59 parentheses, 83 not a number.
    """
    reader = _Reader(text, operand, variable)
    value = reader.expression(0)
    if reader.rest():
        raise Refused(PARENTHESES if reader.rest()[0] in ")]" else NOT_A_NUMBER)
    return value


class _Reader:
    def __init__(self, text: str, operand: Look, variable: Look) -> None:
        self._text = text.strip()
        self._at = 0
        self._operand = operand
        self._variable = variable

    def rest(self) -> str:
        while self._at < len(self._text) and self._text[self._at] == " ":
            self._at += 1
        return self._text[self._at :]

    def expression(self, depth: int) -> float:
        if depth > DEEPEST:
            raise Refused(PARENTHESES)
        value = self._term(depth)
        while (sign := next((s for s in _SIGNS if self.rest().startswith(s)), None)) is not None:
            self._at += len(sign)
            value = _bounded(_combine(sign, value, self._term(depth)))
        return value

    def _term(self, depth: int) -> float:
        rest = self.rest()
        if rest.startswith(("-", "+")):
            self._at += 1
            value = self._term(depth + 1) if depth < DEEPEST else 0.0
            return -value if rest[0] == "-" else value
        if rest.startswith("("):
            self._at += 1
            return self._closed(")", depth)
        if rest.startswith("@"):
            name = rest.split("[", 1)[0]
            if name not in _FUNCTIONS or "[" not in rest:
                raise Refused(UNKNOWN)
            self._at += len(name) + 1
            return _bounded(_FUNCTIONS[name](self._closed("]", depth)))
        if match := _NUMBER.match(rest):
            self._at += match.end()
            return _bounded(_number(match.group()))
        if match := _WORD.match(rest):
            self._at += match.end()
            name = match.group()
            return self._operand(name) if name.startswith("_") or name == "TIME" else self._variable(name)
        raise Refused(OPERAND if rest.startswith("_") else NOT_A_NUMBER)

    def _closed(self, end: str, depth: int) -> float:
        value = self.expression(depth + 1)
        if not self.rest().startswith(end):
            raise Refused(PARENTHESES)
        self._at += 1
        return value


def _number(text: str) -> float:
    if not text.startswith("$"):
        return float(text)
    whole, _, fraction = text[1:].partition(".")
    return float(int(whole, 16)) + (int(fraction, 16) / 16.0 ** len(fraction) if fraction else 0.0)


def _bounded(value: float) -> float:
    if not abs(value) < BOUND:
        raise Refused(OUT_OF_RANGE)
    return value


def _combine(sign: str, a: float, b: float) -> float:
    if sign in ("/", "%") and b == 0.0:
        raise Refused(OUT_OF_RANGE)
    if sign in ("<", ">", "=", "<=", ">=", "<>"):
        truth = {"<": a < b, ">": a > b, "=": a == b, "<=": a <= b, ">=": a >= b, "<>": a != b}
        return float(truth[sign])
    if sign in ("&", "|"):
        return float(int(a) & int(b)) if sign == "&" else float(int(a) | int(b))
    if sign == "%":
        return math.fmod(a, b)
    return {"+": a + b, "-": a - b, "*": a * b}[sign] if sign != "/" else a / b


VARIABLE_NAME = re.compile(r"[A-Z][A-Z0-9]{0,7}")


def look_up(variables: dict[str, float], name: str) -> float:
    """Return a variable.

    Parameters
    ----------
    variables : dict of float
        Those that have been set.
    name : str
        Which.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    Refused
        9, it has not been set.
    """
    if name not in variables:
        raise Refused(VARIABLE)
    return variables[name]
