"""Table rate: a ripple of the table's rate with its angle, and how it settles, by the gyroscope of the turned axis.

Dwell i at the stated rate w_i, psi the table's angle, t since its start, turned about k::

    reading_k = o_i + S_k w_i (1 + r(psi, t))
    r = a cos psi + b sin psi + c cos 2 psi + d sin 2 psi + sum_j e_j exp(-t / T_j)
    mean rate = w_i (1 + rho_i)        rho_i the mean of r over the dwell

a to d are those of one mounting in one recording, since psi is the integral of the gyroscope; e_j those of a mounting. o_i is
free, so only what changes within a dwell determines them, and no scale factor enters. Terms once a turn, twice a turn and those
of settling are groups of a size of their own, each in where it shows (fit/least_squares.py). What of the rate is left beyond
the noise counts as white. Stated rates that are measured means hold all of that already: where the means of the readings follow
them better, rho is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.fit.least_squares import GROUP_SHOWS, block_size, fit_components
from undrift.model import AXES
from undrift.record import Record, Turn

SHOWS = 3.0  # standard errors of a scatter that exceeds another, for it to count
# Half octaves: how a table settles lies between, and so does what its shape leaves unknown
_SETTLES_S = (0.15, 0.21, 0.3, 0.42, 0.6, 0.85, 1.2)
_LEAST_BLOCKS = 4  # in a dwell, for its unevenness
_PASSES = 4  # of fit and noise
_LEAST_NOISE = 1e-7  # of block means, of the rate: below any gyroscope, and sound arithmetic
_FIRST = 1e-6  # variance of a term to begin with: 0.1 % of the rate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dwells:
    """The dwells of a session as its recordings hold them."""

    records: Sequence[Record]
    turns: Sequence[Turn]  # Those with an axis and a rate
    mounting: IntArray  # (N,), number of the mounting of each
    reading: FloatArray  # (N, 3), mean gyroscope reading of each
    up: FloatArray  # (N,), 1 where +axis points up, -1 down, 0 where it is not vertical
    settle_s: float  # Start of each that is left out, s

    def settled(self, k: int) -> slice:
        """Return the settled samples of a dwell."""
        turn = self.turns[k]
        time = self.records[turn.recording].time[turn.start : turn.stop]
        return slice(turn.start + int(np.searchsorted(time, time[0] + self.settle_s)), turn.stop)

    @property
    def sizes(self) -> list[int]:
        """Samples of a block of each dwell, (N,)."""
        of = {k: block_size(self.records[k].sample_rate_hz) for k in {turn.recording for turn in self.turns}}
        return [of[turn.recording] for turn in self.turns]

    @property
    def own(self) -> IntArray:
        """Number of the axis of each dwell, (N,)."""
        return np.array([AXES.index(turn.axis or "x") for turn in self.turns], int)

    @property
    def turn_rate(self) -> FloatArray:
        """Stated rate of each dwell, (N,), rad/s."""
        return np.array([turn.turn_rate for turn in self.turns], float)

    @property
    def lines(self) -> FloatArray:
        """Scale factor and offset of each sensor by its own dwells, (3, 2); NaN where these do not show them."""
        return np.array([_line(self.turn_rate[self.own == k], self.reading[self.own == k, k]) for k in range(3)])

    def codes(self, *, rate: bool) -> FloatArray:
        """Return the variance that rounding to codes leaves in a mean of each sensor (3,), its unit squared."""
        windows = [
            self.records[turn.recording].gyro if rate else self.records[turn.recording].accel for turn in self.turns
        ]
        parts = [np.asarray(values)[self.settled(n)] for n, values in enumerate(windows) if values is not None]
        scatter = np.nanmedian([np.nanvar(part, axis=0) for part in parts], axis=0) if parts else np.zeros(3)
        return code_variance(code_steps(self.records, rate=rate), scatter)


def _line(rate: FloatArray, reading: FloatArray) -> FloatArray:
    if len(np.unique(rate)) < 2:
        return np.full(2, np.nan)
    return np.asarray(np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0])


def azimuths(dwells: Dwells, rows: list[int], line: FloatArray) -> list[FloatArray] | None:
    """Return the angle of the table (M,) in the settled part of dwells of one recording; None where a gap hides it."""
    k, record = int(dwells.own[rows[0]]), dwells.records[dwells.turns[rows[0]].recording]
    begin, end = min(dwells.turns[n].start for n in rows), max(dwells.turns[n].stop for n in rows)
    if record.gyro is None or np.isnan(line).any() or np.isnan(record.gyro[begin:end]).any():
        return None
    rate = (record.gyro[begin:end, k] - line[1]) / line[0]
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])
    angle = np.concatenate(([0.0], np.cumsum(step)))
    return [angle[dwells.settled(n).start - begin : dwells.settled(n).stop - begin] for n in rows]


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Return means (E, C) of whole blocks of values (N, C)."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, -1).mean(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnevenRate:
    """By how much the mean rate of each dwell is off the stated one, relative."""

    ratio: FloatArray  # (N,), rho
    covariance: FloatArray  # (N, N)
    size: FloatArray  # (3,), rms of terms once a turn, twice a turn and of settling, relative; 0 where they do not show


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Piece:
    """One dwell: the terms that may change its rate, and its reading."""

    dwell: int
    own: int  # Number of its axis
    places: list[int]  # Of its terms among all parameters
    mean: FloatArray  # (T,), of its terms
    away: FloatArray  # (E, T + 1), block means of its terms and of the reading over S w, less their mean
    drive: float  # |S w|, unit of the reading


def uneven_rate(dwells: Dwells) -> UnevenRate:
    """Fit ripple and settling to what the gyroscope of the turned axis reads within the dwells."""
    count, codes = len(dwells.own), np.nan_to_num(dwells.codes(rate=True))
    pieces, groups = _pieces(dwells)
    width = sum(map(len, groups))
    theta: FloatArray = np.zeros(width)
    covariance: FloatArray = np.zeros((width, width))
    noise, size = np.zeros(3), np.zeros(3)
    for _ in range(_PASSES if pieces else 0):
        noise = _left(pieces, theta, covariance, noise) + codes
        normal, moment = np.zeros((width, width)), np.zeros(width)
        for one in pieces:
            weighted = one.away * one.drive / noise[one.own] ** 0.5
            normal[np.ix_(one.places, one.places)] += weighted[:, :-1].T @ weighted[:, :-1]
            moment[one.places] += weighted[:, :-1].T @ weighted[:, -1]
        found = fit_components(normal, moment, np.zeros(width), groups, np.zeros(3), _FIRST)
        theta, covariance, size = found.theta, found.covariance, np.sqrt(found.variance)
    mean, jitter = np.zeros((count, width)), np.zeros(count)
    more = _jitter(dwells, noise)
    for one in pieces:
        mean[one.dwell, one.places] = one.mean
        jitter[one.dwell] = more[one.own] / len(one.away) / one.drive**2
    ratio, spread = mean @ theta, mean @ covariance @ mean.T
    if _measured(dwells, pieces, noise, ratio, np.diag(spread)):
        ratio, spread, size = 0.0 * ratio, 0.0 * spread, np.zeros(3)
    return UnevenRate(ratio=ratio, covariance=spread + np.diag(jitter), size=size)


def _measured(dwells: Dwells, pieces: list[_Piece], noise: FloatArray, ratio: FloatArray, spread: FloatArray) -> bool:
    """Return whether the stated rates are measured means: readings follow them, and not those that the terms make."""
    better = 0.0
    for k in range(3):
        own = [one for one in pieces if one.own == k]
        rows = [one.dwell for one in own]
        variance = np.array([noise[k] / len(one.away) + one.drive**2 * spread[one.dwell] for one in own])
        root, rates = np.sqrt(variance), dwells.turn_rate[rows]
        for sign, rate in ((-1.0, rates), (1.0, rates * (1.0 + ratio[rows]))):
            design, reading = (
                np.column_stack((rate, np.ones_like(rate))) / root[:, None],
                dwells.reading[rows, k] / root,
            )
            left = reading - design @ np.linalg.lstsq(design, reading, rcond=None)[0]
            better += sign * float(left @ left)
    return better > GROUP_SHOWS


def _pieces(dwells: Dwells) -> tuple[list[_Piece], list[IntArray]]:
    """Return the dwells that show how even their rate is, and the places of the terms of each group."""
    own, lines, rates, sizes = dwells.own, dwells.lines, dwells.turn_rate, dwells.sizes
    phases: list[tuple[list[int], list[FloatArray]]] = []
    for key in sorted({(t.recording, int(m)) for t, m in zip(dwells.turns, dwells.mounting, strict=True)}):
        rows = [n for n, t in enumerate(dwells.turns) if (t.recording, int(dwells.mounting[n])) == key]
        for part in (rows, *([n] for n in rows)):  # a gap between dwells leaves each a phase of its own
            angles = azimuths(dwells, part, lines[own[part[0]]])
            if angles is not None:
                phases.append((part, angles))
                if part is rows:
                    break
    mounts = sorted(set(dwells.mounting.tolist()))
    last, found = 4 * len(phases), []
    for number, (part, angles) in enumerate(phases):
        for n, psi in zip(part, angles, strict=True):
            window, drive = dwells.settled(n), lines[own[n], 0] * rates[n]
            if rates[n] == 0.0 or len(psi) < _LEAST_BLOCKS * sizes[n]:
                continue
            record = dwells.records[dwells.turns[n].recording]
            since = record.time[window] - record.time[dwells.turns[n].start]
            waves = [np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi)]
            terms = np.column_stack([*waves, *(np.exp(-since / settle) for settle in _SETTLES_S)])
            means = block_means(np.column_stack((terms, np.asarray(record.gyro)[window, own[n]] / drive)), sizes[n])
            late = last + len(_SETTLES_S) * mounts.index(dwells.mounting[n])
            places = [*range(4 * number, 4 * number + 4), *range(late, late + len(_SETTLES_S))]
            piece = _Piece(
                dwell=n, own=int(own[n]), places=places, mean=terms.mean(axis=0), away=means - means.mean(axis=0), drive=abs(drive)
            )  # fmt: skip
            found.append(piece)
    turned = np.arange(last).reshape(-1, 2, 2)
    return found, [turned[:, 0].ravel(), turned[:, 1].ravel(), np.arange(last, last + len(_SETTLES_S) * len(mounts))]


def _left(pieces: list[_Piece], theta: FloatArray, covariance: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the variance (3,) of block means of each sensor about its own axis that the terms leave; 1 where it has none."""
    square, spare = np.zeros(3), np.zeros(3)
    for one in pieces:
        terms = one.away[:, :-1] * one.drive
        left = one.drive * one.away[:, -1] - terms @ theta[one.places]
        square[one.own] += left @ left
        spare[one.own] += len(left) - 1
        if noise[one.own] > 0.0:  # parameters that the readings determine
            spare[one.own] -= ((terms.T @ terms) * covariance[np.ix_(one.places, one.places)]).sum() / noise[one.own]
    floor = np.full(3, 1e-300)
    for one in pieces:  # the last digit of readings without noise
        floor[one.own] = max(floor[one.own], (_LEAST_NOISE * one.drive) ** 2)
    return np.where(spare > 0.5, np.maximum(square / np.maximum(spare, 0.5), floor), 1.0)


def _jitter(dwells: Dwells, noise: FloatArray) -> FloatArray:
    """Return by how much the variance (3,) of block means about the own axis exceeds that about the others, where it shows."""
    more, own = np.zeros(3), dwells.own
    windows = [np.asarray(dwells.records[t.recording].gyro)[dwells.settled(n)] for n, t in enumerate(dwells.turns)]
    parts = [block_means(window, size) for window, size in zip(windows, dwells.sizes, strict=True)]
    for k in range(3):
        others = [parts[n][:, k] for n in np.flatnonzero(own != k) if len(parts[n]) > 1]
        spare = sum(len(part) - 1 for part in others)
        if spare and (own == k).any():
            usual = sum(float(((part - part.mean()) ** 2).sum()) for part in others) / spare
            blocks = sum(len(parts[n]) - 1 for n in np.flatnonzero(own == k))
            shows = 1.0 + SHOWS * (2.0 / spare + 2.0 / max(blocks, 1)) ** 0.5
            more[k] = noise[k] - usual if noise[k] > shows * usual else 0.0
    return more
