import numpy as np
import pytest
from hypothesis import given, settings, strategies
from scipy.interpolate import BSpline

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.record import Reference
from undrift.sim.motion.motion import wave
from undrift.sim.motion.poses import (
    PoseSettings,
    PoseSpline,
    find_stretches,
    fit_pose_spline,
    quintic,
    turning,
    zero_phase,
)
from undrift.sim.motion.tasks import Task

G = 9.81


def tumble(duration_s: float = 20.0) -> Task:
    """A body that turns about all axes while it travels along all."""

    def swung(amplitude, frequency, phase):
        return (wave(amplitude, frequency, phase, -10.0, duration_s + 10.0),)

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


def motion_at(reference: Reference, rate_hz: float, settings: PoseSettings = PoseSettings()):
    """Return the motion through poses at a sample rate."""
    spline = fit_pose_spline(reference, settings)
    start, stop = spline.span_s
    return spline.at(start + np.arange(int((stop - start) * rate_hz + 1e-6) + 1) / rate_hz, G)


def worst(a, b):
    return float(np.nanmax(np.abs(a - b)))


def angle_between_deg(p, q):
    return np.degrees(np.linalg.norm(rotation_vector(quaternion_product(quaternion_conjugate(p), q)), axis=1))


def test_a_body_that_turns_while_it_travels_is_recovered_at_instants_between_the_poses():
    task = tumble()
    motion = motion_at(poses_of(task), 286.0, PoseSettings(cutoff_hz=None, position_cutoff_hz=None))
    truth = task.at(motion.time, G)
    # A quintic through poses h = 1/120 s apart errs by h^6 x^(6) / 100 in the pose, h^4 in the second derivative.
    show("pose, deg", angle_between_deg(motion.q_nb, truth.q_nb).max(), 1e-6)
    show("rate, rad/s", worst(motion.rate_b, truth.rate_b), 1e-6)
    show("specific force, m/s2", worst(motion.force_b, truth.force_b), 1e-4)
    assert angle_between_deg(motion.q_nb, truth.q_nb).max() < 1e-6
    assert worst(motion.rate_b, truth.rate_b) < 1e-6
    assert worst(motion.force_b, truth.force_b) < 1e-4
    assert (motion.valid == 1.0).all()
    assert (motion.moving == 1.0).all()


def test_the_default_low_pass_leaves_a_human_motion_alone():
    task = tumble()
    motion = motion_at(poses_of(task), 100.0)
    truth = task.at(motion.time, G)
    inner = (motion.time > 1.0) & (motion.time < task.duration_s - 1.0)  # two periods of 10 Hz settle in less
    rate, force = worst(motion.rate_b[inner], truth.rate_b[inner]), worst(motion.force_b[inner], truth.force_b[inner])
    show("rate, rad/s of 10", rate, 2e-3)
    show("specific force, m/s2", force, 5e-3)
    assert rate < 2e-3
    assert force < 5e-3


def test_angular_acceleration_is_the_change_of_the_rate_to_1e_6():
    spline = fit_pose_spline(poses_of(tumble()))
    time, h = np.linspace(1.0, 19.0, 500), 1e-4
    before, here, after = (spline.at(time + shift, G) for shift in (-h, 0.0, h))
    numeric = (after.rate_b - before.rate_b) / (2.0 * h)
    scale = np.abs(numeric).max()
    show("relative to the largest", worst(here.angular_acceleration_b, numeric) / scale, 1e-6)
    assert worst(here.angular_acceleration_b, numeric) < 1e-6 * scale


def test_specific_force_is_the_second_difference_of_position_plus_gravity_rotated_last():
    spline = fit_pose_spline(poses_of(tumble()))
    time, h = np.linspace(1.0, 19.0, 500), 2e-4
    second = (spline.position(time + h) - 2.0 * spline.position(time) + spline.position(time - h)) / h**2
    here = spline.at(time, G)
    numeric = rotate(quaternion_conjugate(here.q_nb), second + np.array([0.0, 0.0, G]))
    assert worst(here.force_b, numeric) < 1e-5  # h^2 p'''' / 12, p'''' up to 1300 m/s4


def gauss_integral(spline: PoseSpline, time, q):
    """Fourth-order Magnus integration of the instantaneous rate: two Gauss points a step, an independent equation."""
    h, out = np.diff(time), [q]
    middle, off = 0.5 * (time[1:] + time[:-1]), h * np.sqrt(3.0) / 6.0
    a, b = spline.at(middle - off, G).rate_b, spline.at(middle + off, G).rate_b
    step = quaternion_of(0.5 * h[:, None] * (a + b) + (np.sqrt(3.0) / 12.0) * h[:, None] ** 2 * np.cross(a, b))
    for one in step:
        out.append(quaternion_product(out[-1], one))
    return np.array(out)


