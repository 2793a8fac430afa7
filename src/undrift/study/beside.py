"""The note's Table 1 beside ours: does a study agree with the row, or why does it not?

A row agrees where its protocol is statistically as good as the optimum, whatever the four numbers are: where a minimum is flat,
two honest studies name different protocols. Where it differs, the four parameters are exchanged one at a time for ours, and the
one that takes most of the error off is named.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.study.effects import PARAMETERS
from undrift.study.note import NoteRow
from undrift.study.optimise import Optimum
from undrift.study.run import TaskSurface

UNITS = {
    "cutoff_hz": ("cut-off", "Hz"),
    "turn_rate_step_dps": ("step", "deg/s"),
    "turn_rate_min_dps": ("omega_m", "deg/s"),
    "turn_rate_max_dps": ("omega_M", "deg/s"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """A row of the note beside an optimum.

    Parameters
    ----------
    row : NoteRow
        As printed.
    place : int or None
        Of the note's protocol on the surface; None where it was not tried.
    error_deg : float
        Mean of the objective with the note's protocol, deg.
    difference_deg : float
        That minus the optimum's, deg.
    verdict : str
        agrees, differs or not tried.
    because : str
        Why, in words and figures.
    """

    row: NoteRow
    place: int | None
    error_deg: float
    difference_deg: float
    verdict: Literal["agrees", "differs", "not tried"]
    because: str


def compare_with_note(
    surface: TaskSurface, optimum: Optimum, row: NoteRow, *, objective: str = "rms", level: float = 0.05
) -> Beside:
    """Compare an optimum with the note's.

    Parameters
    ----------
    surface : TaskSurface
        All errors.
    optimum : Optimum
        What was found on it.
    row : NoteRow
        What the note printed.
    objective : str
        rms or maximum.
    level : float
        Of the tests.

    Returns
    -------
    Beside
        With its reason.
    """
    wanted = np.array([getattr(row, name) for name in PARAMETERS])
    table = np.stack([getattr(surface, name) for name in PARAMETERS], axis=1)
    place, nan = _place(table, wanted), float("nan")
    error_of = surface.error(objective)
    mean = error_of.mean(axis=0)
    if place is None or not np.isfinite(mean[place]):
        why = "its protocol is not among those tried" if place is None else "its protocol left a device uncalibrated"
        return Beside(row=row, place=place, error_deg=nan, difference_deg=nan, verdict="not tried", because=why)
    error, apart = float(mean[place]), float(mean[place] - mean[optimum.best])
    count, tried = int(optimum.equivalent.sum()), len(mean)
    flat = "; the minimum is flat" if optimum.flat else ""
    if optimum.deciding and count > 1:
        flat = f"; still {_words_of(optimum.deciding)} the error"
    elif count == tried:
        flat = "; nothing that was tried is worse, so the four parameters do not decide the error here"
    if place == optimum.best:
        because = f"its protocol is our optimum, with {count - 1} of {tried - 1} others as good{flat}"
        verdict: Literal["agrees", "differs"] = "agrees"
    elif optimum.equivalent[place]:
        seen = _least_seen(error_of[:, place] - error_of[:, optimum.best], tried, level)
        because = (
            f"its protocol is one of the {count} of {tried} that {len(error_of)} subjects do not tell from the optimum "
            f"({error:.3f} against {mean[optimum.best]:.3f} deg; {seen:.3f} deg more would have shown){flat}"
        )
        verdict = "agrees"
    else:
        because = (
            f"its protocol errs by {apart:.3f} deg more than ours ({error:.3f} against {mean[optimum.best]:.3f} deg)"
            + _reason(table, mean, place, optimum.best)
        )
        verdict = "differs"
    return Beside(row=row, place=place, error_deg=error, difference_deg=apart, verdict=verdict, because=because)


def _place(table: FloatArray, wanted: FloatArray) -> int | None:
    hits = np.flatnonzero(np.isclose(table, wanted, rtol=1e-6).all(axis=1))
    return int(hits[0]) if len(hits) else None


def _words_of(deciding: tuple[str, ...]) -> str:
    words = [UNITS[name][0] for name in deciding]
    return f"{' and '.join(words)} {'decides' if len(words) == 1 else 'decide'}"


def _least_seen(apart: FloatArray, tests: int, level: float) -> float:
    """Return the mean difference from which on the test among so many tells a protocol from the optimum, deg."""
    from scipy.stats import t as t_distribution

    n = len(apart)
    return float(t_distribution.ppf(1.0 - level / tests, n - 1) * apart.std(ddof=1) / np.sqrt(n))


def _reason(table: FloatArray, mean: FloatArray, place: int, best: int) -> str:
    """Name the parameter whose exchange for ours takes most of the error off, where such protocols were tried."""
    gains: list[tuple[float, str]] = []
    for k, name in enumerate(PARAMETERS):
        exchanged = table[place].copy()
        exchanged[k] = table[best, k]
        at = _place(table, exchanged)
        if at is not None and at != place and np.isfinite(mean[at]):
            word, unit = UNITS[name]
            text = f"{word} {table[best, k]:.4g} in place of {table[place, k]:.4g} {unit}"
            gains.append((float(mean[place] - mean[at]), text))
    if not gains or max(gains)[0] <= 0.0:
        return "; no single parameter explains it"
    gain, text = max(gains)
    return f"; {text} alone takes {gain:.3f} deg off"
