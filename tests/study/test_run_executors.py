"""Executors with real worker processes: one is killed in the middle, a client is killed, and the bits are the same."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import UndriftError
from undrift.study.case import run_unit, units_of
from undrift.study.plan import Study, read_study
from undrift.study.run import MOST_LOSSES, Dask, InProcess, Pool, run_study

TEXT = """
[study]
subjects = 4
[[task]]
name = "sit_to_stand"
[task.space]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [5.0, 10.0]
turn_rate_min_dps = [5.0, 10.0]
turn_rate_max_dps = [50.0, 60.0, 70.0, 80.0, 90.0]
[task.protocol]
dwell_s = 1.0
bracket_s = 3.0
"""
# the command, which stands still at the third subject until it is killed
CLIENT = """
import sys, time
from pathlib import Path
from undrift.cli.app import main
from undrift.study import run

folder, work = Path(sys.argv[4]), run.run_units

def stands(units):
    if len(list(folder.glob("runs/*.parquet"))) == 4:
        (folder / "stands").touch()
        time.sleep(3600.0)
    return work(units)

run.run_units = stands
main(sys.argv[1:])
"""
LONG_S = 300.0  # a machine that is busy takes its time; nothing takes so long


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "study.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def study(plan: Path) -> Study:
    return read_study(plan)


@pytest.fixture(scope="module")
def expected(study: Study, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    return run_study(study, InProcess(), tmp_path_factory.mktemp("one"))[0].error_rms_deg


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes under nannies, each with one thread; nothing listens to the outside."""
    import distributed

    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        silence_logs=50,
    ) as made:
        yield made


class KillsOne:
    """An executor that kills one of its worker processes after the first result."""

    def __init__(self, held: Any, victims: Any) -> None:
        self.held, self.victims, self.killed = held, victims, 0
        self.workers = 2

    def run(self, work: Any, units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for place, result in self.held.run(work, units):
            if not self.killed:
                self.killed = self.victims()
                os.kill(self.killed, signal.SIGKILL)
            yield place, result


def own_worker() -> int:
    """Return a worker process of this process's pool."""
    import multiprocessing

    return next(p.pid for p in multiprocessing.active_children() if p.pid and p.is_alive())


def wait_for(event: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LONG_S
    while not event():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.02)


def dies(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def sleeps(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


@pytest.mark.slow
def test_a_unit_of_work_is_worth_sending(study: Study) -> None:
    import pickle

    unit = units_of(study)[0]
    run_unit(unit)
    worked, sent = [], []
    for _ in range(3):
        start = time.perf_counter()
        found = run_unit(unit)
        worked.append(time.perf_counter() - start)
        start = time.perf_counter()
        pickle.loads(pickle.dumps((unit, found)))
        sent.append(time.perf_counter() - start)
    show("a unit of work over packing and unpacking it", min(worked) / min(sent), "some 1000; >= 20")
    assert min(worked) >= 20.0 * min(sent)  # of the same machine: the quickest of three is no pause of its scheduler


@pytest.mark.slow
def test_a_pool_whose_worker_is_killed_gives_the_same_bits(study: Study, expected: np.ndarray, tmp_path: Path) -> None:
    executor = KillsOne(Pool(2), own_worker)
    found = run_study(study, executor, tmp_path)
    assert executor.killed
    assert (found[0].error_rms_deg == expected).all()


def whose(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def test_the_process_that_asks_works_beside_the_others() -> None:
    done = dict(Pool(2).run(whose, [0.05] * 40))
    assert sorted(done) == list(range(40))
    show(
        "units of 40 done by the process that asks", sum(pid == os.getpid() for pid in done.values()), "told, not held"
    )
    assert len(set(done.values())) == 2
    assert done[39] == os.getpid()  # from the last on
    assert done[0] != os.getpid()


@pytest.mark.slow
def test_work_that_kills_its_workers_is_given_up() -> None:
    with pytest.raises(UndriftError, match=f"wanted workers that live, got {MOST_LOSSES + 1} losses"):
        list(Pool(1).run(dies, [0]))


@pytest.mark.slow
def test_dask_gives_the_same_bits_with_a_worker_killed_in_the_middle(
    study: Study, expected: np.ndarray, cluster: Any, tmp_path: Path
) -> None:
    executor = KillsOne(
        Dask(cluster.scheduler_address), lambda: next(iter(cluster.workers.values())).process.process.pid
    )
    found = run_study(study, executor, tmp_path)
    assert executor.killed
    assert (found[0].error_rms_deg == expected).all()


@pytest.mark.slow
def test_work_that_kills_the_workers_of_a_scheduler_is_given_up(cluster: Any) -> None:
    cluster.scheduler.allowed_failures = 0  # of the default four, so that the test need not wait for four new workers
    with pytest.raises(UndriftError, match="wanted workers that live, got 1 losses"):
        list(Dask(cluster.scheduler_address).run(dies, [0]))
    cluster.scheduler.allowed_failures = 3


def test_a_scheduler_that_goes_away_is_said(tmp_path: Path) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        silence_logs=50,
    ) as short:
        found = Dask(short.scheduler_address).run(sleeps, [0.01, 3600.0])
        assert next(found) == (0, 0.01)
    with pytest.raises(UndriftError, match=r"scheduler: wanted an answer from tcp://.*, got none any more"):
        list(found)


@pytest.mark.slow
def test_a_client_that_is_killed_loses_nothing_that_was_finished(
    plan: Path, study: Study, expected: np.ndarray, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, "study", str(plan), "-o", str(folder), "--workers", "1"],
        stdout=subprocess.DEVNULL,
    )
    try:
        wait_for(lambda: (folder / "stands").exists() or client.poll() is not None)
    finally:
        client.send_signal(signal.SIGKILL)
        client.wait()
    before = {path: path.stat().st_mtime_ns for path in folder.glob("runs/*.parquet")}
    assert len(before) == 4
    told: list[tuple[int, int]] = []
    found = run_study(study, InProcess(), folder, advance=lambda done, total: told.append((done, total)))
    assert told[0] == (len(before), len(units_of(study)))
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert (found[0].error_rms_deg == expected).all()
