"""Sources of live readings by address, ``kind:place?option=value&option=value``.

    tcp://host:port        udp://:port        serial:///dev/ttyUSB0?baud=115200        lsl:name

The options are the fields of a StreamDescription. A TCP device is a server to which this computer connects. A UDP device sends
whole datagrams to a port of this computer. LSL provides its own time stamps. A new kind of source needs a function like
``tcp_source`` and a row in SOURCES.
"""

import importlib
import os
import socket
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock, Port
from undrift.errors import InputError, LinkError
from undrift.live.decoder import COUNTER, Chunk, StreamDescription, decoder_for, described, finite
from undrift.plugins import Options, split_address

POLL_S = 0.05
WRITE_S = 1.0
CONNECT_S = 5.0
LARGEST = 1 << 16
BAUD = 115_200
BUFFER_BYTES = 1 << 22  # size of the system's buffer for datagrams
RESOLVE_S = 5.0
SCAN_S = 3.0  # time to search for streams, s
QUIET = "[log]\nlevel = -2\n"  # configuration of the LSL library, so that it prints no log
# USB vendors of microcontroller boards and of USB serial converters
BOARDS = {0x0403, 0x0483, 0x067B, 0x10C4, 0x16C0, 0x1915, 0x1A86, 0x2341, 0x239A, 0x2886, 0x2A03, 0x2E8A, 0x303A}
LSL_FOLDERS = (".", "~/lsl_api", "/etc/lsl_api")  # folders of a user's lsl_api.cfg


class Source(Protocol):
    """A device that sends readings without being asked."""

    name: str  # name for messages
    description: StreamDescription  # channels, units and framing
    errors: int  # number of corrupted readings that were omitted so far

    def open(self) -> None:
        """Connect, or raise LinkError if nothing answers."""

    def read(self, wait_s: float) -> Chunk | None:
        """Return the readings that arrive within a time, s, or None."""

    def received_instead(self) -> str:
        """Describe what was received if there is no reading, for messages."""

    def close(self) -> None:
        """Close the source. A second call has no effect."""


def source_at(text: str, clock: Clock = HOST) -> Source:
    """Return the unopened source of an address. The clock is for timeouts and times of arrival."""
    kind, place, options = device_address(text)
    return SOURCES[kind](place, dict(options), clock)


def device_address(text: str) -> tuple[str, str, Options]:
    """Return the kind, the place and the options of an address."""
    return split_address(text, "device", tuple(SOURCES), "Name how it is connected")


# ---- Ports, which transfer bytes. A read returns b"" on timeout, and raises OSError or EOFError if the connection is lost.


