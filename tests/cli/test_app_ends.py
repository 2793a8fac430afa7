"""However a command ends, no file is half written, and what a killed one left is swept by the next."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import undrift
from testkit.full_calibration import device, record
from undrift.io.parquet import write_parquet
from undrift.io.store import write_calibration

needs_signals = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


MAIN = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the shell of the tests ignores
for name in ("SIGTERM", "SIGHUP"):
    signal.signal(getattr(signal, name), signal.SIG_DFL)
from undrift.cli.app import main
main()
"""


def hidden(folder):
    return sorted(path.name for path in folder.iterdir() if path.name.endswith(".part"))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A calibration and a recording that takes seconds to correct."""
    folder = tmp_path_factory.mktemp("bench")
    write_calibration(device(), folder / "c.json")
    write_parquet(record(4_000_000), folder / "long.parquet")
    write_parquet(record(1000), folder / "short.parquet")
    return folder


def started(bench, out):
    """Start to correct the long recording and return when its part file is there."""
    words = [
        "correct",
        str(bench / "long.parquet"),
        "--calibration",
        str(bench / "c.json"),
        "-o",
        str(out / "o.parquet"),
    ]
    process = subprocess.Popen([sys.executable, "-c", MAIN, *words], stderr=subprocess.PIPE, text=True)
    while not hidden(out):
        assert process.poll() is None
        time.sleep(0.01)
    return process


@needs_signals
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_command_in_one_line_and_leaves_nothing(bench, tmp_path, name):
    process = started(bench, tmp_path)
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err.splitlines()[-1]) == (130, "undrift: stopped. No file was left incomplete.")
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_seen_enough_is_no_failure():
    rest = Path(undrift.__file__).with_name("sample_data") / "rest.parquet"
    words = [sys.executable, "-m", "undrift", "info", str(rest)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        child.stdout.close()
        assert child.wait(timeout=60.0) == 0
        assert child.stderr.read() == b""
