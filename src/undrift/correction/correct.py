"""Correct a record: the only place where a calibration is applied.

For a reading u (3,) at temperature T, in this order::

    1  u1 = u + h sign(u)         for codes truncated toward zero, or u + h if codes were rounded down (h half a step)
    2  u2 = u1 - offset(T) - o(t) tuning table of absolute offsets, otherwise the constant offset, and for gyroscopes the
                                  warm-up o at the time t since power-on, if t is known
    3  w  = M(T) u2               matrix, constant or over temperature
    4  w  = w - G a               g-sensitivity with the corrected specific force a, gyroscopes only
    5  w  = w - e(w, T)           dynamic drift over the measured rate, bilinear, gyroscopes only
    6  w  = w - m(t) d            gyroscopes only, with d from a fit to references, and m = 1 while the device turns, else 0
                                  (segments.py, causal: it lags the onset of 10 deg/s by 0.02 s, the end of 200 deg/s by 1 s)
    7  w  = w - r                 on request: r is the mean of w at a rest, the remaining error of steps 1 to 6 (rest.py)
    8  h  = x - l w x x           magnetometer, x = A (m - b), with w from step 6 (without a model m is copied)

A table replaces its constant. The two are never added. T is the temperature of the sensors: the lag of the thermometer is
subtracted if the calibration has one. Beyond its ends a table keeps its end values. ``policy`` decides whether a temperature beyond
the table raises an error, gets the end value, or becomes a gap. Without a temperature the result is a gap under every policy.

``_evaluate_triad`` contains steps 1 to 5. Only the lag of the thermometer and the search for turns use other samples. Both are
causal, and pass their state to the next chunk of a stream.
"""

import warnings
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.correction import coverage
from undrift.correction.consistency import check_corrected
from undrift.correction.plan import (
    NOTHING,
    NOWHERE,
    Carry,
    Conditions,
    Constants,
    Plans,
    Reach,
    Span,
    carry_at_start,
    conditions_of,
    flat,
    force_uncertainty,
    has_tables,
    hull,
    in_pieces,
    plan_record,
)
from undrift.correction.rest import RemainingOffset, find_offset
from undrift.errors import InputError, check_choice, check_type
from undrift.findings import Finding
from undrift.model import NO_TABLES, Calibration
from undrift.record import Record
from undrift.segments import NOT_TURNING, find_turning

Buffers: TypeAlias = tuple[FloatArray, FloatArray]  # rate, rad/s, and specific force, m/s2, (N, 3)
Policy = Literal["raise", "hold", "nan"]
Offset: TypeAlias = Literal["none", "rest", "motion"] | RemainingOffset


def _evaluate_triad(plan: Constants, u: FloatArray, conditions: Conditions, a: FloatArray, w: FloatArray) -> Span:
    """Evaluate the model for a triad and write readings u to w. The force a is empty without step 4."""
    from undrift.kernels.correct import add_half_step, affine, subtract_g, tabulated, without_line

    matrix, offset = plan.matrix.ravel(), plan.offset
    g = np.zeros(9) if plan.g_sensitivity is None else plan.g_sensitivity.ravel()
    if plan.half_step is not None:
        add_half_step(u, w, plan.half_step)  # step 1
        u = w
    if plan.warm_up is not None and conditions.since.size:
        without_line(u, conditions.since, w, *plan.warm_up)  # o of step 2
        u = w
    if plan.cells is not None:  # steps 2 to 5: w = M(T) (u - offset(T)) - G a, then w - e(w, T)
        least, greatest = tabulated(u, conditions.temp_c, a, w, matrix, offset, g, plan.cells)
        return float(least), float(greatest)
    affine(u, w, matrix, offset)  # steps 2 and 3: w = M (u - offset)
    if a.size:
        subtract_g(a, w, g)  # step 4: w - G a
    return NOWHERE


