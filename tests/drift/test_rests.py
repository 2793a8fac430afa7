"""Rests of one set-point that disagree: by pose, by rest, and how that enters the curve.

Thermal sessions gathered into blocks of rest and dwells.
"""

from dataclasses import replace

import numpy as np
import pytest

from drift.test_static import blocks
from testkit.data import show
from testkit.full_calibration import device
from undrift.drift.checks import rests_verdict, set_points_of, set_points_verdict, with_set_points
from undrift.drift.observe import ObserveSettings, observe_rests, observe_steps, step_error
from undrift.drift.rests import instability_of
from undrift.drift.static import fit_static
from undrift.errors import InputError, NotObservable
from undrift.record import Record, Session, Still, Turn

POINTS = np.array([20.0, 30.0, 40.0, 50.0, 60.0])
SLOPE = np.array([0.01, -0.02, 0.005])
NOISE = 1e-3


def soaks(rng, points=POINTS, poses=3, visits=2, *, by_pose=0.0, by_rest=0.0, blocks_each=2):
    """Rests of two blocks, by set-point, visit and pose, an hour from set-point to set-point."""
    level = by_pose * rng.normal(size=(poses, 3))
    rows = [(p, v, k) for p in range(len(points)) for v in range(visits) for k in range(poses)]
    own = np.repeat(by_rest * rng.normal(size=(len(rows), 3)), blocks_each, axis=0)
    rows = [row for row in rows for _ in range(blocks_each)]
    temp = np.array([points[p] for p, _, _ in rows])
    within = np.tile(10.0 * np.arange(blocks_each), len(rows) // blocks_each)
    time = np.array([3600.0 * p + 100.0 * (v * poses + k) for p, v, k in rows]) + within
    pose = np.array([k for _, _, k in rows])
    gyro = (temp[:, None] - 40.0) * SLOPE + level[pose] + own + NOISE * rng.normal(size=(len(rows), 3))
    return replace(blocks(temp, gyro, noise=NOISE, time=time), pose=pose)


def errors(seeds, **changes):
    """Return error and stated uncertainty of the nodes at the set-points, each of shape (seeds, points, 3)."""
    fits = [
        fit_static(soaks(np.random.default_rng(seed), **changes), nodes=np.arange(20.0, 60.5, 5.0))
        for seed in range(seeds)
    ]
    value = np.array([fit.table.gyro_offset[::2] for fit in fits])
    return value - (POINTS[:, None] - 40.0) * SLOPE, np.array([fit.gyro.curve_uncertainty[::2] for fit in fits])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poses", "by_pose", "by_rest"),
    [
        (3, 0.05, 0.0),
        (6, 0.05, 0.02),
        (3, 0.0, 0.02),
        (6, 0.05, 0.0),
    ],
)
def test_the_table_s_intervals_hold_when_poses_or_rests_disagree(poses, by_pose, by_rest):
    # Truth: the offset without what poses add, whose mean is zero. Sixty devices of three axes.
    error, stated = errors(60, poses=poses, by_pose=by_pose, by_rest=by_rest)
    inside = float((np.abs(error) <= 1.96 * stated).mean())
    ratio = float(np.sqrt((stated**2).mean() / (error**2).mean()))
    show(
        f"{poses} poses {by_pose:g}, rests {by_rest:g}: inside, stated over error", f"{inside:.3f}, {ratio:.2f}", "0.93"
    )
    assert inside >= 0.93
    assert ratio < 2.0


def test_more_samples_of_a_rest_do_not_lessen_what_poses_make():
    few, many = (
        fit_static(soaks(np.random.default_rng(3), visits=visits, by_pose=0.05), nodes=POINTS).gyro.curve_uncertainty
        for visits in (2, 8)
    )
    np.testing.assert_allclose(many, few, rtol=0.1)


