"""Recordings with references under names of their own are read by commands alone: info writes both maps, validate takes them."""

import pytest

from testkit.data import data_path, show

CHAIN, ROBOT, PENDULUM = "chain_with_optics", "robot_arm_reference", "pendulum_with_optics"


@pytest.mark.parametrize(
    ("recording", "reference", "stated", "raw_deg"),
    [
        (
            (CHAIN, "seg2_trial1_imu.csv.gz"),
            (CHAIN, "seg2_trial1_optics.csv.gz"),
            ("--gyro-unit", "rad/s"),
            (40.0, 50.0),
        ),
        (
            (ROBOT, "circle-100_carpus_imu.csv.gz"),
            (ROBOT, "circle-100_carpus_robot.csv.gz"),
            ("--sample-rate-hz", "125", "--gyro-unit", "rad/s"),
            (1.0, 3.0),
        ),
    ],
    ids=["chain", "robot"],
)
def test_both_maps_are_proposed_and_validate_takes_them(undrift, tmp_path, recording, reference, stated, raw_deg):
    own, true = (data_path(*parts) for parts in (recording, reference))
    undrift.good("info", own, *stated, "--write-map", tmp_path / "own.toml")
    described = undrift.good("info", true).out
    assert "a table of orientations" in described
    assert "--reference-map map.toml" in described
    undrift.good("info", true, "--write-map", tmp_path / "true.toml")
    seen = undrift.good("info", true, "--map", tmp_path / "true.toml", "--json").data()
    assert (seen["kind"], seen["rows"] > 1000) == ("reference", True)
    words = ("validate", own, "--map", tmp_path / "own.toml", "--reference", true, "--offset", "none")
    answer = undrift(*words, "--reference-map", tmp_path / "true.toml", "--max-lag-s", "1300", "--json")
    assert answer.code == 0, answer
    (trial,) = answer.data()["trials"]
    low, high = raw_deg  # SOURCE.md: 48.0 deg over the whole trial, 1.4 to 2.4 deg
    show(f"{recording[1]}: end error of raw readings, deg", trial["end_total_deg"], f"{low:g}-{high:g}")
    assert low < trial["end_total_deg"] < high


PENDULUM_MAP = """
delimiter = ";"
columns = { time = 0, gyro = [8, 9, 10], accel = [5, 6, 7] }
units = { time = "s", gyro = "rad/s", accel = "m/s2" }
header = false
skip_rows = 2
repair_time = true
"""


@pytest.mark.slow
def test_columns_under_two_header_rows_are_read_by_positions(undrift, tmp_path):
    path = data_path(PENDULUM, "Pendulum_Test02a_Trial1_Segment_1.csv.gz")
    (tmp_path / "map.toml").write_text(PENDULUM_MAP)
    read = undrift.good("info", path, "--map", tmp_path / "map.toml", "--json").data()
    assert read["rows"] > 15_000


def test_a_map_of_readings_is_no_map_of_a_reference(undrift, tmp_path):
    (tmp_path / "map.toml").write_text(
        'columns = { time = "t", gyro = ["x", "y", "z"] }\nunits = { time = "s", gyro = "dps" }\n'
    )
    own, true = (data_path(CHAIN, f"seg2_trial1_{one}.csv.gz") for one in ("imu", "optics"))
    undrift.good("info", own, "--gyro-unit", "rad/s", "--write-map", tmp_path / "own.toml")
    words = (
        "validate",
        own,
        "--map",
        tmp_path / "own.toml",
        "--reference",
        true,
        "--reference-map",
        tmp_path / "map.toml",
    )
    refused = undrift(*words)
    assert refused.code == 2
    assert "map.toml: expected a map of orientations, got none" in refused.err
