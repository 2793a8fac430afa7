"""undrift noise: coefficients with their intervals, and the Allan plot."""

import numpy as np
import pytest

from testkit.data import show
from undrift.io.formats import write_record
from undrift.record import Record


@pytest.mark.slow
def test_an_angle_after_a_minute_stays_within_its_uncertainty(undrift, tmp_path):
    """Offset from 60 s, then 60 s: of the pairs of the second half at least nine in ten stay within what the first half states."""
    rng = np.random.default_rng(9)
    n = 360_000
    rate = rng.normal(0.0, 1e-3, (n, 3)) + np.cumsum(rng.normal(0.0, 1e-6, (n, 3)), axis=0)
    write_record(Record(time=np.arange(n) / 100.0, gyro=rate), tmp_path / "rest.parquet")
    words = ("noise", tmp_path / "rest.parquet", "--rest-s", "0:1800", "--json")
    axes = undrift.good(*words).json()["tables"]["angle_after_60_s"]
    angles = [row["all (deg)"] for row in axes]
    white = max(row["white noise (deg)"] for row in axes)
    assert white == pytest.approx(2.0 * np.degrees(1e-4) * np.sqrt(2.0 * 60.0), rel=0.06)  # k N sqrt(2 tau)
    ends_deg = np.degrees(60.0 * np.diff(rate[n // 2 :].reshape(-1, 6000, 3).mean(axis=1), axis=0))
    within = abs(ends_deg) <= angles
    show("angle after 60 s, within U, %", 100.0 * np.mean(within), ">= 90 %")
    assert np.mean(within) >= 0.9
    assert np.std(ends_deg) > max(angles) / 5.0  # nor is it much too wide
