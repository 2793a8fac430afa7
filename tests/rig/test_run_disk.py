"""What a run keeps on a disk that is full, in which order it writes, and what damage to a finished run does."""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from testkit.data import show
from testkit.disk import preloaded
from testkit.rig_bench import SHORT, run, simulated
from undrift.errors import UndriftError
from undrift.io.session import read_session
from undrift.rig.folder import RunFolder


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="the names of open files, as Linux has them")
def test_readings_are_on_the_disk_before_the_session_names_them(tmp_path, monkeypatch):
    """A power cut between any two calls leaves a session whose files are whole."""
    calls, synced, renamed = [], os.fsync, Path.replace

    def fsync(handle):
        calls.append(("fsync", Path(os.readlink(f"/proc/self/fd/{handle}")).name))
        synced(handle)

    def replace(self, target):
        calls.append(("rename", Path(target).name, self.name))
        return renamed(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    run(simulated(), tmp_path / "run")
    names = [call for call in calls if call[0] == "rename"]
    assert [name for _, name, _ in names].count("session.toml") == 7  # a dwell each
    for _, name, part in names:
        at = next(k for k, call in enumerate(calls) if call[1:] == (name, part))
        folder = "pieces" if name.endswith(".parquet") else "run"
        later = next((k for k, call in enumerate(calls) if k > at and call[0] == "rename"), len(calls))
        assert ("fsync", part) in calls[:at], f"{name}: it has its name before its content is on the disk"
        assert ("fsync", folder) in calls[at:later], f"{name}: something is written before its name is on the disk"


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


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("flips") / "run"
    run(simulated(), path)
    return path


def read(path):
    """Return the session of a finished run, and its dwells as a resume reads them, as text with all digits."""
    session = read_session(path)
    arrays = [getattr(record, name) for record in session.records for name in ("time", "gyro", "accel", "temp_c")]
    with RunFolder(path, SHORT, resume=True) as folder:
        parts = (session.stills, session.turns, session.serial, session.gravity_m_s2, folder.head, folder.pieces)
        return repr(parts), [None if array is None else array.tobytes() for array in arrays]


@pytest.mark.slow
def test_a_flipped_bit_in_a_finished_run_is_refused_or_changes_nothing(finished):
    sound, rng = read(finished), random.Random(16)
    files = sorted(p for p in finished.rglob("*") if p.is_file() and p.suffix in (".parquet", ".toml"))
    silent, refused = [], 0
    for k in range(200):
        path = files[k % len(files)]
        whole = path.read_bytes()
        place = rng.randrange(8 * len(whole))
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            if read(finished) != sound:
                silent.append((path.name, place))
        except UndriftError:
            refused += 1
        finally:
            path.write_bytes(whole)
            for aside in finished.glob("aside/*"):
                aside.unlink()
    show(f"of {200} flips, silent and different", len(silent), 0)
    show("refused", refused)
    assert silent == []
    assert refused > 200 // 2
