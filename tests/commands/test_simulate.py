"""``undrift simulate`` and ``undrift info device.json``: files out, figures said, calls refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from testkit.command_line import Undrift
from undrift.cli.app import run
from undrift.io.formats import read_record, read_reference
from undrift.io.reference import write_reference
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task


def test_a_task_and_a_preset_make_a_recording_with_its_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, truth, device = tmp_path / "r.parquet", tmp_path / "t.csv", tmp_path / "d.json"
    words = ["simulate", "sit_to_stand", "--device", "enc03j_3031", "--draw", "-o", str(out), "--seed", "3", "--json"]
    assert run([*words, "--truth", str(truth), "--save-device", str(device)]) == 0
    said = json.loads(capsys.readouterr().out)
    record = read_record(out)
    assert said["data"]["samples"] == len(record)
    assert said["data"]["device"]["name"] == "enc03j_3031"
    assert record.gyro_unit == "count"
    assert len(read_reference(truth)) == len(record)
    rows = {(row["effect"], row["unit"]): row for row in said["tables"]["contribution_of_each_effect_rms"]}
    assert rows["offset", "deg/s"]["x"] > 0.0
    again = tmp_path / "again.parquet"
    assert run(["simulate", "sit_to_stand", "--device", "enc03j_3031", "--draw", "-o", str(again), "--seed", "3"]) == 0
    np.testing.assert_array_equal(read_record(again).gyro, record.gyro)  # type: ignore[arg-type]
    assert "Contribution of each effect" in capsys.readouterr().out

    assert run(["info", str(device), "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described["data"]["kind"] == "device"
    effects = {row["effect"] for row in described["tables"]["device_model"] if row["part"] == "gyro"}
    assert {"scale", "low_pass", "warm_up", "adc"} <= effects
    assert run(["info", str(device)]) == 0
    assert "low_pass" in capsys.readouterr().out


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_truth_is_a_motion_that_is_replayed_with_its_accelerometer(tmp_path: Path, ending: str) -> None:
    first, truth, again = tmp_path / "a.parquet", tmp_path / f"truth.{ending}", tmp_path / "b.parquet"
    assert run(["simulate", "free", "--device", "mpu6050", "-o", str(first), "--truth", str(truth)]) == 0
    assert run(["simulate", str(truth), "--device", "mpu6050", "-o", str(again), "--seed", "1"]) == 0
    one, two = read_record(first), read_record(again)
    assert read_reference(truth).position is not None
    assert len(two) == len(one) - 20  # poses are not believed for 0.1 s at either end
    assert one.accel is not None
    assert two.accel is not None
    apart = two.accel - one.accel[10:-10]
    # counts of 1/4096 g: white noise of 0.028 m/s2 in either makes 16.5, the motion itself is 700 to 1700
    assert float(apart.std(axis=0).max()) < 18.0
    assert float(one.accel.std(axis=0).min()) > 500.0


def test_poses_move_the_device_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, device, out = tmp_path / "poses.parquet", tmp_path / "d.json", tmp_path / "r.parquet"
    write_reference(see(draw_task("sit_to_stand", rng=np.random.default_rng(1)), rng=np.random.default_rng(2)), poses)
    first = ["simulate", "free", "--device", "bmi160", "-o", str(tmp_path / "x.csv"), "--save-device", str(device)]
    assert run(first) == 0
    assert run(["simulate", str(poses), "--device", str(device), "-o", str(out), "--temp-c", "30"]) == 0
    record = read_record(out)
    assert len(record) > 1000
    gaps = int(np.isnan(record.gyro[:, 0]).sum())  # type: ignore[index]
    assert gaps > 0  # the cameras lost the body for 0.2 s, twice
    assert f"{gaps} samples are gaps" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["swim", "--device", "bmi160"], "expected a file of poses or markers, or one of sit_to_stand"),
        (["free", "--device", "gold"], "expected a device.json or one of enc03j_3031"),
        (["free", "--device", "DEVICE", "--draw"], "--draw: expected a preset"),
        (["free", "--device", "bmi160", "--sample-rate-hz", "0"], "expected more than 0 Hz, got 0"),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_one_line(
    undrift: Undrift, words: list[str], message: str, tmp_path: Path
) -> None:
    (tmp_path / "d.json").write_text("{}")
    words = [str(tmp_path / "d.json") if word == "DEVICE" else word for word in words]
    assert message in undrift.refused("simulate", *words, "-o", tmp_path / "r.csv")
    assert not (tmp_path / "r.csv").exists()
