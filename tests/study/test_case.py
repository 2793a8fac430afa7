"""Runs of a study: many sessions fitted at once, against the fits of one; the same draws for all; the delay that is found."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.stats import ttest_1samp

from testkit.data import show
from testkit.surfaces import candidates
from undrift.correction.correct import correct_whole
from undrift.fit.curve import not_a_knot
from undrift.fit.least_squares import fit_paper
from undrift.model import Calibration, DriftTables, DynamicDrift, StaticDrift
from undrift.orientation import OrientSettings, orient_unchecked, sagittal_pitch
from undrift.programme import Protocol
from undrift.record import Still
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.effects import Offset
from undrift.sim.device.model import device_json
from undrift.sim.device.presets import preset
from undrift.sim.table_sessions import FACE, RATE, REST, ROOM_TEMP_C, Sessions, joined
from undrift.study.case import (
    BenchReadings,
    NoteFits,
    Unit,
    device_of,
    faces_of,
    fit_as_the_note,
    make_case,
    perform,
    pitch_error,
    run_unit,
    session_of,
    simulate_turns,
    trial_errors,
    units_of,
)
from undrift.study.plan import Space, Study, StudyTask, note_study
from undrift.study.space import Setting
from undrift.units import STANDARD_GRAVITY

DPS = np.pi / 180.0
SPACE = Space(
    cutoff_hz=(5.0, 20.0),
    turn_rate_step=(10.0 * DPS, 20.0 * DPS),
    turn_rate_min=(5.0 * DPS, 10.0 * DPS),
    turn_rate_max=(45.0 * DPS, 50.0 * DPS, 90.0 * DPS),
)


def study(temperatures: tuple[float, ...] = (18.0, 36.0, 54.0, 75.0), name: str = "sit_to_stand") -> Study:
    base = Protocol(grid="paper", dwell_s=1.0, bracket_s=3.0, temperatures_c=temperatures)
    return Study(name="small", device="enc03j_3031", tasks=(StudyTask(name=name, space=SPACE, base=base),), subjects=4)


def calibrated_slowly(
    sessions: Sessions, readings: BenchReadings, fits: NoteFits, number: int, accel: object
) -> Calibration:
    """The note's fit of one session, step by step with the fits of the product."""
    rows = np.arange(sessions.first[number], sessions.first[number + 1])
    soaks = [rows[sessions.soak[rows] == k] for k in range(int(sessions.soak.max()) + 1)]
    rest = [own[sessions.kind[own] == REST] for own in soaks]
    turn = [own[sessions.kind[own] == RATE] for own in soaks]
    temps = np.array([readings.temp_c[own].mean() for own in rest])
    offsets = np.array([readings.gyro[own].mean(axis=0) for own in rest])
    home = int(np.argmin(np.abs(temps - ROOM_TEMP_C)))
    rates = readings.rate[:, None] * np.eye(3)[sessions.axis]
    own = turn[home]
    seen = readings.gyro[own] - offsets[home]
    fit = fit_paper(rates[own], seen, None, method="rate-table/paper", unit_in="count", unit_out="rad/s")
    gyro = replace(fit.model, offset=offsets[home])
    drift = None
    if len(temps) > 1:
        nodes = fits.top[number] * np.linspace(-1.0, 1.0, 2 * fits.half[number] + 1)
        error = np.zeros((len(temps), len(nodes), 3))
        for k, own in enumerate(turn):
            measured = (readings.gyro[own] - offsets[k]) @ gyro.matrix.T
            for axis in range(3):
                there = sessions.axis[own] == axis
                x = np.append(measured[there, axis], 0.0)
                y = np.append(measured[there, axis] - rates[own][there, axis], 0.0)
                order = np.argsort(x)
                curve = CubicSpline(x[order], y[order], bc_type="not-a-knot")
                error[k, :, axis] = curve(np.clip(nodes, x.min(), x.max()))
        over = CubicSpline(temps, error, axis=0, bc_type="not-a-knot")
        table = over(np.clip(fits.dynamic_c, temps[0], temps[-1]))
        offset = not_a_knot(temps, offsets, np.ones_like(offsets), fits.static_c).value
        drift = DriftTables(
            static=StaticDrift(temp_c=fits.static_c, gyro_offset=offset),
            dynamic=DynamicDrift(temp_c=fits.dynamic_c, turn_rate=nodes, error=table),
        )
    return Calibration(
        device="",
        reference_temp_c=float(temps[home]),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=gyro,
        accel=accel,  # type: ignore[arg-type]
        drift=drift,
    )


