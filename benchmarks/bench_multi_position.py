"""Multi-position fit on the Xsens session: accelerometer and gyroscopes, all thresholds, after segmentation.

Segmentation is the sliding variance, timed apart. The rival is the same accelerometer problem given to scipy's
Levenberg-Marquardt with an analytic Jacobian, one threshold after another.
"""

import gzip
import os
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure, stopwatch
from undrift.calibration.multi_position import MULTIPLES, fit_multi_position, still_variance
from undrift.record import Record

DATA = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")).resolve()
GRAVITY = 9.81744


def run() -> list[Figure]:
    """Return the figures.

    Returns
    -------
    list of Figure
        Milliseconds, medians; empty where the recording is absent.
    """
    if not DATA.is_dir():
        return []
    accel, gyro = (_loaded(f"xsens_{what}.txt.gz") for what in ("acc", "gyro"))
    record = Record(time=accel[:, 0], accel=accel[:, 1:], gyro=gyro[:, 1:], accel_unit="count", gyro_unit="count")
    level, nine = still_variance(record), MULTIPLES[:9]
    at_rest = float(np.linalg.norm(accel[:5001, 1:].var(axis=0, ddof=1)))  # the opening 50 s
    rows = [np.concatenate([accel[a : a + 100, 1:] for a, _ in level.below(m * at_rest, 100)]) for m in nine]
    seconds = stopwatch(
        {
            "variance": lambda: still_variance(record),
            "ours": lambda: fit_multi_position(record, gravity=GRAVITY),
            "scipy": lambda: [_scipy(u) for u in rows],
        }
    )
    what = f"multi-position, Xsens session, accel + gyro, {len(MULTIPLES)} thresholds, after segmentation"
    return [
        Figure(
            f"{what}: poses weighed, turns by covariance", 1e3 * (seconds["ours"] - seconds["variance"]), "ms", "<= 100"
        ),
        Figure("sliding variance of both triads, 51,175 samples", 1e3 * seconds["variance"], "ms"),
        Figure("scipy, the accelerometer's nine published fits alone", 1e3 * seconds["scipy"], "ms"),
    ]


def _loaded(name: str) -> np.ndarray:
    with gzip.open(DATA / "multipos_xsens" / name, "rt") as file:
        return np.loadtxt(file)


def _scipy(u: np.ndarray) -> np.ndarray:
    from scipy.optimize import leastsq

    row, column = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
    v = (u - 32768.0) / 415.0

    def parts(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        matrix = np.zeros((3, 3))
        matrix[row, column] = p[:6]
        a = (v - p[6:]) @ matrix.T
        return matrix, a, np.linalg.norm(a, axis=1), v - p[6:]

    def jacobian(p: np.ndarray) -> np.ndarray:
        matrix, a, length, d = parts(p)
        n = a / length[:, None]
        return np.column_stack((n[:, row] * d[:, column], -n @ matrix))

    start = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    solution: np.ndarray = leastsq(lambda p: parts(p)[2] - GRAVITY, start, Dfun=jacobian)[0]
    return solution
