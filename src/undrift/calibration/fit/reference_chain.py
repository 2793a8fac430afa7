"""The reference fit as efficient as white noise allows: all poses in one chain, weighed by where the noise sits.

From pose i to the next pose j the reference turns by what the gyroscope integrated, but for the noise of both poses and that
of the readings in between. Seen in n, with e the noise of a pose and h that of one step::

    y_j = A_j x + e_j - e_i + h_j        var e = s^2 (1 - kappa),  var h = s^2 kappa,  per axis

Neighbouring equations share a pose, so their covariance is tridiagonal. kappa maximises the restricted likelihood: near 0
the poses are the worse witness and the chain acts like one long window, near 1 the readings are and it acts like many short
ones. Each equation is whitened by the Cholesky factor; a whitened residual beyond k standard deviations counts k / |r|
(Huber [1]_).

References
----------
.. [1] P. J. Huber, "Robust estimation of a location parameter", 1964.
"""

from collections.abc import Sequence

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.reference_solve import Solution
from undrift.calibration.fit.reference_windows import Recording, Windows
from undrift.calibration.fit.result import scaled_condition
from undrift.errors import NotObservable
from undrift.frames import rotate

_SEARCH = 24  # steps of golden section: kappa's logit to 1e-3
_REWEIGHTINGS = 15
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def solve_chain(
    recordings: Sequence[Recording], steps: Sequence[Windows], *, keep: FloatArray, huber: float
) -> Solution:
    """Solve the chains of several recordings.

    Parameters
    ----------
    recordings : sequence of Recording
        Their poses turn the equations into n.
    steps : sequence of Windows
        One for each recording, from each pose to the next.
    keep : array, shape (P,)
        1 for a parameter to fit, 0 for one held fixed.
    huber : float
        Whitened residuals up to this many standard deviations count fully.

    Returns
    -------
    Solution
        Zero step and covariance for parameters held fixed; residuals are whitened, rad.

    Raises
    ------
    NotObservable
        Too few poses, or motion that leaves a parameter undetermined.
    """
    kept = np.flatnonzero(keep)
    tables = [_in_level(r, w, kept) for r, w in zip(recordings, steps, strict=True)]
    links = [np.diff(w.first) == 1 for w in steps]
    rows = 3 * sum(len(t) for t in tables)
    if rows <= 2 * len(kept):
        raise NotObservable(
            f"reference: wanted more than {2 * len(kept) // 3} steps between poses, got {rows // 3}; record longer motion",
            steps=rows // 3,
        )
    plain = np.concatenate([t[:, :, 1:].reshape(-1, len(kept)) for t in tables])
    rank, condition = scaled_condition(plain)
    if rank < len(kept):
        raise NotObservable(
            f"reference: wanted motion about all three axes, got a design of rank {rank} for {len(kept)} parameters; "
            "turn the device about every axis",
            rank=rank,
        )
    kappa = _most_likely(tables, links)
    x, covariance, residual, scale = _huber(_whitened(tables, links, kappa), huber)
    step, full = np.zeros(len(keep)), np.zeros((len(keep), len(keep)))
    step[kept] = x
    full[np.ix_(kept, kept)] = covariance
    return Solution(
        step=step, covariance=full, residuals=residual.reshape(-1, 3), scale=scale, rank=rank, condition=condition
    )


def _in_level(recording: Recording, steps: Windows, kept: IntArray) -> FloatArray:
    """Return y and A side by side, (n, 3, 1 + P), turned from the body at the later pose into n."""
    q = recording.q_nb[steps.first + 1][:, None, :]
    table = np.concatenate((steps.turn[:, :, None], steps.design[:, :, kept]), axis=2)
    return np.moveaxis(rotate(q, np.moveaxis(table, 1, 2)), 2, 1)


