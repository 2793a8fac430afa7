"""describe: what a file holds, in one value. It answers for every file that exists and is not damaged."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import BoolArray
from undrift.errors import InputError
from undrift.io.arrays import Arrays, mat_arrays, npz_arrays
from undrift.io.broad import read_broad
from undrift.io.build import Built
from undrift.io.columns import ColumnMap, is_native
from undrift.io.csv import native_columns
from undrift.io.detect import Format, detect
from undrift.io.files import read_bytes
from undrift.io.guess import example_map, foreign_kind, result_of, sniff
from undrift.io.mapping import read_column_map
from undrift.io.markers import Up
from undrift.io.parquet import parquet_names
from undrift.io.recording import NOT_RECORDS, ReadSettings, read_built
from undrift.io.reference import native_reference, read_markers, read_reference
from undrift.io.session import read_session
from undrift.io.symptoms import find_symptoms, gaps_of
from undrift.record import Record, Reference
from undrift.units import SI_UNIT

_REGULAR = 0.005  # mean and usual rate that differ by less are one figure
_NEEDS = "needs a map with the true units, for example"


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What a file holds.

    Parameters
    ----------
    path : str
        The file or folder.
    kind : str
        recording, reference, markers, session, calibration, device, table (needs a map), results, settings,
        text or binary.
    format : str
        csv, parquet, npz, mat, broad, trc, c3d, apdm, ...
    summary : str
        One line: what it is, or what it needs to be read.
    rows : int or None
        Samples or frames.
    sample_rate_hz : float or None
        Samples over time, Hz: what is lost or uneven counts.
    usual_rate_hz : float or None
        Rate of the usual step, drop-outs left out, Hz; the same where every step is alike.
    duration_s : float or None
        s.
    columns : tuple of str
        Channels, markers, or column names.
    units : tuple of (str, str)
        Channel and unit.
    gaps : int
        Samples with a gap.
    temp_c : tuple of float, or None
        Lowest and highest temperature, degC.
    problems : tuple of str
        One sentence each.
    example : tuple of str
        Lines of the map that a table of foreign names may need, "?" where a person must say what is true.
    """

    path: str
    kind: str
    format: Format
    summary: str
    rows: int | None = None
    sample_rate_hz: float | None = None
    usual_rate_hz: float | None = None
    duration_s: float | None = None
    columns: tuple[str, ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    gaps: int = 0
    temp_c: tuple[float, float] | None = None
    problems: tuple[str, ...] = ()
    example: tuple[str, ...] = ()


def describe(
    path: str | Path, columns: ColumnMap | None = None, *, settings: ReadSettings | None = None, up: Up | None = None
) -> Description:
    """Say what a file holds.

    Parameters
    ----------
    path : str or Path
        Any file or folder.
    columns : ColumnMap or None
        For a table with foreign names; without it the answer says which map is needed.
    settings : ReadSettings or None
        Sample rate, sensor and gaps where the file leaves them unsaid.
    up : str or None
        For TRC; the heights of markers are not part of the answer, so it may be left out.

    Returns
    -------
    Description
        Kind, format, figures and problems.

    Raises
    ------
    InputError
        No such file, or a map that does not fit it.
    FileFormatError
        A damaged file.
    """
    path = Path(path)
    kind = detect(path)
    if kind in ("trc", "c3d"):
        return _markers(path, kind, up)
    if kind == "session":
        return _session(path)
    if kind in ("json", "toml"):
        return _settings(path, kind)
    if kind in ("text", "cwa", "nilspod", "binary", "hdf5") and columns is None:
        return _unread(path, kind)
    needs = None if columns is not None else _needs(path, kind, settings or ReadSettings())
    if isinstance(needs, Description):
        return needs
    built = read_built(path, columns, settings=settings)
    found = describe_record(built.record, path=str(path), kind=kind, built=built)
    if columns is None and kind in ("csv", "parquet"):
        names = sniff(path).names if kind == "csv" else parquet_names(path)
        unread = [name for name in names if name not in found.columns]
        if unread:
            problem = f"columns that are not undrift's own names were not read: {', '.join(unread[:12])}"
            found = replace(found, problems=(*found.problems, problem))
    return _with_optics(found, read_broad(path)[1]) if kind == "broad" else found


def describe_record(record: Record, *, path: str = "", kind: Format = "csv", built: Built | None = None) -> Description:
    """Say what a record holds.

    Parameters
    ----------
    record : Record
        Readings.
    path : str
        Where they came from.
    kind : str
        Format of that file.
    built : Built or None
        With the count of rows left out.

    Returns
    -------
    Description
        Of kind "recording".
    """
    dropped, repaired = (0, 0) if built is None else (built.dropped_rows, built.repaired_rows)
    mean, usual = mean_rate_hz(record), record.sample_rate_hz
    return Description(
        path=path,
        kind="recording",
        format=kind,
        summary=f"{len(record)} samples at {_told_rate(mean, usual)}, {record.duration_s:.6g} s"
        + (f", {record.device}" if record.device else ""),
        rows=len(record),
        sample_rate_hz=mean,
        usual_rate_hz=usual,
        duration_s=record.duration_s,
        columns=native_columns(record)[0],
        units=_units(record),
        gaps=gaps_of(record),
        temp_c=_temperatures(record),
        problems=find_symptoms(record, dropped_rows=dropped, repaired_rows=repaired),
    )


def mean_rate_hz(*records: Record) -> float:
    """Return samples over time, drop-outs and all.

    Parameters
    ----------
    records : Record
        One or more.

    Returns
    -------
    float
        Hz, all of them together.
    """
    return sum(len(record) - 1 for record in records) / sum(record.duration_s for record in records)


def _told_rate(mean: float, usual: float) -> str:
    if abs(mean / usual - 1.0) < _REGULAR:
        return f"{mean:.6g} Hz"
    return f"{mean:.4g} Hz on average (usual step {1e3 / usual:.4g} ms, {usual:.4g} Hz)"


def _temperatures(*records: Record) -> tuple[float, float] | None:
    """Return the lowest and the highest temperature, None where there is none."""
    seen = [t[np.isfinite(t)] for t in (record.temp_c for record in records) if t is not None]
    every = np.concatenate(seen) if seen else np.empty(0)
    return (float(every.min()), float(every.max())) if len(every) else None


def _units(record: Record) -> tuple[tuple[str, str], ...]:
    units = [("time", "s")]
    units += [] if record.gyro is None else [("gyro", record.gyro_unit)]
    units += [] if record.accel is None else [("accel", record.accel_unit)]
    units += [] if record.temp_c is None else [("temp", "degC")]
    units += [] if record.mag_ut is None else [("mag", "uT")]
    return tuple(units)


def _with_optics(found: Description, reference: Reference) -> Description:
    seen = 100.0 * float(reference.valid.mean())
    return replace(found, summary=f"{found.summary}, with optical poses ({seen:.1f} % seen, rest and motion together)")


def _needs(path: Path, kind: Format, settings: ReadSettings) -> Description | None:
    """Return the description of a file that cannot be read without more words, None where it can."""
    if kind == "ximu" and settings.sample_rate_hz is None:
        return _table(
            path, kind, (), "an x-IMU recording; needs its sample rate: give sample_rate_hz (256 as delivered)"
        )
    if kind == "apdm" and settings.sensor is None:
        from undrift.io.apdm import apdm_sensors

        held = apdm_sensors(path)
        if len(held) > 1:
            return _table(path, kind, held, f"APDM sensors {', '.join(held)}; needs the name of one of them as sensor")
    if kind in ("npz", "mat"):
        arrays = npz_arrays(path) if kind == "npz" else mat_arrays(path)
        return _of_names(path, kind, tuple(name for name, _ in arrays), arrays)
    if kind == "parquet":
        return _of_names(path, kind, parquet_names(path), ())
    return _text_table(path) if kind == "csv" else None


def _of_names(path: Path, kind: Format, names: tuple[str, ...], arrays: Arrays) -> Description | None:
    if native_reference(names) is not None:
        return _reference(path, kind)
    if is_native(names):
        return None
    shown = tuple(f"{name} {array.shape}" for name, array in arrays) or names
    threes = tuple(name for name, array in arrays if array.ndim == 2 and array.shape[1] == 3)
    example = example_map(names, arrays=threes)
    return _mapless(path, kind, shown, f"{len(names)} arrays or columns", example)


def _text_table(path: Path) -> Description | None:
    text = sniff(path)
    if native_reference(text.names) is not None:
        return _reference(path, "csv")
    if is_native(text.names):
        return None
    what = foreign_kind(text)
    if what is not None:
        return _table(path, "csv", text.names, what)
    named = f"{len(text.names)} columns" + ("" if text.layout.header else " without names")
    return _mapless(path, "csv", text.names, f"a table of {named}", example_map(text.names, text=text))


def _mapless(path: Path, kind: Format, names: tuple[str, ...], what: str, example: tuple[str, ...]) -> Description:
    return replace(_table(path, kind, names, f"{what}; {_NEEDS} {', '.join(example)}"), example=example)


def _table(path: Path, kind: Format, names: tuple[str, ...], summary: str) -> Description:
    return Description(path=str(path), kind="table", format=kind, summary=summary, columns=names, problems=(summary,))


def _reference(path: Path, kind: Format) -> Description:
    reference = read_reference(path)
    seen = int(reference.valid.sum())
    return Description(
        path=str(path),
        kind="reference",
        format=kind,
        summary=f"{len(reference)} poses at {reference.sample_rate_hz:.6g} Hz, {seen} seen",
        rows=len(reference),
        sample_rate_hz=reference.sample_rate_hz,
        duration_s=float(reference.time[-1] - reference.time[0]),
        gaps=len(reference) - seen,
    )


def _markers(path: Path, kind: Format, up: Up | None) -> Description:
    problems: tuple[str, ...] = ()
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if up is not None or "points up" not in str(error):
            raise
        markers = read_markers(path, up="z")
        problems = ('the file does not say which axis points up: state up = "y" or "z" to read it',)
    gap: BoolArray = np.any(np.isnan(markers.points), axis=2)
    never = [label for k, label in enumerate(markers.labels) if gap[:, k].all()]
    if never:
        problems = (*problems, f"never seen: {', '.join(never)}")
    return Description(
        path=str(path),
        kind="markers",
        format=kind,
        summary=f"{len(markers.labels)} markers, {len(markers)} frames at {markers.sample_rate_hz:.6g} Hz",
        rows=len(markers),
        sample_rate_hz=markers.sample_rate_hz,
        duration_s=float(markers.time[-1] - markers.time[0]),
        columns=markers.labels,
        units=(("position", SI_UNIT["length"]),),
        gaps=int(gap.any(axis=1).sum()),
        problems=problems,
    )


def _session(path: Path) -> Description:
    session = read_session(path)
    problems = tuple(
        f"recording {number}: {problem}"
        for number, record in enumerate(session.records)
        for problem in find_symptoms(record)
    )
    return Description(
        path=str(path),
        kind="session",
        format="session",
        summary=f"{session.kind} of {session.serial}: {_count(session.records, 'recording')}, "
        f"{_count(session.stills, 'still')}, {_count(session.turns, 'turn')}",
        rows=sum(len(record) for record in session.records),
        sample_rate_hz=mean_rate_hz(*session.records),
        usual_rate_hz=session.records[0].sample_rate_hz,
        duration_s=sum(record.duration_s for record in session.records),
        columns=native_columns(session.records[0])[0],
        units=_units(session.records[0]),
        gaps=sum(gaps_of(record) for record in session.records),
        temp_c=_temperatures(*session.records),
        problems=problems,
    )


def _settings(path: Path, kind: Format) -> Description:
    if kind == "toml":
        if path.name == "session.toml":
            return _session(path)
        try:
            columns = read_column_map(path)
        except InputError:
            return Description(path=str(path), kind="settings", format=kind, summary="TOML settings, not a column map")
        mapped = ", ".join(columns.mapped())
        return Description(path=str(path), kind="settings", format=kind, summary=f"a column map of {mapped}")
    try:
        held = json.loads(read_bytes(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: wanted JSON, got something else: {error}; repair the file") from error
    if isinstance(held, dict) and held.get("kind") == "undrift.calibration":
        return Description(
            path=str(path),
            kind="calibration",
            format=kind,
            summary=f"calibration of {held.get('device') or 'a device without a serial number'}, format {held.get('format')}",
        )
    if isinstance(held, dict) and held.get("kind") == "undrift.device":
        named = " ".join(str(held[key]) for key in ("name", "serial") if held.get(key)) or "without a name"
        return Description(
            path=str(path), kind="device", format=kind, summary=f"device model {named}, format {held.get('format')}"
        )
    result = result_of(held)
    if result:
        return Description(path=str(path), kind="results", format=kind, summary=result)
    names = (
        ", ".join(list(held)[:8])
        if isinstance(held, dict)
        else f"a list of {len(held)}"
        if isinstance(held, list)
        else "a value"
    )
    return Description(path=str(path), kind="settings", format=kind, summary=f"JSON, not a recording: {names}")


def _count(items: tuple[object, ...], what: str) -> str:
    return f"{len(items)} {what}{'s' * (len(items) != 1)}"


def _unread(path: Path, kind: Format) -> Description:
    what = "text" if kind == "text" else "binary"
    line = ""
    if kind == "text":
        first = next(
            (line for line in read_bytes(path, 4096).decode("utf-8", "replace").splitlines() if line.strip()), ""
        )
        line = f": {first.strip()[:60]}"
    return Description(path=str(path), kind=what, format=kind, summary=NOT_RECORDS[kind] + line)
