"""Known rotation: exact on made sums, reversed turns named, what is missing named."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cohorts import share_limits
from testkit.findings import codes, only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.known_rotation import RotationRows, calibrate_turns, fit_known_rotation, rotation_rows
from undrift.calibration.plausibility import axis_vectors, face_vectors
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.six_face import calibrate_faces
from undrift.errors import Implausible, InputError, NotObservable
from undrift.record import FACES, Record, Still, Turn
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings
from undrift.sim.sessions import simulate_session

G = 9.81
K = np.array([[16.4, 0.1, -0.2], [0.05, 16.0, 0.3], [-0.1, 0.2, 16.7]]) * 180.0 / np.pi  # counts per rad/s
B = np.array([3.0, -20.0, 5.0])
G_SENSITIVITY = np.array([[0.02, -0.01, 0.03], [0.01, 0.05, -0.02], [0.0, 0.02, -0.04]])  # counts per m/s2
ANGLE = 2.0 * np.pi * np.array([1.0, 1.0, -1.0])
FORCE = np.array([[9.8, 1.0, 0.3], [0.5, 9.7, -0.8], [0.2, -0.4, 9.8]]) * 4.0
SAMPLES = np.array([600.0, 500.0, 700.0, 600.0, 550.0, 650.0])


def made(**change):
    """Return six rests and three turns of 4 s."""
    up = G * face_vectors(FACES)
    turns = axis_vectors(("x", "y", "z")) * ANGLE[:, None]
    values = {
        "reading": np.vstack((B + up @ G_SENSITIVITY.T, (turns @ K.T + FORCE @ G_SENSITIVITY.T) / 4.0 + B)),
        "noise": np.vstack((0.3 / np.sqrt(SAMPLES)[:, None] * np.ones(3), np.full((3, 3), 0.05 / 4.0))),
        "force": np.vstack((up, FORCE / 4.0)),
        "samples": SAMPLES,
        "faces": FACES,
        "duration": np.full(3, 4.0),
        "axis": ("x", "y", "z"),
        "angle": ANGLE,
        "unit": "count",
        **change,
    }
    return RotationRows(**values)


def part(rows, pieces, turns):
    return replace(
        rows,
        reading=rows.reading[pieces], noise=rows.noise[pieces], force=rows.force[pieces],
        samples=rows.samples[pieces[: len(pieces) - len(turns)]],
        faces=tuple(rows.faces[k] for k in pieces[: len(pieces) - len(turns)]),
        duration=rows.duration[turns], axis=tuple(rows.axis[k] for k in turns), angle=rows.angle[turns],
    )  # fmt: skip


def parameters(model):
    return np.concatenate((model.matrix.reshape(-1), model.offset, model.g_sensitivity.reshape(-1)))


# the noise is stated in the frame of a first matrix without g-sensitivity, which is off by 0.5 % here
@pytest.mark.parametrize("mode", ["affine", "paper"])
def test_covariance_is_what_readings_carry_into_parameters(mode):
    felt = 20.0 * G_SENSITIVITY  # large, so that the matrix moves the g-sensitivity as much as its own noise does
    noise = (
        made().noise * np.repeat([1.0, 10.0], [6, 3])[:, None]
    )  # the turns' moves the g-sensitivity through the matrix
    rows = made(reading=made().reading + made().force @ (felt - G_SENSITIVITY).T, noise=noise)
    model = fit_known_rotation(rows, gravity=G, mode=mode).model
    expected = np.zeros((21, 21))
    for place in np.ndindex(9, 3):  # central differences: one reading at a time by its own noise
        step = np.zeros((9, 3))
        step[place] = rows.noise[place]
        high, low = (
            parameters(
                fit_known_rotation(replace(rows, reading=rows.reading + sign * step), gravity=G, mode=mode).model
            )
            for sign in (1.0, -1.0)
        )
        expected += 0.25 * np.outer(high - low, high - low)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(model.covariance / np.outer(size, size), expected / np.outer(size, size), atol=0.02)
    off = np.abs(expected / np.outer(size, size) - np.eye(21))
    assert off[:9, 9:12].max() > 0.03  # matrix and offset, matrix and g-sensitivity do depend on each other here
    assert off[:9, 12:].max() > 0.1


def test_uneven_clock_weighs_readings_by_their_intervals():
    time = np.array([0.0, 0.1, 0.2, 0.35, 0.5, 0.6])
    gyro = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])[:, None] * np.ones(3)
    record = Record(time=time, gyro=gyro, accel=np.tile([0.0, 0.0, 9.81], (6, 1)), gyro_unit="count")
    turn = Turn(start=2, stop=5, axis="z", angle=1.0)
    sums = rotation_rows([record], [Still(start=0, stop=3, face="+z")], [turn], matrix=np.eye(3), offset=np.zeros(3))
    np.testing.assert_allclose(sums.reading[1], (0.1 * 4.0 + 0.15 * 8.0 + 0.15 * 16.0) / 0.4)
    np.testing.assert_allclose(sums.duration, 0.4)


def test_noise_of_a_mean_falls_with_the_root_of_its_samples():
    gyro, accel = 0.02 * np.random.default_rng(14).standard_normal((6400, 3)), np.tile([0.0, 0.0, 9.81], (6400, 1))
    record = Record(time=np.arange(6400) / 100.0, gyro=gyro, accel=accel)
    rest, turn = Still(start=0, stop=6000, face="+z"), Turn(start=6000, stop=6400, axis="z", angle=1.0)
    noise = rotation_rows([record], [rest], [turn], matrix=np.eye(3), offset=np.zeros(3)).noise
    # 119 spare blocks of half a second tell it to 6 %
    np.testing.assert_allclose(noise / [[6000.0**-0.5], [400.0**-0.5]], 0.02, rtol=0.2)


def test_axis_error_enters_cross_axis_terms_only():
    sigma = np.radians(0.5)
    sure, unsure = (fit_known_rotation(made(), gravity=G, axis_uncertainty=u).model for u in (0.0, sigma))
    added = np.sqrt(np.diag(unsure.covariance - sure.covariance)[:9].clip(0.0)).reshape(3, 3)
    gain = np.diag(sure.matrix)
    for row, column in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):
        assert added[row, column] == pytest.approx(sigma * gain[column], rel=0.05)  # axes are askew by up to 3 %
    assert (np.diag(added) < 0.1 * sigma * gain).all()
    once = made()
    twice = part(once, [*range(9), 6, 7, 8], [0, 1, 2, 0, 1, 2])
    one, two = (fit_known_rotation(rows, gravity=G, axis_uncertainty=sigma).model for rows in (once, twice))
    assert two.covariance[1, 1] == pytest.approx(one.covariance[1, 1], rel=1e-3)


def test_jitter_of_stamps_is_an_uncertainty_of_the_turned_axis():
    rng, results = np.random.default_rng(8), []
    even = np.arange(1600) / 50.0
    rate = np.where((even >= 14.0) & (even < 18.0), 2.0 * np.pi / 2.0 * np.sin(np.pi * (even - 14.0) / 4.0) ** 2, 0.0)
    for _ in range(200):
        record = Record(
            time=even + 2e-3 * rng.standard_normal(1600),
            gyro=np.column_stack((rate, 0.0 * rate, 0.0 * rate)) + 1e-5 * rng.standard_normal((1600, 3)),
            accel=np.tile([9.81, 0.0, 0.0], (1600, 1)),
        )
        turn = Turn(start=700, stop=901, axis="x", angle=2.0 * np.pi)
        sums = rotation_rows(
            [record], [Still(start=0, stop=690, face="+x")], [turn], matrix=np.eye(3), offset=np.zeros(3)
        )
        results.append((float(sums.duration[0] * sums.reading[1, 0]), float(sums.slip[0, 0, 0]) ** 0.5))
    scatter, stated = np.std([result[0] for result in results]), np.mean([result[1] for result in results])
    assert stated == pytest.approx(scatter, rel=0.2)  # 200 draws know a standard deviation to 5 %: four of them


def test_one_code_at_rest_leaves_its_rounding_in_the_offset():
    coarse = made(rounding=np.full(3, 3.0), noise=np.vstack((np.full((6, 3), 1e-3), made().noise[6:])))
    fit = fit_known_rotation(coarse, gravity=G)
    assert (fit.model.standard_uncertainty[9:12] > 2.9).all()  # all rests may err alike: no average over six
    item = only(fit.verdict.findings, "session.rounding")
    assert item.level == "warn"
    assert item.values["uncertainty"] == 3.0
    fine = fit_known_rotation(replace(coarse, rounding=np.full(3, 1e-5)), gravity=G)
    assert "session.rounding" not in codes(fine.verdict.findings)


def test_rests_beside_the_turns_count_without_being_stated():
    rng = np.random.default_rng(12)
    stated = simulate_session("ferraris", random_device(rng), rng=rng)
    faces = replace(stated, stills=tuple(still for still in stated.stills if still.face is not None))
    both, alone = (observe(session, CalibrateSettings(identify_adc=False)) for session in (stated, faces))
    accel = calibrate_faces(both, "affine")
    every, result = (calibrate_turns(seen, "affine", accel) for seen in (both, alone))
    # The search loses half a second at each end of a rest of six, which is a tenth of its weight. The temperature is counted from
    # the mean time of the faces, which are all in the first half, so a drift adds a third.
    sigma = result.model.standard_uncertainty[9:12] / every.model.standard_uncertainty[9:12]
    np.testing.assert_allclose(sigma, 1.2, atol=0.3)


@pytest.mark.parametrize("order", [[1, 0, 2], [1, 2, 0]])
def test_turns_named_after_exchanged_columns_are_refused(order):
    device = random_device(np.random.default_rng(21), grade="consumer")
    session = simulate_session("ferraris", device, rng=np.random.default_rng(22), labelled=True, temp_c=25.0)
    assert calibrate(session).gyro.method == "known-rotation/affine"
    record = session.records[0]
    moved = {"xyz"[axis]: "xyz"[column] for column, axis in enumerate(order)}
    wrong = replace(
        session,
        records=(replace(record, gyro=record.gyro[:, order]),),
        turns=tuple(replace(turn, axis=moved[turn.axis]) for turn in session.turns),
    )
    with pytest.raises(Implausible, match="gyro"):
        calibrate(wrong)


SESSIONS = 24
HAND_AXIS = BenchSettings(sample_rate_hz=50.0, errors=BenchErrors(hand_axis=np.radians(0.5)))


def gyro_by_hand(device, rng, settings=HAND_AXIS, **statement):
    """Return the fit to a session whose angles are stated 1 deg off at random."""
    session = simulate_session("ferraris", device, rng=rng, settings=settings)
    off = tuple(replace(t, angle=t.angle + np.radians(1.0) * rng.normal()) for t in session.turns)
    seen = observe(replace(session, turns=off), CalibrateSettings(identify_adc=False, **statement))
    return calibrate_turns(seen, "affine", calibrate_faces(seen, "affine"))


def plain(device, **more):
    gyro = replace(device.gyro, adc=None, instability=None, random_walk=None, **more)
    return replace(device, gyro=gyro, accel=replace(device.accel, adc=None, instability=None, random_walk=None))


@pytest.mark.slow
def test_moves_between_rests_sharpen_the_matrix_of_turns():
    rng, away, stated = np.random.default_rng(16), [], []
    for _ in range(SESSIONS):
        device = plain(random_device(rng))
        fit, true = gyro_by_hand(device, rng), true_calibration(device).gyro
        assert "known_rotation.moves_disagree" not in codes(fit.verdict.findings)
        away.append((fit.model.matrix - true.matrix) / true.matrix[0, 0])
        stated.append(fit.model.standard_uncertainty[:9].reshape(3, 3) / true.matrix[0, 0])
    assert np.max(stated) < 1e-3  # the turns alone: 0.0028 along, 0.0087 across
    low, high = share_limits(9 * SESSIONS)
    assert low <= np.mean(np.abs(away) <= 1.96 * np.array(stated)) <= high


def test_an_angle_beyond_its_uncertainty_is_named_by_the_moves():
    rng = np.random.default_rng(17)
    fit = gyro_by_hand(plain(random_device(rng)), rng, angle_uncertainty_deg=0.05, axis_uncertainty_deg=0.02)
    assert "differ by" in only(fit.verdict.findings, "known_rotation.moves_disagree").sentence
    assert fit.verdict.status == "marginal"


def test_gyroscopes_alone_have_their_scale_from_three_turns():
    rng = np.random.default_rng(23)
    device = random_device(rng)
    session = simulate_session("ferraris", device, rng=rng)
    alone = replace(session, records=tuple(replace(record, accel=None) for record in session.records))
    made, true = calibrate(alone), true_calibration(device).gyro
    assert made.accel is None
    assert made.gyro.method == "known-rotation/affine"
    assert made.gyro.g_sensitivity is None
    sigma = made.gyro.standard_uncertainty
    away = np.concatenate(((made.gyro.matrix - true.matrix).ravel(), made.gyro.offset - true.offset))
    assert (np.abs(away) < 3.0 * sigma).all()
    assert (sigma[[0, 4, 8]] < 0.005 * np.diag(true.matrix)).all()  # 1 deg of 360 deg is 0.28 %
    unknown = only(made.verdict.findings, "session.not_observable")
    assert unknown.values["what"] == "g-sensitivity of the gyroscopes"


@pytest.mark.parametrize("about", ["x", "xz"])
def test_axes_without_a_turn_keep_their_prior(about):
    rng = np.random.default_rng(24)
    device = random_device(rng)
    session = simulate_session("ferraris", device, rng=rng)
    part = replace(session, turns=tuple(turn for turn in session.turns if turn.axis in about))
    made, true = calibrate(part), true_calibration(device).gyro
    assert made.gyro.method == "known-rotation/affine"
    lacking = only(made.verdict.findings, "rate_table.axes_missing")
    assert lacking.values["missing"] == tuple(axis for axis in "xyz" if axis not in about)
    sigma = made.gyro.standard_uncertainty
    away = np.concatenate(((made.gyro.matrix - true.matrix).ravel(), made.gyro.offset - true.offset))
    assert (np.abs(away) < 3.0 * sigma[:12]).all()
    share = sigma[[0, 4, 8]] / np.diag(true.matrix)
    known = np.array([axis in about for axis in "xyz"])
    assert (share[known] < 0.005).all()
    np.testing.assert_allclose(share[~known], 0.2 if made.gyro.unit_in == "count" else 0.03, rtol=0.1)


WRONG_ROWS = {
    "reversed turn": (made(angle=ANGLE * [1.0, -1.0, 1.0]), {}, Implausible, {"reversed": ("y",)}),
    "sample rate": (
        made(reading=made().reading / 16.4, unit="dps", duration=np.full(3, 8.0)), {}, Implausible, {"ratio": 2.0},
    ),
    "exchanged columns": (made(reading=made().reading[:, [1, 0, 2]]), {}, Implausible, {"order": "+y, +x, +z"}),
    "exchanged columns, signs of the turns changed": (
        made(reading=made().reading[:, [1, 0, 2]], angle=ANGLE * [-1.0, -1.0, 1.0]),
        {}, Implausible, {"order": "-y, -x, +z"},
    ),
    "missing faces": (
        part(made(), [0, 1, 2, 3, 6, 7, 8], [0, 1, 2]), {"mode": "paper"}, NotObservable, {"missing": ("+z", "-z")},
    ),
    "missing axis": (part(made(), [*range(8)], [0, 1]), {"mode": "paper"}, NotObservable, {"missing": ("z",)}),
}  # fmt: skip


@pytest.mark.parametrize(("rows", "settings", "error", "numbers"), WRONG_ROWS.values(), ids=WRONG_ROWS)
def test_rows_that_contradict_the_session_are_refused(rows, settings, error, numbers):
    with pytest.raises(error) as caught:
        fit_known_rotation(rows, gravity=G, **settings)
    for name, value in numbers.items():
        assert caught.value.numbers[name] == (pytest.approx(value, rel=0.05) if name == "ratio" else value)


def test_gaps_in_a_turn_are_refused():
    gyro = np.ones((40, 3))
    gyro[12] = np.nan
    record = Record(time=np.arange(40) / 10.0, gyro=gyro, accel=np.tile([0.0, 0.0, 9.81], (40, 1)))
    turn = Turn(start=10, stop=20, axis="z", angle=1.0)
    with pytest.raises(InputError, match="z has gaps"):
        rotation_rows([record], [Still(start=0, stop=10, face="+z")], [turn], matrix=np.eye(3), offset=np.zeros(3))