def _evaluate(record: Record, plans: Plans, conditions: Conditions, outputs: Buffers, rows: slice) -> Span:
    """Evaluate the model for some samples and return the least and greatest rate that met the dynamic table."""
    from undrift.kernels.correct import affine_pair

    gyro, accel = plans
    u, v = flat(record.gyro, rows), flat(record.accel, rows)
    w, a = flat(outputs[0], rows), flat(outputs[1], rows)
    row_conditions = Conditions(*(values[rows] for values in conditions))
    g = None if gyro is None else gyro.g_sensitivity
    plain = all(plan is not None and not plan.tables and plan.half_step is None for plan in plans)
    if gyro is not None and accel is not None and g is not None and plain and not row_conditions.since.size:
        affine_pair(u, v, w, a, gyro.matrix.ravel(), gyro.offset, accel.matrix.ravel(), accel.offset, g.ravel())
        return NOWHERE  # both triads in one pass over the memory
    if accel is not None:  # accelerometers first, because step 4 needs a
        _evaluate_triad(accel, v, row_conditions, NOTHING, a)
    return NOWHERE if gyro is None else _evaluate_triad(gyro, u, row_conditions, NOTHING if g is None else a, w)


class DriftRangeWarning(UserWarning):
    """Readings were corrected beyond the range of the calibration."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrected:
    """A corrected record, with masks (N,) of the samples that the calibration did not cover."""

    record: Record  # rad/s and m/s2 in frame b, state corrected
    outside: BoolArray  # temperatures beyond a tuning table
    extrapolated: BoolArray  # temperatures and rates at nodes of a table without nearby data
    missing: BoolArray  # samples without a temperature for a table; the result is NaN under every policy
    # readings beyond the calibration (level warn), errors that it does not correct (info)
    findings: tuple[Finding, ...]
    reach: Reach  # number of samples and seconds in each mask, with the range of temperature and rate
    rest: RemainingOffset | None = None  # offset that was subtracted, with its uncertainty

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the texts of the findings of level warn."""
        return tuple(item.text for item in self.findings if item.level == "warn")

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the texts of the findings of level info."""
        return tuple(item.text for item in self.findings if item.level == "info")


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
    """Correct a device's readings to rate and specific force.

    Parameters
    ----------
    record, calibration : Record, Calibration
        Raw readings, in the calibration's unit or another physical unit, with temperatures if the calibration has tables.
    policy : str
        For samples with a temperature outside a table: "raise" an error, "hold" the end value, or return "nan".
    out : tuple of two arrays, shape (N, 3), optional
        Buffers for rate and specific force. The record then refers to these arrays.
    power_on_s : float, optional
        Time since power-on at the first sample, s. Without it no warm-up is subtracted.
    offset : str or RemainingOffset
        "rest" subtracts the mean rate at the first still phase, including any true slow turn. "motion" also subtracts the
        offset that gravity determines in motion. An object subtracts a known offset.
    check : bool
        If True, check that gyroscope and accelerometer agree and that rests fit the calibration, which takes some tens of
        milliseconds.

    Returns
    -------
    Record
        rad/s and m/s2 in frame b, state corrected. Warns with DriftRangeWarning beyond the calibration's temperatures and
        dynamic table, and if record and calibration do not agree.

    Raises
    ------
    InputError
        The calibration is not for these readings, or a requested rest is missing.
    DriftRangeError
        Under policy "raise", a temperature is outside a table.
    Implausible
        Columns, units or the sample rate are clearly wrong.

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
    corrected = correct_checked(
        record, calibration, policy=policy, out=out, power_on_s=power_on_s, offset=offset, check=check
    )
    for text in corrected.warnings:
        warnings.warn(text, DriftRangeWarning, stacklevel=2)
    return corrected.record


