"""Learning in use: simulated days, made rests, and the given logs cut into days."""

import gzip
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.pictures import cut_texts
from testkit.plain_triad import plain_triad
from undrift.correction.correct import DriftRangeWarning, correct
from undrift.drift.fit import fit_drift
from undrift.drift.learn import LearnSettings, learn_drift
from undrift.errors import InputError, NotObservable
from undrift.io.store import read_calibration, write_calibration
from undrift.model import Calibration, DriftTables, ScaleDrift, StaticDrift
from undrift.record import Record, Session, Still
from undrift.report.drift import draw_learnt
from undrift.sim.daily_use import DailyUseSettings, draw_day, simulate_daily_use
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import RampSettings, ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY

START = datetime(2026, 1, 1, tzinfo=UTC)
USE = DailyUseSettings(days=8, rest_s=20.0, worn_s=30.0, sample_rate_hz=12.5)


def on_days(days):
    return [START + timedelta(days=day) for day in days]


def uncertain(calibration, dps):
    """Return a calibration whose constant offset is uncertain by so many deg/s."""
    model = calibration.gyro
    covariance = np.array(model.covariance)
    covariance[9:12, 9:12] = np.eye(3) * (dps * DPS * model.scale_factor) ** 2
    made = replace(calibration, gyro=replace(model, covariance=covariance))
    return replace(made, provenance=replace(made.provenance, created=START.isoformat()))


@pytest.fixture(scope="module")
def used():
    """Return a device with a steep offset, its calibration, and eight days of use."""
    rng = np.random.default_rng(5)
    device = random_device_of("mpu6050", rng)
    gyro = replace(
        device.gyro, offset=replace(device.gyro.offset, per_k=np.array([[0.03, -0.02, 0.01], [5e-4, 0.0, -5e-4]]) * DPS)
    )
    device = replace(device, gyro=gyro, thermometer=replace(device.thermometer, trim_error_c=0.0))
    pool = [draw_day(rng, USE) for _ in range(2)]
    days = list(simulate_daily_use(device, rng=rng, settings=USE, motions=pool))
    return device, uncertain(true_calibration(device), 0.03), days


@pytest.fixture(scope="module")
def learnt(used):
    _, calibration, days = used
    return learn_drift([day.session for day in days], calibration, dates=on_days(range(8)))


@pytest.mark.slow
def test_eight_days_of_use_show_the_offset_over_temperature_without_a_chamber(used, learnt):
    device, calibration, days = used
    near = ~learnt.extrapolated
    true = [true_calibration(device, temp_c=t).gyro.offset / calibration.gyro.scale_factor for t in learnt.temp_c[near]]
    off = (learnt.after[near] - np.array(true) - days[-1].aged) / DPS
    before = (learnt.before[near] - np.array(true) - days[-1].aged) / DPS
    show("rms error before, deg/s", np.sqrt((before**2).mean(axis=0)))
    show("after", np.sqrt((off**2).mean(axis=0)), 0.04)
    assert np.sqrt((off**2).mean()) < 0.04  # a switch-on moves by 0.03, eight of them by 0.011
    assert np.sqrt((off**2).mean()) < 0.3 * np.sqrt((before**2).mean())
    assert (
        np.abs(off) < 4.0 * learnt.curve_uncertainty[near] / DPS
    ).all()  # eight switch-ons: Student's factor at 0.5 %
    assert learnt.verdict.status == "good"
    assert {"drift.learn_rests", "drift.learn_changed", "drift.learn_turn_on", "drift.learn_no_table"} <= {
        item.code for item in learnt.verdict.findings
    }


def test_turn_on_repeatability_is_found_and_stated(learnt):
    show("turn-on, deg/s", learnt.turn_on / DPS, "drawn with 0.03")
    assert (np.abs(learnt.turn_on / DPS - 0.03) < 0.02).all()
    assert (learnt.turn_on_uncertainty / DPS < 0.015).all()  # the prior alone states 0.023
    assert (learnt.after_uncertainty > learnt.curve_uncertainty).all()


