"""undrift calibrate --rates: the log of a rate table's own controller gives the rates of its dwells."""

import numpy as np

from testkit.command_line import row_of
from testkit.data import show
from testkit.rate_table_log import GAIN, OFFSET, bench
from undrift.io.formats import write_record
from undrift.record import Record


def test_calibrate_takes_the_rates_of_a_log(undrift, tmp_path):
    record, dwells, path = bench(tmp_path)
    write_record(record, tmp_path / "table.parquet")
    words = ("calibrate", tmp_path / "table.parquet", "--rates", path, "--gravity-m-s2", 9.81, "--json")
    told = undrift(*words).json()
    matrix, offset = np.array(told["data"]["gyro"]["matrix"]), np.array(told["data"]["gyro"]["offset"])
    rate = (np.eye(3) * 40.0) @ GAIN.T + OFFSET  # dps
    off = np.degrees((rate - offset) @ matrix.T) - 40.0 * np.eye(3)
    show("corrected rates off by", f"{np.abs(off).max():.4f}", "0.05 deg/s at 40 deg/s")
    assert told["data"]["gyro"]["method"].startswith("rate-table")
    assert np.abs(off).max() < 0.05
    assert row_of(told, "recordings", "table.parquet")["turns used"] == len(dwells)
    assert abs(row_of(told, "clock_of_the_log", "table.parquet")["drift (ppm)"] - 200.0) < 100.0


def test_log_of_another_run_is_refused(undrift, tmp_path):
    record, _, path = bench(tmp_path)
    still = Record(time=record.time, gyro=record.gyro * 0.0 + np.random.default_rng(1).normal(size=record.gyro.shape))
    write_record(still, tmp_path / "still.parquet")
    line = undrift.refused("calibrate", tmp_path / "still.parquet", "--rates", path, "-o", tmp_path / "c.json")
    assert "no common motion" in line
    assert not (tmp_path / "c.json").exists()
