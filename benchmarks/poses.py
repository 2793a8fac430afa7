"""Why five faces are as good as six: the error of a trial by the poses in which accelerometers are calibrated, over many subjects.

``python -m benchmarks.poses [--subjects 600]``. Sit-to-stand of the note's preset at one protocol (45 Hz, the note's rates, all
set-points), each set of poses on the same subjects, devices and benches. The weights say what is expected: accelerometers are used
once, in the pose worn at the start, near +z. A fit to poses u_k predicts the reading there as sum_k w_k s_k::

    w = p pinv(D)                        D rows (u_k, 1), p = (u, 1) of the pose worn
    pitch = sigma |w_k (u_k x e)|        error of the pitch at the start by tilts of the poses, sigma about each axis, e forward

A face does not feel its own tilt along its own axis: those of +x and -x count for nothing.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.motion.motion import unit_vector
from undrift.study.case import EffectName, Unit, run_unit
from undrift.study.plan import POSES, Study, StudyTask, note_study
from undrift.study.space import Space
from undrift.units import RADIAN_PER_DEGREE

WORN_DEG = 4.0  # mean pitch at the start of a sit-to-stand
DPS = RADIAN_PER_DEGREE


def start_tilt(poses: Sequence[str], worn_deg: float = WORN_DEG) -> float:
    """Return the error of the pitch at the start over the tilt of a pose."""
    up = np.array([unit_vector(pose) for pose in poses])
    sine, cosine = np.sin(worn_deg * DPS), np.cos(worn_deg * DPS)
    weight = np.array([-sine, 0.0, cosine, 1.0]) @ np.linalg.pinv(np.column_stack((up, np.ones(len(up)))))
    return float(np.linalg.norm(weight[:, None] * np.cross(up, [cosine, 0.0, sine])))


def one_protocol(study: Study, task: StudyTask, sets: Sequence[int]) -> StudyTask:
    """Return a task with the note's rates at 45 Hz, for sets of poses."""
    rates = {"turn_rate_step": (5.0 * DPS,), "turn_rate_min": (5.0 * DPS,), "turn_rate_max": (90.0 * DPS,)}
    space = Space(cutoff_hz=(45.0,), further=(("poses", tuple(float(k + 1) for k in sets)),), **rates)
    return replace(task, space=space)


def errors(study: Study, task: StudyTask, subjects: int, without: EffectName | None = None) -> FloatArray:
    """Return the rms errors in real time of subjects with each set of poses, (subjects, sets) deg."""
    (setting,) = task.space.settings()
    units = (Unit(study=study, task=task, subject=k, setting=setting, without=without) for k in range(subjects))
    return np.array([run_unit(unit)["error_rms_deg"] for unit in units])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--subjects", type=int, default=600)
    parser.add_argument("--task", default="sit_to_stand")
    parser.add_argument("--offset", default="rest")
    parser.add_argument("--device", default="enc03j_3031")
    asked = parser.parse_args()
    subjects = asked.subjects
    study = replace(note_study(subjects=subjects), offset=asked.offset, device=asked.device)
    task = next(each for each in study.tasks if each.name == asked.task)
    task = one_protocol(study, task, range(len(POSES)))
    every = errors(study, task, subjects)
    named: tuple[EffectName, ...] = ("cross-axis", "accelerometer offset", "noise")
    without = {name: errors(study, task, subjects, name) for name in named}
    groups = every[: 30 * (subjects // 30)].reshape(-1, 30, len(POSES)).mean(axis=1)
    print(f"{task.name}, {subjects} subjects, deg; difference from six faces with its 95 % interval")
    for k, poses in enumerate(POSES):
        apart = every[:, k] - every[:, 0]
        half = 1.96 * apart.std(ddof=1) / np.sqrt(subjects)
        beats = int((groups[:, k] < groups[:, 0]).sum())
        lone = ", ".join(f"without {name} {(x[:, k] - x[:, 0]).mean():+.4f}" for name, x in without.items())
        print(
            f"{k + 1}: {len(poses)} poses {poses[:6]}: start errs by {start_tilt(poses):.3f} of a tilt; error "
            f"{every[:, k].mean():.4f}, {apart.mean():+.4f} +- {half:.4f} (sd {apart.std(ddof=1):.3f}), less than six faces in "
            f"{beats} of {len(groups)} studies of 30; {lone}"
        )


if __name__ == "__main__":
    main()
