"""The note's study as a preset: its three tasks, its device, its Table 1 to stand beside ours.

Spaces surround the note's values; dwell, brackets and set-points are choices, since the note leaves them unsaid (docs/study.md).
"""

from dataclasses import dataclass

from undrift.protocol import Protocol
from undrift.sim.motion.library import TaskName
from undrift.study.plan import Space, Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE

DEVICE = "enc03j_3031"
SET_POINTS_C = (18.0, 30.0, 45.0, 60.0, 75.0)
CUTOFFS_HZ = (5.0, 7.0, 9.0, 11.1, 13.0, 16.0, 20.0, 25.0, 30.0, 40.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteRow:
    """A row of the note's Table 1.

    Parameters
    ----------
    cutoff_hz : float
        Hz.
    turn_rate_step_dps, turn_rate_min_dps, turn_rate_max_dps : float
        deg/s.
    p_value : float
        Printed as statistical significance.
    erratum : str
        What is printed and not meant.
    """

    cutoff_hz: float
    turn_rate_step_dps: float
    turn_rate_min_dps: float
    turn_rate_max_dps: float
    p_value: float
    erratum: str = ""


TABLE_1: dict[TaskName, NoteRow] = {
    "sit_to_stand": NoteRow(
        cutoff_hz=11.1, turn_rate_step_dps=5.0, turn_rate_min_dps=5.0, turn_rate_max_dps=90.0, p_value=0.048
    ),
    "step": NoteRow(
        cutoff_hz=11.4,
        turn_rate_step_dps=3.0,
        turn_rate_min_dps=3.0,
        turn_rate_max_dps=45.0,
        p_value=0.040,
        erratum="printed 111.4 Hz; lies between 11.1 and 11.5",
    ),
    "posturography": NoteRow(
        cutoff_hz=11.5, turn_rate_step_dps=0.1, turn_rate_min_dps=0.1, turn_rate_max_dps=5.0, p_value=0.049
    ),
}


def note_study(*, subjects: int = 30, seed: int = 0, quick: bool = False) -> Study:
    """Return the note's study.

    Parameters
    ----------
    subjects : int
        Of the simulation cohort.
    seed : int
        Same seed, same bits.
    quick : bool
        Two cut-offs and a handful of grids, for a first look.

    Returns
    -------
    Study
        Three tasks, 410 to 420 protocols each.
    """
    tasks = (
        _task("sit_to_stand", (5, 10, 15, 20), (5, 10, 15, 20), (50, 60, 70, 80, 90), 1.0, quick),
        _task("step", (3, 6, 9, 12), (3, 6, 9, 12), (21, 27, 33, 39, 45), 1.0, quick),
        _task("posturography", (1, 2, 3, 4), (1, 2, 3, 4), (30, 35, 40, 45, 50), 0.1, quick),
    )
    return Study(name="note", device=DEVICE, tasks=tasks, subjects=subjects, seed=seed)


def _task(
    name: TaskName,
    steps: tuple[int, ...],
    lows: tuple[int, ...],
    highs: tuple[int, ...],
    unit_dps: float,
    quick: bool,
) -> StudyTask:
    own = TABLE_1[name].cutoff_hz
    cutoffs = tuple(own if f == CUTOFFS_HZ[3] else f for f in CUTOFFS_HZ)
    if quick:
        steps, lows, highs, cutoffs = steps[:2], lows[:1], highs[-3::2], (cutoffs[0], own)
    in_si = [tuple(round(v * unit_dps, 9) * RADIAN_PER_DEGREE for v in values) for values in (steps, lows, highs)]
    return StudyTask(
        name=name,
        space=Space(cutoff_hz=cutoffs, turn_rate_step=in_si[0], turn_rate_min=in_si[1], turn_rate_max=in_si[2]),
        base=Protocol(name=name, grid="paper", dwell_s=2.0, bracket_s=6.0, temperatures_c=SET_POINTS_C),
    )
