"""What a rate table did: about which axis it turned the case, and at what rate."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.erring_bench import rate_table as rate_bench

from testkit.cramer_rao import white_device
from testkit.findings import codes, only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.dwells import Dwells, block_means, mountings, table_axes, table_term, uneven_rate
from undrift.calibration.observe import CalibrateSettings
from undrift.errors import InputError
from undrift.record import RateTable, Record, Still, Turn
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import unit_vector
from undrift.sim.sessions import simulate_session

# ---- the axis of a rate table as gravity shows it: exact without noise, and what stays unknown is stated

DEG = np.pi / 180.0
G = 9.80665
QUIET = BenchErrors(mount_tilt=0.5 * DEG, level=0.2 * DEG)


def turned(kind="rate_table", table=QUIET, seed=3, **settings):
    rng = np.random.default_rng(seed)
    device = white_device(rng).without_noise()
    bench = BenchSettings(
        sample_rate_hz=50.0,
        turn_rates=tuple(rate * DEG for rate in (20.0, 50.0, 90.0)),
        errors=table,
        lever_arm_b=(0.03, -0.02, 0.04),
        **settings,
    )
    return device, simulate_session(kind, device, rng=rng, settings=bench)


def dwells_of(session, device):
    record = session.records[0]
    parts = [record.gyro[t.start + 20 : t.stop].mean(axis=0) for t in session.turns]
    return Dwells(
        records=session.records,
        turns=session.turns,
        mounting=mountings(session.turns),
        reading=np.array(parts),
        up=np.ones(len(parts)),
        settle_s=0.3,
    )


def of_rates(found, dwells, *, alone=True):
    """Return the covariance of D of a fit that weighs all dwells alike, with or without errors of each dwell."""
    square = np.tile(dwells.turn_rate[:, None] ** 2, (1, 3))
    return sum(found.shares(dwells.own, square, alone=alone).values())


def true_accel(device):
    """Return the accelerometers as they are, with no uncertainty: a level table's six faces give them."""
    rng = np.random.default_rng(5)
    made = calibrate(simulate_session("six_face", device, rng=rng), settings=CalibrateSettings(identify_adc=False))
    assert made.accel is not None
    return made.accel


@pytest.mark.slow
def test_the_axis_is_found_through_a_table_off_level_and_an_arm_in_dwells_of_less_than_a_turn():
    device, session = turned()
    found = table_axes(
        dwells_of(session, device), RateTable(mount_tilt_deg=5.0, table_level_deg=0.2), true_accel(device), G
    )
    true = np.array([turn_axis(session, turn) for turn in session.turns])
    nominal = np.array([unit_vector(turn.axis) for turn in session.turns])
    assert np.abs(true - nominal).max() > 0.2 * DEG
    # What is left is of second order, 0.5 deg of mounting by 0.2 deg of level, and the prior of the arm.
    assert np.abs(found.axis_b - true).max() < 0.01 * DEG
    assert found.off.max() > 0.2 * DEG


def turn_axis(session, turn):
    """Return the axis about which the case turned, from the truth of the same seed: a noise-free gyroscope's reading."""
    device, _ = turned()
    record = session.records[0]
    reading = record.gyro[turn.start + 20 : turn.stop].mean(axis=0)
    rate = np.linalg.solve(device.gyro.forward_matrix, reading - device.gyro.raw_offset)
    return rate / np.linalg.norm(rate) * np.sign(turn.turn_rate)


