"""Bench motions are exact: rate, force and orientation belong to one another."""

import math

import numpy as np
import pytest

from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product
from undrift.record import FACES
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import unit_vector

KINDS = ("six_face", "rate_table", "bench", "ferraris", "multi_position")
FEW_RATES = (0.2, 1.0)


def short(kind: str, **changes: object) -> BenchSettings:
    return BenchSettings(**{"still_s": 1.0, "first_still_s": 2.0, "poses": 6, "turn_rates": FEW_RATES, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_integrating_the_mean_rate_gives_back_the_orientation(kind: str) -> None:
    motion = bench_motion(kind, rng=np.random.default_rng(3), settings=short(kind))  # type: ignore[arg-type]
    q = integrate_strapdown(motion.mean_rate_b, motion.time, motion.q_nb[0])
    sine = np.linalg.norm(quaternion_product(quaternion_conjugate(motion.q_nb), q)[:, 1:], axis=1)
    assert sine.max() < 1e-12  # rounding of some thousand products


@pytest.mark.parametrize("kind", ["bench", "ferraris"])
def test_the_rate_is_the_derivative_of_the_orientation(kind: str) -> None:
    worst = []
    for sample_rate_hz in (100.0, 200.0):
        settings = short(kind, sample_rate_hz=sample_rate_hz)
        motion = bench_motion(kind, rng=np.random.default_rng(3), settings=settings)  # type: ignore[arg-type]
        slope = (motion.q_nb[2:] - motion.q_nb[:-2]) * (0.5 * sample_rate_hz)
        numeric = 2.0 * quaternion_product(quaternion_conjugate(motion.q_nb[1:-1]), slope)[:, 1:]
        worst.append(np.abs(numeric - motion.rate_b[1:-1]).max())
    assert worst[0] < 2e-3
    assert worst[1] < 0.35 * worst[0]  # a central difference errs by the square of its step: 1/4


def test_each_face_reads_plus_g_on_the_axis_that_points_up() -> None:
    motion = bench_motion("six_face", rng=np.random.default_rng(4), settings=short("six_face"))
    assert tuple(still.face for still in motion.stills) == FACES
    for still in motion.stills:
        force = motion.force_b[still.start : still.stop]
        np.testing.assert_allclose(
            force, np.tile(motion.gravity_m_s2 * unit_vector(still.face), (len(force), 1)), atol=1e-12
        )  # type: ignore[arg-type]


def test_table_dwells_hold_their_achieved_rate_about_the_axis_that_points_up() -> None:
    motion = bench_motion("rate_table", rng=np.random.default_rng(6), settings=short("rate_table"))
    assert [turn.turn_rate for turn in motion.turns] == [0.2, -0.2, 1.0, -1.0] * 3
    for turn in motion.turns:
        cut = slice(turn.start, turn.stop)
        wanted = turn.turn_rate * unit_vector(turn.axis)  # type: ignore[arg-type,operator]
        for rate in (motion.rate_b, motion.mean_rate_b):
            np.testing.assert_allclose(rate[cut], np.tile(wanted, (turn.stop - turn.start, 1)), atol=1e-12)
        up = motion.force_b[cut] @ unit_vector(turn.axis)  # type: ignore[arg-type]
        np.testing.assert_allclose(up, motion.gravity_m_s2, rtol=1e-12)


def test_hand_turns_sum_to_the_angle_and_are_anything_but_steady() -> None:
    motion = bench_motion("ferraris", rng=np.random.default_rng(7), settings=short("ferraris"))
    assert len(motion.turns) == 3
    for turn in motion.turns:
        mean = motion.mean_rate_b[turn.start : turn.stop] @ unit_vector(turn.axis)  # type: ignore[arg-type]
        assert abs(mean.sum() / 100.0 - 2.0 * math.pi) < 1e-12
        rate = motion.rate_b[turn.start : turn.stop] @ unit_vector(turn.axis)  # type: ignore[arg-type]
        assert abs(rate.sum() / 100.0 - 2.0 * math.pi) < 1e-8  # rectangle rule, flat at both ends: h^4 is left
        assert rate.max() > 1.3 * rate.mean()
        assert rate.min() >= 0.0
