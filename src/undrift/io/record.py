"""From a table and a map to a Record: units, time, and every check that a reader owes.

Limits below are what no wearable sensor reads; they catch a broken cell, not a wrong scale (that is for ``describe``).

CSV: any text table through a ColumnMap, and undrift's own names without one.

undrift writes the unit into every column name. Frame, state and device stand in one first line, only where they are not
the usual ones (sensor axes, raw, no device), so that a corrected file is never corrected twice::

    # undrift record; frame=b; state=corrected; device=MTi-1
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.frames import Frame
from undrift.io.columns import (
    ACCEL_SUFFIX,
    AXES,
    GYRO_SUFFIX,
    LM335_RANGE_C,
    QUANTITY,
    Channel,
    ColumnMap,
    Gaps,
    Scale,
    TextLayout,
    native_map,
)
from undrift.io.table import Table, Text, open_text, parse_text
from undrift.record import Record, State, sample_rate_of
from undrift.units import LM335_K_PER_V, ZERO_CELSIUS_K, Quantity, si_factor, temp_offset

# Largest believable size of a reading, in its own unit.
_LARGEST: dict[tuple[Quantity, str], float] = {
    ("rate", "rad/s"): 500.0,
    ("rate", "dps"): 30_000.0,
    ("accel", "m/s2"): 20_000.0,
    ("accel", "g"): 2_000.0,
    ("accel", "mg"): 2_000_000.0,
    ("temp", "degc"): 300.0,
    ("mag", "ut"): 100_000.0,
}
_DEVICE_LARGEST = {"count": 2.0**24, "v": 1000.0}
_RATE_AGREES = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Built:
    """A record and what was left out to make it."""

    record: Record  # The readings
    dropped_rows: int = 0  # Rows that did not parse
    repaired_rows: int = 0  # Rows whose time did not go forward


def build_record(table: Table, columns: ColumnMap) -> Record:
    """Return the record that a table holds."""
    return build(table, columns).record


def build(table: Table, columns: ColumnMap) -> Built:
    """Return the record that a table holds, and the count of rows left out."""
    if len(table) < 2:
        raise FileFormatError(f"{table.source}: wanted two rows or more, got {len(table)}; the file holds no recording")
    time = _time(table, columns)
    keep = _forward(table, time, columns)
    values = {channel: _channel(table, columns, channel) for channel in columns.mapped() if channel != "time"}
    repaired = 0
    if keep is not None:
        repaired = int((~keep).sum())
        time = time[keep]
        values = {channel: value[keep] for channel, value in values.items()}
    _check_rate(table, time, columns)
    temp = values.get("temp")
    record = Record(
        time=time,
        gyro=values.get("gyro"),
        accel=values.get("accel"),
        temp_c=None if temp is None else temp[:, 0],
        mag_ut=values.get("mag"),
        gyro_unit=columns.unit_of("gyro") if columns.gyro else "rad/s",
        accel_unit=columns.unit_of("accel") if columns.accel else "m/s2",
        frame=columns.frame,
        state=columns.state,
        device=columns.device,
    )
    return Built(record=record, dropped_rows=table.dropped, repaired_rows=repaired)


def with_temperature(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
    """Return the record with a temperature that was sampled on its own clock rate.

    Arrays: time (M,) s, temp_c (M,) degC.
    """
    known = np.isfinite(time) & np.isfinite(temp_c)
    if not known.any():
        raise InputError("temperature: wanted one reading or more, got none; leave the temperature file out")
    order = np.argsort(time[known], kind="stable")
    return replace(record, temp_c=np.interp(record.time, time[known][order], temp_c[known][order]))


def join_records(records: tuple[Record, ...], sources: tuple[str, ...]) -> Record:
    """Return the channels of several files with one time base, side by side."""
    first = records[0]
    joined = first
    for record, source in zip(records[1:], sources[1:], strict=True):
        if len(record) != len(first) or np.abs(record.time - first.time).max() > 0.1 / first.sample_rate_hz:
            raise InputError(
                f"{source}: wanted the {len(first)} samples and times of {sources[0]}, got {len(record)} samples or other times; "
                "files side by side need one time base"
            )
        for channel in ("gyro", "accel", "temp_c", "mag_ut"):
            if getattr(record, channel) is not None and getattr(joined, channel) is not None:
                raise InputError(f"{source}: wanted channels that {sources[0]} lacks, got {channel} again; map it once")
        joined = replace(
            joined,
            gyro=joined.gyro if record.gyro is None else record.gyro,
            gyro_unit=joined.gyro_unit if record.gyro is None else record.gyro_unit,
            accel=joined.accel if record.accel is None else record.accel,
            accel_unit=joined.accel_unit if record.accel is None else record.accel_unit,
            temp_c=joined.temp_c if record.temp_c is None else record.temp_c,
            mag_ut=joined.mag_ut if record.mag_ut is None else record.mag_ut,
        )
    return joined


def _channel(table: Table, columns: ColumnMap, channel: Channel) -> FloatArray:
    """Return the scaled values of one channel, shape (N, 1 or 3), in the unit Record wants."""
    wanted = columns.columns_of(channel)
    if len(wanted) == 1 and channel not in ("time", "temp"):
        wanted = _axes_of(table, str(wanted[0]))
    scale = columns.scale_of(channel)
    unit = columns.unit_of(channel)
    if unit == "lm335_v":
        return _lm335(table, columns)
    factor = si_factor(unit, QUANTITY[channel]) if channel in ("temp", "mag") else 1.0
    limit = _DEVICE_LARGEST.get(unit) or _LARGEST[QUANTITY[channel], "ut" if channel == "mag" else unit]
    out = np.empty((len(table), len(wanted)))
    for k, column in enumerate(wanted):
        values = table.numbers(column)
        if scale is not None or factor != 1.0:
            values = _scaled(values, scale, k) * factor
        _check_values(table, table.names[table.position(column)], values, limit, unit, columns)
        out[:, k] = values
    return out


def _lm335(table: Table, columns: ColumnMap) -> FloatArray:
    """Return the temperature that an LM335's voltage says, trimmed, shape (N, 1), degC."""
    (column,) = columns.columns_of("temp")
    volts = _scaled(table.numbers(column), columns.temp_scale, 0)
    name = table.names[table.position(column)]
    _check_gaps(table, name, volts, columns)
    low, high = ((limit + ZERO_CELSIUS_K) / LM335_K_PER_V for limit in LM335_RANGE_C)
    bad = np.flatnonzero((volts < low) | (volts > high))
    if len(bad):
        row = table.row(int(bad[0]))
        raise FileFormatError(
            f"{table.source}: column {name!r}: wanted {low:.2f} to {high:.2f} V of an LM335 (10 mV/K, {LM335_RANGE_C[0]:g} to "
            f"{LM335_RANGE_C[1]:g} degC), got {volts[bad[0]]:g} V in data row {row} ({len(bad)} such); check its wiring, or "
            "give scale.temp from the file's numbers to V at the part",
            row=row,
        )
    kelvin = volts * si_factor("lm335_v", "temp") * (columns.temp_trim.factor if columns.temp_trim else 1.0)
    return (kelvin + temp_offset("lm335_v"))[:, None]


