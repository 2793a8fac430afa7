"""BROAD (Laidig et al., Data 2021): the gyroscope lags the optics by 4.1 ms, and the optics were up-sampled from 120 Hz."""

import numpy as np
import pytest

from testkit.broad_trials import FILES, trial
from testkit.data import show
from undrift.sync import find_lag, native_poses

pytestmark = pytest.mark.usefixtures("computed_once")

# Per trial, from an earlier analysis of the same files with differentiated poses cut off at 20 Hz, ms.
KNOWN_MS = {2: 4.12, 3: 4.14, 5: 4.14, 7: 4.16, 9: 4.15, 24: 4.14, 32: 4.16, 35: 4.06}


@pytest.mark.parametrize("number", FILES)
def test_the_gyro_lag_is_4_14_ms(number):
    lag = find_lag(*trial(number))
    found, uncertainty = lag.seconds * 1e3, lag.standard_uncertainty * 1e3
    show(
        f"trial {number:02d} gyro lag, ms", f"{found:.3f} +- {uncertainty:.3f}", f"{KNOWN_MS[number]} and 4.14 +- 0.10"
    )
    assert found == pytest.approx(4.14, abs=0.10)
    assert found == pytest.approx(KNOWN_MS[number], abs=0.10)
    assert uncertainty < 0.1
    assert lag.correlation > 0.998


@pytest.mark.parametrize("number", FILES)
def test_the_optics_are_frames_of_120_hz_drawn_on_straight_lines(number):
    _, reference = trial(number)
    native = native_poses(reference)
    show(
        f"trial {number:02d} frames per second of the sensor's clock",
        f"{native.sample_rate_hz:.4f}",
        "120, clock apart",
    )
    # The clock of the cameras runs 1.25e-4 to 1.4e-4 beside that of the sensor: the same in all trials.
    assert native.sample_rate_hz == pytest.approx(120.0158, abs=0.0015)
    # Drawn to the sensor's samples again, the frames give the file back.
    k = np.searchsorted(native.time, reference.time, side="right") - 1
    inside = (k >= 0) & (k + 1 < len(native))
    k = k[inside]
    share = ((reference.time[inside] - native.time[k]) / (native.time[k + 1] - native.time[k]))[:, None]
    a, b = native.q_nb[k], native.q_nb[k + 1]
    b = b * np.where((a * b).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    q = a + share * (b - a)
    q = q / np.linalg.norm(q, axis=1)[:, None]
    q_file = reference.q_nb[inside]
    miss = 2.0 * np.degrees(np.linalg.norm(q * np.sign((q * q_file).sum(axis=1))[:, None] - q_file, axis=1))
    worst = float(np.nanquantile(miss, 0.999))
    show(f"trial {number:02d} file less frames redrawn, deg (99.9 %)", f"{worst:.1e}", 1e-2)
    assert worst < 1e-2  # a chord instead of an arc, and 1e-6 s of phase
