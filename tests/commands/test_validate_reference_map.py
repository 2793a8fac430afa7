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
