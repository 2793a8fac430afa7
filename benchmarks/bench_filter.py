"""The low-pass (W4) on both triads of a record, against memory, C and scipy's sosfilt."""

import ctypes
from functools import partial

import numpy as np

from benchmarks.c_rival import compiled, pointer
from benchmarks.figure import Figure, stopwatch
from undrift.filters import butterworth, lowpass
from undrift.kernels.filter import biquad
from undrift.record import Record

N = 1_000_000


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        W4, ns/sample and ratios.
    """
    from scipy.signal import sosfilt

    rng = np.random.default_rng(1)
    record = Record(time=np.arange(N) * 0.01, gyro=rng.normal(size=(N, 3)), accel=rng.normal(size=(N, 3)))
    section = butterworth(11.1, 100.0)
    sos, both = np.array([[*section[:3], 1.0, *section[3:]]]), np.hstack((record.gyro, record.accel))
    y, z, state = np.empty((N, 3)), np.empty((N, 3)), np.zeros(12)

    def copy() -> None:
        y[:] = record.gyro
        z[:] = record.accel

    def kernel() -> None:
        biquad(record.gyro.reshape(-1), y.reshape(-1), *section, state)
        biquad(record.accel.reshape(-1), z.reshape(-1), *section, state)

    rivals = {
        "copy": copy,
        "kernel": kernel,
        "fresh copy": lambda: (record.gyro.copy(), record.accel.copy()),
        "lowpass": partial(lowpass, record, 11.1),
        "sosfilt": lambda: sosfilt(sos, both, axis=0),
    }
    library = compiled()
    if library:
        coefficients = [ctypes.c_double(v) for v in section]

        def in_c() -> None:
            for x, out in ((record.gyro, y), (record.accel, z)):
                library.biquad(pointer(x), pointer(out), *coefficients, ctypes.c_int64(N))

        rivals["c"] = in_c
    s = stopwatch(rivals, rounds=11)
    figures = [
        Figure("W4 low-pass kernel, six channels, one thread", s["kernel"] / N * 1e9, "ns/sample"),
        Figure("W4 low-pass kernel over the memory copy", s["kernel"] / s["copy"], "x", "<= 1.4"),
        Figure("W4 lowpass(record) over a copy into fresh arrays", s["lowpass"] / s["fresh copy"], "x"),
        Figure("W4 sosfilt over lowpass(record)", s["sosfilt"] / s["lowpass"], "x", ">= 5"),
    ]
    if library:
        figures.append(Figure("W4 low-pass kernel over C", s["kernel"] / s["c"], "x"))
    return figures
