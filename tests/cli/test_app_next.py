"""Every next command that a command prints works as it is printed, and so does every one that follows from it."""

import re
import shlex

import numpy as np
import pytest

from commands.test_calibrate_files import BOARD as MAP_OF_BOARD
from testkit.data import data_path, show
from undrift.io.formats import write_record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

NEXT = re.compile(r"^\s*Next: undrift (.+)$", re.MULTILINE)
BOARD = "multipos_mpu9150/imu0.log.gz"
WARM_UP = "thermal_mpu6050_warmup/Tempdata01-02-14.csv.gz"
MAP_OF_WARM_UP = (
    'columns = { time = "Time", gyro = ["Gx", "Gy", "Gz"], accel = ["Ax", "Ay", "Az"], temp = "dTemp" }\n'
    'units = { time = "ms", gyro = "dps", accel = "g", temp = "degC" }\n'
    "scale = { gyro = { gain = 0.06097560976 }, accel = { gain = 0.00006103515625 }, "
    "temp = { gain = 0.00294117647, offset = 36.53 } }\n"
)
CALLS = (  # the command, and how many commands follow from it at least
    (f"info {BOARD} --write-map m.toml --sample-rate-hz 100 --accel-unit m/s2", 3),  # info, calibrate, correct
    (f"info {BOARD} --map board.toml", 2),
    (f"calibrate {BOARD} --map board.toml -o c.json", 1),
    (f"calibrate {BOARD} --map board.toml", 0),
    (f"info {BOARD} --map board.toml --write-session s", 2),
    ("info 'two words/turns.csv'", 2),
    ("info 'two words/turns.csv' --write-session 'my session' --turn-deg 360", 2),
    ("calibrate 'two words/turns.csv' --turn-deg 360 -o 'my calibration.json'", 1),
    ("info wearable_formats/opensim_apdm_imuData01.csv.gz", 1),
    ("info wearable_formats/ximu", 1),
    ("info c3d/squat.c3d.gz", 1),
    ("info bench/session", 2),
    ("calibrate bench/session -o b.json", 1),
    ("correct bench/trial.parquet --calibration bench/calibration.json -o corrected.parquet", 1),
    ("orient bench/corrected.parquet -o o.csv", 0),
    ("noise bench/corrected.parquet --rest-s 0:3", 0),
    (f"drift {WARM_UP} --map warm.toml -o d.json", 1),
    (f"drift {WARM_UP} --map warm.toml --warm-up -o d.json", 1),
)


@pytest.fixture
def here(bench, tmp_path, monkeypatch):
    """A folder with everything under short names, some with a blank."""
    for name in ("c3d", "wearable_formats", "multipos_mpu9150", "multipos_mpu6050_bicycle", "thermal_mpu6050_warmup"):
        (tmp_path / name).symlink_to(data_path(name))
    (tmp_path / "bench").symlink_to(bench)
    (tmp_path / "board.toml").write_text(MAP_OF_BOARD)
    (tmp_path / "warm.toml").write_text(MAP_OF_WARM_UP)
    (tmp_path / "two words").mkdir()
    session = simulate_session(
        "ferraris", random_device(np.random.default_rng(7)), rng=np.random.default_rng(8), labelled=False
    )
    write_record(session.records[0], tmp_path / "two words" / "turns.csv")
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("call", "least"), CALLS, ids=[call for call, _ in CALLS])
def test_every_next_command_works_as_printed(undrift, here, call, least):
    waiting, done = [call], []
    while waiting:
        words = waiting.pop(0)
        answer = undrift(*shlex.split(words))
        assert answer.code != 2, (words, answer.err)
        assert not re.search(r"\b(RECORD|FILE|SECONDS)\b", "".join(NEXT.findall(answer.out)))
        done.append(words)
        waiting += [found for found in NEXT.findall(answer.out) if found not in [*done, *waiting]]
    show("commands", done)
    assert len(done) - 1 >= least