def pieces_of(*words):
    """Return pieces one after the other: rests by their face, "?" in any pose; turns by axis, or axis and "by" an angle."""
    made = []
    for n, word in enumerate(words):
        span = {"start": 10 * n, "stop": 10 * n + 9}
        if word == "?" or word[0] in "+-":
            made.append(Still(face=None if word == "?" else word, **span))
        else:
            made.append(Turn(axis=word[0], **({"angle": 6.0} if "by" in word else {"turn_rate": 1.0}), **span))
    return made


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("-x +x x x ? +x", [-1, 0, 0, 0, -1, 0]),  # the rest before on the other face is a mounting of its own
        ("+x x +y y y +x x", [0, 0, 1, 1, 1, 2, 2]),
        ("+x x -x x", [0, 0, 1, 1]),
        ("+x -x +y", [-1, -1, -1]),  # six faces on a plate
        ("+x xby +x x", [-1, -1, 0, 0]),
        ("x y", [0, 1]),
    ],
)
def test_rests_and_turns_that_follow_each_other_with_one_axis_up_are_one_mounting(words, numbers):
    found = mountings(pieces_of(*words.split()))
    assert (found < 0).tolist() == [number < 0 for number in numbers]
    on = found >= 0
    alike = np.array(numbers)[:, None] == np.array(numbers)[None, :]
    np.testing.assert_array_equal((found[:, None] == found[None, :])[np.ix_(on, on)], alike[np.ix_(on, on)])


@pytest.mark.slow
def test_dwells_in_recordings_of_their_own_are_one_mounting_too():
    """A rig run writes a recording for each dwell: the azimuth is then known within each alone."""
    device, session = turned()
    dwells = dwells_of(session, device)
    record = session.records[0]
    turns = tuple(
        replace(turn, recording=n, start=0, stop=turn.stop - turn.start) for n, turn in enumerate(session.turns)
    )
    table = RateTable(mount_tilt_deg=0.5, table_level_deg=0.2)
    rng = np.random.default_rng(8)
    noisy = replace(
        record, accel=record.accel + 0.05 / true_accel(device).matrix[0, 0] * rng.standard_normal((len(record), 3))
    )
    dwells = replace(dwells, records=(noisy,))
    parts = tuple(noisy.part(turn.start, turn.stop) for turn in session.turns)
    apart = replace(dwells, records=parts, turns=turns, mounting=mountings(turns))
    lone = table_axes(apart, table, None, G)
    off = [place for place in range(9) if place % 4]
    np.testing.assert_allclose(np.sqrt(np.diag(of_rates(lone, apart, alone=False))[off]), 0.5 * DEG, rtol=1e-9)
    whole, found = (table_axes(one, table, true_accel(device), G) for one in (dwells, apart))
    true = np.array([turn_axis(session, turn) for turn in session.turns])
    error = np.abs(found.axis_b - true).max()
    sigma = np.sqrt(np.diag(of_rates(found, apart))[off]).max()
    # The level, 0.2 deg, is an unknown of each of six dwells; those of 20 deg/s turn by a sixth.
    assert error < 3.0 * sigma
    assert sigma < 0.2 * DEG
    assert sigma > 1.5 * np.sqrt(np.diag(of_rates(whole, dwells))[off]).max()


def test_each_recording_has_a_level_of_its_own_that_is_not_taken_for_wobble():
    device, session = turned(table=BenchErrors(mount_tilt=0.1 * DEG, level=0.2 * DEG))
    turns = tuple(
        replace(turn, recording=n, start=0, stop=turn.stop - turn.start) for n, turn in enumerate(session.turns)
    )
    parts = tuple(session.records[0].part(turn.start, turn.stop) for turn in session.turns)
    dwells = replace(dwells_of(session, device), records=parts, turns=turns, mounting=mountings(turns))
    found = table_axes(dwells, RateTable(table_level_deg=0.2, wobble_deg=0.01), true_accel(device), G)
    rates = (dwells.reading - device.gyro.raw_offset) @ np.linalg.inv(device.gyro.forward_matrix).T
    true = rates / np.linalg.norm(rates, axis=1)[:, None] * np.sign(dwells.turn_rate)[:, None]
    # Each starts at another azimuth. A level in common would leave up to 0.2 deg, and state it as wobble.
    assert np.abs(found.axis_b - true).max() < 0.01 * DEG
    assert np.sqrt(np.diag(found.spread)).reshape(-1, 3)[~np.eye(3, dtype=bool)[dwells.own]].max() < 0.03 * DEG


