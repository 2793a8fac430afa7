"""Links to rigs: questions and answers, each with a deadline, over TCP or a serial port.

The caller that asks also reads the answer. Unsolicited bytes are stored separately. These are the bytes that arrive between two
exchanges and, for a Galil card with CW1, the bytes with the high bit set. After an answer that is too late, the link is out of
step: the late answer would be read as the next one. Such a link raises LinkError until `ask_anew` has resynchronised it.

A link is opened with a URL: ``tcp://host:port``, ``serial:///dev/ttyUSB0`` or a plain path (also of a pty). The pyserial URLs
``socket://host:port`` and ``loop://`` are also accepted.
"""

import contextlib
import logging
import math
import re
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

from undrift.base.clock import HOST, Clock, Port
from undrift.errors import InputError, LinkError, RigError, RigTimeout, check_positive
from undrift.live.transports import POLL_S, SerialPort, host_and_port, reason_of, tcp_port
from undrift.rig.rig import Limits, RigSettings

T = TypeVar("T")
ReplyEnd = Callable[[bytes], int]  # length of the first whole reply in the received bytes, or 0
LONGEST_REPLY = 65536  # longest reply that is accepted, bytes
CLOSE_S = 5.0  # longest wait of close() for a pending exchange to fail, s

log = logging.getLogger(__name__)


def end_of(pattern: bytes) -> ReplyEnd:
    """Return a function that finds the end of a reply from a pattern."""
    text = re.compile(pattern)

    def end(received: bytes) -> int:
        match = text.search(received)
        return match.end() if match else 0

    return end


line_end = end_of(rb"\n")
reply_end = end_of(rb"(?:^|\n)[:?]")  # prompt of a Galil card at the start of a line


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSettings:
    """Line format, timeouts and port settings of a link."""

    terminator: str = "\n"  # end of every question
    reply_end: ReplyEnd = line_end
    reply_timeout_s: float = 2.0  # longest wait for a reply, s, unless an exchange overrides it
    connect_timeout_s: float = 5.0  # longest wait for a connection, s
    baud: int = 19200  # bits per second of a serial port
    hardware_handshake: bool = False  # RTS/CTS of a serial port
    clock: Clock = HOST  # clock of the timeouts

    def __post_init__(self) -> None:
        check_positive(self, "link", "set a positive value", "reply_timeout_s", "connect_timeout_s", "baud")


def link_settings(settings: RigSettings, baud: int = 19200) -> LinkSettings:
    """Return the link settings of a rig. The baud rate applies if the rig settings do not set one."""
    return LinkSettings(
        reply_timeout_s=settings.reply_timeout_s,
        baud=settings.baud or baud,
        hardware_handshake=settings.hardware_handshake,
        clock=settings.timing.host,
    )


def open_port(url: str, settings: LinkSettings) -> Port:
    """Open the port of a URL."""
    accepted = "expected tcp://host:port, serial:///path, a path, socket://host:port or loop://"
    host, port = host_and_port(url.removeprefix("tcp:")) if url.startswith("tcp://") else ("", 0)
    if url.startswith("tcp://") and not (host and port):
        raise InputError(f"link: {accepted}, got '{url}'. Enter host and port.")
    if not url.startswith(("tcp://", "serial://", "socket://", "loop://", "/", "COM")):
        raise InputError(f"link: {accepted}, got '{url}'. Enter the connection of the rig.")
    if url == "serial://":
        raise InputError(f"link: {accepted}, got no port name. Enter the name, for example serial:///dev/ttyUSB0.")
    try:
        if not host:
            return SerialPort(url.removeprefix("serial://"), settings.baud, settings.hardware_handshake)
        return tcp_port(host, port, settings.connect_timeout_s, settings.clock)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        reason = reason_of(error)
        raise LinkError(f"{url}: cannot connect ({reason}). Check power, cable and address.") from error