def test_rests_do_not_average_the_half_width_of_a_loop_away(used):
    _, calibration, days = used
    gyro, nodes, half = calibration.gyro, np.arange(0.0, 61.0), 0.08 * DPS
    raw = np.abs(gyro.scale_factor)
    stated = np.tile(np.hypot(0.03 * DPS, half) * raw, (len(nodes), 1))
    table = StaticDrift(temp_c=nodes, gyro_offset=np.tile(gyro.offset, (len(nodes), 1)), gyro_uncertainty=stated)
    after = {}
    for name, loop in (("unknown", None), ("known", half * raw)):
        held = replace(calibration, drift=DriftTables(static=replace(table, gyro_hysteresis=loop)))
        fit = learn_drift([day.session for day in days], held, dates=on_days(range(8)))
        to_come = np.sqrt(
            fit.after_uncertainty**2 - fit.curve_uncertainty**2
        )  # beside what the rests show of the curve
        after[name] = to_come[~fit.extrapolated].min()
    assert after["known"] > np.hypot(half, after["unknown"])
    assert after["unknown"] < half


def test_rests_on_a_body_are_among_them(used, learnt):
    rests = next(item for item in learnt.verdict.findings if item.code == "drift.learn_rests").values
    assert rests["worn"] >= 4
    assert rests["rests"] > rests["worn"]
    assert learnt.rest_kept.all()


@pytest.mark.slow
def test_day_by_day_and_all_at_once_give_the_same(used, learnt):
    _, calibration, days = used
    for part in ([5, 1], [0, 7, 2], [3], [6, 4]):
        calibration = learn_drift([days[k].session for k in part], calibration, dates=on_days(part)).calibration
    one, other = calibration.drift.static, learnt.calibration.drift.static
    np.testing.assert_array_equal(one.gyro_offset, other.gyro_offset)
    np.testing.assert_array_equal(one.gyro_uncertainty, other.gyro_uncertainty)
    assert calibration.drift.learnt.recordings == learnt.calibration.drift.learnt.recordings


def test_rests_in_moving_temperature_state_what_a_lag_would_do(used, learnt):
    lag = next(item for item in learnt.verdict.findings if item.code == "drift.learn_lag").values
    records = [day.session.records[0] for day in used[2]]
    ramps = [np.abs(np.diff(r.temp_c[::125])) * 6.0 for r in records]  # of ten seconds, degC/min
    assert 0.3 * np.mean(np.concatenate(ramps)) < lag["ramp_c_per_min"] < 3.0 * np.mean(np.concatenate(ramps))
    assert lag["shift_c"] == pytest.approx(lag["ramp_c_per_min"] / 6.0)
    model = used[1]
    known = replace(model, drift=DriftTables(lag_s=5.0, lag_smooth_s=1.0))
    fit = learn_drift([used[2][0].session], known, dates=on_days([0]))
    assert "drift.learn_lag" not in {item.code for item in fit.verdict.findings}
    assert fit.calibration.drift.lag_s == 5.0


def test_a_recording_counts_once(used, learnt):
    days = used[2]
    again = learn_drift([days[3].session], learnt.calibration, dates=on_days([30]))
    np.testing.assert_array_equal(again.after, learnt.after)
    repeated = next(item for item in again.verdict.findings if item.code == "drift.learn_repeated")
    assert repeated.values["count"] == 1
    assert again.recordings == 8


def test_findings_of_earlier_learning_do_not_pile_up(used, learnt):
    days = used[2]
    again = learn_drift([days[3].session], learnt.calibration, dates=on_days([30])).calibration
    assert sum(item.code == "drift.learn_changed" for item in again.verdict.findings) == 1


def test_a_calibration_that_is_younger_than_the_recordings_ages_from_the_first():
    rng = np.random.default_rng(3)
    sessions = [made_day(rng, np.zeros(3), np.zeros(3), 0.004 * day, 25.0) for day in range(0, 100, 10)]
    model = nominal(np.zeros(3), 0.01)
    fits = [
        learn_drift(
            sessions,
            replace(model, provenance=replace(model.provenance, created=created)),
            dates=on_days(range(0, 100, 10)),
        )
        for created in ("2026-01-01T00:00:00+00:00", "2030-01-01T00:00:00+00:00")
    ]
    np.testing.assert_array_equal(fits[0].after, fits[1].after)


