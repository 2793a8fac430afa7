"""What ``print`` shows of a value: its answer, not the numbers of its tables."""

import numpy as np
import pytest

import undrift


@pytest.mark.slow
def test_a_fit_and_a_validation_print_as_a_few_lines():
    rng = np.random.default_rng(7)
    device = undrift.random_device(rng)
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    trials = undrift.validate_trials([(trial.record, trial.reference)], calibrations=[calibration])
    assert str(calibration) == repr(calibration)
    assert str(trials).startswith("Validation\n  simulated optics, sit_to_stand: total 0.")
    assert len(str(trials).splitlines()) < 10
    fit = undrift.fit_drift([undrift.simulate_thermal_session("soak", device, rng=rng)], calibration)
    first, verdict = str(fit).splitlines()
    assert first.startswith(f"Thermal drift of {calibration.device}: Largest error of a lean of 45 deg")
    assert verdict == f"verdict {fit.verdict.status}"
