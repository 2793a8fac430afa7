"""Run folder: the files of a run, which form a readable session at any time.

    protocol.toml     protocol of the run
    pieces/           0007.parquet: the readings of step 7
    session.toml      the session, with the journal of the run in its table [run]
    aside/            pieces that session.toml does not list
    lock              locked while a run writes to the folder

A piece is written to the disk first. Then session.toml is replaced in one atomic step, so a dwell is either complete or not done.
session.toml contains the sha256 of each piece, and its first line contains its own sha256. `resume` refuses a file that was changed
later, and repeats a dwell whose file was deleted.
"""

import hashlib
import os
import tomllib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from undrift.errors import FileFormatError, InputError
from undrift.files import is_full, sha256_of, take_lock, write_whole
from undrift.io.parquet import write_parquet
from undrift.io.session import HeadEntry, StillEntry, TurnEntry, in_degrees, sealed, session_toml
from undrift.programme import Protocol, Purpose, write_protocol
from undrift.record import Axis, Face, Kind, Record

FORMAT = 1
PIECES, ASIDE, PROTOCOL, SESSION, LOCK = "pieces", "aside", "protocol.toml", "session.toml", "lock"


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Identity of a run, which is the same after every `resume`."""

    protocol: str  # sha256 of the protocol
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
    axis: Axis | None = None  # axis of the turn
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
    """The folder of a run in progress, a context manager that unlocks the folder at the end."""

    def __init__(self, path: Path, protocol: Protocol, *, resume: bool = False) -> None:
        self.path, self.digest = path, protocol_digest(protocol)
        self.head: Head | None = None
        self.pieces: tuple[RecordedDwell, ...] = ()
        with disk_errors(path):
            (path / PIECES).mkdir(parents=True, exist_ok=True)
            self._lock = (path / LOCK).open("ab")
        try:
            try:
                take_lock(self._lock.fileno())
            except OSError as error:
                raise InputError(
                    f"{path}: another run is writing to this folder. Wait for that run, end it, or choose another folder."
                ) from error
            with disk_errors(path):
                self._open(protocol, resume)
        except BaseException:
            self._lock.close()
            raise

    def __exit__(self, *failure: object) -> None:
        self._lock.close()

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the steps that are on the disk."""
        return frozenset(piece.step for piece in self.pieces)

    def begin(self, head: Head) -> None:
        """Set the head of a new run, or raise InputError if a resumed run has another head."""
        self.head = self.head or head
        for name, value in asdict(self.head).items():
            if value != getattr(head, name):
                raise InputError(
                    f"{self.path}: the run began with {name} '{value}', got '{getattr(head, name)}'. "
                    "Continue with this value, or use another folder."
                )

    def keep(self, record: Record, piece: RecordedDwell) -> RecordedDwell:
        """Write a dwell to the disk: its readings, then session.toml. Return the dwell with the sha256 of its file."""
        if self.head is None:
            raise InputError("run folder: a dwell requires the head of the run. Call begin first.")
        path = self.path / piece.name
        if path.exists():
            raise InputError(
                f"{path}: readings of this step exist and are kept. Another program wrote them. Continue with `resume` when "
                "that program has ended."
            )
        with disk_errors(path):
            write_parquet(record, path)
            synchronise(path.parent)
            written = replace(piece, sha256=sha256_of(path))
            write_whole(self.path / SESSION, session_text(self.head, (*self.pieces, written)))
            synchronise(self.path)
        self.pieces = (*self.pieces, written)
        return written

    def _open(self, protocol: Protocol, resume: bool) -> None:
        """Read the dwells on the disk, and write the protocol of a new run."""
        path = self.path
        if not resume and ((path / SESSION).exists() or any((path / PIECES).iterdir())):
            raise InputError(
                f"{path}: the folder contains a run. Continue it with `resume`, or choose an empty folder."
            )
        self.head, pieces = read_journal(path / SESSION)
        if self.head is None:
            write_protocol(protocol, path / PROTOCOL)
        elif self.head.protocol != self.digest:
            raise InputError(
                f"{path}: the protocol differs from the protocol with which the run began. Compare it with {PROTOCOL} there."
            )
        self.pieces = tuple(piece for piece in pieces if (path / piece.name).exists())
        self._check_pieces()
        for folder in (path / PIECES, path, path.parent):
            synchronise(folder)

    def _check_pieces(self) -> None:
        """Raise InputError for a piece that was changed, and move pieces that session.toml does not list to `aside`."""
        for piece in self.pieces:
            path = self.path / piece.name
            if sha256_of(path) != piece.sha256:
                raise InputError(
                    f"{path}: the readings of step {piece.step} were changed. Restore the file, or delete it to repeat the dwell."
                )
        listed = {self.path / piece.name for piece in self.pieces}
        for path in sorted({*(self.path / PIECES).iterdir()} - listed):
            (self.path / ASIDE).mkdir(exist_ok=True)
            names = (path.name, *(f"{path.name}.{number}" for number in range(1, 1000)))
            path.replace(next(free for name in names if not (free := self.path / ASIDE / name).exists()))


def protocol_digest(protocol: Protocol) -> str:
    """Return a hash of a protocol, which detects a change of protocol on `resume`."""
    return hashlib.sha256(protocol.model_dump_json().encode()).hexdigest()


# ---- session.toml, which is also the journal.


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
            rate_dps, angle_deg = in_degrees(turn_rate), in_degrees(piece.angle)
            spans.append(TurnEntry(axis=piece.axis, turn_rate_dps=rate_dps, angle_deg=angle_deg, **span))
    about = HeadEntry(kind=head.kind, serial=head.serial, gravity_m_s2=head.gravity_m_s2)
    session = session_toml(about, [{"file": piece.name, "sha256": piece.sha256} for piece in pieces], spans)
    dwells = [{name: value for name, value in asdict(piece).items() if value is not None} for piece in pieces]
    identity = {name: value for name, value in asdict(head).items() if value is not None}
    return sealed(f"{session}\n{tomli_w.dumps({'run': {'format': FORMAT, **identity, 'dwell': dwells}})}")


def read_journal(path: Path) -> tuple[Head | None, tuple[RecordedDwell, ...]]:
    """Return the head of a run and its dwells from session.toml, or None and no dwells if the file does not exist."""
    if not path.exists():
        return None, ()
    try:
        text = path.read_text(encoding="utf-8")
        if sealed(text.partition("\n")[2]) != text:
            raise ValueError("it was changed after the run wrote it")
        table = tomllib.loads(text)["run"]
        if table.pop("format") != FORMAT:
            raise ValueError("it has another format")
        dwells = tuple(RecordedDwell(**dwell) for dwell in table.pop("dwell"))
        return Head(**table), dwells
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: not the session of a run, format {FORMAT} ({error}). Restore the file, or use another folder."
        ) from error


# ---- Files: synchronised, with an error message for a full disk.


def synchronise(folder: Path) -> None:
    """Flush the names in a folder to the disk."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Convert an error of the disk to an InputError with the path and advice."""
    try:
        yield
    except (OSError, InputError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError):
            raise
        advice = "Free space on the disk" if is_full(cause) else "Check the disk"
        raise InputError(
            f"{path}: cannot write a dwell ({cause.strerror or cause}). All earlier dwells are kept. "
            f"{advice} and continue with `resume`."
        ) from cause
