"""Words of the card's language: error texts, and the numbers that its settings take.

Ranges, steps and defaults are those of the 1400 class as DOMAIN 3.1 gathers them; codes are those of its TC table.
"""

from dataclasses import dataclass

UNKNOWN, ONLY_IN_PROGRAM, NOT_IN_PROGRAM, OPERAND, BUFFER_FULL, OUT_OF_RANGE = 1, 2, 3, 4, 5, 6
RUNNING, NOT_RUNNING, VARIABLE, NO_LABEL, JOG_ONLY, PROGRAM_RUNNING = 7, 8, 9, 10, 13, 17
MOTOR_OFF, BEGIN_RUNNING, AT_LIMIT = 20, 21, 22
NOT_ENOUGH, NO_QUESTION, PARENTHESES, LINE_TOO_LONG, NOT_A_NUMBER = 50, 51, 59, 60, 83
SERIAL_TIMEOUT, PERIOD_TIMEOUT = 131, 143

ERROR_TEXT = {
    0: "",
    UNKNOWN: "Unrecognized command",
    ONLY_IN_PROGRAM: "Command only valid from program",
    NOT_IN_PROGRAM: "Command not valid in program",
    OPERAND: "Operand error",
    BUFFER_FULL: "Input buffer full",
    OUT_OF_RANGE: "Number out of range",
    RUNNING: "Command not valid while running",
    NOT_RUNNING: "Command not valid when not running",
    VARIABLE: "Variable error",
    NO_LABEL: "Empty program line or undefined label",
    JOG_ONLY: "JG only valid when running in jog mode",
    PROGRAM_RUNNING: "ED, BN and DL not valid while program running",
    MOTOR_OFF: "Begin not valid with motor off",
    BEGIN_RUNNING: "Begin not valid while running",
    AT_LIMIT: "Begin not possible due to Limit Switch",
    NOT_ENOUGH: "Not enough fields",
    NO_QUESTION: "Question mark not valid",
    PARENTHESES: "Mismatched parentheses",
    LINE_TOO_LONG: "Download error - line too long or too many lines",
    NOT_A_NUMBER: "Not a valid number",
    SERIAL_TIMEOUT: "Serial port timeout",
    PERIOD_TIMEOUT: "TM timed out",
}

STOP_RUNNING, STOP_DONE, STOP_FORWARD, STOP_REVERSE, STOP_ASKED = 0, 1, 2, 3, 4
STOP_ABORT_INPUT, STOP_ABORTED, STOP_ERROR = 6, 7, 8

LARGEST = 2_147_483_647.0


class Refused(Exception):
    """The card answers `?`; TC tells the code.

    Parameters
    ----------
    code : int
        One of the card's error codes.
    """

    def __init__(self, code: int) -> None:
        super().__init__(ERROR_TEXT[code])
        self.code = code


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One number that a command sets.

    Parameters
    ----------
    default : float
        At power-up.
    low, high : float
        Range; beyond is error 6.
    step : float
        The card rounds down to a multiple of it.
    digits, decimals : int
        How `?` shows it.
    while_running : bool
        False is refused with error 7 during a motion.
    axis : bool
        True where an axis letter may follow.
    """

    default: float
    low: float
    high: float
    step: float = 1.0
    digits: int = 8
    decimals: int = 0
    while_running: bool = True
    axis: bool = True


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
    "TM": Setting(default=1000.0, low=1.0, high=20_000.0, step=0.5, digits=5, while_running=False, axis=False),
    "CN": Setting(default=-1.0, low=-1.0, high=1.0, digits=1, axis=False),
    "LZ": Setting(default=0.0, low=0.0, high=1.0, digits=1, axis=False),
    "PF": Setting(default=10.0, low=1.0, high=10.4, step=0.1, digits=2, decimals=1),
    "VF": Setting(default=10.4, low=1.0, high=10.4, step=0.1, digits=2, decimals=1, axis=False),
    "EO": Setting(default=0.0, low=0.0, high=1.0, digits=1, axis=False),
    "CW": Setting(default=2.0, low=1.0, high=2.0, digits=1, axis=False),
}


def shown(value: float, digits: int, decimals: int, bare: bool) -> str:
    """Return a number as the card prints it: a sign or a blank, leading zeros unless LZ1, a fixed count of decimals.

    Parameters
    ----------
    value : float
        The number.
    digits, decimals : int
        Places before and after the point.
    bare : bool
        True drops the leading zeros.

    Returns
    -------
    str
        Such as " 0000003420"; a number too wide for its places fills them with nines.
    """
    text = f"{abs(value):.{decimals}f}"
    whole, point, fraction = text.partition(".")
    if len(whole) > digits:
        whole, fraction = "9" * digits, "9" * len(fraction)
    if not bare:
        whole = whole.rjust(digits, "0")
    sign = "-" if value < 0.0 and (whole + fraction).strip("0") else " "
    return f"{sign}{whole}{point}{fraction}"
