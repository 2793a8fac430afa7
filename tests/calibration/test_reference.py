"""The gyroscope fit against an orientation reference: exact without noise, honest with it, plain about what it cannot see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.findings import only
from testkit.hand_turns import Device, hidden, later, make_recording
from undrift.calibration import reference as reference_module
from undrift.calibration.reference import (
    CODE_PRIOR,
    Solution,
    Windows,
    align,
    fit_aligned,
    fit_reference,
    leave_one_out,
    solve_windows,
)
from undrift.errors import AlignmentError, Implausible, InputError, NotObservable
from undrift.frames import rotate
from undrift.model import AdcModel
from undrift.record import Record, Reference

pytestmark = pytest.mark.usefixtures("computed_once")

FORWARD = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])
REST = np.array([0.004, -0.003, 0.002])
CHANGE = np.array([5e-4, -3e-4, 4e-4])


def recordings(seeds, device, **motion):
    pairs = [make_recording(np.random.default_rng(seed), device, **motion) for seed in seeds]
    return [p[0] for p in pairs], [p[1] for p in pairs]


def fit_throughout(records, references):
    """Fit with an offset that applies from the first to the last rest."""
    return fit_aligned([align(*pair) for pair in zip(records, references, strict=True)], "each", turning=False)


@pytest.fixture(scope="module")
def exact():
    device = Device(forward=FORWARD, offset=REST, motion_offset=CHANGE, lag_s=0.0041)
    return recordings((1, 2), device)


@pytest.fixture(scope="module")
def noisy():
    device = Device(forward=FORWARD, offset=REST, motion_offset=CHANGE, lag_s=0.0041, noise=2e-3)
    return recordings((11, 12, 13), device, optics_noise=1e-3)


@pytest.mark.slow
def test_matrix_offset_and_lag_come_back_without_noise(exact):
    fit = fit_reference(*exact)
    model = fit.triad.model
    # Strapdown holds each reading for 5 ms: what the corners of the motion lose between samples is all that is left.
    assert np.abs(model.matrix - np.linalg.inv(FORWARD)).max() < 5e-5
    assert np.abs(fit.motion_offset - CHANGE).max() < 3e-5  # the change rises at once, the motion over a second
    assert np.abs(model.moving_offset - model.matrix @ CHANGE).max() < 3e-5
    assert np.allclose(model.offset, REST, atol=1e-9)  # at rest
    assert fit.lags_s == pytest.approx([0.0041, 0.0041], abs=5e-6)
    assert np.allclose(fit.rest_offsets, REST, atol=1e-9)
    assert (model.rank, fit.window_s, model.method) == (12, 16.0, "reference/motion")
    assert model.valid_range[0] < -2.0
    assert model.valid_range[1] > 2.0
    assert fit.triad.verdict.status == "good"


def test_a_recording_gets_its_own_rest_offset(exact):
    fit = fit_reference(*exact)
    model = fit.model_at_rest_offset(np.array([0.1, 0.2, 0.3]))
    assert np.allclose(model.offset, [0.1, 0.2, 0.3])
    throughout = fit_throughout(*exact)
    assert throughout.triad.model.moving_offset is None
    assert np.allclose(throughout.model_at_rest_offset(REST).offset, REST + CHANGE, atol=3e-5)


def clipped(records, limit):
    return [replace(record, gyro=np.clip(record.gyro, -limit, limit)) for record in records]


def test_saturated_readings_are_left_out_and_named(noisy):
    fit = fit_reference(clipped(noisy[0], 1.6), noisy[1])  # rad/s, 1 in 10 samples of the third recording
    model = fit.triad.model
    # as without saturation, with the shorter windows that fit between the gaps; clipped readings would miss by 0.02
    assert np.abs(model.matrix - np.linalg.inv(FORWARD)).max() < 2e-3
    results = [item.values for item in fit.triad.verdict.findings if item.code == "session.saturated"]
    beyond = [int((np.abs(record.gyro) >= 1.6).any(axis=1).sum()) for record in noisy[0]]
    assert [values["count"] for values in results] == beyond


def test_counts_and_a_turned_mounting_are_taken_up_by_the_matrix():
    mounting = Rotation.from_rotvec((0.2, -1.1, 0.6))
    forward = 900.0 * FORWARD
    device = Device(forward=forward, offset=np.array([30.0, -12.0, 7.0]), unit="count")
    fit = fit_reference(*recordings((4,), device, mounting=mounting))
    model = fit.triad.model
    expected = mounting.as_matrix() @ np.linalg.inv(forward)
    assert np.abs(model.matrix - expected).max() < 1e-4 / 900.0
    assert model.unit_in == "count"
    assert model.offset == pytest.approx([30.0, -12.0, 7.0], abs=0.05)


@pytest.mark.slow
def test_offsets_that_differ_between_recordings_are_named():
    device = Device(forward=FORWARD, offset=REST)
    warmer = Device(forward=FORWARD, offset=REST + 2e-3)
    a, b = recordings((31,), device), recordings((32,), warmer)
    fit = fit_reference([*a[0], *b[0]], [*a[1], *b[1]])
    assert fit.triad.verdict.status == "marginal"
    spread = only(fit.triad.verdict.findings, "reference.rest_offset").values["spread_dps"]
    assert 0.08 <= spread < 0.09


def test_gaps_on_either_side_are_left_out(exact):
    records, references = exact
    gyro = np.array(records[0].gyro)
    gyro[4000:4020] = np.nan
    holed = Record(time=records[0].time, gyro=gyro)
    fit = fit_reference([holed, records[1]], [hidden(references[0], 30.0, 33.0), references[1]])
    assert np.abs(fit.triad.model.matrix - np.linalg.inv(FORWARD)).max() < 1e-4


@pytest.mark.slow
def test_leave_one_out_knows_nothing_of_the_held_out_reference(noisy):
    records, references = noisy
    held = leave_one_out(records, references)
    # Turn everything the held-out optics saw in motion by a growing error: its own model must not move.
    spoilt = np.array(references[0].q_nb)
    growing = np.linspace(0.0, 0.05, len(spoilt))[:, None] * np.array([1.0, 0.5, -0.3])
    spoilt = (Rotation.from_quat(spoilt, scalar_first=True) * Rotation.from_rotvec(growing)).as_quat(scalar_first=True)
    again = leave_one_out(records, [replace(references[0], q_nb=spoilt), *references[1:]])
    assert (again[0].model.matrix == held[0].model.matrix).all()
    assert np.allclose(again[0].model.offset, held[0].model.offset, atol=1e-6)  # the lag moves the rest's last sample
    assert not np.allclose(again[1].model.matrix, held[1].model.matrix, atol=1e-6)


def test_another_mounting_in_one_recording_is_an_alignment_error(exact):
    records, references = exact
    turn = Rotation.from_euler("z", 20.0, degrees=True)
    turned = replace(records[1], gyro=turn.apply(np.array(records[1].gyro)))
    with pytest.raises(AlignmentError, match="differ by"):
        fit_reference([records[0], turned], references, mounting="one")
    device = Device(forward=FORWARD, offset=REST, motion_offset=CHANGE, lag_s=0.0041)
    other = recordings((2,), device, mounting=turn)
    fit = fit_reference([records[0], *other[0]], [references[0], *other[1]])  # in the mean of both bodies
    body = Rotation.from_rotvec(fit.mountings[0]).as_matrix()
    assert np.abs(body @ fit.triad.model.matrix - np.linalg.inv(FORWARD)).max() < 2e-4
    assert fit.mountings[1] - fit.mountings[0] == pytest.approx(np.radians((0.0, 0.0, 20.0)), abs=2e-4)
    scaled = replace(records[1], gyro=1.2 * np.array(records[1].gyro))
    with pytest.raises(AlignmentError, match="differ by"):
        fit_reference([records[0], scaled], references)


def rounded(pairs, lsb, how):
    return [replace(r, gyro=how(np.array(r.gyro) / lsb) * lsb) for r in pairs[0]], pairs[1]


@pytest.mark.slow
def test_what_codes_lose_is_found_about_half_a_step():
    # Codes cut off toward zero that lose a third of a step beyond half a step, as converters do that are not even about zero.
    lsb, more = 8e-3, np.array([2e-3, -2e-3, -1e-3])
    device = Device(forward=FORWARD, offset=REST, noise=2e-3)
    plain = recordings((81, 82, 83), device, sample_rate_hz=100.0, turn_s=110.0)
    records, references = rounded(plain, lsb, np.trunc)
    records = [replace(r, gyro=np.asarray(r.gyro) - more * np.sign(r.gyro)) for r in records]
    adc = AdcModel(gyro_lsb=np.full(3, lsb), gyro_rounding="toward_zero")
    model = fit_reference(records, references, adc=adc).triad.model
    sigma = dict(zip(model.parameters, model.standard_uncertainty, strict=True))
    for k, axis in enumerate("xyz"):
        assert sigma[f"code_{axis}"] < CODE_PRIOR * lsb  # two minutes add to the prior
        assert abs(model.code_offset[k] - 0.5 * lsb - more[k]) < 3.0 * sigma[f"code_{axis}"]
    assert model.values[-3:] == pytest.approx(model.code_offset)
    # The offset is that of readings that are corrected so: at rest they are zero
    rest = np.asarray(records[0].gyro)[:600]
    residual = (rest + model.code_offset * np.sign(rest)).mean(axis=0) - model.offset
    assert np.abs(residual).max() < 2e-4
    without = fit_reference(records, references).triad.model
    assert without.code_offset is None
    assert without.parameters == model.parameters[:-3]


@pytest.mark.slow
def test_the_change_to_motion_acts_while_the_device_turns_alone():
    # Pauses of 4 s after each 6 s: half of what is within the motion is rest, where the offset is that of the rest.
    device = Device(forward=FORWARD, offset=REST, motion_offset=CHANGE, noise=3e-4)
    pairs = recordings((5, 6), device, pauses=True)
    fit, throughout = fit_reference(*pairs), fit_throughout(*pairs)
    model = fit.triad.model
    true = np.linalg.inv(FORWARD) @ CHANGE
    # It is taken to last half a second beyond the turn, of 6 s
    assert (np.abs(model.moving_offset - true) < 0.16 * np.abs(true)).all()
    assert (np.abs(throughout.motion_offset - CHANGE) > 0.3 * np.abs(CHANGE)).all()  # spread over the pauses
    assert model.offset == pytest.approx(REST, abs=3e-5)
    assert model.parameters[12:] == ("moving_x", "moving_y", "moving_z")


# ---- covariance of windows

REACH, POSES = 32, 240
ERRORS = {
    "poses": lambda rng, n: rng.normal(size=(n, 3)),
    "readings": lambda rng, n: np.cumsum(rng.normal(size=(n, 3)), axis=0),
    "offset": lambda rng, n: np.cumsum(np.cumsum(rng.normal(size=(n, 3)), axis=0), axis=0),
}


def windows_of(rng: np.random.Generator, error: np.ndarray) -> Windows:
    """Windows over a body that turns, true parameters zero: columns are sums of rates that last 2 to 20 poses."""
    count = len(error)
    q = rng.normal(size=(count, 4))
    q_nb = q / np.linalg.norm(q, axis=1, keepdims=True)
    kept = np.exp(-1.0 / rng.uniform(2.0, 20.0, (3, 12)))
    rate = rng.normal(size=(count, 3, 12))
    for k in range(1, count):
        rate[k] += kept * rate[k - 1]
    total, first = np.cumsum(rate, axis=0), np.arange(count - REACH)
    columns = np.concatenate((total, error[:, :, None]), axis=2)
    back = q_nb[REACH:] * (1.0, -1.0, -1.0, -1.0)  # into the body at the end
    inside = np.moveaxis(rotate(back[:, None], np.moveaxis(columns[REACH:] - columns[:-REACH], 1, 2)), 2, 1)
    return Windows(turn=inside[:, :, 12], design=inside[:, :, :12], first=first)


def solved(rng: np.random.Generator, errors: list[np.ndarray]) -> Solution:
    windows = [windows_of(rng, error) for error in errors]
    design = np.concatenate([window.design for window in windows])
    return solve_windows(windows, design, np.zeros(12), np.full(12, np.inf), reach=REACH, scale=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ERRORS)
def test_stated_intervals_hold_whatever_errs(kind: str) -> None:
    # 60 fits of 12 parameters: the share inside 95 % has a standard deviation of about 1 %.
    z = []
    for seed in range(60):
        rng = np.random.default_rng((seed, 5))
        solution = solved(rng, [ERRORS[kind](rng, POSES) for _ in range(2)])
        z.append(solution.step / np.sqrt(np.diag(solution.covariance)))
    inside = 100.0 * float(np.mean(np.abs(z) < 1.96))
    print(f"  {kind}: {inside:.1f} % inside 95 %")
    assert 90.0 <= inside <= 99.0  # eight blocks: Student's factor is too careful where poses err by white noise


# ---- recordings that begin and end in motion


def cut(pairs, start_s=9.0, stop_s=67.0):
    return [record.between(start_s, stop_s) for record in pairs[0]], pairs[1]


@pytest.mark.slow
def test_recordings_without_a_rest_give_the_mean_offset():
    offsets = REST + np.array([[8e-4, -5e-4, 3e-4], [-6e-4, 9e-4, 2e-4]])
    results = [
        recordings((seed,), Device(forward=FORWARD, offset=o, noise=1e-3), optics_noise=1e-3, mark=False)
        for seed, o in zip((91, 92), offsets, strict=True)
    ]
    pairs = cut(([result[0][0] for result in results], [result[1][0] for result in results]))
    fit = fit_reference(*pairs)
    spread = fit.triad.model.standard_uncertainty
    assert np.isnan(fit.rest_offsets).all()
    assert fit.triad.verdict.status == "good"
    assert (np.abs(fit.triad.model.matrix - np.linalg.inv(FORWARD)).reshape(-1) < 4.0 * spread[:9]).all()
    assert spread[:9].max() < 1e-3
    # two recordings, each within 0.1 deg/s of what the device usually has: their mean is known to 0.07
    assert np.abs(fit.triad.model.offset - offsets.mean(axis=0)).max() < 1e-4
    assert spread[9:] == pytest.approx(reference_module.TURN_ON / np.sqrt(2.0), rel=0.1)
    (held, _) = leave_one_out(*pairs)
    assert np.abs(held.model.offset - offsets[1]).max() < 1e-4  # the other's: its own nobody knows


def test_one_of_two_recordings_may_rest():
    device = Device(forward=FORWARD, offset=REST, motion_offset=CHANGE, noise=1e-3)
    records, references = recordings((93, 94), device, optics_noise=1e-3, mark=False)
    fit = fit_reference([records[0], records[1].between(9.0, 67.0)], references)
    np.testing.assert_array_equal(np.isnan(fit.rest_offsets).all(axis=1), [False, True])
    assert np.abs(fit.triad.model.offset - REST).max() < 1e-4
    assert np.abs(fit.motion_offset - CHANGE).max() < 2e-4


@pytest.mark.slow
def test_a_planar_motion_keeps_a_prior_and_names_its_elements():
    records, references = cut(recordings((95, 96), Device(noise=1e-3), mark=False, planar=True))
    fit = fit_reference(records, references)
    assert only(fit.triad.verdict.findings, "motion.prior").values["axes"] == ("z",)
    spread = fit.triad.model.standard_uncertainty[:9].reshape(3, 3)
    assert spread[:, 2] == pytest.approx(reference_module.MATRIX_PRIOR, rel=0.1)
    assert spread[:, :2].max() < 2e-3
    assert np.abs(fit.triad.model.matrix - np.eye(3)).max() < 0.03


def one_axis():
    t = np.arange(0.0, 60.0, 0.005)
    angle = np.where(t > 8.0, 1.5 * (1.0 - np.cos(1.1 * np.maximum(t - 8.0, 0.0))), 0.0)
    rate = np.gradient(angle, t)[:, None] * [0.0, 1.0, 0.0]
    q = Rotation.from_rotvec(angle[:, None] * (0.0, 1.0, 0.0)).as_quat(scalar_first=True)
    return [Record(time=t, gyro=rate)], [Reference(time=t, q_nb=q, moving=(t > 8.0).astype(float))]


@pytest.mark.parametrize(
    ("pairs", "error", "words"),
    [
        (lambda records, references: (records, references[:1]), InputError, "one reference"),
        (
            lambda records, references: ([records[0], replace(records[1], gyro_unit="dps")], references),
            InputError,
            "dps",
        ),
        (lambda records, references: one_axis(), NotObservable, "one axis"),
        (lambda records, references: recordings((9,), Device(forward=FORWARD), turn_s=5.0), NotObservable, "windows"),
        (lambda records, references: (records[:1], [later(references[1], 0.0)]), AlignmentError, "common motion"),
        (
            lambda records, references: ([replace(r, gyro=r.gyro * [1.0, -1.0, 1.0]) for r in records], references),
            Implausible,
            "is reversed",
        ),
    ],
)
def test_recordings_that_determine_no_matrix_are_refused(exact, pairs, error, words):
    with pytest.raises(error, match=words):
        fit_reference(*pairs(*exact))


def test_leave_one_out_refuses_one_recording(exact):
    with pytest.raises(InputError, match="two recordings"):
        leave_one_out(exact[0][:1], exact[1][:1])


def test_refusal_names_saturation_as_its_cause(noisy):
    with pytest.raises(NotObservable, match="saturated"):
        fit_reference(clipped(noisy[0][:2], 1.2), noisy[1][:2])
