"""What the numbers of a Galil card mean: error codes (TC), stop codes (SC), switches (TS), in words a bench can act on.

The numbers are those of the makers' command references; the sentences are ours.
"""

from dataclasses import dataclass

ERRORS = {
    1: "the command is not known to this card",
    2: "the command works only inside a program",
    3: "the command does not work inside a program",
    4: "an operand is wrong",
    5: "the input buffer is full: too much was sent at once",
    6: "the number is out of range",
    7: "not allowed while the axis moves",
    8: "not allowed while the axis rests",
    9: "a variable is wrong",
    10: "an empty program line or an unknown label",
    11: "a wrong label or line number",
    12: "subroutines are nested too deep",
    13: "a jog speed may change only while jogging",
    14: "the card's memory fails its checksum",
    15: "the card's memory could not be written",
    16: "the new target lies behind a running move",
    17: "not allowed while a program runs",
    18: "not allowed in contour mode",
    19: "that program thread runs already",
    20: "a move needs the motor on",
    21: "a move is running already",
    22: "a limit switch forbids the move",
    24: "no sequence of moves is defined",
    28: "that operand cannot be used here",
    29: "not allowed during a coordinated move",
    50: "arguments are missing",
    51: "a question mark is not allowed here",
    52: "a quote is missing or the text is too long",
    53: "the braces are wrong",
    55: "a bracket is missing",
    56: "an array index is out of range",
    57: "the function or array is not known",
    58: "the operand is not known",
    59: "the parentheses do not match",
    66: "no room for arrays",
    67: "too many arrays or variables",
    80: "recording runs already",
    82: "the array is not defined",
    83: "not a number",
    84: "too many elements",
    90: "only an axis letter is allowed here",
    131: "the serial port timed out",
    143: "the card did not settle on the new sample time",
}
STOPS = {
    0: "running",
    1: "at the commanded position",
    2: "stopped by the forward limit",
    3: "stopped by the reverse limit",
    4: "stopped by command",
    6: "stopped by the abort input",
    7: "stopped by an abort command",
    8: "switched off because the following error passed its limit",
    9: "stopped after finding an edge",
    10: "stopped after homing",
    50: "contour running",
    51: "contour stopped",
    99: "timed out before reaching the position",
    100: "vector move running",
    101: "vector move stopped",
}
STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)


@dataclass(frozen=True, slots=True, kw_only=True)
class Switches:
    """The byte that TS returns.

    Parameters
    ----------
    moving : bool
        The profile runs.
    error_beyond_limit : bool
        The following error is larger than ER.
    motor_off : bool
        The amplifier is not enabled.
    forward_limit : bool
        The forward limit switch is pressed.
    reverse_limit : bool
        The reverse limit switch is pressed.
    """

    moving: bool
    error_beyond_limit: bool
    motor_off: bool
    forward_limit: bool
    reverse_limit: bool

    @classmethod
    def from_byte(cls, byte: int) -> "Switches":
        """Read the bits; a limit switch that is not pressed reads 1.

        Parameters
        ----------
        byte : int
            0 to 255.

        Returns
        -------
        Switches
            In words.
        """
        return cls(
            moving=bool(byte & 0x80),
            error_beyond_limit=bool(byte & 0x40),
            motor_off=bool(byte & 0x20),
            forward_limit=not byte & 0x08,
            reverse_limit=not byte & 0x04,
        )

    def wrong(self, enabled: bool) -> list[str]:
        """Say what is not as it should be.

        Parameters
        ----------
        enabled : bool
            Whether the motor was switched on.

        Returns
        -------
        list of str
            Empty when all is well.
        """
        seen = (
            (enabled and self.motor_off, "the motor is off though it was switched on"),
            (self.error_beyond_limit, "the following error is beyond its limit"),
            (self.forward_limit, "the forward limit switch is pressed"),
            (self.reverse_limit, "the reverse limit switch is pressed"),
        )
        return [words for is_so, words in seen if is_so]


def error_in_words(code: int) -> str:
    """Say what an error code means.

    Parameters
    ----------
    code : int
        As TC returns it.

    Returns
    -------
    str
        A short sentence.
    """
    return ERRORS.get(
        code, "an error this driver has no words for; look it up in the card's command reference under TC"
    )


def stop_in_words(code: int) -> str:
    """Say why the axis stopped.

    Parameters
    ----------
    code : int
        As SC returns it.

    Returns
    -------
    str
        A short sentence.
    """
    return STOPS.get(code, "a reason this driver has no words for; look it up under SC")
