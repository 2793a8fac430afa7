"""BROAD (Laidig et al., Data 2021): what a real sensor said against what its poses say it should have felt.

Limits: mean over the eight trials of 2.8 deg/s at 20 Hz and 0.17 m/s2 at 10 Hz, per axis, after delay, rotation, offset, 3 x 3 and
lever arm. They were set by an earlier analysis of the same files whose low-pass was a second-order Butterworth that was 3 dB
down at 20 Hz in EACH of its two passes, orientation and position alike: 16.0 Hz for both passes together, as undrift counts.
With that filter on both sides its figures come back trial by trial, so it is the filter of the limits. Noise of
the poses grows steeply with frequency, so the sharper default at a true 20 Hz leaves more: that figure is shown beside.
"""

from functools import cache

import numpy as np
import pytest

from testkit.broad_trials import FILES, trial
from testkit.data import show
from undrift.sim.motion.poses import (
    ORDER,
    PoseSettings,
    fit_pose_spline,
    zero_phase,
)
from undrift.sync import find_lag, native_poses

pytestmark = pytest.mark.usefixtures("computed_once")

BERLIN = 9.813
EACH_PASS = (np.sqrt(2.0) - 1.0) ** 0.25  # 3 dB in each of two second-order passes: both together are 3 dB down here
# Trial: gyro deg/s at 20 Hz, accelerometer m/s2 at 10 Hz, as the earlier analysis printed them.
KNOWN = {
    2: (2.85, 0.117),
    3: (2.23, 0.094),
    5: (2.76, 0.119),
    7: (3.92, 0.277),
    9: (3.08, 0.194),
    24: (2.80, 0.316),
    32: (2.33, 0.102),
    35: (2.16, 0.093),
}


def rms(values):
    return float(np.sqrt((values**2).mean()))


@cache
def seen(number):
    record, reference = trial(number)
    return record, native_poses(reference), find_lag(record, reference).seconds


def gyro_residual(number, cutoff_hz, order):
    """Return rms residual per axis and rms signal, deg/s: rotation, 3 x 3 and offset by least squares."""
    record, poses, lag = seen(number)
    motion = fit_pose_spline(poses, PoseSettings(cutoff_hz=cutoff_hz, order=order)).at(record.time - lag, BERLIN)
    said = zero_phase(record.gyro, cutoff_hz, sample_rate_hz=record.sample_rate_hz, order=order)
    use = motion.valid * motion.moving > 0.0
    design = np.column_stack((motion.rate_b[use], np.ones(use.sum())))
    residual = said[use] - design @ np.linalg.lstsq(design, said[use])[0]
    return np.degrees(rms(residual)), np.degrees(rms(said[use]))


def accel_fit(motion, said, use):
    """Return what 3 x 3, offset and lever arm leave, and the lever arm."""
    rate, swing, arms = motion.rate_b[use], motion.angular_acceleration_b[use], np.eye(3)
    lever = np.stack([np.cross(swing, arm) + np.cross(rate, np.cross(rate, arm)) for arm in arms], axis=2)
    design = np.concatenate(
        (
            np.einsum("ij,nk->nijk", np.eye(3), motion.force_b[use]).reshape(-1, 3, 9),
            np.broadcast_to(np.eye(3), lever.shape),
            lever,
        ),
        axis=2,
    ).reshape(-1, 15)
    solution = np.linalg.lstsq(design, said[use].reshape(-1))[0]
    return said[use].reshape(-1) - design @ solution, solution[12:]


def accel_residual(number, cutoff_hz, order):
    """Return rms residual and rms signal about its mean, m/s2, lever arm m and delay s: the delay by a search."""
    record, poses, _ = seen(number)
    spline = fit_pose_spline(poses, PoseSettings(cutoff_hz=cutoff_hz, position_cutoff_hz=cutoff_hz, order=order))
    said = zero_phase(record.accel, cutoff_hz, sample_rate_hz=record.sample_rate_hz, order=order)
    tried = np.arange(0.0, 0.0051, 0.001)
    residuals = []
    for delay in tried:
        motion = spline.at(record.time - delay, BERLIN)
        residuals.append(rms(accel_fit(motion, said, motion.valid * motion.moving > 0.0)[0]))
    bend, slope, _ = np.polyfit(tried, np.square(residuals), 2)
    delay = float(-slope / (2.0 * bend))
    motion = spline.at(record.time - delay, BERLIN)
    use = motion.valid * motion.moving > 0.0
    residual, arm = accel_fit(motion, said, use)
    return rms(residual), rms(said[use] - said[use].mean(axis=0)), arm, delay


@pytest.mark.slow
def test_gyro_differs_from_the_poses_by_less_than_2_8_dps():
    error = {number: gyro_residual(number, 20.0 * EACH_PASS, 2) for number in FILES}
    for number, (residual, signal) in error.items():
        show(
            f"trial {number:02d} gyro, 20 Hz each pass, deg/s rms", f"{residual:.2f} of {signal:.0f}", KNOWN[number][0]
        )
        # Frames instead of lines between them: the earlier analysis took the lines, which round off fast motion (07) and noise.
        assert residual == pytest.approx(KNOWN[number][0], rel=0.11)
    mean = np.mean([residual for residual, _ in error.values()])
    show("mean over trials, gyro at 20 Hz, deg/s rms per axis", f"{mean:.2f}", 2.8)
    assert mean <= 2.8
    sharp = np.mean([gyro_residual(number, 20.0, ORDER)[0] for number in FILES])
    show(
        "   the same with the default filter, 3 dB down at 20 Hz after both passes", f"{sharp:.2f}", f"{1.4 * mean:.2f}"
    )
    assert sharp < 1.4 * mean  # noise of angle, flat in frequency, is noise of rate as f^1.5: (20 / 16)^1.5 = 1.40


@pytest.mark.slow
def test_accel_differs_from_the_poses_by_less_than_0_17_m_s2():
    error = {number: accel_residual(number, 10.0 * EACH_PASS, 2) for number in FILES}
    for number, (residual, signal, arm, delay) in error.items():
        show(
            f"trial {number:02d} accelerometer, 10 Hz each pass, m/s2 rms",
            f"{residual:.3f} of {signal:.2f}. Arm {np.round(1e3 * arm, 1)} mm, delay {1e3 * delay:.2f} ms",
            KNOWN[number][1],
        )
        assert residual == pytest.approx(KNOWN[number][1], abs=0.006)
        assert 1e-3 < delay < 4e-3
    mean = np.mean([figures[0] for figures in error.values()])
    show("mean over trials, accelerometer at 10 Hz, m/s2 rms per axis", f"{mean:.3f}", 0.17)
    assert mean <= 0.17
    arms = np.array([figures[2] for number, figures in error.items() if number in (7, 9)])
    show("lever arm in the two fast trials, mm", np.round(1e3 * arms, 1).tolist(), "about 9 mm; 1.5 mm of one another")
    assert np.linalg.norm(arms, axis=1) == pytest.approx(0.008, abs=0.0015)
    assert np.abs(arms[0] - arms[1]).max() < 1.5e-3  # one board, one device
