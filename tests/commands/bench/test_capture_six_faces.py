"""The guided capture of six faces, fed the readings of a simulated device in an operator's hands."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path
from testkit.guided import STEP_S, HandFeed, accel_as_six_faces_see_it, capture_faces, joint_factor
from testkit.hand_held import Tremor, hand_held_log, hand_waves
from undrift.cli.app import run
from undrift.commands.bench.capture import Capture
from undrift.commands.bench.guides import ORDER, SixFaces
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.io.store import read_calibration
from undrift.record import FACES, Record
from undrift.sim.device.presets import random_device


@pytest.fixture
def guide(tmp_path):
    return SixFaces(Capture(tmp_path / "session"))


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A feed, and a guide that has six faces of it; tests change a copy of the guide."""
    with HandFeed(seed=5) as feed:
        guide = SixFaces(Capture(tmp_path_factory.mktemp("complete") / "session"))
        capture_faces(feed, guide, STEP_S)
        yield feed, guide


@pytest.mark.slow
def test_six_faces_are_captured_at_rest_and_calibrate_reads_them(complete, capsys):
    feed, guide = complete
    capture = guide.capture
    assert set(capture.faces) == set(FACES)
    # countdown, settling, the window of a rest, a move
    assert max(held.stop_s for held in capture.faces.values()) < 6 * (6.0 + 1.5 + 1.1 + 2.5)
    for held in capture.faces.values():
        assert not feed.moved_in(held)
        assert held.stop_s - held.start_s == pytest.approx(6.0, abs=2.0 * STEP_S)
    capture.save()
    session = read_session(capture.folder)
    assert [still.face for still in session.stills] == list(capture.faces)
    assert session.serial == feed.held.device.serial
    out = capture.folder.parent / "calibration.json"
    assert run(["calibrate", str(capture.folder), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["data"]["accel"]["method"] == "six-face/affine"
    accel = read_calibration(out).accel
    matrix, offset = accel_as_six_faces_see_it(feed.held.device)
    error = np.concatenate(((accel.matrix - matrix).ravel(), accel.offset - offset))
    assert (np.abs(error) < joint_factor(12) * np.sqrt(np.diag(accel.covariance)[:12])).all()


def test_the_light_says_what_the_device_does_and_what_to_do(guide, feed):
    feed.held.lay("+x")
    lights = feed.watch(guide, 12.0)
    states = [light.state for light in lights]
    first = [state for k, state in enumerate(states) if k == 0 or state != states[k - 1]]
    assert first == ["moving", "settling", "still", "captured"]
    counted = [light.left_s for light in lights if light.state == "still"]
    assert counted == sorted(counted, reverse=True)
    assert 5.5 < counted[0] <= 6.0
    assert lights[0].text == "Moving. Turn +z up."
    assert lights[-1].text == "+x is captured. Turn +z up."
    assert [light.face for light in lights if light.state == "still"] == ["+x"] * len(counted)
    assert guide.wanted == ORDER[0]


@pytest.mark.slow
@pytest.mark.parametrize("in_counts", [False, True])
def test_a_device_that_hands_hold_is_never_captured(guide, in_counts):
    rng = np.random.default_rng(3)
    record, _ = hand_held_log(rng, Tremor(rate_dps=3.0, sway_deg=2.0, accel=0.2), poses=5, hold_s=(12.0, 15.0))
    if in_counts:
        record = replace(
            record, gyro=1000.0 * record.gyro, accel=500.0 * record.accel, gyro_unit="count", accel_unit="count"
        )
    states = [guide.update(record.part(max(0, k - 100), k), k / 100.0).state for k in range(20, len(record), 20)]
    assert "captured" not in states
    assert in_counts or set(states) == {"moving"}
    assert guide.capture.faces == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_whatever_an_operator_does_no_captured_face_holds_a_move(guide, seed):
    rng = np.random.default_rng(seed)
    with HandFeed(seed=seed) as feed:
        for _ in range(25):
            feed.held.lay(FACES[rng.integers(6)])
            feed.watch(guide, float(rng.uniform(1.0, 14.0)))
            for face, held in guide.capture.faces.items():
                assert not feed.moved_in(held), face
    assert guide.capture.faces


def test_redo_replaces_one_face_and_keeps_it_until_then(complete):
    feed, guide = copy.deepcopy(complete, {id(complete[0]): complete[0]})
    before = dict(guide.capture.faces)
    guide.redo("+x")
    guide.redo(None)
    assert guide.wanted is None
    with pytest.raises(InputError, match=r"redo: expected one of \+x, .*, got 'up'. Select a face"):
        guide.redo("up")
    guide.redo("+x")
    assert guide.complete
    assert guide.wanted == "+x"
    feed.held.lay("+y")
    assert feed.watch(guide, 12.0)[-1].state == "wrong face"
    assert guide.light.text == "+y is captured. Turn +x up."
    assert guide.capture.faces == before
    feed.held.lay("+x")
    feed.watch(guide, 12.0)
    changed = [face for face in FACES if guide.capture.faces[face] != before[face]]
    assert changed == ["+x"]
    assert guide.capture.faces["+x"].start_s > before["-y"].stop_s
    assert guide.wanted is None
    stills = guide.capture.session().stills
    assert sorted(still.face for still in stills) == sorted(FACES)


@pytest.mark.parametrize(("lost_s", "restarts"), [(0.01, False), (0.15, True)])
def test_many_readings_that_a_recorder_marks_as_missing_restart_it_and_a_single_one_does_not(
    guide, feed, lost_s, restarts
):
    feed.watch(guide, 5.0)
    at = feed.clock.now()
    for _ in range(60):
        feed.go()
        record = feed.recent()
        gone = np.abs(record.time - at - 0.5 * lost_s) <= 0.5 * lost_s
        record = replace(
            record,
            accel=np.where(gone[:, None], np.nan, record.accel),
            gyro=np.where(gone[:, None], np.nan, record.gyro),
        )
        guide.update(record, feed.clock.now())
    assert (guide.capture.faces["+z"].start_s > at) == restarts


@pytest.mark.parametrize("seeds", [2])
@pytest.mark.parametrize("knocks", [0, 3])
@pytest.mark.parametrize("share_of_gravity", [0.03, 0.3])
def test_a_device_in_counts_that_is_shaken_was_not_turned_over(tmp_path, share_of_gravity, knocks, seeds):
    states = set()
    for seed in range(seeds):
        rng, guide = np.random.default_rng(seed), SixFaces(Capture(tmp_path / str(seed)))
        shaken = np.sqrt(3.0) * hand_waves(rng, np.arange(500) / 100.0, 0.2, 2.0)[0]  # rms 1 on each axis
        for at in rng.integers(25, 475, knocks):
            shaken[at - 12 : at + 12] *= 8.0
        waves = np.concatenate((shaken, np.zeros((1000, 3))))
        time, noise = np.arange(1500) / 100.0, 0.6 * rng.standard_normal((2, 1500, 3))
        accel = np.round(2048.0 + 614.0 * ([0.0, 0.0, 1.0] + share_of_gravity * waves) + noise[0])
        gyro = np.round(2048.0 + 300.0 * waves[:, [2, 0, 1]] + noise[1])
        whole = Record(time=time, gyro=gyro, accel=accel, gyro_unit="count", accel_unit="count")
        lights = [guide.update(whole.part(max(0, k - 100), k), time[k]).state for k in range(20, 1500, 20)]
        states |= set(lights[35:])  # 1.5 s after it was laid down
    assert states == {"unknown face"}


def in_counts_about_mid_scale(record):
    accel, gyro = (2048.0 + np.round(900.0 * each / np.abs(each).max()) for each in (record.accel, record.gyro))
    return replace(record, accel=accel, gyro=gyro, accel_unit="count", gyro_unit="count")


def captured_of(record, folder, lossy=0.0):
    """Play a recording as a device would send it; return what was captured, and from where."""
    lost = (np.random.default_rng(1).random(len(record)) < lossy)[:, None]
    sent = replace(record, accel=np.where(lost, np.nan, record.accel), gyro=np.where(lost, np.nan, record.gyro))
    guide = SixFaces(Capture(folder))
    for stop in range(40, len(record), 40):
        guide.update(sent.part(max(0, stop - 100), stop), float(record.time[stop - 1]))
    return guide.capture.faces


@pytest.mark.slow
@pytest.mark.parametrize(
    ("in_counts", "lossy", "found"), [(False, 0.0, 5), (False, 0.002, 5), (True, 0.0, 2), (True, 0.002, 2)]
)
def test_faces_of_a_real_session_are_what_they_are(tmp_path, in_counts, lossy, found):
    """A foot sensor in a person's hands: five faces rest for 7.5 s or more, two of them after it was turned over."""
    d = np.loadtxt(data_path("ferraris_nilspod", "example_ferraris_session.csv"), delimiter=",", skiprows=1)
    record = Record(time=d[:, 0] / 102.4, gyro=np.radians(d[:, 1:4]), accel=d[:, 4:7])
    faces = captured_of(in_counts_about_mid_scale(record) if in_counts else record, tmp_path / "s", lossy)
    assert len(faces) == found
    for face, held in faces.items():
        up = record.accel[(record.time >= held.start_s) & (record.time <= held.stop_s)].mean(axis=0)
        assert up["xyz".index(face[1])] * (1 if face[0] == "+" else -1) > 9.0


def test_silence_is_said(guide, feed):
    assert guide.update(None, 0.0).state == "no readings"
    feed.watch(guide, 5.0)
    record, now = feed.recent(), feed.clock.now()
    assert guide.update(record, now + 0.5).state == "still"
    assert guide.update(record, now + 1.5).state == "no readings"
    assert guide.light.text == "No readings. Check power and connection of the device."


@pytest.mark.slow
def test_a_device_in_counts_with_an_unknown_zero_is_turned_over_once(guide):
    device = random_device(np.random.default_rng(5), grade="enc03j_3031")
    with HandFeed(seed=5, device=device) as feed:
        light = feed.watch(guide, 3.0)[-1]
        assert light.state == "unknown face"
        assert light.text == "It is not known yet which face is up. Turn the device over all its sides once."
        capture_faces(feed, guide)
        for face, held in guide.capture.faces.items():
            assert not feed.moved_in(held)
            up = np.linalg.solve(device.accel.forward_matrix, np.array(held.mean) - device.accel.raw_offset)
            assert up["xyz".index(face[1])] * (1 if face[0] == "+" else -1) == pytest.approx(9.8, abs=0.1)


@pytest.mark.parametrize("unit", ["g", "count"])
def test_a_tilted_device_is_not_captured_and_the_light_says_by_how_much(guide, feed, unit):
    c, s = np.cos(np.radians(14.0)), np.sin(np.radians(14.0))
    feed.watch(guide, 3.0 if unit == "count" else 0.0)  # lying flat shows the zero
    size, states = feed.held.device.accel.gain * 9.80665, []
    for _ in range(60):
        feed.go()
        record = feed.recent()
        level = (record.accel - feed.held.device.accel.raw_offset) / size
        accel = level @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]).T
        record = replace(record, accel=accel if unit == "g" else accel * size, accel_unit=unit)
        states.append(guide.update(record, feed.clock.now()))
    assert guide.capture.faces == {}
    assert states[-1].state == "tilted"
    assert states[-1].text in [f"Tilted by {n} deg. Lay it flat with +z up." for n in (13, 14, 15)]
