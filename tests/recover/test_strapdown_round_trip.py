"""Motion -> ideal rate -> strapdown gives the motion back."""

import numpy as np
import pytest

from testkit.data import show
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product
from undrift.sim.motion.tasks import draw_task


def end_to_end_deg(q, truth):
    e = quaternion_product(q, quaternion_conjugate(truth))
    return float(np.degrees(2.0 * np.arctan2(np.linalg.norm(e[:, 1:], axis=1), np.abs(e[:, 0]))).max())


@pytest.mark.parametrize("name", ["sit_to_stand", "posturography", "free"])
def test_a_noise_free_gyroscope_gives_back_120_seconds_of_motion(name):
    task = draw_task(name, rng=np.random.default_rng(7), rest_s=30.0)
    motion = task.at(np.arange(12_000) * 0.01, 9.81)
    off = end_to_end_deg(integrate_strapdown(motion.mean_rate_b, motion.time, motion.q_nb[0]), motion.q_nb)
    show(f"{name}: largest angle over 120 s, deg", off, 0.01)
    assert off < 1e-9  # the promise is 0.01; the rule is exact for step means, so only 12,000 roundings are left
