"""Links to rigs: questions and answers, each with a deadline, over TCP or a serial port.

The caller that asks also reads the answer. Bytes that arrive between two exchanges are discarded. After an answer that is too late,
the link is out of step: the late answer would be read as the next one. Such a link raises LinkError until an exchange with `anew`
has resynchronised it.

A link is opened with a URL: ``tcp://host:port``, ``serial:///dev/ttyUSB0`` or a plain path (also of a pty). The pyserial URLs
``socket://host:port`` and ``loop://`` are also accepted.
"""

import logging
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

from undrift.base.clock import HOST, Clock, Port
from undrift.errors import InputError, LinkError, RigError, RigTimeout
from undrift.live.transports import CONNECT_S, POLL_S, SerialPort, host_and_port, reason_of, tcp_port
from undrift.rig.rig import Position, RigSettings

T = TypeVar("T")
LONGEST_REPLY = 65536  # longest reply that is accepted, bytes

log = logging.getLogger(__name__)


def open_port(url: str, baud: int, clock: Clock) -> Port:
    """Open the port of a URL."""
    host, port = host_and_port(url.removeprefix("tcp:")) if url.startswith("tcp://") else ("", 0)
    is_known = url.startswith(("serial://", "socket://", "loop://", "/", "COM")) and url != "serial://"
    if not (host and port) and not is_known:
        raise InputError(
            f"link: expected tcp://host:port, serial:///path, a path, socket://host:port or loop://, got '{url}'. Enter the "
            "connection of the rig."
        )
    try:
        if host:
            return tcp_port(host, port, CONNECT_S, clock)
        return SerialPort(url.removeprefix("serial://"), baud)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        raise LinkError(f"{url}: cannot connect ({reason_of(error)}). Check power, cable and address.") from error


