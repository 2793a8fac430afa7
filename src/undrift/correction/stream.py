"""Correct a stream: the model of correction/correct.py, chunk by chunk.

No step of the model looks at another sample but those that subtract a thermometer's lag and follow a loop of hysteresis, which
hand their states on; so chunks of any length give the bits of the batch. Kept between chunks: the plans (the calibration made ready
for the kernels) and the state, which may be saved and put back. Chunks from a file can be read ahead: the next one while this one
is corrected.
"""

import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from undrift.correction.correct import (
    REFERENCE_SPAN_C,
    Corrected,
    DriftRangeWarning,
    Policy,
    correct_planned,
    re_zeroed,
)
from undrift.correction.coverage import Reach, coverage_findings
from undrift.correction.plan import Carry, Plans, carry_at_start, plan_record
from undrift.correction.rest import RestOffset
from undrift.drift.hysteresis import TempHistory
from undrift.errors import InputError
from undrift.model import Calibration
from undrift.record import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectorState:
    """How far a stream has come: enough to go on elsewhere."""

    samples: int = 0  # Corrected so far
    samples_outside: int = 0  # Of those, outside the tuning tables
    samples_extrapolated: int = 0  # Of those, inside them at nodes that no data were near
    samples_without_temperature: int = 0  # Of those, without the temperature that the tables want
    reach: Reach = field(default_factory=Reach)  # How far temperature and rate went so far, where the calibration cares
    carry: Carry = field(default_factory=Carry)  # Time of power-on, states of the lag and of the hysteresis


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
    temp_history : str or sequence of float, optional
        Course of the temperature before the first sample of the stream, degC, as for ``correct``.
    offset : RestOffset, optional
        What is left at a rest, to subtract from every chunk: ``find_rest_offset_in`` finds it in the first corrected chunks.

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
        temp_history: TempHistory | None = None,
        offset: RestOffset | None = None,
    ) -> None:
        carry_at_start(0.0, power_on_s, calibration, temp_history)  # refused now rather than at the first chunk
        self._calibration, self._policy, self._span = calibration, policy, reference_span_c
        self._power_on_s, self._offset, self._history = power_on_s, offset, temp_history
        self._plans: dict[tuple[str, str, bool, bool, bool], Plans] = {}
        self.state = CorrectorState()  # may be saved, and put back by assignment

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where the stream so far went beyond the calibration: what the batch would report, each once."""
        return tuple(found.text for found in coverage_findings(self.state.reach, self._calibration, self._span))

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
            carry = carry_at_start(float(chunk.time[0]), self._power_on_s, self._calibration, self._history)
        done = correct_planned(
            chunk,
            self._calibration,
            self._plans[key],
            policy=self._policy,
            reference_span_c=self._span,
            carry=carry,
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
        coming = pool.submit(next, chunks, None)
        while (chunk := coming.result()) is not None:
            coming = pool.submit(next, chunks, None)
            yield chunk
