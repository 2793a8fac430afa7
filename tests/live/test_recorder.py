"""Recorder: nothing is lost between reader and disk; a dwell is what came between two moments; every failure is told."""

import binascii
import struct
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from testkit.byte_sender import Sender
from testkit.waiting import eventually
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.io.parquet import read_parquet
from undrift.live import recorder as pieces_module
from undrift.live import recorder as writer_module
from undrift.live.clock import Block
from undrift.live.decoder import StreamDescription
from undrift.live.recorder import (
    DwellReadings,
    PieceWriter,
    Recorder,
    RecorderSettings,
    next_connection,
    piece_path,
    write_synced,
)
from undrift.live.transports import source_at

TEN = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,mag_x,mag_y,mag_z,temp"
THREE = "?channels=count,gyro_x,gyro_y,gyro_z&rate=100"
QUICK = RecorderSettings(silence_s=1.0, piece_s=0.2)
PIECES = RecorderSettings(silence_s=60.0, piece_s=0.2)


def pieces_of(folder, connection=1):
    """Read the pieces of one connection in their order."""
    return [read_parquet(path).record for path in sorted(folder.glob(f"live-{connection:02d}-?????.parquet"))]


def read_pieces(folder, connection=1):
    """Read one connection as one record."""
    pieces = pieces_of(folder, connection)
    channels = {
        name: None if getattr(pieces[0], name) is None else np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ("time", "gyro", "accel", "temp_c", "mag_ut")
    }
    return replace(pieces[0], **channels)


def frames_of(values: np.ndarray) -> bytes:
    body = struct.Struct("<I10h")
    made = []
    for count, row in enumerate(values.tolist()):
        packed = body.pack(count, *row)
        made.append(b"\xaa\x55" + packed + struct.pack("<H", binascii.crc_hqx(packed, 0xFFFF)))
    return b"".join(made)


def paced(rows: int, period_s: float = 0.01, skip=()):
    start = time.monotonic()
    for k in range(rows):
        time.sleep(max(start + k * period_s - time.monotonic(), 0.0))
        if k not in skip:
            yield b"%d,%d,2,3\n" % (k, k)


def test_ten_minutes_at_two_kilohertz_and_ten_channels_reach_the_disk_without_a_loss(tmp_path):
    rng = np.random.default_rng(0)
    block = rng.integers(-250, 250, (12_000, 10))
    rows = 1_200_000
    values = np.tile(block, (100, 1))
    body = np.zeros(rows, dtype=[("sync", "V2"), ("count", "<u4"), ("values", "<i2", 10), ("crc", "<u2")])
    body["sync"], body["count"], body["values"] = np.void(b"\xaa\x55"), np.arange(rows), values
    raw = body.view("u1").reshape(rows, -1)
    body["crc"] = [binascii.crc_hqx(row, 0xFFFF) for row in raw[:, 2:26]]
    data = body.tobytes()
    pieces = [data[a : a + 262_144] for a in range(0, len(data), 262_144)]
    query = f"?format=frame&pack=<I10h&checksum=crc16&rate=2000&temp_scale=0.1&channels={TEN}"
    with Sender(pieces) as device:
        start = time.monotonic()
        with Recorder(source_at(f"tcp://127.0.0.1:{device.port}{query}"), tmp_path) as recorder:
            while recorder.tally().readings < rows and time.monotonic() < start + 300.0:
                time.sleep(0.02)
            tally = recorder.stop()
    assert (tally.readings, tally.written, tally.missing, tally.garbled, tally.late) == (rows, rows, 0, 0, 0)
    record = read_pieces(tmp_path)
    assert np.array_equal(record.gyro, values[:, :3])
    assert np.array_equal(record.accel, values[:, 3:6])
    assert np.array_equal(record.mag_ut, values[:, 6:9])
    assert record.temp_c == pytest.approx(values[:, 9] * 0.1)
    assert record.time == pytest.approx(np.arange(rows) / 2000.0)
    assert tally.pieces > 30


def test_a_disk_slower_than_the_device_makes_the_sender_wait_and_loses_nothing(tmp_path, monkeypatch):
    slow = write_synced

    def tardy(record, path):
        time.sleep(0.02)
        slow(record, path)

    monkeypatch.setattr(writer_module, "write_synced", tardy)
    monkeypatch.setattr(writer_module, "QUEUE_BLOCKS", 2)
    data = frames_of(np.random.default_rng(1).integers(-250, 250, (20_000, 10)))
    query = f"?format=frame&pack=<I10h&checksum=crc16&rate=2000&temp_scale=0.1&channels={TEN}"
    settings = RecorderSettings(piece_s=0.5)
    with (
        Sender([data[a : a + 3000] for a in range(0, len(data), 3000)]) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{query}"), tmp_path, settings) as recorder,
    ):
        end = time.monotonic() + 120.0
        while recorder.tally().readings < 20_000 and time.monotonic() < end:
            time.sleep(0.01)
        assert recorder.stop().written == 20_000
    assert len(read_pieces(tmp_path)) == 20_000


