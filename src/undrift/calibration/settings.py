"""Choices of a calibration that a session file does not make: its fits, options of the command, fields of ``CalibrateSettings``.

Nothing here imports numpy: the command line shows its help from these classes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from inspect import cleandoc
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypeVar

from undrift.fit.priors import SETTLE_S

Kind = TypeVar("Kind", bound=type)
_HEAD = "Parameters\n----------\n"


class FitMethod(NamedTuple):
    """A way to calibrate: its words on a certificate, and what fits each triad, a function or its place in this package."""

    words: str = ""
    accel: str | Callable[..., Any] | None = (
        None  # of what a session shows, the mode, and the accelerometer's fit if any
    )
    gyro: str | Callable[..., Any] | None = None  # likewise
    reference: str | Callable[..., Any] | None = None  # called as ``fit_reference``


FITS = {
    "six-face": FitMethod("six faces against gravity", accel="six_face:calibrate_faces"),
    "rate-table": FitMethod("steady rates of a rate table, about each axis", gyro="rate_table:calibrate_rates"),
    "known-rotation": FitMethod("turns by a known angle about each axis", gyro="known_rotation:calibrate_turns"),
    "multi-position": FitMethod(
        "rests in free poses against the size of gravity",
        *("multi_position:calibrate_poses", "multi_position:calibrate_moves"),
    ),
    "rest": FitMethod("rests alone: offset only, the scale factor is nominal", gyro="calibrate:calibrate_rest"),
    "reference": FitMethod("motion against an orientation reference", reference="reference:fit_reference"),
    "motion": FitMethod("gravity in free motion, nothing else"),  # both triads at once: calibrate_from_motion
}
if TYPE_CHECKING:
    AccelFit: TypeAlias = str
    GyroFit: TypeAlias = str
else:
    AccelFit = Literal[tuple(name for name, fit in FITS.items() if fit.accel)]
    GyroFit = Literal[(*(name for name, fit in FITS.items() if fit.gyro), "none")]


def documented(cls: Kind) -> Kind:
    """Put what the bases of a settings class say of their fields behind what it says of its own."""
    own, mark, examples = cleandoc(cls.__doc__ or "").partition("\n\nExamples\n")
    parts = [cleandoc(base.__doc__ or "").partition(_HEAD)[2] for base in cls.__bases__]
    cls.__doc__ = "\n".join((own, *parts)) + mark + examples
    return cls


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """How readings are averaged and fitted.

    Parameters
    ----------
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell at a known rate that is left out, s; at most half of the dwell.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    axis_uncertainty_deg : float
        Standard uncertainty of the axis of such turns against the case, about each axis across it, deg; the same for all turns
        about one axis, as a fixture or a straight edge errs.
    scale_tolerance : float
        Largest relative difference of a scale factor from the stated unit; physical units only.
    polynomial_degree : int
        Degree of the polynomial in time that filters each face before it is averaged; it sets the noise of the mean.
    spline_cutoff_hz : float or None
        Low-pass each dwell at a known rate by the note's cubic spline, which halves it at this cut-off, Hz; no filter by default.
    cross_axis_prior : float
        Standard deviation of a cross-axis term that the session does not show, relative to the scale; 0.01 is 1 %.
    """

    window_s: float = 6.0
    settle_s: float = SETTLE_S
    angle_uncertainty_deg: float = 1.0
    axis_uncertainty_deg: float = 0.5
    scale_tolerance: float = 0.25
    polynomial_degree: int = 1
    spline_cutoff_hz: float | None = None
    cross_axis_prior: float = 0.01


@dataclass(frozen=True, kw_only=True)
class Table:
    """How good the rate table of a session is, in place of what the session states.

    Parameters
    ----------
    table_level_deg : float or None
        Standard uncertainty of the rate table's axis against the vertical, deg; as the session states, else 0.1.
    mount_tilt_deg : float or None
        Standard uncertainty of the mounting on the table about each axis, deg; as the session states, else 0.1. It stays in the
        covariance in full where accelerometers do not show the table's axis.
    rate_uncertainty : float or None
        Standard uncertainty of the stated rates in common, relative; as the session states, else 0.0001.
    wobble_deg : float or None
        Standard uncertainty of the table's axis from dwell to dwell, deg; as the session states, else 0.01. Scatter that shows
        more counts instead.
    """

    table_level_deg: float | None = None
    mount_tilt_deg: float | None = None
    rate_uncertainty: float | None = None
    wobble_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """How far the device may follow its temperature within a session; a session.toml states it under [temperature].

    Parameters
    ----------
    gyro_offset_dps_per_k : float or None
        Standard deviation of the gyroscopes' offset drift, deg/s per K; as the session states, else 0.05.
    accel_offset_mg_per_k : float or None
        Standard deviation of the accelerometers' offset drift, mg per K; as the session states, else 0.5.
    gyro_scale_percent_per_k : float or None
        Standard deviation of the gyroscopes' change of scale, % per K; as the session states, else 0.02.
    accel_scale_percent_per_k : float or None
        Standard deviation of the accelerometers' change of scale, % per K; as the session states, else 0.02.
    unrecorded_span_k : float or None
        Change of temperature where nothing shows it, neither a temperature column nor rests in deg/s, K; else 1.
    thermometer_lag_s : float or None
        Lag of the thermometer behind the sensors, s; as the session states, else 0, as on one die with them.
    span_limit_k : float or None
        Largest change of temperature within a session without a finding, K; as the session states, else 2.
    """

    gyro_offset_dps_per_k: float | None = None
    accel_offset_mg_per_k: float | None = None
    gyro_scale_percent_per_k: float | None = None
    accel_scale_percent_per_k: float | None = None
    unrecorded_span_k: float | None = None
    thermometer_lag_s: float | None = None
    span_limit_k: float | None = None