def test_each_dwell_has_the_axis_that_gravity_shows_where_the_table_wobbles():
    wobbling = BenchErrors(mount_tilt=0.1 * DEG, level=0.1 * DEG, wobble=0.1 * DEG)
    device, session = turned(table=wobbling)
    dwells = dwells_of(session, device)
    found = table_axes(dwells, RateTable(wobble_deg=0.01), true_accel(device), G)
    rates = (dwells.reading - device.gyro.raw_offset) @ np.linalg.inv(device.gyro.forward_matrix).T
    true = rates / np.linalg.norm(rates, axis=1)[:, None] * np.sign(dwells.turn_rate)[:, None]
    error, pairs = (
        found.axis_b - true,
        np.abs(dwells.turn_rate[::2]) > 40.0 * DEG,
    )  # 120 deg and more of a circle: it has a centre
    # Both ways round at one rate the arm errs alike, and so does the mounting: wobble alone is left
    apart, left = (one[::2][pairs] - one[1::2][pairs] for one in (true, error))
    assert np.sqrt((apart**2).sum(axis=1).mean()) > 0.1 * DEG
    # One axis a mounting would leave all of it; a fifth may stay
    assert np.sqrt((left**2).sum(axis=1).mean()) < 0.2 * np.sqrt((apart**2).sum(axis=1).mean())
    sigma = np.sqrt(np.diag(found.spread)).reshape(-1, 3)
    across = ~np.eye(3, dtype=bool)[dwells.own]
    # Thirty-six components of 18 dwells: 5 standard uncertainties, and second order of mounting, level and wobble
    assert np.all(np.abs(error)[across] < 5.0 * sigma[across] + 3.0 * (0.2 * DEG) ** 2)


def test_codes_of_an_accelerometer_are_an_error_that_all_dwells_of_a_mounting_share():
    device, session = turned(table=BenchErrors(), dwell_s=6.0)
    record = session.records[0]
    accel = true_accel(device)
    step = 0.1 / accel.matrix[0, 0]  # 0.1 m/s2, 10 bits of 5 g
    coarse = replace(record, accel=np.round(record.accel / step) * step)
    table = RateTable(mount_tilt_deg=5.0, table_level_deg=0.0, wobble_deg=0.0)
    dwells = dwells_of(session, device)
    found = [table_axes(replace(dwells, records=(one,)), table, accel, G) for one in (record, coarse)]
    off = [place for place in range(9) if place % 4]
    more = np.diag(of_rates(found[1], dwells) - of_rates(found[0], dwells))[off]
    assert np.all(more > 0.9 * 0.1**2 / 12.0 / G**2)  # the sensors' scales differ by some per cent
    every = np.diag(found[1].spread).reshape(-1, 3)
    across = np.arange(3) != dwells.own[:, None]
    assert np.all(found[1].apart[across] < 0.5 * every[across])  # what dwells share is none of what each has on its own


def test_rests_on_a_table_are_no_level_faces_where_a_plate_shows_all_six():
    device, session = turned("bench", BenchErrors(mount_tilt=0.5 * DEG), still_s=3.0)
    stated = CalibrateSettings(identify_adc=False, mount_tilt_deg=0.5)
    made = calibrate(session, settings=stated).accel
    assert made is not None
    away = made.matrix @ device.accel.forward_matrix - np.eye(3)
    # The plate is level. A rest on the table taken for a face of its own has a third of 0.5 deg in it.
    assert np.abs(away).max() < 0.02 * DEG


