"""Results that are computed once in a run of the suite: they are kept as pickles in a folder of the run, for all its processes."""

import io
import os
import pickle
import shutil
import sys
import time
from collections.abc import Callable
from functools import wraps
from hashlib import blake2b
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


def run_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the folder shared by all processes of a run."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "remembered"
    folder.mkdir(exist_ok=True)
    return folder


def remembered(function: Callable[..., T], folder: Path) -> Callable[..., T]:
    """Return a function that computes equal arguments once per run, or twice if two processes need it at once.

    The function must be pure, and its results must not be modified. ``progress`` does not affect the result.
    """
    results: dict[Path, T] = {}

    @wraps(function)
    def once(*args: object, **words: object) -> T:
        named = sorted((name, word) for name, word in words.items() if name != "progress")
        path = folder / f"{function.__name__}-{_hash_of((args, named))}"
        if path not in results:
            if not path.exists():
                part = path.with_name(f"{path.name}.{os.getpid()}")
                part.write_bytes(pickle.dumps(function(*args, **words), protocol=5))
                part.replace(path)
            results[path] = pickle.loads(path.read_bytes())
        return results[path]

    return once


def folder_made_once(folder: Path, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that the first who asks fills, for all to read."""
    path = folder / name
    while not (path / "made").exists():
        try:
            path.mkdir()
        except FileExistsError:  # another process fills it
            time.sleep(0.1)
            continue
        try:
            make(path)
        except BaseException:
            shutil.rmtree(path)
            raise
        (path / "made").touch()
    return path


def _hash_of(value: object) -> str:
    """Return a hash that is the same for equal values in every process."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=5)
    pickler.fast = True  # without references to earlier objects, because the identity of strings does not matter
    pickler.dump(value)
    return blake2b(stream.getvalue(), digest_size=16).hexdigest()


def put_everywhere(patch: pytest.MonkeyPatch, function: Callable[..., T], instead: Callable[..., T]) -> None:
    """Put a function in the place of another in every module of undrift that has it by name."""
    for name, module in list(sys.modules.items()):
        if name == "undrift" or name.startswith("undrift."):
            for attribute, value in list(vars(module).items()):
                if value is function:
                    patch.setattr(module, attribute, instead)
