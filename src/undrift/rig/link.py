"""Link: questions and answers with a rig or device, each with a deadline.

One thread reads (rig/link.py); everything else happens in the caller. Bytes that nobody asked for are kept aside: those that come
between two exchanges, and, where the device marks them, those whose high bit is set (Galil CW1). After an answer that did not come
in time the link is out of step - the answer may still come, and would be taken for the next one - so it refuses to go on until
`resynchronise`.

Transport: bytes to and from a rig or device, over TCP or over a serial port.

A place is written as a URL: ``tcp://host:port``; ``serial:///dev/ttyUSB0`` or a bare path (a pty too); and what pyserial itself
understands: ``socket://host:port``, ``loop://``. Nothing here waits longer than its deadline.

Receiver: one thread that reads a transport, and a caller that waits for whole replies with a deadline.

Bytes that nobody asked for are kept aside: those the caller sets aside before a question, and, where the device marks them, those
whose high bit is set.

The clock a rig is driven by: the host's monotonic seconds, or an emulator's, which may run faster.

t = speed * (host monotonic time). A motion that takes 6 s on the table takes 6 / speed seconds of waiting here.

Ports to a Galil card: what carries a command there and its answer back.

A command ends with a carriage return; the answer is ``:``, or text and ``:``, or ``?``. LinkPort speaks that over a Link;
galil_gclib.py has the maker's library do it.

The maker's library as the way to a Galil card, for those who have it (USB, PCI, UDP).

gclib is the vendor's, is not on any package index and is not needed: LinkPort speaks to TCP and serial cards without it.
"""

import contextlib
import logging
import math
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol
from urllib.parse import urlsplit

from undrift.errors import InputError, LinkError, RigError, RigTimeout
from undrift.rig.rig import Position

# ---- Transport: bytes to and from a rig or device, over TCP or over a serial port.

POLL_S = 0.05  # how long one read may wait; closing takes at most this long


class Transport(Protocol):
    """An open way for bytes."""

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came for a moment; OSError or EOFError when the way is gone."""

    def write(self, data: bytes) -> None:
        """Send all of it or raise OSError."""

    def wake(self) -> None:
        """Let a `read` that waits in another thread return soon, before `close`."""

    def close(self) -> None:
        """Let go of it; harmless when called again."""


class TcpTransport:
    """Bytes over a TCP socket."""

    def __init__(self, host: str, port: int, connect_timeout_s: float) -> None:
        self._socket = socket.create_connection((host, port), timeout=connect_timeout_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(1.0)

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came within a second."""
        try:
            data = self._socket.recv(65536)
        except TimeoutError:
            return b""
        if not data:
            raise EOFError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of it."""
        self._socket.sendall(data)

    def wake(self) -> None:
        """End the conversation, so that a read returns at once."""
        with contextlib.suppress(OSError):  # the other side was first
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


class SerialTransport:
    """Bytes over whatever pyserial opens: a port, a pty, ``socket://`` or ``loop://``."""

    def __init__(self, url: str, baud: int, hardware_handshake: bool) -> None:
        try:
            import serial
        except ImportError as error:
            raise LinkError("serial port: wanted the package pyserial, got none; pip install undrift[live]") from error
        self._port = serial.serial_for_url(
            url, baudrate=baud, timeout=POLL_S, write_timeout=1.0, rtscts=hardware_handshake
        )

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came for a moment."""
        first: bytes = self._port.read(1)
        waiting = self._port.in_waiting if first else 0
        return first + bytes(self._port.read(waiting)) if waiting else first

    def write(self, data: bytes) -> None:
        """Send all of it."""
        self._port.write(data)

    def wake(self) -> None:
        """Nothing to do: a read waits a moment only."""

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()


def open_transport(
    url: str, *, baud: int = 19200, hardware_handshake: bool = False, connect_timeout_s: float = 5.0
) -> Transport:
    """Open a way for bytes."""
    place = _parse(url)
    try:
        if isinstance(place, str):
            return SerialTransport(place, baud, hardware_handshake)
        return TcpTransport(*place, connect_timeout_s)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        reason = str(error) or type(error).__name__
        raise LinkError(f"{url}: wanted a connection, got '{reason}'; check power, cable and address") from error


def _parse(url: str) -> tuple[str, int] | str:
    """Return (host, port) of a TCP address, or the name that pyserial takes."""
    wanted = "wanted tcp://host:port, serial:///path, a path, socket://host:port or loop://"
    if url.startswith("tcp://"):
        parts = urlsplit(url)
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port or parts.path not in ("", "/"):
            raise InputError(f"link: {wanted}, got '{url}'; name host and port")
        return host, port
    if url.startswith("serial://"):
        url = url.removeprefix("serial://")
    elif not url.startswith(("socket://", "loop://", "/", "COM")):
        raise InputError(f"link: {wanted}, got '{url}'; say how the rig is connected")
    if not url:
        raise InputError(f"link: {wanted}, got no name of a port; write serial:///dev/ttyUSB0")
    return url


# ---- Receiver: one thread that reads a transport, and a caller that waits for whole replies with a deadline.

ReplyEnd = Callable[[bytes], int]
LONGEST_REPLY = 65536  # bytes without an end: no device of ours says so much

log = logging.getLogger(__name__)


def line_end(received: bytes) -> int:
    """Return where a reply of one line ends."""
    return received.find(b"\n") + 1


class Receiver:
    """What comes from one transport, from birth until `stop`."""

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
        """Wait for a whole reply and take it out."""
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
        """Return what came without being asked for, once."""
        with self._change:
            text = bytes(byte & 0x7F for byte in self._aside).decode("ascii")
            self._aside.clear()
        return text

    def lose(self, reason: str) -> None:
        """Note that the connection is gone, and wake whoever waits."""
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


# ---- The clock a rig is driven by: the host's monotonic seconds, or an emulator's, which may run faster.


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Seconds of the table."""

    speed: float = 1.0  # Table seconds per host second: 1 for hardware; what the emulator was started with otherwise

    def __post_init__(self) -> None:
        if not 0.0 < self.speed < 1e6:
            raise InputError(f"clock: wanted a speed above 0, got {self.speed:g}; hardware runs at 1")

    def now(self) -> float:
        """Return the time, s."""
        return self.speed * time.monotonic()

    def wait(self, duration_s: float) -> None:
        """Wait."""
        if duration_s > 0.0:
            time.sleep(duration_s / self.speed)

    def mean_turn_rate(self, position: Callable[[], Position], duration_s: float) -> float:
        """Return the mean rate over a while, from two positions."""
        if not (math.isfinite(duration_s) and duration_s > 0.0):
            raise InputError(f"measured rate: wanted a duration above 0 s, got {duration_s}; give seconds")
        first = position()
        self.wait(duration_s)
        last = position()
        return (last.angle - first.angle) / (last.time - first.time)


