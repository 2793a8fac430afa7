"""Files as bytes, checked TOML, and writing: a file appears whole or not at all.

A file is written beside its place, then moved into it. Errors in TOML name the line and the entry.
"""

import errno
import gzip
import hashlib
import os
import re
import shutil
import tempfile
import time
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from undrift.errors import FileFormatError, InputError

GIGABYTE = 10**9
_HIDDEN, _LOCK = ".undrift-", ".lock"
_GZIP = b"\x1f\x8b"
_RATIO = 200  # A gzip that unpacks to more than so many times its size ...
_SMALL = 10**8  # ... and to more bytes than these is no recording
_BLOCK = 1 << 20


@dataclass(slots=True)
class Limits:
    """What reading one file may take; one object, ``LIMITS``, for the whole process."""

    memory_gb: float = 2.0  # Of its parser, and of the file unpacked
    trust: bool = False  # No limits; parsers run in the caller's own process
    start_s: float = 60.0  # Processor time of a parser for a file of any size ...
    megabyte_s: float = 1.0  # ... and for each megabyte of it

    def over(self, path: Path) -> str:
        """Say that a file takes more memory than this."""
        return (
            f"{path}: wanted a file that reads within {self.memory_gb:g} GB of memory, got one that takes more; it is damaged, or "
            f"read it with --memory-limit-gb {2.0 * self.memory_gb:g}"
        )


LIMITS = Limits()


def data_folder() -> Path:
    """Return undrift's folder in the user's data folder."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "undrift"


def checked_file(path: str | Path) -> Path:
    """Return the path of a file that exists and is not empty."""
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: wanted a file, got a directory; name the file in it")
        if not path.exists():
            raise InputError(f"{path}: wanted a file, got nothing of that name; check the path")
        if path.stat().st_size == 0:
            raise FileFormatError(f"{path}: wanted a recording, got an empty file; record or copy it again")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; check the path and its rights") from error
    return path


def is_gzip(path: str | Path) -> bool:
    """Tell whether a file is gzip by its first bytes."""
    with Path(path).open("rb") as handle:
        return handle.read(2) == _GZIP


def read_bytes(path: str | Path, limit: int = -1) -> bytes:
    """Return the content of a file, unpacked where it is gzip."""
    path = checked_file(path)
    try:
        if not is_gzip(path):
            with path.open("rb") as handle:
                return handle.read(limit)
        with gzip.open(path, "rb") as packed:
            content = packed.read(limit) if limit >= 0 or LIMITS.trust else _unpacked(packed, path)
    except EOFError as error:
        raise FileFormatError(f"{path}: wanted a whole gzip file, got one that is cut off; copy it again") from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise FileFormatError(
            f"{path}: wanted a sound gzip file, got a damaged one ({error}); copy it again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; check its rights") from error
    if not content:
        raise FileFormatError(f"{path}: wanted a recording, got an empty file inside the gzip; record or copy it again")
    return content


def _unpacked(packed: gzip.GzipFile, path: Path) -> bytes:
    """Return what a gzip file holds, unless it is far more than a recording would unpack to."""
    content, size = bytearray(), path.stat().st_size
    while block := packed.read(_BLOCK):
        content += block
        if len(content) > LIMITS.memory_gb * GIGABYTE:
            raise FileFormatError(LIMITS.over(path))
        if len(content) > max(_RATIO * size, _SMALL):
            raise FileFormatError(
                f"{path}: wanted a packed recording, got a file that unpacks to more than {_RATIO} times its size; it is no "
                "recording, or read it with --trust"
            )
    return bytes(content)


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its name where it has none."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file as stored (packed files are not unpacked)."""
    digest = hashlib.sha256()
    with checked_file(path).open("rb") as handle:
        while block := handle.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


# ---- TOML checked against a model


class Entry(BaseModel):
    """A TOML table: unknown keys are an error, and nothing is converted on the quiet."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: str | Path, model: type[Model]) -> Model:
    """Read a TOML file into a model."""
    path = Path(path)
    try:
        text = read_bytes(path).decode("utf-8")
        held = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: wanted UTF-8 text, got other bytes at {error.start}; save the file as UTF-8"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path}: wanted TOML, got a line that is not: {error}") from error
    try:
        return model.model_validate(held)
    except ValidationError as error:
        raise FileFormatError(f"{path}: {_explained(error, text)}") from error


def line_of(text: str, place: tuple[Any, ...]) -> int:
    """Return the line of an entry in a TOML text."""
    lines, start, keys = text.splitlines(), -1, [part for part in place if isinstance(part, str)]
    if keys:
        head = rf"^\s*\[+\s*{re.escape(keys[0])}\s*\]+"
        hits = [number for number, line in enumerate(lines) if re.match(head, line)]
        wanted = place[1] if len(place) > 1 and isinstance(place[1], int) else 0
        if wanted < len(hits):
            start, keys = hits[wanted], keys[1:]
    for key in reversed(keys):
        for number in range(start + 1, len(lines)):
            if lines[number].lstrip().startswith("["):
                break
            if re.search(rf'(^|[\s{{,"]){re.escape(key)}"?\s*=', lines[number]):
                return number + 1
    return max(start, 0) + 1


def entry_name(place: tuple[Any, ...]) -> str:
    """Return an entry's name for a message: "[[turn]] 2, angle_deg"."""
    parts: list[str] = []
    for k, part in enumerate(place):
        if isinstance(part, int):
            continue
        follows = place[k + 1] if k + 1 < len(place) else None
        number = f" {follows + 1}" if isinstance(follows, int) else ""
        parts.append(
            (f"[[{part}]]" if number and k == 0 else f"[{part}]" if k == 0 and len(place) > 1 else part) + number
        )
    return ", ".join(parts)


