"""A full disk, and a log of the writes to a disk: disk.c, compiled once and preloaded into a separate process."""

import ctypes
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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


def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(None)
    library.disk_count.restype = ctypes.c_long
    library.disk_arm.argtypes = (ctypes.c_char_p, ctypes.c_long, ctypes.c_int, ctypes.c_int)
    library.disk_mark.argtypes = (ctypes.c_long,)
    return library


@contextmanager
def full_after(folder: Path, sound: int, *, stays: bool) -> Iterator[list[int]]:
    """Let a number of calls that allocate disk space below a folder succeed, and the next call fail. The yielded list
    counts them.
    """
    library, counted = _library(), list[int]()
    library.disk_arm(str(folder).encode(), sound, stays, -1)
    try:
        yield counted
    finally:
        counted.append(library.disk_count())
        library.disk_arm(b"", 0, 0, -1)


def mark(number: int) -> None:
    """Write a mark into the log of this process."""
    _library().disk_mark(number)


# ---- power cuts: what a disk may hold after one, from a log of what was written to it


@dataclass
class Content:
    """The bytes of a file, as programs see them and as the disk has them for certain."""

    seen: bytearray
    certain: bytes = b""


@dataclass(frozen=True)
class Cut:
    """A disk after a power cut: the reports before it, and the remaining files by name below the folder."""

    marks: tuple[int, ...]
    files: dict[str, bytes]
    way: str


WAYS = ("all that was not brought to the disk is lost", "names are kept", "zeros in place of contents", "torn in the middle",
        "contents are kept, names lost", "nothing is lost")  # fmt: skip


def logged(code: str, folder: Path, log: Path, *, timeout_s: float = 120.0) -> None:
    """Run code in a separate process and log its writes below a folder."""
    env = preloaded(DISK_FOLDER=str(folder), DISK_LOG=str(log))
    subprocess.run([sys.executable, "-c", code], env=env, check=True, timeout=timeout_s)


def cuts(log: Path, folder: Path, *, everywhere: bool = False) -> Iterator[Cut]:
    """Yield every different disk that a power cut just before a fsync, or before any change, and at the end, may leave."""
    seen_before, marks = set[tuple[object, ...]](), list[int]()
    names, certain_names = dict[str, Content](), dict[str, Content]()
    folders, certain_folders = {""}, {""}
    for kind, number, path, to, data in [*_changes(log, folder), ("S", 0, "", "", b"")]:
        if everywhere or kind == "S":
            for way in WAYS:
                keeps = not way.startswith(("all", "contents"))
                values = {
                    name: _left(content, way)
                    for name, content in (names if keeps else certain_names).items()
                    if keeps or _parents(name) <= certain_folders
                }
                key = (len(marks), *sorted(values.items()))
                if key not in seen_before:
                    seen_before.add(key)
                    yield Cut(tuple(marks), values, way)
        if kind == "K":
            marks.append(number)
        elif kind == "C":
            names[path] = Content(bytearray())
        elif kind == "M":
            folders.add(path)
        elif kind == "W":
            content = names[path].seen
            content.extend(bytes(max(number - len(content), 0)))
            content[number : number + len(data)] = data
        elif kind == "T":
            content = names[path].seen
            content.extend(bytes(max(number - len(content), 0)))
            del content[number:]
        elif kind == "L":
            names[to] = names[path]
        elif kind == "U":
            names.pop(path, None)
            folders.discard(path)
        elif kind == "R":
            if path in names:
                names[to] = names.pop(path)
            for name in [name for name in names if name.startswith(path + "/")]:
                names[to + name.removeprefix(path)] = names.pop(name)
        elif kind == "S" and path in names:
            names[path].certain = bytes(names[path].seen)
        elif kind == "S":  # a folder
            for tree, certain in ((names, certain_names), (dict.fromkeys(folders), certain_folders)):
                for name in {*tree, *certain}:
                    if name and os.path.dirname(name) == path:
                        if isinstance(certain, set):
                            certain.add(name) if name in tree else certain.discard(name)
                        elif name in tree:
                            certain[name] = names[name]
                        else:
                            del certain[name]


def _left(content: Content, way: str) -> bytes:
    """Return the content of a file after a power cut."""
    if way.startswith(("contents", "nothing")):
        return bytes(content.seen)
    if way.startswith("zeros"):
        return content.certain + bytes(max(len(content.seen) - len(content.certain), 0))
    if way.startswith("torn"):
        return bytes(content.seen[: (len(content.seen) + len(content.certain)) // 2])
    return content.certain


def _parents(name: str) -> set[str]:
    return {str(parent).removeprefix(".") for parent in Path(name).parents}


def _changes(log: Path, folder: Path) -> Iterator[tuple[str, int, str, str, bytes]]:
    data, place = log.read_bytes(), 0
    while place < len(data):
        end = data.index(b"\n", place)
        kind, number, _, path, to, size = data[place:end].decode().split("\t")
        place = end + 1 + int(size)
        short = [name.removeprefix(str(folder)).lstrip("/") for name in (path, to)]
        yield kind, int(number), short[0], short[1], data[end + 1 : place]
