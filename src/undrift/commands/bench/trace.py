"""Readings, rests, faces and turns of a recording, with its orientation if the readings show it, for the page that draws them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray, runs
from undrift.calibration.pieces import Piece, pieces_of
from undrift.calibration.session import look
from undrift.calibration.settings import CalibrateSettings
from undrift.commands.files import Opening
from undrift.files import write_together
from undrift.io.inspect import describe
from undrift.orientation import LONGEST_HOLE_S, filtered
from undrift.record import Record, Still
from undrift.segments import sphere_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

_SHOWN: tuple[tuple[str, Quantity, str, float], ...] = (
    ("gyro", "rate", "deg/s", RADIAN_PER_DEGREE),
    ("accel", "accel", "g", STANDARD_GRAVITY),
)
LEAST_DRAWN = 0.1  # of a recording: shorter pieces between gaps show no orientation


def write_trace(recording: Path, opening: Opening, path: Path) -> dict[str, object]:
    """Write time, readings and orientation of a recording as .npy; return its stretches, and the means at rest."""
    columns, settings = opening.how(recording)
    session = describe(recording, columns, settings=settings).session
    if session is None or session.means:
        return {}
    seen = look(session, CalibrateSettings())
    record, pieces = seen.session.records[0], pieces_of(seen.session, seen=seen)[0]
    kinds = [("time", "f8"), ("gyro", "f4", 3), ("accel", "f4", 3), ("q_nb", "f4", 4)]
    table = np.full(len(record), np.nan, dtype=kinds)
    table["time"], units, at_rest = record.time, dict[str, str](), dict[str, float]()
    for name, quantity, unit, size in _SHOWN:
        if (values := getattr(record, name)) is None:
            continue
        units[name] = own = getattr(record, f"{name}_unit")
        if is_physical(own):
            values, units[name] = values * (si_factor(own, quantity) / size), unit
        table[name] = values
        means = [float(np.linalg.norm(values[still.start : still.stop].mean(axis=0))) for still in seen.stills]
        at_rest |= {name: float(np.median(means))} if means else {}
    table["q_nb"], words = _lying(record, seen.stills)

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.save(file, table)

    write_together({path: write}, table.nbytes)
    spans = [(one.kind, one.label, one.why, *_span(record, one)) for one in pieces]
    span = float(record.time[0]), float(record.time[-1])
    return {"span_s": span, "stretches": spans, "units": units, "at_rest": at_rest, "lying": words}


def _span(record: Record, piece: Piece) -> tuple[float, float]:
    """Return the times of the first and the last sample of a stretch, s."""
    return float(record.time[piece.start]), float(record.time[piece.stop - 1])


def _lying(record: Record, rests: Sequence[Still]) -> tuple[FloatArray, str]:
    """Return how the device lay, (N, 4), NaN where nothing shows it, and what a person should know of it."""
    q_nb = np.full((len(record), 4), np.nan)
    counts = not (is_physical(record.gyro_unit) and is_physical(record.accel_unit))
    record = record if counts else record.in_si()
    if record.gyro is None or record.accel is None:
        return q_nb, ""
    still = [record.gyro[one.start : one.stop].mean(axis=0) for one in rests]
    gyro, words, follows_s = record.gyro - (np.median(still, axis=0) if rests else 0.0), "", 3.0
    if counts:  # the filter takes its tilt from the accelerometers: a rough scale is enough
        if not rests or (scaled := _scale_by_gravity(record, gyro, rests)) is None:
            return q_nb, ""
        scale, accel = scaled
        drawn = "gravity gives the drawing their scale, so it is rough"
        if not scale:
            drawn, follows_s = "the drawing shows tilt alone, and is rough", 0.3
        words, gyro = f"The readings have no physical unit: {drawn}.", scale * gyro
        record = replace(record, accel=STANDARD_GRAVITY * accel, accel_unit="m/s2")
    whole = np.isfinite(np.hstack((gyro, np.asarray(record.accel)))).all(axis=1)
    whole[1:] &= np.diff(record.time) <= max(LONGEST_HOLE_S, 5.0 / record.sample_rate_hz)
    for start, stop in (pieces := runs(whole)):
        if stop - start >= LEAST_DRAWN * len(record):
            piece = record.part(start, stop), gyro[start:stop], RADIAN_PER_DEGREE
            q_nb[start:stop], _ = filtered(*piece, magnetometer=False, acc_s=follows_s)
    return q_nb, words + " Nothing is drawn in a gap; its heading begins anew after one." * (len(pieces) > 1)


def _scale_by_gravity(record: Record, gyro: FloatArray, rests: Sequence[Still]) -> tuple[float, FloatArray] | None:
    """Return the scale of gyroscopes, rad/s a code, and the specific force, g, of a record in counts; None without gravity.

    The scale is 0 if gravity f does not follow the turns that are read, df/dt = f x w.
    """
    accel = np.asarray(record.accel)
    means = np.array([accel[one.start : one.stop].mean(axis=0) for one in rests])
    middle, centre = means.mean(axis=0), np.zeros_like(means[0])
    # rests on several sides lie on a sphere: its centre is what the device reads of no force
    if len(means) > 3 and np.linalg.svd(means - middle, compute_uv=False)[-1] > 0.2 * np.nanmax(np.abs(accel - middle)):
        centre, _ = sphere_of(means)
    elif np.nanmin(accel) >= 0.0:  # it reads some thousands of no force
        return None
    force = (accel - centre) / np.median(np.linalg.norm(means - centre, axis=1))
    size = max(1, round(0.2 * record.sample_rate_hz))
    count = len(force) // size
    turned, seen = (values[: count * size].reshape(count, size, 3).mean(axis=1) for values in (gyro, force))
    change, turn = np.diff(seen, axis=0), np.cross(seen[1:] + seen[:-1], turned[1:] + turned[:-1]) / 4.0
    dot, squares, whole = (float(np.nansum(product)) for product in (change * turn, turn**2, change**2))
    shown = dot > 0.0 and dot**2 > 0.3 * squares * whole  # not where an axis is reversed
    return dot / squares * record.sample_rate_hz / size if shown else 0.0, force
