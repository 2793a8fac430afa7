"""Front of error against minutes on the rig: the protocols that no other beats in both."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.study.plan import Aim
from undrift.study.run import TaskSurface
from undrift.validation.agreement import mean_interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Front:
    """The protocols that no other beats in both error and minutes."""

    surface: TaskSurface  # Of all that were tried
    places: IntArray  # (n,), by rising minutes
    mean_deg: FloatArray  # (n,), of the objective
    interval_deg: FloatArray  # (n, 2), its 95 % interval


def pareto_front(minutes: FloatArray, error: FloatArray) -> IntArray:
    """Return the protocols that no other beats in both time and error: minutes (P,), error (P,)."""
    front: list[int] = []
    least = np.inf
    for place in np.lexsort((error, minutes)):
        if error[place] < least:
            front.append(int(place))
            least = error[place]
    return np.array(front, dtype=np.int64)


def front_of(surface: TaskSurface, aim: Aim) -> Front:
    """Find the front of a surface."""
    error = surface.aimed(aim)
    whole = np.isfinite(error).all(axis=0) & (surface.rig_minutes <= (aim.rig_minutes_max or np.inf))
    mean = np.where(whole, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    places = pareto_front(surface.rig_minutes, mean)
    ends = np.array([mean_interval(error[:, place])[1] for place in places]).reshape(-1, 2)
    return Front(surface=surface, places=places, mean_deg=mean[places], interval_deg=ends)