def test_without_accelerometers_the_mounting_stays_in_the_covariance_in_full():
    device, session = turned()
    dwells = dwells_of(session, device)
    found = table_axes(dwells, RateTable(mount_tilt_deg=0.3, rate_uncertainty=2e-4), None, G)
    np.testing.assert_array_equal(found.axis_b, [unit_vector(turn.axis) for turn in session.turns])
    off = [place for place in range(9) if place % 4]
    shared = of_rates(found, dwells, alone=False)
    np.testing.assert_allclose(np.sqrt(np.diag(shared)[off]), 0.3 * DEG, rtol=1e-9)
    assert np.isnan(found.off).all()
    np.testing.assert_allclose(shared[np.ix_([0, 4, 8], [0, 4, 8])], np.full((3, 3), 4e-8), rtol=1e-6)


def test_a_gap_in_the_gyroscope_leaves_a_block_unmeasured():
    device, session = turned()
    dwells = dwells_of(session, device)
    record = session.records[0]
    gyro = np.array(record.gyro)
    first = session.turns[0]
    gyro[first.stop + 3] = np.nan  # in the ramp, between two dwells about x
    gap = Record(time=record.time, gyro=gyro, accel=record.accel, gyro_unit="count", accel_unit="count")
    held = replace(dwells, records=(gap,))
    found = table_axes(held, RateTable(), true_accel(device), G)
    about_x = np.array([turn.axis == "x" for turn in session.turns])
    assert np.isnan(found.off[about_x]).all()
    assert np.isfinite(found.off[~about_x]).all()


def test_a_mounting_is_known_as_stated_where_the_accelerometers_know_it_worse():
    device, session = turned(table=BenchErrors())
    accel = true_accel(device)
    poor = replace(
        accel, covariance=np.diag([*np.full(9, (0.01 * accel.matrix[0, 0]) ** 2), 0.0, 0.0, 0.0]), budget=None
    )
    dwells = dwells_of(session, device)
    found = table_axes(dwells, RateTable(mount_tilt_deg=0.01, wobble_deg=0.0), poor, G)
    sigma = np.sqrt(np.diag(found.spread)).reshape(-1, 3)[~np.eye(3, dtype=bool)[dwells.own]]
    assert sigma.max() < 0.011 * DEG  # 1 % of the matrix is 0.6 deg


def test_a_mounting_far_off_the_stated_one_is_said_and_one_within_it_is_not_a_doubt():
    _, session = turned("bench", BenchErrors(mount_tilt=1.0 * DEG))
    stills = tuple(replace(still, face=still.face if n < 6 else None) for n, still in enumerate(session.stills))
    session = replace(session, stills=stills)  # the rests on the table lie askew: no faces for the accelerometers
    wide, narrow = (
        calibrate(session, settings=CalibrateSettings(identify_adc=False, mount_tilt_deg=tilt)) for tilt in (1.0, 0.05)
    )
    assert only(wide.verdict.findings, "rate_table.mounting").level == "info"
    assert only(narrow.verdict.findings, "rate_table.mounting").level == "warn"
    assert narrow.verdict.status != "good"


@pytest.mark.slow
@pytest.mark.parametrize("devices", [16, 100])
def test_a_mounting_three_times_the_stated_one_is_covered_where_tilted_faces_blur_gravity(devices):
    case, rng, ratio = rate_bench.CASES["mounted 0.3 deg off, faces by 0.2 deg"], np.random.default_rng(31), []
    for _ in range(devices):
        device, session, *_ = rate_bench.drawn(case, rng)
        gyro = calibrate(session, settings=case.settings).gyro
        off = gyro.matrix - np.linalg.inv(device.gyro.forward_matrix)
        ratio.append((off / gyro.standard_uncertainty[:9].reshape(3, 3))[~np.eye(3, dtype=bool)])
    inside = np.abs(ratio) <= 1.959964
    # Nine tenths and three standard errors; the half of all terms is independent. With the stated size alone half of them hold
    assert inside.mean() > 0.9 - 3.0 * (0.09 / (0.5 * inside.size)) ** 0.5