class Link(AbstractContextManager["Link"]):
    """A connection that is open from its construction until `close`."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self.name, self.settings = url, settings
        self._one_at_a_time = threading.RLock()
        self._high_bit_is_unsolicited = False
        self._aside: deque[int] = deque(maxlen=LONGEST_REPLY)
        self._connect()

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """True unless the connection is known to be lost."""
        if self._one_at_a_time.acquire(blocking=False):  # otherwise a pending exchange detects the loss
            try:
                self._listen(0.0)
            finally:
                self._one_at_a_time.release()
        return self._lost is None

    def mask_unsolicited(self) -> None:
        """Remove bytes with the high bit set from all later replies, until the link is opened again."""
        self._high_bit_is_unsolicited = True

    def exchange(
        self,
        text: str,
        deadline_s: float | None = None,
        *,
        until: ReplyEnd | None = None,
        terminator: str | None = None,
    ) -> str:
        """Send a question and return the answer."""
        with self._one_at_a_time:
            if not self._in_step:
                raise LinkError(
                    f"{self.name}: cannot send '{text}', the link is out of step with its device. Resynchronise it first."
                )
            reply = self._ask(text, deadline_s, until, terminator)
        try:
            return reply.decode("ascii")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.name}: the answer to '{text}' is not text: {reply[:80]!r}. Check baud rate and cable."
            ) from error

    def ask_anew(
        self, text: str, until: ReplyEnd, deadline_s: float | None = None, *, terminator: str | None = None
    ) -> str:
        """Send a question with a unique answer and discard all bytes before that answer, so that the link is in step again."""
        with self._one_at_a_time:
            return self._ask(text, deadline_s, until, terminator).decode("ascii", errors="backslashreplace")

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer."""
        if self._lost is not None:
            raise LinkError(f"{self.name}: the link is lost ({self._lost}). Reconnect it.")
        try:
            self._port.write(data)
        except OSError as error:
            self._lose(reason_of(error))
            raise LinkError(f"{self.name}: cannot send ({error}). Check the cable and reconnect.") from error

    def unsolicited(self) -> str:
        """Return the unsolicited text that has arrived since the last call."""
        with self._one_at_a_time:
            text = bytes(byte & 0x7F for byte in self._aside).decode("ascii")
            self._aside.clear()
        return text

    def reconnect(self) -> None:
        """Close the link and open it again, with empty buffers."""
        with self._one_at_a_time:
            self.close()
            self._connect()

    def close(self) -> None:
        """Close the connection. A pending exchange raises LinkError. A second call has no effect."""
        self._lose("closed")
        self._port.wake()
        acquired = self._one_at_a_time.acquire(timeout=CLOSE_S)
        try:
            self._port.close()
        finally:
            if acquired:
                self._one_at_a_time.release()

    def _connect(self) -> None:
        self._port = open_port(self.name, self.settings)
        self._lost: str | None = None
        self._received, self._in_step = bytearray(), True
        self._high_bit_is_unsolicited = False
        self._aside.clear()

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
        if self._high_bit_is_unsolicited:
            self._aside.extend(byte for byte in data if byte & 0x80)
        self._received.extend(byte for byte in data if not (byte & 0x80 and self._high_bit_is_unsolicited))
        return bool(data)

    def _ask(self, text: str, deadline_s: float | None, until: ReplyEnd | None, terminator: str | None) -> bytes:
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        end = self.settings.terminator if terminator is None else terminator
        self._in_step = False  # stays False if an exception (also Ctrl-C) prevents reading the answer
        while self._listen(0.0) and len(self._received) < LONGEST_REPLY:
            pass
        self._aside.extend(self._received)  # unsolicited bytes
        self._received.clear()
        self.send((text + end).encode("latin-1"))
        reply = self._take(until or self.settings.reply_end, wait_s, text)
        self._in_step = True
        return reply

    def _take(self, reply_end: ReplyEnd, wait_s: float, question: str) -> bytes:
        """Wait for a whole reply and remove it from the buffer."""
        clock = self.settings.clock
        last = clock.now() + wait_s
        while not (length := reply_end(bytes(self._received))):
            beginning, left_s = bytes(self._received[:80]), last - clock.now()
            if len(self._received) > LONGEST_REPLY:
                raise LinkError(
                    f"{self.name}: the answer to '{question}' does not end, it starts with {beginning!r}. Check the baud rate."
                )
            if self._lost is not None:
                raise LinkError(
                    f"{self.name}: no answer to '{question}', the link is lost ({self._lost}). Reconnect it."
                )
            if left_s <= 0.0:
                received = f"only {beginning!r}" if beginning else "nothing"
                raise RigTimeout(
                    f"{self.name}: no answer to '{question}' within {wait_s:g} s, got {received}. Check power and cable.",
                    deadline_s=wait_s,
                )
            self._listen(min(left_s, POLL_S))
        reply = bytes(self._received[:length])
        del self._received[:length]
        return reply


