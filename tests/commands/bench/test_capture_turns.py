"""The guided capture of turns by hand, fed the readings of a simulated device."""

import itertools
import json
import math

import numpy as np
import pytest

from testkit.guided import STEP_S, HandFeed, accel_as_six_faces_see_it, capture_faces, capture_turns, joint_factor
from undrift.cli.app import run
from undrift.commands.bench.capture import Capture
from undrift.commands.bench.guides import WAYS, SixFaces, Turns
from undrift.io.store import read_calibration
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration

TURN = 2.0 * math.pi


@pytest.fixture
def guide(tmp_path):
    return Turns(Capture(tmp_path / "session"))


def turn(feed, guide, axis="z", angle=TURN, **lost):
    """Rest, turn once, rest; return the lights."""
    lights = feed.watch(guide, 6.0)
    feed.held.turn(axis, angle)
    return lights + feed.watch(guide, 14.0, **lost)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A feed, and a guide that has six faces and six turns of it."""
    with HandFeed(seed=5) as feed:
        guide = Turns(Capture(tmp_path_factory.mktemp("complete") / "session"))
        capture_faces(feed, SixFaces(guide.capture))
        capture_turns(feed, guide, STEP_S)
        yield feed, guide


@pytest.mark.slow
def test_six_faces_and_six_turns_calibrate_both_triads_within_their_uncertainty(complete, capsys):
    feed, guide = complete
    assert list(guide.done) == list(WAYS)
    guide.capture.save()
    out = guide.capture.folder.parent / "calibration.json"
    assert run(["calibrate", str(guide.capture.folder), "-o", str(out), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["data"]
    assert answer["accel"]["method"] == "six-face/affine"
    assert answer["gyro"]["method"] == "known-rotation/affine"
    made = read_calibration(out)
    matrix, offset = accel_as_six_faces_see_it(feed.held.device)
    truth = true_calibration(feed.held.device, temp_c=made.reference_temp_c).gyro
    errors = [
        (made.accel, np.concatenate(((made.accel.matrix - matrix).ravel(), made.accel.offset - offset))),
        (made.gyro, np.concatenate(((made.gyro.matrix - truth.matrix).ravel(), made.gyro.offset - truth.offset))),
    ]
    for model, error in errors:
        within = joint_factor(12) * np.sqrt(np.diag(model.covariance)[:12])
        assert (np.abs(error) < within).all()
    # a turn by hand is known to 1 deg of 360, so that the scale is found within a few of these
    scale = made.gyro.matrix @ feed.held.device.gyro.forward_matrix
    assert np.abs(np.diag(scale) - 1.0).max() < 0.01


def test_each_turn_lies_between_two_rests_and_all_are_apart_in_the_folder(complete):
    feed, guide = complete
    session = guide.capture.session()
    assert [(one.axis, round(math.degrees(one.angle))) for one in session.turns] == [
        (axis, angle) for axis in "xyz" for angle in (360, -360)
    ]
    moves = sorted(feed.moves)
    for one in session.turns:
        start, stop = session.records[0].time[[one.start, one.stop]]
        (inside,) = [move for move in moves if move[0] < stop and start < move[1]]
        assert start <= inside[0] + 0.1  # the slow first and last tenths of a move are below the noise
        assert inside[1] - 0.2 <= stop
        assert stop - start < inside[1] - inside[0] + 1.0
        before, after = (
            [s for s in session.stills if abs(end(s) - at) < 100]
            for end, at in ((lambda s: s.stop, one.start), (lambda s: s.start, one.stop))
        )
        assert len(before) == 1
        assert len(after) == 1
    pieces = sorted((*session.stills, *session.turns), key=lambda piece: piece.start)
    assert all(one.stop <= other.start for one, other in itertools.pairwise(pieces))
    rests = [piece for piece in session.stills if piece.face is None]
    for rest in rests:
        start, stop = session.records[0].time[[rest.start, rest.stop - 1]]
        assert not any(move[0] + 0.1 < stop and start < move[1] - 0.2 for move in moves)


@pytest.mark.slow
def test_a_device_that_is_laid_on_another_face_was_not_turned(guide, feed):
    for face in ("+x", "-z", "+y"):
        feed.watch(guide, 6.0)
        feed.held.lay(face)
        feed.watch(guide, 6.0)
    assert guide.done == {}


def test_a_device_whose_zero_is_not_known_yet_is_turned_over_first(guide):
    with HandFeed(seed=5, device=random_device(np.random.default_rng(5), grade="enc03j_3031")) as feed:
        assert turn(feed, guide, "z")[-1].state == "unknown face"
    assert guide.done == {}


def test_two_turns_are_captured_as_two_where_the_unit_shows_it(guide):
    with HandFeed(seed=5, device=random_device(np.random.default_rng(5), grade="xsens_mti1")) as feed:
        turn(feed, guide, "z", 2.0 * TURN)
    assert guide.done["+z"].turn.angle == pytest.approx(2.0 * TURN)
    assert guide.outcome == "Captured: about z, counter-clockwise, 2 turns."


@pytest.mark.slow
def test_in_counts_two_turns_that_agree_stand_against_the_only_other_one(guide, feed):
    turn(feed, guide, "z", 2.0 * TURN)
    turn(feed, guide, "z", -TURN)
    assert list(guide.done) == ["+z"]
    turn(feed, guide, "z")
    assert list(guide.done) == ["+z"]
    turn(feed, guide, "z", -TURN)
    once, back = guide.done["+z"], guide.done["-z"]
    assert abs(once.reading) == pytest.approx(abs(back.reading), rel=0.02)


def test_a_turn_with_a_gap_does_not_count(guide, feed):
    at = feed.clock.now() + 6.0
    lights = turn(feed, guide, "z", drop=(at + 2.0, at + 2.3))
    assert guide.done == {}
    assert any(light.text.startswith("Gap in the readings: that turn does not count.") for light in lights)