@pytest.mark.parametrize("temperatures", [(18.0, 36.0, 54.0, 75.0), (20.0, 40.0, 60.0), (20.0, 45.0), ()])
def test_many_sessions_fitted_at_once_leave_the_errors_of_each_fitted_alone(temperatures: tuple[float, ...]) -> None:
    made = study(temperatures)
    task, cutoff = made.tasks[0], 20.0
    protocols, case = candidates(task, cutoff), make_case(made, task, 1, Setting(cutoff))
    every = joined([session_of(protocol) for protocol in protocols])
    accel = faces_of(made, case.device, 1, session_of(protocols[0]).chosen(FACE))
    sessions = every.chosen(REST, RATE)
    readings = simulate_turns(made, task.base, case.device, 1, sessions)
    fits = fit_as_the_note(sessions, readings, np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]))
    found = trial_errors(case, [accel] * len(fits.good), fits, "none")
    assert len(found) == len(protocols) >= 6
    for number in range(len(protocols)):
        calibration = calibrated_slowly(sessions, readings, fits, number, accel)
        wanted = [figures_of(pitch_error(each, calibration)) for each in (replace(case, pitch=case.pitch_now), case)]
        np.testing.assert_allclose(
            found[number], np.ravel(wanted), rtol=1e-6
        )  # sums in another order, over 1,500 samples


@pytest.mark.parametrize("temperatures", [(18.0, 36.0, 54.0, 75.0), ()])
def test_the_offset_of_the_rest_is_what_the_corrected_readings_show_before_the_motion(
    temperatures: tuple[float, ...],
) -> None:
    made = study(temperatures)
    task, protocols = made.tasks[0], candidates(made.tasks[0], 20.0)[:2]
    case = make_case(made, task, 1, Setting(20.0))
    sessions = joined([session_of(protocol) for protocol in protocols]).chosen(REST, RATE)
    accel = faces_of(made, case.device, 1, session_of(protocols[0]).chosen(FACE))
    readings = simulate_turns(made, task.base, case.device, 1, sessions)
    fits = fit_as_the_note(sessions, readings, np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]))
    found, drifting = (trial_errors(case, [accel] * len(fits.good), fits, offset) for offset in ("rest", "none"))
    for number in range(len(protocols)):
        corrected = correct_whole(
            case.record, calibrated_slowly(sessions, readings, fits, number, accel), policy="hold"
        ).record
        assert corrected.gyro is not None
        still = Still(start=case.still[0], stop=case.still[1])
        zeroed = replace(corrected, gyro=corrected.gyro - corrected.gyro[still.start : still.stop].mean(axis=0))
        error = (orient_unchecked(zeroed, still).pitch - case.pitch)[slice(*case.moving)]
        # the mean of the corrected readings against that of the readings, corrected: tables bend little over their noise
        np.testing.assert_allclose(found[number, 3:], figures_of(error), rtol=1e-3)
        show("rms offline, deg, rest and none", found[number, 3] / DPS, drifting[number, 3] / DPS)
    assert (found[:, 3] < 0.7 * drifting[:, 3]).all()


