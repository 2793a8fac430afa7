"""BROAD (Laidig et al., Data 2021): twins of three real devices, each judged on recordings that it has not seen.

Limits on lever arm and delays: an earlier implementation's figures for the same trials. The largest
pitch difference within 5 s has no aim: these optics err by 0.04 to 0.06 deg of tilt from 0.4 to 3 Hz, which alone makes 0.13 to
0.18 deg (docs/twin.md). Differences at the end of a window (0.07-0.18 deg an axis) are those of an earlier prototype; the largest
within one is 0.35-0.47 deg. Most of it no parameter of the model explains: a twin of the very recording has it too, slow and fast
motion and three devices have it alike. Poses that err by about 0.1 deg an axis in motion would make it; that the gyroscopes hold
an effect that the model lacks cannot be excluded from these recordings.
"""

from functools import cache

import numpy as np
import pytest

from testkit.broad_trials import DEVICES, trial
from testkit.data import show
from undrift.twin.fit import Twin, fit_twin
from undrift.twin.held_out import compare_held_out

pytestmark = pytest.mark.usefixtures("computed_once")

GRAVITY_M_S2 = 9.813  # Berlin


@cache
def fitted(device: str) -> Twin:
    records, references = zip(*(trial(number) for number in DEVICES[device]), strict=True)
    return fit_twin(records, references, gravity_m_s2=GRAVITY_M_S2, names=[f"{n:02d}" for n in DEVICES[device]])


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_delays_lever_arm_and_codes_are_those_of_the_data_set(device):
    result = {p.name: p for p in fitted(device).parameters}
    arm = np.array([result[f"lever_arm_{axis}"].value for axis in "xyz"])
    gyro, accel = result["gyro_delay"], result["accel_delay"]
    show(
        f"{device}: delay of gyro / accel, ms", f"{1e3 * gyro.value:.2f} / {1e3 * accel.value:.2f}", "4.14 / about 2.4"
    )
    show(f"{device}: lever arm, mm", np.round(1e3 * arm, 2).tolist(), "about 9")
    assert gyro.value == pytest.approx(4.14e-3, abs=5e-5)
    assert accel.value == pytest.approx(2.4e-3, abs=5e-4)
    assert 6e-3 < np.linalg.norm(arm) < 1.2e-2
    adc = fitted(device).adc
    assert adc.gyro_rounding == "toward_zero"
    assert np.degrees(adc.gyro_lsb) == pytest.approx(0.061, abs=1e-4)
    walk = np.degrees([result[f"gyro_angle_random_walk_{axis}"].value for axis in "xyz"])
    show(f"{device}: angle random walk, deg/s/sqrt(Hz)", np.round(walk, 4).tolist(), "0.005-0.008")
    assert 0.004 < walk.min() < walk.max() < 0.008  # 0.007-0.011 one-sided density over sqrt(2)


@pytest.mark.slow
def test_held_out_windows_differ_by_what_the_poses_are_worth():
    medians = []
    for device in DEVICES:
        for t in compare_held_out(fitted(device), rng=np.random.default_rng(0)):
            three = " / ".join(f"{v:.2f}" for v in np.degrees(np.nanquantile(t.pitch, (0.5, 0.95, 1.0))))
            print(
                f"  {t.recording}: {len(t.pitch)} windows of {t.window_s:g} s: pitch {three} deg (median / 95 % / max)"
            )
            if t.window_s == 5.0:
                medians.append(np.degrees(np.nanmedian(t.pitch)))
    show("5 s windows, largest pitch difference, median over trials, deg", f"{np.median(medians):.2f}", 0.45)
    # Set with the figures in view (0.36 and 0.47): these guard against getting worse, for pitch within 60 deg of the plane only.
    assert np.median(medians) < 0.45
    assert max(medians) < 0.55
