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


READINGS = """columns = { time = 0, accel = [5, 6, 7], gyro = [8, 9, 10] }
units = { time = "s", accel = "m/s2", gyro = "rad/s" }
header = false
skip_rows = 2
delimiter = ";"
repair_time = true
"""
POSES = """columns = { time = 0, quaternion = [1, 2, 3, 4] }
units = { time = "s" }
repair_time = true
layout = { delimiter = ";", skip_rows = 2, header = false }
"""


@pytest.mark.parametrize(("up", "most_deg"), [("x", 5.0), ("-x", 180.0)])
def test_vertical_of_a_pendulum_is_checked(undrift, tmp_path, up, most_deg):
    path = data_path(PENDULUM, "Pendulum_Test02b_Trial1_Segment_1.csv.gz")
    (tmp_path / "own.toml").write_text(READINGS)
    (tmp_path / "true.toml").write_text(f'up = "{up}"\n{POSES}')
    words = ("validate", path, "--map", tmp_path / "own.toml", "--reference", path)
    answer = undrift(*words, "--reference-map", tmp_path / "true.toml", "--json").json()
    assert answer["data"]["trials"][0]["rmse_inclination_deg"] < most_deg
    codes = [item["code"] for item in answer["findings"]]
    assert ("validate.not_up" in codes) == (up == "-x")  # the device reads +g along x, and turns about z only


def test_reordered_quaternion_is_named(undrift, tmp_path):
    own, true = (data_path(CHAIN, f"seg2_trial2_{name}.csv.gz") for name in ("imu", "optics"))
    undrift.good("info", own, "--gyro-unit", "rad/s", "--write-map", tmp_path / "own.toml")
    names = ", ".join(f'"seg2_quat_{axis}"' for axis in "xyzw")
    layout = "sample_rate_hz = 30\nlayout = { skip_rows = 2 }\n"
    (tmp_path / "true.toml").write_text(f"columns = {{ quaternion = [{names}] }}\n{layout}")
    words = ("validate", own, "--map", tmp_path / "own.toml", "--reference", true)
    answer = undrift(*words, "--reference-map", tmp_path / "true.toml")
    assert answer.code == 2
    assert "its quaternions are x-y-z-w, not w-x-y-z" in answer.err