@pytest.mark.parametrize(("name", "long_enough"), [("posturography", True), ("sit_to_stand", False)])
def test_the_offset_from_motion_is_that_of_orient_and_a_trial_below_20_s_keeps_the_rest(
    name: str, long_enough: bool
) -> None:
    made = study((18.0, 36.0, 54.0), name)
    task, protocols = made.tasks[0], candidates(made.tasks[0], 20.0)[:2]
    case = make_case(made, task, 1, Setting(20.0))
    sessions = joined([session_of(protocol) for protocol in protocols]).chosen(REST, RATE)
    accel = faces_of(made, case.device, 1, session_of(protocols[0]).chosen(FACE))
    readings = simulate_turns(made, task.base, case.device, 1, sessions)
    fits = fit_as_the_note(sessions, readings, np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]))
    found, rested = (trial_errors(case, [accel] * len(fits.good), fits, offset) for offset in ("motion", "rest"))
    if not long_enough:
        np.testing.assert_array_equal(found, rested)
        return
    for number in range(len(protocols)):
        calibration = calibrated_slowly(sessions, readings, fits, number, accel)
        done = correct_whole(case.record, calibration, policy="hold").record
        still = Still(start=case.still[0], stop=case.still[1])
        oriented = orient_unchecked(done, still, OrientSettings(offset="motion"))
        error = (oriented.pitch - case.pitch)[slice(*case.moving)]
        np.testing.assert_allclose(found[number, 3:], figures_of(error), rtol=1e-6)
        show("rms offline, deg, motion and rest", found[number, 3] / DPS, rested[number, 3] / DPS)
    assert (found[:, 3] < rested[:, 3]).all()


def figures_of(error: np.ndarray) -> tuple[float, float, float]:
    """Root mean square, maximum and end of an error at 100 Hz, rad, where it is known."""
    size = np.abs(error)
    return float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(size)), float(np.abs(np.nanmedian(error[-50:])))


def test_errors_are_counted_where_the_truth_is_known_and_not_round_the_circle() -> None:
    made = study(())
    task = made.tasks[0]
    case, protocols = make_case(made, task, 0, Setting(20.0)), candidates(task, 20.0)[:1]
    sessions = joined([session_of(protocol) for protocol in protocols]).chosen(REST, RATE)
    readings = simulate_turns(made, task.base, case.device, 0, sessions)
    fits = fit_as_the_note(sessions, readings, np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]))
    accel = faces_of(made, case.device, 0, session_of(protocols[0]).chosen(FACE))
    calibration = calibrated_slowly(sessions, readings, fits, 0, accel)
    holed = case.pitch.copy()
    holed[case.moving[0] + 20 :: 3] = np.nan
    (found,) = trial_errors(
        replace(case, pitch_now=holed, pitch=case.pitch + 2.0 * np.pi), [accel] * len(fits.good), fits, "none"
    )
    np.testing.assert_allclose(found[:3], figures_of(pitch_error(replace(case, pitch=holed), calibration)), rtol=1e-6)
    np.testing.assert_allclose(found[3:], figures_of(pitch_error(case, calibration)), rtol=1e-6)
    holed[case.moving[1] - 50 :] = np.nan
    (ended,) = trial_errors(replace(case, pitch_now=holed), [accel] * len(fits.good), fits, "none")
    assert np.isnan(ended[2])
    assert np.isfinite(ended[:2]).all()
    lost = trial_errors(
        replace(case, pitch_now=np.full_like(case.pitch, np.nan)), [accel] * len(fits.good), fits, "none"
    )[0]
    assert np.isnan(lost[:3]).all()


def test_a_delay_costs_in_real_time_and_not_once_it_is_taken_out() -> None:
    made = study()
    task = made.tasks[0]
    for cutoff in (5.0, 20.0):
        unit = next(unit for unit in units_of(made) if unit.subject == 1 and unit.setting.cutoff_hz == cutoff)
        runs, case = run_unit(unit), make_case(made, task, 1, Setting(cutoff))
        rate = np.gradient(case.pitch_now, 0.01)[slice(*case.moving)]
        wanted = case.delay_s * float(np.sqrt(np.nanmean(rate**2))) / DPS
        show(f"real time at {cutoff:g} Hz, deg rms", runs["error_rms_deg"][0], f"delay times rate {wanted:.3f}")
        # beside the delay there is what is left offline, at random to it
        left = runs["error_offline_rms_deg"][0]
        assert abs(runs["error_rms_deg"][0] ** 2 - left**2) ** 0.5 == pytest.approx(wanted, abs=left)
        assert runs["error_rms_deg"][0] > 1.5 * left or cutoff > 5.0
        # at its end the body is at rest: no delay to see
        assert runs["error_end_deg"][0] == pytest.approx(runs["error_offline_end_deg"][0], abs=0.02)


