"""Damage sound inputs and read them: ``python -m tests.fuzz [-n 20000] [-j JOBS] [--seed 1] [--first 0] [--cuts] [WORD ...]``.

Every input is read in a worker with limits of memory (1 GB) and time; every tenth goes through `info` and `calibrate`, too. What is
read of a damaged recording is compared with the sound one (oracle.py). Printed is, for each input, how many were equal, refused,
read with a finding, and so on, and how many ended as they must not: SILENT, a crash, a hang, more than 1 GB, an error that is not
undrift's, a file half written. Those are kept in build/fuzz/ as NUMBER-NAME; the same number and seed make the same input.
A header that states something else for all rows, and that nothing in the file contradicts, is printed by itself. WORD selects
inputs by name; with --cuts every input is cut short instead, a small one at every point, a large one at some. The exit code is 1
where one ended as it must not. A run that SIGTERM or Ctrl-C ends prints what it has, and where --first would go on.
"""

import argparse
import multiprocessing as mp
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from fuzz.inputs import BAD, Outcome, Seed, cut, cut_points, damaged, limit_memory, outcome, seeds
from fuzz.oracle import KINDS

HERE = Path(__file__).parent
KEPT = Path("build", "fuzz")


COMMANDS = 10  # of so many inputs one goes through the commands as well


@dataclass(frozen=True)
class Plan:
    """Which input a number stands for."""

    held: list[Seed]
    start: int
    cuts: list[tuple[int, int]]  # input and point; none where inputs are damaged at random

    def seed_of(self, number: int) -> Seed:
        """Return the sound input of a number."""
        return self.held[self.cuts[number][0] if self.cuts else number % len(self.held)]

    def content_of(self, number: int) -> bytes:
        """Return the damaged input of a number."""
        seed = self.seed_of(number)
        if self.cuts:
            return cut(seed.content, self.cuts[number][1])
        return damaged(seed.content, random.Random(f"{self.start} {number} {seed.name}"))


def work(plan: Plan, todo: "mp.Queue[int]", done: "mp.Queue[tuple[int, int, Outcome | None]]") -> None:
    """Read inputs until there are none; say which one begins before it does."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the main process ends this one
    limit_memory(1.0)
    while (number := todo.get()) >= 0:
        done.put((os.getpid(), number, None))
        folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
        commands = number // len(plan.held) % COMMANDS == 0 and not plan.cuts
        found = outcome(plan.seed_of(number), plan.content_of(number), folder, commands=commands)
        shutil.rmtree(folder)
        done.put((os.getpid(), number, found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*")
    parser.add_argument("-n", "--inputs", type=int, default=20_000)
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--limit-s", type=float, default=60.0)
    parser.add_argument("--cuts", action="store_true", help="cut inputs short")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    held = [seed for seed in seeds() if not given.words or any(word in seed.name for word in given.words)]
    points = [(k, at) for k, seed in enumerate(held) for at in cut_points(seed.content)] if given.cuts else []
    plan = Plan(held, given.seed, points)
    given.inputs = len(points) if given.cuts else given.inputs
    for seed in held:  # once, before there are workers
        if seed.sound is not None:
            _ = seed.sound.place if seed.sound.is_text else seed.sound.anchors
    todo: mp.Queue[int] = mp.Queue()
    done: mp.Queue[tuple[int, int, Outcome | None]] = mp.Queue()
    for number in [*range(given.first, given.first + given.inputs), *[-1] * given.jobs]:
        todo.put(number)

    def started() -> mp.Process:
        worker = mp.Process(target=work, args=(plan, todo, done))
        worker.start()
        return worker

    workers = [started() for _ in range(given.jobs)]
    counts: dict[str, Counter[str]] = {seed.name: Counter() for seed in held}
    open_: dict[int, tuple[int, float]] = {}
    finished, shown = 0, time.monotonic()

    def count(number: int, found: Outcome) -> None:
        nonlocal finished
        finished += 1
        name = plan.seed_of(number).name
        counts[name][found.kind] += 1
        if found.kind in BAD:
            KEPT.mkdir(parents=True, exist_ok=True)
            (KEPT / f"{number}-{name}").write_bytes(plan.content_of(number))
            print(f"{found.kind}: {KEPT / f'{number}-{name}'}: {found.text[:300]}", flush=True)
        elif found.kind == "header value":
            print(f"{found.kind}: {number}-{name}: {found.text[:200]}", flush=True)

    try:
        while finished < given.inputs:
            try:
                worker_id, number, found = done.get(timeout=1.0)
            except Exception:  # noqa: BLE001 - nothing within a second
                found = None
            else:
                if found is None:
                    open_[worker_id] = (number, time.monotonic())
                else:
                    open_.pop(worker_id, None)
                    count(number, found)
            for k, worker in enumerate(workers):
                begun = open_.get(worker.pid or 0)
                if begun is None:
                    continue
                late = time.monotonic() - begun[1] > given.limit_s
                if (late or not worker.is_alive()) and done.empty():
                    worker.kill()
                    worker.join()
                    del open_[worker.pid or 0]
                    count(begun[0], Outcome("hang" if late else "crash", f"exit code {worker.exitcode}"))
                    workers[k] = started()
            if time.monotonic() - shown > 10.0:
                shown = time.monotonic()
                print(f"{finished} of {given.inputs}", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        todo.cancel_join_thread()
        print(f"ended early: --first {given.first + finished} -n {given.inputs - finished} goes on", flush=True)
        for worker in workers:
            worker.kill()
    for worker in workers:
        worker.join()
    kinds = ("read", *KINDS, *(kind for kind in BAD if kind not in KINDS))
    print(f"{'input':44}" + "".join(f"{kind:>13}" for kind in kinds))
    total: Counter[str] = Counter()
    for name, found in counts.items():
        total += found
        print(f"{name[:43]:44}" + "".join(f"{found[kind]:13}" for kind in kinds))
    print(f"{'all, ' + str(finished):44}" + "".join(f"{total[kind]:13}" for kind in kinds))
    return 1 if finished < given.inputs or any(total[kind] for kind in BAD) else 0


if __name__ == "__main__":
    sys.exit(main())
