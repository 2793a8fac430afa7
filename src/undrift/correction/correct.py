"""Correct a record: the only place where a calibration is applied.

For a reading u (3,) at temperature T, in this order::

    1  u1 = u + h sign(u)         codes truncated toward zero; u + h where they were rounded down; h is half a step
    2  u2 = u1 - offset(T) - o(t) tuning table of absolute offsets, else the constant offset; o is the warm-up of a device that
                                  was switched on t ago, if t is known; gyroscopes only
    3  w  = M(T) u2               matrix, constant or over temperature
    4  w  = w - G a               g-sensitivity, gyroscopes only, a the corrected specific force
    5  w  = w - e(w, T)           dynamic drift over the measured rate, bilinear, gyroscopes only
    6  w  = w - m(t) d            where a fit to references has d: m is 1 while the device turns, else 0 (segments.py), which looks
                                  back only: it lags the onset of 10 deg/s by 0.02 s, the end of 200 deg/s by 1 s; gyroscopes only
    7  w  = w - r                 on request: the mean of w at a rest, which takes what steps 1 to 6 leave there (rest.py)
    8  h  = x - l w x x           magnetometer, x = A (m - b) and w that of step 6; without a model m is carried along

A table takes the place of its constant, it is never added to one. T is the temperature of the sensors, with the thermometer's lag
subtracted where the calibration knows it. Tables are held at their ends; a temperature beyond them is an error, is held, or becomes
a gap, as ``policy`` states. Without a temperature the result is a gap under every policy.

``_evaluate_triad`` is where these lines are. Around it: plan.py turns the calibration into what the kernels take, coverage.py
finds what it does not cover, and ``Corrector`` does the same chunk by chunk: no step looks at another sample but those that
subtract a thermometer's lag and find turns, which look back only and hand their states on.
"""

import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, Union

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.correction import coverage
from undrift.correction.consistency import check_corrected
from undrift.correction.plan import (
    NOTHING,
    Carry,
    Conditions,
    Plans,
    TriadPlan,
    carry_at_start,
    conditions_of,
    flat,
    force_uncertainty,
    has_tables,
    in_pieces,
    plan_record,
)
from undrift.correction.rest import RestOffset, find_rest_offset, known_rest_offset, moved_by
from undrift.errors import InputError, check_choice
from undrift.findings import Finding
from undrift.model import NO_TABLES, Calibration, TriadModel
from undrift.record import Record
from undrift.segments import find_turning

if TYPE_CHECKING:
    from undrift.correction.motion import MotionOffset

Buffers: TypeAlias = tuple[FloatArray, FloatArray]  # rate, rad/s, and specific force, m/s2, (N, 3)
Policy = Literal["raise", "hold", "nan"]
OffsetLeft: TypeAlias = Union[RestOffset, "MotionOffset"]  # What a calibration leaves of the offset
Offset: TypeAlias = Literal["none", "rest", "motion"] | OffsetLeft

REFERENCE_SPAN_C = 5.0  # how far from the reference temperature constant offsets are taken to hold


def _evaluate_triad(plan: TriadPlan, u: FloatArray, at: Conditions, a: FloatArray, w: FloatArray) -> coverage.Span:
    """Evaluate the model for one triad: readings u to w; a is empty where step 4 has nothing to do."""
    from undrift.kernels.correct import affine, subtract_g, tabulated, without_line

    g = np.zeros(9) if plan.g_sensitivity is None else plan.g_sensitivity
    h = plan.half_step
    if plan.warm_up is not None and at.since.size:  # step 1, and o of step 2
        without_line(u, at.since, w, h, *plan.warm_up)
        u, h = w, np.zeros(3)
    if plan.tables is not None:  # steps 1 to 5: w = M(T) (u + h sign(u) - offset(T)) - G a, then w - e(w, T)
        least, greatest = tabulated(u, at.temp_c, a, w, plan.matrix, plan.offset, h, g, plan.tables)
        return float(least), float(greatest)
    affine(u, w, plan.matrix, plan.offset, h)  # steps 1 to 3: w = M (u + h sign(u) - offset)
    if a.size:
        subtract_g(a, w, g)  # step 4: w - G a
    return coverage.NOWHERE


