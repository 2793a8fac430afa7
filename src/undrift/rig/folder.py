"""Run folder: what a run leaves on the disk, at every moment a session that can be read.

    protocol.toml     what was asked for
    journal.jsonl     head, then a line for each dwell that is on the disk, or was taken back
    pieces/           0007.parquet: the readings of step 7
    session.toml      made from the journal after each dwell
    aside/            pieces that a crash left half written, or without a line in the journal, or that were taken back

A piece is written and synchronised first, then its line in the journal, then session.toml. What has no line was never done. A
line is {"length": 123, "crc32": "89abcdef", "entry": {...}}: length and checksum of the entry's text tell a line torn by a power
cut from a whole one. The checksum goes on from that of the line before, so that a line cannot be missing, twice, or in another
place. Only the last can be torn; one in the middle was damaged or edited, and is refused. session.toml states the sha256 of each
piece, and in its first line its own. One program at a time has a folder: its journal is locked, and the lock goes with the program
however it ends.
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

# ---- Journal: one line for each thing done, appended and brought to the disk before the next begins.

Entry = dict[str, Any]  # what JSON knows; the values of rig/folder.py are made of it
_LINE = re.compile(rb'\{"length":(\d{1,9}),"crc32":"[0-9a-f]{8}","entry":([^\0]*)\}\n')
_FIRST = zlib.crc32(b"journal")  # from which the first line's checksum goes on


class Journal:
    """An open journal; what was torn off by a crash is cut away when it is opened."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with ExitStack() as opened:
            # apart from the file that is written, which may have to be opened afresh
            self._lock = opened.enter_context(locked(path))
            self.entries, whole, self._sum = read_journal(path)
            self._file: BinaryIO = opened.enter_context(path.open("ab"))
            self._file.truncate(whole)
            self._file.seek(whole)
            self._sync()
            opened.pop_all()

    def append(self, entry: Entry) -> None:
        """Write an entry; it is on the disk when this returns, or not in the journal at all."""
        before = self._file.seek(0, os.SEEK_END)
        try:
            line, following = line_of(entry, self._sum)
            self._file.write(line)
            self._sync()
        except OSError:  # half a line is cut off; where even that fails, the checksum tells
            with suppress(OSError):  # the buffer is written again on closing, and fails again
                self._file.close()
            self._file = self.path.open("ab")
            os.truncate(self.path, before)
            raise
        self.entries, self._sum = (*self.entries, entry), following

    def close(self) -> None:
        """Close the file; harmless when called again."""
        try:
            self._file.close()
        finally:
            self._lock.close()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())


def locked(path: Path) -> BinaryIO:
    """Open a file that no other program has locked, and lock it; closing it, or the end of the program, lets go."""
    file = path.open("ab")
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(1 << 40)  # a byte far behind the end, so that the lines can still be read
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            take_lock(file.fileno())
    except OSError as error:
        file.close()
        raise InputError(
            f"{path.parent}: wanted a folder that no other program writes to, got one where a run is going on; "
            "wait for it or end it, or choose another folder"
        ) from error
    return file


def line_of(entry: Entry, before: int) -> tuple[bytes, int]:
    """Return an entry as a line, and its checksum, with which the checksum of the next line begins."""
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    crc = zlib.crc32(text, before)
    return b'{"length":%d,"crc32":"%08x","entry":%s}\n' % (len(text), crc, text), crc


def read_journal(path: Path) -> tuple[tuple[Entry, ...], int, int]:
    """Return the entries of a journal, where the last whole line ends, and the checksum with which the next line begins."""
    data = path.read_bytes() if path.exists() else b""
    entries: list[Entry] = []
    place = 0
    before = _FIRST
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        entry = _entry(line)
        whole, following = (b"", before) if entry is None else line_of(entry, before)
        if entry is None or line != whole:
            parts = _LINE.fullmatch(line)  # as long as it says: a power cut leaves less of it, or zeros in it
            complete = parts is not None and int(parts[1]) == len(parts[2])
            if place + len(line) < len(data) or complete or (entry is not None and line.endswith(b"\n")):
                raise FileFormatError(
                    f"{path}: line {number}: wanted a line as it was written after the one before, got another; restore the "
                    "file, or begin in another folder"
                )
            break
        entries.append(entry)
        place, before = place + len(line), following
    return tuple(entries), place, before


