"""Trials of a worn sensor: a planted case in which a filter must win and one in which it must not; sampling rate and bits."""

import json
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.rig.programme import Protocol
from undrift.sim.device.model import device_json
from undrift.sim.device.presets import preset
from undrift.sim.motion.worn import WornErrors, wear_on_skin
from undrift.study.case import EFFECTS, device_of, effects_of_study, make_case, perform
from undrift.study.judge import Optimum, find_optimum
from undrift.study.outcome import split_findings, split_study
from undrift.study.plan import Space, Study, StudyTask, Timing
from undrift.study.run import InProcess, TaskSurface, run_study
from undrift.study.space import Setting
from undrift.study.target import REMEDIES

DPS = np.pi / 180.0
CUTOFFS = (5.0, 8.0, 14.0, 20.0, 45.0)
# Above what is measured at the low back: heavy feet set a sensor ringing at 16 Hz, damped as little as on foam; it stays in range
RINGING = WornErrors(tissue=0.1 * DPS, tissue_hz=16.0, tissue_damping=0.05, impact=1.1 * 9.81)
BELOW_HZ = 12.0  # the cut-off that the ringing must choose is below: three quarters of its resonance


def study(trial: WornErrors, timing: Timing = "offline", **further: tuple[float, ...]) -> Study:
    space = Space(
        cutoff_hz=further.pop("cutoff_hz", CUTOFFS),
        turn_rate_step=(20.0 * DPS,),
        turn_rate_min=(10.0 * DPS,),
        turn_rate_max=(50.0 * DPS,),
        further=tuple(further.items()),
    )
    task = StudyTask(name="step", space=space, base=Protocol(dwell_s=2.0, temperatures_c=(30.0, 45.0)))
    return Study(name="worn", device="enc03j_3031", tasks=(task,), subjects=12, timing=timing, trial=trial)


def optimum_of(plan: Study, folder: object) -> tuple[TaskSurface, Optimum]:
    (surface,) = run_study(plan, InProcess(), folder)  # type: ignore[arg-type]
    optimum = find_optimum(surface, plan)
    show(f"{plan.trial.tissue / DPS:g} {plan.timing}", np.round(surface.aimed(plan).mean(axis=0), 3))
    return surface, optimum


