"""The page of a validation shows the fields of the result, and what was done to get them."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.commands.validate import (
    SHOWN,
    Validated,
    coverage_text,
    method_section,
    recordings_section,
    trials_sections,
)
from undrift.correction.correct import correct
from undrift.findings import finding
from undrift.model import AdcModel, Verdict
from undrift.report.figures import trial_figure
from undrift.report.page import write_page
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_trial
from undrift.sync import LagSettings
from undrift.validation.agreement import validate_trials
from undrift.validation.expected import Expected
from undrift.validation.trial import TrialSettings

METHOD = Validated(
    result=None,
    recordings=("a.csv", "b.csv", "c.csv"),
    references=("a.trc", "b.trc", "c.trc"),
    calibration=None,
    source="",
    leave_one_out=False,
    verdict=Verdict(),
    settings=TrialSettings(offset="none"),
)
WHY = finding("imported.uncertainty", "warn", program="imucal")
MADE = true_calibration(random_device(np.random.default_rng(2)))


@pytest.fixture(scope="module")
def result():
    rng = np.random.default_rng(2)
    device = random_device(rng)
    truth = true_calibration(device)
    trials = [simulate_trial("sit_to_stand", device, rng=rng) for _ in range(3)]
    pairs = [(correct(trial.record, truth), trial.reference) for trial in trials]
    return validate_trials(pairs, calibrations=(None,), settings=TrialSettings(offset="none"), names=["a", "b", "c"])


def choices(method):
    return dict(method_section(method).rows)


@pytest.mark.slow
def test_an_error_smaller_than_stated_is_not_outside(result, tmp_path):
    small, large = result.trials[0], result.trials[1]
    of = {"end_total_deg": 40.0, "end_interval_deg": (30.0, 60.0), "end_at_most_deg": 55.0}
    of |= {"rmse_total_deg": 40.0, "rmse_interval_deg": (30.0, 60.0), "rmse_at_most_deg": 55.0}
    low = {"end_total_deg": 1e-4, "end_interval_deg": (5e-5, 3e-4), "end_at_most_deg": 2e-4}
    low |= {"rmse_total_deg": 1e-4, "rmse_interval_deg": (5e-5, 3e-4), "rmse_at_most_deg": 2e-4}
    assert small.figures.rmse_total_deg < 30.0
    trials = (replace(small, expected=Expected(**of)), replace(large, expected=Expected(**low)))
    one, both = replace(result, trials=trials[:1]), replace(result, trials=trials)
    assert (one.coverage.rmse_inside, one.coverage.trials, one.coverage.end_inside) == (1, 1, 1)
    assert (both.coverage.rmse_inside, both.coverage.trials) == (1, 2)  # the second is larger than stated
    assert "total error over the motion 1 of 1" in coverage_text(one.coverage)
    method = replace(METHOD, result=one, recordings=("a.csv",), references=("a.trc",))
    write_page(tmp_path / "page.html", method.summary())
    page = (tmp_path / "page.html").read_text()
    assert "Not larger than expected (95 %, at most): end error 1 of 1" in page
    assert "inside" not in coverage_text(one.coverage)


def test_every_figure_of_the_table_is_a_field_of_the_result(result):
    section, _ = trials_sections(result.trials, [("mean", result.mean)])
    assert len(section.columns) == len(SHOWN) + 3
    assert [row[0] for row in section.rows] == ["a", "b", "c", "mean"]
    for row, figures in zip(section.rows, [*(t.figures for t in result.trials), result.mean], strict=True):
        for cell, key in zip(row[1:], SHOWN, strict=False):
            assert float(cell) == pytest.approx(getattr(figures, key), abs=0.005 + 1e-9)
        assert float(row[-2]) == pytest.approx(100.0 * figures.pitch_defined, abs=0.051)
        assert float(row[-1]) == pytest.approx(100.0 * figures.valid_optics, abs=0.051)


def test_sections_are_errors_what_was_done_and_one_for_each_trial(result):
    sections = [one for one in replace(METHOD, result=result).summary().sections if one.on != "terminal"]
    assert [section.title.partition(" ")[0] for section in sections] == [
        "error",
        "Further",
        "Method",
        "Recordings",
        "a",
        "b",
        "c",
    ]


def test_each_recording_is_shown_with_its_reference_its_lag_and_the_share_of_its_whole_file(result):
    section = recordings_section(METHOD, result.trials)
    assert [row[:2] for row in section.rows] == [("a.csv", "a.trc"), ("b.csv", "b.trc"), ("c.csv", "c.trc")]
    for row, trial in zip(section.rows, result.trials, strict=True):
        shown = dict(zip(section.columns, row, strict=True))
        assert float(shown["lag found (ms)"].split()[0]) == pytest.approx(trial.figures.lag_ms, abs=0.006)
        assert shown["lag in the figures"] == ("undone" if trial.lag_undone else "left in")
        assert shown["motion (s)"] == f"{trial.motion.start_s:.1f} to {trial.motion.stop_s:.1f}"
        assert float(shown["optics seen, whole file (%)"]) == pytest.approx(
            100.0 * trial.figures.valid_optics_file, abs=0.051
        )
    unseen = recordings_section(replace(METHOD, references=()), (replace(result.trials[0], mounting=None),) * 3)
    assert unseen.rows[0][1] == "the same file"
    assert unseen.rows[0][5] == "not observable"


def test_the_page_says_which_calibration_judged_and_what_its_verdict_was():
    assert choices(METHOD)["calibration"] == "none: readings in the unit of their file"
    assert "its verdict" not in choices(METHOD)
    read = replace(METHOD, calibration=MADE, source="mine.json", verdict=Verdict(status="marginal", findings=(WHY,)))
    assert choices(read)["calibration"].startswith(f"mine.json of {MADE.device}: gyroscope by ")
    assert method_section(read).rows[1] == ("its verdict", "marginal")
    assert method_section(METHOD).findings == ()
    assert "figures are optimistic" in choices(replace(METHOD, calibration=MADE))["calibration"]
    assert choices(replace(METHOD, calibration=MADE, leave_one_out=True))["calibration"].startswith(
        "leave-one-out: each"
    )


def test_the_page_says_what_became_of_the_offset():
    rest = replace(METHOD, settings=TrialSettings(offset="rest"))
    assert choices(METHOD)["gyroscope's offset"] == "not corrected"
    assert choices(rest)["gyroscope's offset"] == "the mean rate of the first still phase is subtracted"
    assert choices(replace(METHOD, calibration=MADE))["gyroscope's offset"] == "the calibration's alone"
    assert choices(replace(rest, calibration=MADE))["gyroscope's offset"].startswith(
        "the calibration's, and the mean rate"
    )
    assert "and the motion of the others" in choices(replace(rest, leave_one_out=True))["gyroscope's offset"]


def test_the_page_says_what_became_of_the_rounding():
    codes = replace(MADE, adc=AdcModel(gyro_lsb=np.ones(3), gyro_rounding="toward_zero"))
    assert choices(METHOD)["ADC's rounding"].startswith("corrected where the codes show it")
    assert choices(replace(METHOD, settings=TrialSettings(adc="none")))["ADC's rounding"] == "left in"
    assert choices(replace(METHOD, calibration=codes))["ADC's rounding"] == (
        "corrected by the calibration (gyroscope toward zero)"
    )
    assert (
        choices(replace(METHOD, calibration=replace(MADE, adc=None)))["ADC's rounding"]
        == "unknown to the calibration: left in"
    )


def test_the_page_says_how_far_the_lag_was_looked_for():
    settings = TrialSettings(lag=LagSettings(longest_lag_s=30.0))
    assert choices(replace(METHOD, settings=settings))["lag"].startswith(
        "searched up to 30 s either way; one up to 10 ms"
    )


@pytest.mark.parametrize(
    ("align", "words"),
    [("auto", "removed where it exceeds 5 deg"), ("level", "is removed")],
)
def test_the_page_says_what_became_of_the_mounting(align, words):
    assert choices(replace(METHOD, settings=TrialSettings(align=align)))["mounting"].endswith(words)


def test_a_peak_in_the_table_is_a_peak_in_the_figure(result):
    # A long trial: more samples than the picture has columns, and the peak one sample long.
    trial = result.trials[0]
    n = 50_000
    course = 0.01 * np.sin(np.arange(n) / 40.0)
    course[31_417] = np.radians(-8.41)
    nothing = np.zeros(n)
    error = replace(trial.error, total=np.abs(course), heading=nothing, inclination=nothing, pitch=course)
    long = replace(
        trial,
        time=np.arange(n) / 286.0,
        error=error,
        sensor_pitch=nothing,
        reference_pitch=nothing,
        moving=(np.arange(n) > 20_000).astype(float),
    )
    _, panel = trial_figure(long).axes
    drawn = {line.get_label(): line for line in panel.lines}
    assert drawn["pitch"].get_ydata().min() == pytest.approx(-8.41)
    assert drawn["total"].get_ydata().max() == pytest.approx(8.41)
    assert len(drawn["pitch"].get_ydata()) < 4001
    (shade,) = panel.patches
    assert shade.get_x() == pytest.approx(20_001 / 286.0)
