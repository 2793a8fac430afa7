"""Accelerometers from mean readings in free poses, without a recording."""

import numpy as np
from numpy.typing import ArrayLike

from undrift.calibration.norm import check_count, fit_norm, judged
from undrift.fit.triad import TriadFit


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
    check_count(reading, known_noise=variances is not None)
    return judged(fit_norm(reading, gravity=gravity, variances=variances), reading, unit_in)