def _entry(line: bytes) -> Entry | None:
    """Return the entry of a line, None for a torn one."""
    try:
        entry = json.loads(line)["entry"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None


# ---- Files of a run on the disk: brought there with their names, never over another, and what it means when it is full.


def synchronise(path: Path) -> None:
    """Bring a file and its name to the disk."""
    _fsync(path, os.O_RDWR)
    synchronise_names(path.parent)


def synchronise_names(folder: Path) -> None:
    """Bring the names in a folder to the disk."""
    if os.name == "posix":
        _fsync(folder, os.O_RDONLY)


def _fsync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def claim(path: Path) -> None:
    """Create the empty file of readings that are written next; refuse a name that exists."""
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
    except FileExistsError as error:
        raise InputError(
            f"{path}: wanted no readings of this step yet, got some, which are kept; another program wrote them: "
            "continue with `resume` when it has ended"
        ) from error


@contextmanager
def room(path: Path) -> Iterator[None]:
    """Turn an OSError into an error that names the file and what to do."""
    try:
        yield
    except OSError as error:
        full = errno_of(error) in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        what = "make room on the disk" if full else "mend the disk"
        raise InputError(
            f"{path}: wanted to write a dwell, got '{error.strerror or error}'; all dwells before it are kept: "
            f"{what} and continue with `resume`"
        ) from error


# ---- folder

FORMAT = 1
JOURNAL, PIECES, ASIDE, PROTOCOL, SESSION = "journal.jsonl", "pieces", "aside", "protocol.toml", "session.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """What a run belongs to; the same for every part of it."""

    protocol: str  # sha256 of the protocol as it is written
    rig: str  # What the rig calls itself
    serial: str = ""  # Of the device
    gravity_m_s2: float | None = None  # Local gravity, m/s2, where it is stated
    kind: Kind = "calibration"  # calibration, or thermal where the chamber visits two temperatures or more


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedDwell:
    """A dwell that is on the disk."""

    step: int  # Of the programme
    purpose: Purpose  # face, bracket, rate or turn
    up: Face  # Device axis that points up
    axis: Axis | None  # Axis of the turn
    samples: int  # Readings
    start_s: float  # On the device's clock, s; the stop is left out
    stop_s: float
    nominal_turn_rate: float = 0.0  # As the protocol has it, rad/s
    set_turn_rate: float = 0.0  # As the controller rounded it, rad/s
    turn_rate: float = 0.0  # As the encoder measured it, rad/s
    turn_rate_uncertainty: float = 0.0  # Standard uncertainty of the last, rad/s
    temp_c: float | None = None  # Chamber set-point, degC
    chamber_c: float | None = None  # What the chamber read, degC
    device_c: float | None = None  # Mean of the device's own thermometer, degC; None where it has none
    angle: float | None = None  # Turned between two rests, as the operator or the rig stated it, rad
    missing: int = 0  # Readings that never came; gaps in the piece
    sha256: str = ""  # Of the file

    @property
    def name(self) -> str:
        """File, in the folder."""
        return f"{PIECES}/{self.step:04d}.parquet"


class RunFolder(AbstractContextManager["RunFolder"]):
    """The folder of a run that is going on; closes its journal at the end of a with block."""

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
                    f"{path}: wanted the protocol that the run began with, got another; compare it with {PROTOCOL} there"
                )
            if self.head is None:
                write_protocol(protocol, path / PROTOCOL)
            self._put_aside()
            with room(path):
                for place in (path / PIECES, path, path.parent):
                    synchronise_names(place)
        except BaseException:
            self._journal.close()
            raise

    def __exit__(self, *failure: object) -> None:
        self._journal.close()

    @property
    def done(self) -> frozenset[int]:
        """Steps that are on the disk."""
        return frozenset(piece.step for piece in self.pieces)

    def begin(self, head: Head) -> None:
        """State what the run belongs to, or check that it is the same as before."""
        if self.head is None:
            with room(self.path):
                self._journal.append({"entry": "head", "format": FORMAT, **asdict(head)})
            self.head = head
        for name, value in asdict(self.head).items():
            if value != getattr(head, name):
                raise InputError(
                    f"{self.path}: wanted the {name} that the run began with, '{value}', got '{getattr(head, name)}'; "
                    "continue the same, or begin in another folder"
                )
        if self.pieces:
            self.write_session()

    def keep(self, record: Record, piece: RecordedDwell) -> RecordedDwell:
        """Bring a dwell to the disk: readings, line, session."""
        path = self.path / piece.name
        with uninterrupted():  # Ctrl-C waits: readings, line and session belong together
            with room(self.path):
                claim(path)
                call_writer(partial(write_parquet, record), path)
                synchronise(path)
                kept = replace(piece, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
                self._journal.append({"entry": "dwell", **asdict(kept)})
            self.pieces = (*self.pieces, kept)
            self.write_session()
        return kept

    def withdraw(self, face: Face) -> frozenset[int]:
        """Take back the dwells with a face up: the journal says so, their readings go aside, the steps are to be done again."""
        steps = frozenset(piece.step for piece in self.pieces if piece.up == face)
        with uninterrupted(), room(self.path):
            for step in sorted(steps):
                self._journal.append({"entry": "withdrawn", "step": step})
                self.pieces = tuple(kept for kept in self.pieces if kept.step != step)
            self._put_aside()
        self.write_session()
        return steps

    def write_session(self) -> None:
        """Write session.toml from the journal, whole or not at all."""
        if self.head is not None:
            write_whole(self.path / SESSION, session_text(self.head, self.pieces))
            with room(self.path):
                synchronise_names(self.path)

    def _check_empty(self, resume: bool) -> None:
        """Refuse a run that is not resumed, and readings without their journal; a start that never came to a run left nothing."""
        if self._journal.entries and not resume:
            raise InputError(
                f"{self.path}: wanted an empty folder, got one with a run in it; continue it with `resume`, or choose another"
            )
        if not self._journal.entries and any((self.path / PIECES).glob("*.parquet")):
            raise InputError(
                f"{self.path}: wanted {JOURNAL} with the readings in {PIECES}, got it empty or missing; restore it, or begin in "
                "another folder"
            )

    def _put_aside(self) -> None:
        """Move what a crash left half written, or without a line in the journal, out of the way."""
        for piece in self.pieces:
            path = self.path / piece.name
            if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != piece.sha256:
                raise InputError(
                    f"{path}: wanted the readings of step {piece.step} as they were written, got them missing or changed; "
                    "restore the file, or begin in another folder"
                )
        known = {self.path / piece.name for piece in self.pieces}
        for path in sorted((self.path / PIECES).iterdir()):
            if path not in known:
                (self.path / ASIDE).mkdir(exist_ok=True)
                path.replace(_free(self.path / ASIDE / path.name))


def protocol_digest(protocol: Protocol) -> str:
    """Return a hash of a protocol, so that a run is not continued with another one; numbers count to nine digits."""
    fields = {
        name: float(f"{value:.9g}") if isinstance(value, float) else value for name, value in asdict(protocol).items()
    }
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def read_entries(path: Path, entries: tuple[dict[str, object], ...]) -> tuple[Head | None, tuple[RecordedDwell, ...]]:
    """Return what a journal's entries say."""
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
            f"{path}: wanted the journal of a run, format {FORMAT}, got other entries ({error}); "
            "read it with the undrift that wrote it"
        ) from error


