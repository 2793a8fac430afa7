"""Poses to motion: splines, gaps, low-pass, and simulated optics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotation_vector
from undrift.record import Reference
from undrift.sim.motion.motion import Sway
from undrift.sim.motion.poses import (
    OpticsSettings,
    PoseSettings,
    find_stretches,
    fit_pose_spline,
    see,
    zero_phase,
)
from undrift.sim.motion.tasks import Task, draw_task

G = 9.81


def tumble(duration_s: float = 20.0) -> Task:
    """A body that turns about all axes while it travels along all."""

    def swung(amplitude, frequency, phase):
        return (Sway((amplitude,), (frequency,), (phase,), -10.0, duration_s + 10.0, 1.0),)

    return Task(
        name="tumble",
        duration_s=duration_s,
        moving_s=(0.0, duration_s),
        roll=swung(0.7, 0.9, 0.1),
        pitch=swung(0.9, 1.3, 1.0),
        yaw=swung(2.5, 0.4, 2.0),
        forward=swung(0.3, 0.8, 0.3),
        left=swung(0.2, 1.1, 1.3),
        up=swung(0.1, 1.7, 2.3),
    )


def poses_of(task: Task, rate_hz: float = 120.0) -> Reference:
    time = np.arange(round(task.duration_s * rate_hz)) / rate_hz
    return Reference(time=time, q_nb=task.at(time, G).q_nb, position=task.position(time))


def worst(a, b):
    return float(np.nanmax(np.abs(a - b)))


def angle_between_deg(p, q):
    return np.degrees(np.linalg.norm(rotation_vector(quaternion_product(quaternion_conjugate(p), q)), axis=1))


def test_a_body_that_turns_while_it_travels_is_recovered_at_instants_between_the_poses():
    task = tumble()
    settings = PoseSettings(cutoff_hz=None, position_cutoff_hz=None)
    spline = fit_pose_spline(poses_of(task), settings)
    motion = spline.at(np.arange(0.1, 19.8, 1.0 / 286.0), G)
    assert worst(spline.position(motion.time), task.position(motion.time)) < 1e-6
    truth = task.at(motion.time, G)
    # A quintic through poses h = 1/120 s apart errs by h^6 x^(6) / 100 in the pose, h^4 in the second derivative.
    errors = [angle_between_deg(motion.q_nb, truth.q_nb).max(), worst(motion.rate_b, truth.rate_b)]
    show("pose, deg; rate, rad/s; force, m/s2", (*errors, worst(motion.force_b, truth.force_b)), "1e-6, 1e-6, 1e-4")
    assert max(errors) < 1e-6
    assert worst(motion.angular_acceleration_b, truth.angular_acceleration_b) < 1e-4
    assert worst(motion.force_b, truth.force_b) < 1e-4
    assert (motion.valid == 1.0).all()
    assert (motion.moving == 1.0).all()


def test_the_default_low_pass_leaves_a_human_motion_alone():
    task = tumble()
    motion = fit_pose_spline(poses_of(task)).at(np.arange(1.0, 19.0, 0.01), G)  # two periods of 10 Hz settle in less
    truth = task.at(motion.time, G)
    rate, force = worst(motion.rate_b, truth.rate_b), worst(motion.force_b, truth.force_b)
    show("rate, rad/s of 10", rate, 2e-3)
    show("specific force, m/s2", force, 5e-3)
    assert rate < 2e-3
    assert force < 5e-3


@pytest.mark.slow
def test_integrating_the_rate_gives_the_pose_back_within_0_01_deg_over_120_s_at_286_hz():
    clean = poses_of(tumble(121.0))
    noise = quaternion_of(np.random.default_rng(4).normal(0.0, 3e-4, (len(clean), 3)))  # as noisy as cameras are
    spline = fit_pose_spline(replace(clean, q_nb=quaternion_product(clean.q_nb, noise)))
    time = 0.5 + np.arange(round(120.0 * 286.0)) / 286.0
    motion, h = spline.at(time, G), np.diff(time)[:, None]
    # fourth-order Magnus integration of the instantaneous rate: two Gauss points a step, an independent equation
    middle, off = 0.5 * (time[1:] + time[:-1]), h[:, 0] * np.sqrt(3.0) / 6.0
    a, b = spline.at(middle - off, G).rate_b, spline.at(middle + off, G).rate_b
    magnus = 0.5 * h * (a + b) + (np.sqrt(3.0) / 12.0) * h**2 * np.cross(a, b)
    for label, steps, limit in (("instantaneous", magnus, 0.01), ("mean", motion.mean_rate_b[1:] * h, 1e-9)):
        q = [motion.q_nb[0]]
        for step in quaternion_of(steps):
            q.append(quaternion_product(q[-1], step))
        error = angle_between_deg(np.array(q), motion.q_nb).max()
        show(f"{label} rate integrated over 120 s, worst error, deg", f"{error:.2e}", limit)
        assert error < limit


def test_a_jump_of_sign_is_no_motion():
    poses = poses_of(tumble(5.0))
    signs = np.where(np.arange(len(poses)) % 7 < 3, -1.0, 1.0)[:, None]
    flipped = Reference(time=poses.time, q_nb=poses.q_nb * signs, position=poses.position)
    time = np.linspace(0.5, 4.5, 100)
    a, b = fit_pose_spline(poses).at(time, G), fit_pose_spline(flipped).at(time, G)
    assert worst(a.rate_b, b.rate_b) < 1e-12


def without(poses: Reference, hidden) -> Reference:
    q, p = np.array(poses.q_nb), np.array(poses.position)
    q[hidden], p[hidden] = np.nan, np.nan
    return Reference(time=poses.time, q_nb=q, position=p)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    cuts=strategies.lists(
        strategies.tuples(strategies.integers(5, 590), strategies.integers(1, 60)), min_size=1, max_size=4
    )
)
def test_no_gap_over_a_tenth_of_a_second_is_crossed_and_0_2_s_beside_it_are_masked(cuts):
    poses = poses_of(tumble(6.0), 100.0)
    hidden = np.zeros(len(poses), dtype=bool)
    for start, length in cuts:
        hidden[start : start + length] = True
    try:
        motion = fit_pose_spline(without(poses, hidden)).at(np.linspace(0.0, 5.99, 2000), G)
    except InputError:
        assert hidden.sum() > 50
        return
    seen = poses.time[~hidden]
    long = np.flatnonzero(np.diff(seen) > 0.1 + 1e-9)
    for a, b in zip(seen[long], seen[long + 1], strict=True):
        beside = (motion.time > a - 0.2 + 1e-9) & (motion.time < b + 0.2 - 1e-9)
        assert (motion.valid[beside] == 0.0).all()
        assert np.isnan(motion.rate_b[beside]).all()
    known = motion.valid == 1.0
    for values in (motion.q_nb, motion.rate_b, motion.mean_rate_b, motion.angular_acceleration_b, motion.force_b):
        assert np.isfinite(values[known]).all()
        assert np.isnan(values[~known]).all()
    assert angle_between_deg(motion.q_nb[known], tumble(6.0).at(motion.time[known], G).q_nb).max() < 0.5


def test_a_short_gap_is_bridged():
    poses = poses_of(tumble(6.0), 100.0)
    hidden = np.zeros(len(poses), dtype=bool)
    hidden[300:309] = True  # 0.1 s from pose to pose
    motion = fit_pose_spline(without(poses, hidden)).at(np.linspace(1.0, 5.0, 400), G)
    truth = tumble(6.0).at(motion.time, G)
    assert (motion.valid == 1.0).all()
    assert angle_between_deg(motion.q_nb, truth.q_nb).max() < 0.3  # a cubic errs by h^4 q'''' / 384


def test_poses_at_uneven_times_are_drawn_to_an_even_grid_before_filtering():
    rng = np.random.default_rng(1)
    task = tumble(6.0)
    time = np.arange(600) / 100.0 + rng.uniform(-0.002, 0.002, 600)
    poses = Reference(time=time, q_nb=task.at(time, G).q_nb, position=task.position(time))
    motion = fit_pose_spline(poses).at(np.linspace(1.0, 5.0, 400), G)
    assert worst(motion.rate_b, task.at(motion.time, G).rate_b) < 0.02  # of 10 rad/s


def test_poses_with_long_gaps_everywhere_are_refused():
    time = np.arange(200) / 100.0
    seen = np.arange(200) % 20 < 6
    with pytest.raises(InputError, match=r"without a gap over 0.1 s.*got 60 valid poses of 200"):
        find_stretches(time, seen)


def test_both_passes_together_are_3_db_down_at_the_cut_off():
    time = np.arange(4000) / 200.0
    wave = np.sin(2.0 * np.pi * 10.0 * time)[:, None]
    out = zero_phase(wave, 10.0, sample_rate_hz=200.0)[1000:3000]
    ratio = np.sqrt((out**2).mean() / (wave[1000:3000] ** 2).mean())
    assert ratio == pytest.approx(np.sqrt(0.5), abs=0.01)  # the bilinear transform shifts each pass a little
    assert worst(out, ratio * wave[1000:3000]) < 1e-3  # no delay
    with pytest.raises(InputError, match=r"between 0 and 44.8 Hz"):
        zero_phase(wave, 60.0, sample_rate_hz=100.0)


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


def test_poses_are_late_by_the_delay_and_turned_by_the_mounting() -> None:
    task = draw_task("sit_to_stand", rng=np.random.default_rng(1))
    late = OpticsSettings(angle_sd=0.0, position_sd=0.0, gaps=0, delay_s=0.05, sample_rate_hz=120.0)
    reference = see(task, rng=np.random.default_rng(2), settings=late)
    truth = task.at(reference.time - 0.05, 9.81)
    assert np.abs(angles(truth.q_nb, reference.q_nb)).max() < 1e-12
    np.testing.assert_allclose(reference.position, task.position(reference.time - 0.05), atol=1e-12)
    mounted = see(task, rng=np.random.default_rng(2), settings=replace(late, mount_sd=0.02))
    askew = angles(truth.q_nb, mounted.q_nb)
    assert np.ptp(askew, axis=0).max() < 1e-12
    assert 0.002 < np.linalg.norm(askew[0]) < 0.1