@pytest.mark.slow
def test_poses_that_agree_cost_next_to_nothing():
    one, three = (errors(20, poses=poses, visits=6 // poses)[1] for poses in (1, 3))
    show("stated with three poses that agree over one pose", f"{np.median(three) / np.median(one):.2f}", 1.3)
    assert np.median(three) < 1.3 * np.median(one)


def test_a_jump_to_the_next_set_point_is_no_instability():
    # As a fast chamber makes them: blocks at an even pace through three set-points, a slope of 1 unit a degree.
    temp = np.repeat([20.0, 30.0, 40.0, 50.0], 4)
    value = temp[:, None] + NOISE * np.random.default_rng(0).normal(size=(16, 3))
    made = blocks(temp, value)
    scatter = np.maximum(*instability_of(made, value, made.gyro_variance))
    assert scatter is not None
    assert (np.sqrt(scatter) < 5.0 * NOISE).all()  # eight triples; 4 units where the jumps count


def test_the_instability_is_the_variance_of_the_drift_that_blocks_hold():
    # Seven first-order processes from 10 s to 10,000 s, as flicker noise is made of, blocks every 10 s without sample noise.
    rng, size, count = np.random.default_rng(1), 0.02, 6000
    value = np.zeros((count, 3))
    for tau in 10.0 ** np.arange(1.0, 4.1, 0.5):
        kept = np.exp(-10.0 / tau)
        state = rng.normal(size=3)
        for k in range(count):
            value[k] += size / 7.0**0.5 * state
            state = kept * state + (1.0 - kept * kept) ** 0.5 * rng.normal(size=3)
    made = blocks(np.full(count, 25.0), value, noise=1e-9)
    found = np.maximum(*instability_of(made, made.gyro, made.gyro_variance))
    show("instability of three axes over what was put in", np.round(np.sqrt(found) / size, 3), "0.95-1.05")
    # 6000 second differences of neighbours that share blocks: 2 % in the variance, 1 % in its root; five times that
    np.testing.assert_allclose(np.sqrt(found), size, rtol=0.05)


def test_three_set_points_are_certain_at_the_soaks_and_a_finding_says_what_they_cannot_show():
    rng, points = np.random.default_rng(4), np.array([20.0, 30.0, 40.0])
    fit = fit_static(soaks(rng, points=points, visits=4), nodes=np.arange(20.0, 40.5, 1.0))
    stated = fit.table.gyro_uncertainty
    assert (stated[[0, 10, 20]] < 3.0 * NOISE).all()  # twelve blocks each, that scatter by NOISE
    (few,) = set_points_verdict(fit, soaks(rng, points=points), device(unit="rad/s")).findings
    assert few.code == "drift.few_set_points"
    assert few.text.startswith("3 set-points cannot exclude higher-order curvature: 20.0, 30.0, 40.0 degC; ")
    assert few.text.endswith("soak at 25, 35 degC as well")


def test_two_set_points_are_a_line_and_many_or_a_sweep_give_no_finding():
    rng, model = np.random.default_rng(5), device(unit="rad/s")
    two, twelve = soaks(rng, points=POINTS[:2]), soaks(rng, points=np.linspace(20.0, 60.0, 12))
    verdict = set_points_verdict(fit_static(two, nodes=np.arange(20.0, 30.5, 0.5)), two, model)
    assert verdict.findings[0].values["count"] == 2
    assert verdict.reasons[0].endswith("soak at 25 degC as well")
    assert set_points_verdict(fit_static(twelve, nodes=POINTS), twelve, model).reasons == ()
    np.testing.assert_allclose(set_points_of(np.array([20.1, 40.0, 19.9])), [20.0, 40.0])
    assert len(set_points_of(np.linspace(20.0, 40.0, 100))) == 0


def courses(rng, *, jagged=0.0, visit=0.0, stated=NOISE):
    """Twelve set-points in random order, six times each: a step from one block to the next."""
    points = np.linspace(18.0, 75.0, 12)
    own = jagged * rng.normal(size=(12, 3))
    order = np.concatenate([rng.permutation(12) for _ in range(6)])
    gyro = (points[order, None] - 40.0) * SLOPE + own[order] + np.hypot(visit, NOISE) * rng.normal(size=(72, 3))
    return blocks(points[order], gyro, noise=stated, time=600.0 * np.arange(72.0))


@pytest.mark.slow
def test_soaks_left_out_that_disagree_with_the_stated_uncertainty_are_a_finding():
    def of(**changes):
        fit = fit_static(courses(np.random.default_rng(6), **changes), nodes=np.arange(20.0, 75.0, 5.0))
        return [item for item in fit.verdict.findings if item.code.startswith("drift.left_out")], fit.gyro.curve.spline

    # what visits add is found, and stated; a curve of random steps is not smooth, and six visits to each step share it
    assert of(visit=0.02)[0] == []
    (above,), spline = of(jagged=0.02)
    assert (above.code, above.level, above.values["groups"]) == ("drift.left_out_above", "warn", 12)
    assert above.values["ratio"] == pytest.approx(spline.left_out[1])
    assert above.text.startswith("Soaks left out in turn are missed by ")
    # the rows' noise stated thirty times too large: chance makes them agree as well once in a million
    (below,), _ = of(stated=30.0 * NOISE)
    assert (below.code, below.level) == ("drift.left_out_below", "info")


@pytest.mark.slow
def test_a_log_through_soaks_and_ramps_shows_what_soaks_add():
    # Twelve soaks of an hour and ramps of half an hour in one log; what a soak adds goes over to the next along the ramp.
    inside = []
    for seed in range(12):
        rng, points = np.random.default_rng(seed), np.linspace(18.0, 75.0, 12)
        own = np.repeat(0.02 * rng.normal(size=(12, 3)), 2, axis=0)
        knots = (5400.0 * np.arange(12)[:, None] + [0.0, 3600.0]).ravel()
        time = np.arange(0.0, knots[-1], 10.0)
        temp = np.interp(time, knots, np.repeat(points, 2))
        add = np.column_stack([np.interp(time, knots, column) for column in own.T])
        gyro = (temp[:, None] - 40.0) * SLOPE + add + NOISE * rng.normal(size=add.shape)
        fit = fit_static(blocks(temp, gyro, noise=NOISE, time=time), nodes=points)
        to_come = (points[:, None] - 40.0) * SLOPE + 0.02 * rng.normal(size=(12, 3))
        inside.append(np.abs(fit.table.gyro_offset - to_come) <= 1.96 * fit.table.gyro_uncertainty)
    show("visits to come inside what a log through soaks states", f"{np.mean(inside):.3f}", "0.88-1")
    assert np.mean(inside) >= 0.88  # 36 curves of twelve soaks: 0.95 +- 0.03; 0.16 where the log counts as one ramp


def test_poses_that_disagree_are_reported_with_their_size_and_the_likely_reason():
    model = replace(device(unit="rad/s"), accel=None)
    model = replace(model, gyro=replace(model.gyro, g_sensitivity=None))
    made = soaks(np.random.default_rng(6), by_pose=0.05)
    fit = fit_static(made, nodes=POINTS, calibration=model)
    verdict = with_set_points(fit.verdict, fit, made, model)
    (pose,) = [item for item in verdict.findings if "g-sensitivity" in item.text]
    assert pose.code == "drift.poses_g_no_accel"
    assert pose.values["poses"] == 3
    assert pose.text.startswith("Gyroscope offset depends on the pose (g-sensitivity): ")
    assert rests_verdict(fit_static(soaks(np.random.default_rng(7)), nodes=POINTS), model).reasons == ()


def test_rests_that_disagree_whatever_their_pose_are_reported():
    made = soaks(np.random.default_rng(8), by_rest=0.03)
    model = device(unit="rad/s")
    (rest,) = rests_verdict(fit_static(made, nodes=POINTS), model).findings
    assert rest.code == "drift.rests_disagree"
    assert "hysteresis" in rest.text


RATE = 20.0


def log(seconds=300.0, *, seed=0, moving=False):
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE) + 5.0
    gyro = rng.normal(size=(len(time), 3)) * 0.1 + [1.0, -2.0, 0.5]
    accel = rng.normal(size=(len(time), 3)) * 0.01 + [0.0, 0.0, 9.8]
    if moving:
        gyro += 40.0 * np.sin(2.0 * time)[:, None]
        accel += 5.0 * np.sin(3.0 * time)[:, None]
    return Record(time=time, gyro=gyro, accel=accel, temp_c=20.0 + time / 60.0, gyro_unit="dps")


def session(*records, **pieces):
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=records, **pieces)