def _most_likely(tables: Sequence[FloatArray], links: Sequence[BoolArray]) -> float:
    """Return kappa by golden section over its logit.

    The covariance of an unbroken run of n steps is (1 - kappa) T + kappa, T tridiagonal (-1, 2, -1); sine waves are the
    eigenvectors of T, with values 2 - 2 cos(pi k / (n + 1)). In them every kappa is a diagonal weight.
    """
    runs = [run for t, linked in zip(tables, links, strict=True) for run in np.split(t, np.flatnonzero(~linked) + 1)]
    waves = np.concatenate([_sine_transform(run).reshape(-1, run.shape[2]) for run in runs])
    value = np.concatenate([2.0 - 2.0 * np.cos(np.pi * np.arange(1, len(r) + 1) / (len(r) + 1)) for r in runs])
    y, a = waves[:, 0], waves[:, 1:]

    def cost(logit: float) -> float:
        kappa = 1.0 / (1.0 + np.exp(-logit))
        variance = np.repeat((1.0 - kappa) * value + kappa, 3)
        weighted = a / variance[:, None]
        normal = weighted.T @ a
        residual = y - a @ np.linalg.solve(normal, weighted.T @ y)
        square = max(float((residual**2 / variance).sum()), 1e-300)
        return float((len(y) - a.shape[1]) * np.log(square) + np.log(variance).sum() + np.linalg.slogdet(normal)[1])

    low, high = -12.0, 12.0
    inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    cost_inner, cost_outer = cost(inner), cost(outer)
    for _ in range(_SEARCH):
        if cost_inner < cost_outer:
            high, outer, cost_outer = outer, inner, cost_inner
            inner = high - _GOLDEN * (high - low)
            cost_inner = cost(inner)
        else:
            low, inner, cost_inner = inner, outer, cost_outer
            outer = low + _GOLDEN * (high - low)
            cost_outer = cost(outer)
    return float(1.0 / (1.0 + np.exp(-0.5 * (low + high))))


def _sine_transform(run: FloatArray) -> FloatArray:
    """Return the orthonormal sine transform (type I) over axis 0, by an FFT of the odd continuation."""
    n = len(run)
    zero = np.zeros_like(run[:1])
    odd = np.concatenate((zero, run, zero, -run[::-1]))
    waves: FloatArray = np.fft.rfft(odd, axis=0)[1 : n + 1].imag * (-np.sqrt(0.5 / (n + 1)))
    return waves


def _whitened(tables: Sequence[FloatArray], links: Sequence[BoolArray], kappa: float) -> FloatArray:
    """Return rows (3 n, 1 + P) with covariance s^2 I, each of them local in time, so that one bad pose stays few rows."""
    blocks = []
    diagonal = 2.0 * (1.0 - kappa) + kappa
    for table, linked in zip(tables, links, strict=True):
        white = np.empty_like(table)
        root, before = 1.0, np.zeros_like(table[0])
        for k in range(len(table)):
            shared = -(1.0 - kappa) if k and linked[k - 1] else 0.0
            below = shared / root
            root = float(np.sqrt(diagonal - below * below))
            white[k] = (table[k] - below * before) / root
            before = white[k]
        blocks.append(white.reshape(-1, table.shape[2]))
    return np.concatenate(blocks)


def _huber(white: FloatArray, k: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return parameters, covariance, residuals and scale; the covariance is that of Huber's estimate at the normal."""
    y, a = white[:, 0], white[:, 1:]
    length = np.linalg.norm(a, axis=0)
    scaled, weight = a / length, np.ones(len(y))
    x, scale = np.zeros(a.shape[1]), 0.0
    for _ in range(_REWEIGHTINGS):
        previous = x
        x = np.linalg.solve((scaled.T * weight) @ scaled, scaled.T @ (weight * y))
        size = np.abs(y - scaled @ x)
        scale = 1.4826 * float(np.median(size))
        if scale == 0.0:
            break
        weight = np.minimum(1.0, k * scale / np.maximum(size, 1e-300))
        if np.abs(x - previous).max() <= 1e-9 * max(float(np.abs(x).max()), 1e-12):
            break
    residual = y - scaled @ x
    spare = len(y) - len(x)
    fully = float(np.mean(weight == 1.0))
    variance = float(((weight * residual) ** 2).sum()) / spare / max(fully, 0.1) ** 2
    covariance = np.linalg.inv(scaled.T @ scaled) * variance / np.outer(length, length)
    return x / length, covariance, residual, scale
