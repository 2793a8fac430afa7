"""Run folder: the files of a run, which are a readable session at any time.

    protocol.toml     protocol of the run
    journal.jsonl     head, then a line for each dwell that was written or withdrawn
    pieces/           0007.parquet: the readings of step 7
    session.toml      written from the journal after each dwell
    aside/            pieces that are incomplete, withdrawn or not in the journal

A piece is written and synchronised first, then its line in the journal, then session.toml. A dwell without a line counts as not
done. A line is {"length": 123, "crc32": "89abcdef", "entry": {...}}. Length and checksum of the entry's text detect a line that a
power cut has truncated. Each checksum continues from the previous line, which detects lines that are missing, duplicated or moved.
Only the last line can be truncated. A damaged or edited line before it raises FileFormatError. session.toml contains the sha256 of
each piece, and its first line contains its own sha256. Only one program can use a folder, because the journal is locked. The lock
ends when the program ends, in any way.
"""

import errno
import hashlib
import json
import os
import re
import sys
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import Any, BinaryIO

from undrift.errors import FileFormatError, InputError
from undrift.files import call_writer, errno_of, take_lock, write_whole
from undrift.io.parquet import write_parquet
from undrift.io.session import HeadEntry, StillEntry, TurnEntry, sealed, session_toml
from undrift.programme import Protocol, Purpose, write_protocol
from undrift.record import Axis, Face, Kind, Record
from undrift.rig.lock import uninterrupted

# ---- Journal: one line per event, written to the disk before the next event.

Entry = dict[str, Any]  # JSON object of a journal line
_LINE = re.compile(rb'\{"length":(\d{1,9}),"crc32":"[0-9a-f]{8}","entry":([^\0]*)\}\n')
_FIRST = zlib.crc32(b"journal")  # start value of the first line's checksum


class Journal:
    """An open journal. Opening it removes a last line that a crash has truncated."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with ExitStack() as opened:
            # The lock has a file handle of its own, because the journal may have to be reopened.
            self._lock = opened.enter_context(locked(path))
            self.entries, end, self._sum = read_journal(path)
            self._file: BinaryIO = opened.enter_context(path.open("ab"))
            self._file.truncate(end)
            self._file.seek(end)
            self._sync()
            opened.pop_all()

    def append(self, entry: Entry) -> None:
        """Write an entry to the disk. If that fails, the entry is not in the journal."""
        before = self._file.seek(0, os.SEEK_END)
        try:
            line, following = line_of(entry, self._sum)
            self._file.write(line)
            self._sync()
        except OSError:  # removes half a line (if that fails too, the checksum detects the line)
            with suppress(OSError):  # closing writes the buffer again, which fails again
                self._file.close()
            self._file = self.path.open("ab")
            os.truncate(self.path, before)
            raise
        self.entries, self._sum = (*self.entries, entry), following

    def close(self) -> None:
        """Close the file. A second call has no effect."""
        try:
            self._file.close()
        finally:
            self._lock.close()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())


def locked(path: Path) -> BinaryIO:
    """Open and lock a file, or raise InputError if another program has locked it. Closing the file releases the lock."""
    file = path.open("ab")
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(1 << 40)  # locks a byte far beyond the end, so that the lines can still be read
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            take_lock(file.fileno())
    except OSError as error:
        file.close()
        raise InputError(
            f"{path.parent}: another run is writing to this folder. Wait for that run, end it, or choose another folder."
        ) from error
    return file


def line_of(entry: Entry, before: int) -> tuple[bytes, int]:
    """Return an entry as a line, and its checksum, which is the start value for the next line."""
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    crc = zlib.crc32(text, before)
    return b'{"length":%d,"crc32":"%08x","entry":%s}\n' % (len(text), crc, text), crc


def read_journal(path: Path) -> tuple[tuple[Entry, ...], int, int]:
    """Return the entries of a journal, the end of the last whole line, bytes, and the start value of the next checksum."""
    data = path.read_bytes() if path.exists() else b""
    entries: list[Entry] = []
    position = 0
    before = _FIRST
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        entry = _entry(line)
        expected, following = (b"", before) if entry is None else line_of(entry, before)
        if entry is None or line != expected:
            match = _LINE.fullmatch(line)  # a power cut truncates the line or leaves zeros in it
            complete = match is not None and int(match[1]) == len(match[2])
            if position + len(line) < len(data) or complete or (entry is not None and line.endswith(b"\n")):
                raise FileFormatError(
                    f"{path}: line {number}: the line was changed after it was written. Restore the file, or use another "
                    "folder."
                )
            break
        entries.append(entry)
        position, before = position + len(line), following
    return tuple(entries), position, before


def _entry(line: bytes) -> Entry | None:
    """Return the entry of a line, or None for a truncated line."""
    try:
        entry = json.loads(line)["entry"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None


# ---- Files of a run on the disk: synchronised, never overwritten, and with an error message for a full disk.


def synchronise(path: Path) -> None:
    """Flush a file and its directory entry to the disk."""
    _fsync(path, os.O_RDWR)
    synchronise_names(path.parent)


def synchronise_names(folder: Path) -> None:
    """Synchronise the names in a folder with the disk."""
    if os.name == "posix":
        _fsync(folder, os.O_RDONLY)


def _fsync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def claim(path: Path) -> None:
    """Create an empty file for the readings, or raise InputError if the file exists."""
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
    except FileExistsError as error:
        raise InputError(
            f"{path}: readings of this step exist and are kept. Another program wrote them. Continue with `resume` when that "
            "program has ended."
        ) from error


@contextmanager
def room(path: Path) -> Iterator[None]:
    """Convert an OSError to an InputError with the path and advice."""
    try:
        yield
    except OSError as error:
        full = errno_of(error) in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        advice = "Free space on the disk" if full else "Check the disk"
        raise InputError(
            f"{path}: cannot write a dwell ({error.strerror or error}). All earlier dwells are kept. "
            f"{advice} and continue with `resume`."
        ) from error


# ---- folder

FORMAT = 1
JOURNAL, PIECES, ASIDE, PROTOCOL, SESSION = "journal.jsonl", "pieces", "aside", "protocol.toml", "session.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Identity of a run, which is the same after every `resume`."""

    protocol: str  # sha256 of the written protocol
    rig: str  # identity that the rig reports
    serial: str = ""  # serial number of the device
    gravity_m_s2: float | None = None  # local gravity, m/s2, or None if it is not set
    kind: Kind = "calibration"  # calibration, or thermal if the chamber visits at least two temperatures


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedDwell:
    """A dwell that is on the disk."""

    step: int  # step number in the programme
    purpose: Purpose  # face, bracket, rate or turn
    up: Face  # device axis that points up
    axis: Axis | None  # axis of the turn
    samples: int  # number of readings
    start_s: float  # start on the device's clock, s
    stop_s: float  # end (exclusive) on the device's clock, s
    nominal_turn_rate: float = 0.0  # turn rate in the protocol, rad/s
    set_turn_rate: float = 0.0  # turn rate as the controller rounded it, rad/s
    turn_rate: float = 0.0  # turn rate measured with the encoder, rad/s
    turn_rate_uncertainty: float = 0.0  # standard uncertainty of turn_rate, rad/s
    temp_c: float | None = None  # set-point of the chamber, degC
    chamber_c: float | None = None  # air temperature in the chamber, degC
    device_c: float | None = None  # mean temperature of the device's thermometer, degC, or None without thermometer
    angle: float | None = None  # angle between two rests, reported by operator or rig, rad
    missing: int = 0  # number of missing readings, which are gaps in the piece
    sha256: str = ""  # sha256 of the file

    @property
    def name(self) -> str:
        """Path of the file in the folder."""
        return f"{PIECES}/{self.step:04d}.parquet"


