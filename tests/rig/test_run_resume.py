"""What a run survives: kill -9, a full disk, half-written pieces; and what a resume refuses."""

import errno
import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.emulated.emulator import EmulatedBench, EmulatedBenchSettings, EmulatorSettings
from testkit.emulated_axis import axis_rate
from testkit.rig_bench import SHORT, at_rest, emulated, run
from testkit.waiting import eventually
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.rig import folder as folder_file
from undrift.rig.folder import JOURNAL, RunFolder, read_journal
from undrift.rig.programme import Protocol, write_protocol
from undrift.units import RADIAN_PER_DEGREE as DPS

SPEED = 10.0
LONGEST_S = 3.0  # about as long as a run takes once its motor is on
LONGER = Protocol(
    faces=("+z",), face_s=1.0, turn_rate_min=30.0 * DPS, turn_rate_max=90.0 * DPS, turn_rate_step=30.0 * DPS, axes=("z",),
    dwell_s=2.0, bracket_s=1.0,
)  # fmt: skip
LIMIT_FILES = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000)); "


def words(bench, protocol, path, *more):
    addresses = ("--rig", bench.rig_address, "--device", bench.device_address)
    return bench.hands_address, ["rig", "run", str(protocol), *addresses, "-o", str(path), "--yes", *more]


def started(called, before=""):
    hands, calls = called
    mounted = (
        "import undrift.rig.manual as m; from testkit.emulated.emulator import BenchHands; "
        f"m.AskedOperator = lambda ask: BenchHands({hands!r}); "
    )
    code = before + mounted * bool(hands) + f"from undrift.cli.app import main; main({calls!r})"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def killed_at_random(bench, folder, protocol, kills, rng, tell=lambda line: None):
    """Kill runs with kill -9 and resume them, in a new folder when one is complete; return what was counted."""
    counted = {
        "kills": 0,
        "at rest": 0,
        "dwells kept": 0,
        "dwells lost": 0,
        "folders complete": 0,
        "silently different": 0,
    }
    started(words(bench, protocol, folder / "whole")).communicate(timeout=240.0)
    whole_run = dwells_of(folder / "whole")
    held: dict[str, str] = {}  # pieces on the disk: name -> sha256
    path = folder / "run1"
    while counted["kills"] < kills or held:
        last = counted["kills"] >= kills  # finish what is begun
        process = started(words(bench, protocol, path, "--resume", "--json"))
        if not last:
            turns = rng.random() < 0.8  # else it is struck while it starts, or mounts
            begun = (lambda: abs(axis_rate(bench.rig)) > 10.0 * DPS) if turns else (path / JOURNAL).exists
            eventually(lambda: begun() or process.poll() is not None, "it begins", within_s=240.0)  # noqa: B023
            time.sleep(rng.uniform(0.0, LONGEST_S if turns else 1.0))
        over = process.poll() is not None
        if not (over or last):
            process.kill()
        out, err = process.communicate(timeout=240.0)
        counted["at rest"] += ends_its_move(bench.rig)
        counted["kills"] += 1
        entries = read_journal(path / JOURNAL)[0]
        now = {entry["step"]: entry["sha256"] for entry in entries[1:]}
        for step, digest in held.items():
            whole = now.get(step) == digest == sha256_of(path / f"pieces/{step:04d}.parquet")
            counted["dwells lost"] += not whole
        counted["dwells kept"] += len(now) - len(held)
        if now:
            read = len(read_session(path).records)
            counted["dwells lost"] += read not in (len(now), len(now) - 1)  # one behind, if struck just then
        held = now
        if over or last:
            counted["kills"] -= 1  # it ended before
            assert process.returncode == 0, err
            assert json.loads(out)["dwells"] == 9
            session = read_session(path)
            assert (len(session.turns), len(session.stills)) == (6, 3)
            counted["silently different"] += not alike(dwells_of(path), whole_run)
            counted["folders complete"] += 1
            counted["at rest"] -= 1
            path, held = folder / f"run{counted['folders complete'] + 1}", {}
        tell(str(counted))
    return counted


