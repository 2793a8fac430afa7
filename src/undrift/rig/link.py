"""Link: questions and answers with a rig or device, each with a deadline.

One thread reads; everything else happens in the caller. Bytes that nobody asked for are kept aside: those that come between two
exchanges, and, where the device marks them, those whose high bit is set (Galil CW1). After an answer that did not come in time the
link is out of step - the answer may still come, and would be taken for the next one - so it refuses to go on until `resynchronise`.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from undrift.errors import InputError, LinkError, RigTimeout
from undrift.rig.transport import Transport, open_transport

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


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSettings:
    """How to talk.

    Parameters
    ----------
    terminator : str
        Ends every question.
    reply_end : ReplyEnd
        Tells where a reply ends in what has come; 0 while it is not whole.
    reply_timeout_s : float
        Longest wait for a reply, s, unless an exchange says otherwise.
    connect_timeout_s : float
        Longest wait for a connection, s.
    baud : int
        Bits per second of a serial port.
    hardware_handshake : bool
        RTS/CTS of a serial port.
    """

    terminator: str = "\n"
    reply_end: ReplyEnd = line_end
    reply_timeout_s: float = 2.0
    connect_timeout_s: float = 5.0
    baud: int = 19200
    hardware_handshake: bool = False

    def __post_init__(self) -> None:
        for name in ("reply_timeout_s", "connect_timeout_s", "baud"):
            if not getattr(self, name) > 0:
                raise InputError(f"link: wanted {name} above 0, got {getattr(self, name)}; every wait has an end")


class Link:
    """A connection that is open from birth until `close`.

    Parameters
    ----------
    url : str
        ``tcp://host:port``, ``serial:///dev/ttyUSB0``, a path, ``socket://host:port`` or ``loop://``.
    settings : LinkSettings
        How to talk.

    Raises
    ------
    InputError
        Not such a URL.
    LinkError
        Nobody answers there.
    """

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self.url = url
        self.settings = settings
        self.high_bit_is_unsolicited = False
        self._change = threading.Condition()
        self._one_at_a_time = threading.RLock()
        self._received = bytearray()
        self._aside: deque[int] = deque(maxlen=LONGEST_REPLY)
        self._lost: str | None = "not connected yet"
        self._in_step = True
        self._transport: Transport | None = None
        self._reader: threading.Thread | None = None
        self._connect()

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known here."""
        return self._lost is None

    def exchange(self, text: str, deadline_s: float | None = None, *, until: ReplyEnd | None = None) -> str:
        """Ask and return the answer.

        Parameters
        ----------
        text : str
            The question, without its terminator.
        deadline_s : float or None
            Longest wait, s; the settings' when None.
        until : ReplyEnd or None
            Where this reply ends, when otherwise than the settings say.

        Returns
        -------
        str
            The reply with its end.

        Raises
        ------
        RigTimeout
            No whole reply in time.
        LinkError
            The connection is lost or out of step, or what came is no text.
        """
        with self._one_at_a_time:
            if not self._in_step:
                raise LinkError(
                    f"{self.url}: wanted an answer to '{text}', got a link out of step with its device; resynchronise first"
                )
            self.set_aside()
            self._in_step = False  # and stays so when anything, Ctrl-C included, keeps the answer from being read
            self.send((text + self.settings.terminator).encode("ascii"))
            reply = self.read(deadline_s, until=until, question=text)
            self._in_step = True
            return reply

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer.

        Parameters
        ----------
        data : bytes
            As they go out.

        Raises
        ------
        LinkError
            The connection is lost.
        """
        transport = self._transport
        if transport is None or self._lost is not None:
            raise LinkError(f"{self.url}: wanted an open link, got one lost: {self._lost}; reconnect")
        try:
            transport.write(data)
        except OSError as error:
            self._lose(str(error) or type(error).__name__)
            raise LinkError(f"{self.url}: wanted to send, got '{error}'; check the cable, reconnect") from error

    def read(self, deadline_s: float | None = None, *, until: ReplyEnd | None = None, question: str = "") -> str:
        """Return the next reply or line that comes.

        Parameters
        ----------
        deadline_s : float or None
            Longest wait, s; the settings' when None.
        until : ReplyEnd or None
            Where it ends, when otherwise than the settings say.
        question : str
            What it answers, for messages.

        Returns
        -------
        str
            With its end.

        Raises
        ------
        RigTimeout
            Not whole in time.
        LinkError
            The connection is lost, or what came is no text.
        """
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        reply_end = until or self.settings.reply_end
        last = time.monotonic() + wait_s
        with self._one_at_a_time, self._change:
            while not (length := reply_end(bytes(self._received))):
                self._refuse_to_wait(question, wait_s, last)
                self._change.wait(max(last - time.monotonic(), 0.0))
            reply = bytes(self._received[:length])
            del self._received[:length]
        try:
            return reply.decode("ascii")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.url}: wanted text in answer to '{question}', got {reply!r}; check baud and cable"
            ) from error

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
            High bits removed; what is no text is shown as \\x..
        """
        with self._change:
            text = bytes(byte & 0x7F for byte in self._aside).decode("ascii", errors="backslashreplace")
            self._aside.clear()
        return text

    def resynchronise(self, text: str, until: ReplyEnd, deadline_s: float | None = None) -> str:
        """Ask something that only one answer fits, and throw away all before it.

        Parameters
        ----------
        text : str
            The question.
        until : ReplyEnd
            Where its own answer ends, whatever stands before it.
        deadline_s : float or None
            Longest wait, s; the settings' when None.

        Returns
        -------
        str
            All that came, the answer at its end.

        Raises
        ------
        RigTimeout
            It did not come in time.
        LinkError
            The connection is lost.
        """
        with self._one_at_a_time:
            self._in_step = True
            return self.exchange(text, deadline_s, until=until)

    def reconnect(self) -> None:
        """Close and open again, with nothing left over from before.

        Raises
        ------
        LinkError
            Nobody answers.
        """
        with self._one_at_a_time:
            self.close()
            self._connect()

    def close(self) -> None:
        """Let go of the connection and end the reading thread; harmless when called again."""
        transport, reader = self._transport, self._reader
        self._transport = self._reader = None
        if transport is None:
            return
        self._lose("closed")
        transport.wake()
        if reader is not None:
            reader.join(timeout=5.0)
        transport.close()

    def _connect(self) -> None:
        transport = open_transport(
            self.url,
            baud=self.settings.baud,
            hardware_handshake=self.settings.hardware_handshake,
            connect_timeout_s=self.settings.connect_timeout_s,
        )
        with self._change:
            self._received.clear()
            self._lost = None
            self._in_step = True
            self.high_bit_is_unsolicited = False
        self._transport = transport
        self._reader = threading.Thread(target=self._read_all, args=(transport,), name=f"link {self.url}", daemon=True)
        self._reader.start()

    def _read_all(self, transport: Transport) -> None:
        """Read until the connection ends; the only place that reads."""
        while self._transport is transport:
            try:
                data = transport.read()
            except (OSError, EOFError, TypeError, ValueError) as error:  # pyserial closed beneath us says Type or Value
                if self._transport is transport:
                    self._lose(str(error) or type(error).__name__)
                break
            if data:
                self._keep(data)

    def _keep(self, data: bytes) -> None:
        with self._change:
            if self.high_bit_is_unsolicited:
                self._aside.extend(byte for byte in data if byte & 0x80)
                data = bytes(byte for byte in data if not byte & 0x80)
            self._received.extend(data)
            self._change.notify_all()

    def _lose(self, reason: str) -> None:
        with self._change:
            self._lost = self._lost or reason
            self._change.notify_all()
        log.info("link %s: %s", self.url, reason)

    def _refuse_to_wait(self, question: str, wait_s: float, last: float) -> None:
        """Raise when waiting on cannot help; called with the lock held."""
        came = bytes(self._received[:80])
        if len(self._received) > LONGEST_REPLY:
            self._in_step = False
            raise LinkError(
                f"{self.url}: wanted an end of the answer to '{question}', got {came!r} and more; check baud"
            )
        if self._lost is not None:
            raise LinkError(f"{self.url}: wanted an answer to '{question}', got a lost link: {self._lost}; reconnect")
        if time.monotonic() >= last:
            got = f"only {came!r}" if came else "nothing"
            raise RigTimeout(
                f"{self.url}: wanted an answer to '{question}' within {wait_s:g} s, got {got}; check power and cable",
                deadline_s=wait_s,
            )