# ---- Ports of a Galil card. A command ends with a carriage return. The answer is ``:``, text and ``:``, or ``?``.


class LinkPort(Link):
    """A card on TCP or a serial port."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self._token = 41_000
        super().__init__(url, replace(settings, terminator="\r", reply_end=reply_end))

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Return the text of the answer ("" for a bare ``:``), or None if the card rejects the command."""
        reply = self.exchange(command, deadline_s)
        if reply == "?":
            return None
        if not reply.endswith(":") or "?" in reply:
            raise LinkError(f"{self.name}: {reply!r} is not an answer to '{command}'. Check cable and baud rate.")
        return reply[:-1]

    def shout(self, command: str) -> None:
        """Send without waiting for an answer. The next question reports a lost link."""
        with contextlib.suppress(RigError):
            self.send(f"{command}\r".encode("ascii"))

    def resynchronise(self) -> None:
        """Ask the card to print a number that was not used before, and discard all bytes before that number."""
        for attempt in range(3):
            self._token += 1
            try:  # the card may add leading zeros and decimals
                self.ask_anew(f"MG {self._token}", end_of(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % self._token))
            except RigTimeout:
                if attempt == 2:
                    raise
            else:
                self.unsolicited()  # discards prompts of commands that were sent without reading the answer
                return


# ---- Clock of a card.

MILLISECOND = 1e-3
OLD_SECOND = 1000.0 / 1024.0  # factor of old cards, which count milliseconds of 1/1024 s
CRYSTAL = 2e-4  # largest relative difference between the clock rates of card and host, 1


class CardClock:
    """Times of positions from the card's ticks, free of the delays of the link.

    TIME counts samples or nominal milliseconds. On old cards a millisecond is 1/1024 s. So the tick is 1 ms, 1000/1024 ms, TM or
    TM 1000/1024. The host's clock determines which candidate applies. Two answers bound the tick: n0 ticks, asked at a0 and
    answered at b0, and n ticks, asked at a and answered at b:

        (a - b0) / (n - n0) <= tick <= (b - a0) / (n - n0)

    When only one candidate is left, the time of a position is offset + tick (n + 1/2), to half a tick. Until then, or if no
    candidate fits (for example with a wrong clock_speed), the time is the middle between question and answer.
    Use differences of these times only, because the crystals of card and host drift apart by milliseconds per hour.
    Source of the factor 1000/1024: DMC-1400 command reference, TM and TIME.
    """

    def __init__(self, sample_time_us: float) -> None:
        sample = self._sample = 1e-6 * sample_time_us
        ticks = (MILLISECOND, MILLISECOND * OLD_SECOND, sample, sample * OLD_SECOND)
        self._candidates = {round(tick, 12) for tick in ticks}
        self._latest = -1
        self._bounds = (0.0, math.inf)
        self._anchor: tuple[int, float, float] | None = None  # quickest answer: ticks, when asked, when answered
        self._offset: float | None = None

    @property
    def tick_s(self) -> float | None:
        """Length of a tick, s, or None until it is determined."""
        low, high = self._bounds
        fit = [c for c in self._candidates if low * (1.0 - CRYSTAL) <= c <= high * (1.0 + CRYSTAL)]
        return fit[0] if len(fit) == 1 else None

    @property
    def sample_s(self) -> float:
        """Sample period of the servo, s. It is nominal until the tick is determined."""
        old = (MILLISECOND * OLD_SECOND, self._sample * OLD_SECOND)
        is_old = any(math.isclose(self.tick_s or 0.0, tick, rel_tol=1e-9) for tick in old)
        return self._sample * (OLD_SECOND if is_old else 1.0)

    def when(self, ticks: int, asked_s: float, answered_s: float) -> tuple[float, float]:
        """Return the time of a position on the host's clock and its largest error, s."""
        if ticks < self._latest:  # the card has restarted
            self._bounds, self._anchor, self._offset = (0.0, math.inf), None, None
        self._latest = ticks
        then, first, last = self._anchor or (ticks, asked_s, answered_s)
        if (count := ticks - then) > 0:
            low, high = self._bounds
            # the tick counter reads n from n ticks to n + 1 ticks
            self._bounds = (
                max(low, (asked_s - last) / (count + 1)),
                min(high, (answered_s - first) / max(count - 1, 0.5)),
            )
        if self._anchor is None or answered_s - asked_s < last - first:
            then, first, last = self._anchor = (ticks, asked_s, answered_s)
        tick = self.tick_s
        if tick is None:
            self._offset = None
            return 0.5 * (asked_s + answered_s), 0.5 * (answered_s - asked_s)
        if self._offset is None:
            self._offset = 0.5 * (first + last) - tick * then
        return self._offset + tick * (ticks + 0.5), 0.5 * tick


