"""The program on the card that stops the axis when nobody writes its variable: guard and runner killed, left-overs, refusals."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from testkit.emulated_axis import axis_rate, axis_state
from testkit.rig_bench import at_rest, emulated, opened
from testkit.scripted_server import Card
from testkit.waiting import eventually
from undrift.cli.app import run
from undrift.errors import LinkError, RigFault
from undrift.rig import galil as card_watchdog
from undrift.rig.galil import LEFT, LIMIT_S, program_for
from undrift.rig.link import GclibPort
from undrift.rig.programme import Protocol, write_protocol
from undrift.sim.rig.emulator import EmulatedBench, EmulatedBenchSettings, EmulatorSettings
from undrift.units import RADIAN_PER_DEGREE as DPS

SPEED = 10.0
BRAKES_S = 1.0  # of the card: a count of 0.2 s, and 90 deg/s at 2300 deg/s2
LONG = Protocol(
    faces=("+z",), face_s=1.0, turn_rate_min=30.0 * DPS, turn_rate_max=60.0 * DPS, turn_rate_step=30.0 * DPS, axes=("z",),
    dwell_s=500.0, bracket_s=1.0,
)  # fmt: skip


@pytest.fixture
def quick(monkeypatch):
    """Let half a second count as silence."""
    monkeypatch.setattr(card_watchdog, "LIMIT_S", 0.5)
    monkeypatch.setattr(card_watchdog, "BEAT_S", 0.1)


def on_card(emulator):
    return [line for line in emulator.machine.program._lines if line]


def guard_of(process):
    """Return the process number of a run's guard."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process.pid and "undrift.rig.watch" in (folder / "cmdline").read_text():
                return int(folder.name)
        except OSError:
            continue  # it has just ended
    raise AssertionError("the run has no guard")


def test_guard_and_runner_killed_at_once_leave_an_axis_that_its_card_stops_in_the_stated_time(tmp_path):
    write_protocol(LONG, tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        addresses = ("--rig", bench.rig_address, "--device", bench.device_address, "--operator", bench.hands_address)
        calls = ["rig", "run", str(tmp_path / "protocol.toml"), *addresses, "-o", str(tmp_path / "run"), "--yes"]
        code = f"from undrift.cli.app import main; main({[*calls, '--card-watchdog']!r})"
        process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE)
        try:
            eventually(lambda: abs(axis_rate(bench.rig)) > 20.0 * DPS, "it turns", within_s=120.0)
            assert on_card(bench.rig) == program_for("X")
            victims = (guard_of(process), process.pid)
        finally:
            killed = bench.rig.now()
            process.kill()
            os.kill(victims[0], signal.SIGKILL)
            process.communicate(timeout=60.0)
        assert abs(axis_state(bench.rig, killed)[1]) > 20.0 * DPS  # no mean: it may still gain speed
        stated = killed + LIMIT_S * SPEED + BRAKES_S
        eventually(lambda: bench.rig.now() > stated + 1.0, "the stated time passes", within_s=120.0)
        assert abs(axis_state(bench.rig, stated, mean_s=0.5)[1]) < 0.05 * DPS
        assert at_rest(bench.rig, 0.0)
        assert bench.rig.machine.card.variables[LEFT] == -1  # it was the card


def test_an_axis_is_not_stopped_while_its_host_lives_and_the_card_is_left_as_it_was(quick):
    with emulated() as emulator:
        rig = opened(emulator, card_watchdog=lambda: True)
        assert on_card(emulator) == program_for("X")
        rig.enable(True)
        rig.turn(30.0 * DPS)
        emulator.clock.wait(1.2)
        assert abs(axis_rate(emulator)) > 20.0 * DPS
        rig.close()
        assert on_card(emulator) == []
        assert not emulator.machine.program.running
        assert at_rest(emulator, 0.0)


