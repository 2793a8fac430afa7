"""Accelerometers over temperature: faces and free poses at several temperatures."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rate_steps import GRAVITY, reading
from undrift.drift.accel import fit_accel_drift, fit_joint, warm_poses, with_accel
from undrift.drift.observe import RestBlocks
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.model import DriftTables, ScaleDrift, StaticDrift
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables

NODES = np.arange(20.0, 60.1, 1.0)
FACES = np.concatenate((np.eye(3), -np.eye(3)))
NOISE = 2e-4 * GRAVITY


def device(seed=0):
    made = random_device_of("enc03j_3031", np.random.default_rng(seed))
    return replace(made, accel=replace(made.accel, nonlinearity=None, lever_arm=None))


def free_poses(count=14, seed=5):
    up = np.random.default_rng(seed).normal(size=(count, 3))
    return up / np.linalg.norm(up, axis=1)[:, None]


def rests(made, poses, noise=NOISE, seed=1):
    """Return one block for each (temperature, number of pose, direction that points up)."""
    temp = np.array([t for t, _, _ in poses], dtype=float)
    up = np.array([u for _, _, u in poses])
    n, sigma = len(temp), noise * made.accel.gain
    mean = reading(made.accel, GRAVITY * up, temp - made.reference_temp_c)
    return RestBlocks(
        session=np.zeros(n, int),
        pose=np.array([k for _, k, _ in poses]),
        time=np.arange(n, dtype=float),
        power_on_s=np.zeros(n),
        temp_c=temp,
        ramp_c_per_min=np.zeros(n),
        gyro=np.zeros((n, 3)),
        accel=mean + np.random.default_rng(seed).normal(0.0, sigma, (n, 3)),
        gyro_variance=np.ones((n, 3)),
        accel_variance=np.full((n, 3), sigma**2),
    )


def everywhere(directions, temps=(20.0, 30.0, 40.0, 50.0, 60.0)):
    return [(t, k, u) for t in temps for k, u in enumerate(directions)]


def turned_alike(made, matrix):
    """Return a matrix turned into the axes that the fit keeps: M M0^-1 symmetric."""
    known = true_calibration(made).accel.matrix
    change = matrix @ np.linalg.inv(known)
    values, vectors = np.linalg.eigh(change.transpose(0, 2, 1) @ change)
    root = np.einsum("nij,nj,nkj->nik", vectors, np.sqrt(values), vectors)
    return root @ known


@pytest.mark.parametrize("poses", [FACES, free_poses()])
def test_poses_at_five_temperatures_give_back_offset_and_matrix(poses):
    made = device()
    fit = fit_accel_drift(rests(made, everywhere(poses), noise=1e-7), true_calibration(made), temp_c=NODES)
    truth = true_tables(made, NODES, np.array([-1.0, 1.0]))
    assert fit.method == "by temperature"
    # 10 % of a change of 1 % in sensitivity, by which cross-axis terms of 1 % differ, is left where faces do not show them.
    assert np.abs(fit.offset - truth.static.accel_offset).max() / made.accel.gain < 1e-4 * GRAVITY
    assert np.abs(fit.matrix - turned_alike(made, truth.scale.accel_matrix)).max() * made.accel.gain < 1e-4
    assert np.abs(fit.percent_per_k - 100.0 * made.accel.thermal_scale.per_k[0]).max() < 2e-4


@pytest.mark.slow
def test_intervals_hold_offset_and_sensitivity():
    z_offset, z_matrix = [], []
    for seed in range(12):
        made = device(seed)
        fit = fit_accel_drift(rests(made, everywhere(free_poses()), seed=seed), true_calibration(made), temp_c=NODES)
        truth = true_tables(made, NODES, np.array([-1.0, 1.0]))
        z_offset.append((fit.offset - truth.static.accel_offset) / fit.offset_uncertainty)
        diagonal = np.einsum("nii->ni", fit.matrix - turned_alike(made, truth.scale.accel_matrix))
        z_matrix.append(diagonal / np.einsum("nii->ni", fit.matrix_uncertainty))
    # Twelve devices of three straight curves: some seventy free values each, standard error 2.6 %.
    assert 0.87 < np.mean(np.abs(z_offset) < 1.96) <= 1.0
    assert 0.87 < np.mean(np.abs(z_matrix) < 1.96) <= 1.0


def test_poses_scattered_over_temperature_are_fitted_at_once():
    made = device()
    scattered = [(20.0 + 4.0 * k, k, u) for k, u in enumerate(free_poses(11))] + [
        (58.0 - 4.0 * k, 20 + k, u) for k, u in enumerate(free_poses(10, seed=6))
    ]
    fit = fit_accel_drift(rests(made, scattered), true_calibration(made), temp_c=NODES)
    truth = true_tables(made, NODES, np.array([-1.0, 1.0]))
    assert fit.method == "joint"
    assert fit.verdict.status == "marginal"
    assert np.abs((fit.offset - truth.static.accel_offset) / fit.offset_uncertainty).max() < 5.0
    assert np.abs(fit.offset - truth.static.accel_offset).max() / made.accel.gain < 2e-3 * GRAVITY
    assert "drift.accel_joint" in {item.code for item in fit.verdict.findings}


def test_poses_that_miss_gravity_make_a_joint_fit_bad():
    made = device()
    scattered = [(20.0 + 2.0 * k, k, u) for k, u in enumerate(free_poses(21))]
    fit = fit_accel_drift(rests(made, scattered, noise=0.08 * GRAVITY), true_calibration(made), temp_c=NODES)
    assert fit.method == "joint"
    assert fit.verdict.status == "bad"
    assert "drift.accel_misses_gravity" in {item.code for item in fit.verdict.findings}


def test_faces_say_that_cross_axis_terms_are_the_calibrations():
    made = device()
    fit = fit_accel_drift(rests(made, everywhere(FACES)), true_calibration(made), temp_c=NODES)
    assert "drift.accel_faces_only" in {item.code for item in fit.verdict.findings}


def test_two_temperatures_draw_a_line():
    made = device()
    fit = fit_accel_drift(rests(made, everywhere(FACES, (25.0, 45.0))), true_calibration(made), temp_c=NODES)
    assert "drift.accel_two_temperatures" in {item.code for item in fit.verdict.findings}
    assert fit.extrapolated[0]
    assert fit.extrapolated[-1]


def test_one_pose_is_refused_and_what_it_leaves_open_is_named():
    made = device()
    with pytest.raises(
        NotObservable, match=r"got 1 poses and 5 means that leave .*sensitivity x.* open; rest on all six faces"
    ):
        fit_accel_drift(rests(made, everywhere(FACES[:1])), true_calibration(made), temp_c=NODES)


def test_one_temperature_is_refused_with_the_span():
    made = device()
    with pytest.raises(NotObservable, match=r"wanted poses 2 degC apart or more, got 0 degC"):
        fit_accel_drift(rests(made, everywhere(FACES, (25.0,))), true_calibration(made), temp_c=NODES)


def test_nothing_but_gaps_is_refused():
    made = device()
    given = rests(made, everywhere(FACES))
    with pytest.raises(InputError, match="got 30 blocks and none of them usable"):
        fit_accel_drift(replace(given, accel=np.full((30, 3), np.nan)), true_calibration(made), temp_c=NODES)


def test_some_gaps_are_left_out_and_counted():
    made = device()
    given = rests(made, everywhere(free_poses()))
    temp = given.temp_c.copy()
    temp[:2] = np.nan
    fit = fit_accel_drift(replace(given, temp_c=temp), true_calibration(made), temp_c=NODES)
    assert any("2 of 70 blocks of rest left out: gaps" in reason for reason in fit.verdict.reasons)
    assert np.isfinite(fit.offset).all()


def test_a_calibration_without_accelerometers_is_refused():
    made = device()
    with pytest.raises(InputError, match="wanted a calibration with accelerometers, got one without"):
        fit_accel_drift(rests(made, everywhere(FACES)), replace(true_calibration(made), accel=None), temp_c=NODES)


def test_readings_that_no_linear_device_gives_do_not_settle():
    made = device()
    given = rests(made, everywhere(free_poses(3), (20.0, 40.0, 60.0)) + everywhere(FACES, (30.0, 50.0)))
    wild = replace(given, accel=given.accel * np.random.default_rng(3).uniform(-6.0, 6.0, given.accel.shape))
    with pytest.raises(PoorFit, match=r"wanted 21 poses of length 9\.80665 m/s2, got none that a device"):
        fit_joint(warm_poses(wild, true_calibration(made).accel), GRAVITY)


def test_the_part_joins_tables_on_the_same_nodes_only():
    made = device()
    fit = fit_accel_drift(rests(made, everywhere(FACES)), true_calibration(made), temp_c=NODES)
    gyro = np.zeros((len(NODES), 3))
    tables = with_accel(
        DriftTables(static=StaticDrift(temp_c=NODES, gyro_offset=gyro), lag_s=3.0, lag_smooth_s=1.0), fit
    )
    assert tables.lag_s == 3.0
    assert np.array_equal(tables.static.gyro_offset, gyro)
    assert np.array_equal(tables.static.accel_offset, fit.offset)
    assert np.array_equal(tables.scale.accel_matrix, fit.matrix)
    other = DriftTables(scale=ScaleDrift(temp_c=[20.0, 30.0]))
    with pytest.raises(
        InputError, match="wanted the nodes of the gyroscope tables, 2 from 20 to 30 degC, got 41 from 20 to 60"
    ):
        with_accel(other, fit)
