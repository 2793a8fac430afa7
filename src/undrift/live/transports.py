"""Sources: where readings come from, by address: ``kind:place?option=value&option=value``.

    tcp://host:port        udp://:port        serial:///dev/ttyUSB0?baud=115200        lsl:name

The options are the fields of a StreamDescription, and ``description=FILE`` for a TOML file of them. A device on TCP listens; one on
UDP sends to this computer's port; each datagram is whole. LSL has time stamps of its own. A new
kind is a function from an Address to a Source, and a row in SOURCES; or a package with an entry point in "undrift.sources".
"""

import contextlib
import importlib
import os
import socket
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock, Port
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.decoder import COUNTER, Chunk, StreamDescription, decoder_for, described, finite, read_description
from undrift.plugins import Options, load_named, split_address

POLL_S = 0.05
WRITE_S = 1.0
CONNECT_S = 5.0
LARGEST = 1 << 16
BAUD = 115_200
BUFFER_BYTES = 1 << 22  # what the system keeps of datagrams while nobody looks
RESOLVE_S = 5.0
SCAN_S = 3.0  # for devices and streams that are listed
QUIET = "[log]\nlevel = -2\n"
# USB vendors of microcontroller boards, and of the chips by which they or a card of a rate table are connected
BOARDS = {0x0403, 0x0483, 0x067B, 0x10C4, 0x16C0, 0x1915, 0x1A86, 0x2341, 0x239A, 0x2886, 0x2A03, 0x2E8A, 0x303A}
LSL_FOLDERS = (".", "~/lsl_api", "/etc/lsl_api")  # of lsl_api.cfg, which a person wrote
OFFLINE = "[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n"
SOURCES = {  # kind -> the function that makes a source of an address
    **{kind: f"undrift.live.transports:{kind}_source" for kind in ("tcp", "udp", "serial", "lsl")},
    "simulated": "undrift.live.hands:source_of",
}
GROUP = "undrift.sources"


class Source(Protocol):
    """A device that sends by itself."""

    name: str  # What to call it in a message
    description: StreamDescription  # What it sends
    errors: int  # Garbled readings that were left out so far

    def open(self) -> None:
        """Connect; raise LinkError if nothing answers."""

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come, one reading or more."""

    def close(self) -> None:
        """Close it; harmless when called again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """An address taken apart."""

    kind: str  # A row of SOURCES
    place: str  # What stands between the colon and the question mark
    options: Options = ()  # What stands behind it
    description: StreamDescription | None = None  # What the options change
    clock: Clock = HOST  # By which its source waits, and says when readings came

    def option(self, name: str, default: str) -> str:
        """Return an option that belongs to the kind of source."""
        return dict(self.options).get(name, default)

    def describe(self, *own: str) -> StreamDescription:
        """Return what is sent, by the file and the options."""
        file = self.option("description", "")
        base = read_description(file) if file else self.description
        return described(base, tuple(pair for pair in self.options if pair[0] not in (*own, "description")))


def source_at(text: str, description: StreamDescription | None = None, clock: Clock = HOST) -> Source:
    """Return the source of an address, not opened yet."""
    kind, place, options = split_address(text, "device", SOURCES, GROUP, "name how it is connected")
    address = Address(kind=kind, place=place, options=options, description=description, clock=clock)
    source: Source = load_named(kind, SOURCES, GROUP)(address)
    return source


# ---- Ports: ways for bytes. A read returns b"" when nothing came in time, and raises OSError or EOFError when the way is gone.


class SocketPort:
    """Bytes over a socket."""

    def __init__(self, connection: socket.socket, datagrams: bool = False) -> None:
        self.datagrams, self._socket = datagrams, connection

    def receive(self, wait_s: float) -> bytes:
        """Return what has come."""
        self._socket.settimeout(max(wait_s, 0.0))
        try:
            data = self._socket.recv(LARGEST)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data and not self.datagrams:
            raise EOFError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of it or raise OSError."""
        self._socket.settimeout(WRITE_S)
        self._socket.sendall(data)

    def wake(self) -> None:
        """End the conversation, so that a read that waits in another thread returns at once."""
        with contextlib.suppress(OSError):  # the peer has already closed
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def tcp_port(host: str, port: int, longest_s: float, clock: Clock = HOST) -> Port:
    """Connect over TCP. With a virtual clock, connect to the simulated server on that clock."""
    if (way := clock.connection(host, port)) is not None:
        return way
    connection = socket.create_connection((host, port), timeout=longest_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SocketPort(connection)


class SerialPort:
    """Bytes over whatever pyserial opens: a port, a pty, ``socket://`` or ``loop://``."""

    datagrams = False

    def __init__(self, place: str, baud: int, hardware_handshake: bool = False) -> None:
        serial, self.baud = package_of("serial", "pyserial", "serial port"), baud
        self._port = serial.serial_for_url(place, baudrate=baud, write_timeout=WRITE_S, rtscts=hardware_handshake)

    def receive(self, wait_s: float) -> bytes:
        """Return what has come."""
        if wait_s <= 0.0:
            return bytes(self._port.read(self._port.in_waiting)) if self._port.in_waiting else b""
        if self._port.timeout != wait_s:
            self._port.timeout = wait_s
        first: bytes = self._port.read(1)
        waiting = self._port.in_waiting if first else 0
        return first + bytes(self._port.read(waiting)) if waiting else first

    def set_baud(self, baud: int) -> None:
        """Read at another rate from now on, without what came before."""
        self._port.baudrate = self.baud = baud
        self._port.reset_input_buffer()

    def write(self, data: bytes) -> None:
        """Send all of it or raise OSError."""
        self._port.write(data)

    def wake(self) -> None:
        """Nothing to do: a read waits a moment only."""

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def reason_of(error: Exception) -> str:
    """Return an error in words, whatever it is."""
    return str(error) or type(error).__name__


