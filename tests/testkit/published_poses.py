"""The published rule of multi-position poses (Tedaldi, Pretto, Menegatti, ICRA 2014), as an oracle.

Of the thresholds 2 to 10 times the level of the opening rest the one with the smallest summed cost over the first second of each
still; gyroscopes by turns that count alike, their offset the mean of the opening rest.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from undrift.arrays import runs
from undrift.calibration.moves import Moves, gravity_directions, rough_matrix
from undrift.fit.triad import TriadFit, triad_fit
from undrift.record import Record, Still
from undrift.segments import sphere_of


@dataclass(frozen=True)
class PublishedFit:
    """Output of the published demonstration."""

    multiples: tuple[float, ...]
    stills: list[int]  # Found at each
    costs: list[float]  # (m/s2)^2
    accel: TriadFit
    gyro_matrix: np.ndarray
    gyro_offset: np.ndarray
    moves: int


@dataclass(frozen=True)
class StillVariance:
    """Length of the variance of three accelerometers over windows of a second, and at rest."""

    values: np.ndarray  # (N, 3)
    level: np.ndarray  # (N,), infinite at the ends
    at_rest: float

    def below(self, threshold: float, least: int) -> list[tuple[int, int]]:
        """Return the stretches [start, stop) below a threshold that have enough samples."""
        return [(int(a), int(b)) for a, b in runs(self.level < threshold) if b - a >= least]


def variance_with_rest(record: Record, rest_s: float = 50.0) -> StillVariance:
    """Return the windowed variance of a recording, and the level at rest from its opening rest."""
    values = np.asarray(record.accel)
    half = round(0.5 * record.sample_rate_hz)
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1, axis=0)
    level = np.full(len(values), np.inf)
    level[half:-half] = np.linalg.norm(windows.var(axis=-1, ddof=1), axis=1)
    rest = values[: int(np.searchsorted(record.time, record.time[0] + rest_s))]
    return StillVariance(values, level, float(np.linalg.norm(rest.var(axis=0, ddof=1))))


def fit_lengths(reading: np.ndarray, gravity: float, unit_in: str) -> TriadFit:
    """Fit an upper triangular matrix and an offset to readings (N, 3) of equal length and weight."""
    center, radius = sphere_of(reading)
    scale, upper = gravity / radius, np.triu_indices(3)
    v = scale * (reading - center)

    def matrix_of(p: np.ndarray) -> np.ndarray:
        matrix = np.zeros((3, 3))
        matrix[upper] = p[:6]
        return matrix

    def missed(p: np.ndarray) -> np.ndarray:
        return np.linalg.norm((v - p[6:]) @ matrix_of(p).T, axis=1) - gravity

    start = np.append(np.eye(3)[upper], np.zeros(3))
    p = least_squares(missed, start, method="lm", xtol=1e-12, ftol=1e-12).x
    return triad_fit(
        missed(p), method="multi-position", unit_in=unit_in, unit_out="m/s2", matrix=scale * matrix_of(p),
        offset=center + p[6:] / scale, covariance=np.full((12, 12), np.nan), rank=9, condition=1.0,
        valid_range=(-gravity, gravity),
    )  # fmt: skip


def fit_as_published(record: Record, gravity: float, rest_s: float = 50.0) -> PublishedFit:
    level = variance_with_rest(record, rest_s)
    shortest = round(record.sample_rate_hz)
    multiples = tuple(float(m) for m in range(2, 11))
    result: list[tuple[float, list[tuple[int, int]], TriadFit]] = []
    for multiple in multiples:
        stills = [(int(a), int(b)) for a, b in level.below(multiple * level.at_rest, shortest)]
        reading = np.concatenate([level.values[a : a + shortest] for a, _ in stills])
        fit = fit_lengths(reading, gravity, record.accel_unit)
        result.append((0.5 * float(fit.residuals @ fit.residuals), stills, fit))
    _, stills, accel = min(result, key=lambda one: one[0])
    used = [Still(start=a, stop=b) for a, b in stills]
    moves = Moves([record], used)
    n = gravity_directions(moves, accel.model)[0]
    offset = np.asarray(record.between(record.time[0], record.time[0] + rest_s).gyro).mean(axis=0)
    start = rough_matrix(moves, accel.model, offset)

    def missed(x: np.ndarray) -> np.ndarray:
        turn = moves.integrate(moves.gyro - offset, x.reshape(3, 3) * size)[0]
        return (np.einsum("jab,jb->ja", turn, n[moves.before]) - n[moves.before + 1]).ravel()

    size = float(np.cbrt(abs(np.linalg.det(start))))
    solved = least_squares(missed, start.ravel() / size, method="lm", xtol=1e-12, ftol=1e-12)
    return PublishedFit(
        multiples=multiples, stills=[len(one[1]) for one in result], costs=[one[0] for one in result], accel=accel,
        gyro_matrix=solved.x.reshape(3, 3) * size, gyro_offset=offset, moves=len(moves.first),
    )  # fmt: skip