def test_new_tables_of_a_thermal_session_leave_nothing_of_learning(used, learnt):
    ramp = RampSettings(low_c=20.0, high_c=35.0, hold_s=120.0)
    settings = ThermalSettings(bench=BenchSettings(sample_rate_hz=10.0), ramp=ramp)
    session = simulate_thermal_session("ramp", used[0], rng=np.random.default_rng(1), settings=settings)
    fitted, plain = (fit_drift([session], c).calibration for c in (learnt.calibration, used[1]))
    assert fitted.drift.learnt is None
    assert fitted.provenance.inputs == plain.provenance.inputs
    assert dict(fitted.provenance.settings) == dict(plain.provenance.settings)
    assert fitted.verdict.reasons == plain.verdict.reasons
    np.testing.assert_array_equal(fitted.accel.offset, plain.accel.offset)


@pytest.mark.slow
def test_the_same_rests_update_the_accelerometers_and_count_once(used):
    device, calibration, _ = used
    rng = np.random.default_rng(2)
    pool = [draw_day(rng, USE) for _ in range(8)]  # each with other poses on the table
    days = list(simulate_daily_use(device, rng=rng, settings=USE, motions=pool))
    wrong = calibration.accel.offset + np.array([60.0, -40.0, 80.0])  # its covariance states nothing: a data sheet's
    off = replace(calibration, accel=replace(calibration.accel, offset=wrong))
    sessions, dates = [day.session for day in days], on_days(range(8))
    fit = learn_drift(sessions, off, dates=dates)
    show("accelerometers, rests left out, before and after, m/s2", fit.accel.held_out)
    assert fit.accel.changed
    assert "drift.learn_accel_changed" in [note.code for note in fit.calibration.verdict.findings]
    up = rng.standard_normal((100, 3))
    reading = (
        calibration.accel.offset
        + STANDARD_GRAVITY * up / np.linalg.norm(up, axis=1)[:, None] @ np.linalg.inv(calibration.accel.matrix).T
    )
    left = [
        np.sqrt(np.mean((np.linalg.norm((reading - m.offset) @ m.matrix.T, axis=1) - STANDARD_GRAVITY) ** 2))
        for m in (off.accel, fit.calibration.accel)
    ]
    show("length of gravity in all directions, m/s2 rms", left)
    assert left[1] < 0.2 * left[0]
    halves = learn_drift(sessions[:4], off, dates=dates[:4]).calibration
    halves = learn_drift(sessions[4:], halves, dates=dates[4:]).calibration
    again = learn_drift(sessions, halves, dates=dates).calibration
    for made in (halves, again):
        np.testing.assert_array_equal(made.accel.offset, fit.calibration.accel.offset)
        np.testing.assert_array_equal(made.accel.covariance, fit.calibration.accel.covariance)
        np.testing.assert_array_equal(made.drift.static.accel_offset, fit.calibration.drift.static.accel_offset)


def turned(session, dps):
    """Return a session in which the device turned slowly all the time."""
    record = session.records[0]
    counts = np.array(dps) * 16.4
    return replace(session, records=(replace(record, gyro=record.gyro + counts),))


def test_a_day_of_slow_turning_is_left_out(used, learnt):
    _, calibration, days = used
    sessions = [day.session if day.number != 4 else turned(day.session, [0.0, 1.5, 0.0]) for day in days]
    fit = learn_drift(sessions, calibration, dates=on_days(range(8)))
    of_day = fit.calibration.drift.learnt.recording == 4
    assert not fit.rest_kept[of_day].any()
    assert fit.rest_kept[~of_day].all()
    assert "drift.learn_left_out" in {item.code for item in fit.verdict.findings}
    near = ~fit.extrapolated & np.isin(fit.temp_c, learnt.temp_c)
    there = np.isin(learnt.temp_c, fit.temp_c[near])
    moved = np.abs(fit.after[near] - learnt.after[there]) / DPS
    assert moved.max() < 0.03  # one switch-on of eight fewer


def test_rests_of_another_device_make_the_verdict_bad(used):
    _, calibration, days = used
    fit = learn_drift(
        [turned(day.session, [20.0, -15.0, 10.0]) for day in days[:4]], calibration, dates=on_days(range(4))
    )
    assert fit.verdict.status == "bad"
    assert any("check device and unit" in reason for reason in fit.verdict.reasons)


