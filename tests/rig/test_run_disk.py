"""What a power cut leaves of a run: at each fsync, with what was not brought to the disk lost, empty, zeros or torn."""

import hashlib
import random
import subprocess
import sys
from collections import Counter

import pytest

from testkit.data import show
from testkit.disk import cuts, logged, preloaded
from testkit.rig_bench import SHORT, run, simulated
from undrift.errors import InputError, UndriftError
from undrift.io.session import read_session
from undrift.rig.folder import RunFolder

RUN = """
from testkit.disk import mark
from testkit.rig_bench import SHORT, run, simulated
from undrift.rig.folder import RunFolder

def keep(folder, record, piece, real=RunFolder.keep):
    kept = real(folder, record, piece)
    mark(kept.step)
    return kept

RunFolder.keep = keep
run(simulated(), {path})
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Return the log of a run and its folder."""
    folder = tmp_path_factory.mktemp("run") / "disk"
    folder.mkdir()
    path = f"__import__('pathlib').Path({str(folder / 'run')!r})"
    logged(RUN.format(path=path), folder, folder.with_name("log"))
    return folder.with_name("log"), folder


@pytest.mark.parametrize(
    ("everywhere", "every"),
    [(False, 5), pytest.param(False, 1, marks=pytest.mark.slow), pytest.param(True, 1, marks=pytest.mark.slow)],
)
def test_a_power_cut_at_each_fsync_loses_no_dwell_that_was_reported(log, tmp_path, everywhere, every):
    counted, rng = Counter(), random.Random(3)
    digests = set()
    for number, cut in enumerate(cuts(*log, everywhere=everywhere)):
        if number % every:
            continue
        path = tmp_path / str(number)
        for name, content in cut.files.items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_bytes(content)
        path.mkdir(exist_ok=True)
        reported = {*cut.marks}
        counted["cuts"] += 1
        run_path = path / "run"
        counted[f"session {before_resume(run_path)}"] += 1
        with RunFolder(run_path, SHORT, resume=True) as folder:
            assert reported <= folder.done, cut
            for piece in folder.pieces:
                digests.add((piece.step, piece.sha256))
                assert hashlib.sha256((run_path / piece.name).read_bytes()).hexdigest() == piece.sha256
            if folder.pieces:
                folder.begin(folder.head)
        if folder.pieces:
            assert len(read_session(run_path).records) == len(folder.pieces)
        if rng.random() < 0.01 or number % 100 == 0:
            bench = simulated()
            result, _ = run(bench, run_path, resume=True)
            assert len(result.pieces) == 7
            counted["resumed to the end"] += 1
    assert len(digests) <= 7  # none but those that were written
    show("power cuts of a run", counted)
    assert counted["cuts"] > 60 / every


def before_resume(path):
    """Say what the session is before the run is resumed: whole, or refused."""
    if not (path / "session.toml").exists():
        return "none"
    try:
        read_session(path)
    except InputError:
        return "refused"
    return "read"


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
