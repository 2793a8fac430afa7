"""What a power cut leaves of a run: at each fsync, with what was not brought to the disk lost, empty, zeros or torn."""

import hashlib
import random
from collections import Counter

import pytest

from testkit.data import show
from testkit.disk import cuts, logged
from testkit.rig_bench import SHORT, run, simulated
from undrift.errors import InputError
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
