"""Results that are computed once in a run of the suite: what tests in several processes need is made for all of them.

Results are kept as pickles in a folder of the run, each under the hash of what went in; they go with the folder.
"""

import io
import os
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from hashlib import blake2b
from pathlib import Path
from typing import TypeVar

import pytest

try:
    import fcntl
except ImportError:  # Windows has no flock: each process keeps its own results
    fcntl = None  # type: ignore[assignment]

T = TypeVar("T")


def run_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the folder shared by all processes of a run, or a folder of this process if no lock is available."""
    base = factory.getbasetemp()
    folder = (base.parent if fcntl and "PYTEST_XDIST_WORKER" in os.environ else base) / "remembered"
    folder.mkdir(exist_ok=True)
    return folder


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Allow only one process at a time in the block."""
    if fcntl is None:
        yield
        return
    with path.with_name(f"{path.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(lock, fcntl.LOCK_UN)  # a process that was forked meanwhile keeps the file open


def remembered(function: Callable[..., T], folder: Path) -> Callable[..., T]:
    """Return a function that is computed once per run for equal arguments.

    The function must be pure, and its results must not be modified. A generator argument must not be used afterwards.
    ``progress`` does not affect the result.
    """
    results: dict[Path, T] = {}

    @wraps(function)
    def once(*args: object, **words: object) -> T:
        finding = sorted((name, word) for name, word in words.items() if name != "progress")
        path = folder / f"{function.__name__}-{_hash_of((args, finding))}"
        if path not in results:
            with locked(path):
                if not path.exists():
                    result = function(*args, **words)
                    whole = path.with_name(f"{path.name}.part")
                    whole.write_bytes(pickle.dumps(result, protocol=5))
                    whole.rename(path)
                results[path] = pickle.loads(path.read_bytes())
        return results[path]

    return once


def folder_made_once(folder: Path, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that the first who asks fills, for all to read."""
    path = folder / name
    with locked(path):
        if not (path / "made").exists():
            shutil.rmtree(path, ignore_errors=True)  # of a process that failed half-way
            path.mkdir()
            make(path)
            (path / "made").touch()
    return path


def _hash_of(value: object) -> str:
    """Return a hash that is the same for equal values in every process."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=5)
    pickler.fast = (
        True  # without references to earlier pickled objects, because the identity of strings does not matter
    )
    pickler.dump(value)
    return blake2b(stream.getvalue(), digest_size=16).hexdigest()


def put_everywhere(
    patch: pytest.MonkeyPatch, function: Callable[..., T], instead: Callable[..., T], within: str = "undrift"
) -> None:
    """Put a function in the place of another in every module of a package that has it by name."""
    for name, module in list(sys.modules.items()):
        if name.startswith(within) and name[len(within) : len(within) + 1] in (".", ""):
            for attribute, value in list(vars(module).items()):
                if value is function:
                    patch.setattr(module, attribute, instead)
