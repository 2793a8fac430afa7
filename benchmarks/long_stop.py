"""Emergency stop of the bench: from the click to the command in the emulated table's hands, 60 times; about five minutes."""

import http.client
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from benchmarks.figure import Figure
from undrift.commands.bench.rig_run import RigRun, RunOrder, begin_run
from undrift.sim.rig import galil_language
from undrift.sim.rig.emulator import EmulatedBench, EmulatedBenchSettings, EmulatorSettings
from undrift.web.rate_table import ProtocolForm

LIMIT_MS = 100
PROTOCOL = ProtocolForm(faces=(), axes=("z",), turn_rate_min_dps="30", bracket_s="1", dwell_s="60").toml()
LOAD = """
import threading, urllib.request
def ask():
    while True:
        try:
            urllib.request.urlopen({address!r} + "rate-table", timeout=20).read()
        except OSError:
            pass
threads = [threading.Thread(target=ask) for _ in range(4)]
[thread.start() for thread in threads]
"""


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Median and largest delay in each condition, ms.
    """
    obeyed: list[float] = []
    with tempfile.TemporaryDirectory() as folder, _noting(obeyed), _table() as table:
        order = RunOrder(rig=table.rig_address, device=table.device_address, operator=table.hands_address)
        held = begin_run(Path(folder) / "jobs" / "stop" / "session", PROTOCOL, order)
        found = {"while the run turns the table": [_click(held, obeyed) for _ in range(20)]}
        found["while the run's process is halted"] = [_click(held, obeyed, halted=True) for _ in range(15)]
        with _loaded(Path(folder)) as port:
            found["while four clients keep the bench busy"] = [_click(held, obeyed) for _ in range(15)]
            found["the same, through the busy bench itself"] = [_click(held, obeyed, bench=port) for _ in range(10)]
    figures = []
    for what, late in found.items():
        late.sort()
        gate = "" if "itself" in what else f"<= {LIMIT_MS}"
        print(f"  {what}, ms: {' '.join(f'{each:.1f}' for each in late)}")
        figures += [Figure(f"emergency stop {what}: median of {len(late)}", late[len(late) // 2], "ms")]
        figures += [Figure(f"emergency stop {what}: largest", late[-1], "ms", gate)]
    return figures


def _click(held: RigRun, obeyed: list[float], *, halted: bool = False, bench: int = 0) -> float:
    """Run until the table turns, post a stop as a browser does, and return how late it was obeyed, ms."""
    held.launch()
    last = time.monotonic() + 120.0
    while held.refresh().phase != "dwelling":
        assert time.monotonic() < last, held.view
        time.sleep(0.02)
    if halted:
        os.kill(held.view.pid or 0, signal.SIGSTOP)
        time.sleep(0.1)
    obeyed.clear()
    port, _, rest = held.stop_url.removeprefix(":").partition("/")
    clicked = time.monotonic()
    with closing(http.client.HTTPConnection("127.0.0.1", bench or int(port), timeout=60.0)) as link:
        link.request("POST", "/stop" if bench else f"/{rest}")
        link.getresponse().read()
    while held.refresh().state not in ("stopped", "failed"):
        assert time.monotonic() < last, held.view
        time.sleep(0.02)
    assert (held.view.state, held.view.confirmed) == ("stopped", True), held.view
    return 1e3 * (obeyed[0] - clicked)


@contextmanager
def _noting(obeyed: list[float]) -> Iterator[None]:
    """Note when the emulated card obeys a stop."""
    before = galil_language._ACTS["ST"]

    def stop(card: object) -> None:
        obeyed.append(time.monotonic())
        before(card)  # type: ignore[arg-type]

    galil_language._ACTS["ST"] = stop
    try:
        yield
    finally:
        galil_language._ACTS["ST"] = before


def _table() -> EmulatedBench:
    return EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=20.0)))


@contextmanager
def _loaded(folder: Path) -> Iterator[int]:
    """Serve a bench that four clients ask for pages without a pause; yield its port."""
    words = ["bench", "--port", "0", "--no-browser", "--json", "--folder", str(folder)]
    server = subprocess.Popen([sys.executable, "-m", "undrift", *words], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = json.loads(server.stdout.readline())["address"]
    load = subprocess.Popen([sys.executable, "-c", LOAD.format(address=address)])
    try:
        time.sleep(3.0)
        yield int(address.rstrip("/").rpartition(":")[2])
    finally:
        load.kill()
        load.wait()
        server.terminate()
        server.wait(60.0)
        server.stdout.close()