class SocketPort:
    """Port of a socket."""

    def __init__(self, connection: socket.socket, datagrams: bool = False) -> None:
        self.datagrams, self._socket = datagrams, connection

    def receive(self, wait_s: float) -> bytes:
        """Return the bytes that have arrived."""
        self._socket.settimeout(max(wait_s, 0.0))
        try:
            data = self._socket.recv(LARGEST)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data and not self.datagrams:
            raise EOFError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all bytes, or raise OSError."""
        self._socket.settimeout(WRITE_S)
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialPort:
    """Port that pyserial opens: a serial port, a pty, ``socket://`` or ``loop://``."""

    datagrams = False

    def __init__(self, place: str, baud: int) -> None:
        serial, self.baud = package_of("serial", "pyserial", "serial port"), baud
        self._port = serial.serial_for_url(place, baudrate=baud, write_timeout=WRITE_S)

    def receive(self, wait_s: float) -> bytes:
        """Return the bytes that have arrived."""
        if self._port.timeout != wait_s:  # setting it takes time
            self._port.timeout = wait_s
        return bytes(self._port.read(max(self._port.in_waiting, 1)))

    def write(self, data: bytes) -> None:
        """Send all bytes, or raise OSError."""
        self._port.write(data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def open_port(url: str, baud: int, clock: Clock = HOST) -> Port:
    """Open ``tcp://host:port``, or ``serial://`` and a path or URL of pyserial."""
    if not url.startswith("tcp://"):
        return SerialPort(url.removeprefix("serial://"), baud)
    host, port = host_and_port(url.removeprefix("tcp:"))
    if (way := clock.connection(host, port)) is not None:
        return way
    connection = socket.create_connection((host, port), timeout=CONNECT_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SocketPort(connection)


def reason_of(error: Exception) -> str:
    """Return the text of an error, or its type if it has no text."""
    return str(error) or type(error).__name__


def number_of(text: str) -> float:
    """Return the number in a text, or NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def host_and_port(place: str) -> tuple[str, int]:
    """Return host and port of ``//host:port``, with "" or 0 for missing parts."""
    parts = urlsplit(place)
    try:
        port = parts.port or 0
    except ValueError:
        port = 0
    return parts.hostname or "", port if parts.path in ("", "/") else 0


def serial_ports() -> list[tuple[str, str]]:
    """Return names and descriptions of the serial ports: microcontroller boards first, then other USB ports, then the rest."""
    ports = package_of("serial.tools.list_ports", "pyserial", "serial port").comports()
    ports_by_kind = sorted(ports, key=lambda port: (port.vid is None, port.vid not in BOARDS, port.device))
    return [(port.device, port.description if port.vid is not None else "built in") for port in ports_by_kind]


def lsl_streams() -> list[tuple[str, str]]:
    """Return names and descriptions of the LSL streams in the network."""
    is_configured = any(Path(folder, "lsl_api.cfg").expanduser().exists() for folder in LSL_FOLDERS)
    if not is_configured and "LSLAPICFG" not in os.environ:
        path = Path(tempfile.gettempdir()) / f"undrift-lsl-{os.getpid()}.cfg"
        path.write_text(QUIET, encoding="ascii")
        os.environ["LSLAPICFG"] = str(path)
    pylsl = package_of("pylsl", "pylsl", "LSL")
    streams = ((info, info.nominal_srate()) for info in pylsl.resolve_streams(SCAN_S))
    return [(info.name(), f"{info.type()}, {info.channel_count()} channels, {rate:g} Hz") for info, rate in streams]


def package_of(module: str, package: str, who: str) -> Any:
    """Import an optional package, or raise LinkError with the package to install."""
    try:
        return importlib.import_module(module)
    except (ImportError, RuntimeError) as error:  # pylsl raises RuntimeError if its library is missing
        raise LinkError(f"{who}: the package {package} is missing. Run pip install undrift[live].") from error


# ---- Sources, which open a port and read it until a reading is complete.


class ByteSource:
    """A device that sends bytes through a port."""

    way = "link"
    ending = "close"  # name of the port's closing method

    def __init__(
        self, name: str, description: StreamDescription, connect: Callable[[], Any], clock: Clock = HOST
    ) -> None:
        self.name, self.description, self.errors = name, description, 0
        self._connect, self.clock = connect, clock
        self.port: Any = None
        self._received = 0  # number of bytes since the last reading
        self._decoder = decoder_for(description)

    def open(self) -> None:
        """Connect to the device."""
        self.close()
        self._decoder = decoder_for(self.description)
        try:
            self.port = self._connect()
        except InputError:  # the message already describes the error in the address
            raise
        except (OSError, ValueError) as error:
            reason = reason_of(error)
            raise LinkError(f"{self.name}: cannot connect ({reason}). Check power, cable and address.") from error

    def read(self, wait_s: float) -> Chunk | None:
        """Return the readings that are complete after a wait, s, or None."""
        if self.port is None:
            raise LinkError(f"{self.name}: the {self.way} is closed. Open it first.")
        rows = self._poll(wait_s)
        if not len(rows):
            return None
        counter, values = self.description.split(rows)
        return Chunk(host_time=self.clock.now(), counter=counter, values=values)

    def close(self) -> None:
        """Close the port. A second call has no effect."""
        if self.port is not None:
            getattr(self.port, self.ending)()
            self.port = None

    def receive(self, wait_s: float) -> bytes:
        """Return the bytes that have arrived, or b"" on timeout."""
        try:
            data: bytes = self.port.receive(wait_s)
        except (OSError, EOFError) as error:
            raise LinkError(f"{self.name}: the link is lost ({reason_of(error)}). Reconnect it.") from error
        return data

    def _poll(self, wait_s: float) -> FloatArray:
        """Return the readings that are complete after a short wait, (N, K)."""
        data = self.receive(wait_s)
        self._received += len(data)
        errors = self._decoder.errors
        rows = self._decoder.feed(data, whole=self.port.datagrams) if data else np.empty((0, 0))
        self.errors += self._decoder.errors - errors
        self._received = 0 if len(rows) else self._received
        return rows

    def received_instead(self) -> str:
        """Describe what was received if there is no reading, for messages."""
        if not self._received:
            return "nothing"
        return f"{self._received} bytes without a reading. Check format, checksum and baud rate"


class LslSource(ByteSource):
    """A stream of the Lab Streaming Layer."""

    way, ending = "stream", "close_stream"

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Any]) -> None:
        if description.has_counter:
            raise InputError("lsl: the channels contain 'count', but LSL has its own time stamps. Remove 'count'.")
        stamped = replace(description, channels=(COUNTER, *description.channels), tick=1.0, counter_bits=0)
        super().__init__(name, stamped, connect)

    def _poll(self, wait_s: float) -> FloatArray:
        try:
            samples, stamps = self.port.pull_chunk(timeout=min(wait_s, POLL_S))  # waits even if samples arrive
        except (RuntimeError, OSError) as error:  # pylsl's LostError is a RuntimeError
            raise LinkError(f"{self.name}: the stream is lost ({error}). Start the sender again.") from error
        width = len(self.description.channels)
        complete = [(stamp, *row) for stamp, row in zip(stamps, samples, strict=True) if len(row) == width - 1]
        valid = finite(np.array(complete, dtype=float).reshape(-1, width))
        self.errors += len(stamps) - len(valid)
        return valid

    def received_instead(self) -> str:
        width = len(self.description.channels) - 1
        return f"{self.errors} samples of another width than {width}" if self.errors else "nothing"


