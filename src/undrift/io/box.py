"""A box for parsers: a child process reads a binary file, within limits of memory and time.

A damaged file can crash a library or make it take all memory; then the child dies, and the caller gets one line. What was read
comes back as shared memory, so that large arrays are copied once. The child is forked; where the system cannot fork (Windows),
and for files that the caller trusts, the parser runs in the caller's own process. A session of many files is read in one box
(``one_box``): each file within its own limits, and one that fails beside others is read again in a box of its own.
"""

import contextlib
import faulthandler
import functools
import mmap
import os
import pickle
import signal
import socket
import struct
import tempfile
import time
import warnings
from collections.abc import Callable, Generator, Iterator
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TypeVar

from undrift.errors import FileFormatError, InputError, UndriftError
from undrift.files import GIGABYTE, LIMITS, checked_file, first_line

with contextlib.suppress(ImportError):  # Windows has none, and no fork
    import resource

P = ParamSpec("P")
T = TypeVar("T")

_inside = False  # a box: what it calls is not boxed again
_shared: ContextVar["list[_Box] | None"] = ContextVar("_shared", default=None)  # the box of a session, once it is made
_LENGTH = struct.Struct("<Q")


def boxed(*libraries: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Let a reader run in a box; its first argument is the path of a file or folder.

    The libraries that it needs are imported before the box is made, once for all files.
    """

    def decorate(read: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(read)
        def in_box(*given: P.args, **named: P.kwargs) -> T:
            once = functools.partial(_once, read, given, named)
            (value,) = _parts(given[0], libraries, once, (in_box, given, named))
            return value

        return in_box

    return decorate


def boxed_parts(*libraries: str) -> Callable[[Callable[P, Iterator[T]]], Callable[P, Iterator[T]]]:
    """Let a reader that yields the parts of a file run in a box, one part ahead of its caller."""

    def decorate(read: Callable[P, Iterator[T]]) -> Callable[P, Iterator[T]]:
        @functools.wraps(read)
        def in_box(*given: P.args, **named: P.kwargs) -> Iterator[T]:
            return _parts(given[0], libraries, functools.partial(read, *given, **named))

        return in_box

    return decorate


@contextlib.contextmanager
def one_box() -> Iterator[None]:
    """Read the files of a ``with`` block, or of a function so decorated, in one box, which is made for the first of them."""
    if _shared.get() is not None:
        yield
        return
    boxes = list[_Box]()
    token = _shared.set(boxes)
    try:
        yield
    finally:
        _shared.reset(token)
        for box in boxes:
            box.close()


def _parts(
    file: Any, libraries: tuple[str, ...], read: Callable[[], Iterator[T]], call: Any = None
) -> Generator[T, None, None]:
    """Yield what a reader yields; a call that can be sent goes into the box that stands, where there is one."""
    path = checked_file(file) if not Path(file).is_dir() else Path(file)
    if _inside or LIMITS.trust or not hasattr(os, "fork"):
        with _foreseen(path):
            yield from read()
        return
    for library in libraries:
        with contextlib.suppress(ImportError):  # the reader says what to install
            import_module(library)
    shared = _shared.get() if call is not None else None
    if shared:
        shared[0].ask(path, call)
        if (yield from shared[0].received()):
            return
        shared.pop().close()  # it may have died of the files before: once more, in a box of its own
    box, whole = _Box(path, read), False
    try:
        whole = yield from box.received()
        if not whole:
            raise FileFormatError(_death(path, box.ended()))
    finally:
        if whole and shared is not None:
            shared.append(box)
        else:
            box.close()


def load(module: str, path: Path, extra: str = "io") -> Any:
    """Return a library that an extra installs."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise InputError(
            f"{path}: wanted {name} to read it, got no such library; run pip install 'undrift[{extra}]'"
        ) from error


@contextlib.contextmanager
def _foreseen(path: Path) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one line."""
    try:
        yield
    except MemoryError as error:
        raise FileFormatError(LIMITS.over(path)) from error
    except (UndriftError, OSError):
        raise
    except Exception as error:
        if os.environ.get("UNDRIFT_TRACEBACK") == "1":
            raise
        raise FileFormatError(
            f"{path}: wanted a sound file, got a damaged one ({type(error).__name__}: {first_line(error)}); copy it again"
        ) from error


# ---- the child


def _run(path: Path, read: Callable[[], Iterator[Any]], channel: socket.socket) -> NoReturn:
    """Send what one parser after another yields, or its error, and end this process at once: its buffers are the caller's."""
    global _inside
    _inside = True
    status = 1
    try:
        faulthandler.disable()
        for low, high in ((3, channel.fileno()), (channel.fileno() + 1, 1 << 16)):
            os.closerange(low, high)  # the locks, ports and files of the caller are not this process's to hold
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        quiet = os.open(os.devnull, os.O_WRONLY)  # a library's own words, also those of its death
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        memory, first = _held() + int(LIMITS.memory_gb * GIGABYTE), True
        while True:
            _set_limits(path, memory)
            try:
                with _foreseen(path):
                    for part in read():
                        _send(channel, (part, None))
                _send(channel, (None, StopIteration()))
            except Exception as error:
                if not first and isinstance(error.__cause__, MemoryError):
                    raise
                _send(channel, (None, error))  # the caller raises it again
            size = channel.recv(_LENGTH.size, socket.MSG_WAITALL)
            if not size:  # the caller has closed the box
                break
            path, call = pickle.loads(channel.recv(_LENGTH.unpack(size)[0], socket.MSG_WAITALL))
            first, read = False, functools.partial(_once, *call)
        status = 0
    finally:
        os._exit(status)


