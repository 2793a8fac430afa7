"""Where the axis of a Galil card is, in counts, and when that was.

TP and the card's TIME come in one answer, and the time is then the card's own (card_clock.py); cards that do not tell both give
TP alone, half-way between question and answer. A position that no axis can have reached since the last is taken for garbage.
"""

import re
import time
from typing import NamedTuple

from undrift.errors import LinkError
from undrift.rig.clock import Clock
from undrift.rig.galil.card import GalilCard
from undrift.rig.galil.card_clock import CardClock

BOTH = re.compile(r" *(-?\d{10}) +(-?\d{10}) *")
FINDING_S = 0.5  # longest look for the card's clock at the start, s of the host; every later position goes on looking


class Place(NamedTuple):
    """Where, and when.

    Parameters
    ----------
    counts : int
        TP.
    time : float
        s of the clock.
    within_s : float
        That time may be off by so much either way, s.
    """

    counts: int
    time: float
    within_s: float


class GalilPlace:
    """Reads positions.

    Parameters
    ----------
    card : GalilCard
        Its language.
    clock : Clock
        Hardware's or an emulator's.
    fastest : float
        Largest rate the axis is ever told, counts/s.
    slack : float
        How far a position may be off what that rate explains, counts.
    """

    def __init__(self, card: GalilCard, clock: Clock, fastest: float, slack: float) -> None:
        self.last: int | None = None
        self._card = card
        self._clock = clock
        self._fastest, self._slack = fastest, slack
        self._read_at = 0.0
        self._card_clock: CardClock | None = None
        self._both = f"MG _TP{card.axis}{{F10.0}},TIME{{F10.0}}"  # ten digits each: a lost byte shows

    def find_clock(self) -> None:
        """See whether the card tells a position and its own time in one answer, and for a moment how fast that time runs."""
        answer = self._card.port.ask(self._both)
        if answer is None or not BOTH.fullmatch(answer.strip("\r\n")):
            return
        self._card_clock = CardClock(self._card.number("MG _TM"))
        end = time.monotonic() + FINDING_S
        while self._card_clock.tick_s is None and time.monotonic() < end:
            self.read()
            time.sleep(0.02)

    def read(self) -> Place:
        """Return where it is and when that was.

        Returns
        -------
        Place
            Counts, s.

        Raises
        ------
        LinkError
            It jumped as no axis can, or the answer is garbled.
        """
        asked, ticks = self._clock.now(), 0
        if self._card_clock is None:
            counts = self._card.position(f"TP{self._card.axis}")
        else:
            counts, ticks = self._counts_and_ticks()
        answered = self._clock.now()
        middle = 0.5 * (asked + answered)
        self._check_reach(counts, answered)
        self.last, self._read_at = counts, asked
        if self._card_clock is None:
            return Place(counts, middle, 0.5 * (answered - asked))
        return Place(counts, *self._card_clock.when(ticks, asked, answered))

    def settled(self) -> int:
        """Return the position once it changes by a count at most; the servo settles after the profile.

        Returns
        -------
        int
            Counts.
        """
        before = self.read().counts
        for _ in range(50):
            self._clock.wait(0.02)
            now = self.read().counts
            if abs(now - before) <= 1:
                break
            before = now
        return now

    def _counts_and_ticks(self) -> tuple[int, int]:
        answer = self._card.text(self._both)
        found = BOTH.fullmatch(answer)
        if not found:
            raise LinkError(
                f"{self._card.port.name}: wanted two numbers of ten digits in answer to '{self._both}', got {answer!r}; "
                "check cable and baud"
            )
        return int(found.group(1)), int(found.group(2))

    def _check_reach(self, counts: int, now: float) -> None:
        """Allow for all the time that can have passed: from the last question to this answer."""
        if self.last is None:
            return
        reach = 1.5 * self._fastest * (now - self._read_at) + self._slack
        if abs(counts - self.last) > reach:
            raise LinkError(
                f"{self._card.port.name}: wanted a position within {reach:.0f} counts of {self.last}, got {counts}; "
                "the card was restarted, the answer is garbled, or an emulator runs faster than clock_speed says",
                counts=counts,
            )
