"""orient: the whole way from readings to angles."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.findings import only
from testkit.hand_turns import Device, make_recording
from testkit.plain_triad import plain_triad
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.orientation import OrientSettings, heading_of, inclination_of, orient, sagittal_pitch
from undrift.record import Record, Still

G = 9.81


def moved(n=600, rest=200, *, lead=0, seed=1, noise=0.0, offset=0.0):
    """A record that rests, then turns; lead samples of motion come before the rest. Rates are means over their steps."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) * 0.01
    course = np.concatenate((np.linspace(1.0, 0.0, lead), np.zeros(rest), np.linspace(0.0, 6.0, n - lead - rest)))
    half = 0.5 * course  # one axis, so that the step's mean rate is exact
    axis = np.array([0.48, 0.6, 0.64])
    q = np.column_stack((np.cos(half), np.sin(half)[:, None] * axis))
    rate = np.diff(course, prepend=course[0]) / 0.01
    up = np.stack([quaternion_product(quaternion_product(quaternion_conjugate(p), [0, 0, 0, G]), p)[1:] for p in q])
    gyro = rate[:, None] * axis + offset + noise * rng.normal(size=(n, 3))
    return Record(time=time, gyro=gyro, accel=up + noise * rng.normal(size=(n, 3))), q


def off(q, truth):
    e = quaternion_product(q, quaternion_conjugate(truth))
    return 2.0 * np.arctan2(np.linalg.norm(e[:, 1:], axis=1), np.abs(e[:, 0]))


def test_ideal_readings_give_back_the_motion():
    record, truth = moved(lead=120)
    orientation = orient(record, Still(start=130, stop=310))
    show("noise-free round trip, rad", off(orientation.q_nb, truth).max(), 1e-12)
    assert off(orientation.q_nb, truth).max() < 1e-12  # 600 roundings
    np.testing.assert_array_equal(orientation.inclination, inclination_of(orientation.q_nb))
    np.testing.assert_array_equal(orientation.heading, heading_of(orientation.q_nb))
    np.testing.assert_array_equal(orientation.pitch, sagittal_pitch(orientation.q_nb))
    np.testing.assert_array_equal(orientation.offset, 0.0)


def test_the_rest_offset_is_taken_off_when_asked():
    record, truth = moved(offset=0.02)
    still = Still(start=0, stop=200)
    with_it, without = orient(record, still), orient(record, still, OrientSettings(offset="rest"))
    assert off(with_it.q_nb, truth)[-1] > 0.03
    assert off(without.q_nb, truth)[-1] < 1e-12
    np.testing.assert_allclose(without.offset, 0.02, rtol=1e-12)


def test_a_rest_is_found_when_none_is_given():
    record, truth = moved(noise=1e-4)
    orientation = orient(record)
    # the search may lose half a window, and gain none of the motion
    assert 0 <= orientation.still.start < orientation.still.stop <= 202
    # 600 steps of 1e-4 rad/s noise walk to 2e-5 rad; the tilt errs by 1e-5
    assert off(orientation.q_nb, truth).max() < 1e-3


SHAKEN = np.random.default_rng(2).normal(size=(2, 600, 3))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda record: {"gyro": None}, "no gyroscope readings"),
        (lambda record: {"gyro": SHAKEN[0], "accel": record.accel + SHAKEN[1]}, "no still phase"),
        (lambda record: {"gyro_unit": "count"}, "got count"),
        (lambda record: {"time": record.time + 5.0 * (np.arange(600) >= 400)}, r"first of 5.0"),
        (lambda record: {"gyro": record.gyro * [0.0, 1.0, 1.0]}, "x of the gyroscopes"),
    ],
)
def test_what_cannot_be_oriented_is_refused(change, words):
    record, _ = moved(noise=1e-4)
    with pytest.raises(InputError, match=words):
        orient(replace(record, **change(record)))


# ---- offsets of every rest, the drift to expect, and the filter


