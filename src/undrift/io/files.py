"""Files as bytes: there or not, gzip or not, and their checksum."""

import gzip
import hashlib
import zlib
from pathlib import Path

from undrift.errors import FileFormatError, InputError

_GZIP = b"\x1f\x8b"
_BLOCK = 1 << 20


def checked_file(path: str | Path) -> Path:
    """Return the path of a file that exists and is not empty.

    Parameters
    ----------
    path : str or Path
        File to read.

    Returns
    -------
    Path
        The same, as a Path.

    Raises
    ------
    InputError
        Missing, a directory, empty, or not readable.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: wanted a file, got a directory; name the file in it")
        if not path.exists():
            raise InputError(f"{path}: wanted a file, got nothing of that name; check the path")
        if path.stat().st_size == 0:
            raise FileFormatError(f"{path}: wanted a recording, got an empty file; record or copy it again")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; check the path and its rights") from error
    return path


def is_gzip(path: str | Path) -> bool:
    """Tell whether a file is gzip by its first bytes.

    Parameters
    ----------
    path : str or Path
        File to look at.

    Returns
    -------
    bool
        True for gzip, whatever the suffix says.
    """
    with Path(path).open("rb") as handle:
        return handle.read(2) == _GZIP


def read_bytes(path: str | Path, limit: int = -1) -> bytes:
    """Return the content of a file, unpacked where it is gzip.

    Parameters
    ----------
    path : str or Path
        File, plain or gzip (told by content).
    limit : int
        At most so many bytes; -1 for all.

    Returns
    -------
    bytes
        Unpacked content.

    Raises
    ------
    InputError
        Missing, a directory, or not readable.
    FileFormatError
        Empty, or a gzip file that ends early or is damaged.
    """
    path = checked_file(path)
    try:
        if not is_gzip(path):
            with path.open("rb") as handle:
                return handle.read(limit)
        with gzip.open(path, "rb") as packed:
            content = packed.read(limit)
    except EOFError as error:
        raise FileFormatError(f"{path}: wanted a whole gzip file, got one that is cut off; copy it again") from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise FileFormatError(
            f"{path}: wanted a sound gzip file, got a damaged one ({error}); copy it again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; check its rights") from error
    if not content:
        raise FileFormatError(f"{path}: wanted a recording, got an empty file inside the gzip; record or copy it again")
    return content


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file as stored (packed files are not unpacked).

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    InputError
        Missing, a directory, or empty.
    """
    digest = hashlib.sha256()
    with checked_file(path).open("rb") as handle:
        while block := handle.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()
