"""Run: trials through the kernel, 32 abreast, errors out batch by batch."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray
from undrift.session import Face
from undrift.trial.bench import TrialBench
from undrift.trial.values import Trial, TrialErrors

WORD = 2**64 - 1
# Columns of a trial's parameters, three to a field, in the order of kernels/trial.py.
NOISE, MATRIX, ZERO, TEMP, START = slice(30, 36), slice(81, 90), slice(90, 93), 93, slice(105, 109)


def run_trials(bench: TrialBench, trials: Iterable[Trial]) -> Iterator[TrialErrors]:
    """Run trials and hand out their errors batch by batch; memory does not grow with their number.

    Parameters
    ----------
    bench : TrialBench
        What they are made of.
    trials : iterable of Trial
        May be a generator.

    Yields
    ------
    TrialErrors
        Of the next ``settings.batch`` trials.
    """
    from concurrent.futures import ThreadPoolExecutor

    from undrift.kernels.trial import LANES

    threads, stream = bench.settings.threads, iter(trials)
    with ThreadPoolExecutor(threads) as pool:
        while batch := list(islice(stream, bench.settings.batch)):
            groups = [batch[i : i + LANES] for i in range(0, len(batch), LANES)]
            if threads == 1:
                errors = [_run(bench, group) for group in groups]
            else:
                errors = list(pool.map(lambda group: _run(bench, group), groups))
            found = np.concatenate(errors, axis=1)
            yield TrialErrors(np.array([trial.number for trial in batch]), found[0], found[1])


def trial_noise(seed: int, number: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """Return the normal numbers that a trial draws: what the twin of the kernel takes in place of its own.

    Parameters
    ----------
    seed : int
        Of the settings.
    number : int
        Of the trial.
    samples : int
        N.

    Returns
    -------
    white, walk : array, shape (N, 3)
        Unit variance.
    """
    from undrift.kernels.trial import LANES, NOISE_1, NOISE_2, SIZE, WIDE, normals

    key, out = _keys(seed, [number] * LANES), np.empty(SIZE)
    z = np.empty(3 * WIDE, dtype=np.uint64)
    found = np.empty((2, samples, 3))
    with np.errstate(over="ignore"):  # a hash overflows, which numpy notices where the kernel is not compiled
        for k in range(samples):
            normals(key, np.uint64(k), z, z.view(np.float64), out, NOISE_1, NOISE_2)
            for i, at in enumerate((int(NOISE_1), int(NOISE_2))):
                found[i, k] = out[at : at + WIDE : LANES]
    return found[0], found[1]


def _run(bench: TrialBench, group: list[Trial]) -> FloatArray:
    """Return RMS and greatest error of at most 32 trials, shape (2, B)."""
    from undrift.kernels.trial import LANES
    from undrift.kernels.trial import trials as kernel

    lanes = group + group[-1:] * (LANES - len(group))
    motion, device, calibration = (np.array([trial[i] for trial in lanes]) for i in range(3))
    columns = bench.devices[device]
    columns[:, MATRIX] = bench.calibrations[calibration][:, :9]
    columns[:, ZERO] = bench.calibrations[calibration][:, 9:12]
    columns[:, START] = bench.calibrations[calibration][:, 12:]
    columns[:, TEMP] = [trial.temp_c for trial in lanes]
    columns[:, TEMP + 1] = [trial.warming_k_per_s * bench.step_s for trial in lanes]
    start = np.concatenate((bench.start[motion].T.ravel(), bench.lacking[device]))
    forward, up = _unit(bench.settings.forward), _unit(bench.settings.up)
    out = np.empty(2 * LANES)
    with np.errstate(over="ignore"):  # as in trial_noise
        kernel(
            bench.rows,
            bench.first[motion].astype(np.int64),
            bench.length[motion].astype(np.float64),
            np.ascontiguousarray(columns.T).ravel(),
            _keys(bench.settings.seed, [trial.number for trial in lanes]),
            start,
            bench.table,
            np.concatenate((forward, up)),
            bench.step_s,
            bool(columns[:, NOISE].any()),
            out,
        )
    return out.reshape(2, LANES)[:, : len(group)]


def _unit(face: Face) -> FloatArray:
    axis = np.zeros(3)
    axis["xyz".index(face[1])] = 1.0 if face[0] == "+" else -1.0
    return axis


def _keys(seed: int, numbers: Sequence[int]) -> NDArray[np.uint64]:
    """Return one key per axis and lane: a hash of seed, effect and trial."""
    words = np.array([1, 2, 3, *(number & WORD for number in numbers), seed & WORD], dtype=np.uint64)
    mixed = _mixed(words)
    effects = _mixed(mixed[-1:] ^ mixed[:3])
    return _mixed(effects[:, None] ^ mixed[3:-1]).ravel()


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Finish of splitmix64."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
