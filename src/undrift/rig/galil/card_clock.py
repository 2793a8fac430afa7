"""The card's own clock: when a position was taken, free of the delays of the link.

The operand TIME grows by a tick a sample, or a nominal millisecond, and cards count milliseconds of 1/1024 s: which of the four,

    tick = 1 ms, 1000/1024 ms, TM, TM 1000/1024

is seen from the host's clock. Two answers, n0 ticks asked at a0 and answered at b0, n ticks at a and b, bound it,

    (a - b0) / (n - n0) <= tick <= (b - a0) / (n - n0)

and as soon as one candidate alone is left, the time of a position is offset + tick (n + 1/2), known to half a tick. Before that,
and when none fits - a clock_speed that is wrong, a card that counts otherwise - it is the middle between question and answer.
Only differences of these times count: over hours the crystals of card and host part by milliseconds.
Source of the 2.4 %: DMC-1400 command reference, TM and TIME.
"""

import math

MILLISECOND = 1e-3
OLD_SECOND = 1000.0 / 1024.0  # a card's second that is divided by 1024
CRYSTAL = 2e-4  # how far the clocks of card and host may differ by themselves, 1


class CardClock:
    """When positions were taken, by the card's ticks.

    Parameters
    ----------
    sample_time_us : float
        TM as the card tells it, us.
    """

    def __init__(self, sample_time_us: float) -> None:
        sample = 1e-6 * sample_time_us
        ticks = (MILLISECOND, MILLISECOND * OLD_SECOND, sample, sample * OLD_SECOND)
        self._candidates = {round(tick, 12) for tick in ticks}
        self._latest = -1
        self._bounds = (0.0, math.inf)
        self._anchor: tuple[int, float, float] | None = None  # quickest answer: ticks, when asked, when answered
        self._offset: float | None = None

    @property
    def tick_s(self) -> float | None:
        """Length of a tick, s; None while it is not known."""
        low, high = self._bounds
        fit = [c for c in self._candidates if low * (1.0 - CRYSTAL) <= c <= high * (1.0 + CRYSTAL)]
        return fit[0] if len(fit) == 1 else None

    def when(self, ticks: int, asked: float, answered: float) -> tuple[float, float]:
        """Return when an answer was true.

        Parameters
        ----------
        ticks : int
            TIME in it.
        asked : float
            The host's clock before the question, s.
        answered : float
            The same after the answer, s.

        Returns
        -------
        time : float
            s.
        within_s : float
            It may be off by that much either way, s.
        """
        if ticks < self._latest:  # the card was restarted
            self._forget()
        self._latest = ticks
        self._learn(ticks, asked, answered)
        tick = self.tick_s
        if tick is None or self._anchor is None:
            self._offset = None
            return 0.5 * (asked + answered), 0.5 * (answered - asked)
        if self._offset is None:
            then, first, last = self._anchor
            self._offset = 0.5 * (first + last) - tick * then
        return self._offset + tick * (ticks + 0.5), 0.5 * tick

    def _forget(self) -> None:
        self._bounds, self._anchor, self._offset = (0.0, math.inf), None, None

    def _learn(self, ticks: int, asked: float, answered: float) -> None:
        if self._anchor is not None and ticks > self._anchor[0]:
            then, first, last = self._anchor
            low, high = self._bounds
            count = ticks - then
            # a reading of n ticks is a time of n to n + 1 of them
            self._bounds = (max(low, (asked - last) / (count + 1)), min(high, (answered - first) / max(count - 1, 0.5)))
        if self._anchor is None or answered - asked < self._anchor[2] - self._anchor[1]:
            self._anchor = (ticks, asked, answered)
