"""Rates from a table's own log: a simulated table whose controller has another clock, coarse steps and gaps; then a real one."""

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.rate_table_log import bench
from testkit.stepper_jig import RUNS, turned
from undrift.errors import AlignmentError, FileFormatError, InputError
from undrift.rate_log import align_clocks, cut_dwells, read_rate_log
from undrift.record import Record


@pytest.mark.parametrize(
    ("how", "limit_s"),
    [
        ({}, 0.005),
        ({"step_s": 0.2, "gaps": 0.05, "drift": -3e-4, "offset_s": -40.0}, 0.02),
        ({"column": "turn_rate_dps", "resolution_deg": 0.05, "step_s": 0.1}, 0.01),
    ],
)
def test_offset_drift_and_rates_of_another_clock_are_found(tmp_path, how, limit_s):
    record, dwells, path = bench(tmp_path, **how)
    log = read_rate_log(path)
    clocks = align_clocks(log, record)
    offset, drift = how.get("offset_s", 1234.5), how.get("drift", 2e-4)
    for at in (0.0, clocks.middle_s, log.time[-1]):
        off = clocks.later(at) - (at * (1.0 + drift) + offset)
        show(
            f"clocks apart at {at:.0f} s",
            f"{off * 1e3:+.2f} ms +- {clocks.uncertainty_s(at) * 1e3:.2f}",
            f"{limit_s * 1e3:g} ms",
        )
        assert abs(off) < min(limit_s, 4.0 * clocks.uncertainty_s(at))
    assert abs(clocks.skew - drift) < 4.0 * clocks.skew_uncertainty
    turns, missed = cut_dwells(log, [(record, clocks)])
    assert len(turns) == len(dwells)
    assert missed == 0
    for result, (start, stop, up, rate) in zip(turns, dwells, strict=True):
        turn = result.turn
        assert turn.axis == up[1]
        assert abs(np.degrees(turn.turn_rate) - rate) < 4.0 * np.degrees(result.uncertainty) + 1e-9
        assert np.degrees(result.uncertainty) < 0.05
        inside = (record.time[[turn.start, turn.stop - 1]] - offset) / (1.0 + drift)
        assert start + 0.3 < inside[0] < inside[1] < stop - 0.3


def test_stated_uncertainties_hold_over_draws(tmp_path):
    off = []
    for seed in range(4):
        record, dwells, path = bench(tmp_path, seed=seed, step_s=0.1, resolution_deg=0.1)
        log = read_rate_log(path)
        clocks = align_clocks(log, record)
        truth = clocks.middle_s * (1.0 + 2e-4) + 1234.5
        off.append((clocks.later(clocks.middle_s) - truth) / clocks.lag_uncertainty_s)
        turns, _ = cut_dwells(log, [(record, clocks)])
        errors = [np.degrees(t.turn.turn_rate) - rate for t, (*_, rate) in zip(turns, dwells, strict=True)]
        scaled = np.array(errors) / np.degrees([t.uncertainty for t in turns])
        assert np.sqrt(np.mean(scaled**2)) < 1.5
    show("offset error over its uncertainty, rms", f"{np.sqrt(np.mean(np.square(off))):.2f}", "below 1.5")
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_an_angle_that_wraps_and_semicolons_with_commas_are_read(tmp_path):
    _record, _dwells, path = bench(tmp_path)
    plain = read_rate_log(path)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    wrapped = ["time_ms;angle_deg"]
    wrapped += [f"{float(t) * 1e3:.3f};{float(a) % 360.0:.2f}".replace(".", ",") for t, a in rows[1:]]
    path.write_text("\n".join(wrapped) + "\n")
    other = read_rate_log(path)
    np.testing.assert_allclose(np.diff(other.time), np.diff(plain.time), atol=1e-6)
    np.testing.assert_allclose(np.diff(other.angle), np.diff(plain.angle), atol=np.radians(0.011))


def test_log_of_another_run_is_refused(tmp_path):
    record, _, path = bench(tmp_path)
    log = read_rate_log(path)
    rng = np.random.default_rng(3)
    other = Record(
        time=record.time,
        gyro=np.repeat(30.0 * rng.normal(size=(len(record) // 500 + 1, 3)), 500, axis=0)[: len(record)],
    )
    with pytest.raises(AlignmentError, match="no common motion"):
        align_clocks(log, other)
    jumped = np.where(np.arange(len(record)) > len(record) // 2, record.time + 3.0, record.time)
    with pytest.raises(AlignmentError, match="no common motion"):
        align_clocks(log, Record(time=jumped, gyro=record.gyro, gyro_unit="dps"))
    with pytest.raises(InputError, match="has no gyroscope"):
        align_clocks(log, Record(time=record.time, accel=record.accel))
    reversed_z = Record(
        time=record.time, gyro=record.gyro * [1, 1, -1], accel=record.accel, gyro_unit="dps", accel_unit="m/s2"
    )
    with pytest.raises(InputError, match="x and z have opposite"):
        cut_dwells(log, [(reversed_z, align_clocks(log, reversed_z))])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("time_s,speed\n0,1\n", "one column"),
        ("time_s,angle_deg,turn_rate_dps\n0,1,2\n", "one column"),
        ("time_s,angle_deg\n" + "0,1\n" * 40, "time that repeats"),
        ("time_s,angle_deg\n0,1\n1,2\n", "30 rows"),
    ],
)
def test_a_log_that_cannot_be_read_says_why(tmp_path, text, complaint):
    (tmp_path / "rates.csv").write_text(text)
    with pytest.raises(FileFormatError, match=complaint):
        read_rate_log(tmp_path / "rates.csv")


@pytest.mark.parametrize("run", RUNS[:1])
def test_log_of_a_real_table_gives_its_commanded_rates(tmp_path, run):
    held = np.load(data_path("ratetable_jig", f"{run}.npz"))
    path = tmp_path / "rates.csv"
    rows = zip(held["t_jig"], held["top_angle_deg"], strict=True)
    path.write_text("time_s,angle_deg\n" + "".join(f"{t:.6f},{a:.6f}\n" for t, a in rows))
    record, turns = turned(run, "bno")
    log = read_rate_log(path)
    clocks = align_clocks(log, record)
    result, _ = cut_dwells(log, [(record, clocks)])
    by_rate = {round(np.degrees(item.turn.turn_rate)): item for item in result}
    show(f"{run}: clocks apart, s", f"{clocks.lag_s:.3f} +- {clocks.lag_uncertainty_s:.3f}", "0.0..0.7 (SOURCE.md)")
    assert 0.0 < abs(clocks.lag_s) < 0.7
    assert len(turns) >= 7
    for turn in turns:
        match = by_rate[round(np.degrees(turn.turn_rate))]
        assert match.turn.axis == "y"
        assert abs(match.turn.turn_rate / turn.turn_rate - 1.0) < 1e-3
        assert abs(record.time[match.turn.start] - record.time[turn.start]) < 1.0