def correct_checked(
    record: Record,
    calibration: Calibration,
    *,
    policy: Policy = "raise",
    out: Buffers | None = None,
    threads: int | None = None,
    power_on_s: float | None = None,
    offset: Offset = "none",
    check: bool = True,
) -> Corrected:
    """Correct a record, and return findings and masks if the calibration does not cover or fit it.

    Parameters
    ----------
    record, calibration, policy, out
        As for ``correct``, which also lists the exceptions.
    threads : int, optional
        By default all processors for long records, and one for short records. The result does not depend on it.
    power_on_s, offset, check
        As for ``correct``.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> corrected = undrift.correct_checked(trial.record, calibration)
    >>> len(corrected.findings), int(corrected.outside.sum())
    (0, 0)
    """
    check_type(record, Record, "correct: `record`", "Read a file with read_record.")
    check_type(calibration, Calibration, "correct: `calibration`", "Read a file with read_calibration.")
    corrector = Corrector(calibration, policy, power_on_s=power_on_s)
    corrected = corrector.push_checked(record, out=out, threads=threads)
    if isinstance(offset, str):
        check_choice(offset, ("none", "rest", "motion"), "correct", "offset")
    if offset != "none":
        if isinstance(offset, str):
            offset = find_offset(corrected.record, offset, calibration.gyro)
        corrected = _subtract_offset(corrected, offset, out)
    if not check:
        return corrected
    stills = None if corrected.rest is None else corrected.rest.stills
    suspicions = check_corrected(corrected.record, calibration, record, stills)
    return replace(corrected, findings=(*suspicions, *corrected.findings))


def _subtract_offset(corrected: Corrected, offset: RemainingOffset, out: Buffers | None = None) -> Corrected:
    # step 7
    if corrected.record.gyro is None:
        return corrected
    rate = np.subtract(corrected.record.gyro, offset.at(corrected.record.time), out=None if out is None else out[0])
    record = corrected.record.computed(gyro=rate, offset_uncertainty=offset.uncertainty)
    return replace(corrected, record=record, rest=offset, findings=(*corrected.findings, *offset.findings))


def corrected_arrays(record: Record, calibration: Calibration) -> Buffers:
    """Return rates and specific forces as ``correct`` with policy hold, but without its checks, for many short records."""
    plans = plan_record(record, calibration)
    conditions, _ = conditions_of(record, calibration, plans, Carry())
    outputs = _buffers(len(record), plans, None)
    _evaluate(record, plans, conditions, outputs, slice(None))
    _add_rest_offset(record.time, plans, outputs, NOT_TURNING)
    return outputs


def _add_rest_offset(time: FloatArray, plans: Plans, outputs: Buffers, state: tuple[float, ...]) -> tuple[float, ...]:
    """Add the offset of a device that does not turn (step 6: the constants apply in motion), and return the next state."""
    rest_offset = None if plans[0] is None else plans[0].at_rest
    if rest_offset is None:
        return state
    outputs[0][:] += rest_offset
    turning, state = find_turning(outputs[0], time, state)
    outputs[0][turning > 0.0] -= rest_offset
    return state


def _buffers(n: int, plans: Plans, out: Buffers | None) -> Buffers:
    """Return the output arrays, new or provided by the caller."""
    if out is None:
        gyro, accel = (np.empty((0 if plan is None else n, 3)) for plan in plans)
        return gyro, accel
    for plan, buffer in zip(plans, out, strict=True):
        fits = buffer.shape == (n, 3) and buffer.dtype == np.float64 and buffer.flags.c_contiguous
        if plan is not None and not (fits and buffer.flags.writeable):
            raise InputError(
                f"correct: expected writeable float64 buffers of shape ({n}, 3) in C order, got {buffer.dtype} {buffer.shape}. "
                "Create them with numpy.empty."
            )
    return out


# ---- A stream


