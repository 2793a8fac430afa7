"""The emergency stop: past a busy, halted or dead run, over each kind of controller; how late it reaches the table is printed."""

import http.client
import os
import signal
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from testkit.rig_bench import on_host, opened
from testkit.web_run import at_end, emulated_bench, ended_at_last, is_dwelling, new_run, wait
from undrift.rig.rig import RigSettings, open_rig
from undrift.rig.watch import Standby, StopWatch, stop_now, stop_rig
from undrift.units import RADIAN_PER_DEGREE as DPS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="locks and signals of POSIX")
LATEST_S = 1.0  # on a busy machine; `python -m benchmarks stop` has the strict figure, for an idle one


@pytest.fixture(scope="module")
def bench():
    with emulated_bench() as started:
        yield started


def post(run, path="/stop", key=None):
    """Post as a browser does, on a new connection; return the status."""
    held = run._standing
    with closing(http.client.HTTPConnection("127.0.0.1", held["port"], timeout=10.0)) as link:
        link.request("POST", f"{path}?key={held['key'] if key is None else key}")
        return link.getresponse().status


def rate_dps(rig):
    return rig.axis_states(np.array([rig.now()]))[1][0] / DPS


def wait_for_rest(rig):
    last = time.monotonic() + 20.0
    while rig.motor_on or abs(rate_dps(rig)) > 1e-3:
        assert time.monotonic() < last
        time.sleep(0.01)


@pytest.mark.parametrize("halted", [False, True])
def test_a_stop_reaches_the_table_at_once_also_when_the_run_is_halted(bench, halted, tmp_path, capsys):
    started, obeyed = bench
    with ended_at_last(new_run(started, tmp_path / "session")) as run:
        run.launch()
        pid = wait(run, is_dwelling).pid
        if halted:
            os.kill(pid, signal.SIGSTOP)
            time.sleep(0.1)
        obeyed.clear()
        clicked = time.monotonic()
        assert post(run) == 200
        answered = time.monotonic() - clicked
        view = wait(run, at_end)
        late_s = obeyed[0] - clicked
        with capsys.disabled():
            print(f"\nstop, {'halted' if halted else 'running'}: {1e3 * late_s:.1f} ms, answer {1e3 * answered:.1f} ms")
        assert late_s < LATEST_S
        assert (view.state, view.confirmed, view.question) == ("stopped", True, None)
        assert not started.rig.motor_on
        assert abs(rate_dps(started.rig)) < 1e-3
        run.launch()  # a stopped run can be continued
        wait(run, is_dwelling)
        run.pause()
        assert wait(run, at_end).state == "paused"


@pytest.mark.slow
def test_a_stop_needs_the_key_and_a_known_place(bench, tmp_path):
    started, _ = bench
    with ended_at_last(new_run(started, tmp_path / "session")) as run:
        run.launch()
        wait(run, is_dwelling)
        assert post(run, key="") == post(run, key="0" * 32) == 403
        assert post(run, path="/start") == 404
        assert run.refresh().state == "running"
        assert started.rig.motor_on
        assert post(run, path="/pause") == 200
        assert wait(run, at_end).state == "paused"


@pytest.mark.slow
def test_a_stop_works_without_the_supervisor(bench, tmp_path):
    started, obeyed = bench
    with ended_at_last(new_run(started, tmp_path / "session")) as run:
        run.launch()
        pid = wait(run, is_dwelling).pid
        os.kill(run._standing["pid"], signal.SIGKILL)
        os.kill(pid, signal.SIGSTOP)
        run._supervisor.wait(10.0)
        obeyed.clear()
        clicked = time.monotonic()
        run.emergency_stop()
        assert obeyed[0] - clicked < LATEST_S
        assert (run.view.state, run.view.confirmed, run.is_going()) == ("stopped", True, False)
        assert not started.rig.motor_on


def test_a_hung_run_is_killed_and_the_table_stopped(capsys):
    with on_host() as emulator, closing(opened(emulator)) as rig:
        rig.enable(True)
        rig.turn(60.0 * DPS)
        time.sleep(0.1)
        address = f"galil:tcp://127.0.0.1:{emulator.port}"
        marks, ended = StopWatch(address), threading.Event()
        standby = Standby(address)
        threading.Timer(0.6, ended.set).start()
        assert stop_now(standby, ended.is_set, None) is True
        standby.close()
        wait_for_rest(emulator)
        with pytest.raises(Exception, match="stopped from elsewhere by rig stop"):
            marks.check()


def test_a_table_that_does_not_slow_down_is_aborted(capsys):
    with on_host() as emulator, closing(opened(emulator)) as rig:
        rig.enable(True)
        rig.set_acceleration(0.7)
        rig.turn(60.0 * DPS)
        time.sleep(0.5)
        standby = Standby(f"galil:tcp://127.0.0.1:{emulator.port}")
        assert standby.reason == ""
        assert standby.shout()
        time.sleep(0.05)
        assert emulator.motor_on  # MO is refused while it slows down
        assert standby.shout(1, 0.1)
        assert standby.shout(11, 0.6)
        wait_for_rest(emulator)
        standby.close()
        assert standby.shout() is False


@pytest.mark.parametrize("pty", [False, True])
def test_a_stepper_board_is_stopped_over_its_second_client_or_the_same_port(pty):
    if pty:
        pytest.importorskip("serial")
    with on_host(kind="grbl", with_pty=True, speed=1.0) as emulator:
        place = f"serial://{emulator.pty_path}" if pty else f"tcp://127.0.0.1:{emulator.port}"
        address = f"grbl:{place}?clock_speed={emulator.settings.speed}"
        with closing(open_rig(address, RigSettings(reply_timeout_s=20.0))) as rig:
            rig.enable(True)
            rig.set_acceleration(10.0)
            rig.move_by(0.1)
            standby = Standby(address)
            assert ("serial port" in standby.reason) is pty
            rig.turn(30.0 * DPS)
            last = time.monotonic() + 20.0
            while abs(rate_dps(emulator)) < 20.0:  # a busy computer may send the first jogs late
                assert time.monotonic() < last
                time.sleep(0.01)
            rig._axis.feeder.end()  # as when its process has ended; what was queued would go on for a second
            assert standby.shout()
            after = emulator.now() + 0.1
            while emulator.now() < after:
                time.sleep(0.01)
            assert abs(emulator.axis_states(np.array([after]))[1][0]) < 1e-6
            standby.close()


def test_a_galil_card_on_a_serial_port_is_stopped_between_the_runs_own_commands():
    pytest.importorskip("serial")
    with on_host(with_pty=True) as emulator:
        address = f"galil:serial://{emulator.pty_path}?clock_speed={emulator.settings.speed}"
        with closing(open_rig(address, RigSettings())) as rig:
            rig.enable(True)
            rig.turn(60.0 * DPS)
            time.sleep(0.1)
            standby = Standby(address)
            assert standby.shout()
            assert standby.shout(1, 0.1) is False  # the run's own end follows, undisturbed
            time.sleep(0.2)
            assert abs(rate_dps(emulator)) < 1.0
            standby.close()
        stop_rig(address)
        assert not emulator.motor_on


@pytest.mark.parametrize(
    ("address", "reason", "motor"),
    [
        ("manual:", "no second connection", False),
        ("galil:serial:///dev/no-such-port", "a serial port has one owner", True),
        ("galil:tcp://127.0.0.1:9", "127.0.0.1:9", True),
    ],
)
def test_what_cannot_be_promised_is_said(address, reason, motor):
    standby = Standby(address)
    assert reason in standby.reason
    assert standby.has_motor is motor
    assert standby.shout() is False
    standby.close()
