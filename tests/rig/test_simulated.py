"""The simulated bench: its seed, its chamber, its table. Runs on it: test_run.py."""

import numpy as np
import pytest

from testkit.rig_bench import SHORT, run, with_set_points
from undrift.io.session import read_session
from undrift.rig.simulated import AirSettings, SimulatedBench, SimulatedSettings
from undrift.sim.device.presets import random_device

DEVICE = random_device(np.random.default_rng(3), grade="consumer")


def own(bench):
    return bench.readings[0]


def test_the_same_seed_makes_the_same_run_and_another_seed_another(tmp_path):
    read = []
    for name, seed in (("one", 1), ("same", 1), ("other", 2)):
        run(SimulatedBench((DEVICE,), SimulatedSettings(seed=seed)), tmp_path / name, readings=own)
        read.append([record.gyro for record in read_session(tmp_path / name).records])
    assert all(np.array_equal(a, b) for a, b in zip(read[0], read[1], strict=True))
    assert not np.array_equal(read[0][0], read[2][0])


def test_a_chamber_soaks_and_the_board_follows(tmp_path):
    air = AirSettings(ramp_c_per_min=60.0, period_s=20.0, board_lag_s=10.0)
    bench = SimulatedBench((DEVICE,), SimulatedSettings(air=air))
    run(bench, tmp_path / "run", with_set_points(SHORT, 30.0, 40.0), chamber=bench.chamber, readings=own)
    temps = {round(turn.temp_c) for turn in read_session(tmp_path / "run").turns}
    assert len(temps) == 2
    assert max(temps) - min(temps) == pytest.approx(10.0, abs=1.0)
    bench.chamber.close()
    bench.clock.wait(3600.0)
    assert bench.chamber.read() == pytest.approx(25.0, abs=1.0)
