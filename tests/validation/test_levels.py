"""Levels of correction over trials, people and tasks: planted devices, whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.frames import quaternion_of, quaternion_product, rotation_vector
from undrift.model import BodyMounting
from undrift.record import Reference
from undrift.sim.device.effects import Offset, Scale, Thermometer, WhiteNoise
from undrift.sim.device.model import DeviceModel, SensorChain
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.study.figure3 import OPTICS, actual_device, worn_record
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.validation.levels import (
    LEVEL_NAMES,
    NOTE_DIFFERENCE_DEG,
    LevelTrial,
    calibrate_by_others,
    judge_levels,
)
from undrift.validation.trial import TrialSettings, validate_trial

pytestmark = pytest.mark.usefixtures("computed_once")
NODES_C, RATES = np.linspace(10.0, 50.0, 9), np.radians(np.linspace(-300.0, 300.0, 61))
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
FULL = replace(true_calibration(DEVICE), drift=true_tables(DEVICE, NODES_C, RATES))
# a thermometer that errs would shift the tables, which are the truth
NOTE_DEVICE = replace(actual_device(preset("enc03j_3031"), hidden=False), thermometer=Thermometer())
NOTE_FULL = replace(true_calibration(NOTE_DEVICE), drift=true_tables(NOTE_DEVICE, NODES_C, RATES))


def worn(person, task="sit_to_stand", device=DEVICE):
    """A person's trial, warmed by the person."""
    rng = np.random.default_rng([18, person, len(task)])
    performed = draw_task(task, rng=rng)
    return worn_record(device, performed, rng=rng), see(performed, rng=rng, settings=OPTICS)


def trial(person, task="sit_to_stand", calibration=FULL, device=DEVICE, **more):
    record, reference = worn(person, task, device)
    about = {"person": f"p{person}", "task": task, "device": "A", "calibration": calibration} | more
    return LevelTrial(recording=f"{person} {task}", record=record, reference=reference, **about)


def summary_of(table, level, method="strapdown", group="all"):
    return next(row for row in table.summaries if (row.group, row.level, row.method) == (group, level, method))


def errors_of(table, level):
    return next(row for row in table.errors if row.level == level)


@pytest.fixture(scope="module")
def six():
    trials = [trial(person, task) for person in range(3) for task in ("sit_to_stand", "step")]
    return judge_levels(trials, methods=("strapdown", "vqf"))


@pytest.mark.slow
def test_each_level_leaves_less_than_readings_as_they_come(six):
    means = {name: summary_of(six, name).mean_deg for name in LEVEL_NAMES}
    show("mean error by level, deg", {name: round(mean, 3) for name, mean in means.items()})
    assert six.quantity == "pitch"
    assert means["uncalibrated"] > 3.0 * means["rest"]
    assert means["constants"] > 3.0 * means["static table"]
    assert means["all tables, rest"] < 0.15
    rest = summary_of(six, "rest")
    assert (rest.people, rest.trials, rest.previous) == (3, 6, "all tables")
    assert summary_of(six, "static table").decision.verdict == "better"
    assert list(dict.fromkeys(row.group for row in six.summaries)) == ["all", "sit_to_stand", "step"]
    tasks = [summary_of(six, "rest", group=task).mean_deg for task in ("sit_to_stand", "step")]
    assert np.mean(tasks) == pytest.approx(rest.mean_deg)


def test_agreement_counts_people_not_trials(six):
    """Twelve trials of three people have no agreement."""
    table = judge_levels([replace(one, recording=f"{one.recording} {k}") for k in range(4) for one in six.trials[:3]])
    assert all(row.agreement is None and row.icc is None for row in table.summaries)


@pytest.mark.slow
def test_ten_people_have_agreement_and_an_icc_within_a_task():
    best = summary_of(judge_levels([trial(person) for person in range(10)]), "all tables, rest")
    assert best.agreement.count == 10
    assert abs(best.agreement.bias) < 0.1
    assert best.icc.value > 0.999


def test_a_level_without_its_tables_says_why():
    table = judge_levels([trial(7, calibration=None)])
    assert errors_of(table, "constants").missing.startswith("missing in 1 of 1 trials: no calibration")
    assert "no calibration" in errors_of(table, "all tables, rest").missing
    assert np.isfinite(errors_of(table, "rest").error_deg).all()
    constants = judge_levels([trial(7, calibration=replace(FULL, drift=None))])
    assert "no static table" in errors_of(constants, "static table").missing
    assert np.isfinite(errors_of(constants, "constants").error_deg).all()