def _explained(error: ValidationError, text: str) -> str:
    """Say the first thing that is wrong: unknown keys first, they explain the rest."""
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    problem = problems[0]
    place = tuple(part for part in problem["loc"] if not _is_branch(part))
    what = {
        "extra_forbidden": "wanted a known key, got this one; check its spelling",
        "missing": "wanted this key, got none; add it",
    }.get(problem["type"], f"{_plain(problem['msg'])}, got {problem['input']!r}")
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"line {line_of(text, place)}: {entry_name(place)}: {what}{more}"


def _is_branch(part: Any) -> bool:
    """Tell pydantic's names for the branches of a union from keys of the file."""
    return isinstance(part, str) and (part in ("str", "int", "float", "bool") or "[" in part or part[:1].isupper())


def _plain(message: str) -> str:
    message = message.removeprefix("Value error, ")
    return message.replace("Input should be ", "wanted ").splitlines()[0]


# ---- writing


def write_whole(path: Path | str, content: bytes | str) -> None:
    """Write a file whole or not at all; one of that name is replaced."""
    path = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:40]}.", suffix=".part")
    except OSError as error:
        raise InputError(f"{path}: wanted a folder to write to, got {error.strerror}; choose another") from error
    part = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.chmod(0o644)
        part.replace(path)
    except OSError as error:
        raise unwritten(path, error, len(data)) from error
    finally:
        part.unlink(missing_ok=True)


def errno_of(error: OSError) -> int | None:
    """Return the number of an error, which Arrow states in its text alone."""
    stated = re.search(r"\[errno (\d+)\]", str(error))
    return int(stated[1]) if stated and error.errno is None else error.errno


def unwritten(path: Path, error: OSError, size: int) -> InputError:
    """Return what to say when `size` bytes more of a file could not be written."""
    number = errno_of(error)
    if number not in (errno.ENOSPC, errno.EDQUOT):
        return InputError(
            f"{path}: cannot be written: {os.strerror(number) if number else error}; check the name, the folder and its rights"
        )
    free = shutil.disk_usage(path.parent).free
    lacks = f"{size - free} are missing" if size > free else "a quota is spent"
    return InputError(
        f"{path}: wanted room for {size} bytes more on the disk, got {free}: {lacks}; make room and run it again",
        missing=max(size - free, 0),
    )


@contextmanager
def hidden_folder(beside: Path) -> Iterator[Path]:
    """Make a folder for files that appear together when they are whole; those that a killed run left there are deleted."""
    for stale in beside.glob(f"{_HIDDEN}*"):
        if _is_left(stale):
            shutil.rmtree(stale, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=beside, prefix=_HIDDEN) as name, _claimed(Path(name)):
        yield Path(name)


@contextmanager
def _claimed(folder: Path) -> Iterator[None]:
    """Hold a lock beside a folder as long as this process works in it; the system frees it when the process dies."""
    with folder.with_name(folder.name + _LOCK).open("wb") as lock:
        with suppress(ImportError):  # Windows: nothing is swept there
            take_lock(lock.fileno())
        try:
            yield
        finally:
            Path(lock.name).unlink(missing_ok=True)


def take_lock(handle: int, wait_s: float = 2.0) -> None:
    """Lock an open file for this process (POSIX); OSError where another holds it.

    A process that was forked a moment ago, to become another program or a box, holds the locks of its parent until it has closed
    them: that is waited for.
    """
    import fcntl

    last = time.monotonic() + wait_s
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except OSError:
            if time.monotonic() > last:
                raise
            time.sleep(0.02)


def _is_left(folder: Path) -> bool:
    """Tell a hidden folder whose process has died from one that is at work; the lock of the former is deleted."""
    lock = folder.with_name(folder.name + _LOCK)
    try:
        with lock.open("rb") as held:
            take_lock(held.fileno(), 0.0)
            lock.unlink()
    except (ImportError, OSError):
        return False
    return True
