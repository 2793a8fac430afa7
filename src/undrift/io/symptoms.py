"""Find suspicious properties of a readable recording: a wrong unit, gaps, drop-outs, dead axes, saturated readings. They are
reported, not raised or repaired.
"""

from collections.abc import Iterator

import numpy as np

from undrift.arrays import FloatArray, IntArray, runs
from undrift.findings import Finding, finding
from undrift.io.clock import host_clock
from undrift.io.column_map import AXES
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

GRAVITY_RANGE = (0.8, 1.25)  # limits of a worn sensor's median, g
ROOM_C = (-10.0, 45.0)
JUMP_C = 5.0  # largest change between two samples, K
REST_TURN_RATE = 0.35  # rad/s, 20 deg/s: larger than the offset of any gyroscope
UNEVEN = 0.1  # limit of the distance between quartiles, relative to the median step
STUCK = 8  # number of successive samples at the largest reading


def find_symptoms(record: Record) -> tuple[Finding, ...]:
    """Return the symptoms of a recording."""
    symptoms = [*check_gravity(record), *_rest(record), *_temperature(record), *check_sampling(record.time)]
    for name in ("gyro", "accel"):
        if getattr(record, name) is not None:
            symptoms += _axes(name, getattr(record, name))
    return (*symptoms, *find_saturated(record))


def gaps_of(record: Record) -> int:
    """Return the number of samples with a gap in any channel."""
    channels = (record.gyro, record.accel, record.mag_ut, record.temp_c)
    gaps = [np.isnan(values).reshape(len(record), -1).any(axis=1) for values in channels if values is not None]
    return int(np.any(gaps, axis=0).sum())


def check_gravity(record: Record) -> Iterator[Finding]:
    """Yield a finding if the specific force is far from 1 g at its median."""
    if record.accel is None or not is_physical(record.accel_unit) or not np.isfinite(record.accel).all(axis=1).any():
        return
    size = np.linalg.norm(record.accel, axis=1) * (si_factor(record.accel_unit, "accel") / STANDARD_GRAVITY)
    median = float(np.nanmedian(size))
    if not GRAVITY_RANGE[0] <= median <= GRAVITY_RANGE[1]:
        small = 0.0 < median < 1.0
        factor, direction = (1.0 / median, "small") if small else (median, "large")
        units = "g, not m/s2" if small else "m/s2, not g"
        cause = f": acceleration is in {units}" if abs(factor / STANDARD_GRAVITY - 1.0) < 0.2 else ""
        yield finding(
            "recording.gravity",
            "warn",
            f"The median acceleration is {median:.3g} g, but a body at rest reads 1 g ({factor:.3g} times too "
            f"{direction}){cause}.",
            "Correct units.accel or scale.accel in the map.",
            median_g=median,
            direction=direction,
        )


def _rest(record: Record) -> Iterator[Finding]:
    """Return the offset of a gyroscope from the quietest two seconds."""
    size = max(8, int(2.0 * record.sample_rate_hz))
    count = len(record) // size
    if record.gyro is None or not is_physical(record.gyro_unit) or count < 3:
        return
    rate = record.gyro * si_factor(record.gyro_unit, "rate")
    blocks = rate[: count * size].reshape(count, size, 3)
    spread = blocks.std(axis=1).sum(axis=1)
    if np.isfinite(spread).any():
        best = int(np.nanargmin(spread))
        mean = float(np.linalg.norm(blocks[best].mean(axis=0)))
        if mean >= REST_TURN_RATE and spread[best] <= 0.1 * mean:
            quiet_s, rate_dps = record.time[best * size], mean / RADIAN_PER_DEGREE
            yield finding(
                "recording.rest_rate",
                "warn",
                f"The gyroscope reads {rate_dps:.3g} deg/s in its quietest two seconds (at {quiet_s:.6g} s): the device turns "
                f"steadily, or unit or scale is wrong.",
                "Check units.gyro and scale.gyro in the map.",
                turn_rate_dps=rate_dps,
            )


CHECK_TEMPERATURE = "Check the column, unit and scale of the temperature in the map."


def _temperature(record: Record) -> Iterator[Finding]:
    if record.temp_c is None:
        return
    temp = record.temp_c[np.isfinite(record.temp_c)]
    if not len(temp):
        yield finding("recording.temperature", "info", "The temperature column is empty.", CHECK_TEMPERATURE)
        return
    low, high = float(temp.min()), float(temp.max())
    if low > ROOM_C[1] or high < ROOM_C[0]:
        sentence = f"The temperature is {low:.1f} to {high:.1f} degC: it may be of a processor or a chamber, or have a wrong scale."
        yield finding("recording.temperature", "warn", sentence, CHECK_TEMPERATURE, low_c=low, high_c=high)
    jumps = np.flatnonzero(np.abs(np.diff(temp)) > JUMP_C)
    if len(jumps):
        sentence = f"The temperature jumps by over {JUMP_C:g} K between samples {len(jumps)} times, first after sample {jumps[0]}."
        values = {"count": len(jumps), "first_sample": jumps[0]}
        yield finding("recording.temperature", "warn", sentence, CHECK_TEMPERATURE, **values)