class RunFolder(AbstractContextManager["RunFolder"]):
    """The folder of a run in progress, a context manager that closes the journal at the end."""

    def __init__(self, path: Path, protocol: Protocol, *, resume: bool = False) -> None:
        self.path = path
        with room(path):
            (path / PIECES).mkdir(parents=True, exist_ok=True)
            self._journal = Journal(path / JOURNAL)
        try:
            self._check_empty(resume)
            self.head, self.pieces = read_entries(path / JOURNAL, self._journal.entries)
            self.digest = protocol_digest(protocol)
            if self.head is not None and self.head.protocol != self.digest:
                raise InputError(
                    f"{path}: the protocol differs from the protocol that the run began with. Compare it with {PROTOCOL} there."
                )
            if self.head is None:
                write_protocol(protocol, path / PROTOCOL)
            self._put_aside()
            with room(path):
                for folder in (path / PIECES, path, path.parent):
                    synchronise_names(folder)
        except BaseException:
            self._journal.close()
            raise

    def __exit__(self, *failure: object) -> None:
        self._journal.close()

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the steps that are on the disk."""
        return frozenset(piece.step for piece in self.pieces)

    def begin(self, head: Head) -> None:
        """Write the head of a new run, or raise InputError if a resumed run has another head."""
        if self.head is None:
            with room(self.path):
                self._journal.append({"entry": "head", "format": FORMAT, **asdict(head)})
            self.head = head
        for name, value in asdict(self.head).items():
            if value != getattr(head, name):
                raise InputError(
                    f"{self.path}: the run began with {name} '{value}', got '{getattr(head, name)}'. "
                    "Continue with the former, or use another folder."
                )
        if self.pieces:
            self.write_session()

    def keep(self, record: Record, piece: RecordedDwell) -> RecordedDwell:
        """Write a dwell to the disk: readings, journal line and session. Return the dwell with the sha256 of its file."""
        path = self.path / piece.name
        with uninterrupted():  # Ctrl-C waits, since readings, line and session belong together
            with room(self.path):
                claim(path)
                call_writer(partial(write_parquet, record), path)
                synchronise(path)
                written = replace(piece, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
                self._journal.append({"entry": "dwell", **asdict(written)})
            self.pieces = (*self.pieces, written)
            self.write_session()
        return written

    def withdraw(self, face: Face) -> frozenset[int]:
        """Withdraw all dwells with a face up, move their readings to `aside`, and return the steps to repeat."""
        steps = frozenset(piece.step for piece in self.pieces if piece.up == face)
        with uninterrupted(), room(self.path):
            for step in sorted(steps):
                self._journal.append({"entry": "withdrawn", "step": step})
                self.pieces = tuple(piece for piece in self.pieces if piece.step != step)
            self._put_aside()
        self.write_session()
        return steps

    def write_session(self) -> None:
        """Write session.toml from the journal, in one atomic step."""
        if self.head is not None:
            write_whole(self.path / SESSION, session_text(self.head, self.pieces))
            with room(self.path):
                synchronise_names(self.path)

    def _check_empty(self, resume: bool) -> None:
        """Raise InputError for a folder with a run that is not resumed, or with readings but no journal."""
        if self._journal.entries and not resume:
            raise InputError(
                f"{self.path}: the folder contains a run. Continue it with `resume`, or choose an empty folder."
            )
        if not self._journal.entries and any((self.path / PIECES).glob("*.parquet")):
            raise InputError(
                f"{self.path}: {PIECES} contains readings, but {JOURNAL} is empty or missing. Restore it, or use another folder."
            )

    def _put_aside(self) -> None:
        """Move pieces without a line in the journal to `aside`, and check the sha256 of all other pieces."""
        for piece in self.pieces:
            path = self.path / piece.name
            if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != piece.sha256:
                raise InputError(
                    f"{path}: the readings of step {piece.step} are missing or were changed. "
                    "Restore the file, or use another folder."
                )
        piece_paths = {self.path / piece.name for piece in self.pieces}
        for path in sorted((self.path / PIECES).iterdir()):
            if path not in piece_paths:
                (self.path / ASIDE).mkdir(exist_ok=True)
                path.replace(_free(self.path / ASIDE / path.name))


def protocol_digest(protocol: Protocol) -> str:
    """Return a hash of a protocol, with numbers rounded to nine digits. It detects a change of protocol on `resume`."""
    fields = {
        name: float(f"{value:.9g}") if isinstance(value, float) else value for name, value in asdict(protocol).items()
    }
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def read_entries(path: Path, entries: tuple[dict[str, object], ...]) -> tuple[Head | None, tuple[RecordedDwell, ...]]:
    """Return the head and the dwells in a journal's entries."""
    if not entries:
        return None, ()
    try:
        first = dict(entries[0])
        if first.pop("entry") != "head" or first.pop("format") != FORMAT:
            raise ValueError("another format")
        pieces: list[RecordedDwell] = []
        for entry in entries[1:]:
            fields = dict(entry)
            kind = fields.pop("entry")
            if kind == "withdrawn":
                pieces = [piece for piece in pieces if piece.step != fields["step"]]
            elif kind == "dwell":
                pieces.append(RecordedDwell(**fields))  # type: ignore[arg-type]
            else:
                raise ValueError("another kind of entry")
        return Head(**first), tuple(pieces)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: expected the journal of a run, format {FORMAT}, got other entries ({error}). "
            "Read it with the undrift version that wrote it."
        ) from error