def _evaluate(record: Record, plans: Plans, conditions: Conditions, outputs: Buffers, rows: slice) -> coverage.Span:
    """Evaluate the model for some samples and return the least and greatest rate that met the dynamic table."""
    from undrift.kernels.correct import affine_pair

    gyro, accel = plans
    u, v = flat(record.gyro, rows.start, rows.stop), flat(record.accel, rows.start, rows.stop)
    w, a = flat(outputs[0], rows.start, rows.stop), flat(outputs[1], rows.start, rows.stop)
    at = Conditions(*(values[rows] for values in conditions))
    g = None if gyro is None else gyro.g_sensitivity
    plain = all(plan is not None and plan.tables is None for plan in plans) and not at.since.size
    if gyro is not None and accel is not None and g is not None and plain:
        of_accel = (accel.matrix, accel.offset, accel.half_step)  # both triads in one pass over the memory
        affine_pair(u, v, w, a, gyro.matrix, gyro.offset, gyro.half_step, *of_accel, g)
        return coverage.NOWHERE
    if accel is not None:  # first, since step 4 wants a
        _evaluate_triad(accel, v, at, NOTHING, a)
    return coverage.NOWHERE if gyro is None else _evaluate_triad(gyro, u, at, NOTHING if g is None else a, w)


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
    extrapolated : array, shape (N,)
        True where it lay inside, at nodes that no data were near.
    missing : array, shape (N,)
        True where a tuning table found no temperature: what it corrects is NaN there, whatever the policy.
    findings : tuple of Finding
        Codes ``correct.*``: what went beyond the calibration (level warn), and what a reader may not expect (level info).
    reach : Reach
        How far temperature and rate went, where the calibration cares.
    carry : Carry
        What the next chunk of a stream needs.
    rest : RestOffset, MotionOffset or None
        What was subtracted of the offset, left at a rest or shown by the motion, with its uncertainty.
    """

    record: Record
    outside: BoolArray
    extrapolated: BoolArray
    missing: BoolArray
    findings: tuple[Finding, ...]
    reach: coverage.Reach
    carry: Carry
    rest: OffsetLeft | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What went beyond the calibration: temperature, span of the constant offsets, rate."""
        return tuple(found.text for found in self.findings if found.level == "warn")

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader may not expect: a triad without a model, another device, hysteresis, a warm-up left in."""
        return tuple(found.text for found in self.findings if found.level == "info")

    @property
    def seconds_outside(self) -> float:
        """Time spent outside the tuning tables, s."""
        return self.reach.seconds_outside

    @property
    def seconds_extrapolated(self) -> float:
        """Time spent inside the tuning tables at nodes that no data were near, s."""
        return self.reach.seconds_extrapolated

    @property
    def seconds_without_temperature(self) -> float:
        """Time without the temperature that the tuning tables want, s."""
        return self.reach.seconds_without_temperature


def correct(
    record: Record,
    calibration: Calibration,
    *,
    policy: Policy = "raise",
    out: Buffers | None = None,
    power_on_s: float | None = None,
    offset: Offset = "none",
    check: bool = True,
) -> Record:
    """Turn a device's readings into rate and specific force.

    Parameters
    ----------
    record : Record
        Raw readings, in the calibration's unit or another physical one; temperatures where the calibration has tables.
    calibration : Calibration
        The device's model.
    policy : str
        What becomes of samples whose temperature lies outside a table: "raise", "hold" the table's end, or "nan". Samples
        without a temperature are gaps under each: no value is made up for them.
    out : tuple of two arrays, shape (N, 3), optional
        Where to write rate and specific force; saves fresh arrays, and the record then lives on these.
    power_on_s : float, optional
        Time since power-on at the first sample, s; without it no warm-up is subtracted, and a note of ``correct_checked`` says
        how large it is.
    offset : str, RestOffset or MotionOffset
        "rest" subtracts the mean rate that is left at the first still phase, and with it any true slow turn; "motion" also what
        gravity shows while the device moves; an object subtracts one that was found before. A note of ``correct_checked``
        states it with its uncertainty.
    check : bool
        Look whether gyroscope and accelerometer agree and rests fit the calibration, as ``correct_checked`` does: some tens of
        milliseconds.

    Returns
    -------
    Record
        rad/s and m/s2 in frame b, state corrected. Warns with DriftRangeWarning beyond the calibration's range, and where record
        and calibration do not fit.

    Raises
    ------
    InputError
        Readings corrected already, in a unit that the calibration does not know, or without the temperatures it needs; a
        negative power_on_s; no rest where one is asked for.
    DriftRangeError
        Temperatures outside a table under policy "raise".
    Implausible
        Columns, units or a sample rate that clearly are others than stated.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> corrected = undrift.correct(trial.record, calibration)
    >>> corrected.gyro_unit, corrected.accel_unit, corrected.frame
    ('rad/s', 'm/s2', 'b')
    """
    corrected = correct_whole(record, calibration, power_on_s, offset, policy=policy, out=out)
    found = _suspicions(corrected, calibration, record) if check else ()
    for text in (*(one.text for one in found), *corrected.warnings):
        warnings.warn(text, DriftRangeWarning, stacklevel=2)
    return corrected.record


def correct_checked(
    record: Record,
    calibration: Calibration,
    *,
    policy: Policy = "raise",
    reference_span_c: float = REFERENCE_SPAN_C,
    threads: int | None = None,
    power_on_s: float | None = None,
    offset: Offset = "none",
) -> Corrected:
    """Correct a record and say where the calibration did not cover it, or where record and calibration do not fit.

    Parameters
    ----------
    record : Record
        As for ``correct``.
    calibration : Calibration
        The device's model.
    policy : str
        "raise", "hold" or "nan".
    reference_span_c : float
        Without a table, warn where the temperature departs from the reference by more than this, degC.
    threads : int, optional
        Default: all processors for long records, one for short ones. The bits of the result do not depend on it.
    power_on_s : float, optional
        As for ``correct``, s.
    offset : str, RestOffset or MotionOffset
        As for ``correct``.

    Returns
    -------
    Corrected
        The record, the masks and the findings.

    Raises
    ------
    InputError
        As for ``correct``.
    DriftRangeError
        As for ``correct``.
    Implausible
        Columns, units or a sample rate that clearly are others than stated.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> done = undrift.correct_checked(trial.record, calibration)
    >>> len(done.findings), int(done.outside.sum())
    (0, 0)
    """
    how = {"policy": policy, "reference_span_c": reference_span_c, "threads": threads}
    done = correct_whole(record, calibration, power_on_s, offset, **how)
    return replace(done, findings=(*_suspicions(done, calibration, record), *done.findings))


def _suspicions(done: Corrected, calibration: Calibration, record: Record) -> tuple[Finding, ...]:
    """Return what speaks against a record or its calibration; still phases that step 7 has found are not looked for again."""
    return check_corrected(done.record, calibration, record, None if done.rest is None else done.rest.stills)


def correct_whole(
    record: Record,
    calibration: Calibration,
    power_on_s: float | None = None,
    offset: Offset = "none",
    **how: Any,
) -> Corrected:
    """Correct a record from its start; `how` is for correct_planned."""
    carry = carry_at_start(float(record.time[0]), power_on_s)
    done = correct_planned(record, calibration, plan_record(record, calibration), carry=carry, **how)
    return re_zeroed(done, offset, how.get("threads"), calibration.gyro)


def re_zeroed(
    done: Corrected, offset: Offset, threads: int | None = None, model: TriadModel | None = None
) -> Corrected:
    """Subtract what is left of the offset from a record that was just corrected, in its own buffer: step 7."""
    if offset == "none":
        return done
    if isinstance(offset, str):
        check_choice(offset, ("rest", "motion"), "correct", "offset")
        rest = find_rest_offset(done.record) if offset == "rest" else known_rest_offset(done.record)
        offset = offset_left(done.record, offset, rest, model)
    remainder: OffsetLeft = offset
    rate, time = done.record.gyro, done.record.time
    if rate is None:
        return done

    def subtract(start: int, stop: int) -> None:
        rate[start:stop] -= remainder.at(time[start:stop])

    rate.flags.writeable = True
    in_pieces(subtract, len(rate), threads)
    rate.flags.writeable = False
    object.__setattr__(done.record, "offset_uncertainty", remainder.uncertainty)
    return replace(done, rest=remainder, findings=(*done.findings, *remainder.findings))


def offset_left(
    record: Record, offset: Literal["rest", "motion"], rest: RestOffset | None, model: TriadModel | None
) -> OffsetLeft:
    """Return what a calibration leaves of the offset of a corrected record: at the rest, or in motion, from a rest on if any."""
    if offset == "rest" and rest is not None:
        return replace(rest, moved=moved_by(model))
    from undrift.correction.motion import find_motion_offset  # scipy and a kernel, for this alone

    return find_motion_offset(record, rest, model)


def correct_planned(
    record: Record,
    calibration: Calibration,
    plans: Plans,
    *,
    policy: Policy = "raise",
    out: Buffers | None = None,
    reference_span_c: float = REFERENCE_SPAN_C,
    threads: int | None = None,
    carry: Carry = Carry(),
) -> Corrected:
    """Correct a record with plans made beforehand, as a stream has them."""
    check_choice(policy, Policy, "correct", "policy")
    conditions, coming = conditions_of(record, calibration, plans, carry)
    temp_c = conditions.temp_c
    # A least value is NaN where any is. Masks stay None where nothing is marked: most records need no second pass over them.
    before, missing = carry.last_time, np.isnan(temp_c) if has_tables(plans) and np.isnan(temp_c.min()) else None
    drift, allowed = calibration.drift or NO_TABLES, policy != "raise"
    outside = coverage.find_outside(record, temp_c, plans, drift, allowed=allowed, before=before)
    outputs = _buffers(len(record), plans, out)

    def evaluate(start: int, stop: int) -> coverage.Span:
        return _evaluate(record, plans, conditions, outputs, slice(start, stop))

    spans = in_pieces(evaluate, len(record), threads)
    if plans[0] is not None and plans[0].at_rest is not None:  # step 6: the constants hold in motion
        outputs[0][:] += plans[0].at_rest
        turning, state = find_turning(outputs[0], record.time, carry.turning)
        outputs[0][turning > 0.0] -= plans[0].at_rest
        coming = replace(coming, turning=state)
    extrapolated, stated = coverage.find_extrapolated(record, temp_c, plans, outputs, threads)
    if policy == "nan" and outside is not None:
        for plan, values in zip(plans, outputs, strict=True):
            if plan is not None and plan.tables is not None:
                values[outside] = np.nan
    unmarked = np.broadcast_to(np.False_, len(record))  # fresh memory costs as much as a tenth of the kernel
    span_c, departure_c = coverage.temperature_reach(temp_c, calibration, plans)
    reach = coverage.Reach(
        temp_c=span_c,
        departure_c=departure_c,
        seconds_outside=coverage.seconds_of(outside, record.time, before),
        turn_rate=(min(low for low, _ in spans), max(high for _, high in spans)),
        seconds_extrapolated=coverage.seconds_of(extrapolated, record.time, before),
        stated=stated,
        seconds_without_temperature=coverage.seconds_of(missing, record.time, before),
    )
    return Corrected(
        record=_adopted(record, plans, outputs, _field(record, calibration, outputs[0]), calibration),
        outside=unmarked if outside is None else outside,
        extrapolated=unmarked if extrapolated is None else extrapolated,
        missing=unmarked if missing is None else missing,
        findings=(
            *coverage.coverage_findings(reach, calibration, reference_span_c),
            *coverage.model_findings(record, calibration, coming),
        ),
        reach=reach,
        carry=coming,
    )


def _buffers(n: int, plans: Plans, out: Buffers | None) -> Buffers:
    """The arrays to write to: fresh ones, or the caller's."""
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


