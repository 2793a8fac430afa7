"""Links to rigs: questions and answers with a deadline each, over TCP or a serial port.

Who asks also reads. Bytes that nobody asked for are kept aside: those that come between two exchanges, and, where the device marks
them, those whose high bit is set (Galil CW1). After an answer that did not come in time the link is out of step - the answer may
still come, and would be taken for the next one - so it refuses to go on until `ask_anew`.

A place is a URL: ``tcp://host:port``; ``serial:///dev/ttyUSB0`` or a bare path (a pty too); and what pyserial itself understands:
``socket://host:port``, ``loop://``.
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
ReplyEnd = Callable[[bytes], int]  # where a reply ends in what has come; 0 while it is not whole
LONGEST_REPLY = 65536  # bytes, longest reply that is accepted
CLOSE_S = 5.0  # s, how long close() waits for a pending exchange to fail

log = logging.getLogger(__name__)


def end_of(pattern: bytes) -> ReplyEnd:
    """Return what finds the end of a reply: where a pattern ends."""
    text = re.compile(pattern)

    def end(received: bytes) -> int:
        found = text.search(received)
        return found.end() if found else 0

    return end


line_end = end_of(rb"\n")
reply_end = end_of(rb"(?:^|\n)[:?]")  # of a Galil card: a prompt that opens a line


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSettings:
    """How to talk."""

    terminator: str = "\n"  # Ends every question
    reply_end: ReplyEnd = line_end
    reply_timeout_s: float = 2.0  # Longest wait for a reply, s, unless an exchange says otherwise
    connect_timeout_s: float = 5.0  # Longest wait for a connection, s
    baud: int = 19200  # Bits per second of a serial port
    hardware_handshake: bool = False  # RTS/CTS of a serial port
    clock: Clock = HOST  # By which it waits

    def __post_init__(self) -> None:
        check_positive(self, "link", "every wait has an end", "reply_timeout_s", "connect_timeout_s", "baud")


def link_settings(settings: RigSettings, baud: int = 19200) -> LinkSettings:
    """Return how to talk to a rig with a usual baud rate."""
    return LinkSettings(
        reply_timeout_s=settings.reply_timeout_s,
        baud=settings.baud or baud,
        hardware_handshake=settings.hardware_handshake,
        clock=settings.timing.host,
    )


def open_port(url: str, settings: LinkSettings) -> Port:
    """Open a way for bytes."""
    wanted = "wanted tcp://host:port, serial:///path, a path, socket://host:port or loop://"
    host, port = host_and_port(url.removeprefix("tcp:")) if url.startswith("tcp://") else ("", 0)
    if url.startswith("tcp://") and not (host and port):
        raise InputError(f"link: {wanted}, got '{url}'; name host and port")
    if not url.startswith(("tcp://", "serial://", "socket://", "loop://", "/", "COM")):
        raise InputError(f"link: {wanted}, got '{url}'; say how the rig is connected")
    if url == "serial://":
        raise InputError(f"link: {wanted}, got no name of a port; write serial:///dev/ttyUSB0")
    try:
        if not host:
            return SerialPort(url.removeprefix("serial://"), settings.baud, settings.hardware_handshake)
        return tcp_port(host, port, settings.connect_timeout_s, settings.clock)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        got = reason_of(error)
        raise LinkError(f"{url}: wanted a connection, got '{got}'; check power, cable and address") from error


class Link(AbstractContextManager["Link"]):
    """A connection that is open from birth until `close`; whoever asks reads."""

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
        """Whether the connection stands, as far as is known here."""
        if self._one_at_a_time.acquire(blocking=False):  # else somebody waits for an answer, and sees it too
            try:
                self._listen(0.0)
            finally:
                self._one_at_a_time.release()
        return self._lost is None

    def mask_unsolicited(self) -> None:
        """Keep bytes whose high bit is set out of the replies from now on, until the link is opened again."""
        self._high_bit_is_unsolicited = True

    def exchange(
        self,
        text: str,
        deadline_s: float | None = None,
        *,
        until: ReplyEnd | None = None,
        terminator: str | None = None,
    ) -> str:
        """Ask and return the answer."""
        with self._one_at_a_time:
            if not self._in_step:
                raise LinkError(
                    f"{self.name}: wanted an answer to '{text}', got a link out of step with its device; resynchronise first"
                )
            reply = self._ask(text, deadline_s, until, terminator)
        try:
            return reply.decode("ascii")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.name}: wanted text in answer to '{text}', got {reply[:80]!r}; check baud and cable"
            ) from error

    def ask_anew(
        self, text: str, until: ReplyEnd, deadline_s: float | None = None, *, terminator: str | None = None
    ) -> str:
        """Ask something that only one answer fits, and throw away all before it: the link is in step again."""
        with self._one_at_a_time:
            return self._ask(text, deadline_s, until, terminator).decode("ascii", errors="backslashreplace")

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer."""
        if self._lost is not None:
            raise LinkError(f"{self.name}: wanted an open link, got one lost: {self._lost}; reconnect")
        try:
            self._port.write(data)
        except OSError as error:
            self._lose(reason_of(error))
            raise LinkError(f"{self.name}: wanted to send, got '{error}'; check the cable, reconnect") from error

    def unsolicited(self) -> str:
        """Return what came without being asked for since the last time."""
        with self._one_at_a_time:
            text = bytes(byte & 0x7F for byte in self._aside).decode("ascii")
            self._aside.clear()
        return text

    def reconnect(self) -> None:
        """Close and open again, with nothing left over from before."""
        with self._one_at_a_time:
            self.close()
            self._connect()

    def close(self) -> None:
        """Close the connection; a pending exchange raises LinkError. Harmless when called again."""
        self._lose("closed")
        self._port.wake()
        alone = self._one_at_a_time.acquire(timeout=CLOSE_S)
        try:
            self._port.close()
        finally:
            if alone:
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
        """Take in what comes within a while; return whether anything did."""
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
        self._in_step = False  # and stays so when anything, Ctrl-C included, keeps the answer from being read
        while self._listen(0.0) and len(self._received) < LONGEST_REPLY:
            pass
        self._aside.extend(self._received)  # nobody asked for it
        self._received.clear()
        self.send((text + end).encode("latin-1"))
        reply = self._take(until or self.settings.reply_end, wait_s, text)
        self._in_step = True
        return reply

    def _take(self, reply_end: ReplyEnd, wait_s: float, question: str) -> bytes:
        """Wait for a whole reply and take it out."""
        clock, wanted = self.settings.clock, f"an answer to '{question}'"
        last = clock.now() + wait_s
        while not (length := reply_end(bytes(self._received))):
            came, left_s = bytes(self._received[:80]), last - clock.now()
            if len(self._received) > LONGEST_REPLY:
                wanted = f"an end of the answer to '{question}'"
                raise LinkError(f"{self.name}: wanted {wanted}, got {came!r} and more; check baud")
            if self._lost is not None:
                raise LinkError(f"{self.name}: wanted {wanted}, got a lost link: {self._lost}; reconnect")
            if left_s <= 0.0:
                got = f"only {came!r}" if came else "nothing"
                raise RigTimeout(
                    f"{self.name}: wanted {wanted} within {wait_s:g} s, got {got}; check power and cable",
                    deadline_s=wait_s,
                )
            self._listen(min(left_s, POLL_S))
        reply = bytes(self._received[:length])
        del self._received[:length]
        return reply


