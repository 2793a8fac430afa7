"""Sources: where readings come from, by address: ``kind:place?option=value&option=value``.

    tcp://host:port        udp://:port        serial:///dev/ttyUSB0?baud=115200        lsl:name        ble:id?characteristic=uuid

The options are the fields of a StreamDescription, and ``description=FILE`` for a TOML file of them. A new kind is one file with a
function from an Address to a Source, and one row in SOURCES; or a package with an entry point in the group "undrift.sources".
"""

import asyncio
import contextlib
import os
import queue
import socket
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.decoder import COUNTER, Chunk, StreamDescription, decoder_for, described, read_description
from undrift.plugins import load_named, names_in

POLL_S = 0.05


class Source(Protocol):
    """A device that sends by itself."""

    @property
    def name(self) -> str:
        """What to call it in a message."""

    @property
    def description(self) -> StreamDescription:
        """What it sends."""

    @property
    def errors(self) -> int:
        """Garbled readings that were left out so far."""

    def open(self) -> None:
        """Connect; LinkError where nobody is."""

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come, one reading or more."""

    def close(self) -> None:
        """Let go of it; harmless when called again."""


class Port(Protocol):
    """An open way on which bytes come."""

    datagrams: bool

    def receive(self, wait_s: float) -> bytes:
        """Return bytes, b"" where none came in time; OSError or EOFError where the way is gone."""

    def close(self) -> None:
        """Let go of it."""


class ByteSource:
    """A device whose bytes come through a port."""

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Port]) -> None:
        self.name, self.description = name, description
        self._connect = connect
        self._port: Port | None = None
        self._decoder = decoder_for(description)

    @property
    def errors(self) -> int:
        """Garbled readings that were left out so far."""
        return self._decoder.errors

    def open(self) -> None:
        """Connect."""
        self.close()
        errors = self._decoder.errors
        self._decoder = decoder_for(self.description)
        self._decoder.errors = errors
        try:
            self._port = self._connect()
        except (OSError, ValueError) as error:
            reason = str(error) or type(error).__name__
            raise LinkError(
                f"{self.name}: wanted a connection, got '{reason}'; check power, cable and address"
            ) from error

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come."""
        if self._port is None:
            raise LinkError(f"{self.name}: wanted an open link, got a closed one; open it first")
        last, came = time.monotonic() + deadline_s, 0
        while True:
            data = self._receive(self._port, min(max(last - time.monotonic(), 0.0), POLL_S))
            arrived = time.monotonic()
            came += len(data)
            rows = self._decoder.feed(data, whole=self._port.datagrams) if data else ()
            if len(rows):
                counter, values = self.description.split(np.asarray(rows))
                return Chunk(host_time=np.full(len(rows), arrived), counter=counter, values=values)
            if arrived >= last:
                what = f"{came} bytes and no reading in them; check format, checksum and baud" if came else "nothing"
                raise RigTimeout(
                    f"{self.name}: wanted a reading within {deadline_s:g} s, got {what}; check that the device sends",
                    deadline_s=deadline_s,
                )

    def close(self) -> None:
        """Let go of the port; harmless when called again."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _receive(self, port: Port, wait_s: float) -> bytes:
        try:
            return port.receive(wait_s)
        except (OSError, EOFError) as error:
            reason = str(error) or type(error).__name__
            raise LinkError(f"{self.name}: wanted readings, got a lost link: {reason}; reconnect") from error


# ---- Addresses: ``kind:place?option=value&option=value`` -> a source of readings.

SOURCES = {  # kind -> the function that makes a source of an address
    "tcp": "undrift.live.transports:tcp_source",
    "udp": "undrift.live.transports:udp_source",
    "serial": "undrift.live.transports:serial_source",
    "lsl": "undrift.live.transports:lsl_source",
    "ble": "undrift.live.transports:ble_source",
}
GROUP = "undrift.sources"


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """An address taken apart."""

    kind: str  # A row of SOURCES
    place: str  # What stands between the colon and the question mark
    options: tuple[tuple[str, str], ...] = ()  # What stands behind it
    description: StreamDescription | None = None  # What the options change

    def option(self, name: str, default: str) -> str:
        """Return an option that belongs to the kind of source."""
        return dict(self.options).get(name, default)

    def describe(self, *own: str) -> StreamDescription:
        """Return what is sent, by the file and the options."""
        file = self.option("description", "")
        base = read_description(file) if file else self.description
        return described(base, tuple(pair for pair in self.options if pair[0] not in (*own, "description")))


def parse_address(text: str, description: StreamDescription | None = None) -> Address:
    """Take an address apart."""
    kind, colon, rest = text.partition(":")
    if not colon or (kind not in SOURCES and kind not in names_in(SOURCES, GROUP)):
        known = ", ".join(f"{name}:..." for name in names_in(SOURCES, GROUP))
        raise InputError(f"device: wanted one of {known}, got '{text}'; name how it is connected")
    place, _, query = rest.partition("?")
    try:
        options = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise InputError(f"device: wanted options as name=value&name=value, got '{query}'; mend the address") from error
    return Address(kind=kind, place=place, options=tuple(options), description=description)


def source_at(text: str, description: StreamDescription | None = None) -> "Source":
    """Return the source of an address, not opened yet."""
    address = parse_address(text, description)
    source: Source = load_named(address.kind, SOURCES, GROUP)(address)
    return source


# ---- Readings over a serial port or whatever pyserial opens: ``serial:///dev/ttyUSB0?baud=115200&...``.

BAUD = 115_200


class SerialPort:
    """A serial port that bytes come from."""

    datagrams = False

    def __init__(self, port: Any) -> None:
        self._port = port

    def receive(self, wait_s: float) -> bytes:
        """Return what has come."""
        self._port.timeout = wait_s
        first: bytes = self._port.read(1)
        waiting = self._port.in_waiting if first else 0
        return first + bytes(self._port.read(waiting)) if waiting else first

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()


def serial_source(address: Address) -> Source:
    """Return a source that reads a serial port."""
    place = address.place.removeprefix("//")
    text = address.option("baud", str(BAUD))
    if not place or not text.isdigit() or int(text) == 0:
        raise InputError(f"device: wanted serial:///dev/name?baud=115200, got '{place}' and baud '{text}'; name both")

    def connect() -> Port:
        try:
            import serial
        except ImportError as error:
            raise LinkError("serial port: wanted the package pyserial, got none; pip install undrift[live]") from error
        return SerialPort(serial.serial_for_url(place, baudrate=int(text)))

    return ByteSource(f"serial:{place}", address.describe("baud"), connect)


# ---- Readings over TCP: the device listens, ``tcp://host:port?...``.

CONNECT_S = 5.0
LARGEST = 1 << 16


class SocketPort:
    """A socket that bytes come from."""

    def __init__(self, connection: socket.socket, datagrams: bool) -> None:
        self.datagrams = datagrams
        self._socket = connection

    def receive(self, wait_s: float) -> bytes:
        """Return what has come."""
        self._socket.settimeout(max(wait_s, 1e-4))
        try:
            data = self._socket.recv(LARGEST)
        except TimeoutError:
            return b""
        if not data and not self.datagrams:
            raise EOFError("the other side closed the connection")
        return data

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def host_and_port(address: Address) -> tuple[str, int]:
    """Return host and port of a place."""
    parts = urlsplit(address.place)
    try:
        port = parts.port
    except ValueError:
        port = None
    if not port or parts.path not in ("", "/"):
        wanted = f"{address.kind}://host:port"
        raise InputError(f"device: wanted {wanted}, got '{address.kind}:{address.place}'; name host and port")
    return parts.hostname or "", port


def tcp_source(address: Address) -> Source:
    """Return a source that connects over TCP."""
    host, port = host_and_port(address)
    if not host:
        raise InputError(f"device: wanted tcp://host:port, got no host in '{address.place}'; name it")

    def connect() -> Port:
        connection = socket.create_connection((host, port), timeout=CONNECT_S)
        return SocketPort(connection, datagrams=False)

    return ByteSource(f"tcp://{host}:{port}", address.describe(), connect)


# ---- Readings over UDP: the device sends to this computer's port, ``udp://:port?...`` or ``udp://address-of-this-computer:port?...``.

BUFFER_BYTES = 1 << 22  # what the system keeps while nobody looks


def udp_source(address: Address) -> Source:
    """Return a source that listens for datagrams."""
    host, port = host_and_port(address)

    def connect() -> Port:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            listener.bind((host, port))
        except OSError:
            listener.close()
            raise
        return SocketPort(listener, datagrams=True)

    return ByteSource(f"udp://{host}:{port}", address.describe(), connect)


# ---- Readings from Bluetooth Low Energy: ``ble:id?characteristic=uuid&format=frame&...``; each notification is a datagram.

CONNECT_S_BLE = 15.0
MOST_WAITING = 100_000  # notifications


class Client(Protocol):
    """What a Bluetooth client does here, as bleak's does."""

    def connect(self) -> Awaitable[Any]:
        """Connect."""

    def start_notify(self, characteristic: str, callback: Callable[[Any, bytearray], None], /) -> Awaitable[Any]:
        """Have a characteristic's values brought."""

    def disconnect(self) -> Awaitable[Any]:
        """Let go of the device."""