def _field(record: Record, calibration: Calibration, rate: FloatArray) -> FloatArray | None:
    """Return the magnetic field in the axes of the gyroscopes, uT: step 8; without their rate its lag stays."""
    made = calibration.magnetometer
    if made is None or record.mag_ut is None:
        return record.mag_ut
    x = (record.mag_ut - made.model.offset) @ made.model.matrix.T
    field: FloatArray = x - made.lag_s * np.cross(rate, x) if len(rate) else x
    field.flags.writeable = False
    return field


def _adopted(
    record: Record, plans: Plans, buffers: Buffers, field: FloatArray | None, calibration: Calibration
) -> Record:
    """The record with corrected readings; the kernels wrote them in the right shape: neither copied nor checked again."""
    done, values = object.__new__(Record), {name: getattr(record, name) for name in Record.__slots__}
    for name, plan, buffer in zip(("gyro", "accel"), plans, buffers, strict=True):
        values[name] = None if plan is None else buffer.view()
        if plan is not None:
            values[name].flags.writeable = False
    values |= {
        "gyro_unit": "rad/s",
        "accel_unit": "m/s2",
        "frame": "b",
        "state": "corrected",
        "accel_uncertainty": force_uncertainty(calibration, record.accel_unit),
        "mag_ut": field,
    }
    for name, value in values.items():
        object.__setattr__(done, name, value)
    return done


