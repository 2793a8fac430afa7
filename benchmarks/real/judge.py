"""What rows share: plain rivals in numpy, and stated intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotation_vector
from undrift.model import TriadModel
from undrift.record import Record, Reference
from undrift.sync import find_lag
from undrift.validation.trial import orientation_at

Z95 = 1.96


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Errors of a row, in the unit of the row."""

    error: float
    rivals: dict[str, float]
    inside: int = 0  # stated 95 % intervals that hold
    checks: int = 0
    parts: dict[str, float] = field(default_factory=dict)  # error of each recording or element


def held(difference: FloatArray, uncertainty: FloatArray) -> dict[str, int]:
    """Return how many 95 % intervals hold, of how many."""
    inside = np.abs(difference) <= Z95 * np.broadcast_to(uncertainty, np.shape(difference))
    return {"inside": int(inside.sum()), "checks": inside.size}


def rms(values: FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


# ---- gravity in poses


def lengths(means: FloatArray, model: TriadModel) -> tuple[FloatArray, FloatArray]:
    """Return the length of gravity in poses (K, 3), and the standard uncertainty of each by the covariance of the model."""
    centred = means - model.offset
    force = centred @ model.matrix.T
    length = np.linalg.norm(force, axis=1)
    direction = force / length[:, None]
    by_matrix = (direction[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    slopes = np.hstack((by_matrix, -direction @ model.matrix))
    covariance = model.covariance[:12, :12]
    return length, np.sqrt(np.einsum("ki,ij,kj->k", slopes, covariance, slopes))


# ---- plain least squares against poses of a reference

WINDOW_S = 4.0


def windows_of(record: Record, reference: Reference, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Return readings times their steps (W, n, 3), rad, and the rotations (W, 4) of the reference over the same windows."""
    count = int(WINDOW_S * record.sample_rate_hz) // 2 * 2
    gyro, time = np.asarray(record.gyro), record.time
    turns = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(time)[:, None]
    starts = np.arange(0, len(turns) - count, count)
    q_nb = orientation_at(reference.time, reference.q_nb, time[np.append(starts, starts[-1] + count)] - lag_s)
    rotations = quaternion_product(quaternion_conjugate(q_nb[:-1]), q_nb[1:])
    known = np.isfinite(rotations).all(axis=1)
    return np.stack([turns[start : start + count] for start in starts[known]]), rotations[known]


def chained(turns: FloatArray) -> FloatArray:
    """Return the rotations (W, 4) of successive turns (W, n, 3), rad."""
    q = quaternion_of(turns.reshape(-1, 3)).reshape(*turns.shape[:2], 4)
    while q.shape[1] > 1:
        rest = q[:, q.shape[1] // 2 * 2 :]
        paired = quaternion_product(q[:, :-1:2].reshape(-1, 4), q[:, 1::2].reshape(-1, 4))
        q = np.concatenate((paired.reshape(len(q), -1, 4), rest), axis=1)
    return q[:, 0]


def fit_plain(pairs: Sequence[tuple[Record, Reference]]) -> FloatArray:
    """Return matrix and offset (4, 3) by ordinary least squares of the rotations over windows of 4 s, without a prior."""
    lags = [find_lag(record, reference) for record, reference in pairs]
    parts = [windows_of(*pair, lag.seconds) for pair, lag in zip(pairs, lags, strict=True)]
    steps = [float(np.median(np.diff(record.time))) for record, _ in pairs]

    def missed(parameters: FloatArray) -> FloatArray:
        fitted = parameters.reshape(4, 3)
        residuals = [
            rotation_vector(
                quaternion_product(quaternion_conjugate(seen), chained(turns @ fitted[:3] + step * fitted[3]))
            )
            for (turns, seen), step in zip(parts, steps, strict=True)
        ]
        return np.concatenate(residuals).ravel()

    start = np.vstack((lags[0].matrix.T, lags[0].constant))
    return least_squares(missed, start.ravel(), method="lm", max_nfev=200).x.reshape(4, 3)


def apply_plain(record: Record, fitted: FloatArray) -> Record:
    """Return a record corrected by `fit_plain`, with its accelerometers turned to the same axes."""
    left, _, right = np.linalg.svd(fitted[:3])
    accel = None if record.accel is None else np.asarray(record.accel) @ left @ right
    return replace(record, gyro=np.asarray(record.gyro) @ fitted[:3] + fitted[3], accel=accel)


# ---- angle about an axis


def angle_about(q_nb: FloatArray, axis: int) -> FloatArray:
    """Return the turn about a body axis since the first sample, deg, unwrapped."""
    turn = quaternion_product(quaternion_conjugate(q_nb[:1]), q_nb)
    return np.degrees(np.unwrap(2.0 * np.arctan2(turn[:, 1 + axis], turn[:, 0])))
