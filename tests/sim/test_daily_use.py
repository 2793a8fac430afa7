"""Daily use that does not exist: what is drawn, and what the command writes."""

import json

import numpy as np
import pytest

from testkit.data import show
from undrift.cli.app import run
from undrift.errors import InputError
from undrift.io.formats import read_record
from undrift.sim.daily_use import DailyUseSettings, board_temperature, draw_day, simulate_daily_use
from undrift.sim.device.presets import preset
from undrift.units import RADIAN_PER_DEGREE as DPS

QUICK = DailyUseSettings(days=60, rest_s=4.0, worn_s=4.0, sample_rate_hz=10.0)


def test_each_day_is_a_switch_on_of_a_device_that_ages():
    rng = np.random.default_rng(4)
    pool = [draw_day(rng, QUICK)]
    days = list(simulate_daily_use(preset("mpu6050"), rng=rng, settings=QUICK, motions=pool))
    aged = np.array([day.aged for day in days]) / DPS
    shift = np.array([day.shift for day in days]) / DPS - aged
    show("turn-on, deg/s", shift.std(), 0.03)
    show("ageing in 30 days, deg/s", np.diff(aged, axis=0).std() * 30.0**0.5, 0.02)
    assert 0.025 < shift.std() < 0.035  # 180 draws: three standard errors
    assert 0.016 < np.diff(aged, axis=0).std() * 30.0**0.5 < 0.024
    assert [day.number for day in days] == list(range(60))
    assert all(not day.session.stills and day.session.serial == preset("mpu6050").serial for day in days)


def test_the_board_warms_in_use_and_cools_when_put_down():
    rng = np.random.default_rng(4)
    use = DailyUseSettings(outdoors=0.0, room_sd_c=0.0, rise_c=(8.0, 8.0), warming_s=10.0)
    motion = draw_day(rng, use)
    temp = board_temperature(motion, rng, use)
    assert temp[0] == pytest.approx(20.0)
    assert temp.max() == pytest.approx(28.0, abs=0.1)
    assert temp[-1] < 21.0


def test_a_shift_moves_the_constant_offset_alone():
    gyro = preset("mpu6050").gyro
    moved = gyro.shifted(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(moved.offset.constant - gyro.offset.constant, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(moved.offset.per_k, gyro.offset.per_k)


def test_the_command_writes_a_recording_for_each_day_named_by_its_date(tmp_path, capsys):
    words = ["simulate", "daily_use", "--device", "mpu6050", "--days", "2", "--sample-rate-hz", "10"]
    assert run([*words, "-o", str(tmp_path / "days"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["days"] == 2
    names = sorted(path.name for path in (tmp_path / "days").iterdir())
    assert names == ["2026-01-01.parquet", "2026-01-02.parquet"]
    record = read_record(tmp_path / "days" / names[0])
    assert answer["temp_c"][0] <= record.temp_c.min() < record.temp_c.max() <= answer["temp_c"][1]


def test_options_that_would_do_nothing_are_refused(tmp_path, capsys):
    start = ["simulate", "--device", "mpu6050", "-o", str(tmp_path / "x.parquet")]
    assert run([*start, "step", "--days", "3"]) == 2
    assert "wanted no --days" in capsys.readouterr().err
    assert run([*start[:3], "-o", str(tmp_path / "days"), "daily_use", "--temp-c", "20"]) == 2
    assert "leave the others out" in capsys.readouterr().err
    with pytest.raises(InputError, match="wanted a day or more"):
        DailyUseSettings(days=0)
