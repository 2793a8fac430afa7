"""What the maker's tuning program sets: the servo filter's gains and its sample time.

Older cards (1000, 1400, 1500 and Optima): D(z) = 4 KP + 4 KD (1 - 1/z) + KI / 2 / (1 - 1/z); newer ones leave out the fours. On
older cards every speed changes with the sample time, so change it before, not during, a run.
"""

import logging
import math
from dataclasses import dataclass

from undrift.errors import InputError, LimitError
from undrift.rig.galil.card import GalilCard

FASTEST_US = 250.0  # below this, cards of the 1400 series may refuse

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """The servo filter.

    Parameters
    ----------
    kp : float
        0 to 1023.875 in steps of 1/8.
    ki : float
        0 to 2047.875 in steps of 1/128.
    kd : float
        0 to 4095.875 in steps of 1/8.
    """

    kp: float
    ki: float
    kd: float


def set_gains(card: GalilCard, gains: Gains) -> Gains:
    """Set the servo filter (KP, KI, KD).

    Parameters
    ----------
    card : GalilCard
        A rig's `card`.
    gains : Gains
        As wanted.

    Returns
    -------
    Gains
        As the card holds them.

    Raises
    ------
    LimitError
        Beyond the card's range; nothing was sent.
    """
    wanted = []
    for name, value, step, largest in (
        ("KP", gains.kp, 1 / 8, 1023.875),
        ("KI", gains.ki, 1 / 128, 2047.875),
        ("KD", gains.kd, 1 / 8, 4095.875),
    ):
        if not 0.0 <= value <= largest:
            raise LimitError(f"{name}: wanted 0 to {largest}, got {value:g}; choose another gain", gain=value)
        wanted.append((name, min(step * math.floor(value / step + 0.5), largest), step))
    kp, ki, kd = (card.set(name, value, tolerance=step) for name, value, step in wanted)
    return Gains(kp=kp, ki=ki, kd=kd)


def read_gains(card: GalilCard) -> Gains:
    """Return the servo filter that the card runs.

    Parameters
    ----------
    card : GalilCard
        A rig's `card`.

    Returns
    -------
    Gains
        As the card holds them.
    """
    kp, ki, kd = (card.number(f"MG _{name}{card.axis}") for name in ("KP", "KI", "KD"))
    return Gains(kp=kp, ki=ki, kd=kd)


def set_sample_time(card: GalilCard, sample_time_us: float) -> float:
    """Set the servo's sample time (TM).

    Parameters
    ----------
    card : GalilCard
        A rig's `card`.
    sample_time_us : float
        Microseconds; 1000 is the card's default.

    Returns
    -------
    float
        As the card holds it, microseconds.

    Raises
    ------
    InputError
        No sample time of any card.
    RigFault
        Not one of this card.
    """
    if not 1.0 <= sample_time_us <= 20_000.0:
        raise InputError(f"TM: wanted 1 to 20000 us, got {sample_time_us:g}; 1000 is usual")
    if sample_time_us < FASTEST_US:
        log.warning("TM %g us is faster than cards of the 1400 series are likely to allow", sample_time_us)
    card.do(f"TM {sample_time_us:.10g}")
    return card.number("MG _TM")
