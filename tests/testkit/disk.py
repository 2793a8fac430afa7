"""A full disk: disk.c, compiled once and preloaded into a separate process."""

import ctypes
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SOURCE = Path(__file__).with_name("disk.c")


def preloaded(**more: str) -> dict[str, str]:
    """Return the environment of a process whose disk can be full."""
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    built = Path(tempfile.gettempdir(), f"undrift-disk-{os.getuid()}-{digest}.so")
    if not built.exists():
        part = built.with_suffix(f".{os.getpid()}")
        subprocess.run(
            ["gcc", "-O1", "-Wall", "-Werror", "-shared", "-fPIC", SOURCE, "-o", part], check=True, timeout=60
        )
        part.replace(built)
    path = os.pathsep.join((str(Path(__file__).parents[1]), *sys.path))
    return os.environ | {"LD_PRELOAD": str(built), "PYTHONPATH": path} | more


@contextmanager
def full_after(folder: Path, sound: int, *, stays: bool) -> Iterator[list[int]]:
    """Let a number of calls that allocate disk space below a folder succeed, and the next call fail. The yielded list
    counts them.
    """
    library, counted = ctypes.CDLL(None), list[int]()
    library.disk_count.restype = ctypes.c_long
    library.disk_arm.argtypes = (ctypes.c_char_p, ctypes.c_long, ctypes.c_int)
    library.disk_arm(str(folder).encode(), sound, stays)
    try:
        yield counted
    finally:
        counted.append(library.disk_count())
        library.disk_arm(b"", 0, 0)