def sha256_of(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def dwells_of(path):
    """Return axis or face of each dwell, its rate in deg/s, and the mean readings over it in counts."""
    session, found = read_session(path), []
    for part in (*session.stills, *session.turns):
        record = session.records[part.recording]
        means = [getattr(record, name)[part.start : part.stop].mean(axis=0) for name in ("gyro", "accel")]
        turn = hasattr(part, "turn_rate")
        found.append((part.axis if turn else part.face, part.turn_rate / DPS if turn else 0.0, means))
    return sorted(found, key=lambda dwell: (str(dwell[0]), dwell[1]))


def alike(one, other):
    """Compare dwells: the rate to 0.1 deg/s, mean readings to 3 and 6 counts: 0.2 deg/s and 1.5 mg, five times their noise."""
    return len(one) == len(other) and all(
        str(a[0]) == str(b[0]) and abs(a[1] - b[1]) < 0.1
        and all(np.abs(x - y).max() < limit for x, y, limit in zip(a[2], b[2], (3.0, 6.0), strict=True))
        for a, b in zip(one, other, strict=True)
    )  # fmt: skip


@pytest.mark.parametrize("kills", [3, pytest.param(60, marks=pytest.mark.slow)])
def test_kill_9_at_random_instants_leaves_a_table_at_rest_and_loses_nothing(tmp_path, kills):
    write_protocol(LONGER, tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        counted = killed_at_random(bench, tmp_path, tmp_path / "protocol.toml", kills, random.Random(5))
    show("kill -9 at random instants", counted)
    assert (counted["kills"], counted["at rest"], counted["dwells lost"], counted["silently different"]) == (
        kills,
        kills,
        0,
        0,
    )
    assert counted["folders complete"] >= 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGTSTP])
