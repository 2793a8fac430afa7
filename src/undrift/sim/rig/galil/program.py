"""Program: lines kept on the card and run there, with trippoints.

DL .. \\ loads, LS lists, XQ runs from a label, HX halts. JP, EN, AM and WT mean something only here. What a program prints nobody
asked for; a command that fails ends it with `?`, the line number and the line.
"""

import re

from undrift.sim.rig.galil.card import Card
from undrift.sim.rig.galil.language import CRLF, execute
from undrift.sim.rig.galil.numbers import evaluate
from undrift.sim.rig.galil.tell import operand_value, variable_value
from undrift.sim.rig.galil.words import LINE_TOO_LONG, NO_LABEL, NOT_RUNNING, PROGRAM_RUNNING, Refused

SLICE_S = 1e-3  # emulated time between looks at a program
AT_ONCE = 50  # commands in a slice
LONGEST, MOST = 80, 250  # characters of a line, lines

_STATEMENT = re.compile(r'(?:[^;"]|"[^"]*")+')


class Program:
    """The one program of a card.

    Parameters
    ----------
    card : Card
        What it commands.
    """

    def __init__(self, card: Card) -> None:
        self._card = card
        self._lines: list[str] = []
        self._todo: list[tuple[int, str]] = []
        self._next: int | None = None  # next line; None when nothing runs
        self._until: float | None = None  # operand TIME that WT waits for
        self._waiting = False  # AM

    @property
    def running(self) -> bool:
        """Whether lines are being executed."""
        return self._next is not None

    def halt(self) -> None:
        """Stop executing lines."""
        self._next, self._todo, self._until, self._waiting = None, [], None, False

    def load(self, text: str) -> None:
        """Replace the program.

        Parameters
        ----------
        text : str
            Lines, each ended by a carriage return.

        Raises
        ------
        Refused
            60, a line too long or too many.
        """
        lines = text.strip("\r").split("\r")
        if len(lines) > MOST or any(len(line) > LONGEST for line in lines):
            raise Refused(LINE_TOO_LONG)
        self._lines = lines

    def command(self, line: str) -> str | None:
        """Do a command about the program.

        Parameters
        ----------
        line : str
            From a client.

        Returns
        -------
        str or None
            Its answer; "DL" to take lines until a backslash; None for any other command.

        Raises
        ------
        Refused
            8 HX with nothing running, 10 no such label, 17 DL while running.
        """
        text = line.strip()
        word, rest = text[:2], text[2:].strip()
        if word == "DL" and not rest:
            if self.running:
                raise Refused(PROGRAM_RUNNING)
            return "DL"
        if word == "LS" and not rest:
            return "".join(f"{number} {line}{CRLF}" for number, line in enumerate(self._lines))
        if word == "XQ":
            self._next, self._todo = self._label(rest.split(",")[0]) if rest else 0, []
            return ""
        if word == "HX":
            if not self.running:
                raise Refused(NOT_RUNNING)
            self.halt()
            return ""
        if word == "AB" and rest != "1":
            self.halt()
        return None

    def advance(self, time: float) -> None:
        """Bring card and program up to a moment.

        Parameters
        ----------
        time : float
            Emulated time, s.
        """
        card = self._card
        while self.running and card.axis.time < time - SLICE_S:
            card.advance(card.axis.time + SLICE_S)
            self._step()
        card.advance(time)
        if self.running:
            self._step()

    def _step(self) -> None:
        for _ in range(AT_ONCE):
            if self._next is None or (self._waiting and self._card.motion.running):
                return
            if self._until is not None and self._card.ticks < self._until:
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
                self._until = self._card.ticks + self._value(rest)
            elif word == "JP":
                label, _, condition = rest.partition(",")
                if not condition or self._value(condition):
                    self._next, self._todo = self._label(label), []
            elif text:
                answer = execute(self._card, text, in_program=True)
                if answer:
                    self._card.unsolicited.append(answer)
        except Refused as refusal:
            self._card.error_code = refusal.code
            self._card.unsolicited.append(f"?{number:03d} {text}{CRLF}")
            self.halt()

    def _value(self, text: str) -> float:
        return evaluate(text, lambda n: operand_value(self._card, n), lambda n: variable_value(self._card, n))

    def _label(self, text: str) -> int:
        for number, line in enumerate(self._lines):
            if line.strip().split(";")[0].strip() == text.strip() and text.strip().startswith("#"):
                return number
        raise Refused(NO_LABEL)