def test_a_mounting_turns_the_readings():
    one = trial(1, calibration=None)
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # worn with its y forward
    turned = replace(one.record, gyro=one.record.gyro @ quarter, accel=one.record.accel @ quarter)
    worn_so = BodyMounting(place="lower-back", matrix=quarter, covariance=np.zeros((3, 3)), basis="stated")
    plain, mounted = (
        errors_of(judge_levels([each]), "rest").error_deg
        for each in (one, replace(one, record=turned, mounting=worn_so))
    )
    np.testing.assert_allclose(mounted, plain, rtol=1e-6)


def test_a_trial_without_a_rest_is_named():
    device = Device(forward=np.diag([1.03, 0.98, 1.01]), offset=np.array([0.004, -0.003, 0.002]), noise=1e-3)
    record, reference = make_recording(np.random.default_rng(4), device, turn_s=40.0, optics_noise=5e-4)
    begin = float(reference.time[np.argmax(reference.moving > 0.0)]) + 2.0
    inside = (reference.time > begin) & (reference.time < begin + 30.0)
    cut = Reference(time=reference.time[inside], q_nb=reference.q_nb[inside])
    table = judge_levels([LevelTrial(recording="a", record=record.between(begin, begin + 30.0), reference=cut)])
    assert errors_of(table, "rest").missing == "missing in 1 of 1 trials: the recording has no rest"
    assert np.isfinite(errors_of(table, "uncalibrated").error_deg).all()


@pytest.mark.slow
def test_a_device_without_a_calibration_is_fitted_to_its_other_recordings():
    device = Device(forward=np.diag([1.03, 0.98, 1.01]), offset=np.array([0.004, -0.003, 0.002]), noise=1e-3)
    pairs = [make_recording(np.random.default_rng(seed), device, turn_s=40.0, optics_noise=5e-4) for seed in (1, 2, 3)]
    trials = [
        LevelTrial(recording=str(k), record=record, reference=reference, device="d")
        for k, (record, reference) in enumerate(pairs)
    ]
    fitted = calibrate_by_others(trials)
    assert all(one.left_out and one.calibration is not None for one in fitted)
    table = judge_levels(fitted)
    assert summary_of(table, "constants").mean_deg < 0.3 * summary_of(table, "uncalibrated").mean_deg
    assert calibrate_by_others(trials[:1])[0].calibration is None


@pytest.mark.slow
def test_the_simulated_device_predicts_the_error_of_each_level():
    table = judge_levels([trial(person, calibration=NOTE_FULL, device=NOTE_DEVICE) for person in range(3)])
    for name in ("constants", "static table"):  # parameters are the truth: noise and codes are left
        assert (errors_of(table, name).difference_deg < NOTE_DIFFERENCE_DEG).all(), name
    assert errors_of(table, "constants").error_deg.min() > 1.0
    assert np.isnan(errors_of(table, "all tables").simulated_deg).all()  # the calibration predicts no error of its own


PLAIN = replace(FULL, drift=None)


def judged(turned_deg, **settings):
    record, reference = worn(1)
    body = quaternion_of(np.radians(turned_deg))
    turned = replace(reference, q_nb=quaternion_product(reference.q_nb, body))
    return validate_trial(
        record, turned, calibration=PLAIN, settings=TrialSettings(**{"offset": "rest"} | settings)
    ), body


@pytest.mark.parametrize("turned_deg", [(20.0, -30.0, 100.0), (0.0, 0.0, 175.0)])
def test_a_sit_to_stand_shows_how_the_device_sits_on_a_cluster_of_any_axes(turned_deg):
    trial, body = judged(turned_deg, align="level")
    expected = np.linalg.norm(rotation_vector(body))
    show(f"turned by {turned_deg}: angle found, deg", np.degrees(trial.mounting.angle), np.degrees(expected))
    show("error left, deg", trial.figures.rmse_total_deg, 0.2)
    assert trial.mounting.applied
    assert trial.mounting.angle == pytest.approx(expected, abs=np.radians(0.3))
    assert trial.figures.rmse_total_deg < 0.2
