from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import quaternion_of, quaternion_product
from undrift.record import Reference
from undrift.sim.motion.poses import choose_cutoff


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


@pytest.mark.parametrize("method", ["residual", "rest"])
@pytest.mark.parametrize("signal", ["orientation", "position"])
def test_the_cut_off_lies_above_the_motion_and_well_below_half_the_sample_rate(method, signal):
    chosen = choose_cutoff(swung(), method=method, signal=signal)
    show(f"motion up to 4 Hz, {signal} by {method}", f"{chosen.cutoff_hz:.1f} Hz: {chosen.reason}", "4 to 15 Hz")
    assert 4.0 <= chosen.cutoff_hz <= 15.0  # products of angles reach beyond 4 Hz


def test_more_noise_asks_for_a_lower_cut_off():
    for method in ("residual", "rest"):
        quiet, loud = (choose_cutoff(swung(noise), method=method).cutoff_hz for noise in (1e-4, 1e-2))
        show(f"{method}: noise of 0.1 and of 10 mrad, Hz", f"{quiet:.1f} {loud:.1f}")
        assert loud < quiet


def test_the_noise_that_the_residual_points_to_is_the_noise_that_was_put_in():
    # Winter's straight line over-reaches for white noise, whose residual bends: sqrt(1 - f / f_N).
    reason = choose_cutoff(swung(1e-3), method="residual", signal="position").reason
    assert 0.2 < float(reason.split("noise of ")[1].split()[0]) < 0.4


def test_cameras_that_are_noisier_in_motion_have_no_crossing_and_it_says_so():
    poses = swung(1e-3)
    rng = np.random.default_rng(9)
    shake = quaternion_of(rng.normal(0.0, 1e-2, (4000, 3)) * poses.moving[:, None])
    noisy = replace(poses, q_nb=quaternion_product(poses.q_nb, shake))
    chosen = choose_cutoff(noisy, method="rest")
    assert chosen.cutoff_hz == pytest.approx(35.0)
    assert "no crossing, choose another method" in chosen.reason
    assert choose_cutoff(noisy).method == "residual"  # left to itself it takes the other method
    assert choose_cutoff(poses).method == "rest"
    assert choose_cutoff(replace(poses, moving=None)).method == "residual"


def test_what_a_method_needs_is_asked_for():
    poses = swung()
    with pytest.raises(InputError, match="wanted a rest, got no stretch marked as not moving"):
        choose_cutoff(replace(poses, moving=None), method="rest")
    with pytest.raises(InputError, match="wanted positions, got poses without"):
        choose_cutoff(replace(poses, position=None), method="residual", signal="position")
    short = 1.0 - ((poses.time >= 1.0) & (poses.time <= 2.0))
    with pytest.raises(InputError, match=r"wanted 2 s or more of rest and of motion without a long gap, got 1 s"):
        choose_cutoff(replace(poses, moving=short), method="rest")
