"""Dwells: no reading that the device took before the start enters, however late it comes. All times are scripted."""

import itertools

import numpy as np
import pytest

from testkit.byte_sender import Paced, Sender
from testkit.virtual_clock import VirtualClock
from testkit.waiting import LONG_S
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.recorder import DwellReadings, Recorder
from undrift.live.transports import source_at

RATE = 100.0
CONNECTED = 50.0  # host s


THREE = "?channels=count,gyro_x,gyro_y,gyro_z&rate=100"


class Bench:
    """Dwells of a device that takes reading k, of value k, at k / RATE s of the host.

    A step contains the time of the last reading of a packet, and the time at which that packet arrives, host s.
    """

    def __init__(self, steps, deadline_s=LONG_S):
        pieces, sent = [], 0
        for taken, arrival in itertools.takewhile(lambda step: step[1] < CONNECTED + 20.0, steps):
            last = int(np.floor(taken * RATE + 1e-9))
            pieces.append((arrival - CONNECTED, b"".join(b"%d,%d,0,0\n" % (k, k) for k in range(sent + 1, last + 1))))
            sent = last
        self.clock = VirtualClock()
        self.clock.jump(CONNECTED)
        device = Paced(self.clock, pieces)
        source = source_at(f"tcp://127.0.0.1:{device.port}{THREE}", clock=self.clock)
        self.recorder = Recorder(source, silence_s=LONG_S, clock=self.clock)
        self.dwells = DwellReadings(self.recorder, deadline_s)

    def __enter__(self):
        self.recorder.start()
        return self

    def __exit__(self, *failure):
        self.recorder.stop()

    def dwell(self, start, length):
        """Return when the readings of a dwell were taken, and how long its start waited, s from the start."""
        self.clock.wait(start - self.clock.now())
        began = self.clock.now()
        self.dwells.start()
        waited = self.clock.now() - began
        self.clock.wait(length)
        return self.dwells.stop().gyro[:, 0] / RATE - began, waited


def backlog(behind_s, speed, packet_s=0.02, jitter_s=0.004, latency_s=0.002):
    """Deliver what the device kept from before the connection, then what it takes, each packet a little late."""
    rng = np.random.default_rng(1)
    host, taken = CONNECTED, CONNECTED - behind_s
    while True:
        host += packet_s
        taken = min(taken + speed * packet_s, host)
        late = latency_s + rng.exponential(jitter_s) if taken == host else 0.0
        yield taken, host + late


def test_a_backlog_from_before_the_start_does_not_enter_a_dwell():
    with Bench(backlog(behind_s=3.0, speed=4.0)) as bench:  # drains for 1 s
        taken, waited = bench.dwell(CONNECTED + 0.1, 0.5)  # over, by a clock of the first packets, while it drains
        assert taken[0] >= 0.0
        assert taken[-1] - taken[0] >= 0.5 - 0.05
        assert 0.9 < waited < 1.5
        taken, waited = bench.dwell(CONNECTED + 3.0, 0.5)
        assert taken[0] >= 0.0
        assert waited < 0.15
        taken, waited = bench.dwell(CONNECTED + 6.0, 0.5)
        assert taken[0] >= 0.0


@pytest.mark.parametrize("late_s", [0.05, 0.3])
def test_a_clock_known_from_late_packets_alone_does_not_open_a_dwell_early(late_s):
    def steps():
        rng = np.random.default_rng(2)
        taken = arrived = CONNECTED
        while True:
            taken += 0.02
            late = late_s * rng.uniform(0.2, 1.0) if taken < CONNECTED + 1.5 else 0.0
            arrived = max(arrived + 1e-4, taken + late)
            yield taken, arrived

    with Bench(steps()) as bench:
        taken, _ = bench.dwell(CONNECTED + 0.5, 0.5)
        assert taken[0] >= 0.0
        assert taken[-1] - taken[0] >= 0.4


def test_what_comes_after_the_start_checks_it_again():
    """All packets are late by 0.3 s, which nobody can see, until one in the middle of the dwell is prompt."""

    def steps():
        host = CONNECTED
        while True:
            host += 0.02
            yield (host - 0.3 if host < CONNECTED + 1.5 else host), host

    with Bench(steps()) as bench:
        taken, _ = bench.dwell(CONNECTED + 1.0, 2.0)
        assert taken[0] >= 0.0
        assert taken[-1] > 1.8


