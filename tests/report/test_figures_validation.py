"""The page of a validation shows the fields of the result, and what was done to get them."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.correction.correct import correct
from undrift.report.page import page_text
from undrift.report.validation import ERRORS, Comparison, errors_table, validation_report
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_trial
from undrift.validation.agreement import validate_trials
from undrift.validation.expected import Expected
from undrift.validation.levels import LevelTrial, judge_levels
from undrift.validation.trial import TrialSettings


@pytest.fixture(scope="module")
def pairs():
    rng = np.random.default_rng(2)
    device = random_device(rng)
    truth = true_calibration(device)
    trials = [simulate_trial("sit_to_stand", device, rng=rng) for _ in range(3)]
    return [(correct(trial.record, truth), trial.reference) for trial in trials]


@pytest.fixture(scope="module")
def result(pairs):
    return validate_trials(pairs, names=["a", "b", "c"])


@pytest.fixture(scope="module")
def validated(pairs, result):
    trials = [
        LevelTrial(recording=name, record=record, reference=reference)
        for name, (record, reference) in zip("abc", pairs, strict=True)
    ]
    return Comparison(
        result=result, levels=judge_levels(trials), files=(("a.csv", "a.trc"), ("b.csv", "b.trc"), ("c.csv", "")),
        calibration=None, source="", settings=TrialSettings(),
    )  # fmt: skip


def report_of(compared):
    """The report without findings of a fit."""
    return validation_report(compared, (), ())


@pytest.mark.slow
def test_an_error_smaller_than_predicted_is_within(result, validated):
    high = {"end_total_deg": 40.0, "end_interval_deg": (30.0, 60.0), "end_at_most_deg": 55.0}
    high |= {"rmse_total_deg": 40.0, "rmse_interval_deg": (30.0, 60.0), "rmse_at_most_deg": 55.0}
    low = {"end_total_deg": 1e-4, "end_interval_deg": (5e-5, 3e-4), "end_at_most_deg": 2e-4}
    low |= {"rmse_total_deg": 1e-4, "rmse_interval_deg": (5e-5, 3e-4), "rmse_at_most_deg": 2e-4}
    small, large = (
        replace(trial, expected=Expected(**of)) for trial, of in zip(result.trials, (high, low), strict=False)
    )
    assert small.figures.rmse_total_deg < 30.0
    assert [trial.within_expected for trial in (small, large, result.trials[2])] == [True, False, None]
    validated = replace(validated, result=replace(result, trials=(small, large)), files=validated.files[:2])
    report = report_of(validated)
    assert "Within the predicted limits: no (1 of 2 recordings)." in report.answer
    assert "Predicted limits (deg)" in page_text(report)


def test_every_number_of_the_table_is_a_field_of_the_result(result):
    table = errors_table(result)
    figures = [*(trial.figures for trial in result.trials), result.mean, result.median]
    assert [row[0] for row in table.rows] == ["a", "b", "c", "mean", "median"]
    for row, errors in zip(table.rows, figures, strict=True):
        assert list(row[1:-2]) == [getattr(errors, key) for key in ERRORS.values()]
        assert row[-2:] == (100.0 * errors.pitch_defined, 100.0 * errors.valid_optics)
