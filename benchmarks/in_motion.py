"""Recordings with a reference that begin and end in motion: remaining orientation error of each calibration, deg.

``python -m benchmarks.in_motion`` prints a table of each set (two minutes), or of the named sets: chain, carpus,
radius, pendulum. Each recording is judged raw, with the fit to the other recordings of its device, and with the fit to
their motion only. Each is also judged with the offset from its own motion. Raw and calibrated readings start from the
reference. The robot's rests at the start are cut to a second, because its accelerometers have errors of 1 deg there.

Sets and their sources: SOURCE.md of chain_with_optics, robot_arm_reference and pendulum_with_optics.
"""

import gzip
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate_from_motion, calibrate_to_references
from undrift.calibration.reference import fit_reference
from undrift.errors import UndriftError
from undrift.frames import quaternion_product
from undrift.record import Record, Reference
from undrift.validation.agreement import Validation, validate_leave_one_out, validate_trials
from undrift.validation.trial import Trial, TrialSettings, validate_trial

SETS = {
    "chain": ("seg2_trial1", "seg2_trial2"),
    "carpus": ("circle-100_carpus", "circle-150_carpus", "circle-250_carpus"),
    "radius": ("circle-100_radius", "circle-150_radius", "circle-250_radius"),
    "pendulum": ("Pendulum_Test02a_Trial1_Segment_2", "Pendulum_Test02b_Trial1_Segment_2"),
}
_UP = 2.0**-0.5 * np.array([1.0, 0.0, 1.0, 0.0])  # the pendulum's laboratory: its -x points up


def _rows(folder: str, name: str, head: int, separator: str = ",") -> FloatArray:
    path = Path(os.environ.get("UNDRIFT_DATA", "../shared/data")) / folder / f"{name}.csv.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()[head:]
    lines = [re.sub(r"(\d),(\d)", r"\1.\2", line) for line in lines] if separator == ";" else lines
    return np.array([[float(cell or "nan") for cell in line.split(separator)] for line in lines])


@cache
def pair(name: str) -> tuple[Record, Reference]:
    """Return record and reference of a recording."""
    if name.startswith("seg"):
        rows, poses = _rows("chain_with_optics", f"{name}_imu", 3), _rows("chain_with_optics", f"{name}_optics", 3)
        time, optics_time = np.arange(len(rows)) / 40.0, np.arange(len(poses)) / 30.0
        return Record(time=time, gyro=rows[:, 3:6], accel=rows[:, :3]), Reference(
            time=optics_time, q_nb=poses[:, -4:], name=name
        )
    if name.startswith("circle"):
        rows, poses = _rows("robot_arm_reference", f"{name}_imu", 1), _rows("robot_arm_reference", f"{name}_robot", 1)
        time, optics_time = np.arange(len(rows)) / 125.0, 1e-6 * (poses[:, 0] - poses[0, 0])
        return Record(time=time, gyro=rows[:, 4:7], accel=rows[:, 1:4]), Reference(
            time=optics_time, q_nb=poses[:, 1:], name=name
        )
    rows = _rows("pendulum_with_optics", name, 2, ";")
    time = np.linspace(rows[0, 0], rows[-1, 0], len(rows))  # stamps are rounded to 10 ms, and repeat
    level = quaternion_product(_UP, rows[:, 1:5])
    return Record(time=time, gyro=rows[:, 8:11], accel=rows[:, 5:8]), Reference(time=time, q_nb=level, name=name)


def pairs(name: str) -> list[tuple[Record, Reference]]:
    """Return the recordings of a device, rests of three seconds and more cut to one."""
    trials = []
    for record, reference in map(pair, SETS[name]):
        late = 2.2 if record is pair("circle-250_carpus")[0] or record is pair("circle-250_radius")[0] else 0.0
        trials.append((record.between(late, np.inf), reference))
    return trials


def table(name: str) -> Iterator[tuple[str, Validation]]:
    """Yield the calibrations and the trials of a device."""
    trials, called = pairs(name), SETS[name]
    for offset in ("none", "motion"):
        settings, suffix = TrialSettings(offset=offset), " + offset from motion" * (offset == "motion")
        yield f"raw{suffix}", validate_trials(trials, settings=settings, names=called)
        yield f"fit to the others{suffix}", validate_leave_one_out(trials, settings=settings, names=called)
        yield f"motion of the others alone{suffix}", by_motion(trials, settings, called)


def by_motion(trials: list[tuple[Record, Reference]], settings: TrialSettings, names: tuple[str, ...]) -> Validation:
    """Return the trials of a device, each calibrated by the motion in the others, without their reference."""
    return Validation.of(
        tuple(
            validate_trial(
                *pair,
                calibration=calibrate_from_motion([record for record, _ in trials if record is not pair[0]]),
                settings=settings,
                name=name,
            )
            for pair, name in zip(trials, names, strict=True)
        )
    )


def by_themselves(name: str) -> Validation:
    """Return the trials of a device, each fitted to itself: the residual errors of reference and model."""

    def judged(record: Record, reference: Reference) -> Trial:
        return validate_trial(record, reference, calibration=calibrate_to_references([record], [reference]))

    return Validation.of([judged(*pair) for pair in pairs(name)])


def main(names: tuple[str, ...]) -> None:
    """Print the tables."""
    for name in names:
        print(f"\n{name}: total rmse / end total / end inclination, deg, of each recording, then their means")
        rows = [*table(name)]
        try:
            rows.append(("fit to itself", by_themselves(name)))
        except UndriftError as error:
            print(f"  fit to itself: {error}")
        for what, result in rows:
            cells = [
                f"{f.rmse_total_deg:6.2f} {f.end_total_deg:6.2f} {f.end_inclination_deg:6.2f}"
                for f in (*(trial.figures for trial in result.trials), result.mean)
            ]
            print(f"  {what:40s} {' | '.join(cells)}")
        unseen = fit_reference(*zip(*pairs(name), strict=True)).triad.verdict.findings
        print("  " + "; ".join(entry.text for entry in unseen))


if __name__ == "__main__":
    main(tuple(sys.argv[1:]) or tuple(SETS))