def _axes_of(table: Table, name: str) -> tuple[str, ...]:
    """Return the three columns of a two-dimensional array of an npz or mat file."""
    axes = tuple(f"{name}[{k}]" for k in range(3))
    if axes[2] not in table.names or f"{name}[3]" in table.names:
        raise InputError(
            f"{table.source}: wanted an array {name!r} of shape (N, 3), got none; it holds {', '.join(table.names[:16])}"
        )
    return axes


def _scaled(values: FloatArray, scale: Scale | None, axis: int) -> FloatArray:
    if scale is None:
        return values
    gain = scale.gain[axis] if isinstance(scale.gain, tuple) else scale.gain
    offset = scale.offset[axis] if isinstance(scale.offset, tuple) else scale.offset
    return gain * values + offset


def _check_values(table: Table, name: str, values: FloatArray, limit: float, unit: str, columns: ColumnMap) -> None:
    low, high = float(values.min()), float(values.max())  # NaN passes through both
    if low >= -limit and high <= limit:
        return
    gap = _check_gaps(table, name, values, columns)
    wild = np.flatnonzero(np.abs(np.where(gap, 0.0, values)) > limit)
    if len(wild):
        row = table.row(int(wild[0]))
        raise FileFormatError(
            f"{table.source}: column {name!r}: wanted readings up to {limit:g} {unit}, got {values[wild[0]]:g} in data row {row} "
            f"({len(wild)} such); repair the row or check unit and scale",
            row=row,
        )


