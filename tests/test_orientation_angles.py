"""Inclination, heading, sagittal pitch, Cardan angles."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.frames import quaternion_product
from undrift.orientation import heading_of, inclination_of, sagittal_pitch


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


def test_heading_and_inclination_part_a_turn_about_the_vertical_from_a_lean():
    lean = np.linspace(-3.0, 3.0, 25)
    q = quaternion_product(about(Z, 0.7), about([0.6, 0.8, 0.0], lean))
    np.testing.assert_allclose(heading_of(q), 0.7, rtol=0, atol=1e-14)
    np.testing.assert_allclose(inclination_of(q), np.abs(lean), rtol=0, atol=1e-14)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_pitch_follows_a_forward_lean_through_the_vertical_and_beyond(heading):
    lean = np.linspace(-3.1, 3.1, 63)  # past +-90 deg, where an Euler pitch would turn back
    q = quaternion_product(about(Z, heading), about(Y, lean))
    np.testing.assert_allclose(sagittal_pitch(q), lean, rtol=0, atol=1e-14)


def test_pitch_reads_the_same_lean_in_any_mounting():
    lean = np.linspace(-1.5, 1.5, 31)
    # device x up and z backward: forward is -z; the mediolateral axis that stays is y
    np.testing.assert_allclose(
        sagittal_pitch(quaternion_product(about(Y, lean), about(Y, -np.pi / 2)), forward="-z", up="+x"),
        lean,
        rtol=0,
        atol=1e-14,
    )


def test_pitch_is_a_gap_only_where_the_vertical_leaves_the_plane():
    side = np.radians([0.0, 60.0, 84.0, 86.0, 90.0])
    pitch = sagittal_pitch(about(X, side))
    np.testing.assert_array_equal(np.isnan(pitch), [False, False, False, True, True])


def test_axes_that_span_no_plane_are_refused():
    with pytest.raises(InputError, match=r"two different axes .* got forward [+]x and up -x"):
        sagittal_pitch(ANY, forward="+x", up="-x")
    with pytest.raises(InputError, match="got forward up and up"):
        sagittal_pitch(ANY, forward="up")


def test_gaps_pass_through_every_angle():
    q = ANY.copy()
    q[3] = np.nan
    for values in (inclination_of(q), heading_of(q), sagittal_pitch(q)):
        assert np.isnan(values[3])
        assert np.isfinite(values[:3]).all()