# ---- A card's own clock: when a position was taken, free of the delays of the link.

MILLISECOND = 1e-3
OLD_SECOND = 1000.0 / 1024.0  # a card's second that is divided by 1024
CRYSTAL = 2e-4  # how far the clocks of card and host may differ by themselves, 1


class CardClock:
    """When positions were taken, by the card's ticks.

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
        tick = self.tick_s
        old = tick is not None and any(
            math.isclose(tick, t * OLD_SECOND, rel_tol=1e-9) for t in (MILLISECOND, self._sample)
        )
        return self._sample * (OLD_SECOND if old else 1.0)

    def when(self, ticks: int, asked: float, answered: float) -> tuple[float, float]:
        """Return when an answer was true."""
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


# ---- link


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSettings:
    """How to talk."""

    terminator: str = "\n"  # Ends every question
    reply_end: ReplyEnd = line_end  # Tells where a reply ends in what has come; 0 while it is not whole
    reply_timeout_s: float = 2.0  # Longest wait for a reply, s, unless an exchange says otherwise
    connect_timeout_s: float = 5.0  # Longest wait for a connection, s
    baud: int = 19200  # Bits per second of a serial port
    hardware_handshake: bool = False  # RTS/CTS of a serial port

    def __post_init__(self) -> None:
        for name in ("reply_timeout_s", "connect_timeout_s", "baud"):
            if not getattr(self, name) > 0:
                raise InputError(f"link: wanted {name} above 0, got {getattr(self, name)}; every wait has an end")


class Link:
    """A connection that is open from birth until `close`."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self.url = url
        self.settings = settings
        self._one_at_a_time = threading.RLock()
        self._in_step = True
        self._transport, self._receiver = self._connect()

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known here."""
        return self._receiver.lost is None

    def mask_high_bit(self) -> None:
        """Keep bytes whose high bit is set out of the replies from now on, until the link is opened again."""
        self._receiver.high_bit_is_unsolicited = True

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
                    f"{self.url}: wanted an answer to '{text}', got a link out of step with its device; resynchronise first"
                )
            return self._decoded(self._ask(text, deadline_s, until, terminator), text)

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer."""
        lost = self._receiver.lost
        if lost is not None:
            raise LinkError(f"{self.url}: wanted an open link, got one lost: {lost}; reconnect")
        try:
            self._transport.write(data)
        except OSError as error:
            self._receiver.lose(str(error) or type(error).__name__)
            raise LinkError(f"{self.url}: wanted to send, got '{error}'; check the cable, reconnect") from error

    def read(self, deadline_s: float | None = None, *, until: ReplyEnd | None = None) -> str:
        """Return the next line that comes by itself."""
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        with self._one_at_a_time:
            return self._decoded(self._receiver.take(until or self.settings.reply_end, wait_s, ""), "")

    def unsolicited(self) -> str:
        """Return what came without being asked for since the last time."""
        return self._receiver.unsolicited()

    def resynchronise(
        self, text: str, until: ReplyEnd, deadline_s: float | None = None, *, terminator: str | None = None
    ) -> str:
        """Ask something that only one answer fits, and throw away all before it."""
        with self._one_at_a_time:
            return self._ask(text, deadline_s, until, terminator).decode("ascii", errors="backslashreplace")

    def reconnect(self) -> None:
        """Close and open again, with nothing left over from before."""
        with self._one_at_a_time:
            self.close()
            self._transport, self._receiver = self._connect()
            self._in_step = True

    def close(self) -> None:
        """Let go of the connection and end the reading thread; harmless when called again."""
        self._receiver.stop()
        self._transport.close()

    def _ask(self, text: str, deadline_s: float | None, until: ReplyEnd | None, terminator: str | None) -> bytes:
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        end = self.settings.terminator if terminator is None else terminator
        self._receiver.set_aside()
        self._in_step = False  # and stays so when anything, Ctrl-C included, keeps the answer from being read
        self.send((text + end).encode("latin-1"))
        reply = self._receiver.take(until or self.settings.reply_end, wait_s, text)
        self._in_step = True
        return reply

    def _decoded(self, reply: bytes, question: str) -> str:
        try:
            return reply.decode("ascii")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.url}: wanted text in answer to '{question}', got {reply[:80]!r}; check baud and cable"
            ) from error

    def _connect(self) -> tuple[Transport, Receiver]:
        transport = open_transport(
            self.url,
            baud=self.settings.baud,
            hardware_handshake=self.settings.hardware_handshake,
            connect_timeout_s=self.settings.connect_timeout_s,
        )
        return transport, Receiver(transport, self.url)