def session_text(head: Head, pieces: tuple[RecordedDwell, ...]) -> str:
    """Return the text of session.toml, with a recording per piece, a still per rest and a turn per achieved rate."""
    spans: list[StillEntry | TurnEntry] = []
    heated = any(piece.temp_c is not None for piece in pieces)  # then all faces have a temperature
    for number, piece in enumerate(pieces):
        measured_c = next((c for c in (piece.device_c, piece.temp_c, piece.chamber_c) if c is not None), None)
        span: dict[str, Any] = {"recording": number, "start_s": piece.start_s, "stop_s": piece.stop_s}
        span["temp_c"] = measured_c if heated else None
        if piece.angle is None and piece.purpose != "rate":
            spans.append(StillEntry(face=piece.up, **span))
        else:
            turn_rate = piece.turn_rate if piece.angle is None else None
            spans.append(TurnEntry(axis=piece.axis, turn_rate=turn_rate, angle=piece.angle, **span))
    about = HeadEntry(kind=head.kind, serial=head.serial, gravity_m_s2=head.gravity_m_s2)
    return sealed(session_toml(about, [{"file": piece.name, "sha256": piece.sha256} for piece in pieces], spans))


def _free(path: Path) -> Path:
    """Return a path that does not exist, with a number appended if necessary."""
    names = (path.with_name(f"{path.name}.{number}") for number in count(1))
    return next(free for free in chain((path,), names) if not free.exists())