def number_of(text: str) -> float:
    """Return the number that a text states, NaN where it states none."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def host_and_port(place: str) -> tuple[str, int]:
    """Return host and port of ``//host:port``; "" and 0 where they are missing."""
    parts = urlsplit(place)
    try:
        port = parts.port or 0
    except ValueError:
        port = 0
    return parts.hostname or "", port if parts.path in ("", "/") else 0


def serial_ports() -> list[tuple[str, str]]:
    """Return the serial ports of this computer, and what is behind each; boards first, then all others of USB."""
    ports = package_of("serial.tools.list_ports", "pyserial", "serial port").comports()
    found = sorted(ports, key=lambda port: (port.vid is None, port.vid not in BOARDS, port.device))
    return [(port.device, port.description if port.vid is not None else "built in") for port in found]


def lsl_streams() -> list[tuple[str, str]]:
    """Return the LSL streams in the network by their names, and what they hold."""
    if not any(Path(folder, "lsl_api.cfg").expanduser().exists() for folder in LSL_FOLDERS):
        configure_lsl(QUIET)
    pylsl = package_of("pylsl", "pylsl", "LSL")
    streams = ((one, one.nominal_srate()) for one in pylsl.resolve_streams(SCAN_S))
    return [(one.name(), f"{one.type()}, {one.channel_count()} channels, {rate:g} Hz") for one, rate in streams]


def package_of(module: str, package: str, who: str, extra: str = "live") -> Any:
    """Import an optional package, or say what to install."""
    try:
        return importlib.import_module(module)
    except (ImportError, RuntimeError) as error:  # pylsl: the second where the library beneath it is missing
        raise LinkError(f"{who}: wanted the package {package}, got none; pip install undrift[{extra}]") from error


# ---- Sources: a way that is opened, and read until it has brought a reading.


