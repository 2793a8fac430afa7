"""The language of Galil cards: one command, one answer, read strictly.

A command ends with a carriage return. The card answers ``:`` when it accepts, ``?`` when it refuses (TC1 then says why), and text
before the ``:`` when it was asked for some. An answer that is not exactly of the kind that was asked for is a LinkError: a rig
never moves on garbage. The port beneath is a Link, or the maker's library.
"""

import re

from undrift.errors import LinkError, RigFault
from undrift.rig.galil.port import GalilPort
from undrift.rig.galil.words import error_in_words

NUMBER = re.compile(r"[ ]*-?[ ]?\d{1,12}(?:\.\d{1,8})?[ ]*")
CABLE = "check cable and baud"
AXES = "ABCDEFGH"


class GalilCard:
    """Commands and questions to one axis of a card.

    Parameters
    ----------
    port : GalilPort
        What carries them.
    axis : str
        A to H, or X, Y, Z, W.
    """

    def __init__(self, port: GalilPort, axis: str = "X") -> None:
        self.port = port
        self.axis = axis
        self._commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        self._digits: int | None = None
        self._tells_signs: bool | None = None  # of a jog speed that is read back

    def do(self, command: str, deadline_s: float | None = None) -> None:
        """Give a command that has no answer but ``:``.

        Parameters
        ----------
        command : str
            As the card takes it.
        deadline_s : float or None
            Longest wait, s; the port's own when None.

        Raises
        ------
        RigFault
            The card refused; its error code in words and as the attribute ``code``.
        LinkError
            It answered something else.
        """
        answer = self.port.ask(command, deadline_s)
        if answer is None:
            raise _refusal(self.port, command)
        if answer:
            raise LinkError(f"{self.port.name}: wanted ':' in answer to '{command}', got {answer!r}; {CABLE}")

    def tries(self, command: str) -> bool:
        """Give a command that older cards may not know.

        Parameters
        ----------
        command : str
            As the card takes it.

        Returns
        -------
        bool
            Whether it was accepted.
        """
        return self.port.ask(command) is not None

    def text(self, command: str, deadline_s: float | None = None) -> str:
        """Ask for text.

        Parameters
        ----------
        command : str
            As the card takes it.
        deadline_s : float or None
            Longest wait, s; the port's own when None.

        Returns
        -------
        str
            What came before the prompt.

        Raises
        ------
        RigFault
            The card refused.
        """
        answer = self.port.ask(command, deadline_s)
        if answer is None:
            raise _refusal(self.port, command)
        return answer.strip("\r\n")

    def number(self, command: str) -> float:
        """Ask for a number.

        Parameters
        ----------
        command : str
            ``MG _BGX``, ``KP ?``, ...

        Returns
        -------
        float
            In the card's unit.

        Raises
        ------
        LinkError
            What came is not one number.
        """
        answer = self.text(command)
        if not NUMBER.fullmatch(answer):
            raise LinkError(f"{self.port.name}: wanted a number in answer to '{command}', got {answer!r}; {CABLE}")
        return float(answer.replace(" ", ""))

    def integer(self, command: str, smallest: int = -(2**31), largest: int = 2**31 - 1) -> int:
        """Ask for a whole number.

        Parameters
        ----------
        command : str
            ``TPX``, ``JG ?``, ...
        smallest, largest : int
            Range that can be true.

        Returns
        -------
        int
            In the card's unit.

        Raises
        ------
        LinkError
            What came is no whole number, or outside that range.
        """
        value = self.number(command)
        if value != int(value) or not smallest <= value <= largest:
            raise LinkError(
                f"{self.port.name}: wanted a whole number from {smallest} to {largest} in answer to '{command}', "
                f"got {value:g}; {CABLE}"
            )
        return int(value)

    def position(self, command: str) -> int:
        """Ask for a position, which the card writes with a fixed number of digits once `fix_format` was called.

        Parameters
        ----------
        command : str
            ``TPX`` or ``TEX``.

        Returns
        -------
        int
            Counts.

        Raises
        ------
        LinkError
            Not a whole number, or with digits missing.
        """
        answer = self.text(command)
        digits = sum(character.isdigit() for character in answer)
        if not re.fullmatch(r" *-? ?\d{1,10} *", answer) or (self._digits is not None and digits != self._digits):
            raise LinkError(f"{self.port.name}: wanted counts in answer to '{command}', got {answer!r}; {CABLE}")
        return int(answer.replace(" ", ""))

    def fix_format(self) -> None:
        """Have positions written with ten digits, so that a lost byte shows; cards that will not are taken as they are."""
        if self.tries("PF 10.0") and self.tries("LZ 0"):
            answer = self.text(f"TP{self.axis}")
            digits = sum(character.isdigit() for character in answer)
            self._digits = 10 if digits == 10 else None

    def set(self, name: str, value: float, *, tolerance: float = 0.0, magnitude: bool = False) -> float:
        """Set a parameter of the axis and read it back.

        Parameters
        ----------
        name : str
            JG, AC, KP, ...
        value : float
            In the card's unit, already rounded to what the card holds.
        tolerance : float
            How far a card of coarser steps may differ.
        magnitude : bool
            Some cards read it back without its sign.

        Returns
        -------
        float
            What the card holds, signed as the value.

        Raises
        ------
        RigFault
            The card refused.
        LinkError
            It holds something else: a byte was lost on the way.
        """
        tell, ask = f"{name} {self._commas}{value:.10g}", f"{name} {self._commas}?"
        self.do(tell)
        held = self.number(ask)
        if magnitude and value < 0.0:
            if held > 0.0 and self._tells_signs is None:  # a minus sign that was lost, or such a card
                self.do(tell)
                held = self.number(ask)
            self._tells_signs = self._tells_signs or held < 0.0
            held = held if self._tells_signs else -held
        if abs(held - value) > tolerance:
            raise LinkError(
                f"{self.port.name}: wanted {name} {value:.10g}, got {held:.10g} when it was read back; {CABLE}",
                wanted=value,
                held=held,
            )
        return held


def _refusal(port: GalilPort, command: str) -> RigFault:
    """Return what TC1 says about the last ``?``, in our words."""
    said = port.ask("TC1") or ""
    found = re.match(r"\s*(\d{1,3})\b", said)
    if not found:
        raise LinkError(f"{port.name}: wanted an error code in answer to 'TC1', got {said!r}; {CABLE}")
    code = int(found.group(1))
    return RigFault(
        f"{port.name}: wanted '{command}', got error {code}: {error_in_words(code)}; see the state of the card",
        code=code,
        command=command,
    )
