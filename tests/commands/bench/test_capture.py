"""What a guided capture keeps and writes: what is captured, little else, one recording for each stretch without a gap."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.guided import HandFeed, capture_faces
from undrift.calibration.calibrate import calibrate
from undrift.commands.bench.capture import KEEP_S, Capture
from undrift.commands.bench.guides import SixFaces
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.record import Record
from undrift.sim.device.presets import random_device


def kept_s(capture):
    return sum(float(chunk.time[-1] - chunk.time[0]) for chunk in capture._readings)


@pytest.fixture
def guide(tmp_path):
    return SixFaces(Capture(tmp_path / "session", serial="A17", gravity_m_s2=9.81))


@pytest.mark.slow
def test_a_lost_connection_begins_another_recording_and_all_of_them_calibrate(guide):
    with HandFeed(seed=5) as feed:
        feed.held.lay("+x")
        feed.watch(guide, 12.0)
    with HandFeed(seed=5) as feed:  # its clock begins at zero again
        capture_faces(feed, guide)
    guide.capture.save()
    session = read_session(guide.capture.folder)
    assert len(session.records) == 2
    assert {still.recording for still in session.stills if still.face == "+x"} == {0}
    assert calibrate(session).accel.method == "six-face/affine"
    guide.redo("+x")
    with HandFeed(seed=5) as feed:
        feed.held.lay("+x")
        feed.watch(guide, 14.0)
    guide.capture.save()
    assert len(read_session(guide.capture.folder).records) == 2
    assert sorted(path.name for path in guide.capture.folder.iterdir()) == [
        "recording_0.parquet",
        "recording_1.parquet",
        "session.toml",
    ]


@pytest.fixture
def keep_s(monkeypatch):
    """How long readings are kept in which nothing is captured, s: a quarter of what is usual."""
    monkeypatch.setattr("undrift.commands.bench.capture.KEEP_S", KEEP_S / 4.0)
    return KEEP_S / 4.0


@pytest.mark.slow
def test_what_was_captured_is_kept_while_the_rest_is_forgotten(guide, keep_s):
    made = random_device(np.random.default_rng(5), grade="consumer")
    slow = replace(made, sampling=replace(made.sampling, sample_rate_hz=20.0))
    with HandFeed(seed=5, device=slow) as feed:
        feed.watch(guide, 12.0)
        held = guide.capture.faces["+z"]
        feed.watch(guide, 3.0 * keep_s)
        assert kept_s(guide.capture) < 2.0 * keep_s + 30.0
        feed.held.lay("+x")
        feed.watch(guide, 12.0)
    session = guide.capture.session()
    still = next(still for still in session.stills if still.face == "+z")
    record = session.records[still.recording]
    assert (record.time[still.start], record.time[still.stop]) == pytest.approx((held.start_s, held.stop_s), abs=0.06)
    assert len(session.records) == 2


def test_what_cannot_be_captured_is_refused(guide):
    record = Record(time=np.arange(100) / 100.0, gyro=np.ones((100, 3)), accel=np.ones((100, 3)))
    with pytest.raises(InputError, match=r"capture: gyroscope and accelerometer are both required"):
        guide.update(replace(record, gyro=None), 0.0)
    with pytest.raises(InputError, match=r"session: expected a captured face or turn, got none. Capture one first"):
        guide.capture.save()
    guide.update(record, 0.0)
    with pytest.raises(InputError, match=r"capture: expected readings in m/s2, got g"):
        guide.update(replace(record, accel_unit="g", time=record.time + 1.0), 1.0)


def test_one_reading_behind_a_gap_is_no_rest_and_no_error(tmp_path):
    rng = np.random.default_rng(2)
    accel, gyro = rng.normal((0.0, 0.0, 9.81), 0.01, (201, 3)), rng.normal(0.0, 0.001, (201, 3))
    accel[150:200] = gyro[150:200] = np.nan  # lost on the way
    capture = Capture(tmp_path / "session")
    capture.take(Record(time=np.arange(201) / 100.0, gyro=gyro, accel=accel), 0.0)
    assert capture.tail(3.0) is None
    assert capture.rest() is None
