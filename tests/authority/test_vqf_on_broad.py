"""Corrected readings and a filter, on eight real trials against optics.

Source: BROAD (Laidig et al., Data 6(7), 72, 2021), read 2026-11.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from testkit import vqf_trials
from testkit.broad_trials import trial
from testkit.data import show
from undrift.orientation import orient

PAGE = Path(__file__).parents[2] / "docs" / "orientation.md"


@pytest.mark.slow
def test_the_table_of_the_page_is_what_the_trials_give():
    cells = re.findall(r"^\| (\d\d \(\w\))((?: \| [\d.]+){4}) \|$", PAGE.read_text(), re.M)
    printed = {name: [float(cell) for cell in re.findall(r"[\d.]+", text)] for name, text in cells}
    errors = vqf_trials.errors_deg()
    assert printed.keys() == errors.keys()
    for name, values in errors.items():
        show(f"{name}: raw, corrected, with prior, strapdown, deg", np.round(values, 2), printed[name])
        np.testing.assert_allclose(values, printed[name], atol=0.02)  # deg: rounding, and another build of the filter


def test_the_stated_drift_is_of_the_size_that_optics_see():
    record, reference = trial(5)
    orientation = orient(record)
    (item,) = (finding for finding in orientation.findings if "drift_deg" in finding.values)
    error = vqf_trials.total_error_deg(orientation.q_nb, reference)
    show("drift stated, deg; seen as rms over the motion, deg", (item.values["drift_deg"], error))
    assert item.level == "warn"
    # the end is about 1.7 times the rms of a straight course, and the offset's direction turns with the device
    assert 0.5 < item.values["drift_deg"] / (1.7 * error) < 3.0
