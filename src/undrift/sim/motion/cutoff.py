"""Cut-off: how much of a pose sequence is motion and how much is camera noise, and where to cut.

Four ways, of which each states its reason::

    fixed      a number that the caller stands for
    residual   R(f) = rms(x - lowpass(x, f)); the straight line of the noise, through the upper half of f, meets f = 0 at the
               noise's own rms; the cut-off is where R(f) falls to it [1]_
    rest       the lowest f from where on the spectrum of the motion stays below twice that of a rest
    gyro       the f at which the rate from the poses is closest to that of a real gyroscope, 3 x 3 and offset free

References
----------
.. [1] D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed., 2009, section 3.4.4.3.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.record import Reference
from undrift.sim.motion.gaps import find_stretches
from undrift.sim.motion.lowpass import zero_phase
from undrift.sim.motion.poses import PoseSettings, evenly, fit_pose_spline, signed
from undrift.units import RADIAN_PER_DEGREE

Method = Literal["fixed", "residual", "rest", "gyro"]
Signal = Literal["orientation", "position"]
_SMOOTH_HZ = 2.0  # a spectrum of few segments scatters by half: neighbours are averaged
_TOP = 0.35  # of the sample rate: the highest cut-off that is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class CutoffSettings:
    """What a cut-off is chosen by.

    Parameters
    ----------
    fixed_hz : float
        For method fixed, Hz.
    lowest_hz : float
        Lowest that is tried, Hz.
    tries : int
        Cut-offs tried, from lowest to 0.35 of the sample rate, in equal ratios.
    rest_s : tuple of float or None
        Rest for method rest, s; None takes the longest stretch that the recording does not mark as moving.
    noise_factor : float
        Power of the motion over that of the rest at which it counts as noise.
    segment_s : float
        Length of a spectrum's segments, s; the resolution is its inverse.
    """

    fixed_hz: float = 20.0
    lowest_hz: float = 1.0
    tries: int = 40
    rest_s: tuple[float, float] | None = None
    noise_factor: float = 2.0
    segment_s: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cutoff:
    """A cut-off and why.

    Parameters
    ----------
    cutoff_hz : float
        3 dB down after both passes, Hz.
    method : str
        fixed, residual, rest or gyro.
    reason : str
        One sentence with the figures it rests on.
    """

    cutoff_hz: float
    method: Method
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealRate:
    """Readings of a real gyroscope on the clock of the poses.

    Parameters
    ----------
    time : array, shape (N,)
        s, its delay taken off.
    rate : array, shape (N, 3)
        rad/s, axes and offset as they are.
    """

    time: FloatArray
    rate: FloatArray


def choose_cutoff(
    reference: Reference,
    *,
    method: Method,
    signal: Signal = "orientation",
    settings: CutoffSettings = CutoffSettings(),
    gyro: RealRate | None = None,
) -> Cutoff:
    """Choose the cut-off of the low-pass for poses.

    Parameters
    ----------
    reference : Reference
        Poses at the frames that the instrument took.
    method : str
        fixed, residual, rest or gyro.
    signal : str
        orientation or position.
    settings : CutoffSettings
        What it is chosen by.
    gyro : RealRate, optional
        For method gyro.

    Returns
    -------
    Cutoff
        With its reason.

    Raises
    ------
    InputError
        Another method or signal; no rest, no gyroscope, no position where the method needs it.
    """
    if method not in get_args(Method) or signal not in get_args(Signal):
        raise InputError(
            f"cut-off: wanted a method of {', '.join(get_args(Method))} and a signal of {', '.join(get_args(Signal))}, got "
            f"{method!r} and {signal!r}; choose one of each"
        )
    if method == "fixed":
        return Cutoff(cutoff_hz=settings.fixed_hz, method=method, reason=f"{settings.fixed_hz:g} Hz as stated")
    if method == "gyro":
        if gyro is None or signal != "orientation":
            raise InputError(
                "cut-off: wanted readings of a gyroscope and the orientation, got other; choose method residual"
            )
        return _by_gyro(reference, gyro, settings)
    if method == "rest":
        return _by_rest(reference, signal, settings)
    return _by_residual(reference, signal, settings)


def _by_residual(reference: Reference, signal: Signal, settings: CutoffSettings) -> Cutoff:
    time, values = _series(reference, signal, np.ones(len(reference), dtype=np.bool_))
    rate = float((len(time) - 1) / (time[-1] - time[0]))
    tried = np.linspace(settings.lowest_hz, _TOP * rate, 4 * settings.tries)
    left = np.array([_rms(values - zero_phase(values, f, sample_rate_hz=rate)) for f in tried])
    upper = tried > 0.5 * tried[-1]
    _, noise = np.polyfit(tried[upper], left[upper], 1)
    below = np.flatnonzero(left <= noise)
    chosen = float(tried[below[0]]) if below.size else float(tried[-1])
    unit, scale = ("deg", 1.0 / RADIAN_PER_DEGREE) if signal == "orientation" else ("mm", 1e3)
    return Cutoff(
        cutoff_hz=chosen,
        method="residual",
        reason=f"what a low-pass at {chosen:.1f} Hz leaves equals the noise of {scale * noise:.3g} {unit} rms that the line from "
        f"{tried[upper][0]:.0f} to {tried[-1]:.0f} Hz points to",
    )


def _by_rest(reference: Reference, signal: Signal, settings: CutoffSettings) -> Cutoff:
    from scipy.signal import welch

    rest = _rest(reference, settings)
    spectra = []
    for part in (rest, ~rest):
        time, values = _series(reference, signal, part)
        rate = float((len(time) - 1) / (time[-1] - time[0]))
        length = round(settings.segment_s * rate)
        if len(time) < length:
            raise InputError(
                f"cut-off: wanted {settings.segment_s:g} s or more of rest and of motion without a long gap, got "
                f"{time[-1] - time[0]:.2g} s; state rest_s or shorten segment_s"
            )
        power = welch(values, rate, nperseg=length, axis=0, detrend="linear")[1].sum(axis=1)  # type: ignore[call-overload]  # its stub spells linear "literal"
        width = round(_SMOOTH_HZ * settings.segment_s) + 1
        spectra.append(np.convolve(power, np.full(width, 1.0 / width), mode="same"))
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    use = (frequency >= settings.lowest_hz) & (frequency <= _TOP * rate)
    above = np.flatnonzero(use & (spectra[1] > settings.noise_factor * spectra[0]))
    last = float(frequency[use][-1])
    chosen = float(frequency[above[-1] + 1]) if above.size else settings.lowest_hz
    if chosen > last:  # cameras are noisier in motion than at rest
        reason = f"up to {last:.1f} Hz, the highest tried, the motion has more than {settings.noise_factor:g} times the power"
        return Cutoff(cutoff_hz=last, method="rest", reason=f"{reason} of the rest: no crossing, choose another method")
    return Cutoff(
        cutoff_hz=chosen,
        method="rest",
        reason=f"from {chosen:.1f} Hz on the motion has less than {settings.noise_factor:g} times the power of the rest",
    )


def _by_gyro(reference: Reference, gyro: RealRate, settings: CutoffSettings) -> Cutoff:
    tried = np.geomspace(settings.lowest_hz, _TOP * reference.sample_rate_hz, settings.tries)
    poses = replace(reference, position=None)
    left, signal = [], 0.0
    for f in tried:
        motion = fit_pose_spline(poses, PoseSettings(cutoff_hz=float(f))).at(gyro.time, 0.0)
        use = (motion.valid * motion.moving > 0.0) & np.isfinite(gyro.rate).all(axis=1)
        if use.sum() < 100:
            raise InputError(
                f"cut-off: wanted 100 readings or more while the poses move, got {use.sum()}; check the gyroscope's clock"
            )
        design = np.column_stack((motion.rate_b[use], np.ones(use.sum())))
        solution = np.linalg.lstsq(design, gyro.rate[use])[0]
        left.append(_rms(gyro.rate[use] - design @ solution))
        signal = _rms(gyro.rate[use])
    best = int(np.argmin(left))
    return Cutoff(
        cutoff_hz=float(tried[best]),
        method="gyro",
        reason=f"at {tried[best]:.1f} Hz the rate from the poses is closest to the gyroscope: "
        f"{left[best] / RADIAN_PER_DEGREE:.3g} of {signal / RADIAN_PER_DEGREE:.3g} deg/s rms are left",
    )


def _rest(reference: Reference, settings: CutoffSettings) -> BoolArray:
    time = reference.time
    if settings.rest_s is not None:
        return np.asarray((time >= settings.rest_s[0]) & (time <= settings.rest_s[1]))
    if reference.moving is None or not (reference.moving == 0.0).any():
        raise InputError("cut-off: wanted a rest, got no stretch marked as not moving; state rest_s")
    return np.asarray(reference.moving == 0.0)


def _series(reference: Reference, signal: Signal, part: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the longest stretch of a part of the poses: even time, and quaternions doubled (rad) or coordinates (m)."""
    seen = reference.valid & part
    if signal == "position":
        if reference.position is None:
            raise InputError("cut-off: wanted positions, got poses without; choose the orientation")
        seen &= np.isfinite(reference.position).all(axis=1)
    stretches = find_stretches(reference.time, seen, trim_s=0.0, end_trim_s=0.0)
    rows = max(stretches, key=lambda stretch: len(stretch.rows)).rows
    poses = reference.position[rows] if reference.position is not None and signal == "position" else None
    values = 2.0 * signed(reference.q_nb[rows]) if poses is None else poses
    return evenly(reference.time[rows], values, 1.0 / reference.sample_rate_hz)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).sum(axis=1).mean() / 3.0))
