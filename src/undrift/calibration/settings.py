"""Settings of a calibration that neither the recordings nor a session file contain."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from undrift.errors import InputError
from undrift.fit.priors import SETTLE_S
from undrift.segments import StillSettings

AccelFit = Literal["six-face", "multi-position"]
GyroFit = Literal["rate-table", "known-rotation", "multi-position", "rest", "none"]
Mode = Literal["paper", "affine"]


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings:
    """Settings of a calibration.

    The quality of a rate table and the temperature sensitivity of a device belong to a ``Session`` (``rate_table``,
    ``sensitivity``).

    Parameters
    ----------
    still : StillSettings
        Detection of still phases in a session without given stills.
    latitude_deg : float or None
        Latitude for the Earth's rate on a rate table, deg. None ignores the Earth's rate.
    turn_angle_deg : float or None
        Angle of the turns between rests in a session without given turns, deg. None uses no angle.
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell at a known rate that is omitted, s, at most half of the dwell.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    axis_uncertainty_deg : float
        Standard uncertainty of the direction of the turn axis in the case, about each perpendicular axis, deg. The error is
        common to all turns about the same axis, as for a fixture or a straight edge.
    polynomial_degree : int
        Degree of the polynomial in time that filters each face before it is averaged. It determines the noise of the mean.
    spline_cutoff_hz : float or None
        Cut-off of the note's cubic spline, Hz, which low-pass filters each dwell at a known rate. None applies 5 Hz in mode paper,
        and no filter in mode affine.
    cross_axis_prior : float
        Standard deviation of a cross-axis term that the session does not determine, relative to the scale (0.01 is 1 %).
    identify_adc : bool
        If True, identify step and rounding of the codes.
    Examples
    --------
    >>> import undrift
    >>> undrift.CalibrateSettings(polynomial_degree=2).window_s
    6.0
    """

    still: StillSettings = field(default_factory=StillSettings)
    latitude_deg: float | None = None
    turn_angle_deg: float | None = None
    window_s: float = 6.0
    settle_s: float = SETTLE_S
    angle_uncertainty_deg: float = 1.0
    axis_uncertainty_deg: float = 0.5
    polynomial_degree: int = 1
    spline_cutoff_hz: float | None = None
    cross_axis_prior: float = 0.01
    identify_adc: bool = True

    def __post_init__(self) -> None:
        limits = {
            "latitude_deg": (-90.0, 90.0),
            "turn_angle_deg": (np.nextafter(0.0, 1.0), np.inf),
            "window_s": (np.nextafter(0.0, 1.0), np.inf),
            "settle_s": (0.0, np.inf),
            "angle_uncertainty_deg": (0.0, 90.0),
            "axis_uncertainty_deg": (0.0, 90.0),
            "polynomial_degree": (0, np.inf),
            "spline_cutoff_hz": (np.nextafter(0.0, 1.0), np.inf),
            "cross_axis_prior": (1e-6, 0.2),
        }
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise InputError(f"calibrate: {name} must be from {least:.2g} to {most:g}, got {value:g}")
