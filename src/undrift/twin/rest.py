"""Rest: white noise and bandwidth from the spectrum of readings at rest.

White noise N through the device's own second-order Butterworth low-pass of bandwidth f_b leaves the one-sided density::

    S(f) = 2 N^2 / (1 + (f / f_b)^4), and its images at multiples of the sample rate

Averaged periodograms scatter as chi-square, so the Whittle likelihood sum(log S + P / S) is maximised over f_b, N^2 in closed
form. Only the upper part of the band counts: hands and floors move a device at low frequency. Where no bandwidth is better
than an infinite one by more than chi-square allows, the noise is flat and only a lower limit is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.record import Record

BAND = (0.35, 0.95)  # of half the sample rate
_SEGMENT = 256  # samples
_IMAGES = 3  # of the spectrum on either side
_BETTER = 9.0  # chi-square, one degree of freedom, three standard deviations
_LIMIT = 4.0  # the same, two


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestNoise:
    """White noise of a triad, and what its spectrum says of the bandwidth.

    Parameters
    ----------
    random_walk, random_walk_error : array, shape (3,)
        N and its standard error, unit/sqrt(Hz).
    bandwidth_hz : float
        f_b; NaN where the noise is flat.
    bandwidth_error_hz : float
        Standard error; NaN likewise.
    bandwidth_above_hz : float
        Lower limit.
    """

    random_walk: FloatArray
    random_walk_error: FloatArray
    bandwidth_hz: float
    bandwidth_error_hz: float
    bandwidth_above_hz: float


def rest_noise(records: Sequence[Record], channel: str, *, step: float = 0.0) -> RestNoise | None:
    """Return white noise and bandwidth of a triad from recordings at rest.

    Parameters
    ----------
    records : sequence of Record
        Rests of one device.
    channel : str
        "gyro" or "accel".
    step : float
        Of the codes, unit of the readings: their own noise, step^2 / 12, is taken off.

    Returns
    -------
    RestNoise or None
        None where no rest is long enough, the triad is missing, or a reading never changes.
    """
    spectra, counts = [], []
    f: FloatArray = np.empty(0)
    rate = records[0].sample_rate_hz if records else 1.0
    for record in records:
        values = getattr(record, channel)
        if values is None or len(values) < 4 * _SEGMENT or not np.isfinite(values).all():
            continue
        if not values.std(axis=0).all():
            continue  # readings that never change hold no noise
        f, density, averaged = _periodogram(values, rate)
        spectra.append(density)
        counts.append(averaged)
    if not spectra:
        return None
    weight = np.array(counts, float) / sum(counts)
    chosen = (f >= BAND[0] * 0.5 * rate) & (f <= BAND[1] * 0.5 * rate)
    density = np.einsum("r,rfi->fi", weight, np.array(spectra)[:, chosen])
    return _likely(
        f[chosen], density, 0.8 * sum(counts), (rate, step)
    )  # Hann windows that half overlap: about 0.8 independent


def _periodogram(values: FloatArray, rate: float) -> tuple[FloatArray, FloatArray, int]:
    count = 2 * (len(values) // _SEGMENT) - 1
    window = np.hanning(_SEGMENT)
    starts = np.arange(count) * (_SEGMENT // 2)
    pieces = values[starts[:, None] + np.arange(_SEGMENT)]
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * window[None, :, None]
    power = np.abs(np.fft.rfft(pieces, axis=1)) ** 2
    density = 2.0 * power.mean(axis=0) / (rate * float((window**2).sum()))
    return np.fft.rfftfreq(_SEGMENT, 1.0 / rate), density, count


def _likely(f: FloatArray, density: FloatArray, averaged: float, sampling: tuple[float, float]) -> RestNoise:
    rate, step = sampling
    trials = np.geomspace(0.1, 10.0, 400) * 0.5 * rate  # beyond 1 the noise folds back: no bandwidth, only a limit
    cost = np.array([_cost(density / _shape(f, b, rate)[:, None], _shape(f, b, rate), averaged) for b in trials])
    flat = _cost(density, np.ones(len(f)), averaged)
    best = int(np.argmin(cost))
    bandwidth = error = float("nan")
    near = trials[cost <= cost[best] + 1.0]
    above = float(trials[cost <= min(flat, cost[best]) + _LIMIT].min())
    if flat - cost[best] > _BETTER and best > 0 and trials[best] < 0.45 * rate:
        bandwidth, error = float(trials[best]), 0.5 * float(near[-1] - near[0])
    shape = np.ones(len(f)) if np.isnan(bandwidth) else _shape(f, bandwidth, rate)
    square = 0.5 * (density / shape[:, None]).mean(axis=0) - step**2 / (12.0 * rate)
    level = np.sqrt(np.maximum(square, 0.0))
    independent = averaged * len(f) * 2.0 / 3.0  # neighbouring bins of a Hann window share
    return RestNoise(
        random_walk=level,
        random_walk_error=level * 0.5 / np.sqrt(independent),
        bandwidth_hz=bandwidth,
        bandwidth_error_hz=error,
        bandwidth_above_hz=min(above, 0.5 * rate),
    )


def _shape(f: FloatArray, bandwidth: float, rate: float) -> FloatArray:
    # What lies above half the sample rate folds back into the band.
    images = np.abs(f[:, None] + rate * np.arange(-_IMAGES, _IMAGES + 1))
    shape: FloatArray = (1.0 / (1.0 + (images / bandwidth) ** 4)).sum(axis=1)
    return shape


def _cost(whitened: FloatArray, shape: FloatArray, averaged: float) -> float:
    # -2 log likelihood with the level at its best: P / S averages 1.
    n = len(shape) * 2.0 / 3.0
    return float(2.0 * averaged * n * (np.log(whitened.mean(axis=0)) + np.log(shape).mean()).sum())
