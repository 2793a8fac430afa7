"""Subjects: who performs a task, and the two groups of thirty of the note's Table 2.

A subject has an age, a height, a level of imbalance (an ordinal label that nothing is computed from) and habits: a root of
random numbers of its own. A quantity of a performance is drawn as ::

    x = mean + sd (0.8 h + 0.6 z)       h the subject's habit for this quantity, z new each time; 0.8^2 + 0.6^2 = 1

and drawn again until it lies within its bounds, so that over many subjects it has the stated mean and sd (nearly: the
bounds cut the tails), and one subject resembles itself.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from undrift.errors import InputError
from undrift.sim.streams import Streams, draw_streams

Group = Literal["simulation", "testing"]
GROUP_SIZE = 30  # Table 2 and the text: thirty subjects
HABIT, TRIAL = 0.8, 0.6  # shares of a habit and of the day: a choice


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """One person.

    Parameters
    ----------
    number : int
        In the group, from 1.
    group : str
        simulation or testing.
    age_years : float
        Years.
    height : float
        m.
    tinetti_level : int
        1 no imbalance ... 4 major imbalance: a label.
    habits : Streams
        What this person always does the same way.
    """

    number: int
    group: Group
    age_years: float
    height: float
    tinetti_level: int
    habits: Streams


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRow:
    """A group as a table prints it.

    Parameters
    ----------
    age_years : (float, float, float)
        Lowest, mean, highest.
    height : (float, float, float)
        Lowest, mean, highest, m.
    """

    age_years: tuple[float, float, float]
    height: tuple[float, float, float]


TABLE_2: dict[Group, TableRow] = {  # [note] Table 2; both groups Tinetti level 2
    "simulation": TableRow(age_years=(45.0, 62.0, 84.0), height=(1.50, 1.66, 1.85)),
    "testing": TableRow(age_years=(45.0, 65.0, 83.0), height=(1.52, 1.67, 1.83)),
}
TYPICAL_AGE, TYPICAL_HEIGHT = 63.5, 1.665  # between the two groups' means; who performs where no subject is named


def cohort(group: Group, *, rng: np.random.Generator) -> tuple[Subject, ...]:
    """Draw the thirty subjects of one group.

    The youngest and oldest, shortest and tallest have the printed values, and the means are the printed ones: u from
    a beta(2, 2) law, with 0 and 1 among them, becomes low + (high - low) u^k, k such that the mean comes out.

    Parameters
    ----------
    group : str
        simulation or testing; the two share no random numbers, even from equal generators.
    rng : Generator
        Draws the people.

    Returns
    -------
    tuple of Subject
        Thirty, Tinetti level 2.

    Raises
    ------
    InputError
        A group that is not one.
    """
    if group not in get_args(Group):
        raise InputError(f"cohort: wanted one of {', '.join(get_args(Group))}, got '{group}'; name one of them")
    streams = draw_streams(rng)
    row = TABLE_2[group]
    ages = _spread(row.age_years, streams.of(f"{group} age"))
    heights = _spread(row.height, streams.of(f"{group} height"))
    roots = streams.of(f"{group} habits")
    return tuple(
        Subject(
            number=number,
            group=group,
            age_years=float(age),
            height=float(height),
            tinetti_level=2,
            habits=draw_streams(roots),
        )
        for number, (age, height) in enumerate(zip(ages, heights, strict=True), start=1)
    )


def _spread(row: tuple[float, float, float], draw: np.random.Generator) -> np.ndarray:
    low, mean, high = row
    unit = np.concatenate(([0.0, 1.0], draw.beta(2.0, 2.0, GROUP_SIZE - 2)))
    wanted = (mean - low) / (high - low)
    small, large = 0.05, 20.0  # the mean of u^k falls as k grows
    for _ in range(60):
        k = 0.5 * (small + large)
        small, large = (k, large) if np.mean(unit**k) > wanted else (small, k)
    return np.asarray(draw.permutation(low + (high - low) * unit**k))


@dataclass(frozen=True, slots=True)
class Performance:
    """One performance by one person: where its numbers come from.

    Parameters
    ----------
    draw : Generator
        What is new each time.
    subject : Subject or None
        Whose habits; None draws an unknown person of typical age and height.
    """

    draw: np.random.Generator
    subject: Subject | None = None

    @property
    def age_years(self) -> float:
        """Age, years."""
        return self.subject.age_years if self.subject else TYPICAL_AGE

    @property
    def height(self) -> float:
        """Height, m."""
        return self.subject.height if self.subject else TYPICAL_HEIGHT

    def number(self, name: str, mean: float, sd: float, low: float, high: float) -> float:
        """Draw one quantity within its bounds.

        Parameters
        ----------
        name : str
            Names the habit.
        mean, sd : float
            Unit of the quantity.
        low, high : float
            Bounds, drawn within, never cut to.

        Returns
        -------
        float
            Unit of the quantity.
        """
        habit = _bounded_normal(self.subject.habits.of(name)) if self.subject else None
        while True:
            z = float(self.draw.normal())
            value = mean + sd * (z if habit is None else HABIT * habit + TRIAL * z)
            if low <= value <= high:
                return value


def _bounded_normal(draw: np.random.Generator) -> float:
    while True:  # within 2 sd: a habit far outside its bounds could never be performed
        z = float(draw.normal())
        if abs(z) <= 2.0:
            return z
