"""Plant faults in a copy of the source, one at a time, and print those that the nearest tests do not notice.

    python -m tests.mutants [-j JOBS] [--limit-s SECONDS] [WORD ...]     from the root of the project; WORD selects by file or name

faults.toml lists them: file, old text (once in that file), new text, tests. A fault is caught where these tests fail or take longer
than the limit. Every set of tests has to pass on the untouched copy first. The exit code is 1 where a fault survives or cannot be
planted. Kernels are run without the compiler.
"""

import argparse
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
PASSED, FAILED = 0, 1  # exit codes of pytest; any other is no verdict on the fault


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One change of the source that a test has to notice."""

    name: str
    file: str  # below src/undrift
    old: str
    new: str
    tests: tuple[str, ...]  # below tests

    @property
    def without_compiler(self) -> bool:
        """Whether the fault is in code that numba compiles."""
        return self.file.startswith("kernels/")


def read_faults(words: Iterable[str] = ()) -> list[Fault]:
    """Read the table, or the faults whose file or name has one of the words."""
    rows = tomllib.loads((HERE / "faults.toml").read_text())["fault"]
    faults = [Fault(**{**row, "tests": tuple(row["tests"])}) for row in rows]
    return [one for one in faults if not words or any(word in f"{one.file} {one.name}" for word in words)]


def planted(fault: Fault, source: str) -> str | None:
    """Return the source with the fault, None where the old text is not in it exactly once."""
    return source.replace(fault.old, fault.new) if source.count(fault.old) == 1 else None


class Copy:
    """A copy of the source that faults are planted in."""

    def __init__(self, folder: Path) -> None:
        self.source = folder / "src"
        shutil.copytree(ROOT / "src", self.source, ignore=shutil.ignore_patterns("__pycache__"))

    def write(self, file: str, text: str) -> None:
        """Write one file and forget its bytecode, which equal times and sizes would keep."""
        path = self.source / "undrift" / file
        path.write_text(text)
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()

    def run(self, tests: tuple[str, ...], *, without_compiler: bool, limit_s: float) -> int | None:
        """Run tests against the copy and return the exit code of pytest, None beyond the limit."""
        names = [f"tests/{name}" for name in tests]
        command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *names]
        environment = {**os.environ, "PYTHONPATH": str(self.source), "OPENBLAS_NUM_THREADS": "1"}
        if without_compiler:
            environment["NUMBA_DISABLE_JIT"] = "1"
        with subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process:
            try:
                return process.wait(limit_s)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                return None


def tried(fault: Fault, copy: Copy, limit_s: float) -> str:
    """Plant one fault, run its tests and take it out again; return caught, survived, or why it is no trial."""
    source = (copy.source / "undrift" / fault.file).read_text()
    text = planted(fault, source)
    if text is None:
        return f"cannot be planted: the old text is there {source.count(fault.old)} times"
    copy.write(fault.file, text)
    try:
        code = copy.run(fault.tests, without_compiler=fault.without_compiler, limit_s=limit_s)
    finally:
        copy.write(fault.file, source)
    if code is None:
        return "caught (time limit)"
    return {PASSED: "survived", FAILED: "caught"}.get(code, f"cannot be judged: pytest ended with {code}")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--limit-s", type=float, default=120.0)
    asked = parser.parse_args()
    faults, begin = read_faults(asked.words), time.monotonic()
    copies: queue.SimpleQueue[Copy] = queue.SimpleQueue()

    def with_copy(work: Fault | tuple[tuple[str, ...], bool]) -> str:
        copy = copies.get()
        try:
            if isinstance(work, Fault):
                return tried(work, copy, asked.limit_s)
            code = copy.run(work[0], without_compiler=work[1], limit_s=5.0 * asked.limit_s)
            return "" if code == PASSED else f"tests do not pass on the untouched copy ({code}): {' '.join(work[0])}"
        finally:
            copies.put(copy)

    with tempfile.TemporaryDirectory(prefix="undrift-mutants-") as folder, ThreadPoolExecutor(asked.jobs) as pool:
        for number in range(asked.jobs):
            copies.put(Copy(Path(folder) / str(number)))
        sets = sorted({(fault.tests, fault.without_compiler) for fault in faults})
        refused = [text for text in pool.map(with_copy, sets) if text]
        if refused:
            print("\n".join(refused))
            return 2
        left = []
        for fault, outcome in zip(faults, pool.map(with_copy, faults), strict=True):
            print(f"{outcome:10} {fault.file}: {fault.name}", flush=True)
            if not outcome.startswith("caught"):
                left.append(f"  {fault.file}: {fault.name}: {outcome}")
    print(f"{len(faults) - len(left)} of {len(faults)} faults caught in {time.monotonic() - begin:.0f} s")
    print("\n".join(left))
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
