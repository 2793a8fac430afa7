"""Card watchdog: a program on a Galil card that stops the axis when this computer has not written a variable for 5 s.

The guard (rig/guard.py) stops the table when the program that drives it is gone; this helps where both are. It is uploaded on
request alone, since DL replaces what the card holds: a card with a program of its own is refused. Nothing is burned.

    #UNDRWD                       the program: every 200 ms (WT) a variable goes down by 1
    UNDRLEFT=UNDRLEFT-1
    WT 200
    JP #UNDRWD,(UNDRLEFT>0)       written every second by this computer, to 25
    STX                           else stop, after that (AM) motor off, and a mark that it was so
    AMX
    MOX
    UNDRLEFT=-1
    EN

Each command is carried out whole before the next, so that the card's subtraction and our writing do not mix. Source: DMC-1400, 2x00
and 4103 command references (DL, LS, XQ, HX, WT, JP, AM, ST with an axis, MO). ST and AB without an axis halt programs.
"""

import contextlib
import logging
import re
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from undrift.errors import LinkError, RigError, RigFault

if TYPE_CHECKING:
    from undrift.rig.galil import GalilAxis, GalilCard

LIMIT_S, COUNT_MS, BEAT_S = 5.0, 200, 1.0  # s of the host without a word; ms of the card; s of the host
LABEL, LEFT = "#UNDRWD", "UNDRLEFT"
TRIPPED = -1
STARTS_S = 5.0  # within which it must count

log = logging.getLogger(__name__)


def program_for(axis: str) -> list[str]:
    """Return the lines of the program."""
    again, stop = (
        [f"{LEFT}={LEFT}-1", f"WT {COUNT_MS}", f"JP {LABEL},({LEFT}>0)"],
        [f"ST{axis}", f"AM{axis}", f"MO{axis}"],
    )
    return [LABEL, *again, *stop, f"{LEFT}={TRIPPED}", "EN"]


def halt_left_over(card: "GalilCard") -> None:
    """End the program of a run that was killed, which would stop the next one."""
    if card.port.ask(f"MG {LEFT}") is not None and LABEL in (_listed(card) or ()):
        card.tries("HX")


def _listed(card: "GalilCard") -> list[str] | None:
    """Return the lines of the program on the card; None where they cannot be read."""
    try:
        lines = [re.sub(r"^\s*\d+ ?", "", line).strip() for line in card.text("LS").splitlines()]
    except RigError:  # too long, or with what looks like a refusal: none of ours
        card.port.resynchronise()
        return None
    return [line for line in lines if line]


class CardWatchdog:
    """The program on the card from `start` to `clear`, and the thread that writes its variable."""

    def __init__(self, card: "GalilCard", axis: "GalilAxis", alive: Callable[[], bool], clock_speed: float) -> None:
        self._card, self._axis, self._alive = card, axis, alive
        self._full = round(LIMIT_S * 1000.0 / COUNT_MS * clock_speed)  # an emulated card counts faster
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="card watchdog", daemon=True)

    def start(self) -> None:
        """Upload the program, start it and see it count."""
        card, lines = self._card, program_for(self._card.axis)
        held = _listed(card)
        if held is None or (held and held[0] != LABEL):
            raise RigFault(
                f"{card.port.name}: wanted a card without a program for --card-watchdog, got one that it would replace; save and "
                "clear that one, or leave the option out"
            )
        card.tries("HX")
        card.port.download("\r".join(lines))
        if _listed(card) != lines:
            raise LinkError(
                f"{card.port.name}: wanted the watchdog's program on the card, got another one; check the link"
            )
        self._write()
        card.do(f"XQ {LABEL},0")
        last = time.monotonic() + STARTS_S
        while not 0 < self._left() < self._full:
            if time.monotonic() > last:
                raise RigFault(f"{card.port.name}: wanted the card's watchdog counting, got it at rest; leave it out")
            time.sleep(0.02)
        self._write()
        self._thread.start()

    def clear(self) -> None:
        """End the thread, halt the program and take it from the card; a card that does not answer stops by itself."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        with contextlib.suppress(RigError):
            self._card.tries("HX")
            self._card.port.download("")
            return
        log.warning("%s: the watchdog's program could not be taken from the card", self._card.port.name)

    def _left(self) -> int:
        return self._card.integer(f"MG {LEFT}", TRIPPED, self._full)

    def _write(self) -> None:
        self._card.do(f"{LEFT}={self._full}")

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_S):
            if not self._alive():
                continue
            try:
                if self._left() <= 0:
                    self._axis.refused = (
                        f"its card watchdog stopped it, not having heard of this computer for {LIMIT_S:g} s"
                    )
                    return
                self._write()
            except RigError as error:  # whoever drives the axis meets it too, and reports how it began
                self._axis.broken = self._axis.broken or error
                return
