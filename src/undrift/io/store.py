"""Parquet, undrift's own format: names carry the unit, the schema carries frame, state and device.

The schema metadata holds one key, ``undrift``: ``{"kind": "undrift.record", "format": 1, "gyro_unit": "dps", "accel_unit": "g",
"frame": "s", "state": "raw", "device": "MTi-1"}``. Files of any size are read and written in chunks of constant memory.

Calibration files: calibration.json, one object, kind "undrift.calibration", format 1.

Numbers are written so that they read back to the last bit. NaN is null; infinity, which JSON does not know, is "inf" or "-inf".
A file is written whole or not at all: into a temporary neighbour first, which then takes its name.

The calibration file in pydantic models: every key, its type and its shape. The JSON Schema is made from them.

null stands for NaN; infinity, which JSON does not know, is "inf" or "-inf" where it can occur. A key with a default is written
only where it says something, so that a file without it reads everywhere.
"""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, ValidationError

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, write_whole
from undrift.findings import CATALOGUE, Level, finding
from undrift.io.columns import ColumnMap, Gaps, native_map
from undrift.io.record import build_record, native_columns
from undrift.io.table import Table
from undrift.model import (
    AdcModel,
    Calibration,
    DriftTables,
    DynamicDrift,
    NoiseModel,
    Provenance,
    Rounding,
    ScaleDrift,
    StaticDrift,
    Status,
    TriadModel,
    Verdict,
    WarmUp,
)
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE

# ---- Orientation over time as a table: Parquet or CSV, columns that carry their units.

COLUMNS = ("time_s", "q_w", "q_x", "q_y", "q_z", "inclination_deg", "heading_deg", "pitch_deg")


def write_orientation(
    time: FloatArray, q_nb: FloatArray, angles: tuple[FloatArray, FloatArray, FloatArray], path: str | Path
) -> None:
    """Write orientation over time; undrift reads the quaternions back as a reference.

    Arrays: time (N,) s, q_nb (N, 4), angles (N,) rad.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    path = Path(path)
    values = np.column_stack((time, q_nb, *(angle / RADIAN_PER_DEGREE for angle in angles)))
    table = pa.table(dict(zip(COLUMNS, values.T, strict=True)))
    part = path.with_name(path.name + ".part")
    try:
        if path.name.lower().endswith(".parquet"):
            parquet.write_table(table, part)
        elif path.name.lower().endswith(".csv"):
            csv.write_csv(table, part)
        elif path.name.lower().endswith(".csv.gz"):
            with pa.CompressedOutputStream(str(part), "gzip") as stream:
                csv.write_csv(table, stream)
        else:
            raise InputError(
                f"{path}: wanted a name ending in .parquet, .csv or .csv.gz, got another; name the format so"
            )
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error}; check the folder and its rights") from error


# ---- The calibration file in pydantic models: every key, its type and its shape. The JSON Schema is made from them.

KIND_FILE_MODEL = "undrift.calibration"
FORMAT = 1


def _finite(x: float) -> float:
    if not math.isfinite(x):
        raise ValueError("wanted a finite number, null or 'inf'")
    return x


Finite = Annotated[float, AfterValidator(_finite)]
Number = Finite | None | Literal["inf", "-inf"]
Vector = Annotated[list[Finite | None], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Nodes = Annotated[list[Finite], Field(min_length=2)]


class TriadFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """One triad: corrected = matrix @ (raw - offset) - g_sensitivity @ accel; matrix in unit_out per unit_in."""

    method: str
    unit_in: str
    unit_out: str
    matrix: Matrix
    offset: Vector
    g_sensitivity: Matrix | None
    parameters: list[str]
    covariance: list[list[Finite | None]]
    rms_residual: Number
    count: int
    rank: int
    condition: Number
    valid_range: Annotated[list[Number], Field(min_length=2, max_length=2)]


class WarmUpFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Extra offset over the time since power-on, raw unit; it ends at zero."""

    power_on_s: Nodes
    gyro_offset: list[Vector]


class StaticFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Absolute offsets over temperature and their standard uncertainties, raw unit; temperatures in degC."""

    temp_c: Nodes
    gyro_offset: list[Vector] | None = None
    accel_offset: list[Vector] | None = None
    gyro_uncertainty: list[Vector] | None = None
    accel_uncertainty: list[Vector] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None
    gyro_hysteresis: Vector | None = None
    warm_up: WarmUpFile | None = None


class ScaleFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Matrices over temperature and the standard uncertainty of each element, unit_out per unit_in; temperatures in degC."""

    temp_c: Nodes
    gyro_matrix: list[Matrix] | None = None
    accel_matrix: list[Matrix] | None = None
    gyro_uncertainty: list[Matrix] | None = None
    accel_uncertainty: list[Matrix] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None


class DynamicFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Rate error over temperature and measured rate and its standard uncertainty, rad/s; temperatures in degC."""

    temp_c: Nodes
    turn_rate: Nodes
    error: list[list[Vector]]
    uncertainty: list[list[Vector]] | None = None
    extrapolated: list[list[bool]] | None = None


class DriftFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Tuning tables, null where there is none, over the temperature that the thermometer shows lag_s late (s)."""

    static: StaticFile | None = None
    scale: ScaleFile | None = None
    dynamic: DynamicFile | None = None
    lag_s: Annotated[Finite, Field(ge=0.0)] = 0.0
    lag_smooth_s: Annotated[Finite, Field(ge=0.0)] = 0.0


class AdcFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Code step in the raw unit and rounding: lsb and rounding of the gyroscopes, accel_ the same of the accelerometers."""

    lsb: Vector | None
    rounding: Rounding
    accel_lsb: Vector | None
    accel_rounding: Rounding


class NoiseFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Noise coefficients per axis, SI; null where the record was too short to tell."""

    angle_random_walk: Vector
    bias_instability: Vector
    rate_random_walk: Vector
    velocity_random_walk: Vector
    accel_bias_instability: Vector
    accel_random_walk: Vector


class FindingFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """What a fit noticed: a code with its numbers, and the sentences of the version that wrote them."""

    code: str
    level: Level
    values: dict[str, Any]
    text: str
    action: str


class VerdictFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """What the calibration is worth; files from before findings had codes hold reasons alone."""

    status: Status
    reasons: list[str]
    findings: list[FindingFile] = []


class InputFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A file that the calibration was made from."""

    file: str
    sha256: str


class ProvenanceFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Where the calibration came from; time is ISO 8601, UTC."""

    inputs: list[InputFile]
    settings: dict[str, str]
    versions: dict[str, str]
    time: str


class CalibrationFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A device's calibration as undrift writes it."""

    kind: Literal["undrift.calibration"]
    format: Literal[1]
    device: str
    reference_temp_c: Finite | None
    gravity_m_s2: Finite
    gyro: TriadFile | None
    accel: TriadFile | None
    drift: DriftFile | None
    adc: AdcFile | None
    noise: NoiseFile | None
    verdict: VerdictFile
    provenance: ProvenanceFile


# ---- Calibration files: calibration.json, one object, kind "undrift.calibration", format 1.

LATER_KEYS = (
    "gyro_uncertainty", "accel_uncertainty", "gyro_extrapolated", "accel_extrapolated", "gyro_hysteresis", "warm_up",
    "uncertainty", "extrapolated",
)  # fmt: skip


