"""One door to every recording: the content of the file says which reader it takes."""

import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, read_bytes
from undrift.io.arrays import mat_arrays, npz_arrays, record_of_arrays
from undrift.io.columns import ColumnMap, Gaps
from undrift.io.mocap import is_c3d, read_broad
from undrift.io.record import Built, build_csv, write_csv
from undrift.io.store import CHUNK_ROWS, iter_parquet, read_parquet, write_parquet
from undrift.io.wearables import read_actigraph, read_apdm, read_ngimu, read_ximu, read_ximu3
from undrift.record import Record

# ---- What a file is, by its content first and its name only where the content does not say.

Format = Literal[
    "csv", "parquet", "npz", "mat", "broad", "hdf5", "trc", "c3d", "apdm", "actigraph", "ngimu", "ximu", "ximu3", "session",
    "json", "toml", "text", "cwa", "nilspod", "binary",
]  # fmt: skip
_HEAD = 8192
_XIO: tuple[tuple[str, Format], ...] = (("Time (s)", "ngimu"), ("Timestamp (us)", "ximu3"), ("Packet number", "ximu"))
_PROSE = {".md", ".rst", ".pdf", ".html"}


def detect(path: str | Path) -> Format:
    """Return the format of a file or folder."""
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
    from undrift.io.arrays import open_hdf5

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


# ---- formats

NOT_RECORDS: dict[Format, str] = {
    "trc": "marker trajectories; read them as a reference (labels of one rigid cluster, and which axis is up)",
    "c3d": "marker trajectories; read them as a reference (labels of one rigid cluster)",
    "cwa": "the binary of an Axivity logger; export it with OMGUI or open-movement to CSV (time, gyro dps, accel g, temperature)",
    "nilspod": "the binary of a NilsPod; export it with NilsPodLib to CSV",
    "binary": "binary data of an unknown kind; export it to CSV, MAT or npz",
    "hdf5": "HDF5 of an unknown kind; only BROAD trials and MATLAB 7.3 files are read",
    "text": "prose, not a table",
    "json": "JSON, not a recording",
    "toml": "settings, not a recording",
    "session": "a session of recordings; read it as a session",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadSettings:
    """What a file may leave unsaid."""

    sample_rate_hz: float | None = None  # Hz, for a file without a time column (undrift's own names, x-IMU)
    sensor: str | None = None  # Which sensor, in a file of several (APDM)
    # "raise" or "keep", whatever a map says; None: as the map says, and without one gaps are refused except in
    # Parquet that undrift wrote
    gaps: Gaps | None = None
    # For a text or Parquet table with undrift's own names: leave out rows whose time does not go forward
    repair_time: bool = False
    drop_bad_rows: bool = False  # For a text table with undrift's own names: leave out rows that do not parse


def read_record(path: str | Path, columns: ColumnMap | None = None, *, settings: ReadSettings | None = None) -> Record:
    """Read a recording of any known format.

    Parameters
    ----------
    path : str or Path
        Text table (plain or gzip), Parquet, npz, mat, BROAD HDF5, APDM, ActiGraph, or an NGIMU, x-IMU or x-IMU3 folder.
    columns : ColumnMap or None
        Which column is what; None where the format or undrift's own names say so.
    settings : ReadSettings or None
        Sample rate, sensor and gaps where the file leaves them unsaid.

    Returns
    -------
    Record
        Time in s; gyro and accel in the unit of the file or map.

    Raises
    ------
    InputError
        No such file; a file that needs a map, a rate or the name of a sensor; bad data.
    FileFormatError
        Not a recording, or a damaged one.
    """
    return read_built(path, columns, settings=settings).record


def read_built(path: str | Path, columns: ColumnMap | None = None, *, settings: ReadSettings | None = None) -> Built:
    """Read a recording and the count of rows left out."""
    settings, path = settings or ReadSettings(), Path(path)
    columns = _overruled(columns, settings)
    kind = detect(path)
    if kind in NOT_RECORDS and not (kind == "text" and columns is not None):
        raise FileFormatError(f"{path}: wanted a recording, got {NOT_RECORDS[kind]}")
    if columns is None and kind not in ("csv", "parquet") and (settings.repair_time or settings.drop_bad_rows):
        raise InputError(
            f"{path}: wanted a table of text or Parquet for repair_time and drop_bad_rows without columns, got {kind}; name the "
            "columns in the map, or leave these keys out"
        )
    if kind in ("npz", "mat"):
        arrays = npz_arrays(path) if kind == "npz" else mat_arrays(path)
        gaps = settings.gaps or "raise"
        return Built(record=record_of_arrays(arrays, path, columns, sample_rate_hz=settings.sample_rate_hz, gaps=gaps))
    if kind == "parquet":
        rate, repair = settings.sample_rate_hz, settings.repair_time
        return Built(record=read_parquet(path, columns, sample_rate_hz=rate, gaps=settings.gaps, repair_time=repair))
    if columns is not None or kind == "csv":
        return build_csv(
            path,
            columns,
            sample_rate_hz=settings.sample_rate_hz,
            gaps=settings.gaps or "raise",
            repair_time=settings.repair_time,
            drop_bad_rows=settings.drop_bad_rows,
        )
    return Built(record=_read_wearable(path, kind, settings))


def iter_record(
    path: str | Path, columns: ColumnMap | None = None, *, rows: int = CHUNK_ROWS, settings: ReadSettings | None = None
) -> Iterator[Record]:
    """Read a recording in chunks. Parquet streams in constant memory; other formats are read whole and handed out in parts."""
    settings = settings or ReadSettings()
    columns = _overruled(columns, settings)
    if detect(path) == "parquet":
        yield from iter_parquet(path, columns, rows=rows, gaps=settings.gaps, repair_time=settings.repair_time)
        return
    if rows < 2:
        raise InputError(f"rows: wanted two samples or more in a chunk, got {rows}")
    record = read_record(path, columns, settings=settings)
    start = 0
    while start < len(record):
        stop = start + rows if len(record) - start - rows >= 2 else len(record)
        yield record.part(start, stop)
        start = stop


def write_record(record: Record, path: str | Path) -> None:
    """Write a record as Parquet or CSV, by the name's ending.

    Parameters
    ----------
    record : Record
        Readings.
    path : str or Path
        NAME.parquet, NAME.csv or NAME.csv.gz.

    Raises
    ------
    InputError
        Another ending, or a file that cannot be written.
    """
    name = Path(path).name.lower()
    if name.endswith(".parquet"):
        write_parquet(record, path)
    elif name.endswith((".csv", ".csv.gz")):
        write_csv(record, path)
    else:
        raise InputError(f"{path}: wanted a name ending in .parquet, .csv or .csv.gz, got another; name the format so")


def _overruled(columns: ColumnMap | None, settings: ReadSettings) -> ColumnMap | None:
    """The map with the gaps that were asked for beside it."""
    return columns if columns is None or settings.gaps is None else replace(columns, gaps=settings.gaps)


def _read_wearable(path: Path, kind: Format, settings: ReadSettings) -> Record:
    if kind == "broad":
        return read_broad(path)[0]
    if kind == "apdm":
        return read_apdm(path, settings.sensor)
    if kind == "actigraph":
        return read_actigraph(path)
    if kind == "ngimu":
        return read_ngimu(path)
    if kind == "ximu3":
        return read_ximu3(path)
    if settings.sample_rate_hz is None:
        raise InputError(
            f"{path}: wanted the sample rate of this x-IMU recording, got none; give sample_rate_hz (--sample-rate-hz)"
        )
    return read_ximu(path, sample_rate_hz=settings.sample_rate_hz)
