"""Axis: the emulated shaft and its servo, brought up to a moment when someone looks.

The state is advanced in whole samples of the card. Where the axis was is kept in a ring of 1 ms steps, read back by cubic
interpolation from angle and rate.
"""

from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.kernels import servo as k
from undrift.kernels.servo import Coefficients
from undrift.sim.rig.servo import ServoSettings, resting_coefficients

TELL_VELOCITY_S = 0.25  # TV is a mean over about a quarter of a second


class Axis:
    """One shaft with motor, encoder and sampled loop.

    Parameters
    ----------
    servo : ServoSettings
        The loop.
    history_s : float
        How far back `history` and `states` reach, s.
    """

    def __init__(self, servo: ServoSettings, history_s: float = 1200.0) -> None:
        self.servo = servo
        self.coefficients: Coefficients = resting_coefficients(servo)
        self.values: FloatArray = np.zeros(k.SIZE)
        length = max(16, round(history_s / (self.coefficients.stride * servo.period_s)))
        self._log_time: FloatArray = np.empty(length)
        self._log_angle: FloatArray = np.empty(length)
        self._log_rate: FloatArray = np.empty(length)
        self._log_time[0] = self._log_angle[0] = self._log_rate[0] = 0.0
        self.values[k.LOGGED] = 1.0  # the axis at rest at time zero
        self._tell: FloatArray = np.zeros(1)
        self.set_period(servo.period_s)

    def change(self, **coefficients: Any) -> None:
        """Change coefficients of the loop or the state of its parts from the next sample on.

        Parameters
        ----------
        **coefficients : float or bool
            Fields of Coefficients.
        """
        self.coefficients = self.coefficients._replace(**coefficients)

    def set_period(self, period_s: float) -> None:
        """Change the time between samples.

        Parameters
        ----------
        period_s : float
            s.
        """
        self.change(period=period_s)
        self._tell = np.full(max(2, round(TELL_VELOCITY_S / period_s)), self.values[k.COUNT])

    def warm(self) -> None:
        """Compile the loop, so that the first look does not wait for it."""
        k.servo(np.zeros(k.SIZE), self.coefficients, np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), 2)

    def advance(self, time: float) -> int:
        """Bring the axis up to a moment, or to the first event before it.

        Parameters
        ----------
        time : float
            Emulated time, s.

        Returns
        -------
        int
            What happened: one of the events of the kernel; 0 when the moment was reached.
        """
        samples = int((time - self.values[k.TIME]) / self.coefficients.period + 1e-6)
        if samples <= 0:
            return k.NOTHING
        logs = (self._log_time, self._log_angle, self._log_rate)
        return int(k.servo(self.values, self.coefficients, self._tell, *logs, samples))

    @property
    def time(self) -> float:
        """Emulated time that the axis has reached, s."""
        return float(self.values[k.TIME])

    @property
    def register(self) -> int:
        """Position register, counts: what TP tells."""
        return round(float(self.values[k.COUNT]) + self.coefficients.offset)

    @property
    def velocity_counts(self) -> int:
        """Mean speed of the last quarter of a second, counts/s: what TV tells."""
        newest: int = (int(self.values[k.SAMPLES]) - 1) % self._tell.size
        oldest = (newest + 1) % self._tell.size
        span = (self._tell.size - 1) * self.coefficients.period
        return round(float(self._tell[newest] - self._tell[oldest]) / span)

    def define(self, counts: int) -> None:
        """Call where the axis stands a number; the axis and its loop notice nothing.

        Parameters
        ----------
        counts : int
            New value of the position register.
        """
        shift = counts - (self.values[k.COUNT] + self.coefficients.offset)
        self.values[k.REFERENCE] += shift
        self.change(offset=self.coefficients.offset + shift)

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the axis was.

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s, none later than the axis has reached.

        Returns
        -------
        angle, rate : array, shape (n,)
            rad, rad/s.

        Raises
        ------
        InputError
            A time that is not reached yet, or is no longer kept.
        """
        t = np.asarray(times, float)
        time, angle, rate = self.history(max(self.time - t.min(initial=self.time), 0.0) + 0.1)
        if t.size and (t.max() > time[-1] + self.coefficients.period or t.min() < time[0]):
            raise InputError(
                f"axis state: wanted times in {time[0]:.4f}..{time[-1]:.4f} s, got {t.min():.4f}..{t.max():.4f} s; "
                "ask for what has been emulated and is still kept"
            )
        right = np.clip(np.searchsorted(time, t), 1, len(time) - 1)
        left = right - 1
        h = time[right] - time[left]
        u = (t - time[left]) / h
        rise = angle[right] - angle[left]
        v0, v1 = rate[left] * h, rate[right] * h
        square, cube = 3.0 * rise - 2.0 * v0 - v1, v0 + v1 - 2.0 * rise
        return (
            angle[left] + u * (v0 + u * (square + u * cube)),
            (v0 + u * (2.0 * square + 3.0 * u * cube)) / h,
        )

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the kept past, the present last.

        Parameters
        ----------
        last_s : float or None
            Only so much of it, s.

        Returns
        -------
        time, angle, rate : array, shape (n,)
            s, rad, rad/s; strictly increasing time.
        """
        size, logged = self._log_time.size, int(self.values[k.LOGGED])
        kept = min(size, logged)
        if last_s is not None:
            kept = min(kept, int(last_s / (self.coefficients.period * self.coefficients.stride)) + 3)
        index = np.arange(logged - kept, logged) % size
        present = (self.values[k.TIME], self.values[k.ANGLE], self.values[k.RATE])
        logs = (self._log_time, self._log_angle, self._log_rate)
        if self._log_time[index[-1]] >= present[0]:
            return logs[0][index], logs[1][index], logs[2][index]
        time, angle, rate = (np.append(log[index], value) for log, value in zip(logs, present, strict=True))
        return time, angle, rate
