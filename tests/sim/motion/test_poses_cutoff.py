from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import quaternion_of, quaternion_product
from undrift.record import Reference
from undrift.sim.motion.poses import choose_cutoff, cutoff_by_residual, cutoff_by_rest

METHODS = {"residual": cutoff_by_residual, "rest": cutoff_by_rest}


def swung(noise: float = 1e-3, highest_hz: float = 4.0) -> Reference:
    """10 s of rest, then 30 s of swinging with content up to a known frequency, as noisy cameras see it."""
    rng = np.random.default_rng(3)
    time = np.arange(4000) / 100.0
    on = np.clip(time - 10.0, 0.0, 1.0)
    angle = np.zeros((4000, 3))
    for f in np.arange(0.5, highest_hz + 0.01, 0.5):
        angle += 0.3 / f * np.sin(2.0 * np.pi * f * time[:, None] + rng.uniform(0.0, 6.0, 3)) * on[:, None]
    q = quaternion_product(quaternion_of(angle), quaternion_of(rng.normal(0.0, noise, (4000, 3))))
    position = angle * 0.3 + rng.normal(0.0, 0.3 * noise, (4000, 3))
    return Reference(time=time, q_nb=q, position=position, moving=(time > 10.0).astype(float))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("signal", ["orientation", "position"])
def test_the_cut_off_lies_above_the_motion_and_well_below_half_the_sample_rate(method, signal):
    chosen = METHODS[method](swung(), signal)
    show(f"motion up to 4 Hz, {signal} by {method}", f"{chosen.cutoff_hz:.1f} Hz: {chosen.reason}", "4 to 15 Hz")
    assert 4.0 <= chosen.cutoff_hz <= 15.0  # products of angles reach beyond 4 Hz


@pytest.mark.slow
def test_more_noise_asks_for_a_lower_cut_off():
    for method, choose in METHODS.items():
        quiet, loud = (choose(swung(noise), "orientation").cutoff_hz for noise in (1e-4, 1e-2))
        show(f"{method}: noise of 0.1 and of 10 mrad, Hz", f"{quiet:.1f} {loud:.1f}")
        assert loud < quiet


def test_the_noise_that_the_residual_points_to_is_the_noise_that_was_put_in():
    # Winter's straight line over-reaches for white noise, whose residual bends: sqrt(1 - f / f_N).
    reason = cutoff_by_residual(swung(1e-3), "position").reason
    assert 0.2 < float(reason.split("noise of ")[1].split()[0]) < 0.4


def test_cameras_that_are_noisier_in_motion_have_no_crossing_and_the_residual_is_taken():
    poses = swung(1e-3)
    rng = np.random.default_rng(9)
    shake = quaternion_of(rng.normal(0.0, 1e-2, (4000, 3)) * poses.moving[:, None])
    noisy = replace(poses, q_nb=quaternion_product(poses.q_nb, shake))
    assert cutoff_by_rest(noisy, "orientation") is None
    assert choose_cutoff(noisy).method == "residual"
    assert choose_cutoff(poses).method == "rest"
    assert choose_cutoff(replace(poses, moving=None)).method == "residual"


def test_without_a_rest_of_two_seconds_the_residual_is_taken():
    poses = swung()
    short, shorter = (1.0 - ((poses.time >= 1.0) & (poses.time <= 1.0 + length_s)) for length_s in (1.0, 0.05))
    for moving in (short, shorter, np.ones(len(poses.time))):
        assert choose_cutoff(replace(poses, moving=moving)).method == "residual"


def test_positions_are_asked_for_where_there_are_none():
    poses = swung()
    with pytest.raises(InputError, match="wanted positions, got poses without"):
        choose_cutoff(replace(poses, position=None), signal="position")
