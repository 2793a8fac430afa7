"""Free poses without a session: accelerometers from mean readings, and both triads from recordings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.calibration import moves
from undrift.calibration.norm import check_count, fit_norm, judged
from undrift.errors import NotObservable
from undrift.fit.triad import TriadFit
from undrift.record import Record, Still
from undrift.segments import find_poses


def fit_poses(
    means: ArrayLike,
    *,
    gravity: float,
    standard_errors: ArrayLike | None = None,
    unit_in: str = "count",
) -> TriadFit:
    """Fit to mean readings (K, 3) of any direction, with standard errors where known."""
    reading = np.asarray(means, float)
    variances = None if standard_errors is None else np.asarray(standard_errors, float) ** 2
    check_count(reading, 10 if variances is None else 9)
    return judged(fit_norm(reading, gravity=gravity, variances=variances), reading, unit_in)


@dataclass(frozen=True)
class PosesFit:
    """Accelerometer and, if the moves determine them, gyroscopes."""

    accel: TriadFit
    gyro: TriadFit | None
    stills: tuple[Still, ...]


def fit_multi_position(
    recorded: Record | Sequence[Record],
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    gyro: bool = True,
    cross_axis_prior: float | None = 0.01,
) -> PosesFit:
    """Fit both triads to recordings of free poses and moves. Stills are detected if they are not given."""
    records = (recorded,) if isinstance(recorded, Record) else tuple(recorded)
    if stills is None:
        stills = [still for search in find_poses(records) for still in search.stills]
    used = tuple(sorted(stills, key=lambda still: (still.recording, still.start)))
    accel = moves.fit_poses(records, used, gravity=gravity, cross_axis_prior=cross_axis_prior)
    try:
        fit = moves.fit_moves(records, used, accel.model) if gyro else None
    except NotObservable:
        fit = None
    return PosesFit(accel=accel, gyro=fit, stills=used)
