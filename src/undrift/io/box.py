"""A box for parsers: a child process reads a binary file, within limits of memory and time.

A damaged file can crash a library or make it take all memory; then the child dies, and the caller gets one line. What was read
comes back as data, JSON and arrays in shared memory: large arrays are copied once, and nothing that the child says is run. The
child is forked; where the system cannot fork (Windows), and for files that the caller trusts, the parser runs in the caller's own
process. A session of many files is read in one box (``one_box``): each file within its own limits, and one that fails beside
others is read again in a box of its own.
"""

import contextlib
import faulthandler
import functools
import json
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
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TypeVar

import numpy as np

from undrift import errors
from undrift.errors import FileFormatError, InputError, UndriftError
from undrift.files import LIMITS, WATCH, bytes_in, checked_file, first_line, read_so_far

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
        with sound(path):
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
def sound(path: Path, kind: str = "") -> Iterator[None]:
    """Turn whatever a library raises on a damaged file of a kind into one line; of any kind, whatever is no error of the disk."""
    try:
        yield
    except MemoryError as error:
        raise FileFormatError(LIMITS.over(path)) from error
    except Exception as error:
        if (
            isinstance(error, UndriftError if kind else UndriftError | OSError)
            or os.environ.get("UNDRIFT_TRACEBACK") == "1"
        ):
            raise
        wanted, got, why = f"a sound {kind} file", "a damaged or cut one", first_line(error)
        if not kind:
            wanted, got, why = "a sound file", "a damaged one", f"{type(error).__name__}: {why}"
        raise FileFormatError(f"{path}: wanted {wanted}, got {got} ({why}); copy it again") from error


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
        WATCH.set(lambda path, share: _send(channel, (path, share), watch=True))
        memory, first = _held() + int(LIMITS.room), True
        while True:
            _set_limits(path, memory)
            try:
                with sound(path):
                    for part in read():
                        _send(channel, part)
                _send(channel, None, end=True)
            except Exception as error:
                if not first and isinstance(error.__cause__, MemoryError):
                    raise
                _send(channel, None, error)  # the caller raises it again
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
    seconds = round(time.process_time() + LIMITS.start_s + LIMITS.megabyte_s * bytes_in(path) / 1e6)
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


def _send(channel: socket.socket, part: Any, error: BaseException | None = None, **kind: bool) -> None:
    """Send a value or an error: JSON, its arrays as they are in a file in memory, and that file's number."""
    raw = list[Any]()
    tree = {"part": _tree(part, raw), "error": None if error is None else _error_tree(error, raw), **kind}
    head = json.dumps(tree).encode()
    memory: Any = getattr(os, "memfd_create", None)  # Linux alone has it
    with tempfile.TemporaryFile() if memory is None else os.fdopen(memory("undrift"), "w+b") as file:
        file.write(struct.pack(f"<{len(raw) + 2}Q", len(raw), len(head), *(view.nbytes for view in raw)))
        file.write(head)
        for view in raw:
            file.write(bytes(-file.tell() % 64))
            file.write(view)
        file.flush()
        socket.send_fds(channel, [b"+"], [file.fileno()])
    channel.recv(1)  # wait while two are not taken


# ---- what is sent: data alone, whatever became of the child. Values of undrift are named by their class, arrays by their place.

_PLAIN = (bool, int, float, str, type(None))
_GROUPS: dict[str, type] = {"tuple": tuple, "list": list, "set": set, "frozenset": frozenset}


def _tree(value: Any, raw: list[Any]) -> Any:
    """Return a value as JSON knows it; the bytes of its arrays are added to ``raw``."""
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind.__name__ in _GROUPS:
        return {kind.__name__: [_tree(item, raw) for item in value]}
    if kind is dict:
        return {"dict": [[_tree(key, raw), _tree(item, raw)] for key, item in value.items()]}
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.hasobject:
            return {"cells": [_tree(cell, raw) for cell in array.ravel().tolist()], "shape": array.shape}
        turned = array.flags.f_contiguous and not array.flags.c_contiguous
        raw.append(np.ascontiguousarray(array.T if turned else array).reshape(-1).view(np.uint8).data)
        about = {
            "shape": array.shape[::-1] if turned else array.shape,
            "turned": turned,
            "kept": not array.flags.writeable,
        }
        return {"array": len(raw) - 1, "type": array.dtype.str, **about}
    if isinstance(value, Path):
        return {"path": os.fspath(value)}
    if kind is bytes:
        raw.append(memoryview(value))
        return {"bytes": len(raw) - 1}
    if is_dataclass(value) and kind.__module__.startswith("undrift."):
        held = {item.name: _tree(getattr(value, item.name), raw) for item in fields(value)}
        return {"value": f"{kind.__module__}:{kind.__qualname__}", "fields": held}
    if kind.__module__.startswith("pyarrow"):  # a column
        import pyarrow as pa

        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, (table := pa.table({"": value})).schema) as stream:
            stream.write_table(table)
        raw.append(memoryview(sink.getvalue()))
        return {"column": len(raw) - 1}
    raise TypeError(f"box: wanted data, got {kind.__module__}.{kind.__qualname__}")


