"""Faults: what an emulated rig can be made to suffer, and what the real one would do.

Faults of the link change the bytes of answers between card and client; faults of the rig are handed to the machine.
"""

import random
import threading
import time

from undrift.errors import InputError

LINK_FAULTS = {
    "drop_bytes": "every third byte of each answer is lost",
    "stall": "answers are held back until the fault is cleared, then come late; the card goes on doing what it is told",
    "garbage": "each answer is replaced by random bytes without a prompt",
    "half_reply": "the second half of each answer, prompt included, is lost",
    "slow_link": "answers come at 20 bytes a second of the host's time",
    "late_reply": "each answer comes 0.5 s late, host's time",
    "disconnect": "every client's socket is closed once; the card goes on with what it was told, clients may come back",
}
RIG_FAULTS = {
    "amplifier_fault": "no torque while it lasts; with OE1 the card switches the motor off, SC 8; else the error grows",
    "encoder_loss": "the count freezes and the axis runs away, until the error passes ER with OE1: motor off, SC 8",
    "limit_switch": "the forward switch closes: a forward motion slows to rest, SC 2; BG forward is refused with TC 22",
    "limit_switch_reverse": "the reverse switch closes: a reverse motion slows to rest, SC 3; BG back is refused with TC 22",
    "abort_input": "the motion ends at once, SC 6; with OE1 the motor is switched off",
    "power_cut": "sockets close, none is accepted, the axis coasts to rest by friction; cleared, the card starts afresh",
    "message": "the card sends a line that nobody asked for, once",
}
SLOW_BYTES_PER_S = 20.0
LATE_S = 0.5


def check_fault(name: str) -> None:
    """Refuse a fault that is not one.

    Parameters
    ----------
    name : str
        Its name.

    Raises
    ------
    InputError
        Not one of the faults.
    """
    if name not in LINK_FAULTS and name not in RIG_FAULTS:
        known = ", ".join((*LINK_FAULTS, *RIG_FAULTS))
        raise InputError(f"fault: wanted one of {known}, got '{name}'; name one of them")


class FaultyLink:
    """What the link does to answers.

    Parameters
    ----------
    seed : int
        Of the garbage.
    """

    def __init__(self, seed: int = 0) -> None:
        self._active: dict[str, int | None] = {}  # answers that it still lasts for; None without end
        self._random = random.Random(seed)
        self._lock = threading.Lock()

    def start(self, name: str, answers: int | None) -> None:
        """Let a fault begin.

        Parameters
        ----------
        name : str
            One of LINK_FAULTS.
        answers : int or None
            How many answers it strikes; None until it is cleared.
        """
        with self._lock:
            self._active[name] = answers

    def stop(self, name: str | None) -> None:
        """Let a fault end.

        Parameters
        ----------
        name : str or None
            Which; None for all.
        """
        with self._lock:
            if name is None:
                self._active.clear()
            else:
                self._active.pop(name, None)

    @property
    def stalled(self) -> bool:
        """Whether answers are held back."""
        with self._lock:
            return "stall" in self._active

    def take_disconnect(self) -> bool:
        """Tell, once, that clients are to be cut off."""
        with self._lock:
            return self._active.pop("disconnect", 0) != 0

    def pass_on(self, answer: bytes, free_at: float) -> list[tuple[float, bytes]]:
        """Return an answer as it arrives: pieces with the host's time at which each is sent.

        Parameters
        ----------
        answer : bytes
            From the card.
        free_at : float
            When the last piece before it is sent, host's monotonic s.

        Returns
        -------
        list of (float, bytes)
            In order.
        """
        now = max(time.monotonic(), free_at)
        with self._lock:
            if self._struck("garbage"):
                letters = [byte for byte in range(256) if byte not in b":?"]
                answer = bytes(self._random.choice(letters) for _ in range(len(answer) + 8))
            if self._struck("half_reply"):
                answer = answer[: len(answer) // 2]
            if self._struck("drop_bytes"):
                answer = (
                    bytes(byte for place, byte in enumerate(answer, start=1) if place % 3) if len(answer) > 1 else b""
                )
            if self._struck("late_reply"):
                now = max(time.monotonic() + LATE_S, free_at)
            if self._struck("slow_link"):
                step = 1.0 / SLOW_BYTES_PER_S
                return [(now + step * (place + 1), answer[place : place + 1]) for place in range(len(answer))]
        return [(now, answer)]

    def _struck(self, name: str) -> bool:
        if name not in self._active:
            return False
        left = self._active[name]
        if left is not None:
            if left <= 1:
                del self._active[name]
            else:
                self._active[name] = left - 1
        return True