def test_a_dwell_has_the_same_draws_in_every_protocol_that_has_it() -> None:
    made = study()
    device, protocols = device_of(made, 0), candidates(made.tasks[0], 5.0)
    sessions = joined([session_of(protocol) for protocol in protocols]).chosen(REST, RATE)
    read = simulate_turns(made, made.tasks[0].base, device, 0, sessions)
    of = np.repeat(np.arange(len(protocols)), np.diff(sessions.first))
    top = 45.0 * DPS
    same = np.abs(sessions.rate - top) < 1e-9
    same &= (sessions.axis == 1) & (sessions.soak == 2)
    assert len(np.unique(of[same])) > 1
    rows = np.flatnonzero(same)
    # the white noise is common: what is left is drift over another time
    assert np.ptp(read.gyro[rows, 1]) < 0.3 * np.ptp(read.gyro[sessions.kind == REST, 1])
    alone = session_of(protocols[0]).chosen(REST, RATE)
    again = simulate_turns(made, made.tasks[0].base, device, 0, alone)
    np.testing.assert_array_equal(again.gyro, read.gyro[: sessions.first[1]])  # whatever else is simulated with it


def test_a_bench_without_a_chamber_has_no_soaks_that_err() -> None:
    steady = study(())
    shaken = replace(steady, bench=replace(steady.bench, soak_k=20.0, board_lag_s=6000.0))
    np.testing.assert_array_equal(*(run_unit(units_of(one)[0])["error_rms_deg"] for one in (steady, shaken)))
    warm = replace(shaken, tasks=study().tasks)
    assert (run_unit(units_of(warm)[0])["error_rms_deg"] != run_unit(units_of(study())[0])["error_rms_deg"]).all()


def test_protocols_differ_by_what_is_tried_alone_in_a_part_of_the_search_too() -> None:
    unit = units_of(study())[0]
    whole = run_unit(unit)
    few = tuple(unit.task.space.grids())[1:3]
    part = run_unit(replace(unit, task=replace(unit.task, space=replace(unit.task.space, only=few))))
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][1:3])


@pytest.mark.parametrize(("name", "within_ms"), [("sit_to_stand", 2.0), ("step", 2.0), ("posturography", 5.0)])
def test_the_delay_that_is_found_is_that_of_the_filter(name: str, within_ms: float) -> None:
    """Known to the test alone: the flow has the readings and the poses."""
    made = replace(note_study(subjects=3), name="delay")
    task = next(one for one in made.tasks if one.name == name)
    for cutoff in (5.0, 20.0):
        case = make_case(made, task, 0, Setting(cutoff))
        low_pass = case.device.gyro.low_pass
        assert low_pass is not None
        wanted = float(low_pass.group_delay_s[1]) - 0.005  # about the axis of the pitch; strapdown holds half a sample
        show(f"{name} at {cutoff:g} Hz: delay found, ms", 1e3 * case.delay_s, f"{1e3 * wanted:.1f}")
        assert case.delay_s == pytest.approx(wanted, abs=1e-3 * within_ms)
        moved = sagittal_pitch(perform(made, task, 0)[0].at(case.record.time - case.delay_s, STANDARD_GRAVITY).q_nb)
        np.testing.assert_allclose(case.pitch[10:], moved[10:], atol=1e-4 * DPS)  # the truth is as late