def test_two_axes_keep_the_mountings_uncertainty_too():
    _, session = turned()
    about = [turn for turn in session.turns if turn.axis != "z"]
    part = replace(session, turns=tuple(about), stills=())
    narrow, wide = (
        calibrate(part, gyro="rate-table", settings=CalibrateSettings(mount_tilt_deg=tilt)).gyro for tilt in (0.0, 1.0)
    )
    sigma = wide.standard_uncertainty / wide.matrix[0, 0]
    assert sigma[1] == pytest.approx(1.0 * DEG, rel=0.1)  # of m_xy
    assert narrow.standard_uncertainty[1] < 0.1 * wide.standard_uncertainty[1]


@pytest.mark.parametrize("name", ["table_level_deg", "mount_tilt_deg", "rate_uncertainty", "wobble_deg"])
def test_what_no_table_can_be_is_refused(name):
    with pytest.raises(InputError, match=f"rate table: wanted {name} from 0 to"):
        CalibrateSettings(**{name: -0.1})
    with pytest.raises(InputError, match="got nan"):
        RateTable(**{name: float("nan")})


def test_settings_overrule_the_session():
    held = CalibrateSettings(wobble_deg=0.3).rate_table(RateTable(mount_tilt_deg=0.7))
    assert held == RateTable(mount_tilt_deg=0.7, wobble_deg=0.3)
    assert "rate_table.mounting" in codes(
        calibrate(turned("bench")[1], settings=CalibrateSettings(identify_adc=False)).verdict.findings
    )


def test_what_multiplies_every_rate_multiplies_the_matrix_from_the_left():
    rng = np.random.default_rng(2)
    matrix, D = rng.normal(size=(2, 3, 3))
    model = replace(true_accel(turned()[0]), matrix=matrix)
    made = (D @ matrix).ravel()
    term = table_term(model, np.outer(D.ravel(), D.ravel()))
    np.testing.assert_allclose(term[:9, :9], np.outer(made, made), rtol=1e-12)


# ---- uneven rates of a table: ripple and settling are found within the dwells, and the mean rates follow

NOISE = 1e-4  # rad/s, of a sample at 100 Hz: a hundredth of a deg/s in a block of 0.5 s would be 1.7e-4


def rippled(theta, terms, *, noise=0.0, seed=1, n=600):
    """Return dwells about x, y, z that turn both ways by theta and half of it (rad) in 6 s, and their mean rates over the stated.

    ``terms`` is r(psi, t), relative; psi runs on from dwell to dwell.
    """
    time, rng = np.arange(n) / 100.0, np.random.default_rng(seed)
    pieces, turns, ratio = [], [], []
    for k, axis in enumerate("xyz"):
        for stated in (theta / 6.0, -theta / 6.0, theta / 12.0, -theta / 12.0):
            r = terms((0.0 if stated > 0.0 else 6.0 * abs(stated)) + stated * time, time)
            gyro = noise * rng.standard_normal((n, 3))
            gyro[:, k] += stated * (1.0 + r)
            turns.append(Turn(start=len(pieces) * n, stop=(len(pieces) + 1) * n, axis=axis, turn_rate=stated))
            pieces.append(gyro)
            ratio.append(r.mean())
    record = Record(time=np.arange(n * 12) / 100.0, gyro=np.vstack(pieces))
    reading = np.array([piece.mean(axis=0) for piece in pieces])
    dwells = Dwells(
        records=(record,), turns=turns, mounting=np.repeat([0, 1, 2], 4), reading=reading, up=np.ones(12), settle_s=0.0
    )
    return dwells, np.array(ratio)


@pytest.mark.parametrize("harmonic", [1, 2])
def test_a_ripple_once_or_twice_a_turn_gives_the_mean_rate_of_every_dwell(harmonic):
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + harmonic * psi), noise=NOISE)
    found = uneven_rate(dwells)
    assert np.abs(true).max() > 0.0005
    sigma = np.sqrt(np.diag(found.covariance))
    # 4 standard uncertainties, and the second order of 0.4 %: the angle that the gyroscope shows ripples too.
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.004**2)
    assert sigma.max() < 0.2 * np.abs(true).max()
    assert found.size[harmonic - 1] > 0.0
    assert found.size[2 - harmonic] == 0.0