def rests(made, **settings):
    return observe_rests([made], temperatures=[[r.temp_c for r in made.records]], settings=ObserveSettings(**settings))


def test_a_log_that_never_moves_is_one_rest_of_ten_second_blocks():
    blocks = rests(session(log()))
    assert len(blocks) == 30
    assert set(blocks.pose) == {0}
    np.testing.assert_allclose(np.diff(blocks.time), 10.0, atol=0.1)
    np.testing.assert_allclose(blocks.ramp_c_per_min, 1.0, atol=1e-6)
    np.testing.assert_allclose(blocks.gyro, np.tile([1.0, -2.0, 0.5], (30, 1)), atol=5 * 0.1 / 200**0.5)
    np.testing.assert_allclose(
        np.sqrt(blocks.gyro_variance), 0.1 / 200**0.5, rtol=0.15
    )  # 300 differences of half seconds


def test_torn_lines_spikes_and_gaps_do_not_reach_the_means():
    clean = log()
    gyro, temp = clean.gyro.copy(), clean.temp_c.copy()
    gyro[50::333] = 4000.0
    gyro[1000:1050] = np.nan
    temp[70::500] = -100.0
    dirty = Record(time=clean.time, gyro=gyro, accel=clean.accel, temp_c=temp, gyro_unit="dps")
    found, wanted = rests(session(dirty)), rests(session(clean))
    np.testing.assert_allclose(found.gyro, wanted.gyro, atol=0.01)
    np.testing.assert_allclose(found.temp_c, wanted.temp_c, atol=0.01)


