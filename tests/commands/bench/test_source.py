"""Source: what a page sees is what the device sent; correction and pitch are those of the batch; a lost device comes back."""

import math
import os
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.talking_device import CHANNELS, TalkingDevice, resting
from testkit.waiting import eventually
from undrift import calibrate, correct, random_device, read_record, simulate_session
from undrift.commands.bench.source import LiveDevice
from undrift.errors import InputError, LinkError
from undrift.io.parquet import ParquetWriter
from undrift.model import BodyMounting
from undrift.orientation import OrientStream, sagittal_pitch
from undrift.record import Record, joined
from undrift.sim.device.model import DeviceModel
from undrift.sim.rig.emulator import EmulatedBench, EmulatedBenchSettings
from undrift.sim.rig.stream import StreamSettings


@pytest.fixture
def talker() -> Iterator[TalkingDevice]:
    with TalkingDevice() as device:
        yield device


@pytest.fixture
def source(talker: TalkingDevice) -> Iterator[LiveDevice]:
    made = LiveDevice(talker.address)
    made.start()
    yield made
    made.stop()


def seconds(source: LiveDevice) -> float:
    held = source.updates()
    return held[-1].raw.time[-1] - held[0].raw.time[0] if held else 0.0


def test_recent_readings_are_the_newest_in_the_units_of_the_device(source: LiveDevice):
    eventually(lambda: seconds(source) > 2.0, "two seconds of readings")
    record, last = source.recent(1.0), source.updates()[-1].raw
    assert (source.name, record.gyro_unit, record.accel_unit, record.device) == ("talker", "dps", "m/s2", "talker")
    assert 0.9 < record.duration_s < 1.0
    np.testing.assert_allclose(np.diff(record.time), 0.005, rtol=1e-9)
    steps = np.diff(record.gyro[:, 0])
    assert set(np.round(steps, 4)) == {0.01, -0.49}  # every reading, once
    assert last.time[-1] - record.time[-1] < 0.5
    status = source.status()
    assert status.error == ""
    assert status.sample_rate_hz == pytest.approx(200.0, rel=0.1)  # of a busy machine
    assert status.nominal_rate_hz == 200.0
    assert (status.lost, status.garbled) == (0, 0)
    assert status.temp_c == pytest.approx(25.0 + 1e-4 * status.readings, abs=0.05)


def test_lost_readings_are_counted_and_marked(source: LiveDevice, talker: TalkingDevice):
    talker.leave_out = lambda k: k % 10 == 3
    eventually(lambda: source.status().lost >= 20, "lost readings")
    record = source.recent(1.0)
    gaps = np.isnan(record.gyro[:, 0])
    assert gaps.sum() == pytest.approx(len(record) / 10, abs=2)
    np.testing.assert_allclose(np.diff(record.time), 0.005, rtol=1e-6)


def test_a_silent_device_is_an_error_in_one_line_and_comes_back_by_itself(source: LiveDevice, talker: TalkingDevice):
    eventually(lambda: seconds(source) > 0.5, "readings")
    talker.silent = True
    eventually(lambda: source.error, "an error")
    assert "wanted a" in source.error
    assert "\n" not in source.error
    assert "check that the device sends" in source.error
    assert source.recent(5.0) is None, "old readings are not now"
    assert math.isnan(source.status().sample_rate_hz)
    before, number = source.status().readings, source.updates()[-1].number
    talker.silent = False
    eventually(lambda: not source.error and source.recent(0.2), "a new connection")
    after = source.updates(number)
    eventually(lambda: source.status().readings > before, "readings that go on counting")
    whole = joined([one.raw for one in source.updates()])  # refuses time that steps back
    gap = after[0].raw.time[0] - next(one for one in source.updates() if one.number == number).raw.time[-1]
    assert 1.9 <= gap <= 60.0  # the error comes after 2 s of silence; a busy link holds readings back
    assert np.diff(whole.time).max() == pytest.approx(gap)


def test_a_device_that_hangs_up_is_connected_again(source: LiveDevice, talker: TalkingDevice):
    eventually(lambda: seconds(source) > 0.2, "readings")
    first = source.recorder
    talker.hang_up()
    eventually(lambda: source.recorder is not first, "another recorder")
    eventually(lambda: source.recent(0.2), "readings")
    assert source.error == ""


