"""Counts and angles: what an encoder's lines or a stepper's steps are in rad, and how a card rounds what it is told.

An encoder of N lines gives 4N counts per turn (both edges of both tracks), so one count is 2 pi / 4N rad: 0.009 deg at 10 000
lines. Rounding happens here, before a byte is sent, so that what was sent is what the card holds.
"""

import math
from dataclasses import dataclass

from undrift.errors import InputError, LimitError

COUNTS_PER_LINE = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class CountScale:
    """How many counts make a turn.

    Parameters
    ----------
    counts_per_turn : float
        Counts (or steps) in 2 pi.
    """

    counts_per_turn: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.counts_per_turn) and self.counts_per_turn > 0.0):
            raise InputError(
                f"encoder: wanted counts per turn above 0, got {self.counts_per_turn:g}; look at its data sheet"
            )

    @classmethod
    def from_lines(cls, encoder_lines: int) -> "CountScale":
        """Make it from the lines on an encoder's disc.

        Parameters
        ----------
        encoder_lines : int
            Lines per turn, a quarter of the counts.

        Returns
        -------
        CountScale
            4 counts a line.

        Raises
        ------
        InputError
            No lines.
        """
        return cls(counts_per_turn=float(COUNTS_PER_LINE * encoder_lines))

    def angle(self, counts: float) -> float:
        """Return the angle of counts (or the rate of counts/s).

        Parameters
        ----------
        counts : float
            Counts, counts/s or counts/s2.

        Returns
        -------
        float
            rad, rad/s or rad/s2.
        """
        return counts * (2.0 * math.pi / self.counts_per_turn)

    def counts(self, angle: float) -> float:
        """Return the counts of an angle, not rounded.

        Parameters
        ----------
        angle : float
            rad, rad/s or rad/s2.

        Returns
        -------
        float
            Counts, counts/s or counts/s2.

        Raises
        ------
        InputError
            Not a number.
        """
        if not math.isfinite(angle):
            raise InputError(f"rig: wanted a finite angle or rate, got {angle}; check what computed it")
        return angle * (self.counts_per_turn / (2.0 * math.pi))


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """The values one command of a card accepts: multiples of a step within a range.

    Parameters
    ----------
    name : str
        The command, for messages: "JG", "AC", ...
    step : int
        Counts, counts/s or counts/s2 between two values.
    smallest : int
        Smallest magnitude that does something.
    largest : int
        Largest magnitude.
    """

    name: str
    step: int
    smallest: int
    largest: int

    def round(self, counts: float) -> int:
        """Return the nearest value the card can hold.

        Parameters
        ----------
        counts : float
            What is wanted, signed.

        Returns
        -------
        int
            A multiple of the step; halves go away from zero.

        Raises
        ------
        LimitError
            Too small to do anything, or beyond the card's range.
        """
        magnitude = self.step * math.floor(abs(counts) / self.step + 0.5)
        if not self.smallest <= magnitude <= self.largest:
            raise LimitError(
                f"{self.name}: wanted {self.smallest} to {self.largest} in steps of {self.step}, got {counts:.6g} counts; "
                "choose another rate, acceleration or angle",
                counts=counts,
                smallest=self.smallest,
                largest=self.largest,
            )
        return magnitude if counts > 0 else -magnitude


LONGEST_MOVE = 2_147_483_647  # counts, a signed word of 32 bits
JOG = Grid(name="JG", step=1, smallest=1, largest=12_000_000)
JOG_BY_TWO = Grid(name="JG", step=2, smallest=2, largest=12_000_000)
SLEW = Grid(name="SP", step=2, smallest=2, largest=12_000_000)
ACCELERATION = Grid(name="AC", step=1024, smallest=1024, largest=67_107_840)
MOVE = Grid(name="PR", step=1, smallest=1, largest=LONGEST_MOVE)
