"""What a file is, by its content first and its name only where the content does not say."""

import json
import zipfile
from pathlib import Path
from typing import Literal

from undrift.errors import FileFormatError, InputError
from undrift.io.c3d import is_c3d
from undrift.io.files import checked_file, read_bytes

Format = Literal[
    "csv", "parquet", "npz", "mat", "broad", "hdf5", "trc", "c3d", "apdm", "actigraph", "ngimu", "ximu", "ximu3", "session",
    "json", "toml", "text", "cwa", "nilspod", "binary",
]  # fmt: skip
_HEAD = 8192
_XIO: tuple[tuple[str, Format], ...] = (("Time (s)", "ngimu"), ("Timestamp (us)", "ximu3"), ("Packet number", "ximu"))
_PROSE = {".md", ".rst", ".pdf", ".html"}


def detect(path: str | Path) -> Format:
    """Return the format of a file or folder.

    Parameters
    ----------
    path : str or Path
        File, plain or gzip, or a folder of a session, NGIMU, x-IMU or x-IMU3.

    Returns
    -------
    str
        "csv" for any table of text, "text" for prose, "binary" for what nothing here knows.

    Raises
    ------
    InputError
        Missing, or a folder that is none of these.
    FileFormatError
        Empty, or a damaged gzip file.
    """
    path = Path(path)
    if path.is_dir():
        return _folder(path)
    head = read_bytes(checked_file(path), _HEAD)
    return _binary(path, head) or _text(path, head)


def _folder(path: Path) -> Format:
    if (path / "session.toml").is_file():
        return "session"
    if (path / "sensors.csv").is_file():
        return "ngimu"
    if (path / "Inertial.csv").is_file():
        return "ximu3"
    if any(path.glob("*_CalInertialAndMag.csv")):
        return "ximu"
    raise InputError(
        f"{path}: wanted a file, or a folder with session.toml, sensors.csv (NGIMU), Inertial.csv (x-IMU3) or "
        "*_CalInertialAndMag.csv (x-IMU), got another directory; name a file in it"
    )


def _binary(path: Path, head: bytes) -> Format | None:
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"PK\x03\x04"):
        return _zip(path)
    if head.startswith(b"MATLAB"):
        return "mat"
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return _hdf5(path)
    if head.startswith(b"MD") and path.suffix.lower() == ".cwa":
        return "cwa"
    if is_c3d(head) and b"POINT" in head:
        return "c3d"
    if b"\0" in head:
        return "nilspod" if path.suffix.lower() == ".bin" and head[0] >= 0x30 else "binary"
    return None


def _zip(path: Path) -> Format:
    try:
        with zipfile.ZipFile(path) as held:
            return "npz" if held.namelist() and all(name.endswith(".npy") for name in held.namelist()) else "binary"
    except zipfile.BadZipFile as error:
        raise FileFormatError(f"{path}: wanted a sound zip or npz file, got a damaged one; copy it again") from error


def _hdf5(path: Path) -> Format:
    from undrift.io.hdf5 import open_hdf5

    with open_hdf5(path) as held:
        if "imu_gyr" in held and "opt_quat" in held:
            return "broad"
        return "mat" if any("MATLAB_class" in held[name].attrs for name in held) else "hdf5"


def _text(path: Path, head: bytes) -> Format:
    text = head.decode("utf-8", "replace")
    lines = text.splitlines()
    suffix = Path(path.stem).suffix.lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if text.startswith("PathFileType"):
        return "trc"
    if "ActiGraph" in lines[0]:
        return "actigraph"
    if len(lines) > 2 and lines[2].startswith("Time,") and "/Acceleration/X" in lines[2]:
        return "apdm"
    if "Gyroscope X (deg/s)" in lines[0]:
        return next((kind for first, kind in _XIO if lines[0].startswith(first)), "csv")
    if suffix == ".json" or (lines[0].lstrip()[:1] in ("{", "[") and _is_json(path)):
        return "json"
    if suffix == ".toml":
        return "toml"
    if suffix in _PROSE:
        return "text"
    return "csv" if _is_table(lines) else "text"


def _is_json(path: Path) -> bool:
    try:
        json.loads(read_bytes(path))
    except (UnicodeDecodeError, json.JSONDecodeError):
        return False
    return True


def _is_table(lines: list[str]) -> bool:
    """Tell a table from prose: most of its lines have as many separators as each other, or it is a column of numbers."""
    body = [line for line in lines[1:64] if line.strip()][:-1] or lines
    for delimiter in (",", "\t", ";"):
        counts = [line.count(delimiter) for line in body]
        if max(counts) > 0 and counts.count(max(set(counts), key=counts.count)) > 0.8 * len(counts) and min(counts) > 0:
            return True
    return all(_numbers(line) for line in body)


def _numbers(line: str) -> bool:
    try:
        [float(cell) for cell in line.split()]
    except ValueError:
        return False
    return bool(line.strip())