# ---- Ports to a Galil card: what carries a command there and its answer back.

PROMPT = re.compile(rb"(?:^|\n)[:?]")


def reply_end(received: bytes) -> int:
    """Return where a card's answer ends: at a prompt that opens a line."""
    found = PROMPT.search(received)
    return found.end() if found else 0


class GalilPort(Protocol):
    """What carries commands to a card."""

    @property
    def name(self) -> str:
        """Where the card is, for messages."""

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Return the text of the answer ("" for a bare ``:``), None when the card refused."""

    def shout(self, command: str) -> None:
        """Send without waiting for an answer; nothing is raised."""

    def resynchronise(self) -> None:
        """Make sure that the next answer is the next command's."""

    def mask_unsolicited(self) -> None:
        """Keep characters with the high bit set out of the answers from now on."""

    def unsolicited(self) -> str:
        """Return unsolicited messages of the card, once."""

    @property
    def is_open(self) -> bool:
        """Whether the connection stands."""

    def reconnect(self) -> None:
        """Close and open again."""

    def close(self) -> None:
        """Let go of the connection; harmless when called again."""


class LinkPort:
    """A card on TCP or a serial port."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self._link = Link(
            url,
            LinkSettings(
                terminator="\r",
                reply_end=reply_end,
                reply_timeout_s=settings.reply_timeout_s,
                connect_timeout_s=settings.connect_timeout_s,
                baud=settings.baud,
                hardware_handshake=settings.hardware_handshake,
            ),
        )
        self._token = 41_000

    @property
    def name(self) -> str:
        """The link's URL."""
        return self._link.url

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known here."""
        return self._link.is_open

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Send a command and return the text of its answer."""
        reply = self._link.exchange(command, deadline_s)
        if reply == "?":
            return None
        if not reply.endswith(":") or "?" in reply:
            raise LinkError(f"{self.name}: wanted an answer to '{command}', got {reply!r}; check cable and baud")
        return reply[:-1]

    def shout(self, command: str) -> None:
        """Send without waiting for an answer; a lost link is left to whoever asks next."""
        try:
            self._link.send(f"{command}\r".encode("ascii"))
        except RigError:
            return

    def resynchronise(self) -> None:
        """Ask the card to say a number that it was never asked for before, and throw away all before it."""
        for attempt in range(3):
            self._token += 1
            try:
                self._link.resynchronise(f"MG {self._token}", _end_of(self._token))
            except RigTimeout:
                if attempt == 2:
                    raise
            else:
                return

    def mask_unsolicited(self) -> None:
        """Keep characters with the high bit set out of the answers from now on."""
        self._link.mask_high_bit()

    def unsolicited(self) -> str:
        """Return unsolicited messages of the card, once."""
        return self._link.unsolicited()

    def reconnect(self) -> None:
        """Close and open again."""
        self._link.reconnect()

    def close(self) -> None:
        """Let go of the link; harmless when called again."""
        self._link.close()


