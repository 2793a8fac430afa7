"""Run folder: what a run leaves on the disk, at every moment a session that can be read.

    protocol.toml     what was asked for
    journal.jsonl     head, then a line for each dwell that is on the disk
    pieces/           0007.parquet: the readings of step 7
    session.toml      made from the journal after each dwell
    aside/            pieces that a crash left half written, or without a line in the journal

A piece is written and synchronised first, then its line in the journal, then session.toml. What has no line was never done.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from undrift.errors import FileFormatError, InputError
from undrift.files import write_whole
from undrift.io.parquet import write_parquet
from undrift.io.protocol import write_protocol
from undrift.protocol import Protocol
from undrift.record import Record
from undrift.rig.disk import claim, room, synchronise, synchronise_names
from undrift.rig.journal import Journal
from undrift.rig.programme import Purpose
from undrift.rig.signals import uninterrupted
from undrift.session import Axis, Face, Kind
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

FORMAT = 1
JOURNAL, PIECES, ASIDE, PROTOCOL, SESSION = "journal.jsonl", "pieces", "aside", "protocol.toml", "session.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """What a run is of; the same for every part of it.

    Parameters
    ----------
    protocol : str
        sha256 of the protocol as it is written.
    rig : str
        What the rig calls itself.
    serial : str
        Of the device.
    gravity_m_s2 : float
        Local gravity, m/s2.
    kind : str
        calibration, or thermal where the chamber visits two temperatures or more.
    """

    protocol: str
    rig: str
    serial: str = ""
    gravity_m_s2: float = STANDARD_GRAVITY
    kind: Kind = "calibration"


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A dwell that is on the disk.

    Parameters
    ----------
    step : int
        Of the programme.
    purpose : str
        face, bracket or rate.
    up : str
        Device axis that points up.
    axis : str or None
        Axis of the turn.
    samples : int
        Readings.
    start_s, stop_s : float
        On the device's clock, s; the stop is left out.
    nominal_turn_rate, set_turn_rate, turn_rate : float
        As the protocol has it, as the controller rounded it, as the encoder measured it: rad/s.
    turn_rate_uncertainty : float
        Standard uncertainty of the last, rad/s.
    temp_c : float or None
        Chamber set-point, degC.
    chamber_c : float or None
        What the chamber read, degC.
    device_c : float or None
        Mean of the device's own thermometer, degC; None where it has none.
    missing : int
        Readings that never came; gaps in the piece.
    sha256 : str
        Of the file.
    """

    step: int
    purpose: Purpose
    up: Face
    axis: Axis | None
    samples: int
    start_s: float
    stop_s: float
    nominal_turn_rate: float = 0.0
    set_turn_rate: float = 0.0
    turn_rate: float = 0.0
    turn_rate_uncertainty: float = 0.0
    temp_c: float | None = None
    chamber_c: float | None = None
    device_c: float | None = None
    missing: int = 0
    sha256: str = ""

    @property
    def name(self) -> str:
        """File, in the folder."""
        return f"{PIECES}/{self.step:04d}.parquet"


class RunFolder:
    """The folder of a run that is going on; closes its journal at the end of a with block.

    Parameters
    ----------
    path : Path
        Made where it is missing.
    protocol : Protocol
        What is asked for.
    resume : bool
        Go on with what a run before left here; without it the folder must hold none.

    Raises
    ------
    InputError
        Another program writes here; a run is here and ``resume`` is not said; another protocol; readings without their journal;
        a disk that is full or cannot be written.
    FileFormatError
        A damaged journal, or one of another version.
    """

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
            self.put_aside()
            with room(path):
                for place in (path / PIECES, path, path.parent):
                    synchronise_names(place)
        except BaseException:
            self._journal.close()
            raise

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, *failure: object) -> None:
        self._journal.close()

    @property
    def done(self) -> frozenset[int]:
        """Steps that are on the disk."""
        return frozenset(piece.step for piece in self.pieces)

    def begin(self, head: Head) -> None:
        """Say what the run is of, or check that it is the same as before.

        Parameters
        ----------
        head : Head
            Of this part.

        Raises
        ------
        InputError
            Another rig, device or gravity than before; a full disk.
        """
        if self.head is None:
            with room(self.path):
                self._journal.append({"entry": "head", "format": FORMAT, **asdict(head)})
            self.head = head
        for name, value in asdict(self.head).items():
            if value != getattr(head, name):
                raise InputError(
                    f"{self.path}: wanted the {name} that the run began with, '{value}', got '{getattr(head, name)}'; "
                    "go on with the same, or begin in another folder"
                )
        if self.pieces:
            self.write_session()

    def keep(self, record: Record, piece: Piece) -> Piece:
        """Bring a dwell to the disk: readings, line, session.

        Parameters
        ----------
        record : Record
            Readings.
        piece : Piece
            What they are of; the sha256 is filled in here.

        Returns
        -------
        Piece
            As it stands in the journal.

        Raises
        ------
        InputError
            The disk is full or cannot be written, or readings of that step lie there; all dwells before are kept.
        """
        path = self.path / piece.name
        with uninterrupted():  # Ctrl-C waits: readings, line and session belong together
            with room(self.path):
                claim(path)
                write_parquet(record, path)
                synchronise(path)
                kept = replace(piece, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
                self._journal.append({"entry": "dwell", **asdict(kept)})
            self.pieces = (*self.pieces, kept)
            self.write_session()
        return kept

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
                f"{self.path}: wanted an empty folder, got one with a run in it; go on with it by --resume, or choose another"
            )
        if not self._journal.entries and any((self.path / PIECES).glob("*.parquet")):
            raise InputError(
                f"{self.path}: wanted {JOURNAL} with the readings in {PIECES}, got it empty or missing; restore it, or begin in "
                "another folder"
            )

    def put_aside(self) -> tuple[Path, ...]:
        """Move what a crash left half written, or without a line in the journal, out of the way.

        Returns
        -------
        tuple of Path
            Where it is now.

        Raises
        ------
        InputError
            A piece of the journal is missing or changed.
        """
        for piece in self.pieces:
            path = self.path / piece.name
            if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != piece.sha256:
                raise InputError(
                    f"{path}: wanted the readings of step {piece.step} as they were written, got them missing or changed; "
                    "restore the file, or begin in another folder"
                )
        known = {self.path / piece.name for piece in self.pieces}
        moved = []
        for path in sorted((self.path / PIECES).iterdir()):
            if path not in known:
                (self.path / ASIDE).mkdir(exist_ok=True)
                moved.append(path.replace(_free(self.path / ASIDE / path.name)))
        return tuple(moved)


