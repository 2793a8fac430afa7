"""Optics: noise, gaps and delay as asked for."""

import numpy as np
import pytest

from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task


def angles(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return 2.0 * quaternion_product(quaternion_conjugate(p), q)[:, 1:]


def test_noise_has_the_stated_size_and_gaps_lie_in_the_motion() -> None:
    task = draw_task("free", rng=np.random.default_rng(1))
    reference = see(task, rng=np.random.default_rng(2), settings=OpticsSettings(angle_sd=1e-3, gaps=3))
    truth = task.at(reference.time, 9.81)
    seen = reference.valid
    assert 20 <= (~seen).sum() <= 60  # three gaps of 20 samples, which may overlap
    assert (reference.moving[~seen] == 1.0).all()  # type: ignore[index]
    error = angles(truth.q_nb[seen], reference.q_nb[seen])
    assert np.std(error) == pytest.approx(1e-3, rel=4.0 / np.sqrt(2.0 * error.size))


def test_a_delayed_pose_is_the_pose_of_that_much_earlier() -> None:
    task = draw_task("sit_to_stand", rng=np.random.default_rng(1))
    settings = OpticsSettings(angle_sd=0.0, position_sd=0.0, gaps=0, delay_s=0.05, sample_rate_hz=120.0)
    reference = see(task, rng=np.random.default_rng(2), settings=settings)
    truth = task.at(reference.time - 0.05, 9.81)
    assert np.abs(angles(truth.q_nb, reference.q_nb)).max() < 1e-12
    np.testing.assert_allclose(reference.position, task.position(reference.time - 0.05), atol=1e-12)


def test_a_marker_body_sits_askew_by_one_constant_turn() -> None:
    task = draw_task("free", rng=np.random.default_rng(1))
    settings = OpticsSettings(angle_sd=0.0, gaps=0, mount_sd=0.02)
    reference = see(task, rng=np.random.default_rng(2), settings=settings)
    askew = angles(task.at(reference.time, 9.81).q_nb, reference.q_nb)
    assert np.ptp(askew, axis=0).max() < 1e-12
    assert 0.002 < np.linalg.norm(askew[0]) < 0.1
