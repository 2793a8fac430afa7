"""Plausibility: each refusal names the number and what to do."""

import itertools

import numpy as np
import pytest

from undrift.calibration.plausibility import (
    cause_by_gravity,
    check_axis_order,
    check_faces,
    check_gravity,
    check_gyro_scale,
    check_own_scale,
    check_range,
    face_vectors,
    nearest_signed_permutation,
)
from undrift.errors import Implausible
from undrift.record import FACES
from undrift.units import RADIAN_PER_DEGREE

FORWARD = np.array([[1.02, 0.01, -0.008], [0.004, 0.97, 0.012], [-0.006, 0.009, 1.01]])
READING = 9.81 * face_vectors(FACES) @ FORWARD.T + np.array([0.3, -0.2, 0.1])


def permuted(*order):
    return READING[list(order)]


@pytest.mark.parametrize(
    ("reading", "faces"),
    [
        (READING, FACES),
        (np.concatenate((READING, READING[:2] + 0.02)), (*FACES, "+x", "-x")),
    ],
)
def test_good_faces_pass(reading, faces):
    check_faces(reading, faces)


def labels_with(wrong):
    return tuple("+y" if face == wrong else face for face in FACES)


@pytest.mark.parametrize(
    ("reading", "faces", "words", "wrong"),
    [
        (np.concatenate((READING[:3], READING[:1] + 0.02, READING[4:])), FACES, "recorded twice", {"-y"}),
        (READING, labels_with("-y"), "labelled twice", {"+y"}),
        (permuted(2, 1, 0, 3, 4, 5), FACES, "are swapped", {"+x", "+y"}),
        (permuted(0, 1, 3, 2, 4, 5), FACES, "y is reversed", {"+y", "-y"}),  # the fit would be perfect
        (permuted(4, 1, 2, 3, 0), FACES[:5], "are swapped", {"+x", "+z"}),
        (permuted(3, 5, 2, 0, 4, 1), FACES, "do not fit", {"+x", "-x", "-y", "-z"}),
        (READING[:, [1, 0, 2]], FACES, "y are exchanged", {"+x", "-x", "+y", "-y"}),
        (READING[:, [1, 2, 0]], FACES, "in a ring", set(FACES)),
        (-READING, FACES, "opposite sign", set(FACES)),
    ],
)
def test_faces_that_contradict_their_labels_are_refused(reading, faces, words, wrong):
    with pytest.raises(Implausible, match=words) as caught:
        check_faces(reading, faces)
    assert set(caught.value.wrong) == wrong


def test_gravity_is_the_length_of_the_force_in_any_pose():
    check_gravity(np.full((4, 3), 9.81 / np.sqrt(3.0)), 9.81)
    check_gravity(READING, 9.81)
    with pytest.raises(Implausible, match="times too small") as caught:
        check_gravity(READING / 3.97, 9.81)
    assert caught.value.ratio == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize(
    ("scales", "ratio", "words"),
    [
        ((0.5,), 0.5, "50 samples"),
        ((1.2, 0.7, 1.0), 0.7, "nominal value"),  # the scale factor that is furthest off
        ((1.4, 0.7, 1.0), 1.4, "nominal value"),
    ],
)
def test_scale_beyond_its_tolerance_is_refused(scales, ratio, words):
    with pytest.raises(Implausible, match=words) as caught:
        check_own_scale(np.array(scales), "rad/s", "rate", "gyroscope", sample_rate_hz=100.0)
    assert caught.value.ratio == ratio


@pytest.mark.parametrize(("scales", "unit"), [((1.0, 1.02, 0.98), "rad/s"), ((16.4,), "count")])
def test_scale_within_its_tolerance_passes(scales, unit):
    check_own_scale(np.array(scales), unit, "rate", "gyroscope")


@pytest.mark.parametrize(
    ("scale", "level"), [((1.0, 0.853, 1.0), ["fail"]), ((1.0, 1.0, 0.93), ["warn"]), ((1.03, 0.97, 1.0), [])]
)
def test_a_gyroscope_s_scale_is_judged_by_what_data_sheets_allow(scale, level):
    result = list(check_gyro_scale(np.array(scale) / RADIAN_PER_DEGREE, "dps", 1.0, rates_given=True))
    assert [item.level for item in result] == level
    if level == ["fail"]:
        assert result[0].values["off_percent"] == pytest.approx(-14.7)
        assert "Gyroscope y" in result[0].sentence


def test_counts_are_judged_by_the_range_that_16_bit_would_have():
    def levels(per_dps, largest, stated):
        scale = np.full(3, per_dps / RADIAN_PER_DEGREE)
        return [item.level for item in check_gyro_scale(scale, "count", largest, rates_given=stated)]

    assert (levels(16.4, 3000.0, False), levels(16.4, 3000.0, True)) == ([], ["info"])
    assert levels(942.0, 30000.0, True) == ["warn"]  # ends at 35 deg/s
    assert levels(942.0, 1e6, True) == ["info"]  # more than 16 bit


