"""A motion from poses, at a sample rate or at given instants."""

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline


def motion_from_poses(
    reference: Reference,
    *,
    gravity_m_s2: float,
    sample_rate_hz: float | None = None,
    time: FloatArray | None = None,
    settings: PoseSettings = PoseSettings(),
) -> Motion:
    """Return the readings of an ideal sensor at the body's origin."""
    if (sample_rate_hz is None) == (time is None):
        raise InputError(
            "motion: expected either a sample rate or the instants, got "
            f"{'neither' if time is None else 'both'}. Give sample_rate_hz or time"
        )
    spline = fit_pose_spline(reference, settings)
    if time is not None:
        return spline.at(time, gravity_m_s2)
    start, stop = spline.span_s
    rate = float(sample_rate_hz or 0.0)
    return spline.at(start + np.arange(int((stop - start) * rate + 1e-6) + 1) / rate, gravity_m_s2)
