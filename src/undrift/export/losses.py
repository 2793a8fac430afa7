"""What a target cannot carry, with figures: the parts of a calibration, and those that a target has a place for."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from undrift.findings import Finding, finding
from undrift.model import NO_TABLES, Calibration, DriftTables
from undrift.units import RADIAN_PER_DEGREE, si_factor

# ---- Exported: a text for another program, and what that program cannot do with the calibration.


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A file for another program.

    Parameters
    ----------
    text : str
        The file.
    not_carried : tuple of str
        What the calibration holds and the file does not, one sentence each, with its size where it has one.
    notes : tuple of str
        What the reader of the file must know or do.
    more : tuple of str
        Files beside it.
    figures : mapping
        Sizes and error bounds, for ``--json``.
    findings : tuple of Finding
        What is not carried, and the notes, as codes with numbers.
    """

    text: str
    not_carried: tuple[str, ...]
    notes: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    figures: Mapping[str, object] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


def texts_of(lost: tuple[Finding, ...], notes: Iterable[Finding]) -> dict[str, Any]:
    """Return what is not carried, and the notes, as the fields of an export: texts, and findings."""
    notes = tuple(notes)
    texts = {key: tuple(item.text for item in items) for key, items in (("not_carried", lost), ("notes", notes))}
    return {**texts, "findings": (*lost, *notes)}


# ---- losses

Part = Literal[
    "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross", "warm-up",
    "lag", "uncertainty", "noise", "moving", "magnetometer",
]  # fmt: skip


def losses(calibration: Calibration, carried: frozenset[Part]) -> tuple[Finding, ...]:
    """Return what a target that carries some parts leaves out of this calibration."""
    return tuple(found for part, found in _parts(calibration) if part not in carried)


def _parts(calibration: Calibration) -> Iterator[tuple[Part, Finding]]:
    coded = (triad.model is not None and triad.model.code_offset is not None for triad in calibration.triads)
    if any(triad.lsb is not None and triad.rounding == "toward_zero" for triad in calibration.triads) or any(coded):
        yield "rounding", finding("export.rounding", "warn")
    parts: tuple[tuple[Part, Part, str], ...] = (
        ("gain", "cross", "gyroscopes"),
        ("accel gain", "accel cross", "accelerometers"),
    )
    for triad, (gain, cross, name) in zip(calibration.triads, parts, strict=True):
        if triad.model is not None:
            yield gain, finding("export.gain", "warn", triad=name)
            matrix, diagonal = triad.model.matrix, np.diag(triad.model.matrix)
            least, off = float(np.abs(diagonal).min()), float(np.abs(matrix - np.diag(diagonal)).max())
            if off > 0.0:
                most = off / least * 100.0 if least > 0.0 else float("inf")
                yield cross, finding("export.cross", "warn", triad=name, most_percent=most)
    gyro = calibration.gyro
    if gyro is not None and gyro.g_sensitivity is not None:
        rate = np.abs(gyro.g_sensitivity).max() * si_factor(gyro.unit_out, "rate") / RADIAN_PER_DEGREE
        yield "g", finding("export.g_sensitivity", "warn", most_dps_per_g=rate * si_factor("g", "accel"))
    if gyro is not None and gyro.moving_offset is not None:
        most = np.abs(gyro.moving_offset).max() * si_factor(gyro.unit_out, "rate") / RADIAN_PER_DEGREE
        yield "moving", finding("export.moving_offset", "warn", most_dps=most)
    if calibration.magnetometer is not None:
        yield "magnetometer", finding("export.magnetometer", "warn")
    yield from _tables(calibration, calibration.drift or NO_TABLES)
    yield "uncertainty", finding("export.uncertainty", "warn")
    if calibration.noise is not None:
        yield "noise", finding("export.noise", "warn")


def _tables(calibration: Calibration, drift: DriftTables) -> Iterator[tuple[Part, Finding]]:
    static, scale, dynamic = drift.static, drift.scale, drift.dynamic
    if static is not None:
        yield "static", finding("export.static", "warn")
        if static.warm_up is not None:
            yield "warm-up", finding("export.warm_up", "warn")
    if scale is not None:
        matrices = np.zeros((1, 3, 3)) if scale.gyro_matrix is None else scale.gyro_matrix
        diagonal = np.diagonal(matrices, axis1=1, axis2=2)
        middle = np.abs(diagonal.mean(axis=0))
        if (middle > 0.0).all():
            change = float((np.ptp(diagonal, axis=0) / middle).max()) * 100.0
            yield "scale", finding("export.scale_change", "warn", change_percent=change)
        else:
            yield "scale", finding("export.scale", "warn")
    if dynamic is not None:
        worst = float(np.abs(dynamic.error).max()) / RADIAN_PER_DEGREE
        yield "dynamic", finding("export.dynamic", "warn", most_dps=worst)
    if drift.lag_s > 0.0:
        yield "lag", finding("export.lag", "warn", lag_s=drift.lag_s)
