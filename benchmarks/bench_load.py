"""The bench under load: processor time of its server with a device of 200 Hz x 6 channels and two browsers; memory over an hour.

The device is a sender of this process; the server is ``undrift bench`` in a process of its own, with a calibration set, so that raw
and corrected signals, pitch and temperature are made and sent. The hour runs twenty times faster, on the device's clock.
"""

import binascii
import contextlib
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import undrift
from benchmarks.figure import Figure

RATE = 200
CHANNELS = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp"
MEASURED_S, WARM_S = 20.0, 5.0
SPEED, HOUR_S = 20.0, 3600.0


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Share of a core with two plain clients and with two pages, growth of memory over an hour.
    """
    figures = []
    with _served(1.0) as (server, address, page):
        figures += [Figure("processor of the server, nobody looks", _share(server, []), "% core", "")]
        with _listening(address), _listening(address):
            share = _share(server, [])
        figures += [Figure("processor of the server, two plain clients of the feed", share, "% core", "<= 10")]
        pages = [page(), page()]
        figures += [
            Figure("processor of the server, the page Live in two browsers", _share(server, pages), "% core", "<= 10")
        ]
    with _served(SPEED) as (server, address, _), _listening(address), _listening(address):
        grown, risen = _growth(server)
        figures += [Figure("memory of the server at the end of an hour", _resident_mb(server), "MB", "")]
    figures += [Figure("its growth after the first tenth, medians of tenths", grown, "MB", "<= 5")]
    return [*figures, Figure("its largest rise for a moment", risen, "MB", "")]


def _share(server: int, pages: list[Any]) -> float:
    """Return the processor time of a process over some seconds, percent of a core."""
    _pass(WARM_S, pages)
    start, used = time.monotonic(), _used_s(server)
    _pass(MEASURED_S, pages)
    return 100.0 * (_used_s(server) - used) / (time.monotonic() - start)


def _pass(seconds: float, pages: list[Any]) -> None:
    if pages:
        pages[0].wait_for_timeout(1000.0 * seconds)  # the browser's events are seen to meanwhile
    else:
        time.sleep(seconds)


def _growth(server: int) -> tuple[float, float]:
    """Return by how much memory grows over an hour of the device after its first tenth, and by how much it rises for a moment: MB.

    Growth is the median of the last tenth over that of the second: on a busy machine readings pile up for a moment.
    """
    start, sampled = time.monotonic(), []
    while (passed := SPEED * (time.monotonic() - start)) < HOUR_S:
        if passed > HOUR_S / 10.0:
            sampled.append(_resident_mb(server))
        time.sleep(0.25)
    tenth = len(sampled) // 9
    before = statistics.median(sampled[:tenth])
    return statistics.median(sampled[-tenth:]) - before, max(sampled) - before


def _used_s(process: int) -> float:
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / float(os.sysconf("SC_CLK_TCK"))


def _resident_mb(process: int) -> float:
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


# ---- The server, and who looks


@contextmanager
def _served(speed: float) -> Iterator[tuple[int, str, Callable[[], Any]]]:
    """Run a bench that has a device and a calibration; yields its process, the feed's address, and what opens the page Live."""
    from playwright.sync_api import sync_playwright

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        made = folder / "jobs" / "load" / "calibration.json"
        made.parent.mkdir(parents=True)
        rng = np.random.default_rng(7)
        device = undrift.random_device(rng)
        undrift.write_calibration(undrift.calibrate(undrift.simulate_session("bench", device, rng=rng)), made)
        readings = undrift.simulate_trial("sit_to_stand", device, rng=rng).record
        sender = stack.enter_context(_sending(readings, speed))
        words = f"-m undrift bench --port 0 --token none --no-browser --json --folder {folder}"
        server = stack.enter_context(
            subprocess.Popen([sys.executable, *words.split()], stdout=subprocess.PIPE, text=True)
        )
        stack.callback(server.terminate)
        address = json.loads(server.stdout.readline())["address"]  # type: ignore[union-attr]
        browser = stack.enter_context(sync_playwright()).chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )

        def page() -> Any:
            shown = browser.new_context().new_page()
            shown.goto(address + "live")
            shown.wait_for_function("window.socket && window.socket.connected")
            return shown

        first = page()
        first.get_by_label("Address of the device").fill(sender)
        first.get_by_role("button", name="Connect", exact=True).click()
        first.locator(".panel-state", has_text="Live.").wait_for()
        first.get_by_label("Calibration").select_option("load")
        first.locator("[aria-label*='corrected x']").first.wait_for()
        first.context.close()
        yield server.pid, address.replace("http", "ws") + "feed", page


@contextmanager
def _listening(address: str) -> Iterator[None]:
    """Read the feed until the end of the block."""
    from websockets.sync.client import connect

    with connect(address, max_size=None) as browser:
        thread = threading.Thread(target=lambda: [None for _ in browser])
        thread.start()
        yield
        assert thread.is_alive(), "the feed ended early"
        browser.close()
        thread.join()


@contextmanager
def _sending(readings: undrift.Record, speed: float) -> Iterator[str]:
    """Send a record again and again, on time, reading by reading where the clock lets it; yields the address."""
    at = np.arange(0, len(readings), max(1, round(readings.sample_rate_hz / RATE)))
    values = np.column_stack([readings.gyro[at], readings.accel[at], np.full(len(at), 25.0)])  # type: ignore[index]
    body = np.zeros(RATE * 3600, dtype=[("sync", "V2"), ("count", "<u4"), ("values", "<f4", 7), ("crc", "<u2")])
    body["sync"], body["count"] = np.void(b"\xaa\x55"), np.arange(len(body))
    body["values"] = np.resize(values, (len(body), 7))
    size = body.itemsize
    raw = body.view("u1").reshape(-1, size)
    body["crc"] = [binascii.crc_hqx(row, 0xFFFF) for row in raw[:, 2 : size - 2]]
    data, over = memoryview(body.tobytes()), threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def send() -> None:
        client, _ = listener.accept()
        with client, contextlib.suppress(OSError):  # the server ends first
            start, sent = time.monotonic(), 0
            while not over.wait(0.005):
                due = min(int((time.monotonic() - start) * RATE * speed), len(body))
                client.sendall(data[sent * size : due * size])
                sent = due

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    options = f"format=frame&pack=<I7f&checksum=crc16&rate={RATE}&clock_speed={speed:g}&channels={CHANNELS}"
    units = f"&gyro_unit={readings.gyro_unit}&accel_unit={readings.accel_unit}"
    yield f"tcp://127.0.0.1:{listener.getsockname()[1]}?{options}{units}"
    over.set()
    thread.join(5.0)
    listener.close()
