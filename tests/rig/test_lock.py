"""One run for one table: by a lock on this computer, and by what the controller says of its motor."""

import math
import os
import signal
import time
from contextlib import closing

import pytest

from testkit.bench import FORKS
from testkit.cards import TurningBoard, TurningCard
from testkit.rig_bench import PROTOCOL, driven, simulated
from testkit.waiting import eventually
from undrift.cli.app import run
from undrift.errors import RigFault
from undrift.rig.lock import one_run, place_of, stop_rig
from undrift.rig.rig import RigSettings, open_rig
from undrift.units import RADIAN_PER_DEGREE as DPS

PORT = 20_000 + os.getpid() % 20_000  # no other test uses it, and nothing is opened
TABLE = f"galil:tcp://127.0.0.1:{PORT}"


def test_the_spelling_of_an_address_does_not_matter(tmp_path):
    same = {
        place_of(f"galil:tcp://{host}:5000{rest}") for host in ("127.0.0.1", "localhost") for rest in ("", "?axis=A")
    }
    assert same == {"loopback:5000"}
    assert place_of("galil:tcp://127.0.0.1:5001") != place_of("galil:tcp://127.0.0.1:5000")
    (tmp_path / "tty").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "tty")
    assert place_of(f"grbl:serial://{tmp_path / 'by-id'}") == place_of(f"grbl:serial://{tmp_path / 'tty'}")


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_a_lock_is_held_by_one_and_free_after_it():
    with (
        one_run(TABLE, "the first"),
        pytest.raises(RigFault, match=r"in use by the first \(process \d+ of .*\)"),
        one_run(TABLE.replace("127.0.0.1", "localhost"), "the second"),
    ):
        pass
    with one_run(TABLE, "the third"):
        pass


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_a_second_run_is_refused_before_there_is_a_folder(tmp_path, capsys):
    (tmp_path / "p.toml").write_text(PROTOCOL)
    words = ["rig", "run", str(tmp_path / "p.toml"), "--yes", "--rig", TABLE]
    with one_run(TABLE, "the first"):
        assert run([*words, "--device", "tcp://127.0.0.1:9", "-o", str(tmp_path / "two")]) == 3
    assert "in use by the first" in capsys.readouterr().err
    assert not (tmp_path / "two").exists()


def hold(address):
    with one_run(address, "the first"):
        time.sleep(60.0)


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_stop_ends_the_process_that_drives_the_table():
    card = TurningCard(simulated())
    process = FORKS.Process(target=hold, args=(card.address,))
    process.start()

    def is_locked():
        try:
            with one_run(card.address, "the second"):
                return False
        except RigFault:
            return True

    eventually(is_locked, "the lock")
    stop_rig(card.address, RigSettings(clock=card.bench.clock))
    process.join(10.0)
    assert process.exitcode == -signal.SIGTERM
    assert card.server.heard[-2:] == ["MOX", "MG _MOX"]


def check_free(card, accept):
    """Open the table of a card as a run does, and close the link only."""
    open_rig(card.address, RigSettings(clock=card.bench.clock, accept=accept)).disconnect()


def test_a_table_whose_motor_is_on_or_that_moves_is_refused_and_goes_on():
    card = TurningCard(simulated())
    bench, settings = card.bench, RigSettings(clock=card.bench.clock)
    check_free(card, "off")
    with closing(driven(card)) as rig:
        rig.enable(True)
        with pytest.raises(RigFault, match="got its motor on"):
            check_free(card, "off")
        check_free(card, "on")
        rig.turn_for(30.0 * DPS, 600.0)
        bench.clock.wait(1.0)
        for accept in ("off", "on"):
            with pytest.raises(RigFault, match=r"got moving"):
                check_free(card, accept)
        before = bench.angle()
        bench.clock.wait(1.0)
        assert math.degrees(bench.angle() - before) == pytest.approx(30.0, abs=0.1)
    stop_rig(card.address, settings)
    check_free(card, "off")


def test_a_stepper_board_that_moves_is_refused():
    board = TurningBoard(simulated())
    check_free(board, "off")
    assert board("$J=G91G21A3600F600") == b"ok\r\n"
    with pytest.raises(RigFault, match=r"got moving"):
        check_free(board, "off")