def test_a_dwell_is_what_came_between_two_moments():
    with Sender(paced(300)) as device, Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}")) as recorder:
        eventually(lambda: recorder.tally().readings > 200, "200 readings, some of them prompt")
        begin = recorder.tally().clock.host_time(0.0)
        record = recorder.between(begin + 0.205, begin + 0.405)
        assert record.gyro[:, 0].tolist() == pytest.approx(np.arange(21, 41), abs=2)
        assert record.gyro[:, 0] == pytest.approx(record.time * 100.0)
        assert 18 <= len(record) <= 22
        assert record.gyro_unit == "count"


def test_dwells_follow_each_other():
    with Sender(paced(300)) as device, Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}")) as recorder:
        dwells = DwellReadings(recorder)
        with pytest.raises(InputError, match=r"dwell: wanted one that was started, got none; start it first"):
            dwells.stop()
        records = []
        for _ in range(2):
            dwells.start()
            time.sleep(0.1)
            records.append(dwells.stop())
        assert records[0].time[-1] < records[1].time[0]
        assert dwells.latest().endswith("gyro_y 2  gyro_z 3")
        dwells.close()


def test_drop_outs_are_rows_of_nan_in_dwells_and_on_the_disk(tmp_path):
    with (
        Sender(paced(300, skip=(20, 21, 22))) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path, PIECES) as recorder,
    ):
        eventually(lambda: recorder.tally().readings > 200, "200 readings, some of them prompt")
        begin = recorder.tally().clock.host_time(0.0)
        record = recorder.between(begin + 0.1, begin + 0.4)
        tally = recorder.stop()
    assert np.isnan(record.gyro[:, 0]).sum() == 3
    assert (tally.missing, tally.gaps) == (3, 1)
    written = read_pieces(tmp_path)
    assert np.flatnonzero(np.isnan(written.gyro[:, 0])).tolist() == [20, 21, 22]
    assert np.diff(written.time) == pytest.approx(0.01)


def test_a_device_that_never_sends_is_a_timeout_and_nothing_keeps_running():
    with Sender([b"rubbish\n" * 9]) as device:
        recorder = Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), settings=QUICK)
        with pytest.raises(RigTimeout, match=r"wanted a reading within 0.2 s"):
            recorder.start()
        assert recorder.tally().readings == 0
        assert recorder.tally().clock is None
        with pytest.raises(InputError, match=r"wanted a fresh one, got one that was started before; make another"):
            recorder.start()


def test_a_device_that_falls_silent_is_told_and_what_came_is_on_the_disk(tmp_path):
    with (
        Sender(paced(30)) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path, QUICK) as recorder,
    ):
        with pytest.raises(RigTimeout, match=r"got nothing; check that the device sends"):
            recorder.between(recorder.now(), recorder.now() + 60.0)
        with pytest.raises(RigTimeout, match=r"got nothing"):
            recorder.check()
        recorder.stop()
    assert len(read_pieces(tmp_path)) == 30


def test_a_device_that_hangs_up_is_told(tmp_path):
    with (
        Sender(paced(30), hang_up=True) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path, QUICK) as recorder,
    ):
        with pytest.raises(LinkError, match=r"got a lost link: the other side closed the connection"):
            recorder.between(recorder.now(), recorder.now() + 60.0)
        with pytest.raises(LinkError, match=r"lost link"):
            recorder.latest()
    assert next_connection(tmp_path) == 2


def test_readings_that_do_not_come_in_time_are_a_timeout():
    with Sender(paced(500)) as device, Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}")) as recorder:
        now = recorder.now()
        with pytest.raises(InputError, match=r"wanted a start before the stop"):
            recorder.between(now, now)
        with pytest.raises(InputError, match=r"wanted two or more in 0.001 s, got [01]; dwell longer"):
            recorder.between(now, now + 0.001)


def test_a_stopped_recorder_does_not_let_anybody_wait():
    with Sender(paced(500)) as device, Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}")) as recorder:
        recorder.stop()
        with pytest.raises(
            LinkError, match=r"wanted readings up to the end of a dwell, got a recorder that was stopped"
        ):
            recorder.between(recorder.now(), recorder.now() + 5.0)


