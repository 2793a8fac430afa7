"""Sliding variance of an accelerometer, and the stills below a threshold of it.

::

    s2_k = |(var u_x, var u_y, var u_z)| over the window centred at k        sample variances, raw unit squared

A turn about the vertical does not show in an accelerometer: where there are gyroscopes, a still is cut down to its core, in
which they are as quiet as they are in most of the stills.

Running sums make window, mean and variance of any stretch cost the same whatever its length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.record import Record
from undrift.segments.still import runs
from undrift.session import Still

QUIETEST = 0.05  # share of all windows that tells the level at rest
CORE = 4.0  # variance of the gyroscopes in the core of a still, in units of their median variance in all stills


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillVariance:
    """Windowed variance of one record.

    Parameters
    ----------
    values : array, shape (N, 3)
        Readings, raw unit.
    level : array, shape (N,)
        Length of the variance vector over the window centred at each sample, raw unit squared; infinite at the ends and
        beside gaps.
    gyro_level : array, shape (N,), or None
        The same of the gyroscopes, their unit squared; None without gyroscopes.
    at_rest : float
        Value of ``level`` at rest, raw unit squared.
    sums, squares : array, shape (N + 1, 3)
        Running sums of the readings less ``centre``, and of their squares.
    centre : array, shape (3,)
        Raw unit.
    """

    values: FloatArray
    level: FloatArray
    gyro_level: FloatArray | None
    at_rest: float
    sums: FloatArray
    squares: FloatArray
    centre: FloatArray

    def below(self, threshold: float, least: int) -> list[tuple[int, int]]:
        """Return the stretches [start, stop) below a threshold.

        Parameters
        ----------
        threshold : float
            Raw unit squared.
        least : int
            Shortest stretch, samples.

        Returns
        -------
        list of (int, int)
            In order.
        """
        found = runs(self.level < threshold)
        return [(int(a), int(b)) for a, b in found[found[:, 1] - found[:, 0] >= least]]

    def cores(self, stretches: list[tuple[int, int]], least: int) -> list[tuple[int, int]]:
        """Return stills cut down to the part in which the gyroscopes are quiet too.

        Parameters
        ----------
        stretches : list of (int, int)
            Stills [start, stop).
        least : int
            Shortest core, samples; a still without one stays as it is.

        Returns
        -------
        list of (int, int)
            As many, each within its own.
        """
        if self.gyro_level is None or not stretches:
            return stretches
        limit = CORE * float(np.median(np.concatenate([self.gyro_level[a:b] for a, b in stretches])))
        kept: list[tuple[int, int]] = []
        for start, stop in stretches:
            quiet = runs(self.gyro_level[start:stop] <= limit)
            first, last = max(quiet, key=lambda run: run[1] - run[0], default=(0, 0))
            kept.append((start + int(first), start + int(last)) if last - first >= least else (start, stop))
        return kept

    def moments(self, stills: Sequence[Still]) -> tuple[FloatArray, FloatArray]:
        """Return the mean reading of each still and its variance, the noise pooled over all.

        Parameters
        ----------
        stills : sequence of Still
            Of this record, without gaps inside.

        Returns
        -------
        mean : array, shape (K, 3)
            Raw unit.
        variance : array, shape (K, 3)
            Of the mean, for white noise, raw unit squared.
        """
        start, stop = np.array([s.start for s in stills]), np.array([s.stop for s in stills])
        count = (stop - start)[:, None].astype(float)
        sums, squares = self.sums[stop] - self.sums[start], self.squares[stop] - self.squares[start]
        within = (squares - sums**2 / count).sum(axis=0) / max(1.0, float(count.sum()) - len(stills))
        return sums / count + self.centre, np.maximum(within, 0.0) / count


def still_variance(record: Record, *, window_s: float, rest_s: float | None) -> StillVariance:
    """Return the windowed variance of a record's accelerometer and its level at rest.

    Parameters
    ----------
    record : Record
        With accelerometer readings.
    window_s : float
        Length of the window, s.
    rest_s : float or None
        Opening rest that tells the level, s; None takes the quietest windows.

    Returns
    -------
    StillVariance
        Raw unit squared.

    Raises
    ------
    InputError
        No accelerometer, or a record shorter than its window or its rest.
    """
    if record.accel is None:
        raise InputError("still variance: wanted accel readings, got none; map the accelerometer columns")
    half = max(5, round(0.5 * window_s * record.sample_rate_hz))
    width = 2 * half + 1
    rest = len(record) if rest_s is None else int(np.searchsorted(record.time, record.time[0] + rest_s))
    if len(record) < width + 1 or (rest_s is not None and record.duration_s < rest_s):
        raise InputError(
            f"still variance: wanted a record longer than its window of {window_s:g} s"
            + ("" if rest_s is None else f" and its opening rest of {rest_s:g} s")
            + f", got {record.duration_s:.2f} s; shorten them"
        )
    level, sums, squares, centre = _windowed(record.accel, half)
    if rest_s is None:
        finite = level[np.isfinite(level)]
        at_rest = float(np.quantile(finite, QUIETEST)) if len(finite) else np.inf
    else:
        at_rest = float(np.linalg.norm(np.nanvar(record.accel[:rest], axis=0, ddof=1)))
    return StillVariance(
        values=record.accel,
        level=level,
        gyro_level=None if record.gyro is None else _windowed(record.gyro, half)[0],
        at_rest=at_rest,
        sums=sums,
        squares=squares,
        centre=centre,
    )


def _windowed(values: FloatArray, half: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the level over windows of 2 half + 1 samples, running sums, running sums of squares, and their centre."""
    width = 2 * half + 1
    gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
    centre = values[~gap].mean(axis=0) if not gap.all() else np.zeros(3)
    u = np.where(gap[:, None], 0.0, values - centre)
    sums, squares = np.zeros((len(u) + 1, 3)), np.zeros((len(u) + 1, 3))
    np.cumsum(u, axis=0, out=sums[1:])
    np.cumsum(u * u, axis=0, out=squares[1:])
    s, q = sums[width:] - sums[:-width], squares[width:] - squares[:-width]
    level = np.full(len(u), np.inf)
    level[half:-half] = np.linalg.norm((q - s * s / width) / (width - 1), axis=1)
    if gap.any():
        lost = np.concatenate(([0], np.cumsum(gap)))
        level[half:-half][lost[width:] > lost[:-width]] = np.inf
    return level, sums, squares, centre
