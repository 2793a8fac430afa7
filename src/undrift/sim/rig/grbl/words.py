"""Words of a stepper board: lines of letters and numbers, `$n=value`, and the codes of what is wrong with them."""

import re
from dataclasses import dataclass, field

ERROR_MEANING = {
    1: "a word without its letter",
    2: "a number that is missing or not one",
    3: "a $ command that is not known",
    4: "a negative setting",
    5: "homing is not enabled",
    8: "not unless idle",
    9: "locked: an alarm, or a jog in progress",
    11: "line too long",
    15: "jog beyond the travel of the table",
    16: "jog with a forbidden word, or without `=`",
    20: "a command that is not supported",
    21: "two commands of one group",
    22: "no feed rate",
    25: "a word twice",
    26: "no axis word",
}

_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_SETTING = re.compile(r"\$(\d+)=(.*)")
_DISTANCE = {"G90": False, "G91": True}
_HARMLESS = ("G21", "G94", "G54", "G17", "M5", "M9")
_MOVES = {"G0": True, "G1": False}


class Denied(Exception):
    """The board answers `error:n`.

    Parameters
    ----------
    code : int
        n.
    """

    def __init__(self, code: int) -> None:
        super().__init__(ERROR_MEANING[code])
        self.code = code


@dataclass(slots=True)
class Move:
    """What a line asks for.

    Parameters
    ----------
    target : dict of float
        Axis letter to angle, deg.
    feed : float
        deg/min; 0 where the line gives none.
    relative : bool or None
        G91, G90, or neither.
    rapid : bool
        G0.
    """

    target: dict[str, float] = field(default_factory=dict)
    feed: float = 0.0
    relative: bool | None = None
    rapid: bool = False


def parse_line(text: str, axes: str, *, jog: bool) -> Move:
    """Read a line, or what stands behind `$J=`.

    Parameters
    ----------
    text : str
        Upper case, no blanks.
    axes : str
        Letters of the axes.
    jog : bool
        True for a jog.

    Returns
    -------
    Move
        What it asks for.

    Raises
    ------
    Denied
        1, 2, 16, 20, 21, 22, 25, 26.
    """
    move, seen = Move(), set[str]()
    groups: set[str] = set()
    for letter, number in _words(text):
        name = f"{letter}{number:g}"
        key = name if letter in "GM" else letter
        if key in seen:
            raise Denied(25)
        seen.add(key)
        if letter in axes:
            move.target[letter] = number
        elif letter == "F":
            if number < 0.0:
                raise Denied(4)
            move.feed = number
        elif name in _DISTANCE or (name in _MOVES and not jog):
            group = "distance" if name in _DISTANCE else "motion"
            if group in groups:
                raise Denied(21)
            groups.add(group)
            move.relative = _DISTANCE.get(name, move.relative)
            move.rapid = _MOVES.get(name, move.rapid)
        elif name not in _HARMLESS:
            raise Denied(16 if jog else 20)
    if jog:
        if not move.target:
            raise Denied(26)
        if not move.feed:
            raise Denied(22)
    return move


def _words(text: str) -> list[tuple[str, float]]:
    words, at = [], 0
    while at < len(text):
        match = _WORD.match(text, at)
        if match is None:
            raise Denied(2 if text[at].isalpha() else 1)
        words.append((match.group(1), float(match.group(2))))
        at = match.end()
    return words


def parse_setting(text: str, known: dict[int, float]) -> tuple[int, float]:
    """Read `$n=value`.

    Parameters
    ----------
    text : str
        The line.
    known : dict of float
        Settings that there are.

    Returns
    -------
    number, value : int, float
        The setting.

    Raises
    ------
    Denied
        2, 3, 4.
    """
    match = _SETTING.fullmatch(text)
    if match is None or len(match.group(1)) > 3 or int(match.group(1)) not in known:
        raise Denied(3)
    try:
        value = float(match.group(2))
    except ValueError:
        raise Denied(2) from None
    if not value >= 0.0 or value > 1e9:
        raise Denied(4)
    number = int(match.group(1))
    if value == 0.0 and number >= 100:
        raise Denied(4)
    return number, value
