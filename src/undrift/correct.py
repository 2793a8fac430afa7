"""Correct a record: the only place where a calibration is applied.

For a reading u (3,) at temperature T, in this order::

    1  u1 = u + h sign(u)         codes truncated toward zero; u + h where they were rounded down; h is half a step
    2  u2 = u1 - offset(T)        tuning table of absolute offsets, else the constant offset
    3  w  = M(T) u2               matrix, constant or over temperature
    4  w  = w - G a               g-sensitivity, gyroscopes only, a the corrected specific force
    5  w  = w - e(w, T)           dynamic drift over the measured rate, bilinear, gyroscopes only

Tables are held at their ends; a temperature beyond them is an error, is held, or becomes a gap, as ``policy`` says.
"""

import copy
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration
from undrift.drift.coverage import find_outside, notes_on, rate_warnings, temperature_warnings
from undrift.drift.lookup import Plans, TriadPlan, plan_triad
from undrift.errors import InputError
from undrift.record import Record

Policy = Literal["raise", "hold", "nan"]
Buffers = tuple[FloatArray, FloatArray]

REFERENCE_SPAN_C = 5.0  # how far from the reference temperature constant offsets are taken to hold
THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves


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
    """

    record: Record
    outside: BoolArray
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

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
    return _apply(record, calibration, _plans(record, calibration), policy, out, reference_span_c, threads)


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectorState:
    """How far a stream has come: enough to go on elsewhere.

    Parameters
    ----------
    samples : int
        Corrected so far.
    samples_outside : int
        Of those, outside the tuning tables.
    last_time : float
        Time of the last sample, s; minus infinity before the first.
    """

    samples: int = 0
    samples_outside: int = 0
    last_time: float = -np.inf


class Corrector:
    """Correct a stream chunk by chunk; the result equals the batch to the last bit.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    policy : str
        "raise", "hold" or "nan", as for ``correct``.
    reference_span_c : float
        As for ``correct_checked``, degC.
    """

    def __init__(
        self, calibration: Calibration, policy: Policy = "raise", *, reference_span_c: float = REFERENCE_SPAN_C
    ) -> None:
        self._calibration, self._policy, self._span = calibration, policy, reference_span_c
        self._plans: dict[tuple[str, str, bool, bool, bool], Plans] = {}
        self.state = CorrectorState()  # may be saved, and put back by assignment

    def push(self, chunk: Record) -> Record:
        """Correct the next chunk.

        Parameters
        ----------
        chunk : Record
            Raw readings that follow the last chunk.

        Returns
        -------
        Record
            The same samples, corrected.

        Raises
        ------
        InputError
            As for ``correct``, or a chunk that does not follow the last one in time; the state is as before.
        DriftRangeError
            As for ``correct``; the state is as before.
        """
        corrected = self.push_checked(chunk)
        for text in corrected.warnings:
            warnings.warn(text, DriftRangeWarning, stacklevel=2)
        return corrected.record

    def push_checked(self, chunk: Record) -> Corrected:
        """Correct the next chunk and say where the calibration did not cover it.

        Parameters
        ----------
        chunk : Record
            Raw readings that follow the last chunk.

        Returns
        -------
        Corrected
            The same samples, corrected, with mask, warnings and notes of this chunk.

        Raises
        ------
        InputError
            As for ``push``.
        DriftRangeError
            As for ``push``.
        """
        if chunk.time[0] <= self.state.last_time:
            raise InputError(
                f"corrector: wanted a chunk that begins after {self.state.last_time:.6g} s, got one from {chunk.time[0]:.6g} s; "
                "push chunks in order, each once"
            )
        key = (chunk.gyro_unit, chunk.accel_unit, chunk.gyro is None, chunk.accel is None, chunk.temp_c is None)
        if key not in self._plans or chunk.state == "corrected":
            self._plans[key] = _plans(chunk, self._calibration)
        done = _apply(chunk, self._calibration, self._plans[key], self._policy, None, self._span, None)
        self.state = CorrectorState(
            samples=self.state.samples + len(chunk),
            samples_outside=self.state.samples_outside + int(done.outside.sum()),
            last_time=float(chunk.time[-1]),
        )
        return done


def _plans(record: Record, calibration: Calibration) -> Plans:
    if record.state == "corrected":
        raise InputError(
            "correct: wanted raw readings, got a corrected record; correct the device's own recording, once"
        )
    gyro = None if record.gyro is None else plan_triad(calibration, "rate", record.gyro_unit)
    accel = None if record.accel is None else plan_triad(calibration, "accel", record.accel_unit)
    if gyro is not None and gyro.g_sensitivity is not None and accel is None:
        raise InputError(
            "correct: wanted accelerometer readings, which the g-sensitivity of the gyroscopes needs, got none; "
            "map the columns that hold them"
        )
    if record.temp_c is None and any(plan is not None and plan.tables is not None for plan in (gyro, accel)):
        raise InputError("correct: wanted temperatures for the tuning tables, got none; map the column temp_c")
    return gyro, accel


def _apply(
    record: Record,
    calibration: Calibration,
    plans: Plans,
    policy: Policy,
    out: Buffers | None,
    reference_span_c: float,
    threads: int | None,
) -> Corrected:
    outside = find_outside(record, plans, allowed=policy != "raise")
    gyro_out, accel_out = _buffers(len(record), plans, out)
    slices = _slices(len(record), threads)
    reached = _in_threads(lambda start, stop: _run(record, plans, (gyro_out, accel_out), start, stop), slices)
    if policy == "nan" and outside.any():
        for plan, values in zip(plans, (gyro_out, accel_out), strict=True):
            if plan is not None and plan.tables is not None:
                values[outside] = np.nan
    done = _adopted(
        record, *(None if plan is None else v for plan, v in zip(plans, (gyro_out, accel_out), strict=True))
    )
    said = (
        *temperature_warnings(record, calibration, plans, outside, reference_span_c),
        *rate_warnings(plans[0], min(low for low, _ in reached), max(high for _, high in reached)),
    )
    return Corrected(record=done, outside=outside, warnings=said, notes=notes_on(record, calibration))


def _run(record: Record, plans: Plans, outputs: Buffers, start: int, stop: int) -> tuple[float, float]:
    """Correct the samples [start, stop) and return the least and greatest rate that met the dynamic table."""
    from undrift.kernels.correct import affine_pair

    nothing, reached = np.empty(0), (np.inf, -np.inf)
    (gyro, accel), (w, a) = plans, (_flat(outputs[0], start, stop), _flat(outputs[1], start, stop))
    temp = nothing if record.temp_c is None else record.temp_c[start:stop]
    x, y = _flat(record.gyro, start, stop), _flat(record.accel, start, stop)
    g = None if gyro is None else gyro.g_sensitivity
    if gyro is not None and accel is not None and g is not None and gyro.tables is None and accel.tables is None:
        of_accel = (accel.matrix, accel.offset, accel.half_step)
        affine_pair(x, y, w, a, gyro.matrix, gyro.offset, gyro.half_step, *of_accel, g)
        return reached
    if accel is not None:
        _run_triad(accel, y, temp, nothing, a)
    if gyro is not None:
        reached = _run_triad(gyro, x, temp, nothing if g is None else a, w)
    return reached


def _run_triad(plan: TriadPlan, x: FloatArray, temp: FloatArray, a: FloatArray, out: FloatArray) -> tuple[float, float]:
    from undrift.kernels.correct import affine, subtract_g, tabulated

    g = np.zeros(9) if plan.g_sensitivity is None else plan.g_sensitivity
    if plan.tables is not None:
        least, greatest = tabulated(x, temp, a, out, plan.matrix, plan.offset, plan.half_step, g, plan.tables)
        return float(least), float(greatest)
    affine(x, out, plan.matrix, plan.offset, plan.half_step)
    if a.size:
        subtract_g(a, out, g)
    return np.inf, -np.inf


def _flat(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    return np.empty(0) if values is None else values[start:stop].reshape(-1)


def _buffers(n: int, plans: Plans, out: Buffers | None) -> Buffers:
    if out is None:
        gyro, accel = (np.empty((0 if plan is None else n, 3)) for plan in plans)
        return gyro, accel
    for plan, buffer in zip(plans, out, strict=True):
        wanted = buffer.shape == (n, 3) and buffer.dtype == np.float64 and buffer.flags.c_contiguous
        if plan is not None and not (wanted and buffer.flags.writeable):
            raise InputError(
                f"correct: wanted writeable float64 buffers of shape ({n}, 3) in C order, got {buffer.dtype} {buffer.shape}; "
                "make them with numpy.empty"
            )
    return out


def _slices(n: int, threads: int | None) -> list[tuple[int, int]]:
    count = (os.cpu_count() or 1) if threads is None and n >= THREADS_FROM else threads or 1
    bounds = [n * i // count for i in range(count + 1)]
    return [(start, stop) for start, stop in pairwise(bounds) if stop > start]


def _in_threads(
    work: Callable[[int, int], tuple[float, float]], slices: list[tuple[int, int]]
) -> list[tuple[float, float]]:
    if len(slices) == 1:
        return [work(*slices[0])]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(len(slices)) as pool:
        return list(pool.map(lambda piece: work(*piece), slices))


def _adopted(record: Record, gyro: FloatArray | None, accel: FloatArray | None) -> Record:
    """Return the record with new readings. The kernels wrote them in the right shape, so they are neither copied nor checked."""
    done = copy.copy(record)
    for name, value in (("gyro", gyro), ("accel", accel)):
        if value is not None:
            value = value.view()
            value.flags.writeable = False
        object.__setattr__(done, name, value)
    for name, text in (("gyro_unit", "rad/s"), ("accel_unit", "m/s2"), ("frame", "b"), ("state", "corrected")):
        object.__setattr__(done, name, text)
    return done
