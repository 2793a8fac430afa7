"""Accelerometers over temperature: faces and free poses at several temperatures."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rate_steps import GRAVITY, reading
from testkit.rest_blocks import rest_blocks
from undrift.drift.accel import fit_accel_drift
from undrift.errors import NotObservable
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration, true_tables

NODES = np.arange(20.0, 60.1, 1.0)
FACES = np.concatenate((np.eye(3), -np.eye(3)))
NOISE = 2e-4 * GRAVITY


def device(seed=0):
    model = random_device(np.random.default_rng(seed), grade="enc03j_3031")
    return replace(model, accel=replace(model.accel, nonlinearity=None, lever_arm=None))


def free_poses(count=14, seed=5):
    up = np.random.default_rng(seed).normal(size=(count, 3))
    return up / np.linalg.norm(up, axis=1)[:, None]


def rests(made, poses, noise=NOISE, seed=1):
    """Return one block for each (temperature, number of pose, direction that points up)."""
    temp = np.array([t for t, _, _ in poses], dtype=float)
    up = np.array([u for _, _, u in poses])
    n, sigma = len(temp), noise * made.accel.gain
    mean = reading(made.accel, GRAVITY * up, temp - made.reference_temp_c)
    accel = mean + np.random.default_rng(seed).normal(0.0, sigma, (n, 3))
    return rest_blocks(temp, np.zeros((n, 3)), accel=accel, noise=sigma, pose=np.array([k for _, k, _ in poses]))


def fitted(given, made):
    calibration = true_calibration(made)
    return fit_accel_drift(given, calibration.accel, gravity=calibration.gravity_m_s2, temp_c=NODES)


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
    model = device()
    fit = fitted(rests(model, everywhere(poses), noise=1e-7), model)
    truth = true_tables(model, NODES, np.array([-1.0, 1.0]))
    # 10 % of a change of 1 % in sensitivity, by which cross-axis terms of 1 % differ, is left where faces do not show them.
    assert np.abs(fit.offset - truth.static.accel_offset).max() / model.accel.gain < 1e-4 * GRAVITY
    assert np.abs(fit.matrix - turned_alike(model, truth.scale.accel_matrix)).max() * model.accel.gain < 1e-4


@pytest.mark.slow
def test_intervals_hold_offset_and_sensitivity():
    z_offset, z_matrix = [], []
    for seed in range(12):
        model = device(seed)
        fit = fitted(rests(model, everywhere(free_poses()), seed=seed), model)
        truth = true_tables(model, NODES, np.array([-1.0, 1.0]))
        z_offset.append((fit.offset - truth.static.accel_offset) / fit.offset_uncertainty)
        diagonal = np.einsum("nii->ni", fit.matrix - turned_alike(model, truth.scale.accel_matrix))
        z_matrix.append(diagonal / np.einsum("nii->ni", fit.matrix_uncertainty))
    # Twelve devices of three straight curves: some seventy free values each, standard error 2.6 %.
    assert 0.87 < np.mean(np.abs(z_offset) < 1.96) <= 1.0
    assert 0.87 < np.mean(np.abs(z_matrix) < 1.96) <= 1.0


@pytest.mark.parametrize(
    "poses",
    [
        everywhere(FACES[:1]),
        everywhere(FACES, (25.0,)),
        [(20.0 + 4.0 * k, k, u) for k, u in enumerate(free_poses(11))],  # one pose at each temperature
    ],
)
def test_too_few_poses_at_two_temperatures_are_refused(poses):
    model = device()
    with pytest.raises(NotObservable, match="three temperatures"):
        fitted(rests(model, poses), model)
