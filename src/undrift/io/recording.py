"""One door to every recording: the content of the file says which reader it takes."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from undrift.errors import FileFormatError, InputError
from undrift.io.actigraph import read_actigraph
from undrift.io.apdm import read_apdm
from undrift.io.arrays import mat_arrays, npz_arrays, record_of_arrays
from undrift.io.broad import read_broad
from undrift.io.build import Built
from undrift.io.columns import ColumnMap, Gaps
from undrift.io.csv import build_csv, write_csv
from undrift.io.detect import Format, detect
from undrift.io.parquet import CHUNK_ROWS, iter_parquet, read_parquet, write_parquet
from undrift.io.xio import read_ngimu, read_ximu, read_ximu3
from undrift.record import Record

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
    """What a file may leave unsaid.

    Parameters
    ----------
    sample_rate_hz : float or None
        Hz, for a file without a time column (undrift's own names, x-IMU).
    sensor : str or None
        Which sensor, in a file of several (APDM).
    gaps : str or None
        "raise" or "keep", whatever a map says; None: as the map says, and without one gaps are refused except in Parquet that
        undrift wrote.
    repair_time : bool
        For a text or Parquet table with undrift's own names: leave out rows whose time does not go forward.
    drop_bad_rows : bool
        For a text table with undrift's own names: leave out rows that do not parse.
    """

    sample_rate_hz: float | None = None
    sensor: str | None = None
    gaps: Gaps | None = None
    repair_time: bool = False
    drop_bad_rows: bool = False


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
    """Read a recording and the count of rows left out.

    Parameters
    ----------
    path : str or Path
        As for :func:`read_record`.
    columns : ColumnMap or None
        Likewise.
    settings : ReadSettings or None
        Likewise.

    Returns
    -------
    Built
        Record, dropped and repaired rows.

    Raises
    ------
    InputError
        As :func:`read_record`.
    """
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
    """Read a recording in chunks. Parquet streams in constant memory; other formats are read whole and handed out in parts.

    Parameters
    ----------
    path : str or Path
        As for :func:`read_record`.
    columns : ColumnMap or None
        Likewise.
    rows : int
        Samples in a chunk, two or more.
    settings : ReadSettings or None
        Likewise.

    Yields
    ------
    Record
        Chunks in order of time, two samples or more each.

    Raises
    ------
    InputError
        As :func:`read_record`.
    """
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
