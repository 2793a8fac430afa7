"""A rig run on the simulated bench with `undrift rig run`. The operator mounts each face and axis with an error of 0.1
deg.

There is a run for each thirty requested devices. The offset is not compared, because it includes the flicker noise of
the run.
"""

import contextlib
import io
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.calibration.calibrate import calibrate
from undrift.cli.app import run
from undrift.io.session import read_session
from undrift.model import Calibration
from undrift.programme import FacesTable, Protocol, ProtocolTable, RatesTable, write_protocol
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration

RUNS = 30  # devices for each run
PROTOCOL = Protocol(
    protocol=ProtocolTable(name="mounted askew"),
    faces=FacesTable(),
    rates=RatesTable(turn_rate_min_dps=30.0, turn_rate_max_dps=90.0, turn_rate_step_dps=30.0, seconds=3.0),
)


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield one row a group."""
    tally = Tally("rig run, simulated", "mounted 0.1 deg off per axis")
    for number in range(max(1, devices // RUNS)):
        device, calibration = run_of(seed + number, 0.1)
        true = true_calibration(device)
        assert calibration.gyro is not None
        assert true.gyro is not None
        away = calibration.gyro.matrix @ np.linalg.inv(true.gyro.matrix) - np.eye(3)
        sigma, diagonal = calibration.gyro.standard_uncertainty, np.eye(3, dtype=bool)
        reported = sigma[:9].reshape(3, 3) / np.diag(true.gyro.matrix)
        tally.add(
            calibration.verdict,
            scale=(away[diagonal], reported[diagonal]),
            cross_axis=(away[~diagonal], reported[~diagonal]),
        )
    yield from tally.rows()


def run_of(seed: int, mount_tilt_deg: float) -> tuple[DeviceModel, Calibration]:
    """Return the simulated device and its calibration from a run."""
    address = f"simulated:?seed={seed}&tilt_deg={mount_tilt_deg:g}"
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        write_protocol(PROTOCOL, folder / "protocol.toml")
        addresses = ["--rig", "simulated:?clock_speed=1e6", "--device", address]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = run(["rig", "run", str(folder / "protocol.toml"), *addresses, "-o", str(folder / "run"), "--yes"])
        if code != 0:
            raise RuntimeError(f"rig run: exit {code}")
        device = random_device(np.random.default_rng(seed), grade="consumer")
        return device, calibrate(read_session(folder / "run"))
