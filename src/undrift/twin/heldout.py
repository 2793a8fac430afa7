"""Held out: the twin simulated on a motion that it was not fitted to, against what the real device said of it.

The twin comes from the other recordings of the device. Its readings of the held-out motion and the real readings are corrected
alike, by the twin's matrix and each less its own offset, and integrated from the same orientation over every window. What
counts is the largest difference of sagittal pitch in a window, where the vertical is within 60 deg of the sagittal plane:
beyond, pitch stretches a difference of tilt more than twofold and loses its meaning. Beside it stands the largest angle
between the two verticals, which needs no plane, and the difference at the window's end about each axis of the body.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.reference_windows import restored
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.orientation.angles import sagittal_pitch
from undrift.orientation.strapdown import integrate_strapdown
from undrift.segments.still import runs
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline
from undrift.twin.device import device_of, with_offset
from undrift.twin.fit import Prepared, Twin, fit_prepared
from undrift.twin.match import Match
from undrift.validation.errors import wrapped

LENGTHS_S = (5.0, 50.0)
SHARED_CLOCK_S = 1e-3  # delays of a device's recordings agree to this where device and optics share a clock
IN_PLANE = 0.5  # shortest part of the vertical in the sagittal plane
STRIDE_S = 0.5  # from one window to the next
POINTS_PER_S = 36.0  # at which a window is looked at
MOTION_SETTINGS = PoseSettings(cutoff_hz=20.0, position_cutoff_hz=10.0)
_FRESH = 30  # samples: shorter stretches hold nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowErrors:
    """Differences over all windows of one length.

    Parameters
    ----------
    pitch : array, shape (W,)
        Largest difference of pitch in each window, rad; NaN where the vertical never came near the plane.
    tilt : array, shape (W,)
        Largest angle between the verticals, rad.
    end : array, shape (W, 3)
        Size of the difference at the end about each axis of the body, rad.
    """

    pitch: FloatArray
    tilt: FloatArray
    end: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutTrial:
    """One held-out recording.

    Parameters
    ----------
    recording : str
        Name.
    window_s : float
        Length of the windows, s.
    errors : WindowErrors
        Of all windows.
    """

    recording: str
    window_s: float
    errors: WindowErrors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stage:
    """A held-out motion and how the twin stands to it.

    Parameters
    ----------
    match : Match
        The held-out recording.
    twin : Twin
        Of the others.
    device : DeviceModel
        The twin without delay: the motion is asked at the delayed instants.
    motion : Motion
        What the poses tell, at those instants.
    offset : array, shape (3,)
        Of the real readings in motion: their own rest plus the twin's change from rest to motion, rad/s.
    """

    match: Match
    twin: Twin
    device: DeviceModel
    motion: Motion
    offset: FloatArray

    def corrected(self, readings: FloatArray, offset: FloatArray) -> FloatArray:
        """Return readings corrected by the twin's matrix.

        Parameters
        ----------
        readings : array, shape (N, 3)
            Rounding given back, rad/s.
        offset : array, shape (3,)
            Taken off first, rad/s.

        Returns
        -------
        array, shape (N, 3)
            rad/s, frame of the optical body.
        """
        done: FloatArray = (readings - offset) @ self.twin.gyro.triad.model.matrix.T
        return done

    def simulated(self, device: DeviceModel, rng: np.random.Generator) -> FloatArray:
        """Return what a device says of the motion, corrected as the real readings are.

        Parameters
        ----------
        device : DeviceModel
            The twin or a variation of it.
        rng : Generator
            Noise.

        Returns
        -------
        array, shape (N, 3)
            rad/s, frame of the optical body.
        """
        said = np.asarray(simulate_device(device, self.motion, rng=rng).record.gyro, dtype=np.float64)
        adc = self.twin.adc if device.gyro.adc is not None else None
        offset = self.twin.gyro.triad.model.offset
        return self.corrected(restored(said, adc), offset)


def hold_out(prepared: Prepared, number: int, *, twin: Twin | None = None) -> Stage:
    """Fit the twin to all recordings but one, and put the one before it.

    Parameters
    ----------
    prepared : Prepared
        Two recordings of a device or more.
    number : int
        Which one is held out.
    twin : Twin, optional
        Instead of the fit to the others.

    Returns
    -------
    Stage
        Ready to be simulated.

    Raises
    ------
    InputError
        One recording alone.
    """
    others = [k for k in range(len(prepared.records)) if k != number]
    if twin is None:
        if not others:
            raise InputError("twin: wanted two recordings to hold one out, got one; record the device a second time")
        twin = fit_prepared(prepared, chosen=others, brief=True)
    match = prepared.matches[number]
    rate = match.record.sample_rate_hz
    lag = twin.delay if abs(match.lag.seconds - twin.delay) < SHARED_CLOCK_S else match.lag.seconds
    spline = fit_pose_spline(replace(match.reference, position=None), MOTION_SETTINGS)
    motion = spline.at(match.record.time - (lag - 0.5 / rate), twin.settings.gravity_m_s2)
    device = replace(device_of(twin, sample_rate_hz=rate), sampling=Sampling())
    return Stage(
        match=match,
        twin=twin,
        device=device,
        motion=motion,
        offset=match.rest_offset + twin.gyro.motion_offset,
    )


def compare_held_out(
    prepared: Prepared, *, rng: np.random.Generator, lengths_s: Sequence[float] = LENGTHS_S
) -> tuple[HeldOutTrial, ...]:
    """Hold every recording out in turn and compare the twin of the others with it.

    Parameters
    ----------
    prepared : Prepared
        Two recordings of a device or more.
    rng : Generator
        Noise of the simulated devices.
    lengths_s : sequence of float
        Lengths of the windows, s.

    Returns
    -------
    tuple of HeldOutTrial
        One for each recording and length that fits into it.

    Raises
    ------
    InputError
        One recording alone.
    """
    found = []
    for number in range(len(prepared.records)):
        stage = hold_out(prepared, number)
        real = stage.corrected(stage.match.gyro, stage.offset)
        said = stage.simulated(stage.device, rng)
        for length in lengths_s:
            errors = window_errors(stage, real, said, length)
            if len(errors.pitch):
                found.append(HeldOutTrial(recording=stage.match.name, window_s=length, errors=errors))
    return tuple(found)


def window_errors(stage: Stage, one: FloatArray, other: FloatArray, length_s: float) -> WindowErrors:
    """Compare two rates over every window of the motion.

    Parameters
    ----------
    stage : Stage
        Motion and initial orientations.
    one, other : array, shape (N, 3)
        Corrected rates, rad/s.
    length_s : float
        Length of the windows, s.

    Returns
    -------
    WindowErrors
        No rows where no window fits between the gaps.
    """
    known = stage.match.moving & (np.asarray(stage.motion.valid) > 0.0)
    known &= np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    rows = [run_errors(stage.motion, one, other, slice(int(a), int(b)), length_s) for a, b in runs(known)]
    table = np.concatenate([r for r in rows if len(r)] or [np.empty((0, 5))])
    return WindowErrors(pitch=table[:, 0], tilt=table[:, 1], end=table[:, 2:])


def run_errors(motion: Motion, one: FloatArray, other: FloatArray, rows: slice, length_s: float) -> FloatArray:
    """Compare two rates over every window of one stretch.

    Parameters
    ----------
    motion : Motion
        Known throughout the stretch.
    one, other : array, shape (N, 3)
        Corrected rates, rad/s.
    rows : slice
        The stretch.
    length_s : float
        Length of the windows, s.

    Returns
    -------
    array, shape (W, 5)
        Largest difference of pitch and of tilt, difference at the end about each axis, rad.
    """
    time, q = motion.time[rows], motion.q_nb[rows]
    rate = motion.sample_rate_hz
    samples, stride = round(length_s * rate), max(1, round(STRIDE_S * rate))
    if len(time) <= max(samples, _FRESH):
        return np.empty((0, 5))
    tracks = [integrate_strapdown(w[rows], time, q[0]) for w in (one, other)]
    within: IntArray = np.arange(0, samples + 1, max(1, round(rate / POINTS_PER_S)))
    within[-1] = samples
    return np.array([_window(tracks, q, first, within) for first in range(0, len(time) - samples, stride)])


def _window(tracks: Sequence[FloatArray], q: FloatArray, first: int, within: IntArray) -> FloatArray:
    a, b = (
        quaternion_product(quaternion_product(q[first], quaternion_conjugate(t[first])), t[first + within])
        for t in tracks
    )
    vertical = rotate(quaternion_conjugate(b), np.array([0.0, 0.0, 1.0]))
    near = np.hypot(vertical[:, 0], vertical[:, 2]) > IN_PLANE
    pitch = np.abs(wrapped(sagittal_pitch(a) - sagittal_pitch(b)))[near]
    turn = rotation_vector(quaternion_product(quaternion_conjugate(b), a))
    tilt = np.linalg.norm(np.cross(turn, vertical), axis=1)  # small: the part of the turn across the vertical
    largest = np.nanmax(pitch) if np.isfinite(pitch).any() else np.nan
    return np.concatenate(([largest, tilt.max()], np.abs(turn[-1])))


def plain(device: DeviceModel) -> DeviceModel:
    """Return the device without noise and rounding.

    Parameters
    ----------
    device : DeviceModel
        The twin.

    Returns
    -------
    DeviceModel
        The same scale and offset.
    """
    offset = device.gyro.raw_offset
    return with_offset(replace(device, gyro=replace(device.gyro, white_noise=None, adc=None)), offset)