# ---- Ports to a Galil card. A command ends with a carriage return; the answer is ``:``, or text and ``:``, or ``?``.


class LinkPort(Link):
    """A card on TCP or a serial port."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self._token = 41_000
        super().__init__(url, replace(settings, terminator="\r", reply_end=reply_end))

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Return the text of the answer ("" for a bare ``:``), None when the card refused."""
        reply = self.exchange(command, deadline_s)
        if reply == "?":
            return None
        if not reply.endswith(":") or "?" in reply:
            raise LinkError(f"{self.name}: wanted an answer to '{command}', got {reply!r}; check cable and baud")
        return reply[:-1]

    def shout(self, command: str) -> None:
        """Send without waiting for an answer; a lost link is left to whoever asks next."""
        with contextlib.suppress(RigError):
            self.send(f"{command}\r".encode("ascii"))

    def resynchronise(self) -> None:
        """Ask the card to say a number that it was never asked for before, and throw away all before it."""
        for attempt in range(3):
            self._token += 1
            try:  # leading zeros and decimals are the card's to choose
                self.ask_anew(f"MG {self._token}", end_of(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % self._token))
            except RigTimeout:
                if attempt == 2:
                    raise
            else:
                self.unsolicited()  # prompts of shouted commands that came before the number was asked for
                return


# ---- A card's own clock.

MILLISECOND = 1e-3
OLD_SECOND = 1000.0 / 1024.0  # a card's second that is divided by 1024
CRYSTAL = 2e-4  # how far the clocks of card and host may differ by themselves, 1