# ---- Kinds of sources: functions of the place and the options of an address.

PlaceOptions = dict[str, str]


def _address_error(kind: str, place: str) -> InputError:
    return InputError(f"device: expected {kind}://host:port, got '{kind}:{place}'. Enter host and port.")


def tcp_source(place: str, options: PlaceOptions, clock: Clock) -> Source:
    """Return a source that connects over TCP."""
    if not all(host_and_port(place)):
        raise _address_error("tcp", place)
    url = f"tcp:{place}"
    return ByteSource(url, described(options), lambda: open_port(url, 0, clock), clock)


def udp_source(place: str, options: PlaceOptions, clock: Clock) -> Source:
    """Return a source that listens for datagrams."""
    host, port = host_and_port(place)
    if not port:
        raise _address_error("udp", place)

    def connect() -> SocketPort:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            listener.bind((host, port))
        except OSError:
            listener.close()
            raise
        return SocketPort(listener, datagrams=True)

    return ByteSource(f"udp:{place}", described(options), connect, clock)


def serial_source(place: str, options: PlaceOptions, clock: Clock) -> Source:
    """Return a source that reads a serial port."""
    path, baud = place.removeprefix("//"), options.pop("baud", str(BAUD))
    if not path or not baud.isdigit() or int(baud) == 0:
        raise InputError(
            f"device: expected serial:///dev/name?baud=115200, got '{path}' and baud '{baud}'. Enter both."
        )
    return ByteSource(f"serial:{path}", described(options), lambda: SerialPort(path, int(baud)), clock)


def lsl_source(place: str, options: PlaceOptions, clock: Clock) -> Source:
    """Return a source that reads an LSL stream."""
    if not place:
        raise InputError("device: expected lsl:name, got no name. Enter the stream's name.")

    def connect() -> Any:
        pylsl = package_of("pylsl", "pylsl", "lsl")
        streams = pylsl.resolve_byprop("name", place, timeout=RESOLVE_S)
        if not streams:
            raise LinkError(f"lsl:{place}: no stream with that name within {RESOLVE_S:g} s. Start the sender.")
        flags = pylsl.proc_dejitter | pylsl.proc_monotonize
        return pylsl.StreamInlet(streams[0], recover=False, processing_flags=flags)

    return LslSource(f"lsl:{place}", described(options), connect)


def simulated_source(place: str, options: PlaceOptions, clock: Clock) -> Source:
    """Return the source of a simulated device in the hands of an operator."""
    from undrift.live.hands import source_of  # it imports this module

    return source_of(place, options)


SOURCES: dict[str, Callable[[str, PlaceOptions, Clock], Source]] = {
    "tcp": tcp_source,
    "udp": udp_source,
    "serial": serial_source,
    "lsl": lsl_source,
    "simulated": simulated_source,
}