def _error_tree(error: BaseException, raw: list[Any]) -> dict[str, Any]:
    if isinstance(error, UndriftError):
        return {"error": type(error).__name__, "text": str(error), "numbers": _tree(error.numbers, raw)}
    number, text, file = (getattr(error, name, None) for name in ("errno", "strerror", "filename"))
    return {"errno": number, "text": text or first_line(error), "file": None if file is None else os.fsdecode(file)}


def _value(tree: Any, raw: list[memoryview]) -> Any:
    """Return the value of a tree; its arrays stay in ``raw``."""
    if not isinstance(tree, dict):
        return tree
    (kind, held), *_ = tree.items()
    if kind in _GROUPS:
        return _GROUPS[kind](_value(item, raw) for item in held)
    if kind == "dict":
        return {_value(key, raw): _value(item, raw) for key, item in held}
    if kind == "cells":
        cells = np.empty(len(held), dtype=object)
        cells[:] = [_value(item, raw) for item in held]
        return cells.reshape(tree["shape"])
    if kind == "array":
        array = np.frombuffer(raw[held], np.dtype(tree["type"])).reshape(tree["shape"])
        array = array.T if tree["turned"] else array
        array.flags.writeable = not tree["kept"]
        return array if array.ndim else array[()]
    if kind in ("path", "bytes"):
        return Path(held) if kind == "path" else bytes(raw[held])
    if kind == "column":
        import pyarrow as pa

        return pa.ipc.open_stream(pa.py_buffer(raw[held])).read_all().column(0)
    module, _, name = held.partition(":")
    made = getattr(import_module(module), name) if module.startswith("undrift.") else None
    if not (isinstance(made, type) and is_dataclass(made)):
        raise FileFormatError(f"box: wanted a value of undrift, got {held}; copy the file again")
    value = object.__new__(made)
    for item in fields(made):
        object.__setattr__(value, item.name, _value(tree["fields"][item.name], raw))
    return value


def _error(tree: dict[str, Any], raw: list[memoryview]) -> Exception:
    if "errno" in tree:
        return OSError(tree["errno"], tree["text"], tree["file"])
    kind = getattr(errors, tree["error"], None)
    kind = kind if isinstance(kind, type) and issubclass(kind, UndriftError) else FileFormatError
    return kind(tree["text"], **_value(tree["numbers"], raw))


# ---- the caller


class _Box:
    """A child process, from the first file that it reads on."""

    def __init__(self, path: Path, read: Callable[[], Iterator[Any]]) -> None:
        self._channel, theirs = socket.socketpair()
        self._status: int | None = None  # Of the process, once it has ended
        with warnings.catch_warnings():
            # of a fork beside threads: the child runs the parser alone
            warnings.simplefilter("ignore", DeprecationWarning)
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
            tree, raw = _unpacked(files[0])
            if "end" in tree:
                return True
            if tree["error"] is not None:
                raise _error(tree["error"], raw)
            self._send(b"+")
            if "watch" in tree:
                read_so_far(*_value(tree["part"], raw))
            else:
                yield _value(tree["part"], raw)

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


def _unpacked(number: int) -> tuple[Any, list[memoryview]]:
    """Return the tree in a file of memory, and the bytes of its arrays, which stay in it."""
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
    return json.loads(bytes(head)), buffers


def _death(path: Path, code: int) -> str:
    """Say of what a parser died."""
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return f"{path}: wanted a sound file, got one whose parser does not come to an end; copy it again"
    name = signal.Signals(-code).name if code < 0 else f"exit {code}"
    return (
        f"{path}: wanted a sound file, got one that makes its parser crash ({name}); copy it again, or export it anew"
    )