def session_text(head: Head, pieces: tuple[RecordedDwell, ...]) -> str:
    """Return session.toml: each piece a recording, each rest a still, each rate a turn at the rate that was achieved."""
    stated: list[StillEntry | TurnEntry] = []
    heated = any(piece.temp_c is not None for piece in pieces)  # then faces at room temperature state it too
    for number, piece in enumerate(pieces):
        measured_c = next((c for c in (piece.device_c, piece.temp_c, piece.chamber_c) if c is not None), None)
        span: dict[str, Any] = {"recording": number, "start_s": piece.start_s, "stop_s": piece.stop_s}
        span["temp_c"] = measured_c if heated else None
        if piece.angle is None and piece.purpose != "rate":
            stated.append(StillEntry(face=piece.up, **span))
        else:
            turn_rate = piece.turn_rate if piece.angle is None else None
            stated.append(TurnEntry(axis=piece.axis, turn_rate=turn_rate, angle=piece.angle, **span))
    about = HeadEntry(kind=head.kind, serial=head.serial, gravity_m_s2=head.gravity_m_s2)
    return sealed(session_toml(about, [{"file": piece.name, "sha256": piece.sha256} for piece in pieces], stated))


def _free(path: Path) -> Path:
    """Return a name that is not taken."""
    names = (path.with_name(f"{path.name}.{number}") for number in count(1))
    return next(free for free in chain((path,), names) if not free.exists())
