"""Files appear whole or not at all: written beside their place, then moved into it."""

import os
import tempfile
from pathlib import Path

from undrift.errors import InputError


def write_whole(path: Path | str, content: bytes | str) -> None:
    """Write a file whole or not at all; one of that name is replaced.

    Parameters
    ----------
    path : Path or str
        Where to; its folder must exist.
    content : bytes or str
        Text is written as UTF-8.

    Raises
    ------
    InputError
        A folder or name that cannot be written to; no file is left behind.
    """
    path = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    except OSError as error:
        raise InputError(f"{path}: wanted a folder to write to, got {error.strerror}; choose another") from error
    part = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.chmod(0o644)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(
            f"{path}: wanted to write the file, got {error.strerror}; free the name or the disk"
        ) from error