# ---- what the columns of a gyroscope see, in words

SKEW = np.array([[1.0, 0.1, -0.05], [0.02, 0.9, 0.12], [-0.08, 0.03, 1.1]])


def rows(*axes):
    """Signed permutation whose row i sees the axis named."""
    seen = np.zeros((3, 3))
    for i, axis in enumerate(axes):
        seen[i, "xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    return seen


def test_each_of_48_orders_is_found_behind_a_skewed_triad():
    for order in itertools.permutations("xyz"):
        for signs in itertools.product("+-", repeat=3):
            seen = rows(*(s + a for s, a in zip(signs, order, strict=True)))
            np.testing.assert_array_equal(nearest_signed_permutation(800.0 * seen @ SKEW), seen)


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        (rows("+x", "-y", "+z"), "gyroscope column y"),
        (rows("-x", "-y", "+z"), "accelerometer column z"),
        (rows("-x", "-y", "-z"), "all gyroscope columns"),
        (rows("+y", "+x", "+z"), "gyroscope columns x"),
        (rows("+y", "-z", "-x"), "gyroscope columns x"),
    ],
)
def test_gravity_names_the_columns_of_either_triad(seen, cause):
    assert cause_by_gravity(seen).startswith(cause)


@pytest.mark.parametrize(("against", "words"), [("accelerometer", "accelerometer axes"), ("turns", "of the turns")])
def test_even_exchange_of_columns_is_refused(against, words):
    ring = rows("+y", "+z", "+x") @ SKEW
    assert np.linalg.det(ring) > 0.0  # right-handed
    with pytest.raises(Implausible, match=words) as caught:
        check_axis_order(ring, "rate table", against=against)
    assert caught.value.order == "+y, +z, +x"


# ---- runs at the end of the range, and steps too coarse to tell

SWING = 3.0 * np.sin(np.arange(2000) / 40.0)[:, None] * np.ones(3)
SLOW = np.round(40000.0 * np.sin(np.arange(3000) / 200.0))[:, None] + np.round(
    np.random.default_rng(0).normal(0.0, 5.0, (3000, 3))
)
TURN = np.round(2000.0 * np.sin(np.linspace(0.0, np.pi, 620)))[:, None] * np.ones(3)


def noisy(seed=0):
    return SWING + 0.01 * np.random.default_rng(seed).normal(size=SWING.shape)


# codes of a rest repeat for long, but no code is left and reached in one sample from far away
COARSE = np.round(np.concatenate((np.zeros((300, 3)), 100.0 * noisy(), np.zeros((300, 3)))))
SPOILT = COARSE.copy()
SPOILT[1000:1010, 0] = -32768.0
CUT = noisy()
CUT[:, 1] = CUT[:, 1].clip(None, 2.5)
POSES = [
    up + 0.02 * np.random.default_rng(n).normal(size=(200, 3))
    for n, up in enumerate(9.81 * np.vstack((np.eye(3), -np.eye(3))))
]


@pytest.mark.parametrize(
    ("windows", "extreme", "words"),
    [
        ([np.clip(SLOW, -32768, 32767)], 32767.0, "of x are"),
        ([CUT[:1000], CUT[1000:]], 2.5, "of y are"),
        ([TURN.clip(None, 1990.0)], 1990.0, "of x are"),
        ([SPOILT], -32768.0, "of x are"),
        ([pose.clip(None, 9.5) for pose in POSES], 9.5, "of x are"),  # a pose that sticks as a whole
    ],
)
def test_readings_at_the_end_of_the_range_are_refused(windows, extreme, words):
    with pytest.raises(Implausible, match=words) as caught:
        check_range(windows, "gyroscope")
    assert caught.value.extreme == extreme


def to_one_side():
    """Return a turn to one side between rests, in hundredths."""
    time = np.arange(1000) / 100.0
    rate = np.where((time > 3.0) & (time < 7.0), 2.0 * np.sin(np.pi * (time - 3.0) / 4.0) ** 2, 0.0) - 0.02
    return np.round(np.stack((rate, 0.0 * rate + 0.01, 0.0 * rate - 0.01), axis=1), 2)


@pytest.mark.parametrize(
    "windows",
    [
        [SLOW],
        [np.round(np.random.default_rng(0).normal(2.0, 0.6, (5000, 3)))],  # codes 0 to 5 repeat often
        [noisy()],
        [],
        [TURN],  # its rounded top is long enough to be taken for a run
        [COARSE],
        [np.repeat(100.0 * noisy(), 6, axis=0)],  # samples that are held
        POSES,
        [to_one_side()],
    ],
    ids=["slow", "codes", "swing", "none", "turn", "coarse", "held", "poses", "one side"],
)
def test_readings_within_the_range_pass(windows):
    check_range(windows, "gyroscope")
