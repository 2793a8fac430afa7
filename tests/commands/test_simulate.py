"""``undrift simulate`` and ``undrift info device.json``: files out, figures said, calls refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from testkit.command_line import Undrift
from undrift.io.formats import read_record, read_reference
from undrift.io.reference import write_reference
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task


def test_a_task_and_a_preset_make_a_recording_with_its_truth(undrift: Undrift, tmp_path: Path) -> None:
    out, truth, device = tmp_path / "r.parquet", tmp_path / "t.csv", tmp_path / "d.json"
    words = ("simulate", "sit_to_stand", "--device", "enc03j_3031", "--draw", "--seed", 3)
    said = undrift.good(*words, "-o", out, "--truth", truth, "--save-device", device, "--json").json()
    record = read_record(out)
    assert said["data"]["samples"] == len(record)
    assert said["data"]["device"]["name"] == "enc03j_3031"
    assert record.gyro_unit == "count"
    assert len(read_reference(truth)) == len(record)
    rows = {(row["effect"], row["unit"]): row for row in said["tables"]["contribution_of_each_effect_rms"]}
    assert rows["offset", "deg/s"]["x"] > 0.0
    again = tmp_path / "again.parquet"
    assert "Contribution of each effect" in undrift.good(*words, "-o", again).out
    np.testing.assert_array_equal(read_record(again).gyro, record.gyro)  # type: ignore[arg-type]
    described = undrift.good("info", device, "--json").json()
    assert described["data"]["kind"] == "device"
    effects = {row["effect"] for row in described["tables"]["device_model"] if row["part"] == "gyro"}
    assert {"scale", "low_pass", "warm_up", "adc"} <= effects
    assert "low_pass" in undrift.good("info", device).out


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_truth_is_a_motion_that_is_replayed_with_its_accelerometer(
    undrift: Undrift, tmp_path: Path, ending: str
) -> None:
    first, truth, again = tmp_path / "a.parquet", tmp_path / f"truth.{ending}", tmp_path / "b.parquet"
    undrift.good("simulate", "free", "--device", "mpu6050", "-o", first, "--truth", truth)
    undrift.good("simulate", truth, "--device", "mpu6050", "-o", again, "--seed", 1)
    one, two = read_record(first), read_record(again)
    assert read_reference(truth).position is not None
    assert len(two) == len(one) - 20  # poses are not believed for 0.1 s at either end
    assert one.accel is not None
    assert two.accel is not None
    apart = two.accel - one.accel[10:-10]
    # counts of 1/4096 g: white noise of 0.028 m/s2 in either makes 16.5, the motion itself is 700 to 1700
    assert float(apart.std(axis=0).max()) < 18.0
    assert float(one.accel.std(axis=0).min()) > 500.0


def test_poses_move_the_device_of_a_file(undrift: Undrift, tmp_path: Path) -> None:
    poses, device, out = tmp_path / "poses.parquet", tmp_path / "d.json", tmp_path / "r.parquet"
    write_reference(see(draw_task("sit_to_stand", rng=np.random.default_rng(1)), rng=np.random.default_rng(2)), poses)
    undrift.good("simulate", "free", "--device", "bmi160", "-o", tmp_path / "x.csv", "--save-device", device)
    answer = undrift.good("simulate", poses, "--device", device, "-o", out, "--temp-c", 30)
    record = read_record(out)
    assert len(record) > 1000
    gaps = int(np.isnan(record.gyro[:, 0]).sum())  # type: ignore[index]
    assert gaps > 0  # the cameras lost the body for 0.2 s, twice
    assert f"{gaps} samples are gaps" in answer.out


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
