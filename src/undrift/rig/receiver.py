"""Receiver: one thread that reads a transport, and a caller that waits for whole replies with a deadline.

Bytes that nobody asked for are kept aside: those the caller sets aside before a question, and, where the device marks them, those
whose high bit is set.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from undrift.errors import LinkError, RigTimeout
from undrift.rig.transport import Transport

ReplyEnd = Callable[[bytes], int]
LONGEST_REPLY = 65536  # bytes without an end: no device of ours says so much

log = logging.getLogger(__name__)


def line_end(received: bytes) -> int:
    """Return where a reply of one line ends.

    Parameters
    ----------
    received : bytes
        What has come since the question.

    Returns
    -------
    int
        Length of the reply with its line feed, 0 while it is not whole.
    """
    return received.find(b"\n") + 1


class Receiver:
    """What comes from one transport, from birth until `stop`.

    Parameters
    ----------
    transport : Transport
        Open; whoever opened it closes it after `stop`.
    name : str
        Where it leads, for messages.
    """

    def __init__(self, transport: Transport, name: str) -> None:
        self.lost: str | None = None
        self.high_bit_is_unsolicited = False
        self._name = name
        self._transport = transport
        self._change = threading.Condition()
        self._received = bytearray()
        self._aside: deque[int] = deque(maxlen=LONGEST_REPLY)
        self._thread = threading.Thread(target=self._read_all, name=f"link {name}", daemon=True)
        self._thread.start()

    def take(self, reply_end: ReplyEnd, wait_s: float, question: str) -> bytes:
        """Wait for a whole reply and take it out.

        Parameters
        ----------
        reply_end : ReplyEnd
            Tells where it ends.
        wait_s : float
            Longest wait, s.
        question : str
            What it answers, for messages.

        Returns
        -------
        bytes
            With its end.

        Raises
        ------
        RigTimeout
            Not whole in time.
        LinkError
            The connection is lost, or no end comes.
        """
        last = time.monotonic() + wait_s
        with self._change:
            while not (length := reply_end(bytes(self._received))):
                self._check_hope(question, wait_s, last)
                self._change.wait(max(last - time.monotonic(), 0.0))
            reply = bytes(self._received[:length])
            del self._received[:length]
        return reply

    def set_aside(self) -> None:
        """Move what came without being asked for to the unsolicited text."""
        with self._change:
            self._aside.extend(self._received)
            self._received.clear()

    def unsolicited(self) -> str:
        """Return what came without being asked for, once.

        Returns
        -------
        str
            High bits removed.
        """
        with self._change:
            text = bytes(byte & 0x7F for byte in self._aside).decode("ascii")
            self._aside.clear()
        return text

    def lose(self, reason: str) -> None:
        """Note that the connection is gone, and wake whoever waits.

        Parameters
        ----------
        reason : str
            The first one stays.
        """
        with self._change:
            self.lost = self.lost or reason
            self._change.notify_all()
        log.info("link %s: %s", self._name, reason)

    def stop(self) -> None:
        """End the reading thread; harmless when called again."""
        self.lose("closed")
        self._transport.wake()
        self._thread.join(timeout=5.0)

    def _read_all(self) -> None:
        while self.lost is None:
            try:
                data = self._transport.read()
            except (OSError, EOFError) as error:
                self.lose(str(error) or type(error).__name__)
                return
            if data:
                self._keep(data)

    def _keep(self, data: bytes) -> None:
        with self._change:
            if self.high_bit_is_unsolicited:
                self._aside.extend(byte for byte in data if byte & 0x80)
                data = bytes(byte for byte in data if not byte & 0x80)
            self._received.extend(data)
            self._change.notify_all()

    def _check_hope(self, question: str, wait_s: float, last: float) -> None:
        """Raise when waiting on cannot help; called with the lock held."""
        came = bytes(self._received[:80])
        if len(self._received) > LONGEST_REPLY:
            raise LinkError(
                f"{self._name}: wanted an end of the answer to '{question}', got {came!r} and more; check baud"
            )
        if self.lost is not None:
            raise LinkError(f"{self._name}: wanted an answer to '{question}', got a lost link: {self.lost}; reconnect")
        if time.monotonic() >= last:
            got = f"only {came!r}" if came else "nothing"
            raise RigTimeout(
                f"{self._name}: wanted an answer to '{question}' within {wait_s:g} s, got {got}; check power and cable",
                deadline_s=wait_s,
            )
