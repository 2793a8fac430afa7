"""Tell: what the card says about itself, as words, as operands of MG and as the binary record of QR."""

import struct

from undrift.kernels import servo as k
from undrift.sim.rig.galil.card import Card, limits_closed
from undrift.sim.rig.galil.numbers import look_up
from undrift.sim.rig.galil.words import OPERAND, SETTINGS, Refused, shown

TELL = ("TP", "TE", "TV", "TT", "RP", "TD", "TS", "SC", "TB", "TI")
_AXES = ("X", "A", "")


def switches(card: Card) -> int:
    """Return the byte of TS.

    Parameters
    ----------
    card : Card
        The card.

    Returns
    -------
    int
        Bit 7 moving, 6 following error over its limit, 5 motor off, 3 and 2 forward and reverse limit inactive, 1 home.
    """
    forward, reverse = limits_closed(card)
    bits = (
        card.motion.running,
        bool(card.axis.values[k.OVER]),
        not card.motor_on,
        False,
        not forward,
        not reverse,
        True,
    )
    return sum(int(bit) << (7 - place) for place, bit in enumerate(bits))


def value_of(card: Card, word: str) -> float:
    """Return the number that a two-letter word stands for.

    Parameters
    ----------
    card : Card
        The card.
    word : str
        Such as TP, BG or KP.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    Refused
        4, no such operand.
    """
    motion, values = card.motion, card.axis.values
    if word in card.values:
        return card.values[word]
    known = {
        "TP": card.axis.register, "DP": card.axis.register, "TE": round(values[k.ERROR]), "TV": card.axis.velocity_counts,
        "TT": values[k.VOLTAGE], "RP": int(values[k.REFERENCE] // 1), "TD": card.auxiliary, "DE": card.auxiliary,
        "TS": switches(card), "SC": motion.stop_code, "TC": card.error_code, "BG": motion.running, "MO": not card.motor_on,
        "JG": motion.jog, "PR": motion.distance, "PA": motion.target,
        "LF": not limits_closed(card)[0], "LR": not limits_closed(card)[1], "HM": 1, "TB": 1, "TI": 255, "AB": 1,
    }  # fmt: skip
    if word not in known:
        raise Refused(OPERAND)
    return float(known[word])


def operand_value(card: Card, name: str) -> float:
    """Return an operand such as _TPX, or TIME.

    Parameters
    ----------
    card : Card
        The card.
    name : str
        With its underscore.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    Refused
        4, no such operand or no such axis.
    """
    if name == "TIME":
        return float(card.ticks)
    word, axis = name[1:3], name[3:]
    if len(word) < 2 or axis not in _AXES:
        raise Refused(OPERAND)
    return value_of(card, word)


def variable_value(card: Card, name: str) -> float:
    """Return a variable.

    Parameters
    ----------
    card : Card
        The card.
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
    return look_up(card.variables, name)


def told(card: Card, word: str) -> str:
    """Return the answer to a tell word or to `word ?`, in its own format.

    Parameters
    ----------
    card : Card
        The card.
    word : str
        Two letters.

    Returns
    -------
    str
        Without line end.
    """
    bare = card.values["LZ"] == 1.0
    value = value_of(card, word)
    if word in SETTINGS:
        return shown(value, SETTINGS[word].digits, SETTINGS[word].decimals, bare)
    if word in ("TP", "TE", "RP", "TD", "PR", "PA", "DP", "DE"):
        return shown(value, *places(card.values["PF"]), bare)
    digits = {"TV": (7, 0), "JG": (8, 0), "TT": (1, 4)}.get(word, (3, 0))
    return shown(value, *digits, bare)


def places(number: float) -> tuple[int, int]:
    """Return digits and decimals of a format such as 10.4.

    Parameters
    ----------
    number : float
        n.m.

    Returns
    -------
    tuple of int
        n, m.
    """
    tenths = round(number * 10.0)
    return tenths // 10, tenths % 10


def record(card: Card) -> str:
    """Return the binary record of QR: a header, the sample number, the inputs, one block of 28 bytes for the axis.

    Parameters
    ----------
    card : Card
        The card.

    Returns
    -------
    str
        One character a byte.
    """
    values = card.axis.values
    status = (int(card.motion.running) << 15) | int(not card.motor_on)
    block = struct.pack(
        "<HBBiiiiihH",
        status, switches(card), card.motion.stop_code,
        *(_long(value_of(card, word)) for word in ("RP", "TP", "TE", "TD", "TV")),
        max(-32_768, min(32_767, round(values[k.VOLTAGE] * 32_767.0 / 10.0))), 0,
    )  # fmt: skip
    general = struct.pack("<HBBBB", card.ticks & 0xFFFF, 0xFF, 0, card.error_code & 0xFF, 0)
    body = general + block
    header = struct.pack("<BBH", 0x85, 0x01, len(body) + 4)
    return (header + body).decode("latin-1")


def _long(value: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(value)))
