"""Plausibility: each refusal names the number and what to do."""

import gzip
import itertools

import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.calibration.plausibility import (
    axis_vectors,
    cause_by_gravity,
    check_axis_order,
    check_faces,
    check_gravity,
    check_gyro_scale,
    check_own_scale,
    check_range,
    columns_text,
    face_vectors,
    missing_faces,
    nearest_signed_permutation,
    stuck_windows,
)
from undrift.errors import Implausible
from undrift.record import FACES
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

FORWARD = np.array([[1.02, 0.01, -0.008], [0.004, 0.97, 0.012], [-0.006, 0.009, 1.01]])
READING = 9.81 * face_vectors(FACES) @ FORWARD.T + np.array([0.3, -0.2, 0.1])


def test_faces_and_axes_become_signed_unit_vectors():
    np.testing.assert_array_equal(face_vectors(("-y", "+z")), [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(axis_vectors(("z", "x")), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert missing_faces(("+x", "-x", "+y", "-z")) == ("-y", "+z")


def test_good_faces_pass():
    check_faces(READING, FACES)
    check_faces(np.concatenate((READING, READING[:2] + 0.02)), (*FACES, "+x", "-x"))


def test_gravity_is_the_length_of_the_force_in_any_pose():
    check_gravity(np.full((4, 3), 9.81 / np.sqrt(3.0)), 9.81)


def test_a_face_recorded_twice_is_named():
    twice = READING.copy()
    twice[3] = twice[0] + 0.02
    with pytest.raises(Implausible, match=r"faces \+x and -y .* recorded twice"):
        check_faces(twice, FACES)


@pytest.mark.parametrize("wrong", ["-y", "-z"])
def test_a_label_stated_twice_is_named_with_what_is_missing(wrong):
    labels = tuple("+y" if face == wrong else face for face in FACES)
    with pytest.raises(Implausible, match=rf"face \+y is labelled twice, and {wrong} is missing"):
        check_faces(READING, labels)


@pytest.mark.parametrize(("a", "b"), [(0, 2), (1, 4), (3, 5)])
def test_two_swapped_faces_are_named(a, b):
    swapped = READING.copy()
    swapped[[a, b]] = swapped[[b, a]]
    with pytest.raises(Implausible, match=r"are swapped") as caught:
        check_faces(swapped, FACES)
    assert set(caught.value.numbers["wrong"]) == {FACES[a], FACES[b]}


def test_opposite_faces_swapped_are_named_although_the_fit_would_be_perfect():
    swapped = READING.copy()
    swapped[[2, 3]] = swapped[[3, 2]]
    with pytest.raises(Implausible, match=r"column y is reversed, or faces \+y and -y are swapped"):
        check_faces(swapped, FACES)


def test_accelerometer_columns_in_another_order_or_sign_are_named():
    for columns, cause in (((1, 0, 2), "columns x and y are exchanged"), ((1, 2, 0), "exchanged in a ring")):
        with pytest.raises(Implausible, match=f"accelerometer .*{cause}"):
            check_faces(READING[:, columns], FACES)
    with pytest.raises(Implausible, match="opposite sign"):
        check_faces(-READING, FACES)


def test_five_faces_are_judged_as_six():
    check_faces(READING[:5], FACES[:5])
    with pytest.raises(Implausible, match=r"faces \+x and \+z are swapped"):
        check_faces(READING[[4, 1, 2, 3, 0]], FACES[:5])


def test_labels_in_disorder_are_refused_even_when_no_single_swap_explains_them():
    disorder = READING[[2, 3, 0, 1, 5, 4]][[1, 4, 0, 2, 5, 3]]
    with pytest.raises(Implausible):
        check_faces(disorder, FACES)


def test_a_quarter_of_gravity_is_called_a_wrong_unit_or_range():
    with pytest.raises(Implausible, match=r"\(0\.25\d g\): readings are 4 times too small") as caught:
        check_gravity(READING / 3.97, 9.81)
    assert caught.value.ratio == pytest.approx(0.25, abs=0.01)
    check_gravity(READING, 9.81)


@pytest.mark.parametrize(("name", "ratio"), [("BMI_270_hot_test", 0.252), ("BMI_270_cold_test", 0.254)])
def test_the_hot_and_cold_bmi270_logs_are_caught_at_a_quarter_of_gravity(name, ratio):
    # A public log (2026; MIT) whose firmware divides by 16384 in the +-8 g range; its broken first and last lines are skipped.
    with gzip.open(data_path("thermal_bmi270_two_point", f"{name}.csv.gz"), "rt", errors="replace") as file:
        rows = [line.strip().split(",") for line in file]
    accel = np.array([[float(x) for x in row[1:4]] for row in rows if len(row) == 7 and _numbers(row)])
    with pytest.raises(Implausible, match=r"readings are (3\.9|4) times too small") as caught:
        check_gravity(accel * STANDARD_GRAVITY, STANDARD_GRAVITY)
    show(f"{name} |a|, g", f"{caught.value.ratio:.4f}", ratio)
    assert caught.value.ratio == pytest.approx(ratio, abs=0.001)


def _numbers(row):
    try:
        return all(np.isfinite(float(x)) for x in row)
    except ValueError:
        return False


def test_a_gain_off_by_two_is_called_a_factor_and_the_sample_rate_is_named():
    with pytest.raises(Implausible, match=r"got 2\.0100 of it \(\+101\.0 %\): readings are 2 times too large"):
        check_own_scale(np.array([1.99, 2.01, 2.0]), "rad/s", "rate", 0.2, "gyroscope")
    with pytest.raises(Implausible, match=r"within 3 % .* got 0\.8507 of it \(-14\.9 %\)"):
        check_own_scale(np.array([0.8507]), "rad/s", "rate", 0.03, "gyroscope y")
    with pytest.raises(Implausible, match=r"has 50 samples a second instead of 100"):
        check_own_scale(np.array([0.5]), "rad/s", "rate", 0.2, "gyroscope", sample_rate_hz=100.0)
    check_own_scale(np.array([1.0, 1.02, 0.98]), "rad/s", "rate", 0.03, "gyroscope")
    check_own_scale(np.array([16.4]), "count", "rate", 0.03, "gyroscope")


def test_readings_stuck_at_the_end_of_the_range_are_found_and_quantised_rest_is_not():
    rng = np.random.default_rng(0)
    motion = np.round(40000.0 * np.sin(np.arange(3000) / 200.0))[:, None] + np.round(rng.normal(0.0, 5.0, (3000, 3)))
    clipped = np.clip(motion, -32768, 32767)
    with pytest.raises(Implausible, match=r"gyroscope: \d+ samples of x are stuck at 32767"):
        check_range([clipped], "gyroscope")
    check_range([motion], "gyroscope")
    check_range([np.round(rng.normal(2.0, 0.6, (5000, 3)))], "gyroscope")  # codes 0..5 repeat often and mean nothing


def test_the_scale_factor_that_is_named_is_the_one_furthest_off_either_way():
    for scales, off in (
        ((1.2, 0.7, 1.0), r"0\.7000 of it \(-30\.0 %\)"),
        ((1.4, 0.7, 1.0), r"1\.4000 of it \(\+40\.0 %\)"),
    ):
        with pytest.raises(Implausible, match=f"got {off}"):
            check_own_scale(np.array(scales), "rad/s", "rate", 0.25, "gyroscope")


@pytest.mark.parametrize(
    ("scale", "level"), [((1.0, 0.853, 1.0), ["fail"]), ((1.0, 1.0, 0.93), ["warn"]), ((1.03, 0.97, 1.0), [])]
)
def test_a_gyroscope_s_scale_is_judged_by_what_data_sheets_allow(scale, level):
    found = list(check_gyro_scale(np.array(scale) / RADIAN_PER_DEGREE, "dps", 1.0, rates_given=True))
    assert [item.level for item in found] == level
    if level == ["fail"]:
        assert found[0].values["off_percent"] == pytest.approx(-14.7)
        assert "Gyroscope y" in found[0].sentence


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


def test_every_one_of_the_48_orders_is_found_behind_a_skewed_triad():
    for order in itertools.permutations("xyz"):
        for signs in itertools.product("+-", repeat=3):
            seen = rows(*(s + a for s, a in zip(signs, order, strict=True)))
            np.testing.assert_array_equal(nearest_signed_permutation(800.0 * seen @ SKEW), seen)


def test_the_order_as_it_should_be_passes():
    check_axis_order(SKEW, "rate table", against="turns")
    check_axis_order(SKEW, "gyro", against="accelerometer")


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        (rows("+x", "-y", "+z"), "gyroscope column y is reversed"),
        (rows("-x", "-y", "+z"), "accelerometer column z is reversed, or gyroscope columns x and y are reversed"),
        (rows("-x", "-y", "-z"), "all gyroscope columns are reversed, or the same two columns of both triads"),
        (rows("+y", "+x", "+z"), "gyroscope columns x and y are exchanged"),
        (rows("-y", "-x", "-z"), "accelerometer columns x and y are exchanged, or gyroscope columns x and y are"),
        (rows("+y", "+z", "+x"), "gyroscope columns x, y and z are exchanged in a ring, or accelerometer columns x, y"),
        (rows("+y", "-z", "-x"), "gyroscope columns x, y and z are exchanged in a ring, and y and z reversed"),
    ],
)
def test_gravity_names_the_columns_of_either_triad(seen, cause):
    assert cause_by_gravity(seen).startswith(cause)


def test_exchanged_accelerometer_columns_show_as_the_cause_says():
    exchanged = rows("+y", "+x", "+z")  # a' = A a; a turn seen in that frame is det(A) A w
    forward = np.linalg.inv(np.linalg.det(exchanged) * exchanged)
    assert cause_by_gravity(nearest_signed_permutation(forward)).startswith(
        "accelerometer columns x and y are exchanged"
    )


def test_columns_that_are_exchanged_or_reversed_are_named():
    assert columns_text(rows("+y", "+x", "+z")) == "columns x and y are exchanged"
    assert columns_text(rows("+y", "+z", "+x")) == "columns x, y and z are exchanged in a ring"
    assert columns_text(rows("+x", "+y", "-z")) == "column z is reversed"


def test_an_even_exchange_is_right_handed_and_refused_all_the_same():
    ring = rows("+y", "+z", "+x") @ SKEW
    assert np.linalg.det(ring) > 0.0
    with pytest.raises(Implausible, match=r"accelerometer axes \+y, \+z, \+x: ") as caught:
        check_axis_order(ring, "gyro against accel", against="accelerometer")
    assert caught.value.numbers["order"] == "+y, +z, +x"
    with pytest.raises(Implausible, match=r"\+y, \+z, \+x: .* or the axes or signs of the turns"):
        check_axis_order(ring, "rate table", against="turns")


# ---- runs at the end of the range, and steps too coarse to tell

SWING = 3.0 * np.sin(np.arange(2000) / 40.0)[:, None] * np.ones(3)


def noisy(seed=0):
    return SWING + 0.01 * np.random.default_rng(seed).normal(size=SWING.shape)


def test_readings_cut_off_at_the_top_are_named_with_their_axis():
    cut = noisy()
    cut[:, 1] = cut[:, 1].clip(None, 2.5)
    check_range([noisy()], "gyroscope")
    check_range([], "gyroscope")
    with pytest.raises(Implausible, match=r"gyroscope: \d+ samples of y are stuck at 2.5"):
        check_range([cut[:1000], cut[1000:]], "gyroscope")


def test_coarse_steps_and_gaps_say_nothing():
    check_range([np.round(noisy())], "gyroscope")
    check_range([np.full((50, 3), np.nan)], "gyroscope")


def test_the_rounded_top_of_a_turn_is_no_end_of_the_range():
    turn = np.round(2000.0 * np.sin(np.linspace(0.0, np.pi, 620)))[:, None] * np.ones(3)
    assert (turn == turn.max()).sum() >= 3 * 5  # a run long enough to be taken for one
    check_range([turn], "gyroscope in the turn about z")
    with pytest.raises(Implausible, match="stuck at 1990"):
        check_range([turn.clip(None, 1990.0)], "gyroscope in the turn about z")


def test_a_reading_that_jumps_to_the_end_of_the_range_is_seen_among_coarse_codes_at_rest():
    """Codes of a rest repeat for long, but no code is left and reached in one sample from far away."""
    coarse = np.round(np.concatenate((np.zeros((300, 3)), 100.0 * noisy(), np.zeros((300, 3)))))
    check_range([coarse], "gyroscope")
    spoilt = coarse.copy()
    spoilt[1000:1010, 0] = -32768.0
    with pytest.raises(Implausible, match=r"gyroscope: 10 samples of x are stuck at -32768"):
        check_range([spoilt], "gyroscope")
    assert stuck_windows([coarse[:1000], spoilt[900:1100], coarse[1000:]]).tolist() == [False, True, False]


def test_samples_that_are_held_are_no_end_of_the_range():
    check_range([np.repeat(100.0 * noisy(), 6, axis=0)], "gyroscope")


def test_a_pose_that_sticks_as_a_whole_is_seen_among_the_others():
    rng = np.random.default_rng(1)
    poses = [up + 0.02 * rng.normal(size=(200, 3)) for up in 9.81 * np.vstack((np.eye(3), -np.eye(3)))]
    check_range(poses, "accelerometer")
    with pytest.raises(Implausible, match=r"accelerometer: .* of x are stuck at 9\.5"):
        check_range([pose.clip(None, 9.5) for pose in poses], "accelerometer")


def test_level_at_rest_of_a_turn_to_one_side_is_no_end_of_the_range():
    time = np.arange(1000) / 100.0
    rate = np.where((time > 3.0) & (time < 7.0), 2.0 * np.sin(np.pi * (time - 3.0) / 4.0) ** 2, 0.0) - 0.02
    log = np.round(np.stack((rate, 0.0 * rate + 0.01, 0.0 * rate - 0.01), axis=1), 2)
    check_range([log], "gyroscope")
