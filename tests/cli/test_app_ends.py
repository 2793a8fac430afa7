"""However a command ends, no file is half written, and what a killed one left is swept by the next."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import undrift
from testkit.full_calibration import device, record
from undrift.errors import InputError
from undrift.io.parquet import ParquetWriter, write_parquet
from undrift.io.store import write_calibration
from undrift.io.text import write_rows

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


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_fills_while_rows_are_written_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("pyarrow.csv.write_csv", full)
    with pytest.raises(InputError, match=r"r\.csv: expected free disk space"):
        write_rows(tmp_path / "r.csv", ("a", "b"), (np.zeros(10), np.zeros(10)))

    def full_of_arrow(*_):
        raise OSError("Error writing bytes to file. Detail: [errno 28] No space left on device")

    monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", full_of_arrow)
    with pytest.raises(InputError, match=r"r\.parquet: expected free disk space"):  # noqa: SIM117
        with ParquetWriter(tmp_path / "r.parquet") as writer:
            writer.write(record(100))
    assert list(tmp_path.iterdir()) == []


@needs_signals
def test_a_limit_on_the_size_of_files_is_one_line(tmp_path):
    code = """
import resource, sys
from pathlib import Path
from testkit.full_calibration import record
from undrift.errors import InputError
from undrift.io.parquet import write_parquet
made, path = record(4000), Path(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
try:
    write_parquet(made, path)
except InputError as error:
    print(error)
"""
    words = [sys.executable, "-c", code, str(tmp_path / "o.parquet")]
    paths = os.pathsep.join((str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": paths})
    assert done.stdout.startswith(f"{tmp_path / 'o.parquet'}: cannot be written: File too large. Check")
    assert done.stdout.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_seen_enough_is_no_failure():
    rest = Path(undrift.__file__).with_name("sample_data") / "rest.parquet"
    words = [sys.executable, "-m", "undrift", "info", str(rest)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        child.stdout.close()
        assert child.wait(timeout=60.0) == 0
        assert child.stderr.read() == b""
