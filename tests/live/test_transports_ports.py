"""What is listed of senders: serial ports, those of USB first, with what is behind them."""

import sys
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from undrift.errors import LinkError
from undrift.live.transports import lsl_streams, serial_ports


def test_ports_of_boards_stand_first_then_those_of_usb(monkeypatch: pytest.MonkeyPatch):
    modem = SimpleNamespace(device="/dev/ttyACM0", description="modem", vid=0x12D1)
    built_in = SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None)
    boards = [SimpleNamespace(device=f"/dev/ttyUSB{k}", description=f"board {k}", vid=0x2341) for k in (1, 0)]
    monkeypatch.setattr(list_ports, "comports", lambda: [built_in, modem, *boards])
    usb = [("/dev/ttyUSB0", "board 0"), ("/dev/ttyUSB1", "board 1"), ("/dev/ttyACM0", "modem")]
    assert serial_ports() == [*usb, ("/dev/ttyS0", "built in")]


def test_a_missing_lsl_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(LinkError, match=r"pylsl .*pip install undrift\[live\]"):
        lsl_streams()
