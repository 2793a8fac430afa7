"""Correct a record: the only place where a calibration is applied.

For a reading u (3,) at temperature T, in this order::

    1  u1 = u + h sign(u)         codes truncated toward zero; u + h where they were rounded down; h is half a step
    2  u2 = u1 - offset(T)        tuning table of absolute offsets, else the constant offset
    3  w  = M(T) u2               matrix, constant or over temperature
    4  w  = w - G a               g-sensitivity, gyroscopes only, a the corrected specific force
    5  w  = w - e(w, T)           dynamic drift over the measured rate, bilinear, gyroscopes only

Tables are held at their ends; a temperature beyond them is an error, is held, or becomes a gap, as ``policy`` says.

``_evaluate_triad`` is where these lines are. Around it: drift/plan.py turns the calibration into what the kernels take,
drift/coverage.py looks for what it does not cover, drift/buffers.py and drift/pieces.py say where to and on how many threads, and
stream.py does the same chunk by chunk.
"""

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration
from undrift.drift.buffers import Buffers, adopt, flat, out_buffers
from undrift.drift.coverage import NOWHERE, UNMOVED, Reach, Span, find_outside, notes_on, reach_of, warnings_on
from undrift.drift.pieces import in_pieces
from undrift.drift.plan import Plans, TriadPlan, plan_record
from undrift.record import Record

Policy = Literal["raise", "hold", "nan"]

REFERENCE_SPAN_C = 5.0  # how far from the reference temperature constant offsets are taken to hold
NOTHING = np.empty(0)


def _evaluate_triad(plan: TriadPlan, u: FloatArray, temp: FloatArray, a: FloatArray, w: FloatArray) -> Span:
    """Evaluate the model for one triad: readings u to w; a is empty where step 4 has nothing to do."""
    from undrift.kernels.correct import affine, subtract_g, tabulated

    g = np.zeros(9) if plan.g_sensitivity is None else plan.g_sensitivity
    if plan.tables is not None:  # steps 1 to 5: w = M(T) (u + h sign(u) - offset(T)) - G a, then w - e(w, T)
        least, greatest = tabulated(u, temp, a, w, plan.matrix, plan.offset, plan.half_step, g, plan.tables)
        return float(least), float(greatest)
    affine(u, w, plan.matrix, plan.offset, plan.half_step)  # steps 1 to 3: w = M (u + h sign(u) - offset)
    if a.size:
        subtract_g(a, w, g)  # step 4: w - G a
    return NOWHERE


def _evaluate(record: Record, plans: Plans, outputs: Buffers, start: int, stop: int) -> Span:
    """Evaluate the model for the samples [start, stop) and return the least and greatest rate that met the dynamic table."""
    from undrift.kernels.correct import affine_pair

    gyro, accel = plans
    u, v = flat(record.gyro, start, stop), flat(record.accel, start, stop)
    w, a = flat(outputs[0], start, stop), flat(outputs[1], start, stop)
    temp = NOTHING if record.temp_c is None else record.temp_c[start:stop]
    g = None if gyro is None else gyro.g_sensitivity
    if gyro is not None and accel is not None and g is not None and gyro.tables is None and accel.tables is None:
        of_accel = (accel.matrix, accel.offset, accel.half_step)  # both triads in one pass over the memory
        affine_pair(u, v, w, a, gyro.matrix, gyro.offset, gyro.half_step, *of_accel, g)
        return NOWHERE
    if accel is not None:  # first, since step 4 wants a
        _evaluate_triad(accel, v, temp, NOTHING, a)
    return NOWHERE if gyro is None else _evaluate_triad(gyro, u, temp, NOTHING if g is None else a, w)