@pytest.mark.parametrize("settle_s", [0.2, 0.45, 1.0])
def test_a_rate_that_settles_late_is_a_sum_of_time_constants_within_its_uncertainty(settle_s):
    dwells, true = rippled(4.0 * np.pi, lambda _, time: 0.003 * np.exp(-time / settle_s), noise=NOISE)
    found = uneven_rate(dwells)
    sigma = np.sqrt(np.diag(found.covariance))
    # Sums of half octaves miss a time constant near the longest by 1 % of the mean
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.01 * np.abs(true))
    assert np.all(sigma < 0.5 * np.abs(true))
    assert found.size[2] > 0.0


@pytest.mark.slow
def test_an_even_rate_is_left_as_it_is():
    rng = range(20)
    shown = [uneven_rate(rippled(4.0, lambda psi, _: 0.0 * psi, noise=NOISE, seed=n)[0]) for n in rng]
    # Each of three groups appears by chance once in a thousand: two of twenty sessions once in 600.
    assert sum(bool(one.size.any()) for one in shown) <= 1
    assert sum(bool(one.ratio.any()) for one in shown) <= 1


def test_a_ripple_has_a_phase_of_its_own_in_each_dwell_where_a_gap_hides_the_angle():
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + psi), noise=NOISE)
    record = dwells.records[0]
    n = len(record.time) // 12
    keep = np.ones(len(record.time), bool)
    gyro = np.array(record.gyro)
    turns = [replace(turn, start=turn.start + 5) for turn in dwells.turns]
    gyro[np.arange(12) * n] = np.nan  # before every dwell
    gap = replace(dwells, records=(Record(time=record.time[keep], gyro=gyro),), turns=turns)
    found, whole = uneven_rate(gap), uneven_rate(dwells)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.01 * np.abs(true).max())
    assert sigma.mean() > np.sqrt(np.diag(whole.covariance)).mean()


def test_measured_mean_rates_hold_the_ripple_already():
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + psi), noise=NOISE)
    turns = [replace(turn, turn_rate=turn.turn_rate * (1.0 + r)) for turn, r in zip(dwells.turns, true, strict=True)]
    found = uneven_rate(replace(dwells, turns=turns))
    np.testing.assert_array_equal(found.ratio, 0.0)
    np.testing.assert_array_equal(found.size, 0.0)


def test_a_rate_that_jumps_about_leaves_white_noise_in_every_mean():
    rng = np.random.default_rng(3)
    dwells, _ = rippled(4.0 * np.pi, lambda _, time: 0.003 * np.repeat(rng.standard_normal(12), 50), noise=NOISE)
    sigma = np.sqrt(np.diag(uneven_rate(dwells).covariance))
    # 0.003 of each of 12 blocks: 0.003 / sqrt(12) of the mean; all dwells of a sensor have one variance, that of 0.003 times
    # sqrt((1 + 1 / 4) / 2) of the larger rate, and 44 squares know it within a third
    assert sigma[::4] == pytest.approx(0.003 * (5.0 / 8.0) ** 0.5 / 12.0**0.5, rel=0.33)


def test_dwells_that_are_too_short_to_show_gravity_are_calibrated_by_their_rates() -> None:
    device, session = turned(dwell_s=0.5)
    dwells = dwells_of(session, device)
    felt = table_axes(dwells, RateTable(), true_accel(device), G)
    assert np.isnan(felt.off).all()  # gravity is not seen: the axes are those stated, as well as a table is mounted
    np.testing.assert_array_equal(felt.axis_b, np.eye(3)[dwells.own])
    assert block_means(np.ones((30, 4)), 50).shape == (0, 4)
