"""Tables cut to the temperatures asked for, after they were fitted and judged over all that was seen.

A table holds its ends beyond them. Were it fitted to the range asked for, the soaks outside would be judged by held ends, and the
choice of tables would hang on the range. Tables are linear between nodes, so that cutting changes no value inside.
"""

from dataclasses import replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import DynamicDrift, ScaleDrift
from undrift.drift.fit.choose import Choice
from undrift.drift.fit.dynamic import DynamicFit
from undrift.drift.fit.static import StaticFit, TriadDrift, far_from_data


def widened(nodes: FloatArray, span_c: tuple[float, float]) -> FloatArray:
    """Return nodes that go on at the same step until they span a range.

    Parameters
    ----------
    nodes : array, shape (n,)
        degC, evenly spaced; n of 2 or more.
    span_c : (float, float)
        Least and greatest temperature to reach, degC.

    Returns
    -------
    array, shape (m,)
        degC, the nodes given among them; the same where they span it already.
    """
    step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
    below = max(int(np.ceil((nodes[0] - span_c[0]) / step - 1e-9)), 0)
    above = max(int(np.ceil((span_c[1] - nodes[-1]) / step - 1e-9)), 0)
    return np.concatenate(
        (nodes[0] - step * np.arange(below, 0, -1), nodes, nodes[-1] + step * np.arange(1, above + 1))
    )


def cropped_static(fit: StaticFit, nodes: FloatArray) -> StaticFit:
    """Return the offsets at some of their nodes.

    Parameters
    ----------
    fit : StaticFit
        Over wider nodes.
    nodes : array, shape (n,)
        degC, a stretch of the fit's own.

    Returns
    -------
    StaticFit
        Table, triads and the words on nodes without data cut; slopes and curves are of all that was seen.
    """
    keep = _rows(fit.table.temp_c, nodes)
    gyro, accel = _triad(fit.gyro, keep), _triad(fit.accel, keep)
    table = replace(
        fit.table,
        temp_c=fit.table.temp_c[keep],
        gyro_offset=_some(fit.table.gyro_offset, keep),
        gyro_uncertainty=_some(fit.table.gyro_uncertainty, keep),
        gyro_extrapolated=_marks(fit.table.gyro_extrapolated, keep),
        accel_offset=_some(fit.table.accel_offset, keep),
        accel_uncertainty=_some(fit.table.accel_uncertainty, keep),
        accel_extrapolated=_marks(fit.table.accel_extrapolated, keep),
    )
    reasons = [reason for reason in fit.verdict.reasons if "are marked extrapolated" not in reason]
    reasons += [] if gyro is None else far_from_data("gyroscope", gyro)
    reasons += [] if accel is None or accel.offset is None else far_from_data("accelerometer", accel)
    return replace(fit, table=table, gyro=gyro, accel=accel, verdict=replace(fit.verdict, reasons=tuple(reasons)))


def cropped_choice(choice: Choice, nodes: FloatArray) -> Choice:
    """Return what was chosen with all its tables cut.

    Parameters
    ----------
    choice : Choice
        Judged over wider nodes.
    nodes : array, shape (n,)
        degC, a stretch of them.

    Returns
    -------
    Choice
        The figures of the judgement are those of all that was seen.
    """
    scale = choice.scale
    return replace(
        choice,
        scale=None if scale is None else replace(scale, drift=_scale(scale.drift, nodes)),
        dynamic=_dynamic(choice.dynamic, nodes),
        both=_dynamic(choice.both, nodes),
    )


def _rows(temp_c: FloatArray, nodes: FloatArray) -> slice:
    first = int(np.argmin(np.abs(temp_c - nodes[0])))
    return slice(first, first + len(nodes))


def _some(values: FloatArray | None, keep: slice) -> FloatArray | None:
    return None if values is None else values[keep]


def _marks(values: BoolArray | None, keep: slice) -> BoolArray | None:
    return None if values is None else values[keep]


def _triad(found: TriadDrift | None, keep: slice) -> TriadDrift | None:
    if found is None:
        return None
    return replace(
        found,
        offset=_some(found.offset, keep),
        uncertainty=found.uncertainty[keep],
        extrapolated=found.extrapolated[keep],
        unknown_scale=_some(found.unknown_scale, keep),
    )


def _scale(drift: ScaleDrift, nodes: FloatArray) -> ScaleDrift:
    keep = _rows(drift.temp_c, nodes)
    return replace(
        drift,
        temp_c=drift.temp_c[keep],
        gyro_matrix=_some(drift.gyro_matrix, keep),
        gyro_uncertainty=_some(drift.gyro_uncertainty, keep),
        gyro_extrapolated=_marks(drift.gyro_extrapolated, keep),
    )


def _dynamic(fit: DynamicFit | None, nodes: FloatArray) -> DynamicFit | None:
    """Its nodes lie further apart: the ends asked for become nodes, linear between their neighbours."""
    if fit is None:
        return None
    old, low, high = fit.drift.temp_c, nodes[0], nodes[-1]
    at = np.concatenate(([low], old[(old > low + 1e-9) & (old < high - 1e-9)], [high]))
    right = np.clip(np.searchsorted(old, at - 1e-9), 1, len(old) - 1)
    share = np.clip((at - old[right - 1]) / (old[right] - old[right - 1]), 0.0, 1.0)[:, None]

    def between(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.where(
            weight == 0.0,
            values[right - 1],
            np.where(weight == 1.0, values[right], (1.0 - weight) * values[right - 1] + weight * values[right]),
        )

    drift: DynamicDrift = fit.drift
    marks = None if drift.extrapolated is None else between(drift.extrapolated.astype(float)) > 0.0
    cut = replace(
        drift,
        temp_c=at,
        error=between(drift.error),
        uncertainty=None if drift.uncertainty is None else between(drift.uncertainty),
        extrapolated=marks,
    )
    return replace(fit, drift=cut)
