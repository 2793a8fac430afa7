"""Offset over temperature: what enters it and what the verdict says."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.full_calibration import device
from undrift.drift.checks import static_verdict
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import bins_of, gather, instability_of
from undrift.drift.static import StaticSettings, both_ways, cooling, fit_static, near_data, warm_up_table, warm_up_time
from undrift.errors import InputError, NotObservable
from undrift.model import TriadModel
from undrift.units import EARTH_RATE

NODES = np.arange(20.0, 60.1, 1.0)


def blocks(temp_c, gyro, *, accel=None, session=0, noise=1e-3, time=None):
    n = len(temp_c)
    whole = np.full(n, session, np.int64)
    clock = 10.0 * np.arange(n) if time is None else time
    return RestBlocks(
        session=whole,
        pose=whole,
        time=clock,
        power_on_s=clock,
        temp_c=np.asarray(temp_c, float),
        ramp_c_per_min=np.zeros(n),
        gyro=gyro,
        accel=np.full((n, 3), np.nan) if accel is None else accel,
        gyro_variance=np.full((n, 3), noise**2),
        accel_variance=np.full((n, 3), noise**2),
    )


def joined(*parts):
    names = [name for name in RestBlocks.__dataclass_fields__ if getattr(parts[0], name) is not None]
    return RestBlocks(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def line(temp_c, rng, noise=1e-3):
    return 0.01 * (np.asarray(temp_c)[:, None] - 25.0) * [1.0, -2.0, 0.5] + noise * rng.normal(size=(len(temp_c), 3))


def test_what_gravity_and_earth_feign_is_taken_off():
    rng, calibration = np.random.default_rng(0), device(unit="rad/s")
    temp = np.linspace(20.0, 60.0, 80)
    model, force = calibration.gyro, np.array([0.0, 0.0, 9.81])
    accel = np.tile(calibration.accel.forward_matrix @ force + calibration.accel.offset, (80, 1))
    rate = model.g_sensitivity @ force + [0.0, 0.0, EARTH_RATE * np.sin(np.radians(50.0))]
    made = blocks(temp, line(temp, rng, 1e-6) + model.forward_matrix @ rate, accel=accel, noise=1e-6)
    settings = StaticSettings(latitude_deg=50.0)
    fit = fit_static(made, nodes=NODES, calibration=calibration, settings=settings)
    np.testing.assert_allclose(fit.table.gyro_offset, line(NODES, rng, 0.0), atol=5e-6)
    heading = EARTH_RATE * np.cos(np.radians(50.0)) / 2.0**0.5  # in an unknown direction
    assert (fit.table.gyro_uncertainty > 0.9 * heading).all()
    with pytest.raises(InputError, match="Earth rate: wanted a calibration of both triads"):
        fit_static(made, nodes=NODES, settings=settings)


def test_accelerometer_offsets_hang_on_the_calibration_at_its_reference_temperature():
    rng = np.random.default_rng(0)
    model = TriadModel(
        method="six-face", unit_in="g", unit_out="m/s2", matrix=9.81 * np.eye(3), offset=np.array([0.01, 0.02, 0.03]),
        covariance=np.zeros((12, 12)), rms_residual=0.0, count=6, rank=12, condition=1.0, valid_range=(-20.0, 20.0),
    )  # fmt: skip
    calibration = replace(device(), accel=model, gyro=None, reference_temp_c=30.0)
    temp = np.linspace(20.0, 60.0, 80)
    drift = 1e-3 * np.outer(temp - 30.0, [1.0, 0.0, -1.0])
    accel = [0.01, 0.02, 1.03] + drift + 1e-6 * rng.normal(size=(80, 3))
    made = blocks(temp, line(temp, rng), accel=accel, noise=1e-6)
    fit = fit_static(made, nodes=NODES, calibration=calibration)
    wanted = model.offset + 1e-3 * np.outer(NODES - 30.0, [1.0, 0.0, -1.0])
    np.testing.assert_allclose(fit.table.accel_offset, wanted, atol=2e-5)
    assert "drift.accel_one_pose" in {item.code for item in fit.verdict.findings}
    scale = 2e-4 * np.abs(NODES - 30.0)[:, None] * [0.0, 0.0, 1.0]  # of 1 g along z, by one pose
    np.testing.assert_allclose(fit.accel.unknown_scale, scale, atol=1e-7)
    assert (fit.table.accel_uncertainty >= scale).all()
    assert (fit.table.accel_uncertainty[:, :2] < 1e-4).all()
    assert fit.accel.mostly_unknown_scale
    assert static_verdict(replace(fit, gyro=None), None).status == "marginal"
    loose = replace(fit, gyro=None, accel=replace(fit.accel, uncertainty=fit.accel.uncertainty + 0.1))
    assert static_verdict(loose, None).status == "good"
    reasons = static_verdict(fit, None).reasons
    assert sum("0.02 % per degC of gravity counts as uncertainty" in reason for reason in reasons) == 1
    unknown = fit_static(made, nodes=NODES, calibration=replace(calibration, reference_temp_c=np.nan))
    assert unknown.table.accel_offset is None
    np.testing.assert_allclose(unknown.accel.slope, [1e-3, 0.0, -1e-3], atol=1e-5)


def test_nodes_without_data_near_them_are_marked():
    near = near_data(np.array([18.0, 19.6, 25.0, 30.0, 40.0, 41.0]), np.array([20.0, 40.0]), gap_c=5.0)
    np.testing.assert_array_equal(near, [False, True, True, False, True, False])


def test_the_hot_end_of_a_warm_up_counts_no_more_than_its_degrees():
    rng = np.random.default_rng(1)
    temp = 60.0 - 40.0 * np.exp(-np.arange(1000) / 100.0)
    cells = gather(
        blocks(temp, line(temp, rng)), line(temp, rng), np.full((1000, 3), 1e-6), direction=np.zeros(1000),
        regressors=np.zeros((1000, 0)),
    )  # fmt: skip
    assert len(cells.temp_c) < 90
    assert (cells.temp_c > 59.0).sum() <= 3
    np.testing.assert_array_equal(bins_of(np.array([1.0, 1.2, 1.4, 5.0, 5.6]), 0.5), [0, 0, 0, 1, 2])
    assert instability_of(blocks(temp[:6], line(temp[:6], rng)), line(temp[:6], rng), np.full((6, 3), 1e-6)) is None


def test_the_state_of_the_loop_follows_the_temperature():
    temp = np.concatenate((np.arange(20.0, 60.0), np.arange(60.0, 19.0, -1.0)))
    made = blocks(temp, np.zeros((len(temp), 3)))
    state = cooling(made)
    assert state[0] == 0.0
    np.testing.assert_array_equal(state[2:40], -1.0)
    np.testing.assert_allclose(state[40:45], [-1.0, -0.5, 0.0, 0.5, 1.0])  # across 4 degC after the turn
    np.testing.assert_array_equal(state[45:], 1.0)
    assert both_ways(made, state)
    assert not both_ways(made.taken(slice(0, 40)), state[:40])


def test_few_blocks_on_the_way_down_do_not_pull_the_middle_curve():
    rng = np.random.default_rng(2)
    temp = np.concatenate((np.linspace(20.0, 60.0, 300), np.linspace(60.0, 40.0, 40)))
    made = blocks(temp, np.zeros((340, 3)))
    made = replace(made, gyro=line(temp, rng) + 0.05 * cooling(made)[:, None])
    fit = fit_static(made, nodes=NODES)
    np.testing.assert_allclose(fit.table.gyro_hysteresis, 0.05, atol=0.002)
    # the table is the middle of the loop: a reading lies half its width beside it
    assert (fit.table.gyro_uncertainty >= np.abs(fit.table.gyro_hysteresis)).all()
    np.testing.assert_allclose(fit.table.gyro_offset, line(NODES, rng, 0.0), atol=0.004)


@pytest.mark.slow
def test_sessions_on_several_days_give_the_scatter_of_the_switch_on():
    rng = np.random.default_rng(4)
    temp = np.linspace(20.0, 60.0, 120)
    shifts = rng.normal(size=(6, 3)) * 0.05
    parts = [blocks(temp, line(temp, rng) + shift, session=k) for k, shift in enumerate(shifts)]
    fit = fit_static(joined(*parts), nodes=NODES)
    turn_on = fit.gyro.curve.turn_on
    np.testing.assert_allclose(turn_on.shift, shifts - shifts.mean(axis=0), atol=0.003)
    np.testing.assert_allclose(np.sqrt(turn_on.variance), shifts.std(axis=0, ddof=1), rtol=0.1)
    assert (fit.table.gyro_uncertainty > 0.9 * shifts.std(axis=0, ddof=1)).all()
    off = np.abs(fit.table.gyro_offset - line(NODES, rng, 0.0)) / fit.table.gyro_uncertainty
    assert off.max() < 2.5
    alone = fit_static(parts[0], nodes=NODES)
    assert "drift.one_session" in {item.code for item in alone.verdict.findings}


def test_a_warm_up_that_goes_with_temperature_is_not_observable():
    time = 10.0 * np.arange(200)
    temp = 60.0 - 40.0 * np.exp(-time / 600.0)
    made = blocks(temp, 0.1 * np.exp(-time / 600.0)[:, None] * np.ones(3), time=time)
    with pytest.raises(NotObservable, match=r"temperature and time since power-on that differ, got 100\.0 %"):
        warm_up_time(made, made.gyro)
    table = warm_up_table(100.0, np.array([1.0, 2.0, 0.0]))
    assert table.power_on_s[0] == 0.0
    np.testing.assert_array_equal(table.gyro_offset[[0, -1]], [[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])


def test_the_notes_spline_goes_through_the_set_points():
    rng = np.random.default_rng(3)
    temp = np.repeat(np.arange(20.0, 61.0, 5.0), 12)
    made = blocks(temp, line(temp, rng))
    fit = fit_static(made, nodes=NODES, settings=StaticSettings(not_a_knot=True))
    means = np.array([made.gyro[temp == t].mean(axis=0) for t in np.unique(temp)])
    np.testing.assert_allclose(fit.table.gyro_offset[::5], means, atol=1e-9)


def test_blocks_that_tell_nothing_are_refused():
    temp = np.full(20, 25.0)
    with pytest.raises(NotObservable, match="wanted two temperatures or more"):
        fit_static(blocks(temp, line(temp, np.random.default_rng(0))), nodes=NODES)
    with pytest.raises(NotObservable, match="static drift: wanted readings at two temperatures or more, got none"):
        fit_static(blocks(temp, np.full((20, 3), np.nan)), nodes=NODES)


def test_two_plateaus_on_two_days_show_no_scatter_between_switch_ons_and_no_sweep():
    rng = np.random.default_rng(5)
    cold, hot = 13.0 + 0.3 * rng.normal(size=40), 48.0 + 0.3 * rng.normal(size=40)
    fit = fit_static(joined(blocks(cold, line(cold, rng)), blocks(hot, line(hot, rng), session=1)), nodes=NODES)
    turn_on = fit.gyro.curve.turn_on
    assert np.isnan(turn_on.variance).all()
    assert np.isnan(turn_on.shift).all()
    assert np.isfinite(fit.table.gyro_uncertainty).all()
    codes = [item.code for item in fit.verdict.findings]
    assert codes.count("drift.sessions_apart") == codes.count("drift.hysteresis_no_sweep") == 1
    assert "drift.hysteresis_one_way" not in codes


def test_a_session_that_shares_no_temperature_leaves_the_shifts_of_the_others_as_they_are():
    rng = np.random.default_rng(6)
    low, high = np.linspace(20.0, 35.0, 80), np.linspace(45.0, 60.0, 80)
    parts = [blocks(low, line(low, rng) + k * 0.04, session=k) for k in range(2)]
    fit = fit_static(joined(*parts, blocks(high, line(high, rng), session=2)), nodes=NODES)
    shift = fit.gyro.curve.turn_on.shift
    np.testing.assert_allclose(shift[1] - shift[0], 0.04, atol=0.002)
    np.testing.assert_allclose(shift[0] + shift[1], 0.0, atol=1e-12)
    assert np.isnan(shift[2]).all()
    np.testing.assert_allclose(np.sqrt(fit.gyro.curve.turn_on.variance), 0.04 / 2.0**0.5, rtol=0.1)


def test_two_sessions_that_agree_state_a_bound_instead_of_no_scatter():
    rng = np.random.default_rng(7)
    temp = np.linspace(20.0, 60.0, 120)
    same = line(temp, rng)
    swap = np.where(np.arange(120)[:, None] % 2 == 0, 1e-3, -1e-3)  # the means agree better than the noise lets them
    fit = fit_static(joined(blocks(temp, same + swap), blocks(temp, same - swap, session=1)), nodes=NODES)
    turn_on = fit.gyro.curve.turn_on
    assert turn_on.bounded.all()
    known = 1e-3 / 240.0**0.5  # of half the difference of two means of 120 blocks, white noise alone
    assert (np.sqrt(turn_on.variance) > known).all()
    assert (np.sqrt(turn_on.variance_to_come) > 6.0 * known).all()  # Student's 12.7 over 1.96
    # 97.5 % points by the tables: Student's with one degree of freedom 12.706, normal 1.960
    np.testing.assert_allclose(np.sqrt(turn_on.variance_to_come / turn_on.variance), 12.706 / 1.960, rtol=1e-3)
    assert (fit.table.gyro_uncertainty >= np.sqrt(turn_on.variance_to_come)).all()
    assert any(
        item.code == "drift.turn_on_bound" and item.values == {"sessions": 2, "axes": ("x", "y", "z")}
        for item in fit.verdict.findings
    )


def test_warming_and_cooling_over_different_temperatures_are_not_called_one_way():
    rng = np.random.default_rng(8)
    up, down = np.linspace(20.0, 38.0, 60), np.linspace(60.0, 40.0, 60)
    fit = fit_static(joined(blocks(up, line(up, rng)), blocks(down, line(down, rng), session=1)), nodes=NODES)
    assert any("warming and cooling share no 3 degC" in reason for reason in fit.verdict.reasons)
    one = fit_static(blocks(up, line(up, rng)), nodes=NODES)
    assert any("went one way only" in reason for reason in one.verdict.reasons)


def test_at_the_reference_temperature_an_accelerometer_is_as_uncertain_as_its_calibration():
    rng = np.random.default_rng(9)
    own = np.array([4e-6, 9e-6, 1e-6])  # variances of the offset, g squared
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.diag(own)
    model = TriadModel(
        method="six-face", unit_in="g", unit_out="m/s2", matrix=9.81 * np.eye(3), offset=np.zeros(3),
        covariance=covariance, rms_residual=0.0, count=6, rank=12, condition=1.0, valid_range=(-20.0, 20.0),
    )  # fmt: skip
    calibration = replace(device(), accel=model, gyro=None, reference_temp_c=40.0)
    temp = np.linspace(20.0, 60.0, 80)
    accel = [0.0, 0.0, 1.0] + 1e-3 * rng.normal(size=(80, 3))
    fit = fit_static(blocks(temp, line(temp, rng), accel=accel), nodes=NODES, calibration=calibration)
    stated = fit.accel.curve_uncertainty**2
    # there the change since the reference is none: the curve is subtracted from itself, and its error with it
    np.testing.assert_allclose(stated[NODES == 40.0][0], own, rtol=1e-6)
    # elsewhere the noise of 80 blocks, 1e-3 each, counts beside it: of the mean alone (1e-3)^2 / 80
    away = np.abs(NODES - 40.0) > 10.0
    assert (stated[away] > own + 1e-6 / 80.0).all()


def test_the_notes_spline_has_what_the_set_points_share_from_pose_to_pose():
    rng = np.random.default_rng(10)
    temp = np.repeat(np.arange(20.0, 61.0, 5.0), 40)
    pose = np.tile(np.repeat(np.arange(4), 10), 9)
    seat = 0.05 * rng.normal(size=(4, 3))  # what each of four poses adds at every temperature
    made = replace(blocks(temp, line(temp, rng) + seat[pose]), pose=pose)
    fit = fit_static(made, nodes=NODES, settings=StaticSettings(not_a_knot=True))
    # the mean of four poses keeps half their scatter, which averages no further over the set-points
    assert (fit.table.gyro_uncertainty > 0.5 * 0.5 * 0.05).all()
    alone = fit_static(blocks(temp, line(temp, rng)), nodes=NODES, settings=StaticSettings(not_a_knot=True))
    assert (alone.table.gyro_uncertainty < 0.005).all()


def test_a_face_that_was_mounted_anew_at_one_temperature_does_not_bend_the_accelerometers_table():
    rng, temp, calibration = np.random.default_rng(2), np.repeat([20.0, 40.0, 60.0], 20), device(unit="rad/s")

    def lying(temp_c, number, force):
        moved = 0.003 * (temp_c[:, None] - 40.0) * [1.0, 0.5, -1.0] + 1e-3 * rng.normal(size=(len(temp_c), 3))
        accel = calibration.accel.offset + moved + calibration.accel.forward_matrix @ force
        made = blocks(
            temp_c, np.zeros((len(temp_c), 3)), accel=accel, time=1000.0 * number + 10.0 * np.arange(len(temp_c))
        )
        return replace(made, mounting=np.full(len(temp_c), number, np.int64))

    level, off = np.array([0.0, 0.0, 9.81]), np.array([0.03, -0.02, 9.81])  # 0.2 deg off level
    fits = [
        fit_static(joined(*parts), nodes=NODES, calibration=calibration).table.accel_offset
        for parts in ((lying(np.full(10, 30.0), 0, off), lying(temp, 1, level)), (lying(temp, 1, level),))
    ]
    show("difference that a face makes that was mounted anew, raw unit", float(np.abs(fits[0] - fits[1]).max()))
    np.testing.assert_allclose(fits[0], fits[1], atol=2e-3)
