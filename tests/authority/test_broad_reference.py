"""BROAD (Laidig et al., Data 2021): a fit to the other trials of a device, judged on a trial that it has not seen.

End total error, mean over the device's trials, degrees. Limits: a tenth above what the fit reaches.
"""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import nominal_calibration

from testkit.broad_trials import DEVICES, of_device
from testkit.cohorts import first_and_long
from testkit.data import show
from undrift.calibration import reference
from undrift.validation import agreement
from undrift.validation.expected import ERROR_PRIOR
from undrift.validation.trial import TrialSettings

pytestmark = pytest.mark.usefixtures("computed_once")

LIMITS = {"B": 1.0, "C": 1.1, "D": 0.7}  # matrix and offset in motion, with what codes lose fitted
REST_AND_ROUNDING = {"B": 1.81, "C": 3.21, "D": 7.20}  # means of row (c); README and docs/accuracy.md print them
REST_ALONE = {"B": 4.25, "C": 3.45, "D": 8.25}  # means of row (b) of test_broad_rows


# Device B, four recordings, takes a minute: python -m benchmarks.public orientation prints it too.
@pytest.mark.parametrize("device", [pytest.param("B", marks=pytest.mark.slow), "C", "D"])
def test_the_end_error_of_held_out_trials_stays_below_its_limit(device):
    pairs, names = of_device(device)
    settings = TrialSettings(offset="rest")
    rest = agreement.validate_trials(pairs, settings=settings, names=names)
    rounding = [nominal_calibration(record) for record, _ in pairs]
    undone = agreement.validate_trials(pairs, calibrations=rounding, settings=settings, names=names)
    show(f"device {device}, and quantisation, mean end error, deg", f"{undone.mean.end_total_deg:.2f}")
    assert undone.mean.end_total_deg == pytest.approx(REST_AND_ROUNDING[device], abs=0.05)
    fitted = agreement.validate_leave_one_out(pairs, names=names)
    show(
        f"device {device}, rest offset alone, mean end error, deg", f"{rest.mean.end_total_deg:.2f}", REST_ALONE[device]
    )
    assert rest.mean.end_total_deg == pytest.approx(REST_ALONE[device], abs=0.1)  # printed to a tenth
    each = " ".join(f"{trial.figures.end_total_deg:.2f}" for trial in fitted.trials)
    mean = fitted.mean.end_total_deg
    show(
        f"device {device}, matrix, offset in motion and codes, mean end error, deg",
        f"{mean:.2f} ({each})",
        LIMITS[device],
    )
    assert mean <= LIMITS[device]
    assert mean < 0.5 * rest.mean.end_total_deg


# Spread between recordings of one device as the *other* devices show it, by python -m benchmarks.broad on 2026-11-26:
# elements of the matrix, and offset in motion less that at rest, deg/s.
LEARNT = {"B": (2.4e-4, 0.0128), "C": (3.7e-4, 0.0065), "D": (4.5e-4, 0.0065)}


@pytest.mark.slow
def test_nine_in_ten_errors_of_held_out_trials_are_where_they_were_expected():
    # The limit is the task's; eight trials allow none outside for the end error and none for the root mean square.
    inside, trials = np.zeros(2, int), 0
    for device, (matrix, offset_dps) in LEARNT.items():
        pairs, names = of_device(device)
        prior = replace(ERROR_PRIOR, matrix=matrix, motion_offset=np.radians(offset_dps))
        result = agreement.validate_leave_one_out(pairs, settings=TrialSettings(prior=prior), names=names)
        for t in result.trials:
            made = t.expected
            show(
                f"{t.recording}: end error, deg, expected",
                f"{t.figures.end_total_deg:.2f}",
                f"{made.end_total_deg:.2f}",
            )
            show("   total rmse, deg, expected", f"{t.figures.rmse_total_deg:.2f}", f"{made.rmse_total_deg:.2f}")
            inside += (
                made.end_interval_deg[0] <= t.figures.end_total_deg <= made.end_interval_deg[1],
                made.rmse_interval_deg[0] <= t.figures.rmse_total_deg <= made.rmse_interval_deg[1],
            )
        trials += len(result.trials)
    show("inside 95 %, end error and rmse", inside.tolist(), f"90 % of {trials}")
    assert (inside >= 0.9 * trials).all()


@pytest.mark.slow
@pytest.mark.parametrize("device", first_and_long(DEVICES))
def test_windows_of_12_to_20_s_give_about_the_same(device, monkeypatch):
    # The default of 16 s is reasoned (poses err by 0.1 deg, offsets wander by 0.005 deg/s), but it was settled with the held-out
    # figures of these same trials in view: 14 to 24 s keep every limit, 2 to 12 s miss that of device C (1.4 to 1.7 deg).
    # So the figures above are a little in favour of the fit; this test shows how much the length matters.
    pairs, names = of_device(device)
    ends = []
    for longest in (12.0, 20.0):
        monkeypatch.setattr(reference, "WINDOWS_S", (2.0, 4.0, 8.0, longest, longest, longest))
        # a result is remembered by its arguments, which do not contain the windows
        result = agreement.validate_leave_one_out(pairs, names=[f"{name}, {longest:g} s" for name in names])
        ends.append(result.mean.end_total_deg)
        show(f"device {device}, windows up to {longest:g} s, mean end error, deg", f"{ends[-1]:.2f}", 1.5)
    assert max(ends) < 1.5


def test_elements_are_those_of_this_class_of_device():
    pairs, names = of_device("B")
    result = agreement.validate_leave_one_out(pairs, names=names)
    fast = result.held_out[2]  # trial 07, up to 1450 deg/s; the others reach 1200
    model = fast.fit.triad.model
    show("device B without trial 07, matrix less identity, %", np.round(100.0 * (model.matrix - np.eye(3)), 3).tolist())
    show("   standard uncertainty, %", np.round(100.0 * model.standard_uncertainty[:9], 3).tolist())
    offset = np.degrees(fast.fit.motion_offset)
    show("   in motion minus at rest, deg/s", np.round(offset, 4).tolist(), "0.05")
    assert np.abs(model.matrix - np.eye(3)).max() < 0.009  # elements of this class of device: 0.1-0.9 %
    assert np.abs(offset).max() < 0.05
    assert fast.fit.lags_s == pytest.approx(np.full(3, 4.14e-3), abs=1e-4)