def test_what_is_no_longer_kept_is_refused():
    settings = RecorderSettings(keep_s=0.1)
    with (
        Sender(paced(3000)) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), settings=settings) as recorder,
    ):
        start = recorder.now()
        with pytest.raises(InputError, match=r"got a recorder that keeps 0.1 device seconds; keep more"):
            recorder.between(start, start + 0.4)


def test_the_newest_reading_is_asked_of_a_started_recorder():
    with pytest.raises(InputError, match=r"wanted the newest, got none yet; start the recorder"):
        Recorder(source_at(f"tcp://127.0.0.1:9{THREE}")).latest()


def test_waits_without_end_are_refused():
    with pytest.raises(InputError, match=r"recorder: wanted silence_s above 0, got 0; every wait has an end"):
        RecorderSettings(silence_s=0)


def test_a_full_disk_is_told_and_the_reader_stops(tmp_path, monkeypatch):
    def full(record, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pieces_module, "write_parquet", full)
    with (
        Sender(paced(500)) as device,
        Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path, QUICK) as recorder,
        pytest.raises(
            InputError, match=r"live-01-00001.parquet: wanted to write readings, got 'No space left on device'"
        ),
    ):
        recorder.between(recorder.now(), recorder.now() + 60.0)
    assert not list(tmp_path.iterdir())


def test_a_disk_that_is_full_at_the_very_end_is_told_once(tmp_path, monkeypatch):
    def full(record, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pieces_module, "write_parquet", full)
    with Sender(paced(20)) as device:
        recorder = Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path)
        recorder.start()
        time.sleep(0.1)
        with pytest.raises(InputError, match=r"wanted to write readings, got 'No space left on device'"):
            recorder.stop()
        assert recorder.stop().written == 0


def test_a_folder_that_cannot_be_is_refused_and_nothing_keeps_running(tmp_path):
    (tmp_path / "file").write_text("")
    with Sender(paced(10)) as device:
        recorder = Recorder(source_at(f"tcp://127.0.0.1:{device.port}{THREE}"), tmp_path / "file")
        with pytest.raises(InputError, match=r"file: wanted a folder, got 'File exists'; choose another"):
            recorder.start()


def block(first, count):
    return Block(np.arange(first, first + count) * 0.01, np.full((count, 3), float(first)))


def description():
    return StreamDescription(channels=("gyro_x", "gyro_y", "gyro_z"), rate=100.0)


def test_every_row_is_written_once_however_the_blocks_are_cut(tmp_path):
    for connection, cuts in enumerate(([2], [1, 1], [10, 1], [9, 1, 1], [1] * 25, [25], [10, 10, 1]), start=1):
        writer = PieceWriter(tmp_path, description(), 10)
        at = 0
        for count in cuts:
            writer.put(block(at, count), 1.0)
            at += count
        writer.stop(5.0)
        writer.stop(5.0)
        assert read_pieces(tmp_path, connection).time == pytest.approx(np.arange(at) * 0.01), cuts


def test_a_disk_that_hangs_is_told(tmp_path, monkeypatch):
    hangs, mended = threading.Event(), threading.Event()

    def write(record, path):
        hangs.set()
        mended.wait(60.0)

    monkeypatch.setattr(writer_module, "write_synced", write)
    monkeypatch.setattr(writer_module, "QUEUE_BLOCKS", 1)
    writer = PieceWriter(tmp_path, description(), 4)
    writer.put(block(0, 4), 60.0)
    assert hangs.wait(60.0)
    writer.put(block(4, 4), 60.0)
    with pytest.raises(RigTimeout, match=r"wanted room for readings within 0.05 s, got a disk that does not keep up"):
        writer.put(block(8, 4), 0.05)
    with pytest.raises(LinkError, match=r"wanted the last readings written in 0.01 s, got no end; check the disk"):
        writer.stop(0.01)
    mended.set()
    writer.stop(60.0)


def test_half_written_pieces_are_left_aside(tmp_path):
    record = description().record(np.arange(3.0), np.ones((3, 3)))
    write_synced(record, piece_path(tmp_path, 1, 1))
    (tmp_path / "live-01-00002.parquet.new.part").write_bytes(b"PAR1half")
    assert [len(piece) for piece in pieces_of(tmp_path)] == [3]
    assert read_parquet(piece_path(tmp_path, 1, 1)).record.state == "raw"
    assert next_connection(tmp_path / "none") == 1
