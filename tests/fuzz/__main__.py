"""Damage sound inputs and read them: ``python -m tests.fuzz [-n 20000] [-j JOBS] [--seed 1] [--first 0] [--cuts] [WORD ...]``.

Every input is read in a process with limits of memory (1 GB) and time; every tenth goes through `info` and `calibrate` too. What is
read of a damaged recording is compared with the sound one (oracle.py). Printed is, for each input, how many were equal, refused,
read with a finding, and so on, and how many ended as they must not: SILENT, a crash, a hang, more than 1 GB, an error that is not
undrift's, a file half written. Those are kept in build/fuzz/ as NUMBER-NAME; the same number and seed make the same input.
A header that states something else for all rows, and that nothing in the file contradicts, is printed by itself. WORD selects
inputs by name; with --cuts every input is cut short instead, a small one at every point, a large one at some. The exit code is 1
if one ended as it must not. A run that Ctrl-C ends prints what it has, and where --first would go on.
"""

import argparse
import multiprocessing as mp
import os
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from undrift.errors import FileFormatError, InputError
from undrift.io import libraries, mocap
from undrift.io.isolated import LIMIT_S

sys.path.insert(0, str(Path(__file__).parents[1]))
from fuzz.inputs import BAD, Outcome, Seed, cut, cut_points, damaged, limit_memory, outcome, seeds
from fuzz.oracle import KINDS

KEPT = Path("build", "fuzz")
COMMANDS = 10  # of so many inputs one goes through the commands as well
LIBRARIES = [
    "actfast",
    "ezc3d",
    "nilspodlib",
    "pyarrow.csv",
    "pyarrow.parquet",
    "pymatreader",
    "pyulog",
    "pyxdf",
    "rosbags.highlevel",
]
FORK = mp.get_context("fork")  # the inputs are prepared once, before there are workers


@dataclass(frozen=True)
class Plan:
    """Which input a number stands for."""

    inputs: list[Seed]
    start: int
    cuts: list[tuple[int, int]]  # input and point; empty if inputs are damaged at random

    def seed_of(self, number: int) -> Seed:
        return self.inputs[self.cuts[number][0] if self.cuts else number % len(self.inputs)]

    def content_of(self, number: int) -> bytes:
        seed = self.seed_of(number)
        if self.cuts:
            return cut(seed.content, self.cuts[number][1])
        return damaged(seed.content, random.Random(f"{self.start} {number} {seed.name}"))


PLANS: list[Plan] = []  # the one of this run; workers inherit it


def in_fork(work: Callable[[], Any], limit_s: float) -> Any:
    """Return what a call returns in a process of its own. Raises TimeoutError if it hangs, and EOFError if it crashes."""
    near, far = FORK.Pipe(duplex=False)
    process = FORK.Process(target=lambda: far.send(work()))
    process.start()
    far.close()
    try:
        if not near.poll(limit_s):
            raise TimeoutError(f"no end within {limit_s:g} s")
        return near.recv()
    finally:
        process.kill()
        process.join()


def parsed_in_fork(parse: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """Stand in for undrift.io.isolated: a fork in place of a new process that imports everything again."""

    def parsed() -> Any:
        try:
            return parse(path, *arguments)
        except InputError as error:
            return error

    try:
        found = in_fork(parsed, LIMIT_S)
    except (TimeoutError, EOFError) as error:
        raise FileFormatError(f"{path}: the parser did not finish, or crashed.") from error
    if isinstance(found, InputError):
        raise found
    return found


def read_one(number: int) -> Outcome:
    """Return what became of an input, in a process of its own."""
    plan = PLANS[0]
    limit_memory(1.0)
    libraries.isolated = mocap.isolated = parsed_in_fork  # type: ignore[attr-defined]
    commands = number // len(plan.inputs) % COMMANDS == 0 and not plan.cuts
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        return outcome(plan.seed_of(number), plan.content_of(number), Path(folder), commands=commands)


def guarded(number: int, limit_s: float) -> Outcome:
    """Return what became of an input, also if its process crashes or hangs."""
    try:
        found: Outcome = in_fork(partial(read_one, number), limit_s)
    except TimeoutError as error:
        return Outcome("hang", str(error))
    except EOFError:
        return Outcome("crash", "the process ended without an answer")
    return found


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
    inputs = [seed for seed in seeds() if not given.words or any(word in seed.name for word in given.words)]
    cuts = [(k, at) for k, seed in enumerate(inputs) for at in cut_points(seed.content)] if given.cuts else []
    plan = Plan(inputs, given.seed, cuts)
    PLANS.append(plan)
    # once, before there are workers
    for name in LIBRARIES:
        import_module(name)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        outcome(inputs[0], inputs[0].content, Path(folder), commands=True)
    for seed in inputs:
        if seed.sound is not None and seed.sound.is_text:
            _ = seed.sound.place
    numbers = range(len(cuts)) if cuts else range(given.first, given.first + given.inputs)
    counts: dict[str, Counter[str]] = {seed.name: Counter() for seed in inputs}
    finished = 0
    with ProcessPoolExecutor(given.jobs, mp_context=FORK) as pool:
        try:
            for number, found in zip(numbers, pool.map(partial(guarded, limit_s=given.limit_s), numbers), strict=True):
                finished += 1
                name = plan.seed_of(number).name
                counts[name][found.kind] += 1
                if found.kind in BAD:
                    KEPT.mkdir(parents=True, exist_ok=True)
                    (KEPT / f"{number}-{name}").write_bytes(plan.content_of(number))
                if found.kind in BAD or found.kind == "header value":
                    print(f"{found.kind}: {number}-{name}: {found.text[:300]}", flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            print(f"ended early: --first {numbers[0] + finished} -n {len(numbers) - finished} goes on", flush=True)
    kinds = ("read", *KINDS, *(kind for kind in BAD if kind not in KINDS))
    print(f"{'input':44}" + "".join(f"{kind:>13}" for kind in kinds))
    total: Counter[str] = Counter()
    for name, found_kinds in counts.items():
        total += found_kinds
        print(f"{name[:43]:44}" + "".join(f"{found_kinds[kind]:13}" for kind in kinds))
    print(f"{'all, ' + str(finished):44}" + "".join(f"{total[kind]:13}" for kind in kinds))
    return 1 if finished < len(numbers) or any(total[kind] for kind in BAD) else 0


if __name__ == "__main__":
    sys.exit(main())
