"""What is listed of senders: serial ports, those of USB first, with what is behind them; Bluetooth devices with their names."""

import asyncio
import sys
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from undrift.errors import LinkError
from undrift.live.transports import ble_devices, lsl_streams, serial_ports


def test_ports_of_boards_stand_first_then_those_of_usb(monkeypatch: pytest.MonkeyPatch):
    modem = SimpleNamespace(device="/dev/ttyACM0", description="modem", vid=0x12D1)
    built_in = SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None)
    boards = [SimpleNamespace(device=f"/dev/ttyUSB{k}", description=f"board {k}", vid=0x2341) for k in (1, 0)]
    monkeypatch.setattr(list_ports, "comports", lambda: [built_in, modem, *boards])
    usb = [("/dev/ttyUSB0", "board 0"), ("/dev/ttyUSB1", "board 1"), ("/dev/ttyACM0", "modem")]
    assert serial_ports() == [*usb, ("/dev/ttyS0", "built in")]


def test_bluetooth_devices_with_a_name_stand_first_within_a_loop_too(monkeypatch: pytest.MonkeyPatch):
    async def discover(timeout: float) -> list[SimpleNamespace]:
        return [
            SimpleNamespace(address=f"AA:0{k}", name=name) for k, name in enumerate((None, "Wrist", "Foot")) if timeout
        ]

    monkeypatch.setitem(sys.modules, "bleak", SimpleNamespace(BleakScanner=SimpleNamespace(discover=discover)))
    listed = [("AA:02", "Foot"), ("AA:01", "Wrist"), ("AA:00", "no name")]
    assert ble_devices() == listed

    async def in_a_notebook() -> list[tuple[str, str]]:
        return ble_devices()

    assert asyncio.run(in_a_notebook()) == listed


def test_what_cannot_be_looked_at_says_what_to_do(monkeypatch: pytest.MonkeyPatch):
    async def off(timeout: float) -> None:
        raise OSError("no adapter")

    monkeypatch.setitem(sys.modules, "bleak", SimpleNamespace(BleakScanner=SimpleNamespace(discover=off)))
    with pytest.raises(LinkError, match="Bluetooth: wanted an adapter, got 'no adapter'; switch it on"):
        ble_devices()
    for module, look in (("bleak", ble_devices), ("pylsl", lsl_streams)):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(LinkError, match=rf"wanted the package {module}, got none; pip install undrift\[live\]"):
            look()
