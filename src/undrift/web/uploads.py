"""Uploads from a browser: limited in size, type and name, and stored below one folder. Incomplete uploads are never
kept.

They are only stored here. They are read by a command in a separate process.
"""

import re
import secrets
import unicodedata
from pathlib import Path

from starlette.requests import ClientDisconnect, Request

from undrift.errors import InputError

KEPT = frozenset(" ._-+=,@()")  # characters allowed in a name, in addition to letters, marks and digits of any script
LONGEST = 200  # longest name, bytes in UTF-8 (file systems accept 255, and results add a suffix)
ENDING = re.compile(r"(\.[A-Za-z0-9]{1,8})?\.gz$|\.[A-Za-z0-9]{1,8}$|$", re.I)
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.I)  # names that Windows gives to devices
_NAMES = (
    "csv txt tsv parquet json toml mat h5 hdf5 c3d trc xdf ulg bag db3 "
    "mcap bin log gz zip bwx cwa gt3x mvnx edf npz sto data mot xlsx param params parm h"
)
ENDINGS = tuple(f".{name}" for name in _NAMES.split())  # of recordings, references, maps and calibrations


async def receive_upload(request: Request, folder: Path, largest_mb: float) -> Path:
    """Store the body of ``POST /upload?name=walk.csv`` in a folder of its own, and return the file. Raise InputError
    for a refused file, which is not kept.
    """
    name = safe_name(request.query_params.get("name", ""), "recording")
    if Path(name).suffix.lower() not in ENDINGS:
        raise InputError(
            f"upload: expected a recording ({', '.join(ENDINGS[:4])} ...), got '{name}'. Choose another file."
        )
    largest = int(largest_mb * 1e6)
    length = request.headers.get("content-length", "")
    if length.isdigit() and int(length) > largest:
        raise InputError(_too_large(name, largest_mb))
    place = folder / secrets.token_hex(6)  # names may repeat
    path, arriving, came = place / name, place / "sent.part", 0
    place.mkdir(parents=True)
    try:
        with arriving.open("xb") as file:
            async for piece in request.stream():
                came += len(piece)
                if came > largest:
                    raise InputError(_too_large(name, largest_mb))
                file.write(piece)
        if not came:
            raise InputError(f"upload: {name} is empty. Choose another file.")
        arriving.replace(path)
    except BaseException as error:
        arriving.unlink(missing_ok=True)
        place.rmdir()
        if isinstance(error, ClientDisconnect):
            raise InputError(f"upload: {name} is incomplete, got {came} bytes. Send it again.") from error
        raise
    return path


def _too_large(name: str, largest_mb: float) -> str:
    asking = "Send a part of it, or restart the bench with a larger --upload-mb"
    return f"upload: {name} is larger than {largest_mb:g} MB. {asking}."


def safe_name(text: str, otherwise: str) -> str:
    """Return a text as a file name, in any script, with its endings. The result is never a path, a hidden or a reserved
    name.
    """
    name = unicodedata.normalize("NFC", text.replace("\\", "/").rsplit("/", 1)[-1])
    name = re.sub("-+", "-", "".join(c if c in KEPT or unicodedata.category(c)[0] in "LMN" else "-" for c in name))
    ending = ENDING.search(name)[0]  # type: ignore[index]  # it may be empty
    stem = (
        name.removesuffix(ending).strip("-. ").encode()[: LONGEST - len(ending)].decode(errors="ignore").rstrip("-. ")
    )
    return ("_" if RESERVED.match(stem) else "") + (stem or otherwise) + ending