class DriftRangeWarning(UserWarning):
    """Readings were corrected beyond what the calibration covers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrected:
    """A corrected record, and where the calibration did not cover it.

    Parameters
    ----------
    record : Record
        rad/s and m/s2 in frame b, state corrected.
    outside : array, shape (N,)
        True where the temperature lay outside a tuning table.
    warnings : tuple of str
        What went beyond the calibration: temperature, span of the constant offsets, rate.
    notes : tuple of str
        What was done that a reader may not expect: a triad without a model, another serial number.
    reach : Reach
        How far temperature and rate went, where the calibration cares.
    """

    record: Record
    outside: BoolArray
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    reach: Reach = UNMOVED

    @property
    def seconds_outside(self) -> float:
        """Time spent outside the tuning tables, s."""
        return float(self.outside.sum()) / self.record.sample_rate_hz


def correct(
    record: Record, calibration: Calibration, *, policy: Policy = "raise", out: Buffers | None = None
) -> Record:
    """Turn a device's readings into rate and specific force.

    Parameters
    ----------
    record : Record
        Raw readings, in the calibration's unit or another physical one; temperatures where the calibration has tables.
    calibration : Calibration
        The device's model.
    policy : str
        What becomes of samples whose temperature lies outside a table: "raise", "hold" the table's end, or "nan".
    out : tuple of two arrays, shape (N, 3), optional
        Where to write rate and specific force; saves fresh arrays, and the record then lives on these.

    Returns
    -------
    Record
        rad/s and m/s2 in frame b, state corrected. Warns with DriftRangeWarning beyond the calibration's range.

    Raises
    ------
    InputError
        Readings corrected already, in a unit that the calibration does not know, or without the temperatures it needs.
    DriftRangeError
        Temperatures outside a table under policy "raise".
    """
    corrected = correct_checked(record, calibration, policy=policy, out=out)
    for text in corrected.warnings:
        warnings.warn(text, DriftRangeWarning, stacklevel=2)
    return corrected.record


def correct_checked(
    record: Record,
    calibration: Calibration,
    *,
    policy: Policy = "raise",
    out: Buffers | None = None,
    reference_span_c: float = REFERENCE_SPAN_C,
    threads: int | None = None,
) -> Corrected:
    """Correct a record and say where the calibration did not cover it.

    Parameters
    ----------
    record : Record
        As for ``correct``.
    calibration : Calibration
        The device's model.
    policy : str
        "raise", "hold" or "nan".
    out : tuple of two arrays, shape (N, 3), optional
        Where to write rate and specific force.
    reference_span_c : float
        Without a table, warn where the temperature departs from the reference by more than this, degC.
    threads : int, optional
        Default: all processors for long records, one for short ones. The bits of the result do not depend on it.

    Returns
    -------
    Corrected
        The record, the mask, warnings and notes.

    Raises
    ------
    InputError
        As for ``correct``.
    DriftRangeError
        As for ``correct``.
    """
    plans = plan_record(record, calibration)
    return correct_planned(
        record, calibration, plans, policy=policy, out=out, reference_span_c=reference_span_c, threads=threads
    )


def correct_planned(
    record: Record,
    calibration: Calibration,
    plans: Plans,
    *,
    policy: Policy = "raise",
    out: Buffers | None = None,
    reference_span_c: float = REFERENCE_SPAN_C,
    threads: int | None = None,
) -> Corrected:
    """Correct a record with plans made beforehand, as a stream has them.

    Parameters
    ----------
    record : Record
        As for ``correct``.
    calibration : Calibration
        The device's model.
    plans : tuple of two TriadPlan or None
        The same model, made ready for the units and channels of this record.
    policy : str
        "raise", "hold" or "nan".
    out : tuple of two arrays, shape (N, 3), optional
        Where to write rate and specific force.
    reference_span_c : float
        As for ``correct_checked``, degC.
    threads : int, optional
        As for ``correct_checked``.

    Returns
    -------
    Corrected
        The record, the mask, warnings and notes.

    Raises
    ------
    InputError
        Buffers that do not fit.
    DriftRangeError
        As for ``correct``.
    """
    outside = find_outside(record, plans, allowed=policy != "raise")
    outputs = out_buffers(len(record), plans, out)
    spans = in_pieces(lambda start, stop: _evaluate(record, plans, outputs, start, stop), len(record), threads)
    if policy == "nan" and outside.any():
        for plan, values in zip(plans, outputs, strict=True):
            if plan is not None and plan.tables is not None:
                values[outside] = np.nan
    turn_rate = (min(low for low, _ in spans), max(high for _, high in spans))
    reach = reach_of(record, calibration, plans, outside, turn_rate)
    return Corrected(
        record=adopt(record, plans, outputs),
        outside=outside,
        warnings=warnings_on(reach, calibration, reference_span_c),
        notes=notes_on(record, calibration),
        reach=reach,
    )