class Link(AbstractContextManager["Link"]):
    """A connection that is open from its construction until `close`."""

    terminator = "\n"  # end of every question
    reply_end = re.compile(rb"\n")  # end of the first whole reply in the received bytes

    def __init__(self, url: str, *, reply_timeout_s: float = 2.0, baud: int = 19200, clock: Clock = HOST) -> None:
        self.name, self.reply_timeout_s, self.clock = url, reply_timeout_s, clock
        self._baud = baud
        self._lost: str | None = None  # reason why the connection is lost
        self._received, self._in_step = bytearray(), True
        self._port = open_port(url, baud, clock)

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """True unless the connection is known to be lost."""
        self._listen(0.0)
        return self._lost is None

    def exchange(
        self,
        text: str,
        wait_s: float | None = None,
        *,
        until: re.Pattern[bytes] | None = None,
        terminator: str | None = None,
        anew: bool = False,
    ) -> str:
        """Send a question and return the answer. With `anew`, the question has a unique answer, so the link is in step again."""
        if not (self._in_step or anew):
            raise LinkError(
                f"{self.name}: cannot send '{text}', the link is out of step with its device. Resynchronise it first."
            )
        self._in_step = False  # stays False if an exception (also Ctrl-C) prevents reading the answer
        while self._listen(0.0) and len(self._received) < LONGEST_REPLY:
            pass
        self._received.clear()
        self.send((text + (self.terminator if terminator is None else terminator)).encode("latin-1"))
        reply = self._wait_for(text, until or self.reply_end, self.reply_timeout_s if wait_s is None else wait_s)
        self._in_step = True
        try:
            return reply.decode("ascii", errors="backslashreplace" if anew else "strict")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.name}: the answer to '{text}' is not text: {reply[:80]!r}. Check baud rate and cable."
            ) from error

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer."""
        if self._lost is not None:
            raise LinkError(f"{self.name}: the link is lost ({self._lost}). Reconnect it.")
        try:
            self._port.write(data)
        except OSError as error:
            self._lose(reason_of(error))
            raise LinkError(f"{self.name}: cannot send ({error}). Check the cable and reconnect.") from error

    def reconnect(self) -> None:
        """Close the link and open it again, with empty buffers."""
        self.close()
        self._port = open_port(self.name, self._baud, self.clock)
        self._lost, self._in_step = None, True
        self._received.clear()

    def close(self) -> None:
        """Close the connection. A second call has no effect."""
        self._lose("closed")
        self._port.close()

    def _lose(self, reason: str) -> None:
        self._lost = self._lost or reason
        log.info("link %s: %s", self.name, reason)

    def _listen(self, wait_s: float) -> bool:
        """Receive the bytes that arrive within a time, and return True if any arrived."""
        if self._lost is not None:
            return False
        try:
            data = self._port.receive(wait_s)
        except (OSError, EOFError) as error:
            self._lose(reason_of(error))
            return False
        self._received.extend(data)
        return bool(data)

    def _wait_for(self, text: str, reply_end: re.Pattern[bytes], wait_s: float) -> bytes:
        """Wait for the whole reply to a question and remove it from the buffer."""
        last = self.clock.now() + wait_s
        while not (match := reply_end.search(self._received)):
            beginning, left_s = bytes(self._received[:80]), last - self.clock.now()
            if len(self._received) > LONGEST_REPLY:
                raise LinkError(
                    f"{self.name}: the answer to '{text}' does not end, it starts with {beginning!r}. Check the baud rate."
                )
            if self._lost is not None:
                raise LinkError(f"{self.name}: no answer to '{text}', the link is lost ({self._lost}). Reconnect it.")
            if left_s <= 0.0:
                received = f"only {beginning!r}" if beginning else "nothing"
                raise RigTimeout(
                    f"{self.name}: no answer to '{text}' within {wait_s:g} s, got {received}. Check power and cable.",
                    deadline_s=wait_s,
                )
            self._listen(min(left_s, POLL_S))
        reply = bytes(self._received[: match.end()])
        self._received = self._received[match.end() :]
        return reply


# ---- Common parts of rigs with a link.


def ask_until(ask: Callable[[], T], clock: Clock, within_s: float) -> T | None:
    """Ask a controller until the answer is true, and return that answer, or None on timeout (after at least 1 s)."""
    return clock.until(ask, max(within_s, 1.0))


class LinkedRig(ABC):
    """Base class of rigs with a link. A subclass has the commands of its controller, and makes the table safe after an error."""

    stopped = unconfirmed = ""  # state of the table after a failure, for messages
    unit, slack = "", 0.0  # unit of the controller's positions, and their tolerance
    rad_per_unit = 1.0  # angle of one unit of position, rad

    def __init__(self, link: Link, settings: RigSettings) -> None:
        self.limits, self.clock, self._link = settings.limits, settings.clock, link
        self._enabled = False
        self._refused = ""  # reason to refuse all commands
        self._fastest = math.inf  # largest rate, units/s
        self._home = 0.0  # position when the rig was opened, units
        self._last = math.nan  # last position, units (NaN until the first one)
        self._asked_s = 0.0  # time of its question, s
        try:
            self._prepare(settings)
        except RigError:
            link.close()
            raise

    @abstractmethod
    def _prepare(self, settings: RigSettings) -> None:
        """Check that the table is free, configure the controller and store the initial position."""

    @abstractmethod
    def _make_safe(self) -> bool:
        """Stop and switch the motor off, and reconnect first if the link is lost. Return True if the controller confirms it."""

    @abstractmethod
    def _ask_position(self) -> float:
        """Return the position that the controller reports, units."""

    def position(self) -> Position:
        """Return the angle since the rig was opened, rad, timed half-way between question and answer."""
        with self._guarded():
            asked_s = self.clock.now()
            angle = (self._read_position() - self._home) * self.rad_per_unit
            answered_s = self.clock.now()
        return Position(angle=angle, time=0.5 * (asked_s + answered_s), within_s=0.5 * (answered_s - asked_s))

    def close(self) -> None:
        """Stop, switch the motor off and close the link. A second call has no effect."""
        if self._refused == "it is closed":
            return
        try:
            confirmed = self._make_safe()
        finally:
            self._refused = "it is closed"
            self._link.close()
        if not confirmed:
            raise LinkError(
                f"{self._link.name}: no answer when the motor was switched off at the end. {self.unconfirmed}"
            )

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise LinkError if the rig is closed or lost. If the link fails within the block, make the table safe first."""
        if self._refused:
            raise LinkError(f"{self._link.name}: the rig accepts no commands ({self._refused}). Open it again.")
        try:
            yield
        except (LinkError, RigTimeout) as error:
            outcome = self.stopped if self._make_safe() else self.unconfirmed
            raise type(error)(f"{error} {outcome}", **error.numbers) from error

    def _check_travel(self, distance: float) -> None:
        """Raise LimitError if a move by a distance, units, leads beyond the travel."""
        self.limits.check_travel((self._last - self._home + distance) * self.rad_per_unit)

    def _read_position(self) -> float:
        """Return the position, units. Raise LinkError for one that the axis cannot have reached since the last one."""
        before_s, self._asked_s = self._asked_s, self.clock.now()
        position = self._ask_position()
        reach = 1.5 * self._fastest * (self.clock.now() - before_s) + self.slack
        if abs(position - self._last) > reach:
            raise LinkError(
                f"{self._link.name}: expected a position within {reach:.1f} {self.unit} of {self._last:g}, got {position:g}. "
                "The controller was restarted, or the answer is corrupted.",
                position=position,
            )
        self._last = position
        return position