def _check_gaps(table: Table, name: str, values: FloatArray, columns: ColumnMap) -> BoolArray:
    """Return where a column has gaps; raise where there are any and the map refuses them."""
    gap = np.isnan(values)
    if gap.any() and columns.gaps == "raise":
        row = table.row(int(np.flatnonzero(gap)[0]))
        raise InputError(
            f"{table.source}: column {name!r}: wanted a number in every row, got {int(gap.sum())} empty or NaN cells, first in "
            f'data row {row}{_period(gap)}; say --gaps keep, or gaps = "keep" in a map '
            "or [[recording]], to keep them as gaps",
            row=row,
        )
    return gap


def _period(gap: BoolArray) -> str:
    """Name a channel that is empty in a regular pattern: it runs at a lower rate."""
    filled = np.flatnonzero(~gap)
    if len(filled) > 2 and len(np.unique(steps := np.diff(filled))) == 1 and steps[0] > 1:
        return f" (filled in every {steps[0]}th row only: two rates in one file; export each rate to its own file)"
    return ""


def _time(table: Table, columns: ColumnMap) -> FloatArray:
    if columns.time is None:
        rows = np.arange(len(table)) if table.rows is None else table.rows - table.rows[0]
        return rows / (columns.sample_rate_hz or np.nan)  # ColumnMap has seen to it that the rate is there
    time = table.numbers(columns.time)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        row = table.row(int(bad[0]))
        raise InputError(
            f"{table.source}: time column {columns.time!r}: wanted a number in every row, got {len(bad)} empty or NaN cells, "
            f"first in data row {row}; repair the file",
            row=row,
        )
    factor = si_factor(columns.unit_of("time"), "time")
    return time if factor == 1.0 else time * factor


def _forward(table: Table, time: FloatArray, columns: ColumnMap) -> BoolArray | None:
    """Return the rows whose time goes forward, None when all do."""
    steps = np.diff(time)
    if (steps > 0.0).all():
        return None
    row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
    if columns.repair_time:
        latest = np.maximum.accumulate(time)
        keep = np.concatenate(([True], time[1:] > latest[:-1]))
        if keep.sum() >= 0.5 * len(time):
            return keep
        raise InputError(
            f"{table.source}: time column {columns.time!r}: wanted time that mostly goes forward, got {int((~keep).sum())} of "
            f"{len(time)} rows to drop; check that this is the time column"
        )
    kind = "doubled" if steps[row - 1] == 0.0 else "backward"
    raise InputError(
        f"{table.source}: time column {columns.time!r}: wanted strictly increasing time, got {int((steps <= 0).sum())} steps back "
        f"or doubled, first in data row {table.row(row)} ({kind}: {time[row - 1]:.9g} s then {time[row]:.9g} s); say repair_time = "
        "true in a map (--map FILE) or its [[recording]] to drop such rows",
        row=table.row(row),
    )


def _check_rate(table: Table, time: FloatArray, columns: ColumnMap) -> None:
    if columns.time is None or len(time) < 2:
        return
    stated = columns.sample_rate_hz
    if stated is not None:
        held, mean = sample_rate_of(time), (len(time) - 1) / float(time[-1] - time[0])
        if min(abs(held / stated - 1.0), abs(mean / stated - 1.0)) > _RATE_AGREES:
            raise InputError(
                f"{table.source}: wanted {stated:g} Hz as stated, got {held:.4g} Hz from time column {columns.time!r}; correct "
                "sample_rate_hz or units.time"
            )
    rates = two_rates(time)
    if rates is not None:
        raise InputError(
            f"{table.source}: wanted one sample rate, got {rates[0]:.4g} Hz and then {rates[1]:.4g} Hz from {rates[2]:.6g} s on; "
            "cut the file there and read each part by itself"
        )


