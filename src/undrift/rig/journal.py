"""Journal: one line for each thing done, appended and brought to the disk before the next begins.

    {"length": 123, "crc32": "89abcdef", "entry": {...}}

Length and checksum are of the entry's text as it stands in the line, so that a line torn by a power cut is known from a whole one.
Only the last line can be torn; one in the middle means that the file was damaged or edited, and is refused. One program at a time
has it: the file is locked, and the lock goes with the program however it ends.
"""

import json
import os
import sys
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from undrift.errors import FileFormatError, InputError

Entry = dict[str, Any]  # what JSON knows; the values of folder.py are made of it


class Journal:
    """An open journal; what was torn off by a crash is cut away when it is opened.

    Parameters
    ----------
    path : Path
        File; made where it is missing.

    Raises
    ------
    FileFormatError
        A damaged line that is not the last.
    InputError
        Another program has it open.
    OSError
        The file cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = locked(path)  # apart from the file that is written, which may have to be opened afresh
        try:
            self.entries, whole = read_journal(path)
            self._file: BinaryIO = path.open("ab")
        except BaseException:
            self._lock.close()
            raise
        try:
            self._file.truncate(whole)
            self._file.seek(whole)
            self._sync()
        except BaseException:
            self.close()
            raise

    def append(self, entry: Entry) -> None:
        """Write an entry; it is on the disk when this returns, or not in the journal at all.

        Parameters
        ----------
        entry : dict
            What JSON knows.

        Raises
        ------
        OSError
            The disk is full or lost; what was written of the line is taken back.
        """
        before = self._file.seek(0, os.SEEK_END)
        try:
            self._file.write(line_of(entry))
            self._sync()
        except OSError:
            self._take_back(before)
            raise
        self.entries = (*self.entries, entry)

    def close(self) -> None:
        """Let go of the file; harmless when called again."""
        try:
            self._file.close()
        finally:
            self._lock.close()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def _take_back(self, length: int) -> None:
        """Cut off half a line; where even that fails, the checksum tells."""
        self._file = reopened(self._file, self.path)
        os.truncate(self.path, length)


def locked(path: Path) -> BinaryIO:
    """Open a file that no other program has locked, and lock it; closing it, or the end of the program, lets go.

    Parameters
    ----------
    path : Path
        File; made where it is missing.

    Returns
    -------
    file
        Keep it open.

    Raises
    ------
    InputError
        Another program has locked it.
    """
    file = path.open("ab")
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(1 << 40)  # a byte far behind the end, so that the lines can still be read
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise InputError(
            f"{path.parent}: wanted a folder that no other program writes to, got one where a run is going on; "
            "wait for it or end it, or choose another folder"
        ) from error
    return file


def reopened(file: BinaryIO, path: Path) -> BinaryIO:
    """Return a file opened afresh, free of what its buffer could not write.

    Parameters
    ----------
    file : file
        Closed whatever its buffer says.
    path : Path
        Its path.

    Returns
    -------
    file
        For appending.
    """
    with suppress(OSError):  # the buffer is written again on closing, and fails again
        file.close()
    return path.open("ab")


def line_of(entry: Entry) -> bytes:
    """Return an entry as a line.

    Parameters
    ----------
    entry : dict
        What JSON knows.

    Returns
    -------
    bytes
        With the line's end.
    """
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f'{{"length":{len(text)},"crc32":"{zlib.crc32(text.encode()):08x}","entry":{text}}}\n'.encode()


def read_journal(path: Path) -> tuple[tuple[Entry, ...], int]:
    """Return the entries of a journal and where the last whole line ends.

    Parameters
    ----------
    path : Path
        File; a missing one is empty.

    Returns
    -------
    entries : tuple of dict
        In order.
    length : int
        Bytes up to the end of the last whole line.

    Raises
    ------
    FileFormatError
        A damaged line that is not the last.
    """
    data = path.read_bytes() if path.exists() else b""
    entries: list[Entry] = []
    place = 0
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        entry = _entry(line)
        if entry is None:
            if place + len(line) < len(data):
                raise FileFormatError(
                    f"{path}: line {number}: wanted a line as it was written, got a damaged one in the middle; "
                    "restore the file, or begin in another folder"
                )
            break
        entries.append(entry)
        place += len(line)
    return tuple(entries), place


def _entry(line: bytes) -> Entry | None:
    """Return the entry of a whole line, None for a torn one."""
    try:
        held = json.loads(line)
        entry = held["entry"]
    except (ValueError, KeyError, TypeError):
        return None
    return entry if isinstance(entry, dict) and line == line_of(entry) else None