def test_a_host_that_hangs_finds_its_table_stopped_and_says_by_what(quick):
    hangs = [False]
    with emulated() as emulator:
        rig = opened(emulator, card_watchdog=lambda: not hangs[0])
        rig.enable(True)
        rig.turn(30.0 * DPS)
        hangs[0] = True
        assert at_rest(emulator)
        hangs[0] = False

        def is_refused():
            try:
                rig.position()
            except LinkError as error:
                return "its card watchdog stopped it, not having heard of this computer for 0.5 s; open it" in str(
                    error
                )
            return False

        assert emulator.clock.until(is_refused, 5.0), "the rig goes on"
        rig.close()


def test_what_a_killed_run_left_on_the_card_does_not_stop_the_next_one(quick):
    with emulated() as emulator:
        rig = opened(emulator, card_watchdog=lambda: False)  # as if killed: nobody writes
        assert emulator.machine.program.running
        again = opened(emulator)
        assert not emulator.machine.program.running
        again.enable(True)
        again.turn(30.0 * DPS)
        emulator.clock.wait(1.0)
        assert abs(axis_rate(emulator)) > 20.0 * DPS
        again.close()
        opened(emulator, card_watchdog=lambda: True).close()  # and is replaced
        assert on_card(emulator) == []
        rig.close()


@pytest.mark.parametrize("line", ["#AUTO;MG TIME", 'MG "WHO?"'])
def test_a_card_that_holds_another_program_is_refused_and_keeps_it(line):
    with emulated() as emulator:
        emulator.machine.program.load(line)
        with pytest.raises(
            RigFault, match="wanted a card without a program for `card_watchdog`, got one that it would"
        ):
            opened(emulator, card_watchdog=lambda: True)
        opened(emulator).close()


def test_a_program_that_does_not_count_is_refused(quick, monkeypatch):
    monkeypatch.setattr(card_watchdog, "STARTS_S", 0.2)
    with emulated() as emulator:
        emulator.machine.program._step = lambda: None
        with pytest.raises(RigFault, match="wanted the card's watchdog counting, got it at rest; leave it out"):
            opened(emulator, card_watchdog=lambda: True)
        assert on_card(emulator) == []


def test_a_link_that_fails_is_reported_as_it_began(quick):
    with emulated() as emulator:
        rig = opened(emulator, card_watchdog=lambda: True, reply_timeout_s=0.3)
        rig.enable(True)
        rig.turn(30.0 * DPS)
        emulator.inject("disconnect")
        assert emulator.clock.until(lambda: rig._axis.broken is not None, 5.0), "the watchdog has not met the lost link"
        with pytest.raises(LinkError, match=f"wanted an answer to 'MG {LEFT}'|lost"):
            rig.position()
        assert at_rest(emulator)
        rig.close()


@pytest.mark.parametrize("rig", ["grbl:tcp://127.0.0.1:9", "manual:"])
@pytest.mark.parametrize("command", ["run", "check"])
def test_other_rigs_have_no_card(tmp_path, capsys, rig, command):
    write_protocol(LONG, tmp_path / "protocol.toml")
    words = ["run", str(tmp_path / "protocol.toml"), "--device", "tcp://127.0.0.1:9", "-o", str(tmp_path / "run")]
    assert run(["rig", *(words if command == "run" else ["check"]), "--rig", rig, "--card-watchdog"]) == 2
    assert f"card watchdog: wanted a Galil card, got '{rig}'; leave --card-watchdog out" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_gclib_downloads_programs_itself():
    class Library:
        def __init__(self):
            self.card, self.programs, self.wrong = Card(), [], ""

        def GOpen(self, address):
            pass

        def GProgramDownload(self, program):
            if self.wrong:
                raise RuntimeError(self.wrong)
            self.programs.append(program)

    library = Library()
    port = GclibPort("COM1", library=library)
    port.download("#A\rEN")
    assert library.programs == ["#A\rEN"]
    library.wrong = "download error"
    with pytest.raises(LinkError, match="gclib COM1: wanted a program taken by the card, got 'download error'"):
        port.download("#A\rEN")