# ---- A stream


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectorState:
    """How far a stream has come: enough to go on elsewhere."""

    samples: int = 0  # Corrected so far
    samples_outside: int = 0  # Of those, outside the tuning tables
    samples_extrapolated: int = 0  # Of those, inside them at nodes that no data were near
    samples_without_temperature: int = 0  # Of those, without the temperature that the tables want
    reach: coverage.Reach = field(
        default_factory=coverage.Reach
    )  # How far temperature and rate went so far, where the calibration cares
    carry: Carry = field(default_factory=Carry)  # Time of power-on, state of the lag


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
    power_on_s : float, optional
        Time since power-on at the first sample of the stream, s, as for ``correct``.
    offset : RestOffset or MotionOffset, optional
        What is left at a rest or in motion, to subtract from every chunk: ``find_rest_offset_in`` finds the former in the first
        corrected chunks.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> corrector = undrift.Corrector(calibration)
    >>> whole, n = undrift.correct(trial.record, calibration), len(trial.record)
    >>> chunks = [corrector.push(trial.record.part(first, min(first + 100, n))) for first in range(0, n, 100)]
    >>> bool((np.concatenate([chunk.gyro for chunk in chunks]) == whole.gyro).all())
    True
    """

    def __init__(
        self,
        calibration: Calibration,
        policy: Policy = "raise",
        *,
        reference_span_c: float = REFERENCE_SPAN_C,
        power_on_s: float | None = None,
        offset: OffsetLeft | None = None,
    ) -> None:
        check_choice(policy, Policy, "correct", "policy")
        carry_at_start(0.0, power_on_s)  # refused now rather than at the first chunk
        self._calibration, self._policy, self._span = calibration, policy, reference_span_c
        self._power_on_s, self._offset = power_on_s, offset
        self._plans: dict[tuple[str, str, bool, bool, bool], Plans] = {}
        self.state = CorrectorState()  # may be saved, and put back by assignment

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where the stream so far went beyond the calibration, as texts."""
        return tuple(found.text for found in self.findings)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Where the stream so far went beyond the calibration: what the batch would report, each once."""
        return coverage.coverage_findings(self.state.reach, self._calibration, self._span)

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
            The same samples, corrected, with masks and findings of this chunk.

        Raises
        ------
        InputError
            As for ``push``.
        DriftRangeError
            As for ``push``.
        """
        last_time = self.state.carry.last_time
        if last_time is not None and chunk.time[0] <= last_time:
            raise InputError(
                f"corrector: wanted a chunk that begins after {last_time:.6g} s, got one from {chunk.time[0]:.6g} s; "
                "push chunks in order, each once"
            )
        key = (chunk.gyro_unit, chunk.accel_unit, chunk.gyro is None, chunk.accel is None, chunk.temp_c is None)
        if key not in self._plans or chunk.state == "corrected":
            self._plans[key] = plan_record(chunk, self._calibration)
        carry = self.state.carry
        if not self.state.samples:
            carry = carry_at_start(float(chunk.time[0]), self._power_on_s)
        done = correct_planned(
            chunk, self._calibration, self._plans[key], policy=self._policy, reference_span_c=self._span, carry=carry
        )
        done = done if self._offset is None else re_zeroed(done, self._offset)
        self.state = CorrectorState(
            samples=self.state.samples + len(chunk),
            samples_outside=self.state.samples_outside + int(done.outside.sum()),
            samples_extrapolated=self.state.samples_extrapolated + int(done.extrapolated.sum()),
            samples_without_temperature=self.state.samples_without_temperature + int(done.missing.sum()),
            reach=self.state.reach.joined(done.reach),
            carry=done.carry,
        )
        return done


def read_ahead(chunks: Iterator[Record]) -> Iterator[Record]:
    """Read the next chunk in a second thread while the caller works on this one."""
    with ThreadPoolExecutor(1) as pool:
        take = partial(next, chunks, None)
        coming = pool.submit(copy_context().run, take)  # who watches the reading is known there too
        while (chunk := coming.result()) is not None:
            coming = pool.submit(copy_context().run, take)
            yield chunk