# ---- Common parts of rigs with a link: waiting for a state, checks for a closed or lost rig, and a stop before an error is raised.


def ask_until(ask: Callable[[], T], clock: Clock, within_s: float) -> T | None:
    """Ask a controller until the answer is true, and return that answer, or None on timeout (at least 1 s of host time)."""
    return clock.host.until(ask, max(within_s / clock.speed, 1.0), min(0.02, 0.05 / clock.speed))


class RigAxis(Protocol):
    """Interface to the axis of a controller, with the methods that leave it safe."""

    name: str  # address of the controller
    refused: str | None  # reason to refuse all commands
    broken: RigError | None  # first failure of the link (later failures may follow from it)

    def make_safe(self) -> bool:
        """Stop and switch the motor off. Return True if the controller confirms it."""

    def restore(self) -> bool:
        """Stop, and restore acceleration and motor state. Return True if the controller confirms it."""

    def let_go(self) -> None:
        """Close the link."""


class LinkedRig:
    """Base class of rigs with a link. Subclasses add the commands of their controller."""

    stopped = unconfirmed = ""  # state of the table after a failure, for messages
    _axis: RigAxis

    def __init__(self, axis: RigAxis, limits: Limits) -> None:
        self.limits, self._axis, self._closed = limits, axis, False

    def close(self, *, as_found: bool = False) -> None:
        """Stop, switch the motor off or restore its state, and close the link. A second call has no effect."""
        if self._closed:
            return
        self._closed, axis = True, self._axis
        try:
            if as_found and axis.refused is None:
                with self._safely():
                    confirmed = axis.restore()
            else:
                confirmed = axis.make_safe()
        finally:
            axis.let_go()
        if not confirmed:
            raise LinkError(f"{axis.name}: no answer when the motor was switched off at the end. {self.unconfirmed}")

    @contextmanager
    def _safely(self) -> Iterator[None]:
        """Stop and switch the motor off before an error of the link is raised."""
        axis = self._axis
        try:
            yield
        except (LinkError, RigTimeout) as error:
            first = axis.broken or error
            outcome = self.stopped if axis.make_safe() else self.unconfirmed
            axis.broken = None
            raise type(first)(f"{first} {outcome}", **first.numbers) from error

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise LinkError if the rig is closed or lost. If the link fails within the block, stop the axis."""
        reason = "it is closed" if self._closed else self._axis.refused
        if reason:
            raise LinkError(f"{self._axis.name}: the rig accepts no commands ({reason}). Open it again.")
        with self._safely():
            yield
