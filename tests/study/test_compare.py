"""Levels of correction on real trials and their twins: planted devices, whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.sim.device.effects import Thermometer
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.study.compare import ComparedRow, LevelComparison, compare_levels, predict_trial
from undrift.study.figure3 import NOTE_APART_DEG, OPTICS, actual_device, worn_record
from undrift.validation.trial import TrialSettings, validate_trial

pytestmark = pytest.mark.usefixtures("computed_once")

# a thermometer that errs would shift the tables, which are the truth
DEVICE = replace(actual_device(preset("enc03j_3031"), ("g_sensitivity",)), thermometer=Thermometer())
NODES_C, RATES = np.linspace(10.0, 50.0, 9), np.radians(np.linspace(-300.0, 300.0, 61))
FULL = replace(true_calibration(DEVICE), drift=true_tables(DEVICE, NODES_C, RATES))
WARM_K = 12.5
SCALE, OFFSET = np.array([1.03, 0.98, 1.01]), np.array([0.004, -0.003, 0.002])


def worn(person: int, task: str = "sit_to_stand") -> tuple[Record, Reference]:
    """A person's trial, warmed by the person."""
    rng = np.random.default_rng([18, person, len(task)])
    performed = draw_task(task, rng=rng)
    return worn_record(DEVICE, performed, excursion_k=WARM_K, rng=rng), see(performed, rng=rng, settings=OPTICS)


def compared(
    pairs: list[tuple[Record, Reference]],
    calibration: Calibration | None = FULL,
    people: tuple[str, ...] = (),
    **how: float,
) -> LevelComparison:
    names = tuple(f"t{k}" for k in range(len(pairs)))
    settings = {"settings": TrialSettings(), "margin_deg": NOTE_APART_DEG} | how
    return compare_levels(pairs, [calibration] * len(pairs), (names, (), people), **settings)


def by_level(found: LevelComparison) -> dict[str, ComparedRow]:
    return {row.level: row for row in found.rows}


@pytest.fixture(scope="module")
def four() -> LevelComparison:
    return compared([worn(person) for person in range(4)])


@pytest.mark.slow
def test_tables_take_what_temperature_adds_and_the_twin_predicts_it(four):
    rows = by_level(four)
    means = {name: (row.actual_deg.mean(), row.simulated_deg.mean()) for name, row in rows.items()}
    show("actual and simulated by level, deg", {name: np.round(pair, 3).tolist() for name, pair in means.items()})
    assert four.quantity == "pitch"
    assert rows["constants"].mean_deg > 1.0 > rows["static tables"].mean_deg > rows["all tables"].mean_deg
    for name in ("constants", "static tables", "all tables"):  # parameters are the truth: noise and codes are left
        assert (rows[name].apart_deg < NOTE_APART_DEG).all(), name
    assert abs(means["constants"][0] - means["constants"][1]) < 0.02 * means["constants"][0]


def test_verdicts_are_against_the_row_before_that_can_be_made(four):
    rows = by_level(four)
    assert rows["uncalibrated"].decision is None
    assert "got count" in rows["uncalibrated"].missing
    assert rows["constants"].decision is None
    static, rest = rows["static tables"].decision, rows["rest, no tables"].decision
    assert static is not None
    assert (static.verdict, static.margin, static.tests) == ("better", NOTE_APART_DEG, 4)
    assert four.rows[static.other].level == "constants"
    assert static.difference == pytest.approx(rows["constants"].mean_deg - rows["static tables"].mean_deg)
    assert static.difference == pytest.approx(np.mean(rows["constants"].actual_deg - rows["static tables"].actual_deg))
    assert rest is not None
    assert four.rows[rest.other].level == "all tables"
    assert rest.difference < 0.0


def test_trials_too_short_for_an_offset_from_motion_are_named(four):
    row = by_level(four)["motion offset"]
    assert np.isnan(row.actual_deg).all()
    assert np.isnan(row.mean_deg)
    assert row.missing.startswith("missing in 4 of 4 trials: offset from motion: wanted 20 s or more")


@pytest.mark.slow
def test_errors_are_averaged_by_person_and_a_verdict_needs_three():
    pairs = [worn(0), worn(0, "step"), worn(1)]
    row = by_level(compared(pairs, people=("a", "a", "b")))["constants"]
    assert row.mean_deg == pytest.approx(0.5 * (row.actual_deg[:2].mean() + row.actual_deg[2]))
    assert np.isfinite(row.interval_deg).all()
    static = by_level(compared(pairs, people=("a", "a", "b")))["static tables"]
    assert static.decision is None
    assert by_level(compared(pairs))["static tables"].decision is not None


@pytest.fixture(scope="module")
def turned() -> tuple[Record, Reference]:
    device = Device(forward=np.diag(SCALE), offset=OFFSET, noise=1e-3)
    return make_recording(np.random.default_rng(4), device, turn_s=40.0, optics_noise=5e-4)


def test_without_a_calibration_there_are_the_offsets_alone_and_no_twin(turned):
    rows = by_level(compared([turned], None))
    assert rows["constants"].missing == "missing in 1 of 1 trials: no calibration was given"
    assert rows["rest offset"].mean_deg < rows["uncalibrated"].mean_deg
    assert "no twin" in rows["uncalibrated"].missing
    assert np.isnan(rows["rest offset"].simulated_deg).all()


def test_a_trial_without_a_rest_is_named(turned):
    record, reference = turned
    begin = float(reference.time[np.argmax(reference.moving > 0.0)]) + 2.0
    moving = record.between(begin, begin + 30.0)
    inside = (reference.time > begin) & (reference.time < begin + 30.0)
    cut = Reference(time=reference.time[inside], q_nb=reference.q_nb[inside])
    rows = by_level(compared([(moving, cut)], None))
    assert rows["rest offset"].missing == "missing in 1 of 1 trials: no rest"
    assert np.isfinite(rows["uncalibrated"].mean_deg)


def test_the_twin_of_exact_tables_is_corrected_to_the_reference():
    quiet = worn_record(
        DEVICE.without_noise(),
        draw_task("step", rng=np.random.default_rng(3)),
        excursion_k=WARM_K,
        rng=np.random.default_rng(4),
    )
    seen = see(draw_task("step", rng=np.random.default_rng(3)), rng=np.random.default_rng(5), settings=OPTICS)
    readings, poses = predict_trial(quiet, seen, FULL, np.eye(3), np.random.default_rng(0))
    errors = [
        validate_trial(readings, poses, calibration=level).figures.rmse_total_deg
        for level in (replace(FULL, drift=None), FULL)
    ]
    show("twin of exact tables: constants, all tables, total, deg", np.round(errors, 4).tolist())
    assert errors[0] > 1.0
    assert errors[1] < 0.1  # whole counts of a gyroscope of 12 bits, over 3 s, and of an accelerometer at the start


@pytest.mark.slow
def test_gaps_of_the_optics_cost_the_twin_no_more_than_the_device():
    record, reference = worn(3)
    start = int(np.argmax(reference.moving > 0.0))
    q_nb = reference.q_nb.copy()
    q_nb[start + 60 : start + 110] = np.nan
    position = reference.position.copy()
    position[start + 60 : start + 110] = np.nan
    gap = replace(reference, q_nb=q_nb, position=position)
    whole, hidden = (by_level(compared([(record, poses)]))["constants"] for poses in (reference, gap))
    assert hidden.simulated_deg[0] == pytest.approx(whole.simulated_deg[0], rel=0.1)
    assert hidden.apart_deg[0] < 0.3