class BlePort:
    """Notifications of a device, brought by an event loop in a thread of its own."""

    datagrams = True

    def __init__(self, make: Callable[[Callable[[Any], None]], Client], characteristic: str) -> None:
        self._values: queue.Queue[bytes | None] = queue.Queue(MOST_WAITING)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="ble", daemon=True)
        self._thread.start()
        self._lost = False
        try:
            self._client = self._await(self._begin(make, characteristic))
        except BaseException as error:
            self._end()
            if isinstance(error, Exception):
                raise OSError(str(error) or type(error).__name__) from error
            raise

    def receive(self, wait_s: float) -> bytes:
        """Return the next notification."""
        if self._lost and self._values.empty():
            raise EOFError("the device is out of reach or was switched off")
        try:
            return self._values.get(timeout=wait_s) or b""
        except queue.Empty:
            return b""

    def close(self) -> None:
        """Let go of the device and end the thread."""
        with contextlib.suppress(Exception):  # gone already: nothing is left to let go of
            self._await(self._client.disconnect())
        self._end()

    async def _begin(self, make: Callable[[Callable[[Any], None]], Client], characteristic: str) -> Client:
        client = make(self._on_loss)
        await client.connect()
        await client.start_notify(characteristic, self._on_value)
        return client

    def _on_value(self, sender: Any, value: bytearray) -> None:
        with contextlib.suppress(queue.Full):  # nobody has looked for long: its number will be missing
            self._values.put_nowait(bytes(value))

    def _on_loss(self, client: Any) -> None:
        self._lost = True
        with contextlib.suppress(queue.Full):
            self._values.put_nowait(None)  # wakes who waits

    def _await(self, task: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(_with_end(task), self._loop).result(CONNECT_S_BLE + 1.0)

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(CONNECT_S_BLE)
        if not self._thread.is_alive():
            self._loop.close()


async def _with_end(task: Awaitable[Any]) -> Any:
    return await asyncio.wait_for(task, CONNECT_S_BLE)


def ble_source(address: Address) -> Source:
    """Return a source that listens to a Bluetooth device."""
    place, characteristic = address.place, address.option("characteristic", "")
    if not place or not characteristic:
        raise InputError(
            f"device: wanted ble:id?characteristic=uuid, got '{place}' and '{characteristic}'; name device and characteristic"
        )

    def connect() -> Port:
        try:
            import bleak
        except ImportError as error:
            raise LinkError("ble: wanted the package bleak, got none; pip install undrift[live]") from error

        def make(on_loss: Callable[[Any], None]) -> Client:
            client: Client = bleak.BleakClient(place, disconnected_callback=on_loss, timeout=CONNECT_S_BLE)
            return client

        return BlePort(make, characteristic)

    return ByteSource(f"ble:{place}", address.describe("characteristic"), connect)


# ---- Readings from Lab Streaming Layer: ``lsl:name?channels=gyro_x,...&rate=100&offline=yes``.

RESOLVE_S = 5.0
OFFLINE = "[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n"


class Inlet(Protocol):
    """What an LSL inlet does here."""

    def pull_chunk(self, timeout: float = 0.0) -> tuple[list[list[float]], list[float]]:
        """Return samples and their time stamps; both empty where none came in time."""

    def close_stream(self) -> None:
        """Let go of the stream."""


class LslSource:
    """A stream of the Lab Streaming Layer."""

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Inlet]) -> None:
        if description.has_counter:
            raise InputError(
                "lsl: wanted the channels of the stream, got 'count' among them; LSL has stamps of its own"
            )
        self.name, self.errors = name, 0
        self.description = replace(description, channels=(COUNTER, *description.channels), tick=1.0, counter_bits=0)
        self._connect = connect
        self._inlet: Inlet | None = None

    def open(self) -> None:
        """Find the stream."""
        self.close()
        self._inlet = self._connect()

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come."""
        if self._inlet is None:
            raise LinkError(f"{self.name}: wanted an open stream, got a closed one; open it first")
        last = time.monotonic() + deadline_s
        while True:
            samples, stamps = self._pull(self._inlet, min(max(last - time.monotonic(), 0.0), POLL_S))
            arrived = time.monotonic()
            width = len(self.description.channels) - 1
            good = [(stamp, *row) for stamp, row in zip(stamps, samples, strict=True) if len(row) == width]
            self.errors += len(stamps) - len(good)
            rows = np.array(good, dtype=float).reshape(-1, width + 1)
            sound = rows[~np.isinf(rows).any(axis=1)]
            self.errors += len(rows) - len(sound)
            if len(sound):
                counter, values = self.description.split(sound)
                return Chunk(host_time=np.full(len(sound), arrived), counter=counter, values=values)
            if arrived >= last:
                got = f"{self.errors} samples of another width than {width}" if self.errors else "nothing"
                raise RigTimeout(
                    f"{self.name}: wanted a reading within {deadline_s:g} s, got {got}; check that the device sends",
                    deadline_s=deadline_s,
                )

    def close(self) -> None:
        """Let go of the stream; harmless when called again."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None

    def _pull(self, inlet: Inlet, wait_s: float) -> tuple[list[list[float]], list[float]]:
        try:
            return inlet.pull_chunk(timeout=wait_s)
        except (RuntimeError, OSError) as error:  # pylsl's LostError is a RuntimeError
            raise LinkError(
                f"{self.name}: wanted readings, got a lost stream: {error}; start the sender again"
            ) from error


