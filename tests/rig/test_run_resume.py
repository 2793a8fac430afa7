"""What a run survives: kill -9, a full disk, half-written pieces; and what a resume refuses."""

import contextlib
import errno
import hashlib
import io
import itertools
import json
import os
import random
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.bench import FORKS
from testkit.cards import TurningBoard, TurningCard
from testkit.data import show
from testkit.rig_bench import DEVICE, GAIN, OFFSET, RATE_HZ, SHORT, UP, at_rest, driven, run, simulated
from testkit.talking_device import TalkingDevice
from undrift.base.clock import Clock, PacedClock
from undrift.errors import FileFormatError, InputError, LinkError
from undrift.io.session import read_session
from undrift.programme import Protocol, write_protocol
from undrift.rig import folder as folder_file
from undrift.rig.folder import SESSION, Head, RunFolder, read_journal, session_text
from undrift.rig.lock import stop_rig
from undrift.sim.device.model import write_device
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY

TOGETHER_S = 0.02  # between two packets of the device, host s


class BenchOnHost:
    """A bench whose clock runs at a multiple of the host's: a card that drives the table, and a sending device, with +z
    up.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self.bench = simulated(Clock.started(speed))
        self.card = TurningCard(self.bench)
        self.bench.readings[0].start()
        self.device = SendingDevice(self)

    def __enter__(self) -> "BenchOnHost":
        return self

    def __exit__(self, *failure: object) -> None:
        self.device.__exit__()
        self.card.server.close()

    @property
    def address(self) -> str:
        """Return the address of the table."""
        return f"{self.card.address}?clock_speed={self.speed:g}&reply_timeout_s=20"

    def words(self, protocol: Path, path: Path, *more: str) -> list[str]:
        """Return the call of a run."""
        device = f"{self.device.address}&clock_speed={self.speed:g}"
        return ["rig", "run", str(protocol), "--rig", self.address, "--device", device, "-o", str(path), "--yes", *more]

    def turn_rate(self) -> float:
        """Return the true rate of the axis, rad/s."""
        with self.card.lock:
            return self.bench.turn_rate()

    def at_rest(self, *, motor_on: bool = False) -> bool:
        """Wait until the axis is at rest with its motor off, or also on. Return False if this never happens."""
        return until(lambda: abs(self.turn_rate()) <= 2e-3 and (motor_on or not self.bench.servo.powered))

    def turning(self) -> bool:
        """Wait until the axis turns. Return False if this never happens."""
        return until(lambda: abs(self.turn_rate()) > 0.2)


class SendingDevice(TalkingDevice):
    """The device of a bench, sending to all that listen."""

    def __init__(self, host: BenchOnHost) -> None:
        self.host = host
        super().__init__(RATE_HZ)

    def _talk(self) -> None:
        readings = self.host.bench.readings[0]
        while not self._end.wait(TOGETHER_S):
            with self.host.card.lock:
                self.host.bench.advance()
                chunks, readings._kept = readings._kept, []
            rows = ((count, *row) for counts, values in chunks for count, row in zip(counts, values, strict=True))
            lines = "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in rows)
            for client in list(self._clients):
                with contextlib.suppress(OSError):
                    client.sendall(lines.encode())


def until(condition: Callable[[], object], within_s: float = 60.0) -> bool:
    """Wait for a condition, host s."""
    last = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > last:
            return False
        time.sleep(0.005)
    return True


class Command:
    """A command that runs in a process of its own, and finds an Enter whenever it asks.

    With ``killed_at`` it ends by kill -9 in the n-th call of ``fsync`` or, on a simulated bench, of the clock's ``wait``. No
    file may grow beyond ``largest_file`` bytes.
    """

    def __init__(
        self, words: list[str], folder: Path, *, killed_at: tuple[str, int] | None = None, largest_file: int = 0
    ) -> None:
        self._out, self._err = (folder / f"{name} of {time.monotonic_ns()}" for name in ("out", "err"))
        self._process = FORKS.Process(target=_called, args=(words, self._out, self._err, killed_at, largest_file))
        self._process.start()

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.exitcode is not None

    def signal(self, number: int) -> None:
        """Send a signal to the process, if it is still running."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process.pid, number)

    def kill(self) -> None:
        """End it with kill -9."""
        self.signal(signal.SIGKILL)
        self._process.join(30.0)

    def result(self) -> tuple[int | None, str, str]:
        """Wait for the end. Return the exit code, standard output and standard error."""
        self._process.join(120.0)
        return self._process.exitcode, self._out.read_text(), self._err.read_text()


def _called(words: list[str], out: Path, err: Path, killed_at: tuple[str, int] | None, largest_file: int) -> None:
    """Be the command."""
    from undrift.cli.app import main

    sys.stdin = io.StringIO("\n" * 100)
    for number, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    if killed_at:
        _kill_in_call(*killed_at)
    if largest_file:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
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