def worn(*, drift=5e-5, rests=4, noise=1e-3, seed=5):
    """A record of rests of 5 s and turns of 10 s about one axis, whose offset drifts by ``drift`` rad/s in a second."""
    rng = np.random.default_rng(seed)
    time = np.arange(1500 * (rests - 1) + 500) * 0.01
    angle = np.interp(time % 15.0, [0.0, 5.0, 10.0, 15.0], [0.0, 0.0, 1.5, 0.0])
    axis = np.array([0.6, 0.0, 0.8])
    q = np.column_stack((np.cos(angle / 2.0), np.sin(angle / 2.0)[:, None] * axis))
    rate = np.diff(angle, prepend=0.0) / 0.01
    up = np.stack([quaternion_product(quaternion_product(quaternion_conjugate(p), [0, 0, 0, G]), p)[1:] for p in q])
    offset = drift * time[:, None] * [1.0, -1.0, 0.5]
    gyro = rate[:, None] * axis + offset + noise * rng.normal(size=(len(time), 3))
    return Record(time=time, gyro=gyro, accel=up + noise * rng.normal(size=up.shape)), q


def test_expected_drift_is_the_rate_at_rest_times_the_time():
    record, _ = moved(noise=1e-4, offset=0.02)
    (item,) = orient(record).findings
    assert item.code == "orient.drift"
    assert item.level == "warn"
    assert item.values["offset_dps"] == pytest.approx(np.degrees(0.02 * np.sqrt(3.0)), rel=0.01)
    assert item.values["drift_deg"] == pytest.approx(item.values["offset_dps"] * item.values["duration_s"])
    orientation = orient(record, None, OrientSettings(offset="rest"))
    (item,) = orientation.findings
    assert item.level == "info"
    # 0.02 deg/s an axis from rest to motion
    moving = 1.0 - (orientation.still.stop - orientation.still.start) / len(record)
    assert item.values["offset_dps"] == pytest.approx(0.02 * np.sqrt(3.0) * moving, rel=0.01)


def test_uncertainty_of_the_calibrated_offset_counts():
    record, _ = moved(noise=1e-5)
    sd = 0.3  # dps per unit of the raw reading, which is doubled by the matrix
    model = replace(plain_triad("dps", "dps", offset_sigma=sd), method="rate-table", matrix=2.0 * np.eye(3))
    orientation = orient(record, gyro_model=model)
    assert np.degrees(orientation.offset_uncertainty) == pytest.approx(2.0 * sd * np.sqrt(3.0), rel=0.01)
    rest = orient(record, None, OrientSettings(offset="rest"), gyro_model=model)
    assert rest.offset_uncertainty < 0.1 * orientation.offset_uncertainty  # the rest's own mean took its place
    models = [replace(model, method=method, covariance=np.zeros((12, 12))) for method in ("rest", "reference/motion")]
    bench, optics = (orient(record, gyro_model=item).offset_uncertainty for item in models)
    assert optics < 0.1 * bench  # an offset that was fitted in motion does not change from rest to motion


VQF = OrientSettings(method="vqf")


def test_filter_keeps_the_heading_of_the_rest():
    record, truth = worn(drift=0.0)
    orientation = orient(record, None, VQF)
    error = off(orientation.q_nb, truth)
    show("filter on ideal readings, rad", error.max(), 0.01)
    assert error.max() < 0.01  # the filter trusts the accelerometers with 3 s, and smooths them
    assert orientation.heading[orientation.still.stop - 1] == pytest.approx(0.0, abs=1e-6)
    assert orientation.findings == ()


def test_filter_with_a_magnetometer_turns_to_east():
    record, truth = worn(drift=0.0)
    turn = np.array([np.cos(0.6), 0.0, 0.0, np.sin(0.6)])
    true = quaternion_product(turn, truth)
    field = rotate(quaternion_conjugate(true), np.array([0.0, 18.0, -44.0]))
    field[1::2] = np.nan  # half as fast as the others
    orientation = orient(replace(record, mag_ut=field), None, OrientSettings(method="vqf", magnetometer=True))
    error = off(orientation.q_nb, true)
    show("filter with a magnetometer, rad", error.max(), 0.02)
    assert error.max() < 0.02
    assert "to magnetic north" in only(orientation.findings, "orient.north").text
    for change, got in (({}, "got no readings"), ({"mag_ut": field}, "got strapdown")):
        with pytest.raises(InputError, match=got):
            orient(replace(record, **change), None, OrientSettings(magnetometer=True, method="strapdown"))
    with pytest.raises(InputError, match="all gaps"):
        orient(replace(record, mag_ut=field * np.nan), None, OrientSettings(method="vqf", magnetometer=True))


