"""Flicker of an offset: 1/f noise, whose size is not known, in means at rest and in integrals over turns.

    V(q) = white noise + q^2 F        F (E, E): exponential correlations with time constants from 1 s to 10^4 s, variance 1 in all

q is the same for three sensors. Rests of some seconds hardly show it: so results are averaged over all q, by their likelihood and
the prior 1 / (1 + q) / (1 + q^2), q in units of the white noise of a mean over 10 s. At q = 1 the Allan deviation turns from white
noise to flicker at 67 s: inertial MEMS turn at 10 to 100 s. What shows q is scatter between rests, and block means within them:

    y = U' P m                                     m block means of one rest, P takes out their mean (and a slope)
    var y_k = s^2 (1 + q^2 lambda_k / s0^2)        U, lambda of P F P'; s is profiled, s0 the scatter of y as it is
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.fit.least_squares import averaged, block_size
from undrift.record import Record, Still, Turn

SIZES = np.concatenate(([0.0], np.geomspace(0.02, 200.0, 60)))  # q in units of the white noise of a mean over 10 s
_UNIT_S = 10.0
_PRIOR = (1.0 + SIZES) * (1.0 + SIZES**2)
_TIMES_S = np.geomspace(1.0, 1e4, 9)
_MOST_BLOCKS = 32  # of one rest


def spans_of(records: Sequence[Record], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return start and stop of each piece (E, 2), s, on one clock on which the recordings follow each other."""
    begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in records])))
    spans = [
        [
            begins[p.recording] + records[p.recording].time[at] - records[p.recording].time[0]
            for at in (p.start, p.stop - 1)
        ]
        for p in pieces
    ]
    return np.array(spans).reshape(-1, 2)


def size_unit(noise: FloatArray, span: FloatArray) -> float:
    """Return the unit of the SIZES: the noise (P, 3) of means over stretches (P, 2), s, taken to 10 s; median of all."""
    return float(np.median(noise * np.sqrt(np.maximum(np.diff(span, axis=1), 1e-3) / _UNIT_S)))


def flicker_of_means(span: FloatArray) -> FloatArray:
    """Return F of means over stretches (E, 2), s, which may overlap."""
    start, stop = span[:, 0], np.maximum(span[:, 1], span[:, 0] + 1e-3)
    apart = [to[:, None] - of for to, of in ((stop, start), (start, stop), (stop, stop), (start, start))]
    total = np.zeros((len(span), len(span)))
    for time_s in _TIMES_S:  # twice the integral of exp(-|t| / time) over t, then its second difference
        late, early, stops, starts = (np.expm1(-np.abs(t) / time_s) + np.abs(t) / time_s for t in apart)
        total += time_s**2 * (late + early - stops - starts)
    return np.asarray(total / len(_TIMES_S) / np.outer(stop - start, stop - start))


def flicker_about_mean(span: FloatArray, extent: FloatArray | None = None) -> FloatArray:
    """Return F of integrals over stretches (E, 2), s, less the mean from the first to the last; extent (E,) is 1 for a mean."""
    extent = np.ones(len(span)) if extent is None else extent
    every = flicker_of_means(np.vstack((span, (span[:, 0].min(), span[:, 1].max()))))
    away = np.column_stack((np.diag(extent), -extent))
    return np.asarray(away @ every @ away.T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Block means within rests, uncorrelated for every size of flicker."""

    reading: FloatArray  # (B, 3), y
    gain: FloatArray  # (B,), lambda

    def likelihood(self, unit: float) -> FloatArray:
        """Return log L of the SIZES, given their unit in that of the readings."""
        noise = (self.reading**2).mean(axis=0) if len(self.reading) else np.zeros(3)
        if not (noise > 0.0).all():
            return np.zeros(len(SIZES))
        weight = 1.0 / (1.0 + (SIZES[:, None, None] * unit) ** 2 * (self.gain[:, None] / noise))
        square = (weight * self.reading**2).sum(axis=1)
        return np.asarray(
            0.5 * (np.log(weight).sum(axis=(1, 2)) - len(self.reading) * np.log(square / square[0]).sum(axis=1))
        )


def blocks_within(windows: Sequence[FloatArray], rates_hz: Sequence[float], removed: int = 1) -> Blocks:
    """Return the block means of readings (N, 3) at rest, each freed of a polynomial in time with so many terms."""
    readings, gains = [np.zeros((0, 3))], [np.zeros(0)]
    for values, rate_hz in zip(windows, rates_hz, strict=True):
        shortest = block_size(rate_hz)
        size = max(shortest, len(values) // _MOST_BLOCKS)
        count = len(values) // size
        if count <= removed:
            continue
        means = values[: count * size].reshape(count, size, 3).mean(axis=1)
        edges = np.arange(count + 1) * size / rate_hz
        trend = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), removed - 1)
        rest = np.linalg.qr(trend, mode="complete")[0][:, removed:]
        gain, vectors = np.linalg.eigh(rest.T @ flicker_of_means(np.column_stack((edges[:-1], edges[1:]))) @ rest)
        readings.append((rest @ vectors).T @ (means - means.mean(axis=0)) * (size / shortest) ** 0.5)
        gains.append(gain.clip(0.0) * size / shortest)
    return Blocks(reading=np.vstack(readings), gain=np.concatenate(gains))


def mean_square_size(likelihood: FloatArray) -> float:
    """Return the mean of q^2 over the SIZES by their log likelihood."""
    share = np.exp(likelihood - likelihood.max()) * np.gradient(SIZES) / _PRIOR
    return float(share @ SIZES**2 / share.sum())


def averaged_sizes(
    likelihood: FloatArray, thetas: FloatArray, covariances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return theta and its covariance over the SIZES, (Q, P) and (Q, P, P)."""
    return averaged(SIZES, likelihood, thetas, covariances, (_PRIOR, _PRIOR))
