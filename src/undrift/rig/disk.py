"""Files of a run on the disk: brought there with their names, never over another, and what it means when it is full."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from undrift.errors import InputError


def synchronise(path: Path) -> None:
    """Bring a file and its name to the disk.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    OSError
        It cannot be.
    """
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
    synchronise_names(path.parent)


def synchronise_names(folder: Path) -> None:
    """Bring the names in a folder to the disk.

    Parameters
    ----------
    folder : Path
        Where they stand; without effect on systems that cannot open a folder.

    Raises
    ------
    OSError
        They cannot be.
    """
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def claim(path: Path) -> None:
    """Take a name for readings that are written next; never one that is taken.

    Parameters
    ----------
    path : Path
        Of the readings.

    Raises
    ------
    InputError
        Something is there; it is kept.
    OSError
        The name cannot be made.
    """
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
    except FileExistsError as error:
        raise InputError(
            f"{path}: wanted no readings of this step yet, got some, which are kept; another program wrote them: "
            "go on with --resume when it has ended"
        ) from error


@contextmanager
def room(path: Path) -> Iterator[None]:
    """Say what a full or broken disk means for the run.

    Parameters
    ----------
    path : Path
        Folder of the run.

    Yields
    ------
    None
        Once.

    Raises
    ------
    InputError
        The system said no within the block.
    """
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        what = "make room on the disk" if full else "mend the disk"
        raise InputError(
            f"{path}: wanted to write a dwell, got '{error.strerror or error}'; all dwells before it are kept: "
            f"{what} and go on with --resume"
        ) from error