def test_stated_stills_serve_whole_or_in_blocks_and_faces_are_poses():
    stills = (
        Still(start=0, stop=160, face="+z"),
        Still(start=1000, stop=2000, face="-z"),
        Still(start=3000, stop=3160, face="+z"),
    )
    blocks = rests(session(log(), stills=stills))
    assert [int((blocks.pose == p).sum()) for p in (0, 1)] == [2, 5]
    assert blocks.power_on_s[0] == pytest.approx(4.0, abs=0.05)


def test_recordings_follow_each_other_on_one_clock_and_sessions_are_counted():
    one = session(log(60.0), log(60.0, seed=1))
    temps = [[r.temp_c for r in one.records]] * 2
    blocks = observe_rests([one, one], temperatures=temps)
    assert list(np.unique(blocks.session)) == [0, 1]
    assert len(np.unique(blocks.pose)) == 4
    assert (np.diff(blocks.time[blocks.session == 0]) > 0.0).all()


def test_no_rest_no_temperature_and_another_length_are_refused():
    with pytest.raises(NotObservable, match="wanted stretches at rest, got none; leave the device still"):
        rests(session(log(moving=True)))
    made = session(log())
    with pytest.raises(NotObservable, match="at rest with a known temperature, got none"):
        observe_rests([made], temperatures=[[np.full(len(made.records[0]), np.nan)]])
    with pytest.raises(InputError, match="temperature of recording 0: wanted 6000 values, got 5"):
        observe_rests([made], temperatures=[[np.zeros(5)]])


def test_dwells_are_numbered_by_soak_and_carry_the_imposed_rate():
    turns = tuple(
        Turn(start=k * 400, stop=k * 400 + 300, axis=axis, turn_rate=rate)
        for k, (axis, rate) in enumerate((("x", 0.5), ("x", -0.5), ("y", 1.0), ("z", 1.0)))
    )
    made = session(log(), turns=turns)
    temp = np.where(np.arange(6000) < 800, 20.0, 30.0)
    steps = observe_steps([made], temperatures=[[temp]])
    np.testing.assert_array_equal(steps.soak, [0, 0, 1, 1])
    np.testing.assert_array_equal(steps.rate_b, [[0.5, 0, 0], [-0.5, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(steps.temp_c, [20.0, 20.0, 30.0, 30.0])
    with pytest.raises(InputError, match=r"dwell \[0, 300\) of recording 0: wanted a temperature, got none"):
        observe_steps([made], temperatures=[[np.full(6000, np.nan)]])
    assert len(observe_steps([session(log())], temperatures=[[temp]])) == 0


@pytest.mark.parametrize("noise", [0.01, 0.15, 0.3])
def test_the_error_of_steps_is_what_a_converter_leaves_over_all_levels(noise):
    rng = np.random.default_rng(2)
    levels = rng.uniform(0.0, 1.0, 400)
    codes = np.round(levels[:, None] + noise * rng.normal(size=(400, 2000)))
    left = np.sqrt(np.mean((codes.mean(axis=1) - levels) ** 2))
    stated = step_error(np.ones(3), np.full(3, codes.var(axis=1).mean()))
    np.testing.assert_allclose(stated, left, rtol=0.12, atol=noise / 2000**0.5)  # 400 levels tell a deviation to 4-8 %
