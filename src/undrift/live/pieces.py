"""Pieces: records on the disk, each whole and synced before it counts; what was cut off is left aside by its name.

``live-01-00001.parquet`` is the first piece of the first connection recorded into a folder. A file that was under way when the
power went ends with ``.part`` and is never read.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from undrift.errors import InputError
from undrift.io.parquet import read_parquet, write_parquet
from undrift.record import Record

NAME = re.compile(r"live-(\d{2,})-(\d{5,})\.parquet")


def write_synced(record: Record, path: Path | str) -> None:
    """Write a record so that it survives a power cut once this returns.

    Parameters
    ----------
    record : Record
        Readings.
    path : Path or str
        Parquet file; it appears whole or not at all.

    Raises
    ------
    InputError
        The disk is full or the folder cannot be written to.
    """
    path = Path(path)
    part = path.with_name(path.name + ".new.part")
    try:
        write_parquet(record, part)
        _sync(part)
        part.replace(path)
        _sync(path.parent)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise InputError(f"{path}: wanted to write readings, got '{reason}'; free the disk or the folder") from error


def next_connection(folder: Path | str) -> int:
    """Return the number of the next connection to be recorded into a folder.

    Parameters
    ----------
    folder : Path or str
        May hold pieces.

    Returns
    -------
    int
        1 for an empty one.
    """
    return max((int(found.group(1)) for found in map(NAME.fullmatch, _names(folder)) if found), default=0) + 1


def piece_path(folder: Path | str, connection: int, piece: int) -> Path:
    """Return where a piece is written.

    Parameters
    ----------
    folder : Path or str
        The recording's.
    connection, piece : int
        From 1.

    Returns
    -------
    Path
        The file.
    """
    return Path(folder) / f"live-{connection:02d}-{piece:05d}.parquet"


def iter_pieces(folder: Path | str, connection: int = 1) -> Iterator[Record]:
    """Read the pieces of one connection in their order.

    Parameters
    ----------
    folder : Path or str
        The recording's.
    connection : int
        From 1.

    Yields
    ------
    Record
        One piece.
    """
    for name in sorted(_names(folder)):
        found = NAME.fullmatch(name)
        if found and int(found.group(1)) == connection:
            yield read_parquet(Path(folder) / name)


def read_pieces(folder: Path | str, connection: int = 1) -> Record:
    """Read one connection as one record.

    Parameters
    ----------
    folder : Path or str
        The recording's.
    connection : int
        From 1.

    Returns
    -------
    Record
        All of its pieces.

    Raises
    ------
    InputError
        There is none.
    """
    pieces = list(iter_pieces(folder, connection))
    if not pieces:
        raise InputError(f"{folder}: wanted pieces of connection {connection}, got none; check folder and number")

    def joined(name: str) -> object:
        parts = [getattr(piece, name) for piece in pieces]
        return None if parts[0] is None else np.concatenate(parts)

    channels = {name: joined(name) for name in ("time", "gyro", "accel", "temp_c", "mag_ut")}
    return replace(pieces[0], **channels)  # type: ignore[arg-type]


def _names(folder: Path | str) -> list[str]:
    return [path.name for path in Path(folder).iterdir()] if Path(folder).is_dir() else []


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
