"""Supervisor: the process that a run of the rate table lives in, apart from the bench: it starts the command, and stops the table.

    python -m undrift.commands.bench.supervisor FOLDER

It holds a standby connection to the table (rig/watch.py) and listens on a port of its own, so that an emergency stop waits for
neither the bench's event loop nor the run. Its requests are POSTs with the key that stands in FOLDER/../run/standby.json::

    /stop?key=K                     stop at once, end the run
    /pause?key=K                    end the dwell that is going; table at rest, motor off; the command ends with 130
    /answer?key=K&number=1&text=    answer a question of the run

Nothing of it depends on the bench: a bench that ends leaves it, and the next one finds it. It ends with its run.
"""

import contextlib
import json
import os
import secrets
import signal
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import FrameType
from urllib.parse import parse_qs, urlsplit

from undrift.commands.bench.rig_run import ANSWER, LOCK, LOG, PLACE, PROGRESS, STANDBY, command_of, read_order
from undrift.files import take_lock, write_whole
from undrift.rig.run import append
from undrift.rig.watch import Standby, stop_now

NICE = -10  # where the system allows it


class Supervisor:
    """One run, from its start to its end."""

    def __init__(self, folder: Path) -> None:
        self._place = folder.parent / PLACE
        self._lock = os.open(self._place / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        take_lock(self._lock, 0.5)  # the child inherits it: free when both are gone
        order = read_order(folder)
        self.key = secrets.token_hex(16)
        self._stopping: threading.Thread | None = None
        self._one_at_a_time = threading.Lock()
        self._standby = Standby(order.rig)
        self._server = ThreadingHTTPServer((order.host, 0), type("Handler", (_Handler,), {"supervisor": self}))
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, name="stop", daemon=True).start()
        with (self._place / ANSWER).open("wb") as out, (self._place / LOG).open("ab") as err:
            self._child = subprocess.Popen(
                command_of(order, folder), stdin=subprocess.PIPE, stdout=out, stderr=err, pass_fds=(self._lock,)
            )
        with contextlib.suppress(OSError):
            os.nice(NICE)  # after the child was started
        append(self._place / PROGRESS, "started", pid=self._child.pid, standby=self._standby.reason)
        place = {"port": self._server.server_address[1], "key": self.key, "pid": os.getpid()}
        write_whole(self._place / STANDBY, json.dumps(place) + "\n")

    def stop(self) -> bool:
        """Stop the table at once; what follows goes on in a thread. Return whether the stop has left."""
        left = self._standby.shout()
        with self._one_at_a_time:
            if self._stopping is None:
                self._stopping = threading.Thread(target=self._end_it, name="end the run")
                self._stopping.start()
        return left

    def pause(self) -> None:
        """End the run as Ctrl-C does; a halted one is woken for it."""
        append(self._place / PROGRESS, "pausing")
        for number in (signal.SIGTERM, signal.SIGCONT):
            with contextlib.suppress(ProcessLookupError):
                self._child.send_signal(number)

    def answer(self, number: str, text: str) -> None:
        """Hand an answer on to the run."""
        with self._one_at_a_time, contextlib.suppress(OSError, ValueError):
            if self._child.stdin is not None and number.isdigit():
                self._child.stdin.write(f"{number} {' '.join(text.split())}\n".encode())
                self._child.stdin.flush()

    def wait(self) -> None:
        """Wait for the end of the run, and write how it ended."""
        code = self._child.wait()
        if self._stopping is not None:
            self._stopping.join()
        append(self._place / PROGRESS, "ended", code=code)
        self._server.shutdown()
        self._server.server_close()
        self._standby.close()

    def _end_it(self) -> None:
        append(self._place / PROGRESS, "stopping")
        confirmed = stop_now(self._standby, lambda: self._child.poll() is not None, self._child.pid)
        append(self._place / PROGRESS, "stopped", confirmed=confirmed)


class _Handler(BaseHTTPRequestHandler):
    supervisor: Supervisor
    protocol_version = "HTTP/1.1"
    timeout = 30

    def do_POST(self) -> None:
        """Do what is asked with the right key."""
        asked = urlsplit(self.path)
        given = {name: values[0] for name, values in parse_qs(asked.query, keep_blank_values=True).items()}
        held = self.supervisor
        if not secrets.compare_digest(given.get("key", "").encode(), held.key.encode()):
            self._send(403, {"error": "stop: wanted the key of this run, got another; load the page again"})
        elif asked.path == "/stop":
            self._send(200, {"sent": held.stop()})
        elif asked.path == "/pause":
            held.pause()
            self._send(200, {})
        elif asked.path == "/answer":
            held.answer(given.get("number", ""), given.get("text", ""))
            self._send(200, {})
        else:
            self._send(404, {"error": "stop: wanted /stop, /pause or /answer, got another place"})

    def log_message(self, format: str, *words: object) -> None:
        """Say nothing."""

    def _send(self, code: int, answer: dict[str, object]) -> None:
        with contextlib.suppress(OSError):
            text = json.dumps(answer).encode()
            self.send_response(code)
            for name, value in (("Content-Type", "application/json"), ("Content-Length", str(len(text)))):
                self.send_header(name, value)
            self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(text)


def main(folder: Path) -> None:
    """Supervise a run until it ends; Ctrl-C and SIGTERM pause it."""
    held = Supervisor(folder)

    def end(number: int, frame: FrameType | None) -> None:
        held.pause()

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, name), end)
    held.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
