"""Categories of subjects: numbers of the tasks' models for each, with their sources.

The note studies protocols for a task and a category of subjects: healthy, or pathologic by type or by a degree of inability. Its
own thirty subjects have Tinetti level 2, here ``level_2``, the default. A quantity is mean, standard deviation, least and
greatest; a subject has the same habits in every category, in standard deviations.

Sources as in docs/motions.md, which has this table with the publications: found, known, note, assumed. The defaults of ``Category``
are the numbers of level_2 (assumed; three bounds of the note's Table 1). What a category leaves out is as that: for the instant of
the turn found (phases last as long at 25 to 36 as at 61 to 74 years), else assumed.
"""

from dataclasses import dataclass
from typing import Literal

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


CATEGORIES: dict[CategoryName, Category] = {
    "level_2": Category(label="Tinetti level 2", typical_age_years=63.5),
    "young": Category(
        label="healthy young",
        age_years=(20.0, 28.0, 40.0),  # assumed
        height=(1.55, 1.73, 1.95),  # assumed
        typical_age_years=28.0,
        most_dps=(200.0, 90.0, 5.0),  # assumed: twice the note's; the capture of a young adult's trunk peaks at 136
        rise_s=(1.4, 0.25, 1.0, 2.2),  # assumed, below the 1.5 (0.3) found of 65 to 74 years
        flexion_deg=(38.0, 8.0, 20.0, 60.0),  # known: whole trunk 38 to 45
        settling=0.5,  # found: sway after rising 5.0 against 12.4 of healthy elderly
        step_s=(1.4, 0.25, 0.9, 2.2),  # assumed
        lean_deg=(10.0, 3.0, 3.0, 20.0),  # assumed
        roll_deg=(4.0, 1.5, 1.0, 9.0),  # assumed
        sway_deg=((0.5, 0.15, 0.2, 1.0), (0.33, 0.1, 0.12, 0.7), (0.25, 0.07, 0.08, 0.5)),  # found that less; assumed
        noise_s=0.3,  # measured: median frequency 0.4 to 0.6 Hz of one person of 37 years
    ),
    "elderly": Category(
        label="healthy elderly, Tinetti >= 24",
        age_years=(65.0, 73.0, 85.0),  # assumed
        height=(1.50, 1.66, 1.85),  # note: of its subjects
        typical_age_years=73.0,
        most_dps=(140.0, 60.0, 5.0),  # assumed
        rise_s=(1.6, 0.3, 1.1, 2.6),  # found: 1.5 (0.3) at 65 to 74 and 1.5 (0.2) above; 1.67 (0.27) at 62 years
        flexion_deg=(35.0, 7.0, 18.0, 55.0),  # found: as much as the young; for a peak of 94 (17) deg/s
        step_s=(1.7, 0.3, 1.1, 2.8),  # assumed
        # found: sway on foam 173 mm at a low and 217 mm at an intermediate risk of falls: level_2 over 1.25
        sway_deg=((0.72, 0.24, 0.24, 1.44), (0.48, 0.16, 0.16, 0.96), (0.32, 0.08, 0.08, 0.64)),
        stiffness=(1.50, 0.08, 1.3, 1.65),  # assumed: stiffer
    ),
    "impaired": Category(
        label="Tinetti <= 18",
        age_years=(68.0, 80.0, 92.0),  # assumed
        height=(1.45, 1.62, 1.80),  # assumed
        typical_age_years=80.0,
        most_dps=(90.0, 45.0, 10.0),  # note; 10 assumed
        # assumed: twice the healthy elderly's; found 1.5 times (2.2 (1.1) s) and 1.7 times
        rise_s=(3.2, 0.8, 2.0, 6.0),
        turn=(0.45, 0.05, 0.35, 0.55),  # assumed
        flexion_deg=(18.0, 6.0, 8.0, 36.0),  # found: frail adults' trunk less than half of the young's
        standing_deg=(5.0, 4.0, -6.0, 15.0),  # assumed
        settling=2.0,  # assumed
        # assumed: 1.5 times level_2; found 2.1 to 3.2 s for three steps, best and worst group
        step_s=(3.0, 0.7, 1.8, 5.0),
        lean_deg=(15.0, 5.0, 4.0, 30.0),  # assumed
        roll_deg=(7.0, 2.5, 2.0, 14.0),  # assumed
        # assumed: a third above level_2
        sway_deg=((1.2, 0.4, 0.4, 2.4), (0.9, 0.3, 0.3, 1.8), (0.55, 0.15, 0.15, 1.1)),
        upright_deg=(5.0, 3.0, -3.0, 12.0),  # assumed
        stiffness=(1.40, 0.08, 1.2, 1.55),  # assumed: slacker
    ),
    "parkinson": Category(
        label="Parkinson's disease",
        age_years=(50.0, 67.0, 85.0),  # found: 67 (11) years, 70 patients
        height=(1.50, 1.68, 1.88),  # assumed
        typical_age_years=67.0,
        most_dps=(140.0, 45.0, 10.0),  # assumed
        rise_s=(2.2, 0.5, 1.4, 4.0),  # found that slower than healthy; the number assumed
        # found: exaggerated trunk flexion; for a peak of 89 (4.9 standard error) deg/s
        flexion_deg=(40.0, 9.0, 20.0, 62.0),
        sitting_deg=(10.0, 6.0, -6.0, 25.0),  # known: stooped; the number assumed
        standing_deg=(8.0, 4.0, -2.0, 20.0),  # as above
        settling=1.5,  # assumed
        step_s=(2.3, 0.5, 1.4, 4.0),  # assumed
        lean_deg=(15.0, 5.0, 4.0, 30.0),  # assumed
        # found: forward sway as the controls', sideways more; numbers assumed
        sway_deg=((0.8, 0.27, 0.27, 1.6), (0.75, 0.25, 0.25, 1.5), (0.4, 0.1, 0.1, 0.8)),
        upright_deg=(8.0, 4.0, -2.0, 20.0),  # known: stooped; the number assumed
        stiffness=(1.55, 0.08, 1.35, 1.7),  # known that stiffer; the number assumed
    ),
}
