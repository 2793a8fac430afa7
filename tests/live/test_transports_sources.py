"""Sources: the same readings by every way, and every way that is lost says so; no wait without end."""

import contextlib
import os
import socket
import threading
import time

import numpy as np
import pytest

from testkit.byte_sender import Sender
from testkit.pseudo_terminal import open_pseudo_terminal
from testkit.waiting import eventually
from undrift.errors import LinkError, RigTimeout
from undrift.live.decoder import StreamDescription
from undrift.live.transports import LslSource, lsl_streams, source_at

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
        found += source.read(30.0).counter.tolist()
    return found


def test_readings_come_over_tcp_stamped_with_the_hosts_time():
    with Sender([TEXT]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        before = time.monotonic()
        chunk = source.read(30.0)
        assert chunk.counter.tolist() == [0, 1, 2, 3, 4]
        assert chunk.values[0].tolist() == [1, 2, 3]
        assert before <= chunk.host_time[0] <= time.monotonic()


def test_a_device_that_hangs_up_is_a_lost_link_and_can_be_opened_again():
    with Sender([TEXT], hang_up=True) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        counts(source)
        with pytest.raises(LinkError, match=r"link is lost .the other side"):
            source.read(30.0)


def test_silence_and_rubbish_are_timeouts_that_say_which():
    with Sender([b""]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        start = time.monotonic()
        with pytest.raises(RigTimeout, match=r"within 0.1 s, got nothing"):
            source.read(0.1)
        assert time.monotonic() - start < 15.0
    with Sender([b"x\n" * 50]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        told = []

        def rubbish_came():
            with pytest.raises(RigTimeout) as silent:
                source.read(0.2)
            told.append(str(silent.value))
            return "bytes" in told[-1]

        eventually(rubbish_came, "rubbish")
        assert "got 100 bytes without a reading" in told[-1]
        assert source.errors == 49  # the first may have been under way


def test_nobody_there_is_a_lost_link():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(LinkError, match=r"cannot connect .*refused"):
        source_at(f"tcp://127.0.0.1:{port}{OPTIONS}").open()


def test_a_source_that_is_not_open_does_not_read():
    with pytest.raises(LinkError, match=r"link is closed"):
        source_at(f"tcp://127.0.0.1:9{OPTIONS}").read(0.1)


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
        with pytest.raises(RigTimeout, match=r"got nothing"):
            source.read(0.05)


def test_a_udp_port_that_is_taken_is_a_lost_link():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match=r"udp://127.0.0.1:\d+: cannot connect"):
            source_at(f"udp://127.0.0.1:{taken.getsockname()[1]}{OPTIONS}").open()


def test_readings_come_over_a_serial_line():
    ours, theirs = open_pseudo_terminal()
    try:
        with opened(f"serial://{os.ttyname(theirs)}{OPTIONS}&baud=115200") as source:
            os.write(ours, TEXT)
            assert counts(source) == [0, 1, 2, 3, 4]
            with pytest.raises(RigTimeout, match=r"got nothing"):
                source.read(0.05)
    finally:
        os.close(ours)
        os.close(theirs)


def test_a_serial_port_that_is_not_there_is_a_lost_link():
    with pytest.raises(LinkError, match=r"serial:/dev/none: cannot connect"):
        source_at(f"serial:///dev/none{OPTIONS}").open()


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
    chunk = source.read(1.0)
    assert chunk.counter.tolist() == [7.5, 7.51]
    assert chunk.values.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert source.description.tick_s == 1.0
    source.close()
    source.close()
    assert inlet.closed == 1


def test_an_lsl_stream_of_another_width_or_that_ends_says_so():
    inlet = FakeInlet(([[1.0, 2.0], [1.0, float("inf"), 0.0]], [7.5, 7.6]))
    source = LslSource("lsl:imu", PLAIN, lambda: inlet)
    with pytest.raises(LinkError, match=r"stream is closed"):
        source.read(0.1)
    source.open()
    with pytest.raises(RigTimeout, match=r"got 2 samples of another width than 3"):
        source.read(0.01)
    inlet.pulls.append(RuntimeError("the stream has been lost"))
    with pytest.raises(LinkError, match=r"stream is lost"):
        source.read(0.1)


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
            assert source.read(5.0).values[0].tolist() == [1, 2, 3]
        assert (name, "IMU, 3 channels, 100 Hz") in lsl_streams()
    finally:
        stop.set()
        sender.join()


def test_chunks_hold_what_they_say():
    with Sender([TEXT]) as device, opened(f"tcp://127.0.0.1:{device.port}{OPTIONS}") as source:
        chunk = source.read(30.0)
        assert len(chunk) == len(chunk.values) == len(chunk.host_time) == 5
        assert np.isfinite(chunk.values).all()


@pytest.mark.slow
@pytest.mark.parametrize("way", ["udp", "serial"])
def test_ten_channels_at_2_khz_from_a_sender_that_does_not_wait_lose_nothing(way):
    rate, burst = 2000, 20  # as a device would: 20 readings every 10 ms, whether they are taken or not
    channels = ",".join(["count", *(f"{kind}_{axis}" for kind in ("gyro", "accel", "mag") for axis in "xyz")])
    options = f"?channels={channels}&rate={rate}"
    tries = []
    while len(tries) < 6 and (
        not tries or tries[-1] is not None
    ):  # a busy machine may not run the reader; not six times
        tries.append(lost(way, options, rate, burst, total=2 * rate))
    assert tries[-1] is None, tries


def lost(way, options, rate, burst, total):
    """Play readings to a source; return None where each came, else what did."""
    device, sender = paced_sender(way)
    with opened(device + options) as source:
        send, close = sender()
        refused = []

        def play():
            for first in range(0, total, burst):
                time.sleep(burst / rate)  # never faster than the device, however late it is
                for k in range(first, first + burst):
                    try:
                        send(b"%d," % k + b",".join(b"%d.%03d" % (k % 90, n) for n in range(9)) + b"\n")
                    except BlockingIOError:
                        refused.append(k)

        thread = threading.Thread(target=play)
        thread.start()
        found = []
        try:
            while thread.is_alive() or found[-1:] != [total - 1]:
                try:
                    found += source.read(0.5).counter.astype(int).tolist()
                except RigTimeout:
                    if not thread.is_alive():
                        break  # the end is among what was lost
        finally:
            thread.join(60.0)
            close()
        # the first may have been under way when the port was opened
        whole = found[:1] in ([0], [1]) and found == list(range(found[0], total)) and source.errors <= 1
        return None if whole else (len(found), len(refused), source.errors)


def paced_sender(way):
    """Return a device's address and what makes its sender: a call per line that never waits for the reader, and an end."""
    if way == "udp":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]

        def sender():
            out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            return lambda line: out.sendto(line, ("127.0.0.1", port)), out.close

        return f"udp://127.0.0.1:{port}", sender
    ours, theirs = open_pseudo_terminal()
    os.set_blocking(ours, False)  # what the port cannot take is an error here, not a pause

    def end():
        os.close(ours)
        os.close(theirs)

    return f"serial://{os.ttyname(theirs)}", lambda: (lambda line: os.write(ours, line), end)