def test_what_cannot_be_learnt_from_is_refused(used):
    _, calibration, days = used
    session = days[0].session
    record = session.records[0]

    def refused(changed, **given):
        return learn_drift([replace(session, **changed)], calibration, dates=on_days([0]), **given)

    with pytest.raises(InputError, match=r"one device, got .*another"):
        refused({"serial": "another", "records": (replace(record, device="another"),)})
    with pytest.raises(InputError, match="wanted raw readings, got a corrected record"):
        refused({"records": (replace(record, state="corrected", gyro_unit="rad/s", accel_unit="m/s2"),)})
    with pytest.raises(InputError, match=r"wanted a column .* or set-points .*, got neither"):
        refused({"records": (replace(record, temp_c=None),)})
    with pytest.raises(InputError, match="wanted a date for each of 1 recordings, got 0"):
        learn_drift([session], calibration, dates=[])
    with pytest.raises(InputError, match="wanted a calibration of the gyroscopes"):
        learn_drift([session], replace(calibration, gyro=None), dates=on_days([0]))
    with pytest.raises(InputError, match="wanted a recording or more, got none"):
        learn_drift([], calibration, dates=[])
    noisy = record.gyro + 2000.0 * np.random.default_rng(1).standard_normal(record.gyro.shape)
    with pytest.raises(NotObservable, match="learn: wanted rests"):
        refused({"records": (replace(record, gyro=noisy, accel=None),)})


# ---- tables before


@pytest.fixture(scope="module")
def extended(used):
    """Return the fit on a calibration with tables from 20 to 24 degC, of which the days saw more."""
    device, calibration, days = used
    nodes = np.arange(20.0, 24.1, 0.5)
    offset = np.array([true_calibration(device, temp_c=t).gyro.offset for t in nodes])
    static = StaticDrift(
        temp_c=nodes,
        gyro_offset=offset,
        gyro_uncertainty=np.full(offset.shape, 0.01 * DPS) * calibration.gyro.scale_factor,
        gyro_extrapolated=np.zeros(len(nodes), bool),
    )
    matrix = np.repeat(calibration.gyro.matrix[None], 2, axis=0) * np.array([1.0, 1.01])[:, None, None]
    scale = ScaleDrift(temp_c=nodes[[0, -1]], gyro_matrix=matrix, gyro_uncertainty=np.zeros((2, 3, 3)))
    tables = DriftTables(static=static, scale=scale)
    known = replace(calibration, drift=tables)
    return known, learn_drift([day.session for day in days], known, dates=on_days(range(8)))


def test_tables_reach_temperatures_that_were_never_soaked(extended):
    known, fit = extended
    drift = fit.calibration.drift
    nodes, old = drift.static.temp_c, known.drift.static.temp_c
    assert nodes[0] <= fit.rest_temp_c.min() - 4.5
    assert nodes[-1] >= fit.rest_temp_c.max() + 4.5
    np.testing.assert_allclose(np.diff(nodes), 0.5)
    marks = drift.static.gyro_extrapolated
    assert marks[nodes < fit.rest_temp_c.min() - 0.6].all()
    assert not marks[(nodes >= old[0]) & (nodes <= old[-1])].any()
    assert drift.scale.temp_c[0] == nodes[0]
    assert drift.scale.temp_c[-1] == nodes[-1]
    inside = (drift.scale.temp_c >= old[0]) & (drift.scale.temp_c <= old[-1])
    assert drift.scale.gyro_extrapolated[~inside].all()
    assert (drift.scale.gyro_uncertainty[0] > 0.0).any()
    np.testing.assert_array_equal(drift.scale.gyro_matrix[0], known.drift.scale.gyro_matrix[0])


