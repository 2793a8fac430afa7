"""Match: a recording beside the ideal motion that its reference tells, on one time axis.

The motion is a spline through the poses (``sim.motion.poses``); it is asked at the instants that the readings stand for, the
record's time less the delay of the gyroscopes. What is compared is compared in the level frame n: a low-pass there acts on
readings and motion alike, whatever the body does meanwhile, and it commutes with the second derivative of the position.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.reference_windows import restored
from undrift.calibration.model import AdcModel
from undrift.errors import AlignmentError, InputError
from undrift.record import Record, Reference
from undrift.segments.still import runs
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.sync import Lag, LagSettings, find_lag, find_motion, native_poses
from undrift.sync import Motion as Span

LAG_SETTINGS = LagSettings()
POSE_SETTINGS = PoseSettings(cutoff_hz=30.0, position_cutoff_hz=30.0)
_LEAD_S = 0.5  # of rest that belongs to the motion on either side
_SHORTEST_S = 1.0  # stretches shorter than this are not filtered
_EDGE = 1.5  # periods of the cut-off left out at each end of a stretch
_PER_CUTOFF = 4.0  # samples kept for each period of the cut-off


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """One recording and the motion beside it.

    Parameters
    ----------
    name : str
        Of the recording.
    record : Record
        rad/s and m/s2, codes as they came.
    gyro : array, shape (N, 3)
        Readings with the mean loss of the ADC's rounding given back, rad/s.
    reference : Reference
        Poses at the frames that the cameras took.
    spline : PoseSpline
        Through them.
    lag : Lag
        Of the gyroscope readings against the poses.
    span : Motion
        Stretch of motion on the record's clock (of ``sync``).
    rest_offset : array, shape (3,)
        Mean of ``gyro`` at rest before the motion, rad/s.
    """

    name: str
    record: Record
    gyro: FloatArray
    reference: Reference
    spline: PoseSpline
    lag: Lag
    span: Span
    rest_offset: FloatArray

    def at(self, delay_s: float, gravity_m_s2: float) -> Motion:
        """Return the motion that readings with a given delay stand for.

        Parameters
        ----------
        delay_s : float
            How late the readings are, s.
        gravity_m_s2 : float
            Local gravity, m/s2.

        Returns
        -------
        Motion
            One row for each sample of the record, on the reference's clock.
        """
        return self.spline.at(self.record.time - delay_s, gravity_m_s2)

    @property
    def moving(self) -> BoolArray:
        """True within the motion, half a second of rest on either side included, shape (N,)."""
        inside: BoolArray = (self.record.time >= self.span.start_s - _LEAD_S) & (
            self.record.time < self.span.stop_s + _LEAD_S
        )
        return inside

    @property
    def rest(self) -> Record:
        """Readings of the rest before the motion, the ADC's rounding given back: truncation narrows noise about zero."""
        given_back = replace(self.record, gyro=self.gyro)
        return given_back.between(float(self.record.time[0]), self.span.start_s - _LEAD_S)


def match(
    record: Record,
    reference: Reference,
    *,
    adc: AdcModel | None = None,
    name: str = "",
    poses: PoseSettings = POSE_SETTINGS,
    lag_settings: LagSettings = LAG_SETTINGS,
) -> Match:
    """Bring a recording and its reference together.

    Parameters
    ----------
    record : Record
        Raw readings in a physical unit.
    reference : Reference
        Poses of the same body.
    adc : AdcModel or None
        Rounding of the codes, undone in ``Match.gyro``.
    name : str
        What to call it; the reference's name where empty.
    poses : PoseSettings
        Cut-offs and gap policy of the motion.
    lag_settings : LagSettings
        Of the lag search.

    Returns
    -------
    Match
        Ready for the fits.

    Raises
    ------
    InputError
        No gyroscope, or counts.
    AlignmentError
        No common motion, no rest before it, or nothing of it that the poses tell.
    """
    done = record.in_si()
    if done.gyro is None:
        raise InputError("twin: wanted a record with a gyroscope, got none; map its columns")
    frames = native_poses(reference)
    lag = find_lag(done, frames, lag_settings)
    span = find_motion(done, frames, lag_s=lag.seconds)
    gyro = restored(done.gyro, adc)
    at_rest = gyro[done.time < span.start_s - _LEAD_S]
    at_rest = at_rest[np.isfinite(at_rest).all(axis=1)]
    if not len(at_rest):
        raise AlignmentError("twin: wanted readings of a rest before the motion, got none; record a rest first")
    return Match(
        name=name or reference.name,
        record=done,
        gyro=gyro,
        reference=frames,
        spline=fit_pose_spline(frames, poses),
        lag=lag,
        span=span,
        rest_offset=at_rest.mean(axis=0),
    )


def stretches(match: Match, motion: Motion, readings: FloatArray) -> Iterator[slice]:
    """Yield stretches of motion in which both poses and readings are known, long enough to be filtered.

    Parameters
    ----------
    match : Match
        The recording.
    motion : Motion
        At its samples.
    readings : array, shape (N, C)
        What is compared; NaN is a gap.

    Yields
    ------
    slice
        Samples.
    """
    known = match.moving & (np.asarray(motion.valid) > 0.0) & np.isfinite(readings).all(axis=1)
    known &= np.isfinite(motion.force_b).all(axis=1) | np.isnan(motion.force_b).all()
    for start, stop in runs(known):
        if stop - start >= _SHORTEST_S * match.record.sample_rate_hz:
            yield slice(int(start), int(stop))


def smoothed(values: FloatArray, cutoff_hz: float, sample_rate_hz: float) -> tuple[FloatArray, IntArray]:
    """Return columns low-passed without delay, thinned to a few samples for each period, without the ends.

    Butterworth of second order forward and back, each pass 3 dB down at the cut-off, both together 6 dB.

    Parameters
    ----------
    values : array, shape (N, C)
        Evenly spaced, without gaps.
    cutoff_hz : float
        Hz.
    sample_rate_hz : float
        Hz.

    Returns
    -------
    values : array, shape (K, C)
        Filtered.
    rows : array, shape (K,)
        Which samples they are.
    """
    from scipy.signal import butter, sosfiltfilt

    edge = int(np.ceil(_EDGE * sample_rate_hz / cutoff_hz))
    step = max(1, int(sample_rate_hz / (_PER_CUTOFF * cutoff_hz)))
    rows: IntArray = np.arange(edge, len(values) - edge, step)
    sections = butter(2, cutoff_hz, fs=sample_rate_hz, output="sos")
    filtered: FloatArray = sosfiltfilt(sections, values, axis=0)[rows]
    return filtered, rows
