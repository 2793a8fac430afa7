"""One run for one table: by a lock on this computer, and by what the controller says of its motor."""

import os
import random
import re
import socket
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from testkit.emulated.emulator import EmulatedBench, EmulatedBenchSettings, EmulatorSettings
from testkit.rig_bench import PROTOCOL, on_host, opened
from undrift.cli.app import run
from undrift.errors import LinkError, RigFault
from undrift.io.session import read_session
from undrift.rig.lock import check_free, one_run, place_of, stop_rig
from undrift.units import RADIAN_PER_DEGREE as DPS


def test_the_spelling_of_an_address_does_not_matter(tmp_path):
    same = {
        place_of(f"galil:tcp://{host}:5000{rest}") for host in ("127.0.0.1", "localhost") for rest in ("", "?axis=A")
    }
    assert same == {"loopback:5000"}
    assert place_of("galil:tcp://127.0.0.1:5001") != place_of("galil:tcp://127.0.0.1:5000")
    (tmp_path / "tty").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "tty")
    assert place_of(f"grbl:serial://{tmp_path / 'by-id'}") == place_of(f"grbl:serial://{tmp_path / 'tty'}")


def test_a_lock_is_held_by_one_and_free_after_it():
    with on_host() as emulator:
        address = f"galil:tcp://127.0.0.1:{emulator.port}"
        with (
            one_run(address, "the first"),
            pytest.raises(
                RigFault, match=r"for this run alone, got it in use by the first \(process \d+ of .*\); wait"
            ),
            one_run(f"galil:tcp://localhost:{emulator.port}", "the second"),
        ):
            pass
        with one_run(address, "the third"):
            pass


def test_a_table_whose_motor_is_on_or_that_moves_is_refused_and_goes_on():
    with on_host() as emulator:
        address = f"galil:tcp://127.0.0.1:{emulator.port}"
        check_free(address)
        with closing(opened(emulator)) as rig:
            rig.enable(True)
            with pytest.raises(RigFault, match="got its motor on: another program drives it"):
                check_free(address)
            check_free(address, motor_on=True)
            rig.turn_for(30.0 * DPS, 600.0)
            time.sleep(0.2)
            for motor_on in (False, True):
                with pytest.raises(RigFault, match=r"got moving: another program.*undrift rig stop with `rig`"):
                    check_free(address, motor_on=motor_on)
            time.sleep(0.2)
            _, rate = emulator.axis_states(np.array([emulator.now()]), mean_s=1.0)
            assert abs(rate[0] / DPS - 30.0) < 1.0
        stop_rig(address)
        check_free(address)


def test_a_stepper_board_that_moves_is_refused():
    """One jog of six minutes: a chain of jogs comes to rest where the computer is too busy to send the next."""
    with on_host(kind="grbl", speed=1.0) as emulator:
        address = f"grbl:tcp://127.0.0.1:{emulator.port}"
        check_free(address)
        with socket.create_connection(("127.0.0.1", emulator.port), 60.0) as board, board.makefile("rb") as answers:
            board.sendall(b"$J=G91A3600F600\n")
            assert any(answer.strip() == b"ok" for answer in answers)
            with pytest.raises(RigFault, match=r"got state Jog: another program drives it"):
                check_free(address)


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_ten_second_runs_are_refused_and_the_first_is_complete(tmp_path, capsys):
    """The first waits for its operator before each of six faces, so that it lasts, however busy the computer is."""
    (tmp_path / "p.toml").write_text(PROTOCOL)
    rng, refused = random.Random(1), 0
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=20.0))) as bench:
        words = ["rig", "run", str(tmp_path / "p.toml"), "--yes", "--rig", bench.rig_address]
        words += ["--device", bench.device_address]
        other = [word.replace("127.0.0.1", "localhost") for word in words]
        called = [sys.executable, "-m", "undrift", *words, "-o", str(tmp_path / "one")]
        with subprocess.Popen(called, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as first:
            for number in range(6):
                said = ""
                while "press Enter" not in said:
                    letter = first.stderr.read(1)
                    assert letter, said
                    said += letter
                bench.mount(re.search(r"with ([+-][xyz]) up", said)[1])
                first.stdin.write("\n")
                first.stdin.flush()
                for _ in range(2 if number < 5 else 0):
                    time.sleep(0.2 * rng.random())
                    assert run([*(words if rng.random() < 0.5 else other), "-o", str(tmp_path / "two")]) == 3
                    refused += "for this run alone, got it in use by undrift rig run into" in capsys.readouterr().err
            first.communicate(timeout=120.0)
    assert (first.returncode, refused) == (0, 10)
    assert not (tmp_path / "two").exists()
    assert len(read_session(tmp_path / "one").records) == 30


def test_a_table_that_does_not_answer_is_named():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match=r"127\.0\.0\.1.*wanted a connection"):
            check_free(f"galil:tcp://127.0.0.1:{taken.getsockname()[1]}?reply_timeout_s=0.2")