def two_rates(time: FloatArray) -> tuple[float, float, float] | None:
    """Find a lasting change of the sample rate.

    Arrays: time (N,) s.
    """
    size = max(16, (len(time) - 1) // 64)
    count = (len(time) - 1) // size
    every = np.diff(time)
    if count < 4 or every.max() < 1.1 * every.min():
        return None
    steps = every[: count * size].reshape(count, size)
    low, middle, high = np.quantile(steps, (0.25, 0.5, 0.75), axis=1)
    steady = np.flatnonzero((high - low) < 0.1 * middle)
    if len(steady) < 4:
        return None
    medians = middle[steady]
    other = np.abs(medians / medians[0] - 1.0) > 0.1
    if other.sum() < 2 or (~other).sum() < 2:
        return None
    first = steady[int(np.flatnonzero(other)[0])]
    return 1.0 / float(medians[0]), 1.0 / float(middle[first]), float(time[first * size])


# ---- CSV: any text table through a ColumnMap, and undrift's own names without one.


def read_csv(
    path: str | Path, columns: ColumnMap | None = None, *, sample_rate_hz: float | None = None, gaps: Gaps = "raise"
) -> Record:
    """Read a record from a text table, plain or gzip."""
    return build_csv(path, columns, sample_rate_hz=sample_rate_hz, gaps=gaps).record


def build_csv(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    sample_rate_hz: float | None = None,
    gaps: Gaps = "raise",
    repair_time: bool = False,
    drop_bad_rows: bool = False,
) -> Built:
    """Read a record and the count of rows left out."""
    text = open_text(path, TextLayout(drop_bad_rows=drop_bad_rows) if columns is None else columns.layout)
    if columns is None:
        columns = replace(_native(text, sample_rate_hz, gaps), repair_time=repair_time)
    wanted = tuple(column for channel in columns.mapped() for column in columns.columns_of(channel))
    return build(parse_text(text, wanted), columns)


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record with undrift's own column names; every number reads back to the same bits."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names, columns = native_columns(record)
    table = pa.table([pa.array(column, from_pandas=True) for column in columns], names=list(names))
    path = Path(path)
    try:
        with pa.OSFile(str(path), "wb") as raw:
            sink = pa.CompressedOutputStream(raw, "gzip") if path.suffix == ".gz" else raw
            sink.write(_mark(record) + ",".join(names).encode() + b"\n")
            arrow_csv.write_csv(table, sink, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))
            if sink is not raw:
                sink.close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error}; check the folder and its rights") from error


def native_columns(record: Record) -> tuple[tuple[str, ...], tuple[FloatArray, ...]]:
    """Return a record as named columns, undrift's own names."""
    names, columns = ["time_s"], [record.time]
    triples: list[tuple[str, str, Any]] = [
        ("gyro", GYRO_SUFFIX[record.gyro_unit], record.gyro),
        ("accel", ACCEL_SUFFIX[record.accel_unit], record.accel),
        ("mag", "ut", record.mag_ut),
    ]
    for channel, suffix, values in triples:
        if values is not None:
            names += [f"{channel}_{axis}_{suffix}" for axis in AXES]
            columns += [np.ascontiguousarray(values[:, k]) for k in range(3)]
    if record.temp_c is not None:
        names.append("temp_c")
        columns.append(record.temp_c)
    return tuple(names), tuple(columns)


def _native(text: Text, sample_rate_hz: float | None, gaps: Gaps) -> ColumnMap:
    try:
        columns = native_map(text.names, sample_rate_hz=sample_rate_hz, layout=text.layout)
    except InputError as error:
        raise InputError(f"{text.path}: {error}") from error
    frame, state, device = _read_mark(text) if text.mark else ("s", "raw", "")
    return replace(columns, gaps=gaps, frame=frame, state=state, device=device)


def _mark(record: Record) -> bytes:
    if record.frame == "s" and record.state == "raw" and not record.device:
        return b""
    device = " ".join(record.device.replace(";", ",").split())
    return f"# undrift record; frame={record.frame}; state={record.state}; device={device}\n".encode()


def _read_mark(text: Text) -> tuple[Frame, State, str]:
    found = dict(part.strip().split("=", 1) for part in text.mark.split(";")[1:] if "=" in part)
    frames = {name: name for name in get_args(Frame)}
    states = {name: name for name in get_args(State)}
    if found.get("frame") not in frames or found.get("state") not in states:
        raise FileFormatError(
            f"{text.path}: wanted '# undrift record; frame=...; state=...; device=...' in line 1, got {text.mark[:60]!r}"
        )
    return frames[found["frame"]], states[found["state"]], found.get("device", "")
