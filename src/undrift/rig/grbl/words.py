"""What GRBL 1.1 says, in words: error codes, alarms, and its status line.

The numbers are those of the GRBL 1.1 interface; the sentences are ours.
"""

import re
from dataclasses import dataclass

from undrift.errors import LinkError

ERRORS = {
    1: "a letter was expected in the command",
    2: "a number is missing or is no number",
    3: "the $ command is not known",
    4: "a negative value where only a positive one is allowed",
    5: "homing is not switched on in the settings",
    6: "the step pulse is shorter than the board allows",
    7: "the stored settings could not be read and were reset",
    8: "the $ command needs an idle controller",
    9: "locked by an alarm or by a jog that still runs",
    10: "software limits need homing to be switched on",
    11: "the line is too long",
    12: "the steps per second would be more than the board can do",
    13: "the safety door is open",
    14: "the line is too long to be stored",
    15: "the jog would leave the machine's travel",
    16: "the jog has no motion or a word that a jog may not have",
    17: "laser mode needs a controllable output",
    20: "the G-code is not supported",
    22: "the feed rate is missing or not set",
    24: "two commands of one line need the same axis",
    33: "the motion has no valid target",
}
ALARMS = {
    1: "a limit switch was hit; the position is lost",
    2: "the target lies outside the travel",
    3: "reset while moving; the position is lost",
    4: "the probe was not in its starting state",
    5: "the probe was not touched",
    6: "homing was reset",
    7: "the safety door was opened while homing",
    8: "homing could not clear the switch",
    9: "homing did not find the switch",
    10: "homing did not find the second switch",
}
STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")
STATUS = re.compile(rb"<[^<>\r\n]*>\r?\n")
REPLY = re.compile(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")
WELCOME = re.compile(rb"Grbl[^\r\n]*\r?\n")
_PLACE = re.compile(r"-?\d{1,9}\.\d{1,6}(?:,-?\d{1,9}\.\d{1,6}){0,5}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """A status line.

    Parameters
    ----------
    state : str
        Idle, Run, Hold, Jog, Alarm, Door, Check, Home or Sleep.
    machine : tuple of float or None
        Machine positions (MPos) of all axes, deg on rotary axes; None when the line has work positions.
    """

    state: str
    machine: tuple[float, ...] | None


def reply_end(received: bytes) -> int:
    """Return where an answer ends: at ``ok`` or ``error:n``.

    Parameters
    ----------
    received : bytes
        What has come since the line was sent.

    Returns
    -------
    int
        Its length, 0 while it is not whole.
    """
    found = REPLY.search(received)
    return found.end() if found else 0


def status_end(received: bytes) -> int:
    """Return where a status line ends.

    Parameters
    ----------
    received : bytes
        What has come since the question mark.

    Returns
    -------
    int
        Its length, 0 while it is not whole.
    """
    found = STATUS.search(received)
    return found.end() if found else 0


def welcome_end(received: bytes) -> int:
    """Return where the greeting after a reset ends.

    Parameters
    ----------
    received : bytes
        What has come since the reset.

    Returns
    -------
    int
        Its length, 0 while it is not whole.
    """
    found = WELCOME.search(received)
    return found.end() if found else 0


def parse_status(line: str, name: str) -> Status:
    """Read a status line strictly.

    Parameters
    ----------
    line : str
        ``<Jog|MPos:12.500,0.000,0.000|FS:5400,0>``.
    name : str
        Where it came from, for the message.

    Returns
    -------
    Status
        State and position.

    Raises
    ------
    LinkError
        No status line.
    """
    fields = line.strip().removeprefix("<").removesuffix(">").split("|")
    state = fields[0].split(":")[0]
    labelled = dict(field.split(":", 1) for field in fields[1:] if ":" in field)
    place = labelled.get("MPos")
    if state not in STATES or not (place or "WPos" in labelled) or (place and not _PLACE.fullmatch(place)):
        raise LinkError(f"{name}: wanted a status line, got {line!r}; check cable and baud")
    return Status(state=state, machine=tuple(float(number) for number in place.split(",")) if place else None)


def error_in_words(code: int) -> str:
    """Say what an error code means.

    Parameters
    ----------
    code : int
        As in ``error:9``.

    Returns
    -------
    str
        A short sentence.
    """
    return ERRORS.get(code, "an error this driver has no words for; look it up in the firmware's list of errors")


def alarm_in_words(code: int) -> str:
    """Say what an alarm means.

    Parameters
    ----------
    code : int
        As in ``ALARM:3``.

    Returns
    -------
    str
        A short sentence.
    """
    return ALARMS.get(code, "an alarm this driver has no words for; look it up in the firmware's list of alarms")
