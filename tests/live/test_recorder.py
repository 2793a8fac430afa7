"""Recorder: nothing is lost; a dwell is what came between two moments; every failure is told."""

import binascii
import time

import numpy as np
import pytest

from testkit.byte_sender import Paced, Sender
from testkit.virtual_clock import VirtualClock
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.recorder import DwellReadings, Recorder
from undrift.live.transports import source_at

TEN = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,mag_x,mag_y,mag_z,temp"
THREE = "?channels=count,gyro_x,gyro_y,gyro_z&rate=100"


def paced(rows: int, period_s: float = 0.01, skip=()):
    return [(k * period_s, b"%d,%d,2,3\n" % (k, k)) for k in range(rows) if k not in skip]


def on_virtual_clock(pieces, *, keep_s: float = 600.0, hang_up: bool = False):
    """Return a recorder of a device that sends pieces when they are due, and their clock."""
    clock = VirtualClock()
    device = Paced(clock, pieces, hang_up)
    source = source_at(f"tcp://127.0.0.1:{device.port}{THREE}", clock=clock)
    return Recorder(source, silence_s=1.0, keep_s=keep_s, clock=clock), clock


@pytest.mark.slow
@pytest.mark.parametrize("minutes", [1, 10])
def test_minutes_at_two_kilohertz_and_ten_channels_come_without_a_loss(minutes):
    rng = np.random.default_rng(0)
    block = rng.integers(-250, 250, (12_000, 10))
    rows = 120_000 * minutes
    values = np.tile(block, (10 * minutes, 1))
    body = np.zeros(rows, dtype=[("sync", "V2"), ("count", "<u4"), ("values", "<i2", 10), ("crc", "<u2")])
    body["sync"], body["count"], body["values"] = np.void(b"\xaa\x55"), np.arange(rows), values
    raw = body.view("u1").reshape(rows, -1)
    body["crc"] = [binascii.crc_hqx(row, 0xFFFF) for row in raw[:, 2:26]]
    data = body.tobytes()
    pieces = [data[a : a + 262_144] for a in range(0, len(data), 262_144)]
    query = f"?format=frame&pack=<I10h&checksum=crc16&rate=2000&temp_scale=0.1&channels={TEN}"
    with Sender(pieces) as device:
        start = time.monotonic()
        with Recorder(source_at(f"tcp://127.0.0.1:{device.port}{query}")) as recorder:
            while recorder.timeline.readings < rows and time.monotonic() < start + 300.0:
                time.sleep(0.02)
            fit = recorder.timeline.clock()
            record = recorder.between(fit.host_time(-1.0), fit.host_time((rows - 1) / 2000.0))
            timeline, garbled = recorder.timeline, recorder.source.errors
    assert (timeline.readings, timeline.marker.missing, garbled) == (rows, 0, 0)
    assert np.array_equal(record.gyro, values[:, :3])
    assert np.array_equal(record.accel, values[:, 3:6])
    assert np.array_equal(record.mag_ut, values[:, 6:9])
    assert record.temp_c == pytest.approx(values[:, 9] * 0.1)
    assert record.time == pytest.approx(np.arange(rows) / 2000.0)


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
        with pytest.raises(RigTimeout, match=r"no reading within 0.2 s"):
            recorder.start()
        assert recorder.timeline.readings == 0
        with pytest.raises(InputError, match=r"was started before"):
            recorder.start()


def test_a_device_that_falls_silent_is_told():
    recorder, _ = on_virtual_clock(paced(30))
    with recorder:
        with pytest.raises(RigTimeout, match=r"got nothing"):
            recorder.between(recorder.now(), recorder.now() + 60.0)
        with pytest.raises(RigTimeout, match=r"got nothing"):
            recorder.check()
        recorder.stop()
    assert recorder.timeline.readings == 30


def test_a_device_that_hangs_up_is_told():
    recorder, _ = on_virtual_clock(paced(30), hang_up=True)
    with recorder:
        with pytest.raises(LinkError, match=r"link is lost .the other side"):
            recorder.between(recorder.now(), recorder.now() + 60.0)
        with pytest.raises(LinkError, match=r"is lost"):
            recorder.latest()


def test_readings_that_do_not_come_in_time_are_a_timeout():
    recorder, _ = on_virtual_clock(paced(500))
    with recorder:
        now = recorder.now()
        with pytest.raises(InputError, match=r"start must be before"):
            recorder.between(now, now)
        with pytest.raises(InputError, match=r"in 0.001 s, got [01]"):
            recorder.between(now, now + 0.001)


def test_a_stopped_recorder_does_not_let_anybody_wait():
    recorder, _ = on_virtual_clock(paced(500))
    with recorder:
        recorder.stop()
        with pytest.raises(LinkError, match=r"recorder was stopped"):
            recorder.between(recorder.now(), recorder.now() + 5.0)


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


def test_what_came_before_a_link_was_lost_is_returned_before_the_loss_is_raised():
    recorder, clock = on_virtual_clock(paced(20), hang_up=True)
    with recorder:
        clock.wait(1.0)
        record = recorder.since()
        assert record is not None
        np.testing.assert_array_equal(record.gyro[:, 0], np.arange(20.0))
        with pytest.raises(LinkError, match="link is lost"):
            recorder.since(record.time[-1])