def test_tilt_holds_at_the_end_of_the_rest():
    record, _ = moved(lead=120, noise=1e-3, offset=0.02)
    still = Still(start=130, stop=310)
    orientation = orient(record, still, OrientSettings(offset="rest"))
    np.testing.assert_allclose(orientation.q_nb[309], orientation.tilt.q_nb, rtol=0, atol=1e-15)
    assert off(orientation.q_nb[[130]], orientation.tilt.q_nb[None])[0] > 1e-6  # noise of 180 readings lies between
    # the lead turns by 1 rad in 1.2 s; 180 readings of 1e-3 rad/s know the offset to 7.5e-5
    np.testing.assert_allclose(orientation.offset, 0.02, atol=4e-4)


@pytest.mark.parametrize("turned", [False, True], ids=["rest first", "rest last"])
def test_expected_drift_is_that_of_the_farther_end(turned):
    record, _ = moved(n=1000, rest=200, noise=1e-3)
    still = Still(start=0, stop=200)
    if turned:
        record = replace(record, gyro=-record.gyro[::-1], accel=record.accel[::-1])
        still = Still(start=800, stop=1000)
    (drift,) = orient(record, still).findings
    assert drift.values["duration_s"] == pytest.approx(9.99 if turned else 8.0)


# ---- axes of the pitch


def stood_up(axes, *, lean=0.7):
    """A device that rests upright for 2 s and leans forward and back, worn with sensor axes as the rows forward, left, up say."""
    time = np.arange(800) * 0.01
    course = np.where(time < 2.0, 0.0, lean * np.sin(np.pi * (time - 2.0) / 6.0) ** 2)
    rate = np.diff(course, prepend=0.0) / 0.01
    gyro, force = np.zeros((800, 3)), np.column_stack((-G * np.sin(course), np.zeros(800), G * np.cos(course)))
    gyro[:, 1] = rate
    worn = np.array(axes, float)
    return Record(time=time, gyro=gyro @ worn + 1e-9 * np.arange(800)[:, None], accel=force @ worn)


@pytest.mark.parametrize(
    ("axes", "up", "forward"),
    [
        (((0, 0, -1), (0, 1, 0), (1, 0, 0)), "+x", "z"),
        (((1, 0, 0), (0, 0, -1), (0, 1, 0)), "+y", "x"),
        (((1, 0, 0), (0, -1, 0), (0, 0, -1)), "-z", "x"),
    ],
)
def test_pitch_by_wrong_axes_names_the_right_ones(axes, up, forward):
    record, still = stood_up(axes), Still(start=0, stop=200)
    item = only(orient(record, still).findings, "orient.pitch_axes")
    assert item.level == "warn"
    assert (item.values["up"], item.values["forward"]) == (up, forward)
    leans = {}
    for way in (f"+{forward}", f"-{forward}"):
        orientation = orient(record, still, OrientSettings(forward=way, up=up))
        assert not [finding for finding in orientation.findings if finding.code == "orient.pitch_axes"]
        leans[way] = np.degrees([orientation.pitch.min(), orientation.pitch.max()])
    (right,) = (way for way, lean in leans.items() if lean[1] > 30.0)
    assert leans[right] == pytest.approx([0.0, np.degrees(0.7)], abs=0.3)


def test_an_upright_device_and_a_deep_bow_are_no_matter_of_axes():
    upright = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    for lean in (0.3, 1.6):
        orientation = orient(stood_up(upright, lean=lean), Still(start=0, stop=200))
        assert not [finding for finding in orientation.findings if finding.code == "orient.pitch_axes"]


# ---- recordings that begin and end in motion


