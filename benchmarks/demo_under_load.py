"""The quick demo beside busy processes: ``python -m benchmarks.demo_under_load [--runs 20] [--busy 3] [--share 0.5] [--nice 19]``.

Starts the busy processes, runs ``undrift demo --quick`` one time after the other, prints a line for each run and a summary, and
exits with 1 unless every run succeeded. The busy processes end with it, however it ends. ``--share`` puts all of it on one
processor and lets each demo run for that part of every tenth of a second, as a container with a limit does.
"""

import argparse
import contextlib
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

LONGEST_S = 600.0  # of one demo, on a processor of its own
PERIOD_S = 0.1
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent:\n    for _ in range(1_000_000):\n        pass"


def main(words: list[str]) -> int:
    """Run the demos.

    Parameters
    ----------
    words : list of str
        Of the command line.

    Returns
    -------
    int
        0 when every run succeeded, else 1.
    """
    parser = argparse.ArgumentParser(
        prog="benchmarks.demo_under_load", description="The quick demo beside busy processes."
    )
    parser.add_argument("--runs", type=int, default=20, help="demos, one after the other")
    parser.add_argument("--busy", type=int, default=3, help="processes that do nothing but use a processor each")
    parser.add_argument("--share", type=float, default=1.0, help="of one processor that a demo may have")
    parser.add_argument("--nice", type=int, default=0, help="of all processes")
    chosen = parser.parse_args(words)
    os.nice(chosen.nice)
    if chosen.share < 1.0:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # as an exception, so that the busy processes end too
    took_s, failed = [], 0
    with _busy(chosen.busy):
        for number in range(1, chosen.runs + 1):
            code, resumed, last, seconds = _demo(chosen.share)
            took_s.append(seconds)
            failed += code != 0
            result = "ok" if code == 0 else f"FAILED, exit code {code}: {last}"
            load = os.getloadavg()[0]
            print(
                f"run {number:3d} of {chosen.runs}   {seconds:6.1f} s   load {load:4.1f}   resumed {resumed}   {result}",
                flush=True,
            )
    print(
        f"{chosen.runs - failed} of {chosen.runs} runs succeeded beside {chosen.busy} busy processes; "
        f"{min(took_s):.1f} to {max(took_s):.1f} s, median {statistics.median(took_s):.1f} s"
    )
    return 1 if failed else 0


@contextlib.contextmanager
def _busy(count: int) -> Iterator[None]:
    """Keep processes busy; each ends by itself should this one be killed."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        started.extend(subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count))
        yield
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


def _demo(share: float) -> tuple[int, int, str, float]:
    """Return exit code, how often a run was resumed, the last line of stderr, and the time it took, s."""
    began, longest_s = time.monotonic(), LONGEST_S if share == 1.0 else 6.0 * LONGEST_S
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
        command = [sys.executable, "-m", "undrift", "demo", "--quick", "--json", "--out", str(Path(folder) / "demo")]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said, start_new_session=True)
        try:
            while process.poll() is None and time.monotonic() - began < longest_s:
                time.sleep(share * PERIOD_S)
                if share < 1.0:
                    os.killpg(process.pid, signal.SIGSTOP)
                    time.sleep((1.0 - share) * PERIOD_S)
                    os.killpg(process.pid, signal.SIGCONT)
        finally:
            code = process.poll()
            if code is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        said.seek(0)
        lines = [line for line in said.read().splitlines() if line.strip()]
    if code is None:
        code, lines = -1, [*lines, f"no end within {longest_s:g} s"]
    resumed = sum("; resuming, attempt" in line for line in lines)
    return code, resumed, lines[-1] if lines else "", time.monotonic() - began


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
