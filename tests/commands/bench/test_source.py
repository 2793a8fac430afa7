"""Source: what a page sees is what the device sent; a lost device comes back."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from testkit.talking_device import TalkingDevice
from testkit.waiting import eventually
from undrift import read_record
from undrift.commands.bench.source import KEEP_S, LiveDevice
from undrift.errors import InputError, LinkError


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
    record = source.recent(KEEP_S)
    return 0.0 if record is None else record.duration_s


def test_recent_readings_are_the_newest_in_the_units_of_the_device(source: LiveDevice):
    eventually(lambda: seconds(source) > 2.0, "two seconds of readings")
    record = source.recent(1.0)
    assert (source.name, record.gyro_unit, record.accel_unit, record.device) == ("talker", "dps", "m/s2", "talker")
    assert 0.9 < record.duration_s < 1.0
    np.testing.assert_allclose(np.diff(record.time), 0.005, rtol=1e-9)
    steps = np.diff(record.gyro[:, 0])
    assert set(np.round(steps, 4)) == {0.01, -0.49}  # every reading, once
    status = source.status()
    assert status.error == ""
    assert status.sample_rate_hz == pytest.approx(200.0, rel=0.1)  # of a busy machine
    assert (status.lost, status.garbled) == (0, 0)
    assert status.temp_c == pytest.approx(25.0 + 1e-4 * status.readings, abs=0.05)


def test_a_silent_device_is_an_error_in_one_line_and_comes_back_by_itself(source: LiveDevice, talker: TalkingDevice):
    eventually(lambda: seconds(source) > 0.5, "readings")
    talker.silent = True
    eventually(lambda: source.error, "an error")
    assert "reading" in source.error
    assert "\n" not in source.error
    assert "Check that" in source.error
    assert source.recent(5.0) is None, "old readings are not now"
    assert math.isnan(source.status().sample_rate_hz)
    before = source.status().readings
    talker.silent = False
    eventually(lambda: not source.error and source.recent(0.2), "a new connection")
    eventually(lambda: source.status().readings > before, "readings that go on counting")
    whole = source.recent(KEEP_S)  # refuses time that steps back
    assert (
        1.9 <= np.diff(whole.time).max() <= 60.0
    )  # the error comes after 2 s of silence; a busy link holds readings back


def test_what_is_no_address_and_who_is_not_there_are_refused(source: LiveDevice):
    with pytest.raises(InputError, match="expected"):
        LiveDevice("pigeon:loft")
    with pytest.raises(LinkError, match="Check power"):
        LiveDevice("tcp://127.0.0.1:9?channels=gyro_x,gyro_y,gyro_z&rate=100").start()
    with pytest.raises(InputError, match="was started before"):
        source.start()


def test_a_file_holds_all_that_came_while_it_was_open(
    source: LiveDevice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("undrift.io.text.Appender.write_every_s", 0.5)
    eventually(lambda: seconds(source) > 0.2, "readings")
    path = tmp_path / "live.csv"
    source.write_to(path)
    assert source.status().file == path
    with pytest.raises(InputError, match=r"live.csv is still being recorded"):
        source.write_to(tmp_path / "other.csv")
    eventually(lambda: source.status().file_s > 1.7, "three pieces of the file")
    so_far = read_record(path)  # what is there if the process is killed now
    assert source.stop_writing() == path
    assert source.stop_writing() is None
    record, came = read_record(path), source.recent(KEEP_S)
    np.testing.assert_array_equal(so_far.gyro, record.gyro[: len(so_far)])
    assert so_far.duration_s > 0.9
    same = came.between(record.time[0], record.time[-1] + 1e-3)
    np.testing.assert_array_equal(record.gyro, same.gyro)
    np.testing.assert_array_equal(record.time, same.time)
    assert record.duration_s > 1.6
    assert list(tmp_path.iterdir()) == [path]