def _end_of(token: int) -> ReplyEnd:
    """Return what finds the end of an answer that is this number; leading zeros and decimals are the card's to choose."""
    text = re.compile(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % token)

    def end(received: bytes) -> int:
        found = text.search(received)
        return found.end() if found else 0

    return end


# ---- The maker's library as the way to a Galil card, for those who have it (USB, PCI, UDP).


class GclibPort:
    """A card behind gclib."""

    def __init__(self, address: str, reply_timeout_s: float = 2.0, library: Any = None) -> None:
        if library is None:
            try:
                import gclib
            except (ImportError, OSError) as error:  # OSError: the wrapper is there, its shared library is not
                raise LinkError(
                    "galil over gclib: wanted the maker's library, got none; install gclib, or write galil:tcp://host:port"
                ) from error
            library = gclib.py()
        self._library = library
        self._address = address
        self._timeout_ms = round(1000.0 * reply_timeout_s)
        self._one_at_a_time = threading.RLock()
        self._open = False
        self._connect()

    @property
    def name(self) -> str:
        """The address given to gclib."""
        return f"gclib {self._address}"

    @property
    def is_open(self) -> bool:
        """Whether GOpen succeeded and nothing was closed since."""
        return self._open

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Send a command and return the text of its answer."""
        with self._one_at_a_time:
            if not self._open:
                raise LinkError(f"{self.name}: wanted an open link, got a closed one; reconnect")
            self._library.GTimeout(self._timeout_ms if deadline_s is None else round(1000.0 * deadline_s))
            try:
                return str(self._library.GCommand(command))
            except Exception as error:
                if "question mark" in str(error).lower():
                    return None
                raise self._explained(command, error) from error

    def shout(self, command: str) -> None:
        """Send and do not care for the answer."""
        try:
            self.ask(command, 0.2)
        except (LinkError, RigTimeout):
            return

    def resynchronise(self) -> None:
        """Ask for a number until the answer is that number."""
        for token in (41_001, 41_002, 41_003):
            answer = (self.ask(f"MG {token}") or "").strip().lstrip("0")
            if answer.split(".")[0] == str(token):
                return
        raise LinkError(f"{self.name}: wanted answers in step with their commands, got others; reconnect")

    def mask_unsolicited(self) -> None:
        """Nothing to do: gclib keeps unsolicited text apart."""

    def unsolicited(self) -> str:
        """Return "": gclib gives unsolicited text to whoever subscribed to it."""
        return ""

    def reconnect(self) -> None:
        """Close and open again."""
        self.close()
        self._connect()

    def close(self) -> None:
        """Let go of the card; harmless when called again."""
        if self._open:
            self._open = False
            try:
                self._library.GClose()
            except Exception:  # noqa: BLE001 - it is gone either way
                return

    def _connect(self) -> None:
        try:
            self._library.GOpen(self._address)
        except Exception as error:
            raise LinkError(
                f"{self.name}: wanted a connection, got '{error}'; check power, cable and address"
            ) from error
        self._open = True

    def _explained(self, command: str, error: Exception) -> LinkError | RigTimeout:
        text = str(error).lower()
        if "timed out" in text or "timeout" in text:
            return RigTimeout(f"{self.name}: wanted an answer to '{command}', got '{error}'; check power and cable")
        return LinkError(f"{self.name}: wanted an answer to '{command}', got '{error}'; reconnect")
