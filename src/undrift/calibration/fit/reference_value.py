"""Values of the reference fit: how it is asked, what it returns, and how it does on a recording that it has not seen."""

from dataclasses import dataclass, replace
from typing import Literal

from undrift.arrays import FloatArray
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import TriadModel
from undrift.errors import InputError

Offset = Literal["motion", "rest", "common"]
Weights = Literal["windows", "noise"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSettings:
    """How a device is fitted to a reference.

    Parameters
    ----------
    window_s : float
        First window, s: the error of the raw readings over it must stay below about 0.5 rad.
    longest_window_s : float
        Last window, s. Longer weighs pose noise less and slow changes of the offset more.
    stride_s : float
        From the start of one window to the next, s.
    huber : float
        Residuals up to this many standard deviations count fully.
    offset : str
        "motion": rest offset of each recording plus one fitted change from rest to motion. "rest": rest offsets alone.
        "common": one fitted offset for all, whatever they read at rest.
    g_sensitivity : bool
        Fit G as well; needs accelerometer readings.
    weights : str
        "windows": long windows, each alike. "noise": after the first windows, neighbouring poses as one chain weighed by
        the white noise of poses and readings.
    """

    window_s: float = 2.0
    longest_window_s: float = 16.0
    stride_s: float = 0.5
    huber: float = 1.345
    offset: Offset = "motion"
    g_sensitivity: bool = False
    weights: Weights = "windows"

    def __post_init__(self) -> None:
        if not 0.0 < self.stride_s <= self.window_s <= self.longest_window_s:
            raise InputError(
                "reference: wanted 0 < stride_s <= window_s <= longest_window_s, got "
                f"{self.stride_s:g}, {self.window_s:g}, {self.longest_window_s:g} s"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceFit:
    """A gyroscope fitted to references, pooled over recordings of one device.

    Parameters
    ----------
    triad : TriadFit
        Model, residuals of the longest windows (rad, shape (n, 3)), verdict. The model's offset is the mean in-motion
        offset of the recordings.
    motion_offset : array, shape (3,)
        Reading in motion less reading at rest, at zero rate, raw unit; zero unless ``offset`` is "motion".
    rest_offsets : array, shape (R, 3)
        Mean reading at rest of each recording, raw unit.
    lags_s, lag_uncertainties_s : array, shape (R,)
        Lag of each recording and its standard uncertainty, s.
    turn_rates_rms : array, shape (R,)
        Root-mean-square body rate of each recording in motion, rad/s.
    window_s : float
        Length of the longest windows that the recordings were long enough for, s.
    window_rms : float
        Robust standard deviation of the residual rotation of the longest windows, rad.
    offset_mode : str
        As in the settings.
    """

    triad: TriadFit
    motion_offset: FloatArray
    rest_offsets: FloatArray
    lags_s: FloatArray
    lag_uncertainties_s: FloatArray
    turn_rates_rms: FloatArray
    window_s: float
    window_rms: float
    offset_mode: Offset

    def model_at_rest_offset(self, rest_offset: FloatArray) -> TriadModel:
        """Return the model for a recording that reads ``rest_offset`` at rest.

        Parameters
        ----------
        rest_offset : array, shape (3,)
            Mean reading at rest, after ADC correction where the fit had one, raw unit.

        Returns
        -------
        TriadModel
            The fitted model with its offset moved to that recording; unchanged where the fit used one common offset.
        """
        if self.offset_mode == "common":
            return self.triad.model
        return replace(self.triad.model, offset=rest_offset + self.motion_offset)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """A recording judged by a fit to the others.

    Parameters
    ----------
    recording : int
        Its number.
    fit : ReferenceFit
        Fit to all others.
    model : TriadModel
        That fit with the held-out recording's own rest offset: nothing in it knows the held-out reference.
    before, after : float
        Root-mean-square rotation that is left over windows of ``window_s`` in the held-out recording, with the rest
        offset alone and with the model, rad.
    extrapolation : str
        Where the held-out rates exceed what the others saw; "" where they do not.
    """

    recording: int
    fit: ReferenceFit
    model: TriadModel
    before: float
    after: float
    extrapolation: str
