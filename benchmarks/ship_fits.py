"""Make the fits that ship with the package (study/shipped.py): ``python -m benchmarks.ship_fits [STUDY ...] [--sessions ...]``.

It makes the note's study, with the effects, rivals and short sessions of the other group, then each preset with the
sessions of a default study. Fits in the file are kept if the fits of device 0 agree. All fits take half an hour on two
processors. The file is written after each study.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import undrift
from undrift.arrays import FloatArray
from undrift.base.workers import executor
from undrift.sim.device.presets import PRESETS
from undrift.study.case import EFFECTS
from undrift.study.methods import RIVALS, Rival, fit_rival
from undrift.study.plan import SUBJECTS, Study, StudyTask, note_study
from undrift.study.run import StudyDevice, agrees
from undrift.study.sessions import SESSIONS, CalibrationSession
from undrift.study.shipped import ARRAYS, FILE, Fit, pack, shipped_fits

SHORT_MIN = 60.0
EFFECT_DEVICES = 10


def studies() -> Iterator[Study]:
    """Return the note's study and the default study of each preset."""
    yield note_study()
    for name in PRESETS:
        yield Study(name=name, device=name, tasks=(StudyTask(name="sit_to_stand"),))


def fits_of_device(study: Study, number: int) -> dict[int, Fit]:
    """Return the fits of a device by key. For the note's study, variations, effects, rivals and the other group are
    included.
    """
    short = [session for session in study.sessions if session.length_min < SHORT_MIN]
    tried = dict.fromkeys(numbers.session() for task in study.tasks for _, _, numbers in task.variations())
    device = StudyDevice(study, number)
    fits = _fits(device, (*study.sessions, *tried))
    if tried:
        fits |= _fits(StudyDevice(study.other(), number), short)
    if tried and number < EFFECT_DEVICES:
        for effect in EFFECTS:
            fits |= _fits(StudyDevice(study, number, effect), short)
        fits |= _fits(device, RIVALS)
    return fits


def _fits(device: StudyDevice, sessions: Sequence[CalibrationSession | Rival]) -> dict[int, Fit]:
    stored, packed = shipped_fits() if device.study.shipped else {}, dict[int, Fit | None]()
    for session in sessions:
        key, rival = device.key(session), isinstance(session, str)
        if rival or session.suits(device.model):
            packed[key] = stored.get(key) or pack(fit_rival(session, device) if rival else device.fit(session))
    return {key: values for key, values in packed.items() if values is not None}


def write_fits(fits: Mapping[int, Fit], notes: Mapping[str, str], path: Path = FILE) -> None:
    """Write fits by their key."""
    columns = {"key": pa.array(sorted(fits), pa.uint64())}
    for name, (shape, rounding) in ARRAYS.items():
        arrays = [fits[key].get(name) for key in sorted(fits)]
        rows = [None if array is None else _differences(array.reshape(shape), rounding) for array in arrays]
        columns[name] = pa.array(rows, pa.list_(pa.float64()))
    pq.write_table(pa.table(columns, metadata=dict(notes)), path, compression="zstd", compression_level=19)


def _differences(array: FloatArray, rounding: float) -> FloatArray:
    """Return the rounding step of an array, and the second differences of its rounded values along the first axis."""
    step = rounding * float(np.abs(array).max()) or 1.0
    counts = np.round(array / step)
    return np.append(step, np.diff(counts, n=2, axis=0, prepend=np.zeros((2, *array.shape[1:]))))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="note, or presets; all if not given")
    parser.add_argument("--sessions", nargs="*", default=[*SESSIONS], help="sessions to fit; all if not given")
    parser.add_argument("--devices", type=int, default=SUBJECTS)
    options = parser.parse_args()
    fits = dict(shipped_fits())
    for study in studies():
        if options.names and study.name not in options.names:
            continue
        start = time.perf_counter()
        study = replace(study, sessions=tuple(SESSIONS[name] for name in options.sessions))
        with executor() as spread:
            study = replace(study, shipped=all(spread(partial(agrees, study), study.sessions)))
            for device_fits in spread(partial(fits_of_device, study), range(options.devices)):
                fits |= device_fits
        write_fits(fits, {"undrift": undrift.__version__, "seed": str(study.seed)})
        print(f"{study.name}: {len(fits)} fits in the file, {time.perf_counter() - start:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
