"""Norm of gravity over free poses: exact without noise, honest with it, and refused where poses do not show a parameter."""

import numpy as np
import pytest

from testkit.findings import only
from testkit.poses import fit_poses
from undrift.calibration.norm import QUADRATIC_SD, fit_norm
from undrift.errors import Implausible, NotObservable, PoorFit

G = 9.81
MATRIX = np.array([[0.0024, -3e-5, 2e-5], [0.0, 0.00243, -5e-5], [0.0, 0.0, 0.00241]])
OFFSET = np.array([33124.0, 33275.0, 32364.0])


def directions(count: int, seed: int = 1) -> np.ndarray:
    n = np.random.default_rng(seed).normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1)[:, None]


def readings(n: np.ndarray) -> np.ndarray:
    return G * n @ np.linalg.inv(MATRIX).T + OFFSET


def test_poses_without_noise_give_back_matrix_and_offset() -> None:
    fit = fit_poses(readings(directions(20)), gravity=G, standard_errors=np.full((20, 3), 0.1))
    np.testing.assert_allclose(fit.model.matrix, MATRIX, atol=1e-14, rtol=1e-10)  # solver tolerance 1e-11
    np.testing.assert_allclose(fit.model.offset, OFFSET, rtol=1e-12)
    assert fit.model.rank == 9
    assert fit.model.count == 20
    assert fit.verdict.status == "good"
    assert (fit.model.covariance[3] == 0.0).all()  # m_yx was held at zero


def test_known_noise_gives_honest_intervals_at_the_bound() -> None:
    rng, n, sigma = np.random.default_rng(3), directions(24), 0.8
    clean, truth = readings(n), np.concatenate((MATRIX[np.triu_indices(3)], OFFSET))
    scaled = []
    for _ in range(300):
        fit = fit_poses(
            clean + sigma * rng.normal(size=n.shape), gravity=G, standard_errors=np.full(n.shape, sigma)
        ).model
        estimate = np.concatenate((fit.matrix[np.triu_indices(3)], fit.offset))
        scaled.append((estimate - truth) / fit.standard_uncertainty[[0, 1, 2, 4, 5, 8, 9, 10, 11]])
    covered = float((np.abs(scaled) < 1.96).mean())
    print(f"  24 poses, 300 devices: 95 % intervals cover {100 * covered:.1f} %")
    assert 0.93 < covered < 0.975  # 2,700 intervals, correlated within a device: 1 % is two standard deviations
    # the stated covariance may exceed the bound by the excess variance that a lucky set of residuals feigns, 10 % at most
    assert 0.88 < float(np.sqrt(np.mean(np.square(scaled)))) < 1.03


def test_terms_that_the_poses_do_not_show_keep_their_prior() -> None:
    level = readings(np.vstack((np.eye(3), -np.eye(3))))
    fit = fit_norm(level, gravity=G, variances=np.full((6, 3), 0.01), prior_sd=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[[1, 2, 4]], 0.02, rtol=1e-3)


def test_poses_that_moved_get_a_bad_verdict_with_the_figure() -> None:
    n = directions(30)
    shaken = readings(n) + 300.0 * np.random.default_rng(1).normal(size=n.shape)
    fit = fit_poses(shaken, gravity=G, standard_errors=np.full(n.shape, 0.1))
    assert fit.verdict.status == "bad"
    moved = only(fit.verdict.findings, "multi_position.residual")
    assert moved.level == "fail"
    assert moved.values["rms"] == pytest.approx(fit.model.rms_residual / 9.80665e-3)
    assert fit.verdict.reasons[0] == moved.text


def test_uncertainty_of_a_fit_is_that_of_a_reading_of_gravity() -> None:
    rng = np.random.default_rng(2)
    reading = G * directions(14) + 0.002 * rng.normal(size=(14, 3))
    fit = fit_norm(reading, gravity=G, variances=np.full((14, 3), 0.002**2))
    way = rng.normal(size=(4000, 3))
    true = 9.81 * way / np.linalg.norm(way, axis=1)[:, None]
    drawn = rng.multivariate_normal(np.zeros(9), fit.covariance, 4000)
    matrix = np.zeros((4000, 3, 3))
    matrix[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] = drawn[:, :6]
    off = (matrix @ true[:, :, None])[:, :, 0] - drawn[:, 6:]  # of a sensor that is nearly perfect: M' = 1
    # 4000 draws know it to 1.5 %; scale times cross-axis terms are of second order
    assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(fit.uncertainty, rel=0.06)


