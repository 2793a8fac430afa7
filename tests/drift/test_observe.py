"""Rate steps made ready: soaks, mountings, offsets.

Sessions made ready for a thermal fit: units, half steps, power-on, corrected records.

Means over set-points give the tables that their device has.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.rate_steps import GRID, computed
from undrift.drift.fit import fit_drift
from undrift.drift.observe import (
    check_once,
    in_units_of,
    nominal_models,
    observe_rests,
    observe_steps,
)
from undrift.drift.rates import prepared
from undrift.errors import InputError, NotObservable
from undrift.io.session import write_session
from undrift.model import AdcModel, StaticDrift
from undrift.record import Record, Session, SetPointMeans, Still, Turn
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.truth import true_calibration

DEVICE = random_device(np.random.default_rng(0), grade="enc03j_3031")


def made(temps=(20.0, 40.0)):
    return computed(DEVICE, np.array(temps), np.random.default_rng(1), rates=GRID[:3])


def steps_of(steps, static=None):
    return prepared(steps, true_calibration(DEVICE).gyro, static=static)


def test_each_axis_of_each_soak_is_a_mounting():
    steps = steps_of(made())
    assert len(np.unique(steps.mounting)) == 6
    for m in range(6):
        own = steps.mounting == m
        assert len(np.unique(steps.soak[own])) == 1
        rates = steps.rate_b[own][:, steps.axis[own][0]]
        assert np.array_equal(np.sort(np.degrees(rates).round(6)), [-15.0, -10.0, -5.0, 5.0, 10.0, 15.0])


def test_a_wobble_of_the_axis_is_the_same_mounting():
    given = made()
    wobbling = replace(given, rate_b=given.rate_b + 0.01 * np.abs(given.rate_b).max(axis=1, keepdims=True))
    assert len(np.unique(steps_of(wobbling).mounting)) == 6


def test_soaks_of_one_number_in_two_sessions_are_two():
    given = made()
    split = replace(given, session=(np.arange(len(given)) % 2), soak=np.zeros(len(given), int))
    assert len(np.unique(steps_of(split).soak)) == 2


def test_dwells_at_rest_are_no_steps():
    given = made()
    rate = given.rate_b.copy()
    rate[:4] = 0.0
    assert len(steps_of(replace(given, rate_b=rate))) == len(given) - 4


def test_offset_is_linear_between_nodes_and_constant_beyond():
    calibration = true_calibration(DEVICE)
    table = StaticDrift(temp_c=[20.0, 30.0], gyro_offset=[[0.0, 1.0, 2.0], [10.0, 1.0, 0.0]])
    three = replace(made().taken(slice(0, 3)), temp_c=np.array([10.0, 25.0, 40.0]))
    at = three.gyro - steps_of(three, table).reading
    np.testing.assert_allclose(at, [[0.0, 1.0, 2.0], [5.0, 1.0, 1.0], [10.0, 1.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(three.gyro - steps_of(three).reading, np.tile(calibration.gyro.offset, (3, 1)))


COUNTS = true_calibration(preset("enc03j_3031"))


def record(*, begin_s=0.0, seconds=60.0, gyro_unit="count", accel_unit="count", state="raw"):
    rng = np.random.default_rng(2)
    n = round(50 * seconds)
    return Record(
        time=begin_s + np.arange(n) / 50.0,
        gyro=rng.normal(0.0, 1.0, (n, 3)),
        accel=rng.normal([0.0, 0.0, 10.0], 1.0, (n, 3)),
        temp_c=np.linspace(20.0, 30.0, n),
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        state=state,
    )


def session(*records):
    stills = tuple(Still(start=0, stop=len(r), recording=k) for k, r in enumerate(records))
    return Session(kind="thermal", serial="A", gravity_m_s2=9.80665, records=records, stills=stills)


def ages(*records):
    held = [session(*records)]
    blocks = observe_rests(held, temperatures=[[r.temp_c for r in records]])
    return blocks.power_on_s


def test_clock_that_begins_anew_is_another_switch_on():
    assert (np.diff(ages(record(), record(begin_s=300.0))) > 0.0).all()
    since = ages(record(), record(begin_s=300.0), record(begin_s=0.0), record(begin_s=100.0))
    late = since.reshape(4, -1)
    np.testing.assert_allclose(late[2], late[0])
    np.testing.assert_allclose(late[3], late[0] + 100.0)
    np.testing.assert_allclose(late[1], late[0] + 300.0)


def test_readings_come_in_the_units_of_the_calibration():
    physical = replace(COUNTS, gyro=replace(COUNTS.gyro, unit_in="rad/s"))
    ready = in_units_of(session(record(gyro_unit="dps")), physical).records[0]
    assert ready.gyro_unit == "rad/s"
    np.testing.assert_allclose(ready.gyro, np.radians(record().gyro))
    cut = replace(COUNTS, adc=AdcModel(gyro_lsb=np.full(3, 0.5), gyro_rounding="floor"))
    before, after = record(), in_units_of(session(record()), cut).records[0]
    np.testing.assert_allclose(after.gyro, before.gyro + 0.25)
    np.testing.assert_array_equal(after.accel, before.accel)


def test_another_unit_and_a_corrected_record_are_refused():
    with pytest.raises(InputError, match="are in dps"):
        in_units_of(session(record(gyro_unit="dps")), COUNTS)
    corrected = record(gyro_unit="rad/s", accel_unit="m/s2", state="corrected")
    with pytest.raises(InputError, match="recording 1 is corrected"):
        in_units_of(session(record(), corrected), COUNTS)


def test_a_nominal_model_keeps_the_unit_and_counts_have_none():
    model = nominal_models([session(record(gyro_unit="dps"))])
    np.testing.assert_allclose(model.gyro.matrix, np.radians(np.eye(3)))
    assert model.accel is None
    assert model.verdict.status == "marginal"
    with pytest.raises(NotObservable, match="no known scale"):
        nominal_models([session(record())])


TEMPS = np.concatenate((np.arange(20.0, 71.0, 10.0), np.arange(65.0, 24.0, -10.0)))
SD, COUNT = 0.05, 400  # deg/s, readings in a mean


def truth(temp_c):
    """Offset of each axis, deg/s, at a temperature."""
    t = np.asarray(temp_c, float)[..., None] - 25.0
    return np.array([1.0, -2.0, 0.5]) + t * np.array([0.02, -0.01, 0.03]) + t**2 * np.array([2e-4, 1e-4, -1e-4])


def means_session(temp_c, gyro, rate_b, *, sd=None):
    """Return a session of means over set-points: gyro and rate_b (N, 3) in deg/s, sd (N, 3) the spread of COUNT readings."""
    rows = len(temp_c)
    record = Record(time=60.0 * np.arange(rows), gyro=gyro, temp_c=temp_c, gyro_unit="dps")
    none = np.full((rows, 3), np.nan)
    means = SetPointMeans(
        rate_b=np.radians(rate_b),
        gyro_uncertainty=none if sd is None else sd / np.sqrt(COUNT),
        accel_uncertainty=none,
    )
    return Session(kind="set-points", serial="a", gravity_m_s2=9.81, records=(record,), means=(means,))


def session_of(*, seed=1, spread=True, rates=()):
    """Return the means of a simulated device, at rest and at some rates about z."""
    rng, temps, gyro, turned = np.random.default_rng(seed), list[float](), list[np.ndarray](), list[np.ndarray]()
    for temp in TEMPS:
        for rate in (0.0, *rates):
            # a visit scatters about its curve by more than its readings' noise, as bias instability has it
            mean = truth(temp) + np.array([0.0, 0.0, rate]) * (1.0 + 1e-4 * (temp - 25.0))
            temps.append(temp)
            gyro.append(mean + rng.normal(0.0, SD / np.sqrt(COUNT), 3) + rng.normal(0.0, 3e-3, 3))
            turned.append(np.array([0.0, 0.0, rate]))
    sd = np.full((len(temps), 3), SD) if spread else None
    return means_session(np.array(temps), np.array(gyro), np.array(turned), sd=sd)


@pytest.mark.slow
def test_offsets_over_temperature_lie_within_their_intervals():
    inside, worst = [], 0.0
    nodes = np.arange(20.0, 70.5, 0.5)
    for seed in range(8):
        static = fit_drift([session_of(seed=seed)]).calibration.drift.static
        at = [np.interp(nodes, static.temp_c, column) for column in static.gyro_offset.T]
        doubt = [np.interp(nodes, static.temp_c, column) for column in static.gyro_uncertainty.T]
        error = np.stack(at, axis=1) - truth(nodes)
        inside.append((np.abs(error) <= 1.96 * np.stack(doubt, axis=1)).mean())
        worst = max(worst, float(np.abs(error).max()))
    show("set-points: nodes within 95 %; largest error, deg/s", f"{np.mean(inside):.2f}; {worst:.4f}", "0.87; 0.02")
    # 24 curves with about three independent values each: 0.95 - 3 sqrt(0.95 * 0.05 / 72) = 0.87
    assert np.mean(inside) > 0.87
    assert worst < 0.02  # five standard deviations of a visit, 0.05 / 20 and 0.003 deg/s in quadrature


def test_rows_with_a_rate_give_the_scale_over_temperature():
    session = session_of(rates=(-60.0, -30.0, 30.0, 60.0))
    fit = fit_drift([session])
    assert len(fit.steps) == 4 * len(TEMPS)
    assert len(np.unique(fit.steps.soak)) == len(TEMPS)
    (temps,) = (record.temp_c.copy() for record in session.records)
    temps[0] = np.nan  # a first row without temperature
    steps = observe_steps([session], temperatures=[[temps]])
    np.testing.assert_array_equal(steps.soak, fit.steps.soak)
    assert fit.scale is not None
    scale = fit.scale.soaks.forward[:, 2, 2]
    slope = np.polyfit(fit.scale.soaks.temp_c, 100.0 * scale / scale.mean(), 1)[0]
    # 0.01 % per degC is simulated; a soak knows its scale to 0.003 deg/s over 90 deg/s, eleven of them over 50 degC
    assert slope == pytest.approx(0.01, abs=3e-4)


def test_means_without_uncertainty_are_fitted_by_their_scatter():
    poor = fit_drift([session_of(spread=False)])
    rich = fit_drift([session_of()])
    ratio = np.median(poor.calibration.drift.static.gyro_uncertainty / rich.calibration.drift.static.gyro_uncertainty)
    # both know the scatter of eleven visits about a curve, seven degrees of freedom: three standard deviations of it
    assert 0.5 < ratio < 1.8


def test_table_of_means_has_no_finding_of_lag():
    codes = {item.code: item.level for item in fit_drift([session_of()]).verdict.findings}
    assert "drift.set_points_only" not in codes
    assert not any("lag" in item for item in codes)


def test_a_session_of_means_is_not_written(tmp_path):
    with pytest.raises(InputError, match="means of set-points"):
        write_session(session_of(), tmp_path / "out")


def at_rest(temp_c, gyro, rate):
    """Return means without uncertainty, turned about z at known rates, deg/s."""
    turned = np.outer(rate, (0.0, 0.0, 1.0))
    return means_session(temp_c, gyro + turned, turned)


def test_every_row_of_means_is_a_block_of_rest():
    temp_c = np.linspace(-10.0, 56.0, 34)
    fit = fit_drift([at_rest(temp_c, truth(temp_c), np.zeros(34))])
    assert (len(fit.rests), float(fit.rests.temp_c.min())) == (34, -10.0)


def test_gyroscopes_that_repeat_one_reading_are_fitted():
    up = np.linspace(20.0, 40.0, 17)
    fit = fit_drift([at_rest(np.concatenate((up, up[::-1])), np.tile((0.0, 0.0, 0.2), (34, 1)), np.zeros(34))])
    np.testing.assert_allclose(fit.static.table.gyro_offset - (0.0, 0.0, 0.2), 0.0, atol=1e-6)


def test_rates_that_determine_no_surface_are_a_finding():
    rng = np.random.default_rng(1)
    temp_c, rate = np.array([30.0, 30.0, 30.0, 20.0, 30.0]), np.array([0.0, 100.0, -100.0, 0.0, 100.0])
    fit = fit_drift([at_rest(temp_c, truth(temp_c) + rng.normal(0.0, 0.005, (5, 3)), rate)])
    assert "drift.not_observable" in {item.code for item in fit.verdict.findings}


# ---- data given twice are refused; recordings cut from one switch-on are one session


def noise_record(*, seed=0, begin_s=0.0, n=500):
    rng = np.random.default_rng(seed)
    return Record(
        time=begin_s + np.arange(n) / 50.0,
        gyro=rng.normal(size=(n, 3)),
        accel=rng.normal(size=(n, 3)),
        temp_c=np.linspace(20.0, 30.0, n),
    )


def recorded(made, name="log.csv", digest=None, serial=""):
    inputs = () if digest is None else ((name, digest),)
    return Session(kind="thermal", serial=serial, gravity_m_s2=9.80665, records=(made,), inputs=inputs)


def test_equal_readings_are_refused_however_the_clock_was_set():
    later = replace(noise_record(), time=noise_record().time + 1000.0)
    with pytest.raises(InputError, match="the same data"):
        check_once([recorded(noise_record()), recorded(later, "b.csv", "1" * 64)])


def test_a_sensor_that_repeats_one_value_is_not_taken_for_a_copy():
    stuck = [replace(noise_record(seed=k), gyro=np.zeros((500, 3)), accel=np.ones((500, 3))) for k in range(2)]
    check_once([recorded(result) for result in stuck])
    gap = np.where(np.arange(500)[:, None] < 400, np.nan, noise_record().gyro)
    check_once(
        [recorded(replace(noise_record(seed=k), gyro=gap)) for k in range(2)]
    )  # gaps are equal, accelerations are not


# ---- thermal sessions gathered into blocks of rest and dwells

RATE = 20.0


def log(seconds=300.0, *, seed=0, moving=False):
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE) + 5.0
    gyro = rng.normal(size=(len(time), 3)) * 0.1 + [1.0, -2.0, 0.5]
    accel = rng.normal(size=(len(time), 3)) * 0.01 + [0.0, 0.0, 9.8]
    if moving:
        gyro += 40.0 * np.sin(2.0 * time)[:, None]
        accel += 5.0 * np.sin(3.0 * time)[:, None]
    return Record(time=time, gyro=gyro, accel=accel, temp_c=20.0 + time / 60.0, gyro_unit="dps")


def thermal(*records, **pieces):
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=records, **pieces)


def rests(made):
    return observe_rests([made], temperatures=[[r.temp_c for r in made.records]])


def test_a_log_that_never_moves_is_one_rest_of_ten_second_blocks():
    blocks = rests(thermal(log()))
    assert len(blocks) == 30
    assert set(blocks.pose) == {0}
    np.testing.assert_allclose(np.diff(blocks.time), 10.0, atol=0.1)
    np.testing.assert_allclose(blocks.ramp_c_per_min, 1.0, atol=1e-6)
    np.testing.assert_allclose(blocks.gyro, np.tile([1.0, -2.0, 0.5], (30, 1)), atol=5 * 0.1 / 200**0.5)
    np.testing.assert_allclose(
        np.sqrt(blocks.gyro_variance), 0.1 / 200**0.5, rtol=0.15
    )  # 300 differences of half seconds


def test_torn_lines_spikes_and_gaps_do_not_reach_the_means():
    clean = log()
    gyro = clean.gyro.copy()
    gyro[50::333] = 4000.0
    gyro[1000:1050] = np.nan
    dirty = Record(time=clean.time, gyro=gyro, accel=clean.accel, temp_c=clean.temp_c, gyro_unit="dps")
    blocks = rests(thermal(dirty))
    assert len(blocks) > 15
    off = np.abs(blocks.gyro - [1.0, -2.0, 0.5]) / np.sqrt(blocks.gyro_variance)
    assert off.max() < 5.0
    np.testing.assert_allclose(blocks.temp_c, 20.0 + (blocks.time + 5.0) / 60.0, atol=0.01)


def test_stated_stills_serve_in_blocks():
    stills = (
        Still(start=0, stop=160, face="+z"),
        Still(start=1000, stop=2000, face="-z"),
        Still(start=3000, stop=3160, face="+z"),
    )
    blocks = rests(thermal(log(), stills=stills))
    assert [int((blocks.pose == p).sum()) for p in (0, 1)] == [2, 5]
    assert blocks.power_on_s[0] == pytest.approx(4.0, abs=0.05)


def test_recordings_follow_each_other_on_one_clock():
    one = thermal(log(60.0), log(60.0, seed=1))
    temps = [[r.temp_c for r in one.records]] * 2
    blocks = observe_rests([one, one], temperatures=temps)
    assert list(np.unique(blocks.session)) == [0, 1]
    assert len(np.unique(blocks.pose)) == 4
    assert (np.diff(blocks.time[blocks.session == 0]) > 0.0).all()


def test_no_rest_and_no_temperature_are_refused():
    with pytest.raises(NotObservable, match="no stretch"):
        rests(thermal(log(moving=True)))
    thermal_session = thermal(log())
    with pytest.raises(NotObservable, match="with a known temperature"):
        observe_rests([thermal_session], temperatures=[[np.full(len(thermal_session.records[0]), np.nan)]])


def test_dwells_are_numbered_by_soak_and_carry_the_imposed_rate():
    turns = tuple(
        Turn(start=k * 400, stop=k * 400 + 300, axis=axis, turn_rate=rate)
        for k, (axis, rate) in enumerate((("x", 0.5), ("x", -0.5), ("y", 1.0), ("z", 1.0)))
    )
    thermal_session = thermal(log(), turns=turns)
    temp = np.where(np.arange(6000) < 800, 20.0, 30.0)
    steps = observe_steps([thermal_session], temperatures=[[temp]])
    np.testing.assert_array_equal(steps.soak, [0, 0, 1, 1])
    np.testing.assert_array_equal(steps.rate_b, [[0.5, 0, 0], [-0.5, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(steps.temp_c, [20.0, 20.0, 30.0, 30.0])
    with pytest.raises(InputError, match="has no temperature"):
        observe_steps([thermal_session], temperatures=[[np.full(6000, np.nan)]])
    assert len(observe_steps([thermal(log())], temperatures=[[temp]])) == 0
