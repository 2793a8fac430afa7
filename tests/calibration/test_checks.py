"""Plausibility: each refusal names the number and what to do."""

import gzip

import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.calibration.checks import (
    axis_vectors,
    check_faces,
    check_gravity,
    check_handedness,
    check_saturation,
    check_scale_factor,
    face_vectors,
    missing_faces,
)
from undrift.errors import Implausible
from undrift.record import FACES
from undrift.units import STANDARD_GRAVITY

FORWARD = np.array([[1.02, 0.01, -0.008], [0.004, 0.97, 0.012], [-0.006, 0.009, 1.01]])
READING = 9.81 * face_vectors(FACES) @ FORWARD.T + np.array([0.3, -0.2, 0.1])


def test_faces_and_axes_become_signed_unit_vectors():
    np.testing.assert_array_equal(face_vectors(("-y", "+z")), [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(axis_vectors(("z", "x")), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert missing_faces(("+x", "-x", "+y", "-z")) == ("-y", "+z")


def test_good_faces_pass():
    check_faces(READING, FACES)
    check_faces(np.concatenate((READING, READING[:2] + 0.02)), (*FACES, "+x", "-x"))


def test_a_face_recorded_twice_is_named():
    twice = READING.copy()
    twice[3] = twice[0] + 0.02
    with pytest.raises(Implausible, match=r"faces \+x and -y: wanted two poses, got readings 0\.00\d g apart"):
        check_faces(twice, FACES)


@pytest.mark.parametrize(("wrong", "apart"), [("-y", "1.9"), ("-z", "1.")])
def test_a_label_stated_twice_is_named_with_what_is_missing(wrong, apart):
    labels = tuple("+y" if face == wrong else face for face in FACES)
    words = rf"face \+y: stated twice, readings {apart}\d* g apart; {wrong} missing: one of the two is another face"
    with pytest.raises(Implausible, match=words):
        check_faces(READING, labels)


@pytest.mark.parametrize(("a", "b"), [(0, 2), (1, 4), (3, 5)])
def test_two_swapped_faces_are_named(a, b):
    swapped = READING.copy()
    swapped[[a, b]] = swapped[[b, a]]
    with pytest.raises(Implausible, match=r"are swapped: correct the labels in session.toml") as caught:
        check_faces(swapped, FACES)
    assert set(caught.value.swapped) == {FACES[a], FACES[b]}


def test_opposite_faces_swapped_are_named_although_the_fit_would_be_perfect():
    swapped = READING.copy()
    swapped[[2, 3]] = swapped[[3, 2]]
    with pytest.raises(Implausible, match=r"faces \+y and -y: wanted the axis that points up to read the larger value"):
        check_faces(swapped, FACES)


def test_labels_in_disorder_are_refused_even_when_no_single_swap_explains_them():
    disorder = READING[[2, 3, 0, 1, 5, 4]][[1, 4, 0, 2, 5, 3]]
    with pytest.raises(Implausible):
        check_faces(disorder, FACES)


def test_a_quarter_of_gravity_is_called_a_wrong_unit_or_range():
    with pytest.raises(Implausible, match=r"\(0\.25\d g\); readings are 4 times too small: check the unit") as caught:
        check_gravity(READING / 3.97, 9.81)
    assert caught.value.ratio == pytest.approx(0.25, abs=0.01)
    check_gravity(READING, 9.81)


@pytest.mark.parametrize(("name", "ratio"), [("BMI_270_hot_test", 0.252), ("BMI_270_cold_test", 0.254)])
def test_the_hot_and_cold_bmi270_logs_are_caught_at_a_quarter_of_gravity(name, ratio):
    # A public log (2026; MIT) whose firmware divides by 16384 in the +-8 g range; its broken first and last lines are skipped.
    with gzip.open(data_path("thermal_bmi270_two_point", f"{name}.csv.gz"), "rt", errors="replace") as file:
        rows = [line.strip().split(",") for line in file]
    accel = np.array([[float(x) for x in row[1:4]] for row in rows if len(row) == 7 and _numbers(row)])
    with pytest.raises(Implausible, match="readings are 4 times too small") as caught:
        check_gravity(accel * STANDARD_GRAVITY, STANDARD_GRAVITY)
    show(f"{name} |a|, g", f"{caught.value.ratio:.4f}", ratio)
    assert caught.value.ratio == pytest.approx(ratio, abs=0.001)


def _numbers(row):
    try:
        return all(np.isfinite(float(x)) for x in row)
    except ValueError:
        return False


def test_left_handed_axes_are_refused_with_the_axis():
    with pytest.raises(
        Implausible, match=r"gyroscope: wanted right-handed axes, got a left-handed triad: gyroscope reversed about y;"
    ):
        check_handedness(np.diag([1.0, -1.0, 1.0]), "gyroscope")
    with pytest.raises(Implausible, match=r"gyroscope columns x and y are exchanged"):
        check_handedness(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), "gyroscope")
    check_handedness(FORWARD, "gyroscope")


def test_a_gain_off_by_two_is_called_a_factor_and_the_sample_rate_is_named():
    with pytest.raises(
        Implausible, match=r"got 2\.0100 of it \(\+101\.0 %\); readings are 2 times too large: .*sample rate"
    ):
        check_scale_factor(np.array([1.99, 2.01, 2.0]), 1.0, 0.2, "gyroscope")
    with pytest.raises(
        Implausible, match=r"within 3 % of the stated sensitivity, got 0\.8507 of it \(-14\.9 %\); check"
    ):
        check_scale_factor(np.array([0.8507]), 1.0, 0.03, "gyroscope y")
    check_scale_factor(np.array([1.0, 1.02, 0.98]), 1.0, 0.03, "gyroscope")


def test_readings_stuck_at_the_end_of_the_range_are_found_and_quantised_rest_is_not():
    rng = np.random.default_rng(0)
    motion = np.round(40000.0 * np.sin(np.arange(3000) / 200.0))[:, None] + np.round(rng.normal(0.0, 5.0, (3000, 3)))
    clipped = np.clip(motion, -32768, 32767)
    with pytest.raises(
        Implausible, match=r"gyroscope x: wanted readings inside the range, got \d+ samples stuck at 32767"
    ):
        check_saturation(clipped, "gyroscope")
    check_saturation(motion, "gyroscope")
    check_saturation(np.round(rng.normal(2.0, 0.6, (5000, 3))), "gyroscope")  # codes 0..5 repeat often and mean nothing


def test_the_scale_factor_that_is_named_is_the_one_furthest_off_either_way():
    with pytest.raises(Implausible, match=r"got 0\.7000 of it \(-30\.0 %\)"):
        check_scale_factor(np.array([1.2, 0.7, 1.0]) * 16.4, 16.4, 0.25, "gyroscope")
    with pytest.raises(Implausible, match=r"got 1\.4000 of it \(\+40\.0 %\)"):
        check_scale_factor(np.array([1.4, 0.7, 1.0]) * 16.4, 16.4, 0.25, "gyroscope")