def test_parts_of_a_unit_differ_from_subject_to_subject_and_not_from_cut_off_to_cut_off() -> None:
    made = study()
    chains = [
        make_case(made, made.tasks[0], subject, Setting(cutoff)).device.gyro
        for subject, cutoff in ((0, 5.0), (0, 20.0), (1, 5.0))
    ]
    amplifiers, converters = zip(*((chain.amplifier, chain.adc) for chain in chains), strict=True)
    for parts in (
        [one.gain for one in amplifiers],
        [one.null for one in amplifiers],
        [one.reference for one in converters],
    ):
        assert parts[0] == parts[1] != parts[2]
        assert parts[0] == pytest.approx(parts[2], rel=0.08)  # 1 % each
    ratios = [chain.low_pass.cutoff_hz / cutoff for chain, cutoff in zip(chains, (5.0, 20.0, 5.0), strict=True)]
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=1e-12)
    assert np.abs(ratios[0] - 1.0).max() > 1e-4  # what the channels share stays too
    worn = replace(made, worn=quiet_device())
    assert (
        make_case(worn, worn.tasks[0], 1, Setting(5.0)).device.gyro.amplifier.gain
        == preset("enc03j_3031").gyro.amplifier.gain
    )


def test_a_session_without_rests_calibrates_nothing() -> None:
    made = study()
    task = replace(made.tasks[0], base=replace(made.tasks[0].base, bracket_s=0.0))
    runs = run_unit(Unit(study=replace(made, tasks=(task,)), task=task, subject=0, setting=Setting(5.0)))
    assert np.isnan(runs["error_rms_deg"]).all()
    assert (runs["rig_minutes"] > 0.0).all()


def quiet_device() -> str:
    """A device that the bench alone can be blamed for."""
    made = preset("enc03j_3031")
    bare = dict.fromkeys(
        ("white_noise", "instability", "adc", "warm_up", "hysteresis", "g_sensitivity", "nonlinearity", "rate_drift")
    )
    chains = {
        name: replace(getattr(made, name), **bare, thermal_scale=None, offset=Offset(constant=np.full(3, 0.01)))
        for name in ("gyro", "accel")
    }
    return json.dumps(device_json(replace(made, **chains)))


@pytest.mark.slow
@pytest.mark.parametrize("bench", [BenchErrors(), BenchErrors(mount_tilt=1.0 * DPS), BenchErrors(encoder_lines=53)])
def test_rates_average_what_a_planted_bench_does_wrong_from_dwell_to_dwell(bench: BenchErrors) -> None:
    base = Protocol(grid="paper", dwell_s=1.1, bracket_s=3.0)  # no rate turns by whole counts in it
    few, many = (40.0 * DPS, 10.0 * DPS, 90.0 * DPS), (5.0 * DPS, 10.0 * DPS, 90.0 * DPS)  # 2 rates and 16
    steps = (few[0], many[0])
    space = Space(
        cutoff_hz=(20.0,), turn_rate_step=steps, turn_rate_min=few[1:2], turn_rate_max=few[2:], only=(few, many)
    )
    task = StudyTask(name="sit_to_stand", space=space, base=base)
    planted = Study(name="planted", device="quiet", worn=quiet_device(), tasks=(task,), subjects=60, bench=bench)
    errors = np.array(
        [run_unit(unit)["error_offline_rms_deg"] for unit in units_of(planted)]
    )  # a delay is alike in both
    (fewer, more), apart = errors.T.mean(axis=1), errors[:, 1] - errors[:, 0]
    show("2 rates, deg rms", fewer, f"16 rates {more:.4f}")
    if not bench.encoder_lines:
        assert np.abs(apart).max() < 0.002  # deg: a mounting is the same for all rates, so nothing is left to average
        return
    assert fewer > 0.01
    # scale errors of 1 and 1 / 2.2: of their sizes' paired difference t is 5 for 60 subjects
    assert ttest_1samp(apart, 0.0, alternative="less").pvalue < 1e-3
    assert more < 0.8 * fewer  # 1 / 2.2 were it all of the error
