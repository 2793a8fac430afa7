"""Excitation: whether a held-out motion lies within what the twin's training shows of its parameters.

Over a window of a motion, an error of matrix and offset turns the twin by ::

    e = D p        D = integral R_nb [ (u - o)^T x I, -I ] dt,  p = (dM row by row, M do)

in n, readings u, o those at rest. The training determines p by N = sum D^T D over its windows; e of a window beyond what training
has seen is not determined, however small the residuals of training are. The leverage of a window, h = trace(D N^-1 D^T), is
compared with the largest of the training itself, the rule for hidden extrapolation in regression (R. D. Cook, "Detection of
influential observation", 1977). Most of the held-out windows above it is a finding. What the fit's own covariance C makes of the
held-out windows, trace(D C D^T), is stated in degrees, and its share by axis: (D^T D C)_pp summed over the column of M that belongs
to turns about that axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.findings import Finding, finding
from undrift.frames import rotation
from undrift.model import AXES, TriadModel
from undrift.twin.accel import Match, stretches
from undrift.units import RADIAN_PER_DEGREE

WINDOW_S, STRIDE_S = 5.0, 0.5
MOST_BEYOND = 0.5  # share of held-out windows beyond the training's largest leverage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Excitation:
    """A held-out motion against the training."""

    beyond: float  # Share of windows whose leverage exceeds the largest of the training
    leverage: float  # Median leverage of held-out windows over that largest one
    predicted: float  # Rotation over a window by the covariance of matrix and offset, held out, rms, rad
    trained: float  # The same in training
    axis_share: FloatArray  # (3,), of the held-out variance, by turns about x, y, z; the rest is the offset's

    def finding(self, recording: str) -> Finding | None:
        """Return the finding of a motion beyond the training; None within it."""
        if self.beyond <= MOST_BEYOND:
            return None
        return finding(
            "twin.beyond_training",
            "warn",
            recording=recording,
            beyond_percent=100.0 * self.beyond,
            axis=AXES[int(np.argmax(self.axis_share))],
            predicted_deg=self.predicted / RADIAN_PER_DEGREE,
            trained_deg=self.trained / RADIAN_PER_DEGREE,
            window_s=WINDOW_S,
        )


def excitation(held_out: FloatArray, training: Sequence[FloatArray], model: TriadModel) -> Excitation:
    """Compare windows of a held-out motion (W, 3, 12) with those that a gyroscope model was fitted to."""
    from scipy.linalg import block_diag

    seen = np.concatenate(training)
    if not len(held_out) or not len(seen):
        return Excitation(beyond=0.0, leverage=np.nan, predicted=np.nan, trained=np.nan, axis_share=np.full(3, np.nan))
    size = np.sqrt(np.einsum("nap,nap->p", seen, seen))
    inverse = np.linalg.pinv(np.einsum("nap,naq->pq", seen / size, seen / size)) / np.outer(size, size)
    limit, leverage = float(_traces(seen, inverse).max()), _traces(held_out, inverse)
    turned = block_diag(np.eye(9), model.matrix)
    covariance = turned @ model.covariance[:12, :12] @ turned.T
    each = np.einsum("nap,naq,qp->p", held_out, held_out, covariance) / len(held_out)
    return Excitation(
        beyond=float(np.mean(leverage > limit)),
        leverage=float(np.median(leverage)) / limit,
        predicted=float(np.sqrt(each.sum())),
        trained=float(np.sqrt(_traces(seen, covariance).mean())),
        axis_share=each[:9].reshape(3, 3).sum(axis=0) / each.sum(),
    )


def _traces(design: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nap,pq,naq->n", design, covariance, design))


def motion_windows(match: Match) -> FloatArray:
    """Return D of every window of a recording's motion, (W, 3, 12)."""
    motion, rate = match.at(match.lag.seconds, 0.0), match.record.sample_rate_hz
    samples, stride, found = round(WINDOW_S * rate), max(1, round(STRIDE_S * rate)), [np.empty((0, 3, 12))]
    for rows in stretches(match, motion, match.gyro):
        r_nb, u = rotation(motion.q_nb[rows]).as_matrix(), match.gyro[rows] - match.rest_offset
        by_matrix = (r_nb[:, :, :, None] * u[:, None, None, :]).reshape(len(u), 3, 9)
        total = np.cumsum(np.concatenate((by_matrix, -r_nb), axis=2), axis=0) / rate
        first = np.arange(0, len(total) - samples, stride)
        found.append(total[first + samples] - total[first])
    return np.concatenate(found)
