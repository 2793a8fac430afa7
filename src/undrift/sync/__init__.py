"""Sync: bring a record and a reference onto one clock, before any fit or comparison.

``native_poses`` undoes a linear up-sampling of the reference, ``pose_rates`` turns poses into mean rates, ``find_lag``
and ``find_axis_lag`` find how late the record's samples are, ``find_motion`` says where rest ends and begins again.
"""

from undrift.sync.lag import Lag, LagSettings, find_axis_lag, find_lag
from undrift.sync.motion import Motion, find_motion
from undrift.sync.native import native_poses
from undrift.sync.rates import PoseRates, pose_rates

__all__ = [
    "find_lag",
    "find_axis_lag",
    "Lag",
    "LagSettings",
    "find_motion",
    "Motion",
    "native_poses",
    "pose_rates",
    "PoseRates",
]