def stay_offline() -> None:
    """Tell the library, before its first use in this process, to look on this computer only; a stated configuration stays."""
    if "LSLAPICFG" not in os.environ:
        path = Path(tempfile.gettempdir()) / f"undrift-lsl-{os.getpid()}.cfg"
        path.write_text(OFFLINE, encoding="ascii")
        os.environ["LSLAPICFG"] = str(path)


def lsl_source(address: Address) -> Source:
    """Return a source that reads an LSL stream."""
    name, offline = address.place, address.option("offline", "no")
    if not name or offline not in ("yes", "no"):
        raise InputError(f"device: wanted lsl:name?offline=yes or no, got '{name}' and '{offline}'; name the stream")

    def connect() -> Inlet:
        if offline == "yes":
            stay_offline()
        return _inlet(name)

    return LslSource(f"lsl:{name}", address.describe("offline"), connect)


def _inlet(name: str) -> Inlet:
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:  # the second where the library beneath it is missing
        raise LinkError("lsl: wanted the package pylsl, got none; pip install undrift[live]") from error
    found = pylsl.resolve_byprop("name", name, timeout=RESOLVE_S)
    if not found:
        raise LinkError(f"lsl:{name}: wanted a stream of that name, got none in {RESOLVE_S:g} s; start the sender")
    steadied: Inlet = pylsl.StreamInlet(
        found[0], recover=False, processing_flags=pylsl.proc_dejitter | pylsl.proc_monotonize
    )
    return steadied
