"""Optimum of a task: the protocol with the least error, those that are as good, and the cheapest of them.

The least of many noisy means is too small (the winner was also lucky). So the error that is stated for the optimum is taken
from subjects that did not choose it: the subjects are split in two, each half chooses, the other half says what that is
worth. A protocol is as good as the optimum where a paired t test over the subjects, after Holm over all protocols, does not
tell them apart. Where that holds for many and no parameter's own test says that it matters, the minimum is flat. The cheapest of
them in minutes on the rig is the one to use.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import NotObservable
from undrift.study.effects import ParameterEffect, effects_at
from undrift.study.posthoc import adjust_holm
from undrift.study.run import TaskSurface

FLAT_SHARE = 0.25  # a minimum that a quarter of the protocols share is called flat where no parameter decides


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimum:
    """What a study says of one task.

    Parameters
    ----------
    task : str
        Its name.
    best : int
        Place of the protocol with the least mean error.
    error_rms_deg, error_max_deg : float
        Mean over the subjects of both errors at the optimum, deg.
    honest_error_deg, honest_interval_deg : float, (float, float)
        Mean of the objective by subjects that did not choose it, and its 95 % interval, deg.
    equivalent : array of bool, shape (P,)
        Protocols that are statistically as good.
    cheapest : int
        Of those, the one with the shortest session.
    flat : bool
        Whether a quarter of all protocols or more are as good, and no parameter decides the error.
    deciding : tuple of str
        Parameters whose p after Holm is below the level.
    effects : tuple of ParameterEffect
        One a parameter.
    p_value : float
        Least p after Holm over the parameters: whether any of them matters.
    pareto : array of int
        Protocols that no other beats in both error and minutes, by rising minutes.
    failed : int
        Runs whose protocol could not calibrate the device.
    """

    task: str
    best: int
    error_rms_deg: float
    error_max_deg: float
    honest_error_deg: float
    honest_interval_deg: tuple[float, float]
    equivalent: BoolArray
    cheapest: int
    flat: bool
    deciding: tuple[str, ...]
    effects: tuple[ParameterEffect, ...]
    p_value: float
    pareto: IntArray
    failed: int


def find_optimum(
    surface: TaskSurface, *, objective: str = "rms", level: float = 0.05, rig_minutes_max: float | None = None
) -> Optimum:
    """Find the best protocol of a task, and those that are as good.

    Parameters
    ----------
    surface : TaskSurface
        Errors of all subjects with all protocols.
    objective : str
        rms or maximum.
    level : float
        Of the tests.
    rig_minutes_max : float, optional
        Longest session that is allowed, min.

    Returns
    -------
    Optimum
        With its statistics.

    Raises
    ------
    NotObservable
        No protocol calibrated every subject's device, or none is short enough.
    """
    error = surface.error(objective)
    allowed = surface.rig_minutes <= (np.inf if rig_minutes_max is None else rig_minutes_max)
    usable: BoolArray = np.isfinite(error).all(axis=0) & allowed
    if not usable.any():
        raise NotObservable(
            f"study: wanted a protocol of {surface.task} that calibrates every device in the time allowed, got none; "
            "allow longer sessions or other rates"
        )
    mean = np.where(usable, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    best = int(np.argmin(mean))
    equivalent = _equivalent(error, usable, best, level)
    among = np.flatnonzero(equivalent)
    cheapest = int(among[np.lexsort((mean[among], surface.rig_minutes[among]))[0]])
    effects = effects_at(surface, best, error=error, allowed=allowed, level=level)
    honest, interval = _honest(error, usable)
    tested = [effect.p_holm for effect in effects if effect.test is not None]
    deciding = tuple(effect.name for effect in effects if effect.p_holm < level)
    return Optimum(
        task=surface.task,
        best=best,
        error_rms_deg=float(surface.error_rms_deg[:, best].mean()),
        error_max_deg=float(surface.error_max_deg[:, best].mean()),
        honest_error_deg=honest,
        honest_interval_deg=interval,
        equivalent=equivalent,
        cheapest=cheapest,
        flat=bool(equivalent.sum() >= FLAT_SHARE * usable.sum()) and not deciding,
        deciding=deciding,
        effects=effects,
        p_value=min(tested) if tested else float("nan"),
        pareto=pareto_front(surface.rig_minutes, mean),
        failed=int(np.isnan(error).sum()),
    )


def pareto_front(minutes: FloatArray, error: FloatArray) -> IntArray:
    """Return the protocols that no other beats in both time and error.

    Parameters
    ----------
    minutes : array, shape (P,)
        Length of the session, min.
    error : array, shape (P,)
        Mean error; infinite where it is not to be used.

    Returns
    -------
    array of int
        Places, by rising minutes and falling error.
    """
    front: list[int] = []
    least = np.inf
    for place in np.lexsort((error, minutes)):
        if error[place] < least:
            front.append(int(place))
            least = error[place]
    return np.array(front, dtype=np.int64)


def _equivalent(error: FloatArray, usable: BoolArray, best: int, level: float) -> BoolArray:
    from scipy.stats import t as t_distribution

    subjects = len(error)
    places = np.flatnonzero(usable)
    apart = error[:, places] - error[:, [best]]
    spread = apart.std(axis=0, ddof=1) / np.sqrt(subjects)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(spread > 0.0, apart.mean(axis=0) / spread, np.where(apart.mean(axis=0) > 0.0, np.inf, 0.0))
    p = t_distribution.sf(t, subjects - 1)  # one-sided: worse than the best
    found = np.zeros(len(usable), dtype=bool)
    found[places] = adjust_holm(p) >= level
    found[best] = True
    return found


def _honest(error: FloatArray, usable: BoolArray) -> tuple[float, tuple[float, float]]:
    """Error of the protocol that the other half of the subjects chose, each subject once."""
    from scipy.stats import t as t_distribution

    places = np.flatnonzero(usable)
    half = np.arange(len(error)) % 2 == 0
    judged = np.empty(len(error))
    for choosing in (half, ~half):
        chosen = places[int(np.argmin(error[np.ix_(choosing, places)].mean(axis=0)))]
        judged[~choosing] = error[~choosing, chosen]
    mean, spread = float(judged.mean()), float(judged.std(ddof=1) / np.sqrt(len(judged)))
    reach = float(t_distribution.ppf(0.975, len(judged) - 1)) * spread
    return mean, (mean - reach, mean + reach)