class CardClock:
    """When positions were taken, by the card's ticks, free of the delays of the link.

    TIME grows by a tick a sample, or a nominal millisecond, and old cards count milliseconds of 1/1024 s: the tick is 1 ms,
    1000/1024 ms, TM or TM 1000/1024. The host's clock shows which: two answers, n0 ticks asked at a0 and answered at b0, n ticks at
    a and b, bound it,

        (a - b0) / (n - n0) <= tick <= (b - a0) / (n - n0)

    and as soon as one candidate alone is left, the time of a position is offset + tick (n + 1/2), known to half a tick. Before
    that, and when none fits (a wrong clock_speed, a card that counts otherwise), it is the middle between question and answer.
    Only differences of these times count: over hours the crystals of card and host part by milliseconds.
    Source of the 2.4 %: DMC-1400 command reference, TM and TIME.
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
        """Length of a tick, s; None while it is not known."""
        low, high = self._bounds
        fit = [c for c in self._candidates if low * (1.0 - CRYSTAL) <= c <= high * (1.0 + CRYSTAL)]
        return fit[0] if len(fit) == 1 else None

    @property
    def sample_s(self) -> float:
        """Time between two samples of the servo, s; nominal while the tick is not known."""
        old = (MILLISECOND * OLD_SECOND, self._sample * OLD_SECOND)
        is_old = any(math.isclose(self.tick_s or 0.0, tick, rel_tol=1e-9) for tick in old)
        return self._sample * (OLD_SECOND if is_old else 1.0)

    def when(self, ticks: int, asked: float, answered: float) -> tuple[float, float]:
        """Return when an answer was true, and by how much that may be off."""
        if ticks < self._latest:  # the card was restarted
            self._bounds, self._anchor, self._offset = (0.0, math.inf), None, None
        self._latest = ticks
        then, first, last = self._anchor or (ticks, asked, answered)
        if (count := ticks - then) > 0:
            low, high = self._bounds
            # a reading of n ticks is a time of n to n + 1 of them
            self._bounds = (max(low, (asked - last) / (count + 1)), min(high, (answered - first) / max(count - 1, 0.5)))
        if self._anchor is None or answered - asked < last - first:
            then, first, last = self._anchor = (ticks, asked, answered)
        tick = self.tick_s
        if tick is None:
            self._offset = None
            return 0.5 * (asked + answered), 0.5 * (answered - asked)
        if self._offset is None:
            self._offset = 0.5 * (first + last) - tick * then
        return self._offset + tick * (ticks + 0.5), 0.5 * tick


# ---- What rigs behind a link share: waiting for a state, commands refused once they are closed or lost, rest before a failure is
# reported.


def ask_until(ask: Callable[[], T], clock: Clock, within_s: float) -> T | None:
    """Ask a controller until the answer is true, and return it; None where it is not in time, a second of the host at least."""
    return clock.host.until(ask, max(within_s / clock.speed, 1.0), min(0.02, 0.05 / clock.speed))


class RigAxis(Protocol):
    """The axis of a controller, as far as its rig must know it to leave it safe."""

    name: str  # Where it is connected
    refused: str | None  # Why nothing more may be done with it
    broken: RigError | None  # How its link first failed, where other failures may only follow from that

    def make_safe(self) -> bool:
        """Stop and switch the motor off; return whether that is confirmed."""

    def restore(self) -> bool:
        """Come to rest, with acceleration and motor as they were found; return whether they are."""

    def let_go(self) -> None:
        """Close the link."""


class LinkedRig:
    """A rig behind a link, closed once; its controller's own commands are in the classes below it."""

    stopped = unconfirmed = ""  # what a failure says of the table, in words
    _axis: RigAxis

    def __init__(self, axis: RigAxis, limits: Limits) -> None:
        self.limits, self._axis, self._closed = limits, axis, False

    def close(self, *, as_found: bool = False) -> None:
        """Stop, switch the motor off or leave it as it was, let go of the link; harmless when called again."""
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
            raise LinkError(f"{axis.name}: wanted the motor off at the end, got no answer; {self.unconfirmed}")

    @contextmanager
    def _safely(self) -> Iterator[None]:
        """Stop and switch off before the failure of a link is reported."""
        axis = self._axis
        try:
            yield
        except (LinkError, RigTimeout) as error:
            first = axis.broken or error
            outcome = self.stopped if axis.make_safe() else self.unconfirmed
            axis.broken = None
            raise type(first)(f"{first}; {outcome}", **first.numbers) from error

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Refuse a rig that is closed or lost; else have it stopped where its link fails."""
        why = "it is closed" if self._closed else self._axis.refused
        if why:
            raise LinkError(f"{self._axis.name}: wanted a rig ready for commands, got none: {why}; open it again")
        with self._safely():
            yield