@pytest.mark.slow
def test_soft_tissue_that_rings_chooses_a_cut_off_below_its_resonance(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan = study(RINGING)
    surface, optimum = optimum_of(plan, tmp_path)
    for number in range(plan.subjects):  # no rate is beyond the rails
        turns = wear_on_skin(perform(plan, plan.tasks[0], number)[0], RINGING, np.random.default_rng(0), 9.81).rate_b
        assert np.abs(turns).max() < device_of(plan, number).gyro.full_scale
    assert float(surface.cutoff_hz[optimum.best]) < BELOW_HZ
    assert "cutoff_hz" in optimum.deciding
    mean = surface.aimed(plan).mean(axis=0)
    assert mean[-1] > mean.min() + plan.margin_deg  # no filter to speak of is worse by more than what matters
    ((split, *_),), _ = split_study(plan, (surface,), (optimum,), InProcess())
    assert {"soft tissue", "impacts"} <= {term.effect for term in split.terms}
    assert "vibration" not in {term.effect for term in split.terms}


@pytest.mark.slow
def test_where_no_filter_is_tried_the_findings_say_that_tissue_and_impacts_make_the_error(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan = study(RINGING, cutoff_hz=(30.0, 45.0))
    surface, optimum = optimum_of(plan, tmp_path)
    (splits,), _ = split_study(plan, (surface,), (optimum,), InProcess())
    first, second, *_ = splits[0].terms
    assert {first.effect, second.effect} == {"soft tissue", "impacts"}  # one makes the other: each takes nearly all
    assert min(first.share, second.share) > 0.5
    text = split_findings(splits)[0].text
    assert "soft tissue" in text
    assert "impacts" in text


@pytest.mark.slow
@pytest.mark.parametrize("trial", [WornErrors(), WornErrors(impact=9.81)])
def test_a_sensor_that_is_fixed_to_the_bone_needs_no_filter(tmp_path, trial: WornErrors) -> None:  # type: ignore[no-untyped-def]
    surface, optimum = optimum_of(study(trial), tmp_path)
    assert "cutoff_hz" not in optimum.deciding
    assert not surface.at_end(45.0, "cutoff_hz")  # 45 of 50 Hz ends by itself
    highest = int(np.argmax(surface.cutoff_hz))
    assert highest == optimum.best or bool(optimum.equivalent[highest])


@pytest.mark.slow
def test_a_vibration_that_aliases_wants_a_cut_off_or_a_higher_sampling_rate(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan = study(WornErrors(vibration=50.0 * DPS, vibration_hz=95.0), "real time", sample_rate_hz=(100.0, 200.0))
    surface, _ = optimum_of(plan, tmp_path)
    mean, rate_hz = surface.aimed(plan).mean(axis=0), surface.further["sample_rate_hz"]
    slow, fast = mean[rate_hz == 100.0], mean[rate_hz == 200.0]
    # real time at 100 Hz: what aliases to 5 Hz on one side, the delay of the filter on the other
    assert CUTOFFS[int(slow.argmin())] not in (CUTOFFS[0], CUTOFFS[-1])
    assert surface.at_end(45.0, "cutoff_hz")  # samples of 200 Hz can have more
    assert fast[-1] < 0.75 * slow[-1]  # at 200 Hz it is read as it is, and integrates to next to nothing


@pytest.mark.slow
def test_a_coarse_converter_costs_accuracy_and_a_fine_one_does_not(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan = study(WornErrors(), "real time", cutoff_hz=(20.0,), bits=(6.0, 12.0, 16.0))
    surface, _ = optimum_of(plan, tmp_path)
    mean = surface.aimed(plan).mean(axis=0)
    assert mean[0] > 1.5 * mean[1]
    assert mean[2] == pytest.approx(mean[1], rel=0.2)


def test_a_trial_is_sampled_as_it_is_set_and_keeps_the_bones_pitch_as_the_truth() -> None:
    plan = study(replace(RINGING, impact=0.0))
    task = plan.tasks[0]
    slow, fast, plain = (make_case(plan, task, 0, Setting(20.0, sample_rate_hz=rate)) for rate in (50.0, 400.0, None))
    for case, rate in ((slow, 50.0), (fast, 400.0), (plain, 100.0)):
        assert case.sample_rate_hz == rate == pytest.approx(case.record.sample_rate_hz)
        assert case.record.time[case.moving[0]] == pytest.approx(plain.record.time[plain.moving[0]], abs=0.02)
    np.testing.assert_allclose(fast.pitch_now[::8], slow.pitch_now[: len(fast.pitch_now[::8])], atol=1e-9)
    fixed = make_case(study(WornErrors()), task, 0, Setting(20.0))
    np.testing.assert_allclose(plain.pitch_now[: len(fixed.pitch_now)], fixed.pitch_now, atol=1e-9)
    assert make_case(plan, task, 0, Setting(20.0, bits=9.0)).device.gyro.adc.bits == 9  # type: ignore[union-attr]


def test_effects_of_wearing_are_split_where_a_study_has_them_and_have_a_remedy() -> None:
    assert effects_of_study(study(WornErrors())) == EFFECTS
    assert effects_of_study(study(replace(RINGING, vibration=1.0)))[len(EFFECTS) :] == (
        "soft tissue",
        "impacts",
        "vibration",
    )
    assert {"soft tissue", "impacts", "vibration"} <= set(REMEDIES)


def test_bits_of_a_device_without_a_converter_are_refused() -> None:
    bare = preset("enc03j_3031")
    bare = replace(bare, gyro=replace(bare.gyro, adc=None), accel=replace(bare.accel, adc=None))
    plan = study(WornErrors(), bits=(10.0,))
    words = "wanted a device with a converter to vary its bits, got enc03j_3031; leave bits out"
    with pytest.raises(InputError, match=words):
        replace(plan, worn=json.dumps(device_json(bare)))
