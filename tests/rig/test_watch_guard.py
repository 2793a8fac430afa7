"""The guard: what it takes for an end, that it is missed when it dies, and that it stops table and chamber alike."""

import io
import os
import signal
import subprocess
import time

import pytest

from testkit.rig_bench import at_rest, on_host, opened
from undrift.errors import LinkError, RigFault
from undrift.rig import watch as guard_file
from undrift.rig.programme import Protocol, programme_of
from undrift.rig.rig import open_rig
from undrift.rig.run import Progress, Watch
from undrift.rig.watch import Guard, StopWatch, mark_stop, watch
from undrift.sim.rig.emulator import EmulatedBench, EmulatedBenchSettings
from undrift.units import RADIAN_PER_DEGREE as DPS

NOBODY = "galil:tcp://127.0.0.1:9?reply_timeout_s=0.2"


def address(emulator):
    return f"galil:tcp://{emulator.host}:{emulator.port}"


def heard(said, places=("rig", "chamber")):
    """Return what a guard stopped after these lines."""
    complaints = io.StringIO()
    return watch(*places, io.StringIO(said), complaints), complaints.getvalue()


def progress(phase):
    return Progress(phase=phase, number=0, steps=1, step="", left_s=0.0)


def test_only_a_pipe_that_ends_with_done_is_left_alone(monkeypatch):
    stopped = []
    monkeypatch.setattr(guard_file, "stop_rig", stopped.append)
    monkeypatch.setattr(guard_file, "stop_chamber", stopped.append)
    assert heard("\n\ndone\n") == (0, "")
    assert stopped == []
    assert heard("\n\n") == (0, "")
    assert stopped == ["rig", "chamber"]
    assert heard("", ("", "chamber")) == (0, "")
    assert stopped == ["rig", "chamber", "chamber"]


def test_the_chamber_is_switched_off_even_where_the_table_does_not_answer(monkeypatch):
    stopped = []
    monkeypatch.setattr(guard_file, "stop_chamber", stopped.append)
    code, said = heard("", (NOBODY, "chamber"))
    assert code == 3
    assert "undrift: guard: " in said
    assert "127.0.0.1:9" in said
    assert stopped == ["chamber"]


def test_silence_is_an_end(monkeypatch):
    stopped = []
    monkeypatch.setattr(guard_file, "stop_rig", stopped.append)
    read, write = os.pipe()
    with os.fdopen(read) as lines, os.fdopen(write, "w") as program:
        start = time.monotonic()
        program.write("\n")
        program.flush()
        assert watch("rig", "", lines, io.StringIO(), silence_s=0.2) == 0
        assert 0.2 <= time.monotonic() - start < 30.0
    assert stopped == ["rig"]


@pytest.mark.slow
def test_a_program_that_breaks_its_promise_is_taken_for_hanging_and_the_table_stops():
    with on_host() as emulator, Guard(address(emulator)) as guard:
        rig = opened(emulator)
        rig.enable(True)
        rig.turn(30.0 * DPS)
        guard.expect(0.0)
        assert at_rest(emulator), "the guard did not stop the table"
        with pytest.raises(RigFault, match=r"guard: wanted it to stand by .* got it ended \(code 0\).*`resume`"):
            until_ended(guard)
        rig.close()


def lost_after(guard):
    guard.arm()
    open_rig(NOBODY)


def until_ended(guard):
    last = time.monotonic() + 60.0
    while time.monotonic() < last:
        guard.check()
        time.sleep(0.02)


def test_a_guard_that_was_killed_is_missed_before_the_next_step():
    programme = programme_of(Protocol(faces=("+z",), axes=("z",)))
    with Guard(NOBODY) as guard:
        watch_over = Watch(StopWatch(NOBODY), guard, programme)
        watch_over(progress("ramping"))
        os.kill(guard._process.pid, signal.SIGKILL)
        with pytest.raises(RigFault, match=r"got it ended \(code -9\): it was killed"):
            until_ended(guard)
        with pytest.raises(RigFault, match="wanted it to stand by while the table is driven"):
            watch_over(progress("ramping"))
        watch_over(progress("closing"))


def test_a_guard_that_does_not_start_is_refused(monkeypatch):
    real = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda words, **more: real([words[0], "-c", "pass"], **more))
    with pytest.raises(RigFault, match="guard: wanted it ready within 20 s, got ''; nothing moved, start again"):
        Guard(NOBODY)


@pytest.mark.slow
def test_an_error_before_the_rig_is_open_troubles_nobody_and_one_after_it_has_the_table_stopped(capfd):
    with pytest.raises(LinkError), Guard(NOBODY):
        open_rig(NOBODY)
    assert capfd.readouterr().err == ""
    with pytest.raises(LinkError), Guard(NOBODY) as guard:
        lost_after(guard)
    assert "undrift: guard: " in capfd.readouterr().err


@pytest.mark.slow
def test_the_chamber_is_off_when_the_program_is_gone():
    with EmulatedBench(EmulatedBenchSettings()) as bench:
        bench.chamber.air.on = True
        Guard("", bench.chamber_address).release(well=True)
        assert bench.chamber.air.on
        Guard("", bench.chamber_address).release(well=False)
        assert not bench.chamber.air.on


def test_a_stop_from_elsewhere_ends_a_run_of_that_rig_only(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    programme = programme_of(Protocol(faces=("+z",), axes=("z",)))
    mark_stop("manual:")
    mine, other = StopWatch("galil:tcp://h:1?encoder_lines=500"), StopWatch("galil:tcp://h:2")
    mark_stop("galil:tcp://h:1")
    other.check()
    for phase in ("enabling", "soaking", "ramping"):
        with pytest.raises(RigFault, match="got it stopped from elsewhere by rig stop; continue with `resume`"):
            Watch(mine, None, programme)(progress(phase))
    Watch(mine, None, programme)(progress("closing"))
    StopWatch("galil:tcp://h:1").check()


def test_a_mark_that_cannot_be_left_does_not_keep_the_table_from_being_stopped(monkeypatch, tmp_path, caplog):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "file"))
    mark_stop("manual:")
    assert "no mark of the stop could be left" in caplog.text