def test_a_stream_that_goes_on_catching_up_opens_no_dwell():
    with Bench(backlog(behind_s=45.0, speed=1.5), deadline_s=0.3) as bench:
        bench.clock.wait(1.0)
        with pytest.raises(RigTimeout, match=r"certainly later .*within 0.3 s, got a backlog"):
            bench.dwells.start()


def paced(rows: int, period_s: float = 0.01, skip=()):
    return [(k * period_s, b"%d,%d,2,3\n" % (k, k)) for k in range(rows) if k not in skip]


def on_virtual_clock(pieces, *, keep_s: float = 600.0, hang_up: bool = False):
    """Return a recorder of a device that sends pieces when they are due, and their clock."""
    clock = VirtualClock()
    device = Paced(clock, pieces, hang_up)
    source = source_at(f"tcp://127.0.0.1:{device.port}{THREE}", clock=clock)
    return Recorder(source, silence_s=1.0, keep_s=keep_s, clock=clock), clock


def test_dwells_follow_each_other():
    recorder, clock = on_virtual_clock(paced(300))
    with recorder:
        dwells = DwellReadings(recorder)
        with pytest.raises(InputError, match=r"no dwell"):
            dwells.stop()
        records = []
        for _ in range(2):
            dwells.start()
            clock.wait(0.1)
            records.append(dwells.stop())
        assert records[0].time[-1] < records[1].time[0]
        assert dwells.latest().endswith("gyro_y 2  gyro_z 3")
        dwells.close()


def test_drop_outs_are_rows_of_nan_in_dwells():
    recorder, clock = on_virtual_clock(paced(300, skip=(20, 21, 22)))
    with recorder:
        assert clock.until(lambda: recorder.timeline.readings > 200, 60.0)
        begin = recorder.timeline.clock().host_time(0.0)
        record = recorder.between(begin + 0.1, begin + 0.4)
        recorder.stop()
    assert np.isnan(record.gyro[:, 0]).sum() == 3
    assert recorder.timeline.marker.missing == 3
    assert np.diff(np.flatnonzero(np.isnan(record.gyro[:, 0]))).tolist() == [1, 1]
    assert np.diff(record.time) == pytest.approx(0.01)


def test_a_device_that_never_sends_is_a_timeout_and_nothing_keeps_running():
    with Sender([b"rubbish\n" * 9]) as device:
        recorder = Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), silence_s=1.0)
        with pytest.raises(RigTimeout, match=r"no reading within 1 s, got 72 bytes"):
            recorder.start()
        assert recorder.timeline.readings == 0
        with pytest.raises(InputError, match=r"was started before"):
            recorder.start()


@pytest.mark.parametrize(
    ("hang_up", "error", "words"),
    [(False, RigTimeout, "got nothing"), (True, LinkError, "link is lost .the other side")],
)
def test_a_device_that_sends_no_more_is_told(hang_up, error, words):
    recorder, _ = on_virtual_clock(paced(30), hang_up=hang_up)
    with recorder:
        with pytest.raises(error, match=words):
            recorder.between(recorder.now(), recorder.now() + 60.0)
        for ask in (recorder.check, recorder.latest):
            with pytest.raises(error, match=words):
                ask()
        recorder.stop()
    assert recorder.timeline.readings == 30


def test_what_is_no_longer_kept_is_refused():
    recorder, _ = on_virtual_clock(paced(3000), keep_s=0.1)
    with recorder:
        start = recorder.now()
        with pytest.raises(InputError, match=r"stores only 0.1"):
            recorder.between(start, start + 0.4)


def test_readings_since_a_device_time_are_returned():
    recorder, clock = on_virtual_clock(paced(300, 0.005))
    with recorder:
        assert clock.until(lambda: recorder.timeline.readings == 300, 60.0), "all readings"
        assert recorder.since(0.495).gyro[:, 0].tolist() == list(range(50, 300))
        assert recorder.since(2.985) is None, "one reading is no record"


def test_times_without_readings_are_refused():
    recorder, _ = on_virtual_clock(paced(500))
    with pytest.raises(InputError, match="no reading yet"):
        recorder.latest()
    with recorder:
        now = recorder.now()
        with pytest.raises(InputError, match="start must be before"):
            recorder.between(now, now)
        with pytest.raises(RigTimeout, match=r"of 0.001 s, got [01]"):
            recorder.between(now, now + 0.001)