def protocol_digest(protocol: Protocol) -> str:
    """Return what tells a protocol from another.

    Parameters
    ----------
    protocol : Protocol
        What to do.

    Returns
    -------
    str
        sha256 of its fields; rates to 12 digits, as a file keeps them.
    """
    fields = {
        name: float(f"{value:.9g}") if isinstance(value, float) else value for name, value in asdict(protocol).items()
    }
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def read_entries(path: Path, entries: tuple[dict[str, object], ...]) -> tuple[Head | None, tuple[Piece, ...]]:
    """Return what a journal's entries say.

    Parameters
    ----------
    path : Path
        Of the journal, for messages.
    entries : tuple of dict
        Head first.

    Returns
    -------
    head : Head or None
        None for an empty journal.
    pieces : tuple of Piece
        In the order in which they were done.

    Raises
    ------
    FileFormatError
        Entries of another version, or others than these.
    """
    if not entries:
        return None, ()
    try:
        first = dict(entries[0])
        if (first.pop("entry"), first.pop("format")) != ("head", FORMAT):
            raise ValueError("another format")
        pieces = []
        for entry in entries[1:]:
            fields = dict(entry)
            if fields.pop("entry") != "dwell":
                raise ValueError("another kind of entry")
            pieces.append(Piece(**fields))  # type: ignore[arg-type]
        return Head(**first), tuple(pieces)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: wanted the journal of a run, format {FORMAT}, got other entries ({error}); "
            "read it with the undrift that wrote it"
        ) from error


def session_text(head: Head, pieces: tuple[Piece, ...]) -> str:
    """Return session.toml: each piece a recording, each rest a still, each rate a turn at the rate that was achieved.

    The temperature of a piece is the mean that the device's thermometer read; the set-point only where it has none.

    Parameters
    ----------
    head : Head
        Device and place.
    pieces : tuple of Piece
        What is on the disk.

    Returns
    -------
    str
        TOML.
    """
    lines = ["[session]", f'kind = "{head.kind}"', f"serial = {json.dumps(head.serial)}"]
    lines += [f"gravity_m_s2 = {head.gravity_m_s2!r}"]
    for piece in pieces:
        lines += ["", "[[recording]]", f'file = "{piece.name}"']
    for number, piece in enumerate(pieces):
        span = [f"recording = {number}", f"start_s = {piece.start_s!r}", f"stop_s = {piece.stop_s!r}"]
        temp_c = piece.temp_c if piece.device_c is None else piece.device_c
        span += [] if piece.temp_c is None else [f"temp_c = {temp_c!r}"]
        if piece.purpose == "rate":
            dps = piece.turn_rate / RADIAN_PER_DEGREE
            lines += ["", "[[turn]]", *span, f'axis = "{piece.axis}"', f"turn_rate_dps = {dps!r}"]
        else:
            lines += ["", "[[still]]", *span, f'face = "{piece.up}"']
    return "\n".join(lines) + "\n"


def _free(path: Path) -> Path:
    """Return a name that is not taken."""
    number = 0
    free = path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}.{number}")
    return free
