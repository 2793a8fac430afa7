"""What a run survives: kill -9, a full disk, half-written pieces; and what a resume refuses."""

import hashlib
import itertools
import json
import os
import random
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.bench import FORKS
from testkit.cards import TurningBoard, TurningCard
from testkit.data import show
from testkit.rig_bench import DEVICE, FACE, GAIN, OFFSET, RATES, SHORT, UP, at_rest, driven, run, simulated
from undrift.base.clock import PacedClock
from undrift.errors import FileFormatError, InputError, LinkError
from undrift.io.session import read_session
from undrift.programme import Protocol, write_protocol
from undrift.rig.folder import SESSION, RunFolder, read_journal
from undrift.rig.lock import stopping_on_signals
from undrift.sim.device.model import write_device
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY


def command(words: list[str], folder: Path, killed_at: tuple[str, int] | None = None) -> tuple[int | None, str, str]:
    """Run a command in a process of its own. Return the exit code, standard output and standard error.

    With ``killed_at`` it ends by kill -9 in the n-th call of ``fsync`` or of the simulated bench's ``wait``.
    """
    out, err = (folder / f"{name} of {time.monotonic_ns()}" for name in ("out", "err"))
    process = FORKS.Process(target=_called, args=(words, out, err, killed_at))
    process.start()
    process.join(120.0)
    return process.exitcode, out.read_text(), err.read_text()


def _called(words: list[str], out: Path, err: Path, killed_at: tuple[str, int] | None) -> None:
    """Be the command."""
    from undrift.cli.app import main

    for number, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    if killed_at:
        _kill_in_call(*killed_at)
    main(words)


def _kill_in_call(name: str, number: int) -> None:
    """Let this process end with kill -9 after a number of calls of a function."""
    owner: Any = {"fsync": os, "wait": PacedClock}[name]
    function, calls = getattr(owner, name), itertools.count(1)

    def counted(*values: Any) -> Any:
        if next(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*values)

    setattr(owner, name, counted)


LONGER = Protocol(faces=FACE.but(seconds=1.0), rates=RATES.but(turn_rate_max_dps=90.0, seconds=2.0, bracket_s=1.0))
DWELLS = 9
needs_signals = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")


@pytest.fixture
def protocol(tmp_path):
    write_protocol(LONGER, tmp_path / "protocol.toml")
    return tmp_path / "protocol.toml"


def simulated_run(protocol, path, *more):
    """Return the call of a run on a simulated bench in the called process."""
    device = path.with_name("device.json")
    write_device(DEVICE, device)
    addresses = ["--rig", "simulated:?clock_speed=1e6", "--device", f"simulated:?device={device}"]
    return ["rig", "run", str(protocol), *addresses, "-o", str(path), "--yes", *more]


@needs_signals
@pytest.mark.parametrize("wanted", [4, pytest.param(60, marks=pytest.mark.slow)])
def test_kill_9_loses_nothing_and_a_resume_completes(tmp_path, protocol, wanted):
    """A run is killed in a random call, resumed and killed again; each dwell that was written is still there, bit by bit."""
    path, kept, kills, lost, chance = tmp_path / "run", dict[int, str](), list[int](), 0, random.Random(60)
    while True:
        # in a call of the clock's wait while the run moves and reads, or of fsync while it writes
        killed_at = (chance.choice(("wait", "fsync")), chance.randrange(1, 60)) if len(kills) < wanted else None
        code, out, err = command(simulated_run(protocol, path, "--resume", "--json"), tmp_path, killed_at)
        assert code in (0, -signal.SIGKILL), err
        now = {piece.step: piece.sha256 for piece in read_journal(path / SESSION)[1]}
        lost += len(kept.items() - now.items())
        assert not lost
        assert all(digest == sha256_of(path / f"pieces/{step:04d}.parquet") for step, digest in now.items())
        if now:
            assert len(read_session(path).records) == len(now)
        kept = now
        kills += [len(kept)] * (code != 0)
        if code == 0:
            assert json.loads(out)["data"]["dwells"] == DWELLS == len(kept)
            assert_true(read_session(path))
            path, kept = path.with_name(f"{path.name}-again"), {}
            if killed_at is None:
                break
    show("kills; dwells on the disk then, and lost", (len(kills), sum(kills), lost))