LONGER = Protocol(
    faces=("+z",), face_s=1.0, turn_rate_min=30.0 * DPS, turn_rate_max=90.0 * DPS, turn_rate_step=30.0 * DPS, axes=("z",),
    dwell_s=2.0, bracket_s=1.0,
)  # fmt: skip
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
        code, out, err = Command(
            simulated_run(protocol, path, "--resume", "--json"), tmp_path, killed_at=killed_at
        ).result()
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
            card.server._answer = lambda command: None
            died.append(bench.now())
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, LinkError)):
        run(bench, tmp_path, report=die, rig=lambda: driven(card, reply_timeout_s=0.01))
    assert bench.clock.until(lambda: bench.turn_rate() == 0.0, 10.0, 0.1)
    limit_s = 1.1 * SHORT.dwell_s + 2.0 + 3.0  # with its spare time, and the ramps
    show(f"{controller.__name__}, {phase}: at rest after s", round(bench.now() - died[0], 2), limit_s)
    assert bench.now() - died[0] < limit_s
    bench.clock.wait(60.0)
    assert bench.turn_rate() == 0.0


# ---- Processes that drive a card over a socket.


@pytest.fixture(scope="module")
def bench():
    """Return a bench that other processes drive; each test leaves it at rest."""
    with BenchOnHost(5.0) as bench:
        yield bench


@needs_signals
@pytest.mark.parametrize("way", ["SIGTERM", "SIGTSTP", "rig stop"])
def test_a_signal_or_a_stop_ends_at_rest_with_what_was_done(bench, tmp_path, protocol, way):
    process = Command(bench.words(protocol, tmp_path / "run"), tmp_path)
    assert bench.turning()
    if way == "rig stop":
        stop_rig(bench.address)
    else:
        process.signal(getattr(signal, way))
    code, _, err = process.result()
    assert code == 130, err
    assert "stopped. No file was left incomplete" in err
    assert bench.at_rest()
    assert len(read_session(tmp_path / "run").records) >= 2


@needs_signals
def test_more_signals_during_the_end_change_neither_it_nor_the_exit_code(bench, tmp_path, protocol):
    process = Command(bench.words(protocol, tmp_path / "run"), tmp_path)
    assert bench.turning()
    while not process.ended:
        process.signal(signal.SIGINT)
        time.sleep(0.01)
    code, _, err = process.result()
    assert code == 130, err
    assert err.splitlines()[-1] == "undrift: stopped. No file was left incomplete."
    assert bench.at_rest()


@needs_signals
def test_after_kill_9_the_controller_ends_the_dwell_and_a_second_run_was_refused(bench, tmp_path, protocol):
    process = Command(bench.words(protocol, tmp_path / "run"), tmp_path)
    assert bench.turning()
    code, _, err = Command(bench.words(protocol, tmp_path / "other"), tmp_path).result()
    process.kill()
    assert (code, "in use by undrift rig run into" in err) == (3, True)
    assert not (tmp_path / "other").exists()
    assert bench.at_rest(motor_on=True)
    stop_rig(bench.address)
    assert bench.at_rest()


@pytest.mark.slow
def test_a_whole_run_over_sockets_reads_the_true_device(bench, tmp_path, protocol):
    code, _, err = Command(bench.words(protocol, tmp_path / "run"), tmp_path).result()
    assert code == 0, err
    assert_true(read_session(tmp_path / "run"))


# ---- Disks, and folders that are not what a resume needs.


@needs_signals
def test_a_file_that_may_not_grow_is_a_clear_error_in_a_process_of_its_own(tmp_path, protocol):
    process = Command(simulated_run(protocol, tmp_path / "run"), tmp_path, largest_file=6000)
    code, _, err = process.result()
    assert code == 2, err
    assert re.search("cannot write a dwell", err)


def test_a_full_disk_stops_the_table_and_says_what_to_do(tmp_path, monkeypatch):
    real = folder_file.write_parquet

    def full(record, path):
        real(record, path)
        if path.name == "0005.parquet":
            raise OSError(errno.ENOSPC, "No space left on device")

    bench = simulated()
    with monkeypatch.context() as patched:
        patched.setattr(folder_file, "write_parquet", full)
        with pytest.raises(InputError, match=r"No space left on device.*Free space"):
            run(bench, tmp_path / "run")
    assert at_rest(bench)
    assert [turn.axis for turn in read_session(tmp_path / "run").turns] == ["z", "z"]
    result, _ = run(bench, tmp_path / "run", resume=True)
    assert (result.added, len(result.pieces)) == (3, 7)
    assert os.listdir(tmp_path / "run" / "aside") == ["0005.parquet"]


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
        RunFolder(path, replace(SHORT, dwell_s=2.0), resume=True)
    with RunFolder(path, SHORT, resume=True) as folder:
        assert folder.head is not None
        with pytest.raises(InputError, match=r"began with rig 'simulated.*', got 'other'"):
            folder.begin(replace(folder.head, rig="other"))


def test_two_programs_never_write_into_one_folder(tmp_path, protocol):
    path = tmp_path / "run"
    with RunFolder(path, SHORT) as first:
        with pytest.raises(InputError, match="another run is writing"):
            RunFolder(path, SHORT, resume=True)
        code, _, err = Command(simulated_run(protocol, path), tmp_path).result()
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


@pytest.mark.parametrize(("gravity_m_s2", "written_down"), [(None, False), (9.81, True)])
def test_a_session_contains_gravity_only_if_it_was_set(gravity_m_s2, written_down):
    text = session_text(Head(protocol="p", rig="r", gravity_m_s2=gravity_m_s2), ())
    assert ("gravity_m_s2 = 9.81" in text) is written_down
    assert ("gravity" in text) is written_down


def test_a_folder_without_dwells_is_an_empty_folder(tmp_path):
    with RunFolder(tmp_path / "run", SHORT):
        pass
    result, _ = run(simulated(), tmp_path / "run")
    assert result.added == 7
