"""``undrift rig``: a whole calibration on the simulated bench, refusals in one line, a stop from another shell."""

import io
import json
import sys

import numpy as np
import pytest

from testkit.pages import faults_of
from testkit.rig_bench import PROTOCOL
from testkit.talking_device import TalkingDevice
from undrift.cli.app import run
from undrift.commands.rig import run as run_rig
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.io.store import read_calibration
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration

NOBODY = "galil:tcp://127.0.0.1:9?reply_timeout_s=0.2"


SIMULATED = ("--rig", "simulated:?clock_speed=1e6", "--device", "simulated:?seed=3", "--chamber", "simulated:")


def test_run_and_calibrate_find_the_devices_hidden_parameters(tmp_path, capsys):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    words = ["rig", "run", str(tmp_path / "protocol.toml"), *SIMULATED, "-o", str(tmp_path / "run"), "--yes", "--json"]
    assert run([*words, "--report", str(tmp_path / "run.html")]) == 0
    text = (tmp_path / "run.html").read_text()
    assert faults_of(text) == []
    out, err = capsys.readouterr()
    told = json.loads(out)
    rates = [row for row in told["tables"]["dwells"] if row["purpose"] == "rate"]
    assert (told["data"]["dwells"], told["data"]["missing_readings"], len(rates)) == (30, 0, 18)
    largest = max(abs(row["achieved (deg/s)"]["value"] - row["nominal (deg/s)"]) for row in rates)
    assert f"differ from nominal rates by up to {largest:.3g} deg/s" in told["answer"]
    assert "30 dwells, 0:0" in err
    assert " left  +30 deg/s about x, dwelling  gyro_x" in err
    assert run(["rig", "stop", "--rig", "simulated:"]) == 0
    assert "at rest, motor off" in capsys.readouterr().out
    assert run(["calibrate", str(tmp_path / "run"), "-o", str(tmp_path / "calibration.json")]) == 0
    capsys.readouterr()
    found = read_calibration(tmp_path / "calibration.json")
    true = true_calibration(random_device(np.random.default_rng(3), grade="consumer"))
    with capsys.disabled():
        for name in ("gyro", "accel"):
            ratio = getattr(found, name).matrix @ np.linalg.inv(getattr(true, name).matrix)
            print(f"\n{name}: found matrix over true one, off identity by {np.abs(ratio - np.eye(3)).max():.2e}")
            np.testing.assert_allclose(ratio, np.eye(3), atol=3e-3)


def test_check_accepts_a_table_by_its_limit(undrift):
    call = ("rig", "check", "--rig", "simulated:?clock_speed=1e6", "--seconds", "4", "--json")
    found = undrift.good(*call).json()
    assert found["kind"] == "undrift.rig_check"
    (error,) = found["tables"]["following_error_deg"]
    assert 0.0 < error["rms"] < error["largest at steady rate"] < error["limit"] == pytest.approx(0.012)
    servo = found["data"]["servo"]
    assert (servo["kp"], servo["ki"], servo["kd"]) == (12.5, 0.0, 245.0)
    answer = undrift(*call, "--limit-deg", "0.0001")
    failed = answer.json()
    assert (answer.code, failed["verdict"]) == (1, "bad")
    assert [item["code"] for item in failed["findings"] if item["level"] == "fail"] == ["rig_check.error"]


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (["run", "none.toml", "--rig", "manual:", "--device", "tcp://h:1", "-o", "x"], "none.toml", 2),
        (["stop", "--rig", "galil:tcp://127.0.0.1:9?reply_timeout_s=0.2"], "127.0.0.1:9", 3),
        (["check", "--rig", "manual:"], "rig check: expected a table with a motor, got manual:", 2),
        (["check", "--rig", "simulated:?clock_speed=1e6", "--seconds", "0"], "duration positive", 2),
        (
            ["run", "p.toml", *SIMULATED, "--device", "tcp://h:1", "-o", "x"],
            "either all simulated or all real",
            2,
        ),
        (["run", "p.toml", *SIMULATED[:3], "simulated:?device=gold", "-o", "x"], "expected a device.json or one of", 2),
        (["run", "p.toml", *SIMULATED[:3], "simulated:?seed=one", "-o", "x"], "'one' is not a value for seed", 2),
        (["run", "p.toml", *SIMULATED[:3], "simulated:?color=red", "-o", "x"], "unknown option 'color'", 2),
    ],
)
def test_wrong_input_is_2_and_a_rig_that_is_not_there_is_3(undrift, words, message, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.toml").write_text(PROTOCOL)
    answer = undrift("rig", *words)
    assert (answer.code, answer.out) == (code, "")
    assert message in answer.err
    assert answer.err.count("\n") == 1


def test_without_a_yes_nothing_is_opened(undrift, tmp_path, monkeypatch):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    call = ("rig", "run", tmp_path / "protocol.toml", "--rig", NOBODY, "--device", "tcp://127.0.0.1:9")
    for said in ("", "n\n"):
        monkeypatch.setattr(sys, "stdin", io.StringIO(said))
        answer = undrift(*call, "-o", tmp_path / f"run{len(said)}")
        assert (answer.code, "the start was not confirmed, and nothing moved" in answer.err) == (2, True)


def test_devices_without_addresses_or_a_serial_of_their_own_are_refused(tmp_path):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    for device, serial in ((("tcp://a:1", "tcp://a:1"), ""), (("tcp://a:1", "tcp://a:2"), "one")):
        with pytest.raises(InputError, match="several devices need different addresses"):
            run_rig(
                tmp_path / "protocol.toml",
                rig="galil:tcp://127.0.0.1:9",
                device=device,
                serial=serial,
                output=tmp_path / "o",
            )
    assert not (tmp_path / "o").exists()


def test_run_by_hand_reads_a_real_device(tmp_path, monkeypatch, capsys):
    (tmp_path / "p.toml").write_text('[faces]\norder = ["+z"]\nseconds = 1.0\n')
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n" * 9))
    with TalkingDevice() as device:
        words = ["rig", "run", str(tmp_path / "p.toml"), "--rig", "manual:", "--device", device.address, "--yes"]
        assert run([*words, "-o", str(tmp_path / "run")]) == 0, capsys.readouterr().err
    session = read_session(tmp_path / "run")
    assert session.serial == "talker"
    assert [still.face for still in session.stills] == ["+z"]
