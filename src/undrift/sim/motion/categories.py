"""Categories of subjects: numbers of the tasks' models for each, with their sources.

The note studies protocols for a task and a category of subjects: healthy, or pathologic by type or by a degree of inability. Its
own thirty subjects have Tinetti level 2, here ``level_2``, the default. A quantity is mean, standard deviation, least and
greatest; a subject has the same habits in every category, in standard deviations.

Sources as in docs/motions.md, which has this table with the publications: found, known, note, assumed. The defaults of ``Category``
are the numbers of level_2 (assumed; three bounds of the note's Table 1). What a category leaves out is as that: for the instant of
the turn found (phases last as long at 25 to 36 as at 61 to 74 years), else assumed.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

CategoryName = Literal["level_2", "young", "elderly", "impaired", "parkinson"]
DEFAULT: CategoryName = "level_2"
Range = tuple[float, float, float]  # Lowest, mean, highest
Spread = tuple[float, float, float, float]  # Mean, standard deviation, least, greatest


@dataclass(frozen=True, slots=True, kw_only=True)
class Category:
    """How people of one category perform the three tasks."""

    label: str  # For people
    age_years: Range | None = None  # None: the note's Table 2, by group
    height: Range | None = None  # m, as above
    typical_age_years: float  # That the numbers below hold for; a year more adds 0.3 % to durations and 1 % to sway
    # Greatest rate about any axis in sit-to-stand, step and posturography, deg/s; beyond it a performance is drawn again
    most_dps: tuple[float, float, float] = (90.0, 45.0, 5.0)
    # Sit-to-stand: duration, s; instant of the turn as a share of it; flexion at L5, first and last pitch, deg
    rise_s: Spread = (2.3, 0.5, 1.5, 4.0)
    turn: Spread = (0.40, 0.05, 0.3, 0.5)
    flexion_deg: Spread = (32.0, 7.0, 15.0, 50.0)
    sitting_deg: Spread = (5.0, 5.0, -10.0, 20.0)
    standing_deg: Spread = (3.0, 3.0, -6.0, 12.0)
    settling: float = 1.0  # Sway after it, in that of level_2
    # Step: duration, s; forward lean and roll to one side, deg
    step_s: Spread = (2.0, 0.4, 1.2, 3.2)
    lean_deg: Spread = (12.0, 4.0, 3.0, 25.0)
    roll_deg: Spread = (5.0, 2.0, 1.0, 10.0)
    # Quiet stance, eyes closed on foam: rms of pitch, roll and yaw, pitch, deg; what sets the spectrum: stiffness in m g h and
    # time constant of the torque's noise, s
    sway_deg: tuple[Spread, Spread, Spread] = ((0.9, 0.3, 0.3, 1.8), (0.6, 0.2, 0.2, 1.2), (0.4, 0.1, 0.1, 0.8))
    upright_deg: Spread = (3.0, 2.0, -3.0, 9.0)
    stiffness: Spread = (1.45, 0.08, 1.25, 1.6)
    noise_s: float = 1.5


def _numbers(value: object) -> Any:
    """Return lists of a TOML file as tuples."""
    return tuple(_numbers(item) for item in value) if isinstance(value, list) else value


CATEGORIES: dict[CategoryName, Category] = {
    cast(CategoryName, name): Category(**{key: _numbers(value) for key, value in entry.items()})
    for name, entry in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}
