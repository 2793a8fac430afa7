"""The page of a validation shows the fields of the result and nothing else."""

import numpy as np
import pytest

from undrift.correct import correct
from undrift.report.validation import COLUMNS, trials_section, validation_sections, write_validation_report
from undrift.sim import random_device, simulate_trial, true_calibration
from undrift.validation import TrialSettings, validate_trials


@pytest.fixture(scope="module")
def result():
    rng = np.random.default_rng(2)
    device = random_device(rng)
    truth = true_calibration(device)
    trials = [simulate_trial("sit_to_stand", device, rng=rng) for _ in range(3)]
    pairs = [(correct(trial.record, truth), trial.reference) for trial in trials]
    return validate_trials(pairs, calibrations=(None,), settings=TrialSettings(offset="none"), names=["a", "b", "c"])


def test_every_figure_of_the_table_is_a_field_of_the_result(result):
    section = trials_section(result.trials, [("mean", result.mean)])
    assert len(section.columns) == len(COLUMNS) + 2
    assert [row[0] for row in section.rows] == ["a", "b", "c", "mean"]
    for row, figures in zip(section.rows, [*(t.figures for t in result.trials), result.mean], strict=True):
        for cell, (key, _) in zip(row[1:], COLUMNS, strict=False):
            assert float(cell) == pytest.approx(getattr(figures, key), abs=0.005 + 1e-9)
        assert float(row[-1]) == pytest.approx(100.0 * figures.valid_optics, abs=0.051)


def test_sections_are_errors_agreement_and_one_for_each_trial(result):
    titles = [section.title for section in validation_sections(result)]
    assert titles == ["Errors", "Agreement over trials", "a", "b", "c"]
    agreement = validation_sections(result)[1]
    assert f"bias {result.agreement.limits.bias:+.2f} deg" in agreement.text[0]
    assert "An ICC depends on how much the trials differ." in agreement.text[0]


def test_the_page_is_written_with_a_picture_for_each_trial(result, tmp_path):
    write_validation_report(result, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    assert "3 recordings, errors in degrees." in text
    assert text.count("<svg") == 4
    for name in ("a: sagittal pitch", "b: sagittal pitch", "c: sagittal pitch", "pitch (deg)", "rmse (deg)"):
        assert name in text
    assert len(text) < 2_000_000
