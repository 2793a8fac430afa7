"""Read files as bytes and write them atomically: a new file is written under a hidden name in the same folder, then renamed."""

import errno
import gzip
import hashlib
import os
import re
import secrets
import shutil
import stat
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from undrift.errors import FileFormatError, InputError, UndriftError

_HIDDEN, _STALE_S = ".undrift-", 86_400.0
_GZIP = b"\x1f\x8b"
_RATIO = 200  # a gzip file is refused if it unpacks to more than this many times its size ...
_SMALL = 10**8  # ... and to more than this many bytes
_BLOCK = 1 << 20
MOST_BYTES = 8 * 10**9  # largest unpacked file, bytes
MOST_TREE = 10**8  # largest JSON or TOML file, bytes, because parsing needs up to 32 times as much memory


WATCH: ContextVar[Callable[[Path, float], None]] = ContextVar("WATCH")  # callback for reading progress


def read_so_far(path: Path, share: float) -> None:
    """Report the share of a file that has been read, 0 to 1, to the callback in ``WATCH``, if there is one."""
    if watch := WATCH.get(None):
        watch(path, share)


def data_folder() -> Path:
    """Return undrift's folder in the user's data folder."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "undrift"


def checked_file(path: str | Path) -> Path:
    """Return the path of a file that exists and is not empty."""
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: expected a file, got a directory. Give a file in it.")
        if not path.exists():
            raise InputError(f"{path}: there is no file with this name. Check the path.")
        if path.stat().st_size == 0:
            raise FileFormatError(f"{path}: expected a recording, got an empty file. Record or copy it again.")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}. Check the path and its permissions."
        ) from error
    return path


def is_gzip(path: str | Path) -> bool:
    """Return True if the first bytes of a file are the gzip signature."""
    with Path(path).open("rb") as handle:
        return handle.read(2) == _GZIP


def read_bytes(path: str | Path, limit: int = -1) -> bytes:
    """Return the content of a file, unpacked if the file is gzip."""
    path = checked_file(path)
    try:
        if not is_gzip(path):
            if limit < 0 and path.stat().st_size > MOST_BYTES:
                raise too_large(path)
            with path.open("rb") as handle:
                return handle.read(limit)
        with gzip.open(path, "rb") as packed:
            content = packed.read(limit) if limit >= 0 else _unpacked(packed, path)
    except EOFError as error:
        raise FileFormatError(f"{path}: the gzip file is truncated. Copy it again.") from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: the gzip file is damaged ({error}). Copy it again.") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}. Check its permissions.") from error
    if not content:
        raise FileFormatError(
            f"{path}: expected a recording, got an empty file inside the gzip. Record or copy it again."
        )
    return content


def read_tree(path: str | Path) -> bytes:
    """Return the content of a JSON or TOML file. A file that could need too much memory when parsed is refused."""
    content = read_bytes(path)
    if len(content) > MOST_TREE:
        raise too_large(Path(path))
    return content


def _unpacked(packed: gzip.GzipFile, path: Path) -> bytes:
    """Return the unpacked content of a gzip file. A file that unpacks to far more than a recording is refused."""
    content, size = bytearray(), path.stat().st_size
    while block := packed.read(_BLOCK):
        content += block
        if len(content) > MOST_BYTES:
            raise too_large(path)
        if len(content) > max(_RATIO * size, _SMALL):
            raise FileFormatError(
                f"{path}: expected a packed recording, got a file that unpacks to more than {_RATIO} times its size. "
                "It is not a recording."
            )
    return bytes(content)


def too_large(path: Path) -> FileFormatError:
    """Return the error of a file that takes too much memory."""
    return FileFormatError(
        f"{path}: larger than {MOST_BYTES / 1e9:g} GB in memory. Check whether it is damaged, or split it."
    )


@contextmanager
def sound(path: Path, kind: str) -> Iterator[None]:
    """Convert any exception that a library raises on a damaged file into a one-line error."""
    try:
        yield
    except MemoryError as error:
        raise too_large(path) from error
    except Exception as error:
        if isinstance(error, UndriftError) or os.environ.get("UNDRIFT_TRACEBACK") == "1":
            raise
        raise FileFormatError(
            f"{path}: expected a sound {kind} file, got a damaged or truncated file ({first_line(error)}). Copy it again."
        ) from error


def bytes_in(path: Path) -> int:
    """Return the bytes of a file, or of all files of a folder."""
    files = path.rglob("*") if path.is_dir() else (path,)
    return sum(file.stat().st_size for file in files if file.is_file())


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its name if the text is empty."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file as stored (packed files are not unpacked)."""
    digest = hashlib.sha256()
    with checked_file(path).open("rb") as handle:
        while block := handle.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


# ---- writing


Content = bytes | str | Callable[[Path], object] | None  # content of a file, or its writer, or None to delete the file


def write_whole(path: Path | str, content: Content) -> None:
    """Write a file completely or not at all. An existing file with this name is replaced."""
    write_together({Path(path): content})