def test_a_learnt_calibration_reads_back_and_corrects(extended, used, tmp_path):
    fit = extended[1]
    write_calibration(fit.calibration, tmp_path / "c.json")
    back = read_calibration(tmp_path / "c.json")
    np.testing.assert_array_equal(back.drift.static.gyro_offset, fit.calibration.drift.static.gyro_offset)
    one, other = back.drift.learnt, fit.calibration.drift.learnt
    np.testing.assert_array_equal(one.gyro_variance, other.gyro_variance)
    np.testing.assert_array_equal(one.recording, other.recording)
    assert (one.recordings, one.since) == (other.recordings, other.since)
    np.testing.assert_array_equal(one.before.static.gyro_offset, other.before.static.gyro_offset)
    record = used[2][0].session.records[0]
    with pytest.warns(DriftRangeWarning, match="extrapolated"):  # the day's first minute was colder than its rests
        rest = correct(record, back, policy="raise").gyro[:200]
    assert np.abs(rest.mean(axis=0) / DPS).max() < 0.12  # one switch-on, four standard deviations
    again = learn_drift([used[2][0].session], back, dates=on_days([0]))
    np.testing.assert_allclose(again.after, fit.after, rtol=0.0, atol=1e-12)


# ---- made rests: coverage without the cost of a simulated bench


def made_day(rng, nominal, per_k, shift, temp_c):
    """Return a minute at rest at one temperature, two samples a second, deg/s."""
    level = nominal + per_k * (temp_c - 25.0) + shift
    time = np.arange(120) / 2.0
    record = Record(
        time=time,
        gyro=level + 0.02 * rng.standard_normal((120, 3)),
        temp_c=temp_c + 0.01 * rng.standard_normal(120),
        gyro_unit="dps",
    )
    return Session(kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=(record,))


def nominal(offset_dps, sigma_dps):
    model = plain_triad("dps", "rad/s", offset=offset_dps, offset_sigma=sigma_dps)
    return Calibration(device="A", reference_temp_c=25.0, gravity_m_s2=STANDARD_GRAVITY, gyro=model)


@pytest.mark.slow
def test_intervals_hold_the_next_switch_on_of_drawn_devices():
    rng, inside, z = np.random.default_rng(11), [], []
    for _ in range(16):
        true, per_k = rng.normal(0.0, 1.0, 3), rng.normal(0.0, 0.03, 3)
        calibration = nominal(true + rng.normal(0.0, 0.03, 3), 0.03)
        temps = rng.uniform(15.0, 32.0, 6)
        sessions = [made_day(rng, true, per_k, rng.normal(0.0, 0.03, 3), t) for t in temps]
        fit = learn_drift(sessions, calibration, dates=on_days(range(6)))
        at = rng.uniform(temps.min(), temps.max())
        table, stated = (
            np.array([np.interp(at, fit.temp_c, column) for column in value.T]) / DPS
            for value in (fit.after, fit.after_uncertainty)
        )
        z.append((true + per_k * (at - 25.0) + rng.normal(0.0, 0.03, 3) - table) / stated)
        inside.append(np.abs(z[-1]) < 1.96)
    show("inside of 48, rms of z", (int(np.sum(inside)), np.sqrt(np.mean(np.square(z)))), "41, 0.6 to 1.4")
    assert np.sum(inside) >= 41  # of 48: three standard deviations of the binomial distribution below 95 %
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4


def test_one_recording_states_that_the_repeatability_is_a_prior():
    rng = np.random.default_rng(2)
    days, model = [made_day(rng, np.zeros(3), np.zeros(3), 0.0, 20.0)], nominal(np.zeros(3), 0.02)
    fit = learn_drift(days, model, dates=on_days([0]))
    assert fit.verdict.status == "marginal"
    assert "drift.learn_few" in {item.code for item in fit.verdict.findings}
    wider = learn_drift(days, model, dates=on_days([0]), settings=LearnSettings(turn_on=0.06 * DPS))
    at = int(np.argmin(np.abs(fit.temp_c - 20.0)))
    assert (wider.after_uncertainty[at] > 1.5 * fit.after_uncertainty[at]).all()


@pytest.mark.parametrize("drawn_dps", [0.006, 0.08])
def test_the_repeatability_is_that_of_the_device_where_it_is_far_from_the_prior(drawn_dps):
    rng = np.random.default_rng(1)
    sessions = [made_day(rng, np.zeros(3), np.zeros(3), rng.normal(0.0, drawn_dps, 3), 25.0) for _ in range(20)]
    fit = learn_drift(sessions, nominal(np.zeros(3), 0.02), dates=on_days(range(20)))
    found, stated = fit.turn_on / DPS, fit.turn_on_uncertainty / DPS
    show("turn-on, deg/s", (np.round(found, 4), np.round(stated, 4)), f"drawn with {drawn_dps}")
    # of 20 values a standard deviation is known to 1 / sqrt(40) = 0.16 of itself; of the small one the rest's scatter is part
    assert (np.abs(np.log(found / drawn_dps)) < 3.0 * 0.16).all()
    assert (stated / found > 0.5 * 0.16).all()
    assert (stated / found < (0.4 if drawn_dps < 0.01 else 2.0 * 0.16)).all()


