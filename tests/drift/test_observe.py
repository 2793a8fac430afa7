"""Thermal sessions made ready: units, power-on, blocks of rest, dwells, and means over set-points."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from testkit.data import show
from undrift.drift.fit import fit_drift
from undrift.drift.observe import in_units_of, observe_rests, observe_steps
from undrift.errors import InputError, NotObservable
from undrift.model import AdcModel
from undrift.record import Record, Session, Still, Turn
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration

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
    with pytest.raises(InputError, match="recording 1 is already corrected"):
        in_units_of(session(record(), corrected), COUNTS)


TEMPS = np.concatenate((np.arange(20.0, 71.0, 10.0), np.arange(65.0, 24.0, -10.0)))
SD, COUNT = 0.05, 400  # deg/s, readings in a mean


def truth(temp_c):
    """Offset of each axis, deg/s, at a temperature."""
    t = np.asarray(temp_c, float)[..., None] - 25.0
    return np.array([1.0, -2.0, 0.5]) + t * np.array([0.02, -0.01, 0.03]) + t**2 * np.array([2e-4, 1e-4, -1e-4])


def means_of(*, seed=1, rates=()):
    """Return a frame of means of a simulated device, at rest and at some rates about z."""
    rng, rows = np.random.default_rng(seed), []
    for temp in TEMPS:
        for rate in (0.0, *rates):
            # a visit scatters about its curve by more than its readings' noise, as bias instability has it
            mean = truth(temp) + np.array([0.0, 0.0, rate]) * (1.0 + 1e-4 * (temp - 25.0))
            rows.append((temp, rate, *(mean + rng.normal(0.0, SD / np.sqrt(COUNT), 3) + rng.normal(0.0, 3e-3, 3))))
    return pd.DataFrame(rows, columns=["temp_c", "turn_rate_z_dps", "gyro_x_dps", "gyro_y_dps", "gyro_z_dps"])


@pytest.mark.slow
def test_offsets_over_temperature_lie_within_their_intervals():
    inside, worst = [], 0.0
    nodes = np.arange(20.0, 70.5, 0.5)
    for seed in range(8):
        static = fit_drift(means_of(seed=seed)).calibration.drift.static
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
    frame = means_of(rates=(-60.0, -30.0, 30.0, 60.0))
    frame.loc[1, "temp_c"] = np.nan  # a row without temperature is omitted
    fit = fit_drift(frame)
    assert len(fit.rests) == len(TEMPS)
    assert len(fit.steps) == 4 * len(TEMPS) - 1
    assert len(np.unique(fit.steps.soak)) == len(TEMPS)
    scale = fit.scale.soaks.forward[:, 2, 2]
    slope = np.polyfit(fit.scale.soaks.temp_c, 100.0 * scale / scale.mean(), 1)[0]
    # 0.01 % per degC is simulated; a soak knows its scale to 0.003 deg/s over 90 deg/s, eleven of them over 50 degC
    assert slope == pytest.approx(0.01, abs=3e-4)
    assert not {"drift.set_points_only", "drift.left_out"} & {item.code for item in fit.verdict.findings}


def test_means_that_only_turn_are_refused():
    frame = means_of(rates=(30.0,))
    with pytest.raises(NotObservable, match="no stretch at rest"):
        fit_drift(frame[frame.turn_rate_z_dps != 0.0])


def test_gyroscopes_that_repeat_one_reading_are_fitted():
    up = np.linspace(20.0, 40.0, 17)
    frame = pd.DataFrame({"temp_c": [*up, *up[::-1]], "gyro_x_dps": 0.0, "gyro_y_dps": 0.0, "gyro_z_dps": 0.2})
    fit = fit_drift(frame)
    np.testing.assert_allclose(fit.static.table.gyro_offset - (0.0, 0.0, 0.2), 0.0, atol=1e-6)


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
    # 300 differences of half seconds
    np.testing.assert_allclose(np.sqrt(blocks.gyro_variance), 0.1 / 200**0.5, rtol=0.15)


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
