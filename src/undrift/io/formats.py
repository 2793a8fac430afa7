"""The single entry point for all recordings. The content of a file determines its reader.

A format is a line of FORMATS. It names the function that recognises its files, the readers for Record, Markers or Reference. A
reader of recordings returns a table or a Record. Another package can add a format with the entry-point group ``undrift.formats``::

    [project.entry-points."undrift.formats"]
    logger = "their_package.logger:FORMAT"         # FORMAT = Format(recognise, record=read_logger)

Its module is imported only if no built-in format recognises a file.
"""

import json
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from undrift.errors import FileFormatError, InputError, check_type
from undrift.files import checked_file, read_bytes, read_tree, sound
from undrift.io.column_map import READ_SETTINGS, ColumnMap, TempFile, check_parts, is_native, naming, one_map
from undrift.io.columns import RawTable, ReadResult, build_record, in_seconds, is_date, is_number, with_temperature
from undrift.io.dialects import dialects
from undrift.io.labelled import is_labelled, read_labelled
from undrift.io.libraries import (
    is_nilspod,
    mat_arrays,
    read_logger,
    read_mat,
    read_nilspod,
    read_ros,
    read_ulog,
    read_xdf,
)
from undrift.io.log import is_log, log_text, read_log
from undrift.io.mocap import Markers, Up, is_c3d, pose_from_cluster, read_c3d, read_trc
from undrift.io.parquet import CHUNK_ROWS, iter_parquet, parquet_names, read_parquet
from undrift.io.phone import is_phone, is_phone_zip, read_phone, read_phone_zip, read_sensor_logger
from undrift.io.reference import (
    ReferenceMap,
    native_reference,
    poses_in,
    read_array_poses,
    read_parquet_poses,
    read_sto,
    read_text_poses,
)
from undrift.io.text import open_text, parse_text, read_csv
from undrift.io.write import write_record_as
from undrift.plugins import load_named, names_in
from undrift.record import Record, Reference
from undrift.units import canonical_unit, si_factor, temp_offset

GROUP = "undrift.formats"
_HEAD = 8192
_HDF5 = b"\x89HDF\r\n\x1a\n"
_PROSE = {".md", ".rst", ".pdf", ".html"}

