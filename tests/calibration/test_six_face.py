"""Six faces: the note's equations, the affine fit, and tilted faces against its rivals."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.plausibility import face_vectors
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.six_face import (
    FaceMeans,
    calibrate_faces,
    face_means,
    fit_six_face,
    polynomial_filter,
    solve_faces,
)
from undrift.errors import InputError, NotObservable
from undrift.record import FACES, Record, Still
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

G = 9.81
FORWARD = np.array([[1.02, 0.01, -0.008], [0.004, 0.97, 0.012], [-0.006, 0.009, 1.01]])
OFFSET = np.array([0.3, -0.2, 0.1])
UP = G * face_vectors(FACES)


def faces(offset=OFFSET, noise=0.002, unit="m/s2", scale=1.0):
    reading = scale * (UP @ FORWARD.T + offset)
    return FaceMeans(reading=reading, faces=FACES, noise=np.full((6, 3), noise * scale), unit=unit)


def test_mode_paper_is_equation_three_to_the_last_digit():
    poses = faces(offset=np.zeros(3))
    fit = fit_six_face(poses, gravity=G, mode="paper")
    L, S = UP.T, poses.reading.T
    np.testing.assert_allclose(fit.model.matrix, L @ S.T @ np.linalg.inv(S @ S.T), rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(fit.model.matrix, np.linalg.inv(FORWARD), atol=1e-13)
    assert fit.model.offset.tolist() == [0.0, 0.0, 0.0]
    assert fit.verdict.reasons == ()


def test_the_uncertainty_of_mode_paper_holds_under_a_tilt():
    rng, ratio = np.random.default_rng(51), []
    for _ in range(40):
        tilt = np.radians(0.5) * rng.standard_normal((6, 3))
        reading = (UP + np.cross(tilt, UP)) @ FORWARD.T + 1e-3 * rng.standard_normal((6, 3))
        model = fit_six_face(
            FaceMeans(reading=reading, faces=FACES, noise=np.full((6, 3), 1e-3)), gravity=G, mode="paper"
        ).model
        ratio.append((model.matrix - np.linalg.inv(FORWARD)).ravel() / model.standard_uncertainty[:9])
    assert np.mean(np.abs(ratio) <= 1.96) > 0.9  # 360 intervals, nine of which share six tilts


def test_one_missing_face_is_allowed_and_named():
    poses = faces()
    five = FaceMeans(reading=poses.reading[:5], faces=FACES[:5], noise=np.full((5, 3), 0.002))
    fit = fit_six_face(five, gravity=G)
    np.testing.assert_allclose(fit.model.forward_matrix, FORWARD, atol=1e-12)
    with pytest.raises(NotObservable, match="-z missing"):
        fit_six_face(five, gravity=G, mode="paper")
    with pytest.raises(NotObservable, match="missing"):
        fit_six_face(FaceMeans(reading=poses.reading[:4], faces=FACES[:4]), gravity=G)


def test_the_polynomial_filter_leaves_the_mean_alone():
    values = np.random.default_rng(3).normal(size=(613, 3)) + np.linspace(0.0, 3.0, 613)[:, None]
    for degree in (0, 1, 3):
        filtered, residual = polynomial_filter(values, degree)
        np.testing.assert_allclose(filtered.mean(axis=0), values.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(filtered + residual, values, rtol=1e-12)


def session(noise=0.03, seconds=8.0):
    rng = np.random.default_rng(4)
    n = int(100 * seconds)
    reading = np.repeat(UP @ FORWARD.T + OFFSET, n, axis=0) + noise * rng.standard_normal((6 * n, 3))
    record = Record(time=np.arange(6 * n) / 100.0, accel=reading)
    stills = [Still(start=n * k, stop=n * (k + 1), face=face) for k, face in enumerate(FACES)]
    return record, stills


def test_windows_of_six_seconds_are_averaged_with_their_noise():
    record, stills = session()
    poses = face_means([record], [*stills, Still(start=0, stop=100)])
    assert poses.faces == FACES
    middle = record.accel[100:700]
    np.testing.assert_allclose(poses.reading[0], middle.mean(axis=0), rtol=1e-12)
    # 60 spare blocks tell the noise of a mean, 0.03 / sqrt(600), to 9 %; 27 % is three sigma
    np.testing.assert_allclose(poses.noise, 0.03 / np.sqrt(600.0), rtol=0.27)


def test_noise_of_a_face_is_what_its_polynomial_leaves():
    record, _ = session(seconds=60.0)
    ramp = np.tile(np.linspace(-0.3, 0.3, 600), 60)[:, None]  # ten times the noise of a sample
    stills = [Still(start=600 * k, stop=600 * (k + 1), face=FACES[k // 10]) for k in range(60)]
    noise = face_means([replace(record, accel=record.accel + ramp)], stills, polynomial_degree=3).noise
    # a cubic takes four of the 12 blocks of a window, and the 1,440 that it leaves tell the noise to 2 %
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.03 / np.sqrt(600.0), rel=0.07)


def test_a_face_that_is_all_gap_is_refused():
    record, stills = session(seconds=1.0)
    gappy = np.array(record.accel)
    gappy[:100] = np.nan
    with pytest.raises(InputError, match="got 0"):
        face_means([Record(time=record.time, accel=gappy)], stills)


def test_faces_too_short_to_show_their_noise_give_none():
    record, stills = session(seconds=0.6)
    assert face_means([record], stills).noise is None


def test_readings_without_any_noise_are_weighed_alike():
    fit = fit_six_face(faces(noise=0.0), gravity=G)
    np.testing.assert_allclose(fit.model.forward_matrix, FORWARD, atol=1e-13)
    assert fit.verdict.reasons == ()


def test_a_large_tilt_is_a_finding_and_makes_the_fit_marginal():
    rng = np.random.default_rng(7)
    crooked = np.where(UP == 0.0, G * np.radians(1.0) * rng.standard_normal((6, 3)), 0.0)
    poses = FaceMeans(reading=faces().reading + crooked @ FORWARD.T, faces=FACES, noise=np.full((6, 3), 0.002))
    fit, tilt = fit_six_face(poses, gravity=G), tilt_of(poses)
    assert tilt == pytest.approx(np.radians(1.0), rel=0.9)  # six spare equations: three times 29 %
    assert fit.verdict.status == "marginal"
    (large,) = fit.verdict.findings
    assert large.code == "six_face.tilt"
    assert large.values["tilt_deg"] == pytest.approx(np.degrees(tilt))
    assert f"{np.degrees(tilt):.2f} deg" in large.sentence


def tilt_of(poses):
    """Return the standard deviation of the faces' tilt, rad."""
    return solve_faces(poses, G).excess["level"] ** 0.5