def sha256_of(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def assert_true(session):
    """Compare a whole run with the device's true errors: rates to 0.1 deg/s, mean readings to 0.2 deg/s and 0.015 m/s2."""
    assert sorted(round(turn.turn_rate / DPS) for turn in session.turns) == [-90, -60, -30, 30, 60, 90]
    assert [still.face for still in session.stills] == ["+z"] * 3
    for part in (*session.stills, *session.turns):
        record, inside = session.records[part.recording], slice(part.start, part.stop)
        rate = np.array([0.0, 0.0, getattr(part, "turn_rate", 0.0) / DPS])
        np.testing.assert_allclose(record.gyro[inside].mean(axis=0), GAIN @ rate + OFFSET, rtol=0.0, atol=0.2)
        gravity = STANDARD_GRAVITY * UP["+z"]
        np.testing.assert_allclose(record.accel[inside].mean(axis=0), gravity, rtol=0.0, atol=0.015)


@pytest.mark.parametrize("controller", [TurningCard, TurningBoard])
@pytest.mark.parametrize("phase", ["settling", "dwelling"])
def test_a_table_whose_program_died_comes_to_rest_within_the_dwell(tmp_path, controller, phase):
    """The program says nothing more to the controller from that phase on, as after kill -9."""
    bench = simulated()
    card, died = controller(bench), []

    def die(progress):
        if (progress.phase, progress.number) == (phase, 4):
            assert abs(bench.turn_rate()) > 25.0 * DPS
            card.server.answer = lambda command: None
            died.append(bench.now())
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, LinkError)):
        run(bench, tmp_path, report=die, rig=lambda: driven(card, reply_timeout_s=0.01))
    assert bench.clock.until(lambda: bench.turn_rate() == 0.0, 10.0, 0.1)
    limit_s = 1.1 * RATES.seconds + 2.0 + 3.0  # with its spare time, and the ramps
    show(f"{controller.__name__}, {phase}: at rest after s", round(bench.now() - died[0], 2), limit_s)
    assert bench.now() - died[0] < limit_s
    bench.clock.wait(60.0)
    assert bench.turn_rate() == 0.0


@needs_signals
@pytest.mark.parametrize("name", ["SIGTERM", "SIGTSTP"])
def test_signals_end_a_run_at_rest_with_what_was_done(tmp_path, name):
    bench = simulated()
    card, number = TurningCard(bench), getattr(signal, name)

    def report(progress):
        if (progress.phase, progress.number) in (("dwelling", 4), ("closing", 4)):  # another one during the end
            os.kill(os.getpid(), number)

    with pytest.raises(KeyboardInterrupt, match=name), stopping_on_signals():
        run(bench, tmp_path, report=report, rig=lambda: driven(card))
    assert at_rest(bench)
    assert len(read_session(tmp_path).records) == 3


# ---- Folders that are not what a resume needs.


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory):
    path = tmp_path_factory.mktemp("finished") / "run"
    run(simulated(), path)
    return path


@pytest.fixture
def finished(whole_run, tmp_path):
    """Return a copy of a finished run."""
    return shutil.copytree(whole_run, tmp_path / "run")


def test_half_written_pieces_are_put_aside_and_whole_ones_checked(finished):
    path = finished
    (path / "pieces" / "0099.parquet.part").write_bytes(b"PAR1 half")
    (path / "pieces" / "0098.parquet").write_bytes(b"PAR1 half")
    with RunFolder(path, SHORT, resume=True) as folder:
        assert sorted(os.listdir(path / "aside")) == ["0098.parquet", "0099.parquet.part"]
        assert len(folder.done) == 7
    name = path / folder.pieces[0].name
    name.write_bytes(name.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"readings of step 1 were changed"):
        RunFolder(path, SHORT, resume=True)
    name.unlink()
    result, hands = run(simulated(), path, resume=True)
    assert (result.added, len(result.pieces), hands.mounted) == (1, 7, ["+z"])


def test_another_run_is_not_mixed_in(finished):
    path = finished
    with pytest.raises(InputError, match="contains a run"):
        RunFolder(path, SHORT)
    with pytest.raises(InputError, match="protocol differs"):
        RunFolder(path, SHORT.but(rates=RATES.but(seconds=2.0)), resume=True)
    with RunFolder(path, SHORT, resume=True) as folder:
        assert folder.head is not None
        with pytest.raises(InputError, match=r"began with rig 'simulated.*', got 'other'"):
            folder.begin(replace(folder.head, rig="other"))


def test_two_programs_never_write_into_one_folder(tmp_path, protocol):
    path = tmp_path / "run"
    with RunFolder(path, SHORT) as first:
        with pytest.raises(InputError, match="another run is writing"):
            RunFolder(path, SHORT, resume=True)
        code, _, err = command(simulated_run(protocol, path), tmp_path)
        assert (code, "another run is writing" in err) == (2, True)
    assert first.pieces == ()
    result, _ = run(simulated(), path)
    assert result.added == 7


def test_readings_of_a_step_are_never_written_over(tmp_path):
    bench = simulated()
    (tmp_path / "run" / "pieces").mkdir(parents=True)
    strange = tmp_path / "run" / "pieces" / "0005.parquet"

    def drop_in(progress):
        if progress.number == 5:
            strange.write_bytes(b"of another program")

    with pytest.raises(InputError, match=r"0005\.parquet: .* are kept"):
        run(bench, tmp_path / "run", report=drop_in)
    assert at_rest(bench)
    assert strange.read_bytes() == b"of another program"


def test_a_session_that_was_changed_is_refused(finished):
    text = (finished / SESSION).read_text()
    for changed in ("", text[:-20], text.replace("step = 3", "step = 4"), text.partition("\n")[2]):
        (finished / SESSION).write_text(changed)
        with pytest.raises(FileFormatError, match="not the session of a run"):
            RunFolder(finished, SHORT, resume=True)
    (finished / SESSION).unlink()
    with pytest.raises(InputError, match="contains a run"):
        RunFolder(finished, SHORT)
    assert len(os.listdir(finished / "pieces")) == 7
