"""A rigid cluster gives back the pose that made it; gaps stay gaps; a line of markers is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from testkit.strategies import few
from undrift.errors import InputError
from undrift.io.mocap import Markers, fit_cluster, level_from, pose_from_cluster

SHAPE = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.01], [0.03, 0.09, -0.02], [-0.05, 0.04, 0.06]])
LABELS = ("A", "B", "C", "D")


def moving(n=50, seed=0, noise=0.0, shape=SHAPE):
    """A body that tumbles and travels: markers, true rotations and the true path of the centroid."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(size=(n, 3)) * 0.2, axis=0))
    path = np.cumsum(rng.normal(size=(n, 3)) * 0.01, axis=0)
    centred = shape - shape.mean(axis=0)
    points = np.stack([turn.apply(c) for c in centred], axis=1) + path[:, None]
    points += rng.normal(size=points.shape) * noise
    labels = tuple("ABCDEFG"[: len(shape)])
    return Markers(labels=labels, time=np.arange(n) / 100, points=points), turn, path


def turn_error(reference, turn):
    """Angle in rad between the pose and the truth, both taken from the first frame."""
    seen = reference.valid
    got = Rotation.from_quat(reference.q_nb[seen], scalar_first=True)
    true = turn[np.flatnonzero(seen)]
    return (got * (true * true[0].inv() * got[0]).inv()).magnitude()


@few
@given(seed=st.integers(0, 10_000))
def test_without_noise_the_pose_comes_back_exactly(seed):
    markers, turn, path = moving(seed=seed)
    found = fit_cluster(markers, LABELS)
    # 1e-7 rad: quaternions from matrices lose half of the digits near the identity
    assert turn_error(found.reference, turn).max() < 1e-7
    np.testing.assert_allclose(found.reference.position, path, atol=1e-12)
    assert found.rms < 1e-12
    np.testing.assert_allclose(found.reference.q_nb[0], [1, 0, 0, 0], atol=1e-9)


def test_noise_moves_the_pose_as_much_as_theory_says_and_shows_in_the_residual():
    sigma = 2e-4
    markers, turn, _ = moving(n=4000, noise=sigma)
    found = fit_cluster(markers, LABELS)
    centred = SHAPE - SHAPE.mean(axis=0)
    inertia = np.trace(centred.T @ centred) * np.eye(3) - centred.T @ centred
    # least squares: covariance of the small rotation is sigma^2 times the inverse of the cluster's inertia; the first
    # frame's own error adds a constant, so the spread about the mean is compared
    got = Rotation.from_quat(found.reference.q_nb, scalar_first=True)
    error = (turn.inv() * got).mean().inv() * (turn.inv() * got)
    expected = sigma * np.sqrt(np.trace(np.linalg.inv(inertia)))
    assert np.sqrt((error.as_rotvec() ** 2).sum(axis=1).mean()) == pytest.approx(expected, rel=0.05)
    # 12 coordinates, 6 of them spent on the pose: the rms over 4 markers is sigma sqrt(6 / 4)
    assert found.rms == pytest.approx(sigma * np.sqrt(6 / 4), rel=0.03)


def test_two_visible_markers_are_a_gap_and_three_are_a_pose():
    markers, turn, path = moving()
    points = np.array(markers.points)
    points[10, 0] = np.nan
    points[20, :2] = np.nan
    points[30] = np.nan
    found = fit_cluster(Markers(labels=LABELS, time=markers.time, points=points), LABELS)
    assert np.flatnonzero(~found.reference.valid).tolist() == [20, 30]
    assert np.flatnonzero(np.isnan(found.reference.position[:, 0])).tolist() == [20, 30]
    assert found.visible[[10, 20, 30]].tolist() == [3, 2, 0]
    np.testing.assert_allclose(found.reference.position[10], path[10], atol=1e-9)
    assert turn_error(found.reference, turn).max() < 1e-7


def test_a_mirror_image_is_never_the_answer_for_a_flat_cluster():
    flat = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    markers, turn, _ = moving(shape=flat)
    assert turn_error(pose_from_cluster(markers, ("A", "B", "C")), turn).max() < 1e-7


def test_clusters_that_give_no_pose_are_refused():
    markers, _, _ = moving()
    with pytest.raises(InputError, match="expected three different markers or more, got A, B"):
        fit_cluster(markers, ("A", "B"))
    with pytest.raises(InputError, match="expected three different markers or more, got A, A, B"):
        fit_cluster(markers, ("A", "A", "B"))
    with pytest.raises(InputError, match="marker 'Q', got A, B, C,"):
        fit_cluster(markers, ("A", "B", "Q"))
    line, _, _ = moving(shape=np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]]))
    with pytest.raises(InputError, match="expected markers that span a plane, got A, B, C on one line"):
        fit_cluster(line, ("A", "B", "C"))
    points = np.array(markers.points)
    points[:25, 0], points[25:, 1] = np.nan, np.nan
    never = Markers(labels=LABELS, time=markers.time, points=points)
    with pytest.raises(InputError, match=r"expected a frame with all of A, B, C, D, got none. Omit [AB]"):
        fit_cluster(never, LABELS)


def test_a_y_up_laboratory_turns_about_x_and_stays_right_handed():
    np.testing.assert_array_equal(level_from(np.eye(3), "y"), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert np.linalg.det(level_from(np.eye(3), "y")) == pytest.approx(1.0)
    np.testing.assert_array_equal(level_from(np.eye(3), "z"), np.eye(3))
    with pytest.raises(InputError, match='up: expected "y" or "z", got \'x\''):
        level_from(np.eye(3), "x")
