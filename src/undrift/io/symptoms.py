"""Symptoms: what a recording that reads well may still have wrong, in plain sentences. Nothing here raises or repairs.

Looked for: a specific force that is not 1 g (unit or scale), a temperature that is not a room's, a gyroscope that turns while
nothing moves, rows left out, gaps, uneven sampling, drop-outs, axes that never change, and readings stuck at their largest.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.record import Record
from undrift.units import STANDARD_GRAVITY, is_physical, si_factor

GRAVITY_RANGE = (0.8, 1.25)  # g: a worn sensor's median lies inside
ROOM_C = (-10.0, 45.0)
JUMP_C = 5.0  # between two samples
REST_TURN_RATE = 0.35  # rad/s, 20 deg/s: no gyroscope's offset
UNEVEN = 0.1  # of the median step, between quartiles
STUCK = 8  # samples in a row at the largest reading
_AXES = "xyz"


def find_symptoms(record: Record, *, dropped_rows: int = 0, repaired_rows: int = 0) -> tuple[str, ...]:
    """Return what looks wrong with a recording.

    Parameters
    ----------
    record : Record
        As read.
    dropped_rows : int
        Rows that did not parse and were left out on request.
    repaired_rows : int
        Rows whose time did not go forward, likewise.

    Returns
    -------
    tuple of str
        One sentence each; empty when nothing was found.
    """
    found: list[str] = []
    if dropped_rows:
        found.append(f"{dropped_rows} rows did not parse and were left out")
    if repaired_rows:
        found.append(f"{repaired_rows} rows whose time did not go forward were left out")
    found += _gravity(record)
    found += _rest(record)
    found += _temperature(record)
    found += _sampling(record.time)
    for name, values in (("gyro", record.gyro), ("accel", record.accel)):
        if values is not None:
            found += _axes(name, values)
    return tuple(found)


def gaps_of(record: Record) -> int:
    """Return the number of samples with a gap in any channel.

    Parameters
    ----------
    record : Record
        As read.

    Returns
    -------
    int
        Samples.
    """
    gap = np.zeros(len(record), dtype=np.bool_)
    for values in (record.gyro, record.accel, record.mag_ut, record.temp_c):
        if values is not None:
            gap |= np.isnan(values).reshape(len(record), -1).any(axis=1)
    return int(gap.sum())


def median_accel_g(record: Record) -> float:
    """Return the median length of the specific force.

    Parameters
    ----------
    record : Record
        As read.

    Returns
    -------
    float
        g; NaN without an accelerometer in physical units.
    """
    if record.accel is None or not is_physical(record.accel_unit):
        return float("nan")
    size = np.linalg.norm(record.accel, axis=1) * (si_factor(record.accel_unit, "accel") / STANDARD_GRAVITY)
    return float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan")


def _gravity(record: Record) -> list[str]:
    median = median_accel_g(record)
    if np.isnan(median) or GRAVITY_RANGE[0] <= median <= GRAVITY_RANGE[1]:
        return []
    times = f"{1 / median:.3g} times too small" if 0.0 < median < 1.0 else f"{median:.3g} times too large"
    return [f"median |accel| is {median:.3g} g where a body at rest reads 1 g: wrong unit or scale ({times})"]


def _rest(record: Record) -> list[str]:
    """Look at the quietest two seconds: a gyroscope reads its offset there."""
    if record.gyro is None or not is_physical(record.gyro_unit):
        return []
    rate = record.gyro * si_factor(record.gyro_unit, "rate")
    size = max(8, int(2.0 * record.sample_rate_hz))
    count = len(rate) // size
    if count < 3:
        return []
    blocks = rate[: count * size].reshape(count, size, 3)
    spread = blocks.std(axis=1).sum(axis=1)
    if not np.isfinite(spread).any():
        return []
    best = int(np.nanargmin(spread))
    mean = float(np.linalg.norm(blocks[best].mean(axis=0)))
    if mean < REST_TURN_RATE or spread[best] > 0.1 * mean:
        return []
    return [
        f"gyro reads {np.degrees(mean):.3g} deg/s in its quietest two seconds (at {record.time[best * size]:.6g} s): "
        "a steady turn, or a wrong unit or scale"
    ]


def _temperature(record: Record) -> list[str]:
    if record.temp_c is None:
        return []
    temp = record.temp_c[np.isfinite(record.temp_c)]
    if not len(temp):
        return ["the temperature column is empty"]
    found: list[str] = []
    low, high = float(temp.min()), float(temp.max())
    if low > ROOM_C[1] or high < ROOM_C[0]:
        found.append(
            f"temperature {low:.1f} to {high:.1f} degC is not room temperature: processor, chamber, or wrong scale"
        )
    jumps = np.flatnonzero(np.abs(np.diff(temp)) > JUMP_C)
    if len(jumps):
        found.append(
            f"temperature jumps by over {JUMP_C:g} K between samples {len(jumps)} times, first after sample {jumps[0]}"
        )
    return found


def _sampling(time: FloatArray) -> list[str]:
    steps = np.diff(time)
    middle = float(np.median(steps))
    found: list[str] = []
    low, high = np.quantile(steps, (0.25, 0.75))
    if high - low > UNEVEN * middle:
        found.append(f"sampling is uneven: half of the steps lie outside {1e3 * low:.4g} to {1e3 * high:.4g} ms")
    lost = steps > 1.5 * middle
    if lost.any():
        found.append(
            f"{int(lost.sum())} drop-outs, the longest {steps.max():.4g} s at {time[int(steps.argmax())]:.6g} s "
            f"(median step {1e3 * middle:.4g} ms, mean rate {(len(time) - 1) / (time[-1] - time[0]):.4g} Hz)"
        )
    return found


def _axes(name: str, values: FloatArray) -> list[str]:
    found: list[str] = []
    for k, axis in enumerate(_AXES):
        column = values[:, k][np.isfinite(values[:, k])]
        if len(column) < 2 * STUCK:
            continue
        if column.min() == column.max():
            found.append(f"{name} {axis} never changes: a dead or unmapped axis")
            continue
        for limit in (column.max(), column.min()):
            run = _longest_run(column == limit)
            spread = float(np.median(np.abs(column - np.median(column))))
            if run >= STUCK and abs(limit - np.median(column)) > 10.0 * spread > 0.0:
                found.append(f"{name} {axis} stays at {limit:.6g} for {run} samples in a row: saturated")
    return found


def _longest_run(hit: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], hit.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0
