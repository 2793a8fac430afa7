"""Levels of correction and a simulated device, as in ``undrift validate``, on trials of four kinds, deg.

``python -m benchmarks.levels`` prints a table of each set, or of the named sets:

    note     a note-like device (ENC-03J, hysteresis, thermometer lag, bow of the converter, g-sensitivity) on five simulated people
    captured the same device in captured motions of three people: sit-to-stand, squats, stairs (mocap_*, c3d)
    b, c, d  BROAD trials of a device, each by the reference fit to the others
    chain    chain_with_optics, in the same way: 40 Hz, optics at 30 Hz, no rest, no positions

Simulated devices are calibrated on the simulated bench at 25 degC and by soaks while warming. Trials are 12.5 K warmer.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.broad_files import read_broad
from benchmarks.in_motion import pairs as pairs_in_motion
from undrift.calibration.calibrate import calibrate_to_references
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.study.case import REST_S
from undrift.study.figure3 import OPTICS, SETTLED_S, actual_device, calibrated, worn_record
from undrift.study.recorded import SAMPLE_RATE_HZ, OwnMotion, read_motion
from undrift.units import STANDARD_GRAVITY
from undrift.validation.agreement import MOUNTING_ABOVE, validate_leave_one_out
from undrift.validation.levels import LevelTable, LevelTrial, judge_levels
from undrift.validation.trial import TrialSettings

Pairs = list[tuple[Record, Reference]]
DATA = Path(os.environ.get("UNDRIFT_DATA", "../shared/data"))
EXCURSION_K, ROOM_C = 12.5, 25.0
TASKS = ("sit_to_stand", "step")
CAPTURES = (  # file, task, person
    ("mocap_sit_to_stand/STS1.trc.gz", "sit-to-stand", "Subject4"),
    ("mocap_sit_to_stand/STSAsym1.trc.gz", "sit-to-stand", "Subject4"),
    ("mocap_sit_to_stand/squats1.trc.gz", "squat", "Subject4"),
    ("mocap_stair_up/markers_Squat2.trc.gz", "squat", "stair"),
    ("mocap_stair_up/markers_StairUp3.trc.gz", "stairs", "stair"),
    ("c3d/squat.c3d.gz", "squat", "Vicon"),
)
BROAD = {
    "b": ("02_undisturbed_slow_rotation_B", "05_undisturbed_slow_rotation_with_breaks_B", "07_undisturbed_fast_rotation_B",
          "09_undisturbed_fast_rotation_with_breaks_B"),
    "c": ("03_undisturbed_slow_rotation_C", "24_disturbed_tapping_A"),
    "d": ("32_disturbed_attached_magnet_1cm", "35_disturbed_attached_magnet_4cm"),
}  # fmt: skip


def simulated(seed: int = 1, people: int = 5) -> LevelTable:
    """Compare the note-like device's levels on simulated people."""
    device = actual_device(preset("enc03j_3031"))
    full = calibrated(device, rng=np.random.default_rng(seed), back=False)
    pairs, tasks, whose = Pairs(), list[str](), list[str]()
    for person in range(people):
        for task in TASKS:
            rng = np.random.default_rng([9, person, len(task)])
            performed = draw_task(task, rng=rng)
            record = worn_record(device, performed, rng=rng)
            pairs.append((record, see(performed, rng=rng, settings=OPTICS)))
            tasks.append(task)
            whose.append(f"p{person}")
    return _compared(pairs, [full] * len(pairs), tasks, whose)


def captured(seed: int = 2) -> LevelTable:
    """Compare them in captured motions that begin at rest."""
    device = actual_device(preset("enc03j_3031"))
    full = calibrated(device, rng=np.random.default_rng(seed), back=False)
    pairs = Pairs()
    for k, (file, *_) in enumerate(CAPTURES):
        motion_of = OwnMotion(
            path=str(DATA / file), body="pelvis", up="z" if "c3d" in file else "y", rest_s=REST_S, hold=True
        )
        performed = read_motion(motion_of)
        time = np.arange(int(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
        motion = performed.at(time, STANDARD_GRAVITY)
        first = performed.spline.span_s[0]
        position = performed.spline.position(first + np.maximum(time - REST_S, 0.0))
        simulated = simulate_device(
            device, motion, rng=np.random.default_rng([5, k]), temp_c=ROOM_C + EXCURSION_K, power_on_s=SETTLED_S
        )
        moving = (time >= REST_S).astype(float)
        pairs.append((simulated.record, Reference(time=time, q_nb=motion.q_nb, position=position, moving=moving)))
    return _compared(pairs, [full] * len(pairs), [task for _, task, _ in CAPTURES], [who for *_, who in CAPTURES])


def left_out(pairs: Pairs) -> LevelTable:
    """Compare the levels of a real device, each trial by the reference fit to the others."""
    trials = validate_leave_one_out(pairs).held_out
    model = calibrate_to_references([item for item, _ in pairs], [poses for _, poses in pairs])
    settings = TrialSettings(align_above=MOUNTING_ABOVE)
    return _compared(pairs, [replace(model, gyro=item.fit.triad.model) for item in trials], settings=settings)


def _compared(
    pairs: Pairs,
    calibrations: Sequence[Calibration],
    tasks: Sequence[str] = (),
    people: Sequence[str] = (),
    settings: TrialSettings = TrialSettings(),
) -> LevelTable:
    trials = []
    for k, (record, reference) in enumerate(pairs):
        trials.append(
            LevelTrial(
                recording=f"{k + 1}",
                record=record,
                reference=reference,
                calibration=calibrations[k],
                person=people[k] if people else "",
                task=tasks[k] if tasks else "",
            )
        )
    return judge_levels(trials, settings=settings)


def show(name: str, table: LevelTable) -> None:
    """Print one table."""
    print(
        f"{name}: {table.quantity}, rms, deg; mean over people [95 %], less than above; simulated; difference mean, most"
    )
    for row in table.errors:
        mean = next(summary for summary in table.summaries if (summary.group, summary.level) == ("all", row.level))
        if not mean.people:
            print(f"  {row.level:16} {row.missing}")
            continue
        both, decision = np.isfinite(row.difference_deg), mean.decision
        verdict = "" if decision is None else f"{decision.difference:6.2f} {decision.verdict}"
        low, high = mean.interval_deg
        twin = (
            f"{row.simulated_deg[both].mean():6.2f} {row.difference_deg[both].mean():5.2f} {row.difference_deg[both].max():5.2f}"
            if both.any()
            else ""
        )
        print(f"  {row.level:16} {mean.mean_deg:6.2f} [{low:.2f}, {high:.2f}]  {verdict:22} {twin}  {row.missing}")
        print(f"  {'':16} each: {' '.join(f'{x:.2f}' for x in row.error_deg)}")


def main(names: Sequence[str]) -> None:
    """Print the tables of the sets that are named, or of all."""
    for name in names or ("note", "captured", *BROAD, "chain"):
        if name in BROAD:
            show(name, left_out([read_broad(DATA / "broad" / f"{trial}.hdf5") for trial in BROAD[name]]))
        else:
            show(
                name,
                {"note": simulated, "captured": captured, "chain": lambda: left_out(list(pairs_in_motion("chain")))}[
                    name
                ](),
            )


if __name__ == "__main__":
    main(sys.argv[1:])
