"""Error definitions: total, heading, inclination, pitch."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from undrift.validation.trial import compare_orientations, of_finite, rms, wrapped


def quaternions(r):
    return r.as_quat(scalar_first=True)


def test_a_turn_about_the_vertical_is_heading_alone():
    true = Rotation.random(50, rng=np.random.default_rng(0))
    wrong = Rotation.from_euler("z", -12.0, degrees=True) * true
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.heading) == pytest.approx(np.full(50, -12.0))
    assert np.degrees(error.total) == pytest.approx(np.full(50, 12.0))
    assert np.abs(error.inclination).max() < 1e-7
    assert np.nanmax(np.abs(error.pitch)) < 1e-9


def test_a_turn_about_a_level_axis_is_inclination_alone():
    true = Rotation.random(50, rng=np.random.default_rng(1))
    wrong = Rotation.from_rotvec(np.radians(7.0) * np.array([0.6, -0.8, 0.0])) * true
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.inclination) == pytest.approx(np.full(50, 7.0))
    assert np.abs(error.heading).max() < 1e-7


def test_the_sign_of_a_quaternion_does_not_matter_and_large_headings_wrap():
    true = Rotation.random(20, rng=np.random.default_rng(2))
    wrong = Rotation.from_euler("z", 179.0, degrees=True) * true
    q = quaternions(wrong) * np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    error = compare_orientations(q, quaternions(true))
    assert np.degrees(error.heading) == pytest.approx(np.full(20, 179.0))


def test_a_pitch_error_has_its_sign_and_follows_the_axes_given():
    true = Rotation.from_euler("y", [[10.0], [-20.0], [35.0]], degrees=True)
    wrong = Rotation.from_euler("y", [[12.0], [-21.0], [35.5]], degrees=True)
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.pitch) == pytest.approx([2.0, -1.0, 0.5])
    backward = compare_orientations(quaternions(wrong), quaternions(true), forward="-x")
    assert np.degrees(backward.pitch) == pytest.approx([-2.0, 1.0, -0.5])


def test_gaps_stay_gaps_and_count_nowhere():
    true = quaternions(Rotation.random(4, rng=np.random.default_rng(3)))
    seen = true.copy()
    seen[2] = np.nan
    error = compare_orientations(true, seen)
    assert np.isnan(error.total).tolist() == [False, False, True, False]
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))
    assert of_finite(np.median, np.array([1.0, np.nan, 3.0])) == 2.0
    assert np.isnan(rms(np.array([np.nan])))
    assert np.isnan(of_finite(np.median, np.array([np.nan])))


def test_wrapped_angles():
    assert wrapped(np.array([3.5, -3.5, np.pi, -np.pi])) == pytest.approx(
        [3.5 - 2 * np.pi, 2 * np.pi - 3.5, np.pi, np.pi]
    )
