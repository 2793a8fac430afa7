"""The error to expect of a recording: by hand where it can be, by drawn calibrations where it cannot."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from testkit.plain_triad import plain_triad
from undrift.correction.motion import fit_motion
from undrift.correction.rest import MOVED, RemainingOffset
from undrift.frames import integrate_strapdown
from undrift.record import Record
from undrift.validation.expected import ErrorPrior, OffsetSource, Strapdown, expected_errors
from undrift.validation.trial import compare_orientations

NOTHING = ErrorPrior(
    matrix=0.0, motion_offset=0.0, rest_to_motion=0.0, day_to_day=0.0, tilt=0.0, mounting=0.0, pose=0.0
)
OTHER, SHOWN = OffsetSource(rest="other", in_motion=True), OffsetSource(rest="shown", in_motion=True)
DEG = np.degrees(1.0)
T = 40.0
DRAWN = 100


def model_of(covariance, *, matrix=None, **more):
    plain = plain_triad("rad/s", "rad/s")
    return replace(
        plain, method="reference/motion", matrix=np.eye(3) if matrix is None else matrix, covariance=covariance, **more
    )


def course_of(rate, q_nb=None, **more):
    """A record of T seconds at one rate; at rest where it is zero."""
    t = np.arange(0.0, T + 1e-9, 0.01)
    gyro = np.tile(np.asarray(rate, float), (len(t), 1))
    if q_nb is None:
        half = 0.5 * np.linalg.norm(rate) * t
        axis = np.asarray(rate) / max(np.linalg.norm(rate), 1e-12)
        q_nb = np.column_stack((np.cos(half), np.sin(half)[:, None] * axis))
    record = Record(time=t, gyro=gyro, accel=np.tile((0.0, 0.0, 9.81), (len(t), 1)))
    known = {
        "delay_s": 0.0,
        "offset_covariance": np.zeros((3, 3)),
        "offset_prior": np.zeros(3),
        "noise_density": 0.0,
        "tilt": 0.0,
        "mounting": 0.0,
    }
    return Strapdown(record=record, q_nb=q_nb, stop_s=T, turned=np.eye(3), **(known | more))


def only(index, sd, size=12):
    covariance = np.zeros((size, size))
    covariance[index, index] = sd**2
    return covariance


def test_an_offset_grows_with_time_and_its_mean_square_is_a_third():
    made = expected_errors(course_of((0.0, 0.0, 0.0)), model_of(only(9, 1e-4)), OTHER, NOTHING)
    assert made.end_total_deg == pytest.approx(1e-4 * T * DEG, rel=1e-3)
    assert made.rmse_total_deg == pytest.approx(1e-4 * T / np.sqrt(3.0) * DEG, rel=2e-2)
    # one normal error: 2.5 % of its absolute values are above 2.24 and 2.5 % below 0.031 standard deviations
    assert made.end_interval_deg == pytest.approx(np.array([0.0313, 2.2414]) * 1e-4 * T * DEG, rel=5e-3)
    assert made.end_at_most_deg == pytest.approx(1.95996 * 1e-4 * T * DEG, rel=5e-3)  # and 5 % above 1.96


def test_scale_counts_by_the_angle_and_cross_axis_terms_by_what_they_turn_about():
    turning = course_of((0.0, 0.0, 0.5))
    scale, cross = (expected_errors(turning, model_of(only(i, 1e-3)), OTHER, NOTHING).end_total_deg for i in (8, 2))
    assert scale == pytest.approx(1e-3 * 0.5 * T * DEG, rel=1e-3)
    assert cross == pytest.approx(1e-3 * np.hypot(np.sin(0.5 * T), 1.0 - np.cos(0.5 * T)) * DEG, rel=2e-2)


def test_g_sensitivity_and_counts_are_taken_in_their_units():
    names = (*model_of(only(0, 1.0)).parameters, *(f"g_{a}{b}" for a in "xyz" for b in "xyz"))
    made = expected_errors(
        course_of((0.0, 0.0, 0.0)),
        model_of(only(12 + 2, 1e-5, 21), parameters=names, g_sensitivity=np.zeros((3, 3))),
        OTHER,
        NOTHING,
    )
    assert made.end_total_deg == pytest.approx(1e-5 * 9.81 * T * DEG, rel=1e-3)
    counts = model_of(only(8, 1e-6), matrix=1e-3 * np.eye(3))  # 0.1 % of a scale of 1e-3 rad/s a count
    made = expected_errors(course_of((0.0, 0.0, 0.5)), counts, OTHER, NOTHING)
    assert made.end_total_deg == pytest.approx(1e-3 * 0.5 * T * DEG, rel=1e-3)


def test_a_subtracted_rest_takes_the_models_offset_with_it_and_brings_its_own_scatter():
    still = course_of((0.0, 0.0, 0.0), offset_covariance=1e-10 * np.eye(3))
    model = model_of(only(9, 1e-4))
    subtracted = OffsetSource(rest="subtracted", in_motion=False)
    made = expected_errors(still, model, subtracted, NOTHING)
    assert made.end_total_deg == pytest.approx(1e-5 * T * np.sqrt(3.0) * DEG, rel=1e-3)
    moved = expected_errors(still, model, subtracted, replace(NOTHING, rest_to_motion=1e-4))
    assert moved.end_total_deg == pytest.approx(np.hypot(1e-5, 1e-4) * T * np.sqrt(3.0) * DEG, rel=1e-3)


@pytest.mark.parametrize(
    ("prior", "end"),
    [
        ({"day_to_day": 1e-4}, 1e-4 * T * np.sqrt(3.0)),
        ({"motion_offset": 1e-4}, 1e-4 * T * np.sqrt(3.0 * 1.25)),  # spread of one recording and of the mean of four
        ({"matrix": 1e-3}, 1e-3 * 0.5 * T * np.sqrt(1.25)),
        ({"pose": 1e-3}, 1e-3 * np.sqrt(3.0 + 1.0)),  # the heading at the start is the reference's too
        ({"mounting": 1e-3}, 1e-3 * np.sqrt(2.0) * np.hypot(np.sin(0.5 * T), 1.0 - np.cos(0.5 * T))),
    ],
)
def test_what_changes_between_recordings_is_added(prior, end):
    source = OffsetSource(rest="other", in_motion=True, recordings=4)
    rate = (0.0, 0.0, 0.5) if {"matrix", "mounting"} & prior.keys() else (0.0, 0.0, 0.0)
    made = expected_errors(course_of(rate), model_of(np.zeros((12, 12))), source, replace(NOTHING, **prior))
    # elements of the matrix beside the scale turn about level axes, which the turning averages
    assert made.end_total_deg == pytest.approx(end * DEG, rel=6e-3)


def test_noise_tilt_and_delay_count():
    model = model_of(np.zeros((12, 12)))
    noise = expected_errors(course_of((0.0, 0.0, 0.0), noise_density=1e-4), model, OTHER, NOTHING)
    assert noise.end_total_deg == pytest.approx(1e-4 * np.sqrt(3.0 * T) * DEG, rel=1e-3)
    assert noise.rmse_total_deg == pytest.approx(1e-4 * np.sqrt(1.5 * T) * DEG, rel=1e-2)
    tilt = expected_errors(course_of((0.0, 0.0, 0.0), tilt=1e-3), model, OTHER, NOTHING)
    assert tilt.end_total_deg == pytest.approx(tilt.rmse_total_deg) == pytest.approx(1e-3 * np.sqrt(2.0) * DEG)
    late = expected_errors(course_of((0.0, 0.0, 2.0), delay_s=2e-3), model, OTHER, NOTHING)
    assert late.rmse_total_deg == pytest.approx(2.0 * 2e-3 * DEG)
    assert late.end_total_deg == pytest.approx(0.0, abs=1e-9)


def test_an_offset_from_motion_takes_a_wrong_scale_back_where_gravity_shows_it():
    # Turning at 0.5 rad/s about a level axis: a scale that is off by 1e-3 is a steady rate, which the offset takes for its own.
    turning = course_of((0.5, 0.0, 0.0), offset_prior=np.full(3, MOVED))
    lean = 0.5 * turning.record.time
    force = 9.80665 * np.column_stack((np.zeros_like(lean), np.sin(lean), np.cos(lean)))
    turning = replace(turning, record=replace(turning.record, accel=force))
    plain, shown = (expected_errors(turning, model_of(only(0, 1e-3)), each, NOTHING) for each in (OTHER, SHOWN))
    assert plain.end_total_deg == pytest.approx(1e-3 * 0.5 * T * DEG, rel=1e-3)
    show("end error by scale, deg: other offset, offset from motion", (plain.end_total_deg, shown.end_total_deg))
    assert shown.end_total_deg < 0.2 * plain.end_total_deg


@pytest.mark.slow
@pytest.mark.parametrize("source", [OTHER, SHOWN])
def test_drawn_calibrations_err_as_often_as_their_intervals_say(source):
    # Matrix and offset drawn from the stated covariance, correlated; the record itself is exact. Where motion shows the offset, it
    # is drawn about a rest by what moves it there, and each offset that is found answers the matrix drawn with it.
    rng = np.random.default_rng(8)
    forward = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])
    device = Device(forward=forward, offset=np.array([0.004, -0.003, 0.002]))
    record, reference = make_recording(rng, device, turn_s=20.0, sample_rate_hz=100.0, optics_hz=100.0)
    root = rng.normal(size=(12, 12)) * np.repeat((1e-3, 5e-4), (9, 3))[:, None] / np.sqrt(12.0)
    if source is SHOWN:
        record = replace(record, state="corrected")  # otherwise the matrix of a data sheet counts
        root[9:] = np.hstack((np.zeros((3, 9)), MOVED * np.eye(3)))
    truth = np.concatenate((np.linalg.inv(forward).ravel(), device.offset))
    true = integrate_strapdown((record.gyro - truth[9:]) @ truth[:9].reshape(3, 3).T, record.time, reference.q_nb[0])
    inside, ratio = np.zeros(2), []
    for _ in range(DRAWN):
        drawn = truth + root @ rng.normal(size=12)
        model = replace(model_of(root @ root.T, matrix=drawn[:9].reshape(3, 3)), offset=drawn[9:])
        gyro = (record.gyro - model.offset) @ model.matrix.T
        more = {}
        if source is SHOWN:
            nothing = RemainingOffset(
                time=[0.5], rate=np.zeros((1, 3)), covariance=1e-12 * np.eye(3)[None], rest_s=(0.0, 1.0), moved=0.0
            )
            shown = fit_motion(replace(record, gyro=gyro), nothing).offset
            gyro = gyro - shown.at(record.time)
            more = {"offset_covariance": shown.covariance.mean(axis=0), "offset_prior": shown.prior}
        q = integrate_strapdown(gyro, record.time, reference.q_nb[0])
        error = compare_orientations(q, true).total
        course = course_of((0.0, 0.0, 0.0), q, **more)
        course = replace(course, record=replace(record, gyro=gyro), stop_s=float(record.time[-1]))
        made = expected_errors(course, model, source, NOTHING)
        end, rmse = np.degrees((error[-1], np.sqrt((error**2).mean())))
        inside += (
            made.end_interval_deg[0] <= end <= made.end_interval_deg[1],
            made.rmse_interval_deg[0] <= rmse <= made.rmse_interval_deg[1],
        )
        ratio.append((end**2 / made.end_total_deg**2, rmse**2 / made.rmse_total_deg**2))
    low, high = binom.ppf((0.001, 0.999), DRAWN, 0.95)
    show(f"drawn calibrations inside 95 %, end and rmse, of {DRAWN}", inside.tolist(), f"{low:g} to {high:g}")
    show("mean square over the expected one", np.mean(ratio, axis=0).round(2).tolist(), "0.55 to 1.45")
    assert ((low <= inside) & (inside <= high)).all()
    # 100 squares of one degree of freedom or more: their mean scatters by 14 % at most
    assert (np.abs(np.mean(ratio, axis=0) - 1.0) < 0.45).all()