def check_sampling(time: FloatArray) -> Iterator[Finding]:
    steps = np.diff(time)
    if (fit := host_clock(time)) is not None:
        low_ms, high_ms = 1e3 * np.quantile(steps, (0.1, 0.9))
        yield finding(
            "recording.host_clock",
            "warn",
            f"The time stamps are from the host (steps of {low_ms:.3g} to {high_ms:.3g} ms). A regular clock of "
            f"{fit.sample_rate_hz:.5g} Hz fits, with stamps up to {1e3 * fit.jitter_s:.3g} ms late and {fit.missing} samples "
            "missing.",
            "Read it with clock = 'regular' in a map.",
            sample_rate_hz=fit.sample_rate_hz,
            jitter_ms=1e3 * fit.jitter_s,
            gaps=fit.gaps,
            missing=fit.missing,
        )
        return
    low, middle, high = np.quantile(steps, 0.25), float(np.median(steps)), np.quantile(steps, 0.75)
    if high - low > UNEVEN * middle:
        sentence = f"The sampling is uneven: half of the steps are outside {1e3 * low:.4g} to {1e3 * high:.4g} ms."
        yield finding("recording.uneven_sampling", "warn", sentence)
    lost = steps > 1.5 * middle
    if lost.any():
        count, longest_s, longest_start_s = int(lost.sum()), steps.max(), time[int(steps.argmax())]
        sentence = f"The recording has {count} drop-outs, the longest {longest_s:.4g} s at {longest_start_s:.6g} s (median step "
        sentence += f"{1e3 * middle:.4g} ms, mean rate {(len(time) - 1) / (time[-1] - time[0]):.4g} Hz)."
        yield finding("recording.uneven_sampling", "warn", sentence, count=count, longest_s=longest_s)


def _axes(channel: str, values: FloatArray) -> Iterator[Finding]:
    for axis, column in zip(AXES, values.T, strict=True):
        column = column[np.isfinite(column)]
        if len(column) >= 2 * STUCK and column.min() == column.max():
            yield finding(
                "recording.dead_axis",
                "warn",
                f"{channel} {axis} never changes: the axis is dead or not mapped.",
                channel=channel,
                axis=axis,
            )


# ---- readings at the end of the range


def find_saturated(record: Record) -> tuple[Finding, ...]:
    """Return a finding for each end of the range at which an axis of a record is stuck."""
    symptoms = []
    for channel, values in (("gyro", record.gyro), ("accel", record.accel)):
        for axis, column in () if values is None else zip(AXES, values.T, strict=True):
            for limit, stuck in saturated_runs(column):
                longest = (stuck[:, 1] - stuck[:, 0]).max()
                sentence = f"{channel} {axis} is saturated: it stays at {limit:.6g} for {longest} samples in a row."
                symptoms.append(
                    finding("recording.saturated", "warn", sentence, channel=channel, axis=axis, count=longest)
                )
    return tuple(symptoms)


def saturated_runs(column: FloatArray) -> Iterator[tuple[float, IntArray]]:
    """Return each limit at which readings (N,) are stuck, and the stretches (R, 2) at this limit."""
    for end in (np.fmax, np.fmin) if len(column) >= 2 * STUCK else ():
        limit = end.reduce(column)
        at_limit = column == limit
        if np.count_nonzero(at_limit) < STUCK:
            continue
        stuck = runs(at_limit)
        stuck = stuck[stuck[:, 1] - stuck[:, 0] >= STUCK]
        if len(stuck) and np.isfinite(column).sum() >= 2 * STUCK and _ends_range(column, float(limit), stuck):
            yield float(limit), stuck


def _ends_range(column: FloatArray, limit: float, stuck: IntArray) -> bool:
    """Return True if a limit is far from the middle of the readings, or is large and no other values repeat."""
    known = column[np.isfinite(column)]
    middle, codes = np.median(known), np.unique(known)
    usual = np.median(np.abs(known - middle))
    if not usual > 0.0:
        return False
    if codes[0] < 0.0 and abs(limit) < 0.1 * max(-codes[0], codes[-1]):
        return False  # ranges are symmetric about zero: this is the level at rest before motion to one side
    fine = len(codes) > 10 * STUCK  # coarse codes repeat at an end as elsewhere, but are not reached with a jump
    far = abs(limit - middle) > 10.0 * usual
    if not (fine or far):
        return False
    change = np.abs(np.diff(column))
    jumped = bool((change[np.clip(stuck - 1, 0, len(change) - 1)] > 5.0 * change[change > 0.0].min()).any())
    begins = np.flatnonzero(np.diff(column, prepend=np.nan) != 0.0)
    inside = (column[begins] != codes[0]) & (column[begins] != codes[-1])
    alone = int(np.diff(np.append(begins, len(column)))[inside].max(initial=0)) < STUCK // 2
    large = abs(limit) > 0.5 * max(abs(codes[0]), abs(codes[-1]))  # not a rest in a log without noise
    return bool((far and (fine or jumped)) or (large and alone and fine))