def test_ctrl_c_sigterm_and_ctrl_z_end_at_rest_with_what_was_done(tmp_path, number):
    write_protocol(LONGER, tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        process = started(words(bench, tmp_path / "protocol.toml", tmp_path / "run"))
        last = time.monotonic() + 120.0
        while len(read_journal(tmp_path / "run" / JOURNAL)[0]) < 4 and time.monotonic() < last:
            time.sleep(0.01)
        os.kill(process.pid, number)
        _, err = process.communicate(timeout=120.0)
        assert process.returncode == 130
        assert "stopped; nothing was left half written" in err
        assert at_rest(bench.rig)
    assert len(read_session(tmp_path / "run").records) >= 3


def test_more_signals_during_the_end_change_neither_it_nor_the_exit_code(tmp_path):
    write_protocol(LONGER, tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        process = started(words(bench, tmp_path / "protocol.toml", tmp_path / "run"))
        turning(bench.rig)
        last = time.monotonic() + 120.0
        while process.poll() is None and time.monotonic() < last:
            process.send_signal(signal.SIGINT)
            time.sleep(0.01)
        _, err = process.communicate(timeout=120.0)
        assert process.returncode == 130, err
        assert err.splitlines()[-1] == "undrift: stopped; nothing was left half written"
        assert not bench.rig.motor_on


def test_after_kill_9_the_controller_ends_the_dwell_and_a_resume_is_complete(tmp_path):
    write_protocol(replace(LONGER, dwell_s=20.0), tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        process = started(words(bench, tmp_path / "protocol.toml", tmp_path / "run"))
        turning(bench.rig)
        process.kill()
        killed_s = bench.rig.now()
        process.communicate(timeout=60.0)
        assert ends_its_move(bench.rig)
        assert bench.rig.now() - killed_s < 20.0 * 1.1 + 2.0 * SPEED + 10.0  # the dwell, what is spare, a look later
        again = started(words(bench, tmp_path / "protocol.toml", tmp_path / "run", "--resume"))
        _, err = again.communicate(timeout=120.0)
        assert again.returncode == 0, err
        assert at_rest(bench.rig)
    assert len(read_session(tmp_path / "run").turns) == 6


def ends_its_move(rig, within_s=60.0):
    """Wait until the axis is at rest, with its motor on or off; False when it never is."""
    return rig.clock.host.until(lambda: abs(axis_rate(rig)) <= 2e-3, within_s, 0.005)


def turning(rig):
    last = time.monotonic() + 120.0
    while abs(axis_rate(rig)) < 10.0 * DPS:
        assert time.monotonic() < last, "it never turned"
        time.sleep(0.005)


def test_a_full_disk_stops_the_table_and_says_what_to_do(tmp_path, monkeypatch):
    real = folder_file.synchronise

    def full(path):
        if path.name == "0005.parquet":
            raise OSError(errno.ENOSPC, "No space left on device")
        real(path)

    with emulated() as emulator:
        with monkeypatch.context() as patched:
            patched.setattr(folder_file, "synchronise", full)
            with pytest.raises(
                InputError, match=r"No space left on device.*make room on the disk and continue with `resume`"
            ):
                run(emulator, tmp_path / "run")
        assert at_rest(emulator)
        assert [turn.axis for turn in read_session(tmp_path / "run").turns] == ["z", "z"]
        result, _ = run(emulator, tmp_path / "run", resume=True)
        assert (result.added, len(result.pieces)) == (3, 7)
        assert os.listdir(tmp_path / "run" / "aside") == ["0005.parquet"]


def test_a_file_that_may_not_grow_is_a_clear_error_in_a_process_of_its_own(tmp_path):
    write_protocol(LONGER, tmp_path / "protocol.toml")
    with EmulatedBench(EmulatedBenchSettings(rig=EmulatorSettings(speed=SPEED))) as bench:
        process = started(words(bench, tmp_path / "protocol.toml", tmp_path / "run"), LIMIT_FILES)
        _, err = process.communicate(timeout=120.0)
        assert process.returncode == 2
        assert re.search("wanted to write a dwell, got .*; all dwells before it are kept", err)
        assert at_rest(bench.rig)


def test_half_written_pieces_are_put_aside_and_whole_ones_checked(tmp_path):
    path = tmp_path / "run"
    with emulated() as emulator:
        run(emulator, path)
    (path / "pieces" / "0099.parquet.part").write_bytes(b"PAR1 half")
    (path / "pieces" / "0098.parquet").write_bytes(b"PAR1 half")
    with RunFolder(path, SHORT, resume=True) as folder:
        assert sorted(os.listdir(path / "aside")) == ["0098.parquet", "0099.parquet.part"]
        assert len(folder.done) == 7
    name = path / folder.pieces[0].name
    name.write_bytes(name.read_bytes()[:-1])
    with pytest.raises(
        InputError, match="wanted the readings of step 1 as they were written, got them missing or changed"
    ):
        RunFolder(path, SHORT, resume=True)


def test_another_run_is_not_mixed_in(tmp_path):
    path = tmp_path / "run"
    with emulated() as emulator:
        run(emulator, path)
        with pytest.raises(
            InputError, match="wanted an empty folder, got one with a run in it; continue it with `resume`"
        ):
            RunFolder(path, SHORT)
        with pytest.raises(InputError, match="wanted the protocol that the run began with, got another"):
            RunFolder(path, replace(SHORT, dwell_s=2.0), resume=True)
        with RunFolder(path, SHORT, resume=True) as folder:
            assert folder.head is not None
            with pytest.raises(InputError, match=r"wanted the rig that the run began with, 'DMC.*', got 'other'"):
                folder.begin(replace(folder.head, rig="other"))


def test_a_line_of_the_journal_that_is_lost_is_a_dwell_done_again(tmp_path):
    path = tmp_path / "run"
    with emulated() as emulator:
        run(emulator, path)
        data = (path / JOURNAL).read_bytes()
        (path / JOURNAL).write_bytes(data[:-20])
        result, hands = run(emulator, path, resume=True)
    assert result.added == 1
    assert hands.mounted == ["+z"]
    assert len(read_session(path).records) == 7


def test_two_programs_never_write_into_one_folder(tmp_path):
    path = tmp_path / "run"
    with emulated() as emulator, RunFolder(path, SHORT) as first:
        for resume in (False, True):
            with pytest.raises(
                InputError, match="wanted a folder that no other program writes to, got one where a run"
            ):
                RunFolder(path, SHORT, resume=resume)
        process = started(
            ("", ["rig", "run", "none"]),
            f"from pathlib import Path; from undrift.rig.folder import Journal; Journal(Path({str(path / JOURNAL)!r})); ",
        )
        assert "no other program writes to" in process.communicate(timeout=120.0)[1]
    assert first.pieces == ()
    with emulated() as emulator:
        result, _ = run(emulator, path)
        assert result.added == 7


def test_readings_of_a_step_are_never_written_over(tmp_path):
    with emulated() as emulator:
        (tmp_path / "run" / "pieces").mkdir(parents=True)
        strange = tmp_path / "run" / "pieces" / "0005.parquet"

        def drop_in(progress):
            if progress.number == 5:
                strange.write_bytes(b"of another program")

        with pytest.raises(
            InputError, match=r"0005\.parquet: wanted no readings of this step yet, got some, which are kept"
        ):
            run(emulator, tmp_path / "run", report=drop_in)
        assert at_rest(emulator)
    assert strange.read_bytes() == b"of another program"


def test_readings_without_their_journal_are_refused_and_an_empty_journal_is_an_empty_folder(tmp_path):
    path = tmp_path / "run"
    with RunFolder(path, SHORT):
        pass
    with emulated() as emulator:
        run(emulator, path)
    (path / JOURNAL).write_bytes(b"")
    for resume in (False, True):
        with pytest.raises(
            InputError, match=r"wanted journal.jsonl with the readings in pieces, got it empty or missing"
        ):
            RunFolder(path, SHORT, resume=resume)
    assert len(os.listdir(path / "pieces")) == 7
