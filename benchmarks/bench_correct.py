"""correct: matrix only (W1) and with static and dynamic tables (W2), against memory, C, numpy and scipy."""

import ctypes
import importlib.util
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from benchmarks.c_rival import compiled, pointer
from benchmarks.figure import Figure, stopwatch
from undrift.correction.correct import correct_checked
from undrift.model import Calibration, DriftTables, DynamicDrift, StaticDrift, TriadModel
from undrift.record import Record

N = 1_000_000
TEMPS, RATES = np.linspace(18.0, 75.0, 115), np.linspace(-2.0, 2.0, 65)


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        W1 and W2, ns/sample and ratios.
    """
    record = _record()
    return [*_matrices(record), *_tables(record)]


def _record() -> Record:
    rng = np.random.default_rng(1)
    time = np.arange(N) * 0.01
    return Record(
        time=time,
        gyro=rng.normal(size=(N, 3)) * 0.5,
        accel=rng.normal(size=(N, 3)) * 3.0,
        temp_c=25.0 + 30.0 * (1.0 - np.exp(-time / 3000.0)) + 0.05 * rng.normal(size=N),
    )


def _calibration(drift: DriftTables | None) -> Calibration:
    rng = np.random.default_rng(2)

    def triad(unit: str, g: np.ndarray | None) -> TriadModel:
        return TriadModel(
            method="bench",
            unit_in=unit,
            unit_out=unit,
            matrix=np.eye(3) + rng.normal(size=(3, 3)) * 0.01,
            offset=np.zeros(3) if drift else rng.normal(size=3) * 0.1,
            g_sensitivity=g,
            covariance=np.zeros((12, 12)),
            rms_residual=0.0,
            count=0,
            rank=12,
            condition=1.0,
            valid_range=(-1.0, 1.0),
        )

    g = rng.normal(size=(3, 3)) * 1e-3
    return Calibration(
        device="",
        reference_temp_c=np.nan,
        gravity_m_s2=9.81,
        gyro=triad("rad/s", g),
        accel=triad("m/s2", None),
        drift=drift,
    )


def _copy(record: Record, w: np.ndarray, a: np.ndarray, threads: int) -> Callable[[], object]:
    """Copy the bytes of gyro and accel with numpy, on as many threads, started afresh each time as correct starts its own."""
    bounds = [len(record) * i // threads for i in range(threads + 1)]

    def piece(start: int, stop: int) -> None:
        np.copyto(w[start:stop], record.gyro[start:stop])
        np.copyto(a[start:stop], record.accel[start:stop])

    def call() -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(piece, bounds[:-1], bounds[1:]))

    return call if threads > 1 else partial(piece, 0, len(record))


def _matrices(record: Record) -> list[Figure]:
    c, n, cores = _calibration(None), len(record), os.cpu_count() or 1
    w, a = np.empty((n, 3)), np.empty((n, 3))
    m, o, nn, p, g = c.gyro.matrix, c.gyro.offset, c.accel.matrix, c.accel.offset, c.gyro.g_sensitivity

    def plain() -> None:
        force = (record.accel - p) @ nn.T
        _ = (record.gyro - o) @ m.T - force @ g.T

    rivals = {
        "copy": _copy(record, w, a, 1),
        "copies": _copy(record, w, a, cores),
        "one": partial(correct_checked, record, c, check=False, out=(w, a), threads=1),
        "all": partial(correct_checked, record, c, check=False, out=(w, a), threads=cores),
        "fresh": partial(correct_checked, record, c, check=False),
        "fresh copy": lambda: (record.gyro.copy(), record.accel.copy()),
        "numpy": plain,
    }
    library = compiled()
    arrays = [pointer(x) for x in (record.gyro, record.accel, w, a, m, o, nn, p, g)]
    if library:
        rivals["c"] = partial(library.matrices, *arrays, ctypes.c_int64(n))
        flat = [pointer(x) for x in (record.gyro, record.accel, w, a)]
        rivals["c copy"] = partial(library.copies, *flat, ctypes.c_int64(n))
    if importlib.util.find_spec("imucal"):
        rivals["imucal"] = _imucal(record, c)
    s = stopwatch(rivals)
    at = f"N = {n:.0e}".replace("e+0", "e")
    # A copy on one thread is a different limit than one on all: both are shown, the gate is for equal numbers of threads.
    figures = [
        Figure(f"memory copy of gyro and accel, {at}, one thread", s["copy"] / n * 1e9, "ns/sample"),
        Figure(f"memory copy of gyro and accel, {at}, {cores} threads", s["copies"] / n * 1e9, "ns/sample"),
        Figure(f"W1 correct, matrix + g-sensitivity, out=, {at}, one thread", s["one"] / n * 1e9, "ns/sample"),
        Figure(f"W1 correct, {cores} threads, over the copy on as many, {at}", s["all"] / s["copies"], "x", "<= 1.25"),
        Figure(f"W1 correct, {cores} threads, over the copy on one, {at}", s["all"] / s["copy"], "x"),
        Figure(f"W1 correct, one thread, over the copy on one, {at}", s["one"] / s["copy"], "x"),
        Figure(f"W1 correct into fresh arrays, over a copy into fresh arrays, {at}", s["fresh"] / s["fresh copy"], "x"),
        Figure(f"W1 plain numpy over correct, one thread, {at}", s["numpy"] / s["one"], "x"),
    ]
    if library:
        figures.append(Figure(f"W1 correct, one thread, over C, {at}", s["one"] / s["c"], "x"))
        figures.append(
            Figure(f"W1 correct, one thread, over a copy by plain C stores, {at}", s["one"] / s["c copy"], "x")
        )
    if "imucal" in s:
        figures.append(Figure(f"W1 imucal over correct, one thread, {at}", s["imucal"] / s["one"], "x", ">= 6"))
    return figures


def _imucal(record: Record, c: Calibration):
    from imucal import FerrarisCalibrationInfo

    info = FerrarisCalibrationInfo(
        acc_unit="m/s^2", gyr_unit="deg/s", from_acc_unit="a.u.", from_gyr_unit="a.u.",
        K_a=np.eye(3), R_a=c.accel.forward_matrix, b_a=c.accel.offset, K_g=np.eye(3), R_g=c.gyro.forward_matrix,
        K_ga=c.gyro.g_sensitivity, b_g=c.gyro.offset,
    )  # fmt: skip
    return partial(info.calibrate, record.accel, record.gyro, acc_unit="a.u.", gyr_unit="a.u.")


def _drift() -> DriftTables:
    rng = np.random.default_rng(3)
    return DriftTables(
        static=StaticDrift(
            temp_c=TEMPS, gyro_offset=rng.normal(size=(115, 3)) * 0.01, accel_offset=rng.normal(size=(115, 3)) * 0.01
        ),
        dynamic=DynamicDrift(temp_c=TEMPS, turn_rate=RATES, error=rng.normal(size=(115, 65, 3)) * 0.01),
    )


def _tables(record: Record) -> list[Figure]:
    c, n = _calibration(_drift()), len(record)
    w, a = np.empty((n, 3)), np.empty((n, 3))
    rivals = {
        "one": partial(correct_checked, record, c, check=False, out=(w, a), threads=1),
        "two": partial(correct_checked, record, c, check=False, out=(w, a), threads=2),
    }
    library = compiled()
    if library:
        rivals["c"] = _c_tables(library, record, c, w, a)
    s = stopwatch(rivals, rounds=11)
    slow = stopwatch({"scipy": partial(_scipy, record, c)}, rounds=3)["scipy"]
    correct_checked(record, c, check=False, out=(w, a), threads=1)
    single = w.tobytes()
    correct_checked(record, c, check=False, out=(w, a), threads=2)
    figures = [
        Figure(
            "W2 correct with static and dynamic tables, out=, one thread",
            s["one"] / n * 1e9,
            "ns/sample",
            "" if library else "<= 22",
        ),
        Figure("W2 correct, out=, two threads", s["two"] / n * 1e9, "ns/sample"),
        Figure("W2 numpy and RegularGridInterpolator over correct, one thread", slow / s["one"], "x", ">= 15"),
        Figure("W2 two threads give the bits of one (1 is yes)", float(w.tobytes() == single), "", ">= 1"),
    ]
    if library:
        figures.append(Figure("W2 correct, one thread, over C", s["one"] / s["c"], "x", "<= 1.3"))
    return figures


def _c_tables(library: ctypes.CDLL, record: Record, c: Calibration, w: np.ndarray, a: np.ndarray):
    from undrift.correction.plan import LookupTable, constants_of, line_cells, plane_cells, searched

    offsets = np.hstack((c.drift.static.gyro_offset, c.drift.static.accel_offset))
    _, line = line_cells(LookupTable(temp=searched(TEMPS), values=offsets))
    _, _, plane = plane_cells(constants_of(c, "gyro").error_table)
    arrays = [
        record.gyro,
        record.accel,
        record.temp_c,
        w,
        a,
        c.gyro.matrix,
        c.accel.matrix,
        c.gyro.g_sensitivity,
        line,
        plane,
    ]
    d, i = ctypes.c_double, ctypes.c_int64
    grid = (d(TEMPS[0]), d(2.0), i(114), d(RATES[0]), d(16.0), i(64), i(len(record)))

    def call(keep: list[np.ndarray] = arrays) -> None:
        library.tables(*(pointer(x) for x in keep), *grid)

    return call


def _scipy(record: Record, c: Calibration) -> None:
    from scipy.interpolate import RegularGridInterpolator

    static, dynamic = c.drift.static, c.drift.dynamic
    offset = np.column_stack(
        [np.interp(record.temp_c, TEMPS, v) for v in (*static.gyro_offset.T, *static.accel_offset.T)]
    )
    force = (record.accel - offset[:, 3:]) @ c.accel.matrix.T
    rate = (record.gyro - offset[:, :3]) @ c.gyro.matrix.T - force @ c.gyro.g_sensitivity.T
    for axis in range(3):
        table = RegularGridInterpolator((TEMPS, RATES), dynamic.error[..., axis], bounds_error=False, fill_value=None)
        rate[:, axis] -= table(np.column_stack((record.temp_c, np.clip(rate[:, axis], RATES[0], RATES[-1]))))