class ByteSource:
    """A device whose bytes come through a port."""

    way = "link"
    ending = "close"  # what its port calls that

    def __init__(
        self, name: str, description: StreamDescription, connect: Callable[[], Any], clock: Clock = HOST
    ) -> None:
        self.name, self.description, self.errors = name, description, 0
        self._connect, self.clock = connect, clock
        self.port: Any = None
        self._came = 0  # bytes of this read
        self._decoder = decoder_for(description)

    def open(self) -> None:
        """Connect."""
        self.close()
        self._decoder = decoder_for(self.description)
        try:
            self.port = self._connect()
        except InputError:  # the address is wrong, and says how
            raise
        except (OSError, ValueError) as error:
            got = reason_of(error)
            raise LinkError(f"{self.name}: wanted a connection, got '{got}'; check power, cable and address") from error

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come."""
        if self.port is None:
            raise LinkError(f"{self.name}: wanted an open {self.way}, got a closed one; open it first")
        now = self.clock.now
        last, self._came = now() + deadline_s, 0
        while True:
            rows = self._poll(min(max(last - now(), 0.0), POLL_S))
            arrived = now()
            if len(rows):
                counter, values = self.description.split(rows)
                return Chunk(host_time=np.full(len(rows), arrived), counter=counter, values=values)
            if arrived >= last:
                raise RigTimeout(
                    f"{self.name}: wanted a reading within {deadline_s:g} s, got {self._instead()}; check that the device sends",
                    deadline_s=deadline_s,
                )

    def close(self) -> None:
        """Close the port; harmless when called again."""
        if self.port is not None:
            getattr(self.port, self.ending)()
            self.port = None

    def receive(self, wait_s: float) -> bytes:
        """Return bytes as they come, b"" where none came in time."""
        try:
            data: bytes = self.port.receive(wait_s)
        except (OSError, EOFError) as error:
            raise LinkError(f"{self.name}: wanted readings, got a lost link: {reason_of(error)}; reconnect") from error
        return data

    def _poll(self, wait_s: float) -> FloatArray:
        """Return the readings that a short wait completes, (N, K)."""
        data = self.receive(wait_s)
        self._came += len(data)
        garbled = self._decoder.errors
        rows = self._decoder.feed(data, whole=self.port.datagrams) if data else np.empty((0, 0))
        self.errors += self._decoder.errors - garbled
        return rows

    def _instead(self) -> str:
        if not self._came:
            return "nothing"
        return f"{self._came} bytes and no reading in them; check format, checksum and baud"


class LslSource(ByteSource):
    """A stream of the Lab Streaming Layer."""

    way, ending = "stream", "close_stream"

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Any]) -> None:
        if description.has_counter:
            raise InputError(
                "lsl: wanted the channels of the stream, got 'count' among them; LSL has stamps of its own"
            )
        stamped = replace(description, channels=(COUNTER, *description.channels), tick=1.0, counter_bits=0)
        super().__init__(name, stamped, connect)

    def _poll(self, wait_s: float) -> FloatArray:
        try:
            samples, stamps = self.port.pull_chunk(timeout=wait_s)
        except (RuntimeError, OSError) as error:  # pylsl's LostError is a RuntimeError
            raise LinkError(
                f"{self.name}: wanted readings, got a lost stream: {error}; start the sender again"
            ) from error
        width = len(self.description.channels)
        whole = [(stamp, *row) for stamp, row in zip(stamps, samples, strict=True) if len(row) == width - 1]
        sound = finite(np.array(whole, dtype=float).reshape(-1, width))
        self.errors += len(stamps) - len(sound)
        return sound

    def _instead(self) -> str:
        width = len(self.description.channels) - 1
        return f"{self.errors} samples of another width than {width}" if self.errors else "nothing"


def _listed(address: Address) -> tuple[str, int]:
    host, port = host_and_port(address.place)
    if not port:
        wanted = f"{address.kind}://host:port"
        raise InputError(f"device: wanted {wanted}, got '{address.kind}:{address.place}'; name host and port")
    return host, port


def tcp_source(address: Address) -> Source:
    """Return a source that connects over TCP."""
    host, port = _listed(address)
    if not host:
        raise InputError(f"device: wanted tcp://host:port, got no host in '{address.place}'; name it")

    way = f"tcp://{host}:{port}"
    return ByteSource(way, address.describe(), lambda: tcp_port(host, port, CONNECT_S, address.clock), address.clock)


def udp_source(address: Address) -> Source:
    """Return a source that listens for datagrams."""
    host, port = _listed(address)

    def connect() -> SocketPort:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            listener.bind((host, port))
        except OSError:
            listener.close()
            raise
        return SocketPort(listener, datagrams=True)

    return ByteSource(f"udp://{host}:{port}", address.describe(), connect)


def serial_source(address: Address) -> Source:
    """Return a source that reads a serial port."""
    place, text = address.place.removeprefix("//"), address.option("baud", str(BAUD))
    if not place or not text.isdigit() or int(text) == 0:
        raise InputError(f"device: wanted serial:///dev/name?baud=115200, got '{place}' and baud '{text}'; name both")
    return ByteSource(f"serial:{place}", address.describe("baud"), lambda: SerialPort(place, int(text)))


def lsl_source(address: Address) -> Source:
    """Return a source that reads an LSL stream."""
    name, offline = address.place, address.option("offline", "no")
    if not name or offline not in ("yes", "no"):
        raise InputError(f"device: wanted lsl:name?offline=yes or no, got '{name}' and '{offline}'; name the stream")

    def connect() -> Any:
        if offline == "yes":
            configure_lsl(OFFLINE)
        pylsl = package_of("pylsl", "pylsl", "lsl")
        found = pylsl.resolve_byprop("name", name, timeout=RESOLVE_S)
        if not found:
            raise LinkError(f"lsl:{name}: wanted a stream of that name, got none in {RESOLVE_S:g} s; start the sender")
        steadied = pylsl.proc_dejitter | pylsl.proc_monotonize
        return pylsl.StreamInlet(found[0], recover=False, processing_flags=steadied)

    return LslSource(f"lsl:{name}", address.describe("offline"), connect)


def configure_lsl(text: str) -> None:
    """Configure the library before its first use in this process; a stated configuration stays."""
    if "LSLAPICFG" not in os.environ:
        path = Path(tempfile.gettempdir()) / f"undrift-lsl-{os.getpid()}.cfg"
        path.write_text(text, encoding="ascii")
        os.environ["LSLAPICFG"] = str(path)