def write_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration to a file, whole or not at all.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    path : path
        calibration.json; an existing file is replaced.

    Raises
    ------
    InputError
        A folder that cannot be written to, or a value that could not be read back; no file is left behind.
    """
    path = Path(path)
    content = calibration_json(calibration)
    try:
        CalibrationFile.model_validate(content)
    except ValidationError as error:
        raise InputError(
            f"{path}: wanted a calibration that reads back, got {_first_store(error)}; mend the value"
        ) from error
    text = _compact(json.dumps(content, indent=2, allow_nan=False)) + "\n"
    write_whole(path, text)


def read_calibration(path: Path | str) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path : path
        calibration.json.

    Returns
    -------
    Calibration
        As it was written, to the last bit.

    Raises
    ------
    FileFormatError
        No such file, not JSON, another kind or version, a key that is missing, unknown, or of another shape.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a calibration file, got {error.strerror}; check the path") from error
    except (ValueError, RecursionError) as error:  # broken JSON, or text that is not UTF-8
        raise FileFormatError(f"{path}: wanted JSON, got {error}; write the file anew") from error
    kind, version = (content.get("kind"), content.get("format")) if isinstance(content, dict) else (None, None)
    if kind != KIND_FILE_MODEL:
        raise FileFormatError(
            f"{path}: wanted kind {KIND_FILE_MODEL!r}, got {kind!r}; give a file that `undrift calibrate` wrote"
        )
    if version != FORMAT or isinstance(version, bool):
        raise FileFormatError(
            f"{path}: wanted format {FORMAT}, got {version!r}; read it with the undrift that wrote it"
        )
    try:
        return _value(CalibrationFile.model_validate(content))
    except ValidationError as error:
        raise FileFormatError(
            f"{path}: wanted a calibration of format {FORMAT}, got {_first_store(error)}; repair the file"
        ) from error
    except (InputError, ValueError, OverflowError) as error:
        raise FileFormatError(f"{path}: {error}") from error


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as the object that its file holds."""
    drift, adc, noise = calibration.drift, calibration.adc, calibration.noise
    p = calibration.provenance
    return {
        "kind": KIND_FILE_MODEL,
        "format": FORMAT,
        "device": calibration.device,
        "reference_temp_c": _number(calibration.reference_temp_c),
        "gravity_m_s2": _number(calibration.gravity_m_s2),
        "gyro": _plain(calibration.gyro),
        "accel": _plain(calibration.accel),
        "drift": _drift_json(drift),
        "adc": None
        if adc is None
        else {
            "lsb": _plain(adc.gyro_lsb),
            "rounding": adc.gyro_rounding,
            "accel_lsb": _plain(adc.accel_lsb),
            "accel_rounding": adc.accel_rounding,
        },
        "noise": _plain(noise),
        "verdict": verdict_json(calibration.verdict),
        "provenance": {
            "inputs": [{"file": name, "sha256": digest} for name, digest in p.inputs],
            "settings": _by_name(p.settings, "settings"),
            "versions": _by_name(p.versions, "versions"),
            "time": p.created,
        },
    }


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as files and ``--json`` hold it: status, reasons as texts, findings with their numbers."""
    return {
        "status": verdict.status,
        "reasons": list(verdict.reasons),
        "findings": [
            {
                "code": item.code,
                "level": item.level,
                "values": {name: _plain(value) for name, value in item.values.items()},
                "text": item.text,
                "action": item.action,
            }
            for item in verdict.findings
        ],
    }


def calibration_schema() -> dict[str, Any]:
    """Return the JSON Schema of a calibration file, made from the models that read it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **CalibrationFile.model_json_schema(mode="validation"),
    }


def _first_store(error: ValidationError) -> str:
    """The first thing that pydantic found wrong, on one line."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"at {where}: {first['msg'].removeprefix('Value error, ')}"


def _by_name(pairs: tuple[tuple[str, str], ...], what: str) -> dict[str, str]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise InputError(f"provenance: wanted each of the {what} once, got a name twice; name them apart")
    return found


def _number(x: float) -> float | str | None:
    x = float(x)
    return x if math.isfinite(x) else None if math.isnan(x) else "inf" if x > 0.0 else "-inf"


def _plain(value: Any) -> Any:
    """A value as JSON knows it: dataclasses by field, arrays and tuples as lists."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return {name: _plain(getattr(value, name)) for name in value.__slots__}


def _drift_json(drift: DriftTables | None) -> dict[str, Any] | None:
    """The tables, without the keys that came later where they say nothing: a reader that does not know them reads the rest."""
    if drift is None:
        return None
    content = {name: _plain(getattr(drift, name)) for name in drift.__slots__}
    for table in (content["static"], content["scale"], content["dynamic"]):
        for name in LATER_KEYS:
            if table is not None and table.get(name, 0) is None:
                del table[name]
    return {name: value for name, value in content.items() if not (name.startswith("lag_") and value == 0.0)}


def _compact(text: str) -> str:
    """Put lists of plain values on one line: raw line breaks never stand inside a JSON string."""
    return re.sub(r"\[\n\s*([^\[\]{}]*?)\n\s*\]", lambda found: "[" + re.sub(r"\n\s*", " ", found.group(1)) + "]", text)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name}, which is no JSON number")


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)  # None becomes NaN


def _maybe(values: Any) -> FloatArray | None:
    return None if values is None else _array(values)


def _scalar(x: float | str | None) -> float:
    return math.nan if x is None else float(x)


def _verdict(file: VerdictFile) -> Verdict:
    findings = tuple(
        finding(item.code, item.level, **{k: math.nan if v is None else v for k, v in item.values.items()})
        if item.code in CATALOGUE
        else finding("earlier.text", item.level, text=item.text)
        for item in file.findings
    )
    known = {item.text for item in file.findings} | {item.text for item in findings}
    remarks = tuple(reason for reason in file.reasons if reason not in known)
    return Verdict(status=file.status, findings=findings, remarks=remarks)


def _triad(file: TriadFile | None) -> TriadModel | None:
    if file is None:
        return None
    p = len(file.parameters)
    return TriadModel(
        method=file.method,
        unit_in=file.unit_in,
        unit_out=file.unit_out,
        matrix=_array(file.matrix),
        offset=_array(file.offset),
        g_sensitivity=_maybe(file.g_sensitivity),
        parameters=tuple(file.parameters),
        covariance=_array(file.covariance).reshape(p, p) if p == 0 else _array(file.covariance),
        rms_residual=_scalar(file.rms_residual),
        count=file.count,
        rank=file.rank,
        condition=_scalar(file.condition),
        valid_range=(_scalar(file.valid_range[0]), _scalar(file.valid_range[1])),
    )