def _once(read: Callable[..., T], given: tuple[Any, ...], named: dict[str, Any]) -> Iterator[T]:
    yield read(*given, **named)


def _set_limits(path: Path, memory: int) -> None:
    """Limit this process to some bytes, and to the seconds of one file more than it has used."""
    size = sum(p.stat().st_size for p in (path.rglob("*") if path.is_dir() else (path,)) if p.is_file())
    seconds = round(time.process_time() + LIMITS.start_s + LIMITS.megabyte_s * size / 1e6)
    limits = {resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0, resource.RLIMIT_DATA: memory}
    for kind, most in limits.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _held() -> int:
    """Return the bytes of writable memory that this process has mapped; 0 where the system does not say."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmData")).split()[1])
    return 0


def _send(channel: socket.socket, held: tuple[Any, BaseException | None]) -> None:
    """Send an object: its arrays as they are in a file in memory, and that file's number; wait while two are not taken."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(held, protocol=5, buffer_callback=buffers.append)
    raw = [buffer.raw() for buffer in buffers]
    memory: Any = getattr(os, "memfd_create", None)  # Linux alone has it
    with tempfile.TemporaryFile() if memory is None else os.fdopen(memory("undrift"), "w+b") as file:
        file.write(struct.pack(f"<{len(raw) + 2}Q", len(raw), len(head), *(view.nbytes for view in raw)))
        file.write(head)
        for view in raw:
            file.write(bytes(-file.tell() % 64))
            file.write(view)
        file.flush()
        socket.send_fds(channel, [b"+"], [file.fileno()])
    channel.recv(1)


# ---- the caller


class _Box:
    """A child process, from the first file that it reads on."""

    def __init__(self, path: Path, read: Callable[[], Iterator[Any]]) -> None:
        self._channel, theirs = socket.socketpair()
        self._status: int | None = None  # Of the process, once it has ended
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", DeprecationWarning
            )  # of a fork beside threads: the child runs the parser alone
            self._child = os.fork()
        if self._child == 0:
            self._channel.close()
            _run(path, read, theirs)
        theirs.close()

    def ask(self, path: Path, call: Any) -> None:
        """Send the next file, and what reads it."""
        head = pickle.dumps((path, call))
        self._send(_LENGTH.pack(len(head)) + head)

    def received(self) -> Generator[Any, None, bool]:
        """Yield what the child sends of one file; return whether it came to an end by itself."""
        self._send(b"+")  # the child may be one part ahead
        while True:
            try:
                _, files, _, _ = socket.recv_fds(self._channel, 1, 1)
            except ConnectionError:
                return False
            if not files:
                return False
            part, error = _unpacked(files[0])
            if isinstance(error, StopIteration):
                return True
            if error is not None:
                raise error
            self._send(b"+")
            yield part

    def _send(self, data: bytes) -> None:
        with contextlib.suppress(ConnectionError):  # it has died: nothing will come
            self._channel.sendall(data)

    def ended(self) -> int:
        """Wait for the process to end, and return of what."""
        if self._status is None:
            self._status = os.waitpid(self._child, 0)[1]
        return os.waitstatus_to_exitcode(self._status)

    def close(self) -> None:
        """End the process."""
        self._channel.close()
        if self._status is None:
            os.kill(self._child, signal.SIGKILL)
            self.ended()


def _unpacked(number: int) -> Any:
    """Return the object in a file of memory; its arrays stay in it."""
    try:
        held = memoryview(mmap.mmap(number, 0, access=mmap.ACCESS_COPY))
    finally:
        os.close(number)
    count, length = struct.unpack_from("<2Q", held)
    sizes = struct.unpack_from(f"<{count}Q", held, 16)
    at = 16 + 8 * count + length
    head, buffers = held[at - length : at], []
    for size in sizes:
        at += -at % 64
        buffers.append(held[at : at + size])
        at += size
    return pickle.loads(head, buffers=buffers)


def _death(path: Path, code: int) -> str:
    """Say of what a parser died."""
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return f"{path}: wanted a sound file, got one whose parser does not come to an end; copy it again"
    name = signal.Signals(-code).name if code < 0 else f"exit {code}"
    return (
        f"{path}: wanted a sound file, got one that makes its parser crash ({name}); copy it again, or export it anew"
    )
