"""The offset at a rest: what is subtracted, how well it is known, the same in a stream, refused where nothing rests."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.walking import perfect_calibration
from undrift.correction import rest as rest_module
from undrift.correction.correct import Corrector, correct, correct_checked
from undrift.correction.rest import find_rest_offset, rest_offset
from undrift.errors import InputError
from undrift.orientation import OrientSettings, orient
from undrift.record import Record, Still, joined

FS = 100.0
LEFT = np.array([0.02, -0.01, 0.005])  # rad/s
CALIBRATION = perfect_calibration()


def worn(seed=1, *, rest_s=20.0, motion_s=20.0, noise=1e-3):
    """A rest, then turning about y and back; an offset that no calibration knows."""
    rng = np.random.default_rng(seed)
    n, still = int((rest_s + motion_s) * FS), int(rest_s * FS)
    time = np.arange(n) / FS
    turn = np.where(time < rest_s, 0.0, 1.2 * np.sin(2.0 * np.pi * 0.5 * (time - rest_s)))
    angle = np.cumsum(turn) / FS
    gyro = LEFT + noise * rng.standard_normal((n, 3))
    gyro[:, 1] += turn
    force = 9.81 * np.stack([-np.sin(angle), np.zeros(n), np.cos(angle)], axis=1)
    return Record(
        time=time, gyro=gyro, accel=force + 0.01 * rng.standard_normal((n, 3)), temp_c=np.full(n, 25.0)
    ), still


def test_offset_at_the_first_rest_is_subtracted():
    record, still = worn()
    plain, done = correct(record, CALIBRATION, check=False), correct_checked(record, CALIBRATION, offset="rest")
    assert done.rest is not None
    assert done.rest.rest_s[1] < still / FS
    np.testing.assert_allclose(plain.gyro - done.record.gyro, np.tile(done.rest.mean, (len(record), 1)), atol=1e-15)
    np.testing.assert_array_equal(done.record.accel, plain.accel)
    np.testing.assert_allclose(done.rest.mean, LEFT, atol=5.0 * 1e-3 / np.sqrt(15.0 * FS))
    (note,) = (item for item in done.findings if item.code == "correct.offset_subtracted")
    assert note.level == "info"
    assert note.values["offset_dps"] == pytest.approx(np.degrees(done.rest.mean))
    assert "was subtracted" in note.text
    assert np.isfinite(done.rest.covariance).all()


@pytest.mark.parametrize("length", [50, 333])
def test_stream_finds_the_rest_of_the_whole_record(length, monkeypatch):
    monkeypatch.setattr(rest_module, "FOUND_IN_S", 25.0)
    record, _ = worn(3)
    whole = correct_checked(record, CALIBRATION, offset="rest")
    parts = [record.part(a, min(a + length, len(record))) for a in range(0, len(record), length)]
    before = Corrector(CALIBRATION)
    rest = find_rest_offset(joined([before.push(part) for part in parts]))
    assert rest.rest_s == whole.rest.rest_s
    np.testing.assert_array_equal(rest.rate, whole.rest.rate)
    stream = Corrector(CALIBRATION, offset=rest)
    gyro = np.concatenate([stream.push(part).gyro for part in parts])
    np.testing.assert_array_equal(gyro, whole.record.gyro)


def test_padded_rows_are_no_rest_on_any_route():
    record, _ = worn()
    order = np.r_[np.full(500, 3020), np.arange(3020, 4000), np.arange(2000), np.full(300, 1999)]
    held = {name: np.asarray(getattr(record, name))[order] for name in ("gyro", "accel", "temp_c")}
    padded = Record(time=np.arange(len(order)) / FS, **held)
    first, last = 500 + 980, 500 + 980 + 2000  # of the true rest
    done = correct_checked(padded, CALIBRATION, offset="rest")
    assert "recording.padded" in [item.code for item in done.findings]
    assert padded.time[first] <= done.rest.rest_s[0] < done.rest.rest_s[1] < padded.time[last]
    np.testing.assert_allclose(done.rest.mean, LEFT, atol=2e-4)
    plain = correct(padded, CALIBRATION, check=False)
    parts = (plain.part(a, min(a + 777, len(plain))) for a in range(0, len(plain), 777))
    assert find_rest_offset(joined([*parts])).rest_s == done.rest.rest_s
    orientation = orient(plain, settings=OrientSettings(offset="rest"))
    assert "recording.padded" in [item.code for item in orientation.findings]
    stated = orient(plain, Still(start=first + 100, stop=last - 100)).still
    removed = int(plain.time.searchsorted(orientation.time[0]))
    assert (stated.start + removed, stated.stop + removed) == (first + 100, last - 100)
    assert (orientation.time[0], orientation.time[-1]) == (padded.time[500], padded.time[last - 1])
    assert orientation.time[orientation.still.start] == done.rest.rest_s[0]
    np.testing.assert_allclose(orientation.offset, done.rest.mean, atol=1e-12)


def with_a_gap(record):
    return replace(record, gyro=np.where(np.arange(len(record))[:, None] == 300, np.nan, record.gyro))


@pytest.mark.parametrize(
    ("change", "still", "words"),
    [
        (lambda record: record, Still(start=200, stop=205), "got 5 samples"),
        (with_a_gap, Still(start=200, stop=600), "got 1 gaps"),
    ],
)
def test_stated_rest_is_refused_if_it_is_short_or_has_gaps(change, still, words):
    record, _ = worn(5)
    assert rest_offset(record, Still(start=200, stop=600)).rest_s == (2.0, 5.99)
    with pytest.raises(InputError, match=words):
        rest_offset(change(record), still)


def shaken():
    rng = np.random.default_rng(6)
    return Record(time=np.arange(3000) / FS, gyro=rng.normal(size=(3000, 3)), accel=9.8 + rng.normal(size=(3000, 3)))


@pytest.mark.parametrize(
    ("record", "words"),
    [(shaken(), "no still phase"), (Record(time=np.arange(300) / FS, accel=np.tile([0.0, 0.0, 9.8], (300, 1))), "Omit `offset`")],
)  # fmt: skip
def test_recording_without_a_rest_is_refused(record, words):
    with pytest.raises(InputError, match=words):
        correct(record, CALIBRATION, offset="rest")