def test_what_is_no_address_and_who_is_not_there_are_refused(source: LiveDevice):
    with pytest.raises(InputError, match="wanted"):
        LiveDevice("pigeon:loft")
    with pytest.raises(LinkError, match="check power, cable and address"):
        LiveDevice("tcp://127.0.0.1:9?channels=gyro_x,gyro_y,gyro_z&rate=100").start()
    with pytest.raises(InputError, match="wanted a fresh one, got one that was started before; make another"):
        source.start()


def test_a_file_holds_all_that_came_while_it_was_open(
    source: LiveDevice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("undrift.io.parquet.ParquetWriter.write_every_s", 0.5)
    eventually(lambda: seconds(source) > 0.2, "readings")
    path = tmp_path / "live.parquet"
    source.write_to(path)
    assert source.status().file == path
    with pytest.raises(InputError, match=r"wanted to start, got live.parquet still open; stop it first"):
        source.write_to(tmp_path / "other.parquet")
    eventually(lambda: source.status().file_s > 1.7, "three pieces of the file")
    assert not path.exists(), "a file appears whole"
    so_far = read_record(tmp_path / "live.parquet.csv")  # what is there where the process is killed now
    assert source.stop_writing() == path
    assert source.stop_writing() is None
    np.testing.assert_array_equal(so_far.gyro, read_record(path).gyro[: len(so_far)])
    assert (so_far.device, so_far.gyro_unit, so_far.accel_unit) == ("talker", "dps", "m/s2")
    assert so_far.duration_s > 0.9
    record, came = read_record(path), joined([one.raw for one in source.updates()])
    same = came.between(record.time[0], record.time[-1] + 1e-3)
    np.testing.assert_array_equal(record.gyro, same.gyro)
    np.testing.assert_array_equal(record.time, same.time)
    assert record.duration_s > 1.6
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_ends_the_file_with_a_reason_and_the_readings_go_on(
    source: LiveDevice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("undrift.io.parquet.ParquetWriter.write_every_s", 0.3)
    monkeypatch.setattr("undrift.io.text.Appender.write_every_s", 0.3)
    write, calls = ParquetWriter.write, []

    def fill(self: ParquetWriter, record: Record) -> None:
        calls.append(len(record))
        if len(calls) > 2:
            raise InputError("live.parquet: wanted room for 1 MB, got a full disk; make room")
        write(self, record)

    monkeypatch.setattr(ParquetWriter, "write", fill)
    source.write_to(tmp_path / "live.parquet")
    eventually(lambda: source.status().file is None, "the end of the file")
    assert source.status().file_error == "live.parquet: wanted room for 1 MB, got a full disk; make room"
    assert [one.name for one in sorted(tmp_path.iterdir())] == ["live.parquet.csv", "live.parquet.csv.json"]
    assert len(read_record(tmp_path / "live.parquet.csv")) == sum(calls), "what was written before is kept"
    assert source.status().error == ""
    number = source.updates()[-1].number
    eventually(lambda: source.updates(number), "readings")
    source.write_to(tmp_path / "next.parquet")
    assert source.status().file_error == ""


@pytest.mark.parametrize("kind", ["udp", "serial"])
def test_other_ways_than_a_socket_bring_the_same_readings(kind: str):
    lines = [f"{k},{resting(k)}\n".encode() for k in range(400)]
    options = f"channels={CHANNELS}&rate=200&gyro_unit=dps&accel_unit=m/s2"
    with ExitStack() as stack:
        if kind == "serial":
            near, far = os.openpty()
            tty.setraw(far)
            stack.callback(os.close, near)
            stack.callback(os.close, far)
            place, send = f"//{os.ttyname(far)}", lambda line: os.write(near, line)
        else:
            out = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            place, send = f"//127.0.0.1:{port}", lambda line: out.sendto(line, ("127.0.0.1", port))

        def talk() -> None:
            for line in lines:
                send(line)
                time.sleep(0.004)

        source = LiveDevice(f"{kind}:{place}?{options}")
        talker = threading.Thread(target=talk)
        timer = threading.Timer(0.3, talker.start)
        timer.start()
        source.start()
        try:
            eventually(lambda: source.status().readings >= 390, "nearly all readings")
            timer.join()
            talker.join()
        finally:
            source.stop()
        whole = joined([one.raw for one in source.updates()])
        first = round(whole.temp_c[0] * 1e4 - 25e4)
        np.testing.assert_allclose(whole.temp_c, 25.0 + 1e-4 * np.arange(first, first + len(whole)), atol=1e-9)
        assert source.status().lost == 0


def test_a_file_of_nothing_is_no_file(talker: TalkingDevice, tmp_path: Path):
    source = LiveDevice(talker.address)
    source.write_to(tmp_path / "live.parquet")
    assert source.stop_writing() is None
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def device() -> DeviceModel:
    return random_device(np.random.default_rng(7), grade="consumer")


@pytest.mark.slow
def test_corrected_signals_and_orientation_are_those_of_the_batch(device: DeviceModel):
    calibration = calibrate(simulate_session("bench", device, rng=np.random.default_rng(1)))
    settings = EmulatedBenchSettings(device=device, stream=StreamSettings(sample_rate_hz=200.0, framing="frame"))
    with EmulatedBench(settings) as bench:
        source = LiveDevice(bench.device_address)
        source.start()
        try:
            source.set_calibration(calibration)
            assert source.calibration is calibration
            eventually(lambda: any(one.corrected for one in source.updates()), "corrected readings")
            eventually(lambda: source.status().rested_s >= 0.0, "a rest")
            bench.mount("+x")
            eventually(lambda: seconds(source) > 4.0, "four seconds")
        finally:
            source.stop()
        held = [one for one in source.updates() if one.corrected]
        raw, stream = joined([one.raw for one in held]), OrientStream()
        whole = correct(raw, calibration, policy="hold")
        np.testing.assert_array_equal(np.vstack([one.corrected.gyro for one in held]), whole.gyro)
        np.testing.assert_array_equal(np.vstack([one.corrected.accel for one in held]), whole.accel)
        q = np.vstack([one.q_nb for one in held])
        np.testing.assert_allclose(q, stream.push(whole), rtol=0, atol=1e-12)  # roundings of a renewed start
        assert np.isfinite(q[-1]).all()


def test_the_pitch_is_that_of_the_segment_by_the_mounting_until_sides_are_set(source: LiveDevice, device: DeviceModel):
    calibration = calibrate(simulate_session("bench", device, rng=np.random.default_rng(1)))
    gyro, accel = replace(calibration.gyro, unit_in="dps"), replace(calibration.accel, unit_in="m/s2")
    angle = np.radians(30.0)
    matrix = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    worn = BodyMounting(place="thigh", matrix=matrix, covariance=np.eye(3) * 1e-4, basis="stated")
    source.set_calibration(replace(calibration, gyro=gyro, accel=accel, adc=None, mounting=worn))
    assert source.mounting is worn
    eventually(lambda: "pitch of the thigh" in source.status().notes, "a note")
    eventually(lambda: any(one.corrected and one.q_nb is not None for one in source.updates()), "an orientation")
    known = [one for one in source.updates() if one.corrected and one.q_nb is not None][-1]
    np.testing.assert_array_equal(known.pitch, sagittal_pitch(worn.of_body(known.q_nb)))
    source.set_axes("+x", "+z")
    assert source.mounting is None


@pytest.mark.slow
def test_a_calibration_of_another_unit_leaves_the_raw_readings_and_says_why(source: LiveDevice, device: DeviceModel):
    calibration = calibrate(simulate_session("bench", device, rng=np.random.default_rng(1)))
    source.set_calibration(replace(calibration, gyro=replace(calibration.gyro, unit_in="count")))
    eventually(lambda: source.status().correction, "a reason")
    assert "count" in source.status().correction
    number = source.updates()[-1].number
    eventually(lambda: source.updates(number), "raw readings")
    assert source.updates()[-1].corrected is None
    source.set_calibration(None)
    assert source.status().correction == ""


@pytest.mark.slow
def test_a_calibration_of_another_device_is_a_warning_beside_the_corrected_readings(
    source: LiveDevice, device: DeviceModel
):
    made = calibrate(simulate_session("bench", device, rng=np.random.default_rng(1)))
    gyro, accel = replace(made.gyro, unit_in="dps"), replace(made.accel, unit_in="m/s2")
    source.set_calibration(replace(made, device="other", gyro=gyro, accel=accel, adc=None))
    eventually(lambda: source.status().correction, "a warning")
    assert "calibration other" in source.status().correction
    assert "calibration other" not in source.status().notes
    eventually(lambda: source.updates()[-1].corrected is not None, "corrected readings")
