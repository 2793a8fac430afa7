"""Rate table: the note's equations and grid, the affine fit, one axis, linearity, Earth rate."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.plausibility import axis_vectors, nearest_signed_permutation
from undrift.calibration.rate_table import check_dwells, fit_rate_table
from undrift.calibration.table import DwellMeans, dwell_means, imposed_rates, spline_filter
from undrift.errors import Implausible, InputError, NotObservable
from undrift.programme import rate_grid
from undrift.record import Record, Turn
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session
from undrift.units import EARTH_RATE, STANDARD_GRAVITY

DPS = np.pi / 180.0
K = np.array([[940.0, 9.0, -5.0], [4.0, 950.0, 12.0], [-6.0, 8.0, 930.0]])  # counts per rad/s
B = np.array([12.0, -30.0, 7.0])
GRID = rate_grid(5.0, 90.0, 5.0, rule="paper") * DPS


def dwells(offset=B, grid=GRID, noise=0.05, k=K):
    axis = tuple(a for a in ("x", "y", "z") for _ in grid)
    rate = np.tile(grid, 3)
    reading = (axis_vectors(axis) * rate[:, None]) @ k.T + offset
    return DwellMeans(reading=reading, turn_rate=rate, axis=axis, noise=np.full((len(axis), 3), noise), unit="count")


def test_offset_is_not_taken_from_the_one_code_that_dwells_share():
    # two of three dwells read a sensor at its offset, so at one code, with one rounding error; those at other rates have their own
    step, rng = 0.7, np.random.default_rng(0)
    codes = np.full(3, step**2 / 12.0)
    error, stated = [], []
    for _ in range(40):
        true = B + rng.uniform(-0.5, 0.5, 3) * step
        means = dwells(offset=true, noise=1e-3, k=np.diag([941.0, 953.0, 929.0]))
        coarse = replace(
            means,
            reading=np.round(means.reading / step) * step,
            step=np.full(3, step),
            codes=codes,
            noise=np.hypot(means.noise, np.sqrt(codes)),
        )
        model = fit_rate_table(coarse).model
        error.append(model.offset - true)
        stated.append(model.standard_uncertainty[9:12])
    assert np.sqrt(np.mean(np.square(error))) < 0.1 * np.sqrt(codes[0])
    assert np.mean(np.abs(error) < 1.96 * np.array(stated)) > 0.93


def test_cross_axis_terms_below_a_step_of_the_codes_are_inside_their_uncertainty():
    # over all rates a cross-axis term of 0.05 to 0.2 % changes a reading by 0.7 to 3 of its steps
    step, rng = 2.0, np.random.default_rng(1)
    codes, across = np.full(3, step**2 / 12.0), ~np.eye(3, dtype=bool)
    z = []
    for _ in range(40):
        forward = np.diag([941.0, 953.0, 929.0]) + rng.uniform(0.5, 2.0, (3, 3)) * across
        made = dwells(offset=B + rng.uniform(-0.5, 0.5, 3) * step, noise=1e-3, k=forward)
        noise = np.hypot(made.noise, np.sqrt(codes))
        rounded = np.round(made.reading / step) * step
        model = fit_rate_table(replace(made, reading=rounded, step=np.full(3, step), codes=codes, noise=noise)).model
        error = (model.matrix - np.linalg.inv(forward)).ravel() / model.standard_uncertainty[:9]
        z.append(error[across.ravel()])
    assert np.mean(np.abs(z) < 1.96) > 0.9


def test_rests_on_all_faces_share_a_rounding_error_without_g_sensitivity():
    # the prior of the g-sensitivity would put the faces steps apart, each with an error of its own
    step, rng = 1.0, np.random.default_rng(2)
    codes, faces = np.full(3, step**2 / 12.0), STANDARD_GRAVITY * np.vstack((np.eye(3), -np.eye(3)))
    z = []
    for _ in range(40):
        true = B + rng.uniform(-0.5, 0.5, 3)
        made = dwells(offset=true, noise=np.sqrt(codes[0]))
        still = np.tile(true, (len(faces), 1))
        force = np.vstack((STANDARD_GRAVITY * made.axis_b, faces))
        means = made.with_rests(still, noise=np.full(still.shape, codes[0] ** 0.5), span=np.zeros((6, 2)), force=force)
        reading = np.round(means.reading / step) * step
        model = fit_rate_table(replace(means, reading=reading, step=np.full(3, step), codes=codes, span=None)).model
        z.append((model.offset - true) / model.standard_uncertainty[9:12])
    assert np.mean(np.abs(z) < 1.96) > 0.9


def test_mode_paper_is_equation_six_to_the_last_digit():
    means = dwells(offset=np.zeros(3))
    fit = fit_rate_table(means, mode="paper")
    L, S = imposed_rates(means, None).T, means.reading.T
    assert L.shape == (3, 102)
    np.testing.assert_allclose(fit.model.matrix, L @ S.T @ np.linalg.inv(S @ S.T), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(fit.model.forward_matrix, K, rtol=1e-11, atol=1e-9)
    assert fit.verdict.reasons == ()


def test_earth_rate_is_added_to_the_axis_that_points_up():
    means = dwells()
    rates = imposed_rates(means, 42.0)
    up = rates - imposed_rates(means, None)
    vertical = EARTH_RATE * np.sin(np.radians(42.0))
    np.testing.assert_allclose(up, axis_vectors(means.axis) * vertical)
    assert vertical / DPS == pytest.approx(0.0028, abs=5e-5)
    down = imposed_rates(replace(means, up=np.full(102, -1.0)), 42.0) - imposed_rates(means, None)
    np.testing.assert_allclose(down, -axis_vectors(means.axis) * vertical)
    earthly = replace(means, reading=means.reading + axis_vectors(means.axis) @ K.T * vertical)
    with_earth = fit_rate_table(earthly, latitude_deg=42.0).model
    np.testing.assert_allclose(with_earth.offset, B, rtol=1e-10)


def test_dwells_count_by_their_noise():
    made = dwells()
    noise = np.where(np.arange(len(made.axis)) % 2, 0.05, 5.0)[:, None] * np.ones(3)
    reading = made.reading + noise * np.random.default_rng(11).standard_normal(noise.shape)
    model = fit_rate_table(replace(made, reading=reading, noise=noise)).model
    sigma = 0.05 / np.sqrt(51.0)  # half of the dwells determine the offset, as if the others were not there
    np.testing.assert_allclose(model.standard_uncertainty[9:12], sigma, rtol=0.1)
    np.testing.assert_allclose(model.offset, B, atol=4.0 * sigma)


def about(axis, **changes):
    """Dwells about one axis of the table."""
    means = dwells()
    rows = [k for k, a in enumerate(means.axis) if a == axis]
    own = {
        "reading": means.reading[rows],
        "turn_rate": means.turn_rate[rows],
        "axis": (axis,) * len(rows),
        "noise": None,
    }
    return replace(means, **(own | changes))


def record(noise=1e-5, seconds=3.0, settle=True):
    rng = np.random.default_rng(8)
    n = int(100 * seconds)
    pieces = []
    for sign in (1.0, -1.0):
        rate = np.full(n, sign * 0.5)
        if settle:
            rate *= 1.0 - np.exp(-np.arange(n) / 5.0)  # a slow filter: 0.3 s are 6 time constants
        pieces.append(rate)
    z = np.concatenate(pieces)
    gyro = np.column_stack((0.0 * z, 0.0 * z, z)) + noise * rng.standard_normal((2 * n, 3))
    turns = [Turn(start=k * n, stop=(k + 1) * n, axis="z", turn_rate=0.5 * s) for k, s in enumerate((1.0, -1.0))]
    return Record(time=np.arange(2 * n) / 100.0, gyro=gyro), turns


def test_the_settling_start_of_a_dwell_is_thrown_away():
    result, turns = record()
    means = dwell_means([result], turns)
    # exp(-30/5) = 0.25 % at the cut, averaged over 2.7 s: 0.005 %
    np.testing.assert_allclose(means.reading[:, 2], [0.5, -0.5], rtol=1e-4)
    spoilt = dwell_means([result], turns, settle_s=0.0)
    assert abs(spoilt.reading[0, 2] - 0.5) > 0.005


def test_spline_filter_keeps_the_mean():
    rng = np.random.default_rng(9)
    time = np.arange(600) / 100.0
    values = np.sin(2 * np.pi * 0.5 * time)[:, None] + 0.1 * rng.standard_normal((600, 3))
    smooth = spline_filter(time, values, 5.0)
    np.testing.assert_allclose(smooth.mean(axis=0), values.mean(axis=0), atol=1e-10)
    error = smooth - np.sin(2 * np.pi * 0.5 * time)[:, None]
    assert error.std() < 0.05
    tone = np.sin(2 * np.pi * 5.0 * time)[:, None] * np.ones(3)
    inner = spline_filter(time, tone, 5.0)[100:500]
    assert np.abs(inner).max() == pytest.approx(0.5, abs=0.02)  # halved at the cut-off, as stated


def test_the_noise_of_a_dwell_comes_from_its_own_readings():
    result, turns = record(noise=0.02, seconds=30.0)
    means = dwell_means([result], turns)
    # 116 spare blocks tell a standard deviation to 7 %
    np.testing.assert_allclose(means.noise, 0.02 / np.sqrt(2970.0), rtol=0.25)
    assert means.up.tolist() == [1.0, 1.0]


def test_the_accelerometer_tells_which_way_the_axis_points():
    result, turns = record(settle=False)
    down = Record(time=result.time, gyro=result.gyro, accel=np.tile([0.0, 0.1, -9.8], (len(result), 1)))
    assert dwell_means([down], turns).up.tolist() == [-1.0, -1.0]
    side = Record(time=result.time, gyro=result.gyro, accel=np.tile([9.8, 0.1, 0.0], (len(result), 1)))
    assert dwell_means([side], turns).up.tolist() == [0.0, 0.0]


def test_dwells_that_cannot_be_averaged_are_refused():
    result, turns = record()
    with pytest.raises(InputError, match="got 5"):
        dwell_means([result], [Turn(start=0, stop=10, axis="z", turn_rate=0.5)])
    gappy = np.array(result.gyro)
    gappy[200] = np.nan
    with pytest.raises(InputError, match=r"have gaps \(1\)"):
        dwell_means([Record(time=result.time, gyro=gappy)], turns)


def test_range_of_a_fit_is_what_its_dwells_reached():
    fit = fit_rate_table(dwells(grid=np.array([-90.0, -5.0, 5.0, 30.0]) * DPS))
    np.testing.assert_allclose(fit.model.valid_range, (-90.0 * DPS, 30.0 * DPS), rtol=1e-15)


def test_dwells_of_a_later_recording_come_later():
    result, turns = record()
    means = dwell_means([result, result], [turns[0], replace(turns[1], recording=1)])
    # recordings of 6 s; dwells of 3 s, the first of the one and the second of the other; a step of 0.01 s either way
    np.testing.assert_allclose(means.span.mean(axis=1), [1.5, 6.0 + 4.5], atol=0.02)


# ---- turns about one or two axes: what they show is a finding, and what they contradict is refused

AXIS_RATES = np.array([-300.0, -100.0, 100.0, 300.0])


def spans(count):
    """Return pieces of 1 s that follow each other."""
    return np.arange(count)[:, None] + np.array([0.0, 1.0])


def turned(gain=1.0, axis="y", unit="dps", column=None):
    """Four dwells about one axis, read by one column."""
    reading = np.zeros((4, 3))
    reading[:, "xyz".index(column or axis)] = gain * AXIS_RATES
    return DwellMeans(
        reading=reading + 0.3, turn_rate=AXIS_RATES * DPS, axis=(axis,) * 4, unit=unit, span=spans(4), noise=None
    )


def test_axes_that_were_not_turned_keep_their_prior():
    rng = np.random.default_rng(5)
    one = turned(1.02)
    one = replace(one, reading=one.reading + 0.01 * rng.normal(size=(4, 3)), noise=np.full((4, 3), 0.01))
    fit = fit_rate_table(one, cross_axis_prior=0.02)
    share = fit.model.standard_uncertainty[:9].reshape(3, 3) @ np.abs(fit.model.forward_matrix)
    np.testing.assert_allclose(fit.model.scale_factor * DPS, [1.0, 1.02, 1.0], atol=2e-4)  # 4 dwells, 0.01 of 300 deg/s
    np.testing.assert_allclose(fit.model.offset, 0.3, atol=0.03)  # 0.01 deg/s, four dwells, 3 sigma and more
    assert share[1, 1] < 1e-3
    np.testing.assert_allclose(np.diag(share)[[0, 2]], 0.03, rtol=0.05)
    cross = fit.model.standard_uncertainty[:9].reshape(3, 3)[[0, 2], [2, 0]] / DPS
    np.testing.assert_allclose(cross, 0.02, rtol=0.05)
    assert "prior" in fit.model.budget.sources


def test_counts_take_the_scale_of_the_turned_axes():
    fit = fit_rate_table(turned(16.4, unit="count"))
    np.testing.assert_allclose(fit.model.scale_factor, 16.4 / DPS, rtol=1e-8)
    share = fit.model.standard_uncertainty[:9].reshape(3, 3)[0, 0] * 16.4 / DPS
    assert share == pytest.approx(0.2, rel=0.01)


# ---- one dwell with a rate that is not its own: named before the fit, or a walk of the offset, bends to it

SOUND_RATES = np.array([-90.0, -45.0, 45.0, 90.0]) * DPS
SOUND_K = np.array([[900.0, 12.0, -9.0], [-11.0, 910.0, 7.0], [8.0, -6.0, 895.0]])
SOUND_B = np.array([20.0, 95.0, 70.0])
FELT = np.array([[0.3, -0.2, 0.1], [0.2, 0.25, -0.3], [-0.1, 0.3, 0.2]])  # count per m/s2: 0.2 (deg/s)/g


def table(noise=0.5, seed=0, curve=0.0):
    """Twelve dwells and six rests of gyroscopes that feel gravity."""
    rng = np.random.default_rng(seed)
    axis = tuple(a for a in "xyz" for _ in SOUND_RATES)
    rate = np.tile(SOUND_RATES, 3)
    up = 9.81 * np.eye(3)[["xyz".index(a) for a in axis]]
    w = np.eye(3)[["xyz".index(a) for a in axis]] * rate[:, None]
    w = w + curve * w * np.abs(w)
    faces = 9.81 * np.vstack((np.eye(3), -np.eye(3)))
    reading = w @ SOUND_K.T + up @ FELT.T + SOUND_B + noise * rng.normal(size=(12, 3))
    rests = {
        "reading": faces @ FELT.T + SOUND_B + noise * rng.normal(size=(6, 3)),
        "force": np.vstack((up, faces)),
        "noise": np.full((6, 3), max(noise, 1e-6)),
        "span": 8.0 * spans(6) - 4.0,
    }
    dwells = DwellMeans(
        reading=reading,
        turn_rate=rate,
        axis=axis,
        noise=np.full((12, 3), max(noise, 1e-6)),
        up=np.ones(12),
        unit="count",
        span=46.0 + 4.0 * spans(12),
    )
    return dwells, rests


def stated(dwells, k, rate_dps):
    wrong = dwells.turn_rate.copy()
    wrong[k] = rate_dps * DPS
    return replace(dwells, turn_rate=wrong)


def checked(dwells, rests, numbers=None):
    numbers = numbers or range(1, len(dwells.axis) + 1)
    dwells = dwells if rests is None else dwells.with_rests(**rests)
    check_dwells(dwells, imposed_rates(dwells, None), numbers)


@pytest.mark.slow
def test_sound_tables_pass():
    for seed in range(40):
        checked(*table(seed=seed))
        checked(*table(noise=5.0, seed=seed))  # 0.3 deg/s
    checked(*table(noise=0.0))
    checked(*table(curve=0.003))  # 0.5 % of full scale at the ends


def test_table_that_drifts_or_scatters_is_not_good():
    dwells, rests = table(noise=0.05)
    assert fit_rate_table(dwells.with_rests(**rests)).verdict.status == "good"
    wrong = stated(dwells, 5, 45.0)  # as if nobody had looked for it
    fit = fit_rate_table(wrong.with_rests(**rests))
    assert np.array_equal(nearest_signed_permutation(fit.model.forward_matrix), np.eye(3))
    assert fit.verdict.status == "bad"
    uncertain = only(fit.verdict.findings, "session.uncertain")
    assert uncertain.values["size"] > 0.5
    drifting = replace(
        dwells, reading=dwells.reading + 0.4 * (dwells.span.mean(axis=1) - 70.0)[:, None]
    )  # 1.5 deg/s in a minute
    walk = fit_rate_table(drifting)
    assert walk.verdict.status == "marginal"
    drift = only(walk.verdict.findings, "session.offset_drift")
    assert drift.level == "warn"
    assert drift.values["dps_per_minute"] > 0.1


@pytest.mark.parametrize(
    ("dwells", "settings", "error", "numbers"),
    [
        (about("y"), {"mode": "paper"}, NotObservable, {}),
        (replace(about("y"), reading=B[None], turn_rate=GRID[:1], axis=("y",)), {}, NotObservable, {}),
        (dwells(k=K @ np.diag([1.0, 1.0, -1.0])), {}, Implausible, {"order": "+x, +y, -z"}),
        (replace(dwells(k=np.eye(3) * 0.5 / DPS), unit="dps"), {}, Implausible, {"ratio": pytest.approx(0.5)}),
        (turned(-1.0), {}, Implausible, {"reads": "-y"}),
        (turned(column="z"), {}, Implausible, {"reads": "+z"}),
        (turned(0.7), {}, Implausible, {"ratio": pytest.approx(0.7, abs=1e-4)}),
    ],
)
def test_dwells_that_show_no_gyroscope_are_refused(dwells, settings, error, numbers):
    with pytest.raises(error) as caught:
        fit_rate_table(dwells, **settings)
    assert numbers.items() <= caught.value.numbers.items()


AXIS_Z = (*table()[0].axis[:5], "z", *table()[0].axis[6:])


@pytest.mark.parametrize(
    ("change", "turns"),
    [
        ({5: 45.0}, (6,)),  # other sign
        ({5: 0.0}, (6,)),
        ({5: -47.5}, (6,)),
        ({1: 45.0, 5: 45.0, 10: -45.0}, (2, 6, 11)),
        ({}, (6,)),  # another axis
    ],
)
@pytest.mark.parametrize("rested", [True, False])
def test_dwell_with_a_false_statement_is_refused_by_number(change, turns, rested):
    dwells, rests = table()
    for number, rate_dps in change.items():
        dwells = stated(dwells, number, rate_dps)
    dwells = dwells if change else replace(dwells, axis=AXIS_Z)
    with pytest.raises(Implausible) as caught:
        checked(dwells, rests if rested else None, numbers=range(21, 33))
    assert caught.value.turns == tuple(turn + 20 for turn in turns)


@pytest.mark.parametrize(("dwell_s", "named"), [(6.0, False), (3.0, True)])
def test_fast_dwells_shorter_than_a_turn_are_named(dwell_s, named):
    rng = np.random.default_rng(3)
    settings = BenchSettings(turn_rates=(30.0 * DPS, 90.0 * DPS), dwell_s=dwell_s)
    calibration = calibrate(simulate_session("bench", random_device(rng), rng=rng, settings=settings))
    assert ("rate_table.partial_turns" in [item.code for item in calibration.verdict.findings]) == named