Reader = Callable[[Path, ColumnMap], RawTable | Record]


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of file or folder."""

    recognise: Callable[[Path, bytes], bool]  # function of the path and the first 8 KiB, unpacked (b"" for a folder)
    record: Reader | None = None
    markers: Callable[[Path, Up | None], Markers] | None = None
    reference: Callable[[Path, ReferenceMap | None], Reference] | None = None
    bodies: Callable[[Path, str | None, Up | None], Reference] | None = None  # reader of one of several named bodies
    by_map: bool = False  # True if the record reader accepts the columns of a map
    instead: str = ""  # description of a file without a record reader, and advice
    generic: bool = False  # True if the format is tried after all others


def _line(head: bytes, number: int) -> str:
    """Return a line of text, or an empty string for binary data."""
    lines = [] if b"\0" in head else head.splitlines()[: number + 1]
    return lines[number].decode("utf-8", "replace") if number < len(lines) else ""


def _suffix(path: Path) -> str:
    return Path(path.name.lower().removesuffix(".gz")).suffix


def _is_zip_with(name: str) -> Callable[[Path, bytes], bool]:
    """Recognise a zip archive that contains a file with a name."""

    def recognised(path: Path, head: bytes) -> bool:
        if not head.startswith(b"PK\x03\x04"):
            return False
        with sound(path, "zip"), zipfile.ZipFile(path) as archive:
            return name in archive.namelist()

    return recognised


def _is_json(path: Path, head: bytes) -> bool:
    lines = [line.strip() for line in head.splitlines()[:2]]
    if _suffix(path) == ".json":  # lines that are JSON objects are a log, whatever the file name
        return len(lines) < 2 or not all(line.startswith(b"{") and line.endswith(b"}") for line in lines)
    if _line(head, 0).lstrip()[:1] not in ("{", "["):
        return False
    try:
        json.loads(read_tree(path))
    except (ValueError, RecursionError):
        return False
    return True


def _starts(mark: bytes) -> Callable[[Path, bytes], bool]:
    """Recognise a file by its first bytes."""
    return lambda _, head: head.startswith(mark)


def _has(pattern: bytes) -> Callable[[Path, bytes], bool]:
    """Recognise a text by a pattern at its start."""
    text = re.compile(pattern, re.MULTILINE)
    return lambda _, head: b"\0" not in head and text.search(head) is not None


def _foreign(recognise: Callable[[Path, bytes], bool]) -> Callable[[Path, bytes], bool]:
    """Recognise a text that undrift did not write."""

    def recognised(path: Path, head: bytes) -> bool:
        own = is_native(_line(head, 0).replace('"', "").split(","))
        return not own and recognise(path, head)

    return recognised


def _is_prose(path: Path, head: bytes) -> bool:
    """Return True for prose. In a table, most lines have the same number of separators or are numbers."""
    lines = [line for line in head.decode("utf-8", "replace").splitlines()[:64] if line.strip()]
    if _suffix(path) in _PROSE or not lines:
        return True
    body = lines[1:-1][len(lines) // 2 - 1 :] or lines  # lines of text may precede the rows
    for delimiter in (",", "\t", ";"):
        counts = [line.count(delimiter) for line in body]
        if min(counts) > 0 and counts.count(max(set(counts), key=counts.count)) > 0.8 * len(counts):
            return False
    return not all(is_number(cell) or is_date(cell) for line in body for cell in line.split())


_MARKERS = (
    "marker trajectories. Read them as a reference, with the labels of one rigid cluster and the axis that points up."
)
_BAGS = (b"#ROSBAG V2.0", b"SQLite format 3\0", b"\x89MCAP0\r\n")
_UNPACKED = "a zip archive or an Excel workbook. Unpack it and give the folder, or save the sheet as CSV."

FORMATS: dict[str, Format] = {
    "parquet": Format(_starts(b"PAR1"), record=read_parquet, reference=read_parquet_poses, by_map=True),
    "mat": Format(
        _starts(b"MATLAB"), record=read_mat, reference=lambda p, c: read_array_poses(mat_arrays(p), p, c), by_map=True
    ),
    "hdf5": Format(_starts(_HDF5), instead="HDF5. Create a frame from its arrays in Python and use Record.from_frame."),
    "npz": Format(
        lambda path, head: head.startswith(b"PK\x03\x04") and _suffix(path) == ".npz",
        instead="numpy arrays. In Python, create a frame from them and use Record.from_frame.",
    ),
    "cwa": Format(
        lambda path, head: head.startswith(b"MD") and (head[2:4] == b"\xfc\x03" or _suffix(path) == ".cwa"),
        record=read_logger,
    ),
    "geneactiv": Format(_starts(b"Device Identity"), record=read_logger),
    "gt3x": Format(_is_zip_with("log.bin"), record=read_logger),
    "gt3x_activity": Format(
        _is_zip_with("activity.bin"),
        instead="an ActiGraph file of the older layout (activity.bin), which no library reads. Export CSV with ActiLife.",
    ),
    "xdf": Format(_starts(b"XDF:"), record=read_xdf, by_map=True),
    "ros": Format(
        lambda path, head: head.startswith(_BAGS) or (not head and (path / "metadata.yaml").is_file()),
        record=read_ros,
    ),
    "ulog": Format(_starts(b"ULog\x01\x12\x35"), record=read_ulog),
    "nilspod": Format(lambda path, head: _suffix(path) == ".bin" and is_nilspod(head), record=read_nilspod),
    "c3d": Format(
        lambda _, head: b"POINT" in head and is_c3d(head),
        markers=read_c3d,
        instead="marker trajectories. Read them as a reference, with the labels of one rigid cluster.",
    ),
    "trc": Format(_starts(b"PathFileType"), markers=read_trc, instead=_MARKERS),
    "session": Format(
        lambda path, head: not head and (path / "session.toml").is_file(),
        instead="a session of recordings. Read it as a session.",
    ),
    "sensor_logger": Format(_has(rb"\Atime,seconds_elapsed,"), record=read_sensor_logger),
    "phone": Format(lambda path, head: not head and is_phone(path), record=read_phone),
    "phone_zip": Format(
        lambda path, head: head.startswith(b"PK\x03\x04") and is_phone_zip(path), record=read_phone_zip
    ),
    "sto": Format(
        _has(rb"^DataType *= *Quaternion[\s\S]*^endheader"),
        bodies=read_sto,
        instead="orientations. Read them as a reference.",
    ),
    "opensim": Format(
        _has(rb"^endheader\s*$"),
        instead="an OpenSim table of coordinates or forces of a model, not readings of a sensor. The reference for "
        "undrift validate is the .sto file of orientations (DataType=Quaternion).",
    ),
    # The shipped maps and the formats of other packages come here.
    "zip": Format(_starts(b"PK\x03\x04"), instead=_UNPACKED, generic=True),
    "json": Format(_is_json, instead="JSON, not a recording", generic=True),
    "toml": Format(lambda path, _: _suffix(path) == ".toml", instead="settings, not a recording", generic=True),
    "log": Format(
        _foreign(is_log),
        record=read_log,
        reference=lambda path, columns: poses_in(log_text(path), columns),
        by_map=True,
        generic=True,
    ),
    "binary": Format(
        lambda _, head: b"\0" in head, instead="binary data of an unknown kind. Export it to CSV.", generic=True
    ),
    "labelled": Format(_foreign(is_labelled), record=read_labelled, reference=read_text_poses, generic=True),
    "text": Format(_is_prose, instead="prose, not a table", generic=True),
    "csv": Format(lambda *_: True, record=read_csv, reference=read_text_poses, by_map=True, generic=True),
}


@cache
def outside_formats() -> Mapping[str, Format]:
    """Return the formats that other packages add."""
    formats: dict[str, Format] = {}
    for name in names_in({}, GROUP):
        try:
            formats[name] = load_named(name, {}, GROUP, Format)
        except Exception as error:  # noqa: BLE001 - another package may raise anything while it is imported
            warnings.warn(f"the format {name} of another package is not used: {error}", stacklevel=2)
    return formats


def _in_turn() -> Iterator[tuple[str, Format]]:
    """Yield the formats in the order in which they are tried. Formats of other packages are loaded only when needed."""
    yield from ((name, entry) for name, entry in FORMATS.items() if not entry.generic)
    for name, dialect in dialects().items():
        yield name, Format(dialect.recognises, record=dialect.read, reference=read_text_poses)
    yield from ((name, entry) for name, entry in outside_formats().items() if name not in FORMATS)
    yield from ((name, entry) for name, entry in FORMATS.items() if entry.generic)


def format_of(path: str | Path) -> tuple[str, Format]:
    """Return the format of a file or folder, and its name."""
    path = Path(path)
    head = b"" if path.is_dir() else read_bytes(checked_file(path), _HEAD)
    for name, entry in _in_turn():
        if (head or not entry.generic) and entry.recognise(path, head):
            return name, entry
    folders = ", ".join(f"{dialect.folder} ({dialect.maker})" for dialect in dialects().values() if dialect.folder)
    raise InputError(
        f"{path}: expected a file, or a folder with session.toml, {folders}, Gyroscope.csv and an accelerometer's (phone) or "
        "metadata.yaml (ROS 2), got another directory. Give a file in it."
    )


def detect(path: str | Path) -> str:
    """Return the name of the format of a file or folder."""
    return format_of(path)[0]


def read_record(path: str | Path, column_map: ColumnMap | None = None) -> Record:
    """Read a recording of any known format.

    Parameters
    ----------
    path : str or Path
        Text table (plain or gzip), Parquet, mat, a maker's export, XDF, ROS bag, PX4 ULog, Axivity, GENEActiv, GT3X, NilsPod, or an
        NGIMU, x-IMU, x-IMU3 or ROS 2 folder.
    column_map : ColumnMap or None
        Columns and units, if neither the format nor undrift's own names define them. Sample rate, sensor and gaps, if the file does
        not define them.

    Returns
    -------
    Record
        Record with time in s, and gyro and accel in the unit of the file or map.

    Raises
    ------
    InputError
        The file does not exist, needs a map, a rate or the name of a sensor, or contains bad data.
    FileFormatError
        The file is not a recording, or is damaged.

    Examples
    --------
    >>> import pathlib, tempfile, undrift
    >>> path = pathlib.Path(tempfile.mkdtemp(), "turn.csv")
    >>> rows = ("time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps", "0.00,0,0,90", "0.01,0,0,90", "0.02,0,0,90")
    >>> _ = path.write_text(chr(10).join(rows))
    >>> record = undrift.read_record(path)
    >>> len(record), record.gyro_unit, record.sample_rate_hz
    (3, 'dps', 100.0)
    """
    check_type(path, str | Path, "read_record: `path`")
    if column_map is not None:
        check_parts(column_map)
    return read_counted(path, column_map).record


def read_counted(path: str | Path, column_map: ColumnMap | None = None) -> ReadResult:
    """Read a recording and the number of omitted rows."""
    path, how = Path(path), one_map(column_map or READ_SETTINGS)
    name, entry = format_of(path)
    if how.columns and not entry.by_map and (entry.record or name == "text"):
        entry = FORMATS["csv"]  # a map makes a table of any text
    if entry.record is None:
        raise FileFormatError(f"{path}: expected a recording, got {entry.instead or name}")
    table = entry.record(path, how)
    if isinstance(table, RawTable):
        return settled(build_record(table, how), how)
    if how.repair_time or how.drop_bad_rows or how.clock == "regular":
        raise InputError(
            f"{path}: repair_time, drop_bad_rows and a regular clock require a table, got {name}. Omit these keys."
        )
    return settled(ReadResult(record=table), how)


def settled(result: ReadResult, how: ColumnMap) -> ReadResult:
    """Apply the omitted stretches and the thermometer of a map."""
    if how.leave_out:
        spans = ", ".join(f"{start:g} to {stop:g} s" for start, stop in how.leave_out)
        notes = (*result.notes, f"left out as specified: {spans}")
        result = replace(result, record=without(result.record, how.leave_out), notes=notes)
    if how.temp_file is None:
        return result
    note = f"temperature from {Path(how.temp_file.file).name}, interpolated onto the samples"
    return replace(result, record=_with_thermometer(result.record, how.temp_file), notes=(*result.notes, note))


def _with_thermometer(record: Record, thermometer: TempFile) -> Record:
    """Return the record with the temperature from the separate file of a thermometer."""
    dated = canonical_unit(thermometer.time_unit, "time") == "date"
    wanted = (thermometer.temp,) if dated else (thermometer.time, thermometer.temp)
    table = parse_text(open_text(thermometer.file, thermometer), wanted)
    table = in_seconds(table, thermometer.time) if dated else table
    time = table.numbers(thermometer.time) * si_factor(thermometer.time_unit, "time") + thermometer.shift_s
    unit = canonical_unit(thermometer.temp_unit, "temp")
    temp_c = table.numbers(thermometer.temp) * si_factor(unit, "temp") + temp_offset(unit)
    known = time[np.isfinite(time) & np.isfinite(temp_c)]
    if len(known) and (known.max() < record.time[0] or known.min() > record.time[-1]):
        raise InputError(
            f"{thermometer.file}: expected temperatures from {record.time[0]:.6g} to {record.time[-1]:.6g} s on the recording's "
            f"clock, got {known.min():.6g} to {known.max():.6g} s. Set temp_file.shift_s, in s."
        )
    with naming(thermometer.file):
        return with_temperature(record, time, temp_c)


def without(record: Record, stretches: Sequence[tuple[float, float]]) -> Record:
    """Return a record without some stretches, s on its clock. Stretches at the ends are cut off. Others become gaps."""
    time, out = record.time, np.zeros(len(record), dtype=np.bool_)
    for start, stop in stretches:
        out |= (among := (time >= start) & (time < stop))
        if not among.any():
            raise InputError(
                f"leave_out: expected a stretch within {time[0]:.6g} to {time[-1]:.6g} s, the time of the recording, "
                f"got {start:g} to {stop:g} s. Change it."
            )
    stays = np.flatnonzero(~out)
    if len(stays) < 2:
        raise InputError(f"leave_out: expected two remaining samples or more, got {len(stays)}. Leave out less.")
    channels = {name: getattr(record, name) for name in ("gyro", "accel", "temp_c", "mag_ut")}
    gaps: dict[str, Any] = {
        k: np.where(out if v.ndim == 1 else out[:, None], np.nan, v) for k, v in channels.items() if v is not None
    }
    return replace(record, **gaps).part(int(stays[0]), int(stays[-1]) + 1)


def is_streamed(path: str | Path, how: ColumnMap) -> bool:
    """Return True if a recording can be read in constant memory."""
    whole = how.temp_file or how.leave_out or how.clock == "regular" or how.is_dated()
    return detect(path) == "parquet" and not whole


def iter_record(path: str | Path, column_map: ColumnMap | None = None, *, rows: int = CHUNK_ROWS) -> Iterator[Record]:
    """Read a recording in chunks. Parquet is read in constant memory. Other formats are read whole and then split."""
    how = column_map or READ_SETTINGS
    if is_streamed(path, how):
        yield from iter_parquet(path, how, rows=rows)
        return
    if rows < 2:
        raise InputError(f"rows: expected two samples or more in a chunk, got {rows}")
    record = read_record(path, how)
    start = 0
    while start < len(record):
        stop = start + rows if len(record) - start - rows >= 2 else len(record)
        yield record.part(start, stop)
        start = stop


def write_record(record: Record, path: str | Path) -> None:
    """Write a record in the format that the name's ending selects.

    Parameters
    ----------
    record : Record
        Readings.
    path : str or Path
        NAME.parquet, NAME.csv or NAME.csv.gz (with frame, state and device in NAME.csv.json).

    Raises
    ------
    InputError
        The ending is unknown, or the file cannot be written.

    Examples
    --------
    >>> import numpy as np, pathlib, tempfile, undrift
    >>> record = undrift.Record(time=np.arange(3) / 100.0, gyro=np.zeros((3, 3)), gyro_unit="dps")
    >>> path = pathlib.Path(tempfile.mkdtemp(), "rest.parquet")
    >>> undrift.write_record(record, path)
    >>> len(undrift.read_record(path))
    3
    """
    write_record_as(record, Path(path))


def read_reference(
    path: str | Path,
    columns: ReferenceMap | None = None,
    *,
    labels: tuple[str, ...] | list[str] | None = None,
    up: Up | None = None,
) -> Reference:
    """Read poses of a body.

    Parameters
    ----------
    path : str or Path
        CSV, Parquet or mat with quaternions; OpenSim .sto, Xsens; markers in C3D or TRC.
    columns : ReferenceMap or None
        Map for foreign names, or None for undrift's own names.
    labels : tuple of str or None
        Markers of one rigid cluster (C3D and TRC), or the name of one body (.sto).
    up : str or None
        Laboratory axis that points up, "y" or "z". Required for TRC, and for C3D files that do not contain it.

    Returns
    -------
    Reference
        q_nb, position in m if there is one, and NaN in gaps.

    Raises
    ------
    InputError
        The file does not exist, markers have no labels or axis, columns are missing, or quaternions are invalid.
    FileFormatError
        The file is damaged, or of another kind.
    """
    path = Path(path)
    name, entry = format_of(path)
    if entry.markers is not None:
        markers = entry.markers(path, up)
        if not labels:
            raise InputError(
                f"{path}: expected the labels of one rigid cluster, got none. Set `labels` to three or more of "
                f"{', '.join(markers.labels)}."
            )
        return pose_from_cluster(markers, labels)
    if entry.bodies is not None:
        if labels is not None and len(labels) > 1:
            raise InputError(f"{path}: expected the name of one body, got {', '.join(labels)}. Choose one of them.")
        return entry.bodies(path, labels[0] if labels else None, up)
    if entry.reference is None:
        raise FileFormatError(f"{path}: expected poses (C3D, TRC, or a table with q_w, q_x, q_y, q_z), got {name}")
    return entry.reference(path, columns)


def holds_poses(path: str | Path) -> bool:
    """Return True if a recording with undrift's own names, in CSV or Parquet, also contains poses."""
    name, _ = format_of(path)
    names = parquet_names(path) if name == "parquet" else open_text(path).names if name == "csv" else ()
    return is_native(names) and native_reference(names) is not None


def read_markers(path: str | Path, *, up: Up | None = None) -> Markers:
    """Read marker trajectories from C3D or TRC."""
    name, entry = format_of(path)
    if entry.markers is None:
        raise FileFormatError(f"{path}: expected markers (C3D or TRC), got {name}. Check the path.")
    return entry.markers(Path(path), up)
