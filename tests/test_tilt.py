"""Initial tilt: the direction, and an uncertainty that holds what it says."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.correction.rest import mean_variance
from undrift.errors import InputError
from undrift.frames import rotate
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, TriadModel
from undrift.orientation import heading_of, inclination_of, initial_tilt, shortest_rotation_up
from undrift.record import Record, Still

G = 9.81


def resting(force, n=200, **changes):
    return Record(**{"time": np.arange(n) * 0.01, "accel": np.tile(force, (n, 1)), **changes})


def model(covariance):
    return TriadModel(
        method="test",
        unit_in="m/s2",
        unit_out="m/s2",
        matrix=np.eye(3) + 0.01 * np.arange(9).reshape(3, 3) / 9.0,
        offset=[0.1, -0.2, 0.3],
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        covariance=covariance,
        rms_residual=0.0,
        count=18,
        rank=12,
        condition=1.0,
        valid_range=(-G, G),
    )


@pytest.mark.parametrize(
    "force",
    [[0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, 0.0, -0.8], [1e-9, -1e-9, -1.0], [0.3, -0.5, 0.81], [-0.2, 0.9, -0.5]],
)  # fmt: skip
@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_the_tilt_turns_gravity_up_and_has_the_wanted_heading(force, heading):
    force = np.array(force) / np.linalg.norm(force) * G
    tilt = initial_tilt(resting(force), Still(start=0, stop=200), heading=heading)
    np.testing.assert_allclose(rotate(tilt.q_nb, force), [0.0, 0.0, G], rtol=0, atol=1e-14 * 10)
    if force[2] > -0.999 * G:  # straight down the heading is not defined
        assert heading_of(tilt.q_nb) == pytest.approx(heading, abs=1e-12)
    # a cosine near -1 is known to a root of a rounding only
    assert inclination_of(tilt.q_nb) == pytest.approx(np.arccos(force[2] / G), abs=3e-8)


def test_the_shortest_rotation_is_continuous_where_its_formula_changes():
    level = np.array([0.6, 0.8])
    for z in (-0.5 - 1e-12, -0.5 + 1e-12):
        q = shortest_rotation_up(np.array([*(level * np.sqrt(1.0 - z * z)), z]))
        np.testing.assert_allclose(q, [0.5, 0.8 * np.sqrt(0.75), -0.6 * np.sqrt(0.75), 0.0], rtol=0, atol=1e-11)


def test_white_noise_gives_the_textbook_variance_of_a_mean():
    rng = np.random.default_rng(1)
    ratios = [mean_variance(rng.normal(size=400)) * 400 for _ in range(400)]
    show("variance of a mean of white noise over sigma^2/n", np.mean(ratios), "0.9 to 1.2")
    assert 0.9 < np.mean(ratios) < 1.2  # the sum stops at the first negative pair, so it errs to the safe side


@pytest.mark.parametrize("memory", [0.0, 0.8, 0.97])
def test_the_stated_uncertainty_is_the_scatter_of_the_tilt_over_many_rests(memory):
    rng = np.random.default_rng(2)
    n, runs, force = 1000, 200, np.array([2.0, -3.0, 9.0]) * (G / np.linalg.norm([2.0, -3.0, 9.0]))
    noise = rng.normal(size=(runs, n, 3)) * 0.05
    for k in range(1, n):  # first-order autoregression: each sample remembers the one before
        noise[:, k] += memory * noise[:, k - 1]
    angles, stated = [], []
    for run in noise[:, :, :]:
        tilt = initial_tilt(resting(force, n, accel=force + run), Still(start=0, stop=n))
        up = rotate(tilt.q_nb, force) / G
        angles.append(np.arctan2(np.hypot(up[0], up[1]), up[2]))
        stated.append(tilt.inclination_uncertainty)
    real, said = np.sqrt(np.mean(np.square(angles))), np.sqrt(np.mean(np.square(stated)))
    show(f"memory {memory}: stated over real tilt scatter", said / real, "0.85 to 1.15")
    assert (
        0.85 < said / real < 1.15
    )  # 200 runs of two axes know a scatter to 4 %; a memory of 33 samples leaves 30 looks


def test_what_the_calibration_leaves_uncertain_is_added():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(12, 12)) * 1e-3
    m, force = model(root @ root.T), np.array([4.0, 1.0, 8.8])
    tilt = initial_tilt(resting(force), Still(start=0, stop=200), accel_model=m)
    assert tilt.scatter_uncertainty == pytest.approx(0.0, abs=1e-9)
    # the same by drawing calibrations: raw readings stay, the model varies
    raw = np.linalg.solve(m.matrix, force) + m.offset
    draws = rng.normal(size=(4000, 12)) @ root.T
    off = [(m.matrix + d[:9].reshape(3, 3)) @ (raw - m.offset - d[9:]) - force for d in draws]
    up = force / np.linalg.norm(force)
    level = np.array(off) - np.outer(np.array(off) @ up, up)
    drawn = np.sqrt(np.mean(np.sum(level**2, axis=1))) / np.linalg.norm(force)
    show("tilt uncertainty from the calibration, stated and drawn, rad", (tilt.inclination_uncertainty, drawn))
    assert tilt.inclination_uncertainty == pytest.approx(
        drawn, rel=0.05
    )  # 4,000 draws know it to 1 %; the rest is second order


def test_parameters_that_do_not_touch_the_force_add_nothing():
    names = ("g_xx", "offset_y")
    m = replace(model(np.zeros((12, 12))), parameters=names, covariance=np.diag([1.0, 1e-4]))
    tilt = initial_tilt(resting([0.0, 0.0, G]), Still(start=0, stop=200), accel_model=m)
    wanted = 1e-2 * np.abs(m.matrix[:2, 1]) / G
    assert tilt.inclination_uncertainty == pytest.approx(np.linalg.norm(wanted), rel=1e-6)


def test_readings_in_g_are_taken_as_such():
    tilt = initial_tilt(resting([0.0, 0.0, 1.0], accel_unit="g"), Still(start=0, stop=200))
    assert tilt.specific_force[2] == pytest.approx(9.80665)


def test_what_is_no_rest_is_refused():
    still = Still(start=0, stop=200)
    with pytest.raises(InputError, match="wanted accelerometer readings, got none"):
        initial_tilt(Record(time=np.arange(9.0), gyro=np.zeros((9, 3))), still)
    with pytest.raises(InputError, match="wanted 10 samples at rest or more, got 5; give a longer still phase"):
        initial_tilt(resting([0.0, 0.0, G]), Still(start=0, stop=5))
    with pytest.raises(
        InputError, match=r"wanted a mean specific force within 20% of gravity, got 1 m/s2; check the unit"
    ):
        initial_tilt(resting([0.0, 0.0, 1.0]), still)
    with pytest.raises(InputError, match="wanted readings without gaps, got NaN in the still phase"):
        initial_tilt(resting([0.0, np.nan, G]), still)
    with pytest.raises(InputError, match="accel: wanted a physical unit, got count"):
        initial_tilt(resting([0.0, 0.0, G], accel_unit="count"), still)


@pytest.mark.parametrize(("of_gravity", "rest"), [(0.79, False), (0.81, True), (1.19, True), (1.21, False)])
def test_a_rest_is_within_a_fifth_of_standard_gravity(of_gravity, rest):
    made = resting([0.0, 0.0, of_gravity * 9.80665])
    if rest:
        assert initial_tilt(made, Still(start=0, stop=200)).specific_force[2] == pytest.approx(of_gravity * 9.80665)
    else:
        with pytest.raises(InputError, match="within 20% of gravity"):
            initial_tilt(made, Still(start=0, stop=200))


def test_only_the_rest_itself_shows_the_tilt():
    force = np.concatenate(
        (np.tile([G, 0.0, 0.0], (300, 1)), np.tile([0.0, 0.0, G], (200, 1)), np.tile([0.0, G, 0.0], (300, 1)))
    )
    tilt = initial_tilt(resting([0.0, 0.0, G], 800, accel=force), Still(start=300, stop=500))
    np.testing.assert_allclose(tilt.specific_force, [0.0, 0.0, G], rtol=0, atol=1e-12)
    np.testing.assert_allclose(tilt.q_nb, [1.0, 0.0, 0.0, 0.0], rtol=0, atol=1e-12)
