"""Pools of processes for the suite: two that compute, some that wait, some with a browser; each takes what is longest first.

A process says by the environment which pool it is of: ``pytest --dist loadscope --tx 2*popen//env:TEST_POOL=compute ...``, as the
Makefile does. Without, every process is of one pool. Modules of ``FOLDERS`` and those marked ``waits`` at their heads sleep or wait
for sockets most of the time, so that more of them than the machine has cores may run; those in a browser keep it open. All run at
once: processes that compute take what the others leave of the processor, or emulated machines and pages would answer late.

What is handed out is a module, whose tests share fixtures, or a single test that takes ``ALONE_S`` or more of itself.
tests/durations.json has what each took; `make durations` writes it anew. Order is all that hangs on it.

tests/long.json lists the tests that `make test-long` runs and `make test` does not, each with its processor seconds: whole ways and
large sizes of what smaller tests show too. `make mutants` has to catch all its faults by what is not listed.
"""

import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler.loadscope import LoadScopeScheduling
from xdist.workermanage import WorkerController

POOL = "TEST_POOL"
TESTS = Path(__file__).parents[1]
DURATIONS = TESTS / "durations.json"
LONG = TESTS / "long.json"
ALONE_S = 4.0
FOLDERS = {"rig": "wait", "bench": "wait", "web": "wait", "live": "wait", "web_browser": "browser"}


def pool_of(path: Path) -> str:
    """Return the pool of a module of tests."""
    if path.parent.name in FOLDERS:
        return FOLDERS[path.parent.name]
    return "wait" if "pytestmark = pytest.mark.waits" in path.read_text() else "compute"


def take_what_is_left() -> None:
    """Let this process, where it is one that computes, run on what all others leave of the processor; Linux alone knows how."""
    if os.environ.get(POOL) == "compute" and hasattr(os, "SCHED_IDLE"):
        with suppress(OSError):  # a container may forbid it
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def of_another_pool(path: Path) -> bool:
    """Whether a module is not for this process."""
    own = os.environ.get(POOL)
    return own is not None and path.name.startswith("test_") and path.suffix == ".py" and pool_of(path) != own


def mark_long(items: Iterable[pytest.Item]) -> None:
    """Mark as ``long`` the tests that LONG lists."""
    listed = json.loads(LONG.read_text())
    for item in items:
        if item.nodeid in listed:
            item.add_marker("long")


def read_durations(path: Path = DURATIONS) -> dict[str, float]:
    """Return seconds by test, and by module for its fixtures and its short tests together."""
    durations: dict[str, float] = json.loads(path.read_text())
    return durations


def write_durations(reports: Iterable[pytest.TestReport], path: Path = DURATIONS) -> None:
    """Write what a run took: tests that are handed out alone, and what is left of each module."""
    taken: dict[str, float] = {}
    for report in reports:
        module = report.nodeid.partition("::")[0]
        alone = report.when == "call" and report.duration >= ALONE_S
        name = report.nodeid if alone else module
        taken[name] = taken.get(name, 0.0) + report.duration
    rows = {name: round(seconds, 1) for name, seconds in sorted(taken.items()) if seconds >= 1.0}
    path.write_text(json.dumps(rows, indent=1) + "\n")


class Pools(LoadScopeScheduling):
    """Give each process what its pool has left, what takes longest first."""

    def __init__(self, config: pytest.Config, log: Any = None) -> None:
        super().__init__(config, log)
        self.durations = read_durations()
        self._collected: dict[WorkerController, set[str]] = {}

    def _split_scope(self, nodeid: str) -> str:
        return nodeid if nodeid in self.durations else nodeid.partition("::")[0]

    def add_node_collection(self, node: WorkerController, collection: Sequence[str]) -> None:
        """Take what a process has collected: the tests of its pool."""
        self.registered_collections[node] = list(collection)
        self._collected[node] = set(collection)

    def schedule(self) -> None:
        """Give each process its first two pieces of work: it begins with one when it knows the next."""
        if self.collection is None:
            self.collection = list(dict.fromkeys(chain.from_iterable(self.registered_collections.values())))
            pieces: dict[str, dict[str, bool]] = {}
            for test in self.collection:
                pieces.setdefault(self._split_scope(test), {})[test] = False
            for piece in sorted(pieces, key=lambda piece: -self.durations.get(piece, 0.0)):
                self.workqueue[piece] = pieces[piece]
            self.config.pluginmanager.get_plugin("dsession")._session.testscollected = len(self.collection)
        for node in self.nodes * 2:
            self._reschedule(node)

    def remove_node(self, node: WorkerController) -> str | None:
        """Forget a process; return the test in which it crashed, which is not run again, and hand out what else it had."""
        rest = {piece: tests for piece, tests in self.assigned_work.pop(node).items() if not all(tests.values())}
        if not rest:
            return None
        piece = next(iter(rest))
        crashed = next(test for test, done in rest[piece].items() if not done)
        rest[piece][crashed] = True
        self.workqueue.update({piece: tests for piece, tests in rest.items() if not all(tests.values())})
        for other in self.nodes:
            self._reschedule(other)
        return crashed

    def _reschedule(self, node: WorkerController) -> None:
        if node.shutting_down:
            return
        tests = self._collected.get(node, set())
        piece = next((piece for piece, held in self.workqueue.items() if not tests.isdisjoint(held)), None)
        if piece is None:
            node.shutdown()
        elif self._pending_of(self.assigned_work[node]) <= 2:
            self.workqueue.move_to_end(piece, last=False)
            self._assign_work_unit(node)
