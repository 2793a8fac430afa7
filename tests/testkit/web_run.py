"""Runs of the rate table as the bench starts them, on an emulated bench in this process."""

import contextlib
import os
import signal
import time
from contextlib import contextmanager

from undrift.commands.bench.rig_run import RunOrder, begin_run
from undrift.sim.rig import galil_language
from undrift.sim.rig.emulator import EmulatedBench, EmulatedBenchSettings, EmulatorSettings
from undrift.web.rate_table import ProtocolForm

SPEED = 20.0
SHORT = ProtocolForm(
    faces=("+z",),
    face_s="2",
    axes=("z",),
    turn_rate_min_dps="30",
    turn_rate_max_dps="60",
    turn_rate_step_dps="30",
    dwell_s="3",
    bracket_s="1",
).toml()


@contextmanager
def emulated_bench(speed=SPEED):
    """Yield an emulated bench, and the moments at which its card obeyed a stop (ST), host's monotonic s."""
    obeyed, before = [], galil_language._ACTS["ST"]

    def stop(card):
        obeyed.append(time.monotonic())
        before(card)

    galil_language._ACTS["ST"] = stop
    try:
        with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=speed))) as bench:
            yield bench, obeyed
    finally:
        galil_language._ACTS["ST"] = before


def order_of(bench, *, operator=True):
    return RunOrder(
        rig=bench.rig_address, device=bench.device_address, operator=bench.hands_address if operator else ""
    )


def new_run(bench, folder, protocol=SHORT, *, operator=True):
    return begin_run(folder, protocol, order_of(bench, operator=operator))


def wait(run, true, seconds=60.0):
    """Follow a run until something is true of its view."""
    last = time.monotonic() + seconds
    while not true(run.refresh()):
        assert time.monotonic() < last, (run.view, (run.place / "run.log").read_text()[-2000:])
        time.sleep(0.02)
    return run.view


def is_dwelling(view):
    return view.phase == "dwelling" and view.state == "running"


def at_end(view):
    return view.state in ("done", "failed", "paused", "stopped")


@contextmanager
def ended_at_last(run):
    """End every process of a run, whatever a test left of it."""
    try:
        yield run
    finally:
        run.refresh()
        pids = [run.view.pid, run._standing.get("pid")]
        for pid in pids if run.is_going() else ():
            with contextlib.suppress(ProcessLookupError, TypeError):
                os.kill(pid, signal.SIGCONT)
                os.kill(pid, signal.SIGTERM)
        last = time.monotonic() + 20.0
        while run.is_going() and time.monotonic() < last:
            time.sleep(0.05)
        if run._supervisor is not None:
            run._supervisor.wait(20.0)