def _drift(file: DriftFile | None) -> DriftTables | None:
    if file is None:
        return None
    static = scale = dynamic = None
    if file.static is not None:
        warm_up = None if file.static.warm_up is None else WarmUp(**_arrays(file.static.warm_up))
        static = StaticDrift(**_arrays(file.static, but="warm_up"), warm_up=warm_up)
    if file.scale is not None:
        scale = ScaleDrift(**_arrays(file.scale))
    if file.dynamic is not None:
        dynamic = DynamicDrift(**_arrays(file.dynamic))
    return DriftTables(static=static, scale=scale, dynamic=dynamic, lag_s=file.lag_s, lag_smooth_s=file.lag_smooth_s)


def _arrays(file: WarmUpFile | StaticFile | ScaleFile | DynamicFile, but: str = "") -> dict[str, Any]:
    """Arrays by name; the value makes booleans of its marks."""
    return {name: _maybe(values) for name, values in file if name != but}


def _adc(file: AdcFile | None) -> AdcModel | None:
    if file is None:
        return None
    return AdcModel(
        gyro_lsb=_maybe(file.lsb),
        accel_lsb=_maybe(file.accel_lsb),
        gyro_rounding=file.rounding,
        accel_rounding=file.accel_rounding,
    )


def _value(file: CalibrationFile) -> Calibration:
    p = file.provenance
    return Calibration(
        device=file.device,
        reference_temp_c=_scalar(file.reference_temp_c),
        gravity_m_s2=file.gravity_m_s2,
        gyro=_triad(file.gyro),
        accel=_triad(file.accel),
        drift=_drift(file.drift),
        adc=_adc(file.adc),
        noise=None if file.noise is None else NoiseModel(**{k: _array(v) for k, v in file.noise}),
        verdict=_verdict(file.verdict),
        provenance=Provenance(
            inputs=tuple((i.file, i.sha256) for i in p.inputs),
            settings=tuple(p.settings.items()),
            versions=tuple(p.versions.items()),
            created=p.time,
        ),
    )


# ---- store

KIND = "undrift.record"
CHUNK_ROWS = 65_536  # 4 MB of seven channels: stays in the cache
_KEY = b"undrift"
_BUFFER = 1 << 20


def read_parquet(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    sample_rate_hz: float | None = None,
    gaps: Gaps | None = None,
    repair_time: bool = False,
) -> Record:
    """Read a record."""
    handle = _open(path)
    names = tuple(handle.schema_arrow.names)
    columns = columns or replace(
        _native(Path(path), names, handle.schema_arrow.metadata, sample_rate_hz, gaps), repair_time=repair_time
    )
    with handle:
        return _record(Path(path), _whole(handle, path), columns)


def iter_parquet(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    rows: int = CHUNK_ROWS,
    gaps: Gaps | None = None,
    repair_time: bool = False,
) -> Iterator[Record]:
    """Read a record in chunks: constant memory, whatever the size of the file."""
    if rows < 2:
        raise InputError(f"rows: wanted two samples or more in a chunk, got {rows}")
    path, handle = Path(path), _open(path, stream=True)
    names = tuple(handle.schema_arrow.names)
    columns = columns or replace(
        _native(path, names, handle.schema_arrow.metadata, None, gaps), repair_time=repair_time
    )
    if columns.time is None:
        raise InputError(f"{path}: wanted a time column to read in chunks, got none; add time_s or read it whole")
    last: float | None = None
    with handle:
        for table in _batches(handle, rows, path):
            record = _record(path, table, columns)
            if last is not None and record.time[0] <= last:
                raise InputError(
                    f"{path}: wanted strictly increasing time, got {last:.9g} s then {record.time[0]:.9g} s; repair the file"
                )
            last = float(record.time[-1])
            yield record


def write_parquet(record: Record, path: str | Path) -> None:
    """Write a record; every bit reads back."""
    with ParquetWriter(path) as writer:
        writer.write(record)


