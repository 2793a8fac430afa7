"""``undrift rig run`` with several devices on one table."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import PROTOCOL
from undrift.calibration.calibrate import calibrate
from undrift.commands.rig import run
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.sim.device.model import write_device
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration


def test_two_devices_are_calibrated_in_the_time_of_one_each_to_its_own_truth(tmp_path, capsys):
    first, second = (
        replace(random_device(np.random.default_rng(seed), grade="consumer"), serial=f"unit-{seed}") for seed in (3, 4)
    )
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    minutes, addresses = [], []
    for number, one in ((3, first), (4, second)):
        write_device(one, tmp_path / f"{number}.json")
        addresses.append(f"simulated:?seed={number}&device={tmp_path / f'{number}.json'}")
        ran = run(
            tmp_path / "protocol.toml",
            rig="simulated:?clock_speed=1e6",
            device=tuple(addresses),
            output=tmp_path / f"with-{number}",
            yes=True,
        )
        minutes.append(ran.data["duration_s"] / 60.0)
    folders = [path.parent for path in ran.written]
    assert [folder.name for folder in folders] == ["device-1", "device-2"]
    (others,) = [table for table in ran.tables if table.title == "Other devices on the table"]
    assert [row[1] for row in others.rows] == [30]
    for device, folder in zip((first, second), folders, strict=True):
        session = read_session(folder)
        assert session.serial == device.serial
        found, true = calibrate(session), true_calibration(device)
        off = [
            np.abs(getattr(found, n).matrix @ np.linalg.inv(getattr(true, n).matrix) - np.eye(3)).max()
            for n in ("gyro", "accel")
        ]
        with capsys.disabled():
            print(f"\n{device.serial}: gyro {off[0]:.1e}, accel {off[1]:.1e} off the true matrix")
        assert max(off) < 3e-3  # as one device alone: tests/commands/test_rig.py
    with capsys.disabled():
        print(f"one device {minutes[0]:.1f} min, two at once {minutes[1]:.1f} min of the table")
    assert ran.data["added"] == 30
    assert minutes[1] == pytest.approx(minutes[0], rel=0.01)  # one course of the table for both


def test_devices_without_addresses_or_a_serial_of_their_own_are_refused(tmp_path):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    for device, serial in ((("tcp://a:1", "tcp://a:1"), ""), (("tcp://a:1", "tcp://a:2"), "one")):
        with pytest.raises(InputError, match="several devices need different addresses"):
            run(
                tmp_path / "protocol.toml",
                rig="galil:tcp://127.0.0.1:9",
                device=device,
                serial=serial,
                output=tmp_path / "o",
            )
    assert not (tmp_path / "o").exists()
