"""Damage sound inputs and read them: ``python -m tests.fuzz [-n 20000] [-j JOBS] [--seed 1] [WORD ...]`` from the project's root.

Every input is read in a worker with limits of memory (1 GB) and time. Printed is, for each kind of input, how many were read and
refused, and how many ended as they must not: a crash, a hang, more than 1 GB, an error that is not undrift's, a file half written.
Those are kept in build/fuzz/ as NAME-NUMBER; the same number and seed make the same input. WORD selects inputs by name.
The exit code is 1 where there is one.
"""

import argparse
import multiprocessing as mp
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from fuzz.inputs import BAD, Outcome, Seed, damaged, limit_memory, outcome, seeds

HERE = Path(__file__).parent
KEPT = Path("build", "fuzz")


def content_of(seed: Seed, number: int, start: int) -> bytes:
    """Return the input of a number."""
    return damaged(seed.content, random.Random(f"{start} {number} {seed.name}"))


def work(
    held: list[Seed], start: int, todo: "mp.Queue[int]", done: "mp.Queue[tuple[int, int, Outcome | None]]"
) -> None:
    """Read inputs until there are none; say which one begins before it does."""
    limit_memory(1.0)
    while (number := todo.get()) >= 0:
        done.put((os.getpid(), number, None))
        seed = held[number % len(held)]
        folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
        found = outcome(seed, content_of(seed, number, start), folder)
        shutil.rmtree(folder)
        done.put((os.getpid(), number, found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*")
    parser.add_argument("-n", "--inputs", type=int, default=20_000)
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-s", type=float, default=60.0)
    given = parser.parse_args()
    held = [seed for seed in seeds() if not given.words or any(word in seed.name for word in given.words)]
    todo: mp.Queue[int] = mp.Queue()
    done: mp.Queue[tuple[int, int, Outcome | None]] = mp.Queue()
    for number in [*range(given.inputs), *[-1] * given.jobs]:
        todo.put(number)

    def started() -> mp.Process:
        worker = mp.Process(target=work, args=(held, given.seed, todo, done))
        worker.start()
        return worker

    workers = [started() for _ in range(given.jobs)]
    counts: dict[str, Counter[str]] = {seed.name: Counter() for seed in held}
    open_: dict[int, tuple[int, float]] = {}
    finished, shown = 0, time.monotonic()

    def count(number: int, found: Outcome) -> None:
        nonlocal finished
        finished += 1
        seed = held[number % len(held)]
        counts[seed.name][found.kind] += 1
        if found.kind in BAD:
            KEPT.mkdir(parents=True, exist_ok=True)
            (KEPT / f"{number}-{seed.name}").write_bytes(content_of(seed, number, given.seed))
            print(f"{found.kind}: {KEPT / f'{number}-{seed.name}'}: {found.text[:300]}", flush=True)

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
    for worker in workers:
        worker.join()
    kinds = ("read", "refused", *BAD)
    print(f"{'input':44}" + "".join(f"{kind:>13}" for kind in kinds))
    total: Counter[str] = Counter()
    for name, found in counts.items():
        total += found
        print(f"{name[:43]:44}" + "".join(f"{found[kind]:13}" for kind in kinds))
    print(f"{'all, ' + str(finished):44}" + "".join(f"{total[kind]:13}" for kind in kinds))
    return 1 if any(total[kind] for kind in BAD) else 0


if __name__ == "__main__":
    sys.exit(main())
