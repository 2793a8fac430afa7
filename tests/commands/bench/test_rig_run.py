"""Runs as the bench starts them: followed, asked, paused and continued, found again; whatever dies, the table is at rest."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from testkit.waiting import eventually
from testkit.web_run import SHORT, at_end, emulated_bench, ended_at_last, is_dwelling, new_run, order_of, wait
from undrift.commands.bench.rig_run import EmulatedTable, RigRun, RunOrder, View, begin_run, command_of, find_run
from undrift.commands.bench.supervisor import Supervisor
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.sim.rig.emulator import BenchHands

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="locks and signals of POSIX")


@pytest.fixture(scope="module")
def bench():
    with emulated_bench() as (started, _):
        yield started


def at_rest(bench):
    _, rate = bench.rig.axis_states(np.array([bench.rig.now()]))
    return not bench.rig.motor_on and abs(rate[0]) < 1e-6


@pytest.mark.slow
def test_a_run_is_followed_paused_found_and_goes_on_to_its_end(bench, tmp_path):
    with ended_at_last(new_run(bench, tmp_path / "jobs" / "a" / "session")) as run:
        run.launch()
        wait(run, is_dwelling)
        assert run.may_move
        assert run.stop_url.startswith(":")
        run.pause()
        assert wait(run, at_end).state == "paused"
        assert at_rest(bench)
        assert (run.may_move, run.stop_url) == (False, "")
        kept = set(run.view.done)
        again = find_run(tmp_path / "jobs")  # as the next bench does
        assert again is not None
        assert (again.view.state, again.view.done) == ("paused", kept)
        with ended_at_last(again):
            again.launch()
            with pytest.raises(InputError, match="got one that goes on"):
                again.launch()
            seen = set()
            while not at_end(again.refresh()):
                seen.add(again.view.phase)
                time.sleep(0.02)
            view = again.view
    assert (view.state, view.error, view.question) == ("done", "", None)
    assert {"dwelling", "resting"} <= seen
    assert view.dwells == len(view.done) == 7
    assert kept <= view.done
    assert len(read_session(run.folder).turns) == 4
    assert find_run(tmp_path / "jobs") is None
    assert at_rest(bench)
    with pytest.raises(InputError, match="wanted a new folder, got one with a run in it"):
        begin_run(run.folder, SHORT, run.order)


@pytest.mark.slow
def test_each_question_is_answered_once_by_its_number(bench, tmp_path):
    hands = BenchHands(bench.hands_address)
    protocol = SHORT.replace('["+z"]', '["+x", "+z"]')
    with ended_at_last(new_run(bench, tmp_path / "session", protocol, operator=False)) as run:
        run.launch()
        number, text = wait(run, lambda view: view.question is not None).question
        assert (number, "Mount the device with +x up" in text) == (1, True)
        hands.mount("+x")
        for _ in range(3):  # two browsers, one of them twice
            run.answer(number)
        second = wait(run, lambda view: view.question is not None and view.question[0] == 2)
        assert "Mount the device with +z up" in second.question[1]
        for _ in range(20):
            run.answer(1)
            assert run.refresh().phase == "mounting"  # the late answers to the first did not answer the second
        assert not bench.rig.motor_on
        run.answer(2, "q")
        view = wait(run, at_end)
        assert view.state == "failed"
        assert "wanted the device mounted +z up, got 'q'; continue with --resume" in view.error


def test_a_run_outlives_the_bench_and_its_supervisor_and_is_found_and_paused(bench, tmp_path):
    with ended_at_last(new_run(bench, tmp_path / "jobs" / "a" / "session")) as run:
        run.launch()
        wait(run, is_dwelling)
        os.kill(run._standing["pid"], signal.SIGKILL)
        found = find_run(tmp_path / "jobs")  # the next bench has this object alone
        assert found is not None
        assert found.view.state == "running"
        assert bench.rig.motor_on
        found.close()
        assert at_rest(bench)
        assert not found.is_going()
        assert find_run(tmp_path / "jobs").view.state == "failed"  # nobody was left to say how it ended


def test_a_killed_run_says_so_and_its_guard_stops_the_table(bench, tmp_path):
    with ended_at_last(new_run(bench, tmp_path / "session")) as run:
        run.launch()
        pid = wait(run, is_dwelling).pid
        os.kill(run._standing["pid"], signal.SIGKILL)
        os.kill(pid, signal.SIGKILL)
        view = wait(run, at_end)
        assert (view.state, view.error.partition(";")[0]) == ("failed", "the run was killed")
        last = time.monotonic() + 20.0
        while not at_rest(bench):
            assert time.monotonic() < last
            time.sleep(0.05)


@pytest.mark.slow
def test_what_the_command_refuses_is_shown_in_its_own_words(bench, tmp_path):
    order = RunOrder(rig=bench.rig_address, device="tcp://127.0.0.1:9?rate=100")
    with ended_at_last(begin_run(tmp_path / "a" / "session", SHORT, order)) as run:
        run.launch()
        view = wait(run, at_end)
        assert view.state == "failed"
        assert "wanted" in view.error
        assert "got" in view.error
    order = RunOrder(rig="galil:tcp://127.0.0.1:9?reply_timeout_s=0.2", device=bench.device_address)
    with ended_at_last(begin_run(tmp_path / "b" / "session", SHORT, order)) as run:
        run.launch()
        assert "127.0.0.1:9" in wait(run, at_end).error
        assert "127.0.0.1:9" in run.view.standby  # there is no connection to stop by, and the page says so


@pytest.mark.slow
def test_a_supervisor_whose_folder_is_taken_does_not_start(bench, tmp_path):
    with ended_at_last(new_run(bench, tmp_path / "session")) as run:
        run.launch()
        with pytest.raises(OSError):
            Supervisor(run.folder)
        run.pause()
        wait(run, at_end)


def test_the_command_is_the_one_of_the_command_line(bench, tmp_path):
    order = order_of(bench)
    run = begin_run(tmp_path / "session", SHORT, order)
    words = command_of(order, run.folder)[2:]
    place = run.place
    assert words == [
        *("undrift", "rig", "run", str(place / "protocol.toml"), "-o", str(run.folder), "--yes", "--json"),
        *("--progress", str(place / "progress.jsonl"), "--rig", order.rig, "--device", order.device),
        *("--operator", order.operator),
    ]
    run.folder.mkdir()
    (run.folder / "journal.jsonl").touch()
    assert command_of(order, run.folder)[-1] == "--resume"


def test_a_view_knows_the_temperatures_that_are_done_and_since_when_one_is_steady():
    view = View()
    steps = [{"kind": "soak", "text": "soak at 30 degC", "seconds": 60.0, "temp_c": 30.0}]
    steps += [{"kind": "dwell", "text": "rest", "seconds": 6.0, "temp_c": temp_c} for temp_c in (30.0, 30.0, 45.0)]
    at = {"event": "at", "number": 0, "left_s": 600.0, "live": "", "device_c": 28.0, "slope_c_per_min": 0.4}
    lines = [
        {"event": "started", "time": 1.0, "pid": 1, "standby": ""},
        {"event": "plan", "time": 1.0, "steps": steps, "done": [1], "speed": 10.0},
        *({**at, "time": 2.0 + k, "phase": "soaking", "air_c": 30.0} for k in range(5000)),
    ]
    for line in lines:
        view.take(line)
    assert view.set_points() == [(30.0, 1, 2), (45.0, 0, 1)]
    assert (view.minutes_left, view.stable_since, view.slope_c_per_min) == (1.0, None, 0.4)
    view.take({**at, "time": 6000.0, "phase": "enabling", "air_c": 30.0})
    assert view.stable_since == 6000.0
    assert 1000 <= len(view.curve) <= 2000
    assert (view.curve[0].time, view.curve[-1].time) == (2.0, 6000.0)


def test_a_view_compares_the_turn_that_is_read_with_the_one_that_is_commanded():
    view, dps = View(), math.pi / 180.0
    steps = [
        {"kind": "dwell", "text": "rest", "up": "-x", "axis": "x", "turn_rate": 0.0, "seconds": 6.0, "temp_c": None}
    ]
    steps += [{**steps[0], "turn_rate": rate * dps} for rate in (30.0, -60.0)]
    view.take({"event": "started", "time": 1.0, "pid": 1, "standby": ""})
    view.take({"event": "plan", "time": 1.0, "steps": steps, "done": [], "speed": 1.0})

    def read(number, x, y, z):
        live = f"count 7  gyro_x {x}  gyro_y {y}  gyro_z {z} of A17"
        known = {"left_s": 9.0, "slope_c_per_min": None, "air_c": None, "device_c": None}
        phase = "dwelling" if number else "resting"
        view.take({"event": "at", "time": 60.0 * number, "phase": phase, "number": number, "live": live, **known})
        return view.wrong

    assert read(0, 100.0, 5.0, 5.0) == ""
    assert read(1, 100.0, 5.0, 425.0) == "The table turns about x, but z reads most: check the mounting."
    assert read(1, -320.0, 5.0, 5.0) == "The device reads the turn about x in the opposite sense: check the mounting."
    view.rates.clear()
    assert (read(1, 520.0, 5.0, 5.0), view.pose) == ("", ("-x", "-"))  # seen from above, on its other side
    assert (read(2, -740.0, 5.0, 5.0), view.pose) == ("", ("-x", "+"))
    title, *_, ((_, _, measured), (_, _, commanded)) = view.trace()
    assert title == "Turn rate of A17, scaled"
    np.testing.assert_allclose(commanded, [[0.0, 30.0], [1.0, -60.0]])
    np.testing.assert_allclose(measured, commanded)


@pytest.mark.parametrize(("axis", "rate_dps"), [("xyz", 30.0), ("x", 1.0)])
def test_a_skew_mounting_and_a_slow_turn_are_not_judged_by_one_reading(axis, rate_dps):
    view = View()
    step = {"kind": "dwell", "text": "turn", "up": f"+{axis}", "axis": axis, "turn_rate": math.radians(rate_dps)}
    steps = [{**step, "seconds": 6.0, "temp_c": None}]
    view.take({"event": "started", "time": 1.0, "pid": 1, "standby": ""})
    view.take({"event": "plan", "time": 1.0, "steps": steps, "done": [], "speed": 1.0})
    known = {"left_s": 9.0, "slope_c_per_min": None, "air_c": None, "device_c": None}
    live = "gyro_x 10.0 gyro_y 300.0 gyro_z -300.0"
    view.take({"event": "at", "time": 2.0, "phase": "dwelling", "number": 0, "live": live, **known})
    assert view.wrong == ""


@pytest.mark.slow
def test_an_emulator_ends_after_its_last_client_and_after_the_program_that_started_it(tmp_path):
    words, place = (
        [sys.executable, "-m", "undrift", "rig", "emulate", "--json", "--idle-s", "1"],
        tmp_path / "emulator.json",
    )
    place.touch()
    parent = f"import subprocess; subprocess.Popen({words!r}, stdout=open('emulator.json', 'w')).wait()"
    starter = subprocess.Popen([sys.executable, "-c", parent], cwd=tmp_path)
    try:
        eventually(lambda: place.read_text().strip(), "it listens")
        port = int(json.loads(place.read_text())["rig"].split(":")[3].partition("?")[0])
        with socket.create_connection(("127.0.0.1", port)):
            time.sleep(3.0)
            assert starter.poll() is None  # it has a client
        assert starter.wait(60.0) == 0
    finally:
        starter.kill()  # without it the emulator ends too


def test_the_emulated_table_is_found_by_the_next_bench(tmp_path):
    table = EmulatedTable(tmp_path, ("--speed", "20"))
    try:
        addresses = table.start()
        assert set(addresses) == {"rig", "device", "chamber", "operator"}
        after = EmulatedTable(tmp_path, ("--speed", "20"))
        assert after.start() == addresses
        after.close()  # it is not its own
        assert after.is_there()
        after.words = ("--speed", "10")  # another speed is another table
        assert after.start() != addresses
        assert "speed=10" in after.start()["device"]
        addresses = after.start()
        after.close()
    finally:
        table.close()
    assert not table.is_there()
    assert json.loads((tmp_path / "emulator.json").read_text())["rig"] == addresses["rig"]


def test_a_run_that_was_never_started_is_no_run_to_go_on_with(bench, tmp_path):
    begin_run(tmp_path / "jobs" / "a" / "session", SHORT, order_of(bench))
    assert find_run(tmp_path / "jobs") is None
    assert not RigRun(tmp_path / "jobs" / "a" / "session").is_going()
