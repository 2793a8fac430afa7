"""Serial ports as they are listed: those of USB first, with what is behind them."""

from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from undrift.live.transports import serial_ports


def test_ports_of_usb_stand_first(monkeypatch: pytest.MonkeyPatch):
    built_in = SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None)
    boards = [SimpleNamespace(device=f"/dev/ttyUSB{k}", description=f"board {k}", vid=0x2341) for k in (1, 0)]
    monkeypatch.setattr(list_ports, "comports", lambda: [built_in, *boards])
    assert serial_ports() == [("/dev/ttyUSB0", "board 0"), ("/dev/ttyUSB1", "board 1"), ("/dev/ttyS0", "built in")]
