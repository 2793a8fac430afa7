"""integrate_strapdown (W3) against C and against one scipy rotation after the other."""

import ctypes
import importlib.util
from functools import partial

import numpy as np

from benchmarks.c_rival import compiled, pointer
from benchmarks.figure import Figure, stopwatch
from undrift.frames import integrate_strapdown

N = 1_000_000
FEW = 2_000  # samples for the rivals that take microseconds each


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        W3, ns/sample and ratios.
    """
    rng = np.random.default_rng(1)
    gyro, time = rng.normal(size=(N, 3)), np.arange(N) * 0.01
    start, out = np.array([1.0, 0.0, 0.0, 0.0]), np.empty((N, 4))
    rivals = {"undrift": partial(integrate_strapdown, gyro, time, start, out=out)}
    library = compiled()
    if library:
        pointers = [pointer(x) for x in (gyro, time, start, out)]
        rivals["c"] = partial(library.strapdown, *pointers, ctypes.c_int64(N))
    s = stopwatch(rivals)
    slow = stopwatch(_slow(gyro[:FEW], time[:FEW], start), rounds=3)
    base_s = s["undrift"] / N
    figures = [Figure("W3 integrate_strapdown, out=", base_s * 1e9, "ns/sample", "<= 10")]
    if library:
        figures.append(Figure("W3 integrate_strapdown over C", s["undrift"] / s["c"], "x", "<= 1.2"))
    gates = {"ahrs": ">= 1500", "scikit-kinematics": ">= 3000"}
    return figures + [
        Figure(f"W3 {name} over integrate_strapdown", seconds / FEW / base_s, "x", gates.get(name, ""))
        for name, seconds in slow.items()
    ]


def _slow(gyro: np.ndarray, time: np.ndarray, start: np.ndarray) -> dict[str, object]:
    from scipy.spatial.transform import Rotation

    def loop() -> None:
        r = Rotation.from_quat(start, scalar_first=True)
        for k in range(1, len(time)):
            r = r * Rotation.from_rotvec(gyro[k] * (time[k] - time[k - 1]))

    rivals: dict[str, object] = {"scipy Rotation, one after the other,": loop}
    if importlib.util.find_spec("ahrs"):
        from ahrs.filters import AngularRate

        rivals["ahrs"] = lambda: AngularRate(gyr=gyro, q0=start, frequency=100.0)
    if importlib.util.find_spec("vqf"):
        from vqf import BasicVQF

        still = np.tile([0.0, 0.0, 9.81], (len(gyro), 1))
        rivals["BasicVQF (which does more)"] = lambda: BasicVQF(0.01).updateBatch(gyro, still)
    if importlib.util.find_spec("skinematics"):
        from skinematics.imus import kalman  # noqa: F401 - importing tells that the package is whole
        from skinematics.quat import calc_quat

        rivals["scikit-kinematics"] = lambda: calc_quat(gyro, start, 100.0, "bf")
    return rivals
