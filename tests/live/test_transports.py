"""Sources: the same readings by every way, and every way that is lost says so; no wait without end."""

import contextlib
import os
import socket
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from serial.tools import list_ports

from testkit.byte_sender import Sender
from testkit.pseudo_terminal import open_pseudo_terminal
from testkit.waiting import eventually
from undrift.errors import InputError, LinkError
from undrift.live.decoder import StreamDescription
from undrift.live.transports import LslSource, lsl_streams, serial_ports, source_at

OPTIONS = "?channels=count,gyro_x,gyro_y,gyro_z&rate=100"
TEXT = b"".join(b"%d,1,2,3\n" % k for k in range(5))
PLAIN = StreamDescription(channels=("gyro_x", "gyro_y", "gyro_z"), rate=100.0)


@contextlib.contextmanager
def opened(address):
    source = source_at(address)
    source.open()
    try:
        yield source
    finally:
        source.close()
        source.close()


def counts(source, wanted=5):
    found = []
    while len(found) < wanted:
        chunk = source.read(30.0)
        found += [] if chunk is None else chunk.counter.tolist()
    return found


def test_readings_come_over_tcp_stamped_with_the_hosts_time():
    with Sender([TEXT]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        before = time.monotonic()
        chunk = source.read(30.0)
        assert chunk.counter.tolist() == [0, 1, 2, 3, 4]
        assert chunk.values[0].tolist() == [1, 2, 3]
        assert before <= chunk.host_time <= time.monotonic()


def test_silence_and_rubbish_are_told_apart():
    with Sender([b""]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        assert source.read(0.1) is None
        assert source.received_instead() == "nothing"
    with Sender([b"x\n" * 50]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        eventually(lambda: source.read(0.2) is None and "100 bytes" in source.received_instead(), "rubbish")
        assert source.errors == 49  # the first may have been under way


def test_readings_come_over_udp_a_datagram_each():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with (
        opened(f"udp://127.0.0.1:{port}{OPTIONS}") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device,
    ):
        for line in (*TEXT.splitlines(), b""):
            device.sendto(line, ("127.0.0.1", port))
        assert counts(source) == [0, 1, 2, 3, 4]
        assert source.read(0.05) is None


def test_readings_come_over_a_serial_line():
    ours, theirs = open_pseudo_terminal()
    try:
        with opened(f"serial://{os.ttyname(theirs)}{OPTIONS}&baud=115200") as source:
            os.write(ours, TEXT)
            assert counts(source) == [0, 1, 2, 3, 4]
            assert source.read(0.05) is None
    finally:
        os.close(ours)
        os.close(theirs)


class FakeInlet:
    def __init__(self, *pulls):
        self.pulls, self.closed = list(pulls), 0

    def pull_chunk(self, timeout=0.0):
        pull = self.pulls.pop(0) if self.pulls else ([], [])
        if isinstance(pull, Exception):
            raise pull
        return pull

    def close_stream(self):
        self.closed += 1


def test_lsl_stamps_are_the_devices_clock():
    inlet = FakeInlet(([], []), ([[1.0, 2, 3], [4, 5, 6]], [7.5, 7.51]))
    source = LslSource("lsl:imu", PLAIN, lambda: inlet)
    source.open()
    assert source.read(1.0) is None
    chunk = source.read(1.0)
    assert chunk.counter.tolist() == [7.5, 7.51]
    assert chunk.values.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert source.description.tick_s == 1.0
    source.close()
    source.close()
    assert inlet.closed == 1


def test_readings_come_over_lsl_on_this_computer(monkeypatch, tmp_path):
    pylsl = pytest.importorskip("pylsl")
    monkeypatch.setenv("LSLAPICFG", str(tmp_path / "lsl.cfg"))
    (tmp_path / "lsl.cfg").write_text("[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n")
    name = f"undrift-test-{os.getpid()}"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "IMU", 3, 100, "float32", name))
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(0.01):
            outlet.push_sample([1.0, 2.0, 3.0])

    sender = threading.Thread(target=send)
    sender.start()
    try:
        with opened(f"lsl:{name}?channels=gyro_x,gyro_y,gyro_z&rate=100") as source:
            chunks = []
            eventually(lambda: chunks.append(source.read(1.0)) or chunks[-1], "a reading")
            assert chunks[-1].values[0].tolist() == [1, 2, 3]
        assert (name, "IMU, 3 channels, 100 Hz") in lsl_streams()
    finally:
        stop.set()
        sender.join()


SIX = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


def test_an_address_describes_its_stream():
    source = source_at(
        "tcp://127.0.0.1:9?channels=count,gyro_x,gyro_y,gyro_z,-,temp&rate=250&gyro_unit=dps&counter_bits=16&device=A7"
    )
    what = source.description
    assert what.measured == ("gyro_x", "gyro_y", "gyro_z", "temp")
    assert (what.rate, what.gyro_unit, what.counter_bits, what.device) == (250.0, "dps", 16, "A7")
    assert what.tick_s == 1 / 250
    assert source.name == "tcp://127.0.0.1:9"


def test_readings_become_a_record_in_the_units_stated():
    what = StreamDescription(
        channels=("temp", *SIX), rate=10.0, gyro_unit="dps", accel_unit="g", temp_scale=0.5, temp_zero=-5
    )
    record = what.record(np.arange(3.0), np.arange(21.0).reshape(3, 7))
    assert record.gyro_unit == "dps"
    assert record.temp_c.tolist() == [-5.0, -1.5, 2.0]
    assert record.accel[1].tolist() == [11, 12, 13]
    assert (record.state, record.frame, record.mag_ut) == ("raw", "s", None)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, r"`rate` must be above 0"),
        ({"rate": 1.0, "channels": ("gyro_x", "gyro_y")}, r"gyro .*three axes, got 2"),
        ({"rate": 1.0, "channels": ("temp",)}, r"no channel of gyro"),
        ({"rate": 1.0, "format": "xml"}, r"got 'xml'"),
        ({"rate": 1.0, "checksum": "md5"}, r"checksum.*got 'md5'"),
        ({"rate": 1.0, "channels": (*SIX, "x")}, r"count, -, .* got 'x'"),
        ({"rate": 1.0, "counter_bits": 64}, r"counter_bits .*0 to 53 .*got 64 and 0"),
    ],
)
def test_a_description_that_cannot_be_is_refused(options, text):
    with pytest.raises(InputError, match=text):
        StreamDescription(**options)


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("tcp", r"expected one of tcp"),
        ("tcp://h:1?rate=fast", r"'fast' is not a value for rate"),
        ("tcp://h:1?rate=1&speed=2", r"unknown option 'speed'"),
        ("tcp://h?rate=1", r"tcp://host:port, got 'tcp://h'"),
        ("tcp://:80?rate=1", r"tcp://host:port, got 'tcp://:80'"),
        ("serial:?rate=1", r"serial:///dev/name\?baud=115200, got '' and baud '115200'"),
        ("lsl:imu?rate=1", r"channels contain 'count'"),
    ],
)
def test_an_address_that_is_none_is_refused_before_anything_is_opened(address, text):
    with pytest.raises(InputError, match=text):
        source_at(address).open()


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


def test_port_that_cannot_be_opened_is_a_lost_link():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        for address in (f"udp://127.0.0.1:{taken.getsockname()[1]}", "serial:///dev/none", "tcp://127.0.0.1:9"):
            source = source_at(address + OPTIONS)
            with pytest.raises(LinkError, match="cannot connect"):
                source.open()
            with pytest.raises(LinkError, match="is closed"):
                source.read(0.1)