@pytest.mark.slow
def test_integrating_the_rate_gives_the_pose_back_within_0_01_deg_over_120_s_at_286_hz():
    rng = np.random.default_rng(4)
    clean = poses_of(tumble(121.0))
    noise = quaternion_of(rng.normal(0.0, 3e-4, (len(clean), 3)))  # as noisy as cameras are
    poses = Reference(time=clean.time, q_nb=quaternion_product(clean.q_nb, noise), position=clean.position)
    spline = fit_pose_spline(poses)
    time = 0.5 + np.arange(round(120.0 * 286.0)) / 286.0
    motion = spline.at(time, G)
    error = angle_between_deg(gauss_integral(spline, time, motion.q_nb[0]), motion.q_nb)
    show("instantaneous rate integrated over 120 s, worst error, deg", f"{error.max():.2e}", 0.01)
    assert error.max() < 0.01
    q = [motion.q_nb[0]]
    for one in quaternion_of(motion.mean_rate_b[1:] * np.diff(time)[:, None]):
        q.append(quaternion_product(q[-1], one))
    assert angle_between_deg(np.array(q), motion.q_nb).max() < 1e-9  # exact by its definition; only rounding


def test_a_jump_of_sign_is_no_motion():
    poses = poses_of(tumble(5.0))
    signs = np.where(np.arange(len(poses)) % 7 < 3, -1.0, 1.0)[:, None]
    flipped = Reference(time=poses.time, q_nb=poses.q_nb * signs, position=poses.position)
    time = np.linspace(0.5, 4.5, 100)
    a, b = fit_pose_spline(poses).at(time, G), fit_pose_spline(flipped).at(time, G)
    assert worst(a.rate_b, b.rate_b) < 1e-12


def test_a_turn_of_the_laboratory_turns_nothing_that_the_body_feels():
    poses = poses_of(tumble(5.0))
    yaw = quaternion_of(np.array([0.0, 0.0, 1.1]))
    turned = Reference(
        time=poses.time, q_nb=quaternion_product(yaw, poses.q_nb), position=rotate(yaw, poses.position) + 3.0
    )
    time = np.linspace(0.5, 4.5, 100)
    a, b = fit_pose_spline(poses).at(time, G), fit_pose_spline(turned).at(time, G)
    assert worst(a.rate_b, b.rate_b) < 1e-9
    assert worst(a.force_b, b.force_b) < 1e-9


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


def test_without_positions_the_force_is_not_known():
    poses = poses_of(tumble(5.0))
    spline = fit_pose_spline(Reference(time=poses.time, q_nb=poses.q_nb))
    motion = spline.at(np.linspace(1.0, 4.0, 50), G)
    assert np.isfinite(motion.rate_b).all()
    assert np.isnan(motion.force_b).all()
    assert np.isnan(spline.position(motion.time)).all()


def test_marks_of_motion_are_taken_over():
    poses = poses_of(tumble(5.0))
    marked = Reference(time=poses.time, q_nb=poses.q_nb, moving=(poses.time > 2.0).astype(float))
    motion = fit_pose_spline(marked).at(np.array([1.0, 1.9, 2.1, 4.0]), G)
    assert motion.moving.tolist() == [0.0, 0.0, 1.0, 1.0]


def test_a_sample_rate_spans_what_is_known_and_instants_are_kept():
    poses = poses_of(tumble(5.0), 100.0)
    motion = motion_at(poses, 50.0)
    assert motion.time[0] == pytest.approx(0.1)
    assert motion.time[-1] == pytest.approx(4.88, abs=0.011)
    assert motion.sample_rate_hz == pytest.approx(50.0)
    time = np.array([0.0, 1.0, 2.5])
    asked = fit_pose_spline(poses).at(time, G)
    assert asked.valid.tolist() == [0.0, 1.0, 1.0]


def test_poses_with_long_gaps_everywhere_are_refused():
    time = np.arange(200) / 100.0
    seen = np.arange(200) % 20 < 6
    with pytest.raises(InputError, match=r"without a gap over 0.1 s.*got 60 valid poses of 200"):
        find_stretches(time, seen)


def test_a_cut_off_beyond_half_the_sample_rate_is_refused():
    with pytest.raises(InputError, match=r"between 0 and 44.8 Hz at 100 samples/s, got 60 Hz"):
        zero_phase(np.zeros((100, 3)), 60.0, sample_rate_hz=100.0)


@pytest.mark.parametrize("order", [2, 4])
def test_both_passes_together_are_3_db_down_at_the_cut_off(order):
    time = np.arange(4000) / 200.0
    wave = np.sin(2.0 * np.pi * 10.0 * time)[:, None]
    out = zero_phase(wave, 10.0, sample_rate_hz=200.0, order=order)[1000:3000]
    ratio = np.sqrt((out**2).mean() / (wave[1000:3000] ** 2).mean())
    assert ratio == pytest.approx(np.sqrt(0.5), abs=0.01)  # the bilinear transform shifts each pass a little
    assert worst(out, ratio * wave[1000:3000]) < 1e-3  # no delay


def test_a_steady_turn_is_a_steady_rate():
    time = np.arange(60) / 60.0
    spline = quintic(time, quaternion_of(np.outer(time, [0.0, 0.0, 3.0])))
    assert isinstance(spline, BSpline)
    _, rate, acceleration = turning(spline, np.linspace(0.2, 0.8, 20))
    assert worst(rate, np.array([0.0, 0.0, 3.0])) < 1e-9
    assert np.abs(acceleration).max() < 1e-6
