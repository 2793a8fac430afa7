"""Readings from Bluetooth Low Energy: ``ble:id?characteristic=uuid&format=frame&...``; each notification is a datagram."""

import asyncio
import contextlib
import queue
import threading
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from undrift.errors import InputError, LinkError
from undrift.live.address import Address
from undrift.live.source import ByteSource, Port, Source

CONNECT_S = 15.0
MOST_WAITING = 100_000  # notifications


class Client(Protocol):
    """What a Bluetooth client does here, as bleak's does."""

    def connect(self) -> Awaitable[Any]:
        """Connect."""

    def start_notify(self, characteristic: str, callback: Callable[[Any, bytearray], None], /) -> Awaitable[Any]:
        """Have a characteristic's values brought.

        Parameters
        ----------
        characteristic : str
            UUID.
        callback : callable
            Takes sender and value.
        """

    def disconnect(self) -> Awaitable[Any]:
        """Let go of the device."""


class BlePort:
    """Notifications of a device, brought by an event loop in a thread of its own.

    Parameters
    ----------
    make : callable
        Makes the client from what to call when the device is lost.
    characteristic : str
        UUID of what is sent.

    Raises
    ------
    OSError
        The device is not there.
    """

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
        """Return the next notification.

        Parameters
        ----------
        wait_s : float
            Longest wait, s.

        Returns
        -------
        bytes
            b"" where none came in time.

        Raises
        ------
        EOFError
            The device is gone.
        """
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
        return asyncio.run_coroutine_threadsafe(_with_end(task), self._loop).result(CONNECT_S + 1.0)

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(CONNECT_S)
        if not self._thread.is_alive():
            self._loop.close()


async def _with_end(task: Awaitable[Any]) -> Any:
    return await asyncio.wait_for(task, CONNECT_S)


def open_from(address: Address) -> Source:
    """Return a source that listens to a Bluetooth device.

    Parameters
    ----------
    address : Address
        Place: the device's address or UUID; option characteristic.

    Returns
    -------
    Source
        Not opened yet.

    Raises
    ------
    InputError
        No device or characteristic, or an option that is none of a stream's.
    """
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
            client: Client = bleak.BleakClient(place, disconnected_callback=on_loss, timeout=CONNECT_S)
            return client

        return BlePort(make, characteristic)

    return ByteSource(f"ble:{place}", address.describe("characteristic"), connect)