class Corrector:
    """Correct a stream chunk by chunk, with bit-identical results to ``correct``.

    Parameters
    ----------
    calibration, policy, power_on_s
        As for ``correct_checked``.
    offset : RemainingOffset, optional
        Offset that is subtracted from every chunk. ``find_rest_offset`` computes this offset from the first corrected chunks.

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
        power_on_s: float | None = None,
        offset: RemainingOffset | None = None,
    ) -> None:
        check_choice(policy, Policy, "correct", "policy")
        carry_at_start(0.0, power_on_s)  # refuse now rather than at the first chunk
        self._calibration, self._policy = calibration, policy
        self._power_on_s, self._offset = power_on_s, offset
        self._plans: dict[tuple[str, str, bool, bool, bool], Plans] = {}
        self.state = Carry()  # state, which may be saved and restored by assignment

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings of the stream so far, each once. They are identical to the findings of a batch."""
        return coverage.coverage_findings(self.state.reach, self._calibration)

    def push(self, chunk: Record) -> Record:
        """Return the next chunk of raw readings, which must follow the previous chunk, corrected.

        It raises the exceptions of ``correct``, and InputError for a chunk that does not follow in time. The state is then
        unchanged.
        """
        corrected = self.push_checked(chunk)
        for text in corrected.warnings:
            warnings.warn(text, DriftRangeWarning, stacklevel=2)
        return corrected.record

    def push_checked(self, chunk: Record, *, out: Buffers | None = None, threads: int | None = None) -> Corrected:
        """Correct the next chunk, as ``push`` does, and return it with its masks and findings."""
        time, before = chunk.time, self.state.last_time
        if before is not None and time[0] <= before:
            raise InputError(
                f"corrector: expected a chunk that begins after {before:.6g} s, got one from {time[0]:.6g} s. "
                "Push chunks in order, each once."
            )
        carry = self.state if before is not None else carry_at_start(float(time[0]), self._power_on_s)
        calibration, plans = self._calibration, self._plans_for(chunk)
        conditions, coming = conditions_of(chunk, calibration, plans, carry)
        temp_c = conditions.temp_c
        # If any value is NaN, the minimum is NaN. Masks stay None if nothing is marked, so most records need no second pass.
        missing = np.isnan(temp_c) if has_tables(plans) and np.isnan(temp_c.min()) else None
        outside = coverage.find_outside(
            chunk, temp_c, plans, calibration.drift or NO_TABLES, allowed=self._policy != "raise", before=before
        )
        outputs = _buffers(len(chunk), plans, out)
        spans = in_pieces(partial(_evaluate, chunk, plans, conditions, outputs), len(chunk), threads)
        coming = replace(coming, turning=_add_rest_offset(time, plans, outputs, carry.turning))
        extrapolated = coverage.find_extrapolated(temp_c, plans, outputs)
        if self._policy == "nan" and outside is not None:
            for plan, values in zip(plans, outputs, strict=True):
                if plan is not None and plan.tables:
                    values[outside] = np.nan
        masks = {"outside": outside, "extrapolated": extrapolated, "without_temperature": missing}
        amounts: dict[str, Any] = {
            f"samples_{name}": int(mask.sum()) for name, mask in masks.items() if mask is not None
        }
        amounts |= {f"seconds_{name}": coverage.seconds_of(mask, time, before) for name, mask in masks.items()}
        span_c, departure_c = coverage.temperature_reach(temp_c, calibration, plans)
        reach = Reach(samples=len(chunk), temp_c=span_c, departure_c=departure_c, turn_rate=hull(*spans), **amounts)
        coming = replace(coming, reach=carry.reach.joined(reach))
        field = chunk.mag_ut
        if (
            calibration.magnetometer is not None and field is not None
        ):  # step 8 (without rates its lag is not corrected)
            field = calibration.magnetometer.corrected(field, outputs[0] if len(outputs[0]) else None)
        unmarked = np.broadcast_to(np.False_, len(chunk))  # allocating memory takes a tenth of the kernel's time
        corrected = Corrected(
            record=chunk.computed(
                gyro=None if plans[0] is None else outputs[0],
                accel=None if plans[1] is None else outputs[1],
                mag_ut=field,
                gyro_unit="rad/s",
                accel_unit="m/s2",
                frame="b",
                state="corrected",
                accel_uncertainty=force_uncertainty(calibration, chunk.accel_unit),
            ),
            outside=unmarked if outside is None else outside,
            extrapolated=unmarked if extrapolated is None else extrapolated,
            missing=unmarked if missing is None else missing,
            findings=(
                *coverage.coverage_findings(reach, calibration),
                *coverage.model_findings(chunk, calibration, coming),
            ),
            reach=reach,
        )
        self.state = coming
        return corrected if self._offset is None else _subtract_offset(corrected, self._offset)

    def _plans_for(self, chunk: Record) -> Plans:
        """Return the constants for the units and channels of a chunk, computed once."""
        key = (chunk.gyro_unit, chunk.accel_unit, chunk.gyro is None, chunk.accel is None, chunk.temp_c is None)
        if key not in self._plans or chunk.state == "corrected":
            self._plans[key] = plan_record(chunk, self._calibration)
        return self._plans[key]
