"""A run on a disk that is full at any write: it ends at rest with one clear line, keeps what it reported, and resumes."""

import subprocess
import sys

import pytest

from testkit.data import show
from testkit.disk import preloaded

RUNS = """
import hashlib, os, sys, tempfile
from collections import Counter
from pathlib import Path
from testkit.disk import full_after
from testkit.rig_bench import at_rest, run, simulated
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.rig.folder import RunFolder

def keep(folder, record, piece, real=RunFolder.keep):
    kept = real(folder, record, piece)
    reported[kept.name] = kept.sha256
    return kept

RunFolder.keep, counted, n, step = keep, Counter(), 0, int(sys.argv[1])
while True:
    reported = {}
    with tempfile.TemporaryDirectory() as folder:
        bench, path, text = simulated(), Path(folder, "run"), None
        with full_after(Path(folder), n, stays=n % 2 == 0) as calls:
            try:
                run(bench, path)
            except InputError as error:
                text = str(error)
        if calls[0] <= n:
            break
        assert text is not None, f"fault {n} was not noticed"
        assert "Free space" in text and chr(10) not in text, (n, text)
        assert at_rest(bench), n
        opened = [os.path.realpath(link) for link in Path("/proc/self/fd").iterdir()]
        assert not [name for name in opened if folder in name], n  # a deleted file that is open still takes room
        for name, digest in reported.items():
            assert hashlib.sha256((path / name).read_bytes()).hexdigest() == digest, (n, name)
        before = dict(reported)
        result, _ = run(bench, path, resume=True)
        assert {piece.name: piece.sha256 for piece in result.pieces}.items() >= before.items(), n
        assert len(result.pieces) == 7 == len(read_session(path).records), n
        counted["runs"] += 1
        counted["dwells kept"] += len(before)
    n += step
print(n, dict(counted))
"""


@pytest.mark.parametrize("step", [29, pytest.param(1, marks=pytest.mark.slow)])
def test_a_disk_that_is_full_at_any_write_ends_a_run_at_rest_and_it_resumes(step):
    words = [sys.executable, "-c", RUNS, str(step)]
    done = subprocess.run(words, env=preloaded(), capture_output=True, text=True, timeout=900.0, check=False)
    show("a run on a full disk", done.stdout)
    assert done.returncode == 0, done.stderr