def swaying(rng, tilt_deg):
    """Return 30 s at rest and 20 s of a slow tilt, twenty samples a second, deg/s and g, both stated as rests."""
    time = np.arange(1000) / 20.0
    angle = np.radians(tilt_deg) * np.clip((time - 30.0) / 20.0, 0.0, 1.0)
    gyro = np.where(time > 30.0, tilt_deg / 20.0, 0.0)[:, None] * [1.0, 0.0, 0.0] + 0.02 * rng.standard_normal(
        (1000, 3)
    )
    accel = np.stack((np.zeros(1000), np.sin(angle), np.cos(angle)), axis=1) + 1e-3 * rng.standard_normal((1000, 3))
    record = Record(time=time, gyro=gyro, accel=accel, temp_c=np.full(1000, 25.0), gyro_unit="dps", accel_unit="g")
    stills = (Still(start=0, stop=600), Still(start=600, stop=1000))
    return Session(kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=stills)


def test_the_turn_of_a_rest_is_its_uncertainty_and_too_much_of_it_leaves_it_out():
    rng, model = np.random.default_rng(6), nominal(np.zeros(3), 0.02)
    fit = learn_drift([swaying(rng, 1.0)], model, dates=on_days([0]))
    held = fit.calibration.drift.learnt
    show(
        "standard uncertainty of both rests, deg/s",
        np.sqrt(held.gyro_variance),
        "0.0008 and 0.035: 1 deg in 20 s, over root 2",
    )
    assert (np.sqrt(held.gyro_variance[0]) < 0.004).all()
    np.testing.assert_allclose(np.sqrt(held.gyro_variance[1]), 1.0 / 20.0 / 2.0**0.5, rtol=0.1)
    figure = draw_learnt(fit)
    (bars,) = figure.axes[0].containers[0].lines[2]  # of x, deg/s
    assert cut_texts(figure) == []
    drawn = [np.ptp(bar[:, 1]) / 2.0 for bar in bars.get_segments()]
    np.testing.assert_allclose(drawn, 1.96 * np.sqrt(held.gyro_variance[:, 0]))
    nodes = np.array([15.0, 35.0])
    static = StaticDrift(temp_c=nodes, gyro_offset=np.zeros((2, 3)), gyro_uncertainty=np.full((2, 3), 0.01))
    fit = learn_drift([swaying(rng, 5.0)], replace(model, drift=DriftTables(static=static)), dates=on_days([0]))
    assert len(fit.calibration.drift.learnt.temp_c) == 1
    turning = next(item for item in fit.verdict.findings if item.code == "drift.learn_turning")
    assert turning.values["count"] == 1


def test_ageing_is_followed_to_the_last_day():
    rng = np.random.default_rng(3)
    drifted = [np.full(3, 0.004 * day) for day in range(0, 100, 5)]
    sessions = [made_day(rng, np.zeros(3), np.zeros(3), shift, 25.0 + rng.normal()) for shift in drifted]
    fit = learn_drift(sessions, nominal(np.zeros(3), 0.01), dates=on_days(range(0, 100, 5)))
    at = np.array([np.interp(25.0, fit.temp_c, column) for column in fit.after.T]) / DPS
    show("offset after 95 days, deg/s", at, "0.38, their mean 0.19")
    assert (np.abs(at - 0.38) < 0.05).all()
    # 19 steps of 0.02: 0.049 in 30 days, known to 1 / sqrt(38) = 0.16 of itself
    show("ageing in 30 days, deg/s", (fit.ageing / DPS, fit.ageing_uncertainty / DPS), "0.049, 0.008")
    assert (np.abs(np.log(fit.ageing / DPS / 0.049)) < 3.0 * 0.16).all()
    assert (np.abs(np.log(fit.ageing_uncertainty / DPS / 0.008)) < np.log(2.0)).all()


