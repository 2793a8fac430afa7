"""Calibrate: the fits that a session allows, and findings for the rest."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import only
from undrift.calibration import table
from undrift.calibration.calibrate import calibrate
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import InputError, NotObservable
from undrift.record import Record, Session, Still
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

RNG = np.random.default_rng(21)
DEVICE = random_device(RNG, grade="consumer")


def made(kind, labelled=True):
    return simulate_session(kind, DEVICE, rng=np.random.default_rng(22), labelled=labelled, temp_c=25.0)


def relative(model, triad):
    return np.abs(model.matrix @ triad.forward_matrix - np.eye(3)).max()


@pytest.mark.slow
def test_mode_paper_removes_the_offset_first_and_reports_it():
    calibration = calibrate(made("bench"), mode="paper")
    assert calibration.accel.method == "six-face/paper"
    assert calibration.gyro.method == "rate-table/paper"
    assert relative(calibration.accel, DEVICE.accel) < 2e-3
    assert relative(calibration.gyro, DEVICE.gyro) < 2e-3
    assert np.abs(calibration.accel.offset).max() > 0.0


def test_mode_paper_filters_dwells_with_the_spline_of_the_note(monkeypatch):
    cutoffs = []
    monkeypatch.setattr(table, "spline_filter", lambda time, values, cutoff_hz: cutoffs.append(cutoff_hz) or values)
    for mode in ("affine", "paper"):
        calibrate(made("rate_table"), gyro="rate-table", mode=mode)
        assert set(cutoffs) == ({5.0} if mode == "paper" else set())


@pytest.mark.slow
def test_mode_paper_without_rests_takes_the_mean_of_both_signs():
    session = made("rate_table")
    calibration = calibrate(replace(session, stills=(), records=session.records), gyro="rate-table", mode="paper")
    assert relative(calibration.gyro, DEVICE.gyro) < 2e-3


@pytest.mark.parametrize("labelled", [True, False])
def test_free_poses_give_both_triads_without_equipment(labelled):
    calibration = calibrate(made("multi_position", labelled))
    assert calibration.accel.method.startswith("multi-position")
    assert calibration.gyro.method.startswith("multi-position")
    assert relative(calibration.gyro, DEVICE.gyro) < 0.03  # rotated by up to the consumer device's axis errors


def test_faces_are_found_in_an_unlabelled_session():
    calibration = calibrate(made("six_face", labelled=False))
    assert calibration.accel.method == "six-face/affine"
    assert relative(calibration.accel, DEVICE.accel) < 2e-3
    gyro = only(calibration.verdict.findings, "session.not_observable")
    assert (gyro.level, gyro.values["what"]) == ("info", "Gyroscope")  # faces are for the accelerometer
    assert calibration.verdict.status == "good"
    assert calibration.gyro is None


def test_turns_between_faces_calibrate_gyroscopes_in_counts():
    """Steady turns by hand are not those of a table if the moves between the rests agree with gravity."""
    calibration = calibrate(made("ferraris", labelled=False))
    assert (calibration.accel.method, calibration.gyro.method) == ("six-face/affine", "multi-position")
    assert relative(calibration.gyro, DEVICE.gyro) < 0.01


def still_record(n=3000, unit="dps"):
    rng = np.random.default_rng(23)
    return Record(
        time=np.arange(n) / 100.0,
        gyro=np.array([0.3, -0.2, 0.1]) + 0.05 * rng.standard_normal((n, 3)),
        accel=np.array([0.0, 0.0, 9.81]) + 0.02 * rng.standard_normal((n, 3)),
        gyro_unit=unit,
    )


def test_a_single_rest_gives_the_rate_offset_alone():
    session = Session(kind="static", serial="", gravity_m_s2=9.81, records=(still_record(),))
    calibration = calibrate(session)
    assert calibration.gyro.method == "rest"
    assert calibration.accel is None
    # 3000 samples of 0.05: 0.001 deg/s
    np.testing.assert_allclose(calibration.gyro.offset, [0.3, -0.2, 0.1], atol=0.005)
    np.testing.assert_allclose(calibration.gyro.matrix, np.eye(3) * np.pi / 180.0)
    assert np.isnan(calibration.reference_temp_c)
    assert any(item.code == "session.not_observable" for item in calibration.verdict.findings)


def test_truncated_codes_get_their_half_step_back_before_the_fit():
    rng = np.random.default_rng(24)
    n = 30000
    time = np.arange(n) / 100.0
    sweep = 500.0 * np.sin(np.arange(n)[:, None] / np.array([21.0, 23.0, 26.0]))
    sweep[:6000] = 0.0
    gyro = np.trunc(sweep + np.array([3.3, -2.3, 4.3]) + 2.0 * rng.standard_normal((n, 3)))
    record = Record(time=time, gyro=gyro * 0.061, gyro_unit="dps")
    stills = (Still(start=0, stop=6000),)
    session = Session(kind="static", serial="", gravity_m_s2=9.81, records=(record,), stills=stills)
    calibration = calibrate(session)
    assert calibration.adc.gyro_rounding == "toward_zero"
    plain = calibrate(session, settings=CalibrateSettings(identify_adc=False))
    assert plain.adc is None
    truth = 0.061 * np.array([3.3, -2.3, 4.3])
    assert np.abs(calibration.gyro.offset - truth).max() < 0.2 * np.abs(plain.gyro.offset - truth).max()


@pytest.mark.parametrize("change", [{"gyro": None}, {"gyro_unit": "rad/s"}])
def test_recordings_with_other_sensors_or_units_are_refused(change):
    records = (still_record(), replace(still_record(2000), **change))
    with pytest.raises(InputError, match="readings in one unit"):
        calibrate(Session(kind="static", serial="", gravity_m_s2=9.81, records=records))


def saturated(session, at, axis=0, value=-32768.0):
    """0.1 s of one gyroscope at the end of its range."""
    gyro = np.array(session.records[0].gyro)
    gyro[at : at + 10, axis] = value
    return replace(session, records=(replace(session.records[0], gyro=gyro),))


@pytest.mark.parametrize("kind", ["bench", "ferraris"])
def test_turn_with_saturated_readings_is_left_out_by_number(kind):
    session = made(kind)
    turn = session.turns[1]
    middle = (turn.start + turn.stop) // 2
    calibration = calibrate(saturated(session, middle))
    assert calibration.accel.method == "six-face/affine"
    left_out = only(calibration.verdict.findings, "session.saturated")
    time_s = session.records[0].time
    assert left_out.values["pieces"] == (
        f"[[turn]] 2 (recording 0, {time_s[turn.start]:.1f}-{time_s[turn.stop - 1]:.1f} s)",
    )
    if kind == "bench":  # other dwells show the axis too; three turns by hand are one each
        assert relative(calibration.gyro, DEVICE.gyro) < 1e-3
    else:
        assert only(calibration.verdict.findings, "rate_table.axes_missing").values["missing"] == ("y",)


def test_face_that_was_not_recorded_is_named():
    session = made("ferraris", labelled=False)
    (still,) = (still for still in made("ferraris").stills if still.face == "-y")
    record, rng = session.records[0], np.random.default_rng(3)
    around, shake = slice(still.start - 50, still.stop + 50), np.zeros((len(record), 3))
    shake[around] = 200.0 * rng.normal(size=shake[around].shape)
    shaken = replace(session, records=(replace(record, gyro=record.gyro + shake, accel=record.accel + shake),))
    calibration = calibrate(shaken, settings=CalibrateSettings(turn_angle_deg=360.0))
    assert calibration.accel is None
    assert calibration.gyro.method == "known-rotation/affine"  # three turns need no accelerometer
    (accel,) = (item for item in calibration.verdict.findings if item.values.get("what") == "Accelerometer")
    assert "without a rest: -y" in accel.sentence


# ---- settings that reach a fit change it as they say


@pytest.mark.parametrize(
    "settings",
    [
        {"window_s": 0.0},
        {"settle_s": float("nan")},
    ],
)
def test_settings_that_are_none_are_refused(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        CalibrateSettings(**settings)


# ---- a verdict names what the kind of session does not show and which recording would, and stays good for it

LIMITED = random_device(np.random.default_rng(21))


def limited(kind):
    return simulate_session(kind, LIMITED, rng=np.random.default_rng(22), temp_c=25.0)


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        ("multi_position", ["Mounting of the sensors in the case"]),
        ("ferraris", []),
        ("six_face", ["Gyroscope"]),
    ],
)
def test_session_names_what_it_never_determines(kind, unknown):
    verdict = calibrate(limited(kind)).verdict
    findings = [item for item in verdict.findings if item.code == "session.not_observable"]
    assert ([item.values["what"] for item in findings], {item.level for item in findings} - {"info"}) == (
        unknown,
        set(),
    )
    assert verdict.status == "good"


@pytest.mark.parametrize(
    ("kind", "change", "asked", "error"),
    [
        ("six_face", {}, {"gyro": "rate-table"}, NotObservable),
        ("six_face", {}, {"gyro": "rest"}, NotObservable),  # counts have no scale of their own
        ("six_face", {"gyro": None}, {"gyro": "rest"}, NotObservable),
        ("six_face", {"accel": None}, {"accel": "six-face"}, NotObservable),
        ("multi_position", {}, {"mode": "paper"}, InputError),
        ("six_face", {}, {"mode": "best"}, InputError),
    ],
)
def test_fit_that_a_session_does_not_allow_is_refused(kind, change, asked, error):
    session = made(kind)
    session = replace(session, records=tuple(replace(record, **change) for record in session.records))
    with pytest.raises(error, match=next(iter(asked))):
        calibrate(session, **asked)


def test_session_that_allows_no_fit_is_refused():
    session = Session(kind="static", serial="", gravity_m_s2=9.81, records=(still_record(unit="count"),))
    with pytest.raises(NotObservable, match="determine the accelerometer"):
        calibrate(session)


@pytest.mark.parametrize(("gyro", "method"), [("none", None), ("rest", "rest")])
def test_gyroscope_fit_is_the_one_asked_for(gyro, method):
    session = made("multi_position")
    record = session.records[0]
    physical = replace(session, records=(replace(record, gyro=record.gyro / 16.4, gyro_unit="dps"),))
    calibration = calibrate(physical, gyro=gyro)
    assert calibration.accel.method == "multi-position"
    assert (calibration.gyro and calibration.gyro.method) == method
