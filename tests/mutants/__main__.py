"""Plant faults in a copy of the source, one at a time, and print those that the nearest tests do not notice.

    python -m tests.mutants [-j JOBS] [--limit-s SECONDS] [WORD ...]     from the root of the project; WORD selects by file or name

faults.toml lists them: file, old text (once in that file), new text, tests. A fault is caught if these tests fail or take more
processor time than the limit. Every set of tests has to pass on the untouched copy first. The exit code is 1 if a fault survives or
cannot be planted. Kernels run without the compiler.
"""

import argparse
import os
import queue
import resource
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
PASSED, FAILED = 0, 1  # exit codes of pytest; any other is no verdict on the fault
SIGNALS = {-24: "caught (time limit)", -9: "caught (time limit)"}  # SIGXCPU, and SIGKILL one second later


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One change of the source that a test has to notice."""

    name: str
    file: str  # below src/undrift
    old: str
    new: str
    tests: list[str]  # below tests


def run(source: Path, tests: list[str], *, compiled: bool, limit_s: float) -> int:
    """Run tests against a copy of the source and return the exit code of pytest."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *(f"tests/{name}" for name in tests)]
    environment = {**os.environ, "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
    limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (round(limit_s), round(limit_s) + 1))
    return subprocess.run(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=limit,
        check=False,
    ).returncode


def write(path: Path, text: str) -> None:
    """Write a file of the copy and forget its bytecode, which equal times and sizes would keep."""
    path.write_text(text)
    for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        stale.unlink()


def judge(fault: Fault, source: Path, limit_s: float) -> str:
    """Plant one fault, run its tests and take it out again; return caught, survived, or why there is no verdict."""
    path = source / "undrift" / fault.file
    text = path.read_text()
    if text.count(fault.old) != 1:
        return f"cannot be planted: the old text is there {text.count(fault.old)} times"
    write(path, text.replace(fault.old, fault.new))
    try:
        code = run(source, fault.tests, compiled=not fault.file.startswith("kernels/"), limit_s=limit_s)
    finally:
        write(path, text)
    return {PASSED: "survived", FAILED: "caught", **SIGNALS}.get(code, f"cannot be judged: pytest ended with {code}")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--limit-s", type=float, default=120.0)
    given = parser.parse_args()
    faults = [Fault(**row) for row in tomllib.loads((HERE / "faults.toml").read_text())["fault"]]
    faults = [
        fault for fault in faults if not given.words or any(w in f"{fault.file} {fault.name}" for w in given.words)
    ]
    sources: queue.SimpleQueue[Path] = queue.SimpleQueue()

    def check(tests: tuple[str, ...], *, compiled: bool) -> str:
        source = sources.get()
        code = run(source, list(tests), compiled=compiled, limit_s=5.0 * given.limit_s)
        sources.put(source)
        return "" if code == PASSED else f"tests do not pass on the untouched copy ({code}): {' '.join(tests)}"

    def plant(fault: Fault) -> str:
        source = sources.get()
        outcome = judge(fault, source, given.limit_s)
        sources.put(source)
        return outcome

    with tempfile.TemporaryDirectory(prefix="undrift-mutants-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        for number in range(given.jobs):
            sources.put(shutil.copytree(ROOT / "src", Path(folder, str(number), "src")))
        sets = {(tuple(fault.tests), not fault.file.startswith("kernels/")) for fault in faults}
        refused = [text for text in pool.map(lambda item: check(item[0], compiled=item[1]), sorted(sets)) if text]
        if refused:
            print("\n".join(refused))
            return 2
        survivors = []
        for fault, outcome in zip(faults, pool.map(plant, faults), strict=True):
            print(f"{outcome:10} {fault.file}: {fault.name}", flush=True)
            survivors += [] if outcome.startswith("caught") else [f"  {fault.file}: {fault.name}: {outcome}"]
    print("\n".join((f"{len(faults) - len(survivors)} of {len(faults)} faults caught", *survivors)))
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