def tumbled(duration_s=60.0, offset=(0.005, -0.004, 0.006)):
    """Turned by hand without a rest, forces of a hand that comes back; and the true orientation."""
    record, reference = make_recording(
        np.random.default_rng(4), Device(noise=1e-3, offset=np.array(offset)), mark=False
    )
    rng, n = np.random.default_rng(5), len(record)
    shaken = np.array(record.accel) + 0.3 * rng.normal(size=(n, 3))
    return replace(record, accel=shaken).between(9.0, 9.0 + duration_s), reference


def test_recording_without_a_rest_is_oriented_by_gravity():
    record, reference = tumbled(57.0)
    orientation = orient(record, settings=OrientSettings(offset="motion"))
    assert orientation.still is None
    assert orientation.still is None
    assert np.abs(orientation.offset - [0.005, -0.004, 0.006]).max() < 1e-3
    true = np.stack([np.interp(record.time, reference.time, entry) for entry in reference.q_nb.T], axis=1)
    vertical = [rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0])) for q in (orientation.q_nb, true)]
    error = np.degrees(
        np.arccos(np.clip((vertical[0] * vertical[1]).sum(axis=1) / np.linalg.norm(vertical[1], axis=1), -1, 1))
    )
    assert error.max() < 0.8  # forces of 0.3 m/s2, white; half a sample at 66 deg/s is 0.17
    assert error[0] < 2.0 * np.degrees(orientation.tilt.expanded_uncertainty)
    assert "orient.drift" in [item.code for item in orientation.findings]
    raw = orient(record)  # tilt from motion, rates as they are
    assert (raw.offset == 0.0).all()
    assert only(raw.findings, "orient.drift").values["offset_dps"] > 0.3
    assert only(raw.findings, "orient.drift").values["start"] == "the first sample"
    with pytest.raises(InputError, match="no still phase"):
        orient(record, settings=OrientSettings(offset="rest"))
    accel = np.array(record.accel)
    accel[700] = np.nan
    with pytest.raises(InputError, match="got 1 gaps"):
        orient(replace(record, accel=accel), settings=OrientSettings(offset="motion"))
    with pytest.raises(InputError, match="no still phase"):
        orient(record.between(9.0, 20.0), settings=OrientSettings(offset="motion"))


# ---- inclination, heading, sagittal pitch, Cardan angles


def about(axis, angle):
    half = 0.5 * np.asarray(angle)
    return np.stack([np.cos(half), *(np.sin(half) * a for a in axis)], axis=-1)


X, Y, Z = np.eye(3)
ANY = np.random.default_rng(1).normal(size=(200, 4))
ANY /= np.linalg.norm(ANY, axis=1)[:, None]


def test_inclination_and_heading_are_the_benchmarks_definitions():
    w, z = np.abs(ANY[:, 0]), ANY[:, 3] * np.sign(ANY[:, 0])
    # the reference form loses half its digits where the root is near one
    np.testing.assert_allclose(inclination_of(ANY), 2.0 * np.arccos(np.hypot(w, z)), rtol=0, atol=1e-7)
    np.testing.assert_allclose(heading_of(ANY), 2.0 * np.arctan(z / w), rtol=0, atol=1e-12)
    np.testing.assert_allclose(inclination_of(-ANY), inclination_of(ANY), rtol=0, atol=1e-15)
    np.testing.assert_allclose(heading_of(-ANY), heading_of(ANY), rtol=0, atol=1e-15)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_pitch_follows_a_lean_through_the_vertical(heading):
    lean = np.linspace(-3.1, 3.1, 63)  # past +-90 deg, where an Euler pitch would turn back
    q = quaternion_product(about(Z, heading), about(Y, lean))
    np.testing.assert_allclose(sagittal_pitch(q), lean, rtol=0, atol=1e-14)


def test_pitch_is_a_gap_only_where_the_vertical_leaves_the_plane():
    side = np.radians([0.0, 60.0, 84.0, 86.0, 90.0])
    pitch = sagittal_pitch(about(X, side))
    np.testing.assert_array_equal(np.isnan(pitch), [False, False, False, True, True])


def test_axes_that_span_no_plane_are_refused():
    with pytest.raises(InputError, match="two different axes"):
        sagittal_pitch(ANY, forward="+x", up="-x")
    with pytest.raises(InputError, match="got forward up and up"):
        sagittal_pitch(ANY, forward="up")
