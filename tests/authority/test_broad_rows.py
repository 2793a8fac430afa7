"""BROAD (Laidig et al., Data 2021): strapdown baselines, an earlier implementation's figures for the same trials and protocol.

(a) raw gyro, (b) less the mean of the initial rest, (c) (b) after half a step was given back to codes truncated toward zero.
End error: median over the first 3 s after the motion. Degrees.
"""

import pytest
from benchmarks.broad import nominal_calibration

from testkit.broad_trials import FILES, trial
from testkit.data import show
from undrift.validation import trial as trial_module
from undrift.validation.trial import TrialSettings

pytestmark = pytest.mark.usefixtures("computed_once")

# (a) end total, inclination | (b) end total, inclination | (b) rms total, inclination | (c) end total, inclination
ROWS = {
    2: ((27.0, 25.8), (6.5, 6.3), (3.68, 3.57), (3.3, 3.2)),
    3: ((44.7, 44.0), (3.5, 1.0), (2.87, 0.80), (3.9, 2.8)),
    5: ((35.4, 23.1), (2.7, 2.4), (2.22, 2.01), (1.6, 1.2)),
    7: ((31.8, 22.1), (4.9, 4.2), (3.18, 2.65), (1.7, 1.7)),
    9: ((32.8, 20.6), (2.9, 2.4), (1.89, 1.54), (0.7, 0.2)),
    24: ((54.2, 54.1), (3.4, 2.7), (2.32, 1.95), (2.5, 1.6)),
    32: ((14.4, 0.8), (6.7, 0.4), (4.26, 0.56), (5.7, 0.6)),
    35: ((16.3, 1.0), (9.6, 2.2), (6.12, 1.51), (8.5, 2.3)),
}
WITHIN = 0.2  # deg


@pytest.mark.parametrize("number", FILES)
def test_rows_a_b_c_come_out_within_a_fifth_of_a_degree(number):
    a, b, c = (
        trial_module.validate_trial(
            *trial(number), calibration=calibration, settings=settings, name=FILES[number]
        ).figures
        for settings, calibration in (
            (TrialSettings(), None),
            (TrialSettings(offset="rest"), None),
            (TrialSettings(offset="rest"), nominal_calibration(trial(number)[0])),
        )
    )
    found = (
        (a.end_total_deg, a.end_inclination_deg),
        (b.end_total_deg, b.end_inclination_deg),
        (b.rmse_total_deg, b.rmse_inclination_deg),
        (c.end_total_deg, c.end_inclination_deg),
    )
    for what, got, known in zip(("a end", "b end", "b rms", "c end"), found, ROWS[number], strict=True):
        show(f"trial {number:02d} {what} total / inclination, deg", f"{got[0]:.2f} / {got[1]:.2f}", known)
        assert got == pytest.approx(known, abs=WITHIN)
    assert b.valid_optics > 0.99
