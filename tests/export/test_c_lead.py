"""The exported lead against without_lag, alone and before the exported correction against correct."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import LAG_MAIN, UNDEFINED, run_program, run_with_lag
from testkit.data import show
from testkit.full_calibration import device, record, tables
from undrift.correction.correct import correct_checked
from undrift.drift.temperature import without_lag
from undrift.errors import InputError
from undrift.export.c import export_c

LAG_S, SMOOTH_S = 84.0, 6.0


def lagging(**changes):
    return device(drift=replace(tables(), lag_s=LAG_S, lag_smooth_s=SMOOTH_S, **changes))


def ramp(rate_hz, seconds, *, uneven=False, seed=4):
    """A board that warms by 2 degC/min and cools again, seen by a thermometer that trails by the lag, with noise of 0.02 K."""
    n, rng = int(rate_hz * seconds), np.random.default_rng(seed)
    step = rng.uniform(0.1, 1.9, n) / rate_hz if uneven else np.full(n, 1.0 / rate_hz)
    time = np.cumsum(step)
    true = 25.0 + np.interp(time, [0, 0.1 * seconds, 0.5 * seconds, seconds], [0, 0, seconds / 75.0, 0])
    seen, held = np.empty(n), true[0]
    for k in range(n):
        held += (true[k] - held) * -np.expm1(-step[k] / LAG_S)
        seen[k] = held
    r = record(n, time=time, temp_c=seen + rng.normal(size=n) * 0.02)
    return r, true


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["double", "float"])
def test_the_whole_chain_corrects_as_correct_does_with_a_lag(arithmetic, tmp_path):
    calibration = lagging()
    exported = export_c(calibration)
    r, _ = ramp(50.0, 600.0, uneven=True)
    out, same = run_with_lag(exported, tmp_path, arithmetic, r)
    done = correct_checked(same, calibration, policy="hold").record
    led, _ = without_lag(same.temp_c, same.time, lag_s=LAG_S, smooth_s=SMOOTH_S)
    other = correct_checked(
        replace(same, temp_c=same.temp_c), replace(calibration, drift=tables()), policy="hold"
    ).record
    drift = calibration.drift
    per_kelvin = np.abs(np.diff(drift.static.gyro_offset, axis=0)).max() / np.diff(drift.static.temp_c).min()
    slope = (
        per_kelvin * np.abs(calibration.gyro.matrix).sum(axis=1).max() + np.abs(drift.dynamic.error).max() * 2.0 / 0.5
    )
    exact = {"double": 1e-11, "float": 1e-5}[arithmetic]
    limit = exact + slope * float(np.abs(out[:, 6] - led).max())  # rad/s: what the lead's own error makes of the tables
    worst = float(np.abs(out[:, :3] - done.gyro).max())
    show(f"chain with lag, {arithmetic}: worst difference, rad/s", f"{worst:.3g}", f"{limit:.3g}")
    assert worst <= limit
    assert np.abs(other.gyro - done.gyro).max() > 0.1  # without the lead it would be far off
    assert worst < 0.01 * np.abs(other.gyro - done.gyro).max()


@pytest.mark.slow
def test_wild_readings_and_steps_do_nothing_undefined(tmp_path):
    wild = np.array([0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-30, 25.0], dtype="f4")
    inputs = np.random.default_rng(3).choice(wild, (4000, 8))
    run_program(export_c(lagging()), tmp_path, "float", inputs, np.dtype(("f4", 7)), main=LAG_MAIN, options=UNDEFINED)


def test_smoothing_that_does_not_fit_is_refused():
    assert "undrift_temperature" not in export_c(device(drift=tables())).header
    assert "undrift_temperature(undrift_lag_t *lag" in export_c(lagging()).header
    with pytest.raises(InputError, match=r"0.001 to 100000 s .* 84 s .*over 1e-05 s"):
        export_c(device(drift=replace(tables(), lag_s=84.0, lag_smooth_s=1e-5)))