# ---- the given logs cut into days


@pytest.fixture(scope="module")
def warm_up():
    with gzip.open(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), "rt") as file:
        raw = np.genfromtxt(file, delimiter=",", skip_header=1)
    return Record(
        time=1e-3 * raw[:, 12], gyro=raw[:, 3:6] / 16.4, temp_c=raw[:, 9] / 340.0 + 36.53, gyro_unit="dps", device="A"
    )


def plateau(name):
    """Return the lines of a log that hold seven numbers, 50 a second, as a record."""
    rows = []
    with gzip.open(data_path("thermal_bmi270_two_point", name), "rt", errors="replace") as file:
        for line in file:
            words = line.split(",")
            if len(words) == 7 and all(
                word.strip().replace(".", "", 1).replace("-", "", 1).isdigit() for word in words
            ):
                rows.append([float(word) for word in words])
    values = np.array(rows)
    return Record(
        time=np.arange(len(values)) / 50.0, gyro=values[:, 4:], temp_c=values[:, 0], gyro_unit="dps", device="A"
    )


def test_two_plateaus_are_learnt_one_day_each_and_their_second_halves_agree():
    cold, hot = plateau("BMI_270_cold_test.csv.gz"), plateau("BMI_270_hot_test.csv.gz")
    halves = [(r.part(0, len(r) // 2), r.part(len(r) // 2, len(r))) for r in (cold, hot)]
    start = halves[0][0]
    calibration = replace(nominal(start.gyro.mean(axis=0), 0.02), reference_temp_c=float(start.temp_c.mean()))
    sessions = [Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=(one,)) for one, _ in halves]
    fit = learn_drift(sessions, calibration, dates=on_days(range(2)))
    for _, held in halves:
        at = float(held.temp_c.mean())
        table, stated = (
            np.array([np.interp(at, fit.temp_c, column) for column in value.T]) / DPS
            for value in (fit.after, fit.after_uncertainty)
        )
        off = held.gyro.mean(axis=0) - table
        show(f"second half at {at:.1f} degC, mdeg/s", np.round(1e3 * off, 1), "30")
        assert (np.abs(off) < 0.030).all()  # sixths of one plateau differ by up to 0.06
        assert (np.abs(off) < 1.96 * stated).all()
    before = np.array([np.interp(48.0, fit.temp_c, column) for column in fit.before.T]) / DPS
    hottest = np.abs(halves[1][1].gyro.mean(axis=0) - before)
    wide = np.array([np.interp(48.0, fit.temp_c, column) for column in fit.before_uncertainty.T]) / DPS
    assert (hottest < 1.96 * wide).all()  # the prior's slope covers this part
    assert hottest.max() > 0.3  # what was learnt


@pytest.mark.slow
def test_every_other_three_minutes_of_the_warm_up_predict_the_others(warm_up):
    count = int(warm_up.duration_s // 180.0)
    edges = np.searchsorted(warm_up.time - warm_up.time[0], 180.0 * np.arange(count + 1))
    days = [warm_up.part(int(a), int(b)) for a, b in pairwise(edges)]
    first = days[0].gyro.mean(axis=0)
    calibration = replace(nominal(first, 0.02), reference_temp_c=float(days[0].temp_c.mean()))
    sessions = [Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=(day,)) for day in days[::2]]
    fit = learn_drift(sessions, calibration, dates=on_days(range(len(sessions))))
    left, stated = [], []
    for day in days[1::2]:
        for rows in np.array_split(np.arange(len(day)), 18):
            temp = float(day.temp_c[rows].mean())
            columns = [np.interp(temp, fit.temp_c, value) / DPS for value in (*fit.after.T, *fit.after_uncertainty.T)]
            left.append(day.gyro[rows].mean(axis=0) - columns[:3])
            stated.append(columns[3:])
    rms = 1e3 * np.sqrt(np.mean(np.square(left), axis=0))
    show("held-out ten seconds, mdeg/s", np.round(rms, 2), "a table of the whole log leaves 5.3 / 6.3 / 4.6")
    assert (rms <= [8.0, 9.5, 7.0]).all()  # 1.5 times the scatter about the whole log's cubic
    assert (np.abs(left) < 1.96 * np.array(stated)).mean() > 0.9