def write_together(files: Mapping[Path, Content]) -> None:
    """Write files that belong together. All are complete before the first is renamed. Existing files are replaced.

    A function as content receives the path to write to.
    """
    with ExitStack() as stack:
        drafts = dict[Path, Path]()
        for path, content in files.items():
            if content is None:
                continue
            drafts[path] = draft = stack.enter_context(_draft(path))
            if callable(content):
                try:
                    content(draft)
                except InputError as error:  # part of the draft's name
                    raise (error.__cause__ if isinstance(error.__cause__, OSError) else error) from None
            else:
                draft.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
            synchronise(draft)
        _take_names(drafts)
    for path in (path for path, content in files.items() if content is None):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise unwritten(path, error) from error


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield an empty temporary file next to a path. At the end of the block, it is complete on the disk and gets its name.

    If the block fails, it is deleted. Its mode is copied from the file that it replaces, or follows the umask.
    """
    with _draft(path) as draft:
        yield draft
        synchronise(draft)
        _take_names({path: draft})


@contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """Yield an empty temporary file next to a path, and delete it at the end of the block if it has not been renamed."""
    if path.is_dir():
        raise unwritten(path, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))
    draft = path.with_name(f".{path.name[:40]}.{secrets.token_hex(4)}.part")
    try:
        os.close(os.open(draft, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        if path.exists():
            draft.chmod(stat.S_IMODE(path.stat().st_mode))
    except OSError as error:
        raise no_folder(path, error) from error
    try:
        yield draft
    except OSError as error:
        raise unwritten(path, error) from error
    finally:
        draft.unlink(missing_ok=True)


def _take_names(drafts: Mapping[Path, Path]) -> None:
    """Rename complete files. If the disk has no room for a new name, no file is renamed, because replacing a file needs no room."""
    new = [path for path in drafts if not path.exists()]
    for path in sorted(drafts, key=lambda path: path not in new):
        try:
            drafts[path].replace(path)
        except OSError as error:
            for other in new:
                other.unlink(missing_ok=True)
            raise unwritten(path, error) from error


def synchronise(path: Path) -> None:
    """Flush a file to the disk."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def errno_of(error: OSError) -> int | None:
    """Return the errno of an error. Arrow and shutil state it only in the text of their errors."""
    match = re.search(r"\[errno (\d+)\]", str(error), re.IGNORECASE)
    return int(match[1]) if match and error.errno is None else error.errno


def reason_of(error: OSError) -> str:
    """Return the description that the operating system gives of an error."""
    number = errno_of(error)
    return os.strerror(number) if number else str(error)


def is_full(error: OSError) -> bool:
    """Return True if the disk is full or a quota is used up."""
    return errno_of(error) in (errno.ENOSPC, errno.EDQUOT)


def no_folder(path: Path, error: OSError) -> InputError:
    """Return the error for a folder in which no file can be created."""
    if is_full(error):
        return unwritten(path, error)
    return InputError(f"{path}: expected a folder to write to, got {reason_of(error)}. Choose another folder.")


def unwritten(path: Path, error: OSError) -> InputError:
    """Return the error for a file that could not be written."""
    path = path.parent.parent / path.name if path.parent.name.startswith(_HIDDEN) else path
    if is_full(error):
        return InputError(
            f"{path}: expected free disk space, but the disk is full or a quota is used up. Free space and run the command again."
        )
    return InputError(f"{path}: cannot be written: {reason_of(error)}. Check the name, the folder and its permissions.")


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a hidden draft of a new folder. At the end of the block, the complete folder gets its name. If the block fails, there
    is no folder.

    Drafts of killed runs are deleted after a day.
    """
    if folder.exists():
        raise InputError(f"{folder}: the folder already exists. Choose another name.")
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist. Create it first.")
    for stale in folder.parent.glob(f"{_HIDDEN}*"):
        with suppress(FileNotFoundError):  # another process may delete its folder at the same time
            if stale.stat().st_mtime < time.time() - _STALE_S:
                shutil.rmtree(stale, ignore_errors=True)
    hidden = folder.parent / f"{_HIDDEN}{secrets.token_hex(8)}"  # named first: a signal leaves nothing
    try:
        hidden.mkdir(mode=0o700)
        yield hidden / folder.name
        (hidden / folder.name).rename(folder)
    except OSError as error:
        raise no_folder(folder, error) from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def take_lock(handle: int, wait_s: float = 2.0) -> None:
    """Lock an open file for this process. Raise OSError if another process still has the lock after ``wait_s`` seconds.

    The wait is needed because a newly forked process keeps the locks of its parent until it has closed the files.
    """
    if sys.platform == "win32":
        import msvcrt

        return msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    import fcntl

    last = time.monotonic() + wait_s
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return None
        except OSError:
            if time.monotonic() > last:
                raise
            time.sleep(0.02)
