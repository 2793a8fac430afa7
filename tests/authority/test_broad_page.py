"""BROAD 02 and 05: the largest pitch error of the page's table, a few samples of 50,000, is drawn in its figure."""

import numpy as np
import pytest
from benchmarks.broad_files import broad_file

from testkit.data import show
from undrift.io.formats import read_record, read_reference
from undrift.report.figures import trial_figure
from undrift.validation.trial import TrialSettings, validate_trial

pytestmark = pytest.mark.usefixtures("computed_once")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["02_undisturbed_slow_rotation_B", "05_undisturbed_slow_rotation_with_breaks_B"])
def test_the_largest_pitch_error_of_the_table_is_drawn(name):
    path = broad_file(name)
    trial = validate_trial(read_record(path), read_reference(path), settings=TrialSettings(offset="rest"))
    drawn = {line.get_label(): line for line in trial_figure(trial).axes[1].lines}["pitch"]
    time, course = drawn.get_data()
    inside = course[np.interp(time, trial.time, trial.moving) > 0.5]
    show(f"{name}: largest pitch error, table and figure, deg", f"{trial.figures.max_abs_pitch_deg:.2f}")
    assert float(np.nanmax(np.abs(inside))) == pytest.approx(trial.figures.max_abs_pitch_deg, abs=1e-9)
    assert len(course) < len(trial.time) / 10
