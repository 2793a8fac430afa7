"""The picture of a recording: what it marks stands in its text, with counts and reasons."""

import xml.etree.ElementTree as ET

import numpy as np

from testkit.hand_held import Tremor, hand_held_log
from testkit.recordings import nilspod
from undrift.calibration.calibrate import calibrated
from undrift.calibration.pieces import pieces_of
from undrift.calibration.session import look
from undrift.calibration.settings import CalibrateSettings
from undrift.record import Record, Session
from undrift.report.figures import draw_recording, svg_of


def session_of(*records, **pieces):
    return Session(kind="calibration", serial="", gravity_m_s2=9.81, records=records, **pieces)


def drawn(session):
    pieces = pieces_of(look(session, CalibrateSettings()))
    text = svg_of(draw_recording(session.records, pieces, title="bench"))
    assert ET.fromstring(text).tag.endswith("svg")
    return pieces, text


def test_a_hand_turned_session_shows_its_faces_and_its_three_full_turns():
    pieces, text = drawn(session_of(nilspod()))
    faces = [piece.label for piece in pieces if piece.kind == "still"]
    assert faces == ["+x", "+x", "-x", "+y", "-y", "+z", "-z", "+x", "+x", "+y", "+y", "+z", "+z"]
    turns = {piece.label for piece in pieces if piece.kind == "turn"}
    assert {"x -370 deg", "y -354 deg", "z -359 deg"} <= turns
    for label in ("13 stills found", "12 turns found", "x -370 deg", "gyro (deg/s)", "accel (m/s2)"):
        assert label in text, label
    assert "left out" not in text


def test_what_a_calibration_used_is_shown():
    made, observed = calibrated(session_of(nilspod()), settings=CalibrateSettings(turn_angle_deg=360.0))
    pieces = pieces_of(observed, made)
    assert {piece.why for piece in pieces} == {""}
    text = svg_of(draw_recording(observed.session.records, pieces, title="bench", used=True))
    for label in ("13 stills used", "3 turns used"):
        assert label in text, label


def test_gaps_and_saturation_are_marked_with_numbers():
    calm, _ = hand_held_log(np.random.default_rng(1), Tremor(rate_dps=0.1, sway_deg=0.02, accel=0.01), poses=5)
    shaky, _ = hand_held_log(np.random.default_rng(2), Tremor(rate_dps=6.0, sway_deg=0.1, accel=0.02), poses=3)
    gyro = np.clip(np.concatenate((calm.gyro, shaky.gyro)), -1.0, 1.0)
    gyro[4200:4300] = np.nan
    time = np.arange(len(gyro)) / 100.0
    time[3000:] += 2.0
    record = Record(time=time, gyro=gyro, accel=np.concatenate((calm.accel, shaky.accel)))
    _, text = drawn(session_of(record))
    for label in ("2 gaps", "saturated", "5 stills found"):
        assert label in text, label
