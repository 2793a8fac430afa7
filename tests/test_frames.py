"""Quaternions w-x-y-z against scipy's rotations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from testkit.strategies import few
from undrift.frames import (
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation,
    rotation_vector,
)

quaternions = st.integers(1, 9).flatmap(lambda n: arrays(np.float64, (2, n, 4), elements=st.floats(0.1, 1.0)))


@few
@given(pair=quaternions, v=arrays(np.float64, 3, elements=st.floats(-10, 10)))
def test_product_conjugate_and_rotation_agree_with_scipy(pair, v):
    p, q = pair / np.linalg.norm(pair, axis=2, keepdims=True)
    product = quaternion_product(p, q)
    # 1e-12: a few roundings of numbers up to 10
    np.testing.assert_allclose(rotate(product, v[None]), (rotation(p) * rotation(q)).apply(v), atol=1e-12)
    np.testing.assert_allclose(rotate(quaternion_conjugate(q), rotate(q, v[None])), np.tile(v, (len(q), 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(product, axis=1), 1.0, atol=1e-14)


def test_a_quarter_turn_about_z_takes_x_to_y():
    q = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(rotate(q, np.array([1.0, 0.0, 0.0])), [0, 1, 0], atol=1e-15)


def test_gaps_pass_through():
    q = np.array([[1.0, 0, 0, 0], [np.nan] * 4])
    assert np.isnan(quaternion_product(q, q)[1]).all()
    assert np.isnan(rotate(q, np.ones((2, 3)))[1]).all()
    np.testing.assert_array_equal(rotate(q, np.ones((2, 3)))[0], [1, 1, 1])


def test_rotation_vector_takes_the_short_way():
    vector = np.array([0.3, -2.0, 1.1])  # 2.3 rad
    q = quaternion_of(vector)
    np.testing.assert_allclose(rotation_vector(np.stack((q, -q))), [vector, vector], rtol=0, atol=1e-15 * 10)
    long_way = vector * (1.0 - 2.0 * np.pi / np.linalg.norm(vector))
    np.testing.assert_allclose(rotation_vector(quaternion_of(long_way)), vector, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(rotation_vector(np.array([-1.0, 0.0, 0.0, 0.0])), 0.0)