def tilted(tilt_deg, rng, noise=0.002):
    """Return readings of faces that are tilted at random, m/s2."""
    cross = np.where(UP == 0.0, G * np.radians(tilt_deg) * rng.standard_normal((6, 3)), 0.0)
    return FaceMeans(
        reading=UP + cross + noise * rng.standard_normal((6, 3)), faces=FACES, noise=np.full((6, 3), noise)
    )


def test_flicker_widens_the_offset():
    record, stills = session()
    poses = face_means([record], stills)
    model, without = (fit_six_face(item, gravity=G).model for item in (poses, replace(poses, flicker=None)))
    assert (model.standard_uncertainty[9:12] > without.standard_uncertainty[9:12]).all()
    assert "instability" in model.budget.sources


def test_rests_of_one_mounting_count_once():
    rng = np.random.default_rng(10)
    stated = simulate_session("six_face", random_device(rng), rng=rng)
    *others, last = stated.stills
    half = (last.start + last.stop) // 2
    seen = observe(
        replace(stated, stills=(*others, replace(last, stop=half), replace(last, start=half))), CalibrateSettings()
    )
    one, other = (calibrate_faces(item, "affine") for item in (observe(stated, CalibrateSettings()), seen))
    assert other.model.count == one.model.count + 3
    # two halves of a rest have one tilt: the noise of the shorter windows is all that changes
    np.testing.assert_allclose(other.model.standard_uncertainty, one.model.standard_uncertainty, rtol=0.2)


def test_the_cosine_of_a_tilt_widens_the_scale():
    poses = tilted(2.0, np.random.default_rng(14), noise=1e-6)
    fit = fit_six_face(poses, gravity=G)
    # the smallest of three uncertainties is 1.6 d^2; the sines of the tilts alone make 1.2 d^2 of it
    assert fit.model.standard_uncertainty[[0, 4, 8]].min() > 1.4 * tilt_of(poses) ** 2
    budget = fit.model.budget
    by_source = dict(zip(budget.sources, budget.uncertainty[:, [0, 4, 8]], strict=True))
    assert (by_source["level"] > 100.0 * by_source["noise"]).all()
