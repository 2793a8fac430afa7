"""One device of a study: its errors in a trial, its fits, shipped fits, and failed fits that are counted."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.ship_fits import write_fits

from testkit.data import show
from undrift import OrientSettings, correct, orient
from undrift.errors import InputError, NotObservable
from undrift.model import DriftTables, DynamicDrift, ScaleDrift, StaticDrift
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import draw_task
from undrift.study import run as run_module
from undrift.study.case import (
    EFFECTS,
    device_without,
    make_case,
    pitch_delay_s,
    pitch_errors_deg,
    simulate_worn,
    with_cutoff,
)
from undrift.study.plan import Study, StudyTask
from undrift.study.run import CHECKED, StudyDevice, agrees, run_chosen, with_checked_fits
from undrift.study.sessions import ROOM_TEMP_C, SESSIONS
from undrift.study.shipped import FILE, agree, pack, shipped_fits, unpack

DEVICE = with_cutoff(preset("enc03j_3031"), 11.1)
TASK = draw_task("sit_to_stand", rng=np.random.default_rng(5), rest_s=6.0)


def case_of(device, temp_c=25.0, **more):
    return make_case(simulate_worn(device, TASK, temp_c=temp_c, rng=np.random.default_rng(1)), **more)


def test_an_exact_calibration_at_its_temperature_leaves_noise():
    aligned, now, largest = pitch_errors_deg(case_of(DEVICE), [true_calibration(DEVICE, temp_c=25.0)], "rest")[0]
    show("exact calibration: rms aligned, real time, largest, deg", (aligned, now, largest))
    assert aligned < 0.15  # 12 bits, and half of the hysteresis over 3 s
    assert now > 2.0 * aligned  # 15 ms at up to 90 deg/s
    assert aligned <= largest


def test_pitch_is_the_one_that_correct_and_orient_return():
    calibration = true_calibration(DEVICE, temp_c=27.0)
    case = case_of(DEVICE)
    pitch = orient(correct(case.record, calibration, policy="hold"), case.still, OrientSettings(offset="rest")).pitch
    error = np.degrees(pitch - case.pitch)[case.moving]
    assert pitch_errors_deg(case, [calibration], "rest")[0, 0] == pytest.approx(np.sqrt(np.nanmean(error**2)), abs=1e-9)


def test_the_delay_is_that_of_the_filter_minus_half_a_sample():
    share = np.median(DEVICE.gyro.low_pass.cutoff_hz) / DEVICE.gyro.low_pass.cutoff_hz[1]  # tolerance of the parts
    for cutoff_hz in (5.0, 20.0):
        expected = share * np.sqrt(2.0) / (2.0 * np.pi * cutoff_hz) - 0.005  # Butterworth of second order, 100 Hz
        assert pitch_delay_s(with_cutoff(DEVICE, cutoff_hz)) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_that_is_switched_off_leaves_the_other_draws(effect):
    device = device_without(DEVICE, effect)
    one, other = case_of(DEVICE).record, case_of(device).record
    changed = not np.array_equal(one.gyro, other.gyro) or not np.array_equal(one.accel, other.accel)
    assert changed == (effect not in ("delay", "assumed figures"))
    if effect == "gyroscope offset":
        assert np.array_equal(one.accel, other.accel)


CHOSEN = (("sit_to_stand", "hand"),)


def failing(error):
    def calibrate(*given, **stated):
        raise error

    return calibrate


def test_failed_fit_is_a_run_without_an_error(monkeypatch):
    monkeypatch.setattr(run_module, "calibrate_before_soaks", failing(NotObservable("no turn")))
    assert [np.isnan(run.rms_deg) for run in run_chosen(STUDY, CHOSEN, 0)] == [True]


def test_wrong_call_is_not_hidden(monkeypatch):
    monkeypatch.setattr(run_module, "calibrate_before_soaks", failing(InputError("no such mode")))
    with pytest.raises(InputError, match="no such mode"):
        run_chosen(STUDY, CHOSEN, 0)


STUDY = Study(tasks=(StudyTask(name="sit_to_stand"),), sessions=(SESSIONS["hand"],))
HAND = SESSIONS["hand"]
TEMP_C = np.arange(18.0, 75.5, 0.5)


@pytest.fixture(scope="module")
def device():
    return StudyDevice(STUDY, 0)


def with_tables(calibration):
    bend = 1.0 + 1e-3 * (TEMP_C - 25.0) + 2e-5 * (TEMP_C - 25.0) ** 2
    rate = np.linspace(-1.6, 1.6, 9)
    error = 1e-3 * np.sin(0.1 * TEMP_C[::4, None, None]) * rate[:, None] * np.ones(3)
    return replace(
        calibration,
        drift=DriftTables(
            static=StaticDrift(temp_c=TEMP_C, gyro_offset=bend[:, None] * calibration.gyro.offset),
            scale=ScaleDrift(temp_c=TEMP_C, gyro_matrix=bend[:, None, None] * calibration.gyro.matrix),
            dynamic=DynamicDrift(temp_c=TEMP_C[::4], turn_rate=rate, error=error),
        ),
    )


def test_a_fit_from_the_file_leaves_the_same_error(device, tmp_path, monkeypatch):
    for calibration in (device.calibration(HAND), with_tables(device.calibration(HAND))):
        write_fits({7: pack(calibration)}, {"seed": "0"}, tmp_path / "fits.parquet")
        monkeypatch.setattr("undrift.study.shipped.FILE", tmp_path / "fits.parquet")
        shipped_fits.cache_clear()
        read = unpack(shipped_fits()[7], device.worn, ROOM_TEMP_C)
        shipped_fits.cache_clear()
        (case,) = device.cases(STUDY.tasks[0])
        for offset in ("rest", "none"):
            errors = pitch_errors_deg(case, [calibration, read], offset)
            np.testing.assert_allclose(*errors, atol=1e-3)  # deg: a hundredth of the margin


def test_a_failed_fit_is_shipped_as_failed(device):
    assert unpack(pack(None), device.worn, ROOM_TEMP_C) is None
    assert not agree(pack(None), pack(device.calibration(HAND)))


def test_a_key_depends_on_seed_bench_device_and_session(device):
    bench = STUDY.bench.but(level_deg=0.5)
    others = [
        StudyDevice(replace(STUDY, seed=1), 0), StudyDevice(replace(STUDY, bench=bench), 0), StudyDevice(STUDY, 1),
        StudyDevice(STUDY.other(), 0),
    ]  # fmt: skip
    keys = {each.key(HAND) for each in (device, *others)} | {device.key(SESSIONS["hand, warm"]), device.key("optics")}
    assert len(keys) == 7
    assert device.key(replace(HAND, name="mine")) == device.key(HAND)
    assert StudyDevice(replace(STUDY, fit="paper"), 0).key(HAND) == device.key(HAND)  # turns by hand have one fit


@pytest.mark.slow
def test_stale_fits_are_refused(monkeypatch):
    device = StudyDevice(STUDY, 0)
    fit = pack(device.calibration(CHECKED))
    for factor in (1.0, 1.01):
        shipped = {name: factor * array for name, array in fit.items()}
        monkeypatch.setattr(run_module, "shipped_fits", lambda shipped=shipped: {device.key(CHECKED): shipped})
        assert with_checked_fits(STUDY, map).shipped is (factor == 1.0)
    assert not with_checked_fits(replace(STUDY, offset="motion"), map).shipped  # needs uncertainties


@pytest.mark.skipif(not FILE.exists(), reason="no fits in the package: python -m benchmarks.ship_fits makes them")
@pytest.mark.parametrize("fit", ["product", "paper"])
@pytest.mark.parametrize("session", SESSIONS.values(), ids=lambda session: session.name)
def test_the_fits_in_the_package_are_those_of_this_version(session, fit):
    study = replace(STUDY, device="xsens_mti1" if session.kind == "motion" else STUDY.device, fit=fit)
    assert StudyDevice(study, 0).key(session) in shipped_fits()
    assert agrees(study, session)