@pytest.mark.parametrize("size", [0.0, 2e-4, 5e-4])
def test_offsets_hold_beside_quadratic_terms_of_any_size(size: float) -> None:
    rng, forward = np.random.default_rng(5), np.linalg.inv(MATRIX)
    gain = np.linalg.norm(forward, axis=1)
    scaled, errors = [], []
    for _ in range(80):
        along = G * directions(18, int(rng.integers(1 << 30))) @ forward.T / gain  # what each sensor measures, m/s2
        raw = OFFSET + gain * (along + rng.normal(0.0, size, 3) * along**2) + 0.3 * rng.normal(size=(18, 3))
        fit = fit_norm(raw, gravity=G, variances=np.full(raw.shape, 0.09), quadratic_sd=QUADRATIC_SD)
        errors.append((fit.offset - OFFSET) * fit.scale)
        scaled.append(errors[-1] / np.sqrt(np.diag(fit.covariance)[6:]))
    inside, rms = float((np.abs(scaled) < 1.96).mean()), float(np.sqrt(np.mean(np.square(errors))))
    print(
        f"  quadratic terms of {size:g} per m/s2: 95 % intervals of the offset hold in {100 * inside:.1f} %, rms {rms:.1e} m/s2"
    )
    assert (
        inside > 0.90
    )  # 95 % of 240: 1.4 % one sigma; the share of the quadratic terms is an upper limit once they show
    assert rms < 2e-3 + 80.0 * size  # 0.6 g^2 q is 58 q


def test_quadratic_terms_change_no_estimate() -> None:
    raw = readings(directions(12)) + 0.3 * np.random.default_rng(2).normal(size=(12, 3))
    fits = [fit_norm(raw, gravity=G, variances=np.full(raw.shape, 0.09), quadratic_sd=sd) for sd in (0.0, QUADRATIC_SD)]
    np.testing.assert_array_equal(fits[0].p, fits[1].p)
    added = fits[1].budget["nonlinearity"]
    assert (np.diag(added)[6:] > (0.2 * 0.6 * G**2 * QUADRATIC_SD) ** 2).all()  # twelve poses hardly bound them


def one_side() -> np.ndarray:
    every = np.vstack((directions(30), directions(400, 2)))
    return every[every[:, 2] > 0.9]


def in_one_plane() -> np.ndarray:
    way = directions(20) * [1.0, 0.0, 1.0]
    return way / np.linalg.norm(way, axis=1)[:, None]


@pytest.mark.parametrize(
    ("way", "parameters"),
    [
        (in_one_plane(), {"m_yy", "offset_y"}),
        (np.vstack([np.eye(3), -np.eye(3)] * 2), {"m_xy"}),  # faces alone
        (one_side(), {"offset_z"}),
    ],
)
def test_poses_that_leave_parameters_open_are_refused_by_name(way, parameters) -> None:
    raw = readings(way) + np.random.default_rng(0).normal(size=way.shape)
    with pytest.raises(NotObservable) as caught:
        fit_poses(raw, gravity=G, standard_errors=np.ones(way.shape))
    assert parameters <= set(caught.value.parameters)


@pytest.mark.parametrize(("count", "noise", "wanted"), [(8, 0.1, 9), (9, None, 10)])
def test_too_few_poses_are_refused(count, noise, wanted) -> None:
    errors = None if noise is None else np.full((count, 3), noise)
    with pytest.raises(NotObservable) as caught:
        fit_poses(readings(directions(count)), gravity=G, standard_errors=errors)
    assert (caught.value.wanted, caught.value.poses) == (wanted, count)


@pytest.mark.parametrize("scale", [0.25, 1.4])
def test_wrong_unit_of_poses_is_refused(scale: float) -> None:
    with pytest.raises(Implausible) as caught:
        fit_poses(scale * G * directions(20), gravity=G, standard_errors=np.full((20, 3), 1e-3), unit_in="m/s2")
    assert caught.value.ratio == pytest.approx(scale, rel=1e-3)


def test_readings_that_no_linear_sensor_could_give_are_refused() -> None:
    x, y, side = 3.0 * np.random.default_rng(0).normal(size=(3, 40))
    hyperboloid = np.column_stack((x, y, np.sqrt(1.0 + x**2 + y**2) * np.sign(side)))
    with pytest.raises(PoorFit) as caught:
        fit_poses(hyperboloid, gravity=G, standard_errors=np.full((40, 3), 1e-3))
    assert caught.value.poses == 40
