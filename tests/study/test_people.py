"""A study over people, tasks and devices: planted devices, whose errors are known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.model import BodyMounting
from undrift.sim.device.effects import Offset, Scale, WhiteNoise
from undrift.sim.device.model import DeviceModel, SensorChain
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.study.figure3 import OPTICS, worn_record
from undrift.study.people import PIPELINES, PersonTrial, study_people
from undrift.units import RADIAN_PER_DEGREE as DPS

pytestmark = pytest.mark.usefixtures("computed_once")

# In physical units, so that readings can be judged as they come; its offset moves by 0.4 deg/s in the 12.5 K of a wearer
DEVICE = DeviceModel(
    serial="A",
    gyro=SensorChain(
        unit="dps",
        scale=Scale(nominal_sensitivity=1.0 / DPS, error=np.array([0.03, -0.02, 0.01])),
        offset=Offset(constant=np.array([0.6, -0.5, 0.4]) * DPS, per_k=np.array([[0.03, -0.03, 0.02]]) * DPS),
        white_noise=WhiteNoise(random_walk=np.full(3, 0.005 * DPS)),
    ),
    accel=SensorChain(
        unit="m/s2", scale=Scale(nominal_sensitivity=1.0), white_noise=WhiteNoise(random_walk=np.full(3, 2e-3))
    ),
)
NODES_C, RATES = np.linspace(10.0, 50.0, 9), np.radians(np.linspace(-300.0, 300.0, 61))
FULL = replace(true_calibration(DEVICE), drift=true_tables(DEVICE, NODES_C, RATES))


def worn(person, task="sit_to_stand"):
    """A person's trial, warmed by the person."""
    rng = np.random.default_rng([18, person, len(task)])
    performed = draw_task(task, rng=rng)
    return worn_record(DEVICE, performed, excursion_k=12.5, rng=rng), see(performed, rng=rng, settings=OPTICS)


def trial(person, task, device="A", calibration=FULL):
    return PersonTrial(
        recording=f"{person} {task}", person=f"p{person}", task=task, device=device, pair=worn(person, task),
        calibration=calibration,
    )  # fmt: skip


@cache
def found():
    return study_people([trial(p, t) for p in range(3) for t in ("sit_to_stand", "step")], margin_deg=0.15)


def mean_of(study, pipeline, method="strapdown", of="all"):
    return next(g for g in study.groups if (g.of, g.pipeline, g.method) == (of, pipeline, method))


@pytest.mark.slow
def test_each_step_of_the_correction_leaves_less_and_the_optics_agree_with_the_last():
    study = found()
    assert study.quantity == "pitch"
    for name, *_ in PIPELINES[:5]:
        show(name, [round(mean_of(study, name, method).mean_deg, 3) for method in ("strapdown", "vqf")])
    means = {name: mean_of(study, name).mean_deg for name, *_ in PIPELINES}
    assert means["as read"] > 3.0 * means["rest offset"]
    assert means["calibrated, tables"] < 0.15
    assert means["calibrated, tables"] <= means["calibrated"] + 0.02
    best = mean_of(study, "calibrated, tables")
    assert (best.people, best.trials, best.decision.verdict, best.equivalence.verdict) == (3, 6, "better", "equivalent")
    assert best.icc.value > 0.999
    assert abs(best.limits.bias) < 0.1
    raw = mean_of(study, "as read")
    assert raw.decision is None
    assert raw.equivalence.verdict != "equivalent"


def test_tasks_are_groups_and_their_trials_add_up_to_all():
    study = found()
    assert list(dict.fromkeys(group.of for group in study.groups)) == ["all", "sit_to_stand", "step"]
    each = [mean_of(study, "calibrated", of=task) for task in ("sit_to_stand", "step")]
    assert [one.trials for one in each] == [3, 3]
    whole = mean_of(study, "calibrated")
    assert np.mean([one.mean_deg for one in each]) == pytest.approx(
        whole.mean_deg
    )  # as many trials of each person in each


def test_what_cannot_be_made_says_why_and_the_others_stand():
    """One recording of a device without a calibration: no calibration, no tables, no motion of others."""
    study = study_people([trial(7, "sit_to_stand", calibration=None)], margin_deg=0.15)
    by_name = {(one.pipeline, one.method): one for one in study.errors}
    for pipeline in ("calibrated", "calibrated, motion offset", "motion alone"):
        reason = by_name[pipeline, "strapdown"].missing
        assert reason == "missing in 1 of 1 trials: device A has one recording: state its calibration"
    assert by_name["calibrated, tables", "vqf"].missing.endswith("no calibration with tables is stated")
    assert np.isfinite(by_name["rest offset", "strapdown"].pitch_deg).all()
    assert mean_of(study, "as read").limits is None


def test_a_unit_that_is_wrong_is_named_and_a_mounting_is_applied():
    one = trial(1, "sit_to_stand", calibration=None)
    record, reference = one.pair
    in_radians = replace(one, pair=(replace(record, gyro_unit="rad/s"), reference))
    with pytest.raises(InputError, match=r"none: 1 sit_to_stand: wanted rates in the unit that is stated, got 56"):
        study_people([in_radians], margin_deg=0.15)
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # worn with its y forward
    turned = replace(record, gyro=record.gyro @ quarter, accel=record.accel @ quarter)
    worn_so = BodyMounting(place="lower-back", matrix=quarter, covariance=np.zeros((3, 3)), basis="stated")
    plain, worn_as = (
        study_people([each], margin_deg=0.15).errors[2].pitch_deg
        for each in (replace(one, calibration=None), replace(one, pair=(turned, reference), mounting=worn_so))
    )
    np.testing.assert_allclose(worn_as, plain, rtol=1e-6)


def test_what_a_trial_warns_of_is_kept_with_its_recording():
    one = trial(1, "sit_to_stand", calibration=None)
    record, reference = one.pair
    holes = np.array(record.gyro)
    holes[100:103] = np.nan
    study = study_people([replace(one, pair=(replace(record, gyro=holes), reference))], margin_deg=0.15)
    named = [(recording, item.code) for recording, item in study.errors[0].findings]
    assert ("1 sit_to_stand", "validate.gaps_before") in named
