"""The guide through poses of any kind: each new one counts once, and what it asks for calibrates the accelerometers."""

import numpy as np
import pytest

import undrift
from testkit.hand_held import Tremor, hand_held_log
from undrift.commands.bench.capture import Capture
from undrift.commands.bench.guides import POSES, Poses
from undrift.record import Record

STEADY = Tremor(rate_dps=0.02, sway_deg=0.005, accel=0.002)


def fed(guide: Poses, record: Record, step_s: float = 0.2) -> list[str]:
    """Feed a guide with a recording as it comes; return what it said."""
    said = list[str]()
    for now in np.arange(1.0, record.time[-1], step_s):
        said.append(guide.update(record.between(now - 1.0, now), float(now)).text)
    return said


@pytest.fixture
def guide(tmp_path) -> Poses:
    return Poses(Capture(tmp_path / "session"))


@pytest.mark.slow
def test_poses_that_differ_are_captured_and_calibrate(guide):
    rng = np.random.default_rng(5)
    record, _ = hand_held_log(rng, STEADY, poses=POSES + 3, hold_s=(6.0, 8.0))
    said = fed(guide, record)
    assert guide.complete
    assert guide.wanted is None
    assert [*guide.done] == list(guide.order)
    assert all(span.stop_s - span.start_s >= 3.0 for span in guide.done.values())
    assert any("Hold it still in another pose" in text for text in said)
    made = undrift.calibrate(record, accel="multi-position", gyro="rest")
    assert made.accel is not None


def test_the_same_pose_counts_once_and_asks_for_another(guide):
    rng = np.random.default_rng(6)
    record, (first, *_) = hand_held_log(rng, STEADY, poses=3, hold_s=(14.0, 15.0))
    said = fed(guide, record.between(0.0, float(first[1]) - 0.5))
    assert (len(guide.done), guide.wanted) == (1, "2")
    assert said[-1] == "This pose is captured. Tilt it by 30 deg or more in any direction."
    assert "Captured. Tilt it by 30 deg or more in any direction." in said
    assert "Still. Do not touch it." in said