class ParquetWriter:
    """Write a record chunk by chunk. The file appears under its name only when the with block ends well."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._part = self.path.with_name(self.path.name + ".part")
        self._writer: Any = None
        self._schema: Any = None
        self._last = float("-inf")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()
        if kind is None and self._writer is not None:
            self._part.replace(self.path)
        else:
            self._part.unlink(missing_ok=True)

    def write(self, record: Record) -> None:
        """Append a chunk."""
        import pyarrow as pa
        from pyarrow import parquet as pq

        names, columns = native_columns(record)
        schema = pa.schema([(name, pa.float64()) for name in names], metadata=_metadata(record))
        if self._writer is None:
            try:
                self._writer = pq.ParquetWriter(self._part, schema, use_dictionary=False)
            except OSError as error:
                raise InputError(f"{self.path}: cannot be written: {error}; check the folder and its rights") from error
            self._schema = schema
        if not schema.equals(self._schema, check_metadata=True):
            raise InputError(
                f"{self.path}: wanted chunks of one record, got {schema.names} after {self._schema.names} or another "
                "frame, state or device"
            )
        if record.time[0] <= self._last:
            raise InputError(
                f"{self.path}: wanted chunks in order of time, got {record.time[0]:.9g} s after {self._last:.9g} s"
            )
        self._last = float(record.time[-1])
        self._writer.write_table(pa.Table.from_arrays([pa.array(column) for column in columns], schema=schema))


def parquet_rows(path: str | Path) -> int:
    """Return the number of rows without reading them."""
    with _open(path) as handle:
        return int(handle.metadata.num_rows)


def parquet_names(path: str | Path) -> tuple[str, ...]:
    """Return the column names."""
    with _open(path) as handle:
        return tuple(handle.schema_arrow.names)


def read_parquet_table(path: str | Path) -> Table:
    """Return the columns of a Parquet file as they are."""
    with _open(path) as handle:
        return _table(Path(path), _whole(handle, path))


def _open(path: str | Path, *, stream: bool = False) -> Any:
    import pyarrow as pa
    from pyarrow import parquet as pq

    path = checked_file(path)
    try:
        # Read ahead, Arrow keeps every row group it has read: as much memory as the file is long.
        return pq.ParquetFile(path, pre_buffer=not stream, buffer_size=_BUFFER if stream else 0)
    except (pa.ArrowInvalid, OSError) as error:
        raise FileFormatError(
            f"{path}: wanted a Parquet file, got something else or a cut one; {_first(error)}"
        ) from error


def _whole(handle: Any, path: str | Path) -> Any:
    try:
        return handle.read()
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a sound Parquet file, got a damaged one; {_first(error)}") from error


def _batches(handle: Any, rows: int, path: Path) -> Iterator[Any]:
    """Yield Arrow tables of ``rows`` rows; a last single row goes with the chunk before it."""
    import pyarrow as pa

    held: list[Any] = []
    count = 0
    try:
        for batch in handle.iter_batches(batch_size=rows):
            held.append(batch)
            count += batch.num_rows
            while count >= rows + 2:  # what is left over is a chunk of its own
                table = pa.Table.from_batches(held)
                yield table.slice(0, rows)
                held, count = table.slice(rows).to_batches(), count - rows
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a sound Parquet file, got a damaged one; {_first(error)}") from error
    yield pa.Table.from_batches(held, schema=handle.schema_arrow)


def _record(path: Path, table: Any, columns: ColumnMap) -> Record:
    return build_record(_table(path, table), columns)


def _table(path: Path, table: Any) -> Table:
    return Table(source=str(path), names=tuple(table.column_names), columns=tuple(table.columns))


def _native(
    path: Path,
    names: tuple[str, ...],
    metadata: dict[bytes, bytes] | None,
    sample_rate_hz: float | None,
    gaps: Gaps | None,
) -> ColumnMap:
    try:
        columns = native_map(names, sample_rate_hz=sample_rate_hz)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if not metadata or _KEY not in metadata:
        return replace(columns, gaps=gaps or "raise")
    held = json.loads(metadata[_KEY])
    if held.get("kind") != KIND or held.get("format") != FORMAT:
        raise FileFormatError(
            f"{path}: wanted {KIND} format {FORMAT}, got {held.get('kind')} format {held.get('format')}; read it with the "
            "undrift that wrote it"
        )
    return replace(columns, gaps=gaps or "keep", frame=held["frame"], state=held["state"], device=held["device"])


def _metadata(record: Record) -> dict[bytes, bytes]:
    held = {
        "kind": KIND,
        "format": FORMAT,
        "gyro_unit": record.gyro_unit if record.gyro is not None else None,
        "accel_unit": record.accel_unit if record.accel is not None else None,
        "frame": record.frame,
        "state": record.state,
        "device": record.device,
    }
    return {_KEY: json.dumps(held, sort_keys=True).encode()}


def _first(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
